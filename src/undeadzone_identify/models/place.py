"""Models of the location of a zone: sensor, friction in the plant, input, or two of these (F).

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
from undeadzone_identify.models.elements import MapModel, dead_zone_map, identity_map
from undeadzone_identify.models.estimates import (
    best_maximum,
    cache_latest,
    central_differences,
    perturb_each,
    run_lanes_along,
)
from undeadzone_identify.models.least_squares import FittedModel, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.models.zone import Kind, ZoneObjective
from undeadzone_identify.models.zone_fit import (
    ZoneFit,
    fit_linear,
    refit_likelihood,
    refit_longest_record,
)

WIDTH = 32
RUN_AWAY = 1e6  # a z beyond it goes no further
STEP = 1e-5  # of a number, for differences
# Places among the numbers of the element; c_1 to c_n stand behind them.
PARTS = {"sensor": slice(0, 2), "inner": slice(2, 4), "sigma": slice(4, 5), "input": slice(5, 7)}
WIDTHS = 7  # how many numbers these are

# --- One sample


def _zone_expression(x: Any, right: Any, left: Any) -> Any:
    """Return Dz(x) on CasADi expressions."""
    return ca.fmax(x - right, 0.0) + ca.fmin(x + left, 0.0)


@cache
def build_friction_kernel(n: int, m: int, position: bool) -> lanes.Kernel:
    """Build the compiled step of the plant with friction.

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
    u = _zone_expression(exogenous[: m * n], u_right, u_left)
    w = ca.dot(b, u) + ca.dot(x0, exogenous[m * n :])
    w = w - ca.dot(a, ca.vertcat(*z_past)) - ca.dot(c, ca.vertcat(*f_past))
    w = ca.fmax(ca.fmin(w, RUN_AWAY), -RUN_AWAY)
    rest = z_past[0] if position else 0.0
    push = w - rest
    held = 1 + sigma * (moved == 0)
    slides = ca.logic_or(push > right * held, push < -left * held)
    move = ca.if_else(slides, _zone_expression(push, right, left), 0.0)
    z = rest + move
    following = ca.vertcat(z, *z_past[: n - 1], push - move, *f_past[: n - 1], move)
    step = ca.Function("friction", [state, exogenous, numbers], [following, z])
    return lanes.build_kernel(step, params=list(range(numbers.shape[0])), width=WIDTH, fused=True)


def simulate_friction(n: int, m: int, position: bool, exogenous: Floats, numbers: Floats) -> Floats:
    """Simulate z of a record for several parameter sets.

    Args:
        n, m, position: as for `kernel`.
        exogenous: lagged inputs and pulses (N x (m n + n)).
        numbers: one row a set (K x (3 n + m n + 5)).

    Returns:
        z (K x N).
    """
    return run_lanes_along(build_friction_kernel(n, m, position), exogenous, numbers)[0][:, :, 0]


# --- The models


class PlaceShape(NamedTuple):
    """Parts of a model.

    Attributes:
        name: of the model.
        word: the verdict's.
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

    def contains_shape(self, other: PlaceShape) -> bool:
        """Return whether a smaller model is this model with some of its parameters 0."""
        if other.inner and other.position != self.position:
            return False
        return all(mine >= theirs for mine, theirs in zip(self[2:], other[2:], strict=True))


class PlaceModel:
    """Plant with a zone at some location, by a compiled recursion and differences.

    theta = [a, b, x0, d_r, d_l, phi_r, phi_l, sigma, u_r, u_l, c_1 ... c_n]; what a shape lacks
    stays 0.

    Args:
        simulator: the plant, with its records.
        shape: the parts of the model.
    """

    first, last, gain, has_level = 12, 40, 1e-3, True

    def __init__(self, simulator: PlantSimulator, shape: PlaceShape) -> None:
        self.name = shape.name
        self.simulator = simulator
        self.shape = shape
        self.n, self.m = simulator.layout.n, simulator.layout.m
        self.base = simulator.layout.right
        self.size = self.base + WIDTHS + self.n
        widths = [shape.sensor] * 2 + [shape.inner] * 2 + [shape.sticks] + [shape.input] * 2
        fitted = np.append(widths, np.arange(self.n) < shape.free)
        self.free: Integers = np.flatnonzero(np.append(np.ones(self.base, bool), fitted))
        pulses = [np.eye(part.stop - part.start, self.n) for part in simulator.records]
        self.exogenous = np.hstack([simulator.lagged, np.vstack(pulses)])

    def along(self, data: RecordData) -> PlaceModel:
        """Return the same model for other records."""
        return PlaceModel(self.simulator.simulator_along(data), self.shape)

    def part_numbers(self, theta: Floats, name: str) -> Floats:
        """Return a view of a part's parameters, of a single set or several: sensor, inner,
        sigma, input.
        """
        return theta[..., self.base :][..., PARTS[name]]

    def levels(self, theta: Floats) -> Floats:
        """Return the sensor's widths; without, those of the input's zone or of friction (2)."""
        if self.shape.inner and not self.shape.sensor:
            return self.friction_levels(theta)
        return self.part_numbers(theta, "sensor" if self.shape.sensor else "input")

    def friction_levels(self, theta: Floats) -> Floats:
        """Return friction right and left, in rms of the input (2)."""
        force = abs(theta[self.n : 2 * self.n].sum())
        held = max(abs(1 + self.friction_coefficients(theta).sum()), 1e-9)
        return np.asarray(self.part_numbers(theta, "inner") * held / max(force, 1e-9))

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict widths and sigma to 0 or above."""
        widths = slice(self.base, self.base + WIDTHS)
        theta[widths] = np.maximum(theta[widths], 0.0)
        return theta

    def friction_coefficients(self, theta: Floats) -> Floats:
        """Return c_1 to c_n: free, or those of friction at the input, or of a single pole.

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
        return self._simulate_around(theta)[0]

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z, of a single set or several, through the sensor's zone
        if present.
        """
        return dead_zone(z, *self.part_numbers(theta, "sensor").T[..., None])

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free parameters (N x
        free).
        """
        steps = self._perturbation_steps(theta)
        read = self.noise_free_readings(
            self._simulate_around(theta), perturb_each(theta, self.free, steps)
        )
        return read[0], central_differences(read[1:], steps).T

    @cache_latest
    def _simulate_around(self, theta: Floats) -> Floats:
        """Simulate z for theta and for the perturbed parameters ((1 + 2 free) x N)."""
        points = perturb_each(theta, self.free, self._perturbation_steps(theta))
        layout, tail = self.simulator.layout, points[:, self.base + 2 : self.base + WIDTHS]
        plant, starts = points[:, : layout.numerators.stop], points[:, layout.x0]
        tail = np.hstack([self.friction_coefficients(points), tail])
        z = []
        for k, part in enumerate(self.simulator.records):
            rows = np.hstack([plant, starts[:, k * self.n :][:, : self.n], tail])
            own = self.n, self.m, self.shape.position, self.exogenous[part], rows
            z.append(simulate_friction(*own))
        return np.hstack(z)

    def _perturbation_steps(self, theta: Floats) -> Floats:
        """Return the perturbation of each free parameter (free)."""
        return STEP * np.maximum(np.abs(theta[self.free]), 0.02)


PlaceFit = FittedModel[PlaceModel]


def fit_place(simulator: PlantSimulator, shape: PlaceShape, begun: list[Floats]) -> PlaceFit | None:
    """Fit a model from several starts, each for 12 steps, the best two to the end."""
    return LeastSquares(PlaceModel(simulator, shape)).fit_from_starts(begun)


# --- Where climbs begin


def join_place_numbers(plant: Floats, n: int, c: Floats | None = None, **parts: Floats) -> Floats:
    """Join parameters of a plant and of parts to those of a model; missing parts are 0.

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
    """Start points for the fits of the models.

    Args:
        fit: plant and sensor zone of one record.
    """

    def __init__(self, fit: ZoneFit) -> None:
        self.simulator = fit.objective.simulator
        self.n = self.simulator.layout.n
        base = self.simulator.layout.right
        self.plant = fit.theta[:base]
        self.plain = fit_linear(self.simulator, fit.objective.readings.ok).theta[:base]
        self.widths = np.clip([fit.right, fit.left], 0.02, 5.0)
        gain = abs(float(self.simulator.dc_gain(fit.theta)[0]))
        usual = float(np.sqrt(np.mean(fit.z**2)))
        self.gain = gain if gain > 0.1 * usual else max(usual, 1e-3)

    def without_zone(self) -> list[Floats]:
        """Return the starts for a plant without a zone."""
        return [join_place_numbers(plant, self.n) for plant in (self.plain, self.plant)]

    def zone_at_sensor(self) -> list[Floats]:
        """Return the starts for a zone at the sensor."""
        return [join_place_numbers(self.plant, self.n, sensor=self.widths)]

    def input_levels(self) -> list[tuple[Floats, Floats]]:
        """Return start plants and levels in units of the input."""
        widths = self.widths / self.gain
        sizes: list[Floats] = [np.clip(part * widths, 0.02, 1.5) for part in (1.0, 0.4)]
        begun = [(self.plant, size) for size in sizes]
        for level in (0.3, 0.8):
            plant = self.plain.copy()
            plant[self.simulator.layout.numerators] *= 1 + 0.5 * level
            begun.append((plant, np.full(2, level)))
        return begun

    def zone_at_input(self) -> list[Floats]:
        """Return the starts for zones of the input."""
        return [
            join_place_numbers(plant, self.n, input=level) for plant, level in self.input_levels()
        ]

    def friction_at_input(self) -> list[Floats]:
        """Return the starts for friction at the input's location: c = b / b_1."""
        begun = []
        for plant, level in self.input_levels():
            moved, n = plant.copy(), self.n
            if moved[n] <= 1e-3:
                moved[n] = 0.05 * np.abs(plant[n : 2 * n]).max() + 1e-3
            begun.append(join_place_numbers(moved, n, inner=level * moved[n]))
        return begun

    def friction_elsewhere(self, fits: dict[str, PlaceFit]) -> list[Floats]:
        """Return the starts for friction elsewhere, by c = b / b_1 or the product of all
        poles but one.
        """
        begun = []
        for name in ("friction", "sensor"):
            if name not in fits:
                continue
            model, theta = fits[name].model, fits[name].theta
            a, b = theta[: self.n], theta[self.n : 2 * self.n]
            static = b.sum() / (1 + a.sum())
            if name == "friction":
                level = model.part_numbers(theta, "inner") / max(abs(b[0]), 1e-9)
            else:
                level = model.part_numbers(theta, "sensor") / max(abs(static), 1e-6)
            for c in self._friction_shapes(a, b):
                total = c.sum()
                force = abs(b.sum() / total) if abs(total) > 1e-6 else abs(b[0])
                inner = np.maximum(force * level, 1e-4)
                begun.append(join_place_numbers(theta[: model.base], self.n, c[1:], inner=inner))
        return begun

    def _friction_shapes(self, a: Floats, b: Floats) -> list[Floats]:
        """Return candidates of (1, c_1, ... c_(n-1))."""
        shapes = [b / b[0]] if abs(b[0]) > 1e-6 else []
        poles = np.roots(np.append(1.0, a))
        real = np.abs(poles.imag) < 1e-9
        shapes += [np.real(np.poly(np.delete(poles, i))) for i in np.flatnonzero(real)]
        if not real.all() or self.n == 3:
            shapes.append(np.eye(1, self.n)[0])
        return shapes

    def add_breakaway(self, fitted: PlaceFit) -> list[Floats]:
        """Add breakaway above sliding friction to a fit; return the starts."""
        begun = []
        for sigma in (0.2, 0.02):
            theta = fitted.theta.copy()
            fitted.model.part_numbers(theta, "sigma")[:] = sigma
            begun.append(theta)
        return begun

    def add_sensor_zone(self, fitted: PlaceFit) -> list[Floats]:
        """Add a zone of the sensor, of several sizes, to a fit; return the starts."""
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
ZonedTarget = ZoneObjective | LeastSquares[MapModel]


class InputZoneFit(NamedTuple):
    """Plant behind a zone of its input, and perhaps before a zone of the sensor.

    Attributes:
        fit: by least squares, to simulate it.
        stages: what was maximised and its numbers: simulation errors, or the likelihood of single
            samples; then prediction errors, or the likelihood of pairs where noise falls silent.
    """

    fit: FittedModel[MapModel]
    stages: Sequence[tuple[ZonedTarget, Floats]]


def fit_input_zone(fits: Sequence[ZoneFit]) -> InputZoneFit | None:
    """Fit plants behind a zone of the input; return that of least BIC, None without a fit.

    Args:
        fits: of every order, with a zone of the sensor, where climbs start.
    """
    tops = []
    for one in fits:
        starts = PlaceStarts(refit_longest_record(one))
        simulator = PlantSimulator(starts.simulator.data, starts.n, zoned=True)
        squares = LeastSquares(MapModel(simulator, "input_zone", identity_map))
        tops.append(squares.fit_from_starts([np.append(*begun) for begun in starts.input_levels()]))
    best = min(filter(None, tops), key=lambda one: one.bic, default=None)
    if best is None:
        return None
    last = best.squares.minimise_prediction_errors(best.theta)
    return InputZoneFit(best._replace(theta=last[1]), [(best.squares, best.theta), last])


def fit_input_and_sensor(fits: Sequence[ZoneFit], known: PlaceFit) -> InputZoneFit | None:
    """Fit plants between zones of input and sensor; return that of least BIC, None without a
    fit.

    Args:
        fits: of every order, with a zone of the sensor.
        known: both zones behind a plant of one order, by least squares.
    """
    ends = []
    for one in fits:
        old = one.objective
        simulator = PlantSimulator(old.data, old.layout.n, zoned=True)
        kind: Kind = "behind" if old.kind == "behind" else "singles"
        objective = ZoneObjective(simulator, kind, old.limits)
        top = best_maximum(
            objective, _starts_between_zones(fit_linear(old.simulator), objective, known), 10, 60
        )
        if top is not None:
            ends.append(ZoneFit(objective, *top))
    if not ends:
        return None
    best = min(ends, key=lambda one: one.bic)
    squares = LeastSquares(MapModel(best.objective.simulator, "two_zones", dead_zone_map))
    last: tuple[ZonedTarget, Floats] = squares.minimise_prediction_errors(
        best.theta[: squares.model.base + 2]
    )
    if best.objective.kind != "behind":
        pairs = refit_likelihood(best, "pairs")
        best = refit_likelihood(
            pairs, "singles"
        )  # once more: kinks of the edges stop a climb early
        last = pairs.objective, pairs.theta
    theta = last[1][: squares.model.base + 2]
    fit = FittedModel(squares, theta, squares.autoregressive_density(theta))
    return InputZoneFit(fit, [(best.objective, best.theta), last])


def _starts_between_zones(
    plain: ZoneFit, objective: ZoneObjective, known: PlaceFit
) -> list[Floats]:
    """Return start points (parameters each): a plant between zones of its input and its sensor.

    Both zones make the gain of a linear fit too small, so that it is raised.

    Args:
        plain: the linear plant.
        objective: whose parameters the starts have.
        known: an earlier fit with both zones, whose widths are scaled.
    """
    layout, begun = objective.layout, list[Floats]()
    for gain, size in LOUDER:
        theta = np.zeros(layout.parameter_count)
        theta[layout.denominator], theta[layout.numerators] = (
            plain.theta[layout.denominator],
            gain * plain.theta[layout.numerators],
        )
        theta[layout.input_widths] = size * known.model.part_numbers(known.theta, "input")
        sensor = size * known.model.part_numbers(known.theta, "sensor")
        # d_r, d_l, and the logarithm of the rms of the noise
        theta[layout.right : layout.right + 3] = *sensor, math.log(max(known.density.rms, 1e-3))
        begun.append(theta)
    return begun
