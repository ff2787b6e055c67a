"""What is behind a play follows the reference: z is led across the gap where r turns.

Behind the play is y / m = z - c_r while z moves right in contact, z + c_l while it moves left. So z
has to follow r + c_r^ while r rises and r - c_l^ while it falls. The step between both passes a
copy of the model with all poles at -w: what z, x and u do on the way belongs to each other, and
the gap is crossed after the turn of r (docs/play.md).
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import Zone, offset, side
from undeadzone.errors import InputError, StructureError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linear.poles import state_gain
from undeadzone.plants.system import System
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, scalar

KEY = "behind_play"
ROUNDING = 1e-9  # share of r by which it may change without a turn


class Crossing(NamedTuple):
    """Numbers of the filter, the last field of those of the controller.

    Attributes:
        A, B, C: of the sampled model (n x n, n x 1, 1 x n).
        K: gain that puts the poles at -w (1 x n).
        gain: input per wanted z at rest (1).
    """

    A: Floats
    B: Floats
    C: Floats
    K: Floats
    gain: Any


class State(NamedTuple):
    """The controller's state, and what is known of the way across.

    Attributes:
        controller: the controller's.
        moved: state of the filter, by which x_ref is moved (n).
        last: r one sample ago (1) [z].
        towards: side to which r moved last (1), 0 before it moves.
    """

    controller: Any
    moved: Any
    last: Any
    towards: Any


def led_across(
    controller: Controller, model: System, sensor: Zone, tracked: list[int], rate: float | None
) -> Controller:
    """The controller with a reference that is moved by the gap; itself without a rate.

    Args:
        controller: that makes z follow a reference.
        model: the sampled model.
        sensor: the sensor.
        tracked: numbers of the outputs that follow the reference.
        rate: w, of the critically damped filter [1/s].

    Raises:
        InputError: for a rate that is none, a sensor without play, several inputs, a plant that is
            not linear.
        StructureError: where no input holds z at another place.
    """
    if rate is None:
        return controller
    w = scalar(KEY, rate, above=0.0)
    if sensor.kind != "play":
        raise InputError(
            f'{KEY}: nothing is behind a sensor of kind "{sensor.kind}"; leave it out, or set '
            'sensor.kind = "play"'
        )
    if model.nonlinear or model.m != 1 or len(tracked) != 1:
        raise InputError(
            f"{KEY}: needs a linear plant of one input with one tracked output; leave it out"
        )
    numbers = _crossing(model, tracked[0], w)
    zero, kind = np.zeros(1), type(controller.params)

    def init(q: Any) -> State:
        inner = controller.init(tree.parted(q, kind))
        return State(inner, np.zeros(model.n), zero, zero)

    params = tree.joined(controller.params, "crossing", numbers)
    step = partial(step_across, controller, tracked[0])
    return controller._replace(params=params, init=init, step=step)


def _crossing(model: System, output: int, w: float) -> Crossing:
    """The numbers of the filter. Raises InputError, StructureError."""
    linear = model.linear
    K = state_gain(linear, [-w] * model.n, model.Ts, KEY)
    C = linear.C[[output]]
    rest = np.eye(model.n) - linear.A + linear.B @ K
    gain = (C @ np.linalg.solve(rest, linear.B)).item()
    if abs(gain) < 1e-12 * np.abs(C).max() * np.abs(linear.B).max():
        raise StructureError(
            f"{KEY}: no constant input of the plant holds z at another place (a zero at s = 0)"
        )
    return Crossing(linear.A, linear.B, C, K, np.float64(1 / gain))


def step_across(
    controller: Controller, output: int, q: Any, s: State, estimate: Estimate, target: Target
) -> tuple[State, Any]:
    """One sample of the controller with its target moved; q: its numbers, then `Crossing`."""
    inner, numbers = tree.parted(q, type(controller.params)), q.crossing
    turned = side(target.r - s.last, ROUNDING * (ca.fabs(target.r) + ca.fabs(s.last)))
    towards = ca.if_else(turned != 0, turned, s.towards)
    wanted = offset(towards, estimate.right[output], estimate.left[output])
    push = numbers.gain * wanted - numbers.K @ s.moved
    moved = target._replace(
        r=target.r + numbers.C @ s.moved,
        x_ref=target.x_ref + s.moved,
        u_ff=target.u_ff + push,
    )
    after, u = controller.step(inner, s.controller, estimate, moved)
    following = numbers.A @ s.moved + numbers.B @ push
    return State(after, following, target.r, towards), u
