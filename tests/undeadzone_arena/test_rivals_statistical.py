"""EKF, UKF, Tobit, particle filter, moving horizon.

Where they must coincide with Kalman, filterpy or least squares, and where they fail.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from benchmarks.filters import coverage
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import norm

import undeadzone_arena.unscented as unscented
from requirements import import_package
from scenes import (
    PAPER_PLANT,
    OnNumbers,
    linear,
    random_plant,
    scene,
    seeds,
    tables_of,
    zone,
)
from undeadzone.errors import InputError
from undeadzone.interfaces import (
    COLUMNS,
    Estimate,
    Observer,
    PythonObserver,
    Reading,
    Traits,
    build_python_observer,
)
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.numerics.gaussian import TAIL, from_upper_entries, to_upper_entries
from undeadzone.observers import Kalman
from undeadzone.observers.filtering.augmented_state import (
    power_of_two_units,
    quarter_period,
    white_disturbance_rms,
)
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation import sample_by_sample as live
from undeadzone.simulation.online import Online
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_arena import EKF, UKF, MovingHorizon, ParticleFilter, Tobit
from undeadzone_arena.observers import particle
from undeadzone_arena.observers.particle import systematic_indices, update_particle_weights
from undeadzone_arena.observers.parts import window as horizon
from undeadzone_arena.observers.parts.joint_claims import (
    CROWD,
    JointAssumptions,
    JointDefaults,
    build_joint_prior,
    glitch_probability,
)
from undeadzone_arena.observers.parts.window import Affine, HorizonWeights, Window

TS = 0.05
MODEL = sample_plant(PAPER_PLANT, TS)
ALL = [EKF, UKF, Tobit, ParticleFilter, MovingHorizon]
PENDULUM = tables_of("""
states = ["angle", "rate"]
inputs = ["u"]
f = ["rate", "-9.81 * sin(angle) - 0.5 * rate + u"]
h = ["angle"]
x0 = [0.5, 0.0]
""")
SAMPLED = {"time": "sampled", "step": 0.01, "duration": 6.0}


def full(column: Floats, size: int) -> Floats:
    """The symmetric matrix of a triangle."""
    return np.asarray(ca.DM(ca.triu2symm(ca.DM(ca.Sparsity.upper(size), column))).full())


def follow(observer: Observer, ys: Floats, us: Floats, sides: Floats, seed: int = 0) -> list[Any]:
    """The estimates along readings and inputs."""
    how = observer.python
    assert how is not None
    state, estimates = how.start(seed), []
    for y, u, side in zip(ys, us, sides, strict=True):
        state, estimate = how.correct(state, Reading(np.atleast_1d(y), np.atleast_1d(side)))
        state = how.predict(state, np.atleast_1d(u))
        estimates.append(estimate)
    return estimates


# --- Kalman's filter where the side is known and the model linear


def same_but_for_ranges(ours: Estimate, kalmans: Estimate, tolerance: float) -> None:
    """Equal estimates; Kalman's widths are shown in their claimed ranges."""
    inside = {name: np.clip(getattr(ours, name), 0.5, 2.0) for name in ("right", "left")}
    for name in ("x", "z", "innovation", "x_std", "right_std", "left_std", "width_std"):
        expected = getattr(kalmans, name)
        assert getattr(ours, name) == pytest.approx(expected, rel=tolerance, abs=1e-9), name
    for name, width in inside.items():
        assert width == pytest.approx(getattr(kalmans, name), rel=tolerance, abs=1e-9)


def same_belief(ours: Any, kalmans: Any, tolerance: float) -> None:
    """Equal means and covariances."""
    assert ours.mean == pytest.approx(kalmans.mean, rel=tolerance, abs=1e-9)
    assert ours.cov == pytest.approx(kalmans.cov, rel=tolerance, abs=1e-9)


@given(seeds, st.integers(1, 3), st.integers(1, 2))
@settings(max_examples=15)
def test_the_measured_ekf_is_kalmans_filter_far_from_the_zone(seed: int, n: int, p: int) -> None:
    rng = np.random.default_rng(seed)
    model, where = sample_plant(random_plant(rng, n, 1, p), TS), zone(p, slope=2.0)
    assumptions: dict[str, Any] = {
        "right": [0.5, 2.0],
        "noise": 0.1,
        "x_std": 2.0,
        "disturbance": 0.7,
        "drift": 0.1,
    }
    ours, theirs = (
        EKF(**assumptions, glitches=0.0, mode="measured").build(model, where),
        Kalman(**assumptions, glitches=0.0).build(model, where),
    )
    one, other = OnNumbers(ours, model), OnNumbers(theirs, model)
    s, t = ours.init(ours.params), theirs.init(theirs.params)
    for _ in range(10):
        u, y = rng.normal(size=1), 2 * rng.choice([-1, 1], p) * rng.uniform(3, 9, p)
        (s, estimate), (t, expected) = one(s, u, y, np.sign(y)), other(t, u, y, np.sign(y))
        same_but_for_ranges(estimate, expected, 1e-9)
        same_belief(s.filter, t.filter, 1e-9)


@pytest.mark.parametrize(
    "options",
    [
        EKF(right=[0.5, 2.0]),
        Tobit(right=[0.5, 2.0]),
        UKF(right=[0.5, 2.0]),
        UKF(right=[0.5, 2.0], alpha=0.6, kappa=2.0),
    ],
)
@given(seed=seeds)
@settings(max_examples=5)
def test_filters_on_the_dead_zone_are_kalmans_filter_while_belief_and_readings_stay_on_a_side(
    options: EKF | Tobit | UKF, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    model, where = sample_plant(random_plant(rng, 2, 1, 2), 0.01), zone(2)
    assumptions: dict[str, Any] = {
        "right": [0.5, 2.0],
        "noise": 0.1,
        "x_std": 0.3,
        "disturbance": 0.7,
        "drift": 0.1,
    }
    rival = msgspec.structs.replace(options, **assumptions, glitches=0.0).build(model, where)
    kalman = Kalman(**assumptions, glitches=0.0).build(model, where)
    x = np.linalg.solve(model.linear.C, np.array([40.0, -40.0]))
    s, t = rival.init(rival.params), kalman.init(kalman.params)
    mean = np.concatenate([x / power_of_two_units(model), s.filter.mean[2:]])
    s = s._replace(filter=s.filter._replace(mean=mean))
    t = t._replace(filter=t.filter._replace(mean=mean))
    one, other = OnNumbers(rival, model), OnNumbers(kalman, model)
    for _ in range(10):
        z, u = model.linear.C @ x, rng.normal(size=1)
        y = sensor.deadzone(z, where.right, where.left) + 0.1 * rng.normal(size=2)
        assume((np.abs(z) > 15).all())
        (s, estimate), (t, expected) = one(s, u, y, np.sign(y)), other(t, u, y, np.sign(y))
        x = model.linear.A @ x + model.linear.B @ u
        # Innovations are Kalman's too, but the UKF's come of sums: to rounding.
        same_but_for_ranges(estimate, expected, 1e-7)
        same_belief(s.filter, t.filter, 1e-7)


# --- Tobit


@pytest.mark.parametrize("z", [-2.5, -0.9, 0.2, 1.1, 3.0])
def test_tobit_foretells_the_mean_of_the_reading_over_both_branches(z: float) -> None:
    """Beside a million draws of z, the edges and the noise; the covariance loses S K K'."""
    assumptions: dict[str, Any] = {"right": [0.5, 1.5], "noise": 0.2, "x_std": 0.7, "drift": 0.0}
    model = sample_plant(system(Plant(A=[[-1.0]], B=[[1.0]], C=[[1.0]])), TS)
    observer = Tobit(**assumptions, disturbance=0.0, glitches=0.0).build(model, zone())
    units = power_of_two_units(model)
    s = observer.init(observer.params)
    s = s._replace(filter=s.filter._replace(mean=np.array([z / units[0], 1.0, 1.0])))
    cov = full(s.filter.cov, 3)
    _, estimate = OnNumbers(observer, model)(s, np.zeros(1), np.array([0.4]), np.ones(1))

    rng = np.random.default_rng(1)
    std = np.sqrt(np.diag(cov)) * np.append(units, [1.0, 1.0])
    drawn = np.array([z, 1.0, 1.0])[:, None] + std[:, None] * rng.standard_normal((3, 1_000_000))
    v = 0.2 * rng.standard_normal(1_000_000)
    right, left = drawn[0] + v - drawn[1], -drawn[0] + v - drawn[2]
    read = np.maximum(right, 0.0) - np.maximum(left, 0.0)
    assert estimate.innovation[0] == pytest.approx(0.4 - read.mean(), abs=5e-3)
    slope = np.array(
        [(right > 0).mean() + (left > 0).mean(), -(right > 0).mean(), (left > 0).mean()]
    )
    S = max(read.var(), float(slope**2 @ std**2) + 0.04)
    assert estimate.innovation_std[0] == pytest.approx(np.sqrt(S), rel=0.02)
    left_over = std**2 - (std**2 * slope) ** 2 / S
    found = np.array([estimate.x_std[0], estimate.right_std[0], estimate.left_std[0]])
    assert found == pytest.approx(np.sqrt(left_over), rel=0.02)


# --- UKF


@pytest.mark.parametrize(
    "plant", [PAPER_PLANT, system(Plant(**PENDULUM))], ids=["linear", "pendulum"]
)
def test_the_ukf_agrees_with_filterpy(plant: System) -> None:
    kalman = import_package("filterpy.kalman")
    rng, model = np.random.default_rng(3), sample_plant(plant, TS)
    observer = UKF(
        right=[0.5, 2.0],
        noise=0.1,
        x_std=0.5,
        disturbance=0.0,
        drift=0.1,
        alpha=0.7,
        kappa=1.0,
        glitches=0.0,
    ).build(model, zone())
    step, state = OnNumbers(observer, model), observer.init(observer.params)
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    move = ca.Function(
        "move", [x, u], [model.move(ca.SX(model.params) if model.nonlinear else model.params, x, u)]
    )

    def reading(v: Floats) -> Floats:
        return np.array([sensor.deadzone(v[0], v[2], v[3])])

    def motion(v: Floats, dt: float, u: Any) -> Floats:
        return np.concatenate([move(v[:2], u).full()[:, 0], v[2:]])

    points = kalman.MerweScaledSigmaPoints(4, 0.7, 2.0, 1.0)
    theirs = kalman.UnscentedKalmanFilter(4, 1, TS, reading, motion, points)
    units = np.concatenate([power_of_two_units(model), np.ones(2)])
    square = np.outer(units, units)
    theirs.x, theirs.P = units * state.filter.mean, square * full(state.filter.cov, 4)
    theirs.Q, theirs.R = np.diag([0.0, 0.0, 0.01 * TS, 0.01 * TS]), np.array([[0.01]])
    truth = np.array([0.3, 0.0])
    for k in range(80):
        force = 9.0 * np.cos(2.0 * k * TS)
        y = sensor.deadzone(truth[:1], 1.3, 0.6) + 0.05 * rng.normal(size=1)
        state, estimate = step(state, [force], y, sensor.side(y))
        theirs.update(y)
        assert np.concatenate([estimate.x, estimate.right, estimate.left]) == pytest.approx(
            theirs.x, rel=1e-7, abs=1e-8
        )
        assert estimate.x_std == pytest.approx(np.sqrt(np.diag(theirs.P))[:2], rel=1e-6)
        assert estimate.innovation_std == pytest.approx(np.sqrt(theirs.S[0]), rel=1e-6)
        theirs.predict(u=force)
        assert square * full(state.filter.cov, 4) == pytest.approx(theirs.P, rel=1e-6, abs=1e-8)
        truth = move(truth, force).full()[:, 0]


@given(seeds, st.integers(1, 5), st.integers(0, 5))
def test_the_factor_stands_covariances_without_full_rank(seed: int, size: int, rank: int) -> None:
    root = np.random.default_rng(seed).normal(size=(size, rank))
    column, upper = ca.SX.sym("P", size * (size + 1) // 2), ca.Sparsity.upper(size)
    factor = ca.Function(
        "factor", [column], [unscented.cholesky_factor(from_upper_entries(column, upper))]
    )
    cov = root @ root.T
    factored = factor(to_upper_entries(ca.DM(cov), upper) if size > 1 else cov[0, 0]).full()
    assert np.isfinite(factored).all()
    assert factored @ factored.T == pytest.approx(cov, abs=1e-6 * max(1.0, np.abs(cov).max()))


# --- Particle filter


def test_particles_carry_kalmans_posterior_in_the_linear_case() -> None:
    """Widths known, always the same side.

    Mean and standard deviations over 12 seeds against the exact ones.
    """
    rng = np.random.default_rng(0)
    assumptions: dict[str, Any] = {
        "right": [1.0, 1.0 + 1e-6],
        "noise": 0.5,
        "x_std": 6.0,
        "disturbance": 4.0,
        "drift": 0.0,
    }
    count, runs = 25, 12
    ys, us = 7.0 + 0.5 * rng.normal(size=count), 10.0 + rng.normal(size=count)
    kalman = Kalman(**assumptions).build(MODEL, zone())
    step, state = OnNumbers(kalman, MODEL), kalman.init(kalman.params)
    for y, u in zip(ys, us, strict=True):
        state, exact = step(state, [u], [y], [1.0])
    particle = ParticleFilter(**assumptions, particles=3000).build(MODEL, zone())
    final = [follow(particle, ys, us, np.ones(count), seed)[-1] for seed in range(runs)]
    for name in ("x", "z", "x_std", "innovation", "innovation_std"):
        values = np.stack([getattr(one, name) for one in final])
        monte_carlo = values.std(axis=0, ddof=1) / np.sqrt(runs)
        assert (monte_carlo < 0.05 * exact.x_std.max()).all()
        assert (
            np.abs(values.mean(axis=0) - getattr(exact, name))
            < 5 * monte_carlo + 0.01 * exact.x_std.max()
        ).all(), name


@given(seeds, st.integers(2, 200), st.floats(0, 0.999))
def test_systematic_resampling_copies_each_particle_as_often_as_it_weighs(
    seed: int, count: int, offset: float
) -> None:
    weights = np.random.default_rng(seed).dirichlet(np.full(count, 0.3))
    copies = np.bincount(systematic_indices(weights, offset), minlength=count)
    assert copies.sum() == count
    assert (np.abs(copies - count * weights) < 1 + 1e-9).all()


def test_particles_follow_from_the_seed_alone_and_states_are_values() -> None:
    observer = ParticleFilter(right=[0.5, 2.0], particles=50).build(MODEL, zone()).python
    assert observer is not None
    state = observer.start(4)
    y = Reading(np.array([1.5]), np.array([1.0]))
    first, again = (observer.predict(observer.correct(state, y)[0], np.ones(1)) for _ in range(2))
    other = observer.predict(observer.correct(observer.start(5), y)[0], np.ones(1))
    assert (first.x == again.x).all()
    assert (first.widths == again.widths).all()
    assert (first.x != other.x).all()
    assert (first.widths >= 0.5).all()
    assert (first.widths <= 2.0).all()


def test_particles_survive_a_reading_that_none_of_them_expects() -> None:
    observer = ParticleFilter(right=[0.5, 2.0], particles=50).build(MODEL, zone())
    far = follow(
        observer, np.array([1e9, np.nan, 1e200, 1.0]), np.zeros(4), np.array([1.0, 0.0, 1.0, 1.0])
    )
    assert all(np.isfinite(np.concatenate(estimate)).all() for estimate in far)


def test_particles_find_the_edges_of_a_jump_sensor() -> None:
    """Its active readings bound the widths, its silent ones too.

    What a slope cannot show, samples of the belief can.
    """
    changes: dict[str, Any] = {
        "sensor": {"kind": "jump", "right": 1.2, "left": 0.7, "noise": 0.02},
        "simulation": SAMPLED,
    }
    run = simulate(
        scene(
            observer={
                "method": "particle_filter",
                "right": [0.3, 2.0],
                "swing": 0.1,
                "drift": 0.02,
            },
            **changes,
        )
    )
    assert (np.abs(run.d_hat[-1] - [1.2, 0.7]) < 0.25).all()


# --- Moving horizon


class History:
    """Nodes of a linear model as linear functions of v = [X_0; w_0; ...], textbook style.

    X_j = maps[j] v + rest[j].
    """

    def __init__(self, model: System, us: Floats, stride: int) -> None:
        A, B, _ = model.linear
        n, p, m = model.n, model.p, model.m
        nodes = len(us) // stride
        self.size = n + 2 * p + nodes * m
        at, rest = np.eye(n, self.size), np.zeros(n)
        widths = np.eye(2 * p, self.size, n)
        self.maps, self.rest = [np.vstack([at, widths])], [np.concatenate([rest, np.zeros(2 * p)])]
        for j in range(nodes):
            shake = np.zeros((m, self.size))
            shake[:, n + 2 * p + j * m : n + 2 * p + (j + 1) * m] = np.eye(m)
            for u in us[j * stride : (j + 1) * stride]:
                at, rest = A @ at + B @ shake, A @ rest + B @ np.atleast_1d(u)
            self.maps.append(np.vstack([at, widths]))
            self.rest.append(np.concatenate([rest, np.zeros(2 * p)]))


@given(seeds, st.integers(1, 3), st.integers(1, 3))
@settings(max_examples=12)
def test_without_active_constraints_moving_horizon_is_least_squares_over_all_of_the_past(
    seed: int, n: int, stride: int
) -> None:
    """A window of 4 intervals over 9: what has left it is in its arrival cost."""
    rng = np.random.default_rng(seed)
    model = sample_plant(random_plant(rng, n), TS)
    options = MovingHorizon(
        right=[20.0, 40.0],
        noise=0.3,
        x_std=30.0,
        disturbance=80.0,
        drift=0.0,
        glitches=0.0,
        horizon=4 * stride * TS,
        period=stride * TS,
    )
    count = 9 * stride + 1
    ys, us = rng.choice([-1, 1]) * rng.uniform(1, 5, count), rng.normal(size=count)
    last = follow(options.build(model, zone()), ys, us, np.sign(ys))[-1]
    history = History(model, us[:-1], stride)
    std = np.concatenate(
        [
            np.full(n, 30.0),
            np.full(2, 20 / np.sqrt(12)),
            np.full(history.size - n - 2, 80 / np.sqrt(stride)),
        ]
    )
    mean = np.concatenate([np.zeros(n), [30.0, 30.0], np.zeros(history.size - n - 2)])
    rows, rest = [np.diag(1 / std)], [mean / std]
    for y, at, b in zip(ys[::stride], history.maps, history.rest, strict=True):
        h = np.concatenate([model.linear.C[0], [-1.0 * (y > 0), 1.0 * (y < 0)]])
        rows.append(h[None] @ at / 0.3)
        rest.append(np.array([(y - h @ b) / 0.3]))
    v = np.linalg.lstsq(np.vstack(rows), np.concatenate(rest), rcond=None)[0]
    expected = history.maps[-1] @ v + history.rest[-1]
    assume((expected[n:] > 20).all() and (expected[n:] < 40).all())
    assert np.concatenate([last.x, last.right, last.left]) == pytest.approx(
        expected, rel=1e-5, abs=1e-5
    )
    covariance = (
        history.maps[-1] @ np.linalg.inv(np.vstack(rows).T @ np.vstack(rows)) @ history.maps[-1].T
    )
    assert np.concatenate([last.x_std, last.right_std, last.left_std]) == pytest.approx(
        np.sqrt(np.diag(covariance)), rel=1e-6
    )


@pytest.mark.parametrize("solver", [name for name in ("daqp", "osqp") if ca.has_conic(name)])
@pytest.mark.parametrize("seed", range(3))
def test_with_active_constraints_moving_horizon_is_what_scipy_finds(seed: int, solver: Any) -> None:
    """Readings, silence that the prior contradicts, ranges.

    The same convex function by L-BFGS-B, violations as squares of max(0, .).
    """
    rng, count = np.random.default_rng(seed), 8
    assumptions: dict[str, Any] = {
        "right": [0.5, 1.2],
        "noise": 0.2,
        "x_std": 3.0,
        "disturbance": 5.0,
        "drift": 0.0,
        "glitches": 0.0,
    }
    options = MovingHorizon(**assumptions, horizon=count * TS, period=TS, slack=0.1, solver=solver)
    ys, us = (
        np.where(np.arange(count) % 3 == 0, 2.0 + rng.normal(size=count), 0.0),
        30 * rng.normal(size=count),
    )
    last = follow(options.build(MODEL, zone()), ys, us, np.sign(ys))[-1]
    history, C = History(MODEL, us[:-1], 1), MODEL.linear.C[0]
    std = np.concatenate(
        [[3.0, 3.0], np.full(2, 0.7 / np.sqrt(12)), np.full(history.size - 4, 5.0)]
    )
    mean = np.concatenate([np.zeros(2), [0.85, 0.85], np.zeros(history.size - 4)])
    gate = float(build_joint_prior(options, MODEL, zone()).prior.gate[0])
    bends: list[float] = []

    def cost(v: Floats) -> tuple[float, Floats]:
        e = (v - mean) / std
        total, slope = e @ e, 2 * e / std
        bends.clear()
        for y, at, b in zip(ys, history.maps, history.rest, strict=True):
            for h, excess, scale in _terms(C, y, gate):
                value = h @ (at @ v + b) - excess
                value = value if y else max(0.0, value)
                total, slope = total + (value / scale) ** 2, slope + 2 * value / scale**2 * (h @ at)
                if not y:
                    bends.append(value)
        return total, slope

    bounds = [(None, None)] * 2 + [(0.5, 1.2)] * 2 + [(None, None)] * (history.size - 4)
    best = minimize(
        cost,
        mean,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 5000, "maxfun": 20000},
    )
    cost(best.x)
    assert max(bends) > 0.01  # silence matters here
    tolerance = 2e-3 if solver == "osqp" else 2e-4
    assert np.concatenate([last.x, last.right, last.left]) == pytest.approx(
        history.maps[-1] @ best.x + history.rest[-1], abs=tolerance
    )


def _terms(C: Floats, y: float, gate: float) -> list[tuple[Floats, float, float]]:
    """(h, value, rms) of what a node says.

    It is h X = y on its side; h X <= gate, both edges, if silent.
    """
    right, left = np.concatenate([C, [-1.0, 0.0]]), np.concatenate([C, [0.0, 1.0]])
    if y:
        return [(right if y > 0 else left, y, 0.2)]
    return [(right, gate, 0.1), (-left, gate, 0.1)]


def test_a_programme_that_cannot_be_solved_leaves_the_prediction() -> None:
    observer = MovingHorizon(right=[0.5, 2.0]).build(MODEL, zone())
    estimates = follow(observer, np.array([1.0, 1e300, 1.0]), np.zeros(3), np.ones(3))
    assert np.isfinite(estimates[0].x).all()


# --- What they do wrong


@pytest.mark.parametrize(
    ("method", "reach"), [(EKF, "right edge only"), (EKF, "grazing"), (UKF, "right edge only")]
)
def test_filters_on_the_dead_zone_are_sure_and_wrong_about_what_they_do_not_read(
    method: Any, reach: str
) -> None:
    """With true claims about every problem, few 95 % intervals hold the truth.

    Kalman's on the measured side do.
    """

    def rival(problems: coverage.Problems, k: int) -> Any:
        return method(
            right=coverage.RANGE,
            noise=problems.noise[k],
            x_std=problems.x_std[k],
            disturbance=problems.disturbance[k],
            drift=0.0,
            glitches=0.0,
        )

    problems = coverage.problems(reach, coverage.World(), 2, 60, 7)
    theirs, ours = coverage.observe(rival, problems), coverage.observe(coverage.kalman, problems)
    assert ours.covered()[:4].min() > 0.85
    assert theirs.covered()[:4].min() < 0.8
    assert theirs.nees() > 10 > ours.nees()


def test_an_estimate_inside_its_own_zone_is_deaf() -> None:
    """The Jacobian of the dead zone is 0 there.

    Whatever is read, the predicted-mode EKF corrects nothing; the measured mode does.
    """
    for mode, moves in (("predicted", False), ("measured", True)):
        observer = EKF(right=[0.5, 2.0], mode=mode).build(MODEL, zone())
        step, state = OnNumbers(observer, MODEL), observer.init(observer.params)
        _, estimate = step(state, [0.0], [5.0], [1.0])
        assert (np.abs(estimate.z) > 1).all() == moves
        assert estimate.innovation[0] != 0


def test_the_pseudo_measurement_pulls_a_contradicted_estimate_to_the_edge() -> None:
    for pseudo, moves in ((True, True), (False, False)):
        observer = EKF(right=[0.5, 2.0], mode="measured", pseudo=pseudo).build(MODEL, zone())
        step, state = OnNumbers(observer, MODEL), observer.init(observer.params)
        mean = np.array([4.0, 0.0, 1.25, 1.25])
        state = state._replace(filter=state.filter._replace(mean=mean))
        _, estimate = step(state, [0.0], [0.0], [0.0])
        assert (estimate.z[0] - estimate.right[0] < 0.1) == moves


# --- In the loop


@pytest.mark.parametrize("method", [EKF, UKF])
def test_missing_samples_only_predict_and_the_estimate_does_not_depend_on_the_input(
    method: Any,
) -> None:
    observer = method(right=[0.5, 2.0], disturbance=0.5).build(MODEL, zone())
    step, state = OnNumbers(observer, MODEL), observer.init(observer.params)
    state, _ = step(state, [1.0], [2.0], [1.0])
    after, estimate = step(state, [0.3], [np.nan], [0.0])
    A, B, _ = MODEL.linear
    assert estimate.x == pytest.approx(state.filter.mean[:2])
    assert estimate.innovation == 0.0
    assert after.filter.mean[:2] == pytest.approx(A @ state.filter.mean[:2] + B[:, 0] * 0.3)
    (_, one), (_, two) = (step(state, [u], [1.0], [1.0]) for u in (-5.0, 5.0))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


@pytest.mark.parametrize("method", [ParticleFilter, MovingHorizon])
def test_a_missing_sample_leaves_the_python_observers_to_the_model(method: Any) -> None:
    observer = method(right=[0.5, 2.0]).build(MODEL, zone()).python
    state = observer.start(0)
    state, before = observer.correct(state, Reading(np.array([np.nan]), np.array([0.0])))
    assert before.innovation == 0.0
    assert before.z_inverse == before.z
    assert (np.abs(before.x) < 1).all()


def test_the_live_loop_is_the_loop() -> None:
    """Kalman's filter as a graph, and the same step called from Python: the same run."""
    scenario = scene(
        """
        observer = { method = "kalman", right = [0.5, 2.0] }
        sensor = { noise = 0.02 }
        """,
        simulation=SAMPLED,
    )
    expected, problem = simulate(scenario), resolve_scenario(scenario)
    graph = problem.observer
    step = OnNumbers(graph, problem.model)

    def correct(s: Any, reading: Reading) -> Any:
        return (s, reading), step(s, np.zeros(1), reading.y, reading.side)[1]

    how = PythonObserver(
        lambda seed: graph.init(graph.params),
        correct,
        lambda s, u: step(s[0], u, s[1].y, s[1].side)[0],
    )
    wrapped = problem._replace(observer=build_python_observer(how, problem.plant.p, Traits()))
    ticks: list[int] = []
    outcome = live.run_sample_by_sample(wrapped, inputs.exogenous(problem), ticks.append)
    assert sum(ticks) == expected.t.size
    for name in ("x", "z", "y", "u"):
        signal, same = getattr(outcome, name), getattr(expected, name)
        assert signal == pytest.approx(same, rel=1e-9, abs=1e-9), name
    for name in ("x", "z", "innovation", "x_std", "width_std"):
        signal = getattr(outcome.estimate, name)
        same = getattr(expected, getattr(COLUMNS, name))
        assert signal == pytest.approx(same, rel=1e-9, abs=1e-9), name


CHAIN = tables_of("""
A = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-4.0, -6.0, -4.0]]
B = [[0.0], [0.0], [4.0]]
C = [[1.0, 0.0, 0.0]]
x0 = [0.5, 0.0, 0.0]
""")
TWO = tables_of("""
A = [[-1.0, 0.5], [-0.5, -2.0]]
B = [[1.0, 0.0], [0.0, 1.0]]
C = [[1.0, 0.0], [0.2, 1.0]]
x0 = [0.5, -0.5]
""")
PLANTS: dict[str, tuple[Any, Any]] = {
    "third order": (CHAIN, {"method": "state_feedback", "poles": [-6.0, -6.0, -6.0]}),
    "two outputs": (TWO, {"method": "state_feedback", "alpha": 5.0}),
    "pendulum": (PENDULUM, {"method": "state_feedback", "poles": [-5.0, -5.0]}),
    "integrators": (
        {"integrators": 2, "x0": [0.5, 0.0]},
        {"method": "state_feedback", "poles": [-5.0, -5.0]},
    ),
}


@pytest.mark.parametrize("method", ALL, ids=lambda method: method.__struct_config__.tag)
@pytest.mark.parametrize("plant", PLANTS)
def test_any_plant_runs_and_its_estimates_are_finite_with_their_standard_deviations(
    plant: str, method: Any
) -> None:
    tables, controller = PLANTS[plant]
    amplitude = [3.0, 3.0] if plant == "two outputs" else 3.0
    changes = {
        "plant": tables,
        "controller": controller,
        "reference": {"kind": "sine", "amplitude": amplitude, "frequency": 0.5},
    }
    run = simulate(
        scene(
            """
            sensor = { right = 0.8, left = 0.6, noise = 0.01 }
            simulation = { time = "sampled", step = 0.02, duration = 4.0 }
            """,
            observer={"method": method.__struct_config__.tag, "right": [0.3, 1.5]},
            **changes,
        )
    )
    assert run.info.method == method.__struct_config__.tag
    assert run.divergence_time is None
    for name in ("x_std", "d_std", "width_std", "innovation_std"):
        assert (getattr(run, name) >= 0).all(), name
    assert run.rms_estimation < 1.0
    assert run.rms_tracking < 1.5


def test_the_default_disturbance_moves_z_as_far_as_it_says() -> None:
    for plant in (PAPER_PLANT, system(Plant(**CHAIN)), system(Plant(integrators=2))):
        model = sample_plant(plant, 0.002)
        A, B, C = model.linear
        at, reached = B, 0.0
        for _ in range(round(quarter_period(model) / 0.002)):
            reached, at = reached + float((C @ at)[0, 0]) ** 2, A @ at
        assert np.sqrt(reached) * white_disturbance_rms(model, 0.4)[0] == pytest.approx(
            0.4, rel=0.01
        )


def test_python_observers_say_where_they_cannot_run() -> None:
    scenario = scene(
        observer={"method": "particle_filter", "right": [0.5, 2.0], "particles": 20},
        simulation=SAMPLED,
    )
    with pytest.raises(InputError, match=r"observer\.method.*single simulations only"):
        simulate(scenario, engine="lanes")
    with pytest.raises(InputError, match=r"observer\.method.*single simulations only"):
        Online(
            MovingHorizon(right=[0.5, 2.0]),
            Plant(A=[[-1.0]], B=[[1.0]], C=[[1.0]]),
            Sensor(right=1.0, left=1.0),
            0.01,
        )


# --- Wrong input


# --- Their parts


def test_particles_are_weighed_by_their_likelihood() -> None:
    weights, e = np.array([0.2, 0.3, 0.5]), np.array([[0.5, 1.0, -2.0], [0.0, 1.5, 0.3]])
    never = np.full(2, -np.inf)
    expected = weights * np.exp(-(e**2).sum(axis=0) / 2)
    assert update_particle_weights(weights, e, never) == pytest.approx(expected / expected.sum())
    assert (update_particle_weights(weights, np.full((2, 3), np.nan), never) == weights).all()


def test_particles_of_which_too_few_count_are_drawn_anew() -> None:
    x, widths = np.arange(4.0)[None], np.ones((2, 4))
    many = particle.ParticleState(x, widths, np.array([0.3, 0.3, 0.3, 0.1]), 1, 0)
    assert particle.resample_particles(many) is many
    few = particle.resample_particles(many._replace(weights=np.array([0.0, 0.98, 0.01, 0.01])))
    assert (few.weights == 0.25).all()
    assert (few.x == 1.0).sum() >= 3


def test_the_covariance_after_a_reading_adds_information() -> None:
    rng = np.random.default_rng(4)
    root, h, R = rng.normal(size=(4, 4)), rng.normal(size=4), 0.3
    cov = root @ root.T
    expected = np.linalg.inv(np.linalg.inv(cov) + np.outer(h, h) / R)
    assert horizon.covariance_after_reading(cov, h, R) == pytest.approx(expected)


@pytest.mark.parametrize(("side", "expected"), [(1.0, 1.5), (-1.0, 2.7), (0.0, 2.0)])
def test_a_row_reads_the_edge_of_its_side(side: float, expected: float) -> None:
    C, X = np.array([[1.0, 0.0]]), np.array([2.0, 9.0, 0.5, 0.7])
    assert horizon.reading_row(C, 0, side) @ X == pytest.approx(expected)


def random_window() -> Window:
    """Three nodes of two states, one input and one output, of which the middle one is silent."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(3, 4, 4))
    return Window(
        y=rng.normal(size=(3, 1)),
        side=np.array([[1.0], [0.0], [-1.0]]),
        seen=np.ones((3, 1)),
        mean=rng.normal(size=(3, 4)),
        cov=root @ root.swapaxes(1, 2),
        C=rng.normal(size=(3, 1, 2)),
        offset=rng.normal(size=(3, 1)),
        F=rng.normal(size=(3, 2, 2)),
        f=rng.normal(size=(3, 2)),
        G=rng.normal(size=(3, 2, 1)),
    )


def test_a_window_moves_as_its_motions_say() -> None:
    """x of each node from that of the oldest and the disturbances, and z beyond the edges."""
    window = random_window()
    v = np.random.default_rng(6).normal(size=horizon.programme_size(window)[0])
    oldest = horizon.oldest_node(window)
    assert pytest.approx(window.cov[0]) == oldest.M @ oldest.M.T
    X = oldest.M @ v + oldest.b
    x = X[:2]
    expected = [x]
    for j in range(2):
        x = window.F[j] @ x + window.f[j] + window.G[j, :, 0] * v[4 + j]
        expected.append(x)
    xs, newest = horizon.node_trajectory(window, Affine(oldest.M[:2], oldest.b[:2]))
    assert xs.M @ v + xs.b == pytest.approx(np.array(expected))
    assert newest.M @ v + newest.b == pytest.approx(x)
    beyond = horizon.excess_over_breakpoints(window, xs, Affine(oldest.M[2:], oldest.b[2:]))
    z = np.einsum("ki,ki->k", window.C[:, 0], expected) + window.offset[:, 0]
    assert beyond.M @ v + beyond.b == pytest.approx(np.concatenate([z - X[2], -z - X[3]]))


def test_readings_are_errors_and_silence_is_a_constraint() -> None:
    window, rng = random_window(), np.random.default_rng(7)
    ranges = np.array([[0.5, 2.0], [0.4, 1.0]])
    weights = HorizonWeights(np.array([0.1]), np.array([0.2]), np.array([0.05]), ranges)
    unknowns, rows = horizon.programme_size(window)
    v = rng.normal(size=unknowns)
    beyond, d = (
        Affine(rng.normal(size=(size, unknowns)), rng.normal(size=size)) for size in (6, 2)
    )
    M, b = horizon.reading_errors(window, weights, beyond)
    read = window.y[[0, 2], 0] * [1, -1]
    assert M @ v - b == pytest.approx(((beyond.M @ v + beyond.b)[[0, 5]] - read) / 0.1)
    A, low, high = horizon.qp_constraints(window, weights, beyond, d)
    assert A.shape == (rows, unknowns)
    outside = 0.2 * v[-3:]  # z of a silent sensor, beyond its zone
    assert (A @ v)[:6] == pytest.approx(beyond.M @ v - np.tile(outside, 2))
    inside = np.where([False, True, False] * 2, 0.05 - beyond.b, np.inf)
    assert high[:6] == pytest.approx(inside)
    assert np.isneginf(low[:6]).all()
    assert np.stack([low[6:] + d.b, high[6:] + d.b], axis=1) == pytest.approx(ranges)


def test_the_chance_of_a_glitch_is_that_of_bayes() -> None:
    """A reading of a Gaussian, or one that is evenly spread over reach and tails."""
    e, std, share, reach = np.array([0.3, 2.0]), np.array([0.5, 0.4]), 0.1, 5.0
    doubt: Any = SimpleNamespace(glitch=np.log(share / (1 - share)), reach=np.full(2, reach))
    wrong, right = share / (reach + TAIL * std), (1 - share) * norm.pdf(e, scale=std)
    np.testing.assert_allclose(
        glitch_probability(doubt, e, std), wrong / (wrong + right), rtol=1e-12
    )


@pytest.mark.parametrize("times", [1, 4])
def test_the_noise_of_crowded_readings_grows_with_their_root(times: int) -> None:
    """`times` CROWD readings in a quarter period of the paper's plant, pi / 2 s."""
    plant = linear([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    model = sample_plant(plant, np.pi / 2 / (times * CROWD))
    sensor = resolve(Sensor(right=1.0, left=1.0), 1, 1e-2)
    assumptions, defaults = JointAssumptions(right=[0.0, 2.0]), JointDefaults(0.1, 0.0, 1.0)
    found = build_joint_prior(assumptions, model, sensor, defaults)
    np.testing.assert_allclose(found.prior.R, 0.04 * times, rtol=1e-9)
