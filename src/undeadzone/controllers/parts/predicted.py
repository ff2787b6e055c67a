"""State prediction over an input delay: the controller acts on the state at the end of the delay.

An input that is commanded at sample k acts at k + N. Until then the commands that are under way
act, which are known, so the model is moved on along them from the observer's estimate at k (finite
spectrum assignment: Manitius and Olbrot 1979, for outputs Smith 1957):

    x^(k + N | k) = A^N x^_k + A^(N - 1) B u_(k - N) + ... + B u_(k - 1)

and w^, if the observer estimates it, goes on. The controller gets this state in the place of x^.
With a model that is right the loop is the one without a delay, N samples later: so z follows r as r
was N samples ago.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.nonlinearities.actuator import Belief, input_range, through_line
from undeadzone.numerics.clip import clip
from undeadzone.plants.system import System, hold_integral
from undeadzone.util import tree
from undeadzone.util.arrays import LARGEST, Floats


class DelayPrediction(NamedTuple):
    """Parameters of the predicted model, the last field of the controller's parameters.

    Attributes:
        model: of the sampled model.
        disturbance_gain: change of x in a sample per w^ (n x n) [s].
        low, high: of what acts on the plant (m) [u].
    """

    model: Any
    disturbance_gain: Floats
    low: Floats
    high: Floats


class State(NamedTuple):
    """State of the controller, and the pending inputs, the oldest first (delay m)."""

    controller: Any
    line: Any


def predict_over_delay(controller: Controller, model: System, belief: Belief | None) -> Controller:
    """Return the controller with the estimate predicted to the time its input acts.

    Without a delay return the controller itself.

    Args:
        controller: for the model whose input acts at once.
        model: the sampled model.
        belief: state of knowledge about the actuator, whose limits count (None: there is none).

    Raises:
        InputError: the model has gears: the gaps that it would be moved on with are not known.
    """
    if not model.delay:
        return controller
    if model.gears is not None:
        raise InputError(
            "plant.delay: a controller foretells the state in which its input will act by the "
            "model's own gaps, which are not known. Leave it out, or plant.arm.gears"
        )
    most = np.full(model.m, LARGEST) if model.limit is None else np.minimum(model.limit, LARGEST)
    low = -most
    high = most
    if belief is not None:
        least, largest = input_range(belief.drive)
        low = np.maximum(low, least)
        high = np.minimum(high, largest)
    kind = type(controller.params)

    def init(q: Any) -> State:
        """Return the state at t = 0."""
        return State(
            controller.init(tree.drop_last_field(q, kind)), np.zeros(model.delay * model.m)
        )

    numbers = DelayPrediction(model.params, hold_integral(model), low, high)
    params = tree.append_field(controller.params, "ahead", numbers)
    step = partial(step_with_prediction, controller, model)
    return controller._replace(params=params, init=init, step=step)


def step_with_prediction(
    controller: Controller, model: System, q: Any, s: State, estimate: Estimate, target: Target
) -> tuple[State, Any]:
    """Return the next state, and u (m) for the predicted estimate.

    Here q: the controller's parameters, then `DelayPrediction`.
    """
    inner = tree.drop_last_field(q, type(controller.params))
    ahead = q.ahead
    x = estimate.x
    for acting in ca.vertsplit(s.line, model.m):
        x = model.move(ahead.model, x, acting)
        if estimate.w.shape[0]:
            x = x + ahead.disturbance_gain @ estimate.w
    then = estimate._replace(x=x, z=model.output(ahead.model, x))
    after, u = controller.step(inner, s.controller, then, target)
    line, _ = through_line(s.line, clip(u, ahead.low, ahead.high))
    return State(after, line), u
