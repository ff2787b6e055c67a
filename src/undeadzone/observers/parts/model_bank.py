"""A bank of filters that claim different things gives the mixture of their estimates.

Each counts by how well it foretold the readings (docs/filters.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading

LEAST = 1e-6  # odds of a member against the best one, however wrong it was


class State(NamedTuple):
    """What the bank carries from sample to sample.

    Attributes:
        members: states of the K members.
        odds: log of their odds, 0 for the best (K).
    """

    members: Any
    odds: Any


def bank(member: Observer, variants: Sequence[Callable[[Any], Any]]) -> Observer:
    """The mixture of K observers, as likely as each other at first (Magill 1965).

    Args:
        member: an observer that gives `innovation_std`.
        variants: each makes the numbers of one member from those of `member`; all start from its
            state.
    """

    def init(q: Any) -> State:
        return State(tuple(member.init(q) for _ in variants), np.zeros(len(variants)))

    def step(q: Any, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        moved, estimates = [], []
        for variant, state in zip(variants, s.members, strict=True):
            after, estimated = member.step(variant(q), state, u, reading)
            moved.append(after)
            estimates.append(estimated)
        odds = s.odds + ca.vertcat(*(likelihood(one) for one in estimates))
        odds = ca.fmax(odds - ca.mmax(odds), np.log(LEAST))
        share = ca.exp(odds)
        return State(tuple(moved), odds), mixture(estimates, share / ca.sum1(share))

    return Observer(member.params, init, step, traits=member.traits)


def likelihood(estimated: Estimate) -> Any:
    """The log of the density of the readings that were used, up to a constant.

    An innovation of 0 was not used.
    """
    e, std = estimated.innovation, estimated.innovation_std
    return ca.sum1(ca.if_else(e != 0, -((e / std) ** 2) / 2 - ca.log(std), 0.0))


def mixture(estimates: Sequence[Estimate], share: Any) -> Estimate:
    """Mean of the estimates by their shares (K), and the standard deviations of the mixture."""

    def each(name: str) -> list[Any]:
        return [getattr(one, name) for one in estimates]

    means = [weighted_mean(share, values) for values in zip(*estimates, strict=True)]
    widths = [one.right + one.left for one in estimates]
    return Estimate(*means)._replace(
        x_std=mixture_std(share, each("x"), each("x_std")),
        right_std=mixture_std(share, each("right"), each("right_std")),
        left_std=mixture_std(share, each("left"), each("left_std")),
        width_std=mixture_std(share, widths, each("width_std")),
        innovation_std=mixture_std(share, each("innovation"), each("innovation_std")),
    )


def weighted_mean(share: Any, values: Sequence[Any]) -> Any:
    """The sum of the values, each times its share (K)."""
    return sum(share[k] * value for k, value in enumerate(values))


def mixture_std(share: Any, means: Sequence[Any], stds: Sequence[Any]) -> Any:
    """The standard deviation of a mixture.

    Args:
        share: of each component (K).
        means, stds: of the components.
    """
    centre = weighted_mean(share, means)
    squares = []
    for mean, std in zip(means, stds, strict=True):
        squares.append(std**2 + (mean - centre) ** 2)
    return ca.sqrt(weighted_mean(share, squares))
