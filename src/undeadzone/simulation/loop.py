"""The closed loop as a value: its step is one CasADi graph.

next_state, outputs = step(state, exogenous, params).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import casadi as ca

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate
from undeadzone.nonlinearities.actuator import Drive
from undeadzone.nonlinearities.limits import Limits

RUNGE_KUTTA: Final = 4  # the order that needs no Taylor series
ZOH_INPUTS: Final = 5  # last exogenous inputs of an output: a step holds them constant (zero order)


def instants(Ts: float | None, order: int) -> int:
    """Return how many exogenous inputs a step has: one, three instants, or Taylor coefficients.

    Args:
        Ts: sample time [s] (None in continuous time).
        order: RUNGE_KUTTA, or that of a Taylor series.
    """
    if Ts is not None:
        return 1
    return order if order > RUNGE_KUTTA else 3


class Exogenous(NamedTuple):
    """Exogenous inputs at one instant.

    Attributes:
        target: the controller's target.
        w: disturbance at the input (m).
        before: standard normal noise ahead of the zone (p).
        after: standard normal noise after the zone (p).
        right, left: how much wider than at first an edge is, relative (p).
        lost: NaN if the reading is missing, else 0 (p).
    """

    target: Target
    w: Any
    before: Any
    after: Any
    right: Any
    left: Any
    lost: Any


class SensorParams(NamedTuple):
    """The numbers of the sensor.

    Attributes:
        right, left: d_r, d_l at t = 0 (p) [z].
        slope: m (p) [y/z].
        threshold: |y| that counts as silent (p) [y].
        quantum: step of the reading (p) [y] (empty if nothing is quantised).
        limits: least and largest readings (p) [y] (None: there are none).
        friction: of the load behind a play (p) [u] (empty if absent).
        gap_right, gap_left: of a play ahead of a dead zone (p) [z] (empty if absent).
    """

    right: Any
    left: Any
    slope: Any
    threshold: Any
    quantum: Any
    limits: Limits | None
    friction: Any
    gap_right: Any
    gap_left: Any


class Scale(NamedTuple):
    """Factors on the exogenous inputs.

    Attributes:
        reference: on the whole target (1).
        disturbance: on w (m).
        before: rms of the noise ahead of the zone (p) [z].
        after: rms of the noise after the zone (p) [y].
    """

    reference: Any
    disturbance: Any
    before: Any
    after: Any


class Params(NamedTuple):
    """Every number of the loop. They enter at run time.

    Attributes:
        plant, observer, controller, compensator: the params of each part, trees of numbers.
        sensor: the numbers of the sensor.
        actuator: the numbers of the actuator (None: there is none).
        scale: factors on the exogenous inputs.
        h: time step [s].
    """

    plant: Any
    sensor: SensorParams
    observer: Any
    controller: Any
    scale: Scale
    h: Any
    compensator: Any = None
    actuator: Drive | None = None


class State(NamedTuple):
    """The loop's state: that of each of its parts.

    Attributes:
        plant, observer, controller, compensator: states of the parts.
        sensor: level of a play (p) [z] (empty of a sensor without one).
        actuator: last command, if its rate has a limit (m) [u] (else empty).
        line: commands that have not acted yet, the oldest first (delay m) [u].
    """

    plant: Any
    observer: Any
    controller: Any
    sensor: Any
    compensator: Any
    actuator: Any
    line: Any


class Driven(NamedTuple):
    """The states of what makes an input of readings.

    Attributes:
        observer, controller, compensator: as of `State`.
    """

    observer: Any
    controller: Any
    compensator: Any


class Outputs(NamedTuple):
    """Recorded quantities at the start of each step.

    Attributes:
        x: state (n).
        z: output C x (p).
        y: reading (p).
        side: measured side (p), +2 or -2 at a limit of the range.
        u: input (m).
        estimate: the observer's estimate after the reading.
    """

    x: Any
    z: Any
    y: Any
    side: Any
    u: Any
    estimate: Estimate


class Parts(NamedTuple):
    """A step in parts, which together are right in every case and singly cost less.

    Attributes:
        usual: usual(s, w, p) is (next, out, flag). Its result is right if the flag is 0.
        rare: rare[0](s, w, p) is (next, flag), to be called if the flag before it is 1, and so on.
            The last one is right in any case.
    """

    usual: ca.Function
    rare: tuple[ca.Function, ...]


class Loop(NamedTuple):
    """The closed loop and the numbers that start it.

    In continuous time the exogenous input of a step holds three instants (the step's start, middle
    and end), or as many Taylor coefficients as the order of the method.

    Attributes:
        step: step(state, exogenous, params) is (next state, outputs), all of them columns.
        state: the state at t = 0.
        params: every number of the loop.
        outputs: zeros of the outputs' shapes.
        instant: zeros of the shapes of the exogenous inputs at one instant.
        parts: the same step, split into a usual part and parts for a change of side (None: not
            split).
    """

    step: ca.Function
    state: State
    params: Params
    outputs: Outputs
    instant: Exogenous
    parts: Parts | None
