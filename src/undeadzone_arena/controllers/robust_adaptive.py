"""Robust adaptive control without an inverse, for an actuator with an unknown dead zone.

The zone is a slope and a bounded rest. The bound is learnt, and compensated while there is an
error.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_number, require_positive
from undeadzone_arena.approximators import clip_to_box
from undeadzone_arena.controllers.sliding_mode import (
    USUAL,
    poles_about,
    sliding_surface,
    surface_errors,
)
from undeadzone_arena.gain_defaults import rate_or_default

STEADY = 0.5  # k in layers per step, up to which s does not chatter


class RobustAdaptive(Options, frozen=True, kw_only=True, tag="robust_adaptive"):
    """Robust adaptive control of Wang, Su and Hong (2004), which needs no inverse.

    u = phi (u_ff - G (f(x^, u_ff) - f(x_ref, u_ff))) - rate s - k sat(s / layer), s = G (x^ -
    x_ref), G B = I. With s_e = s - layer sat(s / layer) the bound of the zone's rest grows by
    k' = learning |s_e|, and the inverse of its slope moves by phi' = -slope_learning u_ff s_e.
    Automatica 40 (2004). It needs as many independent columns of B as inputs.

    References:
        X.-S. Wang, C.-Y. Su, H. Hong (2004), doi:10.1016/j.automatica.2003.10.021

    Attributes:
        rate: rate at which s decays [1/s] (default ten times the fastest pole of the plant).
        poles: poles of the error on s = 0 (n - m of them) [1/s] (default about `rate`).
        layer: |s| inside which nothing is learnt, one or one per input [u s] (default 1 / rate).
        learning: rate at which k grows, one or one per input [1/s] (default rate^2 / 5).
        slope_learning: rate at which phi moves [1 / (u s)] (default 0: the slope is 1).
        most: largest k, one or one per input [u] (default none, but in sampled time k stays below
            half of layer / step, beyond which s would chatter).
    """

    rate: float | None = None
    poles: Array | None = None
    layer: Array | None = None
    learning: Array | None = None
    slope_learning: float = 0.0
    most: Array | None = None

    def build(self, model: System) -> Controller:
        """Build the controller for a model, continuous or sampled."""
        m = model.m
        Ts = model.Ts
        rate = rate_or_default(model, "controller.rate", self.rate, USUAL)
        poles = poles_about(model, rate, self.poles)
        layer = 1 / rate if self.layer is None else self.layer
        learning = rate**2 / 5 if self.learning is None else self.learning
        most = 1e50 if self.most is None else self.most
        per_step = model.per_step
        width = require_positive("controller.layer", layer, m, "one per input") / per_step
        bound = require_positive("controller.most", most, m, "one per input")
        params = RobustAdaptiveParams(
            model=model.params,
            G=sliding_surface(model, poles),
            keep=np.float64(-rate if Ts is None else np.exp(-rate * Ts)),
            layer=width,
            learning=require_positive("controller.learning", learning, m, "one per input")
            * per_step**2,
            slope=np.float64(
                require_number("controller.slope_learning", self.slope_learning, least=0.0)
                * per_step**2
            ),
            most=bound if Ts is None else np.minimum(bound, STEADY * width),
        )

        def init(p: RobustAdaptiveParams) -> RobustAdaptiveState:
            """Return the state at t = 0."""
            return RobustAdaptiveState(np.zeros(m), np.ones(m))

        def step(
            p: RobustAdaptiveParams, s: RobustAdaptiveState, estimate: Estimate, target: Target
        ) -> tuple[RobustAdaptiveState, Any]:
            """Return the state's derivative or, when sampled, its next value, and u."""
            apart, distance = surface_errors(model, p, estimate, target)
            pull = clip_to_box(distance / p.layer)
            outside = distance - p.layer * pull
            forced = target.u_ff - p.G @ apart
            u = s.slope * forced + p.keep * distance - s.bound * pull
            bound = model.keep * s.bound + p.learning * ca.fabs(outside)
            slope = model.keep * s.slope - p.slope * forced * outside
            return RobustAdaptiveState(ca.fmin(bound, p.most) if model.keep else bound, slope), u

        return Controller(params, init, step)


class RobustAdaptiveParams(NamedTuple):
    """Numbers of the controller.

    For a sampled model s counts per step, as G B = I uses the sampled B.

    Attributes:
        model: numbers of the model.
        G: from the error to s (m x n), G B = 1.
        keep: -rate, or the factor of s per step.
        layer: |s| inside which nothing is learnt (m).
        learning: rate of the bound (m).
        slope: rate of phi.
        most: largest bound (m) [u].
    """

    model: Any
    G: Floats
    keep: Any
    layer: Floats
    learning: Floats
    slope: Any
    most: Floats


class RobustAdaptiveState(NamedTuple):
    """Adapted bound k of the zone's residual (m) [u], and phi, the inverse of its slope (m)."""

    bound: Any
    slope: Any
