"""Models of the location of a zone: sensor, friction in the plant, input, or two of these (F).

With friction the plant's recursion holds a dead zone of its own:
w_t = - a_1 z_(t-1) - ... + b_1 u_(t-1) + ... - c_1 f_(t-1) - ... - c_n f_(t-n),
z_t = Dz(w_t), f_t = w_t - z_t. With c = a this is exactly a zone of the sensor; with c_n = 0 it is
friction at a measured velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import lanes
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.estimates import (
    cache_latest,
    central_differences,
    perturb_each,
    perturbation_steps,
    run_lanes_along,
)
from undeadzone_identify.models.least_squares import FittedModel, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone, root_mean_square
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.models.zone_fit import (
    ZoneFit,
    fit_linear,
)

WIDTH = 32
ADDED = (0.5, 0.8)  # poles that stand on a zero where a plant of the next order begins
RUN_AWAY = 1e6  # bound of z, which keeps an unstable trial finite
# Places of the element's parameters behind those of the plant; c_1 to c_n follow.
PARTS = {"sensor": slice(0, 2), "inner": slice(2, 4), "input": slice(4, 6)}
WIDTHS = 6  # number of these parameters

# --- One sample


def _zone_expression(x: Any, right: Any, left: Any) -> Any:
    """Return Dz(x) on CasADi expressions."""
    return ca.fmax(x - right, 0.0) + ca.fmin(x + left, 0.0)


@cache
def build_friction_kernel(n: int, m: int, position: bool) -> lanes.Kernel:
    """Build the compiled step of the plant with friction.

    Args:
        n: order of the plant.
        m: number of inputs.
        position: whether z is a position, which sticks at its last value, and not a velocity.

    Returns:
        A kernel with

        - state: z and f of the last n samples (2 n),
        - inputs: lagged inputs (m n), then unit pulses at the first n samples, which set x0 (n),
        - parameters of a lane: a, b, x0, c, phi_r, phi_l, and the zone of the input,
        - output: z.
    """
    z_past, f_past, inputs, pulses = map(ca.SX.sym, "zfuw", (n, n, m * n, n))
    a, b, x0, c, widths = parts = list(map(ca.SX.sym, "abxcd", (n, m * n, n, n, 4)))
    right, left, u_right, u_left = ca.vertsplit(widths)
    w = ca.dot(b, _zone_expression(inputs, u_right, u_left)) + ca.dot(x0, pulses)
    w = w - ca.dot(a, z_past) - ca.dot(c, f_past)
    w = ca.fmax(ca.fmin(w, RUN_AWAY), -RUN_AWAY)
    rest = z_past[0] if position else 0.0
    push = w - rest
    move = _zone_expression(push, right, left)
    z = rest + move
    signals = [ca.vertcat(z_past, f_past), ca.vertcat(inputs, pulses), ca.vertcat(*parts)]
    following = ca.vertcat(z, z_past[:-1], push - move, f_past[:-1])
    step = ca.Function("friction", signals, [following, z])
    return lanes.build_kernel(step, params=range(step.numel_in(2)), width=WIDTH, fused=True)


def simulate_friction(n: int, m: int, position: bool, exogenous: Floats, numbers: Floats) -> Floats:
    """Simulate z along a record for several parameter sets.

    Args:
        n, m, position: as for `build_friction_kernel`.
        exogenous: lagged inputs and pulses (N x (m n + n)).
        numbers: parameters of the lanes, a row per set (K x (3 n + m n + 4)).

    Returns:
        z (K x N).
    """
    return run_lanes_along(build_friction_kernel(n, m, position), exogenous, numbers)[0][:, :, 0]


# --- The models


class PlaceShape(NamedTuple):
    """Parts of a model.

    Attributes:
        name: name of the model.
        sensor: whether the sensor has a zone, d_r and d_l.
        inner: whether the recursion has friction, phi_r and phi_l.
        input: whether the input has a zone, u_r and u_l.
        position: whether friction acts on a measured position, else on a velocity.
        free: number of free parameters among c_1 to c_n. The others are 0, or follow from b if
            friction acts at the input (collocated).
    """

    name: str
    sensor: bool = False
    inner: bool = False
    input: bool = False
    position: bool = False
    free: int = 0

    def contains_shape(self, other: PlaceShape) -> bool:
        """Return whether a smaller model is this model with some of its parameters 0."""
        if other.inner and other.position != self.position:
            return False
        return all(mine >= theirs for mine, theirs in zip(self[1:], other[1:], strict=True))


class PlaceModel:
    """Plant with zones at some locations, with derivatives by central differences.

    theta = [a, b, x0, d_r, d_l, phi_r, phi_l, u_r, u_l, c_1 ... c_n]. The parameters of
    parts that the shape does not have are 0.

    Args:
        simulator: linear plant with its records.
        shape: parts of the model.
    """

    first = 12
    last = 40
    gain = 1e-3
    has_level = True

    def __init__(self, simulator: PlantSimulator, shape: PlaceShape) -> None:
        self.name = shape.name
        self.simulator = simulator
        self.shape = shape
        self.n = simulator.layout.n
        self.m = simulator.layout.m
        self.base = simulator.layout.right
        widths = np.repeat([shape.sensor, shape.inner, shape.input], 2)
        free = [np.ones(self.base, bool), widths, np.arange(self.n) < shape.free]
        self.free: Integers = np.flatnonzero(np.concatenate(free))
        pulses = [np.eye(part.stop - part.start, self.n) for part in simulator.records]
        self.exogenous = np.hstack([simulator.lagged, np.vstack(pulses)])

    def along(self, data: RecordData) -> PlaceModel:
        """Return the same model for other records."""
        return PlaceModel(self.simulator.simulator_along(data), self.shape)

    def part_numbers(self, theta: Floats, name: str) -> Floats:
        """Return a view of the parameters of a part.

        Args:
            theta: one parameter set (P), or several (K x P).
            name: sensor, inner or input.
        """
        return theta[..., self.base :][..., PARTS[name]]

    def levels(self, theta: Floats) -> Floats:
        """Return the right and left width of the zone that the model measures (2).

        It is the sensor's zone, else friction, else the input's zone.
        """
        if self.shape.inner and not self.shape.sensor:
            return self.friction_levels(theta)
        return self.part_numbers(theta, "sensor" if self.shape.sensor else "input")

    def friction_levels(self, theta: Floats) -> Floats:
        """Return the Coulomb friction to the right and left, in rms of the input (2).

        In steady state the recursion gives sum(b) u = (1 + sum(c)) phi at the limit of sticking.
        """
        input_gain = abs(theta[self.n : 2 * self.n].sum())
        friction_gain = max(abs(1 + self.friction_coefficients(theta).sum()), 1e-9)
        return self.part_numbers(theta, "inner") * friction_gain / max(input_gain, 1e-9)

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict the widths to 0 or above; theta is changed in place."""
        widths = slice(self.base, self.base + WIDTHS)
        theta[widths] = np.maximum(theta[widths], 0.0)
        return theta

    def friction_coefficients(self, theta: Floats) -> Floats:
        """Return c_1 to c_n, of one parameter set (n) or of several (K x n).

        They are free, or b_2 / b_1, b_3 / b_1, ... for friction at the input, or 0.
        """
        c = np.zeros((*theta.shape[:-1], self.n))
        free = self.shape.free
        if free and self.shape.inner:
            c[..., :free] = theta[..., self.base + WIDTHS :][..., :free]
        elif self.shape.inner:
            first = theta[..., self.n : self.n + 1]
            divisor = np.copysign(np.maximum(np.abs(first), 1e-9), first)  # b_1, but never 0
            c[..., : self.n - 1] = theta[..., self.n + 1 : 2 * self.n] / divisor
        return c

    def pass_input(self, u: Floats, theta: Floats) -> Floats:
        """Return the input u (N) after its dead zone (N)."""
        return dead_zone(u, *self.part_numbers(theta, "input"))

    def driven_plant(self, theta: Floats) -> PlantSimulator:
        """Return the linear plant driven by the input after its dead zone."""
        data = self.simulator.data
        return self.simulator.simulator_along(data._replace(u=self.pass_input(data.u, theta)))

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""
        return self._simulate_around(theta)[0]

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z without noise.

        Args:
            z: output of the plant for one parameter set (N), or for several (K x N).
            theta: the parameter set (P), or the sets (K x P).
        """
        return dead_zone(z, *self.part_numbers(theta, "sensor").T[..., None])

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free parameters (N x free)."""
        steps = perturbation_steps(theta[self.free])
        readings = self.noise_free_readings(
            self._simulate_around(theta), perturb_each(theta, self.free, steps)
        )
        return readings[0], central_differences(readings[1:], steps).T

    @cache_latest
    def _simulate_around(self, theta: Floats) -> Floats:
        """Simulate z for theta and for the perturbed parameters ((1 + 2 free) x N)."""
        points = perturb_each(theta, self.free, perturbation_steps(theta[self.free]))
        layout = self.simulator.layout
        tail = points[:, self.base + 2 : self.base + WIDTHS]
        tail = np.hstack([self.friction_coefficients(points), tail])
        starts = np.hsplit(points[:, layout.x0], layout.records)
        z = []
        for part, start in zip(self.simulator.records, starts, strict=True):
            rows = np.hstack([points[:, : layout.numerators.stop], start, tail])
            inputs = self.exogenous[part]
            z.append(simulate_friction(self.n, self.m, self.shape.position, inputs, rows))
        return np.hstack(z)


PlaceFit = FittedModel[PlaceModel]


def fit_place(
    simulator: PlantSimulator, shape: PlaceShape, starts: Sequence[Floats]
) -> PlaceFit | None:
    """Fit a model from several start points; return the best fit, None if none is admissible."""
    return LeastSquares(PlaceModel(simulator, shape)).fit_from_starts(starts)


def raise_order(fit: PlaceFit) -> PlaceFit | None:
    """Fit a model without friction with a plant of the next order; None if no fit is admissible.

    It begins at the same plant, with one more pole on a zero.

    Args:
        fit: of a plant of one input.
    """
    old = fit.model
    simulator = old.simulator
    following = PlantSimulator(simulator.data, old.n + 1, simulator.layout.integrators)
    a, b, *records = fit.theta[: old.base].reshape(-1, old.n)  # states at the start of each record
    starts = []
    for pole in ADDED:
        parts = [np.convolve(part, [1.0, -pole]) for part in (np.append(1.0, a), b, *records)]
        starts.append(np.hstack([*parts, fit.theta[old.base :], 0.0])[1:])
    return fit_place(following, old.shape, starts)


# --- Start points


def join_place_numbers(plant: Floats, n: int, c: Floats | None = None, **parts: Floats) -> Floats:
    """Join the parameters of a plant and of parts to theta of a `PlaceModel`.

    Args:
        plant: a, b, x0.
        n: order of the plant.
        c: c_1, c_2, ...; None: all are 0.
        parts: parameters of sensor, inner, input; those of missing parts are 0.
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
        fit: fit of a plant with a sensor zone to one record.

    Attributes:
        plant: a, b, x0 of that fit.
        linear_plant: a, b, x0 of a linear fit without a zone.
        widths: d_r and d_l of the fit, limited to useful start values (2).
        gain: DC gain of the plant, or its usual gain if the plant has hardly any DC gain.
    """

    def __init__(self, fit: ZoneFit) -> None:
        self.simulator = fit.objective.simulator
        self.n = self.simulator.layout.n
        base = self.simulator.layout.right
        self.plant = fit.theta[:base]
        self.linear_plant = fit_linear(self.simulator, fit.objective.readings.ok).theta[:base]
        self.widths = np.clip([fit.right, fit.left], 0.02, 5.0)
        gain = abs(float(self.simulator.dc_gain(fit.theta)[0]))
        usual_gain = root_mean_square(fit.z)  # the input is scaled to rms 1
        self.gain = gain if gain > 0.1 * usual_gain else max(usual_gain, 1e-3)

    def input_levels(self) -> list[tuple[Floats, Floats]]:
        """Return start plants, each with widths of a zone in rms of the input (2)."""
        widths = self.widths / self.gain
        starts: list[tuple[Floats, Floats]] = [
            (self.plant, np.clip(share * widths, 0.02, 1.5)) for share in (1.0, 0.4)
        ]
        for level in (0.3, 0.8):
            plant = self.linear_plant.copy()
            plant[self.simulator.layout.numerators] *= 1 + 0.5 * level
            starts.append((plant, np.full(2, level)))
        return starts

    def friction_at_input(self) -> list[Floats]:
        """Return the starts for friction at the input's location: c = b / b_1."""
        starts = []
        n = self.n
        for plant, level in self.input_levels():
            numbers = plant.copy()
            if plant[n] <= 1e-3:  # b_1, by which c is divided
                numbers[n] = 0.05 * np.abs(plant[n : 2 * n]).max() + 1e-3
            starts.append(join_place_numbers(numbers, n, inner=level * numbers[n]))
        return starts

    def friction_elsewhere(self, fits: dict[str, PlaceFit]) -> list[Floats]:
        """Return the starts for friction at another location than the input.

        Args:
            fits: fits of friction at the input and of a sensor zone, by name, if available.
        """
        starts = []
        for name, part in (("friction", "inner"), ("sensor", "sensor")):
            if name not in fits:
                continue
            model = fits[name].model
            theta = fits[name].theta
            a = theta[: self.n]
            b = theta[self.n : 2 * self.n]
            gain_to_part = b[0] if part == "inner" else b.sum() / (1 + a.sum())
            level = model.part_numbers(theta, part) / max(abs(gain_to_part), 1e-6)
            for c in self._friction_shapes(a, b):
                total = c.sum()
                # As in `friction_levels`: phi = sum(b) u / sum(c) at the limit of sticking.
                gain = abs(b.sum() / total) if abs(total) > 1e-6 else abs(b[0])
                inner = np.maximum(gain * level, 1e-4)
                starts.append(join_place_numbers(theta[: model.base], self.n, c[1:], inner=inner))
        return starts

    def _friction_shapes(self, a: Floats, b: Floats) -> list[Floats]:
        """Return candidates of (1, c_1, ... c_(n-1)): b / b_1, and A(q) without one real pole."""
        shapes = [b / b[0]] if abs(b[0]) > 1e-6 else []
        poles = np.roots(np.append(1.0, a))
        real = np.abs(poles.imag) < 1e-9
        shapes += [np.real(np.poly(np.delete(poles, i))) for i in np.flatnonzero(real)]
        if not real.all() or self.n == 3:
            shapes.append(np.eye(1, self.n)[0])
        return shapes

    def add_sensor_zone(self, fitted: PlaceFit) -> list[Floats]:
        """Add a zone of the sensor, of several sizes, to a fit; return the starts."""
        starts = []
        for sensor_share, element_share in ((0.3, 0.7), (0.8, 0.3), (0.15, 1.0)):
            theta = fitted.theta.copy()
            element = theta[fitted.model.base :]
            element[:WIDTHS] *= element_share
            element[PARTS["sensor"]] = np.maximum(sensor_share * self.widths, 0.05)
            starts.append(theta)
        return starts
