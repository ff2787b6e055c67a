"""The answer to a log as values in the units of the log, with what to be careful about."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.logs.grid import Grid
from undeadzone.identification.logs.log import Options
from undeadzone.identification.logs.prepare import JumpEdge
from undeadzone.identification.models.estimates import DIRECTIONS, Interval, quantile
from undeadzone.identification.models.kalman import AT_INPUT, NAMES
from undeadzone.identification.models.kalman_fit import KalmanFit, innovations
from undeadzone.identification.models.least_squares import Density
from undeadzone.identification.models.motion import Offsets
from undeadzone.identification.models.plant import Layout, Simulator
from undeadzone.identification.models.zone_fit import Fit
from undeadzone.identification.verdict.orders import (
    NoZone,
    OrderFit,
    ResidualMap,
    credible,
    hears_input,
    is_white,
    trained_part,
)
from undeadzone.identification.verdict.place import Place
from undeadzone.identification.verdict.verdict import Case
from undeadzone.identification.verdict.which import Element, Found, held_out_of
from undeadzone.identification.verdict.widths import (
    FEW_VISITS,
    Excitation,
    Widths,
    excitation,
    find_widths,
    lower_bound,
    widened,
)
from undeadzone.support.arrays import Floats

SURE = 0.999  # level of the ranges that an observer is told
LEAST = 1e-6  # of a width, by which its range is wide at least

Shown = dict[str, Interval | None]  # right, left, width, centre


class Evidence(NamedTuple):
    """All that was computed, in the scale of the fit (rms of y is 1).

    Attributes:
        grid: the log on its grid.
        orders: every order.
        chosen: the order that was chosen.
        kalman: fits of (L3), best first.
        no_zone: the test of a zone against none.
        residuals: residual by z^.
        rivals: static rivals.
        place: where the zone is; None where that was not asked.
        excitation: samples and visits a side.
        widths: widths with intervals.
        unreached: edges that no reading passes.
        jumps: edges of a jump sensor, scaled; None for a dead zone.
        delay: samples by which the input acts late.
        element: what stands in the place of a sensor's dead zone; None: nothing does.
        offsets: the four offsets along the log, with the element's plant; None: not looked at.
    """

    grid: Grid
    orders: list[OrderFit]
    chosen: OrderFit
    kalman: Sequence[KalmanFit]
    no_zone: NoZone
    residuals: ResidualMap
    rivals: dict[str, Density]
    place: Place | None
    excitation: Excitation
    widths: Widths
    unreached: tuple[str, ...]
    jumps: tuple[JumpEdge, JumpEdge] | None
    delay: int
    element: Element | None
    offsets: Offsets | None


class Disturbance(NamedTuple):
    """What disturbs z.

    Attributes:
        rms: of all of it [y].
        correlation_time: [s]; None where it is white.
        white: rms of its white part [y]; None where that was not told apart.
        model: which model of the disturbance fits best; None where none was fitted.
        ahead: whether it acts ahead of the zone.
    """

    rms: float
    correlation_time: float | None
    white: float | None
    model: str | None
    ahead: bool


class Answer(NamedTuple):
    """What a log says.

    Attributes:
        verdict: dead_zone, none, saturation, jump, play, both (play and dead zone), friction,
            input_zone, other, unclear or unreached.
        reasons: why, in words.
        right, left, width, centre: (value, low, high) with 95 % intervals, of what the verdict
            names [y], of an input zone [u]; None where the verdict allows no such number.
        order: poles of the plant.
        poles: of the plant (n) [1/s], complex.
        gain: DC gain from each input (m) [y/u].
        remarks: what was done to the log, and what to be careful about.
        options: what the user said.
        evidence: all that was computed.
    """

    verdict: str
    reasons: list[str]
    right: Interval | None
    left: Interval | None
    width: Interval | None
    centre: Interval | None
    order: int
    poles: Any
    gain: Floats
    remarks: list[str]
    options: Options
    evidence: Evidence

    @property
    def zone(self) -> bool:
        """Whether the sensor has a dead zone."""
        return self.verdict in ("dead_zone", "unreached")

    @property
    def fit(self) -> Fit:
        """The fit that every sample enters: (L2), or that of noise behind the zone."""
        return self.evidence.chosen.pairs

    @property
    def scale(self) -> float:
        """rms of y, by which the fit is scaled [y]."""
        return self.fit.objective.data.y_scale

    @property
    def element(self) -> Element | None:
        """What stands in the place of a sensor's dead zone."""
        return self.evidence.element

    @property
    def z(self) -> Floats:
        """Output of the plant (N), scaled."""
        return self.fit.z if self.element is None else self.element.z

    @property
    def plant(self) -> tuple[Simulator, Floats]:
        """The plant along the log, and its numbers, scaled."""
        if self.element is None:
            return self.fit.objective.simulator, self.fit.theta
        return self.element.simulator, self.element.theta

    @property
    def plant_numbers(self) -> tuple[Layout, Floats, Floats, Floats]:
        """Layout, a, b in units of y and u, and their covariance together."""
        simulator, theta = self.plant
        layout, data = simulator.layout, simulator.data
        if self.element is None:
            V = self.fit.objective.spread(theta).V
        else:
            V = self.element.V
        count = layout.b.stop
        scale = np.ones(count)
        factors = np.repeat(data.y_scale / data.u_scale, layout.n)
        scale[layout.b] = factors
        V = V[:count, :count] * np.outer(scale, scale)
        return layout, theta[layout.a], theta[layout.b] * factors, V

    @property
    def disturbance(self) -> Disturbance:
        """What disturbs z."""
        step, scale = self.evidence.grid.step, self.scale
        element, fit = self.element, self.fit
        if element is not None and element.ahead is not None:
            time = -step / math.log(element.ahead.phi) if element.ahead.phi > 0 else None
            noise = element.noise * scale
            return Disturbance(element.unseen * scale, time, noise, NAMES[AT_INPUT], True)
        if element is not None:
            return Disturbance(element.unseen * scale, None, element.noise * scale, None, True)
        time = -step / math.log(fit.rho) if 0.05 < fit.rho < 1 else None
        if fit.objective.kind == "behind":  # the climb to s ends early at a zone without width
            left = fit.objective.residuals(fit.theta)[fit.objective.readings.ok]
            rms = math.sqrt(float(np.mean(left**2)))
            return Disturbance(rms * scale, time, None, None, False)
        if not self.evidence.kalman:
            return Disturbance(fit.s * scale, time, None, None, True)
        best = self.evidence.kalman[0]
        return Disturbance(fit.s * scale, time, best.r * scale, NAMES[best.model], True)


# --- From what was found


def to_answer(case: Case, found: Found) -> Answer:
    """The answer in the units of the log.

    Args:
        case: the log, fitted with a zone of the sensor.
        found: the verdict, and what stands in the zone's place.
    """
    evidence = _evidence(case, found)
    element, fit, step = found.element, evidence.chosen.pairs, case.grid.step
    simulator, theta = fit.objective.simulator, fit.theta
    if element is not None:
        simulator, theta = element.simulator, element.theta
    with np.errstate(divide="ignore"):
        rates = np.log(simulator.poles(theta).astype(complex)) / step
    gain = simulator.gain(theta) * case.data.y_scale / case.data.u_scale
    gain /= step**case.options.integrators
    word = found.verdict.word
    shown: Shown = dict.fromkeys(DIRECTIONS)
    remarks = [*case.prepared.remarks, *found.verdict.cautions]
    if element is not None:
        shown = dict(element.widths)
        remarks += [*element.remarks, *_late(evidence)]
    elif word == "dead_zone" or (word == "jump" and case.of_jump):
        heard = hears_input(fit)
        shown = _shown_jump(evidence) if case.of_jump else _shown(case, evidence, heard)
        remarks += [*_late(evidence), *_edge_remarks(evidence, shown, heard)]
        remarks += _hardly_passed(evidence, shown, case.data.y_scale)
        word = "unreached" if case.unreached else word
    return Answer(
        verdict=word,
        reasons=found.verdict.reasons,
        **shown,
        order=simulator.layout.n,
        poles=rates,
        gain=gain,
        remarks=remarks,
        options=case.options,
        evidence=evidence,
    )


def _evidence(case: Case, found: Found) -> Evidence:
    """All that was computed, the widths and the check on held-out data among it."""
    chosen, best = case.chosen, next(iter(found.kalman), None)
    offset, held_out = case.offset, case.options.held_out
    orders = credible(case.orders)
    widths = find_widths(chosen, orders, case.alike, best, case.quantum, offset)
    edges = widths.right.value, widths.left.value
    excited = excitation(case.data.readings(), chosen.pairs.z, *edges, case.data.silent_zeros)
    if found.element is not None:
        chosen = chosen._replace(**held_out_of(found.element, held_out)._asdict())
    if best is not None:
        chosen = chosen._replace(white=_white_after_filter(best, held_out))
    return Evidence(
        grid=case.grid,
        orders=case.orders,
        chosen=chosen,
        kalman=found.kalman,
        no_zone=case.no_zone,
        residuals=case.residuals,
        rivals=case.rivals,
        place=found.place,
        excitation=excited,
        widths=widths,
        unreached=case.unreached,
        jumps=case.prepared.jumps,
        delay=found.delay,
        element=found.element,
        offsets=found.offsets,
    )


def _white_after_filter(kalman: KalmanFit, held_out: float) -> bool:
    """Whether the filter's one-step errors on the held-out part are white, where it speaks."""
    data = kalman.objective.data
    use = data.ok & (data.side != 0) & ~trained_part(data, held_out)
    return is_white(innovations(kalman), use)


def _late(evidence: Evidence) -> list[str]:
    """That the input acts late, where it does."""
    if not evidence.delay:
        return []
    time = "" if evidence.grid.counted else f" ({evidence.delay * evidence.grid.step:.4g} s)"
    return [f"the input acts {evidence.delay} samples late{time}"]


def _edge_remarks(evidence: Evidence, shown: Shown, heard: bool) -> list[str]:
    """What to know of edges that are given."""
    remarks = list(evidence.widths.remarks) if evidence.jumps is None else []
    if heard:
        remarks.append(
            "past inputs explain part of the one-step residual: a delay, or too few poles; the"
            " plant model does not fit, and the intervals are doubled; try a higher --order, or"
            " shift the input by the delay"
        )
    for name in evidence.unreached:
        remarks.append(
            f"no reading lies beyond the {name} edge: record with a larger input, or say"
            f" --{name} inf if there is none"
        )
    if _tied(evidence):
        remarks.append(
            "z of an integrating plant has no zero of its own: it counts from the middle of the"
            " zone, so both edges are half of the width; the place of the zone is not asked"
        )
    for name in ("right", "left"):
        edge = shown[name]
        if edge is not None and edge.value < 0:
            remarks.append(
                f"d_{name} is negative: the zone does not hold z = 0, as after an offset of the"
                " input or of the output; the width is not touched by that"
            )
    return remarks


def _tied(evidence: Evidence) -> bool:
    """Whether both edges are one number, of a plant that integrates."""
    return evidence.chosen.pairs.objective.limits.tied


def _hardly_passed(evidence: Evidence, shown: Shown, scale: float) -> list[str]:
    """Widen the intervals of edges that are hardly passed, and say so."""
    remarks: list[str] = []
    if evidence.jumps is not None or _tied(evidence):
        return remarks
    for name, visits in zip(("right", "left"), evidence.excitation.visits, strict=True):
        edge = shown[name]
        if not 0 < visits < FEW_VISITS or edge is None or not edge.low < edge.high < math.inf:
            continue
        wider = widened(evidence.chosen.pairs, name, edge, scale)
        more = (edge.low - wider.low, wider.high - edge.high)
        shown[name] = wider
        shown["width"] = _grown(shown["width"], *more)
        shown["centre"] = _grown(shown["centre"], max(more), max(more))
        remarks.append(
            f"the {name} edge is passed {visits} times only: hardly known; its interval is that of"
            " the profile likelihood where that is wider"
        )
    return remarks


def _grown(interval: Interval | None, below: float, above: float) -> Interval | None:
    """An interval that reaches further."""
    if interval is None:
        return None
    return Interval(interval.value, interval.low - below, interval.high + above)


def _shown_jump(evidence: Evidence) -> Shown:
    """The edges of a jump sensor in the units of the log; the others are on the safe side."""
    assert evidence.jumps is not None
    scale = evidence.chosen.pairs.objective.data.y_scale
    sides = []
    for edge in evidence.jumps:
        wider = 0.5 * evidence.grid.quantum if edge.high > edge.low else 0.0
        low, high = edge.low * scale - wider, edge.high * scale + wider
        sides.append(Interval(edge.value * scale, low, high))
    right, left = sides
    width = Interval(right.value + left.value, right.low + left.low, right.high + left.high)
    twice = Interval(right.value - left.value, right.low - left.high, right.high - left.low)
    return {"right": right, "left": left, "width": width, "centre": twice.scaled(0.5)}


def _shown(case: Case, evidence: Evidence, heard: bool) -> Shown:
    """The widths in the units of the log; an edge never reached has a lower bound alone."""
    scale, wider = case.data.y_scale, 2.0 if heard else 1.0
    shown: Shown = {}
    for name in DIRECTIONS:
        value, low, high = getattr(evidence.widths, name).scaled(scale)
        shown[name] = Interval(value, value - wider * (value - low), value + wider * (high - value))
    for name in ("right", "left"):
        low, high = case.options.bounds(name)
        if low == high:
            shown[name] = None if low == math.inf else Interval(low, low, high)
        if low == math.inf:
            shown["width"] = shown["centre"] = None
    if _tied(evidence):
        shown["centre"] = None
    for name in evidence.unreached:
        bound = lower_bound(evidence.chosen.singles, name) * scale
        shown[name] = Interval(bound, bound, math.inf)
        shown["width"] = shown["centre"] = None
    return shown


# --- What an observer is told


def told_range(answer: Answer, side: str) -> tuple[float, float]:
    """The 99.9 % interval of a width, within the bounds that the user gave [y].

    Each half of the shown interval grows as Student's quantile does for the degrees of freedom that
    it has, which are few where the edge is passed a few times; an edge of a jump sensor has
    quantiles of its own.

    Args:
        answer: with both widths.
        side: right or left.

    Returns:
        The least and the largest width.

    Raises:
        InputError: the width has no upper bound.
    """
    edge = answer.right if side == "right" else answer.left
    assert isinstance(edge, Interval)
    low, high = answer.options.bounds(side)
    below, above = _reach(answer, side, edge)
    low, high = max(edge.value - below, low, 0.0), min(edge.value + above, high)
    if not math.isfinite(high):
        raise InputError(
            f"scenario: the log gives no upper bound of d_{side}; bound it by --{side} LOW,HIGH"
        )
    return _not_too_narrow(low, high)


def told_element(element: Element, interval: Interval) -> tuple[float, float]:
    """The 99.9 % interval of a width of an element that is no dead zone, not below 0 [y]."""
    wider = _growth(element.degrees)
    low = max(interval.value - wider * (interval.value - interval.low), 0.0)
    return _not_too_narrow(low, interval.value + wider * (interval.high - interval.value))


def _not_too_narrow(low: float, high: float) -> tuple[float, float]:
    """A range that is wider than rounding."""
    margin = LEAST * max(high, LEAST)
    return (low, high) if high - low > margin else (max(low - margin, 0.0), high + margin)


def _growth(degrees: float) -> float:
    """By how much a 99.9 % interval is wider than one of 95 %."""
    return quantile(degrees, SURE) / quantile(degrees)


def _reach(answer: Answer, side: str, edge: Interval) -> tuple[float, float]:
    """How far the range goes below and above a width [y]."""
    below, above = edge.value - edge.low, edge.high - edge.value
    jumps = answer.evidence.jumps
    if jumps is not None:
        jump = jumps[0] if side == "right" else jumps[1]
        return below + (jump.low - jump.lowest) * answer.scale, above
    degrees = answer.evidence.widths.degrees[side]
    if answer.element is not None:
        degrees = answer.element.degrees
    wider = _growth(degrees)
    return wider * below, wider * above
