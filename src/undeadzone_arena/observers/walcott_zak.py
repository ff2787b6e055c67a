"""Sliding-mode observer of Walcott and Zak with a boundary layer and adaptive widths.

References:
    B. L. Walcott, S. H. Zak (1987), doi:10.1109/TAC.1987.1104530
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import StepError, StructureError
from undeadzone.interfaces import Observer
from undeadzone.linalg.matrices import Matrices, scale_states, spectral_radius, state_response_sizes
from undeadzone.linalg.riccati import lyapunov_of_loop, require_weight
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.adaptive.output_error import (
    build_output_error_observer,
    read_adapted_widths,
)
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import (
    Array,
    Floats,
    list_numbers,
    require_nonnegative,
    require_positive,
)
from undeadzone_arena.approximators import clip_to_box
from undeadzone_arena.gain_defaults import injection_gain


class WalcottZak(Options, frozen=True, kw_only=True, tag="walcott_zak"):
    """x^' = A x^ + B u + L e + G rho sat(e / boundary), C G = I: Walcott and Zak (1987).

    Also Edwards and Spurgeon (1998). G is P^-1 C' made so that C G = I, with
    (A - L C)'P + P (A - L C) = -Q.

    References:
        B. L. Walcott, S. H. Zak (1987), doi:10.1109/TAC.1987.1104530

    Attributes:
        L: gain (n x p) [1/s], in place of poles and speed.
        poles: poles of A - L C (n) [1/s], in place of L and speed.
        speed: speed of A - L C [1/s], in place of L and poles (default ten times the fastest pole
            of the plant).
        rho: largest injection into e', one or one per output [z/s] (default 5 times the fastest
            pole, fit for z of order 1).
        boundary: the layer in which the injection is linear, one or one per output [z] (fit for z
            of order 1).
        Q: weight of the Lyapunov equation, a number, one per state, or a matrix (default 1 in units
            that make the states alike).
        gamma: adaptation gain of the widths, one or one per output [1/s] (0 with widths0 = 0 is the
            classical observer, which takes the reading for the output).
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M per side, one or one per output [z]. The widths stay within [0, width_max]
            (default none).
    """

    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    rho: Array | None = None
    boundary: Array = 0.1
    Q: Array | None = None
    gamma: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        L = injection_gain(model, self.L, self.poles, self.speed, 10.0)
        rho, boundary = self._rho_and_boundary(model)
        law = SlidingLaw(sliding_direction(model, L, self.Q), rho, boundary)
        if model.Ts is not None:
            _require_stable_layer(model, L, law)
        widths = read_adapted_widths(self.gamma, self.widths0, self.width_max, model, sensor)
        return build_output_error_observer(model, sensor, L, widths, law, sliding_term)

    def _rho_and_boundary(self, model: System) -> tuple[Floats, Floats]:
        """Return rho, per step when sampled, and boundary (p each).

        Raises InputError, ShapeError.
        """
        p = model.p
        default = 5 * fastest_pole(model)
        chosen = default if self.rho is None else self.rho
        rho = require_nonnegative("observer.rho", chosen, p, "one per output")
        boundary = require_positive("observer.boundary", self.boundary, p, "one per output")
        if model.Ts is not None:
            rho = rho * model.Ts
        return rho, boundary


class SlidingLaw(NamedTuple):
    """Numbers of the sliding mode.

    Attributes:
        G: direction (n x p).
        rho: largest injection (p), per step when sampled.
        boundary: the layer in which it is linear (p) [z].
    """

    G: Floats
    rho: Floats
    boundary: Floats


def sliding_term(law: SlidingLaw, e: Any) -> Any:
    """Return the sliding term G rho sat(e / boundary), added to x^' beside L e (n)."""
    return law.G @ (law.rho * clip_to_box(e / law.boundary))


def _require_stable_layer(model: System, L: Floats, law: SlidingLaw) -> None:
    """Raise StepError if the sampled observer is not stable inside the boundary layer."""
    gain = L + law.G * (law.rho / law.boundary)
    fastest = spectral_radius(model.linear.A - gain @ model.linear.C)
    if fastest >= 1:
        raise StepError(
            f"simulation.step: {model.Ts:g} s is too coarse for rho / boundary inside the boundary "
            f"layer (spectral radius {fastest:.4g}). "
            "Use a wider observer.boundary, a smaller rho or a shorter step"
        )


def sliding_direction(model: System, L: Floats, Q: Array | None) -> Floats:
    """Return G (n x p), C G = I, along P^-1 C'.

    The error that keeps C x~ = 0 then decays, as C (sI - A + L C)^-1 G is positive real.

    Args:
        model: the model, continuous or sampled.
        L: gain (n x p), per step when the model is sampled.
        Q: weight of the Lyapunov equation (None: 1 in units that make the states alike).

    Raises:
        InputError, ShapeError: for another weight.
        StructureError: unless A - L C is stable, or where rounding spoils the sliding mode.
    """
    n = model.n
    Ts = model.Ts
    closed = model.linear.A - L @ model.linear.C
    _require_stable_matrix(closed, Ts, "A - L C")
    rate = closed if Ts is None else (closed - np.eye(n)) / Ts
    unit = 1 / state_response_sizes(rate.T, model.linear.C.T)  # of each state
    A = scale_states(model.linear.A, unit)
    L = L / unit[:, None]
    C = model.linear.C * unit
    weights = np.eye(n) if Q is None else require_weight("observer.Q", Q, n) * np.outer(unit, unit)
    P = lyapunov_of_loop(Matrices(A, L, C), C, weights, Ts)
    along = np.linalg.solve(P, C.T)
    G = np.linalg.solve((C @ along).T, along.T).T
    hidden = np.linalg.svd(C)[2][model.p :].T  # where C x~ = 0
    mode = hidden.T @ (np.eye(n) - G @ C) @ (A - L @ C) @ hidden
    _require_stable_matrix(mode, Ts, "the sliding mode")
    return unit[:, None] * G


def _require_stable_matrix(A: Floats, Ts: float | None, what: str) -> None:
    """Raise StructureError unless x' = A x, or x+ = A x when sampled, is stable."""
    if not A.size:
        return
    poles = np.linalg.eigvals(A)
    unstable = poles.real.max() >= 0 if Ts is None else np.abs(poles).max() >= 1
    if unstable:
        raise StructureError(
            f"observer.L: {what} is not stable, its poles are {list_numbers(poles)}. "
            "Choose another L, "
            "or slower poles"
        )
