"""Maximisation of a log likelihood, and the uncertainty of its maximum.

The climb is Levenberg and Marquardt's. Intervals hold whatever the colour of the disturbance: their
covariance is estimated by cosines (I1).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial, wraps
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from scipy.fft import dct
from scipy.linalg.lapack import dgesv
from scipy.stats import t as student

from undeadzone.compile import lanes
from undeadzone.errors import InputError
from undeadzone.util.answers import Answers
from undeadzone.util.arrays import Floats, Integers

GAUSSIAN = 2 / 3  # of the fourth power of a Gaussian: what 3 s^4 holds beyond s^4
LEAST_KEPT = 0.05  # share of a variance below which nothing is left of it

# --- The climb


class Target(Protocol):
    """Log likelihood of parameters theta; `free` are the places of variable parameters."""

    free: Integers

    @property
    def gain(self) -> float:
        """Return the least gain of a step: two smaller steps in a row stop the
        maximisation.
        """

    @property
    def longest(self) -> Floats | float:
        """Return the longest step of each free parameter, or of all."""

    @property
    def climbs(self) -> CachedMaxima | None:
        """Return the cache of maxima on disk; None without a cache."""

    def total_log_likelihood(self, theta: Floats) -> float:
        """Return the log likelihood; -inf if theta is inadmissible."""

    def quadratic_model(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """Return value, score and a positive Hessian of minus the value, for the free
        parameters.
        """

    def project_to_bounds(self, theta: Floats) -> Floats:
        """Restrict a trial to its bounds; the trial may be changed in place."""


class Maximum(NamedTuple):
    """Maximum of a log likelihood: the parameters and the value."""

    theta: Floats
    value: float


def array_digest(numbers: Floats) -> str:
    """Return a hash that identifies an array."""
    return hashlib.blake2b(numbers.tobytes(), digest_size=16).hexdigest()


class CachedMaxima:
    """Maxima on disk: a repeated identification of a log reads them.

    Args:
        answers: the file; a log asks for its climbs in the same order each time.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers: Answers | None = answers
        self._count = 0

    def stop_caching(self) -> None:
        """Stop the cache: later maximisations, as for a figure, are not part of the
        answer.
        """
        self._answers = None

    def find_maximum(self, start: Floats, compute: Callable[[], Maximum]) -> Maximum:
        """Return the next maximum, read from the file or computed and cached.

        Args:
            start: where the climb begins (P).
            compute: climbs.
        """
        if self._answers is None:
            return compute()
        self._count += 1
        question = [self._count, array_digest(start)]

        def yield_maximum(missing: list[int]) -> Iterator[tuple[int, Any]]:
            """Yield the computed maximum as an answer of the cache."""
            top = compute()
            yield 0, [top.theta.tolist(), float(top.value)]

        theta, value = self._answers.compute_missing([question], yield_maximum)[0]
        return Maximum(np.array(theta), value)


def maximise_likelihood(
    target: Target, start: Floats, steps: int, gain: float | None = None
) -> Maximum:
    """Raise a log likelihood by damped Newton steps.

    Args:
        target: the log likelihood.
        start: where to start (P).
        steps: how many trials at most.
        gain: in place of the target's own.

    Returns:
        The best theta found; the start with a value of -inf where that makes no sense.
    """
    theta = target.project_to_bounds(start.copy())
    if not math.isfinite(target.total_log_likelihood(theta)):
        return Maximum(theta, -math.inf)
    compute = partial(_maximise_from, target, theta, steps, target.gain if gain is None else gain)
    return compute() if target.climbs is None else target.climbs.find_maximum(theta, compute)


def _maximise_from(target: Target, theta: Floats, steps: int, gain: float) -> Maximum:
    """Find the maximum from an admissible theta by Levenberg-Marquardt steps."""
    top, best = theta, target.quadratic_model(theta)
    damping, small = 1e-2, 0
    for _ in range(steps):
        current, score, hessian = best
        step = _damped_newton_step(score, hessian, damping)
        trial = top.copy()
        trial[target.free] += np.clip(step, -target.longest, target.longest)
        trial = target.project_to_bounds(trial)
        reached = target.total_log_likelihood(trial)
        if not reached > current:
            damping *= 6
            if damping > 1e8:
                return Maximum(top, current)
            continue
        damping = max(damping / 5, 1e-9)
        small = small + 1 if reached - current < gain + 1e-8 * abs(reached) else 0
        if small >= 2:
            return Maximum(trial, reached)
        top, best = trial, target.quadratic_model(trial)
    return Maximum(top, best[0])


def _damped_newton_step(score: Floats, hessian: Floats, damping: float) -> Floats:
    """Return the damped Newton step, scaled by the Hessian's diagonal (P)."""
    diagonal = np.maximum(hessian.diagonal(), 0.0)
    scale = np.sqrt(diagonal + 1e-14 * diagonal.sum()) + 1e-12
    damped = hessian / (scale[:, None] * scale)
    damped.flat[:: scale.size + 1] += damping
    *_, step, singular = dgesv(damped, score / scale)
    step = score / scale**2 if singular else step / scale
    return step if np.isfinite(step).all() else np.zeros(scale.size)


def best_maximum(
    target: Target, starts: Sequence[Floats], first: int, last: int, lead: float = math.inf
) -> Maximum | None:
    """Return the best of the maxima from several starts.

    Args:
        target: the log likelihood.
        starts: where to start.
        first: steps of all of them; 0: all go to the end.
        last: steps of the best two after that.
        lead: by how much the best must lead by then to go on alone.

    Returns:
        The best top; None if no start makes sense.
    """
    begun = list(starts)
    if first:
        tops = [maximise_likelihood(target, start, first) for start in starts]
        tops.sort(key=lambda top: -top.value)
        alone = len(tops) > 1 and tops[0].value - tops[1].value > lead
        best = tops[:1] if alone else tops[:2]
        begun = [top.theta for top in best]
    ends = [maximise_likelihood(target, theta, last) for theta in begun]
    ends = [top for top in ends if math.isfinite(top.value)]
    return max(ends, key=lambda top: top.value, default=None)


Found = TypeVar("Found")


def cache_latest(compute: Callable[[Any, Floats], Found]) -> Callable[[Any, Floats], Found]:
    """Return a method of theta (P) that caches its latest result.

    Args:
        compute: the method.
    """
    place = f"_latest_{compute.__name__}"

    @wraps(compute)
    def kept(self: Any, theta: Floats) -> Found:
        """Return the cached result if theta is unchanged, else compute the result."""
        numbers = theta.tobytes()
        known, found = vars(self).get(place, (None, None))
        if known != numbers:
            found = compute(self, theta)
            vars(self)[place] = numbers, found
        return found

    return kept


# --- Derivatives by differences


def run_lanes_along(kernel: lanes.Kernel, exogenous: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Run a compiled step along a log for several parameter sets, from states of zero.

    Args:
        kernel: the step.
        exogenous: its inputs (N x inputs).
        rows: the sets (K x numbers).

    Returns:
        Outputs (K x N x outputs) and final states (K x states).
    """
    states, _, numbers = kernel.shape.sizes
    at_first, none = np.zeros(states), np.zeros(numbers)
    return lanes.run_lanes(kernel, at_first, exogenous, none, lane_params=rows, threads=1)


def perturb_each(theta: Floats, free: Integers, steps: Floats) -> Floats:
    """Return theta, then each free parameter increased, then each decreased (1 + 2 free, P)."""
    moves, each = np.zeros((1 + 2 * free.size, theta.size)), np.arange(1, 1 + free.size)
    moves[each, free] = steps
    moves[each + free.size, free] = -steps
    return theta + moves


def central_differences(moved: Floats, steps: Floats) -> Floats:
    """Return derivatives by the free parameters (free x ...) from values at the perturbed
    points.
    """
    more, less = np.split(moved, 2)
    return np.asarray((more - less).T / (2 * steps)).T


# --- How surely it is known


class Interval(NamedTuple):
    """Value with its 95 % interval."""

    value: float
    low: float
    high: float

    @staticmethod
    def from_half_width(value: float, half: float) -> Interval:
        """Return an interval symmetric about a value."""
        return Interval(value, value - half, value + half)

    def scale_by(self, factor: float) -> Interval:
        """Return the interval in other units."""
        return Interval(self.value * factor, self.low * factor, self.high * factor)

    def stretch_by(self, factor: float) -> Interval:
        """Return the interval with both halves multiplied by a factor."""
        below, above = self.value - self.low, self.high - self.value
        return Interval(self.value, self.value - factor * below, self.value + factor * above)

    def extend_by(self, below: float, above: float) -> Interval:
        """Return the interval extended downwards and upwards."""
        return Interval(self.value, self.low - below, self.high + above)

    @property
    def half_width(self) -> float:
        """Return half the width of the interval."""
        return 0.5 * (self.high - self.low)


class EstimateCovariance(NamedTuple):
    """Covariance of estimates, robust and naive.

    Attributes:
        V: robust covariance H^-1 J H^-1 (P x P).
        naive: H^-1 (P x P), right for independent samples only.
        degrees: cosines K from which J was estimated.
        scores: of each sample (N x P).
    """

    V: Floats
    naive: Floats
    degrees: int
    scores: Floats

    def variance_and_degrees(self, direction: Floats) -> tuple[float, float]:
        """Return the bias-corrected variance of direction' theta and its degrees of
        freedom.

        Where a few samples tell of an edge, the cosines that they enter are few, and the fit has
        used up part of what they scatter: docs/identify.md, "Few passages".
        """
        variance = max(float(direction @ self.V @ direction), 0.0)
        kept, degrees = few_sample_correction(self.scores, self.naive @ direction, self.degrees)
        return variance / kept, degrees

    def half_and_degrees(self, direction: Floats) -> tuple[float, float]:
        """Return half the 95 % interval of direction' theta, and its degrees of freedom."""
        variance, degrees = self.variance_and_degrees(direction)
        return student_quantile(degrees) * variance**0.5, degrees

    def half_width(self, direction: Floats) -> float:
        """Return half the 95 % interval of direction' theta."""
        return self.half_and_degrees(direction)[0]


def few_sample_correction(scores: Floats, row: Floats, count: int) -> tuple[float, float]:
    """Return share and degrees of freedom of a variance that a few samples dominate.

    References:
        F. E. Satterthwaite (1946), doi:10.2307/3002019

    Args:
        scores: of each sample at the estimate (N x P).
        row: H^-1 c, for the estimate c' theta (P).
        count: cosines K.

    Returns:
        The expected share of the variance that the cosines show after the fit (Bell and McCaffrey
        2002), and the degrees of freedom of that (Satterthwaite 1946), at least 1.
    """
    told = scores @ row  # by each sample, of the estimate
    squares = told**2
    total = float(squares.sum())
    if total <= 0:
        return 1.0, float(count)
    angle = np.pi * (np.arange(told.size) + 0.5) / told.size
    weights = count / 2 + (np.sin((2 * count + 1) * angle) / np.sin(angle) - 1) / 4  # sum of cos^2
    power = 0.5 * dct(squares)[: 2 * count + 1]
    k = np.arange(1, count + 1)
    shared = power[np.abs(k[:, None] - k)] + power[k[:, None] + k]  # covariance of the cosines
    excess = GAUSSIAN * float(np.sum((2 * weights * squares) ** 2))
    degrees = (np.trace(shared) ** 2 - excess) / max(float(np.sum(shared**2)) - excess, 1e-300)
    white = scores @ _score_whitener(scores)
    lever = np.einsum("ij,ij->i", white, white)
    used = np.sum((0.5 * dct(white * told[:, None], axis=0)[1 : count + 1]) ** 2)
    used -= GAUSSIAN * np.sum(weights * lever * squares)
    kept = 1 - 2 / count * float(used) / total
    return max(kept, LEAST_KEPT), float(np.clip(degrees, 1, count))


def _score_whitener(scores: Floats) -> Floats:
    """Return W with W W' the inverse of the sum of the scores' outer products (P x P)."""
    scale = 1 / np.sqrt(np.sum(scores**2, axis=0) + 1e-300)
    values, vectors = np.linalg.eigh(require_finite_matrix((scores * scale).T @ (scores * scale)))
    whitener = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-10))
    return np.asarray(whitener * (values > 1e-10))


def require_finite_matrix(matrix: Floats) -> Floats:
    """Require a finite matrix, before its decomposition.

    Raises:
        InputError: a fit of which so little is known that its derivatives overflow.
    """
    if not np.isfinite(matrix).all():
        raise InputError(
            "log: what the readings tell of the plant overflows. Try a lower --order, or a log"
            " whose readings move more"
        )
    return matrix


def student_quantile(degrees: float, level: float = 0.95) -> float:
    """Return Student's two-sided quantile."""
    return float(student.ppf(0.5 + level / 2, degrees))


def long_run_covariance(scores: Floats, count: int | None = None) -> tuple[Floats, int]:
    """Return the covariance of sum(scores) and its degrees of freedom.

    Args:
        scores: one row a sample (N x P), correlated in any way that dies out.
        count: cosines; default 0.4 N^(2/3) (Lazarus and others 2018), between 8 and N / 8.

    Returns:
        J (P x P) and K.
    """
    parts = cosine_coefficients(scores, count)
    return len(scores) * (parts.T @ parts) / len(parts), len(parts)


def cosine_coefficients(scores: Floats, count: int | None = None) -> Floats:
    """Return the slow cosine coefficients of scores (K x P), as for `long_run_covariance`."""
    size = scores.shape[0]
    number = max(8, min(int(0.4 * size ** (2 / 3)), size // 8)) if count is None else count
    return np.asarray(dct(scores, axis=0, norm="ortho")[1 : number + 1])


def sandwich_covariance(
    scores: Floats, hessian: Floats, count: int | None = None
) -> EstimateCovariance:
    """Return the robust covariance (I1) of an estimate.

    Args:
        scores: of each sample at the estimate (N x P).
        hessian: minus the second derivative of the log likelihood (P x P).
        count: cosines; default as in `long_run_covariance`.

    Returns:
        Covariances and degrees of freedom.
    """
    J, number = long_run_covariance(scores, count)
    inverse = np.linalg.pinv(require_finite_matrix(hessian), rcond=1e-13, hermitian=True)
    return EstimateCovariance(inverse @ J @ inverse, inverse, number, scores)


def raise_eigenvalues(hessian: Floats) -> Floats:
    """Return a Hessian with its scaled eigenvalues raised to at least 1e-6 of the largest."""
    both = 0.5 * (hessian + hessian.T)
    scale = 1 / np.sqrt(np.abs(np.diag(both)) + 1e-300)
    values, vectors = np.linalg.eigh(require_finite_matrix(both * np.outer(scale, scale)))
    raised = np.maximum(values, 1e-6 * values.max())
    return (vectors * raised) @ vectors.T / np.outer(scale, scale)


def raise_to_outer_products(hessian: Floats, outer: Floats, least: float = 0.5) -> Floats:
    """Return a Hessian raised to at least a share of the scores' outer products, in each
    direction.

    Args:
        hessian: minus the second derivative, by differences (P x P).
        outer: sum of the outer products of the scores (P x P).
        least: the part; both are equal where the model is right.

    Returns:
        A positive Hessian; it differs from the given one only where differences tell nothing, as
        along the logarithm of a variance that is nearly 0.
    """
    scale = 1 / np.sqrt(np.diag(outer) + 1e-300)
    values, vectors = np.linalg.eigh(require_finite_matrix(outer * np.outer(scale, scale)))
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values.max()))
    whiten = np.linalg.pinv(root)
    both = 0.5 * (hessian + hessian.T) * np.outer(scale, scale)
    sizes, axes = np.linalg.eigh(require_finite_matrix(whiten @ both @ whiten.T))
    raised = (axes * np.maximum(sizes, least)) @ axes.T
    return root @ raised @ root.T / np.outer(scale, scale)


def weight_row(
    free: Integers, size: int, first: int, weights: Sequence[float], tied: bool = False
) -> Floats:
    """Return the row of a weighted sum of parameters over the free parameters.

    Args:
        free: places of the numbers that may change.
        size: of all numbers (P).
        first: place of the first number of the sum; the others follow.
        weights: of these.
        tied: whether the second one is the first one.
    """
    row = np.zeros(size)
    row[first : first + len(weights)] = weights
    if tied:
        row[first] += row[first + 1]
    return row[free]
