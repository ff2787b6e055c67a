"""Two positions with lost motion between them, at the times at which they were read.

    y(t) = R play(F u(t - T); c) + b + e                                                     (P1)

u is one position (a goal, a motor's encoder, summed pulses), y the other (a joint, an axis, a
star). F is nothing, or lags of first order that a servo or a filter adds. There is no plant to
fit, so times need no grid: u is interpolated at t - T, or held where it moves in steps.

R, b and a bent scale enter linearly. T and the time constant are found by least squares from
several starts, for each c of a scan. The interval of c is that of its profile likelihood. If
residuals are correlated, it is widened by the variance of the score, clustered between reversals.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded
from scipy.optimize import brentq, least_squares, minimize_scalar
from scipy.stats import chi2

from undeadzone.nonlinearities.play import level_limits, levels
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.estimates import Interval, cache_latest, student_quantile
from undeadzone_identify.models.least_squares import (
    Density,
    build_gaussian_density,
    hat_functions,
    regression_residual,
)
from undeadzone_identify.models.likelihood import root_mean_square

SCANNED = 48  # gaps of a scan
WIDEST = 0.9  # largest gap [range of u]
LATEST = 6.0  # largest delay of y [samples]
DELAYS = (13, 4)  # delays of a scan, without lags and with them
FEWEST_LATE = 200  # least number of samples for which a delay is fitted
STARTS = (-1.0, 0.0, 1.0)  # positions in the gap at which a record may begin [half widths]
KEPT = 3  # best points of a scan, from which least squares start
FINEST = 1e-6  # resolution of a gap [range of u]
CLIMBED = 25  # steps of least squares
HELD = 0.5  # share of samples without a change of u, above which u is held between its steps
COARSE = 1e-5  # quantum of u above which u is held between its steps [range of u]
COARSER = 5.0  # quanta of y, above which steps of u determine how y is rounded
HATS = 7  # linear splines of a bent scale
WHITE = 1.35  # largest ratio of `LostMotion.colour` for white residuals
GIVEN = 3  # degrees of freedom that the fit takes from the sums over strokes: gap, gain, level
SURE = 0.9  # level of the chi-squared test for differences between strokes
ROUNDED = 0.45  # largest rms of residuals that rounding alone explains [quanta]
# limits of a time constant [samples]
SLOWEST = 30.0
FASTEST = 0.5
RATES = 7  # time constants of a scan


class Positions(NamedTuple):
    """Two positions, read at the same times.

    Attributes:
        t: times (N) [s], increasing.
        u: the position ahead of the gap (N).
        y: the position behind it (N).
        input_quantum, quantum: quanta of u and y; 0 if they are not rounded.
        is_goal: whether u is a goal of a servo, which is exact.
    """

    t: Floats
    u: Floats
    y: Floats
    input_quantum: float = 0.0
    quantum: float = 0.0
    is_goal: bool = False


class Structure(NamedTuple):
    """Parts of a fit beside gap, gain and level.

    Attributes:
        lags: number of equal first-order lags ahead of the gap.
        late: whether a delay of y is fitted.
        bent: whether the scale from u to y may be a curve.
    """

    lags: int = 0
    late: bool = False
    bent: bool = False


class LostMotion(NamedTuple):
    """Fit of (P1).

    Attributes:
        structure: its parts.
        gap: c [u].
        delay: T [s].
        lag: time constant of each lag [s].
        start: position in the gap at which the record begins [half widths].
        gain: R [y/u], the mean over the range.
        level: b [y].
        residual: e (N) [y].
        numbers: number of fitted parameters.
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
        return root_mean_square(self.residual)

    @property
    def colour(self) -> float:
        """Return the rms of the residuals over that of their changes / sqrt(2); 1 if white [1]."""
        changes = root_mean_square(np.diff(self.residual)) / math.sqrt(2)
        return self.rms / max(changes, 1e-300)

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
        self.data = data
        self.structure = structure
        self.step = float(np.median(np.diff(data.t)))
        self.range = float(np.ptp(data.u))
        still = np.mean(np.diff(data.u) == 0) > HELD
        self.is_held = still or data.input_quantum > COARSE * self.range
        self.y = data.y - data.y.mean()
        self.differences = 1e-2 * np.array([0.01 * self.range, self.step, self.step])

    @cache_latest
    def delay_and_lag(self, lags: Floats) -> Floats:
        """Return the position ahead of the gap: u after its lags and a delay (N) [u].

        Args:
            lags: delay, and time constant of each of the structure's first-order lags (2) [s].
        """
        delay, lag = lags.tolist()
        data = self.data
        u = self.data.u
        if self.structure.lags and lag > 0:
            u = lag_signal(u, data.t, lag, self.structure.lags)
        if delay <= 0:
            return u
        # A held u is that of the last sample before t - delay. Interpolation would average two
        # samples, and so reduce the rounding error. 1e-6 of a step absorbs the rounding of t.
        if self.is_held and not self.structure.lags:
            sample_before = (
                np.searchsorted(data.t, data.t - delay + 1e-6 * self.step, side="right") - 1
            )
            return u[np.clip(sample_before, 0, None)]
        return np.interp(data.t - delay, data.t, u)

    def residuals(
        self, gaps: Floats, lags: Floats, starts: Sequence[float] = STARTS
    ) -> list[tuple[Floats, Floats]]:
        """Return the residuals of K gaps, and the positions behind them (N x K), by start.

        Args:
            gaps: widths of the gaps (K) [u].
            lags: delay and time constant (2) [s].
            starts: positions in the gap at which the record begins [half widths].
        """
        ahead = self.delay_and_lag(lags)
        half = gaps / 2
        limits = level_limits(ahead[:, None], half, half)
        sides = [np.clip(ahead[0] + start * half, *limits) for start in starts]
        return [(self._regress_reading(behind), behind) for behind in sides]

    def _regress_reading(self, behind: Floats) -> Floats:
        """Return the residuals of y, regressed on each position behind a gap (N x K)."""
        if self.structure.bent:
            return np.column_stack(list(map(self._leave_curve, behind.T)))
        centred = behind - behind.mean(axis=0)
        power = np.maximum(np.sum(centred**2, axis=0), 1e-300)
        return self.y[:, None] - centred * (self.y @ centred / power)

    def _leave_curve(self, behind: Floats) -> Floats:
        """Return y less the nearest curve of the position behind the gap (N)."""
        columns = hat_functions(behind, np.linspace(behind.min(), behind.max(), HATS))
        return regression_residual(columns, self.y)

    def squares(self, gaps: Floats, delay: float, lag: float) -> Floats:
        """Return the sums of squared residuals of K gaps (K), each from its best start."""
        found = self.residuals(gaps, np.array([delay, lag]))
        return _sum_squares_by_start(found).min(axis=0)

    def fit(self, gaps: Floats | None = None) -> LostMotion:
        """Return the best fit.

        Args:
            gaps: gaps that are allowed (K) [u]; None: all up to WIDEST.
        """
        scanned = np.linspace(0.0, WIDEST * self.range, SCANNED) if gaps is None else gaps
        starts = []
        for lags in self._scan_lags():
            costs = self.squares(scanned, *lags)
            starts.append((costs.min(), scanned[np.argmin(costs)], *lags))
        kept = sorted(starts)[:KEPT]
        ends = [self._minimise(self._refine(np.array(at), gaps), gaps is None) for _, *at in kept]
        return self.result(min(ends, key=self._cost))

    def _refine(self, at: Floats, gaps: Floats | None) -> Floats:
        """Return gap, delay and time constant (3) with the best gap next to one of the scan."""
        if gaps is not None:
            return at
        near = at[0] + np.array([-1, 1]) * WIDEST * self.range / (SCANNED - 1)
        found = minimize_scalar(
            lambda gap: self._cost(np.array([gap, *at[1:]])),
            bounds=np.maximum(near, 0.0),
            options={"xatol": FINEST * self.range},
        )
        return min(at, np.array([found.x, *at[1:]]), key=self._cost)

    def _cost(self, at: Floats) -> float:
        """Return the sum of squared residuals at gap [u], delay [s] and time constant [s] (3)."""
        return float(np.sum(self._best_start(at)[0] ** 2))

    @cache_latest
    def _best_start(self, at: Floats) -> tuple[Floats, Floats, float]:
        """Return residual and position behind the gap (N each), and where the record best begins.

        Args:
            at: gap [u], delay [s] and time constant [s] (3).
        """
        found = self.residuals(at[:1], at[1:])
        best = np.argmin(_sum_squares_by_start(found))
        e, behind = found[best]
        return e[:, 0], behind[:, 0], STARTS[best]

    def _minimise(self, at: Floats, gap_is_free: bool) -> Floats:
        """Return gap, delay and time constant of least squares (3), none below 0.

        Args:
            at: gap [u], delay [s] and time constant [s] at the start (3).
            gap_is_free: whether the gap may change.
        """
        free = np.flatnonzero([gap_is_free, self.structure.late, self.structure.lags > 0])
        if not free.size:
            return at

        def place(numbers: Floats) -> Floats:
            moved = at.copy()
            moved[free] = numbers
            return moved

        found = least_squares(
            lambda numbers: self._best_start(place(numbers))[0],
            at[free],
            lambda numbers: self._slopes(place(numbers), free),
            bounds=(0.0, np.inf),
            x_scale=self.differences[free],
            ftol=1e-7,
            max_nfev=CLIMBED,
        )
        return min(at, place(found.x), key=self._cost)

    def _slopes(self, at: Floats, free: Integers) -> Floats:
        """Return the derivatives of the residual by free numbers (N x K).

        Args:
            at: gap [u], delay [s] and time constant [s] (3).
            free: places of the free ones (K).
        """
        e, _, start = self._best_start(at)
        shifted = at + np.diag(self.differences)[free]
        moved = [self.residuals(one[:1], one[1:], [start])[0][0] for one in shifted]
        return (np.hstack(moved) - e[:, None]) / self.differences[free]

    def _scan_lags(self) -> list[tuple[float, float]]:
        """Return the delays and time constants of the scan [s]."""
        late, lags = self.structure.late, self.structure.lags
        delays = np.linspace(0.0, LATEST, DELAYS[lags > 0]) if late else np.zeros(1)
        constants = np.geomspace(FASTEST, SLOWEST, RATES) if lags else np.zeros(1)
        return list(itertools.product(self.step * delays, self.step * constants))

    def result(self, at: Floats) -> LostMotion:
        """Return the fit with a gap [u], and delay and time constant [s] (3)."""
        residual, behind, start = self._best_start(at)
        gap, delay, lag = at.tolist()
        gain, level = np.polyfit(behind, self.data.y, 1)
        structure = self.structure
        scale = HATS if structure.bent else 2
        # Scale, gap, variance, and perhaps delay and time constant.
        numbers = scale + 2 + structure.late + (structure.lags > 0)
        return LostMotion(
            structure, gap, delay, lag, start, float(gain), float(level), residual, numbers
        )

    # --- Uncertainty of the gap

    def interval(self, found: LostMotion) -> Interval:
        """Return the 95 % interval of the gap [u], not below 0.

        It contains the gaps of which the sum of squares, minimised over all other parameters, is
        below a limit. The error by rounding that residuals do not show is added in quadrature.

        Args:
            found: the best fit.
        """
        size = found.residual.size
        blocks = reversal_blocks(self.data.u, found.gap)
        degrees = max(size - found.numbers, 1.0)
        naive = found.squares / degrees
        inflation, cluster_degrees = self._clustering(found, blocks, naive)
        if found.colour > WHITE or inflation > chi2.ppf(SURE, cluster_degrees) / cluster_degrees:
            degrees = cluster_degrees
        else:
            inflation = 1.0
        limit = found.squares + naive * inflation * student_quantile(degrees) ** 2
        farthest = found.gap + WIDEST * self.range
        low, high = (self._crossing(found, limit, end) for end in (0.0, farthest))
        data = self.data
        is_coarse = abs(found.gain) * data.input_quantum > COARSER * data.quantum
        if data.is_goal or is_coarse:
            # Motion dithers the rounding of y; only the rest is not in the residuals.
            hidden = max(data.quantum**2 - 12 * found.rms**2, 0.0)
            rounding = math.sqrt(hidden) / max(abs(found.gain), 1e-300)
        else:  # the rounding error of u at a reversal stays until the gap is crossed
            rounding = data.input_quantum / math.sqrt(12 * (1 + blocks[-1]))
        below, above = (math.hypot(end - found.gap, rounding) for end in (low, high))
        return Interval(found.gap, max(found.gap - below, 0.0), found.gap + above)

    def _crossing(self, found: LostMotion, limit: float, end: float) -> float:
        """Return the gap between the best one and an end at which the profile crosses a limit [u].

        Args:
            found: the best fit.
            limit: of the sum of squares, minimised over delay and time constant.
            end: gap that is returned if its sum is below the limit.
        """

        def excess(gap: float) -> float:
            at = self._minimise(np.array([gap, found.delay, found.lag]), False)
            return self._cost(at) - limit

        if found.gap == end or excess(end) <= 0:
            return end
        if excess(found.gap) >= 0:
            return found.gap
        return float(brentq(excess, found.gap, end, xtol=FINEST * self.range))

    def gap_slope(self, found: LostMotion) -> Floats:
        """Return the derivative of the residual by the gap (N) [y/u].

        The part that delay and time constant can compensate is projected out.

        Args:
            found: the best fit.
        """
        at = np.array([found.gap, found.delay, found.lag])
        free = np.flatnonzero([True, self.structure.late, self.structure.lags > 0])
        rows = self._slopes(at, free)
        return regression_residual(rows[:, 1:], rows[:, 0])

    def _clustering(self, found: LostMotion, blocks: Integers, naive: float) -> tuple[float, float]:
        """Return the variance inflation by correlated residuals, and its degrees of freedom.

        The inflation, at least 1, is the variance of the score by the gap, clustered by strokes,
        over that of white residuals.

        Args:
            found: the best fit.
            blocks: stroke of each sample (N).
            naive: variance of the residuals [y^2].
        """
        slope = self.gap_slope(found)
        sums = np.bincount(blocks, slope * found.residual)
        count = sums.size
        clustered = float(sums @ sums) * count / max(count - GIVEN, 1)
        white = max(naive * float(slope @ slope), 1e-300)
        return max(clustered / white, 1.0), max(count - 1.0, 2.0)


def _sum_squares_by_start(found: list[tuple[Floats, Floats]]) -> Floats:
    """Return the sums of squared residuals (starts x K) of `MotionFit.residuals`."""
    return np.array([np.sum(e**2, axis=0) for e, _ in found])


def lag_signal(u: Floats, t: Floats, lag: float, count: int) -> Floats:
    """Return a signal after equal first-order lags (N), which start at rest.

    Args:
        u: the signal (N).
        t: times (N) [s].
        lag: time constant of each lag [s].
        count: number of lags.
    """
    decay = np.exp(-np.diff(t) / lag)
    bands = np.array([np.ones(t.size), np.append(-decay, 0.0)])
    for _ in range(count):
        u = solve_banded((1, 0), bands, np.append(u[0], (1 - decay) * u[:-1]))
    return u


def reversal_blocks(u: Floats, gap: float) -> Integers:
    """Return the number of the stroke of each sample (N), from 0 on.

    A new stroke begins when u has reversed by more than the gap. A play of that width follows u
    only then.

    Args:
        u: position ahead of the gap (N).
        gap: c [u]; smaller reversals do not count.
    """
    least = max(gap, 0.02 * float(np.ptp(u)))
    half = np.array([least / 2])
    output = levels(u, half, half, u[:1])
    moves = np.diff(output, prepend=output[0])
    moving = np.flatnonzero(moves)
    reverses = np.zeros(u.size, int)
    reverses[moving[1:]] = np.diff(np.sign(moves[moving])) != 0
    return np.cumsum(reverses)


def motion_density(name: str, found: LostMotion, scale: float) -> Density:
    """Return the log densities of the readings with white residuals.

    Args:
        name: name of the model.
        found: its fit.
        scale: rms of the rounding error, the least rms of the residuals [y].
    """
    variance = found.rms**2 + scale**2
    density = build_gaussian_density(name, found.residual, found.numbers, variance)
    return density._replace(rms=found.rms)


def best_structure(
    data: Positions, structures: Sequence[Structure], gaps: Floats | None = None
) -> LostMotion:
    """Return the fit of least BIC.

    Args:
        data: the positions.
        structures: structures among which BIC chooses.
        gaps: gaps that are allowed (K) [u]; None: all up to WIDEST.
    """
    fits = (MotionFit(data, structure).fit(gaps) for structure in structures)
    return min(fits, key=LostMotion.bic)


def fit_plant(data: Positions, found: LostMotion, lags: range) -> LostMotion:
    """Return the fit of any linear plant that answers at a few lags, without a gap.

    Args:
        data: the positions.
        found: a fit; only its residual and the number of its parameters are replaced.
        lags: of u; negative ones are leads [samples].
    """
    step = np.median(np.diff(data.t))
    moved = [np.interp(data.t - k * step, data.t, data.u) for k in lags]
    columns = np.column_stack([np.ones(data.t.size), *moved])
    return found._replace(residual=regression_residual(columns, data.y), numbers=len(lags) + 2)


def is_white(found: LostMotion, quantum: float) -> bool:
    """Return whether the residuals of a fit are white noise or rounding errors.

    Args:
        found: the fit.
        quantum: quantum of the readings [y].
    """
    return found.colour <= WHITE or found.rms <= ROUNDED * quantum
