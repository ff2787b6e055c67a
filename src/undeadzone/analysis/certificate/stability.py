"""Models that are not stable have no certificate; here is why, in words."""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.error_dynamics import Dynamics, growth
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import similar
from undeadzone.plants.time_scales import state_units
from undeadzone.support.arrays import Floats


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
    """Whether an eigenvalue on the stability boundary has too few eigenvectors.

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
