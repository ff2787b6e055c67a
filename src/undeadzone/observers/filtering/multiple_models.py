"""A bank of filters that claim different things gives the mixture of their estimates.

Each counts by how well it foretold the readings (docs/filters.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Reading
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.consistency import Member, Step
from undeadzone.observers.filtering.smoothing import Moments, Smoothing
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

LEAST = 1e-6  # odds of a member against the best one, however wrong it was
FALL = 4.0  # from one level of the disturbance to the next, if it is claimed
DOUBTED = 3  # levels from which on one lies above the claim
# Deviations, and what it is that has them: a sum of fields.
EACH = ("x", "right", "left", "innovation", "actuator_right", "actuator_left")
GAPS = ("gap_right", "gap_left")
SPREAD: dict[str, tuple[str, ...]] = {f"{name}_std": (name,) for name in (*EACH, *GAPS)}
SPREAD |= {"width_std": ("right", "left"), "gap_std": GAPS}
LOUDEST, FAINTEST = 4.0, 0.125  # level of the disturbance, in its default, if it is not


class State(NamedTuple):
    """What the bank carries from sample to sample.

    Attributes:
        members: states of the K members.
        odds: log of their odds, 0 for the best (K).
    """

    members: Any
    odds: Any


def with_disturbance_levels(member: Member, levels: int, claimed: bool) -> Member:
    """Return the bank of a filter with several rms of its disturbance; the filter if it has none.

    Args:
        member: the filter.
        levels: how many are weighed (1 to 10).
        claimed: whether the rms is claimed: then one level lies above it and one is the claim.

    Raises:
        InputError: for another number of levels.
    """
    if not 1 <= levels <= 10:
        raise InputError(f"observer.levels: expected 1 to 10, found {levels}")
    if levels == 1 or not member.params.augmentation.variance.any():
        return member
    factors: Floats = np.geomspace(LOUDEST, FAINTEST, levels)
    if claimed:
        factors = FALL ** (1.0 * (levels >= DOUBTED) - np.arange(levels))
    return bank(member, [partial(_scale_disturbance, factor) for factor in factors])


def _scale_disturbance(factor: float, q: Any) -> Any:
    """Return the numbers of a filter with the rms of the disturbance times a factor."""
    variance = q.augmentation.variance * factor**2
    return q._replace(augmentation=q.augmentation._replace(variance=variance))


def bank(member: Member, variants: Sequence[Callable[[Any], Any]]) -> Member:
    """Return the mixture of K filters, as likely as each other at first (Magill 1965).

    Args:
        member: the filter.
        variants: each makes the numbers of one member from those of `member`, the widest claim
            first; all start from its state.
    """

    def init(q: Any) -> State:
        return State(tuple(member.init(q) for _ in variants), np.zeros(len(variants)))

    def step(q: Any, s: State, u: Any, reading: Reading) -> Step:
        one_step = reusable_step(member.step, variants[0](q), s.members[0], u, reading)
        steps = []
        for variant, state in zip(variants, s.members, strict=True):
            steps.append(one_step(variant(q), state, u, reading))
        odds, share = update_weights(s.odds, ca.vertcat(*(one.log for one in steps)))
        return Step(
            state=State(tuple(one.state for one in steps), odds),
            estimate=mixture([one.estimate for one in steps], share),
            log=0.0,
            trust=mean_of_models(share, [one.trust for one in steps]),
            fits=mean_of_models(share, [one.fits for one in steps]),
            restarted=sum(one.restarted for one in steps) > 0,
            opened=sum(one.opened for one in steps) > 0,
        )

    return Member(member.params, init, step, _smoothing(member.smoothing, variants))


def update_weights(odds: Any, logs: Any, least: float = LEAST) -> tuple[Any, Any]:
    """Return (log of the odds, 0 for the best; shares) of K members once they have foretold a
    reading.

    Args:
        odds: their log before (K).
        logs: of how well each foretold it (K).
        least: odds of a member against the best one, however wrong it was.
    """
    odds = odds + logs
    odds = ca.fmax(odds - ca.mmax(odds), np.log(least))
    share = ca.exp(odds)
    return odds, share / ca.sum1(share)


def reusable_step(step: Callable[..., Step], *like: Any) -> Callable[..., Step]:
    """Return a step whose graph is built once: a call puts other expressions in the place of
    symbols.

    Args:
        step: of a member.
        like: arguments of the shapes of those of every call.
    """
    shapes = [leaf for _, leaf in tree.leaves(like)]
    symbols = [ca.SX.sym(f"a{i}", *ca.SX(leaf).shape) for i, leaf in enumerate(shapes)]
    result = step(*tree.rebuild(like, iter(symbols)))
    leaves = [ca.SX(leaf) for _, leaf in tree.leaves(result)]
    graph = ca.Function("member", symbols, leaves)

    def call(*arguments: Any) -> Step:
        given = [leaf for _, leaf in tree.leaves(arguments)]
        found: Step = tree.rebuild(result, iter(graph.call(given)))
        return found

    return call


def _smoothing(member: Smoothing, variants: Sequence[Callable[[Any], Any]]) -> Smoothing:
    """Return the bank as a smoother takes it."""

    def moments(q: Any, s: State, u: Any, reading: Reading) -> tuple[Moments, ...]:
        every: list[Moments] = []
        for variant, state in zip(variants, s.members, strict=True):
            every += member.moments(variant(q), state, u, reading)
        return tuple(every)

    def shown(q: Any, beliefs: Sequence[Gaussian], share: Any, record: Any) -> Estimate:
        each = []
        for variant, belief in zip(variants, beliefs, strict=True):
            each.append(member.shown(variant(q), [belief], 1.0, record))
        return mixture(each, share)

    return Smoothing(moments, lambda s: s.odds, lambda s: (), shown)


def mixture(estimates: Sequence[Estimate], share: Any) -> Estimate:
    """Return mean of the estimates by their shares (K), and deviations whose +-1.96 hold 95 % of
    them.

    Those of what is estimated count each variance by `wider_of_two`; that of the innovation is the
    mixture's own.
    """
    wide = wider_of_two(share)
    means = [mean_of_models(share, values) for values in zip(*estimates, strict=True)]
    stds = {}
    for field, parts in SPREAD.items():
        if getattr(estimates[0], field).shape[0]:
            counted = share if field == "innovation_std" else wide
            values = [sum(getattr(one, part) for part in parts) for one in estimates]
            each = [getattr(one, field) for one in estimates]
            stds[field] = mixture_std(share, counted, values, each)
    return Estimate(*means)._replace(**stds)


def mean_of_models(share: Any, values: Sequence[Any]) -> Any:
    """Return the sum of the values, each times its share (K)."""
    return sum(share[k] * value for k, value in enumerate(values))


def wider_of_two(share: Any) -> Any:
    """Return the chance of each component, widest first, to be the wider one of two that are drawn
    (K).

    A mixture of deviations has more in its tails than a Gaussian of its variance; these shares make
    up for it (docs/filters.md, "What cannot be known").
    """
    tails = [ca.sum1(share[k:]) ** 2 for k in range(share.shape[0])]
    return ca.vertcat(*(here - after for here, after in zip(tails, [*tails[1:], 0.0], strict=True)))


def mixture_std(share: Any, wide: Any, means: Sequence[Any], stds: Sequence[Any]) -> Any:
    """Return the standard deviation of a mixture.

    Args:
        share: of each component (K).
        wide: by which their variances count (K).
        means, stds: of the components.
    """
    centre = mean_of_models(share, means)
    within = mean_of_models(wide, [std**2 for std in stds])
    between = mean_of_models(share, [(mean - centre) ** 2 for mean in means])
    return ca.sqrt(within + between)
