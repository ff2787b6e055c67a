"""Models of where a zone may be: sensor, friction in the plant, input, or two of them (F)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.climb import Top, climb
from undeadzone.identification.friction_step import FAR, simulate
from undeadzone.identification.long_run import Spread, gauss_newton, least_squares_spread
from undeadzone.identification.plant_fit import Simulator
from undeadzone.identification.residual_map import curve_over, is_strange
from undeadzone.identification.static_rivals import Density, first_order_density
from undeadzone.support.arrays import Floats

STEP = 1e-5


class Shape(NamedTuple):
    """Which parts a model has.

    Attributes:
        name: of the model.
        sensor: a zone of the sensor, d_r and d_l.
        inner: friction in the recursion, phi_r and phi_l.
        place: a zone of the input.
        position: friction at a measured position.
        sticks: breakaway above sliding friction, sigma.
        free: how many of c_1 to c_n are free numbers; the others follow from b (collocated), or
            are 0.
    """

    name: str
    sensor: bool = False
    inner: bool = False
    input: bool = False
    position: bool = False
    sticks: bool = False
    free: int = 0


class PlaceModel:
    """Least squares of y on a plant with a zone somewhere.

    theta = [a, b, x0, d_r, d_l, phi_r, phi_l, sigma, u_r, u_l, c_1 ... c_n]; what a shape lacks
    stays 0.

    Args:
        simulator: the plant, with one record.
        shape: the parts of the model.
    """

    def __init__(self, simulator: Simulator, shape: Shape) -> None:
        self.simulator = simulator
        self.shape = shape
        self.n, self.m = simulator.layout.n, simulator.layout.m
        self.base = simulator.layout.right
        self.size = self.base + 7 + self.n
        self.data = simulator.data
        pulses = np.zeros((self.data.y.size, self.n))
        pulses[np.arange(self.n), np.arange(self.n)] = 1.0
        self.exogenous = np.hstack([simulator.lagged, pulses])
        self.free = np.flatnonzero(self._free())
        self._last: tuple[Floats, Floats] | None = None

    def _free(self) -> Floats:
        """Which numbers are fitted (P)."""
        shape = self.shape
        free = np.zeros(self.size, bool)
        free[: self.base] = True
        free[self.base : self.base + 2] = shape.sensor
        free[self.base + 2 : self.base + 4] = shape.inner
        free[self.base + 4] = shape.sticks
        free[self.base + 5 : self.base + 7] = shape.input
        free[self.base + 7 : self.base + 7 + shape.free] = True
        return free

    def theta(self, plant: Floats, **parts: Floats | float) -> Floats:
        """Numbers from those of a plant and of parts: sensor, inner, sigma, input, c."""
        theta = np.zeros(self.size)
        theta[: self.base] = plant[: self.base]
        places = {
            "sensor": slice(self.base, self.base + 2),
            "inner": slice(self.base + 2, self.base + 4),
            "sigma": slice(self.base + 4, self.base + 5),
            "input": slice(self.base + 5, self.base + 7),
        }
        for name, value in parts.items():
            if name == "c":
                c = np.atleast_1d(value)[: self.shape.free]
                theta[self.base + 7 : self.base + 7 + c.size] = c
            else:
                theta[places[name]] = value
        return theta

    def project(self, theta: Floats) -> Floats:
        """Widths and sigma brought back to 0 or above."""
        widths = slice(self.base, self.base + 7)
        theta[widths] = np.maximum(theta[widths], 0.0)
        return theta

    def c(self, theta: Floats) -> Floats:
        """c_1 to c_n: free ones, or those of friction where the input acts, or of one pole."""
        c = np.zeros(self.n)
        free = self.shape.free
        if not self.shape.inner:
            return c
        if free:
            c[:free] = theta[self.base + 7 : self.base + 7 + free]
            return c
        first = theta[self.n]
        size = max(abs(first), 1e-9)
        c[: self.n - 1] = theta[self.n + 1 : 2 * self.n] / math.copysign(size, first)
        return c

    def lane(self, theta: Floats) -> Floats:
        """The numbers of `friction_step.kernel`."""
        tail = theta[self.base + 2 : self.base + 7]
        return np.concatenate([theta[: self.base], self.c(theta), tail])

    def outputs(self, points: Floats) -> Floats:
        """z for several sets of numbers (K x N)."""
        rows = np.array([self.lane(theta) for theta in points])
        return simulate(self.n, self.m, self.shape.position, self.exogenous, rows)

    def readings(self, z: Floats, theta: Floats) -> Floats:
        """The reading that z makes: through the sensor's zone if there is one."""
        right, left = theta[self.base], theta[self.base + 1]
        return np.maximum(z - right, 0.0) + np.minimum(z + left, 0.0)

    def residual(self, theta: Floats) -> Floats:
        """y less the model's reading (N), 0 where missing."""
        z = self.outputs(theta[None, :])[0]
        return (self.data.y - self.readings(z, theta)) * self.data.ok

    def rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """Residual (N) and derivatives of the reading by the free numbers (N x free)."""
        if self._last is not None and np.array_equal(self._last[0], theta):
            saved = self._last[1]
            return saved[:, 0], saved[:, 1:]
        steps = STEP * np.maximum(np.abs(theta[self.free]), 0.02)
        count = self.free.size
        points = np.tile(theta, (1 + 2 * count, 1))
        for place, (index, step) in enumerate(zip(self.free, steps, strict=True)):
            points[1 + place, index] += step
            points[1 + count + place, index] -= step
        z = self.outputs(points)
        values = np.array([self.readings(row, p) for row, p in zip(z, points, strict=True)])
        rows = (values[1 : 1 + count] - values[1 + count :]) / (2 * steps[:, None]) * self.data.ok
        residual = (self.data.y - values[0]) * self.data.ok
        self._last = (theta.copy(), np.column_stack([residual, rows.T]))
        return residual, rows.T

    def value(self, theta: Floats) -> float:
        """Minus N / 2 ln of the mean square of the residual."""
        plant = np.append(theta[: self.base], np.zeros(4))
        if not self.simulator.admissible(plant):
            return -math.inf
        residual, _ = self.rows(theta)
        e = residual[self.data.ok]
        square = float(e @ e)
        if not square < FAR:
            return -math.inf
        return -0.5 * e.size * math.log(square / e.size + 1e-30)

    def quadratic(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """(value, score, Gauss-Newton Hessian) of the free numbers."""
        e, rows = self.rows(theta)
        variance, hessian = gauss_newton(e, rows, int(self.data.ok.sum()))
        return self.value(theta), rows.T @ e / variance, hessian


class PlaceFit(NamedTuple):
    """A fitted model of the zone's place.

    Attributes:
        model: the model.
        theta: its numbers.
        density: its account of the readings.
    """

    model: PlaceModel
    theta: Floats
    density: Density

    def spread(self) -> Spread:
        """(I1) of the free numbers."""
        e, rows = self.model.rows(self.theta)
        return least_squares_spread(e, rows, int(self.model.data.ok.sum()))

    @property
    def sensor(self) -> Floats:
        """Widths at the sensor (2), scaled."""
        return self.theta[self.model.base : self.model.base + 2]

    @property
    def inner(self) -> Floats:
        """Friction levels phi_r, phi_l (2), scaled."""
        return self.theta[self.model.base + 2 : self.model.base + 4]

    @property
    def input(self) -> Floats:
        """Widths at the input (2), scaled."""
        return self.theta[self.model.base + 5 : self.model.base + 7]


def fit_place(model: PlaceModel, begun: list[Floats]) -> PlaceFit | None:
    """The best of the climbs from several starts, all for 12 steps and the best two to the end."""
    tops: list[Top] = []
    for start in begun:
        theta = model.project(start.copy())
        if math.isfinite(model.value(theta)):
            tops.append(_climbed(model, theta, 12))
    if not tops:
        return None
    tops.sort(key=lambda top: -top.value)
    ends = [_climbed(model, top.theta, 40) for top in tops[:2]]
    best = max(ends, key=lambda top: top.value)
    e = model.residual(best.theta)
    density = first_order_density(model.shape.name, e, model.free.size, ())
    z = model.outputs(best.theta[None, :])[0]
    share, chance = curve_over(z[model.data.ok], e[model.data.ok])
    density = density._replace(strange=is_strange(share, chance))
    return PlaceFit(model, best.theta, density)


def _climbed(model: PlaceModel, theta: Floats, steps: int) -> Top:
    """The top that a climb from theta reaches."""
    return climb(
        model.value,
        model.quadratic,
        theta,
        model.free,
        steps,
        1e-3,
        model.project,
        kept=model.data.climbs,
    )
