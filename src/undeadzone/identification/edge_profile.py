"""The interval of an edge that is hardly passed: where its profile likelihood has fallen enough."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import f as fisher

from undeadzone.identification.fit import Fit
from undeadzone.identification.intervals import Interval, profile
from undeadzone.identification.long_run import Spread
from undeadzone.support.arrays import Floats

POINTS = 8  # on each side of the edge
REACH = 4.0  # usual half intervals, within which the ends are sought


def widened(fit: Fit, side: str, edge: Interval, scale: float) -> Interval:
    """The usual interval, and that of the profile where it reaches further.

    2 (L - L(d)) V_naive / V <= F(1, K), with V the robust variance of the edge and V_naive that of
    independent samples.

    Args:
        fit: (L2), scaled.
        side: right or left.
        edge: the usual interval [y].
        scale: rms of y [y].

    Returns:
        The union of both [y]; an end that the likelihood never forbids is infinite, or 0.
    """
    objective = fit.objective
    spread: Spread = objective.spread(fit.theta)
    row = objective.direction(**{side: 1.0})
    robust, degrees = spread.accuracy(row)
    naive = float(row @ spread.naive @ row)
    drop = 0.5 * float(fisher.ppf(0.95, 1, degrees)) * robust / max(naive, 1e-300)
    own = fit.right if side == "right" else fit.left
    reach = REACH * max(edge.half / scale, 1e-6)
    ends = []
    for values in (own - reach * _away(), own + reach * _away()):
        fallen = -profile(fit, side, np.sort(values))
        order = np.argsort(np.abs(np.sort(values) - own))
        ends.append(_crossing(np.sort(values)[order], fallen[order], drop))
    low, high = ends
    shift = edge.value - own * scale
    low = 0.0 if math.isinf(low) else low * scale + shift
    high = high if math.isinf(high) else high * scale + shift
    return Interval(edge.value, min(edge.low, low), max(edge.high, high))


def _away() -> Floats:
    """Distances of the points, in parts of the reach."""
    return np.linspace(0.0, 1.0, POINTS + 1)


def _crossing(values: Floats, fallen: Floats, drop: float) -> float:
    """Where the likelihood has fallen by `drop`, going away from the edge; inf: nowhere."""
    beyond = np.flatnonzero(fallen > drop)
    if not beyond.size:
        return math.inf
    k = int(beyond[0])
    if k == 0 or not math.isfinite(fallen[k]):
        return float(values[k])
    part = (drop - fallen[k - 1]) / (fallen[k] - fallen[k - 1])
    return float(values[k - 1] + part * (values[k] - values[k - 1]))
