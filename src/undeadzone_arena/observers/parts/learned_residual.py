"""Luenberger observer on z_I = y / m + W'psi that adapts to the offset of the sensor.

Adaptive deadzone inverse, inverse network and residual networks differ in the known functions psi,
in when they correct, and in how the weights W move.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, drop_limit_readings
from undeadzone.nonlinearities.limits import Limits
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.numerics.gaussian import linearise
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_positive
from undeadzone_arena.approximators import Basis
from undeadzone_arena.gain_defaults import injection_gain, rate_or_default, width_hiding_speed
from undeadzone_arena.observers.parts.adaptive_laws import AdaptiveLaw, gradient_law


class WeightedFunctions(NamedTuple):
    """Functions of one output whose weights adapt.

    Attributes:
        params: their numbers.
        psi: psi(params, y, side, z) is the N functions [z], with y / m and z in units of `scale`.
        size: their number N.
        gated: whether to correct and learn on an active side only.
        scale: unit of y / m and z (p) [z].
    """

    params: Any
    psi: Callable[[Any, Any, Any, Any], Any]
    size: int
    gated: bool
    scale: Floats


class LearnedParams(NamedTuple):
    """Numbers of the observer.

    Attributes:
        model: numbers of the model.
        L: gain of the innovation (n x p), per step when the model is sampled.
        slope: slope m of the sensor (p).
        psi: numbers of the functions.
        law: numbers of the learning law.
        scale: unit in which the functions see y / m and z (p) [z].
        W0: weights at first (N p).
        limit: upper bound of the weights (p), which are then >= 0 (None: there is none).
        rate: fastest rate of the law [1/s].
    """

    model: Any
    L: Floats
    slope: Floats
    psi: Any
    law: Any
    scale: Floats
    W0: Floats
    limit: Any
    rate: Any


class LearnedState(NamedTuple):
    """State of the observer.

    Attributes:
        x: estimate x^ (n).
        W: weights, those of the first output first (N p).
        sensitivity: d x^ / d W (n x N p) where filtered, else nothing.
        spread: the law's own state.
    """

    x: Any
    W: Any
    sensitivity: Any
    spread: Any


class LearnedSetup(NamedTuple):
    """Fixed parts of one observer.

    Attributes:
        model: the model.
        compensator: the functions.
        law: how the weights learn.
        filtered: whether W learns by the sensitivity of e to it.
        limited: whether the weights have bounds.
        ends: limits of the readings, which are missing there (None: there are none).
    """

    model: System
    compensator: WeightedFunctions
    law: AdaptiveLaw
    filtered: bool
    limited: bool
    ends: Limits | None


def build_learning_observer(
    model: System,
    sensor: Zone,
    L: Floats,
    compensator: WeightedFunctions,
    law: AdaptiveLaw,
    *,
    filtered: bool,
    W0: Floats | None = None,
    limit: Floats | None = None,
) -> Observer:
    """Build the observer x^' = A x^ + B u + L e, e = z_I - C x^, z_I = y / m + W'psi.

    Filtered, W learns by the sensitivity of e to it, zeta = C Phi - psi with Phi' = (A - L C) Phi +
    L psi', and x^ moves with W by Phi W' (Zhang 2002, the swapping lemma). Otherwise it learns by
    zeta = -psi, as if x^ stood still.

    Args:
        model: the model, continuous or sampled, linear or nonlinear.
        sensor: the dead zone.
        L: gain (n x p), per step when the model is sampled.
        compensator: the functions psi.
        law: how W moves.
        filtered: whether W learns by the sensitivity of e to it.
        W0: weights at first (N p) (None: 0).
        limit: upper bound of the weights (p), which needs `filtered` (None: there is none).

    Raises:
        InputError: for a jump sensor, which takes nothing off z.
    """
    if sensor.kind == "jump":
        raise InputError(
            "observer.method: a jump sensor takes nothing off z, this method has nothing to learn. "
            "Use 'certified' or 'censored'"
        )
    n = model.n
    weights = compensator.size * model.p
    setup = LearnedSetup(model, compensator, law, filtered, limit is not None, sensor.limits)
    params = LearnedParams(
        model=model.params,
        L=L,
        slope=sensor.slope,
        psi=compensator.params,
        law=law.numbers,
        scale=compensator.scale,
        W0=np.zeros(weights) if W0 is None else W0,
        limit=limit,
        rate=np.float64(law.rate),
    )
    sensitivity = np.zeros((n, weights if filtered else 0))

    def init(q: LearnedParams) -> LearnedState:
        """Return the state at t = 0."""
        return LearnedState(np.zeros(n), q.W0, sensitivity, law.spread0)

    traits = Traits(L=L, rate=float(law.rate), width_max=limit)
    step = partial(learning_step, setup)
    project = partial(project_weights, setup)
    return Observer(params, init, step, project, traits)


def learning_step(
    setup: LearnedSetup, q: LearnedParams, s: LearnedState, u: Any, reading: Reading
) -> tuple[LearnedState, Estimate]:
    """Return the state's derivative, or its next value when sampled, and the estimate."""
    model = setup.model
    reading = drop_limit_readings(reading, setup.ends)
    sampled = model.Ts is not None
    z, H = linearise(lambda x: model.output(q.model, x), s.x)
    seen = present(reading.y)
    y = ca.if_else(seen, reading.y / q.slope, 0.0)
    used = 1.0 * (reading.side != 0) if setup.compensator.gated else seen
    gate = ca.diag(used)
    psi = basis_functions(setup, q, y, reading.side, z)
    inverse = y + psi @ s.W
    e = used * (inverse - z)
    moved = model.move_with_correction(q.model, s.x, u, q.L @ e)
    zeta = -psi
    sensitivity = s.sensitivity
    if setup.filtered:
        _, F = linearise(lambda x: model.move(q.model, x, u), s.x)
        zeta = H @ s.sensitivity - psi
        sensitivity = F @ s.sensitivity - q.L @ (gate @ zeta)
    added, spread = setup.law.move(q.law, s.W, s.spread, gate @ zeta, e, used)
    if setup.filtered:
        moved += (sensitivity if sampled else s.sensitivity) @ added
    after = LearnedState(
        moved, model.keep * s.W + added, sensitivity, model.keep * s.spread + spread
    )
    if sampled:
        after = project_weights(setup, q, after)
    right = width_from_weights(setup, q, s.W, 1.0)
    left = width_from_weights(setup, q, s.W, -1.0)
    return after, Estimate(s.x, z, right, left, ca.if_else(seen, inverse, z), e)


def basis_functions(setup: LearnedSetup, q: LearnedParams, y: Any, side: Any, z: Any) -> Any:
    """Return psi of every output (p x N p) [1] at y / m and z [z]."""
    y = y / q.scale
    z = z / q.scale
    psi = setup.compensator.psi
    return ca.diagcat(*(psi(q.psi, y[i], side[i], z[i]).T for i in range(setup.model.p)))


def width_from_weights(setup: LearnedSetup, q: LearnedParams, W: Any, side: float) -> Any:
    """Return the width that W'psi represents (p) [z]: its offset at half the scale on a side."""
    at = side * q.scale / 2
    return side * (basis_functions(setup, q, at, side * ca.SX.ones(setup.model.p), at) @ W)


def project_weights(setup: LearnedSetup, q: LearnedParams, s: LearnedState) -> LearnedState:
    """Return the state with its weights clipped to [0, limit], and x^ moved with them."""
    if not setup.limited:
        return s
    upper = ca.kron(q.limit, ca.SX.ones(setup.compensator.size))
    W = ca.fmax(ca.fmin(s.W, upper), 0.0)
    return s._replace(W=W, x=s.x + s.sensitivity @ (W - s.W))


class LearnedOptions(Options, frozen=True, kw_only=True):
    """Options of all observers whose correction adapts by the normalised gradient.

    Attributes:
        L: gain (n x p) [1/s], in place of poles and speed.
        poles: poles of A - L C (n) [1/s], in place of L and speed.
        speed: speed of A - L C [1/s], in place of L and poles (default 6 mean poles of the plant
            (`inverse_network`: 30), fewer beyond second order).
        gain: gain of the normalised gradient [1/s] (default 30 times the fastest pole
            (`inverse_network`: 100 times)).
        leak: leak of the weights, e-modification (default 0, none).
        filtered: learn by the sensitivity of the error, so that fast poles do less harm (false: the
            law as published).
    """

    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    gain: float | None = None
    leak: float = 0.0
    filtered: bool = True


def build_gradient_observer(
    model: System,
    sensor: Zone,
    options: LearnedOptions,
    compensator: WeightedFunctions,
    poles: float,
    gain: float,
) -> Observer:
    """Build a learning observer with the normalised gradient law.

    Args:
        model: the model, continuous or sampled.
        sensor: the dead zone.
        options: the observer's.
        compensator: the functions psi.
        poles: default speed of A - L C, in mean poles of the plant (`mean_pole`).
        gain: default gain of the gradient, in fastest poles of the plant.

    Raises:
        InputError, ShapeError, StructureError: for options that cannot be.
    """
    L = injection_gain(
        model, options.L, options.poles, options.speed, width_hiding_speed(model, poles)
    )
    rate = rate_or_default(model, "observer.gain", options.gain, gain)
    law = gradient_law(model, rate, options.leak, compensator.size)
    return build_learning_observer(model, sensor, L, compensator, law, filtered=options.filtered)


def build_residual_observer(
    model: System, sensor: Zone, options: LearnedOptions, reach: Array, basis: Basis
) -> Observer:
    """Build a learning observer of W'phi(z^ / reach) with the normalised gradient law.

    Args:
        model: the model, continuous or sampled.
        sensor: the dead zone.
        options: the observer's.
        reach: |z| up to which the basis holds, one or one per output [z].
        basis: the functions phi.

    Raises:
        InputError, ShapeError, StructureError: for options that cannot be.
    """

    def psi(params: Any, y: Any, side: Any, z: Any) -> Any:
        """Return the basis functions at z^ (N) [1]."""
        return basis.phi(params, z)

    scale = require_positive("observer.reach", reach, model.p, "one per output")
    compensator = WeightedFunctions(basis.params, psi, basis.size, False, scale)
    return build_gradient_observer(model, sensor, options, compensator, poles=6.0, gain=30.0)
