"""Answer to a log as values in the units of the log, with cautions."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import DIRECTIONS, deadzone, zone
from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.logs.grid import Grid
from undeadzone_identify.logs.log import AT_ONCE
from undeadzone_identify.logs.prepare import FAR_EDGE
from undeadzone_identify.models.estimates import Interval, student_quantile
from undeadzone_identify.models.kalman import AT_INPUT, NAMES
from undeadzone_identify.models.kalman_fit import KalmanFit, filter_innovations
from undeadzone_identify.models.least_squares import CHANCE
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.plant import MANY, Layout, PlantSimulator
from undeadzone_identify.models.shape import SensorShape, measure_shape
from undeadzone_identify.models.zone_fit import ZoneFit
from undeadzone_identify.selection.alternatives import (
    Element,
    Findings,
    validate_element,
)
from undeadzone_identify.selection.decision import (
    AS_LINEAR,
    CANNOT_TELL,
    LARGER,
    MODELS,
    Case,
    Feedback,
    detect_feedback,
)
from undeadzone_identify.selection.decision import (
    LEAST as LEAST_SHARE,
)
from undeadzone_identify.selection.orders import (
    OrderFit,
    credible_orders,
    feedback_share,
    has_input_residual,
    is_white,
    training_samples,
)
from undeadzone_identify.selection.widths import (
    FEW_VISITS,
    SIDES,
    Excitation,
    WidthEstimates,
    find_widths,
    lower_width_bound,
    measure_excitation,
    widen_by_profile,
)
from undeadzone_identify.servo.gap import ServoGap

DRIFT_BLOCKS, LEAST_IN_BLOCK = 16, 8  # parts of a log, and readings of each, that show a drift
ALIKE = 0.5  # von Neumann's ratio of their means, below which they drift: 1e-4 by chance
SURE = 0.999  # level of the ranges that an observer is told
WITHHELD = ("undecided", "unclear")  # words that withhold a name
ODDS_OF = {"operating_point": "none", "unreached": "dead_zone"}  # words with odds of another
CLOSED = (
    "the input answers to the readings: the log is of a closed loop, in which the interval "
    "of a play may be too narrow"
)
LEAST = 1e-6  # of a width, by which its range is wide at least
BOTH = ("width", "centre")  # numbers of both edges

DisplayedWidths = dict[str, Interval | None]  # right, left, width, centre


class Disturbance(NamedTuple):
    """Disturbance of z.

    Attributes:
        rms: of all of it [y].
        correlation_time: [s]; None if it is white.
        white: rms of its white part [y]; None if that was not told apart.
        model: which model of the disturbance fits best; None if none was fitted.
        ahead: whether it acts ahead of the zone.
    """

    rms: float
    correlation_time: float | None = None
    white: float | None = None
    model: str | None = None
    ahead: bool = True


class Answer(NamedTuple):
    """Answer to a log.

    Attributes:
        verdict: dead_zone, none, operating_point, saturation, jump, play, both (play and dead
            zone), friction, input_zone, two_zones (input and sensor), other, undecided, unclear or
            unreached.
        reasons: why, in words.
        right, left, width, centre: (value, low, high) with 95 % intervals, of what the verdict
            names [y], of an input zone [u]; None if the verdict allows no such number.
        remarks: on changes of the log, and cautions.
        loop: whether one is closed.
        case: the log, fitted with a zone of the sensor.
        found: the findings.
        chosen: the order that was chosen, with the checks of the findings.
        excitation: samples and visits a side.
        widths: of a zone of the sensor, with intervals, in the scale of the fit (rms of y is 1).
        shape: of the sensor's zone, as far as readings tell it; None: not asked.
    """

    verdict: str
    reasons: list[str]
    remarks: list[str]
    loop: Feedback
    case: Case
    found: Findings
    chosen: OrderFit
    excitation: Excitation
    widths: WidthEstimates
    right: Interval | None = None
    left: Interval | None = None
    width: Interval | None = None
    centre: Interval | None = None
    shape: SensorShape | None = None

    @property
    def zone(self) -> bool:
        """Return whether the sensor has a dead zone."""
        return self.verdict in ("dead_zone", "unreached", "filtered_zone")

    @property
    def fit(self) -> ZoneFit:
        """Return the fit of plant and zone."""
        return self.chosen.fit

    @property
    def scale(self) -> float:
        """Return the rms of y, by which the fit is scaled [y]."""
        return self.fit.objective.data.y_scale

    @property
    def element(self) -> Element | None:
        """Return the element in place of a sensor's dead zone; None without an element."""
        return self.found.element

    @property
    def servo(self) -> ServoGap | None:
        """Return the servo behind a play; None if the element is not a servo."""
        return None if self.element is None else self.element.servo

    @property
    def z(self) -> Floats:
        """Return the output of the plant (N), scaled."""
        return self.fit.z if self.element is None else self.element.z

    @property
    def hidden_output(self) -> Floats:
        """Return the output of the plant (N) [y]."""
        return self.z * self.scale

    @property
    def plant(self) -> tuple[PlantSimulator, Floats]:
        """Return the plant along the log and its parameters, scaled."""
        if self.element is None:
            return self.fit.objective.simulator, self.fit.theta
        return self.element.simulator, self.element.theta

    @property
    def named_plant(self) -> tuple[PlantSimulator, Floats]:
        """Return the plant of the model that is named, and its parameters, scaled."""
        return self.plant

    @property
    def order(self) -> int:
        """Return the number of poles of the plant."""
        return self.named_plant[0].layout.n

    @property
    def poles(self) -> Any:
        """Return the poles of the plant (n) [1/s], complex."""
        simulator, theta = self.named_plant
        with np.errstate(divide="ignore"):
            return np.log(simulator.plant_poles(theta).astype(complex)) / self.case.grid.step

    @property
    def gain(self) -> Floats:
        """Return the DC gain from each input (m) [y/u]; with integrators, of the rates."""
        simulator, theta = self.named_plant
        gain = (
            simulator.dc_gain(theta) * self.case.record_data.y_scale / self.case.record_data.u_scale
        )
        return gain / self.case.grid.step**simulator.layout.integrators

    @property
    def plant_numbers(self) -> tuple[Layout, Floats, Floats, Floats]:
        """Return layout, a, b in units of y and u, and their joint covariance."""
        simulator, theta = self.plant
        layout = simulator.layout
        data = simulator.data
        estimate = (
            self.fit.objective.robust_covariance(theta) if self.element is None else self.element
        )
        count = layout.numerators.stop
        scale = np.ones(count)
        factors = np.repeat(data.y_scale / data.u_scale, layout.n)
        scale[layout.numerators] = factors
        V = estimate.V[:count, :count] * np.outer(scale, scale)
        return layout, theta[layout.denominator], theta[layout.numerators] * factors, V

    @property
    def at_rest(self) -> tuple[float, float] | None:
        """Return input and output of the log at rest, from which the plant counts; None: from 0.

        Any input at rest serves, with the output that belongs to it. That of a zone is its middle.
        """
        case = self.case
        zero = case.options.zero
        level = 0.0 if self.element is None else self.element.level * case.record_data.y_scale
        if level and not self.named_plant[0].layout.integrators:
            u = float(f"{case.grid.u[:, 0].mean():.4g}")
            return u, float(f"{zero + level + float(self.gain[0]) * u:.8g}")
        if case.grid.zero is None and not zero + level:
            return None
        return case.grid.zero or 0.0, zero + level

    @property
    def z_from_rest(self) -> Floats:
        """Return the output of the plant less that at rest (N) [y]."""
        if self.element is None or not self.element.level or self.at_rest is None:
            return self.hidden_output
        return self.hidden_output - self.gain[0] * self.at_rest[0]

    @property
    def disturbance(self) -> Disturbance:
        """Return the disturbance of z, in units of the log."""
        step = self.case.grid.step
        scale = self.scale
        element = self.element
        fit = self.fit
        if element is not None and element.is_at_rest:
            return Disturbance(element.rms * scale, ahead=False)
        if element is not None:
            phi = 0.0 if element.ahead is None else element.ahead.phi
            time = -step / math.log(phi) if phi > 0 else None
            model = None if element.ahead is None else NAMES[AT_INPUT]
            return Disturbance(element.disturbance_rms * scale, time, element.noise * scale, model)
        time = -step / math.log(fit.rho) if 0.05 < fit.rho < 1 else None
        if fit.objective.kind == "behind":  # the climb to s ends early at a zone without width
            rms = root_mean_square(fit.unexplained[fit.objective.readings.ok])
            return Disturbance(rms * scale, time, ahead=False)
        ahead = Disturbance(fit.disturbance_rms * scale, time)
        if not self.found.kalman:
            return ahead
        best = self.found.kalman[0]
        return ahead._replace(white=best.white_rms * scale, model=NAMES[best.model])


# --- From what was found


def to_answer(case: Case, found: Findings) -> Answer:
    """Convert the findings to an answer in the units of the log.

    Args:
        case: the log, fitted with a zone of the sensor.
        found: the verdict, and the element in the zone's place.
    """
    element = found.element
    doubt = element and (
        _doubt_of_zero(element.widths | {"friction": found.friction})
        or _doubt_of_zero(element.input)
    )
    if doubt:
        found = found.without_name("undecided", doubt, *found.verdict.reasons)
    found = found._replace(odds=_odds_of_word(case, found))
    data = case.record_data
    chosen = _validate_findings(case, found)
    found = withhold_poor_fit(found, chosen.share)
    best = next(iter(found.kalman), None)
    orders = credible_orders(case.fitted.fits)
    widths = find_widths(
        case.chosen, orders, case.fitted.alike, best, case.quantum, case.offset_prior
    )
    edges = widths.right.value, widths.left.value
    answer = Answer(
        verdict=found.verdict.word,
        reasons=found.verdict.reasons,
        remarks=[*case.fitted.prepared.remarks, *found.verdict.cautions],
        loop=Feedback(1.0, None),
        case=case,
        found=found,
        chosen=chosen,
        excitation=measure_excitation(
            data.select_readings(), case.chosen.fit.z, *edges, data.silent_zeros
        ),
        widths=widths,
    )
    answer = _add_feedback(answer)
    if found.element is not None:
        remarks = [*found.element.remarks, *_delay_remarks(answer)]
        answer = _set_widths(answer, found.element.widths, remarks)
    is_jump = answer.verdict == "jump" and case.jump_edges
    if found.element is None and (answer.verdict == "dead_zone" or is_jump):
        answer = _add_edges(answer)
    if answer.zone and found.shaped is not None and case.record_data.y.size <= MANY:
        shape = measure_shape(found.shaped, case.record_data.y_scale, case.grid.step)
        answer = answer._replace(shape=shape)
    return answer


def _odds_of_word(case: Case, found: Findings) -> dict[str, float]:
    """Return the odds that belong to the word: none if it was not they that decided.

    Larger models count for the word where their element is no matter for it, and so do zones below
    the rounding of the readings.
    """
    word = found.verdict.word
    odds = found.odds
    if case.has_limits_as(word):
        return {}  # they are those of what lies between the limits
    if (found.element and found.element.servo) or not odds:
        return odds
    if word == "undecided":
        return odds if found.verdict.reasons[0].startswith(CANNOT_TELL) else {}
    own = ODDS_OF.get(word, word)
    classes = {own, *LARGER.get(own, ())} | (set(AS_LINEAR) if own == "none" else set())
    if own not in odds or next(iter(odds)) not in classes:
        return {}
    if next(iter(odds)) == own:
        return odds
    rest = {name: share for name, share in odds.items() if name not in classes}
    return {own: sum(odds[name] for name in classes if name in odds)} | rest


def withhold_poor_fit(found: Findings, share: float) -> Findings:
    """Withhold a name that explains less than half of the held-out data, whatever the name.

    Args:
        found: with a verdict.
        share: of the held-out data that it explains; of a loop one sample ahead.
    """
    word = found.verdict.word
    if word in WITHHELD or share >= LEAST_SHARE:
        return found
    part = f"{100 * max(share, 0.0):.0f} % of the held-out readings"
    reason = f"{MODELS[ODDS_OF.get(word, word)]}, the likeliest, explains {part}"
    return found.without_name("unclear", reason)


def _validate_findings(case: Case, found: Findings) -> OrderFit:
    """Return the chosen order with the held-out check of the final findings."""
    chosen = case.chosen
    held_out = case.options.held_out
    if found.element is not None:
        chosen = chosen._replace(**validate_element(found.element, held_out)._asdict())
    if found.kalman:
        chosen = chosen._replace(white=_has_white_innovations(found.kalman[0], held_out))
    return chosen


def _add_edges(answer: Answer) -> Answer:
    """Return the answer with the edges of a sensor's zone."""
    has_residual = has_input_residual(answer.fit)
    answer = answer._replace(case=answer.case._replace(unreached=_find_unreached(answer)))
    intervals = _jump_widths(answer.case) or _log_unit_widths(answer, 2.0 if has_residual else 1.0)
    remarks = [*_delay_remarks(answer), *_edge_remarks(answer, intervals, has_residual)]
    _widen_rare_edges(answer, intervals)
    remarks += _widen_by_drift(answer, intervals)
    edges = {*SIDES} - {*answer.case.unreached}  # of which one alone has no width beside it
    if intervals.get("width") is not None:
        edges.clear()
    doubt = _doubt_of_zero(intervals, *edges) or _doubt_of_unmoved(answer, intervals)
    if doubt:
        return _with_doubt(answer, doubt)
    word = "unreached" if answer.case.unreached else answer.verdict
    return _set_widths(answer, intervals, remarks)._replace(verdict=word)


def _find_unreached(answer: Answer) -> tuple[str, ...]:
    """Return the sides beyond whose edges no sample lies, by the readings or by the fit."""
    case = answer.case
    sides = zip(SIDES, answer.excitation.samples, strict=True)
    never = tuple(
        name for name, count in sides if not count and len({*case.options.parse_bounds(name)}) > 1
    )
    return never if case.jump_edges is None and len(never) < len(SIDES) else case.unreached


def _with_doubt(answer: Answer, doubt: str) -> Answer:
    """Return the answer without a name: the likeliest model's own test denies it."""
    found = answer.found._replace(odds={})
    return answer._replace(verdict="undecided", reasons=[doubt], found=found)


def _widen_by_drift(answer: Answer, intervals: DisplayedWidths) -> list[str]:
    """Widen both edges to the zero of any time, in place, and return the remark on its drift.

    Mean residuals beyond the edges follow a zero that drifts, less its mean, which the fitted edges
    hold. They are a drift if neighbours are much more alike than any two (von Neumann's ratio).
    """
    right, left, unit = intervals["right"], intervals["left"], answer.case.grid.output_unit
    if right is None or left is None or not math.isfinite(left.high + right.high):
        return []
    z, grid = answer.hidden_output, answer.case.grid
    beyond = np.flatnonzero(grid.ok & (zone(z, right.value, left.value) != 0))
    if beyond.size < DRIFT_BLOCKS * LEAST_IN_BLOCK:
        return []
    residual = grid.y - deadzone(z, right.value, left.value)
    means = np.array([residual[one].mean() for one in np.array_split(beyond, DRIFT_BLOCKS)])
    reach = 0.5 * float(np.abs(np.diff(means)).max())  # from the middle of a part to its end
    low, high = float(means.min()) - reach, float(means.max()) + reach
    alike = np.sum(np.diff(means) ** 2) < ALIKE * np.sum((means - means.mean()) ** 2)
    if not alike or high - low < max(right.half_width, left.half_width):
        return []
    intervals["right"] = right._replace(low=right.low - high, high=right.high - low)
    intervals["left"] = left._replace(low=left.low + low, high=left.high + high)
    words = f"the zero drifts by {high - low:.3g}{' ' * (unit != '1')}{unit * (unit != '1')}"
    return [f"{words} along the log: both edges are given for any time of it, and their sum holds"]


def _doubt_of_zero(intervals: dict[str, Any], *edges: str) -> str:
    """Return the remark that a width, friction or an edge may be 0; empty if none is or is known.

    Args:
        intervals: by name.
        edges: names that count as well.
    """
    for name in ("width", "friction", *edges):
        own = intervals.get(name)
        if own is not None and own.low <= 0 < own.half_width:
            return f"the {name}'s interval holds 0: {own.value:.4g} [{own.low:.4g}, {own.high:.4g}]"
    return ""


def _doubt_of_unmoved(answer: Answer, intervals: DisplayedWidths) -> str:
    """Return the remark that an edge moves no reading; empty if each does or is known."""
    for name in SIDES:
        low, high = answer.case.options.parse_bounds(name)
        edge = intervals[name]
        if edge is not None and low < high and edge.low == edge.high:
            return f"the {name} edge moves no reading: the fit never found the zone"
    return ""


def _set_widths(answer: Answer, intervals: DisplayedWidths, remarks: list[str]) -> Answer:
    """Return the answer with widths and further remarks."""
    changed: dict[str, Any] = {**intervals, "remarks": [*answer.remarks, *remarks]}
    return answer._replace(**changed)


def _has_white_innovations(kalman: KalmanFit, held_out: float) -> bool:
    """Return whether the filter's held-out innovations are white outside the zone."""
    data = kalman.objective.data
    use = data.ok & (data.side != 0) & ~training_samples(data, held_out)
    return is_white(filter_innovations(kalman), use)


def _delay_remarks(answer: Answer) -> list[str]:
    """Return the remark on an input delay, empty without a delay."""
    delay = answer.found.delay
    grid = answer.case.grid
    if delay <= 0:
        return []
    time = "" if grid.counted else f" ({delay * grid.step:.4g} s)"
    return [f"the input acts {delay} samples late{time}"]


def _add_feedback(answer: Answer) -> Answer:
    """Return the answer with the evidence of feedback and its consequences."""
    servo = answer.servo
    loop = detect_feedback(answer.case)
    is_closed = loop.is_closed
    if servo is not None:
        loop = loop._replace(chance=servo.log.loop)
        is_closed = loop.is_closed or servo.log.is_closed_loop
    remarks = [CLOSED] if is_closed else []
    if answer.case.options.delay == AT_ONCE:
        remarks.append(
            "the input acts within its own sample, or is written a sample late: it is taken one"
            f" sample earlier (--delay {AT_ONCE})"
        )
    remarks += _reference_remarks(answer.case.grid, answer.case.record_data.ok, loop)
    return answer._replace(loop=loop, remarks=[*answer.remarks, *remarks])


def _reference_remarks(grid: Grid, ok: Flags, loop: Feedback) -> list[str]:
    """Return the remarks on a recorded reference."""
    if (
        not loop.answered
        or feedback_share(grid.r, grid.y, ok, grid.r[:, :0], grid.start)[1] > CHANCE
    ):
        return []
    words = "the reference answers to the readings as well: an outer loop makes it, or columns are"
    return [f"{words} exchanged (--columns). Then nothing of this holds"]


def _edge_remarks(answer: Answer, intervals: DisplayedWidths, has_residual: bool) -> list[str]:
    """Return the remarks on the reported breakpoints.

    Args:
        answer: the answer.
        intervals: widths in the units of the log.
        has_residual: whether past inputs explain part of the one-step residual.
    """
    remarks = [] if answer.case.jump_edges else list(answer.widths.remarks)
    if has_residual:
        remarks.append(
            "past inputs explain part of the one-step residual: a delay, or too few poles. The"
            " plant model does not fit, and the intervals are doubled. Try a higher --order, or"
            " shift the input by the delay"
        )
    for name in absent_edges(answer.case):
        remarks.append(f"no reading lies beyond a {name} edge: the sensor is taken to have none")
    if _has_tied_edges(answer):
        remarks.append(
            "z of an integrating plant has no zero of its own: it counts from the middle of the"
            " zone, so both edges are half of the width. The place of the zone is not tested"
        )
    for name in SIDES:
        edge = intervals[name]
        if edge is not None and edge.value < 0:
            remarks.append(
                f"d_{name} is negative: the zone does not hold z = 0, as after an offset of the"
                " input or of the output; the width is not touched by that"
            )
    return remarks


def _has_tied_edges(answer: Answer) -> bool:
    """Return whether both edges share a parameter, as for an integrating plant."""
    return answer.fit.objective.limits.tied


def _widen_rare_edges(answer: Answer, intervals: DisplayedWidths) -> None:
    """Widen the intervals of rarely passed edges in place, by their profile likelihood."""
    if answer.case.jump_edges or _has_tied_edges(answer):
        return
    for name, visits in zip(SIDES, answer.excitation.visits, strict=True):
        edge = intervals[name]
        if not 0 < visits < FEW_VISITS or edge is None or not edge.low < edge.high < math.inf:
            continue
        wider = widen_by_profile(answer.fit, name, edge, answer.scale)
        more = (edge.low - wider.low, wider.high - edge.high)
        intervals[name] = wider
        for sum_of_both, further in (("width", more), ("centre", [max(more) / 2] * 2)):
            interval = intervals[sum_of_both]
            intervals[sum_of_both] = None if interval is None else interval.extend_by(*further)


def _jump_widths(case: Case) -> DisplayedWidths:
    """Return the widths of a jump sensor with their intervals [y]; empty for another sensor.

    Readings of a jump sensor bound each breakpoint from both sides. The intervals of the width
    d_r + d_l and of the offset (d_r - d_l) / 2 follow by interval arithmetic, and so are not too
    narrow. With an absent breakpoint neither of them exists.
    """
    if case.jump_edges is None:
        return {}
    edges = np.array([(one.value, one.low, one.high) for one in case.jump_edges])
    # A reading is rounded by up to half a quantum. A known width stays as it is.
    rounding = 0.5 * case.grid.quantum * (edges[:, 2:] > edges[:, 1:2])
    right, left = edges * case.record_data.y_scale + rounding * [0, -1, 1]
    rows = (right, left, right + left, (right - left[[0, 2, 1]]) / 2)
    absent = absent_edges(case)
    unknown: DisplayedWidths = dict.fromkeys([*absent, *BOTH] if absent else ())
    intervals = (Interval(*row.tolist()) for row in rows)
    return dict(zip(DIRECTIONS, intervals, strict=True)) | unknown


def absent_edges(case: Case) -> list[str]:
    """Return the sides on which the sensor has no edge: by the user, or a jump sensor's readings.

    Args:
        case: the log.
    """
    sides = []
    for k, side in enumerate(SIDES):
        is_far = case.jump_edges is not None and case.jump_edges[k].value == FAR_EDGE
        if is_far or case.options.parse_bounds(side)[0] == math.inf:
            sides.append(side)
    return sides


def _log_unit_widths(answer: Answer, wider: float) -> DisplayedWidths:
    """Return the widths in the units of the log; an unreached edge has only a lower bound."""
    case = answer.case
    scale = answer.scale
    intervals: DisplayedWidths = {}
    for name in DIRECTIONS:
        intervals[name] = getattr(answer.widths, name).scale_by(scale).stretch_by(wider)
    unknown = ["centre"] * _has_tied_edges(answer)
    for name in SIDES:
        low, high = case.options.parse_bounds(name)
        if low == high:
            intervals[name] = Interval(low, low, high)
        if low == math.inf:
            unknown += [name, *BOTH]
    for name in case.unreached:
        bound = lower_width_bound(case.chosen.fit, name) * scale
        intervals[name] = Interval(bound, bound, math.inf)
        unknown += BOTH
    return intervals | dict.fromkeys(unknown)


# --- What an observer is told


def prior_width_range(answer: Answer, side: str) -> tuple[float, float]:
    """Return the 99.9 % interval of a width, within the user's bounds [y].

    Each half of the displayed interval grows as Student's quantile does for the degrees of freedom
    that it has, which are few if the edge is passed a few times. An edge of a jump sensor has
    quantiles of its own, and an edge that does not exist has the other's range.

    Args:
        answer: with both widths.
        side: right or left.

    Returns:
        The least and the largest width.

    Raises:
        InputError: the width has no upper bound.
    """
    if side in absent_edges(answer.case):
        (side,) = {*SIDES} - {side}
    edge: Interval = getattr(answer, side)
    low, high = answer.case.options.parse_bounds(side)
    prior = _interval_of_prior(answer, side, edge)
    low = max(prior.low, low, 0.0)
    high = min(prior.high, high)
    if not math.isfinite(high):
        is_input = answer.verdict == "input_zone"
        cure = "Record an input that passes it" if is_input else f"Bound it by --{side} LOW,HIGH"
        raise InputError(f"scenario: the log gives no upper bound of the {side} width. {cure}")
    return _widen_to_rounding(low, high)


def prior_element_range(element: Element, interval: Interval) -> tuple[float, float]:
    """Return the 99.9 % interval, not below 0, of a width of another element than a dead zone
    [y].
    """
    prior = interval.stretch_by(_interval_growth(element.degrees))
    return _widen_to_rounding(max(prior.low, 0.0), prior.high)


def _widen_to_rounding(low: float, high: float) -> tuple[float, float]:
    """Return a range that is wider than rounding."""
    margin = LEAST * max(high, LEAST)
    return (low, high) if high - low > margin else (max(low - margin, 0.0), high + margin)


def _interval_growth(degrees: float) -> float:
    """Return the ratio of a 99.9 % interval to a 95 % interval [1]."""
    return student_quantile(degrees, SURE) / student_quantile(degrees)


def _interval_of_prior(answer: Answer, side: str, edge: Interval) -> Interval:
    """Return the 99.9 % interval of a width [y]."""
    jumps = answer.case.jump_edges
    if jumps is not None:
        jump = jumps[SIDES.index(side)]
        return edge.extend_by((jump.low - jump.lowest) * answer.scale, 0.0)
    degrees = answer.widths.degrees[side] if answer.element is None else answer.element.degrees
    return edge.stretch_by(_interval_growth(degrees))
