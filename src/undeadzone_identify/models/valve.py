"""A valve that sticks, or has play, ahead of a plant in a control loop.

The valve's position v follows the controller's output u through a dead band and stick band S and a
slip jump J; J = 0 is a play of width S. In a loop u answers to y, so that simulation errors favour
whatever resembles the disturbance. Errors of prediction one step ahead do not, as long as the plant
is late by a sample: y is regressed on its own past and on past positions. What an oscillation from
outside leaves, and a linear loop near its limit, look alike and are asked beside it.

References:
    M. Kano and others (2004), IFAC World Congress
    Q. P. He and others (2007), doi:10.1021/ie061219a
    M. A. A. S. Choudhury, N. F. Thornhill, S. L. Shah (2005), doi:10.1016/j.conengprac.2004.05.005
    N. F. Thornhill, B. Huang, H. Zhang (2003), doi:10.1016/S0959-1524(02)00029-7
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.models.estimates import Interval, cosine_coefficients
from undeadzone_identify.models.least_squares import Density

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24)  # readings before one that foretell it
MORE = 3  # lags of the position beyond those of the reading
LATEST = 30  # samples that a plant may be late
HARMONICS = (1, 2, 3)  # of an oscillation from outside
BREAKS = 2  # numbers that the breaks of a valve cost besides
WIDTHS = np.geomspace(0.005, 1.0, 60)  # S, of the range of u
RATIOS = (0.08, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.2)  # J / S
LARGEST = 1.6  # J / S at most
KANO, HE = "Kano", "He"
ROUNDS, TOPS = 3, 8  # refinements, and grid points that they begin with
PAIRS = 600  # S, J around the best, for the interval
DROP = 1.92  # of a log likelihood: half of the 95 % quantile of chi2
SCATTER = 2.0  # long-run deviations of a loss that count for nothing
CHUNK = 48  # positions that are regressed at once


def valve_positions(u: Floats, stick: Floats, jump: Floats, account: str) -> Floats:
    """Return the positions of valves along an input (N x K).

    Args:
        u: output of the controller (N).
        stick: S of each valve (K) [u].
        jump: J of each valve (K) [u].
        account: whether it slides on after a jump (Kano), or sticks at every sample (He).
    """
    return (_slide_on if account == KANO else _stick_again)(u, stick, jump)


def _slide_on(u: Floats, stick: Floats, jump: Floats) -> Floats:
    """Return positions that slide until u turns or stands still (N x K)."""
    position, rested_at = np.full(stick.size, u[0]), np.full(stick.size, u[0])
    direction, rests = np.zeros(stick.size), np.ones(stick.size, bool)
    out = np.empty((u.size, stick.size))
    out[0] = position
    lost, first = (stick - jump) / 2, (stick + jump) / 2
    for t in range(1, u.size):
        stops = ~rests & (direction * (u[t] - u[t - 1]) <= 0)
        rested_at = np.where(stops, u[t - 1], rested_at)
        rests |= stops
        away = u[t] - rested_at
        back, begins = -direction * away > stick, (direction == 0) & (np.abs(away) > first)
        goes = rests & (back | (direction * away > jump) | begins)
        turned = np.where(goes & back, -direction, direction)
        direction = np.where(goes & begins, np.sign(away), turned)
        rests &= ~goes
        position = np.where(rests, position, u[t] - direction * lost)
        out[t] = position
    return out


def _stick_again(u: Floats, stick: Floats, jump: Floats) -> Floats:
    """Return positions of valves whose friction is static at every sample (N x K)."""
    position, left = np.full(stick.size, u[0]), np.zeros(stick.size)
    out = np.empty((u.size, stick.size))
    out[0] = position
    static, kinetic = (stick + jump) / 2, (stick - jump) / 2
    for t in range(1, u.size):
        push = left + (u[t] - u[t - 1])
        kept = np.where(np.abs(push) > static, np.sign(push) * kinetic, push)
        position = np.where(np.abs(push) > static, position + push - kept, position)
        left = kept
        out[t] = position
    return out


class Regression:
    """Readings regressed on a constant and their past; the rest is asked of positions.

    Args:
        y: readings (N).
        ok: whether there is a reading (N).
        order: readings before one that foretell it.
        first: first sample that counts.
    """

    def __init__(self, y: Floats, ok: Flags, order: int, first: int) -> None:
        whole = ok[first:].copy()
        for k in range(1, order + 1):
            whole &= ok[first - k : y.size - k]
        self.rows: Integers = first + np.flatnonzero(whole)
        self.order = order
        self.past = np.column_stack([y[self.rows - k] for k in range(1, order + 1)])
        self.y = y[self.rows]
        own = np.column_stack([np.ones(self.rows.size), self.past])
        self._basis = np.linalg.qr(own)[0]
        self._left = self._without_past(self.y)

    def _without_past(self, columns: Floats) -> Floats:
        """Return what the constant and the past leave of columns."""
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))

    def lagged(self, v: Floats, lags: range) -> Floats:
        """Return a position at lags (n x L)."""
        return np.column_stack([v[self.rows - k] for k in lags])

    def errors(self, v: Floats, lags: range, more: Floats | None = None) -> Floats:
        """Return prediction errors behind one position, perhaps with more columns (n).

        Args:
            v: the position (N).
            lags: of it.
            more: columns (N x M).
        """
        columns = self.lagged(v, lags)
        if more is not None:
            columns = np.hstack([columns, more[self.rows]])
        columns = self._without_past(columns)
        return np.asarray(
            self._left - columns @ np.linalg.lstsq(columns, self._left, rcond=1e-9)[0]
        )

    def errors_of_each(self, v: Floats, lags: range) -> Floats:
        """Return prediction errors behind each of many positions (n x K).

        Args:
            v: the positions (N x K).
            lags: of each.
        """
        out = np.empty((self.rows.size, v.shape[1]))
        for begin in range(0, v.shape[1], CHUNK):
            part = v[:, begin : begin + CHUNK]
            columns = np.stack([part[self.rows - k] for k in lags], axis=2)
            flat = self._without_past(columns.reshape(len(columns), -1))
            each = flat.reshape(columns.shape).transpose(1, 0, 2)
            gram = np.matmul(each.transpose(0, 2, 1), each)
            trace = np.trace(gram, axis1=1, axis2=2)[:, None, None]
            gram += 1e-10 * (trace + 1e-12) * np.eye(len(lags))
            asked = np.matmul(each.transpose(0, 2, 1), self._left[:, None])
            told = np.matmul(each, np.linalg.solve(gram, asked))[:, :, 0]
            out[:, begin : begin + CHUNK] = self._left[:, None] - told.T
        return out

    def coefficients(self, v: Floats, lags: range) -> tuple[Floats, Floats]:
        """Return the coefficients of the past, and of a position at lags."""
        columns = np.hstack([self.past, self.lagged(v, lags), np.ones((self.rows.size, 1))])
        found = np.linalg.lstsq(columns, self.y, rcond=1e-9)[0]
        return found[: self.order], found[self.order : -1]


class Structure(NamedTuple):
    """Order and delay of a plant, with the oscillation from outside that suits the log.

    Attributes:
        order: readings before one that foretell it.
        lags: of the position.
        first: first sample that counts.
        line: sines and cosines (N x 6); None: nothing swings.
    """

    order: int
    lags: range
    first: int
    line: Floats | None


class ValveFit(NamedTuple):
    """Valve ahead of a plant, fitted.

    Attributes:
        word: the verdict's: input_play or stiction.
        account: of the valve, Kano's or He's.
        stick, jump: S and J [range of u].
        density: of the readings.
    """

    word: str
    account: str
    stick: float
    jump: float
    density: Density

    def position(self, u: Floats) -> Floats:
        """Return the valve's position (N).

        Args:
            u: output of the controller (N) [its range].
        """
        pair = np.array([self.stick]), np.array([self.jump])
        return valve_positions(u, *pair, self.account)[:, 0]


def _density(name: str, e: Floats, numbers: int) -> Density:
    """Return normal log densities of prediction errors."""
    variance = max(float(np.mean(e**2)), 1e-20)
    value = -0.5 * e**2 / variance - 0.5 * math.log(2 * math.pi * variance)
    return Density(name, value, numbers, math.sqrt(variance))


def _bic_of(e: Floats, numbers: Floats | int) -> Floats:
    """Return BIC of prediction errors (n, or n x K), up to a constant."""
    size = len(e)
    return np.asarray(size * np.log(np.mean(e**2, axis=0)) + numbers * math.log(size))


class LoopLog:
    """Record of a loop, scaled: u over its range, y over its deviation.

    Args:
        u: output of the controller (N).
        y: readings (N).
        ok: whether there is a reading (N).
        r: set point (N), NaN where missing; None: not recorded.
    """

    def __init__(self, u: Floats, y: Floats, ok: Flags, r: Floats | None) -> None:
        self.range, self.deviation = float(np.ptp(u)), float(y[ok].std())
        self.u = (u - u.mean()) / self.range
        self.y = np.where(ok, (y - y[ok].mean()) / self.deviation, 0.0)
        self.ok = ok
        known = (
            np.zeros(y.size) if r is None else np.nan_to_num((r - y[ok].mean()) / self.deviation)
        )
        self.error = np.where(ok, self.y - known, 0.0)
        self.error -= self.error.mean()
        self.regularity, self.period = oscillation_of(self.error)

    @property
    def orders(self) -> list[int]:
        """Return the orders that the log is long enough for."""
        return [k for k in ORDERS if 8 * (2 * k + MORE) < self.y.size]

    def regress(self, order: int, first: int) -> Regression:
        """Return the regression of the readings on their past."""
        return Regression(self.y, self.ok, order, first)

    def find_structure(self, valves: Floats) -> Structure:
        """Find order and delay: behind u as it is, or behind one of a few valves.

        Args:
            valves: their positions (N x K).
        """
        latest = min(LATEST, self.y.size // 20)
        first = latest + MORE + max(self.orders) + 6
        positions = np.column_stack([self.u, valves])
        brief = self.regress(4, first)
        price = 4 * (np.arange(positions.shape[1]) > 0)
        tried = []
        for delay in range(1, latest):
            cost = _bic_of(brief.errors_of_each(positions, range(delay, delay + 3)), price)
            tried.append((float(cost.min()), delay, int(np.argmin(cost))))
        _, delay, best = min(tried)
        lag = max(1, delay - 1)
        line = self._find_line(brief, range(lag, lag + 4 + MORE))
        sources = [(positions[:, best], None, 0)]
        if line is not None:
            sources.append((self.u, line, 1 + line.shape[1]))
        costs = []
        for order in self.orders:
            regression, lags = self.regress(order, first), range(lag, lag + order + MORE)
            for v, more, numbers in sources:
                e = regression.errors(v, lags, more)
                costs.append((float(_bic_of(e, 2 * order + numbers)), order))
        order = min(costs)[1]
        return Structure(order, range(lag, lag + order + MORE), first, line)

    def _find_line(self, regression: Regression, lags: range) -> Floats | None:
        """Return the oscillation from outside about the period that explains most (N x 6)."""
        if self.period > self.y.size / 4:
            return None
        t = np.arange(self.y.size)
        around = 1 + np.arange(-0.25, 0.25, self.period / (6 * self.y.size))
        best: tuple[float, Floats | None] = (math.inf, None)
        for factor in around:
            phase = 2 * np.pi / self.period * factor * t
            line = np.column_stack(
                [f(k * phase) for k, f in itertools.product(HARMONICS, (np.sin, np.cos))]
            )
            cost = float(np.mean(regression.errors(self.u, lags, line) ** 2))
            best = min(best, (cost, line), key=lambda one: one[0])
        return best[1]

    def fit_all(self, structure: Structure, thinned: int, rounds: int) -> LoopFits:
        """Fit the loop without a valve's fault, with an oscillation from outside, with valves.

        Args:
            structure: order and delay.
            thinned: each so manyth pair of the grid is tried.
            rounds: refinements.
        """
        regression = self.regress(structure.order, structure.first)
        lags, numbers = structure.lags, 2 + structure.order + len(structure.lags)
        densities = {"none": _density("none", regression.errors(self.u, lags), numbers)}
        if structure.line is not None:
            e = regression.errors(self.u, lags, structure.line)
            swings = numbers + structure.line.shape[1] + 1
            densities["external"] = _density("external", e, swings)
        widths, ratios = WIDTHS[::thinned], np.array(RATIOS[::thinned])
        plays = np.column_stack([WIDTHS, 0 * WIDTHS])
        sticks = np.array([(s, s * ratio) for s, ratio in itertools.product(widths, ratios)])
        fits = []
        for word, account, pairs in (
            ("input_play", KANO, plays),
            ("stiction", KANO, sticks),
            ("stiction", HE, sticks),
        ):
            pair = self._climb(regression, lags, account, pairs, rounds)
            fit = ValveFit(word, account, *pair, densities["none"])
            more = BREAKS + 1 + (word == "stiction")
            e = regression.errors(fit.position(self.u), lags)
            fits.append(fit._replace(density=_density(word, e, numbers + more)))
        return LoopFits(self, structure, regression, densities, tuple(fits))

    def _climb(
        self, regression: Regression, lags: range, account: str, pairs: Floats, rounds: int
    ) -> tuple[float, float]:
        """Return the best S, J of a grid, refined about its best few."""
        is_play = not pairs[:, 1].any()
        best: list[tuple[float, float, float]] = []
        for k in range(rounds + 1):
            v = valve_positions(self.u, *pairs.T, account)
            cost = np.sum(regression.errors_of_each(v, lags) ** 2, axis=0)
            best += [(float(c), float(s), float(j)) for c, (s, j) in zip(cost, pairs, strict=True)]
            best = sorted(best)[: TOPS if k == 0 else 3]
            width = 0.09 / 2.5**k
            moves = itertools.product(
                best, width * np.linspace(-1, 1, 7), width * np.linspace(-2, 2, 1 if is_play else 5)
            )
            pairs = np.array([_moved(s, j, a, b, is_play) for (_, s, j), a, b in moves])
        return best[0][1:]


def _moved(stick: float, jump: float, a: float, b: float, is_play: bool) -> tuple[float, float]:
    """Return S, J moved by shares of S."""
    kept = 0.0 if is_play else float(np.clip(jump + stick * b, 0.02 * stick, LARGEST * stick))
    return stick * (1 + a), kept


class LoopFits(NamedTuple):
    """Fits of a loop, all of the same readings.

    Attributes:
        log: the loop.
        structure: order and delay.
        regression: of the readings.
        densities: without a valve's fault: none, external.
        valves: with one.
    """

    log: LoopLog
    structure: Structure
    regression: Regression
    densities: dict[str, Density]
    valves: tuple[ValveFit, ...]

    @property
    def best(self) -> ValveFit:
        """Return the best valve."""
        return min(self.valves, key=lambda one: one.density.bic)

    @property
    def family(self) -> dict[str, Density]:
        """Return the best density of each word."""
        ranked = sorted(self.valves, key=lambda one: -one.density.bic)
        return self.densities | {one.word: one.density for one in ranked}

    def intervals(self, fit: ValveFit) -> tuple[Interval, Interval]:
        """Return S and J with 95 % intervals: pairs that the readings do not tell from the best.

        Args:
            fit: the valve.
        """
        rng, u = np.random.default_rng(1), self.log.u
        shift = rng.uniform(-1, 1, (2, PAIRS)) * rng.uniform(0, 1, (2, PAIRS)) ** 2
        stick = np.append(fit.stick * np.exp(0.7 * shift[0]), fit.stick)
        jump = np.clip(fit.jump + 0.8 * fit.stick * np.append(shift[1], 0.0), 0, LARGEST * stick)
        if fit.word == "input_play":
            jump = np.zeros(stick.size)
        positions = valve_positions(u, stick, jump, fit.account)
        e = self.regression.errors_of_each(positions, self.structure.lags)
        variance = np.mean(e**2, axis=0)
        values = -0.5 * e**2 / variance - 0.5 * np.log(variance)
        best = int(np.argmax(values.sum(axis=0)))
        less = values[:, [best]] - values
        scatter = np.sqrt(np.mean(cosine_coefficients(less) ** 2, axis=0) * len(less))
        held = less.sum(axis=0) <= np.maximum(DROP, SCATTER * scatter)
        unseen = 0.5 * math.sqrt(float(np.mean(np.diff(u) ** 2)))
        widths, jumps = (_hull(values, best, held, unseen) for values in (stick, jump))
        return widths, jumps if fit.word == "stiction" else Interval(0.0, 0.0, 0.0)

    def sensitivity(self, v: Floats) -> float:
        """Return the largest |1 / (1 + C G)| about the period of the oscillation [1].

        Args:
            v: position of the valve (N).
        """
        if not math.isfinite(self.log.period):
            return 0.0
        e, u = self.log.error, self.log.u
        t = np.arange(3, u.size)
        moves = np.column_stack([e[t], e[t - 1], e[t - 2], u[t - 1] - u[t - 2]])
        c = np.linalg.lstsq(moves, u[t] - u[t - 1], rcond=None)[0]
        past, through = self.regression.coefficients(v, self.structure.lags)
        peak = 0.0
        for w in 2 * np.pi / self.log.period * np.linspace(0.85, 1.15, 13):
            z = np.exp(-1j * w)
            controller = (c[0] + c[1] * z + c[2] * z**2) / ((1 - z) * (1 - c[3] * z))
            den = 1 - np.sum(past * z ** np.arange(1, past.size + 1))
            num = np.sum(through * z ** np.array(self.structure.lags))
            peak = max(peak, float(abs(den / (den - controller * num))))
        return peak


def _hull(values: Floats, best: int, held: Flags, more: float) -> Interval:
    """Return a value with the hull of those that are held, and a margin."""
    low, high = float(values[held].min()), float(values[held].max())
    value = float(values[best])
    return Interval(value, max(min(low, value - more), 0.0), max(high, value + more))


def fit_loop(log: LoopLog) -> LoopFits:
    """Fit a loop: first what decides its structure, then all behind that.

    Args:
        log: its record.
    """
    coarse = np.array(list(itertools.product(np.geomspace(0.02, 1.0, 18), (0.0, 0.4, 1.0))))
    valves = valve_positions(log.u, coarse[:, 0], coarse[:, 0] * coarse[:, 1], KANO)
    begun = log.fit_all(log.find_structure(valves), 3, 0)
    near = np.column_stack([one.position(log.u) for one in begun.valves])
    return log.fit_all(log.find_structure(near), 1, ROUNDS)


def oscillation_of(e: Floats) -> tuple[float, float]:
    """Return how regular an oscillation is, and its period [samples].

    Args:
        e: the control error (N).

    Returns:
        Thornhill's r (above 1: regular), by zeros of the autocorrelation; the period, inf without.
    """
    window = max(3, e.size // 5)
    e = e - np.convolve(e, np.ones(window) / window, "same")
    spectrum = np.abs(np.fft.rfft(e, 2 * e.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: e.size // 2]
    crossings = np.flatnonzero(np.diff(np.signbit(correlation)))[:12]
    if crossings.size < 5:
        return 0.0, math.inf
    gaps = np.diff(crossings)
    return float(gaps.mean() / (3 * gaps.std() + 0.1)), float(2 * gaps.mean())
