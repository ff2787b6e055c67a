"""Modal coordinates, in which boxes move into boxes that shrink as fast as the poles."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.linalg.matrices import scale_states
from undeadzone.util.arrays import Floats


class Modes(NamedTuple):
    """Modal form x = T Phi(angle) zeta: F in real Schur form, with rotating oscillating modes.

    Attributes:
        T, inverse: the coordinates and their inverse (n x n).
        S: T^-1 F T (n x n).
        turn: growth of the angle of each complex pair, per second or per step.
        pairs: the first row of each complex pair.
    """

    T: Floats
    inverse: Floats
    S: Floats
    turn: Floats
    pairs: list[int]


def build_modes(F: Floats, unit: Floats, Ts: float | None) -> Modes:
    """Return the modes of x' = F x, or x+ = F x when sampled.

    Mazenc and Bernard (2011) turn the Jordan form. The Schur form bounds the same, and exists to
    rounding for every F.

    References:
        F. Mazenc, O. Bernard (2011), doi:10.1016/j.automatica.2010.10.019

    Args:
        F: motion (n x n).
        unit: unit of each state (n), so that units of states do not matter.
        Ts: sample time [s] (None in continuous time).
    """
    from scipy.linalg import schur

    S, Q = schur(scale_states(F, unit), output="real")
    pairs = [i for i in range(len(S) - 1) if S[i + 1, i] != 0]
    scale = np.ones(len(S))
    for i in pairs:
        scale[i + 1] = np.sqrt(-S[i + 1, i] / S[i, i + 1])  # the block becomes [[a, w], [-w, a]]
    S = scale_states(S, scale)
    T = unit[:, None] * Q * scale
    w = np.array([S[i, i + 1] for i in pairs])
    a = np.array([S[i, i] for i in pairs])
    turn = w if Ts is None else np.arctan2(w, a)
    return Modes(T, np.linalg.inv(T), S, turn, pairs)


def mode_rotation(pairs: list[int], n: int, angle: Any) -> Any:
    """Return Phi(angle) (n x n): [[cos, sin], [-sin, cos]] at each pair, 1 elsewhere."""
    Phi = ca.SX.eye(n)
    for k, i in enumerate(pairs):
        c = ca.cos(angle[k])
        s = ca.sin(angle[k])
        Phi[i, i] = c
        Phi[i, i + 1] = s
        Phi[i + 1, i] = -s
        Phi[i + 1, i + 1] = c
    return Phi
