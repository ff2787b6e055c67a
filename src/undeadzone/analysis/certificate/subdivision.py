"""A box is halved until interval bounds prove V on all of its parts, or a Jacobian is missed.

On a part, A lies within the bound at the centre plus the bound on its derivatives times the way to
the part's edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.jacobian_bounds import Bounds, Slopes
from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.compile.interval import Interval
from undeadzone.plants.region import Box
from undeadzone.support.arrays import Floats, Integers

AT_ONCE = 2048  # parts of the box in one evaluation
WORST = 8  # of the Jacobians that V misses are named


class Form(NamedTuple):
    """-M of the certificate as a function of the K entries c of A that vary.

    -M = identity - sum (c - mean)_k slope_k, in coordinates (N of them) that make it so.

    Attributes:
        mean: of c at the vertices (K).
        identity: the identity, as rounded (N x N).
        slope: of each entry (K x N x N).
        size: |slope_k|, no less than +-slope_k (K x N x N).
        rounding: of the identity, and of each slope per unit of c (K).
    """

    mean: Floats
    identity: Floats
    slope: Floats
    size: Floats
    rounding: tuple[float, Floats]

    def depth(self, c: Floats) -> Floats:
        """The least eigenvalue of -M, less rounding, for every c (rows x K); -inf if unbounded."""
        c = c - self.mean
        return self._least(np.abs(c), c, None)

    def depth_within(self, c: Floats, loose: Floats, turns: Floats) -> Floats:
        """`depth`, but the least over all entries within +-loose and turns of c.

        Args:
            c: the middle (rows x K).
            loose: by how much each entry may be off, alone (rows x K).
            turns: by how much all entries may be off together, in each direction (rows x D x K).
        """
        c = c - self.mean
        return self._least(np.abs(c) + loose + np.abs(turns).sum(axis=1), c, (loose, turns))

    def _least(self, total: Floats, c: Floats, doubt: tuple[Floats, Floats] | None) -> Floats:
        """The least eigenvalues of -M, less rounding; total: magnitude of each entry at most."""
        bounded = np.isfinite(total).all(axis=1)
        M = self.identity - np.tensordot(c[bounded], self.slope, 1)
        if doubt is not None:
            loose, turns = doubt
            together = absolute(np.tensordot(turns[bounded], self.slope, 1)).sum(axis=1)
            M = M - np.tensordot(loose[bounded], self.size, 1) - together
        of_identity, of_slopes = self.rounding
        least = np.full(len(c), -np.inf)
        least[bounded] = np.linalg.eigvalsh(M)[:, 0] - of_identity - total[bounded] @ of_slopes
        return least


def absolute(M: Floats) -> Floats:
    """(M^2)^(1/2) of symmetric matrices, no less than +-M."""
    values, vectors = np.linalg.eigh((M + M.swapaxes(-1, -2)) / 2)
    return (vectors * np.abs(values)[..., None, :]) @ vectors.swapaxes(-1, -2)


def form(certificate: Certificate, entries: tuple[Integers, Integers]) -> Form:
    """The certificate's M as a function of some entries of A.

    Args:
        certificate: with V that is proved at the vertices.
        entries: rows and columns of these entries (K each).
    """
    errors, P = certificate.dynamics, certificate.P
    mean = np.mean(errors.A, axis=0)
    inequality = errors.inequality(certificate.W)._replace(A=(mean,))
    (M,), (size,) = inequality.matrices(P), inequality.magnitudes(P)
    T = np.linalg.inv(np.linalg.cholesky(-M)).T  # T'(-M) T = I
    slopes = _entry_slopes(P, len(M), errors.Ts, entries)
    slope = T.T @ slopes @ T
    unit = 8 * (len(M) + len(slopes) + 4) * np.finfo(float).eps
    around = [np.linalg.norm(np.abs(T.T) @ np.abs(part) @ np.abs(T)) for part in (size, *slopes)]
    rounding = unit * (around[0] + len(M)), unit * np.array(around[1:])
    return Form(mean[entries], -T.T @ M @ T, slope, absolute(slope), rounding)


def _entry_slopes(
    P: Floats, N: int, Ts: float | None, entries: tuple[Integers, Integers]
) -> Floats:
    """dM/dA_ij (K x N x N) for entries (i, j): P A stands at the corner and, sampled, last too."""
    n = len(P)
    slopes = np.zeros((entries[0].size, N, N))
    places = ((0, 1.0), (N - n, np.sqrt(Ts or 0.0)))
    for slope, i, j in zip(slopes, *entries, strict=True):
        for start, share in places:
            slope[j, start : start + n] += share * P[i]
            slope[start : start + n, j] += share * P[i]
    return slopes


class _Doubt(NamedTuple):
    """What is known of the entries c of A on parts of the box.

    Attributes:
        middle: of c at the centres (parts x K).
        loose: half width of the bounds there (parts x K).
        turns: c changes by +-turns towards each side (parts x (n + m) x K).
        doubt: half width of the bounds on turns (parts x (n + m) x K).
    """

    middle: Floats
    loose: Floats
    turns: Floats
    doubt: Floats


def _doubt(bounds: Bounds, bends: Bounds, low: Floats, centre: Floats, high: Floats) -> _Doubt:
    """The bounds on parts of the box, by the bounds at their centres and on the derivatives."""
    reach = np.nextafter(np.maximum(high - centre, centre - low), np.inf)[:, :, None]
    middle, loose = _middle(bounds(Box(centre, centre)))
    turns, doubt = _middle(bends(Box(low, high)))
    return _Doubt(middle[:, 0], loose[:, 0], turns * reach, doubt * reach)


def missed(certificate: Certificate, slopes: Slopes, box: Box, parts: int) -> Floats:
    """Points of a box whose Jacobians the certificate's V misses or nearly does.

    Args:
        certificate: with V that is proved at its vertices.
        slopes: the model's Jacobian and its bounds.
        box: of [x, u] (n + m).
        parts: of the box that are looked at, at most.

    Returns:
        Points (K x (n + m)); none if V is proved on the box, NaN if that is open.
    """
    bounds, bends = slopes.bounds()
    if not slopes.entries[0].size:
        return np.zeros((0, box.low.size))
    of_A = form(certificate, slopes.entries)
    vertices = np.array(certificate.dynamics.A)[:, *slopes.entries]
    enough = float(of_A.depth(vertices).min()) / 2
    weight = np.linalg.norm(of_A.slope, axis=(1, 2))
    low, high = box.low[None], box.high[None]
    while low.size and parts > 0:
        later_low, later_high = low[:-AT_ONCE], high[:-AT_ONCE]
        low, high = low[-AT_ONCE:], high[-AT_ONCE:]
        parts -= len(low)
        centre = (low + high) / 2
        c, loose, turns, doubt = _doubt(bounds, bends, low, centre, high)
        open_ = ~(of_A.depth_within(c, loose + doubt.sum(axis=1), turns) > 0)
        low, high, centre = low[open_], high[open_], centre[open_]
        depth = of_A.depth(c[open_])
        short = depth < enough
        if short.any():
            return centre[short][np.argsort(depth[short])[:WORST]]
        effect = (np.abs(turns) + doubt)[open_] @ weight
        low, high = halved(low, centre, high, effect, box)
        low, high = np.vstack([later_low, low]), np.vstack([later_high, high])
    return np.full((int(low.size > 0), box.low.size), np.nan)


def halved(
    low: Floats, centre: Floats, high: Floats, effect: Floats, box: Box
) -> tuple[Floats, Floats]:
    """(low, high) of both halves of each part, cut across the side of most effect on M.

    Where an effect has no bound, the side that is longest against the box is cut.
    """
    bounded = np.isfinite(effect).all(axis=1, keepdims=True)
    share = np.where(bounded, effect, (high - low) / (box.high - box.low))
    k, split = np.arange(len(low)), np.argmax(share, axis=1)
    below, above = high.copy(), low.copy()  # upper ends of the lower halves, lower of the upper
    below[k, split] = above[k, split] = centre[k, split]
    return np.vstack([low, above]), np.vstack([below, high])


def _middle(bound: Interval) -> tuple[Floats, Floats]:
    """(middle, half width) of bounds; not finite where there are none."""
    with np.errstate(invalid="ignore"):
        middle = (bound.low + bound.high) / 2
        return middle, np.nextafter(np.maximum(bound.high - middle, middle - bound.low), np.inf)
