"""Records, a sampled plant A(q) z = B(q) u + x(0), and disturbances that pass the plant."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import toeplitz
from scipy.linalg.lapack import dgeev
from scipy.signal import lfilter

from undeadzone.util.arrays import Flags, Floats, Integers, shift_rows
from undeadzone_identify.models.estimates import CachedMaxima, cache_latest
from undeadzone_identify.models.likelihood import Readings

MANY = 10_000  # largest number of samples for methods that need many fits
STRETCH = 5_000  # samples of a stretch of a longer log
# A record must last for so many time constants of a pole. With x(0) a slower real pole equals an
# offset, and a slower oscillating pole a free sine.
SLOW = 6.0
RINGING = 0.5  # the same for oscillating poles
SLOWER = 1.2  # factor of these limits above which a pole certainly settles
FAR = 1e100  # largest coefficient of which roots are computed
CREDIBLE = 1.02  # an order is credible if its error is below so many times the least error
COLOURS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)  # correlations over one sample
RADIUS = 0.98  # largest absolute value of a pole at a start
LAGS = 60  # lags of an autocovariance
LENGTH = 16_000  # samples of a simulated disturbance
SETTLED = 500  # samples after which the transient of the plant has decayed

# --- Records


class RecordData(NamedTuple):
    """Records scaled to rms 1, in sequence.

    Attributes:
        u: inputs (N x m), rms 1 each.
        y: readings (N), rms 1, 0 if missing.
        ok: flags of the readings that are not missing (N).
        start: first sample of each record (R).
        side: +1, 0, -1 (N).
        silent_zeros: whether readings inside the zone are exact zeros: noise ahead of the zone.
        u_scale, y_scale: divisors of u (m) and y.
        climbs: cache of maxima on disk; None: none.
    """

    u: Floats
    y: Floats
    ok: Flags
    start: Integers
    side: Integers
    silent_zeros: bool
    u_scale: Floats
    y_scale: float
    climbs: CachedMaxima | None = None

    @property
    def input_scale(self) -> float:
        """Return the divisor of the first input."""
        return float(self.u_scale[0])

    def select_readings(self, use: Flags | None = None) -> Readings:
        """Return the readings for the likelihoods; `use` (N) flags the samples (None: all)."""
        ok = self.ok if use is None else self.ok & use
        before = np.concatenate([[False], ok[:-1]])
        before[self.start] = False
        return Readings(self.y, self.side, ok, before)

    def record_slices(self) -> list[slice]:
        """Return the slice of each record."""
        return list(map(slice, self.start.tolist(), [*self.start[1:].tolist(), self.y.size]))


def delay_inputs(data: RecordData, samples: int) -> RecordData:
    """Return the records with delayed inputs; unknown inputs are held.

    Args:
        data: the records.
        samples: delay [samples]; negative: an advance.
    """
    return data._replace(u=shift_rows(data.u, samples, data.start))


def busiest_stretches(data: RecordData, longest: int = STRETCH) -> RecordData:
    """Return the stretches of a log that pass the edges most often, `MANY` samples in all.

    A shorter log is returned unchanged.

    Args:
        data: the records.
        longest: largest number of samples of a stretch.
    """
    if data.y.size <= MANY:
        return data
    cut = (_cut_record(record, longest) for record in data.record_slices())
    stretches = sorted(itertools.chain(*cut), key=partial(_count_passages, data), reverse=True)
    samples = np.cumsum([stretch.stop - stretch.start for stretch in stretches])
    busiest = stretches[: max(1, int(np.count_nonzero(samples <= MANY)))]
    return select_samples(data, sorted(busiest, key=lambda stretch: stretch.start))


def _cut_record(record: slice, longest: int) -> list[slice]:
    """Cut a record into stretches of nearly equal length."""
    size = record.stop - record.start
    ends = np.linspace(record.start, record.stop, -(-size // longest) + 1).astype(int).tolist()
    return list(itertools.starmap(slice, itertools.pairwise(ends)))


def _count_passages(data: RecordData, part: slice) -> tuple[int, int]:
    """Count the passages of a stretch over its rarer edge, and over both edges."""
    side = data.side[part][data.ok[part]]
    right, left = (int(np.count_nonzero(np.diff(1 * (side == sign)) > 0)) for sign in (1, -1))
    return min(right, left), right + left


def select_samples(data: RecordData, parts: Sequence[slice]) -> RecordData:
    """Select samples of a log, each part as a separate record.

    Args:
        data: the records.
        parts: within records, in order.
    """
    rows = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    sizes = [part.stop - part.start for part in parts]
    return data._replace(
        u=data.u[rows],
        y=data.y[rows],
        ok=data.ok[rows],
        side=data.side[rows],
        start=np.cumsum([0, *sizes[:-1]]),
    )


def longest_record_of(data: RecordData) -> RecordData:
    """Return the longest record, or its busiest stretches if it is long.

    Args:
        data: the records.
    """
    longest = max(data.record_slices(), key=lambda part: part.stop - part.start)
    if longest.stop - longest.start < data.y.size:
        data = select_samples(data, [longest])
    return busiest_stretches(data, MANY)


# --- The plant


@dataclass(frozen=True)
class Layout:
    """Places of the parameters in theta.

    theta = [a, b, x0, d_r, d_l, log s].

    Attributes:
        n: number of poles, and of numerator terms of each input, from delay 1 on.
        m: number of inputs.
        records: number of records, each with n parameters for its initial state.
        integrators: number of known integrators; a contains the other poles.
    """

    n: int
    m: int
    records: int
    integrators: int = 0

    @cached_property
    def denominator(self) -> slice:
        """Return the places of the denominator's free coefficients a_1, a_2, ..."""
        return slice(0, self.n - self.integrators)

    @cached_property
    def numerators(self) -> slice:
        """Return the places of the numerators, input by input."""
        return slice(self.denominator.stop, self.denominator.stop + self.n * self.m)

    @cached_property
    def x0(self) -> slice:
        """Return the places of the initial states, record by record."""
        return slice(self.numerators.stop, self.numerators.stop + self.n * self.records)

    @cached_property
    def right(self) -> int:
        """Return the place of d_r; d_l and log s follow."""
        return self.x0.stop

    @cached_property
    def widths(self) -> slice:
        """Return the places of d_r and d_l."""
        return slice(self.right, self.right + 2)

    @cached_property
    def log_s(self) -> int:
        """Return the place of log s."""
        return self.right + 2

    def full_denominator(self, a: Floats) -> Floats:
        """Return the coefficients 1, a_1 to a_n of the denominator with its integrators (n + 1)."""
        coefficients = np.concatenate([[1.0], a])
        for _ in range(self.integrators):
            coefficients = np.convolve(coefficients, [1.0, -1.0])
        return coefficients

    @cached_property
    def parameter_count(self) -> int:
        """Return the number of parameters in theta."""
        return self.log_s + 1

    def at_rest(self, other: Layout, theta: Floats) -> Floats:
        """Return the parameters of the same plant along other records that begin at rest.

        Args:
            other: layout of theta.
            theta: a, b, x0, and further parameters.
        """
        x0 = np.zeros(self.n * self.records)
        return np.concatenate([theta[: other.numerators.stop], x0, theta[other.x0.stop :]])


class PlantSimulator:
    """Simulation of z and its gradient for a single order, with the lagged inputs cached.

    Args:
        data: the records.
        n: number of poles.
        integrators: number of integrators among them.
    """

    def __init__(self, data: RecordData, n: int, integrators: int = 0) -> None:
        self.data = data
        self.layout = Layout(n, data.u.shape[1], data.start.size, integrators)
        self.records = data.record_slices()
        self.longest = max(part.stop - part.start for part in self.records)
        self.lagged = self._lag_inputs(data.u)

    def _lag_inputs(self, u: Floats) -> Floats:
        """Return the last n samples of each input (N x m n), 0 before a record."""
        return np.vstack([delay_by_each(u[part], self.layout.n) for part in self.records])

    def simulator_along(self, data: RecordData) -> PlantSimulator:
        """Return the same plant along other records."""
        return PlantSimulator(data, self.layout.n, self.layout.integrators)

    def simulate_z(self, theta: Floats) -> Floats:
        """Simulate z (N) for theta, of which the plant's parameters come first; read-only."""
        return self._simulate_plant(theta[: self.layout.right])

    @cache_latest
    def _simulate_plant(self, theta: Floats) -> Floats:
        """Simulate z (N) for the plant's parameters; the latest result is cached."""
        layout = self.layout
        denominator = layout.full_denominator(theta[layout.denominator])
        x0 = theta[layout.x0].reshape(layout.records, layout.n)
        z = self.lagged @ theta[layout.numerators]  # B(q) u; filtered by 1 / A(q) in place below
        for part, state in zip(self.records, x0, strict=True):
            own = z[part]
            own[: layout.n] += state[: own.size]
            own[:] = lfilter([1.0], denominator, own)
        z.flags.writeable = False
        return z

    def z_gradient(self, theta: Floats, z: Floats) -> Floats:
        """Return the exact dz/dtheta (N x P).

        Since A(q) z = B(q) u + x(0), the derivatives are delayed copies of z / A, u / A and of the
        impulse response of 1 / A.
        """
        layout = self.layout
        own = np.append(1.0, theta[layout.denominator])
        denominator = layout.full_denominator(theta[layout.denominator])
        slopes = np.zeros((z.size, layout.parameter_count))
        states = np.split(np.r_[layout.x0], layout.records)
        for state, part in zip(states, self.records, strict=True):
            by_a = lfilter([1.0], own, z[part, None], axis=0)
            by_u = lfilter([1.0], denominator, self.data.u[part], axis=0)
            impulse = lfilter([1.0], denominator, np.eye(1, len(by_a))[0])
            slopes[part, layout.denominator] = -delay_by_each(by_a, layout.denominator.stop)
            slopes[part, layout.numerators] = delay_by_each(by_u, layout.n)
            slopes[part, state] = toeplitz(impulse, np.zeros(layout.n))
        return slopes

    def respond_from_rest(self, theta: Floats, inputs: Floats) -> Floats:
        """Return the responses of the plant to several signals at its first input, from rest
        (N x K).
        """
        numerator = np.append(0.0, theta[self.layout.numerators][: self.layout.n])
        denominator = self.layout.full_denominator(theta[self.layout.denominator])
        outputs = [lfilter(numerator, denominator, inputs[part], axis=0) for part in self.records]
        return np.concatenate(outputs)

    def dc_gain(self, theta: Floats) -> Floats:
        """Return the DC gain from each input to z, or to the integrators if there are any (m)."""
        layout = self.layout
        numerators = theta[layout.numerators].reshape(layout.m, layout.n)
        return numerators.sum(axis=1) / (1 + theta[layout.denominator].sum())

    def plant_poles(self, theta: Floats) -> Any:
        """Return the poles of the sampled plant (n), complex; integrators last."""
        poles = polynomial_roots(theta[self.layout.denominator])
        return np.append(poles, np.ones(self.layout.integrators))

    def has_settling_poles(self, theta: Floats, margin: float = 1.0) -> bool:
        """Return whether the poles are stable and settle within the longest record.

        Args:
            theta: parameters, a first (P).
            margin: factor of the time constants that a record must last.
        """
        if not np.isfinite(theta).all():
            return False
        poles = polynomial_roots(theta[self.layout.denominator])
        slow = np.abs(np.angle(poles)) < 4 * math.pi / self.longest
        limits = 1 - margin * np.where(slow, SLOW, RINGING) / self.longest
        return bool(np.all(np.abs(poles) < limits))

    def is_at_limit(self, theta: Floats) -> bool:
        """Return whether a pole is so slow that with x(0) it equals an offset or a sine."""
        return not self.has_settling_poles(theta, SLOWER)

    def settling_constants(self, theta: Floats) -> float:
        """Return the longest record's duration in time constants of the slowest pole [1]."""
        slowest = np.abs(polynomial_roots(theta[self.layout.denominator])).max(initial=1e-300)
        return float(-np.log(slowest) * self.longest)


def delay_by_each(signals: Floats, count: int) -> Floats:
    """Return each signal (N x K) delayed by 1 to `count` samples, from rest (N x count K)."""
    return np.hstack([toeplitz(np.append(0.0, x[:-1]), np.zeros(count)) for x in signals.T])


def polynomial_roots(a: Floats) -> Any:
    """Return the roots of z^n + a_1 z^(n-1) + ... + a_n (n), complex if needed.

    Args:
        a: coefficients (n). If they are not finite, or too large, all roots are infinite.
    """
    if not a.size or not np.abs(a).max() < FAR:
        return np.full(a.size, np.inf)
    companion = np.eye(a.size, k=-1)
    companion[0] = -a
    real, imaginary, *_, failed = dgeev(companion, compute_vl=False, compute_vr=False)
    roots = real + 1j * imaginary if imaginary.any() else real
    return np.full(a.size, np.inf) if failed else roots


def stabilise_poles(a: Floats) -> Floats:
    """Return denominator coefficients (n) with poles beyond RADIUS moved to it."""
    poles = polynomial_roots(a)
    if not np.isfinite(poles).all():
        return np.zeros(a.size)
    size = np.abs(poles)
    stable = np.where(size > RADIUS, poles / np.maximum(size, 1e-12) * RADIUS, poles)
    return np.atleast_1d(np.real(np.poly(stable)))[1:]


# --- Noise through the plant


class InputDisturbance(NamedTuple):
    """First-order disturbance at the plant's first input.

    Attributes:
        rms: rms of its response at z, in the scale of the fit.
        phi: its correlation over one sample [1].
        at_input: its rms at the input.
    """

    rms: float
    phi: float
    at_input: float


def find_input_disturbance(
    layout: Layout, plant: Floats, residual: Floats, ok: Flags
) -> InputDisturbance:
    """Find the first-order input disturbance whose response matches the residual.

    The autocovariance of its response at z is fitted to that of the residual by least squares.
    Lag 0 is left out, since it contains the white noise of the readings.

    Args:
        layout: layout of the parameters.
        plant: parameters a, b, ...
        residual: readings less simulation (N); 0 if a reading is missing.
        ok: flags of the readings that are not missing (N).
    """
    lags = max(2, min(LAGS, residual.size // 10))
    measured = mean_lag_products(residual, ok, lags)[1:]
    found = []
    for phi in COLOURS:
        w = plant_response(layout, plant, first_order_noise(1, LENGTH, phi))[0]
        whole, *own = mean_lag_products(w, np.ones(w.size, bool), lags)
        shape = np.array(own)
        power = max(float(shape @ measured) / max(float(shape @ shape), 1e-300), 0.0)
        misfit = np.sum((measured - power * shape) ** 2)
        found.append((misfit, InputDisturbance(math.sqrt(power * whole), phi, math.sqrt(power))))
    return min(found)[1]


def mean_lag_products(e: Floats, ok: Flags, lags: int) -> Floats:
    """Return `lag_products` divided by the number of readings (lags)."""
    return np.array(lag_products(e, ok, lags)) / max(int(ok.sum()), 1)


def lag_products(e: Floats, ok: Flags, lags: int) -> list[float]:
    """Return the products of e, less its mean, with itself at lags 0 to lags - 1."""
    centred = np.where(ok, e - e[ok].mean(), 0.0)
    return [float(centred[lag:] @ centred[: e.size - lag]) for lag in range(lags)]


def first_order_noise(runs: int, size: int, phi: float) -> Floats:
    """Return first-order noise of rms 1, equal draws for every phi (runs x (size + SETTLED))."""
    draws = np.random.default_rng(0).standard_normal((runs, size + SETTLED))
    return lfilter([math.sqrt(1 - phi**2)], [1.0, -phi], draws, axis=1)


def plant_response(layout: Layout, plant: Floats, noise: Floats) -> Floats:
    """Return the plant's response to noise at its first input (runs x size), settled."""
    numerator = np.append(0.0, plant[layout.numerators][: layout.n])
    denominator = layout.full_denominator(plant[layout.denominator])
    return lfilter(numerator, denominator, noise, axis=1)[:, SETTLED:]


def input_noise_gain(a: Floats, b: Floats, n: int, phi: float) -> float:
    """Return the noise power gain: the variance at z by first-order noise of rms 1 at each input.

    It is the sum of squares of the impulse response from the noise's white source to z.

    Args:
        a: denominator a_1, a_2, ...
        b: numerators from delay 1, input by input (m n).
        n: order.
        phi: correlation of the noise over one sample.

    Returns:
        The gain, at least 1e-12 [z^2/u^2].
    """
    shaped = math.sqrt(1 - phi * phi) * phi ** np.arange(5000)  # the response is cut off there
    numerators = np.hstack([np.zeros((b.size // n, 1)), b.reshape(-1, n)])
    responses = [lfilter(one, np.append(1.0, a), shaped) for one in numerators]
    return max(float(np.sum(np.square(responses))), 1e-12)
