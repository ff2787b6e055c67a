"""The map at rest of any shape: readings over commands, flat parts with edges, folds, and a bound.

A flat part is a run of neighbours that read one level, with a bent line beyond each edge. It counts
if a smooth curve fits worse, and if what it hides stands out of what the fit leaves. A map without
one is an answer too: the largest dead band that it could hide.
"""

from __future__ import annotations

from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from undeadzone.util.arrays import Flags, Floats, bounds_of_runs, turns
from undeadzone_identify.logs.grid import find_quantum
from undeadzone_identify.looks.curve import EXPLAINED, Curve, fit_curve, fit_limits
from undeadzone_identify.looks.edges import KNOWN, Levels, Side, find_runs, fit_side, price
from undeadzone_identify.looks.rows import (
    LEVELS,
    Rows,
    noise_of,
    rows_at_rest,
)
from undeadzone_identify.models.estimates import Interval

# Half and double of a number below change no answer of `benchmarks constants` for the worse, but
# for MOST x 0.5.
MOST = 400  # levels of a map; more are put together by quantiles
CLOSE = 1e-3  # of the commands' range, below which two levels are one
WIDE, FINE = 0.012, 1e-4  # of the range: distances from the level of a candidate
CANDIDATES = 6
SMOOTHED = 24  # levels in a row, from which noise is smoothed
END = 3  # levels of an end, at least, among so many
MOVING = 0.35  # of the median slope, from which a map moves
FLAT = 0.1  # of the slope beside it: the largest inside a flat part
HIDES, LEAST = 8.0, 0.008  # residuals and share of the range, that a flat part hides at least
CURVES = range(3, 7)  # degrees of the smooth curves that may explain a flat part
NEAREST, FARTHER = 5, 4  # moving levels that count for an edge, and more for each level at rest
UNVISITED = 0.2  # of the commands' range, from which a gap widens an edge
APART = 0.05  # of the range: the largest noise of a candidate, and a leap from rest
UNSURE = 0.5  # of the commands' range, from which an edge is none
FOLDED = 0.03  # of the range, by which a reading must come back
# of what the map comes back, that readings do on the way out; from 0.25 to 0.95 the maps of 248
# logs of `benchmarks numbers` and the folds of the tests are the same
WAY_OUT = 0.5
TURN = 0.3  # of the commands' range, from which the way back is a sweep of its own
STAIR = 0.5  # of the widest band, from which another one is a step of the same stair
RARELY = 0.2  # of the rows between both thresholds, at which the state may change


class Edge(NamedTuple):
    """Edge of a flat part.

    Attributes:
        interval: the edge with its 95 % interval [u].
        jumps: whether the reading jumps here, so that the edge is a threshold.
        rows: number of moving levels beyond.
    """

    interval: Interval
    jumps: bool
    rows: int

    def place(self, base: float, factor: float) -> Edge:
        """Return the edge along a line: a base, and a factor for the edge."""
        return self._replace(interval=self.interval.place(base, factor))


class FlatPart(NamedTuple):
    """Commands over which the reading keeps one level.

    Attributes:
        kind: "band", "low end" or "high end".
        level: of the reading [y].
        left, right: edges; None where the map ends inside.
    """

    kind: str
    level: float
    left: Edge | None
    right: Edge | None

    @property
    def ends(self) -> tuple[float, float]:
        """Return where the part begins and ends; infinite where the map ends inside."""
        left = self.left
        right = self.right
        return left.interval.value if left else -np.inf, right.interval.value if right else np.inf

    @property
    def widest_interval(self) -> float:
        """Return the width of the widest interval of an edge."""
        return max(2 * edge.interval.half_width for edge in filter(None, self[2:]))

    @property
    def fewest_rows(self) -> int:
        """Return the least number of moving levels beyond an edge."""
        return min(edge.rows for edge in filter(None, self[2:]))

    def place(self, base: Floats, height: Floats) -> FlatPart:
        """Return the part in units of the log, from their origin."""
        left, right = (edge and edge.place(base[0], height[0]) for edge in self[2:])
        return FlatPart(self.kind, float(base[1] + height[1] * self.level), left, right)


class RestMap(NamedTuple):
    """Readings at rest over commands.

    Attributes:
        rows: of the record.
        x, y: medians by level, in the order of the commands (n) [u], [y].
        flats: flat parts, from left to right.
        bound: the largest dead band that the map could hide beside its flat parts [u].
        fold: command beyond which a reading stands for two commands; None for a monotone map.
        nodes: commands and readings of the map as a line (2 x m).
        curve: without a flat part; a sweep with times lacks it.
        limits: of a line that may be the curve, lower and upper [u].
    """

    rows: Rows
    x: Floats
    y: Floats
    flats: tuple[FlatPart, ...]
    bound: float
    fold: float | None
    nodes: Floats
    curve: Curve | None = None
    limits: dict[str, Interval] = {}

    def predict(self, u: Floats) -> Floats:
        """Return the readings at rest for commands; beyond the map those of its ends."""
        return np.interp(u, *self.nodes)


# --- Maps


def map_at_rest(t: Floats | None, u: Floats, y: Floats) -> RestMap | None:
    """Return the map at rest of a log; None where nothing rests.

    Args:
        t: times (N); None for rows in the order of their record.
        u: commands (N).
        y: readings, some may be missing (N).
    """
    rows = rows_at_rest(t, u, y)
    if rows is None:
        return None
    return read_map(rows, t is not None and rows.how not in ("table", "holds"))


def read_map(rows: Rows, may_be_late: bool = False) -> RestMap | None:
    """Return the map of rows at rest; None with few levels, or a reading that never changes.

    Holds, a way up beside a way down, and a sweep that comes back late have a fold by chance alone,
    if no curve explains both ways apart.

    Args:
        rows: at rest.
        may_be_late: whether readings may lag: then a curve without a fold is left out.
    """
    if np.ptp(rows.u) == 0:
        return None
    levels = _medians(rows.u, rows.y)
    x, v, w = levels
    if x.size < LEVELS or np.ptp(v) == 0:
        return None
    base = np.array([x[0], v.min()])
    height = np.array([np.ptp(x), np.ptp(v)])
    u = (rows.u - base[0]) / height[0]
    y = (rows.y - base[1]) / height[1]
    unit = Levels((x - base[0]) / height[0], (v - base[1]) / height[1], w)
    parts = _hysteresis(u, y) or _flat_parts(unit, _legs(u, y, rows.came))
    nodes = _nodes(unit, parts)
    noise = max(float(np.std(unit.v - np.interp(unit.x, *nodes))), noise_of(unit.v))
    fold = _fold(nodes, noise)
    is_late = fold is not None and rows.how == "sweep" and not _folds_on_way_out(u, y, nodes, fold)
    curve = None if parts or (may_be_late and fold is None) else fit_curve(rows)
    is_one_way = curve is not None and (curve.distance is None or curve.distance.low <= 0)
    if curve is not None and not is_one_way:
        fold = None  # of a curve whose ways lie apart
    elif is_late or (fold is not None and rows.how in ("ways", "holds")):
        return None  # what comes back need not be a fold
    bound = _bound(nodes, unit, noise) * height[0]
    if curve is not None:
        bound = min(bound, curve.hides)
    ends: dict[str, Interval] = {}
    if is_one_way:
        ends = fit_limits(unit)
    return RestMap(
        rows=rows,
        x=x,
        y=v,
        flats=tuple(part.place(base, height) for part in parts),
        bound=bound,
        fold=None if fold is None else base[0] + height[0] * fold,
        nodes=base[:, None] + height[:, None] * nodes,
        curve=curve,
        limits={name: one.place(base[0], height[0]) for name, one in ends.items()},
    )


# --- Levels


def _medians(u: Floats, y: Floats) -> Levels:
    """Return the medians by level of the command, or by its quantiles if there are many."""
    x = np.unique(u)
    if x.size > MOST:
        x = np.quantile(u, np.linspace(0, 1, MOST + 1)[:-1])
    x = x[np.unique(np.floor((x - x[0]) / (CLOSE * np.ptp(x))), return_index=True)[1]]
    level = np.searchsorted(x, u, side="right")
    order = np.lexsort((y, level))
    first, count = np.unique(level[order], return_index=True, return_counts=True)[1:]
    readings = y[order]
    commands = u[order]
    high = first + count // 2
    low = first + (count - 1) // 2 if x.size < MOST else high  # no mean across an edge
    w = np.sqrt(np.minimum(count, 30))
    medians = (readings[low] + readings[high]) / 2
    return Levels((commands[low] + commands[high]) / 2, medians, w / w.mean())


def _legs(u: Floats, y: Floats, came: Floats) -> list[Levels]:
    """Return the levels of each sweep of the command, if there are several."""
    turned = turns(u, TURN) if came.any() else np.zeros(0, int)
    legs = zip(np.split(u, turned), np.split(y, turned), strict=True)
    return [_medians(*leg) for leg in legs if turned.size and np.unique(leg[0]).size >= LEVELS]


def _nodes(levels: Levels, parts: list[FlatPart]) -> Floats:
    """Return the map as a line: smoothed readings between the flat parts, and their edges."""
    x = levels.x
    v = levels.v.copy()
    moves = np.ones(x.size, bool)
    points = np.zeros((0, 2))
    for part in parts:
        inside = (x >= part.ends[0]) & (x <= part.ends[1])
        v[inside] = part.level
        moves &= ~inside
        edges = [[end, part.level] for end in part.ends]
        points = np.vstack([points, edges])
    for first, last in zip(*bounds_of_runs(moves), strict=True):
        run = slice(first, last + 1)
        if last - first >= SMOOTHED:
            v[run] = savgol_filter(v[run], SMOOTHED // 2 + 1, 2)
    nodes = np.vstack([np.column_stack([x, v]), points[np.isfinite(points[:, 0])]])
    return nodes[np.argsort(nodes[:, 0], kind="stable")].T


# --- Flat parts


def _flat_parts(levels: Levels, legs: list[Levels]) -> list[FlatPart]:
    """Return the flat parts from left to right."""
    x, v, n = levels.x, levels.v, levels.v.size
    fine = float(np.clip(4 * noise_of(v), FINE, APART))
    runs = find_runs(x, v, fine, 3) + find_runs(x, v, WIDE, 3)
    runs.sort(key=lambda run: x[run[0]] - x[run[1] - 1])
    short = [(0, 2), (n - 2, n)]
    parts: list[FlatPart] = []
    exact = max(find_runs(x, v, 0.0, 3), key=lambda run: run[1] - run[0], default=short[0])
    tries = [(run, FARTHER) for run in [*runs[:CANDIDATES], exact, *short]]
    nearer = [(run, 1) for run in [exact, *runs[:1]]]  # what lies farther may be bent
    for run, more in dict.fromkeys(tries + nearer):
        part = None if parts and more == 1 else _fit_part(levels, run, legs, more)
        if part is not None and part.widest_interval < UNSURE:
            low, high = part.ends
            if all(high < one.ends[0] or low > one.ends[1] for one in parts):
                parts.append(part)
    widths = np.array([float(np.ptp(part.ends)) for part in parts])  # infinite for an end
    counts = widths >= STAIR * widths[np.isfinite(widths)].max(initial=0.0)
    if np.isfinite(widths[counts]).sum() > 1:  # steps of the reading, and no effect
        return []
    return sorted(compress(parts, counts), key=lambda part: part.ends)


def _hysteresis(u: Floats, y: Floats) -> list[FlatPart]:
    """Return a rest whose motion starts and stops at different commands; [] without hysteresis.

    The edge is between the command that stops the motion and that which starts it. Between both the
    state before stays, which no flat part explains otherwise.
    """
    moves = y - y.min() > WIDE
    if min(moves.sum(), np.sum(~moves)) < LEVELS or y[moves].min() - y.min() < APART:
        return []
    starts = float(u[~moves].max())
    stops = float(u[moves].min())
    between = (u >= stops) & (u <= starts)
    changes = np.append(False, np.diff(moves))
    met = min(np.sum(moves[between]), np.sum(~moves[between]))
    if met < LEVELS or changes[between].mean() > RARELY:
        return []
    line = np.polynomial.Polynomial.fit(u[moves], y[moves], 1)
    if np.var((y - line(u))[moves]) > (1 - EXPLAINED) * np.var(y):
        return []
    edge = Edge(Interval((starts + stops) / 2, stops, starts), True, int(moves.sum()))
    return [FlatPart("low end", float(np.median(y[~moves])), None, edge)]


def _fit_part(
    levels: Levels, run: tuple[int, int], legs: list[Levels], more: int
) -> FlatPart | None:
    """Return the flat part that a run of neighbours begins; None if it is not flat.

    Its edges are found by the outer half of the run to begin with, as the other half may belong to
    the line beyond the other edge.

    Args:
        levels: of the map.
        run: first and end of the neighbours.
        legs: levels of each sweep.
        more: moving levels that count for an edge, for each level at rest.
    """
    x, v, w = levels
    n = x.size
    first, end = run
    least = min(end - first, 3)
    views = {way: levels.face(way) for way in (-1, 1)}
    for share in (0.5, 0.0):
        runs = {-1: (n - end, n - first), 1: (first, end)}
        sides = {way: _fit_outwards(views[way], *runs[way], share, more) for way in views}
        left, right = sides.values()
        low = x[0] if left is None else -left.edge.value
        high = x[-1] if right is None else right.edge.value
        inside = (x >= low) & (x <= high)
        first = int(np.argmax(inside))
        end = int(np.argmax(inside) + inside.sum())
        unmet = (left is None and first > 0) or (right is None and end < n)
        if unmet or left is right or end - first < least:
            return None
    fits = {way: side for way, side in sides.items() if side is not None}
    level = float(np.average(v[inside], weights=w[inside] ** 2))
    if least < 3 and len(fits) > 1:
        return None
    residual = np.where(inside, v - level, 0.0)
    for way, side in fits.items():
        beyond = slice(runs[way][1], runs[way][1] + side.outer.size)
        residual[::way][beyond] = side.outer
    if not _is_flat(levels, inside, list(fits.values()), residual):
        return None
    ends = {-1: n - first, 1: end}
    edges = {
        way: _edge(
            views[way],
            side,
            ends[way],
            end - first,
            level,
            legs,
            way,
        )
        for way, side in fits.items()
    }
    before = edges.get(-1)
    after = edges.get(1)
    if before and after and before.interval.value > after.interval.value:
        return None
    end_kind = "low end" if level < np.median(v[~inside]) else "high end"
    return FlatPart("band" if before and after else end_kind, level, before, after)


def _fit_outwards(levels: Levels, first: int, end: int, share: float, more: int) -> Side | None:
    """Return the fit of the edge behind a run, of whose span a share is left out ahead.

    The fewer rows are at rest, the fewer moving ones count.
    """
    last = end + NEAREST + more * (end - first)
    x = levels.x[first:end]
    first += int(np.searchsorted(x, x[0] + share * (x[-1] - x[0])))
    return fit_side(levels.cut(slice(first, last)), end - first)


def _is_flat(levels: Levels, inside: Flags, fits: list[Side], residual: Floats) -> bool:
    """Return whether a part hides more than noise, does not lean, and is no piece of a curve."""
    x, v, w = levels
    n = int(inside.sum())
    middle = float(x[inside].mean())
    width = max(float(np.ptp(x[inside])), 1e-9)
    reach = max(1.5 * width, float(np.sort(np.abs(x - middle))[min(n + NEAREST, x.size - 1)]))
    near = np.abs(x - middle) <= reach
    slope = min(abs(side.slope) + abs(side.step) / width for side in fits)
    hidden = slope * width if n > 1 else abs(float(v[inside][0] - fits[0].ahead))
    free = near.sum() - 2 - len(fits)
    quantum = find_quantum(v)
    left = float(np.sqrt(np.sum(residual[near] ** 2) / free))
    noise = max(left, quantum / np.sqrt(12), KNOWN)
    leans = n > 2 and abs(np.polyfit(x[inside], v[inside], 1, w=w[inside])[0]) > FLAT * slope
    explains = min(side.share for side in fits) > EXPLAINED
    is_exact = n > 2 and np.ptp(v[inside]) == 0 and hidden > HIDES * quantum
    if leans or not (explains or is_exact) or hidden < max(HIDES * noise, LEAST):
        return False
    if is_exact:  # no curve rests, and rounding hides less
        return True
    numbers = 1 + sum(side.numbers for side in fits)
    return not _is_curve(levels.cut(near), residual[near], numbers)


def _is_curve(levels: Levels, residual: Floats, numbers: int) -> bool:
    """Return whether a smooth curve has a lower price than a flat part with its edges.

    Args:
        levels: near the part (n).
        residual: that the part with its edges leaves (n).
        numbers: of the part and its edges.
    """
    x, v, w = levels
    shapes = [(numbers, residual)]
    for degree in filter(lambda one: one + 1 < x.size, CURVES):
        curve = np.polynomial.Polynomial.fit(x, v, degree, w=w)
        shapes.append((degree + 1, v - curve(x)))
    prices = []
    for count, left in shapes:
        loss = float(np.sum((left * w) ** 2)) / (x.size - count)
        prices.append(price(loss, x.size, count))
    return int(np.argmin(prices)) > 0


def _edge(
    view: Levels, side: Side, end: int, inner: int, level: float, legs: list[Levels], way: int
) -> Edge:
    """Return an edge, as wide as the rounding and the spacing, and as each sweep's own edge."""
    still = float(view.x[end - 1])
    moves = float(view.x[end])
    rounding = find_quantum(view.v - level) / 2 / max(abs(side.slope), 1e-9)
    value = (still + moves) / 2 if side.step else side.edge.value
    spare = max(0.25 * (moves - still), rounding)
    is_between = side.step or inner < 3 or moves - still > UNVISITED
    places = [still, moves] if is_between else [value - spare, value + spare]
    places += [side.edge.low, side.edge.high]
    own = [at for leg in legs if (at := _edge_of_leg(leg.face(way), level)) is not None]
    places += np.quantile(own, [0.05, 0.95]).tolist() if own else []
    edge = Edge(Interval(value, min(places), max(places)), bool(side.step), view.x.size - end)
    return edge.place(0.0, way)


def _edge_of_leg(leg: Levels, level: float) -> float | None:
    """Return the edge of a single sweep; None where it does not rest and move."""
    starts, ends = bounds_of_runs(np.abs(leg.v - level) < WIDE)
    if not starts.size:
        return None
    longest = int(np.argmax(ends - starts))
    first = int(starts[longest])
    end = int(ends[longest]) + 1
    side = fit_side(leg.cut(slice(first, None)), end - first) if end - first > 2 else None
    return None if side is None else side.edge.value


# --- The map as a whole


def _fold(nodes: Floats, noise: float) -> float | None:
    """Return the command at which the reading turns back, None for a monotone map."""
    x, v = nodes
    for way in (v, -v):
        top = int(np.argmax(way))
        is_inside = END <= top < x.size - END
        if is_inside and way[top] - max(way[0], way[-1]) > max(FOLDED, HIDES * noise):
            return float(x[top])
    return None


def _folds_on_way_out(u: Floats, y: Floats, nodes: Floats, fold: float) -> bool:
    """Return whether readings come back while commands go on beyond a fold: late ones do not."""
    way = np.sign(2 * fold - 1)  # of the end that is nearer
    visits = zip(*bounds_of_runs(way * u > way * fold), strict=True)
    near, far = np.array([(a or b, a + np.argmax(way * u[a : b + 1])) for a, b in visits]).T
    back = np.interp(fold, *nodes) - np.interp(u[far], *nodes)
    return bool(np.sum(y[near] - y[far]) / np.sum(back) > WAY_OUT)


def _bound(nodes: Floats, levels: Levels, noise: float) -> float:
    """Return the largest dead band that the map could hide: by its noise, slope and spacing.

    In a straight map a band shifts all that lies beyond it, so that what a line leaves is a bound.
    """
    x, v, _ = levels
    slope = np.abs(np.diff(np.interp(x, *nodes)) / np.diff(x))
    moving = slope >= MOVING * np.median(slope)
    widths = np.maximum(4 * np.diff(x), max(HIDES * noise, LEAST) / np.maximum(slope, 1e-9))
    bent = max(float(np.std(v - np.polyval(np.polyfit(x, v, 1), x))), KNOWN)
    ends = max(  # a flat end is as long at most
        one.x[np.argmax(np.abs(one.v - one.v[0]) > HIDES * noise)] - one.x[0]
        for one in (levels, levels.face(-1))
    )
    widest = min(max(ends, np.quantile(widths[moving], 0.95)), 1.0)
    return float(np.clip(HIDES * bent, ends, widest))
