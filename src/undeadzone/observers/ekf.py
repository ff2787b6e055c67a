"""Extended Kalman filter on [x; d_r; d_l]: the dead zone linearised where the estimate is (docs/methods/ekf.md)."""

from __future__ import annotations

from typing import Any, Literal

import casadi as ca

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.numerics.gaussian import Gaussian, linearise, predict, update
from undeadzone.observers.parts.augmented_state import (
    Declared,
    Defaults,
    Sight,
    claims,
    joint_filter,
)
from undeadzone.observers.parts.measured_kalman import Params
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, branch, zone

HABITS = Defaults(noise=0.01, drift=0.005, x_std=5.0)


class EKF(
    Declared, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="ekf"
):
    """Extended Kalman filter on [x; d_r; d_l] (Smith, Schmidt, McGee 1962; joint with parameters: Cox 1964); sampled time.

    right, left, noise, x_std, disturbance, drift: as for `Kalman`, but by default noise is at least 1 % of the range, drift 0.5 % of the
    largest width, and the disturbance what moves z by `swing` times the largest width in a quarter period of the plant (1 s if it only
    integrates). mode: the branch of the dead zone is the predicted one, where the estimate is (the Jacobian of the dead zone itself), or
    the measured one. pseudo: in measured mode, a silent sensor that the estimate contradicts is a reading on the violated edge.
    """

    mode: Literal["predicted", "measured"] = "predicted"
    pseudo: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: the slope of a jump sensor's reading says nothing of its widths, so that 'ekf' cannot find them; use 'censored'"
            )
        n, p = model.n, model.p

        def correct(
            q: Params, belief: Gaussian, i: int, sight: Sight, y: Any, side: Any, seen: Any
        ) -> tuple[Gaussian, Any, Any]:
            if self.mode == "predicted":
                expected, h = linearise(sight, belief.mean)
                use = seen
            else:
                X = belief.mean
                estimated = zone(model.output(q.model, X[:n])[i], X[n + i], X[n + p + i])
                taken = ca.if_else(side != 0, side, estimated if self.pseudo else 0.0)
                expected, h = linearise(
                    lambda X: branch(
                        model.output(q.model, X[:n])[i],
                        taken,
                        X[n + i],
                        X[n + p + i],
                        1.0,
                        sensor.kind,
                    ),
                    X,
                )
                use = ca.logic_and(seen, taken != 0)
            e = ca.if_else(use, y - expected, 0.0)
            belief, S = update(belief, h, e, q.R[i], use)
            return belief, e, S

        return joint_filter(model, sensor, claims(self, model, sensor, HABITS), correct, predict)
