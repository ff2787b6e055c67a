"""The least gain that makes A - L C as fast as asked; by duality, A - B K."""

from __future__ import annotations

import warnings

import numpy as np

from undeadzone.errors import StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.riccati import riccati
from undeadzone.linear.scaling import sizes
from undeadzone.support.arrays import Floats


def fast_gain(linear: Matrices, speed: float, Ts: float | None) -> Floats:
    """L (n x p) that puts A - L C left of -speed / 2 (sampled: within e^(-speed Ts / 2)).

    Args:
        linear: the model, of the sampled one Ad, Bd, C.
        speed: speed [1/s].
        Ts: sample time [s]; None in continuous time.

    Raises:
        StructureError: where the outputs hardly show some state.
    """
    A, _, C = linear
    n = A.shape[0]
    flow = A if Ts is None else (A - np.eye(n)) / Ts
    # the unit of each state, so that the equations below are near 1
    unit = 1 / (speed * sizes(flow.T, C.T, speed))
    A, C = A * unit / unit[:, None], C * unit
    L = _shifted_riccati_gain(A, C, speed, Ts)
    poles = np.linalg.eigvals(A - L @ C)
    rate = poles.real.max() if Ts is None else np.log(np.abs(poles).max()) / Ts
    if not rate < -speed / 4:
        raise StructureError(
            f"observer.speed: {speed:.4g} 1/s cannot be reached, the outputs hardly show some "
            "state; give a lower speed, or poles"
        )
    return unit[:, None] * L


def fast_feedback(linear: Matrices, speed: float, Ts: float | None) -> Floats:
    """K (m x n) that puts A - B K left of -speed / 2 (sampled: within e^(-speed Ts / 2)).

    Args:
        linear: the model, of the sampled one Ad, Bd, C.
        speed: speed [1/s].
        Ts: sample time [s]; None in continuous time.

    Raises:
        StructureError: where the inputs hardly move some state.
    """
    dual = Matrices(linear.A.T, linear.C.T, linear.B.T)
    try:
        return fast_gain(dual, speed, Ts).T
    except StructureError:
        raise StructureError(
            f"controller.speed: {speed:.4g} 1/s cannot be reached, the inputs hardly move some "
            "state; give a lower speed, poles or K"
        ) from None


def _shifted_riccati_gain(A: Floats, C: Floats, speed: float, Ts: float | None) -> Floats:
    """The Riccati gain of A shifted right by speed / 2 (n x p); 0 where there is no solution."""
    n, p = A.shape[0], C.shape[0]
    noise = 1e-8 * np.eye(n)
    with warnings.catch_warnings():
        # of scipy, on ill-conditioned equations: `fast_gain` judges the poles
        warnings.simplefilter("ignore")
        try:
            if Ts is None:
                shifted = Matrices((A / speed + np.eye(n) / 2).T, C.T, C)
                return speed * riccati(shifted, noise, np.eye(p)).K.T
            shrink, span = np.exp(-speed / 2 * Ts), speed * Ts
            shifted = Matrices((A / shrink).T, C.T, C)
            return shrink * riccati(shifted, noise * span, np.eye(p) / span, Ts).K.T
        except np.linalg.LinAlgError:
            return np.zeros((n, p))
