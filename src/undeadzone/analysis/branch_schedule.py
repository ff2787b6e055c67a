"""Schedules: the sensor's branch over time, along a planned reference or a recorded run.

Their use is described in docs/rates.md. A reference is the output Q w of an exosystem w' = S w.
Sides change when z crosses the levels between those that a noise-free sensor reads.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.nonlinearities.play import contacts, levels
from undeadzone.nonlinearities.sensor import Zone, edges, zone
from undeadzone.plants.system import System
from undeadzone.signals.exosystem import Exosystem
from undeadzone.util.arrays import Floats

ROUNDING = 1e-12  # of a signal's size: nearer to a level than this, it does not cross or leave it
PERIODS = 50  # after which a sampled reference must repeat to count as periodic
BISECTIONS = 54  # halve an interval down to the rounding of its ends
MEAN = 4096  # points of the mean over a period: exact for sines below that many cycles


class Schedule(NamedTuple):
    """Sequence of constant branches: K spans of p outputs.

    Attributes:
        sides: +1 (right), 0 (silent, or at a limit of the range), -1 (left) in each span (K x p).
        spans: how long each lasts (K), in seconds, or in samples if sampled.
        Ts: sample time [s] (None in continuous time).
        periodic: whether the whole repeats.
        grain: accuracy of a span in its unit (0: exact).
        low, mean, high: of the true output z (p each).
        levels: the side reads right above levels[:, 0] and left below -levels[:, 1] (p x 2).
        exact: share of the readings beyond an edge that are at no limit of the range (p) (None: all
            of them).
        contacts: of the play ahead of each dead zone in each span (K x p): +1 right, -1 left, 0 if
            the contact is held (None: there is none).
        repeats: how often each output stands in turn, its widths the same.
    """

    sides: Floats
    spans: Floats
    Ts: float | None
    periodic: bool
    grain: float
    low: Floats
    mean: Floats
    high: Floats
    levels: Floats
    exact: Floats | None = None
    contacts: Floats | None = None
    repeats: int = 1

    @property
    def total_duration(self) -> float:
        """Return the duration of the whole schedule [s]."""
        return float(self.spans.sum()) * (1.0 if self.Ts is None else self.Ts)

    def branch_visits(self, samples: int = 0) -> np.ndarray:
        """Return whether the [right, left] branch of each output is visited (p x 2, bool).

        Args:
            samples: a side counts if it lasts, in all, for more than this many (if sampled).
        """
        least = samples * self.grain
        right = self.spans @ (self.sides == 1.0) > least
        left = self.spans @ (self.sides == -1.0) > least
        return np.stack([right, left], axis=1)


def plan_schedule(
    model: System, reference: Exosystem, tracked: list[int], sensor: Zone, horizon: float
) -> Schedule:
    """Return the schedule of a reference that is followed exactly, over its period if that
    exists.

    In continuous time the sides change at roots of the exact signal. Sampled, the sides are those
    at the samples. Spans end at corners of the reference too.

    Args:
        model: the plant's model.
        reference: of the tracked outputs.
        tracked: which outputs these are.
        sensor: the dead zone.
        horizon: how long the schedule is [s] if the reference has no period.

    Raises:
        TrackingError: if the reference cannot be followed.
        InputError: for a nonlinear model with untracked outputs.
    """
    rows = output_map(model, reference, tracked)
    levels = reading_levels(sensor)
    if model.Ts is not None:
        return _plan_samples(rows, reference, sensor, model.Ts, horizon)
    periodic = reference.period is not None
    end = horizon if reference.period is None else reference.period
    inner = (reference.corners > 0) & (reference.corners < end)
    ends = np.unique(np.concatenate([[0.0], reference.corners[inner], [end]]))
    limits = limit_levels(sensor)
    every = [levels] if limits is None else [levels, limits]
    times = _change_times(reference, rows, every, ends)
    z = reference.state((times[:-1] + times[1:]) / 2) @ rows.T
    low, high = extreme_values(reference, rows, ends)
    mean = (reference.state((np.arange(MEAN) + 0.5) / MEAN * end) @ rows.T).mean(axis=0)
    read = noiseless_reading(z, sensor)
    spans = np.diff(times)
    exact = read.exact_share(spans)
    return Schedule(read.side, spans, None, periodic, 0.0, low, mean, high, levels, exact)


def _plan_samples(
    rows: Floats, reference: Exosystem, sensor: Zone, Ts: float, horizon: float
) -> Schedule:
    """Return `plan_schedule` at samples of Ts [s], with z = rows w (rows: p x k)."""
    samples, periodic = _count_samples(reference.period, Ts, horizon)
    z = reference.state(np.arange(samples) * Ts) @ rows.T
    corners = reference.corners
    if reference.period is not None:
        repeats = np.arange(samples * Ts / reference.period)
        corners = np.add.outer(repeats * reference.period, corners).ravel()
    read = noiseless_reading(z, sensor, periodic)
    return _schedule_from_samples(read, z, reading_levels(sensor), Ts, Ts, periodic, corners)


def _change_times(reference: Exosystem, rows: Floats, every: list[Floats], ends: Floats) -> Floats:
    """Return the distinct times at which a branch changes or the reference has a corner [s].

    Args:
        reference: of the tracked outputs.
        rows: z = rows w (p x k).
        every: levels of z (p x 2), [right, left].
        ends: corners of the reference [s].
    """
    times: list[Floats] = [ends]
    for one in every:
        for row, (right, left) in zip(rows, one, strict=True):
            times.append(level_crossing_times(reference, row, right, ends))
            times.append(level_crossing_times(reference, row, -left, ends))
    unique = np.unique(np.concatenate(times))
    apart = np.concatenate([np.diff(unique) > ROUNDING * ends[-1], [True]])
    return np.asarray(unique[apart])


def schedule_of_record(
    z: Floats, sensor: Zone, step: float, Ts: float | None, arrived: np.ndarray | None = None
) -> Schedule:
    """Return the schedule of a record of outputs.

    In continuous time a side is taken to change half way between two samples. A reading that did
    not arrive gives no side: it counts as a censored sample, like a reading at a limit of the
    range.

    Args:
        z: outputs (N x p), true or estimated.
        sensor: the dead zone.
        step: time between two rows [s].
        Ts: sample time [s] (None in continuous time).
        arrived: whether each reading did (N x p) (all of them if not given).
    """
    read = noiseless_reading(z, sensor)
    if arrived is not None:
        side = np.where(arrived, read.side, 0.0)
        read = NoiselessReading(side, read.limited & arrived, read.contact)
    return _schedule_from_samples(read, z, reading_levels(sensor), step, Ts, False, np.empty(0))


def drop_rare_branches(
    schedule: Schedule, dropout: Floats, step: float, duration: float, n: int
) -> Schedule:
    """Return the schedule without the branches from which too few readings can be expected.

    Args:
        schedule: of the sides.
        dropout: probability that a reading is missing (p).
        step: time between two readings [s].
        duration: for how long there are readings [s].
        n: how many readings are too few: as many as there are states.
    """
    if not dropout.any():
        return schedule
    passes = max(1.0, duration / schedule.total_duration)
    unit = step if schedule.Ts is None else 1.0
    sides = schedule.sides.copy()
    for sign in (1.0, -1.0):
        on_side = schedule.spans @ (sides == sign) / unit
        lost = passes * on_side * (1 - dropout) <= n
        sides[(sides == sign) & lost] = 0.0
    return schedule._replace(sides=sides)


def merge_equal_neighbours(schedule: Schedule) -> Schedule:
    """Return the schedule with neighbouring spans of equal branches merged. Contacts are
    dropped.
    """
    first = np.concatenate([[True], (np.diff(schedule.sides, axis=0) != 0).any(axis=1)])
    spans = np.add.reduceat(schedule.spans, np.flatnonzero(first))
    return schedule._replace(sides=schedule.sides[first], spans=spans, contacts=None)


def output_map(model: System, reference: Exosystem, tracked: list[int]) -> Floats:
    """Return the matrix (p x k) such that z = output_map w while the reference is followed.

    Raises:
        TrackingError: if the reference cannot be followed.
        InputError: for a nonlinear model with untracked outputs.
    """
    rows = np.zeros((model.p, reference.S.shape[0]))
    if len(tracked) < model.p:
        if model.nonlinear:
            raise InputError("tracked: a plan for a nonlinear plant must track every output")
        rows = model.linear.C @ steady_state(model, reference, tracked)[0]
    elif not model.nonlinear:
        steady_state(model, reference, tracked)
    rows[tracked] = reference.Q
    return rows


def level_crossing_times(reference: Exosystem, row: Floats, level: float, ends: Floats) -> Floats:
    """Return all times between ends[0] and ends[-1] at which row w meets the level [s].

    Intervals are halved until the exact signal and a bound on its second derivative show that one
    holds no root, or that the signal is monotone on it, then bisection. Only a visit beyond the
    level by less than 1e-12 of the signal can be missed.

    Args:
        reference: the exosystem of w.
        row: of the signal (k).
        level: to be met, in the signal's unit.
        ends: times [s], rising, at which w may jump.
    """
    S = reference.S
    slope = row @ S
    curvature = np.abs(row @ S @ S)
    middle, half = _initial_intervals(S, ends)
    times: list[Floats] = [np.empty(0)]
    while middle.size:
        w = reference.state(middle)
        f = w @ row - level
        reach = _exponential_bound(np.abs(S), float(half.max()))
        # By how much the signal changes on half an interval: by its slope, and by its bend at most.
        tangent = np.abs(w @ slope) * half
        bend = np.abs(w) @ (curvature @ reach) * half**2
        rounding = ROUNDING * (np.abs(w) @ np.abs(row) + abs(level))
        open_ = (np.abs(f) <= tangent + bend / 2) & (tangent + bend > rounding)
        monotone = open_ & (tangent > bend)
        times.append(_bisect_crossings(reference, row, level, middle[monotone], half[monotone]))
        middle = middle[open_ & ~monotone]
        half = half[open_ & ~monotone] / 2
        middle = np.concatenate([middle - half, middle + half])
        half = np.tile(half, 2)
    return np.sort(np.concatenate(times))


def _initial_intervals(S: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """Return (middles, half widths) of the first intervals [s], short for the fastest mode of
    S.
    """
    fastest = float(np.abs(np.linalg.eigvals(S)).max(initial=0.0))
    pieces = np.maximum(1, np.ceil(np.diff(ends) * fastest)).astype(int)
    half = np.repeat(np.diff(ends) / pieces / 2, pieces)
    middles: list[Floats] = []
    for a, b, k in zip(ends[:-1], ends[1:], pieces, strict=True):
        middles.append(a + (b - a) * (np.arange(k) + 0.5) / k)
    return np.concatenate(middles), half


def extreme_values(reference: Exosystem, rows: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """Return the (least, greatest) value of every row w between ends[0] and ends[-1] (p each)."""
    low = []
    high = []
    for row in rows:
        t = np.concatenate([ends, level_crossing_times(reference, row @ reference.S, 0.0, ends)])
        z = reference.state(t) @ row
        low.append(z.min())
        high.append(z.max())
    return np.array(low), np.array(high)


def _bisect_crossings(
    reference: Exosystem, row: Floats, level: float, middle: Floats, half: Floats
) -> Floats:
    """Return the crossing times on intervals with a monotone signal [s]. An interval may hold
    none.
    """
    a = middle - half
    b = middle + half

    def is_above_level(t: Floats) -> Any:
        """Return whether the signal is above the level at times t."""
        return reference.state(t) @ row > level

    crossing = is_above_level(a) != is_above_level(b)
    a = a[crossing]
    b = b[crossing]
    first = is_above_level(a)
    for _ in range(BISECTIONS):
        middle = (a + b) / 2
        left = is_above_level(middle) == first
        a = np.where(left, middle, a)
        b = np.where(left, b, middle)
    return (a + b) / 2


def _exponential_bound(S: Floats, half: float) -> Floats:
    """Return a bound by entries on e^(S t) for |t| <= half: e^(|S| half)."""
    from scipy.linalg import expm

    return np.asarray(expm(S * half))


def _count_samples(period: float | None, Ts: float, horizon: float) -> tuple[int, bool]:
    """Return (samples per period, True), or (samples of the horizon, False) without a period.

    Several periods count as a single period if their total is a whole number of samples.

    Several periods count as one if it takes these.
    """
    if period is not None:
        ratio = Fraction(period / Ts).limit_denominator(PERIODS)
        if ratio > 0 and abs(period / Ts - ratio) < 1e-9 * ratio:
            return ratio.numerator, True
    return max(1, round(horizon / Ts)), False


def _schedule_from_samples(
    read: NoiselessReading,
    z: Floats,
    levels: Floats,
    step: float,
    Ts: float | None,
    periodic: bool,
    corners: Floats,
) -> Schedule:
    """Return the schedule of noise-free readings (N x p) at samples, `step` [s] apart.

    Sampled, a span starts at the first sample from each corner on, too.
    """
    side = read.side
    starts = np.concatenate([[True], (np.diff(side, axis=0) != 0).any(axis=1)])
    if read.contact is not None:
        starts[1:] |= (np.diff(read.contact, axis=0) != 0).any(axis=1)
    after = np.ceil(corners / step - ROUNDING * len(side)).astype(int)
    starts[after[(after > 0) & (after < len(side))]] = True
    first = np.flatnonzero(starts)
    if Ts is None:
        grain = step
        changes = np.concatenate([[0.0], (first[1:] - 0.5) * step, [(side.shape[0] - 1) * step]])
        spans = np.diff(changes)
    else:
        grain = 1.0
        spans = np.diff(np.append(first, side.shape[0])).astype(float)
    with np.errstate(invalid="ignore", over="ignore"):  # a run that diverged has a schedule too
        low = z.min(axis=0)
        mean = z.mean(axis=0)
        high = z.max(axis=0)
        exact = read.exact_share(np.ones(len(side)))
        contact = None if read.contact is None else read.contact[first]
        return Schedule(
            side[first], spans, Ts, periodic, grain, low, mean, high, levels, exact, contact
        )


class NoiselessReading(NamedTuple):
    """Noise-free readings of outputs (N x p each).

    Attributes:
        side: +1, -1 if a reading is exact, else 0.
        limited: whether it is at a limit of its range.
        contact: of a play ahead of a dead zone, in which y moves (None: there is none).
    """

    side: Floats
    limited: np.ndarray
    contact: Floats | None = None

    def exact_share(self, weight: Floats) -> Floats:
        """Return the share of exact readings among all beyond an edge (p), or 1 if none is beyond.

        Args:
            weight: of each row (N), such as how long it lasts.
        """
        exact = weight @ (self.side != 0)
        beyond = exact + weight @ self.limited
        return np.asarray(np.where(beyond > 0, exact / np.where(beyond > 0, beyond, 1.0), 1.0))


def reading_levels(sensor: Zone) -> Floats:
    """Return the levels of z (p x 2): without noise, right above the first, left below
    -second.

    For a play they are its gaps: no level of z determines its side. For a play ahead of a dead zone
    they are the levels at which z moves outwards.
    """
    if sensor.kind == "play":
        return np.stack((sensor.right, sensor.left), axis=1)
    right, left = edges(sensor.right, sensor.left, sensor.slope, sensor.kind, sensor.threshold)
    return np.stack((right, left), axis=1) + _play_gaps(sensor)


def limit_levels(sensor: Zone) -> Floats | None:
    """Return the levels of z beyond which readings are at a limit of the range (p x 2), or None.

    A reading is at a limit above the first level and below -second. None means that the sensor
    has no range.
    """
    if sensor.limits is None:
        return None
    low, high = sensor.limits
    widths = sensor.right, sensor.left, sensor.slope, sensor.kind
    levels_of_zone = np.stack((edges(*widths, high)[0], edges(*widths, -low)[1]), axis=1)
    return np.asarray(levels_of_zone + _play_gaps(sensor))


def _play_gaps(sensor: Zone) -> Floats:
    """Return [c_r, c_l] of the play ahead of each dead zone (p x 2) [z], or 0 without a play."""
    if sensor.play is None:
        return np.zeros((sensor.right.size, 2))
    return np.stack((sensor.play.right, sensor.play.left), axis=1)


def noiseless_reading(z: Floats, sensor: Zone, again: bool = False) -> NoiselessReading:
    """Return the noise-free readings of outputs z (N x p).

    Args:
        z: outputs (N x p), one after the other.
        sensor: the dead zone.
        again: whether they repeat, so that a play had its first pass before.
    """
    limited = np.zeros(z.shape, bool)
    passes = np.concatenate([z, z]) if again else z
    if sensor.kind == "play":  # the side is that of the contact in which the level moves
        side = contacts(passes, sensor.right, sensor.left, sensor.start)[-len(z) :]
        if sensor.limits is not None:
            low, high = (limit / sensor.slope for limit in sensor.limits)
            limited = (z - sensor.right >= high) | (z + sensor.left <= low)
        return NoiselessReading(np.where(limited, 0.0, side), limited)
    gaps = _play_gaps(sensor)
    level = z
    contact = None
    if sensor.play is not None:  # exact beyond an edge, while the level moves
        play = sensor.play.right, sensor.play.left, sensor.start
        level, contact = (along(passes, *play)[-len(z) :] for along in (levels, contacts))
    side = zone(level, *(reading_levels(sensor) - gaps).T)
    limits = limit_levels(sensor)
    if limits is not None:
        limited = zone(level, *(limits - gaps).T) != 0
    silent = limited if contact is None else limited | (contact == 0)
    return NoiselessReading(np.where(silent, 0.0, side), limited, contact)
