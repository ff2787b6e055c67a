"""A plant between elements: a curve or a play of its input, a zone and a filter behind it.

y = F(q) Dz(G(q) g(u; p)) + level. The output of the input element g is known for every p, so a scan
of p with a linear plant behind each gives the start points. Such elements are common beside a dead
zone: the torque of a fan is proportional to u |u|, the linkage of a damper has play, the converter
of a load cell averages. A curve has neither widths nor an inverse.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.signal import lfilter
from scipy.special import expit

from undeadzone.compile import lanes
from undeadzone.nonlinearities.play import levels
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.elements import best_of_each
from undeadzone_identify.models.estimates import (
    cache_latest,
    central_differences,
    perturb_each,
    perturbation_steps,
)
from undeadzone_identify.models.least_squares import FittedModel, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone
from undeadzone_identify.models.place import PlaceFit, PlaceStarts
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.models.zone_fit import ZoneFit, fit_linear

TAPS = 4  # taps of a filter behind the zone, beside the first
WIDEST = 6.0  # largest width of a zone [rms of z]
VANISHING = 0.01  # width below which an element is negligible [rms of its signal]
STRAIGHT = 0.05  # deviation from a line below which a curve is negligible [rms of the curve]
FLATTEST = 0.1  # least ratio of the slopes of both sides
SHARPEST = 1e-4  # least radius of a round edge [rms of z]
ROUND = 0.02  # radius below which an edge is sharp [width of the zone]
PLACES = 13  # edges of a scan for a zone of the input that is not about 0
LATE = 0.05  # lag below which a filter is negligible [samples]
SELDOM = 0.03  # of the samples, in which a drive of limited rate has reached its target
NEAR_BOUND = 1e-3  # distance below which a parameter of a curve is at its bound
STEP = 1e-5  # of z, for differences [rms of y]


class InputElement(NamedTuple):
    """Element of the input.

    Attributes:
        passes: (u (N), p) -> output of the element (N).
        low, high: bounds of its parameters p.
        scanned: parameters of the scan for start points.
        words: format of its description: of its parameters p, of the first one in the unit of the
            input (size), and of the rms of the input (u_scale).
        neutral: parameters with which its output is a multiple of u, or () if no finite ones are.
    """

    passes: Callable[[Floats, Floats], Floats]
    low: tuple[float, ...]
    high: tuple[float, ...]
    scanned: tuple[tuple[float, ...], ...]
    words: str
    neutral: tuple[float, ...] = ()


def power_of_input(u: Floats, p: Floats) -> Floats:
    """Return sign(u) |u|^p."""
    return np.sign(u) * np.abs(u) ** p[0]


def cubic_of_input(u: Floats, p: Floats) -> Floats:
    """Return u + p_0 u^2 + p_1 u^3."""
    return u + (p[0] + p[1] * u) * u * u


def exponential_of_input(u: Floats, p: Floats) -> Floats:
    """Return (exp(p u) - 1) / p."""
    rate = p[0] if abs(p[0]) > 1e-6 else 1e-6
    return np.expm1(np.clip(rate * u, -50.0, 50.0)) / rate


def play_of_input(u: Floats, p: Floats) -> Floats:
    """Return u (N) after a play of gap p_0, which starts in the middle of its gap (N)."""
    half = p[:1] / 2
    return levels(u, half, half, u[:1])


def rate_of_input(u: Floats, p: Floats) -> Floats:
    """Return u (N) after a rate limiter of p_0 per sample (N)."""
    return limit_rates(u, p)[:, 0]


def lag_columns(x: Floats, pole: float) -> Floats:
    """Return signals (N, or N x K) after a first-order lag that is at rest at their first value."""
    return lfilter([1 - pole], [1.0, -pole], x, axis=0, zi=pole * x[:1])[0]


def limit_rates(u: Floats, limits: Floats) -> Floats:
    """Return a signal (N) after rate limiters of several limits (K) per sample (N x K)."""
    signal = u[:, None]
    rows = limits[:, None]
    limited, _ = lanes.run_lanes(
        build_rate_kernel(), u[:1], signal, np.zeros(1), lane_params=rows, threads=1
    )
    return limited[:, :, 0].T


@cache
def build_rate_kernel() -> lanes.Kernel:
    """Return the compiled step of a rate limiter, whose limit is the parameter of a lane."""
    value, target, limit = map(ca.SX.sym, ("s", "u", "p"))
    after = ca.fmin(ca.fmax(target, value - limit), value + limit)
    step = ca.Function("rate", [value, target, limit], [after, after])
    return lanes.build_kernel(step, params=[0])


CURVED = "the input acts by a smooth curve ({}); no zone is needed"
INPUTS = {
    "power": InputElement(
        power_of_input,
        (0.2,),
        (4.0,),
        ((0.5,), (1.5,), (2.0,), (3.0,)),
        CURVED.format("sign(u) |u|^{p[0]:.2g} fits"),
        (1.0,),
    ),
    "cubic": InputElement(
        cubic_of_input,
        (-3.0, -3.0),
        (3.0, 3.0),
        ((0.0, 0.1), (0.0, 0.5), (0.3, 0.1), (-0.3, 0.1)),
        CURVED.format("u {p[0]:+.2g} u^2 {p[1]:+.2g} u^3 fits, u over {u_scale:.4g}"),
        (0.0, 0.0),
    ),
    "exponential": InputElement(
        exponential_of_input,
        (-3.0,),
        (3.0,),
        ((0.4,), (1.0,), (-0.4,), (-1.0,)),
        CURVED.format("exp({p[0]:.2g} u) fits, u over {u_scale:.4g}"),
        (0.0,),
    ),
    "rate": InputElement(
        rate_of_input,
        (1e-3,),
        (4.0,),
        tuple((limit,) for limit in (0.02, 0.05, 0.12, 0.3)),
        "the drive follows the input by at most {size:.4g} a sample",
    ),
    "play": InputElement(
        play_of_input,
        (0.0,),
        (8.0,),
        tuple((gap,) for gap in (0.1, 0.25, 0.5, 0.9, 1.4, 2)),
        "play between input and plant, ahead of its lags, explains the log: {size:.4g}",
        (0.0,),
    ),
}


def zone_of_input(u: Floats, p: Floats) -> Floats:
    """Return the parts of u above p_1 and below p_0."""
    return dead_zone(u, p[1], -p[0])


PLAIN = InputElement(lambda u, _: u, (), (), ((),), "u")
CURVES = ("power", "cubic", "exponential")


class ChainModel:
    """Model y = F(q) Dz(G(q) g(u; p)).

    theta = [a, b, x0, p, d_r, d_l, slope, rounding, f_1 ...]. F has a gain of 1:
    F = 1 - f_1 - ... + f_1 q^-1 + ...

    Args:
        simulator: linear plant of one input with its data.
        element: name of the input element, of `INPUTS`; None: none.
        zone: whether the sensor has a zone.
        taps: number of taps f.
        lags: whether F is a first-order lag instead, with f_1 its pole.
        shaped: whether the left side of the zone has a slope of its own, and the edges are round.
    """

    first = 8
    last = 30
    gain = 1e-3
    has_level = True

    def __init__(
        self,
        simulator: PlantSimulator,
        element: str | None = None,
        zone: bool = False,
        taps: int = 0,
        lags: bool = False,
        shaped: bool = False,
    ) -> None:
        self.simulator = simulator
        self.u = simulator.data.u[:, 0]
        self.element = element
        self.zone = zone
        self.lags = lags
        self.shaped = shaped
        self.taps = 1 if lags else taps
        self.name = element or ("filtered zone" if zone else "filtered")
        self.base = simulator.layout.right
        self.input = PLAIN if element is None else INPUTS[element]
        self.inputs = slice(self.base, self.base + len(self.input.low))
        self.edges = slice(self.inputs.stop, self.inputs.stop + 2 * zone)
        self.shape = slice(self.edges.stop, self.edges.stop + 2 * shaped)
        self.filter = slice(self.shape.stop, self.shape.stop + self.taps)
        bounds = [*zip(self.input.low, self.input.high, strict=True), *[(0.0, WIDEST)] * 2 * zone]
        bounds += [(FLATTEST, 1 / FLATTEST), (SHARPEST, 1.0)] * shaped
        bounds += [(-0.9, 0.98)] * self.taps
        self.low, self.high = np.reshape(bounds, (-1, 2)).T
        self.free: Integers = np.arange(self.filter.stop)

    def along(self, data: RecordData) -> ChainModel:
        """Return the same model for other records."""
        own = self.simulator.simulator_along(data)
        taps = 0 if self.lags else self.taps
        return ChainModel(own, self.element, self.zone, taps, self.lags, self.shaped)

    def levels(self, theta: Floats) -> Floats:
        """Return d_r and d_l of the sensor's zone, else both halves of the input's gap (2)."""
        gap = np.repeat(theta[self.inputs][:1] / 2, 2)
        return theta[self.edges] if self.zone else np.asarray(gap)

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict the parameters of the elements to their bounds; theta is changed in place."""
        theta[self.base :] = np.clip(theta[self.base :], self.low, self.high)
        return theta

    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N); read-only."""
        return self.driven_plant(theta).simulate_z(theta[: self.base])

    def driven_plant(self, theta: Floats) -> PlantSimulator:
        """Return the linear plant driven by the output of the input element."""
        return self.simulator if self.element is None else self._plant_behind(theta[self.inputs])

    @cache_latest
    def _plant_behind(self, p: Floats) -> PlantSimulator:
        """Return the linear plant behind the input element with parameters p."""
        passed = self._pass_records(p)
        return self.simulator.simulator_along(self.simulator.data._replace(u=passed[:, None]))

    def _pass_records(self, p: Floats) -> Floats:
        """Return the input after the element with parameters p, which each record restarts (N)."""
        parts = self.simulator.records
        return np.concatenate([self.input.passes(self.u[part], p) for part in parts])

    def pass_input(self, u: Floats, theta: Floats) -> Floats:
        """Return u (N) after the element of the input (N)."""
        return self.input.passes(u, theta[self.inputs])

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z without noise (N)."""
        return self._filter(self._pass_zone(z, theta), theta)

    def _pass_zone(self, z: Floats, theta: Floats) -> Floats:
        """Return z after the zone of the sensor (N)."""
        if not self.zone:
            return z
        right, left = theta[self.edges]
        if not self.shaped:
            return dead_zone(z, right, left)
        slope, rounding = theta[self.shape]
        # softplus: ln(1 + e^x), a ramp with a round corner.
        right_ramp, left_ramp = np.logaddexp(0.0, [(z - right) / rounding, (-z - left) / rounding])
        return rounding * (right_ramp - slope * left_ramp)

    def _filter(self, columns: Floats, theta: Floats) -> Floats:
        """Return signals (N, or N x K) after the filter, which begins at rest at their first value.

        The filter is linear: derivatives pass it as the signal itself does.
        """
        if not self.taps:
            return columns
        f = theta[self.filter]
        filtered = np.empty(columns.shape)
        for part in self.simulator.data.record_slices():
            x = columns[part]
            if self.lags:
                filtered[part] = lag_columns(x, float(f[0]))
            else:
                padded = np.concatenate([np.repeat(x[:1], self.taps, axis=0), x])
                taps = np.append(1 - f.sum(), f)
                filtered[part] = lfilter(taps, [1.0], padded, axis=0)[self.taps :]
        return filtered

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free numbers (N x free).

        z is differentiated by the plant's numbers exactly, everything else by central differences.
        """
        z = self.output(theta)
        by_z = np.ones((1, 1))
        if self.zone:
            change = self._pass_zone(z + STEP, theta) - self._pass_zone(z - STEP, theta)
            by_z = change[:, None] / (2 * STEP)
        by_z_numbers = self._filter(by_z * self._gradient_of_z(theta, z), theta)
        places = np.arange(self.inputs.stop, self.filter.stop)
        steps = perturbation_steps(theta[places])
        points = perturb_each(theta, places, steps)
        y, *readings = (self.noise_free_readings(z, point) for point in points)
        by_sensor = central_differences(np.reshape(readings, (-1, z.size)), steps).T
        return y, np.hstack([by_z_numbers, by_sensor])[:, self.free]

    def _gradient_of_z(self, theta: Floats, z: Floats) -> Floats:
        """Return dz by the numbers of the plant and of the input element (N x both)."""
        by_plant = self.driven_plant(theta).z_gradient(theta, z)[:, : self.base]
        p = theta[self.inputs]
        steps = perturbation_steps(p)
        points = perturb_each(p, np.arange(p.size), steps)[1:]
        passed = np.reshape(list(map(self._pass_records, points)), (-1, z.size))
        # The plant is linear: the change of its input passes it.
        by_input = self.simulator.respond_from_rest(theta, central_differences(passed, steps).T)
        return np.hstack([by_plant, by_input])

    def class_word(self, theta: Floats) -> str:
        """Return the class of the verdict; negligible elements do not count.

        Args:
            theta: parameters of the fit (P).
        """
        if self.element in CURVES:
            return "none" if self._nonlinear_share(theta) < STRAIGHT else "input_curve"
        if self.element == "play":
            return "none" if theta[self.inputs][0] < VANISHING else "input_play"
        if self.element == "rate":
            effect = self.pass_input(self.u, theta) - self.u
            return "none" if effect.std() < STRAIGHT * self.u.std() else "input_rate"
        has_zone = self.zone and theta[self.edges].sum() > VANISHING * self.output(theta).std()
        if not has_zone:
            is_kinked = self.shaped and abs(math.log(theta[self.shape][0])) > STRAIGHT
            return "other" if is_kinked else "none"
        is_plain = False
        if self.shaped:
            slope, rounding = theta[self.shape]
            is_plain = abs(math.log(slope)) < STRAIGHT and abs(self.lag(theta)) < LATE
            is_plain &= rounding < ROUND * theta[self.edges].sum()
        return "dead_zone" if is_plain else "filtered_zone"

    def slope_inside(self, theta: Floats) -> float:
        """Return the slope in the middle of the zone over that outside: 0 if its edges are sharp.

        Edges that are rounder than the zone is wide leave a curve that is never silent.
        """
        if not self.shaped:
            return 0.0
        slope, rounding = theta[self.shape]
        right, left = expit(-theta[self.edges] / rounding)
        return float(2 * (right + slope * left) / (1 + slope))

    def is_at_bound(self, theta: Floats) -> bool:
        """Return whether a parameter of the input's element is at the end of its range.

        A curve is at its bound. A drive that hardly ever reaches its target acts as a relay.
        """
        if self.element == "rate":
            return float(np.mean(self.pass_input(self.u, theta) == self.u)) < SELDOM
        own = theta[self.inputs]
        near = np.minimum(own - self.input.low, self.input.high - own) < NEAR_BOUND
        return self.element in CURVES and bool(near.any())

    def distance_from_neutral(self, theta: Floats) -> Floats:
        """Return the distance of the input element's parameters from those of a linear input.

        Args:
            theta: its numbers.
        """
        neutral = self.input.neutral
        return theta[self.inputs][: len(neutral)] - neutral

    def lag(self, theta: Floats) -> float:
        """Return the mean delay of the filter behind the zone [samples]."""
        f = theta[self.filter]
        return float(f[0] / (1 - f[0]) if self.lags else f @ np.arange(1, self.taps + 1))

    def _nonlinear_share(self, theta: Floats) -> float:
        """Return the rms of the input's curve about its best line, over that of the curve [1]."""
        curve = self.pass_input(self.u, theta)
        line = np.polyval(np.polyfit(self.u, curve, 1), self.u)
        return float(np.std(curve - line) / max(curve.std(), 1e-12))

    def in_words(self, theta: Floats, u_scale: float, y_scale: float) -> str:
        """Describe the model with its parameters.

        Args:
            theta: parameters of the fit (P).
            u_scale: rms of u [u].
            y_scale: rms of y [y].
        """
        if self.element is not None:
            p = theta[self.inputs]
            return self.input.words.format(p=p, size=p[0] * u_scale, u_scale=u_scale)
        right, left = theta[self.edges] * y_scale
        late = f"behind it a filter that is late by {self.lag(theta):.2g} samples"
        if not self.shaped:
            return f"a dead zone of about {right:.3g} and {left:.3g}, and {late}"
        slope, rounding = theta[self.shape]
        if self.class_word(theta) == "other":
            return f"the sensor has {slope:.3g} times the slope below 0. No zone is needed"
        return (
            f"a dead zone whose left side has {slope:.3g} times the slope of its right, whose edges"
            f" are round over {rounding * y_scale:.3g}, and {late}"
        )


ChainFit = FittedModel[ChainModel]


def fit_chains(
    fit: ZoneFit, places: dict[str, PlaceFit], recorded: RecordData, orders: Sequence[int]
) -> Chains:
    """Fit every chain (input element, plant, zone, filter) and return the best of each class.

    The best one has the least BIC. A plant of several inputs has no chain.

    Args:
        fit: fit of a plant with a sensor zone to one record.
        places: fits of other models to the same record, by class.
        recorded: the same readings with the recorded input. The delay that was found for the
            zone's plant may be an effect of the element.
        orders: orders of plants for which the log has enough samples. The order of the fit and the
            next one are used, with the recorded input also the second next.
    """
    starts = PlaceStarts(fit)
    layout = starts.simulator.layout
    data = starts.simulator.data
    if layout.m > 1:
        return Chains({})
    kinds = [(data, n) for n in (layout.n, layout.n + 1)]
    same = recorded.y.size == data.y.size and np.array_equal(recorded.y, data.y)
    if same and not np.array_equal(recorded.u, data.u):
        kinds += [(recorded, n) for n in range(layout.n, layout.n + 3)]
    plants = [
        PlantSimulator(records, n, layout.integrators)
        for records, n in kinds
        if n in orders or n == layout.n
    ]
    fits: list[ChainFit | None] = []
    for name, element in INPUTS.items():
        fits.append(_fit_best_order(plants, element, partial(ChainModel, element=name)))
    taps = [[0.2, 0.2, 0.0, 0.0], [0.2] * TAPS]
    fits.append(_fit_best_order(plants, PLAIN, partial(ChainModel, taps=TAPS), taps))
    zoned = starts.plant
    widths = starts.widths
    if "dead_zone" in places:
        zone = places["dead_zone"]
        zoned = zone.theta[: layout.right]
        widths = zone.model.part_numbers(zone.theta, "sensor")
    zone_model = partial(ChainModel, starts.simulator, zone=True)
    behind = [(zone_model(lags=True), [[0.3], [0.7]]), (zone_model(taps=TAPS), taps)]
    if not data.silent_zeros:  # noise ahead of a zone makes its edges round as well
        width = widths.sum()
        shapes = [[1.0, 0.02 * width, 0.02], [1.0, 0.1 * width, 0.4]]
        behind.append((zone_model(lags=True, shaped=True), shapes))
    for model, ends in behind:
        points = [np.concatenate([zoned, widths, end]) for end in ends]
        fits.append(LeastSquares(model).fit_from_starts(points))
    by_word = best_of_each(filter(None, fits), lambda fit: fit.model.class_word(fit.theta))
    return Chains(by_word, None if data.silent_zeros else fits[-1])


class Chains(NamedTuple):
    """Fits of chains.

    Attributes:
        by_word: best fit of each class.
        shaped: fit of a zone with two slopes, round edges and a lag; None: not fitted.
    """

    by_word: dict[str, ChainFit]
    shaped: ChainFit | None = None


class ScannedStart(NamedTuple):
    """Start point of a fit.

    Attributes:
        cost: BIC of its linear plant.
        theta: the start point (P).
        scanned: its parameters of the element.
    """

    cost: float
    theta: Floats
    scanned: tuple[float, ...] = ()


def _scan_orders(
    plants: Sequence[PlantSimulator], element: InputElement
) -> list[list[ScannedStart]]:
    """Return the best parameters of a scan for each plant, those of one order begin the next.

    Args:
        plants: plants of rising order, those of the same records together.
        element: element of the input.
    """
    rows: list[list[ScannedStart]] = []
    for k, plant in enumerate(plants):
        tried = element
        if k and plants[k - 1].data is plant.data and rows[-1]:
            tried = element._replace(scanned=tuple(start.scanned for start in rows[-1]))
        rows.append(scan_input(plant, tried))
    return rows


def _fit_best_order(
    plants: Sequence[PlantSimulator],
    element: InputElement,
    model: Callable[[PlantSimulator], ChainModel],
    ends: Sequence[list[float]] = ([],),
) -> ChainFit | None:
    """Return the fit of the order whose scan has the least BIC, None without a start point.

    Args:
        plants: plants of several orders.
        element: element of the input that is scanned.
        model: function that builds the model of a plant.
        ends: filters that are appended to each start point.
    """
    scanned = _scan_orders(plants, element)
    costs = [(min(start.cost for start in row), k) for k, row in enumerate(scanned) if row]
    if not costs:
        return None
    best = min(costs)[1]
    pairs = itertools.product(scanned[best], ends)
    points = [np.append(start.theta, end) for start, end in pairs]
    return LeastSquares(model(plants[best])).fit_from_starts(points)


def find_input_zero(simulator: PlantSimulator) -> float:
    """Return the centre of a zone of the input, scaled; the median of the input without a zone.

    Args:
        simulator: linear plant of one input with its data.
    """
    edges = np.quantile(simulator.data.u[:, 0], np.linspace(0.05, 0.95, PLACES))
    pairs = tuple(itertools.combinations_with_replacement(edges.tolist(), 2))
    best = scan_input(simulator, InputElement(zone_of_input, (), (), pairs, ""), 1)
    return float(best[0].theta[-2:].mean()) if best else float(edges[PLACES // 2])


def scan_input(
    simulator: PlantSimulator, element: InputElement, count: int = 2
) -> list[ScannedStart]:
    """Return the best parameters of a scan, each with a linear plant behind the element.

    Args:
        simulator: linear plant with its data.
        element: element of the input.
        count: number of start points.
    """
    layout = simulator.layout
    data = simulator.data
    starts: list[ScannedStart] = []
    for numbers in element.scanned:
        v = element.passes(data.u[:, 0], np.array(numbers))
        scale = v.std()
        if not 1e-6 < scale < math.inf:
            continue
        passed = data._replace(u=(v / scale)[:, None], climbs=None)
        fit = fit_linear(PlantSimulator(passed, layout.n, layout.integrators), data.ok)
        theta = fit.theta[: layout.right].copy()
        theta[layout.numerators] /= scale
        starts.append(ScannedStart(fit.bic, np.append(theta, numbers), numbers))
    return sorted(starts, key=lambda start: start.cost)[:count]
