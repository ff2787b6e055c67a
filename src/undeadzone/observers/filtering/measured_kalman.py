"""Kalman filter on the measured branch for `[x; d_r; d_l]` and further unknowns.

A reading after a censored sample that is farther away than z can move in the time between is wrong.
The mathematics is in docs/filter_extensions.md, "Outliers".
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading, Traits
from undeadzone.nonlinearities.sensor import LEFT, RIGHT, Zone, present
from undeadzone.numerics.gaussian import (
    Gaussian,
    RobustUpdate,
    from_upper_entries,
    linearise,
    predict,
    predict_first_order,
)
from undeadzone.observers.filtering.augmented_state import rescale_states, scale_prior
from undeadzone.observers.filtering.consistency import (
    Member,
    Step,
    add_consistency_tests,
    innovation_log_density,
)
from undeadzone.observers.filtering.constant_states import (
    SAME,
    add_actuator_estimates,
    add_actuator_states,
    add_friction_state,
    add_gap_estimates,
    add_gap_states,
    gap_numbers,
    predict_plant_input,
    subtract_friction,
    zone_numbers,
)
from undeadzone.observers.filtering.gaussian_filter import (
    Augmentation,
    Params,
    Setup,
    add_unknown_estimates,
    build_filter_params,
    build_transition,
    clip_belief,
    covariance_entries,
    to_estimate,
)
from undeadzone.observers.filtering.innovation_tests import is_repeated
from undeadzone.observers.filtering.measurement_update import (
    Corrected,
    branch_output,
    certain_branch,
    confirm_silences,
    correct_by_readings,
    drop_absent_edges,
    find_censored,
    foresee_reading,
    is_surely_exact,
    range_limits,
    reject_impossible,
    silence_pause,
    use_bounds,
    use_limits,
)
from undeadzone.observers.filtering.motion_detection import add_motion_detection
from undeadzone.observers.filtering.multiple_models import add_disturbance_levels
from undeadzone.observers.filtering.noise_level import (
    Level,
    level_numbers,
    scale_noise,
    start_level,
    update_level,
)
from undeadzone.observers.filtering.prior import Prior, doubt_numbers
from undeadzone.observers.filtering.recovery import (
    LIMIT,
    RejectionRate,
    inflate_covariance,
    reset_if_invalid,
    start_rejection_rate,
)
from undeadzone.observers.filtering.sensor_shape import (
    add_shape_states,
    arrange_columns,
    column_variance,
    resolve_shape,
    shape_numbers,
    start_columns,
    widen_gate,
)
from undeadzone.observers.filtering.smoothing import Moments, Smoothing
from undeadzone.plants.system import System, scale_states
from undeadzone.util.arrays import Floats


class State(NamedTuple):
    """State of the filter from sample to sample.

    Attributes:
        mean, cov: mean and covariance (see `to_upper_entries`) before the reading.
        last, previous: the last two readings, 0 if one was rejected (p) [y].
        wait: samples until a breakpoint bounds the estimate again, right ones, then left ones
            (2p). If the readings have a range, also samples until its limits do, upper ones, then
            lower ones (2p).
        u: the last input (m).
        patience: running record of rejected readings.
        pace: running record of the motion of z.
        columns: sensitivities of the unknowns to the sensor's shape, column by column (empty if
            it is exact).
        level: of the noise.
    """

    mean: Any
    cov: Any
    last: Any
    previous: Any
    wait: Any
    u: Any
    patience: RejectionRate
    pace: Pace
    columns: Any
    level: Level


def build_branch_filter(
    plant: System,
    units: Floats,
    sensor: Zone,
    prior: Prior,
    augmentation: Augmentation,
    glitches: float,
    traits: Traits,
    lasting: float = 1.0,
    bounds: bool = False,
    order: Literal[1, 2] = 2,
    blind: bool = False,
    is_assumed: bool = True,
    careful: bool = False,
    levels: int = 1,
    recovers: bool = True,
    learns_shape: bool = True,
) -> Observer:
    """Build a Kalman filter for `[x; d]` and further unknowns as an observer.

    A reading outside the zone measures z plus the offset of its branch. One inside the zone is a
    censored sample. Around the filter are a multiple-model filter, consistency tests, and for a
    backlash a detector of its branch.

    Args:
        plant: the sampled model, in the plant's units.
        units: units in which the filter counts states (n) [units of x].
        sensor: the dead zone.
        prior: prior mean and covariance, in the plant's units.
        augmentation: unknowns beside `[x; d]` and their model, in the filter's units.
        glitches: probability that a reading is an outlier (0: none is).
        traits: numbers that checks and figures read from the observer.
        lasting: samples for which an error of the linearisation keeps its sign.
        bounds: whether censored samples and assumed ranges bound the state estimate.
        order: order of the prediction: 1 linearises, 2 includes second derivatives.
        blind: whether every reading counts as z itself, as if there were no dead zone.
        is_assumed: whether the user assumes the rms of the disturbance. False: it is a default.
        careful: whether censored samples move widths only as far as readings contained information
            on them.
        levels: number of disturbance rms in the multiple-model filter (`add_disturbance_levels`).
        recovers: whether the filter estimates the causes of a lasting misfit, such as a bias, so
            that its innovations can become consistent again.
        learns_shape: whether the rounding of the breakpoints is estimated. False: it only widens
            the displayed intervals, as errors of the slope and late readings do.
    """
    model = scale_states(plant, units)
    prior = scale_prior(prior, units)
    shape = resolve_shape(sensor, prior, model, learns_shape, blind)
    augmentation, layout = add_shape_states(augmentation, model, shape)
    gaps = gap_numbers(sensor, prior)
    zones = zone_numbers(model.actuator)
    augmentation = add_gap_states(add_friction_state(augmentation, sensor), gaps)
    augmentation = add_actuator_states(augmentation, zones)
    entries = covariance_entries(model, augmentation)
    doubts = glitches > 0 and not blind
    centred = prior.asymmetry is not None
    setup = Setup(
        model, sensor, augmentation, entries, bounds, order, blind, doubts, careful, centred, layout
    )
    p = model.p
    m = model.m

    def init(q: Params) -> State:
        """Return the state at t = 0."""
        each = np.zeros(p)
        waits = np.zeros(4 * p if setup.has_limits else 2 * p)
        return State(
            q.mean,
            q.cov,
            each,
            each,
            waits,
            np.zeros(m),
            start_rejection_rate(p),
            start_pace(setup),
            start_columns(setup),
            start_level(q),
        )

    params = build_filter_params(model, sensor, prior, augmentation)
    doubt = doubt_numbers(model, sensor, prior, glitches, is_assumed)
    params = params._replace(
        lasting=np.asarray(lasting),
        doubt=doubt,
        ends=range_limits(sensor, prior),
        zones=zones,
        rest=np.asarray(silence_pause(model, sensor, lasting)),
        gaps=gaps,
        shape=shape_numbers(sensor, shape),
        level=level_numbers(setup, prior) if doubts else None,
    )
    smoothing = Smoothing(
        moments=partial(filter_moments, setup),
        odds=lambda s: np.zeros(1),
        record=lambda s: (),
        mixture_estimate=lambda q, beliefs, wide, share, record: estimate_of_belief(
            setup, q, beliefs[0], wide[0]
        ),
    )
    member = Member(params, init, partial(step_filter, setup), smoothing)
    member = add_disturbance_levels(member, levels, is_assumed)
    observer = rescale_states(add_consistency_tests(member, model, doubts, traits, recovers), units)
    return add_motion_detection(drop_absent_edges(observer, sensor), plant, sensor)


class Update(NamedTuple):
    """Result of a measurement update.

    Its fields: reading (p), certain branch (p), Gaussians before and after, columns of the
    sensor's shape.
    """

    y: Any
    side: Any
    before: Gaussian
    corrected: RobustUpdate
    bounded: Corrected
    columns: Any


def update_measurement(setup: Setup, q: Params, s: State, reading: Reading) -> Update:
    """Return the measurement update by a reading and by its bounds."""
    seen = present(reading.y)
    y = ca.if_else(seen, reading.y, 0.0)
    side = choose_branch(setup, q, s, reading, y, seen)
    before = Gaussian(s.mean, from_upper_entries(s.cov, setup.entries))
    R = measurement_variances(q, reading)
    surprises = silence_log_ratios(setup, q, s.pace, y, side, R)
    corrected, columns = correct_by_readings(
        setup,
        q,
        before,
        y,
        side,
        R,
        surprises,
        reading.motion,
        s.pace.ahead,
        arrange_columns(setup, s.columns),
    )
    bounded = Corrected(corrected.belief, s.wait, corrected.trust, corrected.likely)
    bounded = apply_bounds(setup, q, s, bounded, reading, y, side)
    if setup.has_limits or setup.sensor.absent.any():
        bounded = bounded._replace(trust=reject_impossible(bounded.trust, reading))
    return Update(y, side, before, corrected, bounded, columns)


def filter_moments(
    setup: Setup, q: Params, s: State, u: Any, reading: Reading
) -> tuple[Moments, ...]:
    """Return the filter's moments at a sample for a smoother, a tuple of length 1."""
    q = scale_noise(widen_gate(setup, q), s.level)
    updated = update_measurement(setup, q, s, reading)
    corrected = updated.corrected
    bounded = updated.bounded
    rows, edges = measurement_rows(setup, q, updated.before.mean, updated.side)
    restarted = reset_if_invalid(
        q, setup.entries, predict_belief(setup, q, bounded.belief, u, reading.side)
    )[2]
    slope = motion_slope(setup, q, bounded.belief, u)
    log = log_likelihood(setup, corrected, bounded)
    none = ca.SX(setup.model.n + 2 * setup.model.p + len(setup.augmentation.cov), 0)
    doubted = (none, none)
    if setup.shape.fixed:
        scale = ca.diag(q.shape.doubt)
        doubted = (arrange_columns(setup, s.columns) @ scale, updated.columns @ scale)
    known = Moments(
        updated.before,
        corrected.belief,
        bounded.belief,
        rows,
        edges,
        slope,
        log,
        restarted,
        doubted,
    )
    return (known,)


def measurement_rows(setup: Setup, q: Params, at: Any, side: Any) -> tuple[Any, Any]:
    """Return the rows of the readings (p x N), and of all breakpoints (2p x N).

    The readings are on the given branches.
    """
    p = setup.model.p
    read = list(enumerate([0.0] * p if setup.is_jump_sensor else ca.vertsplit(side)))
    edges = [(i, edge) for edge, i in product((RIGHT, LEFT), range(p))]

    each = (partial(branch_output, setup, q, i, edge) for i, edge in edges)
    return (
        ca.vertcat(*(foresee_reading(setup, q, i, branch, at, at)[1] for i, branch in read)),
        ca.vertcat(*(linearise(beyond, at)[1] for beyond in each)),
    )


def motion_slope(setup: Setup, q: Params, belief: Gaussian, u: Any) -> Any:
    """Return the Jacobian of the motion in the prediction (N x N)."""
    if setup.order == 1 and setup.augmentation.slope is not None:
        return setup.augmentation.slope(q)
    drive, _ = predict_plant_input(q.zones, belief, u)
    change, _ = build_transition(setup.model, q, setup.augmentation, belief, drive)
    return linearise(change, belief.mean)[1]


def estimate_of_belief(setup: Setup, q: Params, belief: Gaussian, wide: Any) -> Estimate:
    """Return the estimate of a Gaussian, without innovations.

    Here wide: covariance that the sensor's shape adds (N x N), or empty.
    """
    clipped, _ = clip_belief(setup, q, belief)
    if wide.shape[0]:
        clipped = Gaussian(clipped.mean, clipped.cov + wide)
    none = ca.SX(setup.model.p, 1)
    return to_estimate(setup.model, setup.sensor, q, clipped, Reading(none, none), none, none)


def log_likelihood(setup: Setup, corrected: RobustUpdate, bounded: Corrected) -> Any:
    """Return the log predictive density of a sample, up to a constant (1)."""
    if setup.doubts:
        return ca.sum1(ca.log(bounded.likely))
    return innovation_log_density(corrected.e, corrected.std)


def step_filter(setup: Setup, q: Params, s: State, u: Any, reading: Reading) -> Step:
    """Return the result for a sample: correct by the reading, apply bounds, estimate, predict."""
    declared = q.R
    q = scale_noise(widen_gate(setup, q), s.level)
    y, side, _, corrected, bounded, columns = update_measurement(setup, q, s, reading)
    clipped, fits = clip_belief(setup, q, bounded.belief)
    if setup.shape.fixed:
        clipped = Gaussian(clipped.mean, clipped.cov + column_variance(q, columns))
    e = corrected.e
    std = corrected.std
    estimated = to_estimate(setup.model, setup.sensor, q, clipped, reading, e, std)
    estimated = add_unknown_estimates(setup, q, estimated, clipped, s.u)
    estimated = add_actuator_estimates(q.zones, estimated, clipped)
    estimated = add_gap_estimates(q, estimated, clipped, reading)
    if q.level is not None:
        found, assumed = (ca.sqrt(R) * q.slope for R in (q.R, declared))
        estimated = estimated._replace(noise=found, noise_assumed=assumed)
    mean, cov, restarted = reset_if_invalid(
        q, setup.entries, predict_belief(setup, q, bounded.belief, u, reading.side)
    )
    pace = predict_pace(setup, q, s.pace, bounded, u, side, reading)
    if setup.shape.fixed:
        moved = columns + motion_slope(setup, q, bounded.belief, u) @ columns
        sound = ca.logic_and(ca.logic_not(restarted), ca.fabs(moved) < LIMIT)
        columns = ca.vec(ca.if_else(sound, moved, 0.0))
        pace = pace._replace(ahead=ca.if_else(restarted, 0.0, pace.ahead))
    counted = side != 0 if reading.rms is None else ca.logic_and(side != 0, reading.rms <= 0)
    level = update_level(q, s.level, declared, corrected, counted)
    after = State(mean, cov, y, s.last, bounded.wait, u, s.patience, pace, columns, level)
    if setup.doubts:
        after = apply_rejections(setup, q, after, side, bounded.trust)
    return Step(
        state=after,
        estimate=estimated,
        log=log_likelihood(setup, corrected, bounded),
        trust=bounded.trust,
        fits=fits,
        restarted=restarted,
        opened=after.patience.opened == 1,
    )


def measurement_variances(q: Params, reading: Reading) -> Any:
    """Return the variances of the readings (p) [z^2].

    A reading's own variance replaces the filter's.
    """
    if reading.rms is None:
        return q.R
    return ca.if_else(reading.rms > 0, (reading.rms / q.slope) ** 2, q.R)


def apply_bounds(
    setup: Setup, q: Params, s: State, read: Corrected, reading: Reading, y: Any, side: Any
) -> Corrected:
    """Return the correction by silent samples and limits, if the filter uses bounds.

    Args:
        setup: the filter.
        q: its numbers.
        s: its state.
        read: result after the readings on certain sides.
        reading: the reading.
        y: reading, 0 if it is missing (p) [y].
        side: the sides that are sure (p).
    """
    silent = find_censored(setup, q, reading, y)
    if not setup.bounds:
        return read._replace(silence=confirm_silences(setup, q, read.belief, silent))
    if setup.has_backlash_ahead:
        return apply_backlash_bounds(setup, q, s, read, y, present(reading.y))
    if not setup.has_limits:
        return use_bounds(setup, q, read, silent, side, y if setup.is_backlash_sensor else None)
    edges = use_bounds(setup, q, read, silent, side)
    return use_limits(setup, q, edges, s.wait[2 * setup.model.p :], y, reading.side)


def apply_backlash_bounds(
    setup: Setup, q: Params, s: State, read: Corrected, y: Any, seen: Any
) -> Corrected:
    """Return the result of `apply_bounds` for a backlash ahead of a dead zone.

    The backlash bounds z at all times.

    A censored sample implies -d_l - c_l <= z <= d_r + c_r. Beyond an edge z lies within the gap
    about the held level, up to the error of held readings.
    """
    play_side = certain_branch(y, s.last, s.previous, q.gate)
    silent = ca.logic_and(seen, ca.fabs(y) <= q.gate)
    is_bounded = ca.logic_or(silent, play_side != 0)
    play_side = ca.if_else(silent, 0.0, play_side)
    level = ca.if_else(play_side != 0, y, 0.0)
    return use_bounds(setup, q, read, is_bounded, play_side, level, play_side)


def choose_branch(setup: Setup, q: Params, s: State, reading: Reading, y: Any, seen: Any) -> Any:
    """Return the branches for the use of the readings (p), 0 for an uncertain branch.

    Args:
        setup: the filter.
        q: its numbers.
        s: its state.
        reading: the reading.
        y: reading, 0 if it is missing (p) [y].
        seen: whether it is there (p).
    """
    if setup.blind:
        return seen
    side_is_measured = setup.is_jump_sensor or setup.is_backlash_sensor
    side = reading.side if side_is_measured else certain_branch(y, s.last, s.previous, q.gate)
    if setup.has_limits:
        exact = is_surely_exact(setup, q, y, s.last, s.previous, reading.side)
        side = ca.if_else(exact, side, 0.0)
    if setup.has_backlash_ahead:  # a held reading shows no contact
        side = ca.if_else(reading.motion != 0, side, 0.0)
    if not setup.doubts:
        return side
    return ca.if_else(is_repeated(q.doubt, y, s.last), 0.0, side)


def apply_rejections(setup: Setup, q: Params, s: State, side: Any, trust: Any) -> State:
    """Return the state without the rejected readings.

    The covariance is inflated if most recent readings were rejected.

    Args:
        setup: the filter.
        q: its numbers.
        s: the state after the sample.
        side: the sides on which readings were used (p).
        trust: probability that a reading was not wrong (p).
    """
    constants = setup.augmentation.constants
    y = s.last / q.slope
    branch = 0.0 * y if setup.is_jump_sensor else ca.sign(y)
    missed = ca.vertcat(
        *(y[i] - branch_output(setup, q, i, branch[i], s.mean) for i in range(setup.model.p))
    )
    cov, patience = inflate_covariance(
        q, setup.model, constants, setup.entries, s.cov, s.patience, side != 0, trust, missed
    )
    pace = s.pace._replace(since=ca.if_else(patience.opened == 1, 0.0, s.pace.since))
    last = ca.if_else(trust < 0.5, 0.0, s.last)
    return s._replace(cov=cov, last=last, patience=patience, pace=pace)


def predict_belief(setup: Setup, q: Params, belief: Gaussian, u: Any, side: Any) -> Gaussian:
    """Return the Gaussian at the next sample under an input u (m).

    Here side: the measured branch (p).
    """
    augmentation = setup.augmentation
    drive, doubt = predict_plant_input(q.zones, belief, u)
    drive = subtract_friction(setup.sensor, augmentation.zones, drive, side)
    if doubt is not None:
        doubt = SAME * doubt
    change, Q = build_transition(setup.model, q, augmentation, belief, drive, doubt)
    if setup.order == 1:
        slope = None if augmentation.slope is None else augmentation.slope(q)
        return predict_first_order(belief, change, Q, slope)
    bend = None if augmentation.bilinear is None else partial(bilinear_part, setup, q, drive)
    return predict(belief, change, Q, q.lasting, bend)


def bilinear_part(setup: Setup, q: Params, drive: Callable[[Any], Any], X: Any) -> Any:
    """Return the `Products` of the augmentation at X = `[x; d; extra]`."""
    assert setup.augmentation.bilinear is not None
    n = setup.model.n
    p = setup.model.p
    return setup.augmentation.bilinear(q, X[:n], X[n + 2 * p :], drive(X))


class Pace(NamedTuple):
    """Running record of the motion of z, empty if unused.

    Attributes:
        ahead: by how much z moves until the next reading (p) [z].
        variance: of that (p) [z^2].
        since: steps since z was last inside of an edge, right edges, then left ones (2p), 0 if it
            was beyond it at the last reading that was used (empty without a pace test).
    """

    ahead: Any
    variance: Any
    since: Any


def start_pace(setup: Setup) -> Pace:
    """Return the pace before the first reading."""
    p = setup.model.p if setup.has_pace else 0
    return Pace(np.zeros(p), np.zeros(p), np.zeros(2 * p if setup.has_pace_test else 0))


def silence_log_ratios(setup: Setup, q: Params, pace: Pace, y: Any, side: Any, R: Any) -> list[Any]:
    """Return the log density ratio of readings with and without preceding silence (p).

    z was inside the edge since[] steps ago, by a reading within the gate, and moved by that many
    times its motion in a step. A reading beyond that needs a motion of as many deviations, or the
    censored samples were fake.

    Args:
        setup: the filter.
        q: its numbers.
        pace: of z.
        y: reading, 0 if it is missing (p) [y].
        side: the sides that are sure (p).
        R: variances of the readings (p) [z^2].
    """
    p = setup.model.p
    if not setup.has_pace_test:
        return [0.0] * p
    each = []
    for i in range(p):
        steps = ca.if_else(side[i] > 0, pace.since[i], pace.since[p + i])
        gone = side[i] * (y[i] / q.slope[i] - steps * pace.ahead[i])
        over = ca.fmax(gone - q.gate[i] / q.slope[i], 0.0)
        off = over**2 / (steps**2 * pace.variance[i] + R[i])
        each.append(ca.if_else(steps > 0, ca.fmax(-off / 2, q.doubt.fake), 0.0))
    return each


def predict_pace(
    setup: Setup, q: Params, pace: Pace, bounded: Corrected, u: Any, side: Any, reading: Reading
) -> Pace:
    """Return the pace at the next reading.

    Args:
        setup: the filter.
        q: its numbers.
        pace: at this one.
        bounded: result after this reading.
        u: the input from now on (m).
        side: the sides on which readings were used (p).
        reading: the reading.
    """
    if not setup.has_pace:
        return pace
    belief = bounded.belief
    n = setup.model.n
    drive, doubt = predict_plant_input(q.zones, belief, u)
    change, Q = build_transition(setup.model, q, setup.augmentation, belief, drive, doubt)
    E = motion_slope(setup, q, belief, u)
    _, h = linearise(lambda X: setup.model.output(q.model, X[:n]), belief.mean)
    believed = bounded.trust > 0.5
    since = []
    for k, edge in enumerate((RIGHT, LEFT) if setup.has_pace_test else ()):
        before = ca.vertsplit(pace.since, setup.model.p)[k]
        silence = bounded.silence[k]
        across = ca.logic_and(side == -edge, believed)
        beyond = ca.logic_or(ca.logic_and(side == edge, believed), reading.side == 2 * edge)
        later = ca.if_else(ca.logic_or(before == 0, beyond), 0.0, before + 1)
        since.append(ca.if_else(ca.logic_or(silence, across), 1.0, later))
    return Pace(
        ahead=h @ change(belief.mean),
        variance=ca.fmax(ca.diag(h @ (E @ belief.cov @ E.T + Q) @ h.T), 0.0),
        since=ca.vertcat(*since) if since else pace.since,
    )
