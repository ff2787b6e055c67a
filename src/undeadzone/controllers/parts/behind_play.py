"""Reference tracking behind a backlash: z is led across the gap if r turns.

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

from undeadzone.errors import InputError
from undeadzone.feedforward.flank_path import choose_flank, crossing, step_filters
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.nonlinearities.sensor import Zone, offset, side
from undeadzone.plants.system import System
from undeadzone.util import tree
from undeadzone.util.arrays import require_number

KEY = "behind_play"
ROUNDING = 1e-9  # share of r by which it may change without a turn


class State(NamedTuple):
    """State of the controller, and of the gap crossing.

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


def lead_across_gap(
    controller: Controller, model: System, sensor: Zone, tracked: list[int], rate: float | None
) -> Controller:
    """Return the controller with a reference shifted by the gap.

    Without a rate return the controller itself.

    Args:
        controller: that makes z follow a reference.
        model: the sampled model.
        sensor: the sensor.
        tracked: numbers of the outputs that follow the reference.
        rate: w, of the critically damped filter [1/s].

    Raises:
        InputError: for an invalid rate, a sensor without play, several inputs, a plant that is not
            linear.
        StructureError: if no input holds z at another place.
    """
    if rate is None:
        return controller
    w = require_number(KEY, rate, above=0.0)
    if sensor.kind != "play":
        raise InputError(
            f'{KEY}: nothing is behind a sensor of kind "{sensor.kind}". Leave it out, or set '
            'sensor.kind = "play"'
        )
    if model.nonlinear or model.m != 1 or len(tracked) != 1:
        raise InputError(
            f"{KEY}: needs a linear plant of one input with one tracked output. Leave it out"
        )
    linear = model.linear._replace(C=model.linear.C[[tracked[0]]])
    numbers = crossing(linear, w, model.Ts, KEY)
    zero = np.zeros(1)
    kind = type(controller.params)

    def init(q: Any) -> State:
        """Return the state at t = 0."""
        inner = controller.init(tree.drop_last_field(q, kind))
        return State(inner, np.zeros(model.n), zero, zero)

    params = tree.append_field(controller.params, "crossing", numbers)
    step = partial(step_across_gap, controller, tracked[0])
    return controller._replace(params=params, init=init, step=step)


def step_across_gap(
    controller: Controller, output: int, q: Any, s: State, estimate: Estimate, target: Target
) -> tuple[State, Any]:
    """Return the next state, and u (m) for the shifted target.

    Here q: the controller's parameters, then the filter's.
    """
    inner = tree.drop_last_field(q, type(controller.params))
    numbers = q.crossing
    moves = side(target.r - s.last, ROUNDING * (ca.fabs(target.r) + ca.fabs(s.last)))
    towards = choose_flank(moves, s.towards)
    wanted = offset(towards, estimate.right[output], estimate.left[output])
    push, following = step_filters(numbers, s.moved, wanted)
    moved = target._replace(
        r=target.r + numbers.C @ s.moved,
        x_ref=target.x_ref + s.moved,
        u_ff=target.u_ff + push,
    )
    after, u = controller.step(inner, s.controller, estimate, moved)
    return State(after, following, target.r, towards), u
