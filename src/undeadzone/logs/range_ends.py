"""Limits of the measuring range of a log: largest or least readings, where readings saturate."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats, Integers

FEWEST = 10  # least number of readings at a limit
SHARE = 0.005  # least share of all readings at a limit
RUN = 5  # equal readings in a row that are a stop; also the readings over which speed is averaged
SPEED = 1e-3  # least speed before a stop, in a step, as a share of the range of the readings
SAME = 1e-9  # largest relative difference of readings at one limit
MOST_STOPS = 1000  # stops that are recorded: the first ones
VISIT = 3.0  # least mean number of readings in a row at a limit that noisy readings reach
ALIKE = 0.05  # largest share of repeated readings away from the limits if readings are noisy


class RangeEnds(NamedTuple):
    """Limits of a measuring range, at which readings saturate.

    Attributes:
        low, high: limits of the range [y]; -inf, inf if no reading saturates there.
        number: number of saturated readings.
    """

    low: float
    high: float
    number: int

    @property
    def has_ends(self) -> bool:
        """Return whether readings saturate at a limit of the range."""
        return self.number > 0

    @property
    def range_text(self) -> str:
        """Return the range in the syntax of a scenario file, [low, high]."""
        return f"[{self.low:.9g}, {self.high:.9g}]"

    def find_readings_at_ends(self, y: Floats, ok: np.ndarray) -> np.ndarray:
        """Return flags of the saturated readings (N, bool).

        Args:
            y: readings (N) [y].
            ok: flags of the readings that are not missing (N, bool).
        """
        return ok & (_is_at(y, self.high) | _is_at(-y, -self.low))


class RunningEnds:
    """Detector of the limits of a range for readings that arrive block by block."""

    SAVED: Final = ("_upper", "_lower")

    def __init__(self) -> None:
        self._upper = _UpperLimit()
        self._lower = _UpperLimit()

    def add(self, y: Floats, ok: np.ndarray) -> None:
        """Update the detector with the next block of readings.

        Args:
            y: readings (N) [y].
            ok: flags of the readings that are not missing (N, bool).
        """
        self._upper.add(y, ok)
        self._lower.add(-y, ok)

    def find_range_ends(self, quantum: float = 0.0) -> RangeEnds:
        """Return the limits of the range at which readings saturate, -inf and inf without limits.

        Readings repeat at a limit. They also repeat at the turning point of a slow motion, but
        there the motion before has no speed. Therefore the readings must reach a limit with at
        least the share `SPEED` of their range per step, and with 3 quanta. Noisy readings repeat
        only at a limit.

        Args:
            quantum: quantum of the readings [y]; 0: none.
        """
        upper = self._upper
        lower = self._lower
        least_speed = max(SPEED * (upper.top + lower.top), 3 * quantum)
        low = -np.inf
        high = np.inf
        count = 0
        if upper.is_limit(least_speed):
            high = upper.top
            count = upper.count
        if lower.is_limit(least_speed):
            low = -lower.top
            count = count + lower.count
        return RangeEnds(low, high, count)


def range_ends(y: Floats, ok: np.ndarray, quantum: float) -> RangeEnds:
    """Return the limits at which the readings of a whole log saturate.

    Args:
        y: readings (N) [y].
        ok: flags of the readings that are not missing (N, bool).
        quantum: quantum of the readings [y]; 0: none.

    See Also:
        `RunningEnds.find_range_ends`.
    """
    running = RunningEnds()
    running.add(y, ok)
    return running.find_range_ends(quantum)


class _UpperLimit:
    """Statistics of the largest reading so far, which may be the upper limit of the range.

    Attributes:
        top: the largest reading [y].
        count: number of readings equal to it.
    """

    SAVED: Final = (
        *("top", "count", "_total", "_before", "_speed", "_y", "_ok"),
        *("_bottom", "_alike", "_elsewhere", "_visits", "_steps"),
    )

    def __init__(self) -> None:
        self.top = -np.inf
        self.count = 0
        self._total = 0
        self._before: list[float] = []  # last reading before each stop
        self._speed: list[float] = []  # mean step before each stop
        self._y: Floats = np.empty(0)  # last readings of the previous block
        self._ok = np.empty(0, bool)
        self._bottom = np.inf  # least reading so far
        self._elsewhere = 0  # number of readings at neither end and not 0
        self._alike = 0  # number of these that equal the previous reading
        self._visits = 0  # number of arrivals at the limit
        self._steps: list[float] = []  # last step of each arrival

    def add(self, y: Floats, ok: np.ndarray) -> None:
        """Update the statistics with the next block of readings (N) and their flags (N)."""
        self._total += int(ok.sum())
        top = float(y[ok].max(initial=-np.inf))
        if top > self.top:
            if self.top < top * (1 - SAME) or top <= 0:
                self.count = self._visits = 0
                self._before = []
                self._speed = []
                self._steps = []
            self.top = top
        self.count += int((ok & _is_at(y, self.top)).sum())
        self._count_steps(np.append(self._y[-1:], y), np.append(self._ok[-1:], ok))
        y = np.concatenate([self._y, y])
        ok = np.concatenate([self._ok, ok])
        if len(self._before) < MOST_STOPS and self.top > 0:
            first = _first_of_runs(ok & _is_at(y, self.top), ok)[: MOST_STOPS - len(self._before)]
            self._before += y[first - 1].tolist()
            self._speed += ((y[first - 1] - y[first - RUN]) / (RUN - 1)).tolist()
        last = 2 * RUN - 1  # no stop lies in these alone
        self._y = y[-last:]
        self._ok = ok[-last:]

    def _count_steps(self, y: Floats, ok: np.ndarray) -> None:
        """Update the counts of arrivals at the limit, and of repeated readings away from it.

        Args:
            y: readings (N) [y], the first being the last one of the previous block.
            ok: flags of the readings that are not missing (N, bool).
        """
        self._bottom = min(self._bottom, float(y[ok].min(initial=np.inf)))
        known = ok[1:] & ok[:-1]  # steps between two readings
        at_limit = _is_at(y, self.top)
        arrives = known & at_limit[1:] & ~at_limit[:-1]
        self._visits += int(arrives.sum())
        self._steps += np.diff(y)[arrives][: MOST_STOPS - len(self._steps)].tolist()
        elsewhere = known & ~at_limit[1:] & (y[1:] != 0) & (y[1:] > self._bottom)
        self._elsewhere += int(elsewhere.sum())
        self._alike += int((elsewhere & (np.diff(y) == 0)).sum())

    def is_limit(self, least_speed: float) -> bool:
        """Return whether the largest reading is a limit of the range.

        It is if readings stop there suddenly, or if noisy readings stay there for several samples.

        Args:
            least_speed: least step of the readings before a sudden stop [y].
        """
        rare = self.count < max(FEWEST, SHARE * self._total)
        if rare or self.top <= 0 or not self._steps:
            return False
        noisy = self._alike <= ALIKE * self._elsewhere and self.count <= self._elsewhere
        if (
            noisy
            and self.count >= VISIT * self._visits
            and float(np.median(self._steps)) > least_speed
        ):
            return True
        if not self._before:
            return False
        speed = float(np.median(self._speed))
        rest = self.top - float(np.median(self._before))  # way that was left before the stop
        return speed > least_speed and rest < RUN / 2 * speed


def _is_at(y: Floats, top: float) -> np.ndarray:
    """Return flags of the readings (N) that equal the largest one (N, bool)."""
    return np.asarray(y >= top * (1 - SAME))


def _first_of_runs(at: np.ndarray, ok: np.ndarray) -> Integers:
    """Return the first index of each run of `RUN` readings at the limit.

    As many readings below the limit must precede it.

    Args:
        at: flags of the readings at the limit (N, bool).
        ok: flags of the readings that are not missing (N, bool).
    """
    if at.size < 2 * RUN:
        return np.empty(0, int)
    before = _all_in_a_row(ok & ~at)[:-RUN]
    after = _all_in_a_row(at)[RUN:]
    return np.flatnonzero(before & after) + RUN


def _all_in_a_row(flags: np.ndarray) -> np.ndarray:
    """Return flags of the places (N - RUN + 1) from which `RUN` flags (N) in a row are set."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(flags, RUN).all(axis=1))
