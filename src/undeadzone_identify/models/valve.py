"""A valve that sticks, or has play, ahead of a plant in a control loop.

The valve's position v follows the controller's output u through a dead band and stick band S and a
slip jump J; J = 0 is a play of width S. In a loop u answers to y, so that simulation errors favour
whatever resembles the disturbance. Errors of prediction one step ahead do not, as long as the plant
is late by a sample: y is regressed on its own past and on past positions. An external oscillation
and a loop near its stability limit give similar readings, so they are fitted as rivals.

References:
    M. Kano and others (2004), IFAC World Congress
    Q. P. He and others (2007), doi:10.1021/ie061219a
    M. A. A. S. Choudhury, N. F. Thornhill, S. L. Shah (2005), doi:10.1016/j.conengprac.2004.05.005
    N. F. Thornhill, B. Huang, H. Zhang (2003), Journal of Process Control 13
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import correlate, freqz
from scipy.special import expit, softmax

from undeadzone.compile import lanes
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.models.estimates import Interval, draw_sums
from undeadzone_identify.models.least_squares import regression_residual
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.motion import last_reading_rows

ORDERS = (1, 2, 3, 4, 6, 8, 12)  # autoregressive orders of the readings
LOW = 4  # order at which delays are compared
MEMORY = (3.0, 8.0, 20.0, 60.0)  # samples of the exponential averages that are regressors as well
DECAY = np.exp(-1 / np.array(MEMORY))
MORE = 2  # lags of the position beyond those of the reading
LATEST = 30  # largest delay of a plant [samples]
HARMONICS = (1, 2, 3)  # of an external oscillation
# its least periods in a record, and frequencies of a periodogram for each of those of the record
FEWEST, FINE = 4, 32
BREAKS = 2  # parameters that the breakpoints of a valve count for, beside S and J
# least S [range of u], and the number of S of a grid up to the range
FINEST = 0.005
TRIED = 60
RATIOS = (0.08, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.2)  # J / S
LARGEST = 1.6  # J / S at most
KANO = "Kano"
HE = "He"
# refinements of a grid, and grid points at which they start
ROUNDS = 3
TOPS = 8
SIZES = 40  # S of a grid for the interval, up to the widest [range of u]
WIDEST = 1.2
SLIPS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.2)  # J / S of this grid
ASIDE = 0.1  # share of the weight that all its pairs have alike: no model is the valve's own
SPREADS = (0.0, 0.1, 0.2, 0.4, 0.8)  # of ln S between records of one valve
GRID = 0.07  # of ln S: half a step of the grid
NEAR = 0.3  # |ln S| from the median, within which pairs tell J
ELLIPSE_LESS, ELLIPSE_OFF = -0.17, 0.8  # ln(S / width of the ellipse): mean, standard deviation
SCATTER = 3.0  # safety factor of the standard deviation of differences of log likelihoods
DRAWS = 500  # draws of the log likelihoods
CHUNK = 16  # positions that are regressed at once: their regressors fit into the cache
COARSELY = 2000  # readings that a coarse grid predicts: more tell its points apart no better


def valve_positions(u: Floats, valves: Floats, account: str) -> Floats:
    """Return the positions of valves along an input, each before its averages (K x N x A).

    The averages are exponential, over each memory. A valve was at rest before the first sample.

    Args:
        u: output of the controller (N).
        valves: S and J of each (K x 2) [u].
        account: model of the valve: KANO slides after its jump, HE sticks at every sample.
    """
    kernel = build_valve_kernel(account)
    begin = u[0] * np.append(ACCOUNTS[account][1], np.ones(len(MEMORY)))
    moves = np.column_stack([u, np.append(u[0], u[:-1])])
    return lanes.run_lanes(
        kernel,
        begin,
        moves,
        np.zeros(2),
        lane_params=valves,
        threads=1,
    )[0]


def split_valves(u: Floats, valves: Floats, *accounts: str) -> Iterator[Floats]:
    """Yield the positions of `CHUNK` valves at a time, by each model in turn.

    Arguments of `valve_positions`.
    """
    for account, begin in itertools.product(accounts, range(0, len(valves), CHUNK)):
        yield valve_positions(u, valves[begin : begin + CHUNK], account)


def average(x: Floats) -> Floats:
    """Return a signal (N) before its averages (N x A): the position of an ideal valve, S = 0."""
    return valve_positions(x, np.zeros((1, 2)), KANO)[0]


@cache
def build_valve_kernel(account: str) -> lanes.Kernel:
    """Return the compiled step of a valve.

    Args:
        account: model of the valve.

    Returns:
        A kernel with

        - state: of the valve, its position first, and averages of the position,
        - inputs: output of the controller, now and a sample before [u],
        - parameters of a lane: S and J [u],
        - output: the position and its averages.
    """
    step, begin = ACCOUNTS[account]
    state, inputs, valve = ca.SX.sym("s", len(begin)), ca.SX.sym("u", 2), ca.SX.sym("v", 2)
    averages = ca.SX.sym("a", len(MEMORY))
    after = step(ca.vertsplit(state), *ca.vertsplit(inputs), *ca.vertsplit(valve))
    averaged = DECAY * averages + (1 - DECAY) * after[0]
    states = ca.vertcat(state, averages), ca.vertcat(*after, averaged)
    output = ca.vertcat(after[0], averaged)
    function = ca.Function("valve", [states[0], inputs, valve], [states[1], output])
    return lanes.build_kernel(function, params=[0, 1])


def _slide_on(state: Sequence[Any], u: Any, before: Any, stick: Any, jump: Any) -> Sequence[Any]:
    """Return the next state of a valve by Kano's model.

    A valve slides until u reverses or stops. It then rests until u has moved by S against the last
    direction, or by J along it; the first time by (S + J) / 2. A sliding valve is (S - J) / 2
    behind u.

    Args:
        state: position, u at which the valve stopped, direction of its last slide (0: none), and
            whether it slides.
        u, before: output of the controller, now and a sample before [u].
        stick, jump: S and J [u].
    """
    position, stopped_at, direction, slides = state
    stops = ca.logic_and(slides, direction * (u - before) <= 0)
    stopped_at = ca.if_else(stops, before, stopped_at)
    rests = ca.logic_or(ca.logic_not(slides), stops)
    travel = u - stopped_at
    along = direction * travel
    starts = ca.logic_and(direction == 0, ca.fabs(travel) > (stick + jump) / 2)
    reverses = -along > stick
    slips = ca.logic_and(rests, ca.logic_or(ca.logic_or(reverses, along > jump), starts))
    turned = ca.if_else(starts, ca.sign(travel), ca.if_else(reverses, -direction, direction))
    direction = ca.if_else(slips, turned, direction)
    slides = ca.logic_or(ca.logic_not(rests), slips)
    position = ca.if_else(slides, u - direction * (stick - jump) / 2, position)
    return position, stopped_at, direction, slides


def _stick_again(state: Sequence[Any], u: Any, before: Any, stick: Any, jump: Any) -> Sequence[Any]:
    """Return the next state of a valve by He's model.

    The spring force (in units of u) moves the valve if it exceeds static friction, (S + J) / 2.
    The kinetic friction, (S - J) / 2, remains. Friction is static again at every sample.

    Args:
        state: position, and the force that is left [u].
        u, before: output of the controller, now and a sample before [u].
        stick, jump: S and J [u].
    """
    position, force = state
    force = force + (u - before)
    slips = ca.fabs(force) > (stick + jump) / 2
    remaining = ca.if_else(slips, ca.sign(force) * (stick - jump) / 2, force)
    return ca.if_else(slips, position + force - remaining, position), remaining


# Steps of the models of a valve, and their states at first [u].
ACCOUNTS = {KANO: (_slide_on, (1.0, 1.0, 0.0, 0.0)), HE: (_stick_again, (1.0, 0.0))}


class Regression:
    """Regression of the readings on a constant, their past, and positions of a valve.

    The past consists of a few lags, and of exponential averages of all older samples. In a loop u
    is the controller's integral of all past errors, so u would predict readings by itself if the
    regressors held only a short past.

    Args:
        y: readings before their averages, the last one in place of a missing one (N x A).
        ok: flags of the readings that are not missing (N).
        order: lags of the readings.
        first: first sample that is predicted.
        stride: every how many of the samples that can be predicted are.

    Attributes:
        order, first: as given.
        rows: samples that are predicted (n).
        past: lags and averages of the readings (n x L).
        y: readings that are predicted (n).
    """

    def __init__(self, y: Floats, ok: Flags, order: int, first: int, stride: int = 1) -> None:
        whole = sliding_window_view(ok, order + 1)[first - order :].all(axis=1)
        # A slice is read ten times as fast as samples by their numbers.
        self._chosen = np.s_[::stride] if whole.all() else np.flatnonzero(whole)[::stride]
        self.rows: Integers = np.arange(first, len(y))[self._chosen]
        self.order, self.first = order, first
        self.past = self.lagged(y[None], range(1, order + 1))[0].T
        self.y = y[self.rows, 0]
        # Each regressor is a row, so that products of rows run along the memory.
        ones = np.ones(self.rows.size)
        self._basis = np.linalg.qr(np.column_stack([ones, self.past]))[0].T.copy()
        self._target = self.y - (self._basis @ self.y) @ self._basis

    def _before(self, x: Floats, lag: int) -> Floats:
        """Return signals (... x N) a lag before the samples that are predicted (... x n)."""
        return x[..., self.first - lag : x.shape[-1] - lag][..., self._chosen]

    def lagged(self, v: Floats, lags: range) -> Floats:
        """Return lagged signals, and their averages up to the first lag (K x L x n).

        Args:
            v: signals before their averages (K x N x A).
            lags: lags [samples].
        """
        columns = np.empty((len(v), len(lags) + len(MEMORY), self.rows.size))
        signals = np.ascontiguousarray(v[:, :, 0])
        for place, k in enumerate(lags):
            columns[:, place] = self._before(signals, k)
        columns[:, len(lags) :] = self._before(v[:, :, 1:].transpose(0, 2, 1), lags[0])
        return columns

    def mean_square_beside(self, v: Floats, lags: range, others: Floats) -> float:
        """Return the mean squared one-step prediction error for a position.

        Arguments of `regressors`.
        """
        errors = regression_residual(self.regressors(v, lags, others), self.y)
        return float(np.mean(errors**2))

    def prediction_errors_of_each(self, v: Floats, lags: range) -> Floats:
        """Return the one-step prediction errors for each of several positions (K x n).

        Args:
            v: positions before their averages (K x N x A).
            lags: lags of the positions [samples].
        """
        each, along, weights, _ = self.regress_on_each(v, lags)
        return self._target - (weights @ each - weights @ along @ self._basis)[:, 0]

    def regress_on_each(self, v: Floats, lags: range) -> tuple[Floats, Floats, Floats, Floats]:
        """Return lagged positions, their products with the past, weights and mean squared errors.

        The positions without the part that the past explains are regressed on the readings
        without it (Frisch, Waugh and Lovell), from products with the positions as they are.
        Arguments of `prediction_errors_of_each`.
        """
        each = self.lagged(v, lags)
        along = each @ self._basis.T
        # Normal equations of all positions at once, with a ridge against collinear columns.
        gram = each @ each.transpose(0, 2, 1) - along @ along.transpose(0, 2, 1)
        ridge = 1e-10 * (np.trace(gram, axis1=1, axis2=2) + 1e-12)
        products = each @ self._target[:, None]
        regularized = gram + ridge[:, None, None] * np.eye(gram.shape[1])
        weights = np.linalg.solve(regularized, products).transpose(0, 2, 1)
        explained = (weights @ products)[:, 0, 0] + ridge * np.sum(weights**2, axis=(1, 2))
        return each, along, weights, (self._target @ self._target - explained) / self.rows.size

    def rank_valves(
        self, u: Floats, pairs: Floats, account: str, lags: range
    ) -> list[tuple[float, float, float]]:
        """Return mean squared errors with pairs of S and J, the least error first (K).

        Args:
            u: output of the controller (N).
            pairs: S and J (K x 2) [u].
            account: model of the valves.
            lags: lags of their positions [samples].
        """
        squares = np.concatenate([
            self.regress_on_each(valves, lags)[-1] for valves in split_valves(u, pairs, account)
        ])  # fmt: skip
        return sorted(zip(squares.tolist(), *pairs.T.tolist(), strict=True))

    def regressors(self, v: Floats, lags: range, others: Floats) -> Floats:
        """Return the past, the lagged position, a constant and others (n x columns).

        Args:
            v: position before its averages (N x A).
            lags: lags of the position [samples].
            others: further regressors (N x M).
        """
        ones = np.ones((self.rows.size, 1))
        return np.hstack([self.past, self.lagged(v[None], lags)[0].T, ones, others[self.rows]])

    def responses(self, v: Floats, lags: range, points: Floats, others: Floats) -> Floats:
        """Return the frequency responses from the position of the valve to y.

        The regression is y = past(q^-1) y + through(q^-1) v, so the response is
        through / (1 - past), with z in place of q^-1.

        Args:
            v: position of the valve before its averages (N x A).
            lags: lags of the position [samples].
            points: values of z = exp(-i w), with w the frequency [rad/sample] (M).
            others: further regressors (N x M).
        """
        coefficients = np.linalg.lstsq(self.regressors(v, lags, others), self.y, rcond=1e-9)[0]
        z = points[:, None]
        averaged = (1 - DECAY) / (1 - DECAY * z)  # response of each exponential average
        past = np.hstack([z ** np.arange(1, self.order + 1), z * averaged])
        through = np.hstack([z ** np.array(lags), z ** lags[0] * averaged])
        own, acting = np.split(coefficients[: past.shape[1] + through.shape[1]], [past.shape[1]])
        return through @ acting / (1 - past @ own)


def _bic(squares: Any, size: int, numbers: Any) -> Any:
    """Return the BIC of models by their mean squared errors and their numbers of parameters."""
    constant = math.log(2 * math.pi) + 1
    return size * (np.log(np.maximum(squares, 1e-20)) + constant) + numbers * math.log(size)


class LoopLog:
    """Scaled log of a control loop: u over its range, y over its standard deviation.

    Args:
        u: output of the controller (N).
        y: readings (N).
        ok: flags of the readings that are not missing (N).
        r: set point (N); the mean of the readings where none is recorded.

    Attributes:
        range, deviation: divisors of u and y.
        ideal: u before its averages, as an ideal valve follows it (N x A).
        error: control error y - r, without its mean (N).
        regularity, period: of its oscillation, as `oscillation_of` returns them.
        line, frequency: of its largest sine, as `find_line` returns them.
    """

    def __init__(self, u: Floats, y: Floats, ok: Flags, r: Floats) -> None:
        self.range = float(np.ptp(u))
        self.deviation = float(y[ok].std()) or 1.0
        self.u = (u - u.mean()) / self.range
        self.ideal = average(self.u)
        self.y = np.where(ok, (y - y[ok].mean()) / self.deviation, 0.0)
        self._readings = average(self.y[last_reading_rows(ok)])
        self.ok = ok
        self.error = np.where(ok, self.y - (r - y[ok].mean()) / self.deviation, 0.0)
        self.error -= self.error.mean()
        self.regularity, self.period = oscillation_of(self.error)
        self.line, self.frequency = find_line(self.error)

    @property
    def step(self) -> float:
        """Return the rms change of u in a sample [range of u]; a smaller S cannot be identified."""
        return root_mean_square(np.diff(self.u))

    def regress(self, order: int, first: int, stride: int = 1) -> Regression:
        """Return the regression of an order.

        Args:
            order: lags of the readings.
            first: first sample that is predicted.
            stride: every how many samples are predicted.
        """
        return Regression(
            self._readings,
            self.ok,
            order,
            first,
            stride,
        )

    @property
    def coarse_stride(self) -> int:
        """Return the stride by which a regression predicts enough readings for a coarse grid."""
        return max(1, self.y.size // COARSELY)

    def _find_structure(self) -> tuple[Regression, range, Floats]:
        """Find order and delay by BIC, for u itself and for valves of a coarse grid.

        Returns:
            Regression of all readings, lags of the position [samples], and the external
            oscillation that suits the log.
        """
        longest, orders = min(LATEST, self.y.size // 20), find_orders(self.ok)
        # In an oscillation a delay cannot be distinguished from one that is a period longer.
        latest = int(min(longest, max(self.period / 2, 4) + 1))
        first = longest + MORE + max(orders) + 6
        coarse = itertools.product(np.geomspace(0.02, 1.0, 18), (0.0, 0.4, 1.0))
        pairs = np.cumprod([(0.0, 0.0), *coarse], axis=1)  # the ideal valve first
        positions = valve_positions(self.u, pairs, KANO)
        low_order = self.regress(LOW, first, self.coarse_stride)
        valve_numbers = 4 * (np.arange(len(positions)) > 0)
        every = [
            low_order.regress_on_each(positions, range(k, k + 3))[-1] for k in range(1, latest)
        ]
        bic = _bic(every, low_order.rows.size, valve_numbers)
        before, best = np.unravel_index(np.argmin(bic), bic.shape)  # samples less than the delay
        lag = max(1, int(before))
        waves = self._find_oscillation(low_order, range(lag, lag + 4 + MORE))
        costs = []
        for order in orders:
            regression = self.regress(order, first, self.coarse_stride)
            lags = range(lag, lag + order + MORE)
            rivals = (positions[best], waves[:, :0]), (self.ideal, waves)
            for v, others in rivals:
                square = regression.mean_square_beside(v, lags, others)
                numbers = 2 * order + others.shape[1] + (others.size > 0)
                costs.append((_bic(square, regression.rows.size, numbers), order))
        order = min(costs)[1]
        return self.regress(order, first), range(lag, lag + order + MORE), waves

    def _find_oscillation(self, regression: Regression, lags: range) -> Floats:
        """Return the external oscillation of least BIC, a sine of the error with its harmonics.

        Args:
            regression: regression of the readings.
            lags: lags of u [samples].

        Returns:
            Sines and cosines of its harmonics (N x 2 K).
        """
        phases = 2 * np.pi * self.frequency * np.outer(np.arange(self.y.size), HARMONICS)
        waves = [np.hstack([np.sin(phases[:, :k]), np.cos(phases[:, :k])]) for k in HARMONICS]
        squares = [regression.mean_square_beside(self.ideal, lags, one) for one in waves]
        return waves[np.argmin(_bic(squares, regression.rows.size, 2 * np.array(HARMONICS)))]

    def fit_all(self) -> LoopFits:
        """Fit the loop with an ideal valve, with an external oscillation, and with faulty valves.

        Order and delay are those that a coarse grid of valves tells.
        """
        regression, lags, waves = structure = self._find_structure()
        coarse = self.regress(regression.order, regression.first, self.coarse_stride)
        size = regression.rows.size
        numbers = 2 + regression.order + len(lags) + 2 * len(MEMORY)
        bic = {}
        for word, others in (("none", waves[:, :0]), ("external", waves)):
            square = regression.mean_square_beside(self.ideal, lags, others)
            bic[word] = _bic(square, size, numbers + others.shape[1] + (others.size > 0))
        widths = np.geomspace(max(FINEST, self.step), 1.0, TRIED)
        for word, account, ratios in (
            ("input_play", KANO, [0.0]),
            ("stiction", KANO, RATIOS),
            ("stiction", HE, RATIOS),
        ):
            pairs = np.cumprod(list(itertools.product(widths, ratios)), axis=1)
            square = self._refine_grid(
                regression,
                coarse,
                lags,
                account,
                pairs,
            )
            cost = _bic(square, size, numbers + BREAKS + 1 + (word == "stiction"))
            bic[word] = min(cost, bic.get(word, cost))
        return LoopFits(self, *structure, bic)

    def _refine_grid(
        self,
        regression: Regression,
        coarse: Regression,
        lags: range,
        account: str,
        pairs: Floats,
    ) -> float:
        """Return the least mean squared prediction error, by a refined grid.

        Args:
            regression, coarse: of all readings, and of those that rank a grid.
            lags: lags of the position [samples].
            account: model of the valve.
            pairs: grid of S and J (K x 2) [range of u].
        """
        most = LARGEST * pairs[:, 1].any()  # 0 of a play
        best = coarse.rank_valves(self.u, pairs, account, lags)[:TOPS]
        a, b = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-2, 2, 5 if most else 1))
        for k in range(ROUNDS):
            width = 0.09 / 2.5**k
            stick, jump = np.array(best).T[1:, :, None]
            moved = jump + stick * width * b.ravel()
            jumps = np.clip(moved, min(0.02, most) * stick, most * stick)
            pairs = np.stack([stick * (1 + width * a.ravel()), jumps], axis=-1).reshape(-1, 2)
            best = sorted(best + coarse.rank_valves(self.u, pairs, account, lags))[:3]
        return regression.rank_valves(self.u, np.array(best)[:, 1:], account, lags)[0][0]


class LoopFits(NamedTuple):
    """Fits of a loop, all to the same readings.

    Attributes:
        log: log of the loop.
        regression: regression of all readings.
        lags: lags of the position [samples].
        oscillation: sines and cosines of its harmonics (N x 2 K).
        bic: least of each class: none, external (that of none without an oscillation),
            input_play, stiction.
    """

    log: LoopLog
    regression: Regression
    lags: range
    oscillation: Floats
    bic: dict[str, float]

    def weigh_sizes(self) -> Sizes:
        """Return pairs of S and J with their weights by the readings [range of u].

        The models of a valve are Kano's and He's, each with every pair, since S and J may
        compensate each other. All pairs have the same weight where no valve foretells the readings.
        """
        least = max(FINEST, 0.5 * self.log.step)
        grid = itertools.product(np.geomspace(least, max(WIDEST, 2 * least), SIZES), SLIPS)
        pairs = np.array(list(grid))
        stick, ratio = pairs.T
        errors = np.vstack([
            self.regression.prediction_errors_of_each(positions, self.lags)
            for positions in split_valves(self.log.u, np.cumprod(pairs, axis=1), KANO, HE)
        ])  # fmt: skip
        # Sums over blocks have the same long-run variance, and are fewer to transform.
        starts = np.arange(0, errors.shape[1], self.log.coarse_stride)
        squares = np.add.reduceat(errors**2, starts, axis=1).T
        variance = np.maximum(squares.sum(axis=0) / errors.shape[1], 1e-20)
        # The log likelihoods are drawn with the covariance that their long-run variance estimates
        # (BayesBag), so that a single log does not overrule close rivals.
        values = -0.5 * (squares / variance + errors.shape[1] / starts.size * np.log(variance))
        weights = softmax(draw_sums(values, DRAWS, SCATTER), axis=1).mean(axis=0)
        gain = self.bic["none"] - min(self.bic["input_play"], self.bic["stiction"])
        seen = (1 - ASIDE) * float(expit(gain / 2))
        weights = weights.reshape(2, -1).sum(axis=0)
        return Sizes(stick, ratio, seen * weights + (1 - seen) / stick.size)

    def sensitivity(self) -> float:
        """Return the peak of the sensitivity |1 / (1 + C G)| near the oscillation's frequency [1].

        The controller C is fitted to the log as a difference equation of u and the error. G is the
        plant by the regression on u, beside an oscillation from outside. The peak is 0 if the loop
        does not oscillate.
        """
        if not math.isfinite(self.log.period):
            return 0.0
        e = self.log.error
        u = self.log.u
        t = np.arange(3, u.size)
        moves = np.column_stack([e[t], e[t - 1], e[t - 2], u[t - 1] - u[t - 2]])
        c = np.linalg.lstsq(moves, u[t] - u[t - 1], rcond=None)[0]
        angles = 2 * np.pi / self.log.period * np.linspace(0.85, 1.15, 13)
        controller = freqz(c[:3], np.convolve([1.0, -1.0], [1.0, -c[3]]), angles)[1]
        z = np.exp(-1j * angles)
        plants = self.regression.responses(self.log.ideal, self.lags, z, self.oscillation)
        return float(1 / max(np.abs(1 - controller * plants).min(), 1e-9))


class Sizes(NamedTuple):
    """Pairs of S and J of a valve, with their weights by the readings of a record.

    Attributes:
        stick: S (K) [u].
        ratio: J / S (K).
        weight: of sum 1 (K).
    """

    stick: Floats
    ratio: Floats
    weight: Floats


def combine_sizes(records: Sequence[Sizes], expected: float) -> tuple[Interval, Interval]:
    """Return S and J of one valve by its records, medians with 95 % intervals [u].

    ln S of a record is normal about that of the valve. The spread between records is one of a few,
    all of which count by their likelihood: a random effect by day. A record tells S by the weight
    of its pairs near S over that of pairs of equal weight, so that one that shows nothing has no
    say. An S above all its pairs leaves the valve at rest, as the largest of them does.

    Args:
        records: pairs with weights.
        expected: S by the ellipse of PV over OP, which is off by `ELLIPSE_OFF` [u].
    """
    every = np.concatenate([one.stick for one in records])
    values = np.linspace(np.log(every.min()), np.log(every.max()), 240)
    spreads = np.hypot(SPREADS if len(records) > 1 else SPREADS[:1], GRID)
    total = np.zeros((values.size, spreads.size)) - 0.5 * (
        ((values - math.log(expected) - ELLIPSE_LESS) / ELLIPSE_OFF)[:, None] ** 2
    )
    for one in records:
        own = np.log(one.stick)
        away = np.clip(values, own.min(), own.max())[:, None, None] - own
        near = np.exp(-0.5 * (away / spreads[:, None]) ** 2)
        total += np.log(near @ one.weight / near.mean(axis=-1) + 1e-300)
    stick = np.exp(_quantiles(values, softmax(total).sum(axis=1)))
    weights = [
        one.weight * np.exp(-0.5 * (np.log(one.stick / stick[0]) / NEAR) ** 2) for one in records
    ]
    ratios = np.concatenate([one.ratio for one in records])
    jump = stick[0] * _quantiles(ratios, np.concatenate(weights) / np.sum(weights))
    return Interval(*stick.tolist()), Interval(*jump.tolist())


def _quantiles(values: Floats, weights: Floats) -> Floats:
    """Return the median and the ends of 95 % of weighted values (3)."""
    ascending = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[ascending])
    return np.interp((0.5, 0.025, 0.975), cumulative, values[ascending])


def find_orders(ok: Flags) -> list[int]:
    """Return the orders for which enough readings follow one another.

    Args:
        ok: flags of the readings that are not missing (N).
    """
    return [k for k in ORDERS if 8 * (2 * k + MORE) < (np.convolve(ok, np.ones(k + 1)) > k).sum()]


def oscillation_of(e: Floats) -> tuple[float, float]:
    """Return the regularity of an oscillation [1], and its period [samples].

    Both follow from the zero crossings of the autocorrelation, which is less noisy than the signal
    (Thornhill and others 2003).

    Args:
        e: control error (N).

    Returns:
        r = mean / (3 std) of the half periods, above 1 for a regular oscillation; and the period,
        inf without an oscillation.
    """
    e = _without_trend(e)
    autocorrelation = correlate(e, e)[e.size - 1 :][: e.size // 2]
    # later crossings are sums of few products, and noisy
    crossings = np.flatnonzero(np.diff(np.signbit(autocorrelation)))[:12]
    if crossings.size < 5:
        return 0.0, math.inf
    half_periods = np.diff(crossings)
    mean = half_periods.mean()
    # 0.1 samples keep r finite if all half periods are equal.
    return float(mean / (3 * half_periods.std() + 0.1)), float(2 * mean)


def find_line(e: Floats) -> tuple[float, float]:
    """Return the share of the largest sine in the variance of a signal, and its frequency.

    A sine from outside keeps its phase throughout a record. A loop near its limit rings by
    whatever disturbs it, so that its line is as wide as its damping makes it.

    Args:
        e: control error (N).

    Returns:
        The share [1], and a frequency of at least `FEWEST` periods in the record [1/sample].
    """
    e = _without_trend(e)
    power = np.abs(np.fft.rfft(e, FINE * e.size)) ** 2
    peak = FEWEST * FINE + int(np.argmax(power[FEWEST * FINE :]))
    return 2 * power[peak] / (e.size * max(float(e @ e), 1e-20)), peak / (FINE * e.size)


def _without_trend(e: Floats) -> Floats:
    """Return a signal without its slow trend (N)."""
    window = max(3, e.size // 5)
    return e - np.convolve(e, np.ones(window) / window, "same")
