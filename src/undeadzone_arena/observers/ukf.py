"""Unscented Kalman filter on `[x; d_r; d_l]`: 2 N + 1 points pass through the dead zone.

More in docs/methods/nonlinear_filters.md.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.numerics.gaussian import Gaussian, RobustUpdate, update_with_gain
from undeadzone.observers.filtering.gaussian_filter import Params
from undeadzone.plants.system import System
from undeadzone.util.arrays import require_number
from undeadzone_arena import unscented
from undeadzone_arena.observers.parts.joint_claims import (
    JointAssumptions,
    JointDefaults,
    build_joint_prior,
)
from undeadzone_arena.observers.parts.joint_filter import OutputSample, build_joint_filter

# With less, points astride an edge soon pin the widths at wrong values.
DEFAULTS = JointDefaults(noise=0.15, drift=0.1, x_std=0.5)


class UKF(JointAssumptions, frozen=True, kw_only=True, tag="ukf"):
    """Unscented Kalman filter on `[x; d_r; d_l]`, Julier and Uhlmann (1997), sampled time.

    Weights of Wan and van der Merwe (2000). By default noise is at least 15 % of the range, drift
    10 % and x_std 50 % of the largest width.

    References:
        S. J. Julier, J. K. Uhlmann (1997), doi:10.1117/12.280797
        E. A. Wan, R. van der Merwe (2000), doi:10.1109/ASSPCC.2000.882463

    Attributes:
        alpha, kappa: of N = n + 2p variables, points lie alpha sqrt(N + kappa) standard deviations
            from the mean.
        beta: weight of the mean's own point in covariances (2: Gaussian).
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.5

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the filter for a sampled model."""
        weights = self._point_weights(model.n + 2 * model.p)

        def correct(q: Params, belief: Gaussian, sample: OutputSample) -> RobustUpdate:
            """Correct by the reading of one output."""
            R = q.R[sample.i]
            reach = q.doubt.reach[sample.i]
            expected, S, K = unscented.gain_by_points(belief, sample.sight, R, weights)
            e = ca.if_else(sample.seen, sample.y - expected, 0.0)
            return update_with_gain(belief, K, e, S, R, sample.seen, sample.odds, reach)

        def predict(belief: Gaussian, move: Any, Q: Any) -> Gaussian:
            """Predict the state estimate at the next sample."""
            return unscented.predict_by_points(belief, move, Q, weights)

        prior = build_joint_prior(self, model, sensor, DEFAULTS)
        return build_joint_filter(model, sensor, prior, self.glitches, correct, predict)

    def _point_weights(self, size: int) -> unscented.SigmaWeights:
        """Return the weights of the points of `size` variables. Raises InputError."""
        alpha = require_number("observer.alpha", self.alpha)
        beta = require_number("observer.beta", self.beta)
        kappa = require_number("observer.kappa", self.kappa)
        if not (0 < alpha <= 1 and size + kappa > 0):
            raise InputError(
                f"observer.alpha: expected 0 < alpha <= 1 and kappa > -{size}, "
                f"found alpha {alpha:g}, kappa {kappa:g}"
            )
        weights = unscented.sigma_weights(size, alpha, beta, kappa)
        if weights.cov < 0:
            raise InputError(
                f"observer.alpha: the mean's own point would weigh {weights.cov:.3g} in "
                "covariances, which need not stay positive then. Raise alpha or beta"
            )
        return weights
