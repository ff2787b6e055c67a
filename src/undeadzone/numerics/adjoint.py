"""Smoothing: from a filter's moments to the moments given the whole record, by adjoint
variables.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats

TINY = 1e-12  # relative eigenvalues below which a covariance has no information on a direction
EXACT = 1e-8  # standard deviations within which a reading moved a belief along its rows alone


class LaterInformation(NamedTuple):
    """Information of later samples about a state estimate of mean m and covariance P (N
    variables).

    Given them, its mean is m + P push and its covariance P - P known P.

    Attributes:
        push: (N).
        known: (N x N).
    """

    push: Floats
    known: Floats

    @classmethod
    def no_information(cls, size: int) -> LaterInformation:
        """Return the information if no later samples exist."""
        return cls(np.zeros(size), np.zeros((size, size)))


def smooth_backward(
    moments: Any, later: LaterInformation
) -> tuple[Floats, Floats, LaterInformation]:
    """Return the estimates at B samples given later samples, and the information about the
    first estimate.

    Args:
        moments: `Moments` of a filter, with arrays of a row a sample.
        later: information that later samples contain on the estimate after the last motion.

    Returns:
        Means (B x N), covariances (B x N x N), and the information on the estimate before the first
        reading.
    """
    read_push, read_known = adjoint_information(moments.before, moments.read, moments.rows)
    edge_push, edge_known = adjoint_information(moments.read, moments.bounded, moments.edges)
    count, size = moments.before.mean.shape
    mean = np.empty((count, size))
    cov = np.empty((count, size, size))
    unit = np.eye(size)
    lost = (moments.restarted[:, 0] != 0) | ~np.isfinite(moments.slope).all(axis=(1, 2))
    push, known = later
    for k in range(count - 1, -1, -1):
        F = unit + moments.slope[k]
        push = F.T @ push
        known = F.T @ known @ F
        if lost[k]:
            push = np.zeros(size)
            known = np.zeros((size, size))
        P = moments.bounded.cov[k]
        mean[k] = moments.bounded.mean[k] + P @ push
        cov[k] = P - P @ known @ P
        stages = ((edge_push, edge_known, moments.read), (read_push, read_known, moments.before))
        for more, gained, belief in stages:
            closed = unit - gained[k] @ belief.cov[k]
            push = more[k] + closed @ push
            known = gained[k] + closed @ known @ closed.T
    return mean, cov, LaterInformation(push, known)


def adjoint_information(before: Any, after: Any, rows: Floats) -> tuple[Floats, Floats]:
    """Return (push, known) that turn `before` into `after`, as of `LaterInformation`, for B
    samples.

    Args:
        before, after: beliefs (means B x N, covariances B x N x N).
        rows: along whose covariances the belief mostly moves (B x r x N).
    """
    P = before.cov
    lost = P - after.cov
    gained = after.mean - before.mean
    along = P @ np.swapaxes(rows, 1, 2)
    seen = rows @ along
    scale, square = _deviations(seen)
    fine = np.isfinite(seen).all(axis=(1, 2)) & np.isfinite(lost).all(axis=(1, 2))
    inverse = _pseudo_inverses(np.where(fine[:, None, None], seen / square, 0.0))
    weight = inverse @ (rows @ lost @ np.swapaxes(rows, 1, 2) / square) @ inverse / square
    shift = (inverse @ ((rows @ gained[:, :, None]) / scale[:, :, None])) / scale[:, :, None]
    push = (np.swapaxes(rows, 1, 2) @ shift)[:, :, 0]
    known = np.swapaxes(rows, 1, 2) @ weight @ rows
    std, pairs = _deviations(P)
    off = np.abs(lost - along @ weight @ np.swapaxes(along, 1, 2)) / pairs
    rest = np.abs(gained - (along @ shift)[:, :, 0]) / std
    otherwise = fine & ((off.max(axis=(1, 2)) > EXACT) | (rest.max(axis=1) > EXACT))
    for k in np.flatnonzero(otherwise):
        whole = _pseudo_inverses(P[k] / pairs[k]) / pairs[k]
        push[k] = whole @ gained[k]
        known[k] = whole @ lost[k] @ whole
    return push, known


def _deviations(covariances: Floats) -> tuple[Floats, Floats]:
    """Return standard deviations (B x N), never 0, and their products in pairs (B x N x N)."""
    std = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0)) + 1e-300
    return std, std[:, :, None] * std[:, None, :]


def _pseudo_inverses(matrices: Floats) -> Floats:
    """Return the pseudo-inverses of symmetric matrices of unit diagonal."""
    return np.asarray(np.linalg.pinv(matrices, rcond=TINY, hermitian=True))
