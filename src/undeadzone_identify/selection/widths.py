"""Widths with intervals from both stages of the fit, and the excitation of the edges."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher

from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest, zone
from undeadzone.util.arrays import Floats, bounds_of_runs
from undeadzone_identify.models.estimates import (
    Interval,
    maximise_likelihood,
    variance_along,
)
from undeadzone_identify.models.kalman_fit import KalmanFit
from undeadzone_identify.models.likelihood import (
    Readings,
    root_mean_square,
    single_densities,
)
from undeadzone_identify.models.zone import WidthLimits, ZoneObjective
from undeadzone_identify.models.zone_fit import ZoneFit
from undeadzone_identify.selection.orders import OrderFit

FEW_VISITS = 3  # below these an edge is hardly reached
POINTS = 8  # of a profile, on each side of the edge
STEPS = 10  # of each climb of a profile
SINGULAR = 20.0  # ratio of half intervals, from which the Hessian of the wider one is singular
APART = (
    "fits of single samples and of the filter disagree: the plant or its disturbance does not fit."
    " The intervals are widened by the difference"
)
SIDES = ("right", "left")
REACH = 4.0  # usual half intervals, within which its ends are sought


class WidthEstimates(NamedTuple):
    """Estimates of the widths by both stages, scaled.

    Attributes:
        right, left, width, centre: values with intervals.
        degrees: degrees of freedom of the widest stage, by name.
        remarks: for the user.
    """

    right: Interval
    left: Interval
    width: Interval
    centre: Interval
    degrees: dict[str, float]
    remarks: list[str]


def find_widths(
    chosen: OrderFit,
    others: list[OrderFit],
    alike: list[OrderFit],
    kalman: KalmanFit | None,
    quantum: float,
    offset: float | None,
) -> WidthEstimates:
    """Find the widths and their intervals.

    Args:
        chosen: the order that was chosen.
        others: the orders that are credible.
        alike: fits with another delay that explain the log as well.
        kalman: the second stage; None if it was not run.
        quantum: of the readings, scaled.
        offset: rms of an unknown offset, scaled; None: free.

    Returns:
        Values of the last stage, with the widest of the stages' intervals.
    """
    fits: list[ZoneFit | KalmanFit] = [chosen.fit, *filter(None, [kalman])]
    stages = list(map(_to_stage, fits))
    first, last = stages[0].edges, stages[-1].edges
    intervals, degrees, apart = {}, {}, False
    for name, row in DIRECTIONS.items():
        widest = _widest_stage(stages, name)
        gap = abs(float(np.dot(row, np.subtract(last, first))))
        half = widest.halves[name]
        degrees[name] = widest.degrees[name]
        apart |= name != "centre" and gap > half > 0
        if half > 0:  # no score shows the spread over credible orders
            spread = [_width_difference(row, other, chosen) for other in others]
            rounding = heaviest(row) * 0.5 * quantum
            half = math.hypot(max(half, gap), root_mean_square(np.array(spread)), rounding)
        half = widen_by_offset(half, row, offset)
        intervals[name] = Interval.from_half_width(float(np.dot(row, last)), half)
        for other in alike:
            gap = _width_difference(row, other, chosen)
            intervals[name] = intervals[name].extend_by(max(-gap, 0.0), max(gap, 0.0))
    return WidthEstimates(**intervals, degrees=degrees, remarks=[APART] * apart)


def widen_by_offset(half: float, row: tuple[float, float], offset: float | None) -> float:
    """Return half an interval of right, left, width or centre, with the effect of an output
    offset.

    Args:
        half: without it.
        row: weights of right and left.
        offset: its rms; None: free.
    """
    shift = abs(row[0] - row[1])  # by which an offset of 1 moves it
    if not shift:
        return half
    return math.inf if offset is None else math.hypot(half, shift * offset)


class _Stage(NamedTuple):
    """Estimates of a stage: (right, left), and half intervals with degrees of freedom by name."""

    edges: tuple[float, float]
    halves: dict[str, float]
    degrees: dict[str, float]


def _widest_stage(stages: Collection[_Stage], name: str) -> _Stage:
    """Return the stage of the widest interval of a width that another stage does not refute.

    Args:
        stages: those that were run.
        name: right, left, width or centre.
    """
    narrowest = min(one.halves[name] for one in stages)  # 0: a width that is known
    limit = SINGULAR * narrowest or math.inf
    return max(
        (one for one in stages if one.halves[name] <= limit), key=lambda one: one.halves[name]
    )


def _to_stage(fit: ZoneFit | KalmanFit) -> _Stage:
    """Convert a fit to its estimates of the widths."""
    spread = fit.objective.robust_covariance(fit.theta)
    halves = {}
    degrees = {}
    for name, weights in DIRECTIONS.items():
        row = fit.objective.width_weights(*weights)
        halves[name], degrees[name] = spread.half_and_degrees(row)
    return _Stage((fit.right, fit.left), halves, degrees)


def _width_difference(row: tuple[float, float], other: OrderFit, chosen: OrderFit) -> float:
    """Return the excess of a width in another fit, scaled."""
    return float(
        np.dot(row, (other.fit.right - chosen.fit.right, other.fit.left - chosen.fit.left))
    )


def lower_width_bound(fit: ZoneFit, side: str) -> float:
    """Find the least width of an edge that no reading passes, scaled.

    Args:
        fit: with that edge far away.
        side: right or left.

    Returns:
        Where the log likelihood falls by 1.92, that is 95 %, below that of no edge at all. Until z
        first lies beyond the other edge its start is free, and shows nothing.
    """
    noise = fit.zone_noise
    beyond = fit.z < -noise.left if side == "right" else fit.z > noise.right
    shows = np.maximum.accumulate(beyond)
    if not shows.any():
        return 0.0
    readings, z = fit.objective.readings, fit.z
    reach = float(z[shows].max() if side == "right" else -z[shows].min())
    drop = 0.5 * chi2.ppf(0.95, 1)
    base = single_densities(readings, z, noise).value[shows].sum()

    def above_drop(width: float) -> float:
        """Return by how much the log likelihood is above where it has fallen by that much."""
        own = noise._replace(**{side: width})
        if own.right + own.left <= 1e-9:
            return -math.inf
        return float(single_densities(readings, z, own).value[shows].sum()) - base + drop

    low = reach - 6 * fit.disturbance_rms
    high = reach + 6 * fit.disturbance_rms
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if above_drop(middle) < 0 else (low, middle)
    return max(high, 0.0)


def profile_likelihood(fit: ZoneFit, side: str, values: Floats) -> Floats:
    """Return the log likelihood with a width fixed at several values (K), the rest refitted.

    Args:
        fit: the fit whose likelihood is profiled.
        side: right or left.
        values: widths, scaled, from the fitted one outward or in order (K).

    Returns:
        Log likelihoods less that of the fit.
    """
    objective = fit.objective
    place = objective.layout.right + (side == "left")
    centre = np.argmin(np.abs(values - fit.theta[place]))
    sides = SIDES if objective.limits.tied else (side,)
    out = np.full(values.size, -np.inf)
    for direction in (range(centre, values.size), range(centre - 1, -1, -1)):
        theta = fit.theta
        for k in direction:
            fixed: dict[str, Any] = dict.fromkeys(sides, (float(values[k]), float(values[k])))
            limits = WidthLimits(*objective.limits[:2])._replace(**fixed)
            held = ZoneObjective(objective.simulator, objective.kind, limits, objective.readings.ok)
            top = maximise_likelihood(held, theta, STEPS)
            out[k] = top.value - fit.value
            theta = top.theta if math.isfinite(top.value) else theta
    return out


def widen_by_profile(fit: ZoneFit, side: str, edge: Interval, scale: float) -> Interval:
    """Return the union of the usual interval and that of the profile likelihood.

    2 (L - L(d)) V_naive / V <= F(1, K), with V the robust variance of the edge and V_naive that of
    independent samples.

    Args:
        fit: of plant and zone, scaled.
        side: right or left.
        edge: the usual interval [y].
        scale: rms of y [y].

    Returns:
        The union of both [y]; an end that the likelihood never forbids is infinite, or 0.
    """
    spread = fit.objective.robust_covariance(fit.theta)
    row = fit.objective.width_weights(*DIRECTIONS[side])
    robust, degrees = spread.variance_and_degrees(row)
    naive = variance_along(spread.naive, row)
    drop = 0.5 * fisher.ppf(0.95, 1, degrees) * robust / max(naive, 1e-300)
    own = fit.right if side == "right" else fit.left
    reach = REACH * max(edge.half_width / scale, 1e-6)
    ends = []
    away = np.linspace(0.0, 1.0, POINTS + 1)
    for values in (np.sort(own - reach * away), own + reach * away):
        fallen = -profile_likelihood(fit, side, values)
        order = np.argsort(np.abs(values - own))
        ends.append(_profile_crossing(values[order], fallen[order], drop))
    low, high = ends
    shift = edge.value - own * scale
    low = 0.0 if math.isinf(low) else low * scale + shift
    high = high if math.isinf(high) else high * scale + shift
    return Interval(edge.value, min(edge.low, low), max(edge.high, high))


def _profile_crossing(values: Floats, fallen: Floats, drop: float) -> float:
    """Return the value at which the likelihood has fallen by `drop`, away from the edge; inf
    if never.
    """
    beyond = np.flatnonzero(fallen > drop)
    if not beyond.size:
        return math.inf
    k = beyond[0]
    if k == 0 or not math.isfinite(fallen[k]):
        return float(values[k])
    return float(np.interp(drop, fallen[k - 1 : k + 1], values[k - 1 : k + 1]))


# --- Excitation


class Excitation(NamedTuple):
    """Excitation of each edge by a log.

    Attributes:
        samples: readings beyond the right and the left edge.
        visits: how many times each edge was passed.
        silent: share of silent readings.
        longest: samples of the longest silence.
    """

    samples: tuple[int, int]
    visits: tuple[int, int]
    silent: float
    longest: int


def measure_excitation(
    readings: Readings, z: Floats, right: float, left: float, ahead: bool
) -> Excitation:
    """Measure the excitation of the edges by a log.

    Args:
        readings: the record.
        z: output of the fitted plant (N).
        right, left: fitted widths.
        ahead: whether readings show their side: noise ahead of the zone.

    Returns:
        Counts of samples and visits, and the share of silence.
    """
    side = np.where(readings.ok, readings.side if ahead else zone(z, right, left), 0)
    silent = readings.ok & (side == 0)
    samples = (int((side > 0).sum()), int((side < 0).sum()))
    visits = (bounds_of_runs(side > 0)[0].size, bounds_of_runs(side < 0)[0].size)
    first, last = bounds_of_runs(silent)
    longest = int((last - first + 1).max(initial=0))
    return Excitation(samples, visits, float(silent.sum() / readings.ok.sum()), longest)
