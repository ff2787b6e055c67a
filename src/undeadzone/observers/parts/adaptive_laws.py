"""How weights learn from an error that is linear in them: normalised gradient, recursive least squares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import StepError
from undeadzone.interfaces import NONE
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, scalar


class Law(NamedTuple):
    """How weights W (N p) learn from e, whose sensitivity to W is -zeta (p x N p).

    spread0 (N p x N p or nothing): its own state at first; move(numbers, W, spread, zeta, e, told): what is added to W and
    to the spread, each per second, or per step when sampled. told (p): whether an output tells anything.
    rate [1/s]: what the fastest weight moves at, at most.
    """

    numbers: Any
    spread0: Floats
    move: Callable[[Any, Any, Any, Any, Any, Any], tuple[Any, Any]]
    rate: float


def gradient(model: System, gain: float, leak: float, size: int) -> Law:
    """W' = gain zeta'e / (1 + zeta'zeta) - leak |e| W: normalised gradient with e-modification. Raises InputError.

    Sampled, with 1 + (1 + gain Ts) zeta'zeta, which is stable for any gain.
    """
    leak = scalar("observer.leak", leak, least=0.0)
    per_step = 1.0 if model.Ts is None else model.Ts

    def move(numbers: Any, W: Any, spread: Any, zeta: Any, e: Any, told: Any) -> tuple[Any, Any]:
        backward = 1.0 if model.Ts is None else 1.0 + numbers[0]
        normalised = e / (1 + backward * ca.sum2(zeta**2))
        leakage = numbers[1] * ca.kron(ca.fabs(e), ca.SX.ones(size)) * W
        return numbers[0] * (zeta.T @ normalised) - leakage, NONE

    return Law(np.array([gain, leak]) * per_step, np.zeros(0), move, gain)


def least_squares(model: System, gain: float, forgetting: float, size: int) -> Law:
    """W' = P zeta'e, P' = forgetting (P - P^2 / gain) - P zeta'zeta P, P(0) = gain I, which P never exceeds.

    Recursive least squares whose information fades to the initial one (Salgado, Goodwin and Middleton 1988).
    Raises InputError, StepError.
    """
    forgetting = scalar("observer.forgetting", forgetting, least=0.0)
    count, per_step = size * model.p, 1.0 if model.Ts is None else model.Ts
    if model.Ts is not None and forgetting * per_step >= 1:
        raise StepError(
            f"simulation.step: {per_step:g} s is too coarse for observer.forgetting: their product, {forgetting * per_step:.4g}, must be below 1"
        )

    def flow(numbers: Any, W: Any, P: Any, zeta: Any, e: Any, told: Any) -> tuple[Any, Any]:
        step = P @ zeta.T
        return step @ e, ca.mmax(told) * numbers[0] * (P - P @ P / numbers[1]) - step @ step.T

    def jump(numbers: Any, W: Any, P: Any, zeta: Any, e: Any, told: Any) -> tuple[Any, Any]:
        learnt, after = ca.SX.zeros(count), P
        for i in range(model.p):  # one output at a time, each with what the ones before have taught
            row = zeta[i, :]
            step = after @ row.T / (numbers[2] + row @ after @ row.T)
            learnt += step @ (e[i] - row @ learnt)
            after -= step @ (row @ after)
        after += ca.mmax(told) * numbers[0] * (after - after @ after / numbers[1])
        return learnt, after - P

    return Law(
        np.array([forgetting * per_step, gain, 1 / per_step]),
        gain * np.eye(count),
        flow if model.Ts is None else jump,
        gain,
    )
