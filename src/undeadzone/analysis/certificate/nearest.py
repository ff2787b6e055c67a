"""The edge of what can be certified: the certified gains nearest to given ones, and the fastest common-P decay of any."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify_dynamics
from undeadzone.analysis.certificate.positive_real import response, worst
from undeadzone.analysis.dissipation import LEAST
from undeadzone.analysis.error_dynamics import Dynamics, balance, dynamics
from undeadzone.errors import StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.numerics.semidefinite import minimise, symmetric
from undeadzone.support.arrays import Floats


class Nearest(NamedTuple):
    """The nearest gains' certificate (its dynamics hold L and gamma), and how far they are.

    distance: the norm of the change of W^(1/2) G W^(-1/2) (energy of its impulse response) over that of itself, a number
    that no change of coordinates alters.
    """

    certificate: Certificate
    distance: float


def nearest(
    linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None, least: float = 0.01
) -> Nearest:
    """The gains nearest to L (n x p) whose margin is `least` or more; L itself if it has that.

    With the weights W that suit L best, the admissible gains are an intersection of half-spaces, one per frequency and
    direction, so that the nearest is unique; it is found by adding the exact worst frequency again and again. If it
    cannot be proved in floating point it is drawn towards L = 0. Sampled, Gamma is first scaled down so that no Ts
    gamma exceeds 1. Raises StructureError for a model that no gain can certify.
    """
    given = dynamics(linear, L, gamma, Ts)
    if given.Ts is not None:
        given = given._replace(
            gamma=given.gamma / max(1.0, given.Ts * np.linalg.eigvalsh(given.gamma)[-1])
        )
    certificate = certify_dynamics(given)
    if certificate.margin == -np.inf:
        raise StructureError(f"observer.L: no gains can be certified: {certificate.reason}")
    if certificate.certified and certificate.margin >= least:
        return Nearest(certificate, 0.0)
    W, found = certificate.W, _project(given, certificate.W, least)
    for share in (1.0, 0.99, 0.9, 0.5, 0.1, 0.0):
        certificate = certify_dynamics(given._replace(L=share * found), W)
        if certificate.certified and certificate.margin >= least:
            break
    shape = _metric(given, W)
    change, size = (
        float(np.linalg.norm(shape.T @ (gains / np.sqrt(W))))
        for gains in (given.L - share * found, given.L)
    )
    return Nearest(certificate, change / size)


def decay_limit(linear: Matrices, Ts: float | None = None, tolerance: float = 1e-4) -> float:
    """The largest rate [1/s] at which one x~'P x~ can fall while an output is active, over every certified L (and P, W).

    Bisection on the LMI M(P, Y, W) <= 0, (A - LC)'P + P(A - LC) <= -2 rate P with Y = PL (sampled: e^(-2 rate Ts) P);
    inf where there is no limit. It is a limit of common-P proofs, not of how fast the error really falls.
    """
    n, p = linear.A.shape[0], linear.C.shape[0]
    given = dynamics(linear, np.zeros((n, p)), np.zeros(p), Ts)
    scaling = balance(given)
    scaled = scaling.dynamics(given)
    size = float(np.linalg.norm(scaled.A[0], 2))
    low, high = 0.0, size
    while _decays(scaled, high):
        low, high = high, 2 * high
        if high > 1e4 * size:
            return np.inf
    while high - low > tolerance * high:
        middle = (low + high) / 2
        low, high = (middle, high) if _decays(scaled, middle) else (low, middle)
    return low / scaling.time


def _project(given: Dynamics, W: Floats, least: float) -> Floats:
    """L nearest to the given one whose margin under W is `least`: least-distance cutting planes."""
    (A,), C, start, _, Ts = given
    root = np.sqrt(W)
    observed = C * root[:, None]
    inward = np.linalg.inv(_metric(given, W)).T
    target = start / root  # L in units where W = 1
    L, seen, normals, levels = (
        target,
        [set[float]() for _ in given.steps],
        np.zeros((0, target.size)),
        np.zeros(0),
    )
    for _ in range(200):
        done = True
        for step, frequencies in zip(given.steps, seen, strict=True):
            D = np.eye(root.size) - step / 2
            G = response(A, observed, L, D, Ts)
            found = worst(G)
            done &= found.value >= least
            frequencies.add(found.w)
            at = np.array([*frequencies])
            for w, values, directions in zip(at, *np.linalg.eigh(G.at(at)), strict=True):
                rows = observed @ _resolvent(A, w, Ts)
                for v in directions.T[values < least]:
                    slope = np.real((v.conj() @ rows)[:, None] * v)
                    normals = np.vstack([normals, (inward.T @ slope).ravel()])
                    levels = np.append(
                        levels,
                        least * (1 + 1e-3) - np.real(v.conj() @ D @ v) - (slope * target).sum(),
                    )
        if done:
            break
        move, active = _least_distance(normals, levels)
        normals, levels = normals[active], levels[active]
        L = target + inward @ move.reshape(target.shape)
    return np.asarray(L * root)


def _metric(given: Dynamics, W: Floats) -> Floats:
    """M (n x n) such that |M'L|_F is the energy norm of C (s - A)^-1 L weighted by W: M M' is the observability Gramian.

    Directions that are hardly observable are given a least weight, so that M can be inverted.
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    (A,), C, Ts = given.A, given.C * np.sqrt(W)[:, None], given.Ts
    Q = (
        solve_continuous_lyapunov(A.T, -C.T @ C)
        if Ts is None
        else solve_discrete_lyapunov((np.eye(len(A)) + Ts * A).T, Ts * C.T @ C)
    )
    values, vectors = np.linalg.eigh(Q)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1])))


def _resolvent(A: Floats, w: float, Ts: float | None) -> np.ndarray:
    """(s - A)^-1 at s = jw, sampled at (z - 1)/Ts of Tustin's frequency w; 0 or its limit at w = inf."""
    if Ts is None:
        return (
            np.zeros(A.shape, complex)
            if np.isinf(w)
            else np.linalg.inv(1j * w * np.eye(A.shape[0]) - A)
        )
    s = -2 / Ts if np.isinf(w) else 1j * w / (1 - 1j * w * Ts / 2)
    return np.linalg.inv(s * np.eye(A.shape[0]) - A)


def _least_distance(G: Floats, h: Floats) -> tuple[Floats, np.ndarray]:
    """(the shortest x with G x >= h, which rows hold it): Lawson and Hanson 1974, chapter 23."""
    from scipy.optimize import nnls

    size = np.linalg.norm(G, axis=1)
    levels = h / size
    scale = np.abs(levels).max()
    E = np.vstack([(G / size[:, None]).T, levels / scale])
    target = np.append(np.zeros(G.shape[1]), 1.0)
    u, _ = nnls(E, target)
    r = E @ u - target
    return -r[:-1] / r[-1] * scale, u > 0


def _decays(given: Dynamics, rate: float) -> bool:
    """Whether some P, Y = PL, W satisfy both inequalities of `decay_limit` at this rate."""
    (A,), C, _, _, Ts = given
    n, p = A.shape[0], C.shape[0]
    entries = n * (n + 1) // 2

    def blocks(x: Floats) -> list[Floats]:
        P, Y = symmetric(x[:entries], n), x[entries : entries + n * p].reshape(n, p)
        W = np.append(x[entries + n * p : -1], p - x[entries + n * p : -1].sum())
        PF = P @ A
        cross = C.T * W - Y
        M = np.block([[PF + PF.T, cross], [cross.T, -2 * np.diag(W)]])
        active = PF - Y @ C
        gain = 2 * rate if Ts is None else -np.expm1(-2 * rate * Ts) / Ts
        N = active + active.T + gain * P
        if Ts is not None:
            root = np.sqrt(Ts)
            M = np.block([[M, root * np.vstack([PF.T, -Y.T])], [root * np.hstack([PF, -Y]), -P]])
            N = np.block([[N, root * active.T], [root * active, -P]])
        return [
            -x[-1] * np.eye(len(M)) - M,
            -x[-1] * np.eye(len(N)) - N,
            W - LEAST,
            P - LEAST * np.eye(n),
        ]

    cost = np.zeros(entries + n * p + p)
    cost[-1] = -1.0
    x = minimise(cost, blocks)
    return x is not None and bool(x[-1] > 0)
