"""What may stand between the plant and the readings: a play, with a dead zone, or a static map.

What is simulated is z. A play drags its level along, y = Dz(level). The centre of its gap is read
off where z = 0 is known: not of an integrating plant, and not beside a dead zone, where only the
sum of both centres shows. A static map reads y = g(z).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.special import ndtr

from undeadzone.nonlinearities.play import contact, levels
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.estimates import latest, weighing
from undeadzone_identify.models.least_squares import Density, Fitted, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone
from undeadzone_identify.models.plant import CREDIBLE, Data, Simulator
from undeadzone_identify.models.zone_fit import Fit, about_level, fit_linear

HALVES = (0.15, 0.5, 1.0)  # of the gap, in rms of y, where climbs begin
LOUDER = 1.1  # the gain behind a play is larger than a linear fit's
BLURS = (1.0, 0.3, 0.1)  # of what disturbs z: rms of noise ahead of a map
LEAST_BLUR = 0.02
BREAKS = 2  # numbers that two edges cost besides (Zhang and Siegmund 2007), where a map breaks,
# or where a few extreme readings tell of an edge
BLUR_BEHIND = 0.03  # where noise is behind the zone
ROOT = math.sqrt(2 * math.pi)

T = TypeVar("T")

# --- A play, and perhaps a dead zone after it


class PlayModel:
    """y on Dz(play(z)); theta = [a, b, x0, c_r, c_l, d_r, d_l].

    Args:
        simulator: the plant, with its data.
        zone: whether a dead zone follows; then c_l = c_r.
    """

    first, last, gain, has_level = 0, 60, 1e-4, False  # a level is in c_r - c_l, d_r - d_l or x0

    def __init__(self, simulator: Simulator, zone: bool = False) -> None:
        self.name = "play_and_zone" if zone else "play"
        self.simulator = simulator
        self.data = simulator.data
        self.zone = zone
        self.tied = zone or simulator.layout.integrators > 0
        self.base = simulator.layout.right
        self.size = self.base + 4
        fitted = [True, not self.tied, zone, zone]
        self.free: Integers = np.flatnonzero(np.append(np.ones(self.base, bool), fitted))
        self.begun = [self._first_reading(part) for part in self.data.records()]

    def _first_reading(self, part: slice) -> Floats:
        """Return the level with which a record begins (1); that of the log where it has no
        reading.
        """
        there = part if self.data.ok[part].any() else slice(None)
        return self.data.y[there][self.data.ok[there]][:1]

    def along(self, data: Data) -> PlayModel:
        """Return the same model of other records."""
        return PlayModel(self.simulator.along(data), self.zone)

    def of_readings(self, y: Floats) -> PlayModel:
        """Return the same model of other readings (N), which no climb on disk is of."""
        return self.along(self.data._replace(y=np.where(self.data.ok, y, 0.0), climbs=None))

    def project(self, theta: Floats) -> Floats:
        """Return theta with c_r + c_l and d_r + d_l not below 0."""
        for right in (self.base, self.base + 2):
            theta[right : right + 2] -= min(theta[right] + theta[right + 1], 0.0) / 2
        if self.tied:
            theta[self.base + 1] = theta[self.base]
        return theta

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""
        return self.simulator.z(theta)

    def level(self, z: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """What the play passes on, and where it last moved: +1 right, -1 left, 0 not yet (N, N)."""
        gap = theta[self.base : self.base + 2]
        return self._dragged_level(np.append(gap, z))

    @latest
    def _dragged_level(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Return `level` of c_r, c_l and z in one column."""
        right, left, z = numbers[:1], numbers[1:2], numbers[2:, None]
        parts = zip(self.data.records(), self.begun, strict=True)
        level = np.vstack([levels(z[part], right, left, begun) for part, begun in parts])[:, 0]
        side = contact(level, np.roll(level, 1))
        side[self.data.start] = 0.0
        return level, side[self._last_moved(level)]

    def readings(self, z: Floats, theta: Floats) -> Floats:
        """What is read of z without noise (N)."""
        return self._through(self.level(z, theta)[0], theta)

    def _through(self, level: Floats, theta: Floats) -> Floats:
        """Return the level through the dead zone."""
        return dead_zone(level, *theta[self.base + 2 :]) if self.zone else level

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free numbers (N x free)."""
        z = self.output(theta)
        slope = self.simulator.gradient(theta, z)[:, : self.base]
        level, moved = self.level(z, theta)
        rows = np.zeros((z.size, self.size))
        rows[:, : self.base] = slope[self._last_moved(level)] * (moved != 0)[:, None]
        rows[:, self.base] = -1.0 * (moved > 0)
        rows[:, self.base + 1] = 1.0 * (moved < 0)
        if self.tied:
            rows[:, self.base] += rows[:, self.base + 1]
        if self.zone:
            right, left = theta[self.base + 2 :]
            rows *= ((level > right) | (level < -left))[:, None]
            rows[:, self.base + 2] = -1.0 * (level > right)
            rows[:, self.base + 3] = 1.0 * (level < -left)
        return self._through(level, theta), rows[:, self.free]

    def _last_moved(self, level: Floats) -> Integers:
        """Return the sample at which the level last moved (N); the record's first before it did."""
        changed = np.append(True, np.diff(level) != 0)
        changed[self.data.start] = True
        return np.asarray(np.maximum.accumulate(np.where(changed, np.arange(level.size), 0)))

    def direction(self, *weights: float) -> Floats:
        """Return the row that weighs c_r, c_l, d_r, d_l over the free numbers."""
        return weighing(self.free, self.size, self.base, weights, self.tied)


PlayFit = Fitted[PlayModel]


def fit_play(data: Data, orders: list[int], integrators: int) -> PlayFit | None:
    """Return the play behind the plant that suits it best; None where none is stable.

    Args:
        data: the records.
        orders: of the plant, to be tried.
        integrators: of the plant.
    """
    models = [PlayModel(Simulator(data, n, integrators)) for n in orders]
    return _best([LeastSquares(model).best(_gaps(model)) for model in models])


def fit_both(begun: Sequence[PlayFit | Fit]) -> PlayFit | None:
    """Return the play that a dead zone follows, with the plant that suits it best.

    Args:
        begun: fits of a play, or of a dead zone, where climbs start.
    """
    fits = []
    for one in begun:
        simulator = one.objective.simulator if isinstance(one, Fit) else one.model.simulator
        model = PlayModel(simulator, zone=True)
        starts = []
        for half, width in ((0.3, 0.3), (0.1, 0.5), (0.5, 0.1)):
            if not isinstance(one, Fit):
                half = 0.8 * float(one.theta[model.base : model.base + 2].mean())
            starts.append(np.append(one.theta[: model.base], [half, half, width, width]))
        fits.append(LeastSquares(model).best(starts))
    return _best(fits)


def _gaps(model: PlayModel) -> list[Floats]:
    """Return gaps of several sizes behind a plant somewhat louder than a linear fit's."""
    linear = fit_linear(model.simulator, model.data.ok)
    begun = [[*about_level(linear, half), 0.0, 0.0] for half in HALVES]
    return [_start_of_climb(model, linear, LOUDER, numbers) for numbers in begun]


def _start_of_climb(
    model: PlayModel | MapModel, plant: Fit, gain: float, p: Sequence[float]
) -> Floats:
    """Where a climb starts: a plant, the factor of its gain, the element's numbers."""
    theta = np.append(plant.theta[: model.base], p)
    theta[model.simulator.layout.b] *= gain
    return theta


def _best(fits: list[PlayFit | None]) -> PlayFit | None:
    """Return the fit of least BIC; of those that leave as little, one whose plant settles."""
    there = sorted(filter(None, fits), key=lambda one: one.bic)
    alike = (one for one in there if one.density.rms <= CREDIBLE * there[0].density.rms)
    settled = (one for one in alike if not one.model.simulator.at_limit(one.theta))
    return next(settled, next(iter(there), None))


# --- Static maps: (z (N), two numbers p) -> (g (N), dg/dz (N), dg/dp (N x 2))

Map = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]


def linear(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z itself."""
    return z, np.ones(z.size), np.zeros((z.size, 2))


def shift_beyond(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z beyond -p_1 and p_0, less the width: a dead zone."""
    above, below = z > p[0], z < -p[1]
    return dead_zone(z, *p), 1.0 * (above | below), np.column_stack([-1.0 * above, 1.0 * below])


def saturation(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z limited to -p_1 and p_0."""
    above, below = z > p[0], z < -p[1]
    inside = ~(above | below)
    return np.clip(z, -p[1], p[0]), 1.0 * inside, np.column_stack([1.0 * above, -1.0 * below])


def absolute(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return |z - p_0| + p_1."""
    sign = np.sign(z - p[0])
    return np.abs(z - p[0]) + p[1], sign, np.column_stack([-sign, np.ones(z.size)])


def cubic(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z + p_0 z^2 + p_1 z^3."""
    slope = 1.0 + 2 * p[0] * z + 3 * p[1] * z**2
    return z + p[0] * z**2 + p[1] * z**3, slope, np.column_stack([z**2, z**3])


def zone_with_noise(blur: float, z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean reading of a dead zone whose noise of that rms acts ahead of it."""
    a, b, above, below = _edges(blur, z, p)
    value = blur * (np.exp(-0.5 * a**2) / ROOT + a * above - np.exp(-0.5 * b**2) / ROOT - b * below)
    return value, above + below, np.column_stack([-above, below])


def jump_with_noise(blur: float, z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z beyond -p_1 and p_0, else 0; its corners blurred by noise of that rms ahead of
    it.
    """
    a, b, above, below = _edges(blur, z, p)
    share = above + below
    at_a, at_b = np.exp(-0.5 * a**2) / (blur * ROOT), np.exp(-0.5 * b**2) / (blur * ROOT)
    return z * share, share + z * (at_a - at_b), np.column_stack([-z * at_a, -z * at_b])


def _edges(blur: float, z: Floats, p: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """How far z is beyond both edges, in rms, and the chances to be beyond (N each)."""
    a, b = (z - p[0]) / blur, (-p[1] - z) / blur
    return a, b, ndtr(a), ndtr(b)


class MapModel:
    """y on g(z; p): the plant and a static map of two numbers, or of none.

    Args:
        simulator: the plant, with its data.
        name: of the map.
        shape: the map.
    """

    first, last, gain = 0, 40, 1e-4

    def __init__(self, simulator: Simulator, name: str, shape: Map) -> None:
        self.name = name
        self.simulator = simulator
        self.shape = shape
        self.base = simulator.layout.right
        self.free: Integers = np.arange(self.base if shape is linear else self.base + 2)
        holds = shape is absolute or name == "dead_zone"  # whose own numbers are a level too
        self.has_level = not holds and not simulator.layout.integrators

    def along(self, data: Data) -> MapModel:
        """Return the same model of other records."""
        return MapModel(self.simulator.along(data), self.name, self.shape)

    def project(self, theta: Floats) -> Floats:
        """Return widths of the input's zone brought back to 0 or above; other numbers make
        sense.
        """
        widths = self.simulator.layout.input
        theta[widths] = np.maximum(theta[widths], 0.0)
        return theta

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""
        return self.simulator.z(theta)

    def readings(self, z: Floats, theta: Floats) -> Floats:
        """What is read of z without noise (N)."""
        return self.shape(z, theta[self.base :])[0]

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free numbers (N x free)."""
        z = self.output(theta)
        y, by_z, by_p = self.shape(z, theta[self.base :])
        slope = self.simulator.gradient(theta, z)[:, : self.base]
        return y, np.hstack([by_z[:, None] * slope, by_p])[:, self.free]


# --- All of them in the place of the dead zone


def static_rivals(fit: Fit) -> dict[str, Density]:
    """Return the dead zone and its rivals, each fitted by least squares.

    Args:
        fit: plant and zone of the record, where the rivals start.

    Returns:
        Densities by the verdict's words: none, dead_zone, saturation, jump, other (|z|, cubic).
    """
    return {name: one.density for name, one in fit_maps(fit).items()}


def fit_maps(fit: Fit) -> dict[str, Fitted[MapModel]]:
    """Return the fits whose densities `static_rivals` returns, by the verdict's words.

    Args:
        fit: plant and zone of the record, where the rivals start.
    """
    fits = []
    for name, shape, starts in _maps(fit):
        squares = LeastSquares(MapModel(fit.objective.simulator, name, shape))
        begun = [_start_of_climb(squares.model, *start) for start in starts]
        fitted = squares.best(begun) or Fitted(squares, begun[0], _nothing(squares))
        breaks = BREAKS if name in ("jump", "saturation") else 0
        numbers = fitted.density.numbers + breaks
        fits.append(fitted._replace(density=fitted.density._replace(numbers=numbers)))
    return best_maps(fits)


def best_maps(fits: Iterable[Fitted[MapModel]]) -> dict[str, Fitted[MapModel]]:
    """Return the fit of least BIC of each name."""
    return best_of_each((one.density.name, one.density.bic, one) for one in fits)


def best_of_each(models: Iterable[tuple[str, float, T]]) -> dict[str, T]:
    """Return the model of least BIC of each name.

    Args:
        models: name, BIC and model.
    """
    best: dict[str, tuple[float, T]] = {}
    for name, bic, one in models:
        if name not in best or bic < best[name][0]:
            best[name] = (bic, one)
    return {name: one for name, (_, one) in best.items()}


# A map, and where its climbs start: a plant, the factor of its gain, the map's numbers.
Begun = tuple[str, Map, list[tuple[Fit, float, list[float]]]]


def _maps(fit: Fit) -> list[Begun]:
    """Return the maps, and where they start beside the fit of a dead zone."""
    simulator, is_behind = fit.objective.simulator, fit.objective.kind == "behind"
    plain = fit_linear(simulator, fit.objective.readings.ok)
    own = [max(fit.right, 0.0), max(fit.left, 0.0)]
    mean = [max(0.5 * fit.width, 0.05)] * 2
    high, low = (float(np.quantile(simulator.data.y, q)) for q in (0.95, 0.05))
    ends = [max(high, 0.05), max(-low, 0.05)]
    across = [-float(fit.z.std()) / 5, 0.0]
    zones = [(fit, 1.0, own), (plain, 1.0, [0.0, 0.0])]
    maps: list[Begun] = [
        ("none", linear, [(plain, 1.0, [0.0, 0.0])]),
        ("dead_zone", shift_beyond, zones),
        ("saturation", saturation, [(plain, 1.2, ends), (plain, 2.0, ends)]),
        ("other", absolute, [(plain, 3.0, [0.0, 0.0]), (fit, 1.0, across)]),
        ("other", cubic, [(plain, 1.0, [0.0, 0.0])]),
    ]
    jumps = [(plain, 1.0, own), (plain, 1.1, mean), (fit, 0.8, own)]
    blurs = [max(part * fit.s, LEAST_BLUR) for part in BLURS]
    for blur in [BLUR_BEHIND] if is_behind else blurs:
        maps.append(("jump", partial(jump_with_noise, blur), jumps))
        if not is_behind:
            maps.append(("dead_zone", partial(zone_with_noise, blur), [(fit, 1.0, own)]))
    return maps


def _nothing(squares: LeastSquares[MapModel]) -> Density:
    """Return the account of a model of which no start makes sense, which is the worst."""
    worst = np.full(squares.data.y.size, -1e3)
    return Density(squares.model.name, worst, squares.free.size, math.inf)
