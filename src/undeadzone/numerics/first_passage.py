"""First passage of an uncertain position over an edge, and the state estimate at the passage.

A position that is sampled stays short of an edge as long as samples are censored. Truncating the
estimate at the edge in every sample is wrong: each truncation takes a tail from a truncated
density, so that it narrows as if every sample were new information. The estimate of a position that
has not arrived is therefore not truncated, F_k is its probability beyond the edge, and of the
probability that has not arrived

    (F_k - F_(k-1)) / (1 - F_(k-1))

arrives in sample k. This is exact for any estimate if the motion up to the edge is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from undeadzone.numerics.gaussian import Gaussian, normal_cdf, update_with_outliers

LEAST = 1e-6  # chance of not being beyond some edge, below which all has arrived


def chance_beyond(belief: Gaussian, h: Any, excess: Any, R: Any) -> Any:
    """Return the probability that excess + h (x - x^) + v > 0.

    Args:
        belief: of x (N).
        h: row of the edge (1 x N).
        excess: by which the mean x^ lies beyond it.
        R: variance of v, the error of the edge's place.
    """
    std = ca.sqrt(ca.fmax(h @ belief.cov @ h.T, 0.0) + R)
    return normal_cdf(excess / std)


def arrival_shares(before: Sequence[Any], now: Sequence[Any], lost: Any = 0.0) -> list[Any]:
    """Return the shares of the not yet arrived that reach each edge in a sample (their sum is <=
    1).

    Args:
        before, now: chances beyond each edge under the uncut belief, a sample ago and now.
        lost: if true, the uncut estimate contains no information any more on the probability that
            has not arrived, and all of it arrives.
    """
    left = 1 - sum(before)
    gained = [ca.fmax(after - was, 0.0) for was, after in zip(before, now, strict=True)]
    gone = ca.logic_or(lost, ca.logic_or(left < LEAST, sum(gained) > left))
    total = ca.fmax(left, LEAST)
    beyond_any = ca.fmax(sum(now), LEAST)
    shares = []
    for each, after in zip(gained, now, strict=True):
        shares.append(ca.if_else(gone, after / beyond_any, each / total))
    return shares


def condition_on_edge(belief: Gaussian, h: Any, excess: Any, R: Any, moved: Any = None) -> Gaussian:
    """Return the state estimate of a position that has just arrived: excess + h (x - x^) + v =
    0.

    Args:
        belief: of x (N), uncut.
        h: row of the edge (1 x N).
        excess: by which the mean x^ lies beyond it.
        R: variance of v.
        moved: as `update_with_outliers` takes it.
    """
    return update_with_outliers(belief, h, -excess, R, 1.0, None, 0.0, moved).belief
