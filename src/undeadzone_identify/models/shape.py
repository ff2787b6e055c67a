"""Shape of a sensor with a dead zone: rounding of its edges, slopes of its sides, a lag behind.

The rounding has a bound at 0, where its derivatives vanish, so its interval is that of the profile
likelihood. The others are measured as widths are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.chain import SHARPEST, ChainFit
from undeadzone_identify.models.estimates import Interval, maximise_likelihood
from undeadzone_identify.models.least_squares import LeastSquares
from undeadzone_identify.models.measured import measure_levels

DROP = 1.92  # of the log likelihood, at the ends of a 95 % interval
GRID = np.geomspace(1.0, 64.0, 13)  # of roundings, over the least that is tried
FINEST = 0.005  # of the zone's width: the least rounding that is tried
UNSEEN_LAG = 0.1  # samples, within which a lag is not separated from the plant
STEPS = 6  # of the climb of the other numbers


class SensorShape(NamedTuple):
    """Shape of a sensor, with 95 % intervals.

    Attributes:
        rounding: how far about an edge it is round [y].
        slope: of the left side over that of the right [1].
        lag: time constant of a filter behind the zone [s]; a pure delay there cannot be separated
            from one of the input, and is the plant's.
    """

    rounding: Interval
    slope: Interval
    lag: Interval


def measure_shape(fit: ChainFit, y_scale: float, step: float) -> SensorShape:
    """Measure the shape of a sensor.

    Args:
        fit: of a shaped zone with a lag.
        y_scale: rms of y [y].
        step: of the log [s].
    """
    model = fit.model
    later = fit.prediction_fit

    def numbers(theta: Floats) -> Floats:
        """Return slope and lag [samples]."""
        return np.array([theta[model.shape.start], model.lag(theta)])

    stages = [(one.squares, one.theta) for one in (fit, later)]
    intervals = measure_levels(numbers, stages).intervals
    lag = intervals["left"]  # within a part of a sample it is that of the plant's numerators
    wider = Interval.from_half_width(lag.value, math.hypot(lag.half_width, UNSEEN_LAG))
    return SensorShape(
        profile_rounding(later).scale_by(y_scale), intervals["right"], wider.scale_by(step)
    )


def profile_rounding(fit: ChainFit) -> Interval:
    """Return the rounding with the interval of its profile likelihood, scaled.

    Args:
        fit: with least prediction errors.
    """
    place = fit.model.shape.start + 1
    held = fit.model.along(fit.squares.data)
    held.free = held.free[held.free != place]
    squares = LeastSquares(held, fit.squares.past)
    grid = FINEST * fit.theta[held.edges].sum() * GRID
    own = fit.theta[place]
    values = {}
    for side in (grid[grid >= own], [*grid[grid < own][::-1], SHARPEST]):
        theta = fit.theta.copy()
        for rounding in side:
            theta[place] = rounding
            top = maximise_likelihood(squares, theta, STEPS)
            values[float(rounding)] = top.value
            theta = top.theta.copy()
    least_first = np.array([values[key] for key in sorted(values)])
    roundings = np.append(0.0, grid)
    fallen = least_first.max() - least_first
    within = np.flatnonzero(fallen < DROP)
    low = max(within[0] - 1, 0)
    high = min(within[-1] + 1, grid.size)
    best = roundings[int(np.argmin(fallen))]
    least = 0.0 if within[0] == 0 else float(roundings[low])
    most = math.inf if within[-1] == grid.size else float(roundings[high])
    return Interval(float(best), least, most)
