"""What filters show is right, wide, or withdrawn: wrong readings, silence, late constants."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from benchmarks.filters import coverage, glitches
from benchmarks.filters.problems import assumed_worlds
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm
from test_recovery import AT, PLANT, SENSOR, TS, drive

import undeadzone as uz
from scenes import PAPER_PLANT, seeds
from undeadzone.interfaces import Estimate, PythonObserver, Reading
from undeadzone.linalg.hold import zoh
from undeadzone.nonlinearities.sensor import resolve
from undeadzone.numerics.gaussian import Bound, Gaussian, truncate_at_bounds, update_with_outliers
from undeadzone.observers.filtering.consistency import LOST, innovation_log_density, widen_intervals
from undeadzone.observers.filtering.gaussian_filter import FAR, clip_to_ranges, width_excess_square
from undeadzone.observers.filtering.innovation_tests import start_scores
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import arrival_time, sample_plant
from undeadzone.util.arrays import Floats

LOW, HIGH = 0.2, 3.0
FILTERS = {
    "kalman": uz.Kalman,
    "censored": uz.Censored,
    "extended": uz.Extended,
    "ekf": uz.EKF,
    "ukf": uz.UKF,
    "particle_filter": uz.ParticleFilter,
    "moving_horizon": uz.MovingHorizon,
}
RIVALS = ("ekf", "ukf", "particle_filter", "moving_horizon")


@cache
def built(name: str) -> Any:
    """The filter for the paper's plant, as something that steps on numbers."""
    options = FILTERS[name](right=[LOW, HIGH])
    observer = options.build(sample_plant(PAPER_PLANT, TS), resolve(SENSOR, 1, TS))
    return observer.python or options


def follow(name: str, y: Floats, u: Floats) -> list[Estimate]:
    """The estimates along readings and inputs."""
    observer, estimates = built(name), []
    if not isinstance(observer, PythonObserver):
        online = uz.Online(observer, PLANT, SENSOR, TS)
        return [online.update(*pair) for pair in zip(y, u, strict=True)]
    state = observer.start(0)
    for reading, force in zip(y, u, strict=True):
        side = np.sign(reading) * (np.abs(reading) > resolve(SENSOR, 1, TS).threshold)
        state, one = observer.correct(state, Reading(np.atleast_1d(reading), side))
        state = observer.predict(state, np.atleast_1d(force))
        estimates.append(one)
    return estimates


def late_rms(estimates: list[Estimate]) -> float:
    """The rms of z - z^ from 2 s after a wrong reading on."""
    z = np.array([one.z[0] for one in estimates])
    return float(np.sqrt(np.mean((z - drive()[1][: len(z)])[AT + 200 :] ** 2)))


@cache
def usual(name: str) -> float:
    u, _, y = drive()
    return late_rms(follow(name, y, u))


@pytest.mark.parametrize("name", RIVALS)
@pytest.mark.parametrize("size", [-1e6, 0.99e300])
def test_no_filter_is_ruined_by_a_reading(name: str, size: float) -> None:
    u, _, y = drive()
    wrong = y.copy()
    wrong[AT : AT + 3] = size
    estimates = follow(name, wrong, u)
    assert all(np.isfinite(np.concatenate(one)).all() for one in estimates)
    assert late_rms(estimates) <= 1.2 * usual(name) + 1e-3


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_rivals_count_what_they_refuse_and_begin_anew_where_lost(name: str) -> None:
    u, _, y = (part[:400].copy() for part in drive())
    before = follow(name, y, u)[-1].refused
    y[200:203] = 1e4
    assert follow(name, y, u)[-1].refused == before + 3
    u[300] = 1e200
    last = follow(name, y, u)[-1]
    assert np.isfinite(np.concatenate(last)).all()
    assert last.restarts >= 1


@pytest.mark.parametrize("name", FILTERS)
@given(seed=seeds, scale=st.floats(-2, 8))
@settings(max_examples=6, deadline=None)
def test_estimated_widths_stay_in_their_prior_ranges(name: str, seed: int, scale: float) -> None:
    """Whatever is read, after whatever input."""
    rng = np.random.default_rng(seed)
    y = 10**scale * rng.normal(size=60) * (rng.uniform(size=60) < 0.7)
    y[rng.uniform(size=60) < 0.1] = np.nan
    for one in follow(name, y, 10 * rng.normal(size=60)):
        widths = np.concatenate([one.right, one.left])
        assert np.isfinite(np.concatenate(one)).all()
        assert (widths >= LOW - 1e-12).all()
        assert (widths <= HIGH + 1e-12).all()


# --- Silence


def numbers(*parts: Any) -> list[Floats]:
    return [np.asarray(ca.evalf(ca.SX(part)).full()) for part in parts]


def belief_of(seed: int) -> tuple[Gaussian, Floats, Floats]:
    """A belief about three variables, and its mean and covariance as numbers."""
    root = np.random.default_rng(seed).normal(size=(3, 3))
    mean, P = np.array([1.0, 2.0, 0.5]), root @ root.T + 0.1 * np.eye(3)
    return Gaussian(ca.SX(mean), ca.SX(P)), mean, P


def no_share_is_a_share_of_one(update: Callable[..., Any], *known: Any) -> None:
    every, plain = update(*known, ca.SX([1.0, 1.0, 1.0])), update(*known)
    for one, other in zip(numbers(*every.belief), numbers(*plain.belief), strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9)


@given(st.floats(-4.0, 1.5), st.floats(0.0, 1.0), seeds)
@settings(max_examples=30, deadline=None)
def test_silence_leaves_alone_what_it_may_not_move(alpha: float, share: float, seed: int) -> None:
    """A variable of share 0 keeps mean and variance; the covariance stays one for every share."""
    belief, mean, P = belief_of(seed)
    row = np.array([1.0, -1.0, 0.3])
    excess = -alpha * np.sqrt(row @ P @ row + 0.01)
    known = belief, [Bound(ca.SX(row[None]), excess, 1.0)], 0.01, 1.6, -7.0
    for moved in ([1.0, 0.0, 1.0], [1.0, share, 1.0]):
        after, cov = numbers(*truncate_at_bounds(*known, ca.SX(moved)).belief)
        assert np.linalg.eigvalsh(cov).min() > 0
        if moved[1] == 0.0:
            assert after[1, 0] == pytest.approx(mean[1], abs=1e-12)
            assert cov[1, 1] == pytest.approx(P[1, 1], rel=1e-9)
    no_share_is_a_share_of_one(truncate_at_bounds, *known)


def test_edges_that_are_never_reached_stay_unknown_by_default() -> None:
    """Silence under a doubted gust is no evidence for wide zones: it was, by .5 in the width."""

    def options(known: coverage.Problems, k: int) -> Any:
        right, left = known.ranges[k]
        return uz.Censored(right=right, left=left, levels=1)

    posed = coverage.problems("no edge", glitches.SHAKEN, 1, 120, 31)
    verdict = glitches.observe(options, posed).verdict
    assert verdict.covered().min() >= 0.92
    assert (np.abs(verdict.errors.mean(axis=0)[:4]) < 0.15).all()


@given(st.floats(-3.0, 3.0), st.floats(0.0, 1.0), seeds)
@settings(max_examples=30, deadline=None)
def test_a_reading_leaves_alone_what_it_may_not_move(e: float, share: float, seed: int) -> None:
    """The covariance is that of the gain that was used (Joseph), where the reading is sure."""
    belief, mean, P = belief_of(seed)
    row, R, shares = np.array([1.0, -1.0, 0.0]), 0.1, np.array([1.0, 1.0, share])
    known = belief, ca.SX(row[None]), e, R, 1.0
    one = update_with_outliers(*known, -500.0, 20.0, ca.SX(shares))
    after, cov = numbers(*one.belief)
    gain = shares * (P @ row) / (row @ P @ row + R)
    rest = np.eye(3) - np.outer(gain, row)
    assert after[:, 0] == pytest.approx(mean + e * gain, rel=1e-9, abs=1e-9)
    assert cov == pytest.approx(rest @ P @ rest.T + R * np.outer(gain, gain), rel=1e-9, abs=1e-9)
    no_share_is_a_share_of_one(update_with_outliers, *known, -3.0, 20.0)


def test_readings_on_one_edge_leave_the_other_unknown_by_default() -> None:
    """Silence had bound z to the edge that was not reached, and readings then moved it inwards."""
    posed = assumed_worlds.problems(assumed_worlds.KINDS["right edge only"], 2, 120, 11)
    verdict = glitches.observe(glitches.from_ranges, posed).verdict
    assert verdict.covered().min() >= 0.93
    away = posed.z.min(axis=0) > -posed.d[:, 1]
    assert away.sum() > 20
    left = verdict.errors[away, 1]
    assert abs(left.mean()) < 0.2 * np.ptp(posed.ranges[away, 1], axis=1).mean()
    assert (np.abs(left) <= 1.96 * verdict.stds[away, 1]).mean() >= 0.97


# --- How far z can move


def test_a_reading_that_leaves_silence_farther_than_z_can_move_is_refused() -> None:
    """The belief itself is wide: nothing but the silence before and after speaks against it."""
    options = uz.Censored(right=[LOW, HIGH])
    rng = np.random.default_rng(0)
    for sign in (1.0, -1.0):
        y = 0.01 * rng.normal(size=300)
        y[150::50] = sign * np.array([0.3, 0.8, 1.5])
        lone = uz.Online(options, PLANT, SENSOR, TS)
        last = [lone.update(value, 0.0) for value in y][-1]
        assert last.refused == 3
        middle, std = (LOW + HIGH) / 2, (HIGH - LOW) / np.sqrt(12)
        for width, width_std in ((last.right, last.right_std), (last.left, last.left_std)):
            assert width[0] == pytest.approx(middle, abs=0.1)
            assert width_std[0] == pytest.approx(std, rel=0.05)


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_readings_that_leave_silence_as_fast_as_z_moves_are_believed(missing: float) -> None:
    """z crosses the whole zone in four samples."""
    u, z, y = drive()
    gone = np.random.default_rng(1).uniform(size=y.size) < missing
    seen = np.where(gone, np.nan, y)[::4]
    online = uz.Online(uz.Censored(right=[0.0, 3.0]), PLANT, SENSOR, 4 * TS)
    errors = []
    for k, value in enumerate(seen):
        last = online.update(value, u[4 * k : 4 * k + 4].mean())
        errors.append(last.z[0] - z[4 * k])
    assert last.refused <= 1
    assert np.sqrt(np.mean(np.square(errors[150:]))) < 0.05


@pytest.mark.parametrize(
    ("options", "posed", "least", "flagged", "median", "most"),
    [
        # coverage of the width was .84, and a tenth of the errors ten times the usual ones
        (
            glitches.from_ranges,
            partial(assumed_worlds.problems, assumed_worlds.KINDS["both edges"], 1, 120, 12),
            *(0.92, 1.0, 1.1, 2.0),
        ),
        # half of the runs were flagged, and a tenth of the errors hundreds of times the usual
        (
            coverage.kalman,
            partial(coverage.problems, "both edges", glitches.QUIET, 2, 100, 31),
            *(0.9, 0.25, 1.5, 10.0),
        ),
    ],
)
def test_a_tenth_of_wrong_readings_costs_little_by_default(
    options: Any,
    posed: Callable[[], coverage.Problems],
    least: float,
    flagged: float,
    median: float,
    most: float,
) -> None:
    right = posed()
    usual = glitches.observe(options, right)
    wrong = glitches.KINDS["10 % random"][0](np.random.default_rng(5), right.y)
    outcome = glitches.observe(options, right._replace(y=wrong))
    assert outcome.verdict.covered().min() >= least
    assert np.mean(outcome.consistent == 0) <= flagged
    ratio = outcome.rms / usual.rms
    assert np.median(ratio) < median
    assert np.quantile(ratio, 0.9) < most


# --- Claims of a disturbance that are too small, and defaults


@pytest.mark.parametrize(
    ("world", "least"), [(assumed_worlds.World(), 0.95), (assumed_worlds.ASSUMED, 0.8)]
)
def test_the_extended_filter_allows_for_disturbances_by_default(
    world: assumed_worlds.World, least: float
) -> None:
    """Noise alone; and bias and a model off by 5 %, of which only the width shows too little."""
    posed = assumed_worlds.problems(assumed_worlds.KINDS["both edges"], 1, 60, 21, world)

    def alone(known: coverage.Problems, k: int) -> uz.Extended:
        return uz.Extended(right=known.ranges[k, 0], left=known.ranges[k, 1])

    def trusting(known: coverage.Problems, k: int) -> uz.Extended:
        return msgspec.structs.replace(alone(known, k), levels=1, bias=0.0)

    found, plain = glitches.observe(alone, posed), glitches.observe(trusting, posed)
    assert found.verdict.covered().min() >= least
    assert found.verdict.covered()[[0, 1, 3, 4]].min() >= 0.92
    assert np.median(found.rms) < 0.8 * np.median(plain.rms)


def test_a_gust_four_times_the_assumed_size_is_followed() -> None:
    """Without a level above the given one z^ is off by a third more; intervals are far wider."""
    posed = assumed_worlds.problems(assumed_worlds.Kind(gust=4.0), 2, 40, 6)
    outcome = glitches.observe(glitches.doubting, posed)

    def right(known: coverage.Problems, k: int) -> Any:
        observer = glitches.doubting(known, k)
        return msgspec.structs.replace(observer, disturbance=4.0 * known.disturbance[k])

    knowing = glitches.observe(right, posed)
    assert outcome.verdict.covered().min() >= 0.88
    assert np.mean(outcome.consistent == 0) <= 0.3
    assert np.median(outcome.rms / knowing.rms) < 1.1
    widths = outcome.verdict.stds[:, :2] / knowing.verdict.stds[:, :2]
    assert np.median(widths) < 1.3


@pytest.mark.parametrize("order", [2, 3, 4])
def test_a_default_disturbance_is_as_strong_whatever_the_order(order: int) -> None:
    """Of equal poles and gain 1: the same input, though a quarter period shows little of it."""
    moved = []
    for n in (1, order):
        a = np.poly([-1.0] * n)[:0:-1]
        A, B = np.eye(n, k=1), np.eye(n)[:, -1:]
        A[-1] = -a
        plant = sample_plant(system(Plant(A=A, B=B, C=np.eye(n)[:1])), 0.01)
        observer = uz.Censored(right=[0.0, 1.0]).build(
            plant, resolve(uz.Sensor(right=0.5, left=0.5), 1, 0.01)
        )
        moved.append(float(observer.params.augmentation.variance[0]) ** 0.5)
    assert 0.7 <= moved[1] / moved[0] <= 2.2


def test_integrators_are_no_delay() -> None:
    """Each pole is: n equal poles reach a quarter period and n - 1 time constants."""
    for n in (1, 2, 4):
        flow = system(
            Plant(A=-3.0 * np.eye(n) + np.eye(n, k=1), B=np.eye(n)[:, -1:], C=np.eye(n)[:1])
        )
        assert arrival_time(flow.linear) == pytest.approx((np.pi / 2 + n - 1) / 3)
    assert arrival_time(system(Plant(integrators=3)).linear, 0.01) == pytest.approx(0.5)


# --- Late constants


def test_a_filter_that_knows_no_constants_withdraws_what_a_bias_refuted() -> None:
    world = glitches.QUIET._replace(late=1.0)
    posed = coverage.problems("both edges", world, 2, 60, 4)
    outcome = glitches.observe(coverage.kalman, posed)
    assert outcome.verdict.covered().min() >= 0.8  # .04 before
    assert np.mean(outcome.consistent == 0) >= 0.95


def test_a_filter_that_knows_no_constants_is_believed_where_there_is_none() -> None:
    posed = coverage.problems("both edges", glitches.QUIET, 2, 100, 4)
    outcome = glitches.observe(coverage.kalman, posed)
    assert np.mean(outcome.consistent == 0) <= 0.1
    assert outcome.verdict.covered().min() >= 0.9
    assert np.median(outcome.verdict.stds[:, 2]) < 0.01


# --- The problems of the benchmark


@pytest.mark.parametrize("poles", ["stable", "unstable", "marginal"])
def test_a_problem_is_the_same_in_every_unit_of_time(poles: str) -> None:
    """Its sampled plant gives the same outputs of the same inputs, and its truth stays in range."""
    posed = assumed_worlds.problems(assumed_worlds.Kind(poles=poles), 3, 6, 5)
    other = assumed_worlds.in_unit(posed, np.array([1e-3, 0.1, 1.0, 7.0, 50.0, 1e3]))
    for k in range(6):
        answers = []
        for one in (posed, other):
            A, B, C = zoh(one.models[k], one.step[k])
            answers.append([(C @ np.linalg.matrix_power(A, i) @ B)[0, 0] for i in range(6)])
        assert answers[0] == pytest.approx(answers[1], rel=1e-6, abs=1e-12)
    rates = 1 / posed.step
    assert (assumed_worlds.RATES[0] <= rates * (1 + 1e-9)).all()
    assert (rates <= assumed_worlds.RATES[1] * (1 + 1e-9)).all()
    assert ((posed.ranges[:, :, 0] <= posed.d) & (posed.d <= posed.ranges[:, :, 1])).all()
    assert np.isfinite(posed.y).all()


@pytest.mark.parametrize(("excess", "refuted"), [(0.9, False), (1.1, True), (0.5, False)])
def test_a_width_beyond_its_range_is_inconsistent_and_gains_variance(
    excess: float, refuted: bool
) -> None:
    q: Any = SimpleNamespace(ranges=np.array([[0.0, 3.0]]))
    belief = Gaussian(ca.SX([0.0, 3.0 + excess]), ca.SX(np.diag([1.0, 1 / FAR**2])))
    clipped, consistent = clip_to_ranges(1, q, belief, doubts=True)
    variance = 1 / FAR**2 + (excess**2 if refuted else 0.0)
    np.testing.assert_allclose(ca.DM(clipped.mean).full().ravel(), [0.0, 3.0])
    np.testing.assert_allclose(np.diag(ca.DM(clipped.cov).full()), [1.0, variance])
    assert bool(ca.DM(consistent)) is not refuted


def test_the_likelihood_of_innovations_is_the_normal_density() -> None:
    e, std = np.array([0.3, -1.2, 0.0]), np.array([0.5, 3.0, 1.0])
    expected = norm.logpdf(e[:2], scale=std[:2]).sum() + np.log(2 * np.pi)
    assert float(innovation_log_density(ca.DM(e), ca.DM(std))) == pytest.approx(expected)


def widened(std: list[float], mean: Any, estimate: Estimate, **record: Any) -> Estimate:
    """The estimate of two states and one output after doubt: prior deviations, means and record."""
    doubt = SimpleNamespace(std=np.array(std), most=10.0, limit=10.0, keep=0.5)
    q: Any = SimpleNamespace(doubt=doubt, mean=np.asarray(mean))
    none = ca.SX(0, 1)
    usual = {"ratio": ca.SX(1.0), "offset": ca.SX(0.0), "share": ca.SX(0.0)}
    known: Any = SimpleNamespace(
        **usual | record, constant=none, opened=none, scores=start_scores(1)
    )
    plant: Any = SimpleNamespace(n=2, p=1)
    return widen_intervals(plant, q, known, estimate)


def test_a_filter_that_is_lost_knows_no_more_than_the_prior() -> None:
    """About what is shown: prior edges at 1 and 2 with deviations 0.3 and 0.4, shown at 1.4, 1.7.

    The two are independent. A state of deviation 2 about 0 is shown at 1.5.
    """
    blind = Estimate(*[ca.SX(0.0)] * len(Estimate._fields))._replace(
        x=ca.SX([1.5, 0.0]), right=ca.SX(1.4), left=ca.SX(1.7), x_std=ca.SX([0.0, 0.0])
    )
    found = widened([2.0, 2.0, 0.3, 0.4], [0.0, 0.0, 1.0, 2.0], blind, share=ca.SX(LOST + 0.1))
    values = [float(std) for std in (found.right_std, found.left_std, found.width_std)]
    assert values == pytest.approx([0.5, 0.5, np.sqrt(0.5)], rel=1e-12)
    assert ca.DM(found.x_std).full()[:, 0] == pytest.approx([2.5, 2.0])


def test_deviations_gain_the_offset_if_assumptions_are_rejected() -> None:
    """The state that is known worst gains all of it, another one as much as it is unknown."""
    estimate = Estimate(*[ca.SX(0.0)] * len(Estimate._fields))._replace(
        x=ca.SX([0.0, 0.0]), right_std=ca.SX(0.1), x_std=ca.SX([0.0, 0.0])
    )
    seen = {"ratio": ca.SX(16.0), "offset": ca.SX(0.3)}
    found = widened([2.0, 1.0, 0.3, 0.4], np.zeros(4), estimate, **seen)
    assert ca.DM(found.x_std).full()[:, 0] == pytest.approx([0.3, 0.15])
    assert float(found.right_std) == pytest.approx(0.5)  # root of (4 * 0.1)^2 + 0.3^2


def test_what_readings_alone_say_is_the_belief_without_its_prior() -> None:
    """A uniform prior's variance on [0, 2], readings that say 5 +- .1: 3 beyond the range."""
    low, high, reading, noise = 0.0, 2.0, 5.0, 0.01
    prior = (high - low) ** 2 / 12
    variance = 1 / (1 / prior + 1 / noise)
    mean = variance * (1.0 / prior + reading / noise)
    q: Any = SimpleNamespace(ranges=np.array([[low, high]]))
    belief = Gaussian(ca.SX([0.0, mean]), ca.diag(ca.SX([1.0, variance])))
    assert float(width_excess_square(1, q, belief)) == pytest.approx((reading - high) ** 2)


@pytest.mark.parametrize(("times", "gained"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize("std", [0.1, 10.0])
def test_a_width_far_beyond_its_range_gains_variance(
    times: float, gained: bool, std: float
) -> None:
    q: Any = SimpleNamespace(ranges=np.array([[0.0, 2.0]]))
    excess = times * FAR * std
    belief = Gaussian(ca.SX([0.0, 2.0 + excess]), ca.diag(ca.SX([1.0, std**2])))
    after, _ = clip_to_ranges(1, q, belief, doubts=True)
    assert float(after.mean[1]) == 2.0
    assert float(after.cov[1, 1]) == pytest.approx(std**2 + gained * excess**2)
