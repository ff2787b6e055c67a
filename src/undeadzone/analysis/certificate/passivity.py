"""Certificate that replaces Theorem 4.1: a common quadratic V for every switching sequence.

Proofs are in docs/certificate.md. V = x~'P x~ + d~'R d~ with R = W Gamma^-1 (W once per edge).
Continuous: [[A'P + PA, C'W - PL], [., -2W]] < 0. Sampled, in delta form with A = (Ad - I)/Ts and L,
Gamma per second: [[A'P + PA, C'W - PL, sqrt(Ts) A'P], [., Ts W S Gamma S' - 2W, -sqrt(Ts) L'P], [.,
., -P]] < 0. For one output P exists iff the margin below is positive. Models that are not stable
have none. The reason is given in words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.weights import OutputWeights, best_weights, margin_of_weights
from undeadzone.analysis.dissipation import (
    NO_PROOF,
    DefinitenessCheck,
    check_inequality,
    find_storage,
)
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    Storage,
    balance_dynamics,
    build_error_dynamics,
    identity_storage,
    largest_growth_rate,
)
from undeadzone.errors import StructureError
from undeadzone.linalg.matrices import Matrices, change_state_units, delta_form, symmetric_part
from undeadzone.linalg.riccati import storage_of
from undeadzone.plants.system import holds_no_width, state_units
from undeadzone.util.arrays import Floats


class Certificate(NamedTuple):
    """Result of a certification: the storage V that proves the gains, with its check.

    Attributes:
        certified: whether it is proved.
        reason: why not, in words (empty if it is).
        margin: the largest m with Herm W (1 + G - Ts S Gamma S'/2) >= m W on the whole frequency
            axis, G = C (s - A)^-1 L, under the best W. For one output it is
            min Re (1 + G) - Ts gamma / 2.
        frequency: frequency of that margin [rad/s] (None: several vertices, or none stable).
        V: the storage (if not certified, the best that the solver found).
        dynamics: the error dynamics that it is for.
        check: the inequality's eigenvalues.
    """

    certified: bool
    reason: str
    margin: float
    frequency: float | None
    V: Storage
    dynamics: Dynamics
    check: DefinitenessCheck

    @property
    def P(self) -> Floats:
        """Return P of V (n x n)."""
        return self.V.P

    @property
    def W(self) -> Floats:
        """Return the weights of V (p)."""
        return self.V.W


def certify(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None) -> Certificate:
    """Certify gains: a common V falls for every sequence of branches.

    Args:
        linear: the model's A, B, C (n states, p outputs), of one step if sampled.
        L: observer gains (n x p) [1/s].
        gamma: adaptation gains [1/s]: one number, one per output (p), one per edge (p x 2), or
            the full matrix (2p x 2p).
        Ts: sample time [s] (None in continuous time).

    Returns:
        The certificate. An impossible one is a value with its reason.

    Raises:
        InputError, ShapeError: for gains of the wrong kind.
    """
    return certify_dynamics(build_error_dynamics(linear, L, gamma, Ts))


def certify_dynamics(errors: Dynamics, W: Floats | None = None) -> Certificate:
    """Certify error dynamics: a common P for all vertices of A and their convex hull.

    Args:
        errors: the error dynamics.
        W: weights (p) to be used instead of the best, for dynamics with one A.
    """
    V = identity_storage(errors)
    if reason := instability_reason(errors):
        proof = recheck_proof(errors, V.P, V.W)
        return Certificate(False, reason, -np.inf, None, V, errors, proof)
    scaling = balance_dynamics(errors)
    scaled = scaling.scale_dynamics(errors)
    if W is None:
        weights = best_weights(scaled)
    else:
        W = W * scaling.output**2
        weights = OutputWeights(W, *margin_of_weights(scaled, W))
    P_scaled = find_storage(scaled.inequality(weights.W))
    if P_scaled is not None:
        V = V._replace(P=scaling.unscale_storage(P_scaled), W=scaling.unscale_weights(weights.W))
    proof = recheck_proof(errors, V.P, V.W)
    w = None if weights.frequency is None else weights.frequency / scaling.time
    reason = "" if proof.proved else _reason_without_proof(errors, weights.margin, w)
    return Certificate(proof.proved, reason, weights.margin, w, V, errors, proof)


def recheck_proof(errors: Dynamics, P: Floats, W: Floats) -> DefinitenessCheck:
    """Check by eigenvalues alone that P and W prove the dynamics, for proofs found elsewhere.

    Args:
        errors: the error dynamics.
        P: weight of the state errors (n x n), symmetric.
        W: weights of the outputs (p).
    """
    p = errors.C.shape[0]
    if W.shape != (p,) or not np.isfinite(W).all():
        return NO_PROOF
    proof = check_inequality(errors.inequality(W), P)
    one_weight = all(np.ptp(W[group > 0]) == 0 for group in errors.groups.T)
    return proof._replace(proved=bool(proof.proved and one_weight and (W > 0).all()))


def margin_of_dynamics(errors: Dynamics, W: Floats) -> tuple[float, float]:
    """Return (margin, frequency [rad/s]) of unbalanced dynamics, as `certify_dynamics`
    reports.

    Args:
        errors: error dynamics with one stable A.
        W: weights of the outputs (p).
    """
    scaling = balance_dynamics(errors)
    least, frequency = margin_of_weights(scaling.scale_dynamics(errors), W * scaling.output**2)
    return least, frequency / scaling.time


def passive_gain(linear: Matrices, Ts: float | None) -> Floats:
    """Return L = P^-1 C' (n x p) [1/s] with A'P + PA = -2 w I, w the size of A.

    It is certified for every stable model. Sampled, in delta form, P is enlarged until L is
    certified with every gamma up to 1 / Ts.

    Args:
        linear: the model's A, B, C, of one step if sampled.
        Ts: sample time [s] (None in continuous time).

    Raises:
        StructureError: if the model is not stable.
    """
    A, _, C = delta_form(linear, Ts)
    if largest_growth_rate(A, Ts) >= 0:
        raise StructureError("the model is not stable: no gain is passive")
    q = 2 * float(np.linalg.norm(A, 2))
    P = storage_of(linear.A, q * np.eye(A.shape[0]), Ts)
    if Ts is None:
        return np.linalg.solve(P, C.T)
    L = np.linalg.solve(Ts * P, C.T)
    # The rest of the LMI after PL = C' and a Schur complement must stay below 1. Half is taken.
    rest = Ts * C @ L + Ts**2 * C @ A @ A.T @ C.T / q
    return np.asarray(L / max(1.0, 2 * float(np.linalg.eigvalsh(symmetric_part(rest))[-1])))


def _reason_without_proof(errors: Dynamics, least: float, w: float | None) -> str:
    """Describe why stable dynamics are not certified.

    `least` is their margin, `w` its frequency [rad/s].
    """
    if least > 0:
        return (
            f"positive real with margin {least:.3g}, but the proof is lost in rounding: "
            "too small a margin, or too stiff a model for its scaling"
        )
    if w is None:
        return f"the vertices share no V (largest margin found {least:.4g})"
    what = "1 + G" if errors.Ts is None else "1 + G - Ts gamma / 2"
    return f"{what} is not positive real: its least real part is {least:.4g} at {w:.4g} rad/s"


def instability_reason(errors: Dynamics) -> str:
    """Describe why no V can exist with any gains, or return an empty string."""
    fastest, k = max((largest_growth_rate(A, errors.Ts), k) for k, A in enumerate(errors.A))
    seen = Matrices(errors.A[k], errors.L, errors.C)
    A = change_state_units(
        seen.A, state_units(seen)
    )  # the definition of small must not depend on the unit of time
    size = float(np.linalg.norm(A, 2))
    where = "" if len(errors.A) == 1 else f" (vertex {k})"
    if fastest > 1e-9 * size:
        return (
            f"the model is unstable{where}, growth rate {fastest:.4g} 1/s: "
            "while the sensor is silent nothing holds the error, so no common V exists"
            + "; no gamma > 0 learns a width (an odd number of unstable poles)"
            * holds_no_width(A)
        )
    if fastest < -1e-12 * size:
        return ""
    if is_defective(A, errors.Ts):
        return (
            f"the model has a chain of integrators or a repeated undamped mode{where}: "
            "while the sensor is silent the error grows, so no common V exists"
        )
    what = "undamped mode"
    then = "the error can be kept bounded"
    if np.linalg.svd(A, compute_uv=False)[-1] < 1e-9 * size or size == 0:
        what = "integrator"
        then += ", but of the widths only their sum can be known"
    return (
        f"the model is only marginally stable{where} (an {what}): "
        f"while the sensor is silent the error stays, so no strict V exists; {then}"
    )


def is_defective(A: Floats, Ts: float | None) -> bool:
    """Return whether an eigenvalue on the stability boundary has too few eigenvectors.

    Args:
        A: the matrix (n x n, delta form if sampled) [1/s].
        Ts: sample time [s] (None in continuous time).
    """
    poles = np.linalg.eigvals(A)
    size = max(float(np.linalg.norm(A, 2)), 1e-300)
    decay = np.abs(poles.real) if Ts is None else np.abs(np.abs(1 + Ts * poles) - 1) / Ts
    for s in poles[decay < 1e-6 * size]:
        multiplicity = (np.abs(poles - s) < 1e-4 * size).sum()
        singular = np.linalg.svd(A - s * np.eye(A.shape[0]), compute_uv=False)
        if (singular < 1e-9 * size).sum() < multiplicity:
            return True
    return False
