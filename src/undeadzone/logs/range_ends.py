"""Whether readings of a log stick at their largest or least value: the limits of a range."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats, Integers

FEWEST = 10  # readings at a limit
SHARE = 0.005  # of all readings
RUN = 5  # readings in a row: so long they stick, and from so many their speed before is taken
SPEED = 1e-3  # of the range of the readings, by which they move in a step before they stick
SAME = 1e-9  # relative difference of readings at one limit
MOST_STOPS = 1000  # that are remembered: the first ones
VISIT = 3.0  # readings in a row at a limit on average, where noise leads there and back
ALIKE = 0.05  # of the readings elsewhere, those that are the one before: noise leaves none


class RangeEnds(NamedTuple):
    """Where readings stick.

    Attributes:
        low, high: least and largest reading; -inf, inf where readings do not stick there.
        number: of readings there.
    """

    low: float
    high: float
    number: int

    @property
    def has_ends(self) -> bool:
        """Return whether readings stick at either end."""
        return self.number > 0

    @property
    def range_text(self) -> str:
        """Return the range as a scenario has it."""
        return f"[{self.low:.9g}, {self.high:.9g}]"

    def find_readings_at_ends(self, y: Floats, ok: np.ndarray) -> np.ndarray:
        """Return whether each reading is at an end (N, bool).

        Args:
            y: readings (N).
            ok: whether there is a reading (N, bool).
        """
        return ok & (_is_at(y, self.high) | _is_at(-y, -self.low))


class RunningEnds:
    """Where readings stick that come in block after block."""

    KEPT: Final = ("_upper", "_lower")

    def __init__(self) -> None:
        self._upper, self._lower = _End(), _End()

    def add(self, y: Floats, ok: np.ndarray) -> None:
        """Take the next readings in.

        Args:
            y: readings (N).
            ok: whether there is a reading (N, bool).
        """
        self._upper.add(y, ok)
        self._lower.add(-y, ok)

    def find_range_ends(self, quantum: float = 0.0) -> RangeEnds:
        """Return the values at which readings stick on their way, as at the end of an amplifier.

        At the top of a slow or rounded motion readings are alike too; there they do not come to a
        sudden stop. Noise repeats no reading except at the end of the range.

        Args:
            quantum: of the readings; 0: none.
        """
        upper, lower = self._upper, self._lower
        least = max(SPEED * (upper.top + lower.top), 3 * quantum)
        low, high, count = -np.inf, np.inf, 0
        if upper.sticks(least):
            high, count = upper.top, upper.count
        if lower.sticks(least):
            low, count = -lower.top, count + lower.count
        return RangeEnds(low, high, count)


def range_ends(y: Floats, ok: np.ndarray, quantum: float) -> RangeEnds:
    """Return the values at which the readings of a whole log stick; see `RunningEnds.ends`.

    Args:
        y: readings (N).
        ok: whether there is a reading (N, bool).
        quantum: of the readings; 0: none.
    """
    running = RunningEnds()
    running.add(y, ok)
    return running.find_range_ends(quantum)


class _End:
    """The largest reading so far, how many are there, and how readings stopped there.

    Attributes:
        top: the largest reading.
        count: how many readings are there.
    """

    KEPT: Final = (
        *("top", "count", "_total", "_before", "_speed", "_y", "_ok"),
        *("_bottom", "_alike", "_elsewhere", "_visits", "_steps"),
    )

    def __init__(self) -> None:
        self.top = -np.inf
        self.count = 0
        self._total = 0
        self._before: list[float] = []  # reading before each stop
        self._speed: list[float] = []  # per step, before each stop
        self._y: Floats = np.empty(0)  # the last ones of the block before
        self._ok = np.empty(0, bool)
        self._bottom = np.inf  # least reading so far
        self._elsewhere = self._alike = 0  # at neither end and not 0; as the one before
        self._visits = 0  # to the limit
        self._steps: list[float] = []  # to the limit

    def add(self, y: Floats, ok: np.ndarray) -> None:
        """Take the next readings in."""
        self._total += int(ok.sum())
        top = float(y[ok].max(initial=-np.inf))
        if top > self.top:
            if self.top < top * (1 - SAME) or top <= 0:
                self.count = self._visits = 0
                self._before, self._speed, self._steps = [], [], []
            self.top = top
        here = ok & _is_at(y, self.top)
        self.count += int(here.sum())
        self._add_steps(np.append(self._y[-1:], y), np.append(self._ok[-1:], ok))
        y = np.concatenate([self._y, y])
        ok = np.concatenate([self._ok, ok])
        if len(self._before) < MOST_STOPS and self.top > 0:
            first = _first_of_runs(ok & _is_at(y, self.top), ok)[: MOST_STOPS - len(self._before)]
            self._before += y[first - 1].tolist()
            self._speed += ((y[first - 1] - y[first - RUN]) / (RUN - 1)).tolist()
        last = 2 * RUN - 1  # no stop lies in these alone
        self._y, self._ok = y[-last:], ok[-last:]

    def _add_steps(self, y: Floats, ok: np.ndarray) -> None:
        """Take steps to the limit in, and readings elsewhere that are the one before."""
        self._bottom = min(self._bottom, float(y[ok].min(initial=np.inf)))
        both, at = ok[1:] & ok[:-1], _is_at(y, self.top)
        enters = both & at[1:] & ~at[:-1]
        self._visits += int(enters.sum())
        self._steps += np.diff(y)[enters][: MOST_STOPS - len(self._steps)].tolist()
        elsewhere = both & ~at[1:] & (y[1:] != 0) & (y[1:] > self._bottom)
        self._elsewhere += int(elsewhere.sum())
        self._alike += int((elsewhere & (np.diff(y) == 0)).sum())

    def sticks(self, least: float) -> bool:
        """Return whether readings come to a sudden stop at the top, or noise leads there and back.

        Args:
            least: by which they move in the step before they stick, at least.
        """
        rare = self.count < max(FEWEST, SHARE * self._total)
        if rare or self.top <= 0 or not self._steps:
            return False
        noisy = self._alike <= ALIKE * self._elsewhere and self.count <= self._elsewhere
        if noisy and self.count >= VISIT * self._visits and float(np.median(self._steps)) > least:
            return True
        if not self._before:
            return False
        speed = float(np.median(self._speed))
        rest = self.top - float(np.median(self._before))
        return speed > least and rest < RUN / 2 * speed


def _is_at(y: Floats, top: float) -> np.ndarray:
    """Return whether each reading is at the largest one (N, bool)."""
    return np.asarray(y >= top * (1 - SAME))


def _first_of_runs(at: np.ndarray, ok: np.ndarray) -> Integers:
    """Return the starts of runs of `RUN` readings at the limit, after as many that are not."""
    if at.size < 2 * RUN:
        return np.empty(0, int)
    before = _all_in_a_row(ok & ~at)[:-RUN]
    after = _all_in_a_row(at)[RUN:]
    return np.flatnonzero(before & after) + RUN


def _all_in_a_row(flags: np.ndarray) -> np.ndarray:
    """Return whether `RUN` flags in a row are set, from each on."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(flags, RUN).all(axis=1))
