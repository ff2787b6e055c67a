"""The sliding-mode observer of Walcott and Zak, with a boundary layer; its widths may adapt."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError, StepError, StructureError
from undeadzone.interfaces import Observer
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.riccati import lyapunov, weight
from undeadzone.linear.scaling import sizes
from undeadzone.observers.parts.gain import injection
from undeadzone.observers.parts.output_error import adapted, output_error
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, Floats, listed, nonnegative, vector


class WalcottZak(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="walcott_zak",
):
    """x^' = A x^ + B u + L e + G rho sat(e / boundary), C G = I: Walcott and Zak (1987), Edwards and Spurgeon (1998).

    L, poles [1/s] or speed [1/s] of A - L C (default: a speed of ten times the fastest pole of the plant). rho [z/s]:
    what the injection adds to e' at most; boundary [z]: the layer in which it is linear; one or one per output (default: 5
    times the fastest pole, and 0.1, fit for z of order 1). G is P^-1 C' made so that C G = I, with (A - L C)'P + P (A - L C) = -Q
    (default: Q = 1 in units that make the states alike). gamma [1/s]: adapts the widths from widths0 (p x 2) [z] within [0, width_max];
    0 with widths0 = 0 is the classical observer, which takes the reading for the output.
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
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StepError, StructureError."""
        p = model.p
        L = injection(model, self.L, self.poles, self.speed, 10.0)
        rho = nonnegative(
            "observer.rho",
            5 * fastest_pole(model) if self.rho is None else self.rho,
            p,
            "one per output",
        )
        boundary = vector("observer.boundary", self.boundary, p, "one per output")
        if (boundary <= 0).any():
            raise InputError(f"observer.boundary: must be positive, found {boundary.min():g}")
        if model.Ts is not None:
            rho = rho * model.Ts
        G = direction(model, L, self.Q)
        if model.Ts is not None:
            fastest = np.abs(
                np.linalg.eigvals(model.linear.A - (L + G * (rho / boundary)) @ model.linear.C)
            ).max()
            if fastest >= 1:
                raise StepError(
                    f"simulation.step: {model.Ts:g} s is too coarse for rho / boundary inside the boundary layer (spectral radius {fastest:.4g}); "
                    "use a wider observer.boundary, a smaller rho or a shorter step"
                )

        def inject(law: Law, e: Any) -> Any:
            return law.G @ (law.rho * ca.fmax(ca.fmin(e / law.boundary, 1.0), -1.0))

        return output_error(
            model,
            sensor,
            L,
            adapted(self.gamma, self.widths0, self.width_max, model, sensor),
            Law(G, rho, boundary),
            inject,
        )


class Law(NamedTuple):
    """G (n x p); rho (p), per step when sampled; boundary (p)."""

    G: Floats
    rho: Floats
    boundary: Floats


def direction(model: System, L: Floats, Q: Array | None) -> Floats:
    """G (n x p), C G = I, along P^-1 C': the error that keeps C x~ = 0 then decays, as C (sI - A + L C)^-1 G is positive real.

    Raises InputError, ShapeError; StructureError unless A - L C is stable, or where rounding spoils the sliding mode.
    """
    n, Ts = model.n, model.Ts
    flow = model.linear.A - L @ model.linear.C
    _require_stable(flow, Ts, "A - L C")
    unit = 1 / sizes(
        (flow if Ts is None else (flow - np.eye(n)) / Ts).T, model.linear.C.T
    )  # of each state
    A, L, C = model.linear.A * unit / unit[:, None], L / unit[:, None], model.linear.C * unit
    P = lyapunov(
        Matrices(A, L, C),
        C,
        np.eye(n) if Q is None else weight("observer.Q", Q, n) * np.outer(unit, unit),
        Ts,
    )
    along = np.linalg.solve(P, C.T)
    G = np.linalg.solve((C @ along).T, along.T).T
    hidden = np.linalg.svd(C)[2][model.p :].T  # where C x~ = 0
    _require_stable(hidden.T @ (np.eye(n) - G @ C) @ (A - L @ C) @ hidden, Ts, "the sliding mode")
    return unit[:, None] * G


def _require_stable(A: Floats, Ts: float | None, what: str) -> None:
    poles = np.linalg.eigvals(A)
    if A.size and ((poles.real.max() >= 0) if Ts is None else (np.abs(poles).max() >= 1)):
        raise StructureError(
            f"observer.L: {what} is not stable, its poles are {listed(poles)}; choose another L, or slower poles"
        )
