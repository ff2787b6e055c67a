"""What stands in the place of a sensor's dead zone, with its plant: a play, both, an input zone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.identification.ahead import Ahead
from undeadzone.identification.input_zone import InputZone
from undeadzone.identification.intervals import Interval
from undeadzone.identification.place_models import PlaceModel
from undeadzone.identification.plant_fit import Data, Simulator
from undeadzone.identification.play_gap import RUNS, Gap
from undeadzone.identification.play_model import PlayModel
from undeadzone.support.arrays import Floats, Integers

NONE = dict.fromkeys(("right", "left", "width", "centre"))


class Element(NamedTuple):
    """An element that is no dead zone of the sensor, with the plant of its own fit.

    Attributes:
        kind: play, both or input_zone.
        model: what was fitted.
        fitted: its numbers.
        simulator: the plant, with all records.
        theta: its numbers a, b, x0, ..., scaled; of an input zone at rest at first.
        V: covariance of a and b.
        z: output of the plant (N), scaled.
        readings: what is read of it without noise (N), scaled.
        side: contact of a play, side of an input zone (N).
        widths: right, left, width, centre in units of the log; None where they are not known.
        zone: both: d_r + d_l beside the play's width [y]; else None.
        edges: both: d_r and d_l if c_r = c_l, the sum of both centres in them [y]; else None.
        ahead: what disturbs z, scaled; None where it was not told apart.
        noise: rms of the readings' white noise, scaled.
        degrees: of freedom of the intervals.
        rms: of what the fit leaves, scaled.
        remarks: what to know of the widths.
    """

    kind: str
    model: PlayModel | PlaceModel
    fitted: Floats
    simulator: Simulator
    theta: Floats
    V: Floats
    z: Floats
    readings: Floats
    side: Integers
    widths: dict[str, Interval | None]
    zone: Interval | None
    ahead: Ahead | None
    noise: float
    degrees: float
    rms: float
    remarks: list[str]
    edges: tuple[Interval, Interval] | None = None


def of_play(gap: Gap, whole: Data, offset: float | None) -> Element:
    """The element of a play, and of the dead zone after it.

    Args:
        gap: what was found, of the log or of its busiest part.
        whole: all records.
        offset: rms of an unknown offset of the output, scaled; None: free.
    """
    model, theta = _of_all(gap, whole)
    data = model.data
    z = model.z(theta)
    level, moved = model.level(z, theta)
    moves = np.append(False, np.diff(level) != 0)
    remarks = []
    widths: dict[str, Interval | None] = dict(NONE)
    zone, edges = None, None
    if not gap.sure and gap.ahead is not None:
        strong = gap.ahead.rms * data.y_scale
        remarks.append(
            f"a disturbance of rms {strong:.3g} moves z ahead of the play, and turns that no input"
            " made hide the gap: no width is given; record with a larger input"
        )
    elif model.zone:
        widths["width"] = gap.intervals["width"].scaled(data.y_scale)
        zone = gap.intervals["zone"].scaled(data.y_scale)
        right, left = (gap.intervals[f"zone_{side}"] for side in ("right", "left"))
        edges = right.scaled(data.y_scale), left.scaled(data.y_scale)
        remarks.append(
            f"the play's gap is the width above; the dead zone's, d_r + d_l, is {zone.value:.4g}"
            f" [{zone.low:.4g}, {zone.high:.4g}]; of both centres only the sum shows"
        )
    else:
        widths.update(_sides(gap, offset))
    if model.simulator.layout.integrators:
        remarks.append(
            "z of an integrating plant has no zero of its own: the centre of the gap is not known,"
            " and both sides are half of the width"
        )
    return Element(
        kind="both" if model.zone else "play",
        model=gap.model,
        fitted=gap.fit.theta,
        simulator=model.simulator,
        theta=theta,
        V=gap.V,
        z=z,
        readings=model.readings(z, theta),
        side=np.where(moves, moved, 0.0).astype(int),
        widths=widths,
        zone=zone,
        ahead=gap.ahead,
        noise=gap.noise,
        degrees=RUNS - 1,
        rms=gap.model.rms(gap.fit.theta),
        remarks=remarks,
        edges=edges,
    )


def _of_all(gap: Gap, whole: Data) -> tuple[PlayModel, Floats]:
    """The model of all records, and its numbers; at rest at first where a part was fitted."""
    old = gap.model
    if old.data.y.size == whole.y.size:
        return old, gap.theta
    layout = old.simulator.layout
    model = PlayModel(Simulator(whole, layout.n, layout.integrators), old.zone)
    theta = np.zeros(model.size)
    theta[: layout.b.stop] = gap.theta[: layout.b.stop]
    theta[model.base :] = gap.theta[old.base :]
    return model, theta


def _sides(gap: Gap, offset: float | None) -> dict[str, Interval | None]:
    """The play's widths [y]; what an offset of the output leaves of its sides and its centre."""
    shown: dict[str, Interval | None] = {}
    for name in NONE:
        value, low, high = gap.intervals[name]
        if name != "width":
            half = np.inf if offset is None else float(np.hypot(high - value, offset))
            low, high = value - half, value + half
        shown[name] = Interval(value, low, high).scaled(gap.model.data.y_scale)
    if gap.model.tied:
        shown["centre"] = None
    return shown


def of_input_zone(found: InputZone, data: Data) -> Element:
    """The element of an actuator's dead zone.

    Args:
        found: what was found, of the longest record.
        data: all records.
    """
    model, numbers = found.fit.model, found.fit.theta
    right, left = found.fit.input
    passed = np.maximum(data.u - right, 0.0) + np.minimum(data.u + left, 0.0)
    simulator = Simulator(data._replace(u=passed), model.n)
    theta = np.zeros(simulator.layout.size)
    theta[: simulator.layout.b.stop] = numbers[: simulator.layout.b.stop]
    z = simulator.z(theta)
    widths: dict[str, Interval | None] = {}
    for name, interval in found.intervals.items():
        widths[name] = interval.scaled(float(data.u_scale[0]))
    return Element(
        kind="input_zone",
        model=model,
        fitted=numbers,
        simulator=simulator,
        theta=theta,
        V=found.V,
        z=z,
        readings=z,
        side=np.sign(passed[:, 0]).astype(int),
        widths=widths,
        zone=None,
        ahead=found.ahead,
        noise=found.noise,
        degrees=found.degrees,
        rms=found.fit.density.rms,
        remarks=[
            "the widths are those of the input, in its unit; they hold if the input does not answer"
            " to the output"
        ],
    )


def is_there(interval: Interval, least: float) -> bool:
    """Whether a width is above 0 for certain, and no less than matters."""
    return interval.low > 0 and interval.value > least
