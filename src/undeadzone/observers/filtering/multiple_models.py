"""Multiple-model filter: mixture of the estimates of filters with different assumptions.

Each counts by how well it foretold the readings (docs/filter_equations.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import starmap
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Reading
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.consistency import Member, Step
from undeadzone.observers.filtering.smoothing import Moments, Smoothing
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

Result = TypeVar("Result")

LEAST = 1e-6  # odds of a member against the best one, however wrong it was
FALL = 4.0  # from one level of the disturbance to the next, if it is assumed
DOUBTED = 3  # number of levels from which one lies above the assumption
# Deviations, and the quantity that has them: a sum of fields.
EACH = ("x", "right", "left", "innovation", "actuator_right", "actuator_left")
GAPS = ("gap_right", "gap_left")
SPREAD: dict[str, tuple[str, ...]] = {f"{name}_std": (name,) for name in (*EACH, *GAPS)}
SPREAD |= {"width_std": ("right", "left"), "gap_std": GAPS}
# level of the disturbance, in its default, if it is not
LOUDEST = 4.0
FAINTEST = 0.125


class State(NamedTuple):
    """State of the multiple-model filter from sample to sample.

    Attributes:
        members: states of the K members.
        odds: log of their odds, 0 for the best (K).
    """

    members: Any
    odds: Any


def add_disturbance_levels(member: Member, levels: int, is_assumed: bool) -> Member:
    """Return the multiple-model filter over several rms of the disturbance.

    A filter without disturbance is returned unchanged.

    Args:
        member: the filter.
        levels: how many are weighed (1 to 10).
        is_assumed: whether the user assumes the rms: then one level is above it and one equals it.

    Raises:
        InputError: for another number of levels.
    """
    if not 1 <= levels <= 10:
        raise InputError(f"observer.levels: expected 1 to 10, found {levels}")
    if levels == 1 or not member.params.augmentation.variance.any():
        return member
    factors: Floats = np.geomspace(LOUDEST, FAINTEST, levels)
    if is_assumed:
        factors = FALL ** (1.0 * (levels >= DOUBTED) - np.arange(levels))
    return build_multiple_models(
        member, [partial(_scale_disturbance, factor) for factor in factors]
    )


def _scale_disturbance(factor: float, q: Any) -> Any:
    """Return the parameters of a filter with the rms of the disturbance times a factor."""
    variance = q.augmentation.variance * factor**2
    return q._replace(augmentation=q.augmentation._replace(variance=variance))


def build_multiple_models(member: Member, variants: Sequence[Callable[[Any], Any]]) -> Member:
    """Return the mixture of K filters of equal prior probability (Magill 1965).

    References:
        D. T. Magill (1965), doi:10.1109/TAC.1965.1098191

    Args:
        member: the filter.
        variants: each makes the numbers of one member from those of `member`, the widest assumption
            first (all start from its state).
    """

    def init(q: Any) -> State:
        """Return the state at t = 0."""
        return State(tuple(member.init(q) for _ in variants), np.zeros(len(variants)))

    def step(q: Any, s: State, u: Any, reading: Reading) -> Step:
        """Return the result of the mixture for a sample."""
        pairs = zip(variants, s.members, strict=True)
        calls = [(variant(q), state, u, reading) for variant, state in pairs]
        steps = share_step_graph(member.step, calls)
        odds, share = update_weights(s.odds, ca.vertcat(*(one.log for one in steps)))
        return Step(
            state=State(tuple(one.state for one in steps), odds),
            estimate=mix_estimates([one.estimate for one in steps], share),
            log=0.0,
            trust=mean_of_models(share, [one.trust for one in steps]),
            fits=mean_of_models(share, [one.fits for one in steps]),
            restarted=sum(one.restarted for one in steps) > 0,
            opened=sum(one.opened for one in steps) > 0,
        )

    return Member(member.params, init, step, _build_smoothing(member.smoothing, variants))


def update_weights(odds: Any, logs: Any, least: float = LEAST) -> tuple[Any, Any]:
    """Return (log odds, weights) of K models after a reading (K each).

    The best model has log odds 0.

    Args:
        odds: their log before (K).
        logs: of how well each foretold it (K).
        least: odds of a member against the best one, however wrong it was.
    """
    odds = odds + logs
    odds = ca.fmax(odds - ca.mmax(odds), np.log(least))
    share = ca.exp(odds)
    return odds, share / ca.sum1(share)


def share_step_graph(
    step: Callable[..., Result], calls: Sequence[tuple[Any, ...]], long: float = np.inf
) -> list[Result]:
    """Return the results of a step whose graph is built once, in symbols that calls replace.

    Args:
        step: of a member.
        calls: arguments of each, of equal shapes.
        long: instructions of a graph from which on calls of it stay calls (default: none does).
    """
    if len(calls) == 1:
        return [step(*calls[0])]
    shapes = [ca.SX(leaf).sparsity() for _, leaf in tree.iterate_leaves(calls[0])]
    columns = list(map(_flatten_leaves, calls))
    places = _places_of_equals(columns)
    w = ca.SX.sym("w", 1 + max(places))
    result = step(*tree.rebuild_tree(calls[0], _split_leaves(shapes, w[places])))
    sparsities = [ca.SX(leaf).sparsity() for _, leaf in tree.iterate_leaves(result)]
    out = _flatten_leaves(result)
    whence = _places_of_equals([out])
    options = {"never_inline": ca.Function("count", [w], [out]).n_instructions() > long}
    firsts = list(map(whence.index, range(1 + max(whence))))
    graph = ca.Function("member", [w], [out[firsts]], ["w"], ["out"], options)
    begins = list(map(places.index, range(w.numel())))
    each = (graph(column[begins])[whence] for column in columns)
    return [tree.rebuild_tree(result, _split_leaves(sparsities, one)) for one in each]


def _flatten_leaves(value: Any) -> Any:
    """Return the numbers of all leaves as a column."""
    return ca.vertcat(*(ca.vec(ca.SX(leaf)).nz[:] for _, leaf in tree.iterate_leaves(value)))


def _split_leaves(shapes: Sequence[ca.Sparsity], column: Any) -> Iterator[Any]:
    """Return the leaves of which a column holds the numbers."""
    ends = np.cumsum([0, *(shape.nnz() for shape in shapes)]).tolist()
    parts = zip(shapes, ca.vertsplit(column, ends), strict=True)
    return starmap(ca.SX, parts)


def _places_of_equals(columns: Sequence[Any]) -> list[int]:
    """Return a number for each row, the same for rows of equal expressions, as in a covariance."""
    found: dict[tuple[int, ...], int] = {}
    rows = [[one.element_hash() for one in ca.vertsplit(column)] for column in columns]
    return [found.setdefault(key, len(found)) for key in zip(*rows, strict=True)]


def _build_smoothing(member: Smoothing, variants: Sequence[Callable[[Any], Any]]) -> Smoothing:
    """Return the functions of the multiple-model filter for a smoother."""

    def moments(q: Any, s: State, u: Any, reading: Reading) -> tuple[Moments, ...]:
        """Return the moments of all members at a sample."""
        every: list[Moments] = []
        for variant, state in zip(variants, s.members, strict=True):
            every += member.moments(variant(q), state, u, reading)
        return tuple(every)

    def mix_smoothed(
        q: Any, beliefs: Sequence[Gaussian], wide: Sequence[Any], share: Any, record: Any
    ) -> Estimate:
        """Return the mixture estimate of smoothed Gaussians of the members."""
        each = []
        for variant, belief, more in zip(variants, beliefs, wide, strict=True):
            each.append(member.mixture_estimate(variant(q), [belief], [more], 1.0, record))
        return mix_estimates(each, share)

    return Smoothing(moments, lambda s: s.odds, lambda s: (), mix_smoothed)


def mix_estimates(estimates: Sequence[Estimate], share: Any) -> Estimate:
    """Return the weighted mean of the estimates (K). Its deviations cover 95 % at +-1.96.

    Those of the states count each variance by `wider_component_weights`. That of the innovation is
    the mixture's own.
    """
    wide = wider_component_weights(share)
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
    """Return the sum of the values, each times its weight (K)."""
    return sum(share[k] * value for k, value in enumerate(values))


def wider_component_weights(share: Any) -> Any:
    """Return the probability of each component to be the wider of two draws (K) [1].

    The widest component comes first.

    A mixture of deviations has more in its tails than a Gaussian of its variance. These shares make
    up for it (docs/filter_extensions.md, "Bias or centre").
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
