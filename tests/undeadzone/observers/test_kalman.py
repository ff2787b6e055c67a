"""The measured-side Kalman filter against textbook twins, and its claims against the truth.

So is the Gaussian maths beneath it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest
from benchmarks.filters import coverage
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm, truncnorm

from further import further
from requirements import import_package
from scenes import (
    EXACT_SENSOR,
    PAPER_PLANT,
    OnNumbers,
    centre_std,
    random_plant,
    scene,
    seeds,
    tables_of,
    zone,
)
from undeadzone.errors import InputError
from undeadzone.interfaces import Reading
from undeadzone.nonlinearities import sensor
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.numerics import gaussian
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers import Kalman
from undeadzone.observers.filtering import measured_kalman as filtering
from undeadzone.observers.filtering.gaussian_filter import Params, truncate_to_ranges
from undeadzone.observers.filtering.measured_kalman import State
from undeadzone.observers.filtering.measurement_update import reject_impossible
from undeadzone.observers.filtering.prior import Assumptions, build_prior, read_width_ranges
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.results.run import Run
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats

TS = 0.05
MODEL = sample_plant(PAPER_PLANT, TS)
OPTIONS = {"method": "kalman", "right": [0.5, 2.0], "left": [0.5, 2.0], "disturbance": 0.0}
NOTHING = float("nan")
UPPER = ca.Sparsity.upper(4)


def covariance(state: State) -> Floats:
    """The full matrix of a state's triangle."""
    size = len(state.mean)
    upper = np.zeros((size, size))
    upper[np.tril_indices(size)] = state.cov
    return upper + np.tril(upper, -1).T


def evaluate(f: Callable[..., Any], *values: Any) -> list[Floats]:
    """f of CasADi symbols, at numbers."""
    numbers = [ca.DM(value) for value in values]
    symbols = [ca.SX.sym("a", *number.shape) for number in numbers]
    function = ca.Function("f", symbols, list(f(*symbols)))
    return [result.full() for result in function.call(numbers)]


# --- Gaussian maths


@given(seeds)
def test_covariance_and_triangle_are_inverse(seed: int) -> None:
    square = np.random.default_rng(seed).normal(size=(4, 4))
    (whole,) = evaluate(
        lambda P: [gaussian.from_upper_entries(gaussian.to_upper_entries(P, UPPER), UPPER)],
        square + square.T,
    )
    assert (whole == square + square.T).all()


@given(seeds)
def test_prediction_is_exact_for_second_degree(seed: int) -> None:
    """Random quadratic maps, for which Gauss-Hermite quadrature of mean and covariance is exact."""
    rng = np.random.default_rng(seed)
    H, F, mean, root, Q = (
        rng.normal(size=(2, 3, 3)),
        rng.normal(size=(3, 3)),
        rng.normal(size=3),
        rng.normal(size=(3, 3)),
        np.diag(rng.uniform(size=3)),
    )

    def f(X: Any) -> Any:
        return ca.vertcat(*(F[[i]] @ X + X.T @ H[i] @ X for i in range(2)), F[[2]] @ X)

    def predict(m: Any, P: Any) -> Gaussian:
        return gaussian.predict(Gaussian(m, P), lambda X: f(X) - X, Q)

    moments = evaluate(predict, mean, root @ root.T)
    nodes, weights = np.polynomial.hermite_e.hermegauss(4)
    points = mean + np.array(list(product(nodes, repeat=3))) @ root.T
    weight = np.prod(list(product(weights / weights.sum(), repeat=3)), axis=1)
    values = np.stack(
        [
            *(points @ F[i] + np.einsum("ki,ij,kj->k", points, H[i], points) for i in range(2)),
            points @ F[2],
        ],
        axis=1,
    )
    expected = weight @ values
    assert moments[0][:, 0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert moments[1] == pytest.approx(
        (values - expected).T @ np.diag(weight) @ (values - expected) + Q, rel=1e-8, abs=1e-8
    )


def test_hazard_agrees_with_scipy() -> None:
    alpha = np.linspace(-30, 30, 1201)
    ratio = evaluate(gaussian.normal_cdf_and_hazard, alpha)[1]
    expected = np.exp(norm.logpdf(alpha) - norm.logcdf(alpha))
    assert ratio[alpha > -5, 0] == pytest.approx(expected[alpha > -5], rel=1e-8)
    assert ratio[alpha <= -5, 0] == pytest.approx(expected[alpha <= -5], rel=2e-4)


@given(seeds, st.just(0.0) | st.floats(0.01, 2.0))
def test_cut_matches_the_moments_of_the_truncated_belief(seed: int, R: float) -> None:
    """Against quadrature of the belief in q = h x times P(q + v <= 0) = Phi(-q / sqrt R)."""
    rng = np.random.default_rng(seed)
    root, h, excess = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal()
    P, mean = root @ root.T, rng.normal(size=3)
    moments = evaluate(
        lambda m, P: (
            gaussian.truncate_at_bounds(
                Gaussian(m, P), [gaussian.Bound(ca.SX(h[None, :]), excess, 1.0)], R, 1e3
            ).belief
        ),
        mean,
        P,
    )
    variance = h @ P @ h

    def moment(power: int) -> float:
        std = np.sqrt(variance)
        chance = norm.cdf if R else lambda x: float(x >= 0)
        ends = (excess - 12 * std, excess + 12 * std)
        return float(
            quad(
                lambda q: (
                    (q - excess) ** power
                    * norm.pdf(q, excess, std)
                    * chance(-q / np.sqrt(R) if R else -q)
                ),
                *ends,
                points=[0.0, excess],
                limit=200,
            )[0]
        )

    total = moment(0)
    if total < 1e-6:
        return
    shift = moment(1) / total
    gain = P @ h / variance
    assert moments[0][:, 0] == pytest.approx(mean + gain * shift, abs=1e-5)
    assert moments[1] == pytest.approx(
        P + np.outer(gain, gain) * (moment(2) / total - shift**2 - variance), abs=1e-5
    )


def test_update_stays_definite_where_readings_are_nearly_exact() -> None:
    """Noise of 1e-6 on a prior of 1e3: the plain form P - K S K' goes indefinite there."""
    rng = np.random.default_rng(1)
    P, mean, h = ca.SX.sym("P", 4, 4), ca.SX.sym("m", 4), ca.SX.sym("h", 1, 4)
    step = ca.Function(
        "step", [mean, P, h], list(gaussian.joseph_update(Gaussian(mean, P), h, 0.0, 1e-12, 1.0)[0])
    )
    belief, plain = np.eye(4) * 1e6, np.eye(4) * 1e6
    lowest = plain_lowest = 0.0
    for _ in range(300):
        row = rng.normal(size=4) * [1.0, 1e-3, 1.0, 1e-3]
        belief = step(np.zeros(4), belief, row)[1].full()
        gain = plain @ row / (row @ plain @ row + 1e-12)
        plain = plain - np.outer(gain, row @ plain)
        lowest, plain_lowest = (
            min(low, np.linalg.eigvalsh((P + P.T) / 2)[0] / np.abs(P).max())
            for low, P in ((lowest, belief), (plain_lowest, plain))
        )
    assert lowest > -1e-15
    assert plain_lowest < -1e-12


# --- Twins


def textbook(
    model: System, options: Kalman, noise: float, ys: Floats, us: Floats
) -> list[tuple[Floats, Floats]]:
    """[x; d_r; d_l] and covariance after each reading, by the formulas of any textbook.

    All outputs at once, K = P H' S^-1.
    """
    A, B, C = model.linear
    n, p = model.n, model.p
    (lo, hi), (low, high) = options.right, options.left or options.right  # type: ignore[misc]
    mean = np.concatenate([np.zeros(n), np.full(p, (lo + hi) / 2), np.full(p, (low + high) / 2)])
    P = np.diag(
        np.concatenate(
            [
                np.full(n, options.x_std),
                np.full(p, (hi - lo) / np.sqrt(12)),
                np.full(p, (high - low) / np.sqrt(12)),
            ]
        )
        ** 2
    )
    F, Q = np.eye(n + 2 * p), np.eye(n + 2 * p) * options.drift**2 * TS
    F[:n, :n], Q[:n, :n] = A, B @ B.T * float(options.disturbance) ** 2  # type: ignore[arg-type]
    beliefs = []
    for y, u in zip(ys, us, strict=True):
        H = np.hstack([C, -np.diag(1.0 * (y > 0)), np.diag(1.0 * (y < 0))])
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise**2 * np.eye(p))
        mean, P = mean + K @ (y - H @ mean), (np.eye(n + 2 * p) - K @ H) @ P
        beliefs.append((mean, P))
        mean, P = F @ mean, F @ P @ F.T + Q
        mean[:n] += B @ u
    return beliefs


@given(seeds, st.integers(1, 4), st.integers(1, 2), st.integers(1, 2))
def test_where_every_reading_is_active_it_is_the_textbook_filter(
    seed: int, n: int, m: int, p: int
) -> None:
    rng = np.random.default_rng(seed)
    model = sample_plant(random_plant(rng, n, m, p), TS)
    options = Kalman(
        right=[0.5, 2.0],
        left=[0.2, 3.0],
        noise=0.1,
        x_std=2.0,
        disturbance=0.7,
        drift=0.3,
        glitches=0.0,
    )
    observer = options.build(model, zone(p))
    step, state = OnNumbers(observer, model), observer.init(observer.params)
    ys, us = rng.choice([-1, 1], (30, p)) * rng.uniform(1, 9, (30, p)), rng.normal(size=(30, m))
    for y, u, (mean, P) in zip(ys, us, textbook(model, options, 0.1, ys, us), strict=True):
        state, estimate = step(state, u, y, np.sign(y))
        mean[n : n + p] = np.clip(mean[n : n + p], 0.5, 2.0)  # shown inside the claimed ranges
        mean[n + p :] = np.clip(mean[n + p :], 0.2, 3.0)
        assert np.concatenate([estimate.x, estimate.right, estimate.left]) == pytest.approx(
            mean, rel=1e-10, abs=1e-10
        )
        std = np.sqrt(np.diag(P))
        assert np.concatenate(
            [estimate.x_std, estimate.right_std, estimate.left_std]
        ) == pytest.approx(std, rel=1e-10)
        width = [
            np.sqrt(P[n + i, n + i] + P[n + p + i, n + p + i] + 2 * P[n + i, n + p + i])
            for i in range(p)
        ]
        assert estimate.width_std == pytest.approx(width, rel=1e-10)


@given(seeds, st.integers(1, 3))
def test_without_process_noise_it_is_batch_least_squares(seed: int, n: int) -> None:
    """The estimate of the last state and of d is that of the best theta = [x(0); d].

    It minimises |theta - theta_0|^2 / P_0 + sum |y - h theta|^2 / noise^2.
    """
    rng = np.random.default_rng(seed)
    model = sample_plant(random_plant(rng, n), TS)
    A, B, C = model.linear
    options = Kalman(right=[0.5, 2.0], noise=0.1, x_std=2.0, disturbance=0.0, glitches=0.0)
    observer = options.build(model, zone())
    step, state = OnNumbers(observer, model), observer.init(observer.params)
    ys, us = rng.choice([-1, 1], 40) * rng.uniform(1, 9, 40), rng.normal(size=40)
    Phi, forced, rows, rest = np.eye(n), np.zeros(n), [], []
    for y, u in zip(ys, us, strict=True):
        rows.append(np.concatenate([C[0] @ Phi, [-1.0 * (y > 0), 1.0 * (y < 0)]]) / 0.1)
        rest.append((y - C[0] @ forced) / 0.1)
        last = Phi, forced
        state, estimate = step(state, [u], [y], [np.sign(y)])
        Phi, forced = A @ Phi, A @ forced + B[:, 0] * u
    scale = np.concatenate([np.full(n, 2.0), np.full(2, 1.5 / np.sqrt(12))])
    first = np.concatenate([np.zeros(n), [1.25, 1.25]])
    theta = np.linalg.lstsq(
        np.vstack([rows, np.diag(1 / scale)]), np.concatenate([rest, first / scale]), rcond=None
    )[0]
    assert estimate.x == pytest.approx(last[0] @ theta[:n] + last[1], rel=1e-8, abs=1e-8)
    assert np.concatenate([estimate.right, estimate.left]) == pytest.approx(
        np.clip(theta[n:], 0.5, 2.0), rel=1e-8, abs=1e-8
    )


def test_sides_that_are_never_read_and_missing_samples_only_predict() -> None:
    A, B, _ = MODEL.linear
    observer = Kalman(right=[0.5, 2.0], x_std=2.0, disturbance=0.5, drift=0.1).build(
        MODEL, zone(noise=0.01)
    )
    step, state = OnNumbers(observer, MODEL), observer.init(observer.params)
    for y in (NOTHING, 0.0, 0.01, np.inf, -0.01):
        after, estimate = step(state, [0.3], [y], [0.0])
        mean, P = np.asarray(state.filter.mean), covariance(state.filter)
        F, Q = np.eye(4), np.diag([0, 0, 0.01 * TS, 0.01 * TS])
        F[:2, :2], Q[:2, :2] = A, B @ B.T * 0.25
        moved = F @ mean + np.concatenate([B[:, 0] * 0.3, [0, 0]])
        assert after.filter.mean == pytest.approx(moved)
        assert covariance(after.filter) == pytest.approx(F @ P @ F.T + Q)
        assert estimate.innovation == 0.0
        state = after


def test_the_estimate_does_not_depend_on_the_input() -> None:
    observer = Kalman(right=[0.5, 2.0]).build(MODEL, zone())
    step, state = OnNumbers(observer, MODEL), observer.init(observer.params)
    (first, one), (second, two) = (step(state, [u], [1.0], [1.0]) for u in (-5.0, 5.0))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(first.filter.mean, second.filter.mean)


# --- Which readings are used


@pytest.mark.parametrize(
    ("y", "last", "previous", "expected"),
    [
        (2.1, 0.0, 0.0, 1),  # far beyond the gate
        (1.9, 0.0, 0.0, 0),  # neither far nor announced
        (0.1, 1.2, 1.1, 1),  # announced: two beyond, and their line too
        (0.1, 1.2, 1.9, 0),  # the line of the two before is back inside
        (-0.1, 1.2, 1.1, 0),  # across 0 after all
        (1.5, 1.2, 0.9, 0),  # only one before
        (-2.1, 0.0, 0.0, -1),
        (-0.1, -1.2, -1.1, -1),
    ],
)
def test_a_reading_is_used_if_far_or_announced(
    y: float, last: float, previous: float, expected: int
) -> None:
    (sure,) = evaluate(lambda *a: [filtering.certain_branch(*a, ca.SX(1.0))], y, last, previous)
    assert sure == expected


# --- Claims against the truth


@pytest.mark.parametrize("reach", ["both edges", "right edge only", "grazing"])
def test_intervals_cover_the_truth_over_random_problems(reach: str) -> None:
    """100 problems: coverage within three standard errors of 95 % or more.

    NEES and NIS are near 1 (chi-square, 4 sigma).
    """
    outcome = coverage.observe(
        coverage.kalman, coverage.problems(reach, coverage.World(), 2, 100, 5)
    )
    assert outcome.covered().min() > 0.885
    assert outcome.nees() == pytest.approx(1.0, abs=4 / np.sqrt(100))
    assert outcome.nis == pytest.approx(1.0, abs=0.02)


def test_an_edge_that_is_never_reached_keeps_its_prior() -> None:
    outcome = coverage.observe(
        coverage.kalman, coverage.problems("no edge", coverage.World(), 2, 50, 6)
    )
    prior = np.ptp(coverage.RANGE) / np.sqrt(12)
    assert outcome.stds[:, :4] == pytest.approx(
        np.tile([prior, prior, np.sqrt(2) * prior, prior / np.sqrt(2)], (50, 1))
    )
    assert outcome.covered().min() > 0.9


@cache
def grazed(reach: str) -> tuple[coverage.Problems, coverage.Verdict]:
    """Twelve problems, and what our filter makes of them."""
    problems = coverage.problems(reach, coverage.World(), 2, 12, 7)
    return problems, coverage.observe(coverage.kalman, problems)


@pytest.mark.parametrize("build", [coverage.extended, *further(coverage.unscented)])
@pytest.mark.parametrize("reach", ["grazing", *further("right edge only")])
def test_filters_on_the_dead_zone_itself_are_confident_and_wrong(build: Any, reach: str) -> None:
    """filterpy's EKF and UKF where an edge is hardly or never reached.

    Ours gets these problems right.
    """
    import_package("filterpy")
    problems, ours = grazed(reach)
    theirs = coverage.rivalling(build, problems, 12)
    assert ours.covered()[:4].min() >= 10 / 12
    assert ours.nees() < 2
    assert theirs.covered()[:4].min() < ours.covered()[:4].min()
    assert theirs.nees() > 10


def test_of_a_chain_of_integrators_only_the_width_becomes_known() -> None:
    model = sample_plant(system(Plant(integrators=2, x0=[2.0, 0.0])), TS)
    where = zone(right=1.3, left=0.6)
    observer = Kalman(right=[0.5, 2.0], x_std=3.0, disturbance=0.0).build(model, where)
    step, state, x = (
        OnNumbers(observer, model),
        observer.init(observer.params),
        np.array([2.0, 0.0]),
    )
    for k in range(400):
        u = np.array([-12.0 * np.cos(2.0 * k * TS)])
        y = sensor.deadzone(model.linear.C @ x, where.right, where.left)
        state, estimate = step(state, u, y, sensor.side(y))
        x = model.linear.A @ x + model.linear.B @ u
    assert estimate.width_std < 0.02
    assert estimate.right + estimate.left == pytest.approx(1.9, abs=3 * estimate.width_std[0])
    centre = centre_std(estimate)
    assert centre == pytest.approx(1.5 / np.sqrt(24), rel=0.01)
    assert abs((estimate.right - estimate.left) / 2 - 0.35) < 2 * centre


# --- In the loop


def test_a_run_is_saved_with_its_standard_deviations(tmp_path: Any) -> None:
    run = simulate(
        scene(
            observer=OPTIONS,
            sensor={"right": 1.3, "left": 0.6, "noise": 0.02} | EXACT_SENSOR,
            simulation={"time": "sampled", "step": 0.01, "duration": 10.0},
        )
    )
    assert run.info.method == "kalman"
    assert run.d_std is not None
    assert run.x_std is not None
    assert run.width_std is not None
    assert (run.d_std[-1] < 0.02).all()
    assert (np.abs(run.d_hat[-1] - [1.3, 0.6]) < 4 * run.d_std[-1]).all()
    for suffix in ("npz", "csv"):
        loaded = Run.load(run.save(tmp_path / f"run.{suffix}"))
        assert all(
            np.array_equal(getattr(run, name), getattr(loaded, name))
            for name in ("x_std", "d_std", "width_std", "innovation_std")
        )
    assert simulate(scene()).d_std is None
    assert {"d_right_std[0]", "d_left_std[0]", "width_std[0]"} <= set(run.columns())
    assert run.unit("d_right_std[0]") == run.unit("z")


def test_a_nonlinear_plant_is_expanded_where_the_estimate_is() -> None:
    pendulum = tables_of("""
        states = ["angle", "rate"]
        inputs = ["u"]
        f = ["rate", "-9.81 * sin(angle) - 0.5 * rate + u"]
        h = ["angle"]
        x0 = [2.0, 0.0]
        """)
    run = simulate(
        scene(
            """
            reference = { kind = "sine", amplitude = 1.5, frequency = 0.5 }
            observer.method = "kalman"
            observer.right = [0.05, 0.6]
            observer.x_std = [1.5, 3.0]
            observer.disturbance = 0.0
            controller = { method = "state_feedback", poles = [-5.0, -5.0] }
            simulation = { time = "sampled", step = 0.01, duration = 8.0 }
            """,
            plant=pendulum,
            sensor={"right": 0.3, "left": 0.2, "noise": 0.01} | EXACT_SENSOR,
        )
    )
    assert run.d_std is not None
    assert (run.d_std[-1] < 0.01).all()
    assert (np.abs(run.d_hat[-1] - [0.3, 0.2]) < 4 * run.d_std[-1]).all()


# --- Wrong input


def test_continuous_time_is_refused_with_what_to_do() -> None:
    with pytest.raises(InputError, match=r"Set simulation\.time"):
        simulate(scene(observer=OPTIONS))


# --- Its parts


def test_widths_within_their_ranges_have_the_mean_of_a_cut_gaussian() -> None:
    """Independent widths: each has the mean of a truncated normal; the covariance stays.

    But where a width drifted so long that it deviates by more than its range allows.
    """
    ranges = np.array([[0.5, 1.2], [0.0, 0.4]])
    mean, std = np.array([3.0, 1.3, 0.3]), np.array([1.0, 0.4, 0.1])
    params = Params(*[None] * len(Params._fields))._replace(ranges=ranges)

    def cut_moments(mean: Any, cov: Any) -> list[Any]:
        belief, chance = truncate_to_ranges(params, 1, Gaussian(mean, cov))
        return [*belief, chance]

    cut_mean, cov, chance = evaluate(cut_moments, mean, np.diag(std**2))
    a, b = (ranges.T - mean[1:]) / std[1:]
    expected = truncnorm.mean(a, b, loc=mean[1:], scale=std[1:])
    assert cut_mean[:, 0] == pytest.approx([3.0, *expected])
    most = (ranges[0, 1] - ranges[0, 0]) / np.sqrt(12)
    assert cov == pytest.approx(np.diag(np.array([1.0, most, 0.1]) ** 2), rel=1e-9)
    chances = norm.cdf(b) - norm.cdf(a)
    assert chance[0, 0] == pytest.approx(np.prod(chances))


def test_a_prior_is_uniform_over_its_ranges() -> None:
    where = zone(noise=0.1)
    prior = build_prior(Assumptions(right=[0.5, 2.0], left=[0.0, 1.0]), MODEL, where, wear=0.01)
    assert prior.mean.tolist() == [0.0, 0.0, 1.25, 0.5]
    assert prior.std == pytest.approx([10.0, 10.0, 1.5 / np.sqrt(12), 1.0 / np.sqrt(12)])
    assert pytest.approx([0.01]) == prior.R
    assert prior.drift == pytest.approx([0.015**2 * TS, 0.01**2 * TS])


def test_the_left_widths_have_the_ranges_of_the_right_ones_by_default() -> None:
    assert read_width_ranges([0.5, 2.0], None, 2).tolist() == [[0.5, 2.0]] * 4


def test_a_reading_beyond_all_numbers_is_trusted_in_nothing() -> None:
    trusted = reject_impossible(
        ca.SX([0.7, 0.7]), Reading(ca.SX([0.9e300, 1.1e300]), ca.SX([1.0, 1.0]))
    )
    assert ca.DM(trusted).full()[:, 0].tolist() == [0.7, 0.0]


ZONE = resolve(Sensor(right=1.0, left=1.0), 1, 0.01)


def test_no_edge_lies_below_0() -> None:
    with pytest.raises(InputError, match=r"observer\.right: a range \[lo, hi\] must have 0 <= lo"):
        Kalman(right=[-1.0, 2.0], left=[0.0, 2.0]).build(sample_plant(PAPER_PLANT, 0.01), ZONE)
