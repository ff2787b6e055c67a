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
from undeadzone.numerics.doubtful import Weighed, truncate_unless_fake
from undeadzone.numerics.gaussian import Gaussian, linearise, truncate
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


def surely_exact(setup: Setup, q: Params, y: Any, last: Any, previous: Any, side: Any) -> Any:
    """Whether a reading is surely exact, and not one that noise brought there (p).

    It lies far from silence and from the limit of its side, or the two before it announced it: both
    lie between silence and limit, and their straight line too. A reading at a limit announces
    nothing, nor does a silent one: where they would go on is not known.

    Args:
        setup: the filter.
        q: its numbers.
        y: reading (p) [y].
        last, previous: the two before it, 0 where one was missing or refused (p) [y].
        side: measured sides (p), +2 or -2 at a limit.
    """
    gate = 0.0 if setup.jump else q.gate
    right = _surely_between(y, last, previous, gate, q.ends.high, q.ends.gate)
    left = _surely_between(-y, -last, -previous, gate, -q.ends.low, q.ends.gate)
    return ca.logic_and(ca.fabs(side) < 2, ca.logic_or(right, left))


def _surely_between(y: Any, last: Any, previous: Any, gate: Any, high: Any, margin: Any) -> Any:
    """Whether a reading is surely on the right and below its limit.

    Args:
        y: reading (p) [y].
        last, previous: the two before it (p) [y].
        gate: that is surely not silent (p) [y].
        high: the limit (p) [y].
        margin: from the limit, at which a reading surely is no limit (p) [y].
    """

    def between(y: Any, times: float) -> Any:
        return ca.logic_and(y > times * gate, high - y > times * margin)

    both = ca.logic_and(between(last, 1.0), between(previous, 1.0))
    announced = ca.logic_and(both, between(2 * last - previous, 1.0))
    announced = ca.logic_and(announced, between(y, 0.0))
    return ca.logic_or(between(y, 2.0), announced)


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
            waits.append(ca.if_else(used, q.lasting, waiting - 1))
    return known._replace(belief=belief, wait=ca.vertcat(*waits), trust=trust, log=log)


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
    one, used, _ = truncate_unless_fake(belief, -end * h, over, q.R[i], bounded, DOUBT, fake)
    return one, ca.logic_and(used, one.trust > 0.5)


def distrusted(trust: Any, reading: Reading) -> Any:
    """The trust in readings (p), 0 for those that cannot be: beyond their range."""
    return ca.if_else(reading.y > 1e300, 0.0, trust)
