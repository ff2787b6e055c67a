"""PID on the estimated output: two degrees of freedom, filtered derivative, anti-windup."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.controllers.parts import require_square, select_tracked_output
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.numerics.clip import clip
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_matrix,
    require_nonnegative,
    require_positive,
    require_vector,
)


class PID(Options, frozen=True, kw_only=True, tag="pid"):
    """PID law u = k_p (b r - z^) + k_i int (r - z^) + k_d d/dt (c r - z^).

    The derivative is filtered.

    z^ is the observer's estimate of the hidden output, so that the loop acts inside the dead zone
    too. Input i acts on output i. If `limits` cut u off, the integral follows the rest by
    back-calculation (Astrom and Hagglund, Advanced PID Control, 2006).

    Example:
        >>> uz.PID(k_p=2.0, k_i=0.5, k_d=0.1).k_i
        0.5

    See Also:
        LinearController, StateFeedback

    Attributes:
        k_p, k_i, k_d: gains, one or one per output [u/z, u/(z s), u s/z] (default of k_i and k_d
            0).
        filter_time: time constant of the filter of the derivative [s].
        reference_weights: [b, c], shares of r in the proportional and the derivative term.
        limits: [least u, largest u], or one such pair per input (default none).
        tracking_time: time constant of the anti-windup [s] (default sqrt(k_d / k_i), or k_p / k_i
            if k_d is 0).
        feedforward: whether u_ff, which makes the model follow r exactly, is added.
    """

    k_p: Array
    k_i: Array = 0.0
    k_d: Array = 0.0
    filter_time: Array = 0.01
    reference_weights: Array = (1.0, 0.0)
    limits: Array | None = None
    tracking_time: Array | None = None
    feedforward: bool = False

    def build(self, model: System) -> Controller:
        """Return the controller for a model with as many inputs as outputs.

        Raises InputError, ShapeError.
        """
        require_square("pid", model)
        params = self._pid_params(model)
        limited = self.limits is not None

        def init(p: Params) -> State:
            """Return the state at t = 0: zeros."""
            return State(np.zeros(model.p), np.zeros(model.p))

        def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
            """Return the state's derivative, or its next value if sampled, and u (m).

            With f the filtered c r - z^, I the integral term and T_t the tracking time:

                unsaturated = k_p (b r - z^) + I + k_d f',  f' = (c r - z^ - f) / tau
                I' = k_i (r - z^) + (u - unsaturated) / T_t,  u = unsaturated within its limits
            """
            z = select_tracked_output("pid", estimate, target)
            lag = p.c * target.r - z - s.filtered
            unsaturated = p.k_p * (p.b * target.r - z) + s.integral + p.k_d / p.tau * lag
            if self.feedforward:
                unsaturated = unsaturated + target.u_ff
            u = unsaturated
            if limited:
                u = clip(unsaturated, p.low, p.high)
            integral_change = p.k_i * (target.r - z) + p.unwind * (u - unsaturated)
            filtered = model.keep * s.filtered + p.rate * lag
            return State(filtered, model.keep * s.integral + integral_change), u

        fastest = float(1.0 / params.tau.min()) if params.k_d.any() else None
        return Controller(params, init, step, rate=fastest)

    def _pid_params(self, model: System) -> Params:
        """Return the parameters of the controller. Raises InputError, ShapeError."""
        each = "one per output"
        k_p = require_vector("controller.k_p", self.k_p, model.p, each)
        k_i = require_vector("controller.k_i", self.k_i, model.p, each)
        k_d = require_vector("controller.k_d", self.k_d, model.p, each)
        tau = require_positive("controller.filter_time", self.filter_time, model.p, each)
        b, c = require_nonnegative(
            "controller.reference_weights", self.reference_weights, 2, "b and c"
        )
        low, high = self._input_limits(model.m)
        tracking = self._tracking_time(k_p, k_i, k_d)
        unwind = model.per_step / tracking
        if model.Ts is not None:
            unwind = np.minimum(unwind, 1.0)
        unwind = np.where(k_i == 0, 0.0, unwind)
        weights = (np.float64(b), np.float64(c))
        rate = model.filtering(tau)
        return Params(k_p, k_i * model.per_step, k_d, tau, rate, *weights, low, high, unwind)

    def _input_limits(self, m: int) -> tuple[Floats, Floats]:
        """Return the least and the largest input (m each) [u].

        Raises InputError, ShapeError.
        """
        if self.limits is None:
            return np.zeros(m), np.zeros(m)
        pairs = np.atleast_2d(self.limits)
        if len(pairs) == 1:
            pairs = np.repeat(pairs, m, axis=0)
        pairs = require_matrix(
            "controller.limits", pairs, m, 2, "least and largest u of each input"
        )
        low, high = pairs.T
        if (low >= high).any():
            raise InputError(
                "controller.limits: expected [least, largest] with least < largest, found "
                f"{pairs.tolist()}"
            )
        return low, high

    def _tracking_time(self, k_p: Floats, k_i: Floats, k_d: Floats) -> Floats:
        """Return the time constants of the anti-windup (p) [s].

        The value is 1 for an output without integration.
        """
        if self.tracking_time is not None:
            return require_positive("controller.tracking_time", self.tracking_time, k_p.size)
        integral = np.where(k_i == 0, 1.0, np.abs(k_i))
        with_derivative = np.sqrt(np.abs(k_d) / integral)
        times = np.where(k_d != 0, with_derivative, np.abs(k_p) / integral)
        return np.where((k_i == 0) | (times == 0), 1.0, times)


class Params(NamedTuple):
    """Parameters of the controller.

    Attributes:
        k_p, k_i, k_d: gains (p) (k_i per step when sampled).
        tau: time constants of the filter (p) [s].
        rate: rates of the filter (p) [1/s], per step when sampled.
        b, c: weights of the reference.
        low, high: limits of u (m).
        unwind: rates of the anti-windup (p) [1/s], per step when sampled.
    """

    k_p: Floats
    k_i: Floats
    k_d: Floats
    tau: Floats
    rate: Floats
    b: Any
    c: Any
    low: Floats
    high: Floats
    unwind: Floats


class State(NamedTuple):
    """Filtered c r - z^ (p) and the integral term (p)."""

    filtered: Any
    integral: Any
