"""The map of a reading's rate: two lines that meet rate 0 at commands apart, by least squares.

A command that moves within a window is no error here: what it has beyond both edges is averaged
over the window, as the reading sums it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_identify.looks.edges import DEARER, PASSES, PLACES, price
from undeadzone_identify.looks.map import CURVES, Edge, FlatPart, RestMap
from undeadzone_identify.looks.rows import LEVELS, Rows, known_samples
from undeadzone_identify.models.estimates import Interval

EXPLAINED = 0.8  # of the variance of rates, by the command
SIZES = (2, 4, 8, 16, 32)  # samples of a window
WINDOWS = 2000  # of a fit, at least, spread over a longer log


class Fit(NamedTuple):
    """Fit of two edges: criterion, edges with their intervals (2 x 3), coefficients (2 x k).

    These are rates at the distance of the command's range from an edge, and of a jump.
    """

    criterion: float
    both_edges: Floats
    coefficients: Floats


def map_of_rate(t: Floats | None, u: Floats, y: Floats) -> RestMap | None:
    """Return the map of the rate of a reading that integrates, at the best lag; None without one.

    Its part has a jump at its edges if that explains more, and none if its edges are not apart, or
    if a line or a curve explains as much.

    Args:
        t: times (N); None for rows in the order of their record.
        u: commands (N).
        y: readings, some may be missing (N).
    """
    t, u, y = known_samples(t, u, y)
    best: tuple[Floats, Floats] | None = None
    least = math.log(1 - EXPLAINED)
    for size in SIZES:
        for lag in (-1, 0, 1, size // 2, size, 2 * size):
            last = y.size - size + min(lag, 0)
            starts = np.arange(max(lag, 0), last, size)
            starts = starts[:: max(starts.size // WINDOWS, 1)]
            if starts.size < 4 * LEVELS or not np.all(t[starts + size] > t[starts]):
                continue
            some = np.lib.stride_tricks.sliding_window_view(u, size)[starts - lag]
            speed = (y[starts + size] - y[starts]) / (t[starts + size] - t[starts])
            if np.ptp(some.mean(axis=1)) == 0 or np.ptp(speed) == 0:
                continue
            each = fit_edges(some, speed, False, 1).criterion / speed.size
            if each < least:
                best = (some, speed)
                least = each
    return best and _map_of(*best)


def fit_edges(asked: Floats, rate: Floats, jumps: bool, passes: int = PASSES) -> Fit:
    """Fit rates by a line below the lower edge and one above the upper edge, and 0 between them.

    Args:
        asked: commands by window (W x size).
        rate: rates (W).
        jumps: whether the rate jumps at both edges.
        passes: of grids of edges, each closer than the one before.
    """
    mean, unit, numbers = asked.mean(axis=1), rate / np.std(rate), 1 + jumps
    grids = [np.linspace(mean.min(), mean.max(), PLACES)] * 2
    for _ in range(passes):
        both = np.hstack(
            [
                _columns_beyond(asked, way, grid)[..., :numbers].reshape(rate.size, -1)
                for way, grid in zip((-1, 1), grids, strict=True)
            ]
        )
        c, loss = _solve_pairs(both, unit, numbers)
        falls = c[..., :numbers]
        rises = c[..., numbers:]
        is_map = (falls[..., 0] * rises[..., 0] <= 0) & (grids[0][:, None] <= grids[1])
        is_map &= (falls[..., 0] * falls[..., -1] >= 0) & (rises[..., 0] * rises[..., -1] >= 0)
        sides = (grids[0] > mean.min()).astype(int)[:, None] + (grids[1] < mean.max())
        prices = np.where(is_map, price(loss, rate.size, (1 + numbers) * sides), np.inf)
        best = np.unravel_index(int(np.argmin(prices)), prices.shape)
        near = [(prices <= prices[best] + more) for more in (0, DEARER)]
        edges = []
        finer = []
        for axis, grid in enumerate(grids):
            same, inside = (np.flatnonzero(one.any(axis=1 - axis)) for one in near)
            edges.append(grid[[same[same.size // 2], inside[0], inside[-1]]])
            first = max(inside[0] - 1, 0)
            last = min(inside[-1] + 1, PLACES - 1)
            finer.append(np.linspace(grid[first], grid[last], PLACES))
        grids = finer
    return Fit(float(prices[best]), np.array(edges), c[best].reshape(2, -1) * np.std(rate))


def _columns_beyond(asked: Floats, way: int, edges: Floats) -> Floats:
    """Return what commands have beyond edges, and how often they are there (W x edges x 2).

    Args:
        asked: commands by window (W x size).
        way: 1 beyond an upper edge, -1 beyond a lower one.
        edges: at a time one.
    """
    beyond = np.maximum(way * (asked[..., None] - edges), 0)
    travel = beyond.mean(axis=1) / np.ptp(asked.mean(axis=1))
    share = (beyond > 0).mean(axis=1)
    return np.stack([travel, share], axis=-1)


def _solve_pairs(both: Floats, unit: Floats, numbers: int) -> tuple[Floats, Floats]:
    """Return the coefficients and the loss of least squares with each pair of edges.

    Args:
        both: columns of all lower edges, then of all upper ones (W x k).
        unit: rates (W).
        numbers: columns of an edge.
    """
    k = np.arange(both.shape[1]).reshape(2, -1, numbers)
    low = k[0, :, None]
    high = k[1, None, :]
    pairs = np.concatenate(np.broadcast_arrays(low, high), axis=-1)
    ridge = 1e-9 * unit.size * np.mean(both**2)
    gram = both.T @ both + ridge * np.eye(both.shape[1])
    answer = (both.T @ unit)[pairs]
    square = gram[pairs[..., :, None], pairs[..., None, :]]
    c = np.linalg.solve(square, answer[..., None])[..., 0]
    explained = np.sum(c * answer, axis=-1)
    loss = np.maximum(unit @ unit - explained, 0) / unit.size
    return c, loss


def _map_of(asked: Floats, rate: Floats) -> RestMap:
    """Return the map of the rates (W) over windows of the command (W x size)."""
    mean = asked.mean(axis=1)
    fits = {jumps: fit_edges(asked, rate, jumps) for jumps in (False, True)}
    jumps = fits[True].criterion < fits[False].criterion
    cost, (lower, upper), c = fits[jumps]
    alike = np.array([one.both_edges for one in fits.values() if one.criterion < cost + DEARER])
    low = alike[..., 1].min(axis=0)
    high = alike[..., 2].max(axis=0)
    middle = (lower[0] + upper[0]) / 2
    is_part = low[1] > high[0] and cost < _price_of_curves(asked, rate, middle)
    left, right = (
        Edge(Interval(float(edge[0]), *ends), bool(jumps), int(beyond.sum()))
        for edge, ends, beyond in (
            (lower, (low[0], high[0]), mean < lower[0]),
            (upper, (low[1], high[1]), mean > upper[0]),
        )
    )
    met = left if left.rows > LEVELS else None, right if right.rows > LEVELS else None
    end = "low end" if np.mean(rate) > 0 else "high end"
    flat = FlatPart("band" if all(met) else end, 0.0, *met)
    x, first = np.unique(mean, return_index=True)
    ends = np.array([lower[0] - x[0], x[-1] - upper[0]]) / np.ptp(x)
    at_ends = c[:, 0] * ends + (c[:, 1] if jumps else 0)
    return RestMap(
        rows=Rows(mean, rate, np.zeros(rate.size), "rate"),
        x=x,
        y=rate[first],
        flats=(flat,) if is_part and any(met) else (),
        bound=math.inf,
        fold=None,
        nodes=np.array([[x[0], lower[0], upper[0], x[-1]], [at_ends[0], 0, 0, at_ends[1]]]),
    )


def _price_of_curves(asked: Floats, rate: Floats, middle: float) -> float:
    """Return the least price of a curve over all commands, or of one on each side of a jump.

    Args:
        asked: commands by window (W x size).
        rate: rates (W).
        middle: command at the jump.
    """
    mean = asked.mean(axis=1)
    unit = (asked - mean.min()) / np.ptp(mean)
    half = (asked - middle) / np.ptp(mean)
    bent = []
    for one in (np.minimum(half, 0), np.maximum(half, 0)):
        bent += [(one != 0) * one**k for k in range(CURVES[0] + 1)]
    powers = [unit**k for k in range(CURVES[-1] + 1)]
    curves = [powers[: degree + 1] for degree in (1, *CURVES)]
    prices = []
    for shapes in (bent, *curves):
        columns = np.stack([one.mean(axis=1) for one in shapes], axis=1)
        left = rate - columns @ np.linalg.lstsq(columns, rate)[0]
        loss = float(np.var(left) / np.var(rate))
        prices.append(price(loss, rate.size, len(shapes)))
    return float(min(prices))
