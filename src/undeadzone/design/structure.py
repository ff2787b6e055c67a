"""What a plant's structure allows: modes that no output sees or no input moves."""

from __future__ import annotations

import numpy as np

from undeadzone.arrays import LARGEST, Floats, listed
from undeadzone.errors import StructureError
from undeadzone.plant import Matrices
from undeadzone.scaling import sizes

TOLERANCE = 1e-9


def unobservable_modes(A: Floats, C: Floats) -> list[complex]:
    """Eigenvalues of A that C does not see (Hautus test on singular values, in units that make the states alike)."""
    C = _rows(C)
    unit = 1 / sizes(A.T, C.T)
    A = A * unit / unit[:, None]
    scale = max(float(np.linalg.norm(A, 2)), 1e-300)
    C = _rows(C * unit) * scale
    n = A.shape[0]
    return [complex(s) for s in np.linalg.eigvals(A) if np.linalg.svd(np.vstack([A - s * np.eye(n), C]), compute_uv=False)[-1] < TOLERANCE * scale]


def _rows(C: Floats) -> Floats:
    """C with rows of length 1, or 0 where they are next to nothing."""
    lengths = np.linalg.norm(C, axis=1, keepdims=True)
    return C / np.where(lengths > 1 / LARGEST, lengths, np.inf)


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
            raise StructureError(f"{key}: the pair {pair} is {what}: mode{'s' * (len(modes) > 1)} {listed(modes)}; {fix}")
