"""The Kalman filter on the measured side estimates [x; d_r; d_l] and further unknowns.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading
from undeadzone.numerics.gaussian import (
    Gaussian,
    advance,
    linearise,
    mix,
    predict,
    symmetric,
    triangle,
    truncate,
    truncate_to,
    update,
)
from undeadzone.observers.parts.gaussian_filter import (
    Augmentation,
    Params,
    filter_numbers,
    kept_entries,
    motion,
    to_estimate,
)
from undeadzone.observers.parts.prior import Prior
from undeadzone.plants.system import System
from undeadzone.sensor import LEFT, RIGHT, Zone, offset, present

DOUBT = (
    1.6448536269514722  # a silent sensor counts where the belief contradicts it by more than 5 %
)


class State(NamedTuple):
    """What the filter carries from sample to sample.

    Attributes:
        mean, cov: mean and covariance (its `triangle`) before the reading.
        last, previous: the last two readings (p) [y].
        wait: steps to wait until an edge is heard again, right edges, then left ones (2p).
        u: the last input (m).
    """

    mean: Any
    cov: Any
    last: Any
    previous: Any
    wait: Any
    u: Any


class Setup(NamedTuple):
    """What the parts of one filter share.

    Attributes:
        model: the sampled model.
        sensor: the dead zone.
        augmentation: the unknowns beside [x; d].
        entries: entries of the covariance's upper triangle that are kept.
        lasting: steps for which a linearisation error keeps its sign, and for which a silent edge
            is not heard again.
        bounds: whether it uses what bounds: a silent sensor, and the claimed ranges.
        order: order of the prediction.
        blind: whether it takes every reading for z itself.
    """

    model: System
    sensor: Zone
    augmentation: Augmentation
    entries: ca.Sparsity
    lasting: float
    bounds: bool
    order: Literal[1, 2]
    blind: bool

    @property
    def jump(self) -> bool:
        """Whether the sensor is of the jump kind."""
        return self.sensor.kind == "jump"


def measured_filter(
    model: System,
    sensor: Zone,
    prior: Prior,
    augmentation: Augmentation,
    lasting: float = 1.0,
    bounds: bool = False,
    order: Literal[1, 2] = 2,
    blind: bool = False,
) -> Observer:
    """The filter as an observer; `Setup` explains the arguments."""
    entries = kept_entries(model, augmentation)
    setup = Setup(model, sensor, augmentation, entries, lasting, bounds, order, blind)
    p, m = model.p, model.m

    def init(q: Params) -> State:
        return State(q.mean, q.cov, np.zeros(p), np.zeros(p), np.zeros(2 * p), np.zeros(m))

    params = filter_numbers(model, sensor, prior, augmentation)
    return Observer(params, init, partial(filter_step, setup))


def filter_step(
    setup: Setup, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """One sample: correct by the reading, use what bounds, estimate, predict."""
    seen = present(reading.y)
    y = ca.if_else(seen, reading.y, 0.0)
    if setup.blind:
        side = seen
    elif setup.jump:
        side = reading.side
    else:
        side = sure_side(y, s.last, s.previous, q.gate)
    before = Gaussian(s.mean, symmetric(s.cov, setup.entries))
    belief, e, e_std = correct(setup, q, before, y, side)
    wait = s.wait
    if setup.bounds:
        silent = ca.logic_and(seen, ca.fabs(y) <= q.gate)
        belief, wait = use_bounds(setup, q, belief, silent, side, wait)
    after = predicted(setup, q, belief, u)
    shown = shown_belief(setup, q, belief)
    estimated = to_estimate(setup.model, setup.sensor, q, shown, reading, e, e_std)
    estimated = with_unknowns(setup, q, estimated, shown, s.u)
    return State(after.mean, triangle(after.cov, setup.entries), y, s.last, wait, u), estimated


def beyond_edge(setup: Setup, q: Params, i: int, side: Any, X: Any) -> Any:
    """How far z_i is beyond the edge of that side: the reading on it; with side 0, z_i itself."""
    n, p = setup.model.n, setup.model.p
    z = setup.model.output(q.model, X[:n])[i]
    return z - offset(side, X[n + i], X[n + p + i])


def correct(
    setup: Setup, q: Params, belief: Gaussian, y: Any, side: Any
) -> tuple[Gaussian, Any, Any]:
    """The belief after the readings on the sides that are sure, one output at a time.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief before the reading.
        y: reading, 0 where it is missing (p) [y].
        side: the sides that are sure (p), 0 where none is.

    Returns:
        (belief, innovations (p), their standard deviations (p)).
    """
    innovations, stds = [], []
    for i in range(setup.model.p):
        active = side[i] != 0
        branch = 0.0 if setup.jump else side[i]
        expected, h = linearise(partial(beyond_edge, setup, q, i, branch), belief.mean)
        e = ca.if_else(active, y[i] / q.slope[i] - expected, 0.0)
        belief, S = update(belief, h, e, q.R[i], active)
        innovations.append(e)
        stds.append(ca.sqrt(S))
    return belief, ca.vertcat(*innovations), ca.vertcat(*stds)


def use_bounds(
    setup: Setup, q: Params, belief: Gaussian, silent: Any, side: Any, wait: Any
) -> tuple[Gaussian, Any]:
    """The belief given that z is inside the edges of a silent sensor.

    The z of a jump sensor is beyond the edge that it is on, besides.

    Args:
        setup: the filter.
        q: its numbers.
        belief: the belief after the readings on active sides.
        silent: whether each output is silent (p).
        side: the sides that are sure (p).
        wait: steps to wait per edge, right edges, then left ones (2p).

    Returns:
        (belief, steps to wait per edge).
    """
    waits: list[Any] = []
    for edge in (RIGHT, LEFT):
        for i in range(setup.model.p):
            outside = (side[i] == edge) if setup.jump else 0.0
            rested = wait[len(waits)] <= 0
            bounded = ca.logic_and(ca.logic_or(silent[i], outside), rested)
            excess, h = linearise(partial(beyond_edge, setup, q, i, edge), belief.mean)
            sign = edge * (1 - 2 * outside)
            slack = ca.if_else(silent[i], q.gate[i] / q.slope[i], 0.0)
            belief, used = truncate(belief, sign * h, sign * excess - slack, q.R[i], bounded, DOUBT)
            waits.append(ca.if_else(used, setup.lasting, wait[len(waits)] - 1))
    return belief, ca.vertcat(*waits)


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


def shown_belief(setup: Setup, q: Params, belief: Gaussian) -> Gaussian:
    """The belief that an estimate shows.

    Its widths lie in their claimed ranges, and it is the mixture of both if some claim may be
    stronger.
    """
    limited, chance = limit_widths(setup, q, belief)
    if setup.augmentation.alternative is None:
        return limited
    stronger, odds = setup.augmentation.alternative(q, belief)
    stronger, likelier = limit_widths(setup, q, stronger)
    share = 1 / (1 + ca.exp(ca.fmin(chance - likelier - odds, 700.0)))
    return mix(stronger, limited, share)


def limit_widths(setup: Setup, q: Params, belief: Gaussian) -> tuple[Gaussian, Any]:
    """`within_ranges` where the filter uses bounds, else the belief as it is, of chance 1."""
    if not setup.bounds:
        return belief, 0.0
    return within_ranges(q, setup.model.n, belief)


def within_ranges(q: Params, n: int, belief: Gaussian) -> tuple[Gaussian, Any]:
    """The belief with the mean that it has if every width lies in its claimed range.

    The covariance stays: that of a Gaussian cut where it was matched to a uniform distribution
    would claim too much.

    Returns:
        (belief, the log of the chance that every width lies in its range).
    """
    cut = belief
    log_chance = 0.0
    for i in range(q.ranges.shape[0]):
        cut, chance = truncate_to(cut, n + i, q.ranges[i, 0], q.ranges[i, 1])
        log_chance += chance
    return Gaussian(cut.mean, belief.cov), log_chance


def with_unknowns(
    setup: Setup, q: Params, estimated: Estimate, shown: Gaussian, u: Any
) -> Estimate:
    """The estimate with w and theta where there are such unknowns; u: the last input."""
    augmentation, model, n = setup.augmentation, setup.model, setup.model.n
    if len(augmentation.cov):
        extra = shown.mean[n + 2 * model.p :]
        if augmentation.disturbance is None:
            x = shown.mean[:n]
            w = q.rate @ (augmentation.move(q, x, extra, u)[0] - model.move(q.model, x, u))
        else:
            w = augmentation.disturbance(q, extra)
        estimated = estimated._replace(w=w)
    count = len(augmentation.parameters)
    if count:
        theta = q.model[list(augmentation.parameters)] + shown.mean[-count:]
        theta_std = ca.sqrt(ca.fmax(ca.diag(shown.cov)[-count:], 0.0))
        estimated = estimated._replace(theta=theta, theta_std=theta_std)
    return estimated


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
