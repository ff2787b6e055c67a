"""A plant between elements: a curve or a play of its input, a zone and a filter behind it.

y = F(q) Dz(G(q) g(u; p)) + level. What an element of the input passes is known for every p, so a
scan of p with a linear plant behind each finds where a climb begins. These are everyday truths
beside a dead zone: a fan's torque goes by u |u|, a damper's linkage plays, a load cell's converter
averages. A curve has neither widths nor an inverse.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from undeadzone.nonlinearities.play import levels
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.elements import best_of_each
from undeadzone_identify.models.estimates import cache_latest
from undeadzone_identify.models.least_squares import FittedModel, LeastSquares
from undeadzone_identify.models.likelihood import dead_zone
from undeadzone_identify.models.place import PlaceFit, PlaceStarts
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.models.zone_fit import ZoneFit, fit_linear

TAPS = 4  # of a filter behind the zone, beside the first
WIDEST = 6.0  # rms of z, that an edge is away at most
VANISHING = 0.01  # rms of its signal, below which an element counts for none
STRAIGHT = 0.05  # rms of a curve, below which its part beyond a line counts for none
FLATTEST = 0.1  # slope of one side over the other's, at least
SHARPEST = 1e-4  # rms of z, over which an edge is round at least
ROUND = 0.02  # of the zone's width, below which a round edge counts for a sharp one
PLACES = 13  # of an edge, that are tried where a zone of the input is not about 0
LATE = 0.05  # samples, below which a lag counts for none
NEAR_BOUND = 1e-3  # of a curve's number, from which it lies at its bound
STEP = 1e-5  # of a number, for differences


class InputElement(NamedTuple):
    """An element of the input.

    Attributes:
        passes: its output by u (N) and its numbers.
        low, high: bounds of the numbers.
        scanned: numbers that are tried first, a linear plant behind each.
        words: how it reads with its numbers.
        neutral: numbers with which it passes a multiple of u; none if no finite ones do.
    """

    passes: Callable[[Floats, Floats], Floats]
    low: tuple[float, ...]
    high: tuple[float, ...]
    scanned: tuple[tuple[float, ...], ...]
    words: str
    neutral: tuple[float, ...] = ()


def power_of_input(u: Floats, p: Floats) -> Floats:
    """Return sign(u) |u|^p."""
    return np.asarray(np.sign(u) * np.abs(u) ** p[0])


def cubic_of_input(u: Floats, p: Floats) -> Floats:
    """Return u + p_0 u^2 + p_1 u^3."""
    return u + p[0] * u * u + p[1] * u**3


def exponential_of_input(u: Floats, p: Floats) -> Floats:
    """Return (exp(p u) - 1) / p."""
    rate = p[0] if abs(p[0]) > 1e-6 else 1e-6
    return np.asarray(np.expm1(np.clip(rate * u, -50.0, 50.0)) / rate)


def play_of_input(u: Floats, p: Floats) -> Floats:
    """Return u behind a play of gap p, at first without contact."""
    half = p[:1] / 2
    return np.asarray(levels(u[:, None], half, half, u[:1])[:, 0])


def rate_of_input(u: Floats, p: Floats) -> Floats:
    """Return u behind a limit of its rate, p a sample."""
    return limit_rate(u, float(p[0]))


def limit_rate(u: Floats, most: float) -> Floats:
    """Return a signal (N) behind a limit of its rate, so much a sample."""
    out, at = np.empty(u.size), float(u[0])
    for k, value in enumerate(u.tolist()):
        at = min(max(value, at - most), at + most)
        out[k] = at
    return out


INPUTS = {
    "power": InputElement(
        power_of_input,
        (0.2,),
        (4.0,),
        ((0.5,), (1.5,), (2.0,), (3.0,)),
        "sign(u) |u|^{0:.2g}",
        (1.0,),
    ),
    "cubic": InputElement(
        cubic_of_input,
        (-3.0, -3.0),
        (3.0, 3.0),
        ((0.0, 0.1), (0.0, 0.5), (0.3, 0.1), (-0.3, 0.1)),
        "u {0:+.2g} u^2 {1:+.2g} u^3",
        (0.0, 0.0),
    ),
    "exponential": InputElement(
        exponential_of_input,
        (-3.0,),
        (3.0,),
        ((0.4,), (1.0,), (-0.4,), (-1.0,)),
        "exp({0:.2g} u)",
        (0.0,),
    ),
    "rate": InputElement(
        rate_of_input, (1e-3,), (4.0,), tuple((most,) for most in (0.02, 0.05, 0.12, 0.3)), ""
    ),
    "play": InputElement(
        play_of_input,
        (0.0,),
        (8.0,),
        tuple((gap,) for gap in (0.1, 0.25, 0.5, 0.9, 1.4, 2)),
        "",
        (0.0,),
    ),
}


def zone_of_input(u: Floats, p: Floats) -> Floats:
    """Return the parts of u above p_1 and below p_0."""
    return np.asarray(np.maximum(u - p[1], 0.0) + np.minimum(u - p[0], 0.0))


PLAIN = InputElement(lambda u, _: u, (), (), ((),), "u")
CURVES = ("power", "cubic", "exponential")


class ChainModel:
    """y on F(q) Dz(G(q) g(u; p)), with differences.

    theta = [a, b, x0, p, d_r, d_l, slope, rounding, f_1 ...]; F = 1 - f_1 - ... + f_1 q^-1 + ...

    Args:
        simulator: the plant, of one input, with its data.
        element: of the input, of `INPUTS`; None: there is none.
        zone: whether there is a zone of the sensor.
        taps: how many f there are.
        lags: whether F is a lag of first order instead, and f_1 its pole.
        shaped: whether the zone's left side has a slope of its own, and its edges are round.
    """

    first, last, gain, has_level = 8, 30, 1e-3, True

    def __init__(
        self,
        simulator: PlantSimulator,
        element: str | None = None,
        zone: bool = False,
        taps: int = 0,
        lags: bool = False,
        shaped: bool = False,
    ) -> None:
        self.simulator, self.element, self.zone, self.lags = simulator, element, zone, lags
        self.shaped = shaped
        self.taps = 1 if lags else taps
        self.name = element or ("filtered zone" if zone else "filtered")
        self.base = simulator.layout.right
        own = INPUTS[element] if element is not None else None
        low, high = (own.low, own.high) if own is not None else ((), ())
        self.inputs = slice(self.base, self.base + len(low))
        self.edges = slice(self.inputs.stop, self.inputs.stop + 2 * zone)
        self.shape = slice(self.edges.stop, self.edges.stop + 2 * shaped)
        self.filter = slice(self.shape.stop, self.shape.stop + self.taps)
        least, most = (FLATTEST, SHARPEST), (1 / FLATTEST, 1.0)
        self.low = np.array([*low, *([0.0] * 2 * zone), *least * shaped, *([-0.9] * self.taps)])
        self.high = np.array([*high, *([WIDEST] * 2 * zone), *most * shaped, *([0.98] * self.taps)])
        self.free: Integers = np.arange(self.filter.stop)

    def along(self, data: RecordData) -> ChainModel:
        """Return the same model for other records."""
        own = self.simulator.simulator_along(data)
        taps = 0 if self.lags else self.taps
        return ChainModel(own, self.element, self.zone, taps, self.lags, self.shaped)

    def levels(self, theta: Floats) -> Floats:
        """Return the sensor's widths, or half the gap at the input on either side (2)."""
        gap = np.repeat(theta[self.inputs][:1] / 2, 2)
        return theta[self.edges] if self.zone else np.asarray(gap)

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Return numbers of the elements within their bounds."""
        theta[self.base :] = np.clip(theta[self.base :], self.low, self.high)
        return theta

    @cache_latest
    def output(self, theta: Floats) -> Floats:
        """Return z, the output of the plant (N)."""
        return self._simulate(theta)

    def _simulate(self, theta: Floats) -> Floats:
        """Return z of any numbers (N)."""
        layout, u = self.simulator.layout, self.simulator.data.u[:, 0]
        numerator = np.append(0.0, theta[layout.numerators])
        denominator = layout.full_denominator(theta[layout.denominator])
        starts = theta[layout.x0].reshape(layout.records, layout.n)
        z = np.empty(u.size)
        for part, start in zip(self.simulator.records, starts, strict=True):
            driven = lfilter(numerator, [1.0], self.pass_input(u[part], theta))
            driven[: layout.n] += start[: driven.size]
            z[part] = lfilter([1.0], denominator, driven)
        return z

    def pass_input(self, u: Floats, theta: Floats) -> Floats:
        """Return u behind the element of the input (N)."""
        return u if self.element is None else INPUTS[self.element].passes(u, theta[self.inputs])

    def driven_plant(self, theta: Floats) -> PlantSimulator:
        """Return the linear plant alone, driven by u behind the element of the input."""
        data = self.simulator.data
        parts = [self.pass_input(data.u[part, 0], theta) for part in self.simulator.records]
        return self.simulator.simulator_along(data._replace(u=np.concatenate(parts)[:, None]))

    def noise_free_readings(self, z: Floats, theta: Floats) -> Floats:
        """Return the readings of z without noise (N)."""
        y = z
        if self.shaped:
            (right, left), (slope, rounding) = theta[self.edges], theta[self.shape]
            up, down = np.logaddexp(0.0, [(z - right) / rounding, (-z - left) / rounding])
            y = np.asarray(rounding * (up - slope * down))
        elif self.zone:
            y = dead_zone(z, *theta[self.edges])
        if not self.taps:
            return y
        f, out = theta[self.filter], np.empty(y.size)
        for part in self.simulator.data.record_slices():
            if self.lags:
                keep = float(f[0])
                out[part] = lfilter([1 - keep], [1.0, -keep], y[part], zi=[keep * y[part][0]])[0]
            else:
                longer = np.append(np.full(self.taps, y[part][0]), y[part])
                out[part] = lfilter(np.append(1 - f.sum(), f), [1.0], longer)[self.taps :]
        return out

    def slopes(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the readings (N), and their derivatives by the free numbers (N x free)."""
        y = self.noise_free_readings(self.output(theta), theta)
        rows = np.empty((y.size, self.free.size))
        for column, place in enumerate(self.free):
            step = STEP * max(abs(theta[place]), 0.02)
            more, less = theta.copy(), theta.copy()
            more[place] += step
            less[place] -= step
            apart = self.noise_free_readings(self._simulate(more), more)
            rows[:, column] = (apart - self.noise_free_readings(self._simulate(less), less)) / (
                2 * step
            )
        return y, rows

    def class_word(self, theta: Floats) -> str:
        """Return the verdict's word; an element that vanishes counts for none.

        Args:
            theta: its numbers.
        """
        if self.element in CURVES:
            return "none" if self._bend(theta) < STRAIGHT else "input_curve"
        if self.element == "play":
            return "none" if theta[self.inputs][0] < VANISHING else "input_play"
        if self.element == "rate":
            u = self.simulator.data.u[:, 0]
            late = self.pass_input(u, theta) - u
            return "none" if late.std() < STRAIGHT * u.std() else "input_rate"
        is_there = self.zone and theta[self.edges].sum() > VANISHING * self.output(theta).std()
        if not is_there:
            return "none"
        is_plain = False
        if self.shaped:
            slope, rounding = theta[self.shape]
            is_plain = abs(math.log(slope)) < STRAIGHT and abs(self.lag(theta)) < LATE
            is_plain &= rounding < ROUND * theta[self.edges].sum()
        return "dead_zone" if is_plain else "filtered_zone"

    def has_curve_at_bound(self, theta: Floats) -> bool:
        """Return whether the curve of the input lies at the end of those that were tried."""
        own, count = theta[self.inputs], self.inputs.stop - self.inputs.start
        near = np.minimum(own - self.low[:count], self.high[:count] - own) < NEAR_BOUND
        return self.element in CURVES and bool(near.any())

    def distance_from_neutral(self, theta: Floats) -> Floats:
        """Return how far the numbers of the input's element are from those that leave u as it is.

        Args:
            theta: its numbers.
        """
        neutral = INPUTS[self.element].neutral if self.element is not None else ()
        return theta[self.inputs][: len(neutral)] - neutral

    def lag(self, theta: Floats) -> float:
        """Return by how much the filter behind the zone is late [samples]."""
        f = theta[self.filter]
        return float(f[0] / (1 - f[0]) if self.lags else f @ np.arange(1, self.taps + 1))

    def _bend(self, theta: Floats) -> float:
        """Return the rms of the curve about its best line, in the curve's rms."""
        u = self.simulator.data.u[:, 0]
        curve = INPUTS[str(self.element)].passes(u, theta[self.inputs])
        line = np.polyval(np.polyfit(u, curve, 1), u)
        return float(np.std(curve - line) / max(float(curve.std()), 1e-12))

    def in_words(self, theta: Floats, u_scale: float, y_scale: float) -> str:
        """Describe the model with its numbers.

        Args:
            theta: its numbers.
            u_scale: rms of u [u].
            y_scale: rms of y [y].
        """
        if self.element in CURVES:
            shape = INPUTS[str(self.element)].words.format(*theta[self.inputs])
            of = "" if self.element == "power" else f", u over {u_scale:.4g}"
            return f"the input acts by a smooth curve ({shape} fits{of}); no zone is needed"
        if self.element == "play":
            gap = theta[self.inputs][0] * u_scale
            return f"play between input and plant, ahead of its lags, explains the log: {gap:.4g}"
        if self.element == "rate":
            most = theta[self.inputs][0] * u_scale
            return f"the drive follows the input by at most {most:.4g} a sample"
        right, left = theta[self.edges] * y_scale
        late = f"behind it a filter that is late by {self.lag(theta):.2g} samples"
        if not self.shaped:
            return f"a dead zone of about {right:.3g} and {left:.3g}, and {late}"
        slope, rounding = theta[self.shape]
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
        fit: plant and sensor zone of one record.
        places: other models of the same record, by class.
        recorded: the same readings with the input as it was recorded, since the delay of the zone's
            plant may be that of an element.
        orders: of plants that the log is long enough for. The fit's order and the next are tried,
            with the recorded input two higher ones.
    """
    starts = PlaceStarts(fit)
    layout, data = starts.simulator.layout, starts.simulator.data
    if layout.m > 1:
        return Chains({})
    kinds = [(data, n) for n in (layout.n, layout.n + 1)]
    same = recorded.y.size == data.y.size and np.array_equal(recorded.y, data.y)
    if same and not np.array_equal(recorded.u, data.u):
        kinds += [(recorded, n) for n in range(layout.n, layout.n + 3)]
    plants = [
        PlantSimulator(one, n, layout.integrators)
        for one, n in kinds
        if n in orders or n == layout.n
    ]
    fits: list[ChainFit | None] = []
    for name, element in INPUTS.items():
        scanned = [scan_input(plant, element) for plant in plants]
        fits.append(_best_order(plants, scanned, partial(_model_of, name)))
    plain = [scan_input(plant, PLAIN) for plant in plants]
    taps = [np.array(one) for one in ([0.2, 0.2, 0.0, 0.0], [0.2] * TAPS)]
    longer = [_with_taps(row, taps) for row in plain]
    fits.append(_best_order(plants, longer, lambda one: ChainModel(one, taps=TAPS)))
    zoned, widths = starts.plant, starts.widths
    if "dead_zone" in places:
        known = places["dead_zone"]
        zoned, widths = known.theta[: layout.right], known.model.part_numbers(known.theta, "sensor")
    lag = ChainModel(starts.simulator, zone=True, lags=True)
    begun = [np.concatenate([zoned, widths, [pole]]) for pole in (0.3, 0.7)]
    fits.append(LeastSquares(lag).fit_from_starts(begun))
    filtered = ChainModel(starts.simulator, zone=True, taps=TAPS)
    fits.append(
        LeastSquares(filtered).fit_from_starts([np.concatenate([zoned, widths, f]) for f in taps])
    )
    shape = None
    if not data.silent_zeros:  # noise ahead of a zone rounds it, too
        squares = LeastSquares(ChainModel(starts.simulator, zone=True, lags=True, shaped=True))
        own = [[1.0, part * widths.sum(), pole] for part, pole in ((0.02, 0.02), (0.1, 0.4))]
        shape = squares.fit_from_starts([np.concatenate([zoned, widths, one]) for one in own])
    there = [one for one in (*fits, shape) if one is not None]
    rows = ((one.model.class_word(one.theta), one.density.bic, one) for one in there)
    return Chains(best_of_each(rows), shape)


class Chains(NamedTuple):
    """Fits of chains.

    Attributes:
        by_word: the best of each word.
        shaped: a zone with slopes of its sides, round edges and a lag; None: not asked.
    """

    by_word: dict[str, ChainFit]
    shaped: ChainFit | None = None


def _model_of(name: str, simulator: PlantSimulator) -> ChainModel:
    """Return a plant behind an element of the input."""
    return ChainModel(simulator, name)


def _with_taps(starts: Sequence[Begun], taps: Sequence[Floats]) -> list[Begun]:
    """Return each start with each of the filters behind the zone."""
    pairs = itertools.product(starts, taps)
    return [Begun(one.cost, np.append(one.theta, filtered)) for one, filtered in pairs]


class Begun(NamedTuple):
    """Where a climb begins, and BIC of the linear plant there."""

    cost: float
    theta: Floats


def _best_order(
    plants: Sequence[PlantSimulator],
    scanned: Sequence[Sequence[Begun]],
    model: Callable[[PlantSimulator], ChainModel],
) -> ChainFit | None:
    """Return the fit behind the plant whose scan leaves least."""
    there = [(min(one.cost for one in row), k) for k, row in enumerate(scanned) if row]
    if not there:
        return None
    best = min(there)[1]
    return LeastSquares(model(plants[best])).fit_from_starts([one.theta for one in scanned[best]])


def find_input_zero(simulator: PlantSimulator) -> float:
    """Return the middle of a zone of the input at any place, or the median without one, scaled.

    Args:
        simulator: the plant, of one input, with its data.
    """
    places = np.quantile(simulator.data.u[:, 0], np.linspace(0.05, 0.95, PLACES))
    pairs = tuple(itertools.combinations_with_replacement(places.tolist(), 2))
    best = scan_input(simulator, InputElement(zone_of_input, (), (), pairs, ""), 1)
    return float(best[0].theta[-2:].mean()) if best else float(places[PLACES // 2])


def scan_input(simulator: PlantSimulator, element: InputElement, most: int = 2) -> list[Begun]:
    """Return where climbs begin: the best numbers of a scan, with the linear plant behind each.

    Args:
        simulator: the plant, with its data.
        element: of the input.
        most: how many.
    """
    layout, data, found = simulator.layout, simulator.data, list[Begun]()
    for numbers in element.scanned:
        v = element.passes(data.u[:, 0], np.array(numbers))
        scale = float(v.std())
        if not 1e-6 < scale < math.inf:
            continue
        passed = data._replace(u=(v / scale)[:, None], climbs=None)
        fit = fit_linear(PlantSimulator(passed, layout.n, layout.integrators), data.ok)
        theta = fit.theta[: layout.right].copy()
        theta[layout.numerators] /= scale
        found.append(Begun(fit.bic, np.append(theta, numbers)))
    return sorted(found, key=lambda one: one.cost)[:most]
