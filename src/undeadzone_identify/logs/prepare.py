"""From a log on its grid to the data of a fit: exact zeros, excluded readings, refused logs.

The edges of a jump sensor, whose readings are z itself beyond them, are read off here: no reading
lies between 0 and an edge, and the least one lies just beyond it, by an exponential number whose
rate is the density of readings there. Less its edges a jump sensor is a dead zone of known widths,
so the plant is found as behind any other zone.

Which readings of a log count: no spikes, no dropouts, none that is stuck or at a range's end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.errors import InformationError, InputError
from undeadzone.logs.range_ends import RangeEnds, range_ends
from undeadzone.util.arrays import Flags, Floats, Integers, bounds_of_runs
from undeadzone_identify.logs.grid import RARE, SPIKE, Grid, find_spikes
from undeadzone_identify.logs.log import Options
from undeadzone_identify.models.likelihood import root_mean_square, zone_offset
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.models.zone import WidthLimits
from undeadzone_identify.models.zone_fit import fit_linear

LOUD = 2.0  # times the steps beside it, by which readings beside a dropout are beyond silence
PASSING = 5.0  # times a small reading, up to which a lone one may only have passed an edge
DROPPED = 0.1  # share of the readings that may be dropouts
NEAR = 5  # readings beside one at a limit: noise that does not reach it pulls them inwards
ENOUGH = 0.7  # of the readings between the limits, so that they are left out
LASTING = 0.01  # share of the readings that are silent in a row, from which there is a silence
STUCK = 0.05  # share of the readings that hold one value, from which a sensor may be stuck
LONGER = 5.0  # times the second longest hold
HELD = 10  # repeats in a row, that are a hold
JUMPS = 2.0  # times large steps, by which the reading jumps after a hold
OFTEN_HELD, SELDOM = 0.2, 0.01  # share of the readings in such rows at most, and of other repeats
MOVING = 0.3  # of its rms, by which the input moves meanwhile
VISITS = 3  # of an end of the range, in a log that sticks there


class UsableReadings(NamedTuple):
    """Flags of the readings that count.

    Attributes:
        ok: those away from the ends of the range (N).
        at_ends: those at its ends, or so near that noise may reach them (N).
        ends: of the range, at which readings stick.
    """

    ok: Flags
    at_ends: Flags
    ends: RangeEnds


def select_readings(grid: Grid, remarks: list[str]) -> UsableReadings:
    """Return the readings that count, and the ends of the range at which readings stick.

    Args:
        grid: the log on its grid.
        remarks: each omission is added here, for the user.
    """
    ok = grid.ok.copy()
    for find, words in LEFT_OUT:
        bad = find(grid, ok)
        k = bad.argmax()
        remarks += [words.format(bad.sum(), grid.t[k], grid.y[k])] * bool(bad.any())
        ok[bad] = False
    ends = range_ends(grid.y, ok, grid.quantum)
    at = ends.find_readings_at_ends(grid.y, ok)
    visits = [bounds_of_runs(at & side)[0].size for side in (grid.y > 0, grid.y < 0)]
    between = ok & ~at
    sticks = ends.has_ends and max(visits) >= VISITS
    stick = f"{ends.number} readings stick at the ends of the range {ends.range_text}"
    are_few = between.sum() < FEWEST_READINGS <= ok.sum()
    if sticks and are_few:
        remarks.append(f"{stick}: too few lie between them, and all of them count")
    if are_few or not sticks:
        return UsableReadings(ok, np.zeros_like(ok), RangeEnds(-np.inf, np.inf, 0))
    remarks.append(f"{stick}: there they only bound the output, and are taken as missing")
    apart = between & (np.convolve(at, np.ones(2 * NEAR + 1), "same") < 0.5)
    most = apart if apart.sum() >= ENOUGH * between.sum() else between
    return UsableReadings(most, ok & ~most, ends)


def _flag_spikes(grid: Grid, ok: Flags) -> Flags:
    """Return the flags of the few readings far beyond the rest, or beyond both neighbours (N)."""
    from scipy.ndimage import median_filter

    y, size = grid.y, np.abs(grid.y)
    change = np.diff(y)
    before = np.roll(y, 1)
    known = ok & np.roll(ok, 1) & np.roll(ok, -1)
    lone = np.abs(y - median_filter(y, 3, mode="nearest"))
    lone[~known | (y == 0)] = 0.0
    usual = size[known & (y * before > 0)]
    beyond = PASSING * np.quantile(usual, 0.1) if usual.size else 0.0  # not a passage of an edge
    steps = np.abs(change[known[1:] & (change != 0)])
    least = SPIKE * max(np.quantile(lone, 0.99), np.median(steps) if steps.size else 0.0)
    alone = (lone > least) & ((size > beyond) | (before != 0))
    alone &= alone.sum() <= max(1, RARE * alone.size)
    return find_spikes(y, ok) | alone


def _flag_dropouts(grid: Grid, ok: Flags) -> Flags:
    """Return the flags of zeros between readings too large for the output to enter the zone
    (N).

    It would have to move in a step by much more than it does before and after. A jump sensor falls
    silent from its edge, its least reading; so what counts is how far readings are beyond that.
    Where no silence lasts, noise leaves no reading at 0 exactly: there every lonely zero is one.
    """
    y, size = grid.y, np.abs(grid.y)
    side = np.sign(y) * ok
    beyond = np.zeros(y.size)
    for one in (1, -1):
        beyond[side == one] = size[side == one] - size[side == one].min(initial=np.inf)
    step = np.pad(np.abs(np.diff(y)) * (side[1:] * side[:-1] > 0), 1)
    usual = np.median(step[step > 0]) if step.any() else np.inf
    moves = np.where(step > 0, step, np.inf)
    nearest = np.minimum(moves[:-1], moves[1:])
    beyond[beyond > beyond[LOUD * nearest < beyond].max(initial=0.0)] = 0.0  # glitches
    dropped = np.zeros_like(ok)
    silent = ok & (side == 0)
    for first, last in zip(*bounds_of_runs(silent), strict=True):
        before = max(first - 1, 0)
        after = min(last + 1, y.size - 1)
        moved = max(usual, abs(y[after] - y[before]), step[before], step[after + 1])
        loud = min(beyond[before], beyond[after]) > LOUD * moved
        dropped[first : last + 1] = loud and y[before] * y[after] > 0
    lasts = silent & (np.roll(silent, 1) | np.roll(silent, -1))
    if not grid.quantum and lasts.sum() <= LASTING * ok.sum():
        dropped |= silent & ~lasts
    return dropped & (dropped.sum() <= DROPPED * ok.sum())


def _flag_stuck(grid: Grid, ok: Flags) -> Flags:
    """Return the flags of constant readings, not 0 (N).

    They are some holds that end by a jump, of readings that else hardly repeat, or one long hold
    while the input moves. Holds at the ends of the range are those of limits.
    """
    y, change = grid.y, np.diff(grid.y, prepend=np.inf)
    known = ok & np.roll(ok, 1)
    unchanged = (change == 0) & known & (y != 0)
    first, last = bounds_of_runs(unchanged)
    lengths = last - first + 1
    holds = np.flatnonzero(lengths >= HELD)
    stuck = np.zeros_like(ok)
    if not holds.size:
        return stuck
    many, count = lengths[holds].sum(), ok.sum()
    is_rare = many < OFTEN_HELD * count and lengths.sum() - many < SELDOM * count
    steps = np.append(np.abs(change[known & ~unchanged]), np.inf)
    usual = np.quantile(steps, 0.9, method="lower")
    jumps = np.abs(change[np.minimum(last[holds] + 1, y.size - 1)])
    is_frozen = is_rare and holds.size > 1 and np.median(jumps) > JUMPS * usual
    is_frozen &= not np.isin(y[first[holds]], np.quantile(y[ok], [0, 1])).any()
    least = max(STUCK * count, LONGER * np.sort(lengths)[:-1].max(initial=1))
    for k in holds:
        part = slice(first[k] - 1, last[k] + 1)
        moved = grid.u[part].std(axis=0)
        is_long = least <= lengths[k] < count / 2 and (moved > MOVING * grid.u.std(axis=0)).any()
        stuck[part] = is_long or (is_frozen and moved.any())
    return stuck


LEFT_OUT = (  # and words for how many there are, when the first one is, and what it reads
    (
        _flag_spikes,
        f"{{}} readings beyond {SPIKE:g} times the usual size, or alone so far from both"
        " neighbours, are taken as missing, the first at {:.6g} s",
    ),
    (
        _flag_dropouts,
        "{} zeros that no output explains are dropouts, and taken as missing, the first at"
        " {:.6g} s",
    ),
    (
        _flag_stuck,
        "the reading is stuck at {2:.6g} from {1:.6g} s on; {0} such readings are taken as missing",
    ),
)

# --- The data of a fit

STRETCH = 250  # samples of an integrating plant that have one state at their start, or twice as
# many, and so on, until the plant settles within them
POLE = 20.0  # nats by which a pole beside the integrators is real
PER_NUMBER = 50  # readings needed for each pole, and one more
FEWEST_READINGS = 2 * PER_NUMBER
ZEROS = 0.01  # share of silent readings that shows noise ahead of the zone
LEAST = 1e-100  # of the largest value of a column, whose square must not vanish
OFTEN = 5  # times the next reading's count, by which a silence comes back
BLIPS = 0.025  # share of zeros between which a single other reading shows noise behind the zone
FAR_EDGE = 100.0  # rms of y: an edge that does not exist
SIDES = {"right": 1, "left": -1}
NEAREST = 20  # passages of an edge whose least readings tell the density there
FEWEST = 4
SURE = 0.05  # probability that the edge lies below its interval
SUREST = 0.001  # and below the range that an observer is told


class JumpEdge(NamedTuple):
    """Edge of a jump sensor with intervals.

    Attributes:
        value, low, high: the edge with its 95 % interval.
        lowest: the low end of its 99.9 % interval, whose high end is the same.
    """

    value: float
    low: float
    high: float
    lowest: float


class PreparedLog(NamedTuple):
    """Log prepared for a fit.

    Attributes:
        options: of the user.
        data: scaled records.
        limits: of the widths, scaled.
        orders: orders that the log is long enough for.
        quantum: smallest common spacing of the readings, scaled; 0 if there is none.
        remarks: on each change, for the user.
        at_ends: readings at the ends of their range (N), of the whole log.
        ends: of the range, at which readings stick.
        jumps: right and left edge of a jump sensor, scaled; None for a dead zone.
        settles: whether an integrating plant's other poles settle within a record.
    """

    options: Options
    data: RecordData
    limits: WidthLimits
    orders: list[int]
    quantum: float
    remarks: list[str]
    at_ends: Flags
    ends: RangeEnds
    jumps: tuple[JumpEdge, JumpEdge] | None = None
    settles: bool = True


def prepare_log(grid: Grid, options: Options) -> PreparedLog:
    """Prepare the data of a fit.

    Args:
        grid: the log on its grid.
        options: of the user.

    Returns:
        Data scaled to rms 1, limits of the widths, orders to try.

    Raises:
        InputError: a log from which nothing can be learnt: too short, a constant input, a reading
            that never changes or is silent throughout, or vanishes once squared.
    """
    remarks = list(grid.remarks)
    ok, at_ends, ends = select_readings(grid, remarks)
    y = np.where(ok, grid.y, 0.0)
    threshold = 0.5 * grid.quantum * (1 - 1e-9)
    if options.threshold is not None:
        threshold = options.threshold
    side = 1 * (y > threshold) - 1 * (y < -threshold)
    orders = _require_order(int(ok.sum()), options, remarks)
    _require_informative(grid, y[ok], side)
    ahead = _is_noise_ahead(y[ok], side[ok] == 0, options)
    u_scale, y_scale = grid.u.std(axis=0), root_mean_square(y[ok])
    u = grid.u / u_scale
    data = RecordData(u, y / y_scale, ok, grid.start, side, ahead, u_scale, y_scale)
    settles = True
    if options.integrators:
        length, settles = _settled_length(data, orders, options.integrators)
        data = data._replace(start=_first_samples(data.start, y.size, length))
        remarks.append(
            "disturbances add up in an integrating plant: the log is taken as"
            f" {data.start.size} records with a state of their own each"
        )
    data = data._replace(climbs=grid.climbs)
    if options.kind == "jump":
        data, limits, jumps = to_dead_zone_data(data, options)
    else:
        limits, jumps = _width_limits(data, options), None
    return PreparedLog(
        options=options,
        data=data,
        limits=limits,
        orders=orders,
        quantum=grid.quantum / y_scale,
        remarks=remarks,
        at_ends=at_ends,
        ends=ends,
        jumps=jumps,
        settles=settles or jumps is not None,
    )


def find_silent_level(grid: Grid) -> float:
    """Return the reading that comes back as often as inside a zone [y]; 0 if none does."""
    y = grid.y[grid.ok]
    values, counts = np.unique(y, return_counts=True)
    if values.size < 3:
        return 0.0
    next_most, most = np.argsort(counts)[-2:]
    value, count = float(values[most]), counts[most]
    low, high = np.quantile(y[y != value], [0.05, 0.95])
    returns = low < value < high and bounds_of_runs(grid.ok & (grid.y == value))[0].size > 1
    is_often = count > max(ZEROS * y.size, OFTEN * counts[next_most])
    return value if returns and is_often else 0.0


def require_readings(count: int, remarks: str = "", order: int = 1) -> None:
    """Require as many readings as the smallest plant needs. Raise InputError.

    Args:
        count: of readings.
        remarks: on readings that are left out.
        order: of the plant.
    """
    needed = PER_NUMBER * (order + 1)
    if count < needed:
        raise InformationError(
            f"log: {count} readings are too few. Order {order} needs {needed}{remarks}"
        )


def _require_informative(grid: Grid, y: Floats, side: Integers) -> None:
    """Require a log that contains information on plant and zone.

    Args:
        grid: the log.
        y: the readings that there are.
        side: of all samples (N).

    Raises:
        InputError: information is lacking.
    """
    for size in (*np.abs(grid.u).max(axis=0, initial=0.0), np.abs(y).max()):
        if 0 < size < LEAST:
            raise InputError(f"log: values of {size:.3g} vanish once squared. Use another unit")
    moves = grid.u.std(axis=0) > 1e-12 * np.abs(grid.u).max(axis=0, initial=0.0)
    if not moves.any():
        raise InformationError("log: the input is constant: nothing can be learnt about the plant")
    if not moves.all():
        name = grid.inputs[np.argmin(moves)]
        raise InputError(f"log: input {name!r} is constant. Leave it out by --columns")
    if not side.any():
        raise InformationError("log: the sensor is always silent. Record with a larger input")
    if np.ptp(y) <= 1e-12 * np.abs(y).max():
        stays = f"{grid.output!r} never changes ({y[0]:.4g}), while {grid.inputs[0]!r} moves by"
        raise InformationError(
            f"log: {stays} {np.ptp(grid.u[:, 0]):.3g}: nothing can be known from it. Is it the"
            " right column, and its sensor alive? Else record with a larger input"
        )


def feasible_orders(count: int, options: Options) -> list[int]:
    """Return the requested orders that a number of readings allows."""
    return [n for n in options.parse_orders() if count >= PER_NUMBER * (n + 1)]


def _require_order(count: int, options: Options, remarks: list[str]) -> list[int]:
    """Return the orders that the number of readings allows. Raise InputError."""
    requested, orders = options.parse_orders(), feasible_orders(count, options)
    require_readings(count, "; ".join(["", *remarks]), requested[0])
    if len(orders) < len(requested):
        remarks.append(
            f"the log is long enough for order {orders[-1]} at most ({PER_NUMBER} readings a pole)"
        )
    return orders


def _is_noise_ahead(y: Floats, silent: Flags, options: Options) -> bool:
    """Return whether noise acts ahead of the zone, so that readings inside are exact zeros."""
    if options.noise == "before" and not silent.any():
        raise InputError(
            "noise: before the zone means exact zeros inside it, and no reading is silent. Give"
            " --threshold, or --noise after"
        )
    if options.noise != "auto":
        return options.noise == "before"
    lasts = options.threshold is not None or _has_lasting_zeros(y)
    return bool(lasts and silent.sum() > ZEROS * silent.size)


def _has_lasting_zeros(y: Floats) -> bool:
    """Return whether 0 recurs and lasts; noise would round to neighbouring values as well."""
    values, place = np.unique(y, return_inverse=True)
    beside = np.abs(place - np.searchsorted(values, 0.0)) == 1
    zeros = y == 0
    blips = beside[1:-1] & zeros[:-2] & zeros[2:]
    return bool(zeros.sum() > max(OFTEN * beside.sum() / 2, blips.sum() / BLIPS))


def _settled_length(data: RecordData, orders: list[int], integrators: int) -> tuple[int, bool]:
    """Return samples of a stretch in which the poles of a linear plant settle, and if they do.

    Args:
        data: whole records.
        orders: that will be tried.
        integrators: of the plant.
    """
    order = max(integrators + 1, min(orders))
    length = STRETCH
    most = np.diff(data.start, append=data.y.size).max()
    while True:
        cut = data._replace(start=_first_samples(data.start, data.y.size, length))
        fit = fit_linear(PlantSimulator(cut, order, integrators), data.ok)
        if not fit.objective.simulator.is_at_limit(fit.theta):
            return length, True
        if length >= most:
            plain = fit_linear(PlantSimulator(cut, integrators, integrators), data.ok)
            return length, fit.value - plain.value < POLE
        length *= 2


def _first_samples(start: Integers, size: int, length: int) -> Integers:
    """Return first samples of stretches of about so many samples of each record."""
    sizes = np.diff(start, append=size)
    counts = np.fmax(np.rint(sizes / length), 1).astype(int)
    records = zip(start, sizes, counts, strict=True)
    return np.concatenate([first + np.arange(n) * long // n for first, long, n in records])


def _width_limits(data: RecordData, options: Options) -> WidthLimits:
    """Return the limits of the widths, scaled; a missing edge is placed far away."""
    right, left = (_scaled_bounds(data, options, name) for name in SIDES)
    tied = options.integrators > 0 and options.right is None and options.left is None
    return WidthLimits(right, left, tied=tied)


def _scaled_bounds(data: RecordData, options: Options, name: str) -> tuple[float, float]:
    """Return the bounds of a width, scaled; a missing edge is far away. Raise InputError."""
    low, high = options.parse_bounds(name)
    if low < math.inf:
        return low / data.y_scale, high / data.y_scale
    if np.any(data.side[data.ok] == SIDES[name]):
        raise InputError(f"{name}: inf means that no edge exists, but readings lie beyond it")
    return FAR_EDGE, FAR_EDGE


# --- The edges of a jump sensor


def to_dead_zone_data(
    data: RecordData, options: Options
) -> tuple[RecordData, WidthLimits, tuple[JumpEdge, JumpEdge]]:
    """Convert readings of a jump sensor to those of a dead zone of known widths.

    Args:
        data: records, scaled, with exact zeros.
        options: of the user; known edges are taken as they are.

    Returns:
        The records, limits that hold the edges, and the edges with 95 % intervals, scaled.

    Raises:
        InputError: there are no exact zeros, an edge is hardly passed, or a given one contradicts
            the readings.
    """
    if not data.silent_zeros:
        raise InputError(
            "kind: a jump sensor is silent inside its zone, and these readings have no exact zeros."
            " Give --threshold, |y| up to which a reading counts as silent"
        )
    right, left = (_estimate_edge(data, name, options) for name in SIDES)
    shift = zone_offset(data.side, right.value, left.value)
    limits = WidthLimits((right.value, right.value), (left.value, left.value))
    return data._replace(y=(data.y - shift) * (data.side != 0)), limits, (right, left)


def has_jump_edges(data: RecordData) -> bool:
    """Return whether readings show the edges of a jump sensor: each side is never met, or often.

    Args:
        data: records, scaled.
    """
    passages = [_least_by_passage(data, sign).size for sign in SIDES.values()]
    return data.silent_zeros and all(not size or size >= FEWEST for size in passages)


def _estimate_edge(data: RecordData, name: str, options: Options) -> JumpEdge:
    """Estimate an edge with its intervals, scaled. Raise InputError."""
    least = _least_by_passage(data, SIDES[name])
    low, high = _scaled_bounds(data, options, name)
    if low == high and least.size and least[0] < low * (1 - 1e-9):
        given, found = low * data.y_scale, least[0] * data.y_scale
        raise InputError(f"{name}: {given:g} is given, but a reading of {found:.6g} lies below it")
    if low == high or not least.size:
        return JumpEdge(*[low if low == high else FAR_EDGE] * 4)
    if least.size < FEWEST:
        raise InputError(
            f"log: the {name} edge of the jump sensor is passed {least.size} times, and"
            f" {FEWEST} are needed. Record for longer, or give --{name}"
        )
    return jump_edge_below(least)


def jump_edge_below(least: Floats) -> JumpEdge:
    """Estimate the edge below the least readings of several passages.

    With k of them evenly spread above the edge d, (k - 1) / (x_k - x_1) is the density, and x_1 - d
    over their spread has the distribution of a ratio of gamma variables: F with 2 and 2 (k - 1)
    degrees of freedom.

    Args:
        least: least reading of each passage, sorted (at least 2).

    Returns:
        The edge without bias, and its intervals, which end at the least reading.
    """
    from scipy.stats import f

    used = least[: min(NEAREST, max(FEWEST, least.size // 4))]
    k = used.size
    gap = float(np.ptp(used)) / (k - 1)  # mean spacing: x_1 - d is one more
    first = float(used[0])
    low, lowest = first - gap * f.ppf(1 - np.array([SURE, SUREST]), 2, 2 * (k - 1))
    return JumpEdge(first - gap, float(low), first, float(lowest))


def _least_by_passage(data: RecordData, sign: int) -> Floats:
    """Return the least abs(reading) of each passage of an edge, sorted; a visit has two
    passages.
    """
    beyond = data.ok & (data.side == sign)
    first, last = bounds_of_runs(beyond)
    size = np.abs(data.y)
    return np.sort(np.concatenate([size[first], size[last[last > first]]]))
