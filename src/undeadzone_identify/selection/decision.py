"""Log fitted with a zone of the sensor, and the verdict on the nonlinearity in the log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.util.arrays import shift_rows
from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.logs.log import Options
from undeadzone_identify.logs.prepare import JumpEdge
from undeadzone_identify.models import least_squares
from undeadzone_identify.models.elements import MapModel
from undeadzone_identify.models.estimates import long_run_covariance, student_quantile
from undeadzone_identify.models.least_squares import Density, FittedModel
from undeadzone_identify.models.plant import RecordData
from undeadzone_identify.models.zone_fit import ZoneFit, fit_arx, fit_linear
from undeadzone_identify.selection import orders
from undeadzone_identify.selection.delays import FittedOrders
from undeadzone_identify.selection.location import STEPS
from undeadzone_identify.selection.odds import Family
from undeadzone_identify.servo.gap import ServoGap

LEAST = 0.5  # share of the held-out readings that a fit must explain
LIKELY = 0.8  # odds from which a name is given
LIKELY_IN_LOOP = 0.9  # odds of no zone, from which it is named in a loop, which hides one
DOUBT = 0.01  # p of a plant without a zone, below which it is not named
SURELY_NONE = 0.95  # odds of no zone, from which it is named all the same
CONTRADICTED = 1e-6  # unless p is smaller
UNLIKELY = 0.05  # odds below which a name is not worth a word
FEW = 0.005  # of the readings, that may lie across 0 of an operating point
WELL_INSIDE = 2.0  # rms of the noise between z^ and an edge
SURE = 0.999  # level of the interval of an offset that must not hold 0
MOSTLY = 0.5  # share of the readings within their range, below which no memory is named; and of
# what a reference leaves of the input, that is readings', from which a loop is closed
RELEVANT = 0.1  # of the residual's rms, below which an offset is no matter
MEMORY = ("play", "both")  # words of what a play explains
CHAINED = (
    "input_curve",
    "input_play",
    "input_rate",
    "filtered_zone",
)  # words of models/chain.py
VALVE = ("stiction", "input_play")  # words of a valve's fault
AS_LINEAR = ("none", "dead_zone", "jump")  # words under which steps may be taken for a zone
LIMITED = ("none", "saturation", "other")  # words of readings that stick at their limits
FITTED = ("none", "dead_zone", "zone_and_friction")  # what the fit of a zone of the sensor holds
Fits = Mapping[str, Any]  # by word, each with a plant of its own: least_squares.Fitted
LARGER = {  # words of models that hold a word's model and more
    "dead_zone": ("zone_and_friction", "two_zones", "both", "filtered_zone"),
    "friction": ("zone_and_friction",),
    "input_zone": ("two_zones",),
    "play": ("both",),
}
CALM = 0.3  # of the readings' rms, that of held-out ones that hardly move
GROWS = 10.0  # logarithm of what a pole does along the log, from which it is unstable
UNSETTLED = (
    "the plant seems to integrate, or to ring longer than the record: its state at the start and"
    " an offset or a sine cannot be separated. Use --integrators 1 if it is the position of a"
    " motor, or the like. Else record for longer"
)
CANNOT_TELL = "this record cannot decide"
TOO_SHORT = (
    "the plant does not settle within a record: the log is shorter than about six of its time"
    " constants, and a slow pole beside an integrator looks like any curve. Record for"
    " longer"
)
MODELS = {
    "dead_zone": "a dead zone of the sensor",
    "none": "a plant without any zone",
    "saturation": "a saturation",
    "other": "another curve (|z|, cubic)",
    "jump": "a zone with a jump (readings not shifted)",
    "play": "play (gear backlash, hysteresis)",
    "both": "a play with a dead zone after it",
    "friction": "friction in the plant",
    "input_zone": "a zone of the input",
    "zone_and_friction": "friction beside a dead zone of the sensor",
    "two_zones": "a zone of the input beside one of the sensor",
    "input_curve": "a smooth curve of the input",
    "input_rate": "a limit of the input's rate",
    "input_play": "play between input and plant",
    "filtered_zone": "a dead zone of the sensor with a filter, two slopes or round edges",
}


class Case(NamedTuple):
    """Log fitted with a zone of the sensor, without a decision.

    Attributes:
        grid: the log on its grid.
        options: of the user.
        recorded: the records with the input as it was recorded.
        unreached: edges that no reading passes.
        fitted: every order.
        chosen: the order that was chosen.
        no_zone: the test of a zone against none.
        maps: static rivals, each behind the plant that suits it.
        limited: limits of the readings, fitted to all of them, if readings stick there and
            nothing else is left; else None.
        suited: the order behind which one of them explains the log best.
        advance: called with the number of steps just done.
        servo: withheld finding of the servo predictor, which is asked first; None: not asked.
    """

    grid: Grid
    options: Options
    recorded: RecordData
    unreached: tuple[str, ...]
    fitted: FittedOrders
    chosen: orders.OrderFit
    no_zone: orders.ZoneTest
    maps: dict[str, FittedModel[MapModel]]
    limited: FittedModel[MapModel] | None
    suited: orders.OrderFit
    advance: Callable[[int], None]
    servo: ServoGap | None = None

    @property
    def record_data(self) -> RecordData:
        """Return the records as fitted."""
        return self.fitted.prepared.data

    def has_limits_as(self, word: str) -> bool:
        """Return whether a word is that of the limits that explain all readings."""
        return word == "saturation" and self.limited is not None

    @property
    def rivals(self) -> dict[str, Density]:
        """Return the densities of static rivals, by the verdict's words."""
        return {name: one.density for name, one in self.maps.items()}

    @property
    def quantum(self) -> float:
        """Return the quantum of the readings, scaled."""
        return self.fitted.prepared.quantum

    @property
    def jump_edges(self) -> tuple[JumpEdge, JumpEdge] | None:
        """Return the edges of a jump sensor, scaled; None if the log is treated as another
        sensor's.
        """
        return self.fitted.prepared.jumps

    @property
    def offset_prior(self) -> float | None:
        """Return the prior rms of an output offset, scaled; None if free."""
        rms = self.options.parse_offset_rms()
        return None if rms is None else rms / self.record_data.y_scale


class Verdict(NamedTuple):
    """Verdict with its reasons; cautions: remarks on the reported widths."""

    word: str
    reasons: list[str]
    cautions: list[str]

    def add_cautions(self, *cautions: str) -> Verdict:
        """Return the verdict with further cautions."""
        return self._replace(cautions=[*self.cautions, *cautions])


def build_verdict(word: str, *reasons: str) -> Verdict:
    """Build a verdict with its reasons."""
    return Verdict(word, list(reasons), [])


# --- Whether a loop is closed


class Feedback(NamedTuple):
    """Evidence of feedback in a log.

    Attributes:
        chance: p of what past residuals say of the input, if no loop is closed; 1 if the plant
            does not fit, so that they tell nothing.
        answered: share that readings have of what a recorded reference leaves of the input, 0
            where it leaves nothing; None without a reference that moves.
    """

    chance: float
    answered: float | None

    @property
    def is_closed(self) -> bool:
        """Return whether the input depends on the readings."""
        if self.answered is None:
            return self.chance <= least_squares.CHANCE
        is_significant = self.answered > 0 and self.chance <= least_squares.CHANCE
        return is_significant or self.answered > MOSTLY


def detect_feedback(case: Case) -> Feedback:
    """Detect feedback: by residuals, or with certainty by a recorded reference."""
    grid = case.grid
    share = None
    # No controller makes an input that acts in its own row from the reading of that row.
    u = shift_rows(case.recorded.u, min(case.options.recorded_delay, 0), case.recorded.start)
    chance = orders.loop_p_value(case.chosen.fit, u) if case.chosen.white else 1.0
    known = grid.r[np.isfinite(grid.r)]
    if known.size and np.ptp(known) > 0:
        share = orders.feedback_share(grid.u, grid.y, case.record_data.ok, grid.r, grid.start)[0]
    return Feedback(chance, share)


# --- By the odds


def classify_by_probabilities(
    case: Case, odds: dict[str, float], models: Sequence[Family], fits: Fits
) -> Verdict:
    """Return the verdict by the posterior probabilities of all models, or an undecided
    verdict.

    Args:
        case: the log, fitted with a zone of the sensor.
        odds: by word, largest first.
        models: whose odds they are.
        fits: those that have a plant of their own, by word.
    """
    word = _most_probable_word(odds)
    if case.jump_edges:
        return _verdict_on_jump(case, odds, models)
    if not case.fitted.prepared.settles:
        return build_verdict("unclear", TOO_SHORT)
    as_linear = word in AS_LINEAR and sum(odds.get(one, 0.0) for one in AS_LINEAR) >= LIKELY
    if as_linear and _is_below_rounding(case):
        unclear = _find_unclear(case, "none", best_model_of("none", models), fits)
        return (
            _verdict_at_range_ends(case, "none", odds)
            or unclear
            or _verdict_without_zone(case, odds)
        )
    other = case.limited and _verdict_at_range_ends(case, word, odds)
    if other is None:
        best = best_model_of(word, models)
        other = _find_unclear(case, word, best, fits) or _verdict_at_range_ends(case, word, odds)
    if other is not None:
        return other
    likely = {one: share for one, share in odds.items() if one == word or share > UNLIKELY}
    more = [one for one in LARGER.get(word, ()) if one in likely]
    sure = _joint_odds(word, likely)
    in_loop = word == "none" and sure < LIKELY_IN_LOOP and detect_feedback(case).is_closed
    if (sure < LIKELY or in_loop) and not (word == case.options.kind == "play"):
        return _undecided_among(odds)
    cautions = []
    for one in more:
        state = "not excluded" if odds[one] < odds.get(word, 0.0) else "likelier than it alone"
        cautions.append(f"{MODELS[one]} is {state} ({100 * odds[one]:.0f} %)")
    if word == "dead_zone":
        return build_verdict("dead_zone").add_cautions(*cautions)
    if word == "none":
        return _verdict_without_zone(case, odds)
    return build_verdict(word, f"{MODELS[word]} explains the log best").add_cautions(*cautions)


def _verdict_at_range_ends(case: Case, word: str, odds: dict[str, float]) -> Verdict | None:
    """Return saturation if readings stick at the range ends, undecided for a memory there, or
    None.
    """
    ends = case.fitted.prepared.ends
    clipped = odds.get("none", 0.0) + odds.get("saturation", 0.0)
    if not ends.has_ends:
        return None
    mostly = case.record_data.ok.sum() < MOSTLY * case.grid.ok.sum()
    stick = f"readings stick at the ends of the range {ends.range_text}"
    if case.limited is not None and (word in LIMITED or (mostly and word in (*MEMORY, *CHAINED))):
        return build_verdict("saturation", f"{stick}, and limits explain all of them")
    if word in LIMITED and (mostly or clipped > UNLIKELY):
        return build_verdict("saturation", f"{stick}. The odds are those of the parts between")
    if mostly and word in (*MEMORY, *CHAINED):
        return build_verdict(
            "undecided", f"most {stick}, and between them {MODELS[word]} is a guess"
        )
    return None


def _most_probable_word(odds: dict[str, float]) -> str:
    """Return the likeliest class; without a clear leader, a simpler class that larger models
    contain.
    """
    first = next(iter(odds))
    if first == "two_zones" or (first != "zone_and_friction" and odds[first] >= LIKELY):
        return first
    for word in LARGER:
        is_there = first == "zone_and_friction" or odds.get(word, 0.0) > UNLIKELY
        if is_there and _joint_odds(word, odds) >= LIKELY:
            return word
    return first


def _joint_odds(word: str, odds: dict[str, float]) -> float:
    """Return the odds of a class and of the larger models that contain it.

    Beside a zone of the input that is not excluded, the sensor's alone has other widths; a small
    play in front of it changes them little.
    """
    is_wider = word == "dead_zone" and odds.get("two_zones", 0.0) > UNLIKELY
    larger = () if is_wider else LARGER.get(word, ())
    return sum(odds.get(one, 0.0) for one in (word, *larger))


def _verdict_on_jump(case: Case, odds: dict[str, float], models: Sequence[Family]) -> Verdict:
    """Return the verdict on a record that was treated as that of a jump sensor.

    Beyond its edges such a sensor reads z itself, so its readings leave no width to be fitted, and
    the tests of a fitted zone that decide elsewhere do not apply. Two questions are left: whether
    another word explains the log better, and whether the log determines the plant at all.
    """
    word = next(iter(odds))
    if odds["jump"] < UNLIKELY:
        return build_verdict("other", f"{MODELS[word]} explains the log better than a jump sensor")
    return _find_unclear(case, "dead_zone", best_model_of("jump", models), {}) or build_verdict(
        "jump"
    )


def best_model_of(word: str, models: Sequence[Family]) -> Density:
    """Return the best model of a class, by BIC per reading."""
    there = filter(None, (family.get(word) for family in models))
    return min(there, key=lambda one: one.bic / one.value.size)


def _undecided_among(odds: dict[str, float]) -> Verdict:
    """Return the undecided verdict, with the candidate classes."""
    likely = list(filter(lambda word: odds[word] >= UNLIKELY, odds))
    apart = f"{CANNOT_TELL} {' from '.join(MODELS[word] for word in likely)}"
    return build_verdict("undecided", apart)


def _is_below_rounding(case: Case) -> bool:
    """Return whether the fitted zone is smaller than a few quanta of the readings."""
    return 0 < case.chosen.fit.width < STEPS * case.quantum


def _verdict_without_zone(case: Case, odds: dict[str, float]) -> Verdict:
    """Return the verdict on readings that a linear plant explains best.

    Args:
        case: the log, fitted with a zone of the sensor.
        odds: by word.
    """
    y = case.grid.y[case.grid.ok]
    is_aside = np.quantile(y, FEW) > 0 or np.quantile(y, 1 - FEW) < 0
    if is_aside and not case.options.integrators:  # whose z has no zero of its own
        about = f"{float(y.mean()):.4g}"
        point = f"the log lies about an operating point of {about}: nothing can be known of a zone"
        return build_verdict("operating_point", f"{point}; --zero {about}, or take it off")
    if _is_below_rounding(case):
        steps = "the readings are rounded to steps that are larger than any zone"
        return build_verdict("none", f"{steps} ({case.grid.quantum:.3g})")
    chance = case.no_zone.chance
    behind = case.chosen.fit.objective.kind == "behind"
    if not behind or chance >= DOUBT:
        return build_verdict("none", f"readings need no zone (p = {chance:.2g})")
    # The test takes what disturbs the plant as it is; the odds whiten it first.
    if odds.get("none", 0.0) >= SURELY_NONE and chance > CONTRADICTED:
        return build_verdict("none", "readings need no zone, for the colour of their disturbance")
    tested = f"a zone explains more than chance does (p = {chance:.2g}), and no model of one is"
    return build_verdict("undecided", f"{tested} likely. Record for longer")


def _find_unclear(case: Case, word: str, best: Density, fits: Fits) -> Verdict | None:
    """Return an unclear verdict with reasons, or None if a decision is possible."""
    chosen = case.chosen
    data = case.record_data
    within = 1 - best.rms / float(data.y[data.ok].std())
    share = chosen.share if word in FITTED else within
    reasons = []
    if share < LEAST:
        which = "held-out readings" if word in FITTED else "readings"
        explained = f"the best plant explains {100 * max(share, 0.0):.0f} % of the {which}"
        changes = f", and {100 * within:.0f} % of all: it changes, or another input acts"
        others = chosen.error / max(1 - chosen.share, 1e-12)
        if others < CALM * data.y[data.ok].std():  # as after a single step
            changes = ", which hardly move: nothing tests a fit. Record several steps up and down,"
            changes += " each held until the readings settle"
        unstable = _describe_instability(case) if within <= LEAST else None
        if unstable is not None:
            return build_verdict("unclear", explained + unstable)
        reasons.append(explained + changes * (within > LEAST))
    fit = chosen.fit
    if word == "none":
        fit = fit_linear(fit.objective.simulator, fit.objective.readings.ok)
    plant = fit.objective.simulator
    theta = fit.theta
    if word not in FITTED and word in fits:
        plant = fits[word].model.simulator
        theta = fits[word].theta
    if (reasons or word in {*FITTED, *fits}) and plant.is_at_limit(theta):
        reasons.append(UNSETTLED)
    return build_verdict("unclear", *reasons) if reasons else None


def _describe_instability(case: Case) -> str | None:
    """Return the advice on a plant that is unstable without its controller, or None.

    Simulation cannot follow such a plant, but an equation predicts its next reading.

    Args:
        case: the log.
    """
    for order in case.fitted.fits:
        a = fit_arx(order.fit.objective.simulator, None, None)[0]
        pole = math.log(max(np.abs(np.roots(np.append(1.0, a))), default=1.0) or 1.0)
        if pole * case.record_data.y.size > GROWS:
            return (
                f": it seems unstable (a pole of {pole / case.grid.step:+.3g} 1/s) and held by a"
                " controller, and only stable plants and integrators are identified. If the columns"
                " are right, put a model of the plant in a scenario and let `undeadzone estimate`"
                " find the widths"
            )
    return None


# --- An offset after the zone, which the model does not contain


def withdraw_zone_with_offset(verdict: Verdict, fit: ZoneFit) -> Verdict:
    """Return `other` in place of the verdict if readings inside the zone have a mean other than 0.

    A linear plant with a zone does not contain such an offset, and its widths would be wrong.

    Args:
        verdict: dead_zone, other or unclear, so far.
        fit: plant and zone.
    """
    offset = None if verdict.word == "unclear" else mean_inside_zone(fit)
    if offset is not None:
        value = offset * fit.objective.data.y_scale
        reason = (
            f"the readings inside the zone lie about {value:.4g}, not 0: a constant offset behind"
            f" the zone. Take it away by --zero {value:.4g}"
        )
        return build_verdict("other", reason)
    return verdict


def mean_inside_zone(fit: ZoneFit) -> float | None:
    """Return the mean reading well inside the zone, scaled; None if 0 or unknown.

    Args:
        fit: plant and zone; with noise behind the zone, else silence is exactly 0. z of an
            integrating plant has no zero that an offset could move.
    """
    if fit.objective.kind != "behind" or fit.objective.layout.integrators:
        return None
    z = fit.z
    margin = WELL_INSIDE * fit.disturbance_rms
    inside = fit.objective.readings.ok & (z < fit.right - margin) & (z > -fit.left + margin)
    y = fit.objective.data.y[inside]
    if y.size < 50:
        return None
    mean = float(y.mean())
    covariance, degrees = long_run_covariance((y - mean)[:, None])
    half = student_quantile(degrees, SURE) * math.sqrt(covariance[0, 0]) / y.size
    return mean if abs(mean) > max(half, RELEVANT * fit.disturbance_rms) else None
