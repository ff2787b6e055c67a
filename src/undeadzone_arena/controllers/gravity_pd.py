"""PD law with gravity compensation: the simplest law that brings an arm to rest at its target."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, StepError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_positive


class GravityPD(Options, frozen=True, kw_only=True, tag="gravity_pd"):
    """u = K_p (q_ref - q^) + K_d (v_ref - v^) + g(q): Takegaki and Arimoto (1981).

    g is the torque that holds the arm against gravity. An elastic joint is fed back from its motor,
    and g is that of the link: Tomei (1991).

    References:
        P. Tomei (1991), doi:10.1109/9.90238
        M. Takegaki, S. Arimoto (1981), doi:10.1115/1.3139651

    Attributes:
        k_p: K_p, one or one per joint [N m/rad].
        k_d: K_d, one or one per joint [N m s/rad].
        at: take g at q_ref ("reference"), or at the estimate q^ ("estimate").
    """

    k_p: Array
    k_d: Array
    at: Literal["reference", "estimate"] = "reference"

    def build(self, model: System) -> Controller:
        """Build the controller for the model of an arm, continuous or sampled."""
        flat = model.flat
        if flat is None:
            raise InputError(
                "controller.method: 'gravity_pd' needs an arm (plant.arm). For another plant use "
                "'state_feedback' or 'lqr'"
            )
        m = model.m
        half = model.n // 2
        K = self._joint_gain(model)
        if model.Ts is not None:
            _require_no_alternation(model, K)
        at_rest = ca.SX.zeros(m, flat.order)

        def step(p: GravityPDParams, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            """Return the unchanged state and the torque u (m)."""
            x = target.x_ref if self.at == "reference" else estimate.x
            _, gravity = flat.solve(p.model, ca.horzcat(x[half - m : half], at_rest))
            return s, p.K @ (target.x_ref - estimate.x) + gravity

        return Controller(GravityPDParams(model.params, K), lambda p: None, step, K=K)

    def _joint_gain(self, model: System) -> Floats:
        """Return K (m x n) of x = `[motors; links; their speeds]`.

        Raises InputError, ShapeError.

        Motors and links are one in a rigid arm.
        """
        m = model.m
        half = model.n // 2
        K = np.zeros((m, model.n))
        k_p = require_positive("controller.k_p", self.k_p, m, "one per joint")
        k_d = require_positive("controller.k_d", self.k_d, m, "one per joint")
        K[:, :m] = np.diag(k_p)
        K[:, half : half + m] = np.diag(k_d)
        return K


class GravityPDParams(NamedTuple):
    """Parameters of the arm, and K (m x n)."""

    model: Any
    K: Floats


def _require_no_alternation(model: System, K: Floats) -> None:
    """Raise StepError if the sampled loop grows with alternating sign.

    No loop does that is sampled finely.
    """
    poles = np.linalg.eigvals(model.linear.A - model.linear.B @ K)
    if ((np.abs(poles) > 1) & (poles.real < 0)).any():
        raise StepError(
            f"simulation.step: {model.Ts:g} s is too coarse for controller.k_p, k_d: from sample "
            "to sample the arm swings ever more. Lower them"
        )
