"""Alarm of a live log: a flag that may be wrong for a while, with a declared rate of false alarms.

A filter's flag `consistent` is 0 for some per cent of the time although all its assumptions hold:
its tests look at the latest quarter periods again and again. The alarm adds these times up, less
those in which the readings fit: a cumulative sum (Page 1954, doi:10.1093/biomet/41.1-2.100), whose
peaks in true logs are exponential. Its limit is the peak that they reach once in `FALSE_ALARMS`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

FALSE_ALARMS: Final = 30 * 86400.0  # time between two false alarms [s]
PEAK: Final = (
    5.0  # mean excess of a peak over a high level [quarter periods] (`python -m benchmarks alarm`)
)
APART: Final = 40.0  # time between two peaks, extrapolated to a level of 0, likewise


class Alarm:
    """The cumulative sum, block after block.

    Args:
        step: between two samples [s].
        quarter: quarter period of the plant [s].

    Attributes:
        limit: samples without fit, less those with, that raise an alarm.
        count: how many alarms there were.
    """

    SAVED: Final = ("count", "_excess", "_samples", "_change")

    def __init__(self, step: float, quarter: float) -> None:
        chances = max(FALSE_ALARMS / (APART * quarter), math.e)
        self.limit = math.ceil(PEAK * quarter / step * math.log(chances))
        self.count = 0
        self._excess = 0
        self._samples = 0
        self._change = 0

    def add(self, fits: np.ndarray) -> None:
        """Add the next samples: whether the readings fit (N). An alarm begins the sum again."""
        self._samples += len(fits)
        for change in (1 - 2 * fits).tolist():
            self._excess = max(self._excess + change, 0) % self.limit
            self.count += change > self._excess
            self._change = change

    @property
    def is_due(self) -> bool:
        """Return whether the record as a whole does not fit: after an alarm. In a record too short
        for one the end decides.
        """
        return self.count > 0 or self._samples < self.limit * self._change
