"""The certificate that replaces Theorem 4.1: one quadratic V for every switching sequence.

Proofs are in docs/certificate.md. V = x~'P x~ + d~'R d~ with R = W Gamma^-1 (W once per edge).
Continuous: [[A'P + PA, C'W - PL], [., -2W]] < 0.
Sampled, in delta form with A = (Ad - I)/Ts and L, Gamma per second:
[[A'P + PA, C'W - PL, sqrt(Ts) A'P], [., Ts W S Gamma S' - 2W, -sqrt(Ts) L'P], [., ., -P]] < 0.
For one output P exists iff the margin below is positive. Models that are not stable have none; why
not is said in words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.weights import Weights, best_weights, margin
from undeadzone.analysis.dissipation import NOTHING, Check, check, storage
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    Storage,
    balance,
    dynamics,
    growth,
    identity_storage,
)
from undeadzone.errors import StructureError
from undeadzone.linalg.matrices import Matrices, delta, similar
from undeadzone.linalg.riccati import storage_of
from undeadzone.plants.system import state_units
from undeadzone.util.arrays import Floats


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
        """Return P (n x n) of V."""
        return self.V.P

    @property
    def W(self) -> Floats:
        """Return the weights (p) of V."""
        return self.V.W

    def recheck(self) -> Check:
        """Prove it again from P, W and the dynamics, by eigenvalues alone."""
        return recheck(self.dynamics, self.P, self.W)


def certify(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None) -> Certificate:
    """Return whether gains are certified: one V falls whatever the sensor shows.

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
    """Return `certify` for error dynamics: one P for all vertices of A and what lies between.

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
        weights = best_weights(scaled)
    else:
        W = W * scaling.output**2
        weights = Weights(W, *margin(scaled, W))
    P_scaled = storage(scaled.inequality(weights.W))
    if P_scaled is not None:
        V = V._replace(P=scaling.storage(P_scaled), W=scaling.weights(weights.W))
    proof = recheck(errors, V.P, V.W)
    w = None if weights.frequency is None else weights.frequency / scaling.time
    reason = "" if proof.proved else _reason(errors, weights.margin, w)
    return Certificate(proof.proved, reason, weights.margin, w, V, errors, proof)


def recheck(errors: Dynamics, P: Floats, W: Floats) -> Check:
    """Return whether P and W prove the dynamics, by eigenvalues alone; for proofs found elsewhere.

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


def state_margin(errors: Dynamics, W: Floats) -> tuple[float, float]:
    """Return `margin` of dynamics that are not balanced yet, as `certify_dynamics` says it.

    Args:
        errors: error dynamics with one stable A.
        W: weights of the outputs (p).
    """
    scaling = balance(errors)
    least, frequency = margin(scaling.dynamics(errors), W * scaling.output**2)
    return least, frequency / scaling.time


def passive_gain(linear: Matrices, Ts: float | None) -> Floats:
    """Return L = P^-1 C' (n x p) [1/s] with A'P + PA = -2 w I, w the size of A.

    It is certified for every stable model. Sampled, in delta form, P is enlarged until L is
    certified with every gamma up to 1 / Ts.

    Args:
        linear: the model's A, B, C, of one step if sampled.
        Ts: sample time [s]; None in continuous time.

    Raises:
        StructureError: if the model is not stable.
    """
    A, _, C = delta(linear, Ts)
    if growth(A, Ts) >= 0:
        raise StructureError(
            "observer.L: missing; there is a default only for a stable model, give L"
        )
    q = 2 * float(np.linalg.norm(A, 2))
    P = storage_of(linear.A, q * np.eye(A.shape[0]), Ts)
    if Ts is None:
        return np.linalg.solve(P, C.T)
    L = np.linalg.solve(Ts * P, C.T)
    # What is left of the LMI after PL = C' and a Schur complement must stay below 1; half is taken.
    rest = Ts * C @ L + Ts**2 * C @ A @ A.T @ C.T / q
    return np.asarray(L / max(1.0, 2 * float(np.linalg.eigvalsh((rest + rest.T) / 2)[-1])))


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


def unstable(errors: Dynamics) -> str:
    """Why no V can exist whatever the gains, or an empty string."""
    fastest, k = max((growth(A, errors.Ts), k) for k, A in enumerate(errors.A))
    seen = Matrices(errors.A[k], errors.L, errors.C)
    A = similar(seen.A, state_units(seen))  # what is small must not depend on the unit of time
    size = float(np.linalg.norm(A, 2))
    where = "" if len(errors.A) == 1 else f" (vertex {k})"
    if fastest > 1e-9 * size:
        return (
            f"the model is unstable{where}, growth rate {fastest:.4g} 1/s: "
            "while the sensor is silent nothing holds the error, so no common V exists"
        )
    if fastest < -1e-12 * size:
        return ""
    if defective(A, errors.Ts):
        return (
            f"the model has a chain of integrators or a repeated undamped mode{where}: "
            "while the sensor is silent the error grows, so no common V exists"
        )
    what, then = "undamped mode", "the error can be kept bounded"
    if np.linalg.svd(A, compute_uv=False)[-1] < 1e-9 * size or size == 0:
        what = "integrator"
        then += ", but of the widths only their sum can be known"
    return (
        f"the model is only marginally stable{where} (an {what}): "
        f"while the sensor is silent the error stays, so no strict V exists; {then}"
    )


def defective(A: Floats, Ts: float | None) -> bool:
    """Return whether an eigenvalue on the stability boundary has too few eigenvectors.

    Args:
        A: the matrix (n x n; delta form if sampled) [1/s].
        Ts: sample time [s]; None in continuous time.
    """
    poles, size = np.linalg.eigvals(A), max(float(np.linalg.norm(A, 2)), 1e-300)
    decay = np.abs(poles.real) if Ts is None else np.abs(np.abs(1 + Ts * poles) - 1) / Ts
    for s in poles[decay < 1e-6 * size]:
        multiplicity = (np.abs(poles - s) < 1e-4 * size).sum()
        singular = np.linalg.svd(A - s * np.eye(A.shape[0]), compute_uv=False)
        if (singular < 1e-9 * size).sum() < multiplicity:
            return True
    return False
