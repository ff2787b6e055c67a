"""Gains from poles: of A - B K and, by duality, of A - L C."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError, ShapeError, StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Array, Floats, array, listed


def parse_poles(key: str, poles: Array, n: int) -> np.ndarray:
    """n complex poles from numbers or [real, imaginary] pairs, closed under conjugation. Raises InputError, ShapeError."""
    given = np.asarray(poles, object)
    if any(isinstance(pole, complex) for pole in given.ravel()):
        poles = np.stack([np.real(given.astype(complex)), np.imag(given.astype(complex))], axis=-1)
    numbers = array(key, poles)
    found = (
        numbers[:, 0] + 1j * numbers[:, 1]
        if numbers.ndim == 2 and numbers.shape[1] == 2
        else numbers.astype(complex)
    )
    if found.shape != (n,):
        many = "s" * (n != 1)
        raise ShapeError(
            f"{key}: expected {n} pole{many} (one per state; complex ones as [real, imaginary]), found {' x '.join(map(str, found.shape))}"
        )
    if not np.allclose(np.sort_complex(found), np.sort_complex(found.conj())):
        raise InputError(
            f"{key}: complex poles must come in conjugate pairs, found {listed(found)}"
        )
    return found


def place(A: Floats, B: Floats, poles: np.ndarray, key: str) -> Floats:
    """K (m x n) such that A - B K has these poles: Ackermann's formula for one input, scipy's place_poles for more.

    Raises StructureError if the pair is uncontrollable or the poles come out wrong.
    """
    n, m = B.shape
    if m == 1:
        controllability = np.hstack([np.linalg.matrix_power(A, k) @ B for k in range(n)])
        wanted = np.real(np.poly(poles))
        polynomial = sum(
            (c * np.linalg.matrix_power(A, n - k) for k, c in enumerate(wanted)), np.zeros((n, n))
        )
        try:
            K = np.linalg.solve(controllability.T, np.eye(n)[-1])[None, :] @ polynomial
        except np.linalg.LinAlgError:
            raise StructureError(
                f"{key}: the poles cannot be placed, the pair is uncontrollable"
            ) from None
        if not np.isfinite(A - B @ K).all():
            raise StructureError(
                f"{key}: the poles cannot be placed, their numbers and the plant's are too far apart"
            )
    else:
        from scipy.signal import place_poles

        try:
            K = place_poles(A, B, poles).gain_matrix
        except ValueError as error:
            raise StructureError(f"{key}: the poles cannot be placed: {error}") from None
    got = np.poly(A - B @ K)
    off = np.abs(got - np.poly(poles)).max() / np.abs(np.poly(poles)).max()
    if not off < 1e-6:
        raise StructureError(
            f"{key}: the poles cannot be placed accurately (characteristic polynomial off by {off:.1g}); the pair is nearly uncontrollable"
        )
    return np.asarray(K)


def _discretised(key: str, poles: Array, n: int, Ts: float | None) -> np.ndarray:
    found = parse_poles(key, poles, n)
    if (found.real >= 0).any():
        raise InputError(f"{key}: every pole must have a negative real part, found {listed(found)}")
    return found if Ts is None else np.exp(found * Ts)


def state_gain(
    linear: Matrices, poles: Array, Ts: float | None, key: str = "controller.poles"
) -> Floats:
    """K (m x n) that puts A - B K at continuous-time poles [1/s] (at e^{p Ts} for a sampled model)."""
    return place(linear.A, linear.B, _discretised(key, poles, linear.A.shape[0], Ts), key)


def observer_gain(
    linear: Matrices, poles: Array, Ts: float | None, key: str = "observer.poles"
) -> Floats:
    """L (n x p) that puts A - L C at continuous-time poles [1/s] (at e^{p Ts}, L per step, for a sampled model)."""
    return place(linear.A.T, linear.C.T, _discretised(key, poles, linear.A.shape[0], Ts), key).T
