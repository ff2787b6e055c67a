"""The map at rest of any shape: readings over commands, flat parts, folds, ripple, and play.

A flat part is a run of neighbours that read one level, with a bent line beyond each edge. It counts
if a smooth curve fits worse, and if what it hides stands out of what the fit leaves. A map without
one is an answer too: the largest dead band that it could hide.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import median_filter
from scipy.stats import t as student

from undeadzone.util.arrays import Flags, Floats, bounds_of_runs
from undeadzone_identify.logs.grid import find_quantum
from undeadzone_identify.looks.edges import KNOWN, Edge, Side, find_runs, fit_side, jackknife
from undeadzone_identify.looks.rows import (
    LEVELS,
    Rows,
    known_samples,
    noise_of,
    rows_at_rest,
    turns,
)
from undeadzone_identify.models.estimates import Interval

# Half and double of a number below change no shape and no edge of the tests' maps:
# test_half_and_double_of_a_constant_change_no_map.
MOST = 400  # levels of a map; more are put together by quantiles
CLOSE = 1e-3  # of the commands' range, below which two levels are one
WIDE, FINE = 0.012, 1e-4  # of the range: distances from the level of a candidate
CANDIDATES = 6
SMOOTHED = 24  # levels in a row, from which noise is smoothed
STEEPER = 0.35  # of the slope beside it: the largest inside a candidate
FLAT = 0.1  # of the slope beside it: the largest inside a flat part
HIDES, LEAST = 8.0, 0.008  # residuals and share of the range, that a flat part hides at least
LARGEST = 3.0  # standard deviations of a hidden band's amplitude
EXPLAINED = 0.98  # of the variance beside a flat part
NEAREST, FARTHER = 5, 4  # moving levels that count for an edge, and more for each level at rest
BENT = 4.0  # times the bends after it: the bend at an edge behind one or two levels
UNVISITED = 0.2  # of the commands' range, from which a gap is said
APART = 0.05  # of the range: readings that contradict, and both sides of a gap
FEW = 0.05  # of the rows of one way that may contradict the others
RARELY = 0.2  # of the rows between both thresholds, at which the state may change
FOLDED = 0.03  # of the range, by which a reading must come back
TURN = 0.3  # of the commands' range, from which the way back is a sweep of its own
PERIODS, EVEN, RIPPLES = 5, 0.25, 0.5  # least number, spread of distances, share of the variance
STAYS = 0.1  # of the commands' range, by which a command moves that stays
RATE_EXPLAINED = 0.8  # of the variance of rates, by the command


class FlatPart(NamedTuple):
    """Commands over which the reading keeps one level.

    Attributes:
        kind: "band", "low end" or "high end".
        level: of the reading [y].
        left, right: edges; None where the map ends inside.
        rows: number of levels inside.
    """

    kind: str
    level: float
    left: Edge | None
    right: Edge | None
    rows: int


class RestMap(NamedTuple):
    """Readings at rest over commands.

    Attributes:
        rows: of the record.
        x, y: medians by level, in the order of the commands (n) [u], [y].
        flats: flat parts, from left to right.
        shape: "band", "end", "line", "curve", "fold", "ripple" or "play".
        up_down: how far the way down lies beside the way up; None if it went one way [u].
        bound: the largest dead band that the map could hide beside its flat parts [u].
        unvisited: commands between which nothing was visited though the reading changed.
        met: number of moving levels on each side of rest.
        fold: command beyond which a reading stands for two commands.
        contradicts: share of the rows that contradict the others at their command.
        share: of the variance of the rows that the map explains.
        quiet: sides on which the map ends at rest, so that no edge was met there.
        nodes: commands and readings of the map as a line (2 x m).
        lag: of the reading behind the command, for a map of the rate [samples].
    """

    rows: Rows
    x: Floats
    y: Floats
    flats: tuple[FlatPart, ...]
    shape: str
    up_down: Interval | None
    bound: float
    unvisited: tuple[float, float] | None
    met: dict[str, int]
    fold: float | None
    contradicts: float
    share: float
    quiet: tuple[str, ...]
    nodes: Floats
    lag: int = 0

    def predict(self, u: Floats) -> Floats:
        """Return the readings at rest for commands; beyond the map those of its ends."""
        return np.interp(u, *self.nodes)


class Levels(NamedTuple):
    """Medians by level: commands, readings, weights (n)."""

    x: Floats
    v: Floats
    w: Floats

    def select(self, flags: Flags) -> Levels:
        """Return the selected levels."""
        return Levels(self.x[flags], self.v[flags], self.w[flags])

    def mirror(self) -> Levels:
        """Return the levels in the order of -x."""
        return Levels(-self.x[::-1], self.v[::-1], self.w[::-1])


# --- Maps


def map_at_rest(t: Floats | None, u: Floats, y: Floats) -> RestMap | None:
    """Return the map at rest of a log; None where nothing rests.

    Args:
        t: times (N); None for rows in the order of their record.
        u: commands (N).
        y: readings, some may be missing (N).
    """
    rows = rows_at_rest(t, u, y)
    return None if rows is None else read_map(rows)


def map_of_rate(t: Floats | None, u: Floats, y: Floats) -> RestMap | None:
    """Return the map of the rate of a reading that integrates, at the best lag; None without one.

    A row is a window in which the command stays where it is for longer than the lag.
    """
    t, u, y = known_samples(t, u, y)
    best, explained, late = None, RATE_EXPLAINED, 0
    for size in (2, 4, 8, 16, 32):
        for lag in (0, size // 2, size, 2 * size):
            rows = _rate_rows(t, u, y, size, lag)
            if rows is not None and _neighbours_agree(rows) > explained:
                best, explained, late = rows, _neighbours_agree(rows), lag
    found = None if best is None else read_map(best)
    if found is None or found.share < RATE_EXPLAINED:
        return None
    return found._replace(lag=late)


def read_map(rows: Rows) -> RestMap | None:
    """Return the map of rows at rest; None with few levels, or a reading that never changes."""
    levels = _without_outliers(_medians(rows.u, rows.y))
    if levels.x.size < LEVELS or np.ptp(levels.v) == 0:
        return None
    base, height = (
        np.array([levels.x[0], levels.v.min()]),
        np.array([np.ptp(levels.x), np.ptp(levels.v)]),
    )
    u, y = (rows.u - base[0]) / height[0], (rows.y - base[1]) / height[1]
    unit = Levels((levels.x - base[0]) / height[0], (levels.v - base[1]) / height[1], levels.w)
    line = _nodes(unit, [])
    up_down = _up_down(u, y, rows.came, line)
    plays = up_down is not None and up_down.low > 0 and up_down.value > LEAST
    way = _one_way(u, rows.came) if plays else np.ones(u.size, bool)
    one_way = _medians(u[way], y[way]) if plays else unit
    off = np.abs(y - np.interp(u, one_way.x, one_way.v))[way] > APART
    hung = _hysteresis(u, y)
    parts = [hung] if hung else _flat_parts(one_way, _legs(u, y, rows.came), plays)
    parts = [] if plays and np.mean(off) > FEW else parts
    ripples = _ripples(unit, parts)
    parts = [] if ripples else parts
    nodes = _nodes(one_way, parts) if parts else line
    noise = max(float(np.std(one_way.v - np.interp(one_way.x, *nodes))), noise_of(one_way.v))
    fold = _fold(nodes, noise)
    residual = y - np.interp(u, *nodes)
    bent = float(np.std(unit.v - np.polyval(np.polyfit(unit.x, unit.v, 1), unit.x)))
    shapes = {
        "ripple": ripples,
        "band": any(part.kind == "band" for part in parts),
        "end": bool(parts),
        "play": plays,
        "fold": fold is not None,
        "curve": bent > max(3 * noise, LEAST),
        "line": True,
    }
    shape = next(word for word, found in shapes.items() if found)
    return RestMap(
        rows=rows,
        x=levels.x,
        y=levels.v,
        flats=tuple(_in_units(part, base, height) for part in parts),
        shape=shape,
        up_down=None if up_down is None else up_down.scale_by(height[0]),
        bound=_bound(nodes, one_way, noise, shape == "line") * height[0],
        unvisited=_unvisited(levels, height),
        met=_met(one_way, parts),
        fold=None if fold is None else base[0] + height[0] * fold,
        contradicts=float(np.mean(off)),
        share=float(1 - np.var(residual) / np.var(y)),
        quiet=_quiet(parts),
        nodes=base[:, None] + height[:, None] * nodes,
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
    readings, commands = y[order], np.sort(u)
    high = first + count // 2
    low = first + (count - 1) // 2 if x.size < MOST else high  # no mean across an edge
    w = np.sqrt(np.minimum(count, 30))
    medians = (readings[low] + readings[high]) / 2
    return Levels((commands[low] + commands[high]) / 2, medians, w / w.mean())


def _without_outliers(levels: Levels) -> Levels:
    """Return the levels without single readings far from both neighbours on either side."""
    v = levels.v
    if v.size < SMOOTHED:
        return levels
    far = np.abs(v - median_filter(v, 5, mode="nearest"))
    usual = float(np.quantile(v, 0.9) - np.quantile(v, 0.1))
    is_far = far > max(10 * noise_of(v), 0.1 * usual)
    return levels.select(~is_far) if is_far.sum() <= max(1, v.size // 50) else levels


def _one_way(u: Floats, came: Floats) -> Flags:
    """Return flags of the way that covers more commands, the way up if both do."""
    return max((came > 0, came < 0), key=lambda way: float(np.ptp(u[way])))


def _legs(u: Floats, y: Floats, came: Floats) -> list[Levels]:
    """Return the levels of each sweep of the command, if there are several."""
    turned = turns(u, TURN) if came.any() else np.zeros(0, int)
    if not turned.size:
        return []
    legs = zip(np.split(u, turned), np.split(y, turned), strict=True)
    return [_medians(*leg) for leg in legs if np.unique(leg[0]).size >= LEVELS]


def _nodes(levels: Levels, parts: list[FlatPart]) -> Floats:
    """Return the map as a line: smoothed readings between the flat parts, and their edges."""
    x, v = levels.x, levels.v.copy()
    inside = np.zeros(x.size, bool)
    points = []
    for part in parts:
        for edge in filter(None, (part.left, part.right)):
            points.append([edge.still if edge.jumps else edge.interval.value, part.level])
        low, high = _ends(part)
        within = (x >= low) & (x <= high)
        v[within] = part.level
        inside |= within
    for first, last in zip(*bounds_of_runs(~inside), strict=True):
        run = slice(first, last + 1)
        if last - first >= SMOOTHED:
            v[run] = _smooth(x[run], v[run])
    nodes = np.vstack([np.column_stack([x, v]), *points])
    return nodes[np.argsort(nodes[:, 0], kind="stable")].T


def _smooth(x: Floats, v: Floats) -> Floats:
    """Return the smoothest readings that differ from these by their noise (n)."""
    inverse = 1 / np.maximum(np.diff(x), 0.25 / x.size)
    bends = np.zeros((x.size - 2, x.size))
    for k, column in enumerate((inverse[:-1], -inverse[:-1] - inverse[1:], inverse[1:])):
        np.fill_diagonal(bends[:, k:], column)
    squares = bends.T @ bends
    bands = np.zeros((3, x.size))
    for k in range(3):
        bands[2 - k, k:] = np.diag(squares, k)
    most = max(noise_of(v), KNOWN)
    for stiffness in 10.0 ** np.arange(0, -10, -0.5):
        smooth = solveh_banded(stiffness * bands + [[0], [0], [1]], v)
        if np.std(v - smooth) < most:
            return smooth
    return v


# --- Flat parts


def _flat_parts(levels: Levels, legs: list[Levels], plays: bool) -> list[FlatPart]:
    """Return the flat parts from left to right."""
    x, v = levels.x, levels.v
    n = x.size
    fine = float(np.clip(4 * noise_of(v), FINE, APART))
    runs = find_runs(v, fine, 3) + find_runs(v, WIDE, 3)
    runs = [run for run in runs if _is_steeper_beside(levels, *run)]
    runs.sort(key=lambda run: run[0] - run[1])
    short = [] if plays or n >= SMOOTHED else [(0, 2), (n - 2, n), (0, 1), (n - 1, n)]
    parts: list[FlatPart] = []
    for first, end in [*runs[:CANDIDATES], *short]:
        if _is_apart(x[first], x[end - 1], parts):
            part = _fit_part(levels, (first, end), legs)
            if part is not None and _is_apart(*_ends(part), parts):
                parts.append(part)
    return sorted(parts, key=_ends)


def _hysteresis(u: Floats, y: Floats) -> FlatPart | None:
    """Return a rest whose motion starts and stops at different commands, None without hysteresis.

    The edge is between the command that stops the motion, `moves`, and that which starts it,
    `still`. Between both the state before stays, which no flat part explains otherwise.
    """
    level = float(np.median(y[y < y.min() + WIDE])) if np.median(y) < APART else np.nan
    at_rest = np.abs(y - level) < WIDE
    if min(at_rest.sum(), np.sum(~at_rest)) < LEVELS or np.any(np.abs(y - level)[~at_rest] < APART):
        return None
    starts, stops = float(u[at_rest].max()), float(u[~at_rest].min())
    between = (u >= stops) & (u <= starts)
    changes = np.append(False, at_rest[1:] != at_rest[:-1])
    if starts - stops < LEAST or between.sum() < LEVELS or changes[between].mean() > RARELY:
        return None
    line = np.polynomial.Polynomial.fit(u[~at_rest], y[~at_rest], 1)
    if np.var((y - line(u))[~at_rest]) > (1 - EXPLAINED) * np.var(y):
        return None
    found = Interval((starts + stops) / 2, stops, starts)
    edge = Edge(found, starts, stops, True, int(np.sum(~at_rest)))
    return FlatPart("low end", level, None, edge, int(at_rest.sum()))


def _ends(part: FlatPart) -> tuple[float, float]:
    """Return where a flat part begins and ends."""
    left = -np.inf if part.left is None else part.left.interval.value
    right = np.inf if part.right is None else part.right.interval.value
    return left, right


def _is_apart(low: float, high: float, parts: list[FlatPart]) -> bool:
    """Return whether an interval lies beside all flat parts."""
    return all(high < _ends(part)[0] or low > _ends(part)[1] for part in parts)


def _is_steeper_beside(levels: Levels, first: int, end: int) -> bool:
    """Return whether the reading moves faster beside a run than in it."""
    size = max(end - first, 3)
    own, *beside = (
        abs(np.polyfit(levels.x[a:b], levels.v[a:b], 1)[0])
        for a, b in ((first, end), (max(first - size, 0), first), (end, end + size))
        if levels.x[a:b].size > 1
    )
    return bool(beside) and own < STEEPER * max(beside)


def _fit_part(levels: Levels, run: tuple[int, int], legs: list[Levels]) -> FlatPart | None:
    """Return the flat part that a run of neighbours begins; None if it is not flat."""
    x, v, w = levels
    n = x.size
    first, end = run
    is_short = end - first < 3
    views = (levels.mirror(), levels)
    for share in (0.5, 0.0):
        runs = ((n - end, n - first), (first, end))
        sides = [
            _fit_outwards(*view, *bounds, share) for view, bounds in zip(views, runs, strict=True)
        ]
        left, right = sides
        low = x[0] if left is None else -left.x
        high = x[-1] if right is None else right.x
        inside = (x >= low) & (x <= high)
        first, end = int(np.argmax(inside)), int(np.argmax(inside) + inside.sum())
        unmet = (left is None and first > 0) or (right is None and end < n)
        if unmet or (left is right) or end - first < (1 if is_short else 3):
            return None
    level = float(np.average(v[inside], weights=w[inside] ** 2))
    residual = np.where(inside, v - level, 0.0)
    for outwards, (_, moves), side in zip((residual[::-1], residual), runs, sides, strict=True):
        if side is not None:
            outwards[moves : moves + side.outer.size] = side.outer
    fits = [side for side in sides if side is not None]
    view = views[first == 0]
    if is_short and (len(fits) > 1 or not _bends_at_once(view.x, view.v, end - first)):
        return None
    if not _is_flat(levels, inside, fits, residual):
        return None
    runs = ((n - end, n - first), (first, end))
    others = ([leg.mirror() for leg in legs], legs)
    edges: list[Edge | None] = []
    for view, side, bounds, own in zip(views, sides, runs, others, strict=True):
        edges.append(None if side is None else _edge(view, side, *bounds, level, own))
    before, after = edges[0] and _mirror(edges[0]), edges[1]
    kind = "band"
    if before is None or after is None:
        kind = "low end" if level < np.median(v[~inside]) else "high end"
    elif before.interval.high > after.interval.low:
        return None
    return FlatPart(kind, level, before, after, end - first)


def _fit_outwards(
    x: Floats, v: Floats, w: Floats, first: int, end: int, share: float
) -> Side | None:
    """Return the fit of the edge behind a run, of whose rows a share is left out ahead.

    The fewer rows are at rest, the fewer moving ones count.
    """
    last = end + NEAREST + (FARTHER * (end - first) if end - first > 2 else 0)
    first += int(share * (end - first))
    return fit_side(x[first:last], v[first:last], w[first:last], end - first)


def _is_flat(levels: Levels, inside: Flags, fits: list[Side], residual: Floats) -> bool:
    """Return whether a part hides more than noise, does not lean, and is no piece of a curve."""
    x, v, w = levels
    n = int(inside.sum())
    middle, width = float(x[inside].mean()), max(float(np.ptp(x[inside])), 1e-9)
    reach = max(1.5 * width, float(np.sort(np.abs(x - middle))[min(n + NEAREST, x.size - 1)]))
    near = np.abs(x - middle) <= reach
    slope = min(abs(side.slope) + abs(side.step) / width for side in fits)
    hidden = slope * width if n > 1 else abs(float(v[inside][0] - fits[0].ahead))
    free = near.sum() - 2 - len(fits)
    noise = max(float(np.sqrt(np.sum(residual[near] ** 2) / free)), KNOWN)
    leans = n > 2 and abs(np.polyfit(x[inside], v[inside], 1, w=w[inside])[0]) > FLAT * slope
    explains = min(side.share for side in fits) > EXPLAINED
    if leans or not explains or hidden < max(HIDES * noise, LEAST):
        return False
    if n < 3:
        return True
    degree = 2 + len(fits)
    curve = np.polynomial.Polynomial.fit(x[near], v[near], degree, w=w[near])
    bent = np.sum(((v - curve(x)) * w)[near] ** 2)
    return bool(np.sum((residual * w)[near] ** 2) + near.sum() * KNOWN**2 < bent)


def _bends_at_once(x: Floats, v: Floats, inner: int) -> bool:
    """Return whether the line bends at an edge behind few levels, and hardly further out."""
    slope = np.diff(v)[inner - 1 : inner + 4] / np.diff(x)[inner - 1 : inner + 4]
    bend = np.abs(np.diff(slope))
    return slope.size > 3 and bool(
        abs(slope[1]) > abs(slope[0]) and bend[0] > BENT * bend[1:].max()
    )


def _edge(view: Levels, side: Side, first: int, end: int, level: float, legs: list[Levels]) -> Edge:
    """Return an edge with its interval, widened by each sweep's own edge."""
    x, v, w = (part[first:] for part in view)
    still, moves = float(view.x[end - 1]), float(view.x[end])
    cell = 0.25 * (moves - still)
    rows = view.x.size - end
    rounding = find_quantum(view.v - level) / 2 / max(abs(side.slope), 1e-9)
    if side.step:
        near = float(np.abs(v[: end - first] - level).max())
        blur = min(near / max(abs(side.slope), 1e-9), 4 * cell)
        found = Interval((still + moves) / 2, still - blur, moves)
    else:
        found = Interval.from_half_width(
            side.x, jackknife(x, v, w, end - first, side) + max(cell, rounding)
        )
    own = list(filter(None, (_fit_leg(leg, level, len(side.bends)) for leg in legs)))
    if own:
        low, high = np.quantile([leg.x for leg in own], [0.05, 0.95]).tolist()
        found = Interval(found.value, min(found.low, low), max(found.high, high))
    if end - first < 3:
        found = Interval(*np.clip(found, still, moves).tolist())
    if moves - still > UNVISITED:
        found = Interval(found.value, min(found.low, still), max(found.high, moves))
    return Edge(found, still, moves, bool(side.step), rows)


def _fit_leg(leg: Levels, level: float, bends: int) -> Side | None:
    """Return the fit of the edge of a single sweep; None where it does not rest and move."""
    starts, ends = bounds_of_runs(np.abs(leg.v - level) < WIDE)
    if not starts.size:
        return None
    longest = int(np.argmax(ends - starts))
    first, end = int(starts[longest]), int(ends[longest]) + 1
    if end - first < 3 or leg.x.size - end < 3:
        return None
    return fit_side(leg.x[first:], leg.v[first:], leg.w[first:], end - first, bends)


def _mirror(edge: Edge) -> Edge:
    """Return an edge in the order of -x."""
    value, low, high = edge.interval
    return edge._replace(
        interval=Interval(-value, -high, -low), still=-edge.still, moves=-edge.moves
    )


def _in_units(part: FlatPart, base: Floats, height: Floats) -> FlatPart:
    """Return a flat part in units of the log."""

    def scale(edge: Edge | None) -> Edge | None:
        if edge is None:
            return None
        at = [base[0] + height[0] * value for value in (*edge.interval, edge.still, edge.moves)]
        return Edge(Interval(*at[:3]), at[3], at[4], edge.jumps, edge.rows)

    level = float(base[1] + height[1] * part.level)
    return part._replace(level=level, left=scale(part.left), right=scale(part.right))


# --- The map as a whole


def _up_down(u: Floats, y: Floats, came: Floats, line: Floats) -> Interval | None:
    """Return how far the way down lies beside the way up, by the slope of the map.

    Rows that are nearer than that to the last turn are still between both ways.
    """
    if min(np.sum(came > 0), np.sum(came < 0)) < LEVELS:
        return None
    grid = np.linspace(0, 1, 41)
    slope = np.interp(u, grid, np.gradient(np.interp(grid, *line), grid))
    turned = np.append(0, turns(u, LEAST))
    since = np.abs(u - u[turned[np.searchsorted(turned, np.arange(u.size), side="right") - 1]])
    off = y - np.interp(u, *line)
    groups = np.arange(u.size) * 10 // u.size

    def shift(kept: Flags) -> float:
        """Return the distance of both ways in some rows."""
        ways = came[kept] * slope[kept]
        columns = np.column_stack([-ways / 2, np.ones(ways.size)])
        return float(np.linalg.lstsq(columns, off[kept])[0][0])

    value = 0.0
    for _ in range(3):
        kept = (came != 0) & (since >= min(abs(value), TURN))
        if min(np.sum(came[kept] > 0), np.sum(came[kept] < 0)) < LEVELS:
            return None
        value = shift(kept)
    parts = [shift(kept & (groups != group)) for group in range(10)]
    return Interval.from_half_width(value, float(student.ppf(0.975, 9) * 3 * np.std(parts)))


def _ripples(levels: Levels, parts: list[FlatPart]) -> bool:
    """Return whether the map waves with a period, or has flat parts like stairs."""
    bands = [_ends(part) for part in parts if part.kind == "band"]
    apart = np.diff(np.mean(bands, axis=1)) if len(bands) > 2 else np.array([1.0, -1.0])
    if np.std(apart) < EVEN * np.mean(apart):
        return True
    size = levels.x.size
    if size < 5 * PERIODS:
        return False
    x = np.linspace(0, 1, size)
    v = np.interp(x, levels.x, levels.v)
    wave = v - np.polyval(np.polyfit(x, v, 5), x)
    often = np.arange(PERIODS, size / 4, 0.5)
    power = np.abs(np.exp(2j * np.pi * np.outer(often, x)) @ wave) ** 2 * 2 / size
    return bool(np.std(wave) > 5 * KNOWN and power.max() > RIPPLES * np.sum(wave**2))


def _fold(nodes: Floats, noise: float) -> float | None:
    """Return the command at which the reading turns back, None for a monotone map."""
    x, v = nodes
    for way in (v, -v):
        top = int(np.argmax(way))
        if way[top] - max(way[0], way[-1]) > max(FOLDED, HIDES * noise):
            return float(x[top])
    return None


def _bound(nodes: Floats, levels: Levels, noise: float, is_line: bool) -> float:
    """Return the largest dead band that the map could hide: by its noise, slope and spacing."""
    x, v = levels.x, np.interp(levels.x, *nodes)
    if is_line:
        return _bound_beside_line(levels)
    slope = np.abs(np.diff(v) / np.diff(x))
    moving = slope > STEEPER * np.median(slope)
    widths = np.maximum(4 * np.diff(x), max(HIDES * noise, LEAST) / np.maximum(slope, 1e-9))
    return float(min(np.quantile(widths[moving], 0.95), 1.0))


def _bound_beside_line(levels: Levels) -> float:
    """Return the largest dead band at any place that a line's residual allows."""
    x, v = levels.x, levels.v
    basis = np.linalg.qr(np.column_stack([np.ones(x.size), x]))[0]
    off = v - basis @ (basis.T @ v)
    noise = max(float(np.sqrt(off @ off / (x.size - 2))), KNOWN)
    widths, places = np.linspace(0, 1, 101)[1:, None, None], np.linspace(0, 1, 41)[:, None]
    band = np.clip(x - places, -widths / 2, widths / 2)
    band = np.polyfit(x, v, 1)[0] * ((band @ basis) @ basis.T - band)
    size = np.sqrt(np.sum(band**2, axis=-1))
    allowed = band @ off + LARGEST * noise * size > size**2
    allowed &= np.abs(places[:, 0] - 0.5) < 0.5 - widths[:, 0] / 2
    return float(widths[np.argmin(allowed.any(axis=1)), 0, 0])


def _unvisited(levels: Levels, height: Floats) -> tuple[float, float] | None:
    """Return the commands beside the widest gap, if the reading changed over it."""
    k = int(np.argmax(np.diff(levels.x)))
    (low, high), (before, after) = levels.x[k : k + 2].tolist(), levels.v[k : k + 2]
    is_gap = high - low > UNVISITED * height[0] and abs(after - before) > APART * height[1]
    return (low, high) if is_gap else None


def _met(levels: Levels, parts: list[FlatPart]) -> dict[str, int]:
    """Return the number of moving levels on each side of the rest; of all without one."""
    rest = min(parts, key=lambda part: part.kind != "band", default=None)
    low, high = (np.inf, -np.inf) if rest is None else _ends(rest)
    return {"right": int(np.sum(levels.x > high)), "left": int(np.sum(levels.x < low))}


def _quiet(parts: list[FlatPart]) -> tuple[str, ...]:
    """Return the sides on which the map ends at rest."""
    sides = (("left", [part.left for part in parts]), ("right", [part.right for part in parts]))
    return tuple(side for side, edges in sides if None in edges)


# --- Rates


def _rate_rows(t: Floats, u: Floats, y: Floats, size: int, lag: int) -> Rows | None:
    """Return the rate over each window in which the command stays, from `lag` samples ahead."""
    starts = np.arange(lag, y.size - size, size)
    if starts.size < 4 * LEVELS:
        return None
    asked = np.lib.stride_tricks.sliding_window_view(u, size + lag + 1)[starts - lag]
    passed = t[starts + size] - t[starts]
    stays = (np.ptp(asked, axis=1) < STAYS * np.ptp(u)) & (passed > 0)
    if np.sum(stays) < 4 * LEVELS:
        return None
    rate = (y[starts + size] - y[starts])[stays] / passed[stays]
    u = np.median(asked, axis=1)[stays]
    return Rows(u, rate, np.zeros(u.size), np.full(u.size, size), np.zeros(u.size), "sweep")


def _neighbours_agree(rows: Rows) -> float:
    """Return the share of the readings' variance that neighbours in the command have in common."""
    y = rows.y[np.argsort(rows.u, kind="stable")]
    return 1 - float(np.mean(np.diff(y, 2) ** 2) / 6 / max(float(np.var(y)), 1e-300))
