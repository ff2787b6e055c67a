"""State feedback on the estimate plus feedforward: the working form of (29)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.poles import state_gain
from undeadzone.linalg.riccati import (
    fast_feedback,
    lyapunov_of_loop,
    paper_feedback,
    require_weight,
)
from undeadzone.plants.system import System, mean_pole, plant_pace, state_units
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_array, require_matrix, require_number
from undeadzone.util.toml import OptionTable

CHOICES = ("K", "poles", "alpha", "speed")
SPEED = 5.0  # default speed of the closed loop, in mean poles of the plant


class Robust(OptionTable, frozen=True, kw_only=True):
    """Robust term of references [16], [17] of the paper.

    Its value is -gain * tanh(B'P (x^ - x_ref) / width).

    It acts against matched disturbances up to gain.

    Attributes:
        gain: largest size of the term [u].
        width: B'P (x^ - x_ref) at which it saturates.
    """

    gain: float
    width: float = 0.1


class StateFeedback(Options, frozen=True, kw_only=True, tag="state_feedback"):
    """Feedback u = u_ff - K (x^ - x_ref) with at most one of:

    K, poles, alpha and Q of (34), or speed.

    With alpha, K = alpha B'P with A'P + PA - 2 alpha P B B' P = -Q: (34) with A in place of A - L
    C. With a speed, poles p of A slower than half of it move to -speed - p (Anderson and Moore
    1971). Sampled models get the sampled counterpart of the same choice.

    Example:
        >>> uz.StateFeedback(poles=[-2.0, -3.0]).poles
        [-2.0, -3.0]

    See Also:
        LQR, PID

    Attributes:
        K: gains (m x n).
        poles: poles of A - B K (n) [1/s].
        alpha: of (34).
        speed: speed of A - B K [1/s] (default, if the others are absent, five mean poles of the
            plant).
        Q: of (34), a number, one per state, or a matrix.
        robust: an optional tanh term (default none).
        reject: if the observer estimates the effects that its model leaves out, x' = f(x, u) + w^,
            move x_ref and u_ff so that z would follow r if w^ stayed as it is (the first m outputs
            if there are more, Muske and Badgwell 2002).
    """

    K: Array | None = None
    poles: Array | None = None
    alpha: float | None = None
    speed: float | None = None
    Q: Array = 1.0
    robust: Robust | None = None
    reject: bool = True

    def build(self, model: System) -> Controller:
        """Return the controller for a model, continuous or sampled."""
        Q = self._read_weight(model)
        K = self._choose_gain(model, Q)
        params = self._state_feedback_params(model, K, Q)

        def step(p: Params, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            """Return the state unchanged, and u (m)."""
            u = (target.u_ff + p.K @ target.x_ref) - p.K @ estimate.x
            if self.reject and estimate.w.shape[0]:
                u = u + p.counter @ estimate.w
            if self.robust is not None:
                error = estimate.x - target.x_ref
                u = u - p.rho * ca.tanh(p.BtP @ error / p.width)
            return s, u

        return Controller(params, lambda p: None, step, K=K)

    def _read_weight(self, model: System) -> Floats:
        """Return Q (n x n) after checking that at most one design option is set.

        Raises InputError, ShapeError.
        """
        chosen = [name for name in CHOICES if getattr(self, name) is not None]
        if len(chosen) > 1:
            raise InputError(
                "controller: state_feedback takes exactly one of K, poles, alpha, speed, "
                f"found {' and '.join(chosen)}"
            )
        return require_weight("controller.Q", self.Q, model.n)

    def _choose_gain(self, model: System, Q: Floats) -> Floats:
        """Return K (m x n) of the chosen design option, or of the default speed.

        Raises:
            InputError, ShapeError: for numbers that cannot be.
            StructureError: if a speed cannot be reached.
        """
        if self.K is not None:
            K = np.atleast_2d(require_array("controller.K", self.K))
            return require_matrix("controller.K", K, model.m, model.n, "inputs x states")
        if self.poles is not None:
            return state_gain(model.linear, self.poles, model.Ts)
        if self.alpha is None:
            default = SPEED * mean_pole(model)
            speed = default if self.speed is None else self.speed
            speed = require_number("controller.speed", speed, above=0.0)
            return fast_feedback(model.linear, speed, model.Ts)
        alpha = require_number("controller.alpha", self.alpha, above=0.0)
        return paper_feedback(model.linear, alpha, Q, model.Ts)

    def _state_feedback_params(self, model: System, K: Floats, Q: Floats) -> Params:
        """Return the parameters of the controller. Raises InputError, StructureError."""
        counter = np.hstack([K, np.eye(model.m)]) @ rest_response(model)
        if self.robust is None:
            none = np.zeros((model.m, model.n))
            return Params(K, none, np.float64(0.0), np.float64(1.0), counter)
        P = lyapunov_of_loop(model.linear, K, Q, model.Ts)
        rho = require_number("controller.robust.gain", self.robust.gain, least=0.0)
        width = require_number("controller.robust.width", self.robust.width, above=0.0)
        return Params(K, model.linear.B.T @ P, np.float64(rho), np.float64(width), counter)


def rest_response(model: System) -> Floats:
    """Return `[x; u]` at rest per unit of a constant w ((n + m) x n).

    At rest A x + B u + w = 0, and the first m outputs C x are 0. Each equation and unknown is
    divided by its scale, so that units do not decide which singular values count as 0.

    Args:
        model: the model.
    """
    flow = model.continuous
    A, B, C = flow
    x_scale = state_units(flow)
    rate = plant_pace(flow)
    C = C[: model.m]
    w_scale = (rate * x_scale)[:, None]
    # An input of its scale moves the most affected state by the state's scale in a time 1 / rate.
    input_effect = np.abs(B / w_scale).max(axis=0)
    u_scale = 1 / np.where(input_effect > 0, input_effect, 1.0)
    equations = np.block(
        [[A * x_scale / w_scale, B * u_scale / w_scale], [C * x_scale, np.zeros((len(C), model.m))]]
    )
    scaled_response = np.linalg.pinv(equations, rcond=1e-10)[:, : model.n]
    return np.asarray(-np.concatenate([x_scale, u_scale])[:, None] * scaled_response / w_scale.T)


class Params(NamedTuple):
    """Parameters of the controller.

    Attributes:
        K: gains (m x n).
        BtP: B'P of the robust term (m x n).
        rho, width: size and width of the robust term.
        counter: input u that cancels a unit of w^ (m x n).
    """

    K: Floats
    BtP: Floats
    rho: Any
    width: Any
    counter: Floats
