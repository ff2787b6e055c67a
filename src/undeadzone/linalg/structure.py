"""Structure of a plant: unobservable and uncontrollable modes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.errors import StructureError
from undeadzone.linalg.matrices import Matrices, scale_states, state_response_sizes
from undeadzone.util.arrays import LARGEST, Floats, list_numbers

TOLERANCE = 1e-9


class OutputChains(NamedTuple):
    """Outputs and derivatives that determine the whole state.

    Attributes:
        O: regular (n x n), of the rows C_i A^k, k < r_i.
        rows: for each output i the rows of O that are z_i, z_i', ...
    """

    O: Floats
    rows: list[list[int]]


def unobservable_modes(A: Floats, C: Floats) -> list[complex]:
    """Return the eigenvalues of A that C does not observe.

    Hautus's test on singular values, in units that make the states alike.

    Args:
        A: (n x n).
        C: (p x n).
    """
    A, even, scale = _even_states(A, _unit_rows(C))
    C = even * scale
    modes = []
    for s in np.linalg.eigvals(A):
        hautus = np.vstack([A - s * np.eye(A.shape[0]), C])
        if np.linalg.svd(hautus, compute_uv=False)[-1] < TOLERANCE * scale:
            modes.append(complex(s))
    return modes


def _even_states(A: Floats, C: Floats) -> tuple[Floats, Floats, float]:
    """Return A and C in units that make the states alike, C with unit rows, and the norm of A."""
    unit = 1 / state_response_sizes(A.T, C.T)
    A = scale_states(A, unit)
    return A, _unit_rows(C * unit), max(float(np.linalg.norm(A, 2)), 1e-300)


def uncontrollable_modes(A: Floats, B: Floats) -> list[complex]:
    """Return the eigenvalues of A that B does not move: `unobservable_modes` of the dual pair."""
    return unobservable_modes(A.T, B.T)


def require_structure(linear: Matrices, key: str) -> None:
    """Raise StructureError if no output shows, or no input moves, a mode of a plant.

    Args:
        linear: the plant.
        key: named in errors.

    Raises:
        StructureError: (A, C) is unobservable or (A, B) uncontrollable, of a plant
            with an input. It names the mode.
    """
    modes = unobservable_modes(linear.A, linear.C)
    if modes:
        raise StructureError(
            f"{key}: the pair (A, C) is unobservable: {_modes_text(modes)}. Measure another output"
        )
    modes = uncontrollable_modes(linear.A, linear.B) if linear.B.size else []
    if modes:
        raise StructureError(
            f"{key}: the pair (A, B) is uncontrollable: {_modes_text(modes)}. "
            "Add an input or remove the state"
        )


def output_chains(A: Floats, C: Floats) -> OutputChains:
    """Return the outputs and the derivatives under x' = A x that determine the whole state.

    The lowest derivatives come first.

    Args:
        A: (n x n).
        C: (p x n).

    Raises:
        StructureError: they do not determine the whole state.
    """
    n = A.shape[0]
    p = C.shape[0]
    scaled, rows_of_outputs, rate = _even_states(A, C)
    independent: list[Floats] = []
    basis = np.zeros((0, n))
    rows: list[list[int]] = [[] for _ in range(p)]
    # Each output's latest derivative, in the plant's units and in even ones.
    latest = list(zip(C, rows_of_outputs, strict=True))
    for k in range(n):
        for i, (plain, even) in enumerate(latest):
            fresh = even - basis.T @ (basis @ even)
            is_new = np.linalg.norm(fresh) > TOLERANCE * max(1.0, float(np.linalg.norm(even)))
            if is_new and len(rows[i]) == k and len(independent) < n:
                rows[i].append(len(independent))
                independent.append(plain)
                basis = np.vstack([basis, fresh / np.linalg.norm(fresh)])
        latest = [(plain @ A, even @ scaled / rate) for plain, even in latest]
    if len(independent) < n or not all(rows):
        raise StructureError(
            f"plant: the outputs and their derivatives determine {len(independent)} of {n} states, "
            f"or one of {p} outputs is redundant"
        )
    return OutputChains(np.array(independent), rows)


def _unit_rows(C: Floats) -> Floats:
    """Return C with rows of length 1, or 0 for rows of negligible length."""
    lengths = np.linalg.norm(C, axis=1, keepdims=True)
    return C / np.where(lengths > 1 / LARGEST, lengths, np.inf)


def _modes_text(modes: list[complex]) -> str:
    """Format a mode or several as text."""
    return f"mode{'s' * (len(modes) > 1)} {list_numbers(modes)}"
