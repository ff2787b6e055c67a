"""Observers of a plant behind an actuator, with known or estimated widths, or behind a delay."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, wrap_observer
from undeadzone.nonlinearities.actuator import (
    Belief,
    command_memory,
    pass_command,
    through_line,
    through_zone,
)
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util import tree

ESTIMATORS = ("auto", "censored", "kalman")  # of an actuator's widths, of a load's friction


class State(NamedTuple):
    """State of the observer, and of the actuator: of a rate limit, or of a play (m)."""

    observer: Any
    command: Any


def build_with_actuator(
    options: Any, model: System, sensor: Zone, belief: Belief | None
) -> Observer:
    """Return the observer with the given options for a model behind an actuator.

    Args:
        options: of the observer.
        model: the model of the plant, without its actuator.
        sensor: the dead zone.
        belief: knowledge about the actuator (None: there is none).

    Raises:
        InputError: or a subclass, those of the observer, and for a method that cannot estimate the
            unknown numbers.
    """
    _require_friction_support(str(options.__struct_config__.tag), model, sensor)
    observer = _build_without_delay(options, model, sensor, belief)
    return wrap_delay(observer, model) if model.delay else observer


def _build_without_delay(
    options: Any, model: System, sensor: Zone, belief: Belief | None
) -> Observer:
    """Return the observer of a model whose input acts at once.

    Arguments are those of `build_with_actuator`.
    """
    if belief is None:
        return options.build(model, sensor)
    method = str(options.__struct_config__.tag)
    if belief.ranges is not None and (method not in ESTIMATORS or model.Ts is None):
        raise InputError(
            f"model.actuator.right: {method!r} cannot estimate the widths of an actuator. Give "
            f"numbers, or use one of {', '.join(ESTIMATORS)} in sampled time"
        )
    observer = options.build(model._replace(actuator=belief), sensor)
    if observer.python is not None:
        raise InputError(
            f"actuator: {method!r} computes in Python and knows no actuator. Use another observer"
        )
    return wrap_actuator(observer, model, belief)


def _require_friction_support(method: str, model: System, sensor: Zone) -> None:
    """Raise InputError if the friction of a load cannot be taken into account."""
    if sensor.friction.any() and (model.m, model.p) != (1, 1):
        raise InputError(
            "sensor.load_friction: needs a plant of one input and one output, found "
            f"{model.m} and {model.p}. Leave it out"
        )
    if sensor.friction_std.any() and method not in ESTIMATORS:
        raise InputError(
            f"model.load_friction: {method!r} cannot estimate it. Give a number, or use one of "
            f"{', '.join(ESTIMATORS)}"
        )


def wrap_actuator(observer: Observer, model: System, belief: Belief) -> Observer:
    """Return the observer that gets the actuator's output in place of the command.

    Args:
        observer: that takes what enters the plant for its input, or estimates widths itself.
        model: the model.
        belief: knowledge about the actuator.
    """
    last = command_memory(belief.drive, model.m, model.Ts is not None)
    step = partial(step_with_actuator, observer, model, belief.ranges is None)
    return wrap_observer(observer, "actuator", belief.drive, lambda own: State(own, last), step)


class DelayState(NamedTuple):
    """State of the observer, and the pending inputs, the oldest first (delay m)."""

    observer: Any
    line: Any


def wrap_delay(observer: Observer, model: System) -> Observer:
    """Return the observer that gets the input acting now in place of the command.

    Raises InputError.

    Its filter keeps its order, as the inputs under way are known.

    Args:
        observer: that takes what acts for its input.
        model: the model.
    """
    if observer.python is not None:
        raise InputError(
            "plant.delay: an observer that computes in Python knows no delay. Use another observer"
        )
    smoothing = observer.smoothing

    def init(q: Any) -> DelayState:
        """Return the state at t = 0."""
        return DelayState(observer.init(q), np.zeros(model.delay * model.m))

    def project(q: Any, s: DelayState) -> DelayState:
        """Return the state with the observer's part projected."""
        return s._replace(observer=observer.project(q, s.observer))

    def step(q: Any, s: DelayState, u: Any, reading: Reading) -> tuple[DelayState, Estimate]:
        """Return the next state, and the estimate under the input acting now."""
        line, acting = through_line(s.line, u)
        after, estimate = observer.step(q, s.observer, acting, reading)
        return DelayState(after, line), estimate

    if smoothing is not None:
        smoothing = smoothing._replace(
            moments=lambda q, s, u, reading: observer.smoothing.moments(
                q, s.observer, through_line(s.line, u)[1], reading
            ),
            odds=lambda s: observer.smoothing.odds(s.observer),
            record=lambda s: observer.smoothing.record(s.observer),
        )
    return observer._replace(init=init, step=step, project=project, smoothing=smoothing)


def step_with_actuator(
    observer: Observer, model: System, known: bool, q: Any, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the next state and the estimate.

    Here q: parameters of the observer, then the actuator's `Drive`.
    """
    drive = q.actuator
    inner = tree.drop_last_field(q, type(observer.params))
    command, passed = pass_command(ca, u, s.command, drive, model.Ts)
    entering = through_zone(ca, passed, drive) if known else passed
    after, estimate = observer.step(inner, s.observer, entering, reading)
    if known:
        estimate = estimate._replace(actuator_right=drive.right, actuator_left=drive.left)
    return State(after, command), estimate
