"""Intervals that hold whatever the colour of the disturbance: covariance by cosines (I1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.stats import t as student

from undeadzone.support.arrays import Floats


class Spread(NamedTuple):
    """Covariance of estimates.

    Attributes:
        V: robust covariance H^-1 J H^-1 (P x P).
        naive: H^-1 (P x P), right for independent samples only.
        degrees: degrees of freedom K of the estimate of J.
    """

    V: Floats
    naive: Floats
    degrees: int

    def half_width(self, direction: Floats, level: float = 0.95) -> float:
        """Half the interval of direction' theta at a level."""
        variance = float(direction @ self.V @ direction)
        return quantile(self.degrees, level) * max(variance, 0.0) ** 0.5


def quantile(degrees: int, level: float = 0.95) -> float:
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
    inverse = np.linalg.pinv(hessian, rcond=1e-13, hermitian=True)
    return Spread(inverse @ J @ inverse, inverse, number)


def positive(hessian: Floats) -> Floats:
    """A Hessian with its eigenvalues, after scaling, raised to at least 1e-6 of the largest."""
    both = 0.5 * (hessian + hessian.T)
    scale = 1 / np.sqrt(np.abs(np.diag(both)) + 1e-300)
    values, vectors = np.linalg.eigh(both * np.outer(scale, scale))
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
    values, vectors = np.linalg.eigh(outer * np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values.max()))
    whiten = np.linalg.pinv(root)
    both = 0.5 * (hessian + hessian.T) * np.outer(scale, scale)
    sizes, axes = np.linalg.eigh(whiten @ both @ whiten.T)
    raised = (axes * np.maximum(sizes, least)) @ axes.T
    return root @ raised @ root.T / np.outer(scale, scale)
