"""Identification from a log: likelihoods, gradients, intervals, places of a zone, verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import lfilter
from scipy.special import log_ndtr, ndtr
from threadpoolctl import threadpool_info, threadpool_limits

import undeadzone as uz
from further import further
from records import dead_zone, holds, holds_both, steps
from requirements import import_package
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import (
    EstimateCovariance,
    long_run_covariance,
    sandwich_covariance,
    student_quantile,
)
from undeadzone_identify.models.kalman import KalmanObjective, observer_form_matrices
from undeadzone_identify.models.kalman_fit import KalmanFit, filter_innovations, smooth_states
from undeadzone_identify.models.likelihood import (
    DensityTerms,
    Readings,
    ZoneNoise,
    densities_behind,
    log_cdf_difference,
    single_densities,
)
from undeadzone_identify.models.place import simulate_friction
from undeadzone_identify.models.plant import Layout, PlantSimulator, RecordData
from undeadzone_identify.models.zone import WidthLimits, ZoneObjective
from undeadzone_identify.models.zone_fit import (
    ZoneFit,
    fit_zone,
    polish_fit,
    remove_odd_poles,
)
from undeadzone_identify.selection.widths import profile_likelihood

A, B = np.array([-1.6, 0.68]), np.array([0.05, 0.03])


def record(seed=0, size=900, right=0.5, left=0.3, noise=0.03, where="ahead", disturbance=0.0):
    """A log of a second-order plant behind a zone: t, u, y and the true z."""
    rng = np.random.default_rng(seed)
    u = steps(rng, size)
    driven = u + disturbance * lfilter([0.3], [1, -0.95], rng.standard_normal(size))
    z = lfilter(np.append(0.0, B), np.append(1.0, A), driven)
    e = noise * rng.standard_normal(size)
    y = dead_zone(z + e, right, left) if where == "ahead" else dead_zone(z, right, left) + e
    return 0.05 * np.arange(size), u, y, z


def data_of(u, y):
    scale = float(np.sqrt(np.mean(y**2)))
    ok = np.ones(y.size, bool)
    side = np.sign(y).astype(int)
    start = np.zeros(1, int)
    return RecordData(
        u[:, None] / u.std(), y / scale, ok, start, side, True, np.array([u.std()]), scale
    )


def some_readings(seed=1, size=300):
    rng = np.random.default_rng(seed)
    y = np.where(rng.random(size) < 0.4, 0.0, rng.standard_normal(size))
    ok = rng.random(size) < 0.95
    before = np.append(False, ok[:-1])
    z = y + 0.6 * np.sign(y) + 0.2 * rng.standard_normal(size)
    return Readings(y, np.sign(y).astype(int), ok, before), z


# --- likelihoods


def test_log_difference_neither_cancels_nor_underflows() -> None:
    assert log_cdf_difference(np.array([1.0]), np.array([-1.0]))[0] == pytest.approx(
        math.log(ndtr(1.0) - ndtr(-1.0)), rel=1e-13
    )
    far = log_cdf_difference(np.array([-40.0]), np.array([-41.0]))[0]
    assert far == pytest.approx(log_ndtr(-40.0), rel=1e-12)
    mirrored = log_cdf_difference(np.array([41.0]), np.array([40.0]))[0]
    assert mirrored == pytest.approx(far, rel=1e-14)
    narrow = log_cdf_difference(np.array([2.0 + 1e-9]), np.array([2.0]))[0]
    assert narrow == pytest.approx(math.log(1e-9) - 2.0 - 0.5 * math.log(2 * math.pi), rel=1e-6)


def test_a_sample_has_a_density() -> None:
    """Over every reading, speaking or silent, the densities sum to 1."""
    noise = ZoneNoise(0.4, 0.2, 0.5)

    def density(y: float) -> float:
        once = np.ones(1, bool)
        readings = Readings(np.array([y]), np.sign([y]).astype(int), once, ~once)
        return math.exp(single_densities(readings, np.array([0.2]), noise).value[0])

    right = quad(density, 1e-12, 6, epsabs=1e-11)[0]
    left = quad(density, -6, -1e-12, epsabs=1e-11)[0]
    assert right + left + density(0.0) == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("compute", [single_densities, densities_behind])
def test_derivatives_of_the_densities(compute: Callable[..., DensityTerms]) -> None:
    readings, z = some_readings()

    def value(shift: int, amount: float) -> DensityTerms:
        numbers = np.array([0.0, 0.7, 0.4, math.log(0.35)])
        numbers[shift] += amount
        right, left, log_s = numbers[1:]
        return compute(readings, z + numbers[0], ZoneNoise(right, left, math.exp(log_s)))

    for shift, expected in enumerate(value(0, 0.0).slopes.T):
        step = 1e-6
        difference = (value(shift, step).value - value(shift, -step).value) / (2 * step)
        assert difference == pytest.approx(expected, abs=1e-6 * (1 + np.abs(expected).max()))


def test_score_of_all_numbers_of_two_records() -> None:
    _, u, y, _ = record(size=300)
    data = data_of(u, y)._replace(start=np.array([0, 140]))
    simulator = PlantSimulator(data, 2)
    objective = ZoneObjective(simulator, "ahead")
    theta = np.array([*A, 0.3, 0.2, 0.1, 0.05, -0.1, 0.2, 0.6, 0.5, -1.5])
    exact = objective.total_score(theta)
    for index in range(theta.size):
        step = np.zeros(theta.size)
        step[index] = 1e-6
        difference = (
            objective.total_log_likelihood(theta + step)
            - objective.total_log_likelihood(theta - step)
        ) / 2e-6
        assert difference == pytest.approx(exact[index], rel=2e-5, abs=1e-4)


# --- the fit, its intervals


@pytest.fixture(scope="module")
def fitted() -> ZoneFit:
    _, u, y, _ = record(noise=0.05)
    return polish_fit(fit_zone(PlantSimulator(data_of(u, y), 2), WidthLimits()))


def test_the_fit_ends_at_a_top(fitted: ZoneFit) -> None:
    score = fitted.objective.total_score(fitted.theta)[fitted.objective.free]
    spread = fitted.objective.robust_covariance(fitted.theta)
    assert float(score @ spread.naive @ score) < 1e-4
    scale = fitted.objective.data.y_scale
    assert abs(fitted.right * scale - 0.5) < 0.02
    assert abs(fitted.left * scale - 0.3) < 0.02


def test_a_pole_that_a_zero_cancels_is_left_out(fitted: ZoneFit) -> None:
    """What is left makes the same z, with the zone and the noise of before."""
    objective = fitted.objective
    wide = ZoneObjective(PlantSimulator(objective.data, 3), objective.kind, objective.limits)
    old, layout = objective.layout, wide.layout
    theta = np.zeros(layout.parameter_count)
    theta[layout.denominator] = np.convolve([1.0, *fitted.theta[old.denominator]], [1.0, 0.4])[1:]
    theta[layout.numerators] = np.convolve(fitted.theta[old.numerators], [1.0, 0.4])
    theta[layout.x0] = np.convolve(fitted.theta[old.x0], [1.0, 0.4])
    theta[layout.right :] = fitted.theta[old.right :]
    wider = ZoneFit(wide, theta, wide.total_log_likelihood(theta))
    assert wider.z == pytest.approx(fitted.z, abs=1e-12)
    left = remove_odd_poles(wider, objective.simulator)
    assert left == pytest.approx(fitted.theta, abs=1e-6)


def test_a_profile_falls_on_both_sides(fitted: ZoneFit) -> None:
    values = fitted.right + np.array([-0.05, 0.0, 0.05])
    fall = profile_likelihood(fitted, "right", values)
    assert abs(fall[1]) < 1e-3
    assert fall[0] < -1
    assert fall[2] < -1


def test_intervals_of_a_mean_hold_under_first_order_noise() -> None:
    """(I1) covers as it says where independence would not."""
    rng = np.random.default_rng(5)
    robust, naive = 0, 0
    for _ in range(300):
        e = lfilter([1.0], [1.0, -0.8], rng.standard_normal(700))[100:]
        mean = e.mean()
        spread = sandwich_covariance((e - mean)[:, None], np.array([[e.size]], float))
        robust += abs(mean) <= spread.half_width(np.ones(1))
        naive += abs(mean) <= 1.96 * e.std() / math.sqrt(e.size)
    assert 0.91 <= robust / 300 <= 0.985
    assert naive / 300 < 0.7


def of_a_regression(rng: np.random.Generator, passages: int) -> tuple[float, EstimateCovariance]:
    """The estimate of a coefficient that is 0, of a regressor that is on in stretches of 15."""
    rows = lfilter([1.0], [1.0, -0.8], rng.standard_normal((1500, 6)), axis=0)
    rows[:, 0] = 0.0
    for first in rng.integers(0, 1485, passages):
        rows[first : first + 15, 0] = 1.0
    e = rng.standard_normal(1500)
    fitted = np.linalg.lstsq(rows, e, rcond=None)[0]
    e -= rows @ fitted
    variance = float(np.mean(e**2))
    return float(fitted[0]), sandwich_covariance(
        rows * e[:, None] / variance, rows.T @ rows / variance
    )


@pytest.mark.parametrize(("passages", "uncorrected"), [(4, 0.90), (20, 0.95)])
def test_intervals_of_few_passages_hold(passages: int, uncorrected: float) -> None:
    """With K degrees of freedom and no correction of the bias they would not (docs/identify.md)."""
    rng, one = np.random.default_rng(6), np.eye(6)[0]
    covered, plain = 0, 0
    for _ in range(400):
        value, spread = of_a_regression(rng, passages)
        covered += abs(value) <= spread.half_width(one)
        plain += abs(value) <= student_quantile(spread.degrees) * math.sqrt(spread.V[0, 0])
    assert 0.92 <= covered / 400 <= 0.98
    assert plain / 400 < uncorrected


def test_what_few_passages_leave_is_as_it_is_defined() -> None:
    _, spread = of_a_regression(np.random.default_rng(7), 5)
    K, scores = spread.degrees, spread.scores
    variance, degrees = spread.variance_and_degrees(np.eye(6)[0])
    scores_of_width = scores @ spread.naive[:, 0]
    time = (np.arange(scores_of_width.size) + 0.5) / scores_of_width.size
    cosines = np.cos(np.pi * np.outer(np.arange(1, K + 1), time))
    shared = (cosines * scores_of_width**2) @ cosines.T
    thrice = 2 / 3 * np.sum(scores_of_width**4 * np.sum(cosines**2, axis=0) ** 2)
    expected = (np.trace(shared) ** 2 - thrice) / (np.sum(shared**2) - thrice)
    assert degrees == pytest.approx(expected, rel=1e-9)
    white = np.linalg.solve(np.linalg.cholesky(scores.T @ scores), scores.T)
    used = np.sum(((cosines * scores_of_width) @ white.T) ** 2)
    used -= (
        2 / 3 * np.sum(np.sum(cosines**2, axis=0) * np.sum(white**2, axis=0) * scores_of_width**2)
    )
    correction = 1 - 2 * used / K / np.sum(scores_of_width**2)
    assert variance == pytest.approx(spread.V[0, 0] / correction, rel=1e-9)


def test_long_run_covariance_is_that_of_the_cosines() -> None:
    scores = np.random.default_rng(0).standard_normal((50, 2)).cumsum(axis=0)
    time = (np.arange(50) + 0.5) / 50
    rows = np.sqrt(2 / 50) * np.cos(np.pi * np.outer(np.arange(1, 9), time))
    assert rows @ rows.T == pytest.approx(np.eye(8), abs=1e-12)
    parts = rows @ scores
    J, number = long_run_covariance(scores, 8)
    assert number == 8
    assert pytest.approx(50 * parts.T @ parts / 8) == J


def test_filter_without_disturbance_is_singles() -> None:
    """With q = 0 and a known start the filter's densities are those of (L1)."""
    _, u, y, _ = record(size=400)
    data = data_of(u, y)
    objective = KalmanObjective(data, Layout(2, 1, 1), 0, WidthLimits())
    p = np.array([*A, 0.4, 0.3, -20.0, math.log(0.1), 0.8, 0.5])
    by_filter = objective.log_densities(p[None, :])[0]
    simulator = PlantSimulator(data, 2)
    theta = np.array([*A, 0.4, 0.3, 0, 0, 0.8, 0.5, math.log(0.1)])
    z = simulator.simulate_z(theta)
    by_sample = single_densities(data.select_readings(), z, ZoneNoise(0.8, 0.5, 0.1)).value
    settled = slice(200, None)  # the filter's first state is forgotten by then
    assert by_filter[settled] == pytest.approx(by_sample[settled], rel=2e-3, abs=2e-3)


def plain_filter(objective: KalmanObjective, p: Floats) -> tuple[Floats, Floats]:
    """Predicted covariances and g (N), one sample after the other."""
    data, layout, model = objective.data, objective.layout, objective.model
    lane = objective.lane_numbers(p)
    F, B, G, H = (
        part.full() for part in observer_form_matrices(layout.n, layout.m, model, ca.DM(lane))
    )
    q2, r2, right, left, _, first, first_w = lane[-7:]
    x = np.zeros(len(F))
    P = np.diag([first] * layout.n + [first_w] * (model > 0))
    covariances, gs = [], []
    for u, y, side in zip(data.u, objective.data.y, data.side, strict=True):
        covariances.append(P)
        PH = P @ H[0]
        s = math.sqrt(H[0] @ PH + r2)
        mean = H[0] @ x
        a, b = (y + right - mean) / s, (y - left - mean) / s
        g, k = (y + right * (side > 0) - left * (side < 0) - mean) / s, 1.0
        if side == 0:
            mass = ndtr(a) - ndtr(b) if b < 0 else ndtr(-b) - ndtr(-a)
            at_a, at_b = (math.exp(-0.5 * c**2) / math.sqrt(2 * math.pi) / mass for c in (a, b))
            g = at_b - at_a
            k = g**2 + a * at_a - b * at_b
        gs.append(g)
        x = F @ (x + PH * g / s) + B @ u
        P = F @ (P - np.outer(PH, PH) * k / s**2) @ F.T + q2 * G
    return np.array(covariances), np.array(gs)


@pytest.mark.parametrize("model", [0, 1, 2])
def test_compiled_filter_agrees_with_the_plain_one(model: int) -> None:
    _, u, y, _ = record(size=300, disturbance=0.3)
    objective = KalmanObjective(data_of(u, y), Layout(2, 1, 1), model, WidthLimits())
    p = np.array([*A, 0.4, 0.3, -2.0, -2.5, 0.8, 0.5, 1.0][: objective.size])
    covariances, g = plain_filter(objective, p)
    fit = KalmanFit(objective, p, 0.0)
    assert filter_innovations(fit) == pytest.approx(g, rel=1e-7, abs=1e-7)
    smoothed = smooth_states(fit)
    before = np.einsum("i,tij,j->t", smoothed.H, covariances, smoothed.H)
    assert np.all(smoothed.z_std**2 <= before + 1e-9)


@pytest.mark.parametrize("model", [1, 2])
def test_smoother_is_least_squares_where_all_speaks(model: int) -> None:
    """Without a zone it is the mean of a Gaussian given all readings."""
    _, u, y, _ = record(size=40, disturbance=0.3)
    data = data_of(u, y)._replace(side=np.ones(40, int))
    objective = KalmanObjective(data, Layout(2, 1, 1), model, WidthLimits())
    p = np.array([*A, 0.4, 0.3, -2.0, -2.5, 0.0, 0.0, 1.0])
    lane = objective.lane_numbers(p)
    F, B, G, H = (part.full() for part in observer_form_matrices(2, 1, model, ca.DM(lane)))
    q2, r2, *_, first, first_w = lane[-7:]
    mean, power = np.zeros((40, 3)), np.zeros((40, 3, 40, 3))
    power[0, :, 0] = np.diag([first, first, first_w])
    for t in range(39):
        mean[t + 1] = F @ mean[t] + B @ data.u[t]
        power[t + 1] = np.einsum("ij,jsk->isk", F, power[t])
        power[:, :, t + 1] = np.einsum("ij,skj->ski", F, power[:, :, t])
        power[t + 1, :, t + 1] = F @ power[t, :, t] @ F.T + q2 * G
    readings = np.kron(np.eye(40), H)
    P = power.reshape(120, 120)
    gain = P @ readings.T @ np.linalg.inv(readings @ P @ readings.T + r2 * np.eye(40))
    exact = mean.ravel() + gain @ (data.y - readings @ mean.ravel())
    smoothed = smooth_states(KalmanFit(objective, p, 0.0))
    # what no noise moves makes covariances that can hardly be inverted
    assert smoothed.x == pytest.approx(exact.reshape(40, 3), abs=1e-4)
    left = P - gain @ readings @ P
    z_std = np.sqrt(np.diag(readings @ left @ readings.T))
    assert smoothed.z_std == pytest.approx(z_std, abs=1e-4)


# --- places of a zone


def test_friction_family_with_c_equal_a_is_a_sensor_zone() -> None:
    rng = np.random.default_rng(2)
    u = steps(rng, 400)
    lagged = np.column_stack([np.append(np.zeros(j), u[: u.size - j]) for j in (1, 2)])
    pulses = np.eye(400, 2)
    numbers = np.array([*A, *B, 0.0, 0.0, *A, 0.3, 0.2, 0.0, 0.0])
    z = simulate_friction(2, 1, False, np.hstack([lagged, pulses]), numbers[None, :])[0]
    w = lfilter(np.append(0.0, B), np.append(1.0, A), u)
    assert np.abs(z - dead_zone(w, 0.3, 0.2)).max() < 1e-12


def friction_log(seed=1, size=1200, force=0.4, Ts=0.2):
    """A mass with Coulomb friction, its velocity measured, and noise."""
    rng = np.random.default_rng(seed)
    u = steps(rng, size, 5)
    v = np.zeros(size)
    now, h = 0.0, Ts / 40
    for k in range(size):
        v[k] = now
        for _ in range(40):
            if now == 0.0:
                push = max(abs(u[k]) - force, 0.0) * np.sign(u[k])
                now = h * push
                continue
            moved = now + h * (u[k] - now - force * np.sign(now))
            now = 0.0 if moved * now < 0 else moved
    return Ts * np.arange(size), u, v + 0.02 * rng.standard_normal(size)


def test_friction_is_not_sold_as_a_zone_of_the_sensor() -> None:
    t, u, y = friction_log()
    answer = uz.identify(t=t, u=u, y=y, order=1)
    assert answer.verdict == "friction"
    assert not answer.zone
    for level in (answer.right, answer.left):
        assert level is not None
        assert level.low < 0.4 < level.high  # of friction, in the input's unit


# --- answers


@pytest.mark.parametrize("where", ["behind", *further("ahead")])
def test_widths_lie_in_their_intervals(where: str) -> None:
    t, u, y, z = record(seed=14, where=where, disturbance=0.2 if where == "ahead" else 0.0)
    answer = uz.identify(t=t, u=u, y=y, order="1-2")
    assert answer.verdict == "dead_zone"
    assert answer.order == 2
    assert holds_both(answer, 0.5, 0.3)
    assert answer.width.value == pytest.approx(answer.right.value + answer.left.value)
    states = answer.states()
    inside = np.abs(z) < 0.3
    assert np.sqrt(np.mean((states.z - z)[inside] ** 2)) < 0.3 * np.sqrt(np.mean(z[inside] ** 2))


def test_other_maps_are_named() -> None:
    t, u, _, z = record(seed=6, size=1000)
    noise = 0.02 * np.random.default_rng(0).standard_normal(z.size)
    zero = np.where((z > 0.5) | (z < -0.3), z, 0.0)
    cases = {"none": z + noise, "saturation": np.clip(z, -0.5, 0.6) + noise, "jump": zero + noise}
    for verdict, y in cases.items():
        answer = uz.identify(t=t, u=u, y=y, order=2, delay=0)
        assert answer.verdict == verdict
        assert answer.width is None
        with pytest.raises(InputError, match="there is no zone"):
            answer.scenario()


def test_edges_that_are_given_or_never_reached() -> None:
    t, u, y, _ = record(seed=7, left=30.0)
    never = uz.identify(t=t, u=u, y=y, order=2, delay=0)
    assert never.verdict == "unreached"
    assert never.left.low > 0.3
    assert math.isinf(never.left.high)
    assert holds(never.right, 0.5)
    one_sided = uz.identify(t=t, u=u, y=y, order=2, left=math.inf, delay=0)
    assert one_sided.verdict == "dead_zone"
    assert one_sided.left is None
    t, u, y, _ = record(seed=7)
    known = uz.identify(t=t, u=u, y=y, order=2, right=0.5, place="sensor", delay=0)
    assert known.right == (0.5, 0.5, 0.5)
    assert holds(known.left, 0.3)
    with pytest.raises(InputError, match="readings lie beyond it"):
        uz.identify(t=t, u=u, y=y, left=math.inf)


def test_an_offset_widens_the_centre_and_not_the_width() -> None:
    t, u, y, _ = record(seed=8, where="behind")
    plain = uz.identify(t=t, u=u, y=y, order=2, place="sensor", delay=0)
    wide = uz.identify(t=t, u=u, y=y, order=2, place="sensor", offset=0.1, delay=0)
    free = uz.identify(t=t, u=u, y=y, order=2, place="sensor", offset="free", delay=0)
    assert wide.width == plain.width
    assert wide.centre.half_width == pytest.approx(math.hypot(plain.centre.half_width, 0.1))
    assert math.isinf(free.centre.high)
    assert free.width == plain.width


def test_missing_readings_glitches_and_two_records() -> None:
    t, u, y, _ = record(seed=9)
    rng = np.random.default_rng(1)
    holed = np.where(rng.random(y.size) < 0.2, np.nan, y)
    holed[500] = 40.0
    t2, u2, y2, _ = record(seed=10)
    one = uz.identify(t=t, u=u, y=holed, order=2, place="sensor", delay=0)
    assert holds(one.right, 0.5)
    assert any("missing" in remark for remark in one.answer.remarks)
    pandas = import_package("pandas")
    frames = []
    for parts in ((t, u, y), (t2, u2, y2)):
        frames.append(
            pandas.DataFrame(dict(zip(("time [s]", "u [V]", "y [mm]"), parts, strict=True)))
        )
    both = uz.identify(frames, order=2, delay=0)
    assert both.answer.fit.objective.layout.records == 2
    assert holds(both.right, 0.5)
    assert both.answer.case.grid.output_unit == "mm"


def test_swapped_columns_give_no_widths() -> None:
    t, u, y, _ = record(seed=11)
    try:
        answer = uz.identify(t=t, u=y, y=u, order=2)
    except InputError:
        return
    assert answer.verdict != "dead_zone"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, u, y: (t, u, y * np.nan), "every one is missing"),
        (lambda t, u, y: (np.roll(t, 9), u, y), "does not increase"),
        (
            lambda t, u, y: (t, np.where(t == t[50], np.nan, u), y),
            "line 51: input 'u' is missing",
        ),
        (lambda t, u, y: (t, u[:-1], y), "as many rows"),
    ],
)
def test_what_cannot_be_used_is_refused(change, message: str) -> None:
    t, u, y, _ = record()
    t, u, y = change(t, u, y)
    with pytest.raises(InputError, match=message):
        uz.identify(t=t, u=u, y=y)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, u, y: (t, 0 * u + 1, y), "input is constant"),
        (lambda t, u, y: (t, u, 0 * y), "always silent"),
        (lambda t, u, y: (t, u, 0 * y + 3), "never changes"),
        (lambda t, u, y: (t[:60], u[:60], y[:60]), "too few"),
    ],
)
def test_a_sound_log_that_shows_nothing_has_an_answer(change, message: str) -> None:
    t, u, y, _ = record()
    t, u, y = change(t, u, y)
    account = uz.identify(t=t, u=u, y=y).account
    assert not account.effects
    assert message in account.doubts[0]


def test_a_short_log_that_sticks_at_its_ends_counts_all_its_readings() -> None:
    """Too few lie between them; it was refused."""
    t, u, _, z = record(size=200)
    answer = uz.identify(t=t, u=u, y=np.clip(z + 0.01 * np.sin(1e3 * t), -0.3, 0.3))
    assert answer.verdict == "saturation"
    assert any("too few lie between them" in one for one in answer.numbers()["remarks"])


def test_invalid_options_are_refused() -> None:
    t, u, y, _ = record()
    for key, value in {
        "order": "0-3", "right": "-1", "left": "2,1", "offset": "x", "held_out": 0.9,
        "noise": "white", "place": "moon", "threshold": -1.0,
    }.items():  # fmt: skip
        with pytest.raises(InputError, match=key):
            uz.identify(t=t, u=u, y=y, **{key: value})


def test_identify_holds_blas_to_one_thread_meanwhile() -> None:
    """Two threads that wait for each other at small matrices take three times the CPU time."""

    def list_threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    t, u, y, _ = record(size=300)
    seen: list[list[int]] = []
    with threadpool_limits(2, user_api="blas"):
        before = list_threads()
        uz.identify(t=t, u=u, y=y, order=1, progress=lambda _: seen.append(list_threads()))
        assert list_threads() == before
    assert set(before) == {2}
    assert {threads for each in seen for threads in each} == {1}
