"""The certificate that replaces Theorem 4.1: one quadratic V for every switching sequence.

Proofs are in docs/certificate.md. V = x~'P x~ + d~'R d~ with R = W Gamma^-1 (W once per edge).
Continuous: [[A'P + PA, C'W - PL], [., -2W]] < 0.
Sampled, in delta form with A = (Ad - I)/Ts and L, Gamma per second:
[[A'P + PA, C'W - PL, sqrt(Ts) A'P], [., Ts W S Gamma S' - 2W, -sqrt(Ts) L'P], [., ., -P]] < 0.
For one output P exists iff the margin below is positive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate import positive_real
from undeadzone.analysis.certificate.stability import unstable
from undeadzone.analysis.dissipation import (
    LEAST,
    NOTHING,
    Check,
    Inequality,
    check,
    optimise,
    storage,
)
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    Storage,
    balance,
    delta,
    dynamics,
    growth,
    identity_storage,
)
from undeadzone.errors import StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats

SEARCHES = 20  # steps of Dinkelbach's iteration for the weights, at most


class Certificate(NamedTuple):
    """Whether gains are certified, the storage V that proves it, and how it checked.

    Attributes:
        certified: whether it is proved.
        reason: why not, in words; empty if it is.
        margin: the largest m with Herm W (1 + G - Ts S Gamma S'/2) >= m W on the whole frequency
            axis, G = C (s - A)^-1 L, under the best W; for one output it is
            min Re (1 + G) - Ts gamma / 2.
        frequency: where it is attained [rad/s]; None: several vertices, or none stable.
        V: the storage; where not certified the best that the solver found.
        dynamics: the error dynamics that it is for.
        check: the inequality's eigenvalues.
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
    """Whether gains are certified: one V falls whatever the sensor shows.

    Args:
        linear: the model's A, B, C (n states, p outputs), of one step if sampled.
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains [1/s]: one number, one per output (p), one per edge (p x 2), or
            the full matrix (2p x 2p).
        Ts: sample time [s]; None in continuous time.

    Returns:
        The certificate; an impossible one is a value with its reason.

    Raises:
        InputError, ShapeError: for gains of the wrong kind.
    """
    return certify_dynamics(dynamics(linear, L, gamma, Ts))


def certify_dynamics(errors: Dynamics, W: Floats | None = None) -> Certificate:
    """`certify` for error dynamics: one P for all vertices of A and what lies between.

    Args:
        errors: the error dynamics.
        W: weights (p) to be used instead of the best, for dynamics with one A.
    """
    V = identity_storage(errors)
    if reason := unstable(errors):
        proof = recheck(errors, V.P, V.W)
        return Certificate(False, reason, -np.inf, None, V, errors, proof)
    scaling = balance(errors)
    scaled = scaling.dynamics(errors)
    if W is None:
        weights = _best_weights(scaled)
    else:
        W = W * scaling.output**2
        weights = _Weights(W, *margin(scaled, W))
    P_scaled = storage(scaled.inequality(weights.W))
    if P_scaled is not None:
        V = V._replace(P=scaling.storage(P_scaled), W=scaling.weights(weights.W))
    proof = recheck(errors, V.P, V.W)
    w = None if weights.frequency is None else weights.frequency / scaling.time
    reason = "" if proof.proved else _reason(errors, weights.margin, w)
    return Certificate(proof.proved, reason, weights.margin, w, V, errors, proof)


def recheck(errors: Dynamics, P: Floats, W: Floats) -> Check:
    """Whether P and W prove the dynamics, by eigenvalues alone; for proofs found elsewhere.

    Args:
        errors: the error dynamics.
        P: weight of the state errors (n x n), symmetric.
        W: weights of the outputs (p).
    """
    p = errors.C.shape[0]
    if W.shape != (p,) or not np.isfinite(W).all():
        return NOTHING
    proof = check(errors.inequality(W), P)
    one_weight = all(np.ptp(W[group > 0]) == 0 for group in errors.groups.T)
    return proof._replace(proved=bool(proof.proved and one_weight and (W > 0).all()))


def margin(errors: Dynamics, W: Floats) -> tuple[float, float]:
    """(margin for this W, frequency [rad/s] where it is attained); exact, without a solver.

    Args:
        errors: error dynamics with one stable A.
        W: weights of the outputs (p).
    """
    (A,), C, L, _, Ts = errors
    root = np.sqrt(W)
    margins = []
    for step in errors.steps:
        D = np.eye(root.size) - step / 2
        G = positive_real.response(A, C * root[:, None], L / root, D, Ts)
        worst = positive_real.worst(G)
        margins.append((worst.value, G.frequency(worst.w)))
    return min(margins)


def stated_margin(errors: Dynamics, W: Floats) -> tuple[float, float]:
    """`margin` of dynamics that are not balanced yet, as `certify_dynamics` says it.

    Args:
        errors: error dynamics with one stable A.
        W: weights of the outputs (p).
    """
    scaling = balance(errors)
    least, frequency = margin(scaling.dynamics(errors), W * scaling.output**2)
    return least, frequency / scaling.time


def passive_gain(linear: Matrices, Ts: float | None) -> Floats:
    """L = P^-1 C' (n x p) [1/s] with A'P + PA = -2 w I, w the size of A.

    It is certified for every stable model. Sampled, in delta form, P is enlarged until L is
    certified with every gamma up to 1 / Ts.

    Args:
        linear: the model's A, B, C, of one step if sampled.
        Ts: sample time [s]; None in continuous time.

    Raises:
        StructureError: if the model is not stable.
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    A, C = delta(linear, Ts), linear.C
    if growth(A, Ts) >= 0:
        raise StructureError(
            "observer.L: missing; there is a default only for a stable model, give L"
        )
    q = 2 * float(np.linalg.norm(A, 2))
    Q = q * np.eye(A.shape[0])
    if Ts is None:
        return np.asarray(np.linalg.solve(solve_continuous_lyapunov(A.T, -Q), C.T))
    L = np.linalg.solve(Ts * solve_discrete_lyapunov(linear.A.T, Q), C.T)
    # What is left of the LMI after PL = C' and a Schur complement must stay below 1; half is taken.
    rest = Ts * C @ L + Ts**2 * C @ A @ A.T @ C.T / q
    return np.asarray(L / max(1.0, 2 * float(np.linalg.eigvalsh((rest + rest.T) / 2)[-1])))


class _Weights(NamedTuple):
    """Weights W (p), their margin and the frequency [rad/s] where it is attained."""

    W: Floats
    margin: float
    frequency: float | None


def _best_weights(errors: Dynamics) -> _Weights:
    """The weights that maximise the margin, with mean 1 over their groups.

    The largest m with M + 2m diag(0, W) <= 0 for some P is quasi-convex in W: Dinkelbach's
    iteration, one LMI a step.
    """
    exact = len(errors.A) == 1
    equal = np.ones(errors.C.shape[0])
    best = _Weights(equal, *margin(errors, equal)) if exact else _Weights(equal, -np.inf, None)
    if exact and errors.groups.shape[1] == 1:
        return best
    shift = best.margin if exact else 0.0
    for _ in range(SEARCHES):
        deepest = _deepest(errors, shift)
        if deepest is None:
            break
        P, W = deepest
        if exact:
            trial = _Weights(W, *margin(errors, W))
        else:
            trial = _Weights(W, _reached(errors, P, W), None)
        gain = trial.margin - best.margin
        if gain > 0:
            best = trial
        if not gain >= 1e-6 * max(1.0, abs(best.margin)):
            break
        shift = best.margin
    return best


def _deepest(errors: Dynamics, shift: float) -> tuple[Floats, Floats] | None:
    """(P, W) of largest t such that M + 2 diag(0, shift W + t I) <= 0; None if there is none."""
    groups, none = errors.groups, np.zeros((errors.L.shape[0], 0))

    def weights(q: Floats) -> Floats:
        return groups @ np.append(q[:-1], groups.shape[1] - q[:-1].sum())

    def family(q: Floats) -> Inequality:
        W = weights(q)
        return errors.extended(W, none, [(1, 1, np.diag(2 * (shift * W + q[-1])))])

    def positive(P: Floats, q: Floats) -> list[Floats]:
        return [weights(q) - LEAST]

    start = np.append(np.ones(groups.shape[1] - 1), 0.0)
    solution = optimise(family, -np.eye(start.size)[-1], start, positive, passes=1)
    if solution is None:
        return None
    return solution.P, np.maximum(weights(solution.q), LEAST)


def _reached(errors: Dynamics, P: Floats, W: Floats) -> float:
    """The largest m with M + 2m diag(0, W) <= 0 for every M at this P; -inf if there is none."""
    n, p = errors.L.shape
    least = np.inf
    for M in errors.inequality(W).matrices(P):
        e = np.arange(n, n + p)  # the rows of the innovation
        rest = np.delete(np.arange(len(M)), e)
        if not np.linalg.eigvalsh(M[np.ix_(rest, rest)])[-1] < 0:
            return -np.inf
        cross = M[np.ix_(rest, e)]
        corner = M[np.ix_(e, e)] - cross.T @ np.linalg.solve(M[np.ix_(rest, rest)], cross)
        least = min(least, float(np.linalg.eigvalsh(-corner / np.sqrt(np.outer(W, W)) / 2)[0]))
    return least


def _reason(errors: Dynamics, least: float, w: float | None) -> str:
    """Why stable dynamics are not certified; least: their margin, w [rad/s]: where it is."""
    if least > 0:
        return (
            f"positive real with margin {least:.3g}, but the proof is lost in rounding: "
            "too small a margin, or too stiff a model for its scaling"
        )
    if w is None:
        return f"the vertices share no V (largest margin found {least:.4g})"
    what = "1 + G" if errors.Ts is None else "1 + G - Ts gamma / 2"
    return f"{what} is not positive real: its least real part is {least:.4g} at {w:.4g} rad/s"
