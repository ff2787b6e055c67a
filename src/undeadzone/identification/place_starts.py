"""Where the climbs of the models of a zone's place begin."""

from __future__ import annotations

import numpy as np

from undeadzone.identification.fit import Fit, fit_linear
from undeadzone.identification.place_models import PlaceFit
from undeadzone.support.arrays import Floats


class PlaceStarts:
    """Where the climbs of the models begin.

    Args:
        fit: plant and sensor zone of one record.

    Attributes:
        simulator: the plant, with its record.
        n, m: order, inputs.
        linear: numbers of a plant without a zone.
        at_sensor: numbers with the zone at the sensor.
    """

    def __init__(self, fit: Fit) -> None:
        simulator = fit.objective.simulator
        self.simulator = simulator
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
