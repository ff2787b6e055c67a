"""Adaptation laws of the widths: their rate as a function of the drive (docs/adaptation.md).

The drive is -e on the right and +e on the left. Each law states its effect on the certificate: V =
x~'P x~ + |d~|^2 / gamma never rises while M < 0 (docs/certificate.md). Initial widths and their
bound are as every adaptive observer takes them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import NONE
from undeadzone.registry import Options
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_array,
    require_matrix,
    require_number,
    require_positive,
)


def to_width_pairs(key: str, value: Array, p: int) -> Floats:
    """Return [right, left] per output (p x 2) from a number, a pair, or a pair per output.

    Raises ShapeError that names the key.
    """
    numbers = require_array(key, value)
    if numbers.ndim < 2 and numbers.size in (1, 2):
        return np.broadcast_to(numbers, (p, 2)).astype(float)
    return require_matrix(key, numbers, p, 2, "one [right, left] per output")


def read_initial_widths(widths0: Array, width_max: Array | None, p: int) -> tuple[Floats, Floats]:
    """Return the initial widths (p x 2) and their upper bound (p) [z].

    Args:
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M, one or one per output [z] (None: there is none).
        p: number of outputs.

    Returns:
        (d^(0) (p x 2), d_M (p), inf if there is none).

    Raises:
        InputError, ShapeError: unless 0 <= d^(0) <= d_M and d_M > 0.
    """
    limit = np.full(p, np.inf)
    if width_max is not None:
        limit = require_positive("observer.width_max", width_max, p, "one per output")
    widths = to_width_pairs("observer.widths0", widths0, p)
    if (widths < 0).any() or (widths > limit[:, None]).any():
        raise InputError(
            f"observer.widths0: must lie in [0, width_max], found {widths.tolist()} "
            f"with width_max {limit.tolist()}"
        )
    return widths, limit


class BranchWidths(NamedTuple):
    """Widths of a branch of every output, with their drive and gains.

    Attributes:
        drive: what its width is driven by (p).
        adapted: 1 if the width is adapted (p).
        width: d^ (p).
        width0: d^(0) (p).
        gain: its gain if the law moves it (`AdaptationLaw.gains`).
        gamma: adaptation gain (p).
    """

    drive: Any
    adapted: Any
    width: Any
    width0: Any
    gain: Any
    gamma: Any


def gradient_move(numbers: Any, edge: BranchWidths) -> tuple[Any, Any]:
    """Return the change of the widths by the gradient law (p): gamma times the drive. No gain."""
    return edge.gamma * edge.drive, NONE


class AdaptationLaw(NamedTuple):
    """Adaptation law as pure functions. Gains and rates are per step in sampled time.

    Attributes:
        numbers: run-time numbers (None for the one law whose gains are constant).
        soften: soften(numbers, y) is the factor in (0, 1] on the innovation (default 1).
        gains: whether each edge has a gain that moves, from gamma on.
        move: move(numbers, edge) is (the increment of d^, the gain's derivative or next value).
        reset: reset(numbers, gain, gamma) is the gain in place of one that has become too small
            (default: the gain stays).
    """

    numbers: Any = None
    soften: Callable[[Any, Any], Any] = lambda numbers, y: 1.0
    gains: bool = False
    move: Callable[[Any, BranchWidths], tuple[Any, Any]] = gradient_move
    reset: Callable[[Any, Any, Any], Any] = lambda numbers, gain, gamma: gain


GRADIENT = AdaptationLaw()


class Gradient(Options, frozen=True, kw_only=True, tag="gradient"):
    """Gradient law d^' = gamma drive, (25) as repaired. Certified if M < 0."""

    def build_law(self, Ts: float | None) -> AdaptationLaw:
        """Return the adaptation law.

        Args:
            Ts: sample time [s] (None in continuous time).
        """
        return GRADIENT


class Normalised(Options, frozen=True, kw_only=True, tag="normalised"):
    """Gradient law with the innovation divided by 1 + weight y^2 in x^' and d^'.

    Large signals count less.

    Certified if the gradient law is, by the same V: a factor in (0, 1] on e is a sector that M < 0
    covers.

    Attributes:
        weight: weight of y^2, y in units of z [1/z^2].
    """

    weight: float = 1.0

    def build_law(self, Ts: float | None) -> AdaptationLaw:
        """Return the adaptation law.

        Args:
            Ts: sample time [s] (None in continuous time).

        Raises:
            InputError: for a weight below 0.
        """
        weight = require_number("observer.adaptation.weight", self.weight, least=0.0)
        return AdaptationLaw(np.float64(weight), lambda weight, y: 1 / (1 + weight * y**2))


class LeastSquares(Options, frozen=True, kw_only=True, tag="least_squares"):
    """Recursive least squares: d^' = g drive, g(0) = gamma, g <= gamma.

    g' = forgetting g - g^2 while the edge is active. Loses the certificate for constant gains, but
    V = x~'P x~ + sum d~^2 / g never rises, with any forgetting or reset, if |G(jw)| < 1, G = C (sI
    - A)^-1 L, sampled, if |C (zI - Ad)^-1 Ld|^2 < 1 - gamma Ts. Not checked here.

    Attributes:
        forgetting: rate at which old readings fade [1/s] (default 0: they do not fade).
        reset: share of gamma below which g is set back to gamma, below 1 (default 0: never).
    """

    forgetting: float = 0.0
    reset: float = 0.0

    def build_law(self, Ts: float | None) -> AdaptationLaw:
        """Return the adaptation law.

        Args:
            Ts: sample time [s] (None in continuous time).

        Raises:
            InputError: for a rate below 0, or a share outside [0, 1).
        """
        forgetting = require_number("observer.adaptation.forgetting", self.forgetting, least=0.0)
        share = require_number("observer.adaptation.reset", self.reset, least=0.0)
        if share >= 1:
            raise InputError(f"observer.adaptation.reset: must be below 1, found {share:g}")
        fade = forgetting if Ts is None else np.exp(-forgetting * Ts)
        move = least_squares_flow if Ts is None else least_squares_step
        return AdaptationLaw(np.array([fade, share]), gains=True, move=move, reset=reset_small_gain)


def least_squares_flow(numbers: Any, edge: BranchWidths) -> tuple[Any, Any]:
    """Return (d^', g') in continuous time.

    Here numbers: the rate of forgetting and the share of `reset`.
    """
    growth = numbers[0] * edge.gain - edge.adapted * edge.gain**2
    below = edge.gain < edge.gamma
    return edge.gain * edge.drive, ca.if_else(below, growth, ca.fmin(growth, 0.0))


def least_squares_step(numbers: Any, edge: BranchWidths) -> tuple[Any, Any]:
    """Return (the change of d^ in a step, the next g).

    Here numbers: the share of old readings that a step keeps, and the share of `reset`.
    """
    after = ca.fmin(edge.gain / (numbers[0] + edge.adapted * edge.gain), edge.gamma)
    return after * edge.drive, after


def reset_small_gain(numbers: Any, gain: Any, gamma: Any) -> Any:
    """Return gamma in place of a gain below its share of gamma (p) [1/s]."""
    return ca.if_else(gain < numbers[1] * gamma, gamma, gain)


class Sigma(Options, frozen=True, kw_only=True, tag="sigma"):
    """Sigma modification d^' = gamma (drive - leak (d^ - d^(0))).

    Ioannou and Kokotovic (1983).

    The widths are bounded without projection, at a price: exactness is lost,
    V' <= ... - leak |d~|^2 + leak |d - d^(0)|^2. With an edge active for the share a of the time
    and x^ = x, d~ comes to rest near leak / (a + leak) of d - d^(0).

    References:
        P. A. Ioannou, P. V. Kokotovic (1983), doi:10.1007/BFb0006357

    Attributes:
        leak: leak of the widths, relative to the drive.
    """

    leak: float

    def build_law(self, Ts: float | None) -> AdaptationLaw:
        """Return the adaptation law.

        Args:
            Ts: sample time [s] (None in continuous time).

        Raises:
            InputError: for a leak below 0.
        """
        return _build_leaking_law(self.leak, sigma_move)


def sigma_move(leak: Any, edge: BranchWidths) -> tuple[Any, Any]:
    """Return the change of the widths by gamma times the drive less a constant leak (p)."""
    return edge.gamma * (edge.drive - leak * (edge.width - edge.width0)), NONE


class EModification(Options, frozen=True, kw_only=True, tag="e_modification"):
    """e-modification d^' = gamma (drive - leak |drive| (d^ - d^(0))).

    Narendra and Annaswamy (1987).

    Without an error there is no leak. With |d - d^(0)| <= D it keeps V if M + leak D diag(C'C, 3 I)
    < 0: then d^ is exact in the end. Not checked here.

    References:
        K. S. Narendra, A. M. Annaswamy (1987), doi:10.1109/TAC.1987.1104543

    Attributes:
        leak: leak of the widths per unit of the drive [1/z].
    """

    leak: float

    def build_law(self, Ts: float | None) -> AdaptationLaw:
        """Return the adaptation law.

        Args:
            Ts: sample time [s] (None in continuous time).

        Raises:
            InputError: for a leak below 0.
        """
        return _build_leaking_law(self.leak, e_modification_move)


def e_modification_move(leak: Any, edge: BranchWidths) -> tuple[Any, Any]:
    """Return the change of the widths by gamma times the drive less a leak (p).

    The leak is proportional to the error.
    """
    leakage = leak * ca.fabs(edge.drive) * (edge.width - edge.width0)
    return edge.gamma * (edge.drive - leakage), NONE


Adaptation = Gradient | Normalised | LeastSquares | Sigma | EModification


def _build_leaking_law(
    leak: float, move: Callable[[Any, BranchWidths], tuple[Any, Any]]
) -> AdaptationLaw:
    """Return an adaptation law with a leak. Raises InputError for a leak below 0."""
    value = require_number("observer.adaptation.leak", leak, least=0.0)
    return AdaptationLaw(np.float64(value), move=move)
