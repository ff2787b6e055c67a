"""Unscented Kalman filter on [x; d_r; d_l]: 2 N + 1 points sent through the dead zone (docs/methods/ukf.md)."""

from __future__ import annotations

from typing import Any

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.numerics import unscented
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.parts.augmented_state import (
    Declared,
    Defaults,
    Sight,
    claims,
    joint_filter,
)
from undeadzone.observers.parts.measured_kalman import Params
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import scalar

HABITS = Defaults(
    noise=0.15, drift=0.1, x_std=0.5
)  # with less, points astride an edge soon pin the widths where they are not


class UKF(
    Declared, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="ukf"
):
    """Unscented Kalman filter on [x; d_r; d_l], Julier, Uhlmann (1997) with the weights of Wan, van der Merwe (2000); sampled time.

    right, left, noise, x_std, disturbance, swing, drift: as for `EKF`, but by default noise is at least 15 % of the range, drift 10 %
    and x_std 50 % of the largest width. Of N = n + 2p variables, points lie alpha sqrt(N + kappa) standard deviations from the mean;
    beta weighs the mean's own point in covariances (2: Gaussian).
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.5

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        alpha, beta, kappa = (
            scalar(f"observer.{key}", getattr(self, key)) for key in ("alpha", "beta", "kappa")
        )
        size = model.n + 2 * model.p
        if not (0 < alpha <= 1 and size + kappa > 0):
            raise InputError(
                f"observer.alpha: expected 0 < alpha <= 1 and kappa > -{size}, found alpha {alpha:g}, kappa {kappa:g}"
            )
        weights = unscented.weights(size, alpha, beta, kappa)
        if weights.cov < 0:
            raise InputError(
                f"observer.alpha: the mean's own point would weigh {weights.cov:.3g} in covariances, which need not stay positive then; raise alpha or beta"
            )

        def correct(
            q: Params, belief: Gaussian, i: int, sight: Sight, y: Any, side: Any, seen: Any
        ) -> tuple[Gaussian, Any, Any]:
            return unscented.update(belief, sight, y, q.R[i], seen, weights)

        def predict(belief: Gaussian, move: Any, Q: Any) -> Gaussian:
            return unscented.predict(belief, move, Q, weights)

        return joint_filter(model, sensor, claims(self, model, sensor, HABITS), correct, predict)
