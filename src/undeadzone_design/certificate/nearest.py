"""Limits of certification: the certified gains nearest to given gains, and the fastest decay.

The decay is that of x~'P x~ with one P, over all certified gains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify_dynamics
from undeadzone.analysis.certificate.weights import (
    frequency_response,
    least_eigenvalue_over_frequencies,
)
from undeadzone.analysis.dissipation import LEAST
from undeadzone.analysis.error_dynamics import Dynamics, balance_dynamics, build_error_dynamics
from undeadzone.errors import StructureError
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import storage_of
from undeadzone.numerics.semidefinite import minimise_semidefinite, symmetric_matrix
from undeadzone.util.arrays import Floats

CUTS = 200  # rounds of cutting planes, at most
SHARES = (1.0, 0.99, 0.9, 0.5, 0.1, 0.0)  # of the nearest L, until one is proved


class NearestGains(NamedTuple):
    """Certificate of the nearest gains, with their distance.

    Attributes:
        certificate: its dynamics hold L and gamma.
        distance: the norm of the change of W^(1/2) G W^(-1/2) (energy of its impulse response) over
            that of itself, a number that no change of coordinates alters.
    """

    certificate: Certificate
    distance: float


def nearest_certified_gains(
    linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None, least: float = 0.01
) -> NearestGains:
    """Return the gains nearest to L with margin `least` or more, L itself if its margin
    suffices.

    With the weights W that suit L best, the admissible gains are an intersection of half-spaces,
    one per frequency and direction, so that the nearest is unique. It is found by adding the exact
    worst frequency again and again. If it cannot be proved in floating point it is drawn towards
    L = 0. Sampled, Gamma is first scaled down so that no Ts gamma exceeds 1.

    Args:
        linear: the model's A, B, C, of one step if sampled.
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains, see `error_dynamics.adaptation` [1/s].
        Ts: sample time [s] (None in continuous time).
        least: margin that the gains must have.

    Raises:
        StructureError: for a model that no gain can certify.
        InputError, ShapeError: for gains of the wrong kind.
    """
    errors = build_error_dynamics(linear, L, gamma, Ts)
    if errors.Ts is not None:
        largest = errors.Ts * np.linalg.eigvalsh(errors.gamma)[-1]
        errors = errors._replace(gamma=errors.gamma / max(1.0, largest))
    certificate = certify_dynamics(errors)
    if certificate.margin == -np.inf:
        raise StructureError(f"observer.L: no gains can be certified: {certificate.reason}")
    if certificate.certified and certificate.margin >= least:
        return NearestGains(certificate, 0.0)
    W = certificate.W
    projected = _project_gain(errors, W, least)
    for share in SHARES:
        L = share * projected
        certificate = certify_dynamics(errors._replace(L=L), W)
        if certificate.certified and certificate.margin >= least:
            break
    shape = _energy_metric(errors, W)
    change = float(np.linalg.norm(shape.T @ ((errors.L - L) / np.sqrt(W))))
    size = float(np.linalg.norm(shape.T @ (errors.L / np.sqrt(W))))
    return NearestGains(certificate, change / size)


def decay_limit(linear: Matrices, Ts: float | None = None, tolerance: float = 1e-4) -> float:
    """Return the largest rate at which a common x~'P x~ can fall while an output is active
    [1/s].

    The largest over every certified L (and P, W): bisection on the LMI M(P, Y, W) <= 0,
    (A - LC)'P + P(A - LC) <= -2 rate P with Y = PL (sampled: e^(-2 rate Ts) P). It is a limit of
    common-P proofs, not of how fast the error really falls.

    Args:
        linear: the model's A, B, C, of one step if sampled.
        Ts: sample time [s] (None in continuous time).
        tolerance: of the rate, relative.

    Returns:
        The rate, or inf if there is no limit.
    """
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    errors = build_error_dynamics(linear, np.zeros((n, p)), np.zeros(p), Ts)
    scaling = balance_dynamics(errors)
    scaled = scaling.scale_dynamics(errors)
    size = float(np.linalg.norm(scaled.A[0], 2))
    low = 0.0
    high = size
    while _has_decay_proof(scaled, high):
        low = high
        high = 2 * high
        if high > 1e4 * size:
            return np.inf
    while high - low > tolerance * high:
        middle = (low + high) / 2
        if _has_decay_proof(scaled, middle):
            low = middle
        else:
            high = middle
    return low / scaling.time


def _project_gain(errors: Dynamics, W: Floats, least: float) -> Floats:
    """Return L nearest to that of `errors` with margin `least` under W (n x p) [1/s].

    Found by least-distance cutting planes.
    """
    root = np.sqrt(W)
    inward = np.linalg.inv(_energy_metric(errors, W)).T
    # In units where W = 1.
    errors = errors._replace(C=errors.C * root[:, None], L=errors.L / root)
    L = errors.L
    seen = [
        set[float]() for _ in errors.largest_gain_steps
    ]  # the frequencies of each step's half-spaces
    normals = np.zeros((0, L.size))
    levels = np.zeros(0)
    for _ in range(CUTS):
        done = True
        for step, frequencies in zip(errors.largest_gain_steps, seen, strict=True):
            D = np.eye(root.size) - step / 2
            lowest = least_eigenvalue_over_frequencies(
                frequency_response(errors.A[0], errors.C, L, D, errors.Ts)
            )
            done &= lowest.value >= least
            frequencies.add(lowest.w)
            for slope, level in _half_spaces(errors, L, D, least, np.array([*frequencies])):
                normals = np.vstack([normals, (inward.T @ slope).ravel()])
                levels = np.append(levels, level)
        if done:
            break
        move, active = _least_distance(normals, levels)
        normals = normals[active]
        levels = levels[active]
        L = errors.L + inward @ move.reshape(L.shape)
    return np.asarray(L * root)


def _half_spaces(
    errors: Dynamics, L: Floats, D: Floats, least: float, frequencies: Floats
) -> list[tuple[Floats, float]]:
    """Return (slope, level) of the half-spaces that L violates at these frequencies [rad/s].

    The sum of slope times move is `level` or more for admissible gains errors.L + move.
    """
    (A,), C, target, _, Ts = errors
    G = frequency_response(A, C, L, D, Ts)
    half_spaces = []
    eigen = np.linalg.eigh(G.hermitian_part(frequencies))
    for w, values, directions in zip(frequencies, *eigen, strict=True):
        rows = C @ _resolvent_at(A, w, Ts)
        for v in directions.T[values < least]:
            slope = np.real((v.conj() @ rows)[:, None] * v)
            own = np.real(v.conj() @ D @ v)
            half_spaces.append((slope, least * (1 + 1e-3) - own - (slope * target).sum()))
    return half_spaces


def _energy_metric(errors: Dynamics, W: Floats) -> Floats:
    """Return M (n x n) such that |M'L|_F is the energy norm of C (s - A)^-1 L weighted by W.

    M M' is the observability Gramian. Directions that are hardly observable are given a least
    weight, so that M can be inverted.
    """
    (A,) = errors.A
    C = errors.C * np.sqrt(W)[:, None]
    Ts = errors.Ts
    motion = A if Ts is None else np.eye(len(A)) + Ts * A
    gramian = storage_of(motion, (Ts or 1.0) * C.T @ C, Ts)
    values, vectors = np.linalg.eigh(gramian)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1])))


def _resolvent_at(A: Floats, w: float, Ts: float | None) -> np.ndarray:
    """Return (s - A)^-1 at s = jw, sampled at (z - 1)/Ts of Tustin's frequency w (n x n).

    At w = inf the limit is returned.
    """
    if Ts is None and np.isinf(w):
        return np.zeros(A.shape, complex)
    if Ts is None:
        s = 1j * w
    elif np.isinf(w):
        s = -2 / Ts
    else:
        s = 1j * w / (1 - 1j * w * Ts / 2)
    return np.linalg.inv(s * np.eye(A.shape[0]) - A)


def _least_distance(G: Floats, h: Floats) -> tuple[Floats, np.ndarray]:
    """Return (the shortest x with G x >= h, active rows), by Lawson and Hanson 1974, chapter
    23.
    """
    from scipy.optimize import nnls

    size = np.linalg.norm(G, axis=1)
    levels = h / size
    scale = np.abs(levels).max()
    E = np.vstack([(G / size[:, None]).T, levels / scale])
    target = np.append(np.zeros(G.shape[1]), 1.0)
    u, _ = nnls(E, target)
    r = E @ u - target  # the residual
    return -r[:-1] / r[-1] * scale, u > 0


def _has_decay_proof(errors: Dynamics, rate: float) -> bool:
    """Return whether some P, Y = PL, W satisfy both inequalities of `decay_limit` at a rate
    [1/s].
    """
    n, p = errors.L.shape
    entries = n * (n + 1) // 2
    ends = [entries, entries + n * p]

    def blocks(x: Floats) -> list[Floats]:
        # x holds P, Y, the weights but the last (their sum is p), and how deep they lie inside.
        """Return the matrices that must be positive semidefinite."""
        of_P, of_Y, of_W = np.split(x[:-1], ends)
        P = symmetric_matrix(of_P, n)
        Y = of_Y.reshape(n, p)
        W = np.append(of_W, p - of_W.sum())
        M, N = _decay_inequalities(errors, rate, P, Y, W)
        return [
            -x[-1] * np.eye(len(M)) - M,
            -x[-1] * np.eye(len(N)) - N,
            W - LEAST,
            P - LEAST * np.eye(n),
        ]

    cost = np.zeros(entries + n * p + p)
    cost[-1] = -1.0
    x = minimise_semidefinite(cost, blocks)
    return x is not None and bool(x[-1] > 0)


def _decay_inequalities(
    errors: Dynamics, rate: float, P: Floats, Y: Floats, W: Floats
) -> tuple[Floats, Floats]:
    """Return (M of the certificate, N of the active decay) of `decay_limit`. Both must be <=
    0.
    """
    (A,), C, _, _, Ts = errors
    PA = P @ A
    cross = C.T * W - Y
    M = np.block([[PA + PA.T, cross], [cross.T, -2 * np.diag(W)]])
    active = PA - Y @ C  # P (A - L C)
    gain = 2 * rate if Ts is None else -np.expm1(-2 * rate * Ts) / Ts
    N = active + active.T + gain * P
    if Ts is not None:
        root = np.sqrt(Ts)
        M = np.block([[M, root * np.vstack([PA.T, -Y.T])], [root * np.hstack([PA, -Y]), -P]])
        N = np.block([[N, root * active.T], [root * active, -P]])
    return M, N
