"""Path of the input across a gap, led so that motor and load stay consistent with each other.

An input that must be on one flank of a gap first and on the other later is moved by a step of the
gap's width. The step passes a copy of a linear model with all poles at -w, so that state and input
on the way belong to each other. `controllers.parts.behind_play` leads the input of a play across
when the reference turns, `controllers.computed_torque` motors of an arm when the torque that their
links need changes sign: then a link needs none, and may be free.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import StructureError
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import state_gain
from undeadzone.util.arrays import Floats

LEAD = 2.0  # time constants 1 / w that half of a step takes: by so much it begins earlier


class Crossing(NamedTuple):
    """Numbers of the filter.

    Attributes:
        A, B, C: of the sampled model (n x n, n x 1, 1 x n).
        K: gain that puts the poles at -w (1 x n).
        gain: input per target of the output at rest (1).
    """

    A: Floats
    B: Floats
    C: Floats
    K: Floats
    gain: Any


def crossing(linear: Matrices, w: float, Ts: float | None, key: str) -> Crossing:
    """Return the filter of a model of one input and one output.

    Args:
        linear: the sampled model.
        w: of all its poles [1/s].
        Ts: sample time [s].
        key: of w in messages.

    Raises:
        InputError: w cannot be.
        StructureError: no input holds the output at another place.
    """
    n = linear.A.shape[0]
    K = state_gain(linear, [-w] * n, Ts, key)
    rest = np.eye(n) - linear.A + linear.B @ K
    gain = (linear.C @ np.linalg.solve(rest, linear.B)).item()
    if abs(gain) < 1e-12 * np.abs(linear.C).max() * np.abs(linear.B).max():
        raise StructureError(
            f"{key}: no constant input of the plant holds z at another place (a zero at s = 0)"
        )
    return Crossing(linear.A, linear.B, linear.C, K, np.float64(1 / gain))


def doubly_integrated(w: float, Ts: float, key: str) -> Crossing:
    """Return the filter of an acceleration held over a sample, with the arguments of `crossing`."""
    A = np.array([[1.0, Ts], [0.0, 1.0]])
    B = np.array([[Ts**2 / 2], [Ts]])
    return crossing(Matrices(A, B, np.eye(1, 2)), w, Ts, key)


def choose_flank(sign: Any, before: Any) -> Any:
    """Return the required flank (...), the previous one if the sign is 0.

    Args:
        sign: the flank that the load needs, 0 if neither.
        before: the last flank.
    """
    return ca.if_else(sign != 0, sign, before)


def step_filters(numbers: Crossing, moved: Any, targets: Any) -> tuple[Any, Any]:
    """Return (input (1 x k), the next state (n x k)) of k equal filters.

    Args:
        numbers: of the filter.
        moved: their states (n x k).
        targets: targets of the filters' outputs (1 x k).
    """
    push = numbers.gain * targets - numbers.K @ moved
    return push, numbers.A @ moved + numbers.B @ push
