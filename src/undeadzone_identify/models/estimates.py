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

RELATIVE_STEP = 1e-5  # of a parameter of a plant or an element, for differences
GAUSSIAN = 2 / 3  # (E x^4 - s^4) / E x^4 of a Gaussian: E x^4 = 3 s^4
LEAST_KEPT = 0.05  # least factor by which the fit may have shrunk an estimated variance

# --- Maximisation


class Target(Protocol):
    """Log likelihood of parameters theta; `free` are the places of variable parameters."""

    free: Integers

    @property
    def gain(self) -> float:
        """Return the least gain of a step; two smaller gains in a row end the maximisation."""

    @property
    def longest(self) -> Floats | float:
        """Return the longest step of each free parameter, or of all."""

    @property
    def climbs(self) -> CachedMaxima | None:
        """Return the cache of maxima on disk; None without a cache."""

    def total_log_likelihood(self, theta: Floats) -> float:
        """Return the log likelihood; -inf if theta is inadmissible."""

    def quadratic_model(self, theta: Floats) -> tuple[float, Floats, Floats]:
        """Return log likelihood, score (F), and a positive negative Hessian (F x F).

        The derivatives are by the F free parameters.
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
        answers: file of the maxima. Their order is the same each time a log is identified.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers: Answers | None = answers
        self._count = 0

    def stop_caching(self) -> None:
        """Compute later maxima without the cache: those for a figure are not part of a result."""
        self._answers = None

    def find_maximum(self, start: Floats, compute: Callable[[], Maximum]) -> Maximum:
        """Return the next maximum, read from the file or computed and cached.

        Args:
            start: start of the maximisation (P).
            compute: function that maximises.
        """
        if self._answers is None:
            return compute()
        self._count += 1
        question = [self._count, array_digest(start)]

        def yield_maximum(missing: list[int]) -> Iterator[tuple[int, Any]]:
            """Yield the index and the numbers of the computed maximum."""
            maximum = compute()
            yield 0, [maximum.theta.tolist(), float(maximum.value)]

        theta, value = self._answers.compute_missing([question], yield_maximum)[0]
        return Maximum(np.array(theta), value)


@np.errstate(over="ignore", invalid="ignore")  # a step that is not finite is none
def maximise_likelihood(
    target: Target, start: Floats, steps: int, gain: float | None = None
) -> Maximum:
    """Maximise a log likelihood by damped Newton steps (Levenberg and Marquardt).

    Args:
        target: the log likelihood.
        start: start of the maximisation (P).
        steps: largest number of trials.
        gain: least gain of a step, in place of the target's own.

    Returns:
        The maximum; the start with a value of -inf if the start is inadmissible.
    """
    theta = target.project_to_bounds(start.copy())
    if not math.isfinite(target.total_log_likelihood(theta)):
        return Maximum(theta, -math.inf)
    compute = partial(_maximise_from, target, theta, steps, target.gain if gain is None else gain)
    return compute() if target.climbs is None else target.climbs.find_maximum(theta, compute)


def _maximise_from(target: Target, theta: Floats, steps: int, gain: float) -> Maximum:
    """Maximise from an admissible theta (P). Arguments of `maximise_likelihood`."""
    best = theta
    model = target.quadratic_model(theta)
    damping = 1e-2
    small_gains = 0
    for _ in range(steps):
        current, score, hessian = model
        step = damped_newton_step(score, hessian, damping)
        trial = best.copy()
        trial[target.free] += np.clip(step, -target.longest, target.longest)
        trial = target.project_to_bounds(trial)
        reached = target.total_log_likelihood(trial)
        if not reached > current:
            damping *= 6
            if damping > 1e8:
                return Maximum(best, current)
            continue
        damping = max(damping / 5, 1e-9)
        is_small = reached - current < gain + 1e-8 * abs(reached)
        small_gains = small_gains + 1 if is_small else 0
        if small_gains >= 2:
            return Maximum(trial, reached)
        best = trial
        model = target.quadratic_model(trial)
    return Maximum(best, model[0])


def damped_newton_step(score: Floats, hessian: Floats, damping: float) -> Floats:
    """Return the damped Newton step (F), in units of the Hessian's diagonal.

    It is a gradient step if the damped Hessian is singular, and 0 if it is not finite.
    """
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
    """Return the largest of the maxima from several start points.

    Args:
        target: the log likelihood.
        starts: start points (P each).
        first: steps from every start point, after which the best two go on; 0: all go on. Two
            go on anyway, unless one may lead.
        last: further steps.
        lead: lead of the best over the second in log likelihood, above which it goes on alone.

    Returns:
        The maximum; None if no start is admissible.
    """
    points = list(starts)
    if first and (len(points) > 2 or lead < math.inf):
        maxima = [maximise_likelihood(target, start, first) for start in starts]
        maxima.sort(key=lambda maximum: -maximum.value)
        leads = len(maxima) > 1 and maxima[0].value - maxima[1].value > lead
        best = maxima[:1] if leads else maxima[:2]
        points = [maximum.theta for maximum in best]
    ends = [maximise_likelihood(target, point, last) for point in points]
    finite = [maximum for maximum in ends if math.isfinite(maximum.value)]
    return max(finite, key=lambda maximum: maximum.value, default=None)


Result = TypeVar("Result")


def cache_latest(compute: Callable[[Any, Floats], Result]) -> Callable[[Any, Floats], Result]:
    """Return a method of theta (P) that caches its latest result.

    Args:
        compute: the method.
    """
    attribute = f"_latest_{compute.__name__}"

    @wraps(compute)
    def cached(self: Any, theta: Floats) -> Result:
        """Return the cached result if theta is unchanged, else compute the result."""
        key = theta.tobytes()
        cached_key, result = vars(self).get(attribute, (None, None))
        if cached_key != key:
            result = compute(self, theta)
            vars(self)[attribute] = key, result
        return result

    return cached


# --- Derivatives by differences


def run_lanes_along(kernel: lanes.Kernel, exogenous: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Run a compiled step along a log for several parameter sets, from a state of zero.

    Args:
        kernel: the step.
        exogenous: its inputs (N x inputs).
        rows: the parameter sets (K x numbers).

    Returns:
        Outputs (K x N x outputs) and final states (K x states).
    """
    states, _, numbers = kernel.shape.sizes
    start = np.zeros(states)
    shared = np.zeros(numbers)
    return lanes.run_lanes(kernel, start, exogenous, shared, lane_params=rows, threads=1)


def perturbation_steps(values: Floats) -> Floats:
    """Return the step of each parameter for central differences, by its value (F)."""
    return RELATIVE_STEP * np.maximum(np.abs(values), 0.02)


def perturb_each(theta: Floats, free: Integers, steps: Floats) -> Floats:
    """Return the points of central differences (1 + 2 F, P).

    They are theta, then theta with each of F free parameters increased by its step, then decreased.

    Args:
        theta: parameters (P).
        free: places of the free parameters (F).
        steps: their steps (F).
    """
    changes = np.zeros((1 + 2 * free.size, theta.size))
    rows = np.arange(1, 1 + free.size)
    changes[rows, free] = steps
    changes[rows + free.size, free] = -steps
    return theta + changes


def central_differences(values: Floats, steps: Floats) -> Floats:
    """Return derivatives by F free parameters (F x ...).

    Args:
        values: values at the increased, then at the decreased points of `perturb_each` (2 F x ...).
        steps: steps of the parameters (F).
    """
    increased, decreased = np.split(values, 2)
    return ((increased - decreased).T / (2 * steps)).T


# --- Uncertainty


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
        """Return the interval in other units, or of the other sign."""
        return self.place(0.0, factor)

    def place(self, base: float, factor: float) -> Interval:
        """Return the interval along a line: a base, and a factor for the interval."""
        value, *ends = (base + factor * one for one in self)
        return Interval(value, min(ends), max(ends))

    def stretch_by(self, factor: float) -> Interval:
        """Return the interval with both halves multiplied by a factor."""
        below = self.value - self.low
        above = self.high - self.value
        return Interval(self.value, self.value - factor * below, self.value + factor * above)

    def extend_by(self, below: float, above: float) -> Interval:
        """Return the interval extended downwards and upwards."""
        return Interval(self.value, self.low - below, self.high + above)

    @property
    def half_width(self) -> float:
        """Return half the width of the interval."""
        return 0.5 * (self.high - self.low)


def variance_along(V: Floats, direction: Floats) -> float:
    """Return the variance of direction' theta (P) of a covariance V (P x P), not below 0."""
    return max(float(direction @ V @ direction), 0.0)


class EstimateCovariance(NamedTuple):
    """Covariance of estimates, robust and naive.

    Attributes:
        V: robust covariance H^-1 J H^-1 (P x P), J the long-run covariance of the score.
        naive: H^-1 (P x P), right for independent samples only.
        degrees: degrees of freedom of J: the number K of cosines.
        scores: score of each sample (N x P).
    """

    V: Floats
    naive: Floats
    degrees: int
    scores: Floats

    def variance_and_degrees(self, direction: Floats) -> tuple[float, float]:
        """Return the variance of direction' theta (P), and its degrees of freedom.

        If a few samples dominate the estimate, the variance is biased and has fewer degrees of
        freedom than cosines. Both are corrected: docs/identify.md, "Few passages".
        """
        variance = variance_along(self.V, direction)
        share, degrees = few_sample_correction(self.scores, self.naive @ direction, self.degrees)
        return variance / share, degrees

    def half_and_degrees(self, direction: Floats) -> tuple[float, float]:
        """Return half the 95 % interval of direction' theta, and its degrees of freedom."""
        variance, degrees = self.variance_and_degrees(direction)
        return student_quantile(degrees) * variance**0.5, degrees

    def half_width(self, direction: Floats) -> float:
        """Return half the 95 % interval of direction' theta."""
        return self.half_and_degrees(direction)[0]


def few_sample_correction(scores: Floats, row: Floats, count: int) -> tuple[float, float]:
    """Return bias factor and degrees of freedom of a variance that a few samples dominate.

    References:
        F. E. Satterthwaite (1946), doi:10.2307/3002019

    Args:
        scores: score of each sample at the estimate (N x P).
        row: H^-1 c, for the estimate c' theta (P).
        count: number of cosines K.

    Returns:
        The expected variance by the cosines after the fit over the true one (Bell and McCaffrey
        2002), and its degrees of freedom (Satterthwaite 1946), at least 1.
    """
    influence = scores @ row  # of each sample on the estimate
    squares = influence**2
    total = float(squares.sum())
    if total <= 0:
        return 1.0, float(count)
    angle = np.pi * (np.arange(influence.size) + 0.5) / influence.size
    weights = count / 2 + (np.sin((2 * count + 1) * angle) / np.sin(angle) - 1) / 4  # sum of cos^2
    power = 0.5 * dct(squares)[: 2 * count + 1]
    k = np.arange(1, count + 1)
    covariance = power[np.abs(k[:, None] - k)] + power[k[:, None] + k]  # of the K cosines
    # Squared samples estimate the sums of fourth powers too large by the factor of a Gaussian.
    excess = GAUSSIAN * np.sum((2 * weights * squares) ** 2)
    # Satterthwaite: (trace C)^2 / trace C^2 degrees of freedom.
    degrees = (np.trace(covariance) ** 2 - excess) / max(
        float(np.sum(covariance**2)) - excess, 1e-300
    )
    # The fit makes P combinations of the scores 0, and takes that part out of the cosines.
    white = scores @ _score_whitener(scores)
    leverage = np.einsum("ij,ij->i", white, white)
    removed = np.sum((0.5 * dct(white * influence[:, None], axis=0)[1 : count + 1]) ** 2)
    removed -= GAUSSIAN * np.sum(weights * leverage * squares)
    share = 1 - 2 / count * float(removed) / total
    return max(share, LEAST_KEPT), float(np.clip(degrees, 1, count))


def _score_whitener(scores: Floats) -> Floats:
    """Return W (P x P) with W W' the pseudo-inverse of S' S, S the scores (N x P)."""
    scale, values, vectors = decompose_scaled(scores.T @ scores)
    whitener = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-10))
    return whitener * (values > 1e-10)


def decompose_scaled(matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Return units that make a matrix's diagonal 1 (P), its eigenvalues and vectors in them.

    Raises InputError for a matrix that overflows.
    """
    scale = 1 / np.sqrt(np.abs(np.diag(matrix)) + 1e-300)
    values, vectors = np.linalg.eigh(require_finite_matrix(matrix * np.outer(scale, scale)))
    return scale, values, vectors


def propagate_covariance(V: Floats, change: Callable[[Floats], Floats]) -> Any:
    """Return the variances of quantities of numbers with a covariance, by the delta method.

    Args:
        V: covariance of the numbers (P x P).
        change: the change of the quantities with that of the numbers (P), 0 if it has none.
    """
    values, vectors = np.linalg.eigh(V)
    moves = 0.1 * np.sqrt(np.maximum(values, 0.0)) * vectors
    return sum((change(move) / 0.1) ** 2 for move in moves.T)


def require_finite_matrix(matrix: Floats) -> Floats:
    """Return a finite matrix, which can be decomposed; else raise.

    Raises:
        InputError: the matrix overflows, as that of a fit with hardly any information.
    """
    if not np.isfinite(matrix).all():
        raise InputError(
            "log: the readings' information on the plant overflows. Try a lower --order, or a log"
            " whose readings move more"
        )
    return matrix


def student_quantile(degrees: float, level: float = 0.95) -> float:
    """Return the two-sided quantile of Student's distribution at a level, 1.96 for many degrees."""
    return float(student.ppf(0.5 + level / 2, degrees))


def long_run_covariance(scores: Floats, count: int | None = None) -> tuple[Floats, int]:
    """Return the covariance of sum(scores) and its degrees of freedom.

    Args:
        scores: scores of N samples (N x P), with any correlation that decays.
        count: number of cosines; default 0.4 N^(2/3) (Lazarus and others 2018), between 8 and
            N / 8.

    Returns:
        J (P x P) and K.
    """
    coefficients = cosine_coefficients(scores, count)
    number = len(coefficients)
    return len(scores) * (coefficients.T @ coefficients) / number, number


def cosine_coefficients(scores: Floats, count: int | None = None) -> Floats:
    """Return the first K coefficients of the cosine transform of scores (K x P).

    Their mean square estimates the spectrum at frequency 0. Arguments of `long_run_covariance`.
    """
    size = scores.shape[0]
    number = max(8, min(int(0.4 * size ** (2 / 3)), size // 8)) if count is None else count
    return dct(scores, axis=0, norm="ortho")[1 : number + 1]


def draw_sums(values: Floats, draws: int, wider: float = 1.0) -> Floats:
    """Return the sums of values over logs that might have been recorded as well (draws x K).

    They scatter as the cosines of the values do (I1).

    Args:
        values: of each reading (N x K).
        draws: number of such logs.
        wider: factor of the scatter.
    """
    slow = cosine_coefficients(values)  # root of the long-run covariance
    noise = np.random.default_rng(0).standard_normal((draws, len(slow)))
    return values.sum(axis=0) + wider * noise @ slow * math.sqrt(len(values) / len(slow))


def sandwich_covariance(
    scores: Floats, hessian: Floats, count: int | None = None
) -> EstimateCovariance:
    """Return the robust covariance (I1) of an estimate.

    Args:
        scores: score of each sample at the estimate (N x P).
        hessian: minus the second derivative of the log likelihood (P x P).
        count: number of cosines; default as in `long_run_covariance`.
    """
    J, number = long_run_covariance(scores, count)
    inverse = np.linalg.pinv(require_finite_matrix(hessian), rcond=1e-13, hermitian=True)
    return EstimateCovariance(inverse @ J @ inverse, inverse, number, scores)


def raise_eigenvalues(hessian: Floats) -> Floats:
    """Return a Hessian (P x P) made symmetric and positive definite.

    Its eigenvalues, in units of its diagonal, are raised to at least 1e-6 of the largest.
    """
    symmetric = 0.5 * (hessian + hessian.T)
    scale, values, vectors = decompose_scaled(symmetric)
    raised = np.maximum(values, 1e-6 * values.max())
    return (vectors * raised) @ vectors.T / np.outer(scale, scale)


def raise_to_outer_products(hessian: Floats, outer: Floats) -> Floats:
    """Return a Hessian raised to at least half of the scores' outer products.

    Both are equal in expectation if the model is right. So the result differs only in directions
    in which the Hessian by differences is wrong, as along the logarithm of a variance near 0. A
    Hessian that overflows is the outer products.

    Args:
        hessian: minus the second derivative, by differences (P x P).
        outer: sum of the outer products of the scores (P x P).

    Returns:
        A positive Hessian (P x P).
    """
    scale, values, vectors = decompose_scaled(outer)
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values.max())) / scale[:, None]
    whiten = np.linalg.pinv(root)
    with np.errstate(over="ignore", invalid="ignore"):
        whitened = whiten @ (0.5 * (hessian + hessian.T)) @ whiten.T
    if not np.isfinite(whitened).all():
        return outer
    ratios, axes = np.linalg.eigh(whitened)
    return (root @ axes * np.maximum(ratios, 0.5)) @ (root @ axes).T


def weight_row(
    free: Integers, size: int, first: int, weights: Sequence[float], tied: bool = False
) -> Floats:
    """Return c (F) with c' theta_free the weighted sum of consecutive parameters.

    Args:
        free: places of the free parameters (F).
        size: number of parameters P.
        first: place of the first parameter of the sum.
        weights: weights of this parameter and of the following ones.
        tied: whether the second parameter equals the first one, which is free alone.
    """
    row = np.zeros(size)
    row[first : first + len(weights)] = weights
    if tied:
        row[first] += row[first + 1]
    return row[free]
