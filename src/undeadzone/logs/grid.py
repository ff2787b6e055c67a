"""Samples put on the steps of a scenario: other steps are refused, gaps become missing samples."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.errors import FileError
from undeadzone.logs.samples import Lines, Samples
from undeadzone.support.arrays import Floats

TOLERANCE: Final = 0.01  # of the step: how far the usual time between samples may be from it
JITTER: Final = 0.25  # of the step: how far a sample may be from where it should be
LONGEST: Final = 100_000  # steps of a gap
MOST: Final = 10  # steps per sample, on average, in a block of samples
WATCHED: Final = 1000  # intervals whose median is compared with the step


class Regular(NamedTuple):
    """Samples one step apart.

    Attributes:
        t: times (N) [s].
        y: readings (N x p), NaN where one is missing.
        u: inputs (N x m), NaN where one is missing.
    """

    t: Floats
    y: Floats
    u: Floats


class Grid:
    """Puts samples on the steps of a scenario, block after block.

    Args:
        step: of the scenario [s].
        source: the log, for messages.

    Attributes:
        gaps: how many samples were missing altogether, between others.
        measured: the usual time between two samples [s]; None without times.
    """

    def __init__(self, step: float, source: str) -> None:
        self.gaps = 0
        self.measured: float | None = None
        self._step, self._source = step, source
        self._count = 0  # samples so far
        self._last: float | None = None  # time of the last sample [s]
        self._unread = 0  # lines since then that could not be read
        self._intervals: Floats = np.empty(0)  # the first ones [s]

    def place(self, samples: Samples, timed: bool) -> Regular:
        """The samples one step apart; those in gaps are missing.

        Args:
            samples: the next ones of the log.
            timed: whether they have times in seconds.

        Raises:
            FileError: they are another step apart, irregular, or go back in time.
        """
        if not timed:
            t = (self._count + np.arange(len(samples.t))) * self._step
            self._count += len(samples.t)
            return Regular(t, samples.y, samples.u)
        kept = np.isfinite(samples.t)  # what cannot be read shows as a gap in the others' times
        t, y, u = samples.t[kept], samples.y[kept], samples.u[kept]
        if not t.size:
            self._unread += kept.size
            return Regular(t, y, u)
        at = np.flatnonzero(kept)
        lines_between = np.diff(at, prepend=-1 - self._unread)
        self._unread = kept.size - 1 - int(at[-1])
        steps = self._steps(t, samples.lines[kept], lines_between)
        self._last = float(t[-1])
        return self._filled(t, y, u, steps)

    def _steps(self, t: Floats, lines: Lines, lines_between: Lines) -> Floats:
        """How many steps each sample is after the one before (N). Raises FileError.

        Args:
            t: times (N) [s].
            lines: number of each line in the log (N).
            lines_between: lines from the sample before to each (N), 1 where all could be read.
        """
        before = np.nan if self._last is None else self._last
        intervals = np.diff(t, prepend=before)
        if self._last is None:
            intervals[0] = self._step
        self._require_order(intervals, t, lines)
        of_a_line = intervals / lines_between
        self._require_step(of_a_line[1:] if self._last is None else of_a_line)
        steps = np.rint(intervals / self._step)
        off = np.abs(intervals - steps * self._step)
        bad = np.flatnonzero((steps < 1) | (off > JITTER * self._step) | (steps > LONGEST))
        if not bad.size and steps.sum() > LONGEST + MOST * t.size:
            raise FileError(
                f"{self._source}: consists of gaps: {steps.sum():.0f} steps are missing"
            )
        if bad.size:
            k = int(bad[0])
            raise FileError(
                f"{self._source}, line {lines[k]}: t = {t[k]:.9g} s is {intervals[k]:.6g} s after "
                f"the sample before; expected a multiple of the step, {self._step:g} s, and at "
                f"most {LONGEST} of them: bring the log onto regular steps (never by interpolating "
                "readings), or split it"
            )
        return steps

    def _require_order(self, intervals: Floats, t: Floats, lines: Lines) -> None:
        """Raise FileError where time does not increase."""
        back = np.flatnonzero(intervals <= 0)
        if back.size:
            k = int(back[0])
            raise FileError(
                f"{self._source}, line {lines[k]}: time does not increase: {t[k]:.9g} s after "
                f"{t[k] - intervals[k]:.9g} s; sort the lines, or give each run by itself"
            )

    def _require_step(self, intervals: Floats) -> None:
        """Raise FileError where samples are usually not one step apart."""
        if self._intervals.size >= WATCHED or not intervals.size:
            return
        self._intervals = np.append(self._intervals, intervals)[:WATCHED]
        usual = float(np.quantile(self._intervals, 0.5, method="lower"))  # gaps only lengthen
        self.measured = usual
        if abs(usual - self._step) <= TOLERANCE * self._step:
            return
        raise FileError(
            f"{self._source}: its samples are {usual:.6g} s apart, but the scenario's step is "
            f"{self._step:g} s: set simulation.step = {usual:.6g} if the log is right"
            f"{_unit_hint(usual / self._step)}"
        )

    def _filled(self, t: Floats, y: Floats, u: Floats, steps: Floats) -> Regular:
        """The samples, and missing ones in the gaps before them."""
        total = int(steps.sum())
        self._count += total
        self.gaps += total - t.size
        return filled(Regular(t, y, u), steps, self._step)


def filled(samples: Regular, steps: Floats, step: float) -> Regular:
    """Samples with missing ones in the gaps between them.

    Args:
        samples: in order.
        steps: how many steps each is after the one before (N), at least 1.
        step: [s].

    Returns:
        Samples one step apart; readings and inputs in gaps are NaN.
    """
    total = int(steps.sum())
    if total == samples.t.size:
        return samples
    at = np.cumsum(steps).astype(int) - 1
    full = Regular(
        np.full(total, np.nan),
        np.full((total, samples.y.shape[1]), np.nan),
        np.full((total, samples.u.shape[1]), np.nan),
    )
    for whole, part in zip(full, samples, strict=True):
        whole[at] = part
    following = at[np.searchsorted(at, np.arange(total))]
    behind = np.arange(total) - following  # steps before the next sample, 0 at samples
    full.t[:] = full.t[following] + behind * step
    return full


def _unit_hint(ratio: float) -> str:
    """What to do where the steps differ by a power of 1000: times in another unit, perhaps."""
    for power, unit in ((1000.0, "ms"), (1e6, "us"), (1e9, "ns")):
        if abs(ratio / power - 1) < TOLERANCE:
            return f"; if its times are in {unit}, say so in the header: t [{unit}]"
    return ""
