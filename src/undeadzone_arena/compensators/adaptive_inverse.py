"""Adaptive inverse of an actuator's dead zone, Tao and Kokotovic (1994).

References:
    G. Tao, P. V. Kokotovic (1994), doi:10.1109/9.273339
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compensators.parts.coasting import (
    Coasts,
    apply_coasting,
    invert_actuator,
    start_coasting,
)
from undeadzone.errors import InputError, StructureError
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.linalg.matrices import spectral_radius
from undeadzone.nonlinearities.actuator import Actuator as Plain
from undeadzone.nonlinearities.actuator import Belief, Drive, resolve_actuator
from undeadzone.nonlinearities.sensor import present
from undeadzone.plants.system import System
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_nonnegative,
    require_number,
    require_positive,
)

GAIN = 30.0  # of the normalised gradient [1/s] where none is given


class AdaptiveZoneInverse(
    Coasts, frozen=True, kw_only=True, tag_field="method", tag="adaptive_inverse"
):
    """Exact inverse with its own widths, which adapt by the normalised gradient.

    The plant's input is linear in the widths b on the side of u, so that z = C (xi + Phi b) with
    xi' = A xi + B m u and Phi' = A Phi - B m chi. b moves against the error of the observer's
    deadzone inverse (y of a clean sensor). Tao and Kokotovic, Adaptive control of plants with
    unknown dead-zones, IEEE Trans. Automatic Control 39 (1994). It needs a stable, linear plant, in
    sampled time.

    References:
        G. Tao, P. V. Kokotovic (1994), doi:10.1109/9.273339

    Attributes:
        gain: of the normalised gradient [1/s].
        widths0: b_r and b_l at first, one or one per input [u].
        width_max: largest width, one or one per input [u] (default none).
    """

    gain: float = GAIN
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Build the compensator for a model."""
        if model.Ts is None:
            raise InputError(
                "compensator.method: 'adaptive_inverse' needs samples. Set simulation.time = "
                '"sampled"'
            )
        stable = spectral_radius(model.linear.A) < 1
        if model.nonlinear or not stable:
            raise StructureError(
                "compensator.method: 'adaptive_inverse' needs a linear, stable plant. Use "
                "'smooth_inverse' with widths that the observer estimates"
            )
        m = model.m
        n = model.n
        numbers, first = start_coasting(self, model)
        start = require_nonnegative("compensator.widths0", self.widths0, m, "one per input")
        most = np.full(m, np.inf)
        if self.width_max is not None:
            most = require_positive("compensator.width_max", self.width_max, m, "one per input")
        gain = require_number("compensator.gain", self.gain, above=0.0) * model.Ts
        drive = resolve_actuator(Plain(), m) if belief is None else belief.drive
        params = ZoneInverseParams(
            A=model.linear.A,
            B=model.linear.B,
            C=model.linear.C,
            drive=drive,
            gain=np.float64(gain),
            most=np.minimum(np.tile(most, 2), 1e50),
            coasts=numbers,
        )

        def init(q: ZoneInverseParams) -> ZoneInverseState:
            """Return the state at t = 0."""
            return ZoneInverseState(np.zeros(n), np.zeros((n, 2 * m)), np.tile(start, 2), first)

        return Compensator(params, init, partial(adaptive_inverse_step, m))


class ZoneInverseParams(NamedTuple):
    """Numbers of the compensator.

    Attributes:
        A, B, C: of the sampled model.
        drive: the believed actuator, for its slopes.
        gain: of the gradient, per step.
        most: largest widths, right ones, then left ones (2m) [u].
        coasts: numbers of coasting.
    """

    A: Floats
    B: Floats
    C: Floats
    drive: Drive
    gain: Any
    most: Floats
    coasts: Any


class ZoneInverseState(NamedTuple):
    """State: xi (n), Phi (n x 2m), the widths (2m), and the state of coasting."""

    xi: Any
    Phi: Any
    widths: Any
    coasts: Any


def adaptive_inverse_step(
    m: int, q: ZoneInverseParams, s: ZoneInverseState, v: Any, estimate: Estimate, reading: Reading
) -> tuple[ZoneInverseState, Any]:
    """Update the widths by the reading.

    Return the next state and the actuator's input (m) [u].
    """
    zeta = q.C @ s.Phi
    error = estimate.z_inverse - q.C @ (s.xi + s.Phi @ s.widths)
    error = ca.if_else(present(reading.y), error, 0.0)
    change = q.gain * zeta.T @ error / (1 + q.gain * ca.sumsqr(zeta))
    widths = ca.fmax(ca.fmin(s.widths + change, q.most), 0.0)
    drive = q.drive
    u = invert_actuator(drive, v, widths[:m], widths[m:])
    coasts, u = apply_coasting(q.coasts, s.coasts, u, estimate, reading)
    slope = ca.if_else(u > 0, drive.slope_right, drive.slope_left)
    right = slope * (u > 0)
    left = slope * (u < 0)
    xi = q.A @ s.xi + q.B @ (slope * u)
    Phi = q.A @ s.Phi + q.B @ ca.horzcat(-ca.diag(right), ca.diag(left))
    return ZoneInverseState(xi, Phi, widths, coasts), u
