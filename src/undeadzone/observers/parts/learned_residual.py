"""Observers that learn what the sensor takes off z: a Luenberger observer on z_I = y / m + W'psi, with psi known functions.

Adaptive deadzone inverse, inverse network and residual networks differ in psi, in when they correct, and in how W moves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits
from undeadzone.numerics.approximators import Basis
from undeadzone.numerics.gaussian import linearise
from undeadzone.observers.parts.adaptive_laws import Law, gradient
from undeadzone.observers.parts.gain import hiding, injection
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import in_poles
from undeadzone.sensor import Zone, present
from undeadzone.support.arrays import Array, Floats, positive


class Compensator(NamedTuple):
    """psi(params, y, side, z): the N functions of one output, with y / m and z in units of `scale` (p) [z].

    gated: correct and learn on an active side only.
    """

    params: Any
    psi: Callable[[Any, Any, Any, Any], Any]
    size: int
    gated: bool
    scale: Floats


class Params(NamedTuple):
    """Numbers of the observer; L is per step when the model is sampled. limit (p): of the weights, then >= 0, or nothing; rate: of the law [1/s]."""

    model: Any
    L: Floats
    slope: Floats
    psi: Any
    law: Any
    scale: Floats
    W0: Floats
    limit: Any
    rate: Any


class State(NamedTuple):
    """x^, the weights W (N p), d x^ / d W (n x N p) where filtered, the spread of the law."""

    x: Any
    W: Any
    sensitivity: Any
    spread: Any


def learning(
    model: System,
    sensor: Zone,
    L: Floats,
    compensator: Compensator,
    law: Law,
    *,
    filtered: bool,
    W0: Floats | None = None,
    limit: Floats | None = None,
) -> Observer:
    """The observer x^' = A x^ + B u + L e, e = z_I - C x^, z_I = y / m + W'psi, of any linear or nonlinear model.

    filtered: W learns by the sensitivity of e to it, zeta = C Phi - psi with Phi' = (A - L C) Phi + L psi', and x^ moves
    with W by Phi W' (Zhang 2002; the swapping lemma); else by zeta = -psi, as if x^ stood still. limit needs filtered.
    Raises InputError for a jump sensor, of which nothing is taken off.
    """
    if sensor.kind == "jump":
        raise InputError(
            "observer.method: a jump sensor takes nothing off z, this method has nothing to learn; use 'certified' or 'censored'"
        )
    n, p, size = model.n, model.p, compensator.size
    keep = 0.0 if model.Ts is None else 1.0
    start = np.zeros(size * p) if W0 is None else W0
    params = Params(
        model.params,
        L,
        sensor.slope,
        compensator.params,
        law.numbers,
        compensator.scale,
        start,
        limit,
        np.float64(law.rate),
    )

    def init(q: Params) -> State:
        return State(np.zeros(n), q.W0, np.zeros((n, size * p if filtered else 0)), law.spread0)

    def functions(q: Params, y: Any, side: Any, z: Any) -> Any:
        """psi of every output (p x N p)."""
        y, z = y / q.scale, z / q.scale
        return ca.diagcat(*(compensator.psi(q.psi, y[i], side[i], z[i]).T for i in range(p)))

    def project(q: Params, s: State) -> State:
        if limit is None:
            return s
        W = ca.fmax(ca.fmin(s.W, ca.kron(q.limit, ca.SX.ones(size))), 0.0)
        return s._replace(W=W, x=s.x + s.sensitivity @ (W - s.W))

    def step(q: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        z, H = linearise(lambda x: model.output(q.model, x), s.x)
        seen = present(reading.y)
        y = ca.if_else(seen, reading.y / q.slope, 0.0)
        told = 1.0 * (reading.side != 0) if compensator.gated else seen
        gate, psi = ca.diag(told), functions(q, y, reading.side, z)
        inverse = y + psi @ s.W
        e = told * (inverse - z)
        moved, sensitivity, drag = model.move(q.model, s.x, u) + q.L @ e, s.sensitivity, -psi
        if filtered:
            _, F = linearise(lambda x: model.move(q.model, x, u), s.x)
            drag = H @ s.sensitivity - psi
            sensitivity = F @ s.sensitivity - q.L @ (gate @ drag)
        added, spread = law.move(q.law, s.W, s.spread, gate @ drag, e, told)
        if filtered:
            moved += (s.sensitivity if model.Ts is None else sensitivity) @ added
        after = State(moved, keep * s.W + added, sensitivity, keep * s.spread + spread)
        if model.Ts is not None:
            after = project(q, after)
        right, left = (
            side
            * (functions(q, side * q.scale / 2, side * ca.SX.ones(p), side * q.scale / 2) @ s.W)
            for side in (1.0, -1.0)
        )
        return after, Estimate(s.x, z, right, left, ca.if_else(seen, inverse, z), e)

    traits = Traits(L=L, rate=float(law.rate), width_max=limit)
    return Observer(params, init, step, project, traits)


class Residual(Protocol):
    """The options that networks of the estimate share; reach: |z| up to which they hold (p) [z]."""

    @property
    def reach(self) -> Array: ...  # noqa: D102
    @property
    def L(self) -> Array | None: ...  # noqa: D102
    @property
    def poles(self) -> Array | None: ...  # noqa: D102
    @property
    def speed(self) -> float | None: ...  # noqa: D102
    @property
    def gain(self) -> float | None: ...  # noqa: D102
    @property
    def leak(self) -> float: ...  # noqa: D102
    @property
    def filtered(self) -> bool: ...  # noqa: D102


def residual(model: System, sensor: Zone, given: Residual, basis: Basis) -> Observer:
    """`learning` of W'phi(z^ / reach), a function of the estimate, by the normalised gradient. Raises InputError, ShapeError, StructureError."""
    L = injection(model, given.L, given.poles, given.speed, hiding(model, 6.0))
    gain = in_poles(model, "observer.gain", given.gain, 30.0)
    scale = positive("observer.reach", given.reach, model.p, "one per output")
    compensator = Compensator(
        basis.params, lambda params, y, side, z: basis.phi(params, z), basis.size, False, scale
    )
    return learning(
        model,
        sensor,
        L,
        compensator,
        gradient(model, gain, given.leak, basis.size),
        filtered=given.filtered,
    )
