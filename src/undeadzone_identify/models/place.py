"""Models of where a zone may be: sensor, friction in the plant, input, or two of them (F).

With friction the plant's recursion holds a dead zone of its own:
w_t = - a_1 z_(t-1) - ... + b_1 u_(t-1) + ... - c_1 f_(t-1) - ... - c_n f_(t-n),
z_t = Dz(w_t), f_t = w_t - z_t. With c = a this is exactly a zone of the sensor; with c_n = 0 it is
friction at a measured velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import lanes
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.elements import MapModel, linear, shift_beyond
from undeadzone_identify.models.estimates import (
    around,
    best_top,
    differences,
    latest,
    run_along,
    weighing,
)
from undeadzone_identify.models.least_squares import Fitted, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone
from undeadzone_identify.models.plant import Data, Simulator
from undeadzone_identify.models.zone import Kind, Objective
from undeadzone_identify.models.zone_fit import Fit, fit_linear, longest_record, refit

WIDTH = 32
RUN_AWAY = 1e6  # a z beyond it goes no further
STEP = 1e-5  # of a number, for differences
# Places among the numbers of the element; c_1 to c_n stand behind them.
PARTS = {"sensor": slice(0, 2), "inner": slice(2, 4), "sigma": slice(4, 5), "input": slice(5, 7)}
WIDTHS = 7  # how many numbers these are

# --- One sample


def _zone(x: Any, right: Any, left: Any) -> Any:
    """Return dz(x) on CasADi expressions."""
    return ca.fmax(x - right, 0.0) + ca.fmin(x + left, 0.0)


@cache
def kernel(n: int, m: int, position: bool) -> lanes.Kernel:
    """Return the compiled step.

    Args:
        n: order of the plant.
        m: inputs.
        position: whether z is a position, which sticks where it is, and not a velocity.

    Returns:
        A kernel whose state is (z, f, each of the last n samples, and whether it stuck), whose
        inputs are the lagged inputs (m n) and unit pulses at the first n samples, whose lanes
        differ in (a, b, x0, c, phi_r, phi_l, sigma, zone of the input right and left), and whose
        output is z.
    """
    state = ca.SX.sym("s", 2 * n + 1)
    exogenous = ca.SX.sym("w", m * n + n)
    numbers = ca.SX.sym("p", 3 * n + m * n + 5)
    a, b = numbers[:n], numbers[n : n + m * n]
    x0, c = numbers[n + m * n : 2 * n + m * n], numbers[2 * n + m * n : 3 * n + m * n]
    right, left, sigma, u_right, u_left = ca.vertsplit(numbers[3 * n + m * n :])
    past = ca.vertsplit(state)
    z_past, f_past, moved = past[:n], past[n : 2 * n], past[2 * n]
    u = _zone(exogenous[: m * n], u_right, u_left)
    w = ca.dot(b, u) + ca.dot(x0, exogenous[m * n :])
    w = w - ca.dot(a, ca.vertcat(*z_past)) - ca.dot(c, ca.vertcat(*f_past))
    w = ca.fmax(ca.fmin(w, RUN_AWAY), -RUN_AWAY)
    rest = z_past[0] if position else 0.0
    push = w - rest
    held = 1 + sigma * (moved == 0)
    slides = ca.logic_or(push > right * held, push < -left * held)
    move = ca.if_else(slides, _zone(push, right, left), 0.0)
    z = rest + move
    following = ca.vertcat(z, *z_past[: n - 1], push - move, *f_past[: n - 1], move)
    step = ca.Function("friction", [state, exogenous, numbers], [following, z])
    return lanes.build_kernel(step, params=list(range(numbers.shape[0])), width=WIDTH, fused=True)


def simulate(n: int, m: int, position: bool, exogenous: Floats, numbers: Floats) -> Floats:
    """Return z of a record for several sets of numbers.

    Args:
        n, m, position: as for `kernel`.
        exogenous: lagged inputs and pulses (N x (m n + n)).
        numbers: one row a set (K x (3 n + m n + 5)).

    Returns:
        z (K x N).
    """
    return run_along(kernel(n, m, position), exogenous, numbers)[0][:, :, 0]


# --- The models


class Shape(NamedTuple):
    """Which parts a model has.

    Attributes:
        name: of the model.
        word: the verdict's for what is there.
        sensor: a zone of the sensor, d_r and d_l.
        inner: friction in the recursion, phi_r and phi_l.
        input: a zone of the input.
        position: friction at a measured position.
        sticks: breakaway above sliding friction, sigma.
        free: how many of c_1 to c_n are free numbers; the others follow from b (collocated), or
            are 0.
    """

    name: str
    word: str
    sensor: bool = False
    inner: bool = False
    input: bool = False
    position: bool = False
    sticks: bool = False
    free: int = 0

    def holds(self, other: Shape) -> bool:
        """Return whether another model is this one with some of its numbers 0."""
        if other.inner and other.position != self.position:
            return False
        return all(mine >= theirs for mine, theirs in zip(self[2:], other[2:], strict=True))


class PlaceModel:
    """y on a plant with a zone somewhere, by a compiled recursion and differences.

    theta = [a, b, x0, d_r, d_l, phi_r, phi_l, sigma, u_r, u_l, c_1 ... c_n]; what a shape lacks
    stays 0.

    Args:
        simulator: the plant, with one record.
        shape: the parts of the model.
    """

    first, last, gain, has_level = 12, 40, 1e-3, True

    def __init__(self, simulator: Simulator, shape: Shape) -> None:
        self.name = shape.name
        self.simulator = simulator
        self.shape = shape
        self.n, self.m = simulator.layout.n, simulator.layout.m
        self.base = simulator.layout.right
        self.size = self.base + WIDTHS + self.n
        widths = [shape.sensor] * 2 + [shape.inner] * 2 + [shape.sticks] + [shape.input] * 2
        fitted = np.append(widths, np.arange(self.n) < shape.free)
        self.free: Integers = np.flatnonzero(np.append(np.ones(self.base, bool), fitted))
        pulses = np.eye(simulator.data.y.size, self.n)
        self.exogenous = np.hstack([simulator.lagged, pulses])

    def along(self, data: Data) -> PlaceModel:
        """Return the same model of other records."""
        return PlaceModel(self.simulator.along(data), self.shape)

    def part(self, theta: Floats, name: str) -> Floats:
        """Return the numbers of a part, of one set or of several: sensor, inner, sigma, input; a
        view.
        """
        return theta[..., self.base :][..., PARTS[name]]

    def project(self, theta: Floats) -> Floats:
        """Return widths and sigma brought back to 0 or above."""
        widths = slice(self.base, self.base + WIDTHS)
        theta[widths] = np.maximum(theta[widths], 0.0)
        return theta

    def c(self, theta: Floats) -> Floats:
        """Return c_1 to c_n: free ones, or those of friction where the input acts, or of one pole.

        Of one set of numbers, or of several (K x n).
        """
        c, free = np.zeros((*theta.shape[:-1], self.n)), self.shape.free
        if free and self.shape.inner:
            c[..., :free] = theta[..., self.base + WIDTHS :][..., :free]
        elif self.shape.inner:
            first = theta[..., self.n : self.n + 1]
            size = np.copysign(np.maximum(np.abs(first), 1e-9), first)
            c[..., : self.n - 1] = theta[..., self.n + 1 : 2 * self.n] / size
        return c

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""
        return self._simulate_neighbours(theta)[0]

    def readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the reading that z makes, of one set or of several: through the sensor's zone if
        any.
        """
        return dead_zone(z, *self.part(theta, "sensor").T[..., None])

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free numbers (N x free)."""
        steps = self._steps(theta)
        read = self.readings(self._simulate_neighbours(theta), around(theta, self.free, steps))
        return read[0], differences(read[1:], steps).T

    @latest
    def _simulate_neighbours(self, theta: Floats) -> Floats:
        """Return z of the numbers, and of those around them ((1 + 2 free) x N)."""
        points = around(theta, self.free, self._steps(theta))
        plant, tail = points[:, : self.base], points[:, self.base + 2 : self.base + WIDTHS]
        rows = np.hstack([plant, self.c(points), tail])
        return simulate(self.n, self.m, self.shape.position, self.exogenous, rows)

    def _steps(self, theta: Floats) -> Floats:
        """By how much each free number is moved."""
        return STEP * np.maximum(np.abs(theta[self.free]), 0.02)


PlaceFit = Fitted[PlaceModel]


def fit_place(simulator: Simulator, shape: Shape, begun: list[Floats]) -> PlaceFit | None:
    """Return the best of the climbs from several starts, all for 12 steps and the best two to the
    end.
    """
    return LeastSquares(PlaceModel(simulator, shape)).best(begun)


# --- Where climbs begin


def numbers_of(plant: Floats, n: int, c: Floats | None = None, **parts: Floats) -> Floats:
    """Return numbers of a model from those of a plant and of parts; what is not named is 0.

    Args:
        plant: a, b, x0.
        n: order.
        c: c_1, c_2, ...
        parts: sensor, inner, sigma, input.
    """
    element = np.zeros(WIDTHS + n)
    for name, value in parts.items():
        element[PARTS[name]] = value
    if c is not None:
        element[WIDTHS : WIDTHS + c.size] = c
    return np.append(plant, element)


class PlaceStarts:
    """Where the climbs of the models begin.

    Args:
        fit: plant and sensor zone of one record.
    """

    def __init__(self, fit: Fit) -> None:
        self.simulator = fit.objective.simulator
        self.n = self.simulator.layout.n
        base = self.simulator.layout.right
        self.plant = fit.theta[:base]
        self.plain = fit_linear(self.simulator, fit.objective.readings.ok).theta[:base]
        self.widths = np.clip([fit.right, fit.left], 0.02, 5.0)
        gain = abs(float(self.simulator.gain(fit.theta)[0]))
        usual = float(np.sqrt(np.mean(fit.z**2)))
        self.gain = gain if gain > 0.1 * usual else max(usual, 1e-3)

    def none(self) -> list[Floats]:
        """Return a plant without a zone."""
        return [numbers_of(plant, self.n) for plant in (self.plain, self.plant)]

    def at_sensor(self) -> list[Floats]:
        """Return the zone at the sensor."""
        return [numbers_of(self.plant, self.n, sensor=self.widths)]

    def levels(self) -> list[tuple[Floats, Floats]]:
        """Return plants and levels in units of the input to begin with."""
        widths = self.widths / self.gain
        sizes: list[Floats] = [np.clip(part * widths, 0.02, 1.5) for part in (1.0, 0.4)]
        begun = [(self.plant, size) for size in sizes]
        for level in (0.3, 0.8):
            plant = self.plain.copy()
            plant[self.simulator.layout.b] *= 1 + 0.5 * level
            begun.append((plant, np.full(2, level)))
        return begun

    def at_input(self) -> list[Floats]:
        """Return zones of the input."""
        return [numbers_of(plant, self.n, input=level) for plant, level in self.levels()]

    def friction(self) -> list[Floats]:
        """Return friction where the input acts: c = b / b_1."""
        begun = []
        for plant, level in self.levels():
            moved, n = plant.copy(), self.n
            if moved[n] <= 1e-3:
                moved[n] = 0.05 * np.abs(plant[n : 2 * n]).max() + 1e-3
            begun.append(numbers_of(moved, n, inner=level * moved[n]))
        return begun

    def free(self, fits: dict[str, PlaceFit]) -> list[Floats]:
        """Return friction elsewhere: c of the input's, or the product over all poles but one."""
        begun = []
        for name in ("friction", "sensor"):
            if name not in fits:
                continue
            model, theta = fits[name].model, fits[name].theta
            a, b = theta[: self.n], theta[self.n : 2 * self.n]
            static = b.sum() / (1 + a.sum())
            if name == "friction":
                level = model.part(theta, "inner") / max(abs(b[0]), 1e-9)
            else:
                level = model.part(theta, "sensor") / max(abs(static), 1e-6)
            for c in self._shapes(a, b):
                total = c.sum()
                force = abs(b.sum() / total) if abs(total) > 1e-6 else abs(b[0])
                inner = np.maximum(force * level, 1e-4)
                begun.append(numbers_of(theta[: model.base], self.n, c[1:], inner=inner))
        return begun

    def _shapes(self, a: Floats, b: Floats) -> list[Floats]:
        """Return candidates of (1, c_1, ... c_(n-1))."""
        shapes = [b / b[0]] if abs(b[0]) > 1e-6 else []
        poles = np.roots(np.append(1.0, a))
        real = np.abs(poles.imag) < 1e-9
        shapes += [np.real(np.poly(np.delete(poles, i))) for i in np.flatnonzero(real)]
        if not real.all() or self.n == 3:
            shapes.append(np.eye(1, self.n)[0])
        return shapes

    def sticking(self, fitted: PlaceFit) -> list[Floats]:
        """Return the same with breakaway above sliding friction."""
        begun = []
        for sigma in (0.2, 0.02):
            theta = fitted.theta.copy()
            fitted.model.part(theta, "sigma")[:] = sigma
            begun.append(theta)
        return begun

    def with_sensor(self, fitted: PlaceFit) -> list[Floats]:
        """Return the same with a zone of the sensor beside it, of several sizes."""
        begun = []
        for part, rest in ((0.3, 0.7), (0.8, 0.3), (0.15, 1.0)):
            theta = fitted.theta.copy()
            element = theta[fitted.model.base :]
            element[:WIDTHS] *= rest
            element[PARTS["sensor"]] = np.maximum(part * self.widths, 0.05)
            begun.append(theta)
        return begun


# --- A zone of the input, and perhaps one of the sensor, measured

LOUDER = ((1.8, 1.0), (1.4, 0.5), (2.5, 1.3))  # gain of a linear fit, and widths, to begin with
ZonedTarget = Objective | LeastSquares[MapModel]


class Zoned(NamedTuple):
    """A plant behind a zone of its input, and perhaps ahead of one of the sensor.

    Attributes:
        fit: by least squares, to simulate it.
        stages: what was maximised and its numbers: simulation errors, or the likelihood of single
            samples; then prediction errors, or the likelihood of pairs where noise falls silent.
    """

    fit: Fitted[MapModel]
    stages: Sequence[tuple[ZonedTarget, Floats]]

    def width(self, *weights: float) -> tuple[float, float, float]:
        """Return a sum of the input's and the sensor's widths, half its interval, degrees of
        freedom.

        The half is the widest of the stages', and by how much these differ is added to it.
        """
        first, values, halves = self.fit.model.simulator.layout.input.start, [], []
        for target, theta in self.stages:
            row = weighing(target.free, theta.size, first, weights)
            halves.append(target.spread(theta).half_and_degrees(row))
            values.append(float(np.dot(weights, theta[first : first + len(weights)])))
        half, degrees = max(halves)
        return values[-1], math.hypot(half, values[-1] - values[0]), degrees


def fit_at_input(fits: Sequence[Fit]) -> Zoned | None:
    """Return the plant of least BIC behind a zone of the input; None where none fits.

    Args:
        fits: of every order, with a zone of the sensor, where climbs start.
    """
    tops = []
    for one in fits:
        starts = PlaceStarts(longest_record(one))
        simulator = Simulator(starts.simulator.data, starts.n, zoned=True)
        squares = LeastSquares(MapModel(simulator, "input_zone", linear))
        tops.append(squares.best([np.append(*begun) for begun in starts.levels()]))
    best = min(filter(None, tops), key=lambda one: one.bic, default=None)
    if best is None:
        return None
    last = best.squares.fit_predictions(best.theta)
    return Zoned(best._replace(theta=last[1]), [(best.squares, best.theta), last])


def fit_both_ends(fits: Sequence[Fit], known: PlaceFit) -> Zoned | None:
    """Return the plant of least BIC between zones of input and sensor; None where none fits.

    Args:
        fits: of every order, with a zone of the sensor.
        known: both zones behind a plant of one order, by least squares.
    """
    ends = []
    for one in fits:
        old = one.objective
        simulator = Simulator(old.data, old.layout.n, zoned=True)
        kind: Kind = "behind" if old.kind == "behind" else "singles"
        objective = Objective(simulator, kind, old.limits)
        top = best_top(objective, _between(fit_linear(old.simulator), objective, known), 10, 60)
        if top is not None:
            ends.append(Fit(objective, *top))
    if not ends:
        return None
    best = min(ends, key=lambda one: one.bic)
    squares = LeastSquares(MapModel(best.objective.simulator, "two_zones", shift_beyond))
    last: tuple[ZonedTarget, Floats] = squares.fit_predictions(best.theta[: squares.model.base + 2])
    if best.objective.kind != "behind":
        pairs = refit(best, "pairs")
        best = refit(pairs, "singles")  # once more: kinks of the edges stop a climb early
        last = pairs.objective, pairs.theta
    theta = last[1][: squares.model.base + 2]
    fit = Fitted(squares, theta, squares.density(theta))
    return Zoned(fit, [(best.objective, best.theta), last])


def _between(plain: Fit, objective: Objective, known: PlaceFit) -> list[Floats]:
    """Where climbs begin: a louder linear plant between zones of several sizes."""
    layout, begun = objective.layout, list[Floats]()
    for gain, size in LOUDER:
        theta = np.zeros(layout.size)
        theta[layout.a], theta[layout.b] = plain.theta[layout.a], gain * plain.theta[layout.b]
        theta[layout.input] = size * known.model.part(known.theta, "input")
        sensor = size * known.model.part(known.theta, "sensor")
        theta[layout.right : layout.right + 3] = *sensor, math.log(max(known.density.rms, 1e-3))
        begun.append(theta)
    return begun
