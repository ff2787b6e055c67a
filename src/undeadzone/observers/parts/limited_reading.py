"""What a reading at a limit of its range says to the filter on the measured side.

There it only bounds what the sensor reads; near it, noise selects what is read. The mathematics is
in docs/filters.md.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Reading
from undeadzone.numerics.gaussian import (
    Gaussian,
    Weighed,
    linearise,
    truncate,
    truncate_unless_fake,
)
from undeadzone.observers.parts.gaussian_filter import Params
from undeadzone.observers.parts.measured_reading import DOUBT, Heard, beyond_edge
from undeadzone.observers.parts.prior import Prior
from undeadzone.observers.parts.shown_belief import Setup
from undeadzone.sensor import LEFT, RIGHT, Zone
from undeadzone.support.arrays import Floats

BEYOND = 0.5  # share of the wrong readings that lie beyond the range and read as its limit


class Ends(NamedTuple):
    """Numbers of a filter about the range of the readings.

    Attributes:
        low, high: limits of the readings (p) [y].
        gate: distance from a limit at which a reading surely is no limit (p) [y].
    """

    low: Floats
    high: Floats
    gate: Floats


def ends(sensor: Zone, prior: Prior) -> Ends | None:
    """The numbers about the range; None where no output has one."""
    if sensor.limits is None:
        return None
    return Ends(*sensor.limits, 4 * np.sqrt(prior.R) * sensor.slope)


def inside(q: Params, y: Any, last: Any, previous: Any) -> Any:
    """Whether a reading is surely no limit, and not one that noise kept from it (p).

    It lies far inside, or the two before it announced it: as `surely_beyond` says of an edge.

    Args:
        q: numbers of the filter.
        y: reading (p) [y].
        last, previous: the two before it, 0 where one was missing or refused (p) [y].
    """

    def from_high(y: Any) -> Any:
        return q.ends.high - y

    def from_low(y: Any) -> Any:
        return y - q.ends.low

    sure = ca.SX(1.0)
    for distance in (from_high, from_low):
        before = [ca.if_else(was == 0, 0.0, distance(was)) for was in (last, previous)]
        sure = ca.logic_and(sure, surely_beyond(distance(y), *before, q.ends.gate))
    return sure


def surely_beyond(y: Any, last: Any, previous: Any, gate: Any) -> Any:
    """Whether a number with noise is surely positive.

    It is beyond twice the gate, or the two before it announced it: both beyond the gate, their
    straight line too, and it is not below 0.
    """
    both_beyond = ca.logic_and(last > gate, previous > gate)
    line_beyond = ca.logic_and(2 * last - previous > gate, y > 0)
    return ca.logic_or(y > 2 * gate, ca.logic_and(both_beyond, line_beyond))


def use_limits(setup: Setup, q: Params, known: Heard, wait: Any, y: Any, side: Any) -> Heard:
    """What is known given that z is at least, or at most, what a reading at a limit says.

    Args:
        setup: the filter.
        q: its numbers.
        known: what is known after the other readings and silences.
        wait: steps to wait until a limit is heard again, upper limits, then lower ones (2p).
        y: reading, 0 where it is missing (p) [y].
        side: measured sides (p), +2 or -2 at a limit.

    Returns:
        What is known, with the waits of the edges and then of the limits (4p).
    """
    belief, log = known.belief, known.log
    trust, waits = ca.SX(known.trust), [known.wait]
    for k, end in enumerate((RIGHT, LEFT)):
        for i in range(setup.model.p):
            waiting = wait[k * setup.model.p + i]
            bounded = ca.logic_and(side[i] == 2 * end, waiting <= 0)
            one, used = heard_limit(setup, q, belief, i, end, y[i], bounded)
            belief = one.belief
            log += one.log
            trust[i] = ca.fmin(trust[i], one.trust)
            waits.append(ca.if_else(used, setup.lasting, waiting - 1))
    return Heard(belief, ca.vertcat(*waits), trust, log)


def heard_limit(
    setup: Setup, q: Params, belief: Gaussian, i: int, end: float, y: Any, bounded: Any
) -> tuple[Weighed, Any]:
    """What one limit says, and whether it need not be heard again for a while.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief so far.
        i: number of the output.
        end: the upper limit (right) or the lower one (left).
        y: reading [y].
        bounded: whether the limit is heard.
    """
    branch = 0.0 if setup.jump else end
    expected, h = linearise(partial(beyond_edge, setup, q, i, branch), belief.mean)
    over = end * (y / q.slope[i] - expected)
    if not setup.doubts:
        after, used = truncate(belief, -end * h, over, q.R[i], bounded, DOUBT)
        return Weighed(after, 0.0, 0.0, ca.SX(1.0), 0.0), used
    fake = q.doubt.glitch + math.log(BEYOND)
    one, used = truncate_unless_fake(belief, -end * h, over, q.R[i], bounded, DOUBT, fake)
    return one, ca.logic_and(used, one.trust > 0.5)


def distrusted(trust: Any, reading: Reading) -> Any:
    """The trust in readings (p), 0 for those that cannot be: beyond their range."""
    return ca.if_else(reading.y > 1e300, 0.0, trust)
