"""A dead zone of the actuator: its widths with intervals, and the plant behind it.

u is known, so what the zone passes is known for every pair of widths: least squares of the
simulated output is consistent whatever disturbs the plant, as long as u does not answer to it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.ahead import Ahead, disturbance_ahead
from undeadzone.identification.intervals import DIRECTIONS, Interval
from undeadzone.identification.log import Flags
from undeadzone.identification.motion import white_noise
from undeadzone.identification.orders import OrderFit
from undeadzone.identification.place_models import PlaceFit, PlaceModel, Shape, fit_place
from undeadzone.identification.place_starts import PlaceStarts
from undeadzone.identification.records import longest_record
from undeadzone.support.arrays import Floats

FINEST = 2e-4  # rms of u: no interval is narrower


class InputZone(NamedTuple):
    """A dead zone of the actuator, in the scale of the fit.

    Attributes:
        fit: plant and widths.
        intervals: right, left, width, centre, in rms of u.
        V: covariance of the plant's numbers a and b.
        ahead: what disturbs the plant.
        noise: rms of the readings' white noise.
        degrees: of freedom of the intervals, the fewest of them.
    """

    fit: PlaceFit
    intervals: dict[str, Interval]
    V: Floats
    ahead: Ahead
    noise: float
    degrees: float


def find_input_zone(fits: list[OrderFit]) -> InputZone | None:
    """The zone of the input behind which the plant of least BIC stands; None where none fits.

    Args:
        fits: of every order, with a zone of the sensor, where climbs start.
    """
    tops = []
    for one in fits:
        starts = PlaceStarts(longest_record(one.pairs))
        model = PlaceModel(starts.simulator, Shape("input", input=True))
        fitted = fit_place(model, starts.at_input())
        if fitted is not None:
            tops.append(fitted)
    if not tops:
        return None
    best = min(tops, key=lambda one: one.density.bic)
    model, theta = best.model, best.theta
    spread = best.spread()
    intervals, degrees = {}, math.inf
    for name, weights in DIRECTIONS.items():
        row = np.zeros(model.size)
        row[model.base + 5 : model.base + 7] = weights
        value = float(row @ theta)
        half, freedom = spread.half_and_degrees(row[model.free])
        half, degrees = math.hypot(half, FINEST), min(degrees, freedom)
        intervals[name] = Interval(value, value - half, value + half)
    data, layout = model.data, model.simulator.layout
    ok: Flags = data.ok
    ahead = disturbance_ahead(layout, theta, model.residual(theta), ok)
    noise = min(white_noise(data.y, ok, data.start), best.density.rms)
    count = layout.b.stop
    return InputZone(best, intervals, spread.V[:count, :count], ahead, noise, degrees)
