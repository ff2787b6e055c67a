"""The edge of what can be certified: the certified gains nearest to given ones, and the fastest common-P decay of any."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.arrays import Floats
from undeadzone.design.dissipation import LEAST
from undeadzone.design.errordynamics import Dynamics, balance, delta, dynamics
from undeadzone.design.frequency import response, worst
from undeadzone.design.passivity import Certificate, certify_dynamics
from undeadzone.design.semidefinite import minimise, symmetric
from undeadzone.errors import StructureError
from undeadzone.plant import Matrices


class Nearest(NamedTuple):
    """The nearest gains' certificate (its dynamics hold L and gamma), and how far they are: the norm of the change of
    W^(1/2) G (energy of its impulse response) over that of W^(1/2) G itself, a number that no change of coordinates alters."""

    certificate: Certificate
    distance: float


def nearest(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None, least: float = 0.01, rounds: int = 3) -> Nearest:
    """The gains nearest to L (n x p) whose margin is `least` or more; L itself if it has that.

    For one output the admissible L are an intersection of half-spaces, one per frequency, so that the nearest is unique
    and is found by adding the exact worst frequency again and again; for several outputs it is nearest for the weights
    W that suit it best (alternated `rounds` times). Sampled, Gamma is first scaled down so that no Ts gamma exceeds 1.
    Raises StructureError for a model that no gain can certify.
    """
    given = dynamics(linear, L, gamma, Ts)
    if given.Ts is not None:
        given = given._replace(gamma=given.gamma / max(1.0, given.Ts * np.linalg.eigvalsh(given.gamma)[-1]))
    certificate = certify_dynamics(given)
    if certificate.margin == -np.inf:
        raise StructureError(f"observer.L: no gains can be certified: {certificate.reason}")
    distance = 0.0
    for _ in range(rounds):
        if distance == 0.0 and certificate.certified and certificate.margin >= least:
            break
        found, distance = _project(given, certificate.W, least)
        certificate = certify_dynamics(given._replace(L=found))
        if certificate.W.size == 1:
            break
    return Nearest(certificate, distance)


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


def _project(given: Dynamics, W: Floats, least: float) -> tuple[Floats, float]:
    """(L nearest to the given one whose margin under W is `least`, relative distance): least-distance cutting planes."""
    (A,), C, start, _, Ts = given
    root = np.sqrt(W)
    observed = C * root[:, None]
    values, vectors = np.linalg.eigh(_gramian(A, observed, Ts))
    shape = vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1]))  # |shape' dL|_F is the distance
    inward = vectors / np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    target = start / root  # L in units where W = 1
    L, normals, levels = target, [], []
    for _ in range(200):
        cuts = []
        for step in given.steps:
            D = np.eye(root.size) - step / 2
            G = response(A, observed, L, D, Ts)
            found = worst(G)
            if found.value < least:
                row = found.direction.conj() @ observed @ _resolvent(A, found.w, Ts)
                normal = np.real(row[:, None] * found.direction[None, :])
                floor = least * (1 + 1e-3) - float(np.real(found.direction.conj() @ D @ found.direction))
                cuts.append((inward.T @ normal, floor - float((normal * target).sum())))
        if not cuts:
            break
        for normal, level in cuts:
            normals.append(normal.ravel())
            levels.append(level)
        move = _least_distance(np.array(normals), np.array(levels)).reshape(target.shape)
        L = target + inward @ move
    change = np.linalg.norm(shape.T @ (L - target)) / max(np.linalg.norm(shape.T @ target), 1e-300)
    return L * root, float(change)


def _resolvent(A: Floats, w: float, Ts: float | None) -> np.ndarray:
    """(s - A)^-1 at s = jw, sampled at (z - 1)/Ts of Tustin's frequency w; 0 or its limit at w = inf."""
    if Ts is None:
        return np.zeros(A.shape, complex) if np.isinf(w) else np.linalg.inv(1j * w * np.eye(A.shape[0]) - A)
    s = -2 / Ts if np.isinf(w) else 1j * w / (1 - 1j * w * Ts / 2)
    return np.linalg.inv(s * np.eye(A.shape[0]) - A)


def _gramian(A: Floats, C: Floats, Ts: float | None) -> Floats:
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    if Ts is None:
        return np.asarray(solve_continuous_lyapunov(A.T, -C.T @ C))
    return np.asarray(solve_discrete_lyapunov((np.eye(A.shape[0]) + Ts * A).T, Ts * C.T @ C))


def _least_distance(G: Floats, h: Floats) -> Floats:
    """The shortest x with G x >= h (Lawson and Hanson 1974, chapter 23)."""
    from scipy.optimize import nnls

    size = np.linalg.norm(G, axis=1)
    E = np.vstack([(G / size[:, None]).T, h / size])
    u, _ = nnls(E, np.append(np.zeros(G.shape[1]), 1.0))
    r = E @ u - np.append(np.zeros(G.shape[1]), 1.0)
    return np.asarray(-r[:-1] / r[-1])


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
        return [-x[-1] * np.eye(len(M)) - M, -x[-1] * np.eye(len(N)) - N, W - LEAST, P - LEAST * np.eye(n)]

    cost = np.zeros(entries + n * p + p)
    cost[-1] = -1.0
    x = minimise(cost, blocks)
    return x is not None and bool(x[-1] > 0)
