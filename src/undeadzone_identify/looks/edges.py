"""The edge of a flat part: one level inside, bent lines outside, and the edge by least squares.

x points outwards here: the level comes first, the moving rows follow. x and v are in units of their
ranges. Shapes of the line outside are compared by one price, Bayes' criterion, and an edge is as
sure as its price among all of them.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.models.estimates import Interval

# Half and double of a number below change no answer of `benchmarks constants` for the worse.
BENDS = ((), (0.4,), (0.15, 0.5), (0.06, 0.2, 0.5), (0.1, 0.25, 0.5, 0.75))
SHAPES = list(itertools.product(BENDS, (False, True)))
RISES = 0.25  # of the mean slope outside: the least slope just beyond an edge
BEYOND = 3  # moving rows between an edge and the first bend, at least
KNOWN = 4e-4  # of the range: no map is better known
DEARER = 8.0  # price of an edge above that of the best, up to which it may be the edge
PLACES, PASSES = 41, 3  # edges that are compared, and how often ever closer ones


class Levels(NamedTuple):
    """Medians by level: commands, readings, weights (n)."""

    x: Floats
    v: Floats
    w: Floats

    def cut(self, part: slice | Flags) -> Levels:
        """Return some of the levels."""
        return Levels(self.x[part], self.v[part], self.w[part])

    def face(self, way: int) -> Levels:
        """Return the levels in the order of way * x."""
        return Levels(way * self.x[::way], self.v[::way], self.w[::way])


class Side(NamedTuple):
    """Fit of one edge, in units of the ranges.

    Attributes:
        edge: where it is.
        slope: of the reading just beyond the edge.
        step: height of the jump at the edge.
        numbers: of the fit beside its level.
        outer: what is left of each moving row.
        ahead: reading of the line at the first row.
        share: of the variance that is explained.
    """

    edge: Interval
    slope: float
    step: float
    numbers: int
    outer: Floats
    ahead: float
    share: float


class Profile(NamedTuple):
    """Best edge of a shape with its interval, its price, coefficients (k), and residuals (n)."""

    edge: Interval
    price: float
    c: Floats
    residual: Floats


def fit_side(levels: Levels, inner: int) -> Side | None:
    """Fit the edge between rows at rest and moving rows; None with less than two of these.

    Args:
        levels: outwards.
        inner: number of leading rows at rest.
    """
    x, v, w = levels
    n = x.size
    outer = x.size - inner
    shapes = [
        (bends, jumps)
        for bends, jumps in SHAPES
        if outer > 1 + jumps and outer * min(bends, default=1.0) >= min(BEYOND, outer)
    ]
    if not shapes or outer < 2:
        return None
    last = min(inner - 1 + max(inner, 8), n - 2)
    ranks = np.linspace(0.0, last + 0.9, PLACES)
    edges = np.interp(ranks, np.arange(n), x)
    fits = [_profile(levels, edges, *shape) for shape in shapes]
    prices = np.array([fit.price for fit in fits])
    best = fits[int(np.argmin(prices))]
    if not np.isfinite(best.price):
        return None
    alike = np.array([fit.edge for fit in fits])[prices < best.price + DEARER]
    found, c, residual = best.edge.value, best.c, best.residual / w
    mean = np.average(v, weights=w**2)
    share = 1 - float(w**2 @ residual**2) / max(float(w**2 @ (v - mean) ** 2), 1e-300)
    return Side(
        edge=Interval(found, alike[:, 1].min(), alike[:, 2].max()),
        slope=float(c[1]),
        step=float(c[-1]) * shapes[int(np.argmin(prices))][1],
        numbers=c.size - 1,
        outer=residual[inner:],
        ahead=float(c[0] - c[1] * (found - x[0])),
        share=share,
    )


def price(loss: Floats | float, rows: int, numbers: int) -> Floats:
    """Return Bayes' criterion of fits by their mean squares: the less, the better."""
    return np.asarray(rows * np.log(loss + KNOWN**2) + numbers * np.log(rows))


def _profile(levels: Levels, edges: Floats, bends: tuple[float, ...], jumps: bool) -> Profile:
    """Return the best edge of a shape, on a grid that closes in on it."""
    for _ in range(PASSES):
        prices, c, residual = _prices(levels, edges, bends, jumps)
        best = int(np.argmin(prices))
        near = np.flatnonzero(prices <= prices[best] + DEARER)
        edge = Interval(*edges[[best, near[0], near[-1]]].tolist())
        ends = edges[[max(near[0] - 1, 0), min(near[-1] + 1, PLACES - 1)]]
        edges = np.linspace(ends[0], ends[1], PLACES)
    return Profile(edge, float(prices[best]), c[best], residual[best])


def _prices(
    levels: Levels, edges: Floats, bends: tuple[float, ...], jumps: bool
) -> tuple[Floats, Floats, Floats]:
    """Return prices of edges (G), their coefficients (G x k), and weighted residuals (G x n).

    The price is infinite where the line hardly rises behind the edge, or jumps the other way. A
    later bend is the edge there. A jump begins at a row.
    """
    x, v, w = levels
    edges = x[np.searchsorted(x, edges, side="right") - 1] if jumps else edges
    beyond = np.maximum(x - edges[:, None], 0.0)
    reach = x[-1] - edges[:, None]
    bent = [np.maximum(beyond - place * reach, 0.0) for place in bends]
    columns = [np.ones_like(beyond), beyond, *bent, *[1.0 * (beyond > 0)] * jumps]
    design = np.stack(columns, axis=-1) * w[:, None]
    gram = design.mT @ design + 1e-12 * np.eye(len(columns))
    c = np.linalg.solve(gram, (design.mT @ (v * w))[..., None])[..., 0]
    residual = v * w - np.einsum("gnk,gk->gn", design, c)
    loss = np.mean(residual**2, axis=-1)
    mean = c[:, 1 : 2 + len(bends)] @ np.array([1.0, *(1 - place for place in bends)])
    least = 0.0 if jumps else RISES * np.abs(mean)
    is_edge = c[:, -1 if jumps else 1] * np.sign(mean) > least
    return np.where(is_edge, price(loss, x.size, len(columns)), np.inf), c, residual


def find_runs(x: Floats, v: Floats, tolerance: float, least: int) -> list[tuple[int, int]]:
    """Return the disjoint runs of neighbours with a common level, the longest in x first.

    Args:
        x: commands, in order (n).
        v: readings (n).
        tolerance: distance of a reading from the level.
        least: number of rows of the shortest run.
    """
    ends = []
    for k in range(v.size):
        reach = np.maximum.accumulate(v[k:]) - np.minimum.accumulate(v[k:])
        ends.append(k + int(np.searchsorted(reach, 2 * tolerance, side="right")))
    free: Flags = np.ones(v.size, bool)
    runs = []
    for k in np.argsort(x - x[np.array(ends) - 1], kind="stable").tolist():
        if ends[k] - k >= least and free[k : ends[k]].all():
            runs.append((k, ends[k]))
            free[k : ends[k]] = False
    return runs
