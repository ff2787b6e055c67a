"""A filter that says whether the readings fit its claims, and shows wider intervals if not.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading, Traits
from undeadzone.observers.parts.gaussian_filter import Params
from undeadzone.observers.parts.innovation_sums import FAR, Sums, summed
from undeadzone.observers.parts.member import Member, Step
from undeadzone.plants.system import System

NO_TRAITS = Traits()
LOST = 0.5  # share of refused readings beyond which nothing is known any more


class Record(NamedTuple):
    """What is kept of the innovations of each output.

    Attributes:
        total: fading sum of the normalised innovations (p).
        count: what its variance is if the claims are true (p).
        ratio: slow mean of total^2 / count, 1 if the claims are true (p).
        offset: fading mean of the innovations, of refused readings too (p) [z].
        share: fading share of refused readings among those that were used (p).
        refused: number of refused readings (p).
        restarts: how often the filter lost its state (1).
    """

    total: Any
    count: Any
    ratio: Any
    offset: Any
    share: Any
    refused: Any
    restarts: Any


class State(NamedTuple):
    """The state of the filter, and the record of its innovations."""

    filter: Any
    record: Record


class Setup(NamedTuple):
    """What the parts of a judged filter share.

    Attributes:
        member: the filter.
        model: the sampled model.
        widens: whether it shows wider intervals where the readings do not fit.
    """

    member: Member
    model: System
    widens: bool


def judged(member: Member, model: System, widens: bool, traits: Traits = NO_TRAITS) -> Observer:
    """The filter as an observer.

    Args:
        member: the filter.
        model: the sampled model.
        widens: whether it shows wider intervals where the readings do not fit its claims.
        traits: of the observer.
    """
    setup, p = Setup(member, model, widens), model.p

    def init(q: Params) -> State:
        none = np.zeros(p)
        return State(member.init(q), Record(none, none, np.ones(p), none, none, none, np.zeros(1)))

    return Observer(member.params, init, partial(judged_step, setup), traits=traits)


def judged_step(
    setup: Setup, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """One sample of the filter, and what it shows after its readings were judged.

    A restart shows at the next sample: it may come from the input, on which no estimate depends.
    """
    step = setup.member.step(q, s.filter, u, reading)
    record = recorded(q, s.record, step)
    estimated = step.estimate._replace(
        consistent=ca.logic_and(step.fits > 0.5, fitting(q, record)),
        refused=record.refused,
        restarts=s.record.restarts,
    )
    if setup.widens:
        estimated = widened(setup.model, q, record, estimated)
    return State(step.state, record), estimated


def recorded(q: Params, record: Record, step: Step) -> Record:
    """The record after one more sample: of innovations that are used and not far off."""
    e, std = step.estimate.innovation, step.estimate.innovation_std
    used = e != 0
    nu = ca.if_else(used, e / std, 0.0)
    counted = ca.logic_and(used, ca.fabs(nu) <= FAR)
    fade = q.doubt.fade
    before = Sums(record.total, record.count, record.ratio)
    sums = summed(before, ca.if_else(counted, nu, 0.0), counted, fade, q.doubt.keep)
    refused = step.trust < 0.5
    asked = ca.logic_or(used, refused)
    share = fade * record.share + (1 - fade) * refused
    offset = fade * record.offset + (1 - fade) * e
    return Record(
        total=sums.total,
        count=sums.count,
        ratio=sums.ratio,
        offset=ca.if_else(used, offset, record.offset),
        share=ca.if_else(asked, share, record.share),
        refused=record.refused + refused,
        restarts=record.restarts + step.restarted,
    )


def fitting(q: Params, record: Record) -> Any:
    """Whether the innovations fit the claims, and most readings were not refused."""
    return ca.logic_and(ca.mmax(record.ratio) <= q.doubt.most, ca.mmax(record.share) <= LOST)


def widened(model: System, q: Params, record: Record, estimated: Estimate) -> Estimate:
    """The estimate with standard deviations that the innovations bear out.

    Where they do not fit, deviations are multiplied by the root of the largest mean square of sums,
    and gain the mean innovation, for a filter that doubts nothing has none to multiply. Where most
    readings were refused they are those of the prior at least.
    """
    worst = ca.mmax(record.ratio)
    factor = ca.if_else(worst > q.doubt.most, ca.sqrt(worst), 1.0)
    fits = fitting(q, record)
    off = ca.if_else(fits, 0.0, ca.fabs(record.offset))
    lost = ca.mmax(record.share) > LOST

    def shown(std: Any, off: Any, least: Any) -> Any:
        wider = ca.if_else(fits, std, ca.sqrt((factor * std) ** 2 + off**2))
        return ca.if_else(lost, ca.fmax(wider, least), wider)

    n, p = model.n, model.p
    x_std, right, left = ca.vertsplit(ca.SX(q.doubt.std), [0, n, n + p, n + 2 * p])
    scale = x_std / ca.fmax(ca.mmax(x_std), 1e-300)
    return estimated._replace(
        x_std=shown(estimated.x_std, ca.mmax(off) * scale, x_std),
        right_std=shown(estimated.right_std, off, right),
        left_std=shown(estimated.left_std, off, left),
        width_std=shown(estimated.width_std, off, ca.sqrt(right**2 + left**2)),
        theta_std=factor * estimated.theta_std,
    )
