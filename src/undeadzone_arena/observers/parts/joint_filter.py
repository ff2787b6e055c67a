"""Gaussian filters with the dead zone as one function of `[x; d_r; d_l]`, reading by reading."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.interfaces import Observer, Reading, clip_expected_reading
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.numerics.gaussian import Gaussian, RobustUpdate, from_upper_entries, stack_updates
from undeadzone.observers.filtering.augmented_state import (
    power_of_two_units,
    rescale_states,
    scale_prior,
)
from undeadzone.observers.filtering.consistency import Member, Step, add_consistency_tests
from undeadzone.observers.filtering.gaussian_filter import (
    Params,
    build_filter_params,
    build_transition,
    clip_to_ranges,
    covariance_entries,
    to_estimate,
    white_disturbance,
)
from undeadzone.observers.filtering.prior import doubt_numbers, outlier_probability
from undeadzone.observers.filtering.recovery import (
    RejectionRate,
    inflate_covariance,
    reset_if_invalid,
    start_rejection_rate,
)
from undeadzone.plants.system import System, scale_states
from undeadzone_arena.observers.parts.joint_claims import JointPrior, zone_reading

Sight = Callable[[Any], Any]
"""From [x; d_r; d_l] to the reading y_i / m_i without noise."""


class OutputSample(NamedTuple):
    """Reading of one output, in the form that a correction needs.

    Attributes:
        i: the output's number.
        sight: from the unknowns to the reading.
        y: the reading y_i / m_i, 0 if none came.
        side: of the reading.
        seen: whether one came.
        odds: of a glitch (None: no reading is a glitch).
    """

    i: int
    sight: Sight
    y: Any
    side: Any
    seen: Any
    odds: Any


Correct = Callable[[Params, Gaussian, OutputSample], RobustUpdate]
"""(q, belief, reading of an output) -> what is known."""

Predict = Callable[[Gaussian, Callable[[Any], Any], Any], Gaussian]
"""(belief, motion, covariance that it adds) -> belief at the next sample."""


class JointState(NamedTuple):
    """State of a joint filter between samples.

    Attributes:
        mean, cov: mean and covariance (see `to_upper_entries`) of `[x; d_r; d_l]` before the
            reading.
        patience: with readings that are refused.
    """

    mean: Any
    cov: Any
    patience: RejectionRate


def build_joint_filter(
    model: System,
    sensor: Zone,
    prior: JointPrior,
    glitches: float,
    correct: Correct,
    predict: Predict,
) -> Observer:
    """Build the filter as an observer.

    Args:
        model: the sampled model.
        sensor: the dead zone.
        prior: prior at its start.
        glitches: probability that a reading is wrong (0: none is).
        correct: the correction by the reading of one output after the other.
        predict: the motion to the next sample.

    Raises:
        InputError: for an invalid share of glitches.
    """
    share = outlier_probability(glitches)
    units = power_of_two_units(model)
    model = scale_states(model, units)
    prior = prior._replace(prior=scale_prior(prior.prior, units))
    augmentation = white_disturbance(model, prior.variance)
    doubt = doubt_numbers(model, sensor, prior.prior, share, is_assumed=False)
    params = build_filter_params(model, sensor, prior.prior, augmentation)._replace(doubt=doubt)
    entries = covariance_entries(model, augmentation)

    def step(q: Params, s: JointState, u: Any, reading: Reading) -> Step:
        """Return the next state and the estimate, with the data of the consistency tests."""
        seen = present(reading.y)
        y = ca.if_else(seen, reading.y, 0.0) / q.slope
        odds = q.doubt.glitch if share > 0 else None
        belief = Gaussian(s.mean, from_upper_entries(s.cov, entries))
        each = []
        for i in range(model.p):
            sight = partial(noise_free_reading, model, sensor.kind, q, i)
            if sensor.limits is not None:
                sight = partial(reading_at_limit, sight, y[i], reading.side[i])
            sample = OutputSample(i, sight, y[i], reading.side[i], seen[i], odds)
            each.append(correct(q, belief, sample))
            belief = each[-1].belief
        known = stack_updates(each)
        clipped, fits = clip_to_ranges(model.n, q, belief, share > 0)
        estimated = to_estimate(model, sensor, q, clipped, reading, known.e, known.std)
        after = predict(belief, *build_transition(model, q, augmentation, belief, lambda X: u))
        mean, cov, restarted = reset_if_invalid(q, entries, after)
        patience = s.patience
        if share > 0:
            cov, patience = inflate_covariance(
                q, model, 0, entries, cov, patience, seen, known.trust, known.e
            )
        state = JointState(mean, cov, patience)
        return Step(
            state=state,
            estimate=estimated,
            log=0.0,
            trust=known.trust,
            fits=fits,
            restarted=restarted,
            opened=patience.opened == 1,
        )

    member = Member(
        params, lambda q: JointState(q.mean, q.cov, start_rejection_rate(model.p)), step
    )
    return rescale_states(
        add_consistency_tests(member, model, widens=share > 0, recovers=False), units
    )


def noise_free_reading(model: System, kind: str, q: Params, i: int, X: Any) -> Any:
    """Return the noise-free reading y_i / m_i of X = `[x; d_r; d_l]` [z]."""
    n = model.n
    p = model.p
    z = model.output(q.model, X[:n])[i]
    return zone_reading(kind, z, X[n + i], X[n + p + i])


def reading_at_limit(sight: Sight, y: Any, side: Any, X: Any) -> Any:
    """Return `sight` with a reading y_i / m_i at a limit of its range as a bound."""
    return clip_expected_reading(sight(X), y, side)
