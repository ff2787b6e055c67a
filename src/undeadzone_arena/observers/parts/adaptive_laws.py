"""Adaptive laws for weights in which an error is linear: normalised gradient, least squares."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import StepError
from undeadzone.interfaces import NONE
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats, require_number


class AdaptiveLaw(NamedTuple):
    """Adaptive law of weights W (N p) by an error e of sensitivity -zeta to W (p x N p).

    Attributes:
        numbers: run-time numbers.
        spread0: its own state at first (N p x N p, or nothing).
        move: move(numbers, W, spread, zeta, e, used) is the increment of W and of the spread, each
            per second, or per step when sampled (used (p): whether an output contains information).
        rate: largest rate of the fastest weight [1/s].
    """

    numbers: Any
    spread0: Floats
    move: Callable[[Any, Any, Any, Any, Any, Any], tuple[Any, Any]]
    rate: float


def gradient_law(model: System, gain: float, leak: float, size: int) -> AdaptiveLaw:
    """Return the law W' = gain zeta'e / (1 + zeta'zeta) - leak |e| W.

    It is the normalised gradient with e-modification.

    Sampled, with 1 + (1 + gain Ts) zeta'zeta, which is stable for any gain.

    Args:
        model: the model, for its sample time.
        gain: gain [1/s].
        leak: leak of the weights.
        size: number N of functions of an output.

    Raises:
        InputError: for a leak below 0.
    """
    leak = require_number("observer.leak", leak, least=0.0)
    per_step = model.per_step

    def move(numbers: Any, W: Any, spread: Any, zeta: Any, e: Any, used: Any) -> tuple[Any, Any]:
        """Return the changes of W and of the spread."""
        backward = 1.0 if model.Ts is None else 1.0 + numbers[0]
        normalised = e / (1 + backward * ca.sum2(zeta**2))
        leakage = numbers[1] * ca.kron(ca.fabs(e), ca.SX.ones(size)) * W
        return numbers[0] * (zeta.T @ normalised) - leakage, NONE

    return AdaptiveLaw(np.array([gain, leak]) * per_step, np.zeros(0), move, gain)


def least_squares_law(model: System, gain: float, forgetting: float, size: int) -> AdaptiveLaw:
    """Return the law W' = P zeta'e of recursive least squares with forgetting.

    Its spread follows P' = forgetting (P - P^2 / gain) - P zeta'zeta P, P(0) = gain I.

    P never exceeds P(0). Recursive least squares whose information fades to the initial one
    (Salgado, Goodwin and Middleton 1988).

    Args:
        model: the model, for its sample time and number of outputs.
        gain: initial spread [1/s].
        forgetting: rate at which information fades [1/s].
        size: number N of functions of an output.

    Raises:
        InputError, StepError: for a rate below 0, or one that the step is too coarse for.
    """
    forgetting = require_number("observer.forgetting", forgetting, least=0.0)
    count = size * model.p
    per_step = model.per_step
    if model.Ts is not None and forgetting * per_step >= 1:
        raise StepError(
            f"simulation.step: {per_step:g} s is too coarse for observer.forgetting: "
            f"their product, {forgetting * per_step:.4g}, must be below 1"
        )
    move = least_squares_flow if model.Ts is None else partial(least_squares_step, model.p)
    # the rate of fading, the initial spread, the variance of a reading when sampled
    numbers = np.array([forgetting * per_step, gain, 1 / per_step])
    return AdaptiveLaw(numbers, gain * np.eye(count), move, gain)


def least_squares_flow(
    numbers: Any, W: Any, P: Any, zeta: Any, e: Any, used: Any
) -> tuple[Any, Any]:
    """Return W' and P' in continuous time."""
    rate = numbers[0]
    gain = numbers[1]
    step = P @ zeta.T
    return step @ e, ca.mmax(used) * rate * (P - P @ P / gain) - step @ step.T


def least_squares_step(
    p: int, numbers: Any, W: Any, P: Any, zeta: Any, e: Any, used: Any
) -> tuple[Any, Any]:
    """Return the changes of W and P in a step.

    Outputs are used in sequence, each with the result of the last.
    """
    rate = numbers[0]
    gain = numbers[1]
    noise = numbers[2]
    learnt = ca.SX.zeros(W.shape[0])
    after = P
    for i in range(p):
        row = zeta[i, :]
        step = after @ row.T / (noise + row @ after @ row.T)
        learnt += step @ (e[i] - row @ learnt)
        after -= step @ (row @ after)
    after += ca.mmax(used) * rate * (after - after @ after / gain)
    return learnt, after - P
