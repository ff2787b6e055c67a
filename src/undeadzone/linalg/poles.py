"""Gains from poles: of A - B K and, by duality, of A - L C."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError, ShapeError, StructureError
from undeadzone.linalg.matrices import Matrices
from undeadzone.util.arrays import Array, Floats, describe_shape, list_numbers, require_array

ACCURATE = 1e-6  # error of the characteristic polynomial, relative to its largest coefficient


def parse_poles(key: str, poles: Array, n: int) -> np.ndarray:
    """Return complex poles from numbers or [real, imaginary] pairs (n).

    Args:
        key: named in errors.
        poles: n numbers, complex ones perhaps, or pairs (closed under conjugation).
        n: poles expected.

    Raises:
        InputError: not numbers, or not closed under conjugation.
        ShapeError: another number of poles.
    """
    entries = np.asarray(poles, object)
    if any(isinstance(pole, complex) for pole in entries.ravel()):
        numbers = entries.astype(complex)
        poles = np.stack([np.real(numbers), np.imag(numbers)], axis=-1)
    real = require_array(key, poles)
    if real.ndim == 2 and real.shape[1] == 2:
        parsed = real[:, 0] + 1j * real[:, 1]
    else:
        parsed = real.astype(complex)
    if parsed.shape != (n,):
        expected = f"{n} pole{'s' * (n != 1)}"
        raise ShapeError(
            f"{key}: expected {expected} (one per state, complex ones as [real, imaginary]), "
            f"found {describe_shape(parsed.shape)}"
        )
    if not np.allclose(np.sort_complex(parsed), np.sort_complex(parsed.conj())):
        raise InputError(
            f"{key}: complex poles must come in conjugate pairs, found {list_numbers(parsed)}"
        )
    return parsed


def slowest_growth_rate(poles: np.ndarray, Ts: float | None) -> float:
    """Return the growth rate of the slowest mode [1/s], of a continuous or a sampled system."""
    if Ts is None:
        return float(poles.real.max())
    return float(np.log(max(np.abs(poles).max(), np.finfo(float).tiny)) / Ts)


def pole_placement_gain(A: Floats, B: Floats, poles: np.ndarray, key: str) -> Floats:
    """Return K (m x n) such that A - B K has given poles.

    Ackermann's formula for one input, scipy's place_poles for more.

    Args:
        A, B: the pair (n x n, n x m).
        poles: n complex numbers, closed under conjugation.
        key: named in errors.

    Returns:
        K (m x n).

    Raises:
        StructureError: the pair is uncontrollable, or the poles come out wrong.
    """
    K = (
        _ackermann_gain(A, B, poles, key)
        if B.shape[1] == 1
        else _multi_input_gain(A, B, poles, key)
    )
    desired = np.poly(poles)
    reached = np.poly(A - B @ K)
    off = np.abs(reached - desired).max() / np.abs(desired).max()
    if not off < ACCURATE:
        raise StructureError(
            f"{key}: the poles cannot be placed accurately (characteristic polynomial off by "
            f"{off:.1g}). The pair is nearly uncontrollable"
        )
    return np.asarray(K)


def _ackermann_gain(A: Floats, B: Floats, poles: np.ndarray, key: str) -> Floats:
    """Return the gain (1 x n) by Ackermann's formula."""
    n = A.shape[0]
    controllability = np.hstack([np.linalg.matrix_power(A, k) @ B for k in range(n)])
    polynomial = np.zeros((n, n))
    for k, coefficient in enumerate(np.real(np.poly(poles))):
        polynomial = polynomial + coefficient * np.linalg.matrix_power(A, n - k)
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
    return np.asarray(K)


def _multi_input_gain(A: Floats, B: Floats, poles: np.ndarray, key: str) -> Floats:
    """Return the gain (m x n) by scipy's place_poles, for several inputs."""
    from scipy.signal import place_poles

    try:
        return np.asarray(place_poles(A, B, poles).gain_matrix)
    except ValueError as error:
        raise StructureError(f"{key}: the poles cannot be placed: {error}") from None


def state_gain(
    linear: Matrices, poles: Array, Ts: float | None, key: str = "controller.poles"
) -> Floats:
    """Return K (m x n) that puts A - B K at continuous-time poles.

    Args:
        linear: the model, continuous or sampled.
        poles: n poles [1/s] (those of a sampled model are placed at e^{p Ts}).
        Ts: step of a sampled model [s] (None: continuous).
        key: named in errors.

    Returns:
        K (m x n).

    Raises:
        InputError, ShapeError: poles that are not those of a stable system.
        StructureError: the poles cannot be placed.
    """
    continuous = parse_poles(key, poles, linear.A.shape[0])
    if (continuous.real >= 0).any():
        raise InputError(
            f"{key}: every pole must have a negative real part, found {list_numbers(continuous)}"
        )
    desired_poles = continuous if Ts is None else np.exp(continuous * Ts)
    return pole_placement_gain(linear.A, linear.B, desired_poles, key)


def observer_gain(linear: Matrices, poles: Array, Ts: float | None) -> Floats:
    """Return L (n x p) that puts A - L C at continuous-time poles.

    Args:
        linear: the model, continuous or sampled.
        poles: n poles [1/s] (those of a sampled model are placed at e^{p Ts}).
        Ts: step of a sampled model [s], and L is per step (None: continuous).

    Returns:
        L (n x p).

    Raises:
        InputError, ShapeError: poles that are not those of a stable system.
        StructureError: the poles cannot be placed.
    """
    return state_gain(linear.dual, poles, Ts, "observer.poles").T
