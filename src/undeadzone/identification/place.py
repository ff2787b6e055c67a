"""Where is the zone: at the sensor, in the plant as friction, or at its input?"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.fit import Fit
from undeadzone.identification.place_models import PlaceFit, PlaceModel, Shape, fit_place
from undeadzone.identification.place_starts import PlaceStarts
from undeadzone.identification.static_rivals import CLEARLY, Density, compare_statistic
from undeadzone.support.arrays import Floats

KINDS = {
    "none": "none",
    "sensor": "sensor",
    "input": "input",
    "friction": "friction",
    "friction, sticking": "friction",
    "friction, free": "friction",
    "friction, free, sticking": "friction",
    "friction of a position": "friction",
    "sensor and friction": "both",
    "sensor and friction, free": "both",
    "sensor and input": "both",
}
SENSOR_LOW, SENSOR_HIGH = 0.5, 0.95  # lambda's interval that says sensor
FRICTION_HIGH = 0.5
BOTH_LOW = 0.3


class Place(NamedTuple):
    """Where the zone is.

    Attributes:
        verdict: sensor, friction, input, both, sensor*, friction* (the other beside it is not
            excluded) or undecided.
        lam: lambda = c_n / a_n: 1 at the sensor, 0 friction.
        half: half of its 95 % interval.
        by_rivals: what the comparison of models says.
        by_lambda: what lambda says.
        behind: nats per sample by which each other model is behind the best.
        levels: widths of friction and input zone, in units of the input, scaled.
        best: the account of the readings by the best model.
    """

    verdict: str
    lam: float
    half: float
    by_rivals: str
    by_lambda: str
    behind: dict[str, float]
    levels: dict[str, tuple[float, float]]
    best: Density


def find_place(fit: Fit) -> Place:
    """Where the zone of a record is.

    Args:
        fit: plant and sensor zone, one record.

    Returns:
        The verdict, lambda with its interval, and how far each rival is behind.
    """
    fits = _fit_all(fit)
    by_rivals = _winner(fits)
    lam, half = _lambda(fits, fit)
    by_lambda = _by_lambda(lam, half)
    best = min(fits.values(), key=lambda one: one.density.bic)
    count = fit.objective.readings.ok.sum()
    behind = {}
    for name, one in fits.items():
        behind[name] = float((one.density.bic - best.density.bic) / (2 * count))
    verdict = _together(by_rivals, by_lambda)
    levels = _levels(fits)
    return Place(verdict, lam, half, by_rivals, by_lambda, behind, levels, best.density)


def _fit_all(fit: Fit) -> dict[str, PlaceFit]:
    """Every model of the zone's place, fitted."""
    starts = PlaceStarts(fit)
    n, m = starts.n, starts.m
    fits: dict[str, PlaceFit] = {}

    def enter(shape: Shape, begun: list[Floats]) -> None:
        model = PlaceModel(fit.objective.simulator, shape)
        fitted = fit_place(model, begun)
        if fitted is not None:
            fits[shape.name] = fitted

    enter(Shape("none"), [starts.linear])
    enter(Shape("sensor", sensor=True), [starts.at_sensor])
    if m == 1:
        enter(Shape("input", input=True), starts.at_input())
    enter(Shape("friction", inner=True), starts.friction())
    enter(Shape("friction of a position", inner=True, position=True), starts.friction())
    if n > 1:
        enter(Shape("friction, free", inner=True, free=n - 1), starts.free(fits))
    for name in ("friction", "friction, free"):
        if name in fits:
            free = fits[name].model.shape.free
            shape = Shape(f"{name}, sticking", inner=True, sticks=True, free=free)
            enter(shape, starts.sticking(fits[name]))
            shape = Shape(f"sensor and {name}", sensor=True, inner=True, free=free)
            enter(shape, starts.with_sensor(fits[name]))
    if "input" in fits:
        shape = Shape("sensor and input", sensor=True, input=True)
        enter(shape, starts.with_sensor(fits["input"]))
    return fits


def _winner(fits: dict[str, PlaceFit]) -> str:
    """The place whose best model beats every model of every other place."""
    best: dict[str, PlaceFit] = {}
    for name, one in fits.items():
        kind = KINDS[name]
        if kind not in best or one.density.bic < best[kind].density.bic:
            best[kind] = one
    order = sorted(best, key=lambda kind: best[kind].density.bic)
    if order[0] == "both" and not _needs_sensor(best["both"]):
        order.remove("both")
    first = order[0]
    for other in order[1:]:
        if other == "both":
            continue  # a larger model that is not better by BIC
        if compare_statistic(best[first].density, best[other].density) <= CLEARLY:
            return "undecided"
    return first


def _needs_sensor(fitted: PlaceFit) -> bool:
    """Whether the sensor's width beside another zone is above 0 for certain."""
    base = fitted.model.base
    direction = np.isin(fitted.model.free, [base, base + 1]).astype(float)
    return float(fitted.sensor.sum()) > fitted.spread().half_width(direction)


def _lambda(fits: dict[str, PlaceFit], fit: Fit) -> tuple[float, float]:
    """lambda = c_n / a_n of the family that holds sensor and friction, with its half interval."""
    n = fit.objective.layout.n
    model = PlaceModel(fit.objective.simulator, Shape("all", inner=True, free=n))
    begun = []
    if "sensor" in fits:
        theta = fits["sensor"].theta
        width = np.maximum(fits["sensor"].sensor, 0.02)
        begun.append(model.theta(theta, inner=width, c=theta[:n]))
    for name in ("friction", "friction, free"):
        if name in fits:
            one = fits[name]
            c = one.model.c(one.theta)
            begun.append(model.theta(one.theta, inner=np.maximum(one.inner, 1e-4), c=c))
    fitted = fit_place(model, begun)
    if fitted is None:
        return math.nan, math.inf
    theta = fitted.theta
    last, c_last = theta[n - 1], theta[model.base + 7 + n - 1]
    if abs(last) < 1e-9:
        return math.nan, math.inf
    lam = c_last / last
    direction = np.zeros(model.size)
    direction[model.base + 7 + n - 1] = 1 / last
    direction[n - 1] = -lam / last
    return float(lam), fitted.spread().half_width(direction[model.free])


def _by_lambda(lam: float, half: float) -> str:
    """What lambda's interval says."""
    low, high = lam - half, lam + half
    if not math.isfinite(high):
        return "undecided"
    if low > SENSOR_LOW and high > SENSOR_HIGH:
        return "sensor"
    if high < FRICTION_HIGH:
        return "friction"
    if low > BOTH_LOW and high < SENSOR_HIGH:
        return "both"
    return "undecided"


def _together(rivals: str, lam: str) -> str:
    """The verdict from both: agreement, or one of them alone, or a cautious mixture."""
    if rivals == "input":
        return "input"
    if rivals == lam:
        return rivals
    if lam == "undecided" and rivals in ("sensor", "friction"):
        return rivals
    for one, other in ((rivals, lam), (lam, rivals)):
        if one == "both" and other in ("sensor", "friction"):
            return f"{other}*"
    if rivals == "undecided" and lam in ("sensor", "friction"):
        return f"{lam}*"
    return "undecided"


def _levels(fits: dict[str, PlaceFit]) -> dict[str, tuple[float, float]]:
    """Friction and the zone of the input in units of the input, scaled."""
    levels = {}
    for name, one in fits.items():
        kind = KINDS[name]
        if kind == "friction" and kind not in levels:
            b = one.theta[one.model.n : 2 * one.model.n]
            force = abs(b.sum()) / max(abs(1 + one.model.c(one.theta).sum()), 1e-9)
            right, left = one.inner / max(force, 1e-9)
            levels[kind] = (float(right), float(left))
        if kind == "input":
            levels[kind] = (float(one.input[0]), float(one.input[1]))
    return levels
