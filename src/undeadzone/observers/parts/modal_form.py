"""Coordinates in which a linear system moves boxes into boxes that shrink as fast as its poles allow."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.support.arrays import Floats


class Modes(NamedTuple):
    """x = T Phi(angle) zeta: F in real Schur form, S = T^-1 F T, whose oscillating modes are seen turning with them.

    angle (one per complex pair) grows by `turn`, per second or per step; pairs: the first row of each.
    """

    T: Floats
    inverse: Floats
    S: Floats
    turn: Floats
    pairs: list[int]


def modes(F: Floats, unit: Floats, Ts: float | None) -> Modes:
    """The modes of x' = F x (x+ = F x when sampled); unit (n): of each state, so that units of states do not matter.

    Mazenc and Bernard (2011) turn the Jordan form; the Schur form bounds the same, and exists to rounding for every F.
    """
    from scipy.linalg import schur

    S, Q = schur(F * unit / unit[:, None], output="real")
    pairs = [i for i in range(len(S) - 1) if S[i + 1, i] != 0]
    scale = np.ones(len(S))
    for i in pairs:
        scale[i + 1] = np.sqrt(-S[i + 1, i] / S[i, i + 1])  # the block becomes [[a, w], [-w, a]]
    S = S * scale / scale[:, None]
    T = unit[:, None] * Q * scale
    w, a = np.array([S[i, i + 1] for i in pairs]), np.array([S[i, i] for i in pairs])
    return Modes(T, np.linalg.inv(T), S, w if Ts is None else np.arctan2(w, a), pairs)


def turned(pairs: list[int], n: int, angle: Any) -> Any:
    """Phi(angle) (n x n, orthogonal): [[cos, sin], [-sin, cos]] at each pair, 1 elsewhere."""
    found = ca.SX.eye(n)
    for k, i in enumerate(pairs):
        c, s = ca.cos(angle[k]), ca.sin(angle[k])
        found[i, i], found[i, i + 1], found[i + 1, i], found[i + 1, i + 1] = c, s, -s, c
    return found
