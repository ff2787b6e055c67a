"""What a plant's structure allows: modes that no output sees or no input moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.errors import StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import sizes
from undeadzone.support.arrays import LARGEST, Floats, listed

TOLERANCE = 1e-9


def unobservable_modes(A: Floats, C: Floats) -> list[complex]:
    """Eigenvalues of A that C does not see (Hautus test on singular values, in units that make the states alike)."""
    C = _rows(C)
    unit = 1 / sizes(A.T, C.T)
    A = A * unit / unit[:, None]
    scale = max(float(np.linalg.norm(A, 2)), 1e-300)
    C = _rows(C * unit) * scale
    n = A.shape[0]
    return [
        complex(s)
        for s in np.linalg.eigvals(A)
        if np.linalg.svd(np.vstack([A - s * np.eye(n), C]), compute_uv=False)[-1]
        < TOLERANCE * scale
    ]


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
        (
            unobservable_modes(linear.A, linear.C),
            "(A, C)",
            "unobservable",
            "measure another output",
        ),
        (
            uncontrollable_modes(linear.A, linear.B),
            "(A, B)",
            "uncontrollable",
            "add an input or remove the state",
        ),
    ):
        if modes:
            raise StructureError(
                f"{key}: the pair {pair} is {what}: mode{'s' * (len(modes) > 1)} {listed(modes)}; {fix}"
            )


class Chains(NamedTuple):
    """O (n x n), regular: rows C_i A^k, k < r_i; rows: for each output i the rows of O that are z_i, z_i', ..."""

    O: Floats
    rows: list[list[int]]


def output_chains(A: Floats, C: Floats) -> Chains:
    """The outputs and as many of their derivatives under x' = A x as tell the whole state, the lowest first.

    Raises StructureError where they do not.
    """
    n, p = A.shape[0], C.shape[0]
    unit = 1 / sizes(A.T, C.T)
    scaled = A * unit / unit[:, None]
    rate = max(float(np.linalg.norm(scaled, 2)), 1e-300)
    kept: list[Floats] = []
    basis = np.zeros((0, n))
    rows: list[list[int]] = [[] for _ in range(p)]
    last = list(
        zip(C, _rows(C * unit), strict=True)
    )  # each output's latest derivative, in the plant's units and in even ones
    for k in range(n):
        for i, (plain, even) in enumerate(last):
            fresh = even - basis.T @ (basis @ even)
            if (
                len(rows[i]) == k
                and np.linalg.norm(fresh) > TOLERANCE * max(1.0, float(np.linalg.norm(even)))
                and len(kept) < n
            ):
                rows[i].append(len(kept))
                kept.append(plain)
                basis = np.vstack([basis, fresh / np.linalg.norm(fresh)])
        last = [(plain @ A, even @ scaled / rate) for plain, even in last]
    if len(kept) < n or not all(rows):
        raise StructureError(
            f"plant: the outputs and their derivatives tell {len(kept)} of {n} states, or one of {p} outputs tells nothing new"
        )
    return Chains(np.array(kept), rows)
