"""An arm's joints are filtered each for itself: one covariance of [q_i; q_i'; d_ri; d_li; a_i].

What a joint does not know of the others is an unknown acceleration a_i.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.observers.parts.gaussian_filter import Augmentation, Params
from undeadzone.observers.parts.unknown_inputs import Colour
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats


class Noise(NamedTuple):
    """Of the joints' accelerations a+ = F a + noise of covariance Q variance (N)."""

    F: Any
    Q: Any
    variance: Floats


class Joints(NamedTuple):
    """What the functions of `separate` share.

    Attributes:
        rate: rate(params, x, u) is x' of the arm.
        size: number N of joints.
        Ts: sample time [s].
    """

    rate: Callable[[Any, Any, Any], Any]
    size: int
    Ts: float


def separate(model: System, colour: Colour, rms: Floats) -> Augmentation:
    """An unknown acceleration a of each joint, and covariances of its own five unknowns alone.

    The mean moves by the whole model, whose accelerations are taken once a sample; the variance is
    that of the accelerations that the disturbance makes where the model was linearised.

    Args:
        model: the sampled model of an arm.
        colour: the disturbance of unit rms.
        rms: rms of the disturbance (m) [u].

    Raises:
        InputError: for a model that is not [q; q'] with q measured, and for a joint without
            disturbance.
    """
    N, Ts, rate, flow = model.p, model.Ts, model.rate, model.flow
    if rate is None or flow is None or Ts is None or not mechanical(model):
        raise InputError(
            "observer.joints: separate joints need a nonlinear model of states [q; q'] that "
            "measures each position, such as a rigid arm's"
        )
    variance = flow.B[N:] ** 2 @ rms**2
    if not variance.all():
        raise InputError(
            "observer.disturbance: must be positive for separate joints: it stands for what a "
            "joint does not know of the others"
        )
    joints = Joints(rate, N, Ts)
    return Augmentation(
        Noise(colour.F[0, 0], colour.Q[0, 0], variance),
        np.diag(variance),
        partial(joint_change, joints),
        partial(joint_noise, joints),
        slope=partial(joint_slope, joints),
        disturbance=partial(joint_disturbance, joints),
        entries=ca.triu(ca.kron(ca.DM.ones(5, 5), ca.DM.eye(N))).sparsity(),
    )


def joint_change(joints: Joints, q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
    """(x+ - x, a+ - a) with accelerations that stay as they are over the step."""
    N, Ts = joints.size, joints.Ts
    v = x[N:]
    a = joints.rate(q.model, x, u)[N:] + extra
    return ca.vertcat(Ts * v + Ts**2 / 2 * a, Ts * a), (q.augmentation.F - 1) * extra


def joint_slope(joints: Joints, q: Params) -> Any:
    """The Jacobian of the change (5N x 5N), that of a double integrator under a for each joint."""
    Ts = joints.Ts
    one = ca.SX(5, 5)  # of [q_i; q_i'; d_ri; d_li; a_i]
    one[0, 1] = Ts
    one[0, 4] = Ts**2 / 2
    one[1, 4] = Ts
    one[4, 4] = q.augmentation.F - 1
    return ca.kron(one, ca.SX.eye(joints.size))


def joint_noise(joints: Joints, q: Params, x: Any, u: Any) -> tuple[Any, Any]:
    """The covariances that a step adds to x and to the accelerations."""
    states = 2 * joints.size
    return ca.SX(states, states), q.augmentation.Q * ca.diag(q.augmentation.variance)


def joint_disturbance(joints: Joints, q: Params, extra: Any) -> Any:
    """What the accelerations add to x' (2N)."""
    return ca.vertcat(ca.SX.zeros(joints.size), extra)


def mechanical(model: System) -> bool:
    """Whether the states are [q; q'] and the outputs q, less a constant perhaps."""
    N = model.p
    if model.n != 2 * N or model.flow is None:
        return False
    A, B, C = model.flow
    measures_positions = (np.eye(N, 2 * N) == C).all()
    integrates_speeds = (np.eye(N, 2 * N, N) == A[:N]).all() and not B[:N].any()
    return bool(measures_positions and integrates_speeds)
