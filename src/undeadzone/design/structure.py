"""What a plant's structure allows: modes that no output sees or no input moves."""

from __future__ import annotations

import numpy as np

from undeadzone.arrays import Floats
from undeadzone.errors import StructureError
from undeadzone.plant import Matrices
from undeadzone.scaling import sizes

TOLERANCE = 1e-9


def unobservable_modes(A: Floats, C: Floats) -> list[complex]:
    """Eigenvalues of A that C does not see (Hautus test on singular values, in units that make the states alike)."""
    unit = 1 / sizes(A.T, C.T)
    A, C = A * unit / unit[:, None], C * unit
    scale = max(float(np.linalg.norm(A, 2)), 1e-300)
    C = C / np.maximum(np.linalg.norm(C, axis=1, keepdims=True), 1e-300) * scale
    n = A.shape[0]
    return [complex(s) for s in np.linalg.eigvals(A) if np.linalg.svd(np.vstack([A - s * np.eye(n), C]), compute_uv=False)[-1] < TOLERANCE * scale]


def uncontrollable_modes(A: Floats, B: Floats) -> list[complex]:
    """Eigenvalues of A that B does not move: `unobservable_modes` of the dual pair."""
    return unobservable_modes(A.T, B.T)


def require_structure(linear: Matrices, key: str) -> None:
    """Raise StructureError if the pair (A, C) is unobservable or (A, B) uncontrollable, naming the mode."""
    for modes, pair, what, fix in (
        (unobservable_modes(linear.A, linear.C), "(A, C)", "unobservable", "measure another output"),
        (uncontrollable_modes(linear.A, linear.B), "(A, B)", "uncontrollable", "add an input or remove the state"),
    ):
        if modes:
            listed = ", ".join(f"{s.real:.4g}{s.imag:+.4g}j" if s.imag else f"{s.real:.4g}" for s in modes)
            raise StructureError(f"{key}: the pair {pair} is {what}: mode{'s' * (len(modes) > 1)} {listed}; {fix}")
