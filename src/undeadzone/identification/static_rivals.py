"""Other static maps and play in the place of the dead zone, by least squares, compared."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from undeadzone.identification.climb import climb
from undeadzone.identification.fit import Fit, fit_linear
from undeadzone.identification.log import Flags
from undeadzone.identification.long_run import long_run_covariance
from undeadzone.identification.objective import FAR
from undeadzone.identification.plant_fit import Simulator
from undeadzone.identification.residual_map import curve_over, is_strange
from undeadzone.support.arrays import Floats

CLEARLY = 2.0  # Vuong's statistic from which one model beats another

Map = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]
# (z (N), two numbers p) -> (g (N), dg/dz (N), dg/dp (N x 2)); for play dg/dz tells where it moves


class Density(NamedTuple):
    """A model's account of the readings.

    Attributes:
        name: of the model.
        value: log density of each reading (N), residuals being first order.
        numbers: how many numbers were fitted.
        rms: of its residuals, scaled.
        extra: the map's two numbers, scaled.
        strange: whether a curve over its z explains what it leaves: then it is not the map either.
    """

    name: str
    value: Floats
    numbers: int
    rms: float
    extra: tuple[float, ...]
    strange: bool = False

    @property
    def bic(self) -> float:
        """-2 L + p ln N."""
        return -2 * float(self.value.sum()) + self.numbers * math.log(self.value.size)


def dead_zone(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """z beyond -p_1 and p_0, less the width."""
    above, below = z > p[0], z < -p[1]
    value = np.maximum(z - p[0], 0.0) + np.minimum(z + p[1], 0.0)
    return value, 1.0 * (above | below), np.column_stack([-1.0 * above, 1.0 * below])


def dead_zone_of(blur: float) -> Map:
    """The mean reading of a dead zone whose noise of that rms acts ahead of it."""

    def blurred(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
        a, b = (z - p[0]) / blur, (-p[1] - z) / blur
        above, below = ndtr(a), ndtr(b)
        at_a = np.exp(-0.5 * a**2) / math.sqrt(2 * math.pi)
        at_b = np.exp(-0.5 * b**2) / math.sqrt(2 * math.pi)
        value = blur * (at_a + a * above - at_b - b * below)
        return value, above + below, np.column_stack([-above, below])

    return blurred


def saturation(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """z limited to -p_1 and p_0."""
    above, below = z > p[0], z < -p[1]
    inside = ~(above | below)
    return np.clip(z, -p[1], p[0]), 1.0 * inside, np.column_stack([1.0 * above, -1.0 * below])


def absolute(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """|z - p_0| + p_1."""
    sign = np.sign(z - p[0])
    return np.abs(z - p[0]) + p[1], sign, np.column_stack([-sign, np.ones(z.size)])


def jump_of(blur: float) -> Map:
    """z beyond -p_1 and p_0, else 0; its corners blurred by noise of that rms ahead of it."""

    def jump(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
        a, b = (z - p[0]) / blur, (-p[1] - z) / blur
        share = ndtr(a) + ndtr(b)
        at_a = np.exp(-0.5 * a**2) / (blur * math.sqrt(2 * math.pi))
        at_b = np.exp(-0.5 * b**2) / (blur * math.sqrt(2 * math.pi))
        slopes = np.column_stack([-z * at_a, -z * at_b])
        return z * share, share + z * (at_a - at_b), slopes

    return jump


def identity(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """z itself."""
    return z, np.ones(z.size), np.zeros((z.size, 2))


def play(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Play of gaps p_0, p_1: the output is dragged along; dg/dz is the side where it moves."""
    right, left = float(p[0]), max(float(p[1]), -float(p[0]))
    value, moves = np.empty(z.size), np.zeros(z.size)
    now = float(np.clip(0.0, z[0] - right, z[0] + left))
    for k, position in enumerate(z.tolist()):
        if now > position + left:
            now, moves[k] = position + left, -1.0
        elif now < position - right:
            now, moves[k] = position - right, 1.0
        value[k] = now
    return value, moves, np.zeros((z.size, 2))


class MapFit:
    """Least squares of y on g(z; p), plant and map together.

    Args:
        simulator: the plant.
        shape: the map.
        free: how many of the map's two numbers are free.
        use: samples that count (N).
    """

    def __init__(self, simulator: Simulator, shape: Map, free: int, use: Flags) -> None:
        self.simulator = simulator
        self.shape = shape
        self.use = use
        self.size = simulator.layout.right  # a, b, x0; then the map's two numbers
        self.free = np.arange(self.size + free)
        rms = float(np.sqrt(np.mean(simulator.data.y[simulator.data.ok] ** 2)))
        self.x0_weight = 1 / (3 * rms) ** 2

    def split(self, theta: Floats) -> tuple[Floats, Floats]:
        """Numbers of the plant, laid out as `Layout` says, and of the map."""
        plant = np.append(theta[: self.size], np.zeros(4))
        return plant, theta[self.size :]

    def residual(self, theta: Floats) -> Floats:
        """y - g(z) (N); 0 where a reading is missing."""
        plant, p = self.split(theta)
        value, _, _ = self.shape(self.simulator.z(plant), p)
        return (self.simulator.data.y - value) * self.simulator.data.ok

    def value(self, theta: Floats) -> float:
        """Minus N / 2 ln of the mean square of the residual."""
        plant, _ = self.split(theta)
        if not self.simulator.admissible(plant):
            return -math.inf
        e = self.residual(theta)[self.use]
        square = float(e @ e)
        if not square < FAR:
            return -math.inf
        return -0.5 * e.size * math.log(square / e.size + 1e-30)

    def quadratic(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """(value, score, Gauss-Newton Hessian) of the free numbers."""
        plant, p = self.split(theta)
        z = self.simulator.z(plant)
        slope = self.simulator.gradient(plant, z)[:, : self.size]
        value, by_z, by_p = self.shape(z, p)
        if self.shape is play:
            rows = self._dragged(slope, by_z)
        else:
            rows = np.hstack([by_z[:, None] * slope, by_p])
        rows = rows[self.use][:, self.free]
        e = (self.simulator.data.y - value)[self.use]
        variance = float(e @ e) / e.size + 1e-30
        hessian = rows.T @ rows / variance + 1e-9 * np.eye(self.free.size)
        return self.value(theta), rows.T @ e / variance, hessian

    def _dragged(self, slope: Floats, moves: Floats) -> Floats:
        """d(play)/dtheta: that of z - p_0 or z + p_1, by where it last moved."""
        last = np.maximum.accumulate(np.where(moves != 0, np.arange(moves.size), -1))
        known = last >= 0
        at = np.maximum(last, 0)
        rows = np.zeros((moves.size, self.size + 2))
        rows[:, : self.size] = slope[at] * known[:, None]
        rows[:, self.size] = -1.0 * (moves[at] > 0) * known
        rows[:, self.size + 1] = 1.0 * (moves[at] < 0) * known
        return rows


def first_order_density(
    name: str, residual: Floats, numbers: int, extra: tuple[float, ...]
) -> Density:
    """The density of residuals taken as first-order Gaussian noise, rms and correlation fitted."""
    rho = float(residual[1:] @ residual[:-1] / (residual[:-1] @ residual[:-1] + 1e-30))
    rho = float(np.clip(rho, -0.95, 0.995))
    innovation = residual.copy()
    innovation[1:] -= rho * residual[:-1]
    innovation[0] *= math.sqrt(1 - rho**2)
    variance = float(np.mean(innovation**2)) + 1e-12
    value = -0.5 * innovation**2 / variance - 0.5 * math.log(2 * math.pi * variance)
    return Density(name, value, numbers + 2, float(np.sqrt(np.mean(residual**2))), extra)


def compare_statistic(first: Density, second: Density) -> float:
    """Vuong's statistic of one model against another, penalised by BIC; above 2: the first wins."""
    gap = first.value - second.value
    penalty = 0.5 * (first.numbers - second.numbers) * math.log(gap.size)
    total = float(gap.sum()) - penalty
    covariance, _ = long_run_covariance(gap[:, None])
    return total / math.sqrt(max(float(covariance[0, 0]), 1e-9))


def static_rivals(fit: Fit) -> dict[str, Density]:
    """The dead zone and its static rivals, each fitted by least squares.

    Args:
        fit: plant and zone of the record, where the rivals start.

    Returns:
        Densities by name: dead_zone, none, saturation, absolute, jump, play.
    """
    simulator = fit.objective.simulator
    linear = fit_linear(simulator, fit.objective.readings.ok)
    width = max(0.5 * (fit.right + fit.left), 0.05)
    spread = float(fit.z.std())
    blurs = [max(part * fit.s, 0.02) for part in (1.0, 0.3, 0.1)]
    if fit.objective.kind == "behind":
        blurs = [0.03]
    high, low = (float(np.quantile(simulator.data.y, q)) for q in (0.95, 0.05))
    own = np.array([max(fit.right, 0.0), max(fit.left, 0.0)])
    shapes: dict[str, tuple[Map, int, list[tuple[Fit, float, Floats]]]] = {
        "none": (identity, 0, [(linear, 1.0, np.zeros(2))]),
        "dead_zone": (dead_zone, 2, [(fit, 1.0, own)]),
        "saturation": (
            saturation,
            2,
            [(linear, gain, np.array([max(high, 0.05), max(-low, 0.05)])) for gain in (1.2, 2.0)],
        ),
        "absolute": (
            absolute,
            2,
            [(linear, 3.0, np.array([0.0, 0.0])), (fit, 1.0, np.array([-spread / 5, 0.0]))],
        ),
        "play": (play, 2, [(linear, 1.1, np.array([w, w])) for w in (0.15, 0.5, 1.0)]),
    }
    ok = simulator.data.ok
    rivals = {}
    for name, (shape, free, begun) in shapes.items():
        rivals[name] = _fitted(name, MapFit(simulator, shape, free, ok), begun)
    jumps = [(linear, 1.0, own), (linear, 1.1, np.full(2, width)), (fit, 0.8, own)]
    for blur in blurs:
        rounded = _fitted("jump", MapFit(simulator, jump_of(blur), 2, ok), jumps)
        _keep_better(rivals, rounded)
        if fit.objective.kind != "behind":
            zone = MapFit(simulator, dead_zone_of(blur), 2, ok)
            _keep_better(rivals, _fitted("dead_zone", zone, [(fit, 1.0, own)]))
    return rivals


def _keep_better(rivals: dict[str, Density], density: Density) -> None:
    """Enter a density where it is the first or the better of its name, by BIC."""
    name = density.name
    if name not in rivals or density.bic < rivals[name].bic:
        rivals[name] = density


def _fitted(name: str, model: MapFit, begun: list[tuple[Fit, float, Floats]]) -> Density:
    """The best of the climbs from several starts: a plant, its gain's factor, the map's numbers."""
    tops = []
    for plant, gain, p in begun:
        theta = np.append(plant.theta[: model.size], p)
        theta[model.simulator.layout.b] *= gain
        if not math.isfinite(model.value(theta)):
            continue
        kept = model.simulator.data.climbs
        tops.append(climb(model.value, model.quadratic, theta, model.free, 40, kept=kept))
    if not tops:
        return Density(name, np.full(model.use.size, -1e3), model.free.size, math.inf, ())
    best = max(tops, key=lambda top: top.value)
    e = model.residual(best.theta)
    extra = tuple(float(number) for number in best.theta[model.size : model.free.size])
    density = first_order_density(name, e, model.free.size, extra)
    numbers, _ = model.split(best.theta)
    share, chance = curve_over(model.simulator.z(numbers)[model.use], e[model.use])
    return density._replace(strange=is_strange(share, chance))


def better_rivals(first: dict[str, Density], second: dict[str, Density]) -> dict[str, Density]:
    """The better of each model at two orders, by BIC."""
    best = {}
    for name, density in first.items():
        other = second[name]
        best[name] = other if other.bic < density.bic else density
    return best
