"""Elements between plant and readings: a play, a play with a dead zone, or a static map.

z is simulated. A play follows z with its level, and y = Dz(level). The centre of the gap is
identifiable only if z has a known zero, as that of an integrating plant has not. Beside a dead zone
only the sum of both centres is identifiable. A static map reads y = g(z).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from scipy.special import ndtr

from undeadzone.nonlinearities.play import contact, levels
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.estimates import cache_latest, weight_row
from undeadzone_identify.models.least_squares import Density, FittedModel, LeastSquares
from undeadzone_identify.models.likelihood import (
    ZoneNoise,
    dead_zone,
    mean_beyond_edges,
    unit_density,
)
from undeadzone_identify.models.motion import last_reading_rows
from undeadzone_identify.models.plant import CREDIBLE, PlantSimulator, RecordData, busiest_stretches
from undeadzone_identify.models.zone_fit import ZoneFit, fit_linear, widths_about_level

HALVES = (0.15, 0.5, 1.0)  # start values of the half gap [rms of y]
LOUDER = 1.1  # start value of the gain behind a play, over that of a linear fit
GAINS = (1.0, 1.2, 2.0)  # start values of the gain ahead of limits, over that of a linear fit
STRONG = 0.5  # rms that a strong curve leaves, over that of a line
FAR_LIMIT = 1.5  # of the largest reading: start value of a limit that no reading reaches
INSIDE = 0.999  # of a limit: readings below it
BLURS = (1.0, 0.3, 0.1)  # rms of the noise ahead of a map [rms of the disturbance of z]
LEAST_BLUR = 0.02
FEWEST = 10  # samples beyond an edge or a limit, from which it is known
# Parameters that two edges count for in BIC beside their values, if the map is discontinuous there
# or if a few extreme readings determine an edge (Zhang and Siegmund 2007).
BREAKS = 2
BLUR_BEHIND = 0.03  # rms of the noise ahead of a map if noise enters behind the zone

T = TypeVar("T", bound=FittedModel[Any])

# --- A play, and perhaps a dead zone after it


class SimulatedPlant:
    """Model whose plant has no element ahead.

    Attributes:
        simulator: linear plant with its data.
    """

    def __init__(self, simulator: PlantSimulator) -> None:
        self.simulator = simulator

    def driven_plant(self, theta: Floats) -> PlantSimulator:
        """Return the linear plant."""
        return self.simulator

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""
        return self.simulator.simulate_z(theta)


class PlayModel(SimulatedPlant):
    """Plant with a play and perhaps a dead zone, y = Dz(play(z)).

    theta = [a, b, x0, c_r, c_l, d_r, d_l].

    Args:
        simulator: linear plant with its data.
        zone: whether a dead zone follows; then c_l = c_r.

    Attributes:
        tied: whether c_l = c_r, since the centre of the gap is not identifiable.
        base: place of c_r in theta.
        free: places of the free parameters (F).
    """

    # a level is in c_r - c_l, d_r - d_l or x0
    first = 0
    last = 60
    gain = 1e-4
    has_level = False

    def __init__(self, simulator: PlantSimulator, zone: bool = False) -> None:
        super().__init__(simulator)
        self.name = "play_and_zone" if zone else "play"
        self.data = simulator.data
        self.zone = zone
        self.tied = zone or simulator.layout.integrators > 0
        self.base = simulator.layout.right
        self.size = self.base + 4
        fitted = [True, not self.tied, zone, zone]
        self.free: Integers = np.flatnonzero(np.append(np.ones(self.base, bool), fitted))
        self.start_levels = list(map(self._first_reading, self.data.record_slices()))

    def _first_reading(self, part: slice) -> Floats:
        """Return the initial level of a record (1); that of the log if it has no reading."""
        source = part if self.data.ok[part].any() else slice(None)
        return self.data.y[source][self.data.ok[source]][:1]

    def along(self, data: RecordData) -> PlayModel:
        """Return the same model for other records."""
        return PlayModel(self.simulator.simulator_along(data), self.zone)

    def with_readings(self, y: Floats) -> PlayModel:
        """Return the same model for other readings (N), without cached maxima."""
        return self.along(self.data._replace(y=np.where(self.data.ok, y, 0.0), climbs=None))

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict theta to c_r + c_l >= 0 and d_r + d_l >= 0."""
        for right in (self.base, self.base + 2):
            theta[right : right + 2] -= min(theta[right] + theta[right + 1], 0.0) / 2
        if self.tied:
            theta[self.base + 1] = theta[self.base]
        return theta

    def play_level(self, z: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """Return the output of the play and its contact (N each): +1 right, -1 left, 0 not yet."""
        gap = theta[self.base : self.base + 2]
        return self._drag_level(np.append(gap, z))

    @cache_latest
    def _drag_level(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Return `play_level` for c_r, c_l and z stacked in a column."""
        right, left, z = np.split(numbers, [1, 2])
        parts = zip(self.data.record_slices(), self.start_levels, strict=True)
        level = np.concatenate([levels(z[part], right, left, start) for part, start in parts])
        side = contact(level, np.roll(level, 1))
        side[self.data.start] = 0.0
        return level, side[self._last_move_index(level)]

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z without noise (N)."""
        return self._pass_dead_zone(self.play_level(z, theta)[0], theta)

    def _pass_dead_zone(self, level: Floats, theta: Floats) -> Floats:
        """Return the level after the dead zone, if the model has a dead zone (N)."""
        return dead_zone(level, *theta[self.base + 2 :]) if self.zone else level

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free parameters (N x F).

        In contact on the right the level is z - c_r, on the left z + c_l. Between contacts it keeps
        its value, and so its derivatives, of the last move.
        """
        z = self.output(theta)
        slope = self.simulator.z_gradient(theta, z)[:, : self.base]
        level, side = self.play_level(z, theta)
        rows = np.zeros((z.size, self.size))
        rows[:, : self.base] = slope[self._last_move_index(level)] * (side != 0)[:, None]
        rows[:, self.base] = -1.0 * (side > 0)
        rows[:, self.base + 1] = 1.0 * (side < 0)
        if self.tied:
            rows[:, self.base] += rows[:, self.base + 1]
        if self.zone:
            right, left = theta[self.base + 2 :]
            rows *= ((level > right) | (level < -left))[:, None]
            rows[:, self.base + 2] = -1.0 * (level > right)
            rows[:, self.base + 3] = 1.0 * (level < -left)
        return self._pass_dead_zone(level, theta), rows[:, self.free]

    def _last_move_index(self, level: Floats) -> Integers:
        """Return the sample at which the level (N) last moved (N), at least the record's first."""
        changed = np.append(True, np.diff(level) != 0)
        changed[self.data.start] = True
        return last_reading_rows(changed)

    def levels(self, theta: Floats) -> Floats:
        """Return c_r and c_l (2)."""
        return theta[[self.base, self.base + (not self.tied)]]

    def play_weights(self, *weights: float) -> Floats:
        """Return the weights of the free parameters (F) in a sum of c_r, c_l, d_r, d_l."""
        return weight_row(self.free, self.size, self.base, weights, self.tied)


PlayFit = FittedModel[PlayModel]


def fit_play(data: RecordData, orders: list[int], integrators: int) -> PlayFit | None:
    """Fit a play behind plants of several orders; return the best fit, None without a stable one.

    Args:
        data: the records.
        orders: orders of the plant among which BIC chooses.
        integrators: number of integrators of the plant.
    """
    fits = []
    for n in orders:
        model = PlayModel(PlantSimulator(data, n, integrators))
        linear = fit_linear(model.simulator, data.ok)
        gaps = [[*widths_about_level(linear, half), 0.0, 0.0] for half in HALVES]
        starts = [_start_point(model, linear, LOUDER, numbers) for numbers in gaps]
        fits.append(LeastSquares(model).fit_from_starts(starts))
    return _best_settling_fit(fits)


def fit_play_and_zone(earlier_fits: Sequence[PlayFit | ZoneFit]) -> PlayFit | None:
    """Fit a play with a dead zone after it; return the best fit, None without a stable one.

    Args:
        earlier_fits: fits of a play or of a dead zone, which give the start points.
    """
    fits = []
    for earlier in earlier_fits:
        if isinstance(earlier, ZoneFit):
            simulator = earlier.objective.simulator
            halves = (0.3, 0.1, 0.5)
        else:
            simulator = earlier.model.simulator
            halves = (0.8 * earlier.model.levels(earlier.theta).mean(),) * 3
        model = PlayModel(simulator, zone=True)
        starts = []
        for half, width in zip(halves, (0.3, 0.5, 0.1), strict=True):
            starts.append(np.append(earlier.theta[: model.base], [half, half, width, width]))
        fits.append(LeastSquares(model).fit_from_starts(starts))
    return _best_settling_fit(fits)


def _start_point(
    model: PlayModel | MapModel,
    plant: ZoneFit | FittedModel[MapModel],
    gain: float,
    p: Sequence[float],
) -> Floats:
    """Return a start point (P): a plant with a gain factor, then the element's parameters p."""
    theta = np.append(plant.theta[: model.base], p)
    theta[model.simulator.layout.numerators] *= gain
    return theta


def _best_settling_fit(fits: list[PlayFit | None]) -> PlayFit | None:
    """Return the fit of least BIC; among equally small residuals prefer a plant that settles."""
    ranked = sorted(filter(None, fits), key=lambda fit: fit.bic)
    credible = (fit for fit in ranked if fit.density.rms <= CREDIBLE * ranked[0].density.rms)
    settling = (fit for fit in credible if not fit.model.simulator.is_at_limit(fit.theta))
    return next(settling, next(iter(ranked), None))


# --- Static maps: (z (N), p (K)) -> (g (N), dg/dz (N), dg/dp (N x K))

Map = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]


def identity_map(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z itself, with derivatives."""
    return z, np.ones(z.size), np.zeros((z.size, 2))


def dead_zone_map(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the dead zone of z with widths p_0 right and p_1 left, with derivatives."""
    above = z > p[0]
    below = z < -p[1]
    return dead_zone(z, *p), 1.0 * (above | below), np.column_stack([-1.0 * above, 1.0 * below])


def saturation_map(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z limited to -p_1 and p_0, with derivatives."""
    above = z > p[0]
    below = z < -p[1]
    inside = ~(above | below)
    return np.clip(z, -p[1], p[0]), 1.0 * inside, np.column_stack([1.0 * above, -1.0 * below])


def limited_zone_map(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the dead zone of z with widths p_0 and p_1, limited to -p_3 and p_2, with
    derivatives.
    """
    passed, by_z, by_widths = dead_zone_map(z, p[:2])
    limited, by_passed, by_limits = saturation_map(passed, p[2:])
    return limited, by_passed * by_z, np.hstack([by_passed[:, None] * by_widths, by_limits])


def absolute_map(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return abs(z - p_0) + p_1, with derivatives."""
    sign = np.sign(z - p[0])
    return np.abs(z - p[0]) + p[1], sign, np.column_stack([-sign, np.ones(z.size)])


def cubic_map(z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z + p_0 z^2 + p_1 z^3, with derivatives."""
    square = z * z
    cube = square * z
    slope = 1.0 + 2 * p[0] * z + 3 * p[1] * square
    return z + p[0] * square + p[1] * cube, slope, np.column_stack([square, cube])


def noisy_zone_map(blur: float, z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean reading of a dead zone with noise of rms `blur` ahead, with derivatives."""
    _, _, above, below = _edge_chances(blur, z, p)
    value = mean_beyond_edges(z, ZoneNoise(p[0], p[1], blur))
    return value, above + below, np.column_stack([-above, below])


def noisy_jump_map(blur: float, z: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return z beyond -p_1 and p_0, else 0, averaged over noise of rms `blur` ahead."""
    a, b, above, below = _edge_chances(blur, z, p)
    share = above + below
    at_a = unit_density(a) / blur
    at_b = unit_density(b) / blur
    return z * share, share + z * (at_a - at_b), np.column_stack([-z * at_a, -z * at_b])


def _edge_chances(blur: float, z: Floats, p: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the distances of z beyond the right and left edge, in rms of the noise, and the
    probabilities to be beyond them (N each).
    """
    a = (z - p[0]) / blur
    b = (-p[1] - z) / blur
    return a, b, ndtr(a), ndtr(b)


class MapModel(SimulatedPlant):
    """Plant with a static map: y = g(z; p).

    Args:
        simulator: linear plant with its data.
        name: name of the model.
        shape: the map g.
    """

    first = 8
    last = 40
    gain = 1e-4

    def __init__(self, simulator: PlantSimulator, name: str, shape: Map) -> None:
        super().__init__(simulator)
        self.name = name
        self.shape = shape
        self.base = simulator.layout.right
        counts: dict[Map, int] = {identity_map: 0, limited_zone_map: 4}
        self.free: Integers = np.arange(self.base + counts.get(shape, 2))
        # The parameters of these maps, or x(0) of an integrating plant, fit a level already.
        is_level_fitted = shape is absolute_map or name == "dead_zone"
        self.has_level = not is_level_fitted and not simulator.layout.integrators

    def along(self, data: RecordData) -> MapModel:
        """Return the same model for other records."""
        return MapModel(self.simulator.simulator_along(data), self.name, self.shape)

    def levels(self, theta: Floats) -> Floats:
        """Return the edges of the map (2)."""
        return theta[self.base : self.base + 2]

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict the widths of a zone between limits to 0 or above, in place."""
        if self.shape is limited_zone_map:
            widths = slice(self.base, self.base + 2)
            theta[widths] = np.maximum(theta[widths], 0.0)
        return theta

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z without noise (N)."""
        return self.shape(z, theta[self.base :])[0]

    def describe_limits(self, theta: Floats, y_scale: float) -> str:
        """Describe the limits of the readings, and a dead zone between them; empty without limits.

        Args:
            theta: parameters of the fit (P).
            y_scale: rms of y [y].
        """
        if self.shape not in (saturation_map, limited_zone_map):
            return ""
        *widths, high, low = theta[self.base :]
        data = self.simulator.data
        read = self.noise_free_readings(self.output(theta), theta)
        level = self.has_level * (data.y - read)[data.ok].mean()  # limits included
        reached = (end for end in (-low, high) if np.count_nonzero(read == end) >= FEWEST)
        ends = " and ".join(f"{(end + level) * y_scale:.3g}" for end in reached)
        if sum(widths) > 0:
            right, left = np.multiply(widths, y_scale)
            ends += f", behind a dead zone of about {right:.3g} right and {left:.3g} left"
        return f"the readings end at {ends}" if ends else ""

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free parameters (N x F)."""
        z = self.output(theta)
        y, by_z, by_p = self.shape(z, theta[self.base :])
        slope = self.simulator.z_gradient(theta, z)[:, : self.base]
        return y, np.hstack([by_z[:, None] * slope, by_p])[:, self.free]


# --- All of them in the place of the dead zone


def fit_maps(fit: ZoneFit, may_jump: bool = True) -> dict[str, FittedModel[MapModel]]:
    """Fit the dead zone and its static rivals by least squares.

    Args:
        fit: fit of a plant with a zone, which gives the start points.
        may_jump: whether a jump is fitted.

    Returns:
        Fits by class: none, dead_zone, saturation, jump, other (|z|, cubic).
    """
    fits = []
    blurred: list[Floats] = []  # the jump with more noise ahead
    for name, shape, starts in _start_maps(fit):
        if name == "jump" and not may_jump:
            continue
        squares = LeastSquares(MapModel(fit.objective.simulator, name, shape))
        points = [_start_point(squares.model, *start) for start in starts]
        if name == "jump":  # less noise has a narrower maximum, near that of more noise
            points = blurred or points
        fitted = squares.fit_from_starts(points) or FittedModel(
            squares, points[0], _worst_density(squares)
        )
        if name == "jump":
            blurred = [fitted.theta]
        has_edge = name in ("jump", "saturation") or shape is absolute_map
        breaks = BREAKS if has_edge else 0
        numbers = fitted.density.numbers + breaks
        fits.append(fitted._replace(density=fitted.density._replace(numbers=numbers)))
    maps = best_maps(fits)
    if has_strong_curve(maps):
        maps = best_maps([*fits, *_fit_from_strong(maps)])
    return maps


def has_strong_curve(maps: Mapping[str, FittedModel[MapModel]]) -> bool:
    """Return whether another curve of the sensor leaves far less than a line.

    Args:
        maps: fits by class.
    """
    return maps["other"].density.rms < STRONG * maps["none"].density.rms


def _fit_from_strong(maps: Mapping[str, FittedModel[MapModel]]) -> list[FittedModel[MapModel]]:
    """Return the fit of a cubic from a strong one; beside a line a climb may end before it."""
    line = maps["none"]
    squares = LeastSquares(MapModel(line.model.simulator, "other", cubic_map))
    fitted = squares.fit_from_starts([_start_point(squares.model, line, 0.5, [0.0, 1.0])])
    return [] if fitted is None else [fitted]


def fit_limits(
    data: RecordData, orders: Sequence[int], integrators: int, ends: tuple[float, float]
) -> FittedModel[MapModel] | None:
    """Fit a plant with limits of its readings to all of them; return the fit of least BIC.

    Between the limits alone, which readings are left depends on what disturbs the plant.

    Args:
        data: the records, with the readings at the limits.
        orders: of the plant.
        integrators: of the plant.
        ends: least and largest reading, scaled; infinite without a limit.

    Returns:
        The fit; None without a stable one.
    """
    part = busiest_stretches(data)
    low, high = np.clip(ends, *(FAR_LIMIT * np.array([part.y.min(), part.y.max()])))
    between = part.ok & (part.y > ends[0] * INSIDE) & (part.y < ends[1] * INSIDE)
    fits = []
    for n in orders:
        simulator = PlantSimulator(part, n, integrators)
        squares = LeastSquares(MapModel(simulator, "saturation", saturation_map))
        linear = fit_linear(simulator, between)
        starts = [_start_point(squares.model, linear, gain, [high, -low]) for gain in GAINS]
        fits.append(squares.fit_from_starts(starts))
    return min(filter(None, fits), key=lambda one: one.density.bic, default=None)


def best_maps(fits: Iterable[FittedModel[MapModel]]) -> dict[str, FittedModel[MapModel]]:
    """Return the fit of least BIC of each class."""
    return best_of_each(fits, lambda fit: fit.density.name)


def best_of_each(fits: Iterable[T], name: Callable[[T], str]) -> dict[str, T]:
    """Return the fit of least BIC for each name.

    Args:
        fits: of any models.
        name: of a fit.
    """
    best: dict[str, T] = {}
    for fit in sorted(fits, key=lambda one: one.density.bic):
        best.setdefault(name(fit), fit)
    return best


# Name, map, and start points: a plant, the factor of its gain, the map's parameters.
MapStarts = tuple[str, Map, list[tuple[ZoneFit, float, list[float]]]]


def _start_maps(fit: ZoneFit) -> list[MapStarts]:
    """Return the static maps and their start points beside the fit of a dead zone."""
    simulator = fit.objective.simulator
    is_behind = fit.objective.kind == "behind"
    linear = fit_linear(simulator, fit.objective.readings.ok)
    widths = [max(fit.right, 0.0), max(fit.left, 0.0)]
    mean_width = [max(0.5 * fit.width, 0.05)] * 2
    high, low = (float(np.quantile(simulator.data.y, q)) for q in (0.95, 0.05))
    limits = [max(high, 0.05), max(-low, 0.05)]
    kink = [-float(fit.z.std()) / 5, 0.0]
    zones = [(fit, 1.0, widths), (linear, 1.0, [0.0, 0.0])]
    maps: list[MapStarts] = [
        ("none", identity_map, [(linear, 1.0, [0.0, 0.0])]),
        ("dead_zone", dead_zone_map, zones),
        ("saturation", saturation_map, [(linear, 1.2, limits), (linear, 2.0, limits)]),
        ("saturation", limited_zone_map, [(fit, 1.0, [*widths, *limits])]),
        ("other", absolute_map, [(linear, 3.0, [0.0, 0.0]), (fit, 1.0, kink)]),
        ("other", cubic_map, [(linear, 1.0, [0.0, 0.0])]),
    ]
    jumps = [(linear, 1.0, widths), (linear, 1.1, mean_width), (fit, 0.8, widths)]
    blurs = [max(share * fit.disturbance_rms, LEAST_BLUR) for share in BLURS]
    for blur in [BLUR_BEHIND] if is_behind else blurs:
        maps.append(("jump", partial(noisy_jump_map, blur), jumps))
        if not is_behind:
            maps.append(("dead_zone", partial(noisy_zone_map, blur), [(fit, 1.0, widths)]))
    return maps


def _worst_density(squares: LeastSquares[MapModel]) -> Density:
    """Return the density of a model without any admissible start, the worst possible."""
    worst = np.full(squares.data.y.size, -1e3)
    return Density(squares.model.name, worst, squares.free.size, math.inf)
