"""A valve that sticks, or has play, ahead of a plant in a control loop.

The valve's position v follows the controller's output u through a dead band and stick band S and a
slip jump J; J = 0 is a play of width S. In a loop u answers to y, so that simulation errors favour
whatever resembles the disturbance. Errors of prediction one step ahead do not, as long as the plant
is late by a sample: y is regressed on its own past and on past positions. An oscillation from
outside and a linear loop near its limit look alike and are asked beside it.

References:
    M. Kano and others (2004), IFAC World Congress
    Q. P. He and others (2007), doi:10.1021/ie061219a
    M. A. A. S. Choudhury, N. F. Thornhill, S. L. Shah (2005), doi:10.1016/j.conengprac.2004.05.005
    N. F. Thornhill, B. Huang, H. Zhang (2003), Journal of Process Control 13
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.special import softmax

from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.models.estimates import Interval, cosine_coefficients
from undeadzone_identify.models.least_squares import Density

ORDERS = (1, 2, 3, 4, 6, 8, 12)  # readings before one that foretell it
MEMORY = (3.0, 8.0, 20.0, 60.0)  # samples over which older ones are averaged, which do so too
MORE = 2  # lags of the position beyond those of the reading
LATEST = 30  # samples that a plant may be late
HARMONICS = (1, 2, 3)  # of an oscillation from outside
BREAKS = 2  # numbers that the breaks of a valve cost besides
FINEST, TRIED = 0.005, 60  # least S, of the range of u, and how many from there to the range
RATIOS = (0.08, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.2)  # J / S
LARGEST = 1.6  # J / S at most
KANO, HE = "Kano", "He"
ROUNDS, TOPS = 3, 8  # refinements, and grid points that they begin with
PAIRS = 300  # S, J around the best, for the interval
FAR = 1.6  # logarithm of S over the best, that is tried
SCATTER = 3.0  # how much larger than by one log differences of logs are taken
DRAWS = 500  # of logs that might have been recorded
CHUNK = 48  # positions that are regressed at once
TURN = 0.25  # of the range of u, by which it turns back at least to count
BESIDE = (0.1, 0.16, 0.25, 0.4, 0.63, 1.0)  # plays that may act beside u itself [range of u]


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

    The past is a few lags and averages of all older samples: in a loop u is the controller's sum of
    all past errors, and would foretell readings by itself if their own past were short.

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
        known = np.maximum.accumulate(np.where(ok, np.arange(y.size), int(np.argmax(ok))))
        lags = [y[self.rows - k] for k in range(1, order + 1)]
        averages = _averages(y[known][:, None])[self.rows - 1, 0]
        self.past = np.column_stack([*lags, averages])
        self.y = y[self.rows]
        own = np.column_stack([np.ones(self.rows.size), self.past])
        self._basis = np.linalg.qr(own)[0]
        self._left = self._without_past(self.y)

    def _without_past(self, columns: Floats) -> Floats:
        """Return columns without the part that the constant and the past explain."""
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))

    def lagged(self, v: Floats, lags: range) -> Floats:
        """Return positions at lags, and their averages up to the first of these (n x K x L).

        Args:
            v: the positions (N x K).
            lags: of each.
        """
        late = [v[self.rows - k][:, :, None] for k in lags]
        return np.concatenate([*late, _averages(v)[self.rows - lags[0]]], axis=2)

    def errors(self, v: Floats, lags: range, more: Floats | None = None) -> Floats:
        """Return prediction errors behind one position, perhaps with more columns (n).

        Args:
            v: the position (N).
            lags: of it.
            more: columns (N x M).
        """
        columns = self.lagged(v[:, None], lags)[:, 0]
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
            columns = self.lagged(part, lags)
            flat = self._without_past(columns.reshape(len(columns), -1))
            each = flat.reshape(columns.shape).transpose(1, 0, 2)
            gram = np.matmul(each.transpose(0, 2, 1), each)
            trace = np.trace(gram, axis1=1, axis2=2)[:, None, None]
            gram += 1e-10 * (trace + 1e-12) * np.eye(gram.shape[1])
            asked = np.matmul(each.transpose(0, 2, 1), self._left[:, None])
            told = np.matmul(each, np.linalg.solve(gram, asked))[:, :, 0]
            out[:, begin : begin + CHUNK] = self._left[:, None] - told.T
        return out

    def response(self, v: Floats, lags: range, z: complex) -> complex:
        """Return the plant's frequency response by the regression, at a backward shift z.

        Args:
            v: the position (N).
            lags: of it.
            z: exp(-i w).
        """
        columns = np.hstack(
            [self.past, self.lagged(v[:, None], lags)[:, 0], np.ones((self.rows.size, 1))]
        )
        found = np.linalg.lstsq(columns, self.y, rcond=1e-9)[0]
        decay = np.exp(-1 / np.array(MEMORY))
        averaged = (1 - decay) / (1 - decay * z)
        past = np.append(z ** np.arange(1, self.order + 1), z * averaged)
        through = np.append(z ** np.array(lags), z ** lags[0] * averaged)
        num = complex(found[past.size : -1] @ through)
        return num / complex(1 - found[: past.size] @ past)


def _averages(x: Floats) -> Floats:
    """Return exponential averages of signals over each memory (N x K x M)."""
    out = np.empty((*x.shape, len(MEMORY)))
    for k, samples in enumerate(MEMORY):
        decay = math.exp(-1 / samples)
        begun = decay * x[:1]
        out[:, :, k] = lfilter([1 - decay], [1.0, -decay], x, axis=0, zi=begun)[0]
    return out


class Structure(NamedTuple):
    """Order and delay of a plant, with the oscillation from outside that suits the log.

    Attributes:
        order: readings before one that foretell it.
        lags: of the position.
        first: first sample that counts.
        line: sines and cosines (N x 2 K); None: nothing swings.
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


def _bic_of(e: Floats, numbers: Floats | Integers | int) -> Floats:
    """Return BIC of prediction errors (n, or n x K), up to a constant."""
    size = len(e)
    return np.asarray(size * np.log(np.mean(e**2, axis=0)) + numbers * math.log(size))


class LoopLog:
    """Record of a loop, scaled: u over its range, y over its deviation.

    Args:
        u: output of the controller (N).
        y: readings (N).
        ok: whether there is a reading (N).
        r: set point (N), NaN if missing; None: not recorded.
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
    def step(self) -> float:
        """Return the rms by which u moves in a sample: less of a valve is not seen."""
        return math.sqrt(float(np.mean(np.diff(self.u) ** 2)))

    @property
    def turns(self) -> int:
        """Return how often u turned by more than a part of its range: only there a valve shows."""
        v = valve_positions(self.u, np.array([TURN]), np.zeros(1), KANO)[:, 0]
        moves = np.sign(np.diff(v))
        return int(np.count_nonzero(np.diff(moves[moves != 0])))

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
        longest = min(LATEST, self.y.size // 20)
        latest = int(min(longest, max(self.period / 2, 4) + 1))  # else a period late looks alike
        first = longest + MORE + max(self.orders) + 6
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
        sources: list[tuple[Floats, Floats | None, int]] = [(positions[:, best], None, 0)]
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
        """Return the oscillation from outside about the period that explains most (N x 2 K)."""
        if self.period > self.y.size / 4:
            return None
        t = np.arange(self.y.size)
        around = 1 + np.arange(-0.25, 0.25, self.period / (6 * self.y.size))
        best: tuple[float, Floats | None] = (math.inf, None)
        for factor in around:
            phase = 2 * np.pi / self.period * factor * t
            waves = [f(k * phase) for k, f in itertools.product(HARMONICS, (np.sin, np.cos))]
            for count in (2 * k for k in HARMONICS):
                line = np.column_stack(waves[:count])
                cost = _bic_of(regression.errors(self.u, lags, line), count)
                best = min(best, (float(cost), line), key=lambda one: one[0])
        return best[1]

    def fit_all(self, structure: Structure, thinned: int, rounds: int) -> LoopFits:
        """Fit the loop without a valve's fault, with an oscillation from outside, with valves.

        Args:
            structure: order and delay.
            thinned: each so manyth pair of the grid is tried.
            rounds: refinements.
        """
        regression = self.regress(structure.order, structure.first)
        lags = structure.lags
        numbers = 2 + structure.order + len(lags) + 2 * len(MEMORY)
        densities = {"none": _density("none", regression.errors(self.u, lags), numbers)}
        if structure.line is not None:
            e = regression.errors(self.u, lags, structure.line)
            swings = numbers + structure.line.shape[1] + 1
            densities["external"] = _density("external", e, swings)
        every = np.geomspace(max(FINEST, self.step), 1.0, TRIED)
        plays = np.column_stack([every, 0 * every])
        ratios = itertools.product(every[::thinned], RATIOS[::thinned])
        sticks = np.array([(s, s * ratio) for s, ratio in ratios])
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
            v = valve_positions(self.u, pairs[:, 0], pairs[:, 1], account)
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

    def chance_of_play(self) -> float:
        """Return p of what the position of a play explains beside u itself [1].

        The play that explains most counts, for as many as are tried.
        """
        u, lags = self.log.u, self.structure.lags
        without = float(np.sum(self.regression.errors(u, lags) ** 2))
        plays = np.array(BESIDE)
        least = without
        for v in valve_positions(u, plays, 0 * plays, KANO).T:
            late = np.column_stack([np.roll(v, lags[0]), np.roll(v, lags[-1])])
            least = min(least, float(np.sum(self.regression.errors(u, lags, late) ** 2)))
        fallen = (least / without) ** (0.5 * self.regression.rows.size)  # of two numbers each
        return min(plays.size * fallen, 1.0)

    def intervals(self, fit: ValveFit) -> tuple[Interval, Interval]:
        """Return S and J with 95 % intervals: all pairs that the readings do not tell from a fit.

        A pair is told from it by more than chance lets the sum of both log densities differ. Both
        accounts are asked, and pairs far away, as S and J may stand for each other.

        Args:
            fit: the valve.
        """
        u, lags = self.log.u, self.structure.lags
        stick, jump = _pairs_around(fit)
        e = [self.regression.errors(fit.position(u), lags)[:, None]]
        for account in (KANO, HE):
            positions = valve_positions(u, stick, jump, account)
            e.append(self.regression.errors_of_each(positions, lags))
        errors = np.hstack(e)
        variance = np.mean(errors**2, axis=0)
        values = -0.5 * errors**2 / variance - 0.5 * np.log(variance)
        weight = _bagged_weights(values)
        unseen = 0.5 * self.log.step
        widths, jumps = (
            _weighted_range(np.concatenate([[value], tried, tried]), weight, unseen)
            for value, tried in ((fit.stick, stick), (fit.jump, jump))
        )
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
        peak = 0.0
        for w in 2 * np.pi / self.log.period * np.linspace(0.85, 1.15, 13):
            z = complex(np.exp(-1j * w))
            controller = (c[0] + c[1] * z + c[2] * z**2) / ((1 - z) * (1 - c[3] * z))
            plant = self.regression.response(v, self.structure.lags, z)
            peak = max(peak, 1 / max(abs(1 - controller * plant), 1e-9))
        return peak


def _pairs_around(fit: ValveFit) -> tuple[Floats, Floats]:
    """Return S and J of pairs about a fit, half of them far away (PAIRS each)."""
    rng = np.random.default_rng(1)
    near = rng.uniform(-1, 1, (2, PAIRS // 2)) * rng.uniform(0, 1, (2, PAIRS // 2)) ** 2
    far = rng.uniform(-1, 1, PAIRS - PAIRS // 2)
    stick = fit.stick * np.exp(np.append(0.7 * near[0], FAR * far))
    jump = fit.jump + 0.8 * fit.stick * near[1]
    ratio = np.maximum(rng.uniform(-0.2, 1.3, far.size), 0.0)  # a few are plays
    jump = np.append(jump, ratio * stick[near.shape[1] :])
    return stick, np.clip(jump, 0.0, LARGEST * stick)


def _bagged_weights(values: Floats) -> Floats:
    """Return posterior weights, in the mean over logs that might have been recorded (K).

    Args:
        values: log densities of each reading (n x K).
    """
    gains = values - values[:, :1]
    slow = cosine_coefficients(gains)
    noise = np.random.default_rng(0).standard_normal((DRAWS, len(slow)))
    drawn = gains.sum(axis=0) + SCATTER * noise @ slow * math.sqrt(len(gains) / len(slow))
    return np.asarray(softmax(drawn, axis=1).mean(axis=0))


def _weighted_range(values: Floats, weight: Floats, more: float) -> Interval:
    """Return the first value with the 95 % range of all by weight, and a margin."""
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    low, high = (float(np.interp(level, share, values[order])) for level in (0.025, 0.975))
    value = float(values[0])
    return Interval(value, max(min(low, value - more), 0.0), max(high, value + more))


def fit_loop(log: LoopLog) -> LoopFits:
    """Fit a loop: first its structure, then all models behind that.

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
