"""Where is the zone: at the sensor, in the plant as friction, or at its input?"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.models.least_squares import CLEARLY, Density, compare_statistic
from undeadzone.identification.models.place import (
    WIDTHS,
    PlaceFit,
    PlaceStarts,
    Shape,
    fit_place,
    numbers_of,
)
from undeadzone.identification.models.zone_fit import Fit
from undeadzone.identification.verdict.verdict import Verdict, explains_better
from undeadzone.support.arrays import Floats

SENSOR_LOW, SENSOR_HIGH = 0.5, 0.95  # lambda's interval that says sensor
FRICTION_HIGH = 0.5
BOTH_LOW = 0.3
ADVICE = (
    "to tell a sensor's zone from friction, record with an input that reverses within the plant's"
    " slowest time constant (steps or noise of 0.4 to 1.5 times its bandwidth, 50 reversals or"
    " more, several amplitudes, the largest well outside the zone), 10 or more samples a time"
    " constant"
)


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
    fits: dict[str, PlaceFit] = {}

    def enter(shape: Shape, begun: list[Floats]) -> None:
        fitted = fit_place(starts.simulator, shape, begun)
        if fitted is not None:
            fits[shape.name] = fitted

    enter(Shape("none"), starts.none())
    enter(Shape("sensor", sensor=True), starts.at_sensor())
    if starts.simulator.layout.m == 1:
        enter(Shape("input", input=True), starts.at_input())
    enter(Shape("friction", inner=True), starts.friction())
    enter(Shape("friction of a position", inner=True, position=True), starts.friction())
    if starts.n > 1:
        enter(Shape("friction, free", inner=True, free=starts.n - 1), starts.free(fits))
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
    for one in fits.values():
        kind = one.model.shape.kind
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
    model, theta = fitted.model, fitted.theta
    direction = np.isin(model.free, [model.base, model.base + 1]).astype(float)
    width = float(model.part(theta, "sensor").sum())
    return width > fitted.squares.spread(theta).half_width(direction)


def _lambda(fits: dict[str, PlaceFit], fit: Fit) -> tuple[float, float]:
    """lambda = c_n / a_n of the family that holds sensor and friction, with its half interval."""
    n, base = fit.objective.layout.n, fit.objective.layout.right
    begun = []
    if "sensor" in fits:
        model, theta = fits["sensor"].model, fits["sensor"].theta
        inner = np.maximum(model.part(theta, "sensor"), 0.02)
        begun.append(numbers_of(theta[:base], n, theta[:n], inner=inner))
    for name in ("friction", "friction, free"):
        if name in fits:
            model, theta = fits[name].model, fits[name].theta
            inner = np.maximum(model.part(theta, "inner"), 1e-4)
            begun.append(numbers_of(theta[:base], n, model.c(theta), inner=inner))
    fitted = fit_place(fit.objective.simulator, Shape("all", inner=True, free=n), begun)
    if fitted is None:
        return math.nan, math.inf
    theta, c_n = fitted.theta, base + WIDTHS + n - 1
    last = theta[n - 1]
    if abs(last) < 1e-9:
        return math.nan, math.inf
    lam = theta[c_n] / last
    direction = np.zeros(theta.size)
    direction[c_n] = 1 / last
    direction[n - 1] = -lam / last
    spread = fitted.squares.spread(theta)
    return float(lam), spread.half_width(direction[fitted.model.free])


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
    for one in fits.values():
        kind, model, theta = one.model.shape.kind, one.model, one.theta
        if kind == "friction" and kind not in levels:
            b = theta[model.n : 2 * model.n]
            force = abs(b.sum()) / max(abs(1 + model.c(theta).sum()), 1e-9)
            right, left = model.part(theta, "inner") / max(force, 1e-9)
            levels[kind] = (float(right), float(left))
        if kind == "input":
            right, left = model.part(theta, "input")
            levels[kind] = (float(right), float(left))
    return levels


# --- What follows from it


def with_place(verdict: Verdict, place: Place, noise_falls_silent: bool) -> Verdict:
    """The verdict after the zone's place is known.

    Args:
        verdict: dead_zone, as far as static maps go.
        place: what was found about the place.
        noise_falls_silent: whether noise ahead of the zone is silenced by it, which only a sensor
            does.

    Returns:
        dead_zone with cautions, friction or input_zone with advice.
    """
    where = place.verdict
    if where in ("friction", "friction*") and not noise_falls_silent:
        return explains_better("friction", ADVICE)
    if where == "input":
        return explains_better("input_zone")
    return verdict.with_cautions(*_cautions(where, noise_falls_silent))


def _cautions(where: str, noise_falls_silent: bool) -> list[str]:
    """What to know of the widths of a zone of the sensor, by where else one may be."""
    if where == "both":
        return ["friction or a zone of the input lies beside the sensor's zone"]
    if where in ("sensor*", "friction", "friction*"):
        return ["a zone of the sensor is there; friction beside it is not excluded"]
    if where != "undecided":
        return []
    if noise_falls_silent:
        return ["noise falls silent, so the sensor has a zone; friction is not excluded"]
    unknown = (
        "a zone, yes; this record cannot tell whether sensor, friction or input has it; the widths"
        " hold if it is the sensor's alone"
    )
    return [unknown, ADVICE]


def rescued(verdict: Verdict, place: Place, rivals: dict[str, Density]) -> Verdict:
    """What is no dead zone of the sensor may be friction or a zone of the input.

    Args:
        verdict: the verdict by static maps, not dead_zone.
        place: what was found about the place.
        rivals: static maps.

    Returns:
        friction or input_zone where such a model beats every static map; else the verdict.
    """
    if place.best.strange or place.by_rivals not in ("friction", "input"):
        return verdict
    for rival in rivals.values():
        if compare_statistic(place.best, rival) <= CLEARLY:
            return verdict
    if place.by_rivals == "input":
        return explains_better("input_zone")
    return explains_better("friction", ADVICE)
