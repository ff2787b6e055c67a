"""Log as the input of the servo predictor: ticks with boundaries, or noisy readings.

Does the input answer to the readings? A loop shows in the change of u at a tick itself.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import f as fisher

from undeadzone.nonlinearities.play import levels
from undeadzone.util.arrays import Flags, Floats, Integers, shift_rows
from undeadzone_identify.logs.grid import common_spacing
from undeadzone_identify.models.least_squares import regression_residual
from undeadzone_identify.models.motion import last_reading_rows, reading_changes, white_noise_rms
from undeadzone_identify.servo.predictor import LATEST

LAGS = 10  # samples of the past that are taken out
OWN = 3  # changes of readings, of now and before, to which u may answer
OUTLIER = 5.0  # scatters of what the past leaves: steps of a reference are none of the loop's
NORMAL = 1.4826  # standard deviation of a Gaussian by its median deviation
LEAST = 3e-3  # of du, that the past must leave
SHARE = 0.01  # of what it leaves, that readings must explain
CHANCE = 1e-6  # p from which a loop is closed
STILL = 0.5  # share of changes that are 0, from which u is a list of steps


def tick_loop_p_value(u: Floats, y: Floats) -> float:
    """Return p of the effect of recent changes of y on changes of u, without feedback [1].

    1 if they explain hardly anything, or nothing can be told.

    Args:
        u: inputs (N).
        y: readings (N).
    """
    du = np.diff(u)
    dy = np.diff(y)
    if du.size < 11 * LAGS or np.mean(du == 0) > STILL:
        return 1.0
    acted = sliding_window_view(du, LAGS + 1)
    read = sliding_window_view(dy, LAGS + 1)[:, 1:]
    known = np.column_stack([np.ones(len(acted)), acted[:, :-1], read[:, :-OWN]])
    inliers = _inlier_rows(known, acted[:, -1])
    known, now, target = known[inliers], read[inliers, -OWN:], acted[inliers, -1]
    before = regression_residual(known, target)
    if np.std(before) < LEAST * np.std(target):
        return 1.0
    after = regression_residual(np.column_stack([known, now]), target)
    share: Any = 1 - (after @ after) / (before @ before)
    degrees = target.size - known.shape[1] - OWN
    ratio = share / max(1 - share, 1e-12) * degrees / OWN
    return float(fisher.sf(ratio, OWN, degrees)) if share > SHARE else 1.0


def _inlier_rows(columns: Floats, target: Floats) -> Flags:
    """Return the flags of rows without outliers (n)."""
    inliers = np.ones(target.size, bool)
    for _ in range(3):
        slopes = np.linalg.lstsq(columns[inliers], target[inliers], rcond=1e-10)[0]
        left = np.abs(target - columns @ slopes)
        inliers = left <= OUTLIER * NORMAL * np.median(left)
    return inliers


# --- What the predictor hears

USUAL = (5e-4, 0.05)  # of a servo [s]; other samples take as long as those in between
FEWEST = 20  # changes of readings that are worth a look
TURNING = 0.2  # share of changes that turn back, from which they are noise
MOVING = 0.005  # share of readings equal to the one before, below which exact ones are noise
REACH = 3.0  # of a Schmitt trigger, in standard deviations of the noise


class Observations(NamedTuple):
    """Scaled log as signals of the predictor.

    Attributes:
        step: sample time in the predictor's unit, in which rates lie about 1 to 100.
        seconds: sample time [s].
        u: inputs (N), rms 1.
        y: readings from the first one on (N), rms 1.
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        ticks: whether readings are ticks of an encoder, or exact.
        quantum: of an encoder; 0 of others.
        side: of each tick, 0 if none is (N).
        boundary: that a tick passed (N).
        u_scale, y_scale: divisors of u and y.
        loop: p of the dependence of the input on the readings, if no loop is closed.
    """

    step: float
    seconds: float
    u: Floats
    y: Floats
    ok: Flags
    start: Integers
    ticks: bool
    quantum: float
    side: Integers
    boundary: Floats
    u_scale: float
    y_scale: float
    loop: float

    @property
    def is_closed_loop(self) -> bool:
        """Return whether the input depends on the readings."""
        return self.loop < CHANCE

    @property
    def reversal_ticks(self) -> Flags:
        """Return the flags of ticks opposite to the previous tick of their record (N)."""
        at = np.flatnonzero(self.side)
        turned = np.zeros(self.side.size, bool)
        turned[at[1:]] = np.diff(self.side[at]) != 0
        return turned & ~self.first_ticks

    @property
    def first_ticks(self) -> Flags:
        """Return the flags of the first tick of each record (N)."""
        at = np.flatnonzero(self.side)
        record = np.searchsorted(self.start, at, side="right")
        return np.isin(np.arange(self.side.size), at[np.diff(record, prepend=-1) > 0])

    def kernel_inputs(self, counted: Flags) -> Floats:
        """Return the inputs of the kernel (N x inputs), with the counted samples (N)
        marked.
        """
        starts = np.isin(np.arange(self.u.size), self.start)
        late = np.column_stack([shift_rows(self.u, j, self.start) for j in range(LATEST + 1)])
        if not self.ticks:
            return np.column_stack([late, self.y, self.ok, starts, counted])
        ticks = [self.side, self.boundary, self.reversal_ticks, self.first_ticks]
        return np.column_stack([late, *ticks, starts, counted])

    def error_samples(self, free: bool) -> Flags:
        """Return the flags of samples with counted prediction errors (N)."""
        if not self.ticks:
            return self.ok & ~np.isin(np.arange(self.ok.size), self.start)
        counted = (self.side != 0) & ~self.first_ticks
        return counted & ~self.reversal_ticks if free else counted

    def busiest_part(self, most: int, least: int = 0) -> Observations:
        """Return the contiguous part with most reversals; the whole log if it is short
        enough.

        Args:
            most: samples.
            least: reversals; where so many samples have fewer, twice as many are taken, and so on.
        """
        ticked = self if self.ticks else to_schmitt_ticks(self)
        turned = np.cumsum(np.append(0, ticked.reversal_ticks))
        while most < self.u.size and np.max(turned[most:] - turned[:-most]) < least:
            most *= 2
        if self.u.size <= most:
            return self
        first = np.argmax(turned[most:] - turned[:-most])
        part = slice(first, first + most)
        inside = self.start[(self.start > first) & (self.start < first + most)] - first
        signals = ("u", "y", "ok", "side", "boundary")
        parts = {name: getattr(self, name)[part] for name in signals}
        return self._replace(start=np.append(0, inside), **parts)


def build_observations(
    u: Floats, y: Floats, ok: Flags, start: Integers, step: float
) -> Observations | None:
    """Build the predictor's signals from a log; None if nothing moves.

    Args:
        u: input (N).
        y: readings (N).
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        step: sample time [s].
    """
    u_scale = float(np.std(u))
    y_scale = float(np.std(y[ok]))
    if not (u_scale > 0 and y_scale > 0):
        return None
    level = float(y[ok][0])
    filled = ((y - level) / y_scale)[last_reading_rows(ok)]
    side = change_sides(filled, ok, start)
    at = np.flatnonzero(side)
    if at.size < FEWEST:
        return None
    spacing = common_spacing(np.unique(filled[ok]))
    turning = float(np.mean(side[at[1:]] != side[at[:-1]]))
    exact_enough = spacing > 0 or at.size < (1 - MOVING) * y.size
    ticks = turning < TURNING and exact_enough
    side = side * ticks
    return Observations(
        step=step if USUAL[0] <= step <= USUAL[1] else math.sqrt(USUAL[0] * USUAL[1]),
        seconds=step,
        u=u / u_scale,
        y=filled,
        ok=ok,
        start=start,
        ticks=ticks,
        quantum=spacing * ticks,
        side=side,
        boundary=filled - side * spacing / 2,
        u_scale=u_scale,
        y_scale=y_scale,
        loop=tick_loop_p_value(u, filled),
    )


def change_sides(y: Floats, ok: Flags, start: Integers) -> Integers:
    """Return the side of each change from the previous reading (N)."""
    change, known = reading_changes(y, ok, start)
    return np.where(known, np.sign(change), 0.0).astype(int)


def reading_noise_rms(log: Observations) -> float:
    """Return the rms of the white noise of readings, scaled."""
    return max(white_noise_rms(log.y + 10.0, log.ok, log.start), 1e-5)


def to_schmitt_ticks(log: Observations) -> Observations:
    """Convert noisy readings to ticks of a Schmitt trigger; the gap grows by 2 REACH of noise."""
    reach = REACH * reading_noise_rms(log)
    half = np.array([reach])
    play_output = levels(log.y, half, half, log.y[:1])
    spacing = 2 / REACH * reach
    steps = np.round(play_output / spacing) * spacing
    side = change_sides(steps, log.ok, log.start)
    return log._replace(
        ticks=True, quantum=spacing, side=side, boundary=steps - side * spacing / 2
    )  # fmt: skip
