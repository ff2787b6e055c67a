"""Default gains and rates of the compared methods, in poles of the plant."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.poles import observer_gain
from undeadzone.linalg.riccati import fast_gain
from undeadzone.observers.adaptive.gain import innovation_gain
from undeadzone.plants.system import System, fastest_pole, moving_poles
from undeadzone.util.arrays import Array, Floats, require_number


def injection_gain(
    model: System, L: Array | None, poles: Array | None, speed: float | None, default: float
) -> Floats:
    """Return L (n x p), per step when the model is sampled, from one of L, poles and speed.

    With a speed, poles p of A slower than half of it move to -speed - p: the least gain for which
    all of A - L C are left of -speed / 2 (Anderson and Moore 1971).

    Args:
        model: the model, continuous or sampled.
        L: gains (n x p) [1/s].
        poles: poles of A - L C (n) [1/s].
        speed: speed of A - L C [1/s].
        default: speed, in fastest poles of the plant, if all three are absent.

    Raises:
        InputError, ShapeError, StructureError: for more than one of the three, or one that cannot
            be.
    """
    options = {"L": L, "poles": poles, "speed": speed}
    chosen = [name for name, value in options.items() if value is not None]
    if len(chosen) > 1:
        raise InputError(f"observer: give one of L, poles, speed, found {' and '.join(chosen)}")
    if L is not None:
        return innovation_gain(L, model) * model.per_step
    if poles is not None:
        return observer_gain(model.linear, poles, model.Ts)
    return fast_gain(
        model.linear, rate_or_default(model, "observer.speed", speed, default), model.Ts
    )


def width_hiding_speed(model: System, factor: float) -> float:
    """Return the speed that hides the widths from the innovation (in fastest poles) [1].

    It hides as much of them as `factor` mean poles do for second order: the innovation sees them
    through det(sI - A) / det(sI - A + L C), for each output about factor^-2 at low frequency.
    """
    poles = moving_poles(model)
    order = max(2.0, model.n / model.p)
    return float(factor ** (2 / order) * np.exp(np.log(poles).mean()) / poles.max())


def rate_or_default(model: System, key: str, rate: float | None, default: float) -> float:
    """Return the rate that the user gives, or a multiple of the plant's fastest pole [1/s].

    Args:
        model: the plant.
        key: name of the rate in messages.
        rate: as the user gives it [1/s], or None.
        default: the rate in fastest poles [1], in place of None.

    Returns:
        The rate [1/s].

    Raises:
        InputError: the rate is not a positive number.
    """
    if rate is None:
        return default * fastest_pole(model)
    return require_number(key, rate, above=0.0)
