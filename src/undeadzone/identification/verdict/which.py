"""Which nonlinearity is it, if no dead zone of the sensor: a play, both, a zone of the input?

What is found stands in its place, with its plant. u is known, so what a zone of the input passes is
known for every pair of widths: least squares of the simulated output is consistent whatever
disturbs the plant, as long as u does not answer to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.ends.sensor import DIRECTIONS
from undeadzone.identification.models import plant
from undeadzone.identification.models.elements import PlayFit, PlayModel, fit_both, fit_play
from undeadzone.identification.models.estimates import Interval, best_top, weighing
from undeadzone.identification.models.kalman_fit import KalmanFit
from undeadzone.identification.models.least_squares import (
    CLEARLY,
    Density,
    LeastSquares,
    compare_statistic,
)
from undeadzone.identification.models.likelihood import dead_zone
from undeadzone.identification.models.motion import Offsets, along, white_noise
from undeadzone.identification.models.place import PARTS, PlaceFit, PlaceStarts, Shape, fit_place
from undeadzone.identification.models.play_gap import RUNS, Gap, find_gap
from undeadzone.identification.models.zone_fit import Fit, longest_record, reduced
from undeadzone.identification.verdict.delays import GLITCH, RARE
from undeadzone.identification.verdict.orders import HeldOut, judged, one_step, trained_part
from undeadzone.identification.verdict.place import Place
from undeadzone.identification.verdict.verdict import LEAST, Case, Verdict, because, explains_better
from undeadzone.support.arrays import Floats, Integers
from undeadzone.support.text import HALF_95

LEAST_GAP = 0.02  # rms of y, below which a gap is no matter
LEAST_ODD = 1e-3  # least rms from which readings are counted as odd, in rms of y
FINEST = 2e-4  # rms of u: no interval is narrower
LAST = {"play": 25, "both": 25, "input_zone": 40}  # steps of a climb that checks a fit


class Element(NamedTuple):
    """An element that is no dead zone of the sensor, with the plant of its own fit.

    Attributes:
        kind: play, both or input_zone.
        fit: what was fitted.
        simulator: the plant, with all records.
        theta: its numbers a, b, x0, ..., scaled; of an input zone at rest at first.
        V: covariance of a and b.
        z: output of the plant (N), scaled.
        readings: what is read of it without noise (N), scaled.
        side: contact of a play, side of an input zone (N).
        widths: right, left, width, centre in units of the log; None where they are not known.
        ahead: what disturbs z, scaled; None where it was not told apart.
        noise: rms of the readings' white noise, scaled.
        degrees: of freedom of the intervals.
        rms: of what the fit leaves, scaled.
        remarks: what to know of the widths.
        zone: both: d_r + d_l beside the play's width [y]; else None.
        edges: both: d_r and d_l if c_r = c_l, the sum of both centres in them [y]; else None.
    """

    kind: str
    fit: PlayFit | PlaceFit
    simulator: plant.Simulator
    theta: Floats
    V: Floats
    z: Floats
    readings: Floats
    side: Integers
    widths: dict[str, Interval | None]
    ahead: plant.Ahead | None
    noise: float
    degrees: float
    rms: float
    remarks: list[str]
    zone: Interval | None = None
    edges: tuple[Interval, Interval] | None = None

    @property
    def unseen(self) -> float:
        """rms of what z does that no input made, scaled."""
        return self.rms if self.ahead is None else self.ahead.rms


class Found(NamedTuple):
    """What was found of a case so far.

    Attributes:
        verdict: so far.
        delay: samples by which the input acts late; of a play in the records as they are none.
        offsets: the four offsets along the log, with the element's plant; None: not looked at.
        element: what stands in the place of a sensor's dead zone; None: nothing does.
        kalman: fits of (L3), best first.
        place: where the zone is; None where that was not asked.
    """

    verdict: Verdict
    delay: int
    offsets: Offsets | None = None
    element: Element | None = None
    kalman: Sequence[KalmanFit] = ()
    place: Place | None = None


# --- Is it a play, or a play and a dead zone?


def with_play(case: Case, found: Found) -> Found:
    """What is found where a play, or a play and a dead zone, may explain the log better.

    Args:
        case: with static maps that a play has to beat.
        found: the verdict by these.
    """
    brief = reduced(case.chosen.pairs)
    offsets = along(brief.objective.simulator, brief.theta, brief.s, case.quantum)
    found = found._replace(offsets=offsets)
    if not _is_asked(case, found.verdict.word, offsets, brief):
        return found
    logs, orders = [case.data], [one.n for one in case.fitted.fits]
    if case.options.delay == "auto" and case.fitted.delay:  # a play is late, so a delay may be one
        logs = [case.recorded, case.data]
    plays = []
    for data in logs:
        fits = fit_play(plant.part_of(data), orders, case.options.integrators)
        if fits and fits[0].density.value.size == case.rivals["none"].value.size:
            plays.append((_without_glitches(fits[0]), fits[1:], data))
    if not plays:
        return found
    play, others, whole = min(plays, key=lambda one: one[0].density.bic)
    begun = [reduced(one.pairs) for one in case.fitted.fits] if whole is case.data else []
    for fit in _better(case, play, fit_both([play, *begun])):
        gap = find_gap(fit, others, case.quantum)
        case.advance(1)
        rms = gap.fit.squares.rms(gap.fit.theta)
        offsets = along(gap.fit.model.simulator, gap.theta, rms, case.quantum)
        found = found._replace(offsets=offsets)
        if not fit.model.zone or _both_there(gap, offsets):
            return _with_gap(case, found, gap, offsets, whole)
    return found


def _is_asked(case: Case, word: str, offsets: Offsets, brief: Fit) -> bool:
    """Whether a play is looked for: it explains the log, or something with a memory may."""
    kind = case.options.kind
    if kind in ("jump", "deadzone"):
        return False
    perhaps = word in ("play", "other", "unclear") or kind == "play"
    if perhaps or offsets.name in ("play", "both"):
        return True
    both = fit_both([brief])  # a lag of the plant may pass for a play
    least = min(case.rivals["dead_zone"], case.rivals["none"], key=lambda one: one.bic)
    return both is not None and compare_statistic(both.density, least) > CLEARLY


def _without_glitches(fit: PlayFit) -> PlayFit:
    """The fit without the few readings that it cannot have produced."""
    data, e = fit.squares.data, fit.squares.residual(fit.theta)
    usual = float(np.median(np.abs(e[data.ok]))) / 0.6745
    odd = data.ok & (np.abs(e) > GLITCH * max(usual, LEAST_ODD))
    if not odd.any() or odd.sum() > RARE * data.ok.sum():
        return fit
    regular = data._replace(ok=data.ok & ~odd, y=np.where(odd, 0.0, data.y))
    return LeastSquares(fit.model.along(regular)).best([fit.theta]) or fit


def _better(case: Case, play: PlayFit, both: PlayFit | None) -> list[PlayFit]:
    """Which of play and dead zone, and play, beat every static map, in this order.

    A play that the user knows of need not beat anything, only not be beaten.
    """
    static = [one for name, one in case.rivals.items() if name != "play"]
    better = []
    if both is not None:
        clearly = _ahead(both.density, [play.density, *static]) > CLEARLY
        if clearly and both.density.rms < 1 - LEAST:
            better.append(both)
    explains = not play.density.strange and play.density.rms <= 1 - LEAST
    least = -CLEARLY if case.options.kind == "play" else CLEARLY
    if explains and _ahead(play.density, static) > least:
        better.append(play)
    return better


def _ahead(density: Density, others: Sequence[Density]) -> float:
    """Vuong's statistic against the best of others."""
    return min(compare_statistic(density, other) for other in others)


def _both_there(gap: Gap, offsets: Offsets) -> bool:
    """Whether both widths are above 0 for certain; the four offsets must not deny it."""
    there = all(is_there(gap.intervals[name]) for name in ("width", "zone"))
    return there and offsets.name in ("both", "play")


def is_there(interval: Interval) -> bool:
    """Whether a gap is above 0 for certain, and no less than matters."""
    return interval.low > 0 and interval.value > LEAST_GAP


def _with_gap(case: Case, found: Found, gap: Gap, offsets: Offsets, whole: plant.Data) -> Found:
    """What is found with a play, and perhaps a dead zone, that beats every static map."""
    if not gap.fit.model.zone and not is_there(gap.intervals["width"]) and gap.sure:
        return found._replace(verdict=_no_gap(found.verdict, gap))
    element = of_play(gap, whole, case.offset)
    delay = case.fitted.delay if whole is case.data else 0
    return found._replace(verdict=_named(element, offsets), element=element, delay=delay)


def _no_gap(verdict: Verdict, gap: Gap) -> Verdict:
    """A play without a gap is a constant offset, where it is anything."""
    if verdict.word != "play":
        return verdict
    offset = -0.5 * gap.intervals["centre"].value * gap.fit.squares.data.y_scale
    return because(
        "other",
        f"no gap is there, but the readings lie about {offset:.4g} beside the output: a constant"
        f" offset; take it away by --zero {offset:.4g}",
    )


def _named(element: Element, offsets: Offsets) -> Verdict:
    """The verdict on a play that was found."""
    if element.kind == "both":
        reason = "a play with a dead zone after or ahead of it explains the log better than either"
        return because("both", reason)
    verdict = explains_better("play")
    if offsets.name not in ("dead_zone", "both"):
        return verdict
    zone, std = offsets.widths[1], offsets.std[1]
    return verdict.with_cautions(
        f"the four offsets of the readings show a dead zone of {zone:.3g} ± {HALF_95 * std:.2g} in"
        " rms of y beside the play: the fit is not perfect"
    )


# --- A play, and perhaps a dead zone after it


def of_play(gap: Gap, whole: plant.Data, offset: float | None) -> Element:
    """The element of a play, and of the dead zone after it.

    Args:
        gap: what was found, of the log or of its busiest part.
        whole: all records.
        offset: rms of an unknown offset of the output, scaled; None: free.
    """
    model, theta = _of_all(gap, whole)
    z = model.output(theta)
    level, moved = model.level(z, theta)
    moves = np.append(False, np.diff(level) != 0)
    element = Element(
        kind="both" if model.zone else "play",
        fit=gap.fit,
        simulator=model.simulator,
        theta=theta,
        V=gap.V,
        z=z,
        readings=model.readings(z, theta),
        side=np.where(moves, moved, 0.0).astype(int),
        widths=dict.fromkeys(DIRECTIONS),
        ahead=gap.ahead,
        noise=gap.noise,
        degrees=RUNS - 1,
        rms=gap.fit.squares.rms(gap.fit.theta),
        remarks=[],
    )
    if gap.ahead is not None and not gap.sure:
        element = _hidden(element, gap.ahead.rms * whole.y_scale)
    elif model.zone:
        element = _with_zone(element, gap, whole.y_scale)
    else:
        element = element._replace(widths=_sides(gap, offset))
    if model.simulator.layout.integrators:
        element.remarks.append(
            "z of an integrating plant has no zero of its own: the centre of the gap is not known,"
            " and both sides are half of the width"
        )
    return element


def _of_all(gap: Gap, whole: plant.Data) -> tuple[PlayModel, Floats]:
    """The model of all records, and its numbers; at rest at first where a part was fitted."""
    old = gap.fit.model
    if old.data.y.size == whole.y.size:
        return old, gap.theta
    model = old.along(whole)
    return model, model.simulator.layout.at_rest(old.simulator.layout, gap.theta)


def _hidden(element: Element, strong: float) -> Element:
    """No widths: a disturbance of that rms [y] hides them."""
    remark = (
        f"a disturbance of rms {strong:.3g} moves z ahead of the play, and turns that no input"
        " made hide the gap: no width is given; record with a larger input"
    )
    return element._replace(remarks=[remark])


def _with_zone(element: Element, gap: Gap, scale: float) -> Element:
    """The widths of a play and of the dead zone after it."""
    shown = {name: interval.scaled(scale) for name, interval in gap.intervals.items()}
    zone = shown["zone"]
    remark = (
        f"the play's gap is the width above; the dead zone's, d_r + d_l, is {zone.value:.4g}"
        f" [{zone.low:.4g}, {zone.high:.4g}]; of both centres only the sum shows"
    )
    return element._replace(
        widths=element.widths | {"width": shown["width"]},
        zone=zone,
        edges=(shown["zone_right"], shown["zone_left"]),
        remarks=[remark],
    )


def _sides(gap: Gap, offset: float | None) -> dict[str, Interval | None]:
    """The play's widths [y]; what an offset of the output leaves of its sides and its centre."""
    shown: dict[str, Interval | None] = {}
    for name, row in DIRECTIONS.items():
        interval = gap.intervals[name]
        if shift := abs(row[0] - row[1]):  # by which an offset of 1 moves it
            above = interval.high - interval.value
            half = np.inf if offset is None else float(np.hypot(above, shift * offset))
            interval = Interval.around(interval.value, half)
        shown[name] = interval.scaled(gap.fit.model.data.y_scale)
    if gap.fit.model.tied:
        shown["centre"] = None
    return shown


# --- A dead zone of the actuator


def of_input_zone(fits: Sequence[Fit]) -> Element | None:
    """The zone of the input behind which the plant of least BIC stands; None where none fits.

    Args:
        fits: of every order, with a zone of the sensor, where climbs start.
    """
    tops = []
    for one in fits:
        starts = PlaceStarts(longest_record(one))
        fitted = fit_place(starts.simulator, Shape("input", input=True), starts.at_input())
        if fitted is not None:
            tops.append(fitted)
    if not tops:
        return None
    return _of_input(min(tops, key=lambda one: one.density.bic), fits[0].objective.data)


def _of_input(fit: PlaceFit, whole: plant.Data) -> Element:
    """The element of a zone of the input; of the longest record, along all of them."""
    model, data, numbers = fit.model, fit.squares.data, fit.theta
    layout = model.simulator.layout
    passed = dead_zone(whole.u, *model.part(numbers, "input"))
    simulator = plant.Simulator(whole._replace(u=passed), model.n)
    theta = np.zeros(simulator.layout.size)
    theta[: layout.b.stop] = numbers[: layout.b.stop]
    z = simulator.z(theta)
    spread = fit.squares.spread(numbers)
    widths: dict[str, Interval | None] = {}
    degrees = math.inf
    for name, weights in DIRECTIONS.items():
        value = float(np.dot(weights, model.part(numbers, "input")))
        first = model.base + PARTS["input"].start
        row = weighing(model.free, model.size, first, weights)
        half, freedom = spread.half_and_degrees(row)
        interval = Interval.around(value, math.hypot(half, FINEST))
        widths[name] = interval.scaled(float(whole.u_scale[0]))
        degrees = min(degrees, freedom)
    return Element(
        kind="input_zone",
        fit=fit,
        simulator=simulator,
        theta=theta,
        V=spread.V[: layout.b.stop, : layout.b.stop],
        z=z,
        readings=z,
        side=np.sign(passed[:, 0]).astype(int),
        widths=widths,
        ahead=plant.disturbance_ahead(layout, numbers, fit.squares.residual(numbers), data.ok),
        noise=min(white_noise(data.y, data.ok, data.start), fit.density.rms),
        degrees=degrees,
        rms=fit.density.rms,
        remarks=[
            "the widths are those of the input, in its unit; they hold if the input does not answer"
            " to the output"
        ],
    )


# --- How it does on data that had no part in its fit


def held_out_of(element: Element, held_out: float) -> HeldOut:
    """Error, share and whiteness on the last part of a log, fitted to the part before.

    Args:
        element: a play, or a zone of the input.
        held_out: share of the samples, at the end, that checks.
    """
    fit, data = element.fit, element.fit.squares.data
    train = trained_part(data, held_out)
    trained = LeastSquares(fit.model.along(data._replace(ok=data.ok & train, climbs=None)))
    top = best_top(trained, [fit.theta], fit.model.first, LAST[element.kind])
    theta = fit.theta if top is None else top.theta
    test = data.ok & ~train
    e = fit.squares.residual(theta)
    return judged(e, data, test, one_step(e, test, test, data.start))
