"""Backstepping with a barrier: the output keeps its distance from the reference below a bound."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, StepError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Floats, require_number
from undeadzone_arena.controllers.learned_feedback import derivative_rows
from undeadzone_arena.gain_defaults import rate_or_default

FINE = 0.2  # largest product of rate and sample time
LEAST = 0.01  # of bound^2 - e^2 over bound^2, beyond which the barrier rises no further


class Barrier(Options, frozen=True, kw_only=True, tag="barrier"):
    """Barrier Lyapunov function of Tee, Ge and Tay (2009), by backstepping on the estimate.

    V = log(bound^2 / (bound^2 - e^2)) / 2 + ..., e = z^ - r, is infinite at |e| = bound: with the
    true state z stays within `bound` of r, and so within any limits that r keeps by `bound`.

    Attributes:
        bound: largest |z - r| [z].
        rate: rate at which each error decays [1/s] (default ten times the fastest pole of the
            plant).
    """

    bound: float
    rate: float | None = None

    def build(self, model: System) -> Controller:
        """Build the controller for a linear model with a single input and a single output.

        Raises InputError, StepError, StructureError.
        """
        if model.nonlinear or (model.m, model.p) != (1, 1):
            raise InputError(
                "controller.method: 'barrier' is for a linear model of one input and one output, "
                f"found {model.m} and {model.p}{', nonlinear' * model.nonlinear}"
            )
        rows = derivative_rows(model.continuous)
        r = len(rows) - 1
        rate = rate_or_default(model, "controller.rate", self.rate, 10.0)
        if model.Ts is not None and rate * model.Ts > FINE:
            raise StepError(
                f"simulation.step: {model.Ts:g} s is too coarse for controller.rate {rate:g} 1/s. "
                f"Use at most {FINE / rate:.3g} s"
            )
        params = BarrierParams(
            rows=rows[:r],
            top=rows[r],
            b=np.float64((rows[r - 1] @ model.continuous.B).item()),
            bound=np.float64(require_number("controller.bound", self.bound, above=0.0)),
            rate=np.float64(rate),
        )

        def step(p: BarrierParams, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            """Return the unchanged state, and u (1)."""
            highest = p.top.T @ target.x_ref + p.b * target.u_ff
            derivative = barrier_backstepping(
                p, p.rows @ estimate.x, ca.vertcat(p.rows @ target.x_ref, highest)
            )
            return s, (derivative - p.top.T @ estimate.x) / p.b

        return Controller(params, lambda p: None, step, rate=r * rate)


class BarrierParams(NamedTuple):
    """Numbers of the controller.

    Attributes:
        rows: from x to z and its derivatives below the relative degree (r x n).
        top: from x to the part of the r-th derivative that u does not make (n).
        b: input gain.
        bound: largest |z - r| [z].
        rate: of each error [1/s].
    """

    rows: Floats
    top: Floats
    b: Any
    bound: Any
    rate: Any


def barrier_backstepping(p: BarrierParams, z: Any, reference: Any) -> Any:
    """Return the r-th derivative of z with which V falls.

    Args:
        p: numbers of the controller.
        z: output and its derivatives below the relative degree (r).
        reference: the same of the reference, and the derivative above (r + 1).
    """
    r = z.shape[0]
    at = ca.SX.sym("z", r)
    below = ca.SX.sym("ref", r + 1)
    moved = ca.vertcat(at[1:], 0.0)  # the rest does not depend on a derivative that contains u
    reference_moved = ca.vertcat(below[1:], 0.0)
    error = at[0] - below[0]
    pull = ca.SX(0.0)
    alpha = below[1]  # the virtual control of a step, the r-th derivative at last
    for i in range(r):
        alpha = alpha - p.rate * error - pull
        if i + 1 == r:
            break
        room = p.bound**2 - error**2
        pull = error / ca.fmax(room, LEAST * p.bound**2) if i == 0 else error
        error = at[i + 1] - alpha
        alpha = ca.jtimes(alpha, at, moved) + ca.jtimes(alpha, below, reference_moved)
    return ca.substitute(alpha, ca.vertcat(at, below), ca.vertcat(z, reference))
