"""Widths with their intervals, from the three stages of the fit."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from undeadzone.identification.fit import Fit, climbed
from undeadzone.identification.kalman_fit import KalmanFit
from undeadzone.identification.likelihood import Noise, singles
from undeadzone.identification.long_run import Spread
from undeadzone.identification.objective import Limits, Objective
from undeadzone.identification.orders import OrderFit
from undeadzone.support.arrays import Floats

DIRECTIONS = {"right": (1.0, 0.0), "left": (0.0, 1.0), "width": (1.0, 1.0), "centre": (0.5, -0.5)}


class Interval(NamedTuple):
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> Interval:
        """The interval in other units."""
        return Interval(self.value * factor, self.low * factor, self.high * factor)

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


class Widths(NamedTuple):
    """What the three stages say of the widths, scaled.

    Attributes:
        right, left, width, centre: values with intervals.
        stages: (right, left) by each stage that was run.
        halves: half intervals by stage and name, before anything is added.
        degrees: degrees of freedom of the widest of these, by name.
        fits: whether the stages agree; false: the model does not fit.
        remarks: what was found out, for the user.
    """

    right: Interval
    left: Interval
    width: Interval
    centre: Interval
    stages: dict[str, tuple[float, float]]
    halves: dict[str, dict[str, float]]
    degrees: dict[str, float]
    fits: bool
    remarks: list[str]


def find_widths(
    chosen: OrderFit,
    others: list[OrderFit],
    alike: list[OrderFit],
    kalman: KalmanFit | None,
    quantum: float,
    offset: float | None,
) -> Widths:
    """The widths and their intervals.

    Args:
        chosen: the order that was chosen.
        others: the orders that are credible.
        alike: fits with another delay that explain the log as well.
        kalman: the third stage; None where it was not run.
        quantum: of the readings, scaled.
        offset: rms of an unknown offset, scaled; None: free.

    Returns:
        Values of the last stage, with the widest of the stages' intervals.
    """
    stages, halves, known = _stages(chosen, kalman)
    last = list(stages)[-1]
    remarks: list[str] = []
    widest, degrees = {}, {}
    for name in DIRECTIONS:
        stage = max(halves, key=lambda one: halves[one][name])
        widest[name], degrees[name] = halves[stage][name], known[stage][name]
    fits = True
    if "L3" in stages and "L2" in stages:
        for place, name in enumerate(("right", "left")):
            if abs(stages["L3"][place] - stages["L2"][place]) > widest[name]:
                fits = False
                last = "L2"
        if not fits:
            remarks.append(
                "the disturbance model does not fit; the widths are those of pairs, the intervals"
                " widened by the difference"
            )
    values = {name: float(np.dot(row, stages[last])) for name, row in DIRECTIONS.items()}
    intervals = {}
    apart = False
    for name, row in DIRECTIONS.items():
        gap = _gap(stages, row, "L1")
        apart |= name != "centre" and gap > widest[name] > 0
        half = widest[name]
        if half > 0:
            half = max(half, gap, 0.0 if last == "L3" else _gap(stages, row, "L3"))
            half = math.hypot(half, _hidden(name, others, chosen))
        half = math.hypot(half, 0.5 * quantum) if half > 0 else half
        if name != "width":
            half = math.inf if offset is None else math.hypot(half, offset)
        intervals[name] = Interval(values[name], values[name] - half, values[name] + half)
        for other in alike:
            intervals[name] = _reaching(intervals[name], _difference(row, other, chosen))
    if apart:
        fits = False
        remarks.append(
            "fits of single samples and of pairs disagree: the plant model does not fit; the"
            " intervals are widened by the difference"
        )
    return Widths(
        **intervals, stages=stages, halves=halves, degrees=degrees, fits=fits, remarks=remarks
    )


def _gap(stages: dict[str, tuple[float, float]], row: tuple[float, float], stage: str) -> float:
    """How far a stage is from that of pairs; 0 where one of them was not run."""
    if stage not in stages or "L2" not in stages:
        return 0.0
    return abs(float(np.dot(row, stages[stage]) - np.dot(row, stages["L2"])))


Named = dict[str, dict[str, float]]  # numbers by stage and name


def _stages(
    chosen: OrderFit, kalman: KalmanFit | None
) -> tuple[dict[str, tuple[float, float]], Named, Named]:
    """(right, left) by stage; half intervals, and their degrees of freedom."""
    stages: dict[str, tuple[float, float]] = {}
    halves: Named = {}
    degrees: Named = {}
    fits = [("L1", chosen.singles)]
    drifts = chosen.pairs.objective.limits.tied and kalman is not None
    if chosen.pairs is not chosen.singles and not drifts:  # what drifts has no correlation
        fits.append(("L2", chosen.pairs))
    for name, fit in fits:
        stages[name] = (fit.right, fit.left)
        spread = fit.objective.spread(fit.theta)
        rows = {}
        for key, (right, left) in DIRECTIONS.items():
            rows[key] = fit.objective.direction(right=right, left=left)
        halves[name], degrees[name] = _told(spread, rows)
    if kalman is not None:
        stages["L3"] = (kalman.right, kalman.left)
        spread = kalman.objective.spread(kalman.p)
        rows = {key: kalman.direction(*weights) for key, weights in DIRECTIONS.items()}
        halves["L3"], degrees["L3"] = _told(spread, rows)
    return stages, halves, degrees


def _told(spread: Spread, rows: dict[str, Floats]) -> tuple[dict[str, float], dict[str, float]]:
    """Half intervals of weighted sums and their degrees of freedom, by name."""
    told = {name: spread.half_and_degrees(row) for name, row in rows.items()}
    halves = {name: half for name, (half, _) in told.items()}
    return halves, {name: degrees for name, (_, degrees) in told.items()}


def _hidden(name: str, others: list[OrderFit], chosen: OrderFit) -> float:
    """The spread of a width over credible orders, which no score can show."""
    gaps = [_difference(DIRECTIONS[name], other, chosen) for other in others]
    return float(np.sqrt(np.mean(np.square(gaps)))) if gaps else 0.0


def _difference(row: tuple[float, float], other: OrderFit, chosen: OrderFit) -> float:
    """By how much a width is larger in another fit."""
    one, own = other.pairs, chosen.pairs
    return float(np.dot(row, (one.right - own.right, one.left - own.left)))


def _reaching(interval: Interval, gap: float) -> Interval:
    """An interval that also holds itself, moved by a gap."""
    low, high = interval.low + min(gap, 0.0), interval.high + max(gap, 0.0)
    return Interval(interval.value, low, high)


def lower_bound(fit: Fit, side: str) -> float:
    """The least width that an edge which no reading passes may have, scaled.

    Args:
        fit: with that edge far away.
        side: right or left.

    Returns:
        Where the log likelihood falls by 1.92, that is 95 %, below that of no edge at all.
    """
    z = fit.z
    readings = fit.objective.readings
    reach = float(z.max() if side == "right" else -z.min())
    noise = fit.objective.noise(fit.theta)
    drop = 0.5 * float(chi2.ppf(0.95, 1))
    base = float(singles(readings, z, noise).value.sum())
    low, high = reach - 6 * fit.s, reach + 6 * fit.s
    for _ in range(60):
        middle = 0.5 * (low + high)
        right = middle if side == "right" else noise.right
        left = middle if side == "left" else noise.left
        inside = right + left > 1e-9
        value = -math.inf
        if inside:
            value = float(singles(readings, z, Noise(right, left, noise.s, 0.0)).value.sum())
        if value < base - drop:
            low = middle
        else:
            high = middle
    return high


def profile(fit: Fit, side: str, values: Floats, steps: int = 10) -> Floats:
    """The log likelihood with one width held at each of several values (K), others refitted.

    Args:
        fit: the fit whose likelihood is profiled.
        side: right or left.
        values: widths, scaled, from the fitted one outward or in order (K).
        steps: of each climb.

    Returns:
        Log likelihoods less that of the fit.
    """
    objective = fit.objective
    place = objective.layout.right + (side == "left")
    centre = int(np.argmin(np.abs(values - fit.theta[place])))
    out = np.full(values.size, -np.inf)
    for direction in (range(centre, values.size), range(centre - 1, -1, -1)):
        theta = fit.theta
        for k in direction:
            fixed = (float(values[k]), float(values[k]))
            both = objective.limits.tied
            limits = Limits(
                fixed if both or side == "right" else objective.limits.right,
                fixed if both or side == "left" else objective.limits.left,
            )
            held = Objective(objective.simulator, objective.kind, limits, objective.readings.ok)
            top = climbed(held, theta, steps)
            out[k] = top.value - fit.value
            theta = top.theta if math.isfinite(top.value) else theta
    return out
