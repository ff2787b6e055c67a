"""Which nonlinearity is it, if no dead zone of the sensor: a play, both, a zone of the input?

What is found stands in its place, with its plant. u is known, so what a zone of the input passes is
known for every pair of widths: least squares of the simulated output is consistent whatever
disturbs the plant, as long as u does not answer to it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models import plant
from undeadzone_identify.models.chain import ChainFit
from undeadzone_identify.models.elements import (
    MapModel,
    PlayFit,
    PlayModel,
    fit_both,
    fit_play,
)
from undeadzone_identify.models.estimates import Interval, best_top
from undeadzone_identify.models.kalman_fit import KalmanFit
from undeadzone_identify.models.least_squares import LEAST_ODD, Fitted, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone
from undeadzone_identify.models.motion import THERE, Offsets, along, white_noise
from undeadzone_identify.models.place import (
    PlaceFit,
    Zoned,
    fit_at_input,
    fit_both_ends,
)
from undeadzone_identify.models.play_gap import RUNS, Gap, find_gap
from undeadzone_identify.models.zone_fit import Fit, reduce_record
from undeadzone_identify.selection.adequacy import largest_remainder
from undeadzone_identify.selection.decision import (
    CANNOT_TELL,
    CHAINED,
    MEMORY,
    MODELS,
    UNLIKELY,
    Case,
    Verdict,
    classify,
    decide,
    detect_feedback,
)
from undeadzone_identify.selection.delays import GLITCH, RARE
from undeadzone_identify.selection.odds import Family, odds_of
from undeadzone_identify.selection.orders import HeldOut, judge_errors, one_step, training_samples
from undeadzone_identify.selection.widths import with_offset
from undeadzone_identify.servo.gap import ServoGap

LEAST_GAP = 0.02  # rms of y, below which a gap is no matter
LEAST_NOISE = 0.01  # rms of y, from which noise that falls silent is told from rounding
FINEST = 2e-4  # rms of u: no interval is narrower
EVEN = "the centre of the gap is not known, and both sides are half of the width"
LONGEST = 25  # steps of a climb that checks any other fit
TOP_OF_ODDS = ("none", "saturation")  # named for other reasons than odds, too
LAST = {
    "play": 25,
    "both": 25,
    "input_zone": 40,
    "two_zones": 40,
}  # steps of a climb that checks a fit


class Element(NamedTuple):
    """An element that is no dead zone of the sensor, with the plant of its own fit.

    Attributes:
        kind: play, both, input_zone, two_zones; none or friction of a servo without a gap.
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
        input: two_zones: the widths of the input's zone, as `widths` are the sensor's [u].
    """

    kind: str
    fit: PlayFit | Fitted[MapModel] | ServoGap
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
    input: dict[str, Interval] = {}

    @property
    def unseen(self) -> float:
        """Return rms of what z does that no input made, scaled."""
        return self.rms if self.ahead is None else self.ahead.rms


class Plays(NamedTuple):
    """Fits of a play, and of a play and a dead zone, as far as there are any.

    Attributes:
        fits: by the verdict's word, play or both.
        whole: all records.
    """

    fits: dict[str, PlayFit]
    whole: plant.Data


class Found(NamedTuple):
    """What was found of a case so far.

    Attributes:
        verdict: so far.
        delay: samples by which the input acts late; of a play in the records as they are none.
        models: every model that was fitted, those of the same readings together.
        odds: of what may be there by the verdict's words, largest first.
        offsets: the four offsets along the log, with the element's plant; None: not looked at.
        plays: with a memory; None: not looked for.
        places: models of the zone's place by word; empty where that was not asked.
        chains: models of the input's curve or play, and of a filter, by word.
        denied: words of larger models that simulate held-out data no better.
        element: what stands in the place of a sensor's dead zone; None: nothing does.
        kalman: fits of (L3), best first.
        friction: level of a motor's friction [u]; None where no servo measured it.
    """

    verdict: Verdict
    delay: int
    models: tuple[Family, ...]
    odds: dict[str, float]
    offsets: Offsets | None = None
    plays: Plays | None = None
    places: dict[str, PlaceFit] = {}
    chains: dict[str, ChainFit] = {}
    denied: frozenset[str] = frozenset()
    element: Element | None = None
    kalman: Sequence[KalmanFit] = ()
    friction: Interval | None = None

    def judge_again(self, case: Case, *models: Family, without: Collection[str] = ()) -> Found:
        """What is found with more models, and perhaps without some words."""
        every = (*self.models, *models)
        odds = odds_of(every, {*without, *self.denied, *excluded_words(case)})
        plays = {} if self.plays is None else self.plays.fits
        fits = dict(self.places) | dict(self.chains) | dict(plays)
        return self._replace(models=every, odds=odds, verdict=classify(case, odds, every, fits))


def excluded_words(case: Case) -> Collection[str]:
    """Return words that are out of the question: by what the user said, or since noise falls
    silent.
    """
    out = set(MEMORY) if case.options.kind == "deadzone" else set()
    fit = case.chosen.singles
    if not case.data.silent_zeros or case.jumps:
        return out
    speaks = case.data.ok & (case.data.side != 0)
    loud = white_noise(fit.objective.residuals(fit.theta), speaks, case.data.start)
    if loud > max(2 * case.quantum, LEAST_NOISE):  # and only a sensor's zone silences it
        out |= {"none", "friction", "input_zone", "play", "saturation", "other"}
        out |= {"input_curve", "input_play"}
    return out


# --- Is it a play, or a play and a dead zone?


def with_play(case: Case, found: Found) -> Found:
    """What is found where a play, or a play and a dead zone, may explain the log better.

    Args:
        case: with static maps.
        found: the odds of these.
    """
    brief = reduce_record(case.chosen.pairs)
    offsets = along(brief.objective.simulator, brief.theta, brief.s, case.quantum)
    found = found._replace(offsets=offsets)
    if not _is_asked(case, found, offsets, brief):
        return found
    late = case.options.delay == "auto" and case.fitted.delay  # a play is late, so it may be one
    logs = [case.recorded, case.data] if late else [case.data]
    plays = [Plays(_tops(case, data), data) for data in logs]
    best = min(plays, key=lambda one: min((fit.bic for fit in one.fits.values()), default=math.inf))
    if not best.fits:
        return found
    models = {"none": case.rivals["none"]} | {word: fit.density for word, fit in best.fits.items()}
    return found._replace(plays=best).judge_again(case, models)


def _tops(case: Case, data: plant.Data) -> dict[str, PlayFit]:
    """Return the fits of a play, and of a play and a dead zone, by word; none where none is
    stable.
    """
    begun = [
        reduce_record(one.pairs) for one in (case.chosen, *case.fitted.fits) if data is case.data
    ]
    play = fit_play(plant.part_of(data), case.fitted.prepared.orders, case.options.integrators)
    if play is None:
        return {}
    play = _without_glitches(play)
    both = fit_both([play, *begun])
    return {"play": play} | ({} if both is None else {"both": both})


def _is_asked(case: Case, found: Found, offsets: Offsets, brief: Fit) -> bool:
    """Return whether a play is looked for: it explains the log, or something with a memory may."""
    kind = case.options.kind
    if kind in ("jump", "deadzone"):
        return False
    perhaps = found.verdict.word in ("other", "unclear", "undecided", "friction") or kind == "play"
    perhaps |= found.odds.get("zone_and_friction", 0.0) > UNLIKELY  # a memory beside the zone
    if perhaps or offsets.name in ("play", "both"):
        return True
    both = fit_both([brief])  # a lag of the plant may pass for a play
    models = {"none": case.rivals["none"]} | ({} if both is None else {"both": both.density})
    return odds_of((*found.models, models), excluded_words(case)).get("both", 0.0) > UNLIKELY


def _without_glitches(fit: PlayFit) -> PlayFit:
    """Return the fit without the few readings that it cannot have produced."""
    data, e = fit.squares.data, fit.squares.residual(fit.theta)
    usual = float(np.median(np.abs(e[data.ok]))) / 0.6745
    odd = data.ok & (np.abs(e) > GLITCH * max(usual, LEAST_ODD))
    if not odd.any() or odd.sum() > RARE * data.ok.sum():
        return fit
    regular = data._replace(ok=data.ok & ~odd, y=np.where(odd, 0.0, data.y))
    return LeastSquares(fit.model.along(regular)).best([fit.theta]) or fit


def with_gap(case: Case, found: Found) -> Found:
    """Return the widths of a play, and perhaps of a dead zone; without widths above 0 it is none.

    Args:
        case: the log.
        found: named a play, or both.
    """
    assert found.plays is not None
    fit, whole = found.plays.fits[found.verdict.word], found.plays.whole
    gap = find_gap(fit, case.quantum, detect_feedback(case).is_closed)
    case.advance(1)
    rms = gap.fit.squares.rms(gap.fit.theta)
    offsets = along(gap.fit.model.simulator, gap.theta, rms, case.quantum)
    found = found._replace(offsets=offsets)
    if _is_denied(gap, offsets):
        smaller = {"both"} if fit.model.zone else set(MEMORY)
        found = found.judge_again(case, without=smaller)
        return with_gap(case, found) if found.verdict.word in MEMORY else found
    element = of_play(gap, whole, case.offset)
    delay = case.fitted.delay if whole is case.data else 0
    return found._replace(element=element, delay=delay)


def _is_denied(gap: Gap, offsets: Offsets) -> bool:
    """Return whether a width is not above 0 for certain; the four offsets must not deny both of
    them.

    Offsets that are known so badly that this gap would not show deny nothing.
    """
    width = gap.intervals["width"]
    if gap.fit.model.zone:
        there = is_there(width) and is_there(gap.intervals["zone"])
        denies = offsets.name not in ("both", "play") and THERE * offsets.std[0] < width.value
        return not there or bool(denies)
    return gap.sure and not is_there(width)


def is_there(interval: Interval) -> bool:
    """Return whether a gap is above 0 for certain, and no less than matters."""
    return interval.low > 0 and interval.value > LEAST_GAP


# --- A play, and perhaps a dead zone after it


def of_play(gap: Gap, whole: plant.Data, offset: float | None) -> Element:
    """Return the element of a play, and of the dead zone after it.

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
        element = _hide_widths(element, gap.ahead.rms * whole.y_scale)
    elif model.zone:
        element = _with_zone(element, gap, whole.y_scale)
    else:
        element = element._replace(widths=_sides(gap, offset))
    if model.simulator.layout.integrators:
        element.remarks.append(f"z of an integrating plant has no zero of its own: {EVEN}")
    return element


def _of_all(gap: Gap, whole: plant.Data) -> tuple[PlayModel, Floats]:
    """Return the model of all records, and its numbers; at rest at first where a part was
    fitted.
    """
    old = gap.fit.model
    if old.data.y.size == whole.y.size:
        return old, gap.theta
    model = old.along(whole)
    return model, model.simulator.layout.at_rest(old.simulator.layout, gap.theta)


def _hide_widths(element: Element, strong: float) -> Element:
    """No widths: a disturbance of that rms [y] hides them."""
    remark = (
        f"a disturbance of rms {strong:.3g} moves z ahead of the play, and turns that no input"
        " made hide the gap: no width is given; record with a larger input"
    )
    return element._replace(remarks=[remark])


def _with_zone(element: Element, gap: Gap, scale: float) -> Element:
    """Return the widths of a play and of the dead zone after it."""
    shown = {name: interval.scale_interval(scale) for name, interval in gap.intervals.items()}
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
    """Return the play's widths [y]; what an offset of the output leaves of its sides and its
    centre.
    """
    shown: dict[str, Interval | None] = {}
    for name, row in DIRECTIONS.items():
        interval = gap.intervals[name]
        half = with_offset(interval.half, row, offset)
        shown[name] = Interval.around(interval.value, half).scale_interval(
            gap.fit.model.data.y_scale
        )
    if gap.fit.model.tied:
        shown["centre"] = None
    return shown


# --- A dead zone of the actuator, and perhaps one of the sensor


def at_input(case: Case, found: Found) -> Element | None:
    """Return the zone of the input, or of both ends, with the plant; None where none fits.

    Args:
        case: the log.
        found: named input_zone, or two_zones.
    """
    word, fits = found.verdict.word, [one.pairs for one in case.fitted.fits]
    both = word == "two_zones"
    zoned = fit_both_ends(fits, found.places[word]) if both else fit_at_input(fits)
    return None if zoned is None else _of_zones(zoned, case)


def _of_zones(zoned: Zoned, case: Case) -> Element:
    """Return the element of a fit of the longest record, or of all; along all of them."""
    fit, model, numbers = zoned.fit, zoned.fit.model, zoned.fit.theta
    whole, data, layout = case.data, model.simulator.data, model.simulator.layout
    passed = dead_zone(whole.u, *numbers[layout.input])
    simulator = plant.Simulator(whole._replace(u=passed), layout.n)
    theta = np.zeros(simulator.layout.size)
    known = layout.x0.stop if data.y.size == whole.y.size else layout.b.stop  # else at rest
    theta[:known] = numbers[:known]
    z = simulator.z(theta)
    both, readings = model.name == "two_zones", model.readings(z, numbers)
    widths, degrees = _zone_of(zoned, (), float(whole.u_scale[0]), 0.0)
    at_both, remarks = {}, ["the widths are those of the input, in its unit"]
    if both:
        at_both, remarks = widths, []
        widths, degrees = _zone_of(zoned, (0.0, 0.0), whole.y_scale, case.offset)
    target, last = zoned.stages[-1]
    e, heard = fit.squares.residual(numbers), data.ok & ((data.side != 0) | (not data.silent_zeros))
    rms = float(np.sqrt(np.mean(e[heard] ** 2)))
    return Element(
        kind=model.name,
        fit=fit,
        simulator=simulator,
        theta=theta,
        V=target.spread(last).V[: layout.b.stop, : layout.b.stop],
        z=z,
        readings=readings,
        side=np.sign(readings if both else passed[:, 0]).astype(int),
        widths=dict(widths),
        ahead=plant.disturbance_ahead(layout, numbers, e, data.ok),
        noise=min(white_noise(data.y, data.ok, data.start), rms),
        degrees=degrees,
        rms=rms,
        remarks=remarks,
        input=at_both,
    )


def _zone_of(
    zoned: Zoned, before: tuple[float, ...], scale: float, offset: float | None
) -> tuple[dict[str, Interval], float]:
    """Return the widths of a zone, and their least degrees of freedom.

    Args:
        zoned: the fit.
        before: weights of the widths before those of this zone.
        scale: of its signal.
        offset: rms of an unknown offset, scaled; None: free.
    """
    widths, least = {}, math.inf
    for name, row in DIRECTIONS.items():
        value, half, degrees = zoned.width(*before, *row)
        half = with_offset(math.hypot(half, heaviest(row) * FINEST), row, offset)
        widths[name] = Interval.around(value, half).scale_interval(scale)
        least = min(least, degrees)
    return widths, least


# --- Whether what explains the log best leaves nothing known


def fit_of(case: Case, found: Found, word: str) -> Fitted[Any] | None:
    """Return the best fit of a word's models, by BIC per reading; None where there is none.

    Args:
        case: with static maps.
        found: with all other models.
        word: the verdict's, as the odds have it.
    """
    plays = {} if found.plays is None else found.plays.fits
    there = [fits.get(word) for fits in (case.maps, found.places, found.chains, plays)]
    fits: list[Fitted[Any]] = [one for one in there if one is not None]
    return min(fits, key=lambda one: one.density.bic / one.density.value.size, default=None)


def has_a_model(case: Case, found: Found) -> bool:
    """Return whether a name is given, or odds are, and no servo's own tests stand behind it."""
    of_servo = found.element is not None and isinstance(found.element.fit, ServoGap)
    word, top = found.verdict.word, next(iter(found.odds), "")
    is_said = word == "unclear" or (word == "other" and top != "other")  # why nothing is named
    reason = next(iter(found.verdict.reasons), "")
    is_said |= word == "undecided" and not reason.startswith(CANNOT_TELL)
    return bool(top) and not (is_said or of_servo or case.jumps)


def with_adequacy(case: Case, found: Found) -> Found:
    """What is found, unless what the likeliest model leaves depends on something known.

    Args:
        case: the log.
        found: with odds.
    """
    word = found.verdict.word
    if word not in found.odds or word in TOP_OF_ODDS:
        word = next(iter(found.odds))
    fit = fit_of(case, found, word)
    remainder = None if fit is None else largest_remainder(fit, word)
    if remainder is None:
        return found if word not in found.chains else _in_numbers(case, found)
    return found._replace(
        verdict=decide("unclear", *remainder.in_words(MODELS[word])), element=None
    )


def _in_numbers(case: Case, found: Found) -> Found:
    """What is found, with the numbers of a chain that is named."""
    word, verdict, data = found.verdict.word, found.verdict, case.data
    if word not in CHAINED:
        return found
    one = found.chains[word]
    said = one.model.in_words(one.theta, float(data.u_scale[0]), data.y_scale)
    return found._replace(verdict=verdict._replace(reasons=[said]))


def without_needless(case: Case, found: Found) -> Found:
    """What is found, unless the sensor's zone alone leaves no more of held-out data.

    A larger model must simulate them better, too: one-step errors alone are decided by the colour
    of what disturbs the plant.

    Args:
        case: the log.
        found: with a word of a model that holds a sensor's zone and more.
    """
    larger = fit_of(case, found, found.verdict.word)
    models = (found.places.get("dead_zone"), case.maps.get("dead_zone"))
    if larger is None or not any(models):
        return found
    size = larger.squares.data.y.size
    smaller = next((one for one in models if one and one.squares.data.y.size == size), None)
    if smaller is None:
        return found
    held_out = case.options.held_out
    errors = [held_out_error_of_fit(one, held_out).error for one in (smaller, larger)]
    if errors[1] < errors[0]:
        return found
    denied = found.denied | {found.verdict.word}
    return found._replace(denied=denied).judge_again(case)


# --- How it does on data that had no part in its fit


def held_out_error(element: Element, held_out: float) -> HeldOut:
    """Return error, share and whiteness on blocks of a log, fitted to the others.

    Args:
        element: a play, or a zone of the input.
        held_out: share of the samples that checks.
    """
    if isinstance(element.fit, ServoGap):
        return _held_out_error_of_servo(element, element.fit, held_out)
    return held_out_error_of_fit(element.fit, held_out, LAST[element.kind])


def held_out_error_of_fit(fit: Fitted[Any], held_out: float, last: int = LONGEST) -> HeldOut:
    """Return the same of any model that simulates the readings.

    Args:
        fit: the model.
        held_out: share of the samples that checks.
        last: steps of the climb to the others.
    """
    data = fit.squares.data
    train = training_samples(data, held_out)
    trained = LeastSquares(fit.model.along(data._replace(ok=data.ok & train, climbs=None)))
    top = best_top(trained, [fit.theta], fit.model.first, last)
    theta = fit.theta if top is None else top.theta
    test = data.ok & ~train
    e = fit.squares.residual(theta)
    return judge_errors(e, data, test, one_step(e, test, test, data.start))


def _held_out_error_of_servo(element: Element, gap: ServoGap, held_out: float) -> HeldOut:
    """Return the same of a servo's predictor, which hears every reading up to the one before."""
    data, log = element.simulator.data, gap.log
    test = data.ok & ~training_samples(data, held_out)
    one = gap.fit_training_samples(~test)
    readings = gap.predict_readings(one)[1] * (log.y_scale / data.y_scale) + data.y[data.ok][0]
    counted, ends = log.counted_samples(False), np.zeros(1, int)
    r = gap.errors(one)
    errors = one_step(r, test[counted], np.ones(r.size, bool), ends)
    return judge_errors(readings - data.y, data, test, errors)
