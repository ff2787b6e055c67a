"""Adaptation laws: what a push on an edge, -e on the right and +e on the left, does to its width (docs/adaptation.md).

Each law says what becomes of the certificate, V = x~'P x~ + |d~|^2 / gamma never rises while M < 0 (docs/certificate.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import NONE
from undeadzone.support.arrays import scalar


class Edge(NamedTuple):
    """One side of every output: push on its width, 1 where it is adapted, d^, d^(0), its gain (`Law.gains`), gamma."""

    push: Any
    adapted: Any
    width: Any
    width0: Any
    gain: Any
    gamma: Any


class Law(NamedTuple):
    """A law as pure functions; gains and rates are per step in sampled time.

    numbers: run-time numbers, None for the one law whose gains are constant; soften(numbers, y): factor in (0, 1] on the
    innovation; gains: whether each edge has a gain that moves, from gamma on; move(numbers, edge): (what is added to d^,
    the gain's derivative or next value); reset(numbers, gain, gamma): the gain in place of one that has become too small.
    """

    numbers: Any = None
    soften: Callable[[Any, Any], Any] = lambda numbers, y: 1.0
    gains: bool = False
    move: Callable[[Any, Edge], tuple[Any, Any]] = lambda numbers, edge: (
        edge.gamma * edge.push,
        NONE,
    )
    reset: Callable[[Any, Any, Any], Any] = lambda numbers, gain, gamma: gain


GRADIENT = Law()


class Gradient(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="gradient",
):
    """d^' = gamma push, (25) as repaired. Certified where M < 0."""

    def law(self, Ts: float | None) -> Law:
        """The law; Ts [s] is the sample time, None in continuous time."""
        return GRADIENT


class Normalised(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="normalised",
):
    """The innovation, in x^' and d^' alike, is divided by 1 + weight y^2 (y in units of z): large signals count less.

    Certified where the gradient law is, by the same V: a factor in (0, 1] on e is a sector that M < 0 covers.
    """

    weight: float = 1.0

    def law(self, Ts: float | None) -> Law:
        """The law. Raises InputError."""
        weight = scalar("observer.adaptation.weight", self.weight, least=0.0)
        return Law(np.float64(weight), lambda weight, y: 1 / (1 + weight * y**2))


class LeastSquares(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="least_squares",
):
    """Recursive least squares: d^' = g push, g' = forgetting g - g^2 where the edge is active, g(0) = gamma, g <= gamma.

    forgetting [1/s]: rate at which old readings fade; reset: the share of gamma below which g is set back to gamma.
    Loses the certificate for constant gains, but V = x~'P x~ + sum d~^2 / g never rises, whatever is forgotten or reset,
    if |G(jw)| < 1, G = C (sI - A)^-1 L; sampled, if |C (zI - Ad)^-1 Ld|^2 < 1 - gamma Ts. Not checked here.
    """

    forgetting: float = 0.0
    reset: float = 0.0

    def law(self, Ts: float | None) -> Law:
        """The law. Raises InputError."""
        forgetting = scalar("observer.adaptation.forgetting", self.forgetting, least=0.0)
        share = scalar("observer.adaptation.reset", self.reset, least=0.0)
        if share >= 1:
            raise InputError(f"observer.adaptation.reset: must be below 1, found {share:g}")

        def flow(numbers: Any, edge: Edge) -> tuple[Any, Any]:
            growth = numbers[0] * edge.gain - edge.adapted * edge.gain**2
            return edge.gain * edge.push, ca.if_else(
                edge.gain < edge.gamma, growth, ca.fmin(growth, 0.0)
            )

        def step(numbers: Any, edge: Edge) -> tuple[Any, Any]:
            after = ca.fmin(edge.gain / (numbers[0] + edge.adapted * edge.gain), edge.gamma)
            return after * edge.push, after

        def reset(numbers: Any, gain: Any, gamma: Any) -> Any:
            return ca.if_else(gain < numbers[1] * gamma, gamma, gain)

        fade = forgetting if Ts is None else np.exp(-forgetting * Ts)
        return Law(
            np.array([fade, share]), gains=True, move=flow if Ts is None else step, reset=reset
        )


class Sigma(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="sigma",
):
    """d^' = gamma (push - leak (d^ - d^(0))), Ioannou and Kokotovic (1983): bounded without projection, at a price.

    Loses exactness: V' <= ... - leak |d~|^2 + leak |d - d^(0)|^2. With an edge active for the share a of the time and
    x^ = x, d~ comes to rest near leak / (a + leak) of d - d^(0).
    """

    leak: float

    def law(self, Ts: float | None) -> Law:
        """The law. Raises InputError."""
        leak = scalar("observer.adaptation.leak", self.leak, least=0.0)
        return Law(
            np.float64(leak),
            move=lambda leak, edge: (
                edge.gamma * (edge.push - leak * (edge.width - edge.width0)),
                NONE,
            ),
        )


class EModification(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="e_modification",
):
    """d^' = gamma (push - leak |push| (d^ - d^(0))), Narendra and Annaswamy (1987): no leak where there is no error.

    With |d - d^(0)| <= D it keeps V where M + leak D diag(C'C, 3 I) < 0: then d^ is exact in the end. Not checked here.
    """

    leak: float

    def law(self, Ts: float | None) -> Law:
        """The law. Raises InputError."""
        leak = scalar("observer.adaptation.leak", self.leak, least=0.0)
        return Law(
            np.float64(leak),
            move=lambda leak, edge: (
                edge.gamma * (edge.push - leak * ca.fabs(edge.push) * (edge.width - edge.width0)),
                NONE,
            ),
        )


Adaptation = Gradient | Normalised | LeastSquares | Sigma | EModification
