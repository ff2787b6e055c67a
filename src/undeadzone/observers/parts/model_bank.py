"""Filters that claim different things, side by side: what is shown is their mixture, by how well each foretold the readings (docs/filters.md)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading

LEAST = 1e-6  # odds of a claim against the best one, however wrong it was


class State(NamedTuple):
    """States of the members, and the log of their odds, 0 for the best (K)."""

    members: Any
    odds: Any


def bank(member: Observer, claims: Sequence[Callable[[Any], Any]]) -> Observer:
    """The mixture of K observers that give `innovation_std`, as likely as each other at first (Magill 1965).

    claims: each makes the numbers of one of them from those of `member`; all start from its state.
    """

    def init(q: Any) -> State:
        return State(tuple(member.init(q) for _ in claims), np.zeros(len(claims)))

    def step(q: Any, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        moved, found = zip(
            *(
                member.step(claim(q), x, u, reading)
                for claim, x in zip(claims, s.members, strict=True)
            ),
            strict=True,
        )
        odds = s.odds + ca.vertcat(*(likelihood(one) for one in found))
        odds = ca.fmax(odds - ca.mmax(odds), np.log(LEAST))
        share = ca.exp(odds)
        return State(moved, odds), mixture(found, share / ca.sum1(share))

    return Observer(member.params, init, step, traits=member.traits)


def likelihood(found: Estimate) -> Any:
    """The log of the density of the readings that were used, up to a constant; an innovation of 0 was not used."""
    e, std = found.innovation, found.innovation_std
    return ca.sum1(ca.if_else(e != 0, -((e / std) ** 2) / 2 - ca.log(std), 0.0))


def mixture(found: Sequence[Estimate], share: Any) -> Estimate:
    """Mean of the estimates by their shares, and the standard deviations of the mixture."""

    def mean(values: Sequence[Any]) -> Any:
        return sum(share[k] * value for k, value in enumerate(values))

    def std(name: str, of: Callable[[Estimate], Any]) -> Any:
        centre = mean([of(one) for one in found])
        return ca.sqrt(mean([getattr(one, name) ** 2 + (of(one) - centre) ** 2 for one in found]))

    return Estimate(*(mean(values) for values in zip(*found, strict=True)))._replace(
        x_std=std("x_std", lambda one: one.x),
        right_std=std("right_std", lambda one: one.right),
        left_std=std("left_std", lambda one: one.left),
        width_std=std("width_std", lambda one: one.right + one.left),
        innovation_std=std("innovation_std", lambda one: one.innovation),
    )
