"""Filter with consistency tests: wider intervals if the innovations contradict the assumptions.

Sums of normalised innovations are too large if an effect lasts that is not among the assumptions.
Beside its estimate such a filter returns its predictive density, for multiple-model filters and
watches. The mathematics is in docs/innovation_tests.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading, Traits
from undeadzone.observers.filtering import innovation_tests
from undeadzone.observers.filtering.gaussian_filter import Params
from undeadzone.plants.system import System

FAR = 4.5  # standard deviations beyond which an innovation is no evidence for a constant
NO_TRAITS = Traits()
REFUTED = 3.0  # of the chance level: beyond it, an assumption without constants is rejected
BEYOND = 1.01  # score of a width outside its range: other assumptions go before it
DOUBTFUL = 0.7  # of the chance level, from which deviations are shown larger
LOST = 0.5  # share of refused readings beyond which nothing is known any more


class Sums(NamedTuple):
    """Running sums of innovations.

    Attributes:
        total: fading sum of the normalised innovations.
        count: its variance if the assumptions are true.
        ratio: slow mean of total^2 / count, 1 if the assumptions are true.
    """

    total: Any
    count: Any
    ratio: Any


def accumulate_innovations(before: Sums, nu: Any, counted: Any, fade: Any, keep: Any) -> Sums:
    """Return the sums after a further sample.

    Args:
        before: the sums before it.
        nu: normalised innovations, 0 if none counts.
        counted: whether one counts.
        fade: share of the sum that is left after a step.
        keep: share of the mean of its squares that is left after a step.
    """
    total = fade * before.total + nu
    count = fade**2 * before.count + counted
    square = total**2 / ca.fmax(count, 1.0)
    ratio = ca.if_else(count > 1, keep * before.ratio + (1 - keep) * square, before.ratio)
    return Sums(total, count, ratio)


class Step(NamedTuple):
    """Result of a filter for a sample.

    Attributes:
        state: its state at the next sample.
        estimate: the displayed estimate.
        log: log of the density with which it foretold the reading, up to a constant (1).
        trust: probability that the reading was not wrong (p).
        fits: 1 if the widths lie in their assumed ranges, or may do so, else 0 (1).
        restarted: whether it lost its state and begins anew (1).
        opened: whether it opened its belief, for most readings were refused (1).
    """

    state: Any
    estimate: Estimate
    log: Any
    trust: Any
    fits: Any
    restarted: Any
    opened: Any


class Member(NamedTuple):
    """Filter as pure functions on CasADi expressions, before the consistency tests.

    Attributes:
        params: its numbers, `Params`.
        init: init(params) is the state at t = 0.
        step: step(params, state, u, reading) is a `Step`.
        smoothing: data for smoothing of a whole log, of type `Smoothing` (None: it has no
            smoother).
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Any, Reading], Step]
    smoothing: Any = None


def innovation_log_density(e: Any, std: Any) -> Any:
    """Return the log density of the used readings, up to a constant (1).

    Args:
        e: innovations (p) (0 if not used).
        std: their standard deviations (p).
    """
    return ca.sum1(ca.if_else(e != 0, -((e / std) ** 2) / 2 - ca.log(std), 0.0))


class Record(NamedTuple):
    """Running record of the innovations of each output.

    Attributes:
        total: fading sum of the normalised innovations (p).
        count: its variance if the assumptions are true (p).
        ratio: slow mean of total^2 / count, 1 if the assumptions are true (p).
        offset: fading mean of the innovations, of refused readings too (p) [z].
        share: fading share of refused readings among those that were used (p).
        refused: number of refused readings (p).
        restarts: how often the filter lost its state (1).
        constant: largest |offset| since the assumptions were rejected, 0 before (p) [z] (empty for
            a filter that knows of constants, and so recovers).
        opened: 1 once the covariance was inflated (1) (empty as `constant` is).
        scores: those of the variables on which innovations depend, () for a filter without
            constants, whose innovations contain them.
    """

    total: Any
    count: Any
    ratio: Any
    offset: Any
    share: Any
    refused: Any
    restarts: Any
    constant: Any
    opened: Any
    scores: Any


class State(NamedTuple):
    """State of the filter, and the record of its innovations."""

    filter: Any
    record: Record


class Setup(NamedTuple):
    """Options shared by the functions of a filter with consistency tests.

    Attributes:
        member: the filter.
        model: the sampled model.
        widens: whether it shows wider intervals if the readings do not fit.
    """

    member: Member
    model: System
    widens: bool


def add_consistency_tests(
    member: Member, model: System, widens: bool, traits: Traits = NO_TRAITS, recovers: bool = True
) -> Observer:
    """Return the filter with consistency tests as an observer.

    Args:
        member: the filter.
        model: the sampled model.
        widens: whether it shows wider intervals if the readings do not fit its assumptions.
        traits: of the observer.
        recovers: whether its state contains the causes of a lasting misfit, so that the misfit can
            end.
    """
    setup = Setup(member, model, widens)
    p = model.p

    def init(q: Params) -> State:
        """Return the state at t = 0."""
        none = np.zeros(p)
        once = np.zeros(1)
        constant_fields = (np.zeros(0), np.zeros(0)) if recovers else (none, once)
        scores = innovation_tests.start_scores(p) if recovers else ()
        record = Record(none, none, np.ones(p), none, none, none, once, *constant_fields, scores)
        return State(member.init(q), record)

    smoothing = None
    if member.smoothing is not None:
        smoothing = member.smoothing._replace(
            moments=lambda q, s, u, reading: member.smoothing.moments(q, s.filter, u, reading),
            odds=lambda s: member.smoothing.odds(s.filter),
            record=lambda s: s.record,
            mixture_estimate=partial(_to_smoothed_estimate, setup),
        )
    step = partial(step_with_tests, setup)
    return Observer(member.params, init, step, traits=traits, smoothing=smoothing)


def _to_smoothed_estimate(
    setup: Setup, q: Params, beliefs: Any, wide: Any, share: Any, record: Record
) -> Estimate:
    """Return the estimate of smoothed Gaussians, widened as the record demands."""
    estimated = setup.member.smoothing.mixture_estimate(q, beliefs, wide, share, ())
    return widen_intervals(setup.model, q, record, estimated) if setup.widens else estimated


def step_with_tests(
    setup: Setup, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the next state, and the estimate after the consistency tests of a sample.

    A restart shows at the next sample: it may come from the input, on which no estimate depends.
    """
    step = setup.member.step(q, s.filter, u, reading)
    record = update_record(q, s.record, step, u, reading)
    ratios = consistency_statistics(q, record) | {"range": BEYOND * (step.fits <= 0.5)}
    estimated = step.estimate._replace(
        **innovation_tests.assumption_fields(ratios),
        refused=record.refused,
        restarts=record.restarts,
    )
    if setup.widens:
        estimated = widen_intervals(setup.model, q, record, estimated)
    return State(step.state, restart_record(record, step.restarted)), estimated


def restart_record(record: Record, restarted: Any) -> Record:
    """Return the record after the sample.

    After a restart of the filter no assumption counts as rejected.
    """
    return record._replace(
        restarts=record.restarts + restarted,
        constant=ca.if_else(restarted, 0.0, record.constant),
        opened=ca.if_else(restarted, 0.0, record.opened),
    )


def update_record(q: Params, record: Record, step: Step, u: Any, reading: Reading) -> Record:
    """Return the record after a further sample.

    Only innovations that are used and not far off count.
    """
    e = step.estimate.innovation
    std = step.estimate.innovation_std
    used = e != 0
    nu = ca.if_else(used, e / std, 0.0)
    counted = ca.logic_and(used, ca.fabs(nu) <= FAR)
    fade = q.doubt.fade
    before = Sums(record.total, record.count, record.ratio)
    sums = accumulate_innovations(before, ca.if_else(counted, nu, 0.0), counted, fade, q.doubt.keep)
    refused = step.trust < 0.5
    counts_reading = ca.logic_or(used, refused)
    share = fade * record.share + (1 - fade) * refused
    offset = ca.if_else(used, fade * record.offset + (1 - fade) * e, record.offset)
    constant = record.constant
    opened = record.opened
    scores = record.scores
    if scores:
        scores = innovation_tests.update_scores(q, scores, e, nu, counted, refused, reading, u)
    else:
        opened = ca.fmax(opened, step.opened)
        refuted = sums.ratio > ca.if_else(opened, 1.0, REFUTED) * q.doubt.most
        constant = ca.if_else(refuted, ca.fmax(constant, ca.fabs(offset)), constant)
    return Record(
        total=sums.total,
        count=sums.count,
        ratio=sums.ratio,
        offset=offset,
        share=ca.if_else(counts_reading, share, record.share),
        refused=record.refused + refused,
        restarts=record.restarts,
        constant=constant,
        opened=opened,
        scores=scores,
    )


def consistency_statistics(q: Params, record: Record) -> dict[str, Any]:
    """Return the statistic over its limit of each assumption except ranges. Above 1 rejects."""
    lasting = ca.mmax(record.ratio) / q.doubt.most
    if record.constant.numel():
        lasting = ca.if_else(ca.sum1(record.constant) > 0, ca.fmax(lasting, REFUTED), lasting)
    found = {"gust": lasting, "glitches": ca.mmax(record.share) / LOST}
    return found | (
        innovation_tests.assumption_ratios(q.doubt, record.scores) if record.scores else {}
    )


def is_consistent(q: Params, record: Record) -> Any:
    """Return 1 if the innovations fit the assumptions and most readings were accepted."""
    return innovation_tests.assumption_fields(consistency_statistics(q, record))["consistent"]


def widen_intervals(model: System, q: Params, record: Record, estimated: Estimate) -> Estimate:
    """Return the estimate with standard deviations that the innovations support.

    If they do not fit, deviations are multiplied by the root of the largest mean square of sums,
    and gain the mean innovation, as a filter without model errors has no deviations to multiply. If
    most readings were rejected, or some in a row again and again, they are at least those of the
    prior about the displayed values. A filter without constant states takes a constant for an
    asymmetry: once its assumptions are rejected, both last.
    """
    worst = ca.mmax(record.ratio)
    worst = ca.if_else(worst > DOUBTFUL * q.doubt.most, worst, 1.0)
    fits = is_consistent(q, record)
    off = ca.if_else(fits, 0.0, ca.fabs(record.offset))
    lost = ca.mmax(record.share) > LOST
    if record.scores:
        worst = ca.fmax(worst, innovation_tests.variance_factor(q.doubt, record.scores))
        off = ca.fmax(off, innovation_tests.stuck_level(q.doubt, record.scores))
        lost = ca.logic_or(lost, innovation_tests.mismatch_ratio(record.scores) > 1)
    else:
        off = ca.fmax(off, record.constant)
        lost = ca.logic_or(lost, record.opened * ca.sum1(record.constant) > 0)

    factor = ca.sqrt(worst)

    def widen_deviation(std: Any, off: Any, least: Any) -> Any:
        """Return a standard deviation that the innovations support."""
        wider = ca.if_else(fits, factor * std, ca.sqrt((factor * std) ** 2 + off**2))
        return ca.if_else(lost, ca.fmax(wider, least), wider)

    n = model.n
    p = model.p
    about = ca.vertcat(estimated.x, estimated.right, estimated.left) - q.mean[: n + 2 * p]
    prior = ca.sqrt(ca.SX(q.doubt.std) ** 2 + about**2)
    x_std, right, left = ca.vertsplit(prior, [0, n, n + p, n + 2 * p])
    scale = q.doubt.std[:n] / ca.fmax(ca.mmax(q.doubt.std[:n]), 1e-300)
    return estimated._replace(
        x_std=widen_deviation(estimated.x_std, ca.mmax(off) * scale, x_std),
        right_std=widen_deviation(estimated.right_std, off, right),
        left_std=widen_deviation(estimated.left_std, off, left),
        width_std=widen_deviation(estimated.width_std, off, ca.sqrt(right**2 + left**2)),
        theta_std=factor * estimated.theta_std,
    )
