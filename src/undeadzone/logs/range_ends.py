"""Whether readings of a log stick at their largest or least value: the limits of a range."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.support.arrays import Floats, Integers

FEWEST = 10  # readings at a limit
SHARE = 0.005  # of all readings
RUN = 5  # readings in a row: so long they stick, and from so many their speed before is taken
SPEED = 1e-3  # of the range of the readings, by which they move in a step before they stick


class RangeEnds(NamedTuple):
    """Where readings stick.

    Attributes:
        low, high: least and largest reading; -inf, inf where readings do not stick there.
        at: whether each reading is one of them (N, bool).
    """

    low: float
    high: float
    at: np.ndarray

    @property
    def found(self) -> bool:
        """Whether readings stick at either end."""
        return bool(np.isfinite([self.low, self.high]).any())

    @property
    def text(self) -> str:
        """The range as a scenario has it."""
        return f"[{self.low:.9g}, {self.high:.9g}]"


def range_ends(y: Floats, ok: np.ndarray, quantum: float = 0.0) -> RangeEnds:
    """The values at which readings stick on their way, as where an amplifier ends.

    At the top of a slow or rounded motion readings are alike too; there they do not come to a
    sudden stop.

    Args:
        y: readings (N).
        ok: whether there is a reading (N, bool).
        quantum: of the readings; 0: none.
    """
    if not ok.any():
        return RangeEnds(-np.inf, np.inf, np.zeros(y.shape, bool))
    least = max(SPEED * float(np.ptp(y[ok])), 3 * quantum)
    upper = _sticks(y, ok, least)
    lower = _sticks(-y, ok, least)
    high = float(y[ok].max()) if upper.any() else np.inf
    low = float(y[ok].min()) if lower.any() else -np.inf
    return RangeEnds(low, high, upper | lower)


def _sticks(y: Floats, ok: np.ndarray, least: float) -> np.ndarray:
    """Which readings stick at the largest one (N, bool); none if that is not where they end.

    Args:
        y: readings (N).
        ok: whether there is a reading (N, bool).
        least: by which they move in the step before they stick, at least.
    """
    none = np.zeros(y.shape, bool)
    top = float(y[ok].max())
    at = ok & (y >= top * (1 - 1e-9))
    if top <= 0 or at.sum() < max(FEWEST, SHARE * ok.sum()):
        return none
    first = _first_of_runs(at, ok)
    if not first.size:
        return none
    speed = (y[first - 1] - y[first - RUN]) / (RUN - 1)
    rest = top - y[first - 1]
    sudden = np.median(speed) > least and np.median(rest) < RUN / 2 * np.median(speed)
    return at if sudden else none


def _first_of_runs(at: np.ndarray, ok: np.ndarray) -> Integers:
    """Where `RUN` readings in a row are at the limit, after as many that are there and are not."""
    free = ok & ~at
    windows = np.lib.stride_tricks.sliding_window_view
    if at.size < 2 * RUN:
        return np.empty(0, int)
    before = windows(free, RUN).all(axis=1)[:-RUN]
    after = windows(at, RUN).all(axis=1)[RUN:]
    return np.flatnonzero(before & after) + RUN
