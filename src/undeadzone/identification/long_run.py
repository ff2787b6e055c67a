"""Intervals that hold whatever the colour of the disturbance: covariance by cosines (I1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.stats import t as student

from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats

GAUSSIAN = 2 / 3  # of the fourth power of a Gaussian: what 3 s^4 holds beyond s^4
LEAST_KEPT = 0.05  # share of a variance below which nothing is left of it


class Spread(NamedTuple):
    """Covariance of estimates.

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

    def accuracy(self, direction: Floats) -> tuple[float, float]:
        """The variance of direction' theta without its bias, and its degrees of freedom.

        Where a few samples tell of an edge, the cosines that they enter are few, and the fit has
        used up part of what they scatter: docs/identify.md, "Few passages".
        """
        variance = max(float(direction @ self.V @ direction), 0.0)
        kept, degrees = few_samples(self.scores, self.naive @ direction, self.degrees)
        return variance / kept, degrees

    def half_and_degrees(self, direction: Floats, level: float = 0.95) -> tuple[float, float]:
        """Half the interval of direction' theta at a level, and its degrees of freedom."""
        variance, degrees = self.accuracy(direction)
        return quantile(degrees, level) * variance**0.5, degrees

    def half_width(self, direction: Floats, level: float = 0.95) -> float:
        """Half the interval of direction' theta at a level."""
        return self.half_and_degrees(direction, level)[0]


def few_samples(scores: Floats, row: Floats, count: int) -> tuple[float, float]:
    """What few samples leave of an estimated variance, were the samples independent.

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
    white = scores @ _whitener(scores)
    lever = np.einsum("ij,ij->i", white, white)
    used = np.sum((0.5 * dct(white * told[:, None], axis=0)[1 : count + 1]) ** 2)
    used -= GAUSSIAN * np.sum(weights * lever * squares)
    kept = 1 - 2 / count * float(used) / total
    return max(kept, LEAST_KEPT), float(np.clip(degrees, 1, count))


def _whitener(scores: Floats) -> Floats:
    """W with W W' the inverse of the sum of the scores' outer products (P x P)."""
    scale = 1 / np.sqrt(np.sum(scores**2, axis=0) + 1e-300)
    values, vectors = np.linalg.eigh(finite((scores * scale).T @ (scores * scale)))
    whitener = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-10))
    return np.asarray(whitener * (values > 1e-10))


def finite(matrix: Floats) -> Floats:
    """A matrix whose decomposition is asked for.

    Raises:
        InputError: a fit of which so little is known that its derivatives overflow.
    """
    if not np.isfinite(matrix).all():
        raise InputError(
            "log: what the readings tell of the plant overflows; try a lower --order, or a log"
            " whose readings move more"
        )
    return matrix


def quantile(degrees: float, level: float = 0.95) -> float:
    """Student's two-sided quantile."""
    return float(student.ppf(0.5 + level / 2, degrees))


def degrees_of(size: int) -> int:
    """K = 0.4 N^(2/3), between 8 and N / 8."""
    return max(8, min(int(0.4 * size ** (2 / 3)), size // 8))


def long_run_covariance(scores: Floats, count: int | None = None) -> tuple[Floats, int]:
    """The covariance of sum(scores) and its degrees of freedom.

    Args:
        scores: one row a sample (N x P), correlated in any way that dies out.
        count: cosines; default 0.4 N^(2/3) (Lazarus and others 2018).

    Returns:
        J (P x P) and K.
    """
    size = scores.shape[0]
    number = degrees_of(size) if count is None else count
    parts = dct(scores, axis=0, norm="ortho")[1 : number + 1]
    return size * (parts.T @ parts) / number, number


def sandwich(scores: Floats, hessian: Floats, count: int | None = None) -> Spread:
    """(I1): the robust covariance of an estimate.

    Args:
        scores: of each sample at the estimate (N x P).
        hessian: minus the second derivative of the log likelihood (P x P).
        count: cosines; default as in `long_run_covariance`.

    Returns:
        Covariances and degrees of freedom.
    """
    J, number = long_run_covariance(scores, count)
    inverse = np.linalg.pinv(finite(hessian), rcond=1e-13, hermitian=True)
    return Spread(inverse @ J @ inverse, inverse, number, scores)


def gauss_newton(e: Floats, rows: Floats, count: int) -> tuple[float, Floats]:
    """Variance of residuals, and the Hessian of half their squares over it.

    Args:
        e: residuals, 0 where there is no reading (N).
        rows: derivatives of the expected reading by the free numbers, 0 there too (N x P).
        count: readings that there are.

    Returns:
        The variance, and the Hessian with a ridge that keeps it positive (P x P).
    """
    variance = float(e @ e) / count + 1e-30
    return variance, rows.T @ rows / variance + 1e-9 * np.eye(rows.shape[1])


def least_squares_spread(e: Floats, rows: Floats, count: int) -> Spread:
    """(I1) of a least-squares fit; arguments as of `gauss_newton`."""
    variance, hessian = gauss_newton(e, rows, count)
    return sandwich(rows * e[:, None] / variance, hessian)


def positive(hessian: Floats) -> Floats:
    """A Hessian with its eigenvalues, after scaling, raised to at least 1e-6 of the largest."""
    both = 0.5 * (hessian + hessian.T)
    scale = 1 / np.sqrt(np.abs(np.diag(both)) + 1e-300)
    values, vectors = np.linalg.eigh(finite(both * np.outer(scale, scale)))
    raised = np.maximum(values, 1e-6 * values.max())
    return (vectors * raised) @ vectors.T / np.outer(scale, scale)


def above(hessian: Floats, outer: Floats, least: float = 0.5) -> Floats:
    """A Hessian raised to at least a part of the scores' outer products, in every direction.

    Args:
        hessian: minus the second derivative, by differences (P x P).
        outer: sum of the outer products of the scores (P x P).
        least: the part; both are equal where the model is right.

    Returns:
        A positive Hessian; it differs from the given one only where differences tell nothing, as
        along the logarithm of a variance that is nearly 0.
    """
    scale = 1 / np.sqrt(np.diag(outer) + 1e-300)
    values, vectors = np.linalg.eigh(finite(outer * np.outer(scale, scale)))
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values.max()))
    whiten = np.linalg.pinv(root)
    both = 0.5 * (hessian + hessian.T) * np.outer(scale, scale)
    sizes, axes = np.linalg.eigh(finite(whiten @ both @ whiten.T))
    raised = (axes * np.maximum(sizes, least)) @ axes.T
    return root @ raised @ root.T / np.outer(scale, scale)
