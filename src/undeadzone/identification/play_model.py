"""Least squares of readings on a plant behind a play, and perhaps a dead zone after it.

What is simulated is z; the play drags its level along, y = Dz(level). The centre of the gap is
read off where z = 0 is known: not of an integrating plant, and not beside a dead zone, where only
the sum of both centres shows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.climb import Top, climb
from undeadzone.identification.fit import Fit, fit_linear
from undeadzone.identification.log import Flags
from undeadzone.identification.long_run import Spread, gauss_newton, least_squares_spread
from undeadzone.identification.objective import FAR
from undeadzone.identification.plant_fit import Data, Simulator
from undeadzone.identification.residual_map import curve_over, is_strange
from undeadzone.identification.static_rivals import Density, first_order_density
from undeadzone.support.arrays import Floats

HALVES = (0.15, 0.5, 1.0)  # of the gap, in rms of y, where climbs begin
LOUDER = 1.1  # the gain behind a play is larger than a linear fit's
STEPS = 60


class PlayModel:
    """y on Dz(play(z)); theta = [a, b, x0, c_r, c_l, d_r, d_l].

    Args:
        simulator: the plant, with its data.
        zone: whether a dead zone follows; then c_l = c_r.
    """

    def __init__(self, simulator: Simulator, zone: bool = False) -> None:
        self.simulator = simulator
        self.data: Data = simulator.data
        self.base = simulator.layout.right
        self.size = self.base + 4
        self.zone = zone
        self.tied = zone or simulator.layout.integrators > 0
        free = np.ones(self.size, bool)
        free[self.base + 1] = not self.tied
        free[self.base + 2 :] = zone
        self.free = np.flatnonzero(free)
        self.name = "play_and_zone" if zone else "play"
        self.levels = [float(self.data.y[part][self.data.ok[part]][0]) for part in self._whole()]

    def _whole(self) -> list[slice]:
        """The records; of one without a reading the whole log stands for it."""
        parts = []
        for part in self.data.records():
            parts.append(part if self.data.ok[part].any() else slice(0, self.data.y.size))
        return parts

    def project(self, theta: Floats) -> Floats:
        """theta with c_r + c_l and d_r + d_l not below 0."""
        theta = theta.copy()
        for right in (self.base, self.base + 2):
            lacking = min(theta[right] + theta[right + 1], 0.0)
            theta[right : right + 2] -= lacking / 2
        if self.tied:
            theta[self.base + 1] = theta[self.base]
        return theta

    def z(self, theta: Floats) -> Floats:
        """Output of the plant (N)."""
        return self.simulator.z(self._plant(theta))

    def _plant(self, theta: Floats) -> Floats:
        return np.append(theta[: self.base], np.zeros(4))

    def level(self, z: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """What the play passes on, and where it last moved: +1 right, -1 left, 0 not yet (N, N)."""
        right, left = (float(number) for number in theta[self.base : self.base + 2])
        level, moved = np.empty(z.size), np.zeros(z.size)
        for part, begun in zip(self.data.records(), self.levels, strict=True):
            now, last = min(max(begun, z[part.start] - right), z[part.start] + left), 0.0
            for k, position in enumerate(z[part].tolist(), part.start):
                if now > position + left:
                    now, last = position + left, -1.0
                elif now < position - right:
                    now, last = position - right, 1.0
                level[k], moved[k] = now, last
        return level, moved

    def readings(self, z: Floats, theta: Floats) -> Floats:
        """What is read of z without noise (N)."""
        return self._through(self.level(z, theta)[0], theta)

    def _through(self, level: Floats, theta: Floats) -> Floats:
        """The level through the dead zone."""
        right, left = theta[self.base + 2 :]
        if not self.zone:
            return level
        return np.maximum(level - right, 0.0) + np.minimum(level + left, 0.0)

    def residual(self, theta: Floats) -> Floats:
        """y less what is expected (N); 0 where a reading is missing."""
        return (self.data.y - self.readings(self.z(theta), theta)) * self.data.ok

    def rms(self, theta: Floats) -> float:
        """rms of what is left of the readings that there are."""
        return float(np.sqrt(np.mean(self.residual(theta)[self.data.ok] ** 2)))

    def value(self, theta: Floats) -> float:
        """Minus N / 2 ln of the mean square of the residual."""
        if not self.simulator.admissible(self._plant(theta)):
            return -math.inf
        return self._value_of(self.residual(theta))

    def _value_of(self, e: Floats) -> float:
        """The value of an admissible plant with these residuals (N)."""
        square = float(e @ e)
        if not square < FAR:
            return -math.inf
        count = int(self.data.ok.sum())
        return -0.5 * count * math.log(square / count + 1e-30)

    def rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """Residual (N) and derivatives of the reading by the free numbers (N x free)."""
        z = self.z(theta)
        slope = self.simulator.gradient(self._plant(theta), z)[:, : self.base]
        level, moved = self.level(z, theta)
        rows = np.zeros((z.size, self.size))
        rows[:, : self.base] = slope[self._last_moved(level, moved)] * (moved != 0)[:, None]
        rows[:, self.base] = -1.0 * (moved > 0)
        rows[:, self.base + 1] = 1.0 * (moved < 0)
        if self.tied:
            rows[:, self.base] += rows[:, self.base + 1]
        y = self._through(level, theta)
        if self.zone:
            right, left = theta[self.base + 2 :]
            rows *= ((level > right) | (level < -left))[:, None]
            rows[:, self.base + 2] = -1.0 * (level > right)
            rows[:, self.base + 3] = 1.0 * (level < -left)
        ok = self.data.ok
        return (self.data.y - y) * ok, rows[:, self.free] * ok[:, None]

    def _last_moved(self, level: Floats, moved: Floats) -> Floats:
        """The sample at which the level last moved (N); the record's first before it did."""
        changed = np.append(True, np.diff(level) != 0)
        changed[self.data.start] = True
        return np.asarray(np.maximum.accumulate(np.where(changed, np.arange(level.size), 0)))

    def quadratic(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """(value, score, Gauss-Newton Hessian) of the free numbers of an admissible plant."""
        e, rows = self.rows(theta)
        variance, hessian = gauss_newton(e, rows, int(self.data.ok.sum()))
        return self._value_of(e), rows.T @ e / variance, hessian

    def spread(self, theta: Floats) -> Spread:
        """(I1) of the free numbers."""
        return least_squares_spread(*self.rows(theta), int(self.data.ok.sum()))

    def direction(self, *weights: float) -> Floats:
        """The row that weighs c_r, c_l, d_r, d_l over the free numbers."""
        row = np.zeros(self.size)
        row[self.base : self.base + len(weights)] = weights
        if self.tied:
            row[self.base] += row[self.base + 1]
        return row[self.free]

    def climbed(self, theta: Floats, steps: int = STEPS, gain: float = 1e-4) -> Top:
        """The top that a climb from theta reaches."""
        kept = self.data.climbs
        begun = self.project(theta)
        return climb(
            self.value, self.quadratic, begun, self.free, steps, gain, self.project, kept=kept
        )

    def of_readings(self, y: Floats) -> PlayModel:
        """The same model of other readings (N), which no climb on disk is of."""
        data = self.data._replace(y=np.where(self.data.ok, y, 0.0), climbs=None)
        layout = self.simulator.layout
        return PlayModel(Simulator(data, layout.n, layout.integrators), self.zone)


class PlayFit(NamedTuple):
    """A fit of `PlayModel`: the model, its numbers, its account of the readings."""

    model: PlayModel
    theta: Floats
    density: Density


def fit_play(data: Data, orders: list[int], integrators: int) -> list[PlayFit]:
    """The play behind a plant of each order, the one of least BIC first.

    Args:
        data: the records.
        orders: of the plant, to be tried.
        integrators: of the plant.

    Returns:
        One fit an order; those without a stable plant are left out.
    """
    fits = []
    for n in orders:
        model = PlayModel(Simulator(data, n, integrators))
        linear = fit_linear(model.simulator, data.ok)
        fits.append(_best(model, _starts(model, linear)))
    return _ranked(fits)


def fit_both(begun: list[PlayFit | Fit]) -> PlayFit | None:
    """The play that a dead zone follows, with the plant of least BIC.

    Args:
        begun: fits of a play, or of a dead zone, where climbs start.
    """
    fits = []
    for one in begun:
        simulator = one.model.simulator if isinstance(one, PlayFit) else one.objective.simulator
        model = PlayModel(simulator, zone=True)
        starts = []
        for half, width in ((0.3, 0.3), (0.1, 0.5), (0.5, 0.1)):
            widths = [half, half, width, width]
            if isinstance(one, PlayFit):
                half = float(one.theta[model.base : model.base + 2].mean())
                widths = [0.8 * half, 0.8 * half, width, width]
            starts.append(np.append(one.theta[: model.base], widths))
        fits.append(_best(model, starts))
    return next(iter(_ranked(fits)), None)


def _starts(model: PlayModel, linear: Fit) -> list[Floats]:
    """Gaps of several sizes behind a plant somewhat louder than a linear fit's."""
    begun = []
    for half in HALVES:
        theta = np.append(linear.theta[: model.base], [half, half, 0.0, 0.0])
        theta[model.simulator.layout.b] *= LOUDER
        begun.append(theta)
    return begun


def _best(model: PlayModel, starts: list[Floats]) -> PlayFit | None:
    """The best of the climbs from several starts."""
    tops = [model.climbed(theta) for theta in starts if math.isfinite(model.value(theta))]
    if not tops:
        return None
    best = max(tops, key=lambda top: top.value)
    return PlayFit(model, best.theta, density_of(model, best.theta))


def density_of(model: PlayModel, theta: Floats) -> Density:
    """The model's account of the readings, with whether a curve over z explains what it leaves."""
    ok: Flags = model.data.ok
    e = model.residual(theta)
    widths = tuple(float(number) for number in theta[model.base :])
    density = first_order_density(model.name, e, model.free.size, widths)
    return density._replace(strange=is_strange(*curve_over(model.z(theta)[ok], e[ok])))


def _ranked(fits: list[PlayFit | None]) -> list[PlayFit]:
    """The fits that there are, that of least BIC first."""
    return sorted((one for one in fits if one is not None), key=lambda one: one.density.bic)
