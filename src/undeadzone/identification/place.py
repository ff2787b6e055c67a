"""Where is the zone: at the sensor, in the plant as friction, or at its input?"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.fit import Fit, fit_linear
from undeadzone.identification.long_run import quantile, sandwich
from undeadzone.identification.place_models import PlaceFit, PlaceModel, Shape, fit_place
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
    starts = _Starts(fit)
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


class _Starts:
    """Where the climbs of the models begin."""

    def __init__(self, fit: Fit) -> None:
        simulator = fit.objective.simulator
        self.n, self.m = simulator.layout.n, simulator.layout.m
        self.base = simulator.layout.right
        self.plant = fit.theta[: self.base]
        self.widths = np.maximum([fit.right, fit.left], 0.02)
        self.widths = np.minimum(self.widths, 5.0)
        linear = fit_linear(simulator, fit.objective.readings.ok)
        self.plain = linear.theta[: self.base]
        self.zeros = np.zeros(7 + self.n)
        self.linear = np.append(self.plain, self.zeros)
        self.at_sensor = self._with(self.plant, sensor=self.widths)
        gain = abs(float(simulator.gain(fit.theta)[0]))
        usual = float(np.sqrt(np.mean(fit.z**2)))
        self.gain = gain if gain > 0.1 * usual else max(usual, 1e-3)

    def _with(self, plant: Floats, **parts: Floats) -> Floats:
        """Numbers of a plant and of widths: sensor, inner, input."""
        theta = np.append(plant, self.zeros)
        for name, place in (("sensor", 0), ("inner", 2), ("input", 5)):
            if name in parts:
                theta[self.base + place : self.base + place + 2] = parts[name]
        return theta

    def _levels(self) -> list[tuple[Floats, Floats]]:
        """Plants and levels in units of the input to begin with."""
        begun = []
        for part in (1.0, 0.4):
            level = np.clip(part * self.widths / self.gain, 0.02, 1.5)
            begun.append((self.plant, level))
        for level in (0.3, 0.8):
            plant = self.plain.copy()
            plant[self.n : self.n * (1 + self.m)] *= 1 + 0.5 * level
            begun.append((plant, np.full(2, level)))
        return begun

    def at_input(self) -> list[Floats]:
        """Zones of the input."""
        return [self._with(plant, input=level) for plant, level in self._levels()]

    def friction(self) -> list[Floats]:
        """Friction where the input acts: c = b / b_1."""
        begun = []
        for plant, level in self._levels():
            theta = self._with(plant, inner=level)
            first = theta[self.n]
            if first <= 1e-3:
                first = 0.05 * np.abs(plant[self.n : 2 * self.n]).max() + 1e-3
                theta[self.n] = first
            theta[self.base + 2 : self.base + 4] *= first
            begun.append(theta)
        return begun

    def free(self, fits: dict[str, PlaceFit]) -> list[Floats]:
        """Friction elsewhere: c of the input's, or the product over all poles but one."""
        begun = []
        for name in ("friction", "sensor"):
            if name not in fits:
                continue
            theta = fits[name].theta
            a, b = theta[: self.n], theta[self.n : 2 * self.n]
            static = b.sum() / (1 + a.sum())
            if name == "friction":
                level = fits[name].inner / max(abs(b[0]), 1e-9)
            else:
                level = fits[name].sensor / max(abs(static), 1e-6)
            for c in self._shapes(a, b):
                total = c.sum()
                force = abs(b.sum() / total) if abs(total) > 1e-6 else abs(b[0])
                begun.append(self._inner(theta, np.maximum(force * level, 1e-4), c[1:]))
        return begun

    def _shapes(self, a: Floats, b: Floats) -> list[Floats]:
        """Candidates of (1, c_1, ... c_(n-1))."""
        shapes = []
        if abs(b[0]) > 1e-6:
            shapes.append(b / b[0])
        poles = np.roots(np.append(1.0, a))
        real = np.abs(poles.imag) < 1e-9
        for i in np.flatnonzero(real):
            shapes.append(np.real(np.poly(np.delete(poles, i))))
        if not real.all() or self.n == 3:
            shapes.append(np.eye(1, self.n)[0])
        return shapes

    def _inner(self, theta: Floats, level: Floats, c: Floats) -> Floats:
        begun = self._with(theta[: self.base], inner=level)
        begun[self.base + 7 : self.base + 7 + c.size] = c
        return begun

    def sticking(self, fitted: PlaceFit) -> list[Floats]:
        """The same with breakaway above sliding friction."""
        begun = []
        for sigma in (0.2, 0.02):
            theta = fitted.theta.copy()
            theta[self.base + 4] = sigma
            begun.append(theta)
        return begun

    def with_sensor(self, fitted: PlaceFit) -> list[Floats]:
        """The same with a zone of the sensor beside it, of several sizes."""
        begun = []
        for part, rest in ((0.3, 0.7), (0.8, 0.3), (0.15, 1.0)):
            theta = fitted.theta.copy()
            theta[self.base : self.base + 2] = np.maximum(part * self.widths, 0.05)
            theta[self.base + 2 : self.base + 7] *= rest
            begun.append(theta)
        return begun


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
    residual, rows = fitted.model._rows(fitted.theta)
    variance = float(np.mean(residual**2))
    scores = rows * residual[:, None] / variance
    hessian = rows.T @ rows / variance + 1e-9 * np.eye(rows.shape[1])
    spread = sandwich(scores, hessian)
    base = fitted.model.base
    direction = np.isin(fitted.model.free, [base, base + 1]).astype(float)
    return float(fitted.sensor.sum()) > spread.half_width(direction)


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
    residual, rows = model._rows(theta)
    variance = float(np.mean(residual[model.data.ok] ** 2))
    hessian = rows.T @ rows / variance + 1e-9 * np.eye(rows.shape[1])
    spread = sandwich(rows * residual[:, None] / variance, hessian)
    last, c_last = theta[n - 1], theta[model.base + 7 + n - 1]
    if abs(last) < 1e-9:
        return math.nan, math.inf
    lam = c_last / last
    direction = np.zeros(model.size)
    direction[model.base + 7 + n - 1] = 1 / last
    direction[n - 1] = -lam / last
    row = direction[model.free]
    half = quantile(spread.degrees) * math.sqrt(max(float(row @ spread.V @ row), 0.0))
    return float(lam), float(half)


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
