"""What a plant's structure allows: modes that no output sees or no input moves, widths that no reading can tell."""

from __future__ import annotations

from typing import NamedTuple

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


class Identifiable(NamedTuple):
    """Verdicts for the widths of one output, and the reasons for each 'no' in words."""

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: tuple[str, ...]


def identifiable(linear: Matrices, right: list[bool], left: list[bool], jump: bool = False) -> list[Identifiable]:
    """What noise-free readings can tell of d_r, d_l per output, given which sides were visited (docs/theory.md, section 4).

    The unobservable directions of [x; d_r; d_l] are those that every visited side maps to y = 0 for all time.
    A continuous-time linear model with known input is assumed.
    """
    A, _, C = linear
    n, p = A.shape[0], C.shape[0]
    if jump:
        return [_verdict(right[i], left[i], right[i] and left[i], right[i] and left[i], _unvisited(right[i], left[i]), False) for i in range(p)]
    unit = 1 / sizes(A.T, C.T)
    A, C = A * unit / unit[:, None], C * unit
    A = A / max(float(np.linalg.norm(A, 2)), 1e-300)
    powers = [np.linalg.matrix_power(A, k) for k in range(n + 1)]
    rows = []
    for i in range(p):
        for visited, sign, column in ((right[i], -1.0, n + 2 * i), (left[i], 1.0, n + 2 * i + 1)):
            if visited:
                block = np.zeros((n + 1, n + 2 * p))
                block[:, :n] = [C[i] @ power for power in powers]
                block[0, column] = sign
                rows.append(block / np.linalg.norm(C[i]))
    if not rows:
        null = np.eye(n + 2 * p)
    else:
        _, singular, rotation = np.linalg.svd(np.vstack(rows))
        null = rotation[int((singular > TOLERANCE * singular[0]).sum()) :]

    def known(direction: Floats) -> bool:
        return bool(np.abs(null @ direction).max(initial=0.0) < 1e-7)

    found = []
    for i in range(p):
        r, l = np.zeros(n + 2 * p), np.zeros(n + 2 * p)
        r[n + 2 * i], l[n + 2 * i + 1] = 1.0, 1.0
        integrator = np.linalg.svd(A, compute_uv=False)[-1] < TOLERANCE
        found.append(_verdict(known(r), known(l), known(r + l), known(r - l), _unvisited(right[i], left[i]), integrator))
    return found


def _unvisited(right: bool, left: bool) -> list[str]:
    return [f"the {name} edge is never reached: the output stays inside it" for name, visited in (("right", right), ("left", left)) if not visited]


def _verdict(right: bool, left: bool, width: bool, centre: bool, reasons: list[str], integrator: bool) -> Identifiable:
    if integrator and not centre:
        known = "only the width d_r + d_l can be known" if width else "a side's width cannot be told from the state's constant part"
        reasons = [*reasons, f"the centre is not identifiable: A is singular (an integrator), {known}"]
    return Identifiable(right, left, width, centre, tuple(reasons))
