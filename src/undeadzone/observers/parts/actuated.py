"""An observer of a plant behind an actuator that is known, or whose widths it estimates."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.actuator import Belief, through_zone, within_limits, within_rate
from undeadzone.ends.sensor import Zone
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.plants.system import System
from undeadzone.support import tree

ESTIMATORS = ("auto", "censored", "kalman")  # of an actuator's widths, of a load's friction


class State(NamedTuple):
    """The observer's state, and the last command within its rate (m), if that has a limit."""

    observer: Any
    command: Any


def built(options: Any, model: System, sensor: Zone, belief: Belief | None) -> Observer:
    """The observer with these options for a model behind an actuator.

    Args:
        options: of the observer.
        model: the model of the plant, without its actuator.
        sensor: the dead zone.
        belief: what is known of the actuator; None: there is none.

    Raises:
        InputError: or a subclass, those of the observer; for a method that cannot estimate what is
            not known.
    """
    method = str(options.__struct_config__.tag)
    _require_friction(method, model, sensor)
    if belief is None:
        return options.build(model, sensor)
    if belief.ranges is not None and (method not in ESTIMATORS or model.Ts is None):
        raise InputError(
            f"model.actuator.right: {method!r} cannot estimate the widths of an actuator; give "
            f"numbers, or use one of {', '.join(ESTIMATORS)} in sampled time"
        )
    observer = options.build(model._replace(actuator=belief), sensor)
    if observer.python is not None:
        raise InputError(
            f"actuator: {method!r} computes in Python and knows no actuator; use another observer"
        )
    return through_actuator(observer, model, belief)


def _require_friction(method: str, model: System, sensor: Zone) -> None:
    """Raise InputError where the friction of a load cannot be taken into account."""
    if sensor.friction.any() and (model.m, model.p) != (1, 1):
        raise InputError(
            "sensor.load_friction: needs a plant of one input and one output, found "
            f"{model.m} and {model.p}; leave it out"
        )
    if sensor.friction_std.any() and method not in ESTIMATORS:
        raise InputError(
            f"model.load_friction: {method!r} cannot estimate it; give a number, or use one of "
            f"{', '.join(ESTIMATORS)}"
        )


def through_actuator(observer: Observer, model: System, belief: Belief) -> Observer:
    """The observer that is told what passes the actuator in place of the command.

    Args:
        observer: that takes what enters the plant for its input, or estimates widths itself.
        model: the model.
        belief: what is known of the actuator.
    """
    kind = type(observer.params)
    rated = belief.drive.rated and model.Ts is not None
    last = np.zeros(model.m if rated else 0)

    def init(q: Any) -> State:
        return State(observer.init(tree.parted(q, kind)), last)

    def project(q: Any, s: State) -> State:
        return s._replace(observer=observer.project(tree.parted(q, kind), s.observer))

    step = partial(step_through, observer, model, belief.ranges is None)
    params = tree.joined(observer.params, "actuator", belief.drive)
    return Observer(params, init, step, project, observer.traits)


def step_through(
    observer: Observer, model: System, known: bool, q: Any, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """One sample; q: numbers of the observer, then the actuator's `Drive`."""
    drive, inner = q.actuator, tree.parted(q, type(observer.params))
    passed = within_limits(ca, u, drive)
    command = s.command
    if command.shape[0]:
        passed = within_rate(ca, passed, command, drive, model.Ts)
        command = passed
    entering = through_zone(ca, passed, drive) if known else passed
    after, estimate = observer.step(inner, s.observer, entering, reading)
    if known:
        estimate = estimate._replace(actuator_right=drive.right, actuator_left=drive.left)
    return State(after, command), estimate
