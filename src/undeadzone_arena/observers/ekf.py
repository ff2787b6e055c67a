"""Extended Kalman filter on `[x; d_r; d_l]`: the dead zone is linearised at the estimate.

More in docs/methods/nonlinear_filters.md.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import casadi as ca

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer, clip_expected_reading
from undeadzone.nonlinearities.sensor import Zone, branch, zone
from undeadzone.numerics.gaussian import (
    Gaussian,
    RobustUpdate,
    linearise,
    predict,
    update_with_outliers,
)
from undeadzone.observers.filtering.augmented_state import power_of_two_units
from undeadzone.observers.filtering.gaussian_filter import Params
from undeadzone.plants.system import System, scale_states
from undeadzone_arena.observers.parts.joint_claims import (
    JointAssumptions,
    build_joint_prior,
)
from undeadzone_arena.observers.parts.joint_filter import OutputSample, Sight, build_joint_filter


class EKF(JointAssumptions, frozen=True, kw_only=True, tag="ekf"):
    """Extended Kalman filter on `[x; d_r; d_l]` (Smith, Schmidt, McGee 1962), sampled time.

    Joint with parameters: Cox (1964). By default noise is at least 1 % of the range, x_std five
    times and drift 0.5 % of the largest width.

    References:
        H. Cox (1964), doi:10.1109/TAC.1964.1105635

    Attributes:
        mode: the branch of the dead zone is the predicted one, at the estimate (the Jacobian of the
            dead zone itself), or the measured one.
        pseudo: in measured mode, a silent sensor that the estimate contradicts is a reading on the
            violated edge.
    """

    mode: Literal["predicted", "measured"] = "predicted"
    pseudo: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the filter for a sampled model."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: the slope of a jump sensor's reading contains no width, "
                "so that 'ekf' cannot find them. Use 'censored'"
            )
        prior = build_joint_prior(self, model, sensor)
        correct = correct_predicted
        if self.mode == "measured":
            counted = scale_states(model, power_of_two_units(model))
            correct = partial(correct_measured, counted, sensor, self.pseudo)
        return build_joint_filter(model, sensor, prior, self.glitches, correct, predict)


def correct_predicted(q: Params, belief: Gaussian, sample: OutputSample) -> RobustUpdate:
    """Correct on the branch of the estimate."""
    return correct_linearised(q, belief, sample, sample.sight, sample.seen)


def correct_measured(
    model: System,
    sensor: Zone,
    pseudo: bool,
    q: Params,
    belief: Gaussian,
    sample: OutputSample,
) -> RobustUpdate:
    """Correct on the measured branch.

    With `pseudo`, a silent sensor is read on the branch of the estimate.
    """
    n = model.n
    p = model.p
    i = sample.i
    X = belief.mean
    estimated = zone(model.output(q.model, X[:n])[i], X[n + i], X[n + p + i])
    used_side = ca.if_else(sample.side != 0, sample.side, estimated if pseudo else 0.0)

    def reading_on_branch(X: Any) -> Any:
        """Return the noise-free reading on the branch in use."""
        z = model.output(q.model, X[:n])[i]
        on_branch = branch(z, used_side, X[n + i], X[n + p + i], 1.0, sensor.kind)
        return (
            on_branch
            if sensor.limits is None
            else clip_expected_reading(on_branch, sample.y, sample.side)
        )

    return correct_linearised(
        q, belief, sample, reading_on_branch, ca.logic_and(sample.seen, used_side != 0)
    )


def correct_linearised(
    q: Params, belief: Gaussian, sample: OutputSample, sight: Sight, use: Any
) -> RobustUpdate:
    """Correct by a reading that is linearised at the estimate."""
    expected, h = linearise(sight, belief.mean)
    e = ca.if_else(use, sample.y - expected, 0.0)
    i = sample.i
    return update_with_outliers(belief, h, e, q.R[i], use, sample.odds, q.doubt.reach[i])
