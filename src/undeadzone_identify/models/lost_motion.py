"""Two positions with lost motion between them, at the times at which they were read.

    y(t) = R play(F u(t - T); c) + b + e                                                     (P1)

u is one position (a goal, a motor's encoder, summed pulses), y the other (a joint, an axis, a
star). F is nothing, or lags of first order that a servo or a filter adds. There is no plant to
fit, so times need no grid: u is interpolated at t - T, or held where it moves in steps.

R, b and a bent scale are linear, T and the time constant are climbed to behind every c of a scan.
The interval of c is that of its profile. Where residuals depend on one another it is widened by
what blocks between two reversals say of the score.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from undeadzone.nonlinearities.play import levels
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.estimates import Interval, student_quantile
from undeadzone_identify.models.least_squares import Density, hat_functions, regression_residual

SCANNED = 48  # gaps of a scan
WIDEST = 0.9  # of the range of u, that a gap may have
LATEST = 6.0  # samples by which y may be late
DELAYS = 13  # of a scan
FEWEST_LATE = 200  # samples from which a delay is asked
STARTS = (-1.0, 0.0, 1.0)  # where in the gap a record begins, in half widths
KEPT = 3  # places of a scan from which is climbed
FINEST = 1e-6  # of the range of u, to which a gap is looked for
FINE = 13  # points of each closer look
CLIMBED = 25  # steps of a climb
HELD = 0.5  # share of samples at which u does not change, from which it is held and not a ramp
COARSE = 1e-5  # of its range, from which the rounding of u counts
COARSER = 5.0  # quanta of y, from which steps of u hide how y is rounded
HATS = 7  # of a bent scale
PROFILED = 15  # gaps of a profile
WHITE = 1.35  # rms of residuals over that of their changes, from which they depend on one another
GIVEN = 3  # numbers that strokes have given up
SURE = 0.9  # of chi squared, from which strokes are taken to differ
ROUNDED = 0.45  # quanta of rms that rounding alone leaves
SLOWEST, FASTEST = 30.0, 0.5  # samples of a time constant
RATES = 7  # time constants of a scan


class Positions(NamedTuple):
    """Two positions, read at the same times.

    Attributes:
        t: times (N) [s], increasing.
        u: the position ahead of the gap (N).
        y: the position behind it (N).
        input_quantum, quantum: by which u and y are rounded; 0 if they are not.
        is_goal: whether u is a goal, exact as it is written.
    """

    t: Floats
    u: Floats
    y: Floats
    input_quantum: float = 0.0
    quantum: float = 0.0
    is_goal: bool = False


class Structure(NamedTuple):
    """Structure of a fit beside gap, gain and level.

    Attributes:
        lags: equal lags of first order ahead of the gap.
        late: whether y may be late.
        bent: whether the scale is bent.
    """

    lags: int = 0
    late: bool = False
    bent: bool = False


class LostMotion(NamedTuple):
    """A fit of (P1).

    Attributes:
        structure: of the fit.
        gap: c [u].
        delay: T [s].
        lag: time constant of each lag [s].
        start: where in the gap the record begins, in half widths.
        gain: R [y/u], over the whole range.
        level: b [y].
        residual: e (N) [y].
        numbers: how many numbers were fitted.
    """

    structure: Structure
    gap: float
    delay: float
    lag: float
    start: float
    gain: float
    level: float
    residual: Floats
    numbers: int

    @property
    def squares(self) -> float:
        """Return the sum of the squared residuals [y^2]."""
        return float(self.residual @ self.residual)

    @property
    def rms(self) -> float:
        """Return the rms of the residuals [y]."""
        return math.sqrt(self.squares / self.residual.size)

    @property
    def colour(self) -> float:
        """Return the rms of the residuals over that of their changes, 1 if they are white."""
        changes = np.diff(self.residual)
        return self.rms / max(math.sqrt(float(changes @ changes) / (2 * changes.size)), 1e-300)

    def bic(self) -> float:
        """Return the BIC of white residuals."""
        size = self.residual.size
        return size * math.log(self.squares / size + 1e-300) + self.numbers * math.log(size)


class MotionFit:
    """Least squares of (P1) on two positions.

    Args:
        data: the positions.
        structure: of the fit.
    """

    def __init__(self, data: Positions, structure: Structure) -> None:
        self.data, self.structure = data, structure
        self.step = float(np.median(np.diff(data.t)))
        self.range = float(np.ptp(data.u))
        still = float(np.mean(np.diff(data.u) == 0)) > HELD
        self.is_held = still or data.input_quantum > COARSE * self.range

    def moved(self, delay: float, lag: float) -> Floats:
        """Return the position ahead of the gap, late and lagging (N) [u]."""
        data, u = self.data, self.data.u
        if self.structure.lags and lag > 0:
            u = lag_signal(u, data.t, lag, self.structure.lags)
        if delay <= 0:
            return u
        if self.is_held and not self.structure.lags:  # a mean of two has less noise of rounding
            held = np.searchsorted(data.t, data.t - delay + 1e-6 * self.step, side="right") - 1
            return np.asarray(u[np.clip(held, 0, None)])
        return np.interp(data.t - delay, data.t, u)

    def residuals(self, ahead: Floats, gaps: Floats, start: float) -> tuple[Floats, Floats]:
        """Return the residuals (N x K) of several gaps (K), and the levels behind them (N x K)."""
        half = gaps / 2
        wide = np.repeat(ahead[:, None], gaps.size, axis=1)
        passed = levels(wide, half, half, ahead[0] + start * half)
        y = self.data.y - self.data.y.mean()
        if self.structure.bent:
            columns = [y - self._bent_part(one, y) for one in passed.T]
            return np.column_stack(columns), passed
        rest = passed - passed.mean(axis=0)
        share = np.maximum(np.einsum("nk,nk->k", rest, rest), 1e-300)
        return y[:, None] - rest * (y @ rest / share), passed

    def _bent_part(self, passed: Floats, y: Floats) -> Floats:
        """Return the part by a bent scale of readings without their mean (N)."""
        columns = self._scale(passed)
        return np.asarray(columns @ np.linalg.lstsq(columns, y, rcond=1e-10)[0])

    def _scale(self, passed: Floats) -> Floats:
        """Return the columns of a bent scale (N x K)."""
        return hat_functions(passed, np.linspace(passed.min(), passed.max(), HATS))

    def squares(self, gaps: Floats, delay: float, lag: float) -> Floats:
        """Return the sums of squares of several gaps (K), each from the start that suits it."""
        ahead = self.moved(delay, lag)
        every = [self.residuals(ahead, gaps, start)[0] for start in STARTS]
        return np.min([np.einsum("nk,nk->k", e, e) for e in every], axis=0)

    def fit(self, gaps: Floats | None = None) -> LostMotion:
        """Return the best fit.

        Args:
            gaps: those that are allowed (K) [u]; None: all up to most of the range.
        """
        scanned = np.linspace(0.0, WIDEST * self.range, SCANNED) if gaps is None else gaps
        costs = [(float(self.squares(scanned, *one).min()), one) for one in self._places()]
        begun = [self._look_closely(scanned, one) for _, one in sorted(costs)[:KEPT]]
        ends = [self._climb(one, gaps is None) for one in begun]
        best = min(ends, key=self._cost)
        return self.result(float(best[0]), (float(best[1]), float(best[2])))

    def _cost(self, at: Floats) -> float:
        """Return the sum of squares at gap, delay and time constant."""
        return float(self.squares(at[:1], *at[1:])[0])

    def _look_closely(self, scanned: Floats, place: tuple[float, float]) -> Floats:
        """Return the best gap of a scan that gets finer, with its place."""
        gap = float(scanned[np.argmin(self.squares(scanned, *place))])
        width = float(scanned[1] - scanned[0]) if scanned.size > 1 else 0.0
        while width > FINEST * self.range:
            near = np.clip(gap + width * np.linspace(-1, 1, FINE), 0.0, None)
            gap = float(near[np.argmin(self.squares(near, *place))])
            width *= 2.0 / (FINE - 1)
        return np.array([gap, *place])

    def _climb(self, at: Floats, moves: bool) -> Floats:
        """Return gap, delay and time constant of least squares near a start.

        Args:
            at: the start.
            moves: whether the gap is free.
        """
        one = self.structure
        free = np.flatnonzero([moves, one.late, one.lags > 0])
        if not free.size:
            return at
        cost, damping = self._cost(at), 1e-3
        for _ in range(CLIMBED):
            rows, e = self._slopes(at, free)
            normal = rows.T @ rows
            for _ in range(6):
                size = damping * np.diag(np.diag(normal)) + 1e-300 * np.eye(free.size)
                tried = at.copy()
                tried[free] -= np.linalg.lstsq(normal + size, rows.T @ e, rcond=1e-12)[0]
                tried = np.clip(tried, 0.0, None)
                reached = self._cost(tried)
                if reached < cost:
                    break
                damping *= 8.0
            else:
                return at
            gained, at, cost = cost - reached, tried, reached
            damping = max(damping / 8.0, 1e-9)
            if gained < 1e-7 * cost:
                break
        return at

    def _slopes(self, at: Floats, free: Integers) -> tuple[Floats, Floats]:
        """Return the derivatives of the residual by free numbers (N x K), and the residual (N)."""
        start = self._start(at)
        e = self._residual(at, start)
        sizes = 1e-2 * np.array([0.01 * self.range, self.step, self.step])
        rows = []
        for k in free:
            moved = at.copy()
            moved[k] += sizes[k]
            rows.append((self._residual(moved, start) - e) / sizes[k])
        return np.column_stack(rows), e

    def _residual(self, at: Floats, start: float) -> Floats:
        """Return the residual at gap, delay and time constant (N)."""
        return np.asarray(self.residuals(self.moved(*at[1:]), at[:1], start)[0][:, 0])

    def _start(self, at: Floats) -> float:
        """Return where in the gap the record begins best, in half widths."""
        return min(STARTS, key=lambda one: float(np.sum(self._residual(at, one) ** 2)))

    def _places(self) -> list[tuple[float, float]]:
        """Return the delays and time constants of the scan."""
        delays, lags = [0.0], [0.0]
        if self.structure.late:
            delays = list(np.linspace(0.0, LATEST, DELAYS) * self.step)
        if self.structure.lags:
            lags = list(np.geomspace(FASTEST, SLOWEST, RATES) * self.step)
            delays = delays[::4]
        return list(itertools.product(delays, lags))

    def result(self, gap: float, place: tuple[float, float]) -> LostMotion:
        """Return a fit with its residuals."""
        at = np.array([gap, *place])
        start = self._start(at)
        residual, passed = (
            part[:, 0] for part in self.residuals(self.moved(*place), at[:1], start)
        )
        gain, level = np.polyfit(passed, self.data.y, 1)
        one = self.structure
        scale = HATS if one.bent else 2
        numbers = scale + 2 + one.late + (one.lags > 0)  # and the variance
        return LostMotion(one, gap, *place, start, float(gain), float(level), residual, numbers)

    # --- How well the gap is known

    def interval(self, found: LostMotion) -> Interval:
        """Return the 95 % interval of the gap [u], not below 0: of its profile, by blocks.

        Args:
            found: the best fit; what its residuals do not show of rounding is added.
        """
        size = found.residual.size
        blocks = reversal_blocks(self.data.u, found.gap)
        degrees = max(size - found.numbers, 1.0)
        naive = found.squares / degrees
        wider, blocked = self._clustering(found, blocks, naive)
        if found.colour > WHITE or wider > chi2.ppf(SURE, blocked) / blocked:
            degrees = blocked
        else:
            wider = 1.0
        limit = found.squares + naive * wider * student_quantile(degrees) ** 2
        error = math.sqrt(naive * wider / max(self.information(found), 1e-300))
        span = min(max(6.0 * error, 1e-9 * self.range), WIDEST * self.range)
        for _ in range(12):
            gaps = np.clip(found.gap + span * np.linspace(-1, 1, PROFILED), 0.0, None)
            costs = self._profile(gaps, found)
            inside = gaps[costs <= limit]
            ends = inside.size and (inside[0] > gaps[0] or gaps[0] == 0)
            if (ends and inside[-1] < gaps[-1]) or span > WIDEST * self.range:
                break
            span *= 2.0
        low = high = found.gap
        if inside.size:
            low, high = _crossing(gaps, costs, limit, -1), _crossing(gaps, costs, limit, 1)
        data, rounded = self.data, 0.0
        coarse = abs(found.gain) * data.input_quantum > COARSER * data.quantum
        if data.is_goal or coarse:  # motion that is read dithers what is rounded
            unseen = max(data.quantum**2 - 12 * found.rms**2, 0.0)
            rounded = math.sqrt(unseen) / max(abs(found.gain), 1e-300)
        else:  # but where u turns its rounding stays until the gap is crossed
            rounded = data.input_quantum / math.sqrt(12 * (1 + blocks[-1]))
        below, above = (math.hypot(abs(end - found.gap), rounded) for end in (low, high))
        return Interval(found.gap, max(found.gap - below, 0.0), found.gap + above)

    def _profile(self, gaps: Floats, found: LostMotion) -> Floats:
        """Return the sums of squares of gaps (K), with all other numbers free."""
        at = np.array([found.gap, found.delay, found.lag])
        one = self.structure
        if not (one.late or one.lags):
            return self.squares(gaps, *at[1:])
        costs = np.empty(gaps.size)
        middle = int(np.argmin(np.abs(gaps - found.gap)))
        for places in (range(middle, gaps.size), range(middle - 1, -1, -1)):
            now = at
            for k in places:  # from where the last climb ended
                now = self._climb(np.array([gaps[k], *now[1:]]), False)
                costs[k] = self._cost(now)
        return costs

    def _slope(self, found: LostMotion) -> Floats:
        """Return the derivative of the residual by the gap, less what other numbers hold (N)."""
        one = self.structure
        at = np.array([found.gap, found.delay, found.lag])
        free = np.flatnonzero([True, one.late, one.lags > 0])
        rows, _ = self._slopes(at, free)
        if free.size == 1:
            return rows[:, 0]
        return regression_residual(rows[:, 1:], rows[:, 0])

    def information(self, found: LostMotion) -> float:
        """Return the sum of the squared derivatives of the residual by the gap.

        Args:
            found: the best fit.
        """
        slope = self._slope(found)
        return float(slope @ slope)

    def _clustering(self, found: LostMotion, blocks: Integers, naive: float) -> tuple[float, float]:
        """Return the variance of the score by blocks over that of white residuals, at least 1, and
        its degrees of freedom.
        """
        score = self._slope(found) * found.residual
        sums = np.bincount(blocks, score)
        count = sums.size
        spread = float(sums @ sums) * count / max(count - GIVEN, 1)  # gap, gain, level are fitted
        white = max(naive * self.information(found), 1e-300)
        return max(spread / white, 1.0), max(count - 1.0, 2.0)


def lag_signal(u: Floats, t: Floats, lag: float, count: int) -> Floats:
    """Return a signal behind equal lags of first order (N), from rest.

    Args:
        u: the signal (N).
        t: times (N) [s].
        lag: time constant of each [s].
        count: how many there are.
    """
    steps = np.diff(t)
    typical = float(np.median(steps))
    if np.ptp(steps) < 0.02 * typical:
        keep = math.exp(-typical / lag)
        for _ in range(count):
            u = lfilter([0.0, 1 - keep], [1.0, -keep], u, zi=[u[0]])[0]
        return np.asarray(u)
    kept = np.exp(-steps / lag)
    for _ in range(count):
        out = np.empty(u.size)
        now = out[0] = u[0]
        for k, keep in enumerate(kept):
            now = keep * now + (1 - keep) * u[k]
            out[k + 1] = now
        u = out
    return u


def reversal_blocks(u: Floats, gap: float) -> Integers:
    """Return the number of the stroke of each sample (N): it ends where u turned by a gap.

    Args:
        u: the position ahead of the gap (N).
        gap: c [u], or less than which a turn is none.
    """
    least = max(gap, 0.02 * float(np.ptp(u)))
    followed = levels(u[:, None], np.array([least / 2]), np.array([least / 2]), u[:1])[:, 0]
    ways = np.sign(np.diff(followed, prepend=followed[0]))
    moving = np.flatnonzero(ways)
    turned = np.zeros(u.size, int)
    turned[moving[1:]] = ways[moving[1:]] != ways[moving[:-1]]
    return np.cumsum(turned)


def _crossing(gaps: Floats, costs: Floats, limit: float, side: int) -> float:
    """Return where a profile passes its limit on a side, by interpolation [u]."""
    inside = np.flatnonzero(costs <= limit)
    last = inside[0] if side < 0 else inside[-1]
    beyond = last + side
    if not 0 <= beyond < gaps.size or gaps[beyond] == gaps[last]:
        return float(gaps[last])
    share = (limit - costs[last]) / max(costs[beyond] - costs[last], 1e-300)
    return float(gaps[last] + min(share, 1.0) * (gaps[beyond] - gaps[last]))


def motion_density(name: str, found: LostMotion, scale: float) -> Density:
    """Return the log density of each reading, residuals being white, for odds among rivals.

    Args:
        name: of the model.
        found: its fit.
        scale: least residual by rounding [y].
    """
    variance = found.rms**2 + scale**2
    value = -0.5 * found.residual**2 / variance - 0.5 * math.log(2 * math.pi * variance)
    return Density(name, np.asarray(value), found.numbers, found.rms)


def best_structure(
    data: Positions, structures: Sequence[Structure], gaps: Floats | None = None
) -> tuple[MotionFit, LostMotion]:
    """Return the fit of least BIC, and its least squares.

    Args:
        data: the positions.
        structures: which are tried.
        gaps: those that are allowed (K) [u]; None: all up to most of the range.
    """
    tried = [MotionFit(data, one) for one in structures]
    every = [(one, one.fit(gaps)) for one in tried]
    return min(every, key=lambda pair: pair[1].bic())


def is_white(found: LostMotion, quantum: float) -> bool:
    """Return whether residuals are noise, or rounding.

    Args:
        found: a fit.
        quantum: of the readings [y].
    """
    return found.colour <= WHITE or found.rms <= ROUNDED * quantum
