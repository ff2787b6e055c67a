"""The repaired observer: the innovation is formed on the side that the sensor itself shows (docs/observer.md)."""

from __future__ import annotations

import warnings

import numpy as np

from undeadzone.errors import InputError, ShapeError, StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.poles import observer_gain
from undeadzone.linear.riccati import riccati
from undeadzone.linear.scaling import sizes
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import in_poles, moving_poles
from undeadzone.support.arrays import Array, Floats, array, matrix


def gains(L: Array | None, model: System, key: str = "observer.L") -> Floats:
    """L as n x p (a plain list for one output), or P^-1 C' of the model where L is not given. Raises ShapeError."""
    n, p = model.n, model.p
    if L is None:
        from undeadzone.analysis.certificate.passivity import passive_gain

        return passive_gain(model.linear, model.Ts)
    found = array(key, L)
    if found.ndim == 1 and p == 1:
        found = found[:, None]
    if found.ndim != 2:
        raise ShapeError(
            f"{key}: expected {n} x {p} (states x outputs), found {found.size} number{'s' * (found.size != 1)}"
        )
    return matrix(key, found, n, p, "states x outputs")


def injection(
    model: System, L: Array | None, poles: Array | None, speed: float | None, default: float
) -> Floats:
    """L (n x p), per step when the model is sampled, from one of: L [1/s]; poles of A - L C [1/s]; speed [1/s].

    speed (if none is given `default` times the fastest pole of the plant): poles p of A slower than half of it move to
    -speed - p, the least gain for which all of A - L C are left of -speed / 2 (Anderson and Moore 1971).
    Raises InputError, ShapeError, StructureError.
    """
    given = [
        name for name, value in (("L", L), ("poles", poles), ("speed", speed)) if value is not None
    ]
    if len(given) > 1:
        raise InputError(f"observer: give one of L, poles, speed; found {' and '.join(given)}")
    if L is not None:
        return gains(L, model) * (1.0 if model.Ts is None else model.Ts)
    if poles is not None:
        return observer_gain(model.linear, poles, model.Ts)
    return fast_gain(model.linear, in_poles(model, "observer.speed", speed, default), model.Ts)


def hiding(model: System, factor: float) -> float:
    """A speed, in fastest poles, that hides as much of the widths from the innovation as `factor` mean poles do for second order.

    It sees them through det(sI - A) / det(sI - A + L C), for each output about factor^-2 at low frequency.
    """
    poles = moving_poles(model)
    return float(
        factor ** (2 / max(2.0, model.n / model.p)) * np.exp(np.log(poles).mean()) / poles.max()
    )


def fast_gain(linear: Matrices, speed: float, Ts: float | None) -> Floats:
    """L (n x p) that puts A - L C left of -speed / 2 (sampled: within e^(-speed Ts / 2)). Raises StructureError."""
    A, _, C = linear
    n, p = A.shape[0], C.shape[0]
    flow = A if Ts is None else (A - np.eye(n)) / Ts
    unit = 1 / (
        speed * sizes(flow.T, C.T, speed)
    )  # of each state, so that the equations below are near 1
    A, C, noise = A * unit / unit[:, None], C * unit, 1e-8 * np.eye(n)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # of scipy, on ill-conditioned equations: the poles are judged below
        try:
            if Ts is None:
                L = (
                    speed
                    * riccati(Matrices((A / speed + np.eye(n) / 2).T, C.T, C), noise, np.eye(p)).K.T
                )
            else:
                shrink, span = np.exp(-speed / 2 * Ts), speed * Ts
                L = (
                    shrink
                    * riccati(
                        Matrices((A / shrink).T, C.T, C), noise * span, np.eye(p) / span, Ts
                    ).K.T
                )
        except np.linalg.LinAlgError:
            L = np.zeros((n, p))
    poles = np.linalg.eigvals(A - L @ C)
    rate = poles.real.max() if Ts is None else np.log(np.abs(poles).max()) / Ts
    if not rate < -speed / 4:
        raise StructureError(
            f"observer.speed: {speed:.4g} 1/s cannot be reached, the outputs hardly show some state; give a lower speed, or poles"
        )
    return unit[:, None] * L
