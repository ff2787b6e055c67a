"""What a reading, or a silence, says to the filter on the measured side."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.doubtful import (
    Weighed,
    together,
    truncate_unless_fake,
    update_unless_glitch,
)
from undeadzone.numerics.gaussian import Gaussian, linearise, truncate
from undeadzone.observers.parts.gaussian_filter import Params, informed
from undeadzone.observers.parts.shown_belief import Setup
from undeadzone.sensor import LEFT, RIGHT, offset

# A silent sensor counts where the belief contradicts it by more than 5 %.
DOUBT = 1.6448536269514722


class Heard(NamedTuple):
    """What is known after a reading.

    Attributes:
        belief: mean and covariance of [x; d; extra].
        wait: steps to wait until an edge is heard again, right edges, then left ones (2p).
        trust: probability that the reading was not wrong (p).
        log: log of the density with which it was foretold.
    """

    belief: Gaussian
    wait: Any
    trust: Any
    log: Any


def beyond_edge(setup: Setup, q: Params, i: int, side: Any, X: Any) -> Any:
    """How far z_i is beyond the edge of that side: the reading on it; with side 0, z_i itself."""
    n, p = setup.model.n, setup.model.p
    z = setup.model.output(q.model, X[:n])[i]
    return z - offset(side, X[n + i], X[n + p + i])


def correct(setup: Setup, q: Params, belief: Gaussian, y: Any, side: Any, R: Any) -> Weighed:
    """The belief after the readings on the sides that are sure, one output at a time.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief before the reading.
        y: reading, 0 where it is missing (p) [y].
        side: the sides that are sure (p), 0 where none is.
        R: variances of the readings (p) [z^2].

    Returns:
        Innovations, their standard deviations and trust (p each), and the sum of the logs.
    """
    each = []
    for i in range(setup.model.p):
        active = side[i] != 0
        branch = 0.0 if setup.jump else side[i]
        expected, h = linearise(partial(beyond_edge, setup, q, i, branch), belief.mean)
        e = ca.if_else(active, y[i] / q.slope[i] - expected, 0.0)
        odds, reach = q.doubt.glitch if setup.doubts else None, q.doubt.reach[i]
        one = update_unless_glitch(belief, h, e, R[i], active, odds, reach)
        belief = one.belief
        each.append(one)
    return together(each)


def use_bounds(
    setup: Setup, q: Params, known: Heard, silent: Any, side: Any, level: Any = None
) -> Heard:
    """What is known given that z is inside the edges of a silent sensor.

    The z of a jump sensor is beyond the edge that it is on, besides. What a play holds is heard
    once in the window over which its motion is judged: it is one level, however often it is read.

    Args:
        setup: the filter.
        q: its numbers.
        known: what is known after the readings on active sides.
        silent: whether each output is silent (p).
        side: the sides that are sure (p).
        level: from which z is inside the edges (p) [y], y of a play; None: 0.
    """
    waits: list[Any] = []
    belief, log = known.belief, known.log
    trust = ca.SX(known.trust)
    rest = q.lasting if level is None else ca.fmax(q.lasting, setup.sensor.window)
    for edge in (RIGHT, LEFT):
        for i in range(setup.model.p):
            outside = (side[i] == edge) if setup.jump else 0.0
            waiting = known.wait[len(waits)]
            bounded = ca.logic_and(ca.logic_or(silent[i], outside), waiting <= 0)
            above = 0.0 if level is None else edge * level[i]
            slack = q.gate[i] + above
            one, used = heard_edge(setup, q, belief, i, edge, silent[i], outside, bounded, slack)
            belief = one.belief
            log += one.log
            trust[i] = ca.fmin(trust[i], one.trust)
            waits.append(ca.if_else(used, rest, waiting - 1))
    return Heard(belief, ca.vertcat(*waits), trust, log)


def heard_edge(
    setup: Setup,
    q: Params,
    belief: Gaussian,
    i: int,
    edge: float,
    silent: Any,
    outside: Any,
    bounded: Any,
    slack: Any,
) -> tuple[Weighed, Any]:
    """What one edge says, and whether it need not be heard again for a while.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief so far.
        i: number of the output.
        edge: right or left.
        silent: whether the output is silent.
        outside: whether z is beyond the edge instead, by a jump sensor's reading.
        bounded: whether the edge is heard.
        slack: reading up to which z may be beyond the edge of a silent sensor [y].
    """
    excess, h = linearise(partial(beyond_edge, setup, q, i, edge), belief.mean)
    sign = edge * (1 - 2 * outside)
    over = sign * excess - ca.if_else(silent, slack / q.slope[i], 0.0)
    if not setup.doubts:
        after, used = truncate(belief, sign * h, over, q.R[i], bounded, DOUBT)
        return Weighed(after, 0.0, 0.0, ca.SX(1.0), 0.0), used
    moved = informed(q, setup.model, belief.cov) if setup.careful else None
    row, fake = sign * h, q.doubt.fake
    one, used = truncate_unless_fake(belief, row, over, q.R[i], bounded, DOUBT, fake, moved)
    return one, ca.logic_and(used, one.trust > 0.5)
