"""How fast a plant is: its poles, their largest, a quarter of its period."""

from __future__ import annotations

import numpy as np

from undeadzone.linear.matrices import Matrices
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, scalar

STILL = 1e-6  # of |A|: a pole this close to 0 is an integrator's


def rates_of_motion(A: Floats) -> Floats:
    """|pole| of x' = A x [1/s] for each pole that moves; those of integrators are left out.

    Empty for a chain of integrators.
    """
    rates = np.abs(np.linalg.eigvals(A))
    return rates[rates > STILL * np.linalg.norm(A, 2)]


def moving_poles(model: System) -> Floats:
    """|pole| of the plant in continuous time [1/s], those of integrators left out.

    One rate of 1 for a chain of integrators.
    """
    flow = model.linear if model.flow is None else model.flow
    moving = rates_of_motion(flow.A)
    return moving if moving.size else np.ones(1)


def fastest_pole(model: System) -> float:
    """The largest of `moving_poles` [1/s]."""
    return float(moving_poles(model).max())


def mean_pole(model: System) -> float:
    """The geometric mean of `moving_poles` [1/s]."""
    return float(np.exp(np.log(moving_poles(model)).mean()))


def in_poles(model: System, key: str, rate: float | None, default: float) -> float:
    """A rate as the user gives it, or a multiple of the plant's fastest pole.

    Args:
        model: the plant.
        key: name of the rate in messages.
        rate: as the user gives it [1/s], or None.
        default: the rate in fastest poles [1], in place of None.

    Returns:
        The rate [1/s].

    Raises:
        InputError: the rate is no positive number.
    """
    if rate is None:
        return default * fastest_pole(model)
    return scalar(key, rate, above=0.0)


def time_scale(flow: Matrices) -> float:
    """A quarter period pi / (2 |pole|) [s], geometric mean over the poles that are not integrators.

    1 s if all are. flow: the matrices in continuous time.
    """
    moving = rates_of_motion(flow.A)
    if not moving.size:
        return 1.0
    return float(np.pi / 2 * np.exp(-np.log(moving).mean()))
