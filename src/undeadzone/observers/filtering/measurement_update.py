"""Measurement update for a known branch and for censored samples.

A reading at a limit of its range only bounds the sensor's output. Near the limit, noise selects the
readings. The mathematics is in docs/filter_equations.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.nonlinearities.play import readings_of_motion
from undeadzone.nonlinearities.sensor import LEFT, RIGHT, Zone, offset, present
from undeadzone.numerics.gaussian import (
    Bound,
    Gaussian,
    RobustUpdate,
    TruncationUpdate,
    linearise,
    stack_updates,
    truncate_at_bounds,
    update_with_outliers,
)
from undeadzone.observers.filtering.constant_states import backlash_offset, information_shares
from undeadzone.observers.filtering.gaussian_filter import Params, Setup
from undeadzone.observers.filtering.prior import HOLD, SILENT, Prior
from undeadzone.observers.filtering.sensor_shape import (
    add_shape_terms,
    move_columns,
    shape_effects,
)
from undeadzone.plants.system import System, plant_pace, time_scale
from undeadzone.util.arrays import Floats

# A censored sample counts if the estimate contradicts it by more than 5 %.
DOUBT = 1.6448536269514722
BEYOND = 0.5  # share of the wrong readings that lie beyond the range and read as its limit


class Corrected(NamedTuple):
    """Result of a correction by a reading.

    Attributes:
        belief: mean and covariance of `[x; d; extra]`.
        wait: steps to wait until an edge is used again, right edges, then left ones (2p).
        trust: probability that the reading was not wrong (p).
        likely: the density with which each output was foretold (p).
        silence: whether a silence was believed, by right edges and by left ones (2 of p).
    """

    belief: Gaussian
    wait: Any
    trust: Any
    likely: Any
    silence: tuple[Any, ...] = ()


def branch_output(setup: Setup, q: Params, i: int, side: Any, X: Any, contact: Any = 0.0) -> Any:
    """Return the expected reading of z_i on a branch [z]: z_i less its offset.

    Side 0 gives z_i itself.

    contact: of a play ahead of the zone, whose gap is taken off too.
    """
    n = setup.model.n
    p = setup.model.p
    z = setup.model.output(q.model, X[:n])[i]
    return z - offset(side, X[n + i], X[n + p + i]) - backlash_offset(q, i, contact, X)


def correct_by_readings(
    setup: Setup,
    q: Params,
    belief: Gaussian,
    y: Any,
    side: Any,
    R: Any,
    surprise: Sequence[Any],
    contact: Any,
    ahead: Any,
    columns: Any,
) -> tuple[RobustUpdate, Any]:
    """Return the Gaussian after the readings on certain branches, output by output.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief before the reading.
        y: reading, 0 if it is missing (p) [y].
        side: the sides that are sure (p), 0 if none is.
        R: variances of the readings (p) [z^2].
        surprise: log likelihood ratio of each reading given the censored samples before (p).
        contact: of a play ahead of the zone, in which y moves (p) (None: there is none).
        ahead: motion of z in a sample (p) [z] (needed for late readings only).
        columns: of the sensor's shape (N x their number) (None: there are none).

    Returns:
        (innovations, their standard deviations and trust (p each), and the sum of the logs, the
        columns).
    """
    each = []
    before = belief.mean
    for i in range(setup.model.p):
        active = side[i] != 0
        branch = 0.0 if setup.is_jump_sensor else side[i]
        moving = 0.0 if contact is None else contact[i]
        expected, h = foresee_reading(setup, q, i, branch, belief.mean, before, moving)
        e = ca.if_else(active, y[i] / q.slope[i] - expected, 0.0)
        odds = q.doubt.glitch if setup.doubts else None
        reach = q.doubt.reach[i]
        moved = update_shares(setup, q, belief, i, side[i]) if setup.needs_partial_updates else None
        one = update_with_outliers(belief, h, e, R[i], active, odds, reach, moved, surprise[i])
        belief = one.belief
        each.append(one)
        if setup.shape.fixed:
            late = ca.if_else(present(ahead[i]), ahead[i], 0.0) if ahead.shape[0] else 0.0
            effects = shape_effects(q, setup.shape.fixed, i, branch, y[i] / q.slope[i], late)
            columns = move_columns(setup, q, i, columns, one.gain, h, effects)
    return stack_updates(each), columns


def foresee_reading(
    setup: Setup, q: Params, i: int, side: Any, at: Any, before: Any, contact: Any = 0.0
) -> tuple[Any, Any]:
    """Return (what output i is expected to read on a branch [z], its row (1 x N)).

    Args:
        setup: the filter.
        q: its numbers.
        i: number of the output.
        side: the branch.
        at: mean of `[x; d; extra]` (N).
        before: the same before any reading of the sample (N), for the sensor's shape.
        contact: of a play ahead of the zone.
    """
    sight = partial(branch_output, setup, q, i, side, contact=contact)
    foretold = sight(before) if setup.shape.learned else 0.0
    return add_shape_terms(setup, q, i, side, foretold, linearise(sight, at), at)


def silence_pause(model: System, sensor: Zone, lasting: float) -> float:
    """Return the number of steps between uses of a silent breakpoint.

    The pause is at least a 25th of the plant's period.

    However long a disturbance lasts, z has moved in a quarter period.

    A jump sensor's readings bound its edges too, each from another place.

    Args:
        model: the model.
        sensor: the sensor.
        lasting: steps for which an error of the linearisation keeps its sign.
    """
    if sensor.kind == "jump" or model.flow is None or model.Ts is None:
        return lasting
    quarter = time_scale(model.flow, model.Ts) / model.Ts
    return max(
        min(lasting, quarter), readings_of_motion(model.Ts, plant_pace(model.flow, model.Ts))
    )


def update_shares(setup: Setup, q: Params, belief: Gaussian, i: int, side: Any) -> Any:
    """Return the share of the full update of each variable by a reading of output i (N) [1].

    The bound from censored samples couples z and an edge, though it moved the edge by a share only.
    A reading on the other edge, which contains information on z, moves this one by no more.
    """
    n = setup.model.n
    p = setup.model.p
    moved = ca.SX(information_shares(q, setup.model, belief.cov))
    for place, edge in ((n + i, RIGHT), (n + p + i, LEFT)):
        moved[place] = ca.if_else(side == edge, 1.0, moved[place])
    return moved


def use_bounds(
    setup: Setup,
    q: Params,
    known: Corrected,
    silent: Any,
    side: Any,
    level: Any = None,
    play_side: Any = None,
) -> Corrected:
    """Return the correction given that z is inside the breakpoints of a silent sensor.

    The z of a jump sensor is beyond the edge that it is on, besides. Censored samples are used once
    in a while: they contain the same information on the same edge, and mean and covariance do not
    show that a tail was cut already.

    Args:
        setup: the filter.
        q: its numbers.
        known: result after the readings on active sides.
        silent: whether each output is silent (p).
        side: the sides that are sure (p).
        level: from which z is inside the edges (p) [y], y of a play (None: 0).
        play_side: side of the zone on which a play ahead of it holds the reading (p), 0 inside the
            zone (None: no play is ahead of it).
    """
    p = setup.model.p
    waits = ca.vertsplit(ca.SX(known.wait))[: 2 * p]
    believed: list[Any] = [0.0] * (2 * p)
    belief = known.belief
    likely = ca.SX(known.likely)
    trust = ca.SX(known.trust)
    for i, edges in _edge_groups(setup):
        bounds = []
        for k, edge in edges.items():
            outside = (side[i] == edge) if setup.is_jump_sensor else 0.0
            is_used = ca.logic_and(ca.logic_or(silent[i], outside), known.wait[k] <= 0)
            above = 0.0 if level is None else edge * level[i]
            slack = q.gate[i] + above
            branch = edge
            if play_side is not None:
                branch = ca.if_else(play_side[i] != 0, play_side[i], edge)
                slack += ca.if_else(play_side[i] != 0, HOLD / SILENT - 1, 0.0) * q.gate[i]
            slack = ca.if_else(silent[i], slack / q.slope[i], 0.0)
            bounds.append(
                breakpoint_bound(setup, q, belief, i, edge, branch, outside, slack, is_used)
            )
        one = edge_constraint(setup, q, belief, i, bounds)
        belief = one.belief
        likely[i] *= one.likely
        for k, used in zip(edges, one.used, strict=True):
            trust[i] = ca.fmin(trust[i], ca.if_else(used, one.trust, 1.0))
            believed[k] = ca.logic_and(silent[i], one.trust > 0.5)
            again = ca.logic_and(used, one.trust > 0.5)
            waits[k] = ca.if_else(again, q.rest, known.wait[k] - 1)
    silences = tuple(ca.vertsplit(ca.vertcat(*believed), p))
    return Corrected(belief, ca.vertcat(*waits), trust, likely, silences)


def _edge_groups(setup: Setup) -> list[tuple[int, dict[int, float]]]:
    """Return the breakpoints that are applied together.

    Each entry: the output, and the side of each breakpoint by its place.

    Those of a jump sensor are applied one by one: a z beyond one of them implies nothing about the
    other.
    """
    each = _existing_edges(setup.sensor)
    if not setup.is_jump_sensor:
        return list(enumerate(each))
    alone = []
    for i, edges in enumerate(each):
        for k, edge in edges.items():
            alone.append((i, {k: edge}))
    return sorted(alone, key=lambda one: max(one[1]))


def _existing_edges(sensor: Zone) -> list[dict[int, float]]:
    """Return the side of each edge that exists by its place among all, output by output."""
    p = sensor.slope.size
    each = []
    for i, absent in enumerate(sensor.absent.T):
        edges = {}
        for k, side, gone in zip((i, p + i), (RIGHT, LEFT), absent, strict=True):
            if not gone:
                edges[k] = side
        each.append(edges)
    return each


def drop_absent_edges(observer: Observer, sensor: Zone) -> Observer:
    """Return a filter to which a reading beyond an edge that does not exist is impossible.

    Its estimate of that width is infinite, without a deviation.

    Args:
        observer: the filter, which knows no such edge.
        sensor: the dead zone.
    """
    right, left = sensor.absent
    if not sensor.absent.any():
        return observer

    def without(reading: Reading) -> Reading:
        """Return the reading, missing and impossible on a side without an edge."""
        beyond = ca.logic_or(ca.logic_and(right, reading.side > 0), left * (reading.side < 0))
        y = ca.if_else(beyond, np.inf, reading.y)
        return reading._replace(y=y, side=ca.if_else(beyond, 0.0, reading.side))

    def shown(estimate: Estimate) -> Estimate:
        """Return the estimate with infinite widths."""
        for side, gone in zip(("right", "left"), sensor.absent, strict=True):
            width = ca.if_else(gone, np.inf, getattr(estimate, side))
            std = getattr(estimate, f"{side}_std") * ~gone
            estimate = estimate._replace(**{side: width, f"{side}_std": std})
        other = estimate.right_std + estimate.left_std
        width_std = ca.if_else(right | left, other, estimate.width_std)
        return estimate._replace(width_std=width_std)

    def step(q: Any, s: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
        """Return the next state and the estimate."""
        after, estimate = observer.step(q, s, u, without(reading))
        return after, shown(estimate)

    inner = observer.smoothing
    smoothing = inner._replace(
        moments=lambda q, s, u, reading: inner.moments(q, s, u, without(reading)),
        mixture_estimate=lambda *beliefs: shown(inner.mixture_estimate(*beliefs)),
    )
    return observer._replace(step=step, smoothing=smoothing)


def find_censored(setup: Setup, q: Params, reading: Reading, y: Any) -> Any:
    """Return 1 for readings that bound z by the breakpoints (p).

    For a backlash all present readings do.

    Args:
        setup: the filter.
        q: its numbers.
        reading: the reading.
        y: reading, 0 if it is missing (p) [y].
    """
    silent = present(reading.y)
    if not setup.is_backlash_sensor:
        silent = ca.logic_and(silent, ca.fabs(y) <= q.gate)
    if setup.has_limits:
        silent = ca.logic_and(silent, ca.fabs(reading.side) < 2)
    return silent


def confirm_silences(setup: Setup, q: Params, belief: Gaussian, silent: Any) -> tuple[Any, ...]:
    """Return 1 if the Gaussian supports a silence, by right and by left breakpoints (2 of p).

    Empty if unused.

    Args:
        setup: the filter.
        q: its numbers.
        belief: about `[x; d; extra]`, which no censored sample moves here.
        silent: whether each output is silent (p).
    """
    if not setup.has_pace_test:
        return ()
    each = []
    for i, edges in enumerate(_existing_edges(setup.sensor)):
        bounds = []
        for edge in edges.values():
            slack = q.gate[i] / q.slope[i]
            bounds.append(breakpoint_bound(setup, q, belief, i, edge, edge, 0.0, slack, 0.0))
        trust = edge_constraint(setup, q, belief, i, bounds).trust
        each.append(ca.logic_and(silent[i], trust > 0.5))
    return (ca.vertcat(*each),) * 2


def breakpoint_bound(
    setup: Setup,
    q: Params,
    belief: Gaussian,
    i: int,
    edge: float,
    branch: Any,
    outside: Any,
    slack: Any,
    is_used: Any,
) -> Bound:
    """Return the bound that a breakpoint sets.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief so far.
        i: number of the output.
        edge: right or left.
        branch: side of the zone whose edge it is, that of a play ahead of it aside.
        outside: whether z is beyond the edge instead, by a jump sensor's reading.
        slack: how far z may be beyond the edge [z].
        is_used: whether the edge is used.
    """
    sight = partial(branch_output, setup, q, i, branch, contact=edge)
    excess, h = linearise(sight, belief.mean)
    sign = edge * (1 - 2 * outside)
    return Bound(sign * h, sign * excess - slack, is_used)


def edge_constraint(
    setup: Setup, q: Params, belief: Gaussian, i: int, bounds: Sequence[Bound]
) -> TruncationUpdate:
    """Return the Gaussian truncated at breakpoints of output i (bounds: of each breakpoint)."""
    if not setup.doubts:
        return truncate_at_bounds(belief, bounds, q.R[i], DOUBT)
    moved = information_shares(q, setup.model, belief.cov) if setup.careful else None
    return truncate_at_bounds(belief, bounds, q.R[i], DOUBT, q.doubt.fake, moved)


def certain_branch(y: Any, last: Any, previous: Any, gate: Any) -> Any:
    """Return the branch of readings that count as z - d_r or z + d_l with zero-mean noise (p).

    A reading far beyond the gate, or one that the two before it announced: both beyond the gate,
    their straight line too, and y not across 0. A test of y itself against a threshold would select
    noise of one sign.
    """
    return 1.0 * _is_certainly_right(y, last, previous, gate) - 1.0 * _is_certainly_right(
        -y, -last, -previous, gate
    )


def _is_certainly_right(y: Any, last: Any, previous: Any, gate: Any) -> Any:
    """Return 1 if a reading is surely on the right.

    Beyond twice the gate no noise carries a silent reading. Nearer, the reading itself must not
    decide: those with outward noise would be kept, and their mean would be too large. There the two
    readings before it decide, whose noise is independent of its own. Both must be beyond the gate,
    and the line through them at this sample too, so that z does not come back in between.
    """
    both_beyond = ca.logic_and(last > gate, previous > gate)
    line_beyond = ca.logic_and(2 * last - previous > gate, y > 0)
    return ca.logic_or(y > 2 * gate, ca.logic_and(both_beyond, line_beyond))


class RangeLimits(NamedTuple):
    """Parameters of a filter for the range of the readings.

    Attributes:
        low, high: limits of the readings (p) [y].
        gate: distance from a limit beyond which a reading surely is not at the limit (p) [y].
    """

    low: Floats
    high: Floats
    gate: Floats


def range_limits(sensor: Zone, prior: Prior) -> RangeLimits | None:
    """Return the parameters for the range of the readings, or None if no output has a range."""
    if sensor.limits is None:
        return None
    return RangeLimits(*sensor.limits, 4 * np.sqrt(prior.R) * sensor.slope)


def is_surely_exact(setup: Setup, q: Params, y: Any, last: Any, previous: Any, side: Any) -> Any:
    """Return 1 if a reading is surely exact, and not moved into the range by noise (p).

    It lies far from the zone and from the limit of its side, or the two before it announced it:
    both lie between zone and limit, and their straight line too. A reading at a limit or inside the
    zone announces nothing, as its further course is unknown.

    Args:
        setup: the filter.
        q: its numbers.
        y: reading (p) [y].
        last, previous: the two before it, 0 if one was missing or rejected (p) [y].
        side: measured sides (p), +2 or -2 at a limit.
    """
    gate = 0.0 if setup.is_jump_sensor else q.gate
    right = _is_surely_between(y, last, previous, gate, q.ends.high, q.ends.gate)
    left = _is_surely_between(-y, -last, -previous, gate, -q.ends.low, q.ends.gate)
    return ca.logic_and(ca.fabs(side) < 2, ca.logic_or(right, left))


def _is_surely_between(y: Any, last: Any, previous: Any, gate: Any, high: Any, margin: Any) -> Any:
    """Return 1 if a reading is surely on the right and below its limit.

    Args:
        y: reading (p) [y].
        last, previous: the two before it (p) [y].
        gate: that is surely not silent (p) [y].
        high: the limit (p) [y].
        margin: distance from the limit, beyond which a reading surely is not at the limit (p) [y].
    """

    def is_inside_margins(y: Any, times: float) -> Any:
        """Return 1 if a reading lies between gate and limit by their margins."""
        return ca.logic_and(y > times * gate, high - y > times * margin)

    both = ca.logic_and(is_inside_margins(last, 1.0), is_inside_margins(previous, 1.0))
    announced = ca.logic_and(both, is_inside_margins(2 * last - previous, 1.0))
    announced = ca.logic_and(announced, is_inside_margins(y, 0.0))
    return ca.logic_or(is_inside_margins(y, 2.0), announced)


def use_limits(
    setup: Setup, q: Params, known: Corrected, wait: Any, y: Any, side: Any
) -> Corrected:
    """Return the correction given a reading at a limit: z is at or beyond it.

    Args:
        setup: the filter.
        q: its numbers.
        known: result after the other readings and censored samples.
        wait: steps to wait until a limit is used again, upper limits, then lower ones (2p).
        y: reading, 0 if it is missing (p) [y].
        side: measured sides (p), +2 or -2 at a limit.

    Returns:
        The result, with the waits of the edges and then of the limits (4p).
    """
    p = setup.model.p
    belief = known.belief
    likely = ca.SX(known.likely)
    trust = ca.SX(known.trust)
    wait = ca.SX(wait) - 1
    for i in range(p):
        end = ca.sign(side[i])
        waiting = ca.if_else(end == RIGHT, wait[i], wait[p + i])
        is_used = ca.logic_and(ca.fabs(side[i]) == 2, waiting < 0)
        one = limit_update(setup, q, belief, i, end, y[i], is_used)
        (used,) = one.used
        belief = one.belief
        likely[i] *= one.likely
        trust[i] = ca.fmin(trust[i], ca.if_else(used, one.trust, 1.0))
        again = ca.logic_and(used, one.trust > 0.5)
        for k, limit in ((i, RIGHT), (p + i, LEFT)):
            wait[k] = ca.if_else(ca.logic_and(again, end == limit), q.lasting, wait[k])
    wait = ca.vertcat(known.wait, wait)
    return known._replace(belief=belief, wait=wait, trust=trust, likely=likely)


def limit_update(
    setup: Setup, q: Params, belief: Gaussian, i: int, end: Any, y: Any, is_used: Any
) -> TruncationUpdate:
    """Return the Gaussian truncated at a limit of the range.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief so far.
        i: number of the output.
        end: the upper limit (right) or the lower one (left).
        y: reading [y].
        is_used: whether the limit is used.
    """
    branch = 0.0 if setup.is_jump_sensor else end
    expected, h = linearise(partial(branch_output, setup, q, i, branch), belief.mean)
    bound = Bound(-end * h, end * (y / q.slope[i] - expected), is_used)
    fake = q.doubt.glitch + math.log(BEYOND) if setup.doubts else None
    return truncate_at_bounds(belief, [bound], q.R[i], DOUBT, fake)


def reject_impossible(trust: Any, reading: Reading) -> Any:
    """Return the trust in readings (p) [1], 0 for impossible readings beyond their range."""
    return ca.if_else(reading.y > 1e300, 0.0, trust)
