"""Why a control loop swings: a valve that sticks or plays, its tuning, or something outside.

All of it is asked of errors of prediction one step ahead, of the same readings, so that the odds
stand beside those of every other model that foretells these readings.
"""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from undeadzone.logs.kinds import kind_of
from undeadzone.util.arrays import Floats, Integers, shift_rows
from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.logs.log import Log
from undeadzone_identify.models.chain import ChainFit, ChainModel
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.least_squares import (
    CHANCE,
    LeastSquares,
    describe_p_value,
)
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.plant import PlantSimulator, RecordData, select_samples
from undeadzone_identify.models.valve import ORDERS, LoopFits, LoopLog, combine_sizes, fit_loop
from undeadzone_identify.models.zone_fit import fit_linear
from undeadzone_identify.selection.decision import (
    LIKELY,
    MODELS,
    UNLIKELY,
    VALVE,
    Case,
    Verdict,
    best_model_of,
    build_verdict,
    detect_feedback,
)
from undeadzone_identify.selection.odds import Family, model_probabilities
from undeadzone_identify.selection.orders import (
    HeldOutScore,
    are_continuous,
    is_white,
    training_samples,
)

LEAST, MOST = 200, 8000  # samples of a record that is asked
SUSPECTS = ("friction", "play", "jump", "input_zone", "input_play", "zone_and_friction")
SENSOR = ("dead_zone", "jump", "two_zones", "filtered_zone")  # words of a zone of the sensor
OWN = ("none", "external", "input_play", "stiction")  # words of the models of a loop
RARE = 3  # numbers that a cause costs besides which is rare in a control loop
FEW_TURNS = 3  # of the input, below which nothing can be said of its valve
REGULAR = 1.0  # Thornhill's r, above which an oscillation is regular
LEAST_SHAPE = 0.02  # of the ellipse, in the range of u
SHAPE, USUAL = 3.0, 0.3  # logarithm of odds by the ellipse's width, and where it tells nothing
TIGHT = 2.0  # |sensitivity| at the period, above which a loop is tuned too tightly
LEAST_POLE = 1e-6  # of a sampled plant: a pole below it is 0


class ValveFindings:
    """Findings on the valve of a loop; what takes time is computed when it is first asked for.

    Args:
        case: the log.
        fits: of the loop.
        part: samples of the record.
        odds: by word; a fault that is likelier than not moves the valve.
        shape: width of the ellipse of PV over OP, in the range of OP.

    Attributes:
        fit: the valve that explains the loop best.
        late: samples by which the plant answers late.
        regularity: of the oscillation; above 1 it is regular.
        period: of the oscillation [samples]; inf without.
        turns: how often u turned by more than a quarter of its range.
    """

    def __init__(
        self, case: Case, fits: LoopFits, part: slice, odds: dict[str, float], shape: float
    ) -> None:
        word = max(VALVE, key=lambda one: odds.get(one, 0.0))
        self.fit = min(
            (one for one in fits.valves if one.word == word), key=lambda one: one.density.bic
        )
        self._part = part
        self.shape = shape
        self.late = fits.structure.lags[0] - 1
        self.regularity = fits.log.regularity
        self.period = fits.log.period
        self.turns = fits.log.turns
        self._case = case
        self._fits = fits
        self._scale = fits.log.range * case.recorded.input_scale
        is_faulty = sum(odds.get(one, 0.0) for one in VALVE) > 0.5
        self._acting = self.fit.position(fits.log.u) if is_faulty else fits.log.u

    @cached_property
    def _intervals(self) -> list[Interval]:
        """Return S and J [u]."""
        both = combine_sizes([self._fits.weigh_sizes()], max(self.shape, LEAST_SHAPE))
        stick, jump = (one.scale_by(self._scale) for one in both)
        return [stick, jump if self.fit.word == "stiction" else jump.scale_by(0.0)]

    @property
    def stick(self) -> Interval:
        """Return S [u]."""
        return self._intervals[0]

    @property
    def jump(self) -> Interval:
        """Return J [u]."""
        return self._intervals[1]

    @cached_property
    def plant(self) -> ChainFit | None:
        """Return the linear plant behind the valve, behind u if it follows; None: none settles."""
        return _plant_behind(self._case, self._acting, self.late, self._part)

    @cached_property
    def held_out(self) -> HeldOutScore:
        """Return how held-out readings are predicted one step ahead."""
        return _score(self._case, self._fits, self._acting, self._part)

    @cached_property
    def error_without(self) -> float:
        """Return the rms of the same without the valve, scaled as the readings."""
        return _score(self._case, self._fits, self._fits.log.u, self._part).error

    @cached_property
    def sensitivity(self) -> float:
        """Return |1 / (1 + C G)| about the period, beside an oscillation from outside."""
        return self._fits.sensitivity(self._acting, self._fits.structure.oscillation)

    @cached_property
    def apparent(self) -> float:
        """Return |1 / (1 + C G)| about the period, without an oscillation from outside."""
        return self._fits.sensitivity(self._acting, np.empty((self._acting.size, 0)))

    @cached_property
    def hidden(self) -> float:
        """Return the p value of what a play explains beside u itself."""
        return self._fits.chance_of_play()

    @property
    def swings(self) -> bool:
        """Return whether the loop swings regularly."""
        return self.regularity > REGULAR


class LoopAnswer(NamedTuple):
    """Odds of a loop with the verdict.

    Attributes:
        verdict: by the odds.
        odds: by word, largest first.
        families: the models of the loop and all of the same readings, then those of others.
        valve: findings on the valve.
    """

    verdict: Verdict
    odds: dict[str, float]
    families: tuple[Family, ...]
    valve: ValveFindings

    def of_loop_alone(self, excluded: frozenset[str]) -> LoopAnswer:
        """Return the answer by the models of a loop alone.

        Args:
            excluded: words that are out of the question.
        """
        own = {word: one for word, one in self.families[0].items() if word in OWN}
        odds = _probabilities_of_loop((own,), self.valve.shape, excluded)
        return answer_by_odds((own,), odds, self.valve)


def may_be_valve(case: Case, odds: dict[str, float]) -> bool:
    """Return whether a valve may be asked for, and has to.

    Args:
        case: the log.
        odds: so far.
    """
    data, options = case.recorded, case.options
    is_open = options.kind == "auto" and options.place == "auto" and case.jump_edges is None
    if not is_open or data.u.shape[1] > 1 or data.silent_zeros:
        return False
    top = next(iter(odds), "")
    if top in SENSOR and odds[top] >= LIKELY and not is_named_loop(case.grid):
        return False
    part = _longest_record(data)
    ok = data.ok[part]
    u, y = data.u[part, 0], data.y[part][ok]
    in_a_row = np.convolve(ok[ok.size // 4 :], np.ones(max(ORDERS) + 1), "valid") > max(ORDERS)
    if min(y.size, in_a_row.sum()) < LEAST or np.ptp(u) == 0 or np.ptp(y) == 0:
        return False
    return any(odds.get(word, 0.0) > UNLIKELY for word in SUSPECTS) or is_control_loop(case)


def is_named_loop(grid: Grid | Log) -> bool:
    """Return whether the input has the name of a controller's output.

    Args:
        grid: the log.
    """
    return kind_of(grid.inputs[0], grid.input_unit) == "op"


def is_control_loop(case: Case) -> bool:
    """Return whether the log is of a control loop: by its readings, or by the name of u.

    Args:
        case: the log.
    """
    return is_named_loop(case.grid) or detect_feedback(case).is_closed


def _longest_record(data: RecordData) -> slice:
    """Return the samples of the longest record, at most its last `MOST`."""
    longest = max(data.record_slices(), key=lambda part: part.stop - part.start)
    return slice(max(longest.start, longest.stop - MOST), longest.stop)


def ask_valve(case: Case, models: tuple[Family, ...], excluded: frozenset[str]) -> LoopAnswer:
    """Find why a loop swings.

    Args:
        case: the log.
        models: fitted so far.
        excluded: words that are out of the question.
    """
    data, part = case.recorded, _longest_record(case.recorded)
    known = case.grid.r[part, 0] if case.grid.r.shape[1] else None
    reference = None if known is None else known / data.y_scale
    log = LoopLog(data.u[part, 0], data.y[part], data.ok[part], reference)
    fits = fit_loop(log)
    families = _comparable_families(fits, log, models, data, part)
    shape = ellipse_width(log)
    odds = _probabilities_of_loop(families, shape, excluded)
    valve = ValveFindings(case, fits, part, odds, shape)
    return answer_by_odds(families, odds, valve)


def answer_by_odds(
    families: tuple[Family, ...], odds: dict[str, float], valve: ValveFindings
) -> LoopAnswer:
    """Return the answer on a loop by the odds of its models.

    A regression takes any lasting oscillation for a pole near the stability limit. If the loop is
    far from that limit as soon as sines stand beside it, they come from outside.

    Args:
        families: the models, those of the same readings together.
        odds: of these, by word.
        valve: findings on the valve.
    """
    if "none" in odds and valve.swings and valve.apparent > TIGHT:
        word = "tight_tuning" if valve.sensitivity > TIGHT else "external"
        shares = {**odds, word: odds.get(word, 0.0) + odds["none"]}
        del shares["none"]
        odds = dict(sorted(shares.items(), key=itemgetter(1), reverse=True))
    return LoopAnswer(_verdict_of(odds, valve), odds, families, valve)


def ellipse_width(log: LoopLog) -> float:
    """Return how wide an ellipse PV over OP is, in the direction of OP, in the range of OP [1].

    A valve that does not follow leaves PV where it was while OP moves.

    Args:
        log: the loop.
    """
    u = log.u[log.ok]
    across = float(np.mean((u - u.mean()) * log.y[log.ok]))
    return math.sqrt(8 * max(float(u.var()) - across**2, 0.0))


def _probabilities_of_loop(
    families: tuple[Family, ...], shape: float, excluded: frozenset[str]
) -> dict[str, float]:
    """Return odds with the evidence of the ellipse, which predictions one step ahead do not see.

    Its weight is that of loops of known cause (`python -m benchmarks valves`).
    """
    evidence = math.exp(SHAPE * (shape - USUAL))
    weighed = model_probabilities(families, excluded)
    for word in VALVE:
        if word in weighed:
            weighed[word] *= evidence
    total = sum(weighed.values())
    return {word: weighed[word] / total for word in sorted(weighed, key=lambda one: -weighed[one])}


def _comparable_families(
    fits: LoopFits, log: LoopLog, models: tuple[Family, ...], data: RecordData, part: slice
) -> tuple[Family, ...]:
    """Return the densities of the loop with all of the same readings, and those of others.

    A log that is long has models of other readings. No zone explains these no worse than the loop's
    own, so that nothing is gained by a poorer one.
    """
    scale = math.log(log.deviation)
    family = {word: one._replace(value=one.value - scale) for word, one in fits.family.items()}
    there = np.flatnonzero(data.ok)
    rows = np.searchsorted(there, fits.regression.rows + part.start)
    for word in sorted(set().union(*models) - set(VALVE)):  # the same order in each process
        best = best_model_of(word, models)
        if best.value.size == there.size:
            rare = RARE * (word not in OWN)
            same = best._replace(value=best.value[rows], numbers=best.numbers + rare)
            family[word] = min(same, family.get(word, same), key=lambda one: one.bic)
    others: list[Family] = []
    for one in models:
        own, left = one["none"], sorted(set(one) - set(family) - set(VALVE))
        if not left:
            continue
        behind = max(float(family["none"].value.mean() - own.value.mean()), 0.0)
        other = {word: one[word]._replace(numbers=one[word].numbers + RARE) for word in left}
        others.append({**other, "none": own._replace(value=own.value + behind)})
    return (family, *others)


def _score(case: Case, fits: LoopFits, v: Floats, part: slice) -> HeldOutScore:
    """Score predictions of held-out blocks one step ahead behind a position."""
    regression, scale = fits.regression, fits.log.deviation
    rows: Integers = regression.rows
    train = training_samples(case.recorded, case.options.held_out)[part][rows]
    columns = regression.regressors(v, fits.structure.lags)
    coefficients = np.linalg.lstsq(columns[train], regression.y[train], rcond=1e-9)[0]
    e = (regression.y - columns @ coefficients) * scale
    rms = root_mean_square(e[~train])
    share = 1 - rms / max(float(regression.y[~train].std()) * scale, 1e-12)
    return HeldOutScore(rms, share, is_white(e, ~train))


def _plant_behind(case: Case, v: Floats, late: int, part: slice) -> ChainFit | None:
    """Return the linear plant behind a position; None if none settles.

    Its order is the best of those whose poles a plant in continuous time has, else of all.
    """
    own = select_samples(case.recorded, [part])
    delayed = shift_rows(v, late, own.start)[:, None] * np.ptp(own.u[:, 0]) + own.u[:, 0].mean()
    begun = own._replace(u=delayed, climbs=None)
    found = []
    for n in case.fitted.prepared.orders:
        simulator = PlantSimulator(begun, n, case.options.integrators)
        fit = fit_linear(simulator, begun.ok)
        found.append((fit.bic, n, simulator, fit.theta[: simulator.layout.right]))
    plants = (
        LeastSquares(ChainModel(simulator)).fit_from_starts([theta])
        for _, _, simulator, theta in sorted(found, key=lambda one: one[:2])
    )
    best = next(plants)
    return next(filter(_is_continuous, itertools.chain([best], plants)), best)


def _is_continuous(fit: ChainFit | None) -> bool:
    """Return whether a plant in continuous time has the poles: none is 0, or negative and real."""
    return fit is not None and are_continuous(
        fit.model.simulator.plant_poles(fit.theta), LEAST_POLE
    )


def _verdict_of(odds: dict[str, float], valve: ValveFindings) -> Verdict:
    """Return the verdict on a loop by its odds."""
    word, share = next(iter(odds.items()))
    sticks = odds.get("stiction", 0.0) + odds.get("input_play", 0.0)
    cautions = []
    if share < LIKELY <= sticks:
        other = "input_play" if word == "stiction" else "stiction"
        cautions = [f"{MODELS[other]} is not excluded ({100 * odds[other]:.0f} %)"]
    elif share < LIKELY:
        likely = [MODELS[one] for one, p in odds.items() if p >= UNLIKELY]
        return build_verdict("undecided", f"this record cannot decide {' from '.join(likely)}")
    if word in VALVE and valve.held_out.error >= valve.error_without:
        kept = "but predicts held-out readings no better than u itself"
        return build_verdict("undecided", f"{MODELS[word]} is the likeliest, {kept}")
    if word == "none" and valve.turns < FEW_TURNS:
        seen = f"the input turned {valve.turns} times by more than a quarter of its range, and only"
        return build_verdict("undecided", f"{seen} where it turns a valve that sticks shows")
    if word == "none" and valve.hidden < CHANCE:
        reason = f"{MODELS[word]} is the likeliest, but the position of a valve with play foretells"
        seen = f"{reason} its residual ({describe_p_value(valve.hidden)})"
        return build_verdict("undecided", seen)
    return build_verdict(word, f"{MODELS[word]} explains the log best").add_cautions(*cautions)
