"""The certificate that replaces Theorem 4.1: one quadratic V for every switching sequence; proofs in docs/certificate.md.

V = x~'P x~ + d~'R d~ with R = W Gamma^-1 (W once per edge). Continuous: [[A'P + PA, C'W - PL], [., -2W]] < 0.
Sampled, in delta form with A = (Ad - I)/Ts and L, Gamma per second: [[A'P + PA, C'W - PL, sqrt(Ts) A'P],
[., Ts W S Gamma S' - 2W, -sqrt(Ts) L'P], [., ., -P]] < 0. For one output P exists iff the margin below is positive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate import positive_real as frequency
from undeadzone.analysis.dissipation import LEAST, Check, Inequality, check, optimise, storage
from undeadzone.analysis.error_dynamics import Dynamics, Storage, balance, delta, dynamics, growth
from undeadzone.errors import StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats


class Certificate(NamedTuple):
    """certified, or the reason why not; the storage V that proves it for the error dynamics, and how it checked.

    margin: the largest m with Herm W (1 + G - Ts S Gamma S'/2) >= m W on the whole frequency axis, G = C (s - A)^-1 L,
    under the best W; for one output it is min Re (1 + G) - Ts gamma / 2. frequency: where it is attained [rad/s] (None:
    several vertices, or none stable). Where not certified, V is the best that the solver found.
    """

    certified: bool
    reason: str
    margin: float
    frequency: float | None
    V: Storage
    dynamics: Dynamics
    check: Check

    @property
    def P(self) -> Floats:
        """P (n x n) of V."""
        return self.V.P

    @property
    def W(self) -> Floats:
        """The weights (p) of V."""
        return self.V.W

    def recheck(self) -> Check:
        """Prove it again from P, W and the dynamics, by eigenvalues alone."""
        return recheck(self.dynamics, self.P, self.W)


def certify(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None) -> Certificate:
    """Whether gains L (n x p) and gamma (see `errordynamics.adaptation`), both [1/s], are certified; Ts [s] of a sampled model.

    Raises InputError, ShapeError for gains of the wrong kind; an impossible certificate is a value with its reason.
    """
    return certify_dynamics(dynamics(linear, L, gamma, Ts))


def certify_dynamics(given: Dynamics, W: Floats | None = None) -> Certificate:
    """`certify` for error dynamics, whose A may have several vertices: one P for all of them and what lies between.

    W (p): weights to be used instead of the best, for dynamics with one A.
    """
    trivial = np.eye(given.A[0].shape[0]), np.ones(given.C.shape[0])
    if reason := _unstable(given):
        return Certificate(
            False,
            reason,
            -np.inf,
            None,
            Storage(*trivial, given.gamma),
            given,
            recheck(given, *trivial),
        )
    scaling = balance(given)
    scaled = scaling.dynamics(given)
    W, least, w = (
        _weights(scaled)
        if W is None
        else (W * scaling.output**2, *margin(scaled, W * scaling.output**2))
    )
    found = storage(scaled.inequality(W))
    P, W = trivial if found is None else (scaling.storage(found), scaling.weights(W))
    proof = recheck(given, P, W)
    w = None if w is None else w / scaling.time
    return Certificate(
        proof.proved,
        "" if proof.proved else _reason(given, least, w),
        least,
        w,
        Storage(P, W, given.gamma),
        given,
        proof,
    )


def recheck(given: Dynamics, P: Floats, W: Floats) -> Check:
    """Whether P (n x n), W (p) prove the dynamics, by eigenvalues alone; for proofs stored or found elsewhere."""
    found = check(given.inequality(W), P)
    one_weight = all(np.ptp(W[group > 0]) == 0 for group in given.groups.T)
    return found._replace(proved=bool(found.proved and one_weight and (W > 0).all()))


def margin(given: Dynamics, W: Floats) -> tuple[float, float]:
    """(margin for this W, frequency [rad/s] where it is attained) of dynamics with one stable A; exact, without a solver."""
    (A,), C, L, _, Ts = given
    root = np.sqrt(W)
    found = []
    for step in given.steps:
        G = frequency.response(A, C * root[:, None], L / root, np.eye(root.size) - step / 2, Ts)
        worst = frequency.worst(G)
        found.append((worst.value, G.frequency(worst.w)))
    return min(found)


def passive_gain(linear: Matrices, Ts: float | None) -> Floats:
    """L = P^-1 C' [1/s] with A'P + PA = -2 w I, w the size of A: certified for every stable model.

    Sampled, in delta form, P is enlarged until L is certified with every gamma up to 1 / Ts. Raises StructureError if
    the model is not stable.
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    A, C = delta(linear, Ts), linear.C
    if growth(A, Ts) >= 0:
        raise StructureError(
            "observer.L: missing; there is a default only for a stable model, give L"
        )
    q = 2 * float(np.linalg.norm(A, 2))
    if Ts is None:
        return np.asarray(
            np.linalg.solve(solve_continuous_lyapunov(A.T, -q * np.eye(A.shape[0])), C.T)
        )
    L = np.linalg.solve(Ts * solve_discrete_lyapunov(linear.A.T, q * np.eye(A.shape[0])), C.T)
    # What is left of the LMI after PL = C' and a Schur complement; it must stay below 1, half of it is taken.
    rest = Ts * C @ L + Ts**2 * C @ A @ A.T @ C.T / q
    return np.asarray(L / max(1.0, 2 * float(np.linalg.eigvalsh((rest + rest.T) / 2)[-1])))


def _weights(given: Dynamics) -> tuple[Floats, float, float | None]:
    """(W that maximises the margin, with mean 1 over its groups; that margin; where it is attained).

    The largest m with M + 2m diag(0, W) <= 0 for some P is quasi-convex in W: Dinkelbach's iteration, one LMI a step.
    """
    exact = len(given.A) == 1
    W: Floats = np.ones(given.C.shape[0])
    best, w = margin(given, W) if exact else (-np.inf, None)
    if exact and given.groups.shape[1] == 1:
        return W, best, w
    shift = best if exact else 0.0
    for _ in range(20):
        found = _deepest(given, shift)
        if found is None:
            break
        P, trial = found
        reached, at = margin(given, trial) if exact else (_reached(given, P, trial), None)
        gain = reached - best
        if gain > 0:
            W, best, w = trial, reached, at
        if not gain >= 1e-6 * max(1.0, abs(best)):
            break
        shift = best
    return W, best, w


def _deepest(given: Dynamics, shift: float) -> tuple[Floats, Floats] | None:
    """(P, W) of largest t such that M + 2 diag(0, shift W + t I) <= 0; None if there is none."""
    groups, none = given.groups, np.zeros((given.L.shape[0], 0))

    def weights(q: Floats) -> Floats:
        return groups @ np.append(q[:-1], groups.shape[1] - q[:-1].sum())

    def family(q: Floats) -> Inequality:
        W = weights(q)
        return given.extended(W, none, [(1, 1, np.diag(2 * (shift * W + q[-1])))])

    start = np.append(np.ones(groups.shape[1] - 1), 0.0)
    found = optimise(
        family, -np.eye(start.size)[-1], start, lambda P, q: [weights(q) - LEAST], passes=1
    )
    return None if found is None else (found.P, np.maximum(weights(found.q), LEAST))


def _reached(given: Dynamics, P: Floats, W: Floats) -> float:
    """The largest m with M + 2m diag(0, W) <= 0 for every M at this P; -inf if there is none."""
    n, p = given.L.shape
    least = np.inf
    for M in given.inequality(W).matrices(P):
        e = np.arange(n, n + p)
        rest = np.delete(np.arange(len(M)), e)
        if not np.linalg.eigvalsh(M[np.ix_(rest, rest)])[-1] < 0:
            return -np.inf
        cross = M[np.ix_(rest, e)]
        corner = M[np.ix_(e, e)] - cross.T @ np.linalg.solve(M[np.ix_(rest, rest)], cross)
        least = min(least, float(np.linalg.eigvalsh(-corner / np.sqrt(np.outer(W, W)) / 2)[0]))
    return least


def _unstable(given: Dynamics) -> str:
    """Why no V can exist whatever the gains, or an empty string."""
    fastest, k = max((growth(A, given.Ts), k) for k, A in enumerate(given.A))
    size = float(np.linalg.norm(given.A[k], 2))
    where = "" if len(given.A) == 1 else f" (vertex {k})"
    if fastest > 1e-9 * size:
        return f"the model is unstable{where}, growth rate {fastest:.4g} 1/s: while the sensor is silent nothing holds the error, so no common V exists"
    if fastest < -1e-12 * size:
        return ""
    if _defective(given.A[k], given.Ts):
        return f"the model has a chain of integrators or a repeated undamped mode{where}: while the sensor is silent the error grows, so no common V exists"
    what, then = "undamped mode", "the error can be kept bounded"
    if np.linalg.svd(given.A[k], compute_uv=False)[-1] < 1e-9 * size or size == 0:
        what, then = (
            "integrator",
            "the error can be kept bounded, but of the widths only their sum can be known",
        )
    return f"the model is only marginally stable{where} (an {what}): while the sensor is silent the error stays, so no strict V exists; {then}"


def _defective(A: Floats, Ts: float | None) -> bool:
    """Whether an eigenvalue on the stability boundary has fewer eigenvectors than its multiplicity."""
    poles, size = np.linalg.eigvals(A), max(float(np.linalg.norm(A, 2)), 1e-300)
    decay = np.abs(poles.real) if Ts is None else np.abs(np.abs(1 + Ts * poles) - 1) / Ts
    for s in poles[decay < 1e-6 * size]:
        multiplicity = (np.abs(poles - s) < 1e-4 * size).sum()
        singular = np.linalg.svd(A - s * np.eye(A.shape[0]), compute_uv=False)
        if (singular < 1e-9 * size).sum() < multiplicity:
            return True
    return False


def _reason(given: Dynamics, least: float, w: float | None) -> str:
    if least > 0:
        return f"positive real with margin {least:.3g}, but the proof is lost in rounding: too small a margin, or too stiff a model for its scaling"
    if w is None:
        return f"the vertices share no V (largest margin found {least:.4g})"
    what = "1 + G" if given.Ts is None else "1 + G - Ts gamma / 2"
    return f"{what} is not positive real: its least real part is {least:.4g} at {w:.4g} rad/s"
