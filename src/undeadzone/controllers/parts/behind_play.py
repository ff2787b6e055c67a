"""Reference tracking behind a backlash: the reference of z crosses the gap when r reverses.

The output behind the play is y / m = z - c_r while z moves right in contact, and z + c_l while it
moves left. So z has to follow r + c_r^ while r rises, and r - c_l^ while it falls. The step between
both offsets passes a filter: a copy of the model with all poles at -w. Its output, state and input
are consistent shifts of z, x and u, and the gap is crossed after the reversal of r (docs/play.md).
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
ROUNDING = 1e-9  # relative change of r below which it does not reverse


class State(NamedTuple):
    """State of the controller, and of the gap crossing.

    Attributes:
        controller: state of the inner controller.
        shift: state of the filter, the shift of x_ref (n).
        last: r at the previous sample (1) [z].
        direction: last direction of r: +1, -1, 0 before it moves (1).
    """

    controller: Any
    shift: Any
    last: Any
    direction: Any


def lead_across_gap(
    controller: Controller, model: System, sensor: Zone, tracked: list[int], rate: float | None
) -> Controller:
    """Return the controller with the reference shifted to the contact side of the gap.

    Args:
        controller: controller with which z follows a reference.
        model: the sampled model.
        sensor: the sensor.
        tracked: indices of the outputs that follow the reference.
        rate: w of the filter [1/s]; None: the controller is returned unchanged.

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
    """Return the next state, and the input u (m) of the controller for the shifted target.

    Args:
        controller: the inner controller.
        output: index of the tracked output.
        q: parameters of the inner controller, then of the filter.
        s: state.
        estimate: estimate of the observer, with half gaps.
        target: target of z, x and u without the shift.
    """
    inner = tree.drop_last_field(q, type(controller.params))
    numbers = q.crossing
    change = side(target.r - s.last, ROUNDING * (ca.fabs(target.r) + ca.fabs(s.last)))
    direction = choose_flank(change, s.direction)
    gap_offset = offset(direction, estimate.right[output], estimate.left[output])
    input_shift, next_shift = step_filters(numbers, s.shift, gap_offset)
    shifted = target._replace(
        r=target.r + numbers.C @ s.shift,
        x_ref=target.x_ref + s.shift,
        u_ff=target.u_ff + input_shift,
    )
    after, u = controller.step(inner, s.controller, estimate, shifted)
    return State(after, next_shift, target.r, direction), u
