"""Gap at each reversal: a table that shows trends behind the single estimate.

With the motion that the predictor expects, every reversal has a gap of its own,

    c_j = c - s_j e_j,   e_j the error of the first tick after it.                             (S4)

It needs no gap but the servo's motion, so its median is a second opinion. A trend with duration or
speed is friction or a gain that is wrong, one with y a worn gear or an eccentric one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import median_abs_deviation

from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.servo.likelihood import At, Servo, ServoLikelihood
from undeadzone_identify.servo.observations import (
    REACH,
    Observations,
    reading_noise_rms,
    to_schmitt_ticks,
)

FEW = 12  # crossings from which a trend is looked for
CLEAR = 4.0  # standard deviations of a trend that is named
STRONG = 0.1  # of the gap, that a trend must change over the crossings
OUTLIER = 4.0  # scatters beyond which a crossing counts no more than that
OF_MEDIAN = 1.2533  # standard error of a median, in those of a mean
MEANING = {
    "duration": "friction or slow torques are not fully held",
    "speed": "friction or the gain are not fully held",
    "y": "a worn gear, or an eccentric one",
    "direction": "a tick was missed, or the load pulls to one side",
}


class GapCrossings(NamedTuple):
    """Crossings of a gap in temporal order; all arrays (m).

    Attributes:
        at: sample of the first tick beyond the gap.
        time: of it, since the log began [s].
        side: to which it goes: +1 right, -1 left.
        speed: of the motor then [y/s].
        duration: since the last tick before it [s].
        y: the reading.
        gap: that it shows [y].
    """

    at: Integers
    time: Floats
    side: Integers
    speed: Floats
    duration: Floats
    y: Floats
    gap: Floats

    @property
    def median_gap(self) -> float:
        """Return the median gap [y]; nan without crossings."""
        return float(np.median(self.gap)) if self.gap.size else math.nan

    @property
    def gap_scatter(self) -> float:
        """Return the standard deviation of the gaps by their median deviation [y]."""
        if not self.gap.size:
            return math.nan
        return float(median_abs_deviation(self.gap, scale="normal"))

    @property
    def median_error(self) -> float:
        """Return the standard error of the median gap [y]."""
        return OF_MEDIAN * self.gap_scatter / math.sqrt(max(self.gap.size, 1))

    def describe_trends(self) -> list[str]:
        """Describe the quantities with which the gap changes significantly."""
        if self.gap.size < FEW:
            return []
        rows = np.column_stack([self.duration, np.abs(self.speed), self.y, self.side])
        rows = (rows - rows.mean(axis=0)) / (rows.std(axis=0) + 1e-300)
        rows = np.column_stack([np.ones(self.gap.size), rows])
        reach = OUTLIER * self.gap_scatter
        gaps = np.clip(self.gap, self.median_gap - reach, self.median_gap + reach)
        inverse = np.linalg.pinv(rows.T @ rows)
        slopes = inverse @ rows.T @ gaps
        left = gaps - rows @ slopes
        degrees = max(self.gap.size - rows.shape[1], 1)
        errors = np.sqrt(np.maximum(inverse.diagonal() * (left @ left) / degrees, 1e-300))
        found = []
        for name, slope, error in zip(MEANING, slopes[1:], errors[1:], strict=True):
            share = abs(slope) / max(abs(self.median_gap), 1e-300)
            if abs(slope) > CLEAR * error and share > STRONG:
                found.append(
                    f"the gap at each crossing changes with {name}, by {100 * share:.0f} % a"
                    f" standard deviation: {MEANING[name]}"
                )
        return found


def find_crossings(log: Observations, one: Servo, free: bool = False) -> GapCrossings:
    """Find the crossings of a log, in its units.

    Args:
        log: as the predictor hears it; of noisy readings those of a Schmitt trigger are taken.
        one: the servo.
        free: whether z is forgotten at reversals, so that no gap is assumed.
    """
    ticked = log
    wider = 0.0
    if not log.ticks:
        ticked = to_schmitt_ticks(log)
        wider = 2 * REACH * reading_noise_rms(log)
    theta = one.replace_number(At.GAP, one.theta[At.GAP] + wider).theta
    seen = ServoLikelihood(ticked, free).run_predictor(theta[None], one.structure.lag)[0]
    at = np.flatnonzero(ticked.reversal_ticks)
    ticks = np.flatnonzero(ticked.side)
    before = ticks[np.maximum(np.searchsorted(ticks, at) - 1, 0)]
    side = ticked.side[at]
    scale = log.y_scale
    return GapCrossings(
        at=at,
        time=at * log.seconds,
        side=side,
        speed=seen[at, 3] * scale * (log.step / log.seconds),
        duration=(at - before) * log.seconds,
        y=log.y[at] * scale,
        gap=(theta[At.GAP] - side * seen[at, 0] - wider) * scale,
    )
