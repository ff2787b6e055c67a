"""Other nonlinearities than the sensor's dead zone: a play, both, a zone of the input.

The finding stands in its place, with its plant. u is known, so the output of a zone of the input is
known for every pair of widths: least squares of the simulated output is consistent whatever
disturbs the plant, as long as u does not answer to it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone.util.files import read_table
from undeadzone_identify.models import plant
from undeadzone_identify.models.chain import ChainFit, ChainModel
from undeadzone_identify.models.elements import (
    FEWEST,
    MapModel,
    PlayFit,
    fit_play,
    fit_play_and_zone,
)
from undeadzone_identify.models.estimates import Interval, best_maximum, long_run_covariance
from undeadzone_identify.models.kalman_fit import KalmanFit
from undeadzone_identify.models.least_squares import (
    CHANCE,
    FittedModel,
    LeastSquares,
)
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.measured import measure_fit
from undeadzone_identify.models.motion import white_noise_rms
from undeadzone_identify.models.place import (
    PlaceFit,
)
from undeadzone_identify.models.play_gap import RUNS, PlayGap, find_play_gap
from undeadzone_identify.models.zone_fit import refit_busiest_part
from undeadzone_identify.selection.adequacy import (
    NONE_EXPLAINS,
    SEEN,
    Remainder,
    explains_more_bent,
    find_remainders,
    largest_remainder,
)
from undeadzone_identify.selection.decision import (
    CANNOT_TELL,
    CHAINED,
    MEMORY,
    MODELS,
    UNLIKELY,
    UNSETTLED,
    Case,
    Verdict,
    build_verdict,
    classify_by_probabilities,
    detect_feedback,
)
from undeadzone_identify.selection.odds import Family, model_probabilities
from undeadzone_identify.selection.orders import (
    HeldOutScore,
    predict_one_step,
    score_held_out,
    training_samples,
)
from undeadzone_identify.selection.widths import widen_by_offset
from undeadzone_identify.servo.gap import ServoGap

WIDER = 1.25  # of a friction's interval: how a motor sticks is assumed
LEAST_GAP = 0.02  # rms of y, below which a gap is no matter
LEAST_NOISE = 0.01  # rms of y, from which noise that falls silent is told from rounding
EVEN = "the centre of the gap is not known, and both sides are half of the width"
LONGEST = 25  # steps of a climb that checks a fit
TOP_OF_ODDS = ("none", "saturation")  # named for other reasons than odds, too
_TABLES = read_table(__file__)
SMALLER, MEASURED = _TABLES["smaller"], _TABLES["measured"]  # by word
SURELY = 2.0  # deviations, by which a larger model must be worse to be denied
APART = 2.5  # deviations, by which a model is told from another
LITTLE = 0.1  # share of held-out squares: a smaller gain must be one by SURELY deviations
MOST_INSIDE = 0.5  # slope in the middle of a zone over that outside, from which it is another curve
# words of models with a plant of their own
OF_THEIR_OWN = ("friction", "saturation", "other", "input_zone", "two_zones", *CHAINED)
EXCLUDED = {"deadzone": MEMORY, "play": ("friction",)}  # words by what --kind tells
PLACED = {"actuator": "input_zone", "plant": "friction"}  # words by what --place tells
REPEATED = 0.2  # of the readings, from which only changes may be stored
STORED = 3.0  # quanta of the readings, from which the least change is none of rounding
AT_ONCE_POLE = math.exp(-1)  # of a sampled plant, whose time constant is a sample
SAME_AT_ONCE = (
    f"{CANNOT_TELL} friction from a play of twice its level: the readings follow within a sample,"
    " and then both are the same. If you know that it is a play, use --kind play"
)
BEYOND, LEAST_BEYOND = 3.0, 0.05  # rms beyond limits, over that of white noise, and over y's
PASSES_LIMITS = (
    f"{NONE_EXPLAINS}: readings exceed the fitted limits of the saturation. Record slow ramps"
    " through the whole range"
)
ON_EACH = 0.05  # of the readings, that each of two levels has at least
SPREAD = 0.04  # of the distance of two levels: median distance of readings from their level
FAR_AWAY, BETWEEN = 7.0, 0.01  # times that; of the readings that may lie farther from both levels
UNSEEN = 0.1  # of the readings' noise: what a disturbance makes of z, and no log of this kind shows
AHEAD = ("input_zone", "input_play")  # words of elements of the input
OF_INPUT = ("friction", *AHEAD)  # words of widths in the input's unit


class Element(NamedTuple):
    """Element other than a dead zone of the sensor, with the plant of its own fit.

    Attributes:
        kind: play, both, input_zone, two_zones, input_play; none or friction of a servo without a
            gap.
        fit: of the model.
        simulator: the plant, with all records.
        theta: its numbers a, b, x0, ..., scaled; of an input zone at rest at first.
        V: covariance of a and b.
        z: output of the plant (N), scaled.
        readings: of z without noise (N), scaled.
        side: contact of a play, of the input's too, side of an input zone (N).
        widths: right, left, width, centre in units of the log; None if they are not known.
        ahead: disturbance of z, scaled; None if it was not separated.
        noise: rms of the readings' white noise, scaled.
        degrees: of freedom of the intervals.
        rms: of the residual, scaled.
        remarks: on the widths.
        zone: both: d_r + d_l beside the play's width [y]; else None.
        edges: both: d_r and d_l if c_r = c_l, the sum of both centres in them [y]; else None.
        input: two_zones: the widths of the input's zone, as `widths` are the sensor's [u].
        level: input_play: constant part of the readings beside z, scaled; 0 if noise hides it.
    """

    kind: str
    fit: PlayFit | FittedModel[MapModel] | ChainFit | ServoGap
    simulator: plant.PlantSimulator
    theta: Floats
    V: Floats
    z: Floats
    readings: Floats
    side: Integers
    widths: dict[str, Interval | None]
    ahead: plant.InputDisturbance | None
    noise: float
    degrees: float
    rms: float
    remarks: list[str]
    zone: Interval | None = None
    edges: tuple[Interval, Interval] | None = None
    input: dict[str, Interval] = {}
    level: float = 0.0

    @property
    def servo(self) -> ServoGap | None:
        """Return the servo behind a play; None if the element is not a servo."""
        return self.fit if isinstance(self.fit, ServoGap) else None

    def lacks_edge(self, side: str) -> bool:
        """Return whether the log never passes the edge of a side, which has a bound alone."""
        edge = self.widths.get(side)
        return edge is not None and math.isinf(edge.high)

    @property
    def is_at_rest(self) -> bool:
        """Return whether only white noise shows of the disturbance of such a model."""
        return self.kind in OF_THEIR_OWN and (
            self.ahead is None or self.ahead.rms < UNSEEN * self.noise
        )

    @property
    def disturbance_rms(self) -> float:
        """Return the rms of the motion of z that no input explains, scaled."""
        return self.rms if self.ahead is None else self.ahead.rms


class Findings(NamedTuple):
    """Findings on a case so far.

    Attributes:
        verdict: so far.
        delay: samples by which the input acts late; of a play in the records as they are none.
        models: every model that was fitted, those of the same readings together.
        odds: by the verdict's words, largest first.
        plays: with a memory by word, play or both; None: none was found.
        places: models of the zone's place by word; empty if that was not asked.
        chains: models of the input's curve or play, and of a filter, by word.
        shaped: a zone with slopes of its sides, round edges and a lag; None: not fitted.
        denied: words of larger models that simulate held-out data no better.
        element: in the place of a sensor's dead zone; None: there is none.
        kalman: fits of (L2), best first.
        friction: its level [u], the mean of both directions; None if it is not measured.
        remainders: score tests of the likeliest model, by direction; empty: not tested.
    """

    verdict: Verdict
    delay: int
    models: tuple[Family, ...]
    odds: dict[str, float]
    plays: dict[str, PlayFit] | None = None
    places: dict[str, PlaceFit] = {}
    chains: dict[str, ChainFit] = {}
    shaped: ChainFit | None = None
    denied: frozenset[str] = frozenset()
    element: Element | None = None
    kalman: Sequence[KalmanFit] = ()
    friction: Interval | None = None
    remainders: Sequence[Remainder] = ()

    def add_models(self, case: Case, *models: Family, without: Collection[str] = ()) -> Findings:
        """Return the findings with more models and a new decision, perhaps without some
        classes.
        """
        every = (*self.models, *models)
        odds = model_probabilities(every, {*without, *self.denied, *impossible_words(case)})
        found = self._replace(models=every, odds=odds)
        return found._replace(verdict=found.classify(case))

    def without_name(self, word: str, *reasons: str) -> Findings:
        """Return the findings with a verdict that withholds the name, for these reasons."""
        return self._replace(verdict=build_verdict(word, *reasons), element=None, odds={})

    def classify(self, case: Case) -> Verdict:
        """Return the verdict by the odds.

        Args:
            case: the log.
        """
        fits = dict(self.places) | dict(self.chains) | dict(self.plays or {})
        return classify_by_probabilities(case, self.odds, self.models, fits)


def impossible_words(case: Case) -> Collection[str]:
    """Return the classes that are impossible: by the user's options, or by exact zeros under
    noise.
    """
    placed = PLACED.get(case.options.place)
    out = set(EXCLUDED.get(case.options.kind, ()))
    out |= set() if placed is None else set(MODELS) - {"none", placed}
    if not case.record_data.silent_zeros or case.jump_edges or placed is not None:
        return out
    speaks = case.record_data.ok & (case.record_data.side != 0)
    loud = white_noise_rms(case.chosen.fit.unexplained, speaks, case.record_data.start)
    if loud > max(2 * case.quantum, LEAST_NOISE):  # and only a sensor's zone silences it
        out |= {"none", "friction", "input_zone", "play", "saturation", "other"}
        out |= set(CHAINED) - {"filtered_zone"}
    return out


# --- Is it a play, or a play and a dead zone?


def add_play(case: Case, found: Findings) -> Findings:
    """Add a play, or a play with a dead zone, if either may explain the log better.

    Args:
        case: with static maps.
        found: the odds of these.
    """
    if not _needs_play_test(case, found):
        return found
    late = case.options.delay == "auto" and case.fitted.delay  # a play is late, so it may be one
    logs = [case.recorded, case.record_data] if late else [case.record_data]
    plays = [_fit_plays(case, data) for data in logs]
    best = min(plays, key=lambda fits: min((fit.bic for fit in fits.values()), default=math.inf))
    if not best:
        return found
    models = {"none": case.rivals["none"]} | {word: fit.density for word, fit in best.items()}
    return found._replace(plays=best).add_models(case, models)


def _fit_plays(case: Case, data: plant.RecordData) -> dict[str, PlayFit]:
    """Fit a play, and a play with a dead zone; return the fits by class, none if none is
    stable.
    """
    begun = [
        refit_busiest_part(one.fit)
        for one in (case.chosen, *case.fitted.fits)
        if data is case.record_data
    ]
    play = fit_play(
        plant.busiest_stretches(data), case.fitted.prepared.orders, case.options.integrators
    )
    if play is None:
        return {}
    both = fit_play_and_zone([play, *begun])
    return {"play": play} | ({} if both is None else {"both": both})


def _needs_play_test(case: Case, found: Findings) -> bool:
    """Return whether a play must be tested: it explains the log, or a memory may."""
    kind = case.options.kind
    if kind in ("jump", "deadzone"):
        return False
    perhaps = found.verdict.word in ("other", "unclear", "undecided", "friction") or kind == "play"
    perhaps |= found.odds.get("zone_and_friction", 0.0) > UNLIKELY  # a memory beside the zone
    if perhaps:
        return True
    both = fit_play_and_zone([refit_busiest_part(case.chosen.fit)])  # a lag may pass for a play
    models = {"none": case.rivals["none"]} | ({} if both is None else {"both": both.density})
    return (
        model_probabilities((*found.models, models), impossible_words(case)).get("both", 0.0)
        > UNLIKELY
    )


def add_play_gap(case: Case, found: Findings) -> Findings:
    """Add the widths of a play, and perhaps of a dead zone; the play is dropped if a width may
    be 0.

    Args:
        case: the log.
        found: named a play, or both.
    """
    assert found.plays is not None
    fit = found.plays[found.verdict.word]
    whole = _records_of(case, fit)
    gap = find_play_gap(fit, case.quantum, detect_feedback(case).is_closed)
    case.advance(1)
    names = ("width", "zone") if fit.model.zone else ("width",)
    shown = [gap.intervals[name] for name in names]
    if not all(one.low > 0 and one.value > LEAST_GAP for one in shown):
        if not (fit.model.zone or gap.sure):
            assert gap.ahead is not None
            reason = _describe_hidden_gap(gap.ahead.rms * whole.y_scale)
            return found.without_name("undecided", reason)
        smaller = {"both"} if fit.model.zone else set(MEMORY)
        found = found.add_models(case, without=smaller)
        return add_play_gap(case, found) if found.verdict.word in MEMORY else found
    element = build_play_element(gap, whole, case.offset_prior)
    delay = case.fitted.delay if whole is case.record_data else 0
    return found._replace(element=element, delay=delay)


# --- A play, and perhaps a dead zone after it


def build_play_element(gap: PlayGap, whole: plant.RecordData, offset: float | None) -> Element:
    """Build the element of a play, and of the dead zone after it.

    Args:
        gap: of the log or of its busiest part.
        whole: all records.
        offset: rms of an unknown offset of the output, scaled; None: free.
    """
    model, theta = _extend_to_records(gap.fit, gap.theta, whole)
    element = _element_of_fit("both" if model.zone else "play", gap.fit, model, theta)
    level, moved = model.play_level(element.z, theta)
    moves = np.append(False, np.diff(level) != 0)
    element = element._replace(
        V=gap.V,
        side=np.where(moves, moved, 0.0).astype(int),
        ahead=gap.ahead,
        noise=gap.noise,
        degrees=RUNS - 1,
        rms=gap.fit.squares.residual_rms(gap.fit.theta),
    )
    if gap.ahead is not None and not gap.sure:
        element.remarks.append(_describe_hidden_gap(gap.ahead.rms * whole.y_scale))
    elif model.zone:
        shown = {name: interval.scale_by(whole.y_scale) for name, interval in gap.intervals.items()}
        element = element._replace(
            widths=element.widths | {"width": shown["width"]},
            zone=shown["zone"],
            edges=(shown["zone_right"], shown["zone_left"]),
            remarks=["of both centres only the sum shows"],
        )
    else:
        widths = _intervals_with_offset(gap.intervals, whole.y_scale, offset)
        known = widths | {"centre": None} if model.tied else widths
        element = element._replace(widths=dict(known))
    if model.simulator.layout.integrators:
        element.remarks.append(f"z of an integrating plant has no zero of its own: {EVEN}")
    return element


def _extend_to_records(
    fit: FittedModel[Any], theta: Floats, whole: plant.RecordData
) -> tuple[Any, Floats]:
    """Return the model of a fit and its parameters for all records; at rest at first if a part was
    fitted.
    """
    model = fit.model.along(whole)
    if fit.model.simulator.data.y.size == whole.y.size:
        return model, theta
    return model, model.simulator.layout.at_rest(fit.model.simulator.layout, theta)


def _describe_hidden_gap(rms: float) -> str:
    """Return the remark that a disturbance of a given rms ahead of a play hides its gap [y]."""
    return (
        f"a disturbance of rms {rms:.3g} moves z ahead of the play, and turns that no input"
        " made hide the gap: no width is given. Record with a larger input"
    )


# --- Readings that are stored only on change, or those of a switch


def has_hidden_readings(case: Case, found: Findings) -> bool:
    """Return whether the readings repeat, move by more than a step, or have two levels."""
    return find_stored_step(case) > 0 or is_switch(case)


def withhold_hidden_readings(case: Case, found: Findings) -> Findings:
    """Withhold the name, since between stored changes, or two levels, the output is not known.

    Args:
        case: the log.
        found: with any name.
    """
    seen = (
        f"the readings repeat, and else move by {find_stored_step(case):.3g} or more: a recorder"
        " that stores changes only, or something that sticks. Nothing is named"
    )
    cure = "record every sample, with the dead band (exception, compression) of the recorder at 0"
    if is_switch(case):
        seen = "the readings have two levels alone, as those of a switch. Nothing is named"
        cure = "record the signal ahead of the switch, with a sensor that reads it in between"
    return found.without_name("unclear", seen, cure)._replace(friction=None)


def is_switch(case: Case) -> bool:
    """Return whether the readings have two levels and the input has more."""
    has_levels = _has_two_levels(case.grid.y[case.grid.ok])
    return has_levels and not any(map(_has_two_levels, case.grid.u.T))


def _has_two_levels(values: Floats) -> bool:
    """Return whether values lie about two levels, and hardly ever between."""
    above = values > (values.min() + values.max()) / 2
    if not ON_EACH < above.mean() < 1 - ON_EACH:
        return False
    high = np.median(values[above])
    low = np.median(values[~above])
    away = np.abs(values - np.where(above, high, low))
    spread = float(np.median(away))
    return spread < SPREAD * (high - low) and bool(np.mean(away > FAR_AWAY * spread) < BETWEEN)


def find_stored_step(case: Case) -> float:
    """Return the least change of readings of which only changes are stored [y]; else 0.

    Rounded readings move by the spacing of their values, and those of an element that sticks or of
    a slow sensor also by less.
    """
    moves = np.abs(np.diff(case.grid.y[case.grid.ok]))
    moved = moves[moves > 0]
    if moved.size < FEWEST or moved.size > (1 - REPEATED) * moves.size:
        return 0.0
    least = float(np.quantile(moved, 0.05))
    quantum = case.quantum * case.record_data.y_scale
    is_step = least > max(0.5 * np.median(moved), STORED * quantum)
    return least if is_step else 0.0


# --- Any other model that is named


def _measure_input_zone(
    case: Case, fit: FittedModel[Any], misfits: Sequence[Floats]
) -> tuple[dict[str, Interval], float]:
    """Return the widths of the input's zone [u], and their least degrees of freedom."""
    data = fit.model.simulator.data
    measured = measure_fit(fit, misfits, lambda theta: fit.model.part_numbers(theta, "input"))
    u = data.u[:, 0]
    scale = data.input_scale
    passed = fit.model.pass_input(u, fit.theta)
    return _bound_unpassed(measured.scale_by(scale), scale * u, passed), measured.degrees


def _bound_unpassed(widths: dict[str, Interval], u: Floats, passed: Floats) -> dict[str, Interval]:
    """Return the widths of the input with the lower bound of an edge that it hardly passes.

    A fit puts such an edge at the end of the input, whatever it is.

    Args:
        widths: by direction [u].
        u: the input (N).
        passed: the input behind the zone (N).

    Returns:
        Widths by direction, without a sum that is not known.
    """
    known = dict(widths)
    for name, sign in (("right", 1.0), ("left", -1.0)):
        if np.count_nonzero(sign * passed > 0) < FEWEST:
            end = float((sign * u).max())
            known[name] = Interval(end, end, math.inf)
            for summed in ("width", "centre"):
                known.pop(summed, None)
    return known


def _intervals_with_offset(
    measured: Mapping[str, Interval], scale: float, offset: float | None
) -> dict[str, Interval]:
    """Return the widths of an element in units of the log.

    Args:
        measured: the widths by direction.
        scale: of their signal.
        offset: rms of an unknown offset, scaled; None: free.
    """
    widths = {}
    for name, row in DIRECTIONS.items():
        one = measured[name]
        half = widen_by_offset(one.half_width, row, offset)
        widths[name] = Interval.from_half_width(one.value, half).scale_by(scale)
    return widths


def needs_an_element(case: Case, found: Findings) -> bool:
    """Return whether the model that is named has a plant of its own, and no element yet."""
    word = found.verdict.word
    is_likeliest = word == next(iter(found.odds), "") or word != "other"
    is_open = found.element is None
    return is_open and word in OF_THEIR_OWN and word in found.odds and is_likeliest


def add_named_element(case: Case, found: Findings) -> Findings:
    """Add the model that is named, with its numbers: friction, a filtered zone, play ahead, ...

    Args:
        case: the log.
        found: with a name.
    """
    word = found.verdict.word
    fit = fit_of(case, found, word)
    if fit is None:
        return found
    misfits = [one.moves for one in found.remainders if one.chance < CHANCE]
    whole = _records_of(case, fit)
    model, theta = _extend_to_records(fit, fit.theta, whole)
    widths, degrees = measure_word(case, fit, word, misfits)
    element = _element_of_fit(word, fit, model, theta)._replace(widths=widths, degrees=degrees)
    if word == "two_zones":
        element = element._replace(input=_measure_input_zone(case, fit, misfits)[0])
    friction = None
    if word == "friction":
        friction = level_of_friction(element.widths)
        element = element._replace(widths=element.widths | {"width": None})
    delay = found.delay if whole is case.record_data else 0
    return found._replace(element=element, friction=friction, delay=delay)


def level_of_friction(widths: Mapping[str, Interval | None]) -> Interval | None:
    """Return the mean friction of both ways, or that of the only way in which the log moves."""
    if (width := widths["width"]) is not None:
        return width.scale_by(0.5)
    sides = filter(None, (widths[name] for name in ("right", "left")))
    return next((one for one in sides if math.isfinite(one.high)), None)


def _records_of(case: Case, fit: FittedModel[Any]) -> plant.RecordData:
    """Return the records of which a part was fitted: as shifted, or as they were recorded."""
    own = fit.squares.data.u

    def distance(whole: plant.RecordData) -> float:
        """Return how far the inputs of its parts are from those of the fit, scaled."""
        parts = (plant.longest_record_of(whole).u, plant.busiest_stretches(whole).u)
        apart = (float(np.abs(u - own).sum()) for u in parts if u.shape == own.shape)
        return min(apart, default=math.inf)

    return min((case.record_data, case.recorded), key=distance)


def measure_word(
    case: Case, fit: FittedModel[Any], word: str, misfits: Sequence[Floats] = ()
) -> tuple[dict[str, Interval | None], float]:
    """Measure the widths of a fitted class in units of the log; None if it has none.

    Args:
        case: the log.
        fit: of the class.
        word: the verdict's for it.
        misfits: as `measure_fit` takes them.

    Returns:
        right, left, width and centre, and their least degrees of freedom.
    """
    none: dict[str, Interval | None] = dict.fromkeys(DIRECTIONS)
    if word not in MEASURED:
        return none, math.inf
    if word == "input_zone":
        known, degrees = _measure_input_zone(case, fit, misfits)
        return none | known, degrees
    measured = measure_fit(fit, misfits)
    if word in OF_INPUT:
        widths = measured.scale_by(case.record_data.input_scale)
        if word == "friction":
            widths = {name: one.stretch_by(WIDER) for name, one in widths.items()}
            read = fit.model.noise_free_readings(fit.model.output(fit.theta), fit.theta)
            widths = _bound_unpassed(widths, case.grid.u[:, 0], read)
    else:
        widths = _intervals_with_offset(
            measured.intervals, case.record_data.y_scale, case.offset_prior
        )
    return none | {name: widths.get(name) for name in MEASURED[word]}, measured.degrees


def _element_of_fit(word: str, fit: FittedModel[Any], model: Any, theta: Floats) -> Element:
    """Return the element of a fit along all records, without its widths.

    Args:
        word: the verdict's for it.
        fit: to the longest or all records.
        model: along all records.
        theta: parameters of it.
    """
    whole = model.simulator.data
    z = model.output(theta)
    layout = model.simulator.layout
    read = model.noise_free_readings(z, theta)
    e = np.where(whole.ok, whole.y - read, 0.0)
    level = float(e[whole.ok].mean()) if model.has_level else 0.0
    e = np.where(whole.ok, e - level, 0.0)
    rms = root_mean_square(e[whole.ok])
    noise = min(white_noise_rms(whole.y, whole.ok, whole.start), rms)
    side = np.sign(read)
    if word in AHEAD:
        passed = model.driven_plant(theta).data.u[:, 0]
        side = np.sign(passed if word == "input_zone" else np.diff(passed, prepend=passed[0]))
    is_offset = word == "input_play" and abs(level) > max(noise, LEAST_NOISE)
    count = layout.numerators.stop
    return Element(
        kind=word,
        fit=fit,
        simulator=model.driven_plant(theta),
        theta=theta,
        V=fit.squares.robust_covariance(fit.theta).V[:count, :count],
        z=z,
        readings=read + level,
        side=side.astype(int),
        widths=dict.fromkeys(DIRECTIONS),
        ahead=plant.find_input_disturbance(layout, theta, e, whole.ok),
        noise=noise,
        degrees=math.inf,
        rms=rms,
        remarks=[],
        level=is_offset * level,
    )


# --- Whether what explains the log best leaves nothing known


def fit_of(
    case: Case, found: Findings, word: str, readings: int | None = None
) -> FittedModel[Any] | None:
    """Return the best fit of a word's models, by BIC per reading; None if there is none.

    Args:
        case: with static maps.
        found: with all other models.
        word: the verdict's, as the odds have it.
        readings: number of samples that the fit has; None: any.
    """
    if word == "saturation" and case.limited is not None:
        return case.limited
    tables = (case.maps, found.places, found.chains, found.plays or {})
    there = [fits.get(word) for fits in tables]
    fits: Iterable[FittedModel[Any]] = filter(None, there)
    if readings is not None:
        fits = filter(lambda one: one.squares.data.y.size == readings, fits)
    return min(fits, key=lambda one: one.density.bic / one.density.value.size, default=None)


def has_a_model(case: Case, found: Findings) -> bool:
    """Return whether a name is given, or odds are, and no servo's own tests stand behind it."""
    of_servo = found.element is not None and found.element.servo is not None
    word = found.verdict.word
    top = next(iter(found.odds), "")
    is_said = word == "other" and top != "other"  # why nothing is named
    if word == "unclear":  # a plant that does not settle leaves traces of everything
        is_said |= UNSETTLED in found.verdict.reasons or not case.fitted.prepared.settles
    reason = next(iter(found.verdict.reasons), "")
    is_said |= word == "undecided" and not reason.startswith(CANNOT_TELL)
    return bool(top) and not (is_said or of_servo or case.jump_edges)


def with_adequacy(case: Case, found: Findings) -> Findings:
    """Withhold the name if the innovations of the likeliest model depend on a known signal.

    Args:
        case: the log.
        found: with odds.
    """
    word = found.verdict.word
    if not case.has_limits_as(word) and (word not in found.odds or word in TOP_OF_ODDS):
        word = next(iter(found.odds))
    fit = fit_of(case, found, word)
    remainders = [] if fit is None else find_remainders(fit)
    if case.quantum:  # its steps are known: a jump stands in the odds of readings without a zone
        remainders = [one for one in remainders if one.on != "steps"]
    remainder = largest_remainder(remainders, word)
    linear = fit_of(case, found, "none")
    reasons: tuple[str, ...]
    if remainder is not None:
        reasons = remainder.in_words(MODELS[word])
    elif fit is not None and linear is not None and _may_bend(word, linear, fit):
        less = f"a plant that bends leaves less than {MODELS[word]}. Nothing is named"
        reasons = (f"{NONE_EXPLAINS}: {less}", SEEN["spring"])
    else:
        return _in_numbers(case, found._replace(remainders=remainders))
    if found.verdict.word == "unclear":  # for a reason of its own; this one may explain it
        reasons = (*found.verdict.reasons, reasons[1])
    verdict = build_verdict("unclear", *reasons)
    return found._replace(remainders=remainders, verdict=verdict, element=None)


def _may_bend(word: str, linear: FittedModel[Any], fit: FittedModel[Any]) -> bool:
    """Return whether a plant that bends explains more than a word's model, which holds a line."""
    holds_line = "none" in SMALLER.get(word, ())
    same = linear.squares.data.y.size == fit.squares.data.y.size
    return holds_line and same and explains_more_bent(linear, fit)


def _in_numbers(case: Case, found: Findings) -> Findings:
    """Add the numbers of a chain or of limits that are named to the findings."""
    word = found.verdict.word
    verdict = found.verdict
    data = case.record_data
    if word == "friction" and _follows_at_once(fit_of(case, found, word)):
        return found.without_name("undecided", SAME_AT_ONCE)
    one = fit_of(case, found, word) if word in (*CHAINED, "other", "saturation") else None
    if one is not None and isinstance(one.model, MapModel):
        is_open = word == "saturation" and not case.fitted.prepared.ends.has_ends
        if is_open and _passes_limits(one, case.quantum):
            return found.without_name("unclear", PASSES_LIMITS)
        limits = filter(None, [one.model.describe_limits(one.theta, data.y_scale)])
        return found._replace(verdict=verdict._replace(reasons=[*verdict.reasons, *limits]))
    if one is None or not isinstance(one.model, ChainModel):
        return found
    description = one.model.in_words(one.theta, data.input_scale, data.y_scale)
    if one.model.is_at_bound(one.theta):
        seen = f"the best model is at the limit of its numbers: {description}. Nothing is named"
        return found._replace(verdict=build_verdict("unclear", seen, SEEN["input"]))
    if _may_be_neutral(one):
        reason = (
            f"{CANNOT_TELL} {MODELS[word]} from a straight line: the 95 % intervals of its numbers"
            f" hold one ({description}). Record for longer, or with a larger input"
        )
        return found.without_name("undecided", reason)
    return found._replace(verdict=verdict._replace(reasons=[description]))


def _follows_at_once(fit: FittedModel[Any] | None) -> bool:
    """Return whether a plant settles within a sample: friction in it shifts its output alone."""
    if fit is None:
        return False
    poles = fit.model.simulator.plant_poles(fit.theta)
    return bool(np.abs(poles).max(initial=0.0) < AT_ONCE_POLE)


def _passes_limits(fit: FittedModel[MapModel], quantum: float) -> bool:
    """Return whether readings lie far beyond the limits that hold them by the fit."""
    model = fit.model
    data = fit.squares.data
    read = model.noise_free_readings(model.output(fit.theta), fit.theta)
    above = data.y - read
    above -= above[data.ok].mean() * model.has_level
    for end, sign in ((read.max(), 1), (read.min(), -1)):
        held = data.ok & (read == end)
        if np.count_nonzero(held) < FEWEST:
            continue
        beyond = np.maximum(sign * above[held], 0.0)
        white = white_noise_rms(above, held, data.start)
        if math.sqrt(2 * np.mean(beyond**2)) > max(BEYOND * white, LEAST_BEYOND, quantum):
            return True
    return False


def _may_be_neutral(fit: ChainFit) -> bool:
    """Return whether the intervals of the input's element hold numbers that leave u as it is."""
    model = fit.model
    away = np.abs(model.distance_from_neutral(fit.theta))
    if not away.size:
        return False
    covariance = fit.squares.robust_covariance(fit.theta)
    halves = list(map(covariance.half_width, np.eye(model.free.size)[model.inputs]))
    return bool(np.all(away < halves))


def may_have_shaped_zone(case: Case, found: Findings) -> bool:
    """Return whether a shaped zone of the sensor has odds that count."""
    is_open = found.element is None
    return is_open and found.odds.get("filtered_zone", 0.0) > UNLIKELY


def deny_shaped_zone_without_width(case: Case, found: Findings) -> Findings:
    """Deny a shaped zone whose width may be 0, or that passes most of z inside: another element is
    likely.

    Args:
        case: the log.
        found: with odds of a shaped zone.
    """
    fit = fit_of(case, found, "filtered_zone")
    width = None if fit is None else measure_word(case, fit, "filtered_zone")[0]["width"]
    if fit is None or width is None:
        return found
    if width.low > 0 and fit.model.slope_inside(fit.theta) < MOST_INSIDE:
        return found
    return found._replace(denied=found.denied | {"filtered_zone"}).add_models(case)


def holds_more(case: Case, found: Findings) -> bool:
    """Return whether the model that is named holds a smaller one, and has a plant of its own."""
    return found.element is None and found.verdict.word in SMALLER


def without_needless(case: Case, found: Findings) -> Findings:
    """Deny the model that is named if a smaller one predicts held-out data as well.

    A larger model must simulate them better, too, and not by chance: one-step errors alone are
    decided by the colour of what disturbs the plant.

    Args:
        case: the log.
        found: with a word of a model that holds a smaller one.
    """
    word = found.verdict.word
    larger = None if word in found.denied else fit_of(case, found, word)
    if larger is None:
        return found
    held_out = case.options.held_out
    e, test = held_out_residual(larger, held_out)
    for name in SMALLER[word]:
        models = (found.places.get(name), case.maps.get(name))
        smaller = next((one for one in models if one and one.squares.data.y.size == e.size), None)
        if smaller is None:
            continue
        total, spread = gain_and_spread(e[test], held_out_residual(smaller, held_out)[0][test])
        sure = SURELY * spread
        if total > min(sure, LITTLE * float(e[test] @ e[test])):
            continue
        if total > -sure:
            rest = "the other all" if total < 0 else "but only by chance, perhaps, all"
            reason = (
                f"{CANNOT_TELL} {MODELS[word]} from {MODELS[name]}: one predicts a sample better,"
                f" {rest} that had no part in the fit. Record for longer"
            )
            return found.without_name("undecided", reason)
        again = found._replace(denied=found.denied | {word}).add_models(case)
        return without_needless(case, again) if holds_more(case, again) else again
    return found


# --- How it does on data that had no part in its fit


def gain_and_spread(error: Floats, other: Floats) -> tuple[float, float]:
    """Return how much less a model's squared errors are than another's, and its deviation.

    Args:
        error: of the model, on held-out data (N).
        other: of the other one (N).
    """
    gain = other**2 - error**2
    return float(gain.sum()), float(long_run_covariance(gain[:, None])[0][0, 0]) ** 0.5


def validate_element(element: Element, held_out: float) -> HeldOutScore:
    """Validate an element on held-out blocks: return error, share and whiteness.

    Args:
        element: a play, or a zone of the input.
        held_out: share of the samples that are held out.
    """
    if isinstance(element.fit, ServoGap):
        return _validate_servo(element, element.fit, held_out)
    e, test = held_out_residual(element.fit, held_out)
    data = element.fit.squares.data
    return score_held_out(e, data, test, predict_one_step(e, test, test, data.start))


def held_out_residual(fit: FittedModel[Any], held_out: float) -> tuple[Floats, Flags]:
    """Return the residual of a fit to the training samples (N), and the held-out samples.

    Args:
        fit: the model.
        held_out: share of the samples that are held out.
    """
    theta, test = train_fit(fit, held_out)
    return fit.squares.reading_residual(theta), test


def train_fit(fit: FittedModel[Any], held_out: float) -> tuple[Floats, Flags]:
    """Return the parameters of a fit to the training samples, and the held-out samples (N).

    Args:
        fit, held_out: as of `held_out_residual`.
    """
    data = fit.squares.data
    train = training_samples(data, held_out)
    trained = LeastSquares(fit.model.along(data._replace(ok=data.ok & train, climbs=None)))
    top = best_maximum(trained, [fit.theta], fit.model.first, LONGEST)
    return fit.theta if top is None else top.theta, data.ok & ~train


def _validate_servo(element: Element, gap: ServoGap, held_out: float) -> HeldOutScore:
    """Score a servo on held-out blocks: return error, share and whiteness.

    The servo is fitted to the other samples. Its prediction of a held-out reading uses all readings
    up to the previous sample.

    Args:
        element: the servo's play, with the records in the units of the answer.
        gap: the fitted servo, in its own units.
        held_out: share of the samples that are held out.
    """
    data = element.simulator.data
    log = gap.log
    test = data.ok & ~training_samples(data, held_out)
    fit = gap.fit_to_samples(~test)
    # The servo counts readings from the first one, in its own scale.
    predictions = gap.predict_readings(fit)[1] * (log.y_scale / data.y_scale) + data.y[data.ok][0]
    in_errors = log.error_samples(False)
    first_sample = np.zeros(1, int)
    normalised = gap.normalised_errors(fit)
    residuals = predict_one_step(
        normalised, test[in_errors], np.ones(normalised.size, bool), first_sample
    )
    return score_held_out(predictions - data.y, data, test, residuals)
