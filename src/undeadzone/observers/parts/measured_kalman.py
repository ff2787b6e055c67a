"""The Kalman filter on the measured side estimates [x; d_r; d_l] and further unknowns.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Reading
from undeadzone.numerics.gaussian import (
    Gaussian,
    Weighed,
    advance,
    linearise,
    predict,
    symmetric,
    triangle,
    truncate,
    truncate_unless_fake,
    update,
    update_unless_glitch,
)
from undeadzone.observers.parts.doubt import doubt_numbers
from undeadzone.observers.parts.gaussian_filter import (
    Augmentation,
    Params,
    filter_numbers,
    kept_entries,
    motion,
    to_estimate,
)
from undeadzone.observers.parts.member import Member, Step, likelihood
from undeadzone.observers.parts.prior import Prior
from undeadzone.observers.parts.shown_belief import Setup, shown_belief, with_unknowns
from undeadzone.plants.system import System
from undeadzone.sensor import LEFT, RIGHT, Zone, offset, present

# A silent sensor counts where the belief contradicts it by more than 5 %.
DOUBT = 1.6448536269514722
LIMIT = 1e100  # of all numbers of a belief: beyond it, it is lost


class State(NamedTuple):
    """What the filter carries from sample to sample.

    Attributes:
        mean, cov: mean and covariance (its `triangle`) before the reading.
        last, previous: the last two readings, 0 where one was refused (p) [y].
        wait: steps to wait until an edge is heard again, right edges, then left ones (2p).
        u: the last input (m).
    """

    mean: Any
    cov: Any
    last: Any
    previous: Any
    wait: Any
    u: Any


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


def measured_filter(
    model: System,
    sensor: Zone,
    prior: Prior,
    augmentation: Augmentation,
    lasting: float = 1.0,
    bounds: bool = False,
    order: Literal[1, 2] = 2,
    blind: bool = False,
    glitches: float = 0.0,
) -> Member:
    """The filter; `Setup` explains the arguments. glitches: share of the readings that is wrong."""
    entries = kept_entries(model, augmentation)
    doubts = glitches > 0 and not blind
    setup = Setup(model, sensor, augmentation, entries, lasting, bounds, order, blind, doubts)
    p, m = model.p, model.m

    def init(q: Params) -> State:
        return State(q.mean, q.cov, np.zeros(p), np.zeros(p), np.zeros(2 * p), np.zeros(m))

    params = filter_numbers(model, sensor, prior, augmentation)
    doubt = doubt_numbers(model, sensor, prior, glitches)
    return Member(params._replace(doubt=doubt), init, partial(filter_step, setup))


def filter_step(setup: Setup, q: Params, s: State, u: Any, reading: Reading) -> Step:
    """One sample: correct by the reading, use what bounds, estimate, predict."""
    seen = present(reading.y)
    y = ca.if_else(seen, reading.y, 0.0)
    side = side_taken(setup, q, s, reading, y, seen)
    before = Gaussian(s.mean, symmetric(s.cov, setup.entries))
    corrected = correct(setup, q, before, y, side)
    heard = Heard(corrected.belief, s.wait, corrected.trust, corrected.log)
    if setup.bounds:
        silent = ca.logic_and(seen, ca.fabs(y) <= q.gate)
        heard = use_bounds(setup, q, heard, silent, side)
    shown, fits = shown_belief(setup, q, heard.belief)
    e, std = corrected.e, corrected.std
    estimated = to_estimate(setup.model, setup.sensor, q, shown, reading, e, std)
    estimated = with_unknowns(setup, q, estimated, shown, s.u)
    mean, cov, restarted = sound(setup, q, predicted(setup, q, heard.belief, u))
    last = ca.if_else(heard.trust < 0.5, 0.0, y) if setup.doubts else y
    return Step(
        state=State(mean, cov, last, s.last, heard.wait, u),
        estimate=estimated,
        log=heard.log if setup.doubts else likelihood(estimated),
        trust=heard.trust,
        fits=fits,
        restarted=restarted,
    )


def side_taken(setup: Setup, q: Params, s: State, reading: Reading, y: Any, seen: Any) -> Any:
    """The sides on which the readings are used (p), 0 where none is sure.

    Args:
        setup: the filter.
        q: its numbers.
        s: its state.
        reading: what was read.
        y: reading, 0 where it is missing (p) [y].
        seen: whether it is there (p).
    """
    if setup.blind:
        return seen
    side = reading.side if setup.jump else sure_side(y, s.last, s.previous, q.gate)
    if not setup.doubts:
        return side
    stuck = ca.logic_and(y == s.last, q.doubt.noisy)
    return ca.if_else(stuck, 0.0, side)


def sound(setup: Setup, q: Params, belief: Gaussian) -> tuple[Any, Any, Any]:
    """The belief if it is one of finite numbers and positive variances, else the prior.

    Returns:
        (mean, covariance (its `triangle`), 1 where it is the prior).
    """
    cov = triangle(belief.cov, setup.entries)
    size = ca.sum1(ca.fabs(ca.vertcat(belief.mean, cov)))
    least = ca.mmin(ca.densify(ca.diag(belief.cov)))
    fine = ca.logic_and(size < LIMIT, least >= 0)
    mean = ca.if_else(fine, belief.mean, q.mean)
    return mean, ca.if_else(fine, cov, q.cov), ca.logic_not(fine)


def beyond_edge(setup: Setup, q: Params, i: int, side: Any, X: Any) -> Any:
    """How far z_i is beyond the edge of that side: the reading on it; with side 0, z_i itself."""
    n, p = setup.model.n, setup.model.p
    z = setup.model.output(q.model, X[:n])[i]
    return z - offset(side, X[n + i], X[n + p + i])


def correct(setup: Setup, q: Params, belief: Gaussian, y: Any, side: Any) -> Weighed:
    """The belief after the readings on the sides that are sure, one output at a time.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief before the reading.
        y: reading, 0 where it is missing (p) [y].
        side: the sides that are sure (p), 0 where none is.

    Returns:
        Innovations, their standard deviations and trust (p each), and the sum of the logs.
    """
    each = []
    for i in range(setup.model.p):
        active = side[i] != 0
        branch = 0.0 if setup.jump else side[i]
        expected, h = linearise(partial(beyond_edge, setup, q, i, branch), belief.mean)
        e = ca.if_else(active, y[i] / q.slope[i] - expected, 0.0)
        if setup.doubts:
            odds, reach = q.doubt.glitch, q.doubt.reach[i]
            one = update_unless_glitch(belief, h, e, q.R[i], active, odds, reach)
        else:
            after, S = update(belief, h, e, q.R[i], active)
            one = Weighed(after, e, ca.sqrt(S), ca.SX(1.0), 0.0)
        belief = one.belief
        each.append(one)
    return Weighed(
        belief=belief,
        e=ca.vertcat(*(one.e for one in each)),
        std=ca.vertcat(*(one.std for one in each)),
        trust=ca.vertcat(*(one.trust for one in each)),
        log=sum(one.log for one in each),
    )


def use_bounds(setup: Setup, q: Params, known: Heard, silent: Any, side: Any) -> Heard:
    """What is known given that z is inside the edges of a silent sensor.

    The z of a jump sensor is beyond the edge that it is on, besides.

    Args:
        setup: the filter.
        q: its numbers.
        known: what is known after the readings on active sides.
        silent: whether each output is silent (p).
        side: the sides that are sure (p).
    """
    waits: list[Any] = []
    belief, log = known.belief, known.log
    trust = ca.SX(known.trust)
    for edge in (RIGHT, LEFT):
        for i in range(setup.model.p):
            outside = (side[i] == edge) if setup.jump else 0.0
            waiting = known.wait[len(waits)]
            bounded = ca.logic_and(ca.logic_or(silent[i], outside), waiting <= 0)
            one, used = heard_edge(setup, q, belief, i, edge, silent[i], outside, bounded)
            belief = one.belief
            log += one.log
            trust[i] = ca.fmin(trust[i], one.trust)
            waits.append(ca.if_else(used, setup.lasting, waiting - 1))
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
    """
    excess, h = linearise(partial(beyond_edge, setup, q, i, edge), belief.mean)
    sign = edge * (1 - 2 * outside)
    over = sign * excess - ca.if_else(silent, q.gate[i] / q.slope[i], 0.0)
    if not setup.doubts:
        after, used = truncate(belief, sign * h, over, q.R[i], bounded, DOUBT)
        return Weighed(after, 0.0, 0.0, ca.SX(1.0), 0.0), used
    one, used = truncate_unless_fake(belief, sign * h, over, q.R[i], bounded, DOUBT, q.doubt.fake)
    return one, ca.logic_and(used, one.trust > 0.5)


def predicted(setup: Setup, q: Params, belief: Gaussian, u: Any) -> Gaussian:
    """The belief at the next sample."""
    augmentation = setup.augmentation
    move, Q = motion(setup.model, q, augmentation, belief, u)
    if setup.order == 1:
        slope = None if augmentation.slope is None else augmentation.slope(q)
        return advance(belief, move, Q, slope)
    bend = None if augmentation.bilinear is None else partial(bilinear_part, setup, q, u)
    return predict(belief, move, Q, setup.lasting, bend)


def bilinear_part(setup: Setup, q: Params, u: Any, X: Any) -> tuple[Any, Any]:
    """(G, b) of the augmentation with the rows of all of X = [x; d; extra]."""
    assert setup.augmentation.bilinear is not None
    n, p = setup.model.n, setup.model.p
    G, b = setup.augmentation.bilinear(q, X[:n], X[n + 2 * p :], u)
    return ca.vertcat(G, ca.SX(X.shape[0] - n, b.shape[0])), b


def sure_side(y: Any, last: Any, previous: Any, gate: Any) -> Any:
    """The side on which a reading may be taken for z - d_r or z + d_l with noise of mean 0 (p).

    A reading far beyond the gate, or one that the two before it announced: both beyond the gate,
    their straight line too, and y not across 0. To ask only whether y itself is beyond a threshold
    would select noise of one sign.
    """
    return 1.0 * _sure(y, last, previous, gate) - 1.0 * _sure(-y, -last, -previous, gate)


def _sure(y: Any, last: Any, previous: Any, gate: Any) -> Any:
    """Whether a reading is surely on the right."""
    both_beyond = ca.logic_and(last > gate, previous > gate)
    line_beyond = ca.logic_and(2 * last - previous > gate, y > 0)
    return ca.logic_or(y > 2 * gate, ca.logic_and(both_beyond, line_beyond))
