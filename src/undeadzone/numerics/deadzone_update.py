"""Measurement update through a dead zone for any Kalman filter, with NumPy alone.

The graph of `Censored` computes the same, written for readers. A reading on a sure side is linear
in state and widths. A censored sample shows that z lies between both edges, a condition that is
matched in mean and covariance. docs/deadzone_update.md has examples, docs/filter_equations.md the
mathematics.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Relative, as the distribution `deadzone_update` contains both files too (packages/).
from ..errors import InputError, ShapeError

Floats = NDArray[np.floating[Any]]

SILENT = 4.0  # noise, in its rms, that is surely not beyond it
DOUBT = 1.6448536269514722  # an edge inside which z lies with 95 % already is not used
UNSURE = 0.05  # least probability beyond an edge for its use beside the other one
DEEP = 5.0  # standard deviations beyond an edge from which probabilities follow a series
NARROW = 1e-6  # least chance of silence, over that of being inside of the nearer edge
CLIP = 30.0  # standard deviations off an edge from which all is alike
PARALLEL = 1e-12  # 1 - correlation^2 of two edges below which they are one
ROUNDING = 1e-6  # by which a covariance may be none, over its deviations
LENGTH = 1.4  # length over which an edge is round, in `rounding`
FIXED_AT_EDGE = 1.15  # deviation of a reading at its edge, in `rounding`, if it has a column
FAR = 30.0  # lengths beyond which an edge is not round any more


class DeadzoneMemory(NamedTuple):
    """State that `deadzone_update` passes from one reading to the next.

    Attributes:
        last, previous: the last two readings, 0 if one was missing [y].
        right, left: readings to wait until that edge is used again.
    """

    last: float = 0.0
    previous: float = 0.0
    right: int = 0
    left: int = 0


class DeadzoneUpdate(NamedTuple):
    """State estimate after a reading.

    Attributes:
        mean: in the shape that was given.
        cov: covariance (N x N).
        memory: for the next reading.
        side: 1 or -1 if the reading was used on that side, 0 if it was censored, unsure or missing.
        innovation: reading less prediction [z] (0 if side is 0).
        innovation_std: standard deviation of the innovation [z] (0 if side is 0).
        columns: change of the mean per error of the slope [1], of a reading at its edge [z], and of
            the time of a reading [samples] (N x 3). Your prediction moves them like the mean: F @
            columns.
        shown: covariance that includes the effect of these doubts on the mean (N x N), for display
            and not for the next update.
    """

    mean: Floats
    cov: Floats
    memory: DeadzoneMemory
    side: int
    innovation: float = 0.0
    innovation_std: float = 0.0
    columns: Any = None
    shown: Any = None


class Gauss(NamedTuple):
    """A mean (N) and its covariance (N x N)."""

    mean: Floats
    cov: Floats


class Edge(NamedTuple):
    """One edge: the width is row @ mean + known.

    Attributes:
        sign: 1 on the right, -1 on the left.
        row: row that maps the mean to the width (N), 0 if the width is known.
        known: the width if it is known [z].
    """

    sign: int
    row: Floats
    known: float


def deadzone_update(
    mean: ArrayLike,
    cov: ArrayLike,
    C: ArrayLike,
    y: float,
    *,
    right: ArrayLike,
    left: ArrayLike,
    noise: float,
    memory: DeadzoneMemory,
    rest: int,
    noise_before: float = 0.0,
    slope: float = 1.0,
    rounding: float = 0.0,
    slope_std: float = 0.0,
    lag: float = 0.0,
    ahead: float = 0.0,
    columns: ArrayLike | None = None,
) -> DeadzoneUpdate:
    """Return the mean and covariance after a reading y = slope Dz(C x + noise ahead) + noise
    behind.

    Args:
        mean: of the filter's state, after its prediction (N, or N x 1).
        cov: covariance of that (N x N).
        C: row that reads z from the mean (N).
        y: reading [y] (NaN if it is missing, or at a limit of the sensor's range).
        right: width d_r: a number if it is known [z], inf if there is no such edge, or the row that
            reads it from the mean (N).
        left: the same for d_l.
        noise: rms of the noise behind the zone [y].
        memory: memory that the last call returned, at first `DeadzoneMemory()`. A filter without it
            would cut off the same tail at every sample.
        rest: readings for which an edge is not used again: a 25th of the plant's period, or the
            correlation time of its disturbance if that is longer, up to a quarter period.
        noise_before: rms of the noise ahead of the zone [z].
        slope: of the zone's branches [y/z].
        rounding: how far about an edge the characteristic may be round [z] (0: not at all).
        slope_std: relative standard deviation of the slope (0: known).
        lag: standard deviation of an unknown delay behind the zone [samples].
        ahead: predicted change of z in the last sample [z] (needed for a lag).
        columns: `columns` of the last call, moved by your prediction (N x 3) (None: 0).

    Returns:
        The estimate, and the memory for the next reading.

    Raises:
        InputError, ShapeError: unless shapes agree, numbers are finite, cov is a covariance and
            noise is there.

    Example:
        >>> import numpy as np
        >>> updated = uz.deadzone_update(
        ...     mean=np.array([1.4, 0.0]),
        ...     cov=np.diag([0.1, 1.0]),
        ...     C=np.array([1.0, 0.0]),
        ...     y=0.5,
        ...     right=1.0,
        ...     left=0.6,
        ...     noise=0.01,
        ...     memory=uz.DeadzoneMemory(last=0.45, previous=0.4),
        ...     rest=10,
        ... )
        >>> updated.side
        1

    See Also:
        Online, Censored
    """
    shape = np.shape(mean)
    belief = _require_belief(mean, cov)
    if not slope > 0:
        raise InputError(f"slope: must be positive, found {slope:g}")
    rms = float(np.hypot(noise / slope, noise_before))
    if not (rms > 0 and noise >= 0 and noise_before >= 0):
        raise InputError(
            f"noise: expected some rms behind or ahead of the zone, found {noise:g} and "
            f"{noise_before:g}. Of a clean sensor give its resolution"
        )
    z = _row("C", C, len(belief.mean))
    S = _require_columns(columns, len(belief.mean))
    doubts = _require_doubts(rounding=rounding, slope_std=slope_std, lag=lag)
    edges = [_edge("right", 1, right, z), _edge("left", -1, left, z)]
    waits = np.array([memory.right, memory.left])
    later = np.maximum(waits - 1, 0)
    if not np.isfinite(y):
        return DeadzoneUpdate(
            belief.mean.reshape(shape),
            belief.cov,
            DeadzoneMemory(0.0, memory.last, *later.tolist()),
            0,
            columns=S,
            shown=_displayed_covariance(belief, S, doubts),
        )
    gate = max(SILENT * noise, rounding * slope)
    side = _sure(y, memory.last, memory.previous, gate) - _sure(
        -y, -memory.last, -memory.previous, gate
    )
    e = std = 0.0
    if side and np.isinf(edges[0 if side > 0 else 1].known):
        side = 0  # nothing reads beyond an edge that is not there
    if side:
        edge = edges[0] if side > 0 else edges[1]
        h = z - side * edge.row
        e = float(y / slope + side * edge.known - h @ belief.mean)
        K = belief.cov @ h / (h @ belief.cov @ h + rms**2)
        at_edge = side * exp(-min(abs(y / slope) / (LENGTH * rounding), FAR)) if rounding else 0.0
        S = S + np.outer(K, np.array([y / slope, at_edge, -ahead]) - h @ S)
        belief, std = _correct_linear(belief, h, e, rms**2)
    if abs(y) <= gate:
        belief, used = _within(belief, z, edges, gate / slope, rms**2, waits == 0)
        later = np.where(used, rest, later)
    return DeadzoneUpdate(
        belief.mean.reshape(shape),
        belief.cov,
        DeadzoneMemory(y, memory.last, *later.tolist()),
        side,
        e,
        std,
        S,
        _displayed_covariance(belief, S, doubts),
    )


def _displayed_covariance(belief: Gauss, S: Floats, doubts: Floats) -> Floats:
    """Return the covariance with the errors that the sensor's shape may have caused (N x N)."""
    wide = S * doubts
    return belief.cov + wide @ wide.T


def _require_columns(columns: ArrayLike | None, count: int) -> Floats:
    """Return the columns (N x 3) as a new array. Raises InputError, ShapeError."""
    S = np.zeros((count, 3)) if columns is None else np.array(columns, float)
    if S.shape != (count, 3):
        raise ShapeError(f"columns: expected {count} x 3, as were returned, found {S.shape}")
    _require_finite("columns", S)
    return S


def _require_doubts(**doubts: float) -> Floats:
    """Return the standard deviations of slope, reading at an edge, and delay. Raises InputError."""
    for name, value in doubts.items():
        if not 0 <= value < np.inf:
            raise InputError(f"{name}: must be at least 0 and finite, found {value:g}")
    return np.array([doubts["slope_std"], FIXED_AT_EDGE * doubts["rounding"], doubts["lag"]])


def _require_belief(mean: ArrayLike, cov: ArrayLike) -> Gauss:
    """Return mean (N) and covariance (N x N) as new arrays. Raises InputError, ShapeError."""
    m = np.array(mean, float).ravel()
    P = np.array(cov, float)
    if P.shape != (m.size, m.size):
        raise ShapeError(f"cov: expected {m.size} x {m.size}, as the mean, found {P.shape}")
    _require_finite("mean", m)
    _require_finite("cov", P)
    scale = np.sqrt(np.maximum(np.diag(P), 0))
    scale[scale == 0] = 1.0
    related = P / scale[:, None] / scale
    if np.abs(related - related.T).max(initial=0) > ROUNDING:
        raise InputError("cov: expected a covariance, found one that is not symmetric")
    least = np.linalg.eigvalsh(related).min(initial=0)
    if least < -ROUNDING:
        raise InputError(
            f"cov: expected a covariance, found one with eigenvalue {least:.3g} (of correlations). "
            "Use Joseph's form in your filter"
        )
    return Gauss(m, P)


def _require_finite(name: str, numbers: Floats) -> None:
    """Raise InputError for numbers that are not finite."""
    if not np.isfinite(numbers).all():
        raise InputError(f"{name}: expected finite numbers, found NaN or an infinite one")


def _row(name: str, value: ArrayLike, count: int) -> Floats:
    """Return a row (N). Raises ShapeError."""
    row = np.asarray(value, float).ravel()
    if row.size != count:
        raise ShapeError(
            f"{name}: expected a row of {count} numbers, as the mean, found {row.size}"
        )
    _require_finite(name, row)
    return row


def _edge(name: str, sign: int, width: ArrayLike, z: Floats) -> Edge:
    """Return an edge of known or estimated width. Raises InputError, ShapeError."""
    if np.ndim(width):
        return Edge(sign, _row(name, width, z.size), 0.0)
    known = float(np.asarray(width))
    if not known >= 0:
        raise InputError(f"{name}: a known width must be at least 0, found {known:g}")
    return Edge(sign, np.zeros(z.size), known)


def _sure(y: float, last: float, previous: float, gate: float) -> int:
    """Return whether a reading is surely on the right: far out, or announced by the two before
    it.
    """
    announced = last > gate and previous > gate and 2 * last - previous > gate
    return int(y > 2 * gate or (announced and y > 0))


def _correct_linear(belief: Gauss, h: Floats, e: float, R: float) -> tuple[Gauss, float]:
    """Return the belief after a linear reading, by Joseph's form, and the innovation's
    deviation.
    """
    m, P = belief
    S = float(h @ P @ h) + R
    _require_positive(S)
    K = P @ h / S
    half = P - np.outer(K, h @ P)
    return Gauss(m + K * e, half - np.outer(half @ h, K) + R * np.outer(K, K)), sqrt(S)


def _require_positive(variance: float) -> None:
    """Raise InputError for a variance along an edge of which rounding leaves nothing."""
    if not variance > 0:
        raise InputError(
            f"cov: its variance of z less a width is {variance:.3g}. The noise is too small for it"
        )


def _within(
    belief: Gauss, z: Floats, edges: list[Edge], slack: float, R: float, allowed: NDArray[np.bool_]
) -> tuple[Gauss, NDArray[np.bool_]]:
    """Return the belief given that z is inside both edges, and a mask of the edges that were used.

    No value is beyond both, so that the probability of this is Phi(a) + Phi(b) - 1, with a and b
    the distances of z inside the edges in standard deviations. Its logarithm's slope and bend are
    the moments. An edge is used if more than 5 % of the probability that the other one leaves is
    beyond it.
    """
    m, P = belief
    H = np.array([edge.sign * z - edge.row for edge in edges])
    K = P @ H.T
    G = H @ K
    _require_positive(min(G[0, 0], G[1, 1]) + R)
    std = np.sqrt(np.diag(G) + R)
    short_of = [(edge.known + slack) for edge in edges] - H @ m
    alpha = np.clip(short_of / std, -CLIP, CLIP)
    inside = np.array([(1 + erf(a / sqrt(2))) / 2 for a in alpha])
    slope: Floats = np.zeros(2)  # of the log of the chance, in each alpha
    used = allowed & (alpha < DOUBT)
    if used.any():
        nearest = np.argmin(np.where(used, alpha, np.inf))
        slope[nearest] = _hazard(alpha[nearest])
    unsure = 1 - inside > UNSURE * inside[::-1]
    if used.any() and np.all(allowed & unsure & (alpha > -DEEP)):
        both = np.exp(-(alpha**2) / 2) / sqrt(2 * pi) / max(inside.sum() - 1, NARROW)
        if _are_moments(both / std, both * alpha / std**2, G):
            slope = both
    shift = K @ (slope / std)
    after = P - np.outer(shift, shift) - (K * (slope * alpha / std**2)) @ K.T
    return Gauss(m - shift, (after + after.T) / 2), slope > 0


def _are_moments(pull: Floats, bend: Floats, G: Floats) -> bool:
    """Return whether the belief loses no more than all, and no less than nothing, in any
    direction.

    `deadzone_update.h` computes the same in the same order, from the larger variance and the
    remainder of the other edge: for two nearly equal edges the large parts cancel.

    Args:
        pull: slope of the log of the chance along each edge (2).
        bend: what its bend has besides the product of those (2).
        G: covariance along the edges (2 x 2).
    """
    i = 0 if G[0, 0] >= G[1, 1] else 1
    most = G[i, i]
    least = G[1 - i, 1 - i]
    area = most * least - G[0, 1] ** 2
    area = 0.0 if area < PARALLEL * most * least else area  # it may be rounding alone
    together = pull[i] * most + pull[1 - i] * G[0, 1]
    trace = (together**2 + pull[1 - i] ** 2 * area) / most if most > 0 else 0.0
    trace += bend[i] * most + bend[1 - i] * least
    det = area * (pull[0] ** 2 * bend[1] + pull[1] ** 2 * bend[0] + bend[0] * bend[1])
    return bool(0 < trace < 2 and 1 - trace + det > 0 and det > -NARROW)


def _hazard(alpha: float) -> float:
    """Return phi(alpha) / Phi(alpha) of the standard normal distribution, far below 0 by its
    series.
    """
    if alpha > -DEEP:
        return exp(-(alpha**2) / 2) / (sqrt(pi / 2) * (1 + erf(alpha / sqrt(2))))
    return -alpha + (1 - (2 - 10 / alpha**2) / alpha**2) / -alpha
