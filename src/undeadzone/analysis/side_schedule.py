"""Which side the sensor shows when: the schedule of sides along a planned reference or a recorded run (docs/rates.md)."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import steady_state
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, edges, zone
from undeadzone.signals.exosystem import Exosystem
from undeadzone.support.arrays import Floats

ROUNDING = 1e-12  # of a signal's size: nearer to a level than this it neither crosses nor leaves it
PERIODS = 50  # after which a sampled reference must repeat to count as periodic
BISECTIONS = 54  # halve an interval down to the rounding of its ends
MEAN = 4096  # points of the mean over a period: exact for sines below that many cycles


class Schedule(NamedTuple):
    """Constant sides one after another: sides (K x p) of +1, 0, -1, each for spans (K), in seconds or in samples of Ts [s].

    periodic: the whole repeats; grain: what a span is accurate to (0: exact). low, mean, high (p): of the true output z;
    levels (p x 2): the side reads right above levels[:, 0] and left below -levels[:, 1].
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

    @property
    def duration(self) -> float:
        """Of the whole [s]."""
        return float(self.spans.sum()) * (1.0 if self.Ts is None else self.Ts)

    def visited(self, samples: int = 0) -> np.ndarray:
        """Whether the [right, left] side of each output (p x 2) lasts, in all, for more than that many samples, if it is sampled."""
        return np.stack(
            [self.spans @ (self.sides == side) > samples * self.grain for side in (1.0, -1.0)],
            axis=1,
        )


def planned(
    model: System, reference: Exosystem, tracked: list[int], sensor: Zone, horizon: float
) -> Schedule:
    """The schedule of a reference that is followed exactly, over its period, or over `horizon` [s] if it has none.

    In continuous time the sides change at roots of the exact signal; sampled, the sides are those at the samples. Spans
    end at corners of the reference too. Raises TrackingError where the reference cannot be followed, InputError for a
    nonlinear model with untracked outputs.
    """
    rows = output_map(model, reference, tracked)
    levels = reading_levels(sensor)
    if model.Ts is not None:
        samples, periodic = _samples(reference.period, model.Ts, horizon)
        z = reference.state(np.arange(samples) * model.Ts) @ rows.T
        repeats = np.arange(
            0 if reference.period is None else samples * model.Ts / reference.period
        )
        corners = (
            reference.corners
            if reference.period is None
            else np.add.outer(repeats * reference.period, reference.corners).ravel()
        )
        return _from_samples(zone(z, *levels.T), z, levels, model.Ts, model.Ts, periodic, corners)
    end = horizon if reference.period is None else reference.period
    ends = np.unique(
        np.concatenate(
            [[0.0], reference.corners[(reference.corners > 0) & (reference.corners < end)], [end]]
        )
    )
    changes = [
        roots(reference, row, level, ends)
        for row, pair in zip(rows, levels, strict=True)
        for level in (pair[0], -pair[1])
    ]
    times = np.unique(np.concatenate([ends, *changes]))
    times = times[np.concatenate([np.diff(times) > ROUNDING * end, [True]])]
    z = reference.state((times[:-1] + times[1:]) / 2) @ rows.T
    low, high = extremes(reference, rows, ends)
    mean = (reference.state((np.arange(MEAN) + 0.5) / MEAN * end) @ rows.T).mean(axis=0)
    return Schedule(
        zone(z, *levels.T),
        np.diff(times),
        None,
        reference.period is not None,
        0.0,
        low,
        mean,
        high,
        levels,
    )


def recorded(z: Floats, sensor: Zone, step: float, Ts: float | None) -> Schedule:
    """The schedule of a record of outputs z (N x p), true or estimated, `step` [s] apart.

    In continuous time (Ts None) a side is taken to change half way between two samples.
    """
    levels = reading_levels(sensor)
    return _from_samples(zone(z, *levels.T), z, levels, step, Ts, False, np.empty(0))


def reading_levels(sensor: Zone) -> Floats:
    """(p x 2): a noise-free sensor reads right above levels[:, 0] and left below -levels[:, 1] of z."""
    return np.stack(
        edges(sensor.right, sensor.left, sensor.slope, sensor.kind, sensor.threshold), axis=1
    )


def merged(schedule: Schedule) -> Schedule:
    """The same schedule with neighbours of equal sides put together."""
    first = np.concatenate([[True], (np.diff(schedule.sides, axis=0) != 0).any(axis=1)])
    return schedule._replace(
        sides=schedule.sides[first], spans=np.add.reduceat(schedule.spans, np.flatnonzero(first))
    )


def output_map(model: System, reference: Exosystem, tracked: list[int]) -> Floats:
    """(p x k) such that z = output_map w while the reference is followed. Raises TrackingError, InputError."""
    rows = np.zeros((model.p, reference.S.shape[0]))
    if len(tracked) < model.p:
        if model.nonlinear:
            raise InputError("tracked: a plan for a nonlinear plant must track every output")
        rows = model.linear.C @ steady_state(model, reference, tracked)[0]
    elif not model.nonlinear:
        steady_state(model, reference, tracked)
    rows[tracked] = reference.Q
    return rows


def roots(reference: Exosystem, row: Floats, level: float, ends: Floats) -> Floats:
    """Every time between ends[0] and ends[-1] at which row w meets the level; w may jump at the ends given.

    Intervals are halved until the exact signal and a bound on its second derivative show that one holds no root, or
    that the signal is monotone on it; then bisection. Only a visit beyond the level by less than 1e-12 of the signal
    can be missed.
    """
    S = reference.S
    slope, curvature = row @ S, np.abs(row @ S @ S)
    fastest = float(np.abs(np.linalg.eigvals(S)).max(initial=0.0))
    pieces = np.maximum(1, np.ceil(np.diff(ends) * fastest)).astype(int)
    half = np.repeat(np.diff(ends) / pieces / 2, pieces)
    middle = np.concatenate(
        [
            a + (b - a) * (np.arange(k) + 0.5) / k
            for a, b, k in zip(ends[:-1], ends[1:], pieces, strict=True)
        ]
    )
    found = []
    while middle.size:
        w = reference.state(middle)
        f, reach = w @ row - level, _reach(np.abs(S), float(half.max()))
        tangent, bend = np.abs(w @ slope) * half, np.abs(w) @ (curvature @ reach) * half**2
        rounding = ROUNDING * (np.abs(w) @ np.abs(row) + abs(level))
        open_ = (np.abs(f) <= tangent + bend / 2) & (tangent + bend > rounding)
        monotone = open_ & (tangent > bend)
        found.append(_bisect(reference, row, level, middle[monotone], half[monotone]))
        middle, half = middle[open_ & ~monotone], half[open_ & ~monotone] / 2
        middle, half = np.concatenate([middle - half, middle + half]), np.tile(half, 2)
    return np.sort(np.concatenate([np.empty(0), *found]))


def extremes(reference: Exosystem, rows: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """(least, greatest) value of every row w between ends[0] and ends[-1]."""
    low, high = [], []
    for row in rows:
        t = np.concatenate([ends, roots(reference, row @ reference.S, 0.0, ends)])
        z = reference.state(t) @ row
        low.append(z.min())
        high.append(z.max())
    return np.array(low), np.array(high)


def _bisect(
    reference: Exosystem, row: Floats, level: float, middle: Floats, half: Floats
) -> Floats:
    a, b = middle - half, middle + half

    def above(t: Floats) -> Any:
        return reference.state(t) @ row > level

    crossing = above(a) != above(b)
    a, b = a[crossing], b[crossing]
    first = above(a)
    for _ in range(BISECTIONS):
        middle = (a + b) / 2
        left = above(middle) == first
        a, b = np.where(left, middle, a), np.where(left, b, middle)
    return (a + b) / 2


def _reach(S: Floats, half: float) -> Floats:
    """A bound, entry by entry, on e^{S t} for |t| <= half: e^{|S| half}."""
    from scipy.linalg import expm

    return np.asarray(expm(S * half))


def _samples(period: float | None, Ts: float, horizon: float) -> tuple[int, bool]:
    """How many samples make a period (of several, if it takes these), else the horizon; and which of the two it is."""
    if period is not None:
        ratio = Fraction(period / Ts).limit_denominator(PERIODS)
        if ratio > 0 and abs(period / Ts - ratio) < 1e-9 * ratio:
            return ratio.numerator, True
    return max(1, round(horizon / Ts)), False


def _from_samples(
    side: Floats,
    z: Floats,
    levels: Floats,
    step: float,
    Ts: float | None,
    periodic: bool,
    corners: Floats,
) -> Schedule:
    """The schedule of sides at samples; sampled ones start a span at the first sample from each corner on, too."""
    starts = np.concatenate([[True], (np.diff(side, axis=0) != 0).any(axis=1)])
    after = np.ceil(corners / step - ROUNDING * len(side)).astype(int)
    starts[after[(after > 0) & (after < len(side))]] = True
    first = np.flatnonzero(starts)
    if Ts is None:
        changes = np.concatenate([[0.0], (first[1:] - 0.5) * step, [(side.shape[0] - 1) * step]])
        spans = np.diff(changes)
    else:
        spans = np.diff(np.append(first, side.shape[0])).astype(float)
    grain = step if Ts is None else 1.0
    with np.errstate(invalid="ignore", over="ignore"):  # a run that diverged has a schedule too
        return Schedule(
            side[first],
            spans,
            Ts,
            periodic,
            grain,
            z.min(axis=0),
            z.mean(axis=0),
            z.max(axis=0),
            levels,
        )
