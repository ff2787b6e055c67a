"""How fast a plant is: its poles, their largest, a quarter of its period."""

from __future__ import annotations

from math import comb

import numpy as np

from undeadzone.linear.matrices import Matrices, balancing, feedback_loops, similar
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, scalar

QUARTER = (
    50.0  # samples in a quarter period of a chain of integrators, which has no time of its own
)
UNSTABLE = 2.0  # poles of the loop around an unstable pole, at least, in that pole
STILL = 1e-6  # of |A|, balanced: a pole this close to 0 is an integrator's


def rates_of_motion(A: Floats) -> Floats:
    """|pole| of x' = A x [1/s] for each pole that moves; those of integrators are left out.

    Empty for a chain of integrators.
    """
    return np.abs(_moving(A))


def _moving(A: Floats) -> np.ndarray:
    """The poles of x' = A x that are not those of integrators."""
    poles = np.linalg.eigvals(A)
    loops = feedback_loops(A)
    size = np.linalg.norm(similar(loops, balancing(loops)), 2)
    return np.asarray(poles[np.abs(poles) > STILL * size])


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


def time_scale(flow: Matrices, Ts: float | None = None) -> float:
    """A quarter period pi / (2 |pole|) [s], geometric mean over the poles that are not integrators.

    If all are, `QUARTER` samples: who samples so fast expects changes as fast. Of an unstable pole
    `UNSTABLE` times its size counts: the loop around it must be as fast.

    Args:
        flow: the matrices in continuous time.
        Ts: sample time [s]; None in continuous time, where a chain of integrators gets 1 s.
    """
    poles = _moving(flow.A)
    if not poles.size:
        return 1.0 if Ts is None else QUARTER * Ts
    unstable = poles.real > STILL * np.abs(poles)
    moving = np.abs(poles) * np.where(unstable, UNSTABLE, 1.0)
    return float(np.pi / 2 * np.exp(-np.log(moving).mean()))


def arrival(flow: Matrices, Ts: float | None = None) -> float:
    """A quarter period, and 1 / |pole| for each further pole that an input passes to an output [s].

    The poles count per output. Until then an input has moved z by about as much of what it will,
    whatever the order. flow, Ts: as for `time_scale`; integrators are no delay.
    """
    further = max(_moving(flow.A).size / flow.C.shape[0] - 1.0, 0.0)
    return time_scale(flow, Ts) * (1 + 2 / np.pi * further)


def pace(flow: Matrices, Ts: float | None = None) -> float:
    """How fast the plant moves [1/s]: |pole| of equal poles, else at least their mean.

    It is the largest of the k-th roots of the mean products of k poles, which rounding hardly
    changes where poles are nearly equal. That of `time_scale` for a chain of integrators, 1 in
    continuous time. flow, Ts: as there.
    """
    poles = _moving(flow.A)
    if not poles.size:
        return 1.0 if Ts is None else float(np.pi / 2) / time_scale(flow, Ts)
    sums = np.abs(np.poly(poles))
    means = [(sums[k] / comb(poles.size, k)) ** (1 / k) for k in range(1, sums.size)]
    return float(max(means))


def state_units(flow: Matrices, Ts: float | None = None) -> Floats:
    """What of each state shows as a z of 1, in powers of the plant's `pace` (n) [x / z].

    State i of unit s shows in the k-th derivative of z as C A^k, which counts in units of pace^k.
    In these units plants differ by neither their unit of time nor those of their states.

    Args:
        flow: the matrices in continuous time.
        Ts: sample time [s]; None in continuous time.
    """
    rate = pace(flow, Ts)
    shown, seen = flow.C, np.abs(flow.C).max(axis=0)
    for _ in range(1, flow.A.shape[0]):
        shown = shown @ flow.A / rate
        seen = np.maximum(seen, np.abs(shown).max(axis=0))
    some = seen[seen > 0]
    least = some.min() if some.size else 1.0
    return np.asarray(1 / np.where(seen > 0, seen, least))
