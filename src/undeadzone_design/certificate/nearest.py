"""Limits of certification: the certified gains nearest to given gains, and the fastest decay.

The decay is that of x~'P x~ with one P, over all certified gains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify_dynamics
from undeadzone.analysis.certificate.weights import (
    frequency_response,
)
from undeadzone.analysis.dissipation import LEAST
from undeadzone.analysis.error_dynamics import Dynamics, balance_dynamics, build_error_dynamics
from undeadzone.errors import StructureError
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import storage_of
from undeadzone.numerics.semidefinite import minimise_semidefinite, symmetric_matrix
from undeadzone.util.arrays import Floats

ROOM = 1e-3  # of the margin, by which the nearest L exceeds it
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

    With the weights W that suit L best, the admissible gains are a convex set, so that the nearest
    is unique. It solves a semidefinite programme. If it cannot be proved in floating point it is
    drawn towards L = 0. Sampled, Gamma is first scaled down so that no Ts gamma exceeds 1.

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

    In coordinates in which the distance is that of the matrices, L and one Q for each step of the
    largest gains solve a semidefinite programme: D + C (s - A)^-1 L has a Hermitian part of `least`
    or more if and only if [AQ + QA', L - QC'; ., 2 least - D - D'] <= 0 for some Q > 0 (the
    positive real lemma, with Q = P^-1). L = 0 if the solver fails.
    """
    root = np.sqrt(W)
    shape = _energy_metric(errors, W).T
    inverse = np.linalg.inv(shape)
    A = shape @ errors.A[0] @ inverse
    C = root[:, None] * errors.C @ inverse
    target = shape @ (errors.L / root)
    n, p = target.shape
    bound = 2 * least * (1 + ROOM) * np.eye(p)

    def blocks(x: Floats) -> list[Floats]:
        """Return the matrices that must be positive semidefinite, x = [L, every Q, distance]."""
        L = x[: n * p].reshape(n, p)
        move = (L - target).reshape(-1, 1)
        far = x[-1] * np.eye(n * p)
        found = [np.block([[far, move], [move.T, x[-1:, None]]])]
        each = np.split(x[n * p : -1], len(errors.largest_gain_steps))
        for step, entries in zip(errors.largest_gain_steps, each, strict=True):
            Q = symmetric_matrix(entries, n)
            G = frequency_response(A, C, L, np.eye(p) - step / 2, errors.Ts)
            moved = G.A @ Q
            cross = G.L - Q @ G.C.T
            corner = bound - G.D - G.D.T
            found += [-np.block([[moved + moved.T, cross], [cross.T, corner]]), Q]
        return found

    size = n * p + len(errors.largest_gain_steps) * n * (n + 1) // 2
    x = minimise_semidefinite(np.eye(size + 1)[-1], blocks)
    found = np.zeros((n, p)) if x is None else x[: n * p].reshape(n, p)
    return np.asarray(inverse @ found * root)


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
