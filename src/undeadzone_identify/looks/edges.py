"""The edge of a flat part: one level inside, bent lines outside, and the edge by least squares.

x points outwards here: the level comes first, the moving rows follow. x and v are in units of their
ranges. A design has a column of ones, one of the distance beyond the edge, one for each bend at a
share of the way outside, and perhaps a step.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.models.estimates import Interval

# Half and double of a number below change no shape and no edge of the tests' maps:
# test_half_and_double_of_a_constant_change_no_map.
BENDS = ((), (0.4,), (0.15, 0.5), (0.06, 0.2, 0.5), (0.1, 0.25, 0.5, 0.75))
RISES = 0.25  # of the mean slope outside: the least slope just beyond an edge
BEYOND = 3  # moving rows between an edge and the first bend, at least
KNOWN = 4e-4  # of the range: no map is better known
LEAP = 0.02  # of the range, from which a step at an edge is one
MILD = 2.0  # times log n: how much worse a line with a jump may be than one that bends more
SURE = 4.0  # times the residual, from which it is one
TENTHS = 10  # groups of the jackknife


class Edge(NamedTuple):
    """Edge of a flat part.

    Attributes:
        interval: the edge with its 95 % interval [u].
        still: the outermost command at rest [u].
        moves: the innermost command that moves [u]. If it lies inside `still`, motion starts at
            `still` and stops at `moves`.
        jumps: whether the reading jumps here, so that the edge is a threshold.
        rows: number of moving commands beyond.
    """

    interval: Interval
    still: float
    moves: float
    jumps: bool
    rows: int


class Side(NamedTuple):
    """Fit of one edge, in units of the ranges.

    Attributes:
        x: where the edge is.
        level: reading inside.
        slope: of the reading just beyond the edge.
        step: height of the jump at the edge.
        bends: shares of the way outside at which the line may bend.
        outer: what is left of each moving row.
        ahead: reading of the line at the first row.
        share: of the variance that is explained.
    """

    x: float
    level: float
    slope: float
    step: float
    bends: tuple[float, ...]
    outer: Floats
    ahead: float
    share: float


def fit_side(x: Floats, v: Floats, w: Floats, inner: int, bends: int | None = None) -> Side | None:
    """Fit the edge between rows at rest and moving rows; None with less than two of these.

    Args:
        x: commands, outwards (n).
        v: readings (n).
        w: weights (n).
        inner: number of leading rows at rest.
        bends: largest number of bends; None for any, by Bayes' criterion.
    """
    n, outer = x.size, x.size - inner
    if outer < 2:
        return None
    last = min(inner - 1 + max(inner, 8), n - 2)
    rank = np.arange(max(inner // 2 - 0.5, 0.0), last + 0.99, max(0.25, last / 160))
    grid = np.interp(rank, np.arange(n), x)
    at_rows = x[int(rank[0] + 0.5) : last + 1]
    best: dict[bool, tuple[float, tuple[float, ...], float]] = {}
    for steps, places in itertools.product((False, True), BENDS):
        first_bend = outer * places[0] if places else BEYOND
        if (bends is None or len(places) <= bends) and outer > 1 + steps and first_bend >= BEYOND:
            edges = at_rows if steps else _refine(x, v, w, grid, places)
            losses = _losses(x, v, w, edges, places, steps)
            k = int(np.argmin(losses))
            numbers = 3 + len(places) + steps
            price = n * np.log(losses[k] / n + KNOWN**2) + numbers * np.log(n)
            best[steps] = min(
                best.get(steps, (np.inf, (), 0.0)), (float(price), places, float(edges[k]))
            )
    price, places, at = best[False]
    if True in best and best[True][0] < price + MILD * np.log(n):
        side = _finish(x, v, w, inner, best[True][2], best[True][1], True)
        least = max(LEAP, SURE * float(np.std(side.outer)))
        ahead = side.step * np.sign(side.slope or side.step)
        if ahead > least:
            return side
    return _finish(x, v, w, inner, at, places, False) if np.isfinite(price) else None


def jackknife(x: Floats, v: Floats, w: Floats, inner: int, side: Side) -> float:
    """Return the half width of the 95 % interval of an edge, by leaving tenths of the rows out."""
    groups = np.arange(x.size) % min(TENTHS, max(3, x.size // 3))
    place = int(np.searchsorted(x, side.x))
    near = x[place] - x[max(place - 1, 0)]
    if inner < 3:
        groups[:inner] = -1
    reach = max(near, 0.3 * (side.x - x[0]))
    grid = np.linspace(max(side.x - reach, x[0]), min(side.x + reach, x[-2]), 41)
    edges = [
        _refine(x, v, w * (groups != g), grid, side.bends)[10] for g in range(groups.max() + 1)
    ]
    size = len(edges)
    scatter = np.sqrt((size - 1) * np.var(edges))
    return float(student.ppf(0.975, size - 1) * scatter)


def _refine(x: Floats, v: Floats, w: Floats, grid: Floats, places: tuple[float, ...]) -> Floats:
    """Return a grid about the best edge of a grid, three times ten times finer."""
    for _ in range(3):
        k = int(np.argmin(_losses(x, v, w, grid, places, False)))
        grid = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)], 21)
    return grid


def _losses(
    x: Floats, v: Floats, w: Floats, edges: Floats, places: tuple[float, ...], steps: bool
) -> Floats:
    """Return the losses of edges (G), infinite where the line hardly rises behind the edge.

    A later bend is the edge there.
    """
    losses, c = _solve(x, v, w, edges, places, steps)
    mean = c[:, 1 : 2 + len(places)] @ np.array([1.0, *(1 - place for place in places)])
    return np.where((c[:, 1] * np.sign(mean) > RISES * np.abs(mean)) | steps, losses, np.inf)


def _finish(
    x: Floats, v: Floats, w: Floats, inner: int, at: float, places: tuple[float, ...], steps: bool
) -> Side:
    """Return the fit with its edge at a place."""
    losses, (c,) = _solve(x, v, w, np.array([at]), places, steps)
    residual = v - _design(x, np.array([at]), places, steps)[0] @ c
    mean = np.average(v, weights=w**2)
    share = 1 - float(losses[0] / max(float(w**2 @ (v - mean) ** 2), 1e-300))
    step = float(c[-1]) if steps else 0.0
    ahead = float(c[0] - c[1] * (at - x[0]))
    return Side(at, float(c[0]), float(c[1]), step, places, residual[inner:], ahead, share)


def _design(x: Floats, edges: Floats, places: tuple[float, ...], steps: bool) -> Floats:
    """Return the designs for each edge (G x n x k)."""
    beyond = np.maximum(x - edges[:, None], 0.0)
    reach = x[-1] - edges[:, None]
    columns = [np.ones_like(beyond), beyond]
    columns += [np.maximum(beyond - place * reach, 0.0) for place in places]
    columns += [1.0 * (beyond > 0)] * steps
    return np.stack(columns, axis=-1)


def _solve(
    x: Floats, v: Floats, w: Floats, edges: Floats, places: tuple[float, ...], steps: bool
) -> tuple[Floats, Floats]:
    """Return the losses of edges (G), and their coefficients (G x k)."""
    design = _design(x, edges, places, steps)
    scaled = design * w[:, None]
    gram = scaled.mT @ scaled
    gram += 1e-12 * np.eye(gram.shape[-1])
    c = np.linalg.solve(gram, (scaled.mT @ (v * w))[..., None])[..., 0]
    residual = v * w - np.einsum("gnk,gk->gn", scaled, c)
    return np.sum(residual**2, axis=-1), c


def find_runs(v: Floats, tolerance: float, least: int) -> list[tuple[int, int]]:
    """Return the disjoint runs of neighbours with a common level, the longest first.

    Args:
        v: readings (n).
        tolerance: distance of a reading from the level.
        least: number of rows of the shortest run.
    """
    ends = [_end_of_run(v[k:], 2 * tolerance) + k for k in range(v.size)]
    free: Flags = np.ones(v.size, bool)
    runs = []
    for k in np.argsort(np.arange(v.size) - np.array(ends), kind="stable").tolist():
        if ends[k] - k >= least and free[k : ends[k]].all():
            runs.append((k, ends[k]))
            free[k : ends[k]] = False
    return runs


def _end_of_run(v: Floats, most: float) -> int:
    """Return the number of leading readings whose range is at most so large."""
    reach = np.maximum.accumulate(v) - np.minimum.accumulate(v)
    return int(np.searchsorted(reach, most, side="right"))
