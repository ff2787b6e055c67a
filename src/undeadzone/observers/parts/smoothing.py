"""What a smoother of a whole log asks of a filter: its beliefs about each sample, and how it shows.

A filter is a bank of members, one at least, whose beliefs a smoother improves one by one. The
mathematics is in docs/filters.md, "Looking back".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.interfaces import Estimate, Reading
from undeadzone.numerics.gaussian import Gaussian, linearise
from undeadzone.observers.parts.further_constants import entering
from undeadzone.observers.parts.gaussian_filter import (
    Params,
    Setup,
    motion,
    shown_belief,
    to_estimate,
)
from undeadzone.observers.parts.measured_reading import beyond_edge


class Moments(NamedTuple):
    """What a member of a filter knew about a sample of [x; d; extra] (N).

    Attributes:
        before: mean and covariance before the reading.
        read: after the readings on sure sides.
        heard: after what silences and limits bound, too.
        rows: rows of the readings, which have moved `before` to `read` along cov rows' (p x N).
        edges: rows of the edges, likewise (2p x N).
        slope: I + slope is the Jacobian of the motion to the next sample (N x N).
        log: log of the density with which the readings were foretold.
        restarted: 1 where the belief was lost, so that the next one is the prior.
    """

    before: Gaussian
    read: Gaussian
    heard: Gaussian
    rows: Any
    edges: Any
    slope: Any
    log: Any
    restarted: Any


class Smoothing(NamedTuple):
    """A filter as a smoother takes it.

    Attributes:
        moments: moments(q, s, u, reading) are the `Moments` of its members.
        odds: odds(s) is the log of the odds of its members before a sample (K).
        record: record(s) is what it keeps to judge its innovations; empty of a member.
        shown: shown(q, beliefs, share, record) is the estimate that shows beliefs of its members,
            as likely as `share` (K).
    """

    moments: Callable[[Any, Any, Any, Reading], tuple[Moments, ...]]
    odds: Callable[[Any], Any]
    record: Callable[[Any], Any]
    shown: Callable[[Any, Sequence[Gaussian], Any, Any], Estimate]


def rows_at(setup: Setup, q: Params, at: Any, side: Any) -> tuple[Any, Any]:
    """The rows of the readings on these sides (p x N), and of all edges (2p x N)."""
    p = setup.model.p
    read = list(enumerate([0.0] * p if setup.jump else ca.vertsplit(side)))
    edges = [(i, edge) for edge, i in product((1.0, -1.0), range(p))]

    def rows(branches: list[tuple[int, Any]]) -> Any:
        each = (partial(beyond_edge, setup, q, i, branch) for i, branch in branches)
        return ca.vertcat(*(linearise(beyond, at)[1] for beyond in each))

    return rows(read), rows(edges)


def slope_at(setup: Setup, q: Params, belief: Gaussian, u: Any) -> Any:
    """The slope of the motion that the prediction takes (N x N)."""
    if setup.order == 1 and setup.augmentation.slope is not None:
        return setup.augmentation.slope(q)
    drive, _ = entering(q.zones, belief, u)
    change, _ = motion(setup.model, q, setup.augmentation, belief, drive)
    return linearise(change, belief.mean)[1]


def shown_of(setup: Setup, q: Params, belief: Gaussian) -> Estimate:
    """The estimate that shows a belief; it has no innovations."""
    shown, _ = shown_belief(setup, q, belief)
    none = ca.SX(setup.model.p, 1)
    return to_estimate(setup.model, setup.sensor, q, shown, Reading(none, none), none, none)
