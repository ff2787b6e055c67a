"""The filter that hears silence.

Where it must be `kalman`, what its models of disturbance, bias and tolerance are, true claims.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from benchmarks.filters import coverage
from benchmarks.filters.glitches import trusting
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import norm, truncnorm

import undeadzone as uz
from scenes import (
    EXACT_SENSOR,
    PAPER_PLANT,
    OnNumbers,
    centre_std,
    follow_together,
    linear,
    random_plant,
    scene,
    seeds,
    tables_of,
)
from undeadzone.compile import interpret
from undeadzone.controllers.state_feedback import rest_response
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve
from undeadzone.numerics import gaussian
from undeadzone.observers import Censored, Kalman
from undeadzone.observers.filtering import multiple_models
from undeadzone.observers.filtering.gaussian_filter import Params, mix_two_gaussians
from undeadzone.observers.filtering.multiple_models import (
    mean_of_models,
    mixture_std,
    wider_component_weights,
)
from undeadzone.observers.filtering.unknown_inputs import (
    SMALL,
    bias_rest_state,
    build_colour,
    build_unknown_inputs,
    read_tolerance,
    zoh_entry_slopes,
)
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant, time_scale
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import prepare, simulate
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

TS = 0.02
MODEL = sample_plant(PAPER_PLANT, TS)
RANGE = [0.3, 2.0]
PRIOR = 1.7 / np.sqrt(12)
EXACT: dict[str, Any] = {
    "right": RANGE,
    "disturbance": 0.0,
    "bias": 0.0,
    "tolerance": 0.0,
    "drift": 0.0,
}  # nothing is wrong


def zone(p: int = 1, **options: Any) -> Zone:
    return resolve(Sensor(**{"right": 1.0, "left": 1.0} | EXACT_SENSOR | options), p, TS)


def watch(
    options: Any,
    model: System,
    where: Zone,
    u: Floats,
    x: Floats,
    bias: float = 0.0,
    noise: Floats | None = None,
) -> Estimate:
    """The last estimate of a filter that watches the model's own motion.

    The motion starts from x(0) = x and is under u (N x m) + bias.
    """
    observer = options.build(model, where)
    step, state = OnNumbers(observer, model), observer.init(observer.params)
    A, B, C = model.linear
    for k, drive in enumerate(u):
        read = sensor.jump if where.kind == "jump" else sensor.deadzone
        y = read(C @ x, where.right, where.left, where.slope) + (0.0 if noise is None else noise[k])
        state, estimate = step(state, drive, y, sensor.side(y, where.threshold))
        x = A @ x + B @ (drive + bias)
    return estimate


def tones(seconds: float, amplitude: float, offset: float = 0.0) -> Floats:
    t = np.arange(0.0, seconds, TS)
    return (offset + amplitude * np.sin(1.3 * t) + 0.3 * amplitude * np.sin(3.1 * t))[:, None]


# What scores do not widen, which `kalman` has none of.
KNOWN_TO_BOTH = ("x", "z", "right", "left", "innovation", "innovation_std", "refused", "restarts")


# --- Where it is the Kalman filter


@settings(max_examples=25)
@given(seeds, st.integers(1, 3), st.integers(1, 2))
def test_without_silence_and_extras_it_is_kalman(seed: int, n: int, p: int) -> None:
    rng = np.random.default_rng(seed)
    model, where = sample_plant(random_plant(rng, n, 1, p), TS), zone(p, noise=0.02)
    common: dict[str, Any] = {"right": RANGE, "x_std": 2.0, "drift": 0.1}
    pair = [
        options.build(model, where)
        for options in (
            Kalman(**common, disturbance=0.0),
            Censored(**EXACT | common, silence=False),
        )
    ]
    least = np.inf
    readings = (
        (rng.normal(size=p) * rng.choice([0.02, 3.0], p), rng.normal(size=1)) for _ in range(30)
    )
    for states, both in follow_together(pair, model, where, readings):
        assert np.array_equal(*[tree.pack_tree(state.filter) for state in states])
        for name in KNOWN_TO_BOTH:
            assert np.array_equal(*[getattr(estimate, name) for estimate in both]), name
        least = min(least, both[0].x_std.min())
    # Readings at random contradict each other: of one state, nine may be refused, and nothing told.
    assert least < 2.0 or both[0].refused.sum() >= 9


def test_a_silence_that_contradicts_nothing_changes_nothing() -> None:
    """Inside the zone with a state that is known to be at 0, silence is what was expected."""
    quiet = np.zeros((200, 1))
    options = EXACT | {"right": [1.0, 1.2], "x_std": 0.01}
    with_silence, without = (
        watch(Censored(**options, silence=silence), MODEL, zone(noise=0.01), quiet, np.zeros(2))
        for silence in (True, False)
    )
    assert all(np.array_equal(a, b) for a, b in zip(with_silence, without, strict=True))


# --- Its models


@given(st.floats(0.01, 10), st.floats(0.001, 0.3))
def test_the_disturbance_is_first_order_noise_of_unit_rms(
    correlation: float, relative_step: float
) -> None:
    colour = build_colour(correlation, relative_step * correlation)
    assert np.concatenate([*colour.F, *colour.Q, *colour.cov, colour.C]) == pytest.approx(
        [np.exp(-relative_step), -np.expm1(-2 * relative_step), 1.0, 1.0]
    )


@settings(max_examples=25)
@given(seeds, st.integers(1, 3), st.integers(1, 2))
def test_tolerances_are_derivatives_of_the_sampled_model(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    flow = random_plant(rng, n, m)
    tolerance = read_tolerance(sample_plant(flow, TS), 0.1)
    A, B, C = flow.linear
    assert tolerance.std == pytest.approx(np.full(n * (n + m), 0.1))
    slopes, h = tolerance.slopes.reshape(-1, n, n + m), 1e-6
    for (i, j), slope in zip(np.ndindex(n, n), slopes, strict=False):
        moved = A.copy()
        moved[i, j] *= 1 + h
        gained = zoh(Matrices(moved, B, C), TS)
        assert slope == pytest.approx(
            (np.hstack(gained[:2]) - np.hstack(zoh(flow.linear, TS)[:2])) / h, rel=1e-4, abs=1e-7
        )
    for (i, j), slope in zip(np.ndindex(n, m), slopes[n * n :], strict=True):
        assert slope[:, n + j] == pytest.approx(
            np.linalg.solve(A, expm(A * TS) - np.eye(n))[:, i] * B[i, j], rel=1e-6, abs=1e-12
        )


def test_rows_that_only_say_that_one_state_moves_another_are_exact() -> None:
    assert read_tolerance(MODEL, 0.1).std.size == 3  # a_0, a_1 and b of (39)
    assert read_tolerance(MODEL, {"A[1,0]": 0.2}).std == pytest.approx([0.2])
    assert read_tolerance(MODEL, 0.0).slopes.shape == (0, 3)


def test_the_time_scale_is_a_quarter_period() -> None:
    assert time_scale(linear([[0, 1], [-4, -0.1]], [[0], [1]], [[1, 0]]).linear) == pytest.approx(
        np.pi / 4
    )
    assert time_scale(linear([[0, 1], [0, -4]], [[0], [1]], [[1, 0]]).linear) == pytest.approx(
        np.pi / 8
    )


# --- What bias hides


def test_bias_and_centre_are_reported_as_indistinguishable() -> None:
    """Twin worlds: centre 0.35 and no bias, or symmetric and a bias.

    The same readings, whatever is believed; the prior decides.
    """
    prior_options = {"bias": 0.35, "calibrated": 0.0, "tolerance": 0.1, "x_std": [10.0, 10.0]}
    options = Censored(**EXACT | prior_options)
    u = tones(30.0, 8.0)
    shifted = watch(options, MODEL, zone(right=1.3, left=0.6), u, np.array([0.5, 0.0]))
    biased = watch(
        options, MODEL, zone(right=0.95, left=0.95), u, np.array([0.15, 0.0]), bias=-0.35
    )
    assert np.concatenate(shifted) == pytest.approx(np.concatenate(biased), abs=1e-9)
    assert shifted.width_std < 0.01
    assert shifted.right + shifted.left == pytest.approx(1.9, abs=4 * shifted.width_std[0])
    # The readings only show the sum of centre and what a bias adds to z (gain 1 of (39)):
    # two Gaussian priors, one sum.
    prior = PRIOR / np.sqrt(2)
    assert centre_std(shifted) == pytest.approx(prior * 0.35 / np.hypot(prior, 0.35), rel=1e-3)


def test_a_calibrated_input_is_a_mixture_for_display_only() -> None:
    """Displayed are the odds of two Gaussian beliefs about the centre c, by Bayes.

    The readings determine only s = c + bias. The stored belief is as without.
    """
    u, x, where = tones(30.0, 8.0), np.array([0.5, 0.0]), zone(right=1.1, left=0.8)
    wide, small, mixed = (
        watch(Censored(**EXACT | options, x_std=[10.0, 10.0]), MODEL, where, u, x)
        for options in (
            {"bias": 0.8, "calibrated": 0.0},
            {"bias": 0.008, "calibrated": 0.0},
            {"bias": 0.8, "calibrated": 0.7},
        )
    )
    centres = [float(estimate.right[0] - estimate.left[0]) / 2 for estimate in (wide, small, mixed)]
    prior = PRIOR / np.sqrt(2)
    apparent_centre = centres[1] * (prior**2 + 0.008**2) / prior**2  # what readings show of s
    chances = [
        weight * np.exp(-(apparent_centre**2) / (prior**2 + rms**2) / 2) / np.hypot(prior, rms)
        for weight, rms in ((0.3, 0.8), (0.7, 0.008))
    ]
    share = chances[1] / sum(chances)
    assert 0.8 < share < 1
    assert centres[2] == pytest.approx(
        share * centres[1] + (1 - share) * centres[0], rel=1e-2
    )  # the ranges cut a little off
    variance = (
        share**2 * centre_std(small) ** 2
        + (1 - share**2) * centre_std(wide) ** 2
        + share * (1 - share) * (centres[0] - centres[1]) ** 2
    )
    assert centre_std(mixed) ** 2 == pytest.approx(variance, rel=0.05)


@pytest.mark.parametrize("tolerance", [0.0, 0.1])
def test_an_input_that_is_known_shows_the_centre(tolerance: float) -> None:
    estimate = watch(
        Censored(**EXACT | {"tolerance": tolerance}),
        MODEL,
        zone(right=1.3, left=0.6),
        tones(30.0, 8.0),
        np.array([0.5, 0.0]),
    )
    assert centre_std(estimate) < 0.01
    assert abs((estimate.right - estimate.left) / 2 - 0.35) < 4 * centre_std(estimate)


def test_a_wrong_model_is_found_out() -> None:
    """The plant's A[1,0] is 10 % stiffer than the model's.

    With that tolerance the widths are right, without it confidently wrong where all readings are
    taken for right.
    """
    plant, where = (
        sample_plant(linear([[0, 1], [-1.1, -2]], [[0], [1]], [[1, 0]]), TS),
        zone(right=1.3, left=0.6, noise=0.01),
    )
    rng, u, x = np.random.default_rng(2), tones(30.0, 8.0), np.array([0.5, 0.0])
    errors = []
    for tolerance in (0.0, {"A[1,0]": 0.1}):
        options = EXACT | {"tolerance": tolerance, "glitches": 0.0}
        observer = Censored(**options).build(MODEL, where)
        step, state, z = OnNumbers(observer, MODEL), observer.init(observer.params), x
        for drive in u:
            y = sensor.deadzone(plant.linear.C @ z, where.right, where.left) + 0.01 * rng.normal(
                size=1
            )
            state, estimate = step(state, drive, y, sensor.side(y, where.threshold))
            z = plant.linear.A @ z + plant.linear.B @ drive
        errors.append(np.abs(estimate.right - 1.3)[0] / estimate.right_std[0])
    assert errors[0] > 10
    assert errors[1] < 3


# --- What silence tells


def test_an_edge_that_is_not_reached_is_beyond_what_was() -> None:
    """z swings to +-1.2 inside edges at 1.5.

    Then d_r, d_l are somewhere between there and the end of their range.
    """
    u = tones(20.0, 2.5)
    t_end = watch(
        Censored(**EXACT, x_std=0.01), MODEL, zone(right=1.5, left=1.5, noise=0.01), u, np.zeros(2)
    )
    plain = watch(
        Kalman(right=RANGE, x_std=0.01),
        MODEL,
        zone(right=1.5, left=1.5, noise=0.01),
        u,
        np.zeros(2),
    )
    assert plain.right_std == pytest.approx(PRIOR)
    for width, std in ((t_end.right, t_end.right_std), (t_end.left, t_end.left_std)):
        assert 1.15 < width < 2.0
        assert 0.15 < std < 0.9 * PRIOR
        assert abs(width - 1.5) < 2 * std


def test_a_missing_sample_is_not_a_silent_one() -> None:
    observer = Censored(**EXACT, x_std=0.01).build(MODEL, zone(noise=1e-3))
    step = OnNumbers(observer, MODEL)
    state = observer.init(observer.params)
    moved = np.array([1.9, 0.0, *state.filter.mean[2:]])
    state = state._replace(filter=state.filter._replace(mean=moved))
    missing, silent = (step(state, [0.0], [y], [0.0])[1] for y in (float("nan"), 0.0))
    assert missing.right_std == pytest.approx(PRIOR)
    assert silent.right_std < 0.6 * PRIOR
    assert silent.right > 1.8


def test_a_jump_sensor_bounds_its_edges_from_both_sides() -> None:
    estimate = watch(
        Censored(**EXACT),
        MODEL,
        zone(right=1.3, left=0.6, kind="jump"),
        tones(20.0, 8.0),
        np.array([0.5, 0.0]),
    )
    for width, std, truth in (
        (estimate.right, estimate.right_std, 1.3),
        (estimate.left, estimate.left_std, 0.6),
    ):
        assert std < 0.5 * PRIOR
        assert abs(width - truth) < 3 * std


# --- Claims against the truth


@pytest.mark.parametrize("reach", coverage.REACHES)
def test_intervals_cover_the_truth_over_random_problems(reach: str) -> None:
    """60 problems with disturbance, bias and model error.

    Coverage within three standard errors of 95 %, or more; NEES near 1.
    """
    outcome = coverage.observe(
        coverage.censored, coverage.problems(reach, coverage.WORLDS["disturbed"], 2, 60, 8)
    )
    assert outcome.covered().min() > 0.865
    assert outcome.nees() == pytest.approx(1.0, abs=4 / np.sqrt(60))
    assert reach == "no edge" or outcome.nis == pytest.approx(1.0, abs=0.05)


def test_intervals_fail_if_a_coloured_disturbance_is_modelled_as_white() -> None:
    """What the disturbance model is for: the same problems with `kalman` as in textbooks."""
    outcome = coverage.observe(
        trusting(coverage.kalman),
        coverage.problems("both edges", coverage.WORLDS["disturbed"], 2, 120, 8),
    )
    assert outcome.covered().max() < 0.8


def test_two_outputs_and_two_inputs_in_the_loop() -> None:
    run = simulate(
        scene(
            """
            plant.A = [[-1.0, 0.5], [-0.5, -2.0]]
            plant.B = [[1.0, 0.0], [0.0, 1.0]]
            plant.C = [[1.0, 0.0], [0.2, 1.0]]
            plant.x0 = [0.5, -0.5]
            sensor = { right = [0.8, 0.5], left = [0.6, 1.0], noise = [0.01, 0.02] }
            reference = { kind = "sine", amplitude = [3.0, 2.0], frequency = 0.5 }
            disturbance = { kind = "random", rms = [0.5, 0.3], correlation_time = 0.2 }
            controller = { method = "state_feedback", poles = [-4.0, -5.0] }
            simulation = { time = "sampled", step = 0.01, duration = 20.0 }
            """,
            observer={
                "method": "censored",
                "right": [[0.3, 1.2], [0.2, 1.5]],
                "disturbance": [0.5, 0.3],
                "correlation_time": 0.2,
            }
            | {"bias": 0.0, "tolerance": 0.0, "drift": 0.0},
        )
    )
    assert run.d_std is not None
    assert (run.d_std[-1] < 0.1).all()
    assert (np.abs(run.d_hat[-1] - [0.8, 0.6, 0.5, 1.0]) < 3.5 * run.d_std[-1]).all()


# --- Several claims at once


def drawn(
    model: System, where: Zone, rms: float, seconds: float, seed: int
) -> tuple[Floats, Floats]:
    """(u, y) of the model's own motion under tones and a first-order disturbance.

    The disturbance has that rms and a correlation time of 0.2 s.
    """
    rng, F = np.random.default_rng(seed), np.exp(-TS / 0.2)
    u = tones(seconds, 8.0)
    x, w, readings = np.array([0.5, 0.0]), 0.0, []
    for drive in u:
        readings.append(
            sensor.deadzone(model.linear.C @ x, where.right, where.left) + 0.01 * rng.normal(size=1)
        )
        w = F * w + np.sqrt(1 - F**2) * rms * rng.normal()
        x = model.linear.A @ x + model.linear.B @ (drive + w)
    return u, np.array(readings)


def fed(options: Any, where: Zone, u: Floats, y: Floats) -> tuple[list[Any], list[Estimate]]:
    """(states, estimates) of a filter along inputs and readings."""
    observer = options.build(MODEL, where)
    step, states, estimates = OnNumbers(observer, MODEL), [observer.init(observer.params)], []
    for drive, reading in zip(u, y, strict=True):
        after, estimate = step(states[-1], drive, reading, sensor.side(reading, where.threshold))
        states.append(after)
        estimates.append(estimate)
    return states, estimates


@pytest.mark.parametrize("level", [0, 1, 2])
def test_the_readings_tell_how_strong_the_disturbance_is(level: int) -> None:
    where = zone(noise=0.01)
    u, y = drawn(MODEL, where, 4.0 * 4 / 4**level, 20.0, 5)
    states, _ = fed(Censored(**EXACT | {"disturbance": 4.0}, correlation_time=0.2), where, u, y)
    assert states[-1].filter.odds.argmax() == level


def test_the_displayed_estimate_is_the_mixture_by_bayes() -> None:
    """Shares, means and variances from the members' own innovations.

    Each member is run by itself, but for its disturbance at the start.
    """
    where = zone(noise=0.01)
    u, y = drawn(MODEL, where, 1.0, 2.0, 3)
    common = EXACT | {"correlation_time": 0.2}
    members = [
        fed(Censored(**common | {"disturbance": 2.0 / 4**k}, levels=1), where, u, y)[1]
        for k in range(2)
    ]
    _, mixed = fed(Censored(**common | {"disturbance": 2.0}, levels=2), where, u, y)
    log = np.zeros((len(u), 2))
    for k, estimates in enumerate(members):
        e, std = (
            np.array([getattr(one, name)[0] for one in estimates])
            for name in ("innovation", "innovation_std")
        )
        log[:, k] = np.cumsum(np.where(e != 0, norm.logpdf(e, scale=std), 0.0))
    share = np.exp(log - log.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    assert ((share > 0.2).all(axis=1)).any()
    for at in (0, 20, 60, len(u) - 1):
        x, std = (
            np.array([getattr(estimates[at], name)[0] for estimates in members])
            for name in ("x", "x_std")
        )
        mean = share[at] @ x
        assert mixed[at].x[0] == pytest.approx(mean, rel=0.01)
        narrow = share[at, 1] ** 2  # both of two levels that are drawn
        within = (1 - narrow) * std[0] ** 2 + narrow * std[1] ** 2
        variance = within + share[at] @ (x - mean) ** 2
        assert mixed[at].x_std[0] ** 2 == pytest.approx(variance, rel=0.01)


@given(st.floats(-3, 3), st.floats(0.05, 5))
@example(mean=2.0, std=0.25)
def test_a_mean_inside_a_range_is_that_of_the_truncated_normal_distribution(
    mean: float, std: float
) -> None:
    P = np.array([[std**2, 0.3 * std], [0.3 * std, 1.0]])
    found = gaussian.truncate_to_range(ca.SX(mean), ca.SX(P[0, 0]), -0.5, 1.0)
    move, lost, chance = (np.asarray(ca.evalf(ca.SX(part)).full())[0, 0] for part in found)
    m = np.array([[mean], [0.0]]) + move * P[:, :1]
    cov = P - lost * P[:, :1] @ P[:1]
    a, b = (-0.5 - mean) / std, (1.0 - mean) / std
    within = norm.cdf(b) - norm.cdf(a)
    assert chance == pytest.approx(within, rel=1e-6, abs=1e-12)
    if within < gaussian.UNLIKELY:  # a range that the data contradict
        assert move == lost == 0.0
        return
    expected, variance = truncnorm.stats(a, b, loc=mean, scale=std)
    assert m[0, 0] == pytest.approx(expected, abs=1e-6)
    assert cov[0, 0] == pytest.approx(variance, rel=1e-4, abs=1e-7)
    assert m[1, 0] == pytest.approx(0.3 / std * (expected - mean), abs=1e-5)


def test_a_range_that_is_surely_wrong_is_not_insisted_upon() -> None:
    """Widths 2.6 and 2.4 where at most 2 is declared.

    The estimates stay on its edge, say that a claim is wrong, and hold the truth.
    """
    estimate = watch(
        Censored(**EXACT),
        MODEL,
        zone(right=2.6, left=2.4, noise=0.01),
        tones(30.0, 12.0),
        np.zeros(2),
        noise=np.zeros((1500, 1)),
    )
    assert not estimate.consistent
    for width, std, truth in (
        (estimate.right, estimate.right_std, 2.6),
        (estimate.left, estimate.left_std, 2.4),
    ):
        assert width == 2.0
        assert truth - 2.0 < 1.96 * std < 2.0


# --- In the loop


def closed(observer: dict[str, Any], **changes: Any) -> Run:
    tables: dict[str, Any] = tables_of("""
        sensor = { right = 1.3, left = 0.9, noise = 0.01 }
        controller = { method = "state_feedback", poles = [-8.0, -9.0] }
        simulation = { time = "sampled", step = 0.01, duration = 20.0 }
        """) | {"observer": {"method": "censored", "right": RANGE} | observer}
    return simulate(scene(**tables | changes))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_what_the_model_leaves_out_is_countered_at_rest(n: int) -> None:
    rng = np.random.default_rng(n)
    flow = random_plant(rng, n)
    for model in (flow, sample_plant(flow, TS)):
        at_rest = rest_response(model)
        A, B, C = flow.linear
        assert A @ at_rest[:n] + B @ at_rest[n:] == pytest.approx(-np.eye(n), abs=1e-9)
        assert C @ at_rest[:n] == pytest.approx(np.zeros((1, n)), abs=1e-9)


def test_what_it_knows_of_the_disturbance_reaches_the_controller() -> None:
    changes = tables_of("""
        disturbance = { kind = "sine", amplitude = 4.0, frequency = 0.3 }
        sensor = { right = 1.1, left = 1.1, noise = 0.01 }
        """)
    with_it, without = (
        closed(
            {"disturbance": 3.0, "correlation_time": 0.3},
            **changes,
            controller={"method": "state_feedback", "poles": [-8.0, -9.0], "reject": reject},
        )
        for reject in (True, False)
    )
    assert with_it.w_hat is not None
    truth = 4.0 * np.sin(2 * np.pi * 0.3 * with_it.t)
    assert np.corrcoef(with_it.w_hat[500:, 1], truth[500:])[0, 1] > 0.9
    assert with_it.rms_tracking < 0.7 * without.rms_tracking


def test_ranges_alone_do_with_a_wrong_model() -> None:
    """Nothing but the ranges is declared.

    Stiffness and damping are a fifth larger than the model's.
    """
    changes = tables_of("""
        plant.A = [[0.0, 1.0], [-1.2, -2.4]]
        plant.B = [[0.0], [1.0]]
        plant.C = [[1.0, 0.0]]
        plant.x0 = [0.5, 0.0]
        model = { A = [[0.0, 1.0], [-1.0, -2.0]] }
        """)
    doubting, sure = (
        closed({}, **changes),
        closed(dict.fromkeys(("disturbance", "bias", "tolerance", "drift"), 0.0), **changes),
    )
    assert doubting.rms_tracking < 0.5 * sure.rms_tracking
    assert doubting.d_std is not None
    assert (np.abs(doubting.d_hat[-1] - [1.3, 0.9]) < 3 * doubting.d_std[-1]).all()


UNSTABLE = tables_of("""
A = [[0.0, 1.0], [1.0, -0.5]]
B = [[0.0], [1.0]]
C = [[1.0, 0.0]]
""")


@pytest.mark.parametrize("plant", [{"integrators": 2}, UNSTABLE], ids=["integrators", "unstable"])
def test_plants_that_are_not_stable_do_not_drift(plant: dict[str, Any]) -> None:
    """A chain of integrators hides the centre: its estimate stays within its claim for a minute.

    The width is found.
    """
    run = closed(
        {},
        plant=plant | {"x0": [0.3, 0.0]},
        simulation={"time": "sampled", "step": 0.01, "duration": 60.0},
    )
    assert run.d_std is not None
    assert run.width_std is not None
    late = run.t > 20.0
    right, left = run.d_hat[late].T
    assert (np.abs(run.d_hat[late] - [1.3, 0.9]) < 2.5 * run.d_std[late]).all()
    assert (np.abs(right + left - 2.2) < 0.2).all()
    assert np.ptp(right - left) < 0.3
    assert np.abs(run.z - run.z_hat)[late].max() < 0.6


def test_twenty_seconds_at_1_khz_leave_every_covariance_positive() -> None:
    """Little noise, long prior: the worst for rounding.

    And one absurd reading neither overflows nor is for ever.
    """
    problem = resolve_scenario(
        scene(
            """
            sensor = { right = 1.3, left = 0.9, noise = 0.0001 }
            simulation = { time = "sampled", step = 0.001, duration = 20.0 }
            """,
            observer={"method": "censored", "right": RANGE, "x_std": 100.0},
        )
    )
    loop, state, exogenous = prepare(problem)
    noise_column = tree.number_addresses(loop.instant).index("after[0]")
    exogenous[8_000, noise_column] = 1e8
    out, last = interpret.run_interpreted(loop.step, state, exogenous, tree.pack_tree(loop.params))
    assert np.isfinite(out).all()
    sizes = [np.size(leaf) for _, leaf in tree.iterate_leaves(loop.state)]
    leaves = np.split(last, np.cumsum(sizes)[:-1])
    covariances = [
        leaf
        for leaf, (name, _) in zip(leaves, tree.iterate_leaves(loop.state), strict=True)
        if name.endswith(".cov")
    ]
    assert len(covariances) == 3
    for column in covariances:
        size = int(np.sqrt(2 * column.size))
        P = np.zeros((size, size))
        P.T[np.tril_indices(size)] = column
        P = P + np.triu(P, 1).T
        scale = np.sqrt(np.diag(P))
        assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-9


# --- Wrong input


def test_tolerance_of_a_nonlinear_plant_is_one_number() -> None:
    pendulum = system(
        Plant(states=["a", "w"], f=["w", "-g * sin(a) - w + u"], h=["a"], parameters={"g": 9.81})
    )
    with pytest.raises(InputError, match="takes one number"):
        Censored(right=RANGE, tolerance={"A[1,0]": 0.1}).build(sample_plant(pendulum, TS), zone())
    observer = Censored(**EXACT | {"tolerance": 0.1}).build(sample_plant(pendulum, TS), zone())
    assert len(observer.init(observer.params).filter.mean) == 2 + 2 + 1


# --- Its parts


def test_a_small_bias_is_a_prior_a_hundred_times_narrower() -> None:
    """Where nothing has been read yet: its variance is (SMALL b)^2, and the odds stay."""
    rms = 0.7
    colour, none = build_colour(0.5, TS), np.zeros(1)
    augmentation = build_unknown_inputs(
        MODEL, colour, none, np.array([rms]), 0.8, read_tolerance(MODEL, 0.0)
    )
    assert augmentation.alternative is not None
    params = Params(*[None] * 10)._replace(augmentation=augmentation.params)
    cov = ca.diag(ca.SX([1.0, 2.0, 0.1, 0.1, rms**2]))
    belief, odds = augmentation.alternative(params, gaussian.Gaussian(ca.SX.zeros(5), cov))
    assert float(ca.DM(belief.cov[4, 4])) == pytest.approx((SMALL * rms) ** 2)
    assert float(ca.DM(odds)) == pytest.approx(0.8 / 0.2)


def test_a_bias_leads_to_the_rest_that_it_says() -> None:
    at_rest = bias_rest_state(MODEL, np.eye(1))
    assert MODEL.linear.A @ at_rest + MODEL.linear.B == pytest.approx(at_rest)


def test_slopes_of_a_sampled_model_are_its_derivatives() -> None:
    """Against differences of the exact zero-order hold, for an entry of A and one of B."""
    A, B, C = PAPER_PLANT.linear
    entries, Ts, h = [(1, 0), (1, 2)], 0.1, 1e-6
    slopes = zoh_entry_slopes(np.hstack([A, B]), entries, Ts).reshape(2, 2, 3)
    for slope, at in zip(slopes, entries, strict=True):
        ends = []
        for change in (1 + h, 1 - h):
            AB = np.hstack([A, B])
            AB[at] *= change
            ends.append(np.hstack(zoh(Matrices(AB[:, :2], AB[:, 2:], C), Ts)[:2]))
        assert slope == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-8)


def test_a_mixture_spreads_by_its_parts_and_by_what_lies_between() -> None:
    share, means, stds = np.array([0.25, 0.75]), [1.0, 3.0], [0.5, 0.2]
    mean = 0.25 * 1.0 + 0.75 * 3.0
    square = 0.25 * (0.5**2 + 1.0**2) + 0.75 * (0.2**2 + 3.0**2)
    assert mean_of_models(share, means) == pytest.approx(mean)
    std = float(mixture_std(share, share, means, stds))
    assert std == pytest.approx(np.sqrt(square - mean**2))


@pytest.mark.parametrize("shares", [[1, 1, 1], [0.2, 0.5, 0.3], [0.05, 0.05, 0.9], [1, 0, 0]])
def test_intervals_of_ambiguous_levels_hold_95_percent(shares: list[float]) -> None:
    """Of the mixture of N(0, 1), N(0, 1 / 16), N(0, 1 / 256)."""
    share, stds = np.array(shares) / np.sum(shares), np.array([1.0, 1 / 4, 1 / 16])
    wide = wider_component_weights(ca.SX(share))
    assert float(ca.sum1(wide)) == pytest.approx(1.0)
    std = float(mixture_std(ca.SX(share), wide, [0.0] * 3, stds))
    probability = share @ (2 * norm.cdf(1.96 * std / stds) - 1)
    assert 0.949 <= probability <= 0.985


def test_levels_lie_about_the_given_value_and_wider_about_the_default(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As the members of the bank take the variance of the disturbance."""

    def levels(member: Any, variants: Any) -> Any:
        found.append([variant(member.params).augmentation.variance[0] for variant in variants])
        return member

    found: list[list[float]] = []
    monkeypatch.setattr(multiple_models, "build_multiple_models", levels)
    disturbance_alone: dict[str, Any] = {"disturbance": 1.0}
    for options in (disturbance_alone, disturbance_alone | {"levels": 2}, {}):
        Censored(right=[0, 2], **options).build(MODEL, zone())
    stds = [np.sqrt(variances) for variances in found]
    np.testing.assert_allclose(stds[0], [4, 1, 1 / 4])
    np.testing.assert_allclose(stds[1], [1, 1 / 4])
    np.testing.assert_allclose(stds[2] / stds[2][0], [1, 0.5**0.5 / 4, 1 / 32])


@pytest.mark.parametrize("narrow", [1e-6, 0.1, 1.0])
@pytest.mark.parametrize("share", [0.05, 0.3, 0.7, 0.85, 0.95])
@pytest.mark.parametrize("gap", [0.0, 0.5])
def test_intervals_of_an_ambiguous_bias_hold_95_percent(
    narrow: float, share: float, gap: float
) -> None:
    """Of the mixture of N(gap, narrow^2) and N(0, 1), in the middle of which they lie."""
    stronger, weaker = (
        gaussian.Gaussian(ca.SX(m), ca.SX(s**2)) for m, s in ((gap, narrow), (0.0, 1.0))
    )
    mixture = mix_two_gaussians(stronger, weaker, share)
    mean, std = float(mixture.mean), float(mixture.cov) ** 0.5

    def below(x: float) -> float:
        return float(share * norm.cdf((x - gap) / narrow) + (1 - share) * norm.cdf(x))

    probability = below(mean + 1.96 * std) - below(mean - 1.96 * std)
    assert 0.949 <= probability <= 0.985


def test_deviations_never_exceed_those_of_the_prior_ranges() -> None:
    """A width known to 6 mm drifted by what suits all that the sensor hides: 24 mm in 200 s."""
    narrow = Censored(right=[0.997, 1.003])
    seen = watch(narrow, MODEL, zone(noise=0.005), np.zeros((1000, 1)), np.zeros(2))
    assert seen.right_std.max() <= 0.006 / np.sqrt(12) * (1 + 1e-9)
    wide = Censored(right=[0.0, 1.0])
    seen = watch(wide, MODEL, zone(noise=0.005), np.zeros((1000, 1)), np.zeros(2))
    assert seen.right_std.max() <= 1.0 / np.sqrt(12) * (1 + 1e-9)


# --- Left and right, ahead and behind


@given(seed=seeds)
@settings(max_examples=5, deadline=None)
def test_mirrored_problems_have_mirrored_answers(seed: int) -> None:
    """Under all defaults, of readings on both sides, silent, wrong and missing ones."""
    rng = np.random.default_rng(seed)
    u = 10 * np.sin(0.05 * np.arange(200) + rng.uniform(0, 6))
    y = np.clip(rng.normal(size=200).cumsum() / 4, -2, 2)
    y = np.where(np.abs(y) < 0.5, 0.01 * rng.normal(size=200), y)
    y[::17], y[::31] = np.nan, 20.0
    plant = uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0])
    known_sensor = uz.Sensor(right=1.0, left=1.0, noise=0.01)
    here, there = (uz.Online(Censored(right=[0.0, 2.0]), plant, known_sensor, TS) for _ in range(2))
    for k in range(200):
        one, other = here.update(y[k], u[k]), there.update(-y[k], -u[k])
        scale = 1 + abs(one.z[0])
        assert one.z[0] == pytest.approx(-other.z[0], abs=1e-12 * scale, rel=1e-11)
        assert one.right[0] == pytest.approx(other.left[0], abs=1e-12, rel=1e-11)
        assert one.left_std[0] == pytest.approx(other.right_std[0], abs=1e-12, rel=1e-11)
        assert one.x_std == pytest.approx(other.x_std, rel=1e-9)


def gate_of(options: Any, **sensor: Any) -> float:
    """|y| that the filter takes for silent, at most."""
    observer = options.build(MODEL, zone(**sensor))
    return float(observer.params.gate[0])


def test_noise_ahead_of_the_zone_makes_no_silent_sensor_read() -> None:
    """So it is not gated, unless silence is not heard and readings alone would choose its sign."""
    hearing, deaf = Censored(right=RANGE), Censored(right=RANGE, silence=False)
    assert gate_of(hearing, noise_before=0.1) == 0.0
    assert gate_of(hearing, noise_before=0.1, noise=0.01) == gate_of(hearing, noise=0.01)
    assert gate_of(deaf, noise_before=0.1) == pytest.approx(0.4)
    assert gate_of(uz.Kalman(right=RANGE), noise_before=0.1) == pytest.approx(0.4)
    assert gate_of(Censored(right=RANGE, noise=0.1), noise_before=0.1) == pytest.approx(0.4)


def test_a_long_correlation_makes_no_filter_deaf() -> None:
    """An edge rests for a quarter period at most, and for a 25th at least."""

    def rest(**options: Any) -> float:
        return float(Censored(right=RANGE, **options).build(MODEL, zone(noise=0.01)).params.rest)

    quarter = time_scale(MODEL.flow, TS) / TS
    assert rest(correlation_time=1e3) == rest(correlation_time=1e3, disturbance=0.0)
    assert rest(correlation_time=1e3) == pytest.approx(quarter)
    assert rest(correlation_time=0.6) == pytest.approx(30)
    assert rest(correlation_time=TS) == round(0.16 * quarter)
