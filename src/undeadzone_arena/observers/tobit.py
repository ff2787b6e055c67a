"""Tobit Kalman filter on `[x; d_r; d_l]`: a reading is predicted by its mean over both branches.

More in docs/methods/nonlinear_filters.md.
"""

from __future__ import annotations

from functools import partial

import casadi as ca

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer, clip_expected_reading
from undeadzone.nonlinearities.sensor import LEFT, RIGHT, Zone
from undeadzone.numerics.gaussian import (
    Gaussian,
    RobustUpdate,
    linearise,
    normal_cdf,
    normal_density,
    predict,
    update_with_gain,
)
from undeadzone.observers.filtering.augmented_state import power_of_two_units
from undeadzone.observers.filtering.gaussian_filter import Params
from undeadzone.plants.system import System, scale_states
from undeadzone_arena.observers.parts.joint_claims import (
    JointAssumptions,
    build_joint_prior,
)
from undeadzone_arena.observers.parts.joint_filter import OutputSample, build_joint_filter


class Tobit(JointAssumptions, frozen=True, kw_only=True, tag="tobit"):
    """Tobit Kalman filter on `[x; d_r; d_l]` (Allik, Miller, Piovoso, Zurakowski 2016), sampled
    time.

    Here for the two edges of a dead zone that are not known, with the spread of the prediction in
    the chances of the branches. Defaults as those of `ekf`.
    """

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the filter for a sampled model."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: 'tobit' takes a reading for the excess over an edge, but a jump "
                "sensor reads z itself. Use 'censored'"
            )
        prior = build_joint_prior(self, model, sensor)
        counted = scale_states(model, power_of_two_units(model))
        correct = partial(correct_tobit, counted, sensor.limits is not None)
        return build_joint_filter(model, sensor, prior, self.glitches, correct, predict)


def correct_tobit(
    model: System, limited: bool, q: Params, belief: Gaussian, sample: OutputSample
) -> RobustUpdate:
    """Correct by the mean of the reading and by its slopes, averaged over the branches.

    On each branch the reading is max(s, 0) of a normal s, whose moments are known. A reading at a
    limit bounds it.
    """
    n = model.n
    p = model.p
    i = sample.i
    z, row = linearise(lambda X: model.output(q.model, X[:n])[i], belief.mean)
    expected = 0.0
    square = 0.0
    slope = ca.SX(1, n + 2 * p)
    for sign, place in ((RIGHT, n + i), (LEFT, n + p + i)):
        h = sign * row
        h[place] -= 1
        std = ca.sqrt(ca.fmax(h @ belief.cov @ h.T, 0.0) + q.R[i])
        beyond = (sign * z - belief.mean[place]) / std
        chance = normal_cdf(beyond)
        slim = normal_density(beyond)
        expected += sign * std * (chance * beyond + slim)
        square += std**2 * (chance * (1 + beyond**2) + beyond * slim)
        slope += sign * chance * h
    along = belief.cov @ slope.T
    S = ca.fmax(square - expected**2, slope @ along + q.R[i])
    foretold = clip_expected_reading(expected, sample.y, sample.side) if limited else expected
    use = ca.logic_and(sample.seen, foretold == expected)
    e = ca.if_else(use, sample.y - foretold, 0.0)
    return update_with_gain(belief, along / S, e, S, q.R[i], use, sample.odds, q.doubt.reach[i])
