"""The Kalman filter on the measured side estimates [x; d_r; d_l] and further unknowns.

What comes out of silence beyond how far z can move from one reading to the next is wrong. The
mathematics is in docs/filters.md, of the latter in "Readings that are wrong".
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
from undeadzone.observers.filtering.augmented_state import prior_in_units, show_in_plant_units
from undeadzone.observers.filtering.consistency import (
    Member,
    Step,
    log_density,
    with_consistency_tests,
)
from undeadzone.observers.filtering.constant_states import (
    SAME,
    against_friction,
    entering,
    numbers_of,
    with_actuator,
    with_friction,
    with_gaps,
    with_play,
    with_widths,
    zones_of,
)
from undeadzone.observers.filtering.gaussian_filter import (
    Augmentation,
    Params,
    Setup,
    clip_belief,
    covariance_entries,
    filter_numbers,
    motion,
    to_estimate,
    with_unknowns,
)
from undeadzone.observers.filtering.innovation_tests import is_stuck
from undeadzone.observers.filtering.measurement_update import (
    Corrected,
    beyond_edge,
    censoring_probabilities,
    correct,
    downweight_outliers,
    ends,
    find_censored,
    rest_of,
    sure_side,
    surely_exact,
    use_bounds,
    use_limits,
)
from undeadzone.observers.filtering.motion_detection import with_motion_detection
from undeadzone.observers.filtering.multiple_models import with_disturbance_levels
from undeadzone.observers.filtering.prior import Prior, doubt_numbers
from undeadzone.observers.filtering.recovery import (
    RejectionRate,
    inflate_covariance,
    reset_if_invalid,
    start_rejection_rate,
)
from undeadzone.observers.filtering.smoothing import Moments, Smoothing
from undeadzone.plants.system import System, in_units
from undeadzone.util.arrays import Floats


class State(NamedTuple):
    """What the filter carries from sample to sample.

    Attributes:
        mean, cov: mean and covariance (its `triangle`) before the reading.
        last, previous: the last two readings, 0 where one was refused (p) [y].
        wait: steps to wait until an edge is heard again, right edges, then left ones (2p); where
            the readings have a range, then until a limit is, upper ones, then lower ones (2p).
        u: the last input (m).
        patience: with readings that are refused.
        pace: of z.
    """

    mean: Any
    cov: Any
    last: Any
    previous: Any
    wait: Any
    u: Any
    patience: RejectionRate
    pace: Pace


def build_gaussian_filter(
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
    claimed: bool = True,
    careful: bool = False,
    levels: int = 1,
    recovers: bool = True,
) -> Observer:
    """Return the filter as an observer; `Setup`, `Params` and `doubt_numbers` explain other
    arguments.

    Args:
        plant: the sampled model, in the plant's units.
        units: in which the filter counts states (n).
        sensor: the dead zone.
        prior: of the filter, in the plant's units.
        augmentation: the unknowns beside [x; d], of the model in the filter's units.
        glitches: probability that a reading is wrong; 0: none is.
        traits: of the observer.
        claimed: whether the disturbance is claimed, and no default.
        levels: how many rms of the disturbance are weighed (`levelled`).
        recovers: whether its state holds what a lasting misfit may be, so that it can end.
    """
    model = in_units(plant, units)
    prior = prior_in_units(prior, units)
    gaps = numbers_of(sensor, prior)
    zones = zones_of(model.actuator)
    augmentation = with_gaps(with_friction(augmentation, sensor), gaps)
    augmentation = with_widths(augmentation, zones)
    entries = covariance_entries(model, augmentation)
    doubts = glitches > 0 and not blind
    centred = prior.asymmetry is not None
    setup = Setup(
        model, sensor, augmentation, entries, bounds, order, blind, doubts, careful, centred
    )
    p, m = model.p, model.m

    def init(q: Params) -> State:
        each, waits = np.zeros(p), np.zeros(4 * p if setup.uses_limits else 2 * p)
        return State(
            q.mean, q.cov, each, each, waits, np.zeros(m), start_rejection_rate(p), resting(setup)
        )

    params = filter_numbers(model, sensor, prior, augmentation)
    doubt = doubt_numbers(model, sensor, prior, glitches, claimed)
    params = params._replace(
        lasting=np.asarray(lasting),
        doubt=doubt,
        ends=ends(sensor, prior),
        zones=zones,
        rest=np.asarray(rest_of(model, sensor, lasting)),
        gaps=gaps,
    )
    smoothing = Smoothing(
        moments=partial(moments, setup),
        odds=lambda s: np.zeros(1),
        record=lambda s: (),
        shown=lambda q, beliefs, share, record: estimate_of_belief(setup, q, beliefs[0]),
    )
    member = Member(params, init, partial(filter_step, setup), smoothing)
    member = with_disturbance_levels(member, levels, claimed)
    observer = show_in_plant_units(
        with_consistency_tests(member, model, doubts, traits, recovers), units
    )
    return with_motion_detection(observer, plant, sensor)


class Update(NamedTuple):
    """What a reading says: itself (p), its sure side (p), the beliefs before and after it."""

    y: Any
    side: Any
    before: Gaussian
    corrected: RobustUpdate
    heard: Corrected


def update_measurement(setup: Setup, q: Params, s: State, reading: Reading) -> Update:
    """What is known given a reading, and what it bounds."""
    seen = present(reading.y)
    y = ca.if_else(seen, reading.y, 0.0)
    side = choose_branch(setup, q, s, reading, y, seen)
    before = Gaussian(s.mean, from_upper_entries(s.cov, setup.entries))
    R = variances(q, reading)
    surprises = silence_log_ratio(setup, q, s.pace, y, side, R)
    corrected = correct(setup, q, before, y, side, R, surprises, reading.motion)
    heard = Corrected(corrected.belief, s.wait, corrected.trust, corrected.likely)
    heard = with_bounds(setup, q, s, heard, reading, y, side)
    if setup.uses_limits:
        heard = heard._replace(trust=downweight_outliers(heard.trust, reading))
    return Update(y, side, before, corrected, heard)


def moments(setup: Setup, q: Params, s: State, u: Any, reading: Reading) -> tuple[Moments, ...]:
    """What the filter knows about one sample, for a smoother."""
    taken = update_measurement(setup, q, s, reading)
    corrected, heard = taken.corrected, taken.heard
    rows, edges = rows_at(setup, q, taken.before.mean, taken.side)
    restarted = reset_if_invalid(
        q, setup.entries, predict_belief(setup, q, heard.belief, u, reading.side)
    )[2]
    slope = slope_at(setup, q, heard.belief, u)
    log = log_likelihood(setup, corrected, heard)
    known = Moments(
        taken.before, corrected.belief, heard.belief, rows, edges, slope, log, restarted
    )
    return (known,)


def rows_at(setup: Setup, q: Params, at: Any, side: Any) -> tuple[Any, Any]:
    """Return the rows of the readings on these sides (p x N), and of all edges (2p x N)."""
    p = setup.model.p
    read = list(enumerate([0.0] * p if setup.jump else ca.vertsplit(side)))
    edges = [(i, edge) for edge, i in product((RIGHT, LEFT), range(p))]

    def rows(branches: list[tuple[int, Any]]) -> Any:
        each = (partial(beyond_edge, setup, q, i, branch) for i, branch in branches)
        return ca.vertcat(*(linearise(beyond, at)[1] for beyond in each))

    return rows(read), rows(edges)


def slope_at(setup: Setup, q: Params, belief: Gaussian, u: Any) -> Any:
    """Return the slope of the motion that the prediction takes (N x N)."""
    if setup.order == 1 and setup.augmentation.slope is not None:
        return setup.augmentation.slope(q)
    drive, _ = entering(q.zones, belief, u)
    change, _ = motion(setup.model, q, setup.augmentation, belief, drive)
    return linearise(change, belief.mean)[1]


def estimate_of_belief(setup: Setup, q: Params, belief: Gaussian) -> Estimate:
    """Return the estimate that shows a belief; it has no innovations."""
    shown, _ = clip_belief(setup, q, belief)
    none = ca.SX(setup.model.p, 1)
    return to_estimate(setup.model, setup.sensor, q, shown, Reading(none, none), none, none)


def log_likelihood(setup: Setup, corrected: RobustUpdate, heard: Corrected) -> Any:
    """Return the log of the density with which the filter foretold a sample, up to a constant."""
    if setup.doubts:
        return ca.sum1(ca.log(heard.likely))
    return log_density(corrected.e, corrected.std)


def filter_step(setup: Setup, q: Params, s: State, u: Any, reading: Reading) -> Step:
    """Return one sample: correct by the reading, use what bounds, estimate, predict."""
    y, side, _, corrected, heard = update_measurement(setup, q, s, reading)
    shown, fits = clip_belief(setup, q, heard.belief)
    e, std = corrected.e, corrected.std
    estimated = to_estimate(setup.model, setup.sensor, q, shown, reading, e, std)
    estimated = with_unknowns(setup, q, estimated, shown, s.u)
    estimated = with_actuator(q.zones, estimated, shown)
    estimated = with_play(q, estimated, shown, reading)
    mean, cov, restarted = reset_if_invalid(
        q, setup.entries, predict_belief(setup, q, heard.belief, u, reading.side)
    )
    pace = predict_state(setup, q, s.pace, heard, u, side, reading)
    after = State(mean, cov, y, s.last, heard.wait, u, s.patience, pace)
    if setup.doubts:
        after = revise_branch(setup, q, after, side, heard.trust)
    return Step(
        state=after,
        estimate=estimated,
        log=log_likelihood(setup, corrected, heard),
        trust=heard.trust,
        fits=fits,
        restarted=restarted,
        opened=after.patience.opened == 1,
    )


def variances(q: Params, reading: Reading) -> Any:
    """Return variances of the readings (p) [z^2]: the filter's, unless a reading tells its own."""
    if reading.rms is None:
        return q.R
    return ca.if_else(reading.rms > 0, (reading.rms / q.slope) ** 2, q.R)


def with_bounds(
    setup: Setup, q: Params, s: State, heard: Corrected, reading: Reading, y: Any, side: Any
) -> Corrected:
    """What is known given what silences and readings at a limit bound, if the filter uses that.

    Args:
        setup: the filter.
        q: its numbers.
        s: its state.
        heard: what is known after the readings on sure sides.
        reading: what was read.
        y: reading, 0 where it is missing (p) [y].
        side: the sides that are sure (p).
    """
    silent = find_censored(setup, q, reading, y)
    if not setup.bounds:
        return heard._replace(silence=censoring_probabilities(setup, q, heard.belief, silent))
    if setup.both:
        return with_bounds_of_both(setup, q, s, heard, y, present(reading.y))
    if not setup.uses_limits:
        return use_bounds(setup, q, heard, silent, side, y if setup.play else None)
    edges = use_bounds(setup, q, heard, silent, side)
    return use_limits(setup, q, edges, s.wait[2 * setup.model.p :], y, reading.side)


def with_bounds_of_both(
    setup: Setup, q: Params, s: State, heard: Corrected, y: Any, seen: Any
) -> Corrected:
    """Return `with_bounds` of a play ahead of a dead zone, which bounds z wherever it is.

    Silence says -d_l - c_l <= z <= d_r + c_r; beyond an edge z lies within the gap about what is
    held, as far as readings that are held may be off.
    """
    held = sure_side(y, s.last, s.previous, q.gate)
    silent = ca.logic_and(seen, ca.fabs(y) <= q.gate)
    heard_at_all = ca.logic_or(silent, held != 0)
    held = ca.if_else(silent, 0.0, held)
    level = ca.if_else(held != 0, y, 0.0)
    return use_bounds(setup, q, heard, heard_at_all, held, level, held)


def choose_branch(setup: Setup, q: Params, s: State, reading: Reading, y: Any, seen: Any) -> Any:
    """Return the sides on which the readings are used (p), 0 where none is sure.

    Args:
        setup: the filter.
        q: its numbers.
        s: its state.
        reading: what was read.
        y: reading, 0 where it is missing (p) [y].
        seen: whether it is there (p).
    """
    if setup.blind:
        return seen
    shown = setup.jump or setup.play
    side = reading.side if shown else sure_side(y, s.last, s.previous, q.gate)
    if setup.uses_limits:
        exact = surely_exact(setup, q, y, s.last, s.previous, reading.side)
        side = ca.if_else(exact, side, 0.0)
    if setup.both:  # what holds tells no contact
        side = ca.if_else(reading.motion != 0, side, 0.0)
    if not setup.doubts:
        return side
    return ca.if_else(is_stuck(q.doubt, y, s.last), 0.0, side)


def revise_branch(setup: Setup, q: Params, s: State, side: Any, trust: Any) -> State:
    """Return the state without the readings that were refused; opened where most of late were.

    Args:
        setup: the filter.
        q: its numbers.
        s: the state after the sample.
        side: the sides on which readings were used (p).
        trust: probability that a reading was not wrong (p).
    """
    constants = setup.augmentation.constants
    cov, patience = inflate_covariance(
        q, setup.model, constants, setup.entries, s.cov, s.patience, side != 0, trust
    )
    return s._replace(cov=cov, last=ca.if_else(trust < 0.5, 0.0, s.last), patience=patience)


def predict_belief(setup: Setup, q: Params, belief: Gaussian, u: Any, side: Any) -> Gaussian:
    """Return the belief at the next sample, under an input u (m); side: that was measured (p)."""
    augmentation = setup.augmentation
    drive, doubt = entering(q.zones, belief, u)
    drive = against_friction(setup.sensor, augmentation.zones, drive, side)
    if doubt is not None:
        doubt = SAME * doubt
    change, Q = motion(setup.model, q, augmentation, belief, drive, doubt)
    if setup.order == 1:
        slope = None if augmentation.slope is None else augmentation.slope(q)
        return predict_first_order(belief, change, Q, slope)
    bend = None if augmentation.bilinear is None else partial(bilinear_part, setup, q, drive)
    return predict(belief, change, Q, q.lasting, bend)


def bilinear_part(setup: Setup, q: Params, drive: Callable[[Any], Any], X: Any) -> Any:
    """Return the `Products` of the augmentation, at X = [x; d; extra]."""
    assert setup.augmentation.bilinear is not None
    n, p = setup.model.n, setup.model.p
    return setup.augmentation.bilinear(q, X[:n], X[n + 2 * p :], drive(X))


class Pace(NamedTuple):
    """What is kept of how z moves; empty where nobody asks.

    Attributes:
        ahead: by how much z moves until the next reading (p) [z].
        variance: of that (p) [z^2].
        since: steps since z was last inside of an edge, right edges, then left ones (2p); 0 where
            it was beyond it at the last reading that was believed.
    """

    ahead: Any
    variance: Any
    since: Any


def resting(setup: Setup) -> Pace:
    """Nothing is known of z so far."""
    p = setup.model.p if setup.limits_pace else 0
    return Pace(np.zeros(p), np.zeros(p), np.zeros(2 * p))


def silence_log_ratio(setup: Setup, q: Params, pace: Pace, y: Any, side: Any, R: Any) -> list[Any]:
    """Return log of the density of each reading given the silence before it, over that without (p).

    z was inside of the edge since[] steps ago, by a reading within the gate, and moved by so many
    times what it moves in a step. A reading beyond that needs a motion as many deviations off; or
    the silence was fake.

    Args:
        setup: the filter.
        q: its numbers.
        pace: of z.
        y: reading, 0 where it is missing (p) [y].
        side: the sides that are sure (p).
        R: variances of the readings (p) [z^2].
    """
    p = setup.model.p
    if not setup.limits_pace:
        return [0.0] * p
    each = []
    for i in range(p):
        steps = ca.if_else(side[i] > 0, pace.since[i], pace.since[p + i])
        gone = side[i] * (y[i] / q.slope[i] - steps * pace.ahead[i])
        over = ca.fmax(gone - q.gate[i] / q.slope[i], 0.0)
        off = over**2 / (steps**2 * pace.variance[i] + R[i])
        each.append(ca.if_else(steps > 0, ca.fmax(-off / 2, q.doubt.fake), 0.0))
    return each


def predict_state(
    setup: Setup, q: Params, pace: Pace, heard: Corrected, u: Any, side: Any, reading: Reading
) -> Pace:
    """Return the pace at the next reading.

    Args:
        setup: the filter.
        q: its numbers.
        pace: at this one.
        heard: what is known after this one.
        u: the input from now on (m).
        side: the sides on which readings were used (p).
        reading: what was read.
    """
    if not setup.limits_pace:
        return pace
    belief, n = heard.belief, setup.model.n
    drive, doubt = entering(q.zones, belief, u)
    change, Q = motion(setup.model, q, setup.augmentation, belief, drive, doubt)
    E = slope_at(setup, q, belief, u)
    _, h = linearise(lambda X: setup.model.output(q.model, X[:n]), belief.mean)
    believed = heard.trust > 0.5
    since = []
    for k, edge in enumerate((RIGHT, LEFT)):
        before, silence = ca.vertsplit(pace.since, setup.model.p)[k], heard.silence[k]
        across = ca.logic_and(side == -edge, believed)
        beyond = ca.logic_or(ca.logic_and(side == edge, believed), reading.side == 2 * edge)
        later = ca.if_else(ca.logic_or(before == 0, beyond), 0.0, before + 1)
        since.append(ca.if_else(ca.logic_or(silence, across), 1.0, later))
    return Pace(
        ahead=h @ change(belief.mean),
        variance=ca.fmax(ca.diag(h @ (E @ belief.cov @ E.T + Q) @ h.T), 0.0),
        since=ca.vertcat(*since),
    )
