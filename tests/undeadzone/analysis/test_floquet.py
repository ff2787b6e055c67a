"""Rates: sides found exactly, Floquet multipliers against naive twins and the real loop's decay."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, solve_continuous_lyapunov
from test_identifiability import visiting

from scenes import random_plant, scene, seeds, tables_of
from undeadzone.analysis.branch_schedule import (
    Schedule,
    level_crossing_times,
    merge_equal_neighbours,
    plan_schedule,
    schedule_of_record,
)
from undeadzone.analysis.convergence.floquet import (
    Rates,
    error_decay_rates,
    error_matrices,
    integrate_spans,
    matrix_product,
    span_transitions,
)
from undeadzone.analysis.error_dynamics import adaptation_matrix, branch_pattern
from undeadzone.analysis.identifiability.linear import unobservable_changes
from undeadzone.scenario.problem import constant_gains, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Samples, Sine, Sines, Tone, Trapezoid, build_exosystem
from undeadzone.simulation.simulate import simulate

SAMPLED = {"time": "sampled", "step": 1e-2}
TWO_SINES = tables_of("""
kind = "sines"
components = [
    { amplitude = 3.0, frequency = 0.5 },
    { amplitude = 2.0, frequency = 0.75, phase = 1.0 },
]
offset = 0.4
""")
COUPLED = tables_of("""
A = [[0.0, 1.0, 0.0, 0.0], [-4.0, -1.5, 1.0, 0.2], [0.0, 0.0, 0.0, 1.0], [1.0, 0.2, -3.0, -1.2]]
B = [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]
C = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
""")


def schedule_of(scenario: Scenario) -> Schedule:
    problem = resolve_scenario(scenario)
    return plan_schedule(
        problem.model,
        problem.reference,
        problem.tracked,
        problem.sensor,
        scenario.simulation.duration,
    )


def rates_of(scenario: Scenario) -> Rates:
    problem = resolve_scenario(scenario)
    gains = constant_gains(problem.observer, problem.model)
    assert gains is not None
    return error_decay_rates(
        problem.model.linear, *gains, schedule_of(scenario), problem.sensor.kind == "jump"
    )


def certified(L: Any, gamma: float, **more: Any) -> dict[str, Any]:
    return {"method": "certified", "L": L, "gamma": gamma, **more}


@pytest.mark.parametrize(
    ("L", "gamma", "rate"),
    [
        ([12.0, 15.0], 2.0, 0.024),
        ([2.0, 3.0], 10.0, 0.323),
        ([1.0, 1.5], 10.0, 0.441),
        ([0.0, 0.0], 10.0, 1.0),
        ([-0.8733471274245267, 0.7566942548490535], 7.780464880364364, 1.469),
    ],
)
def test_rates_of_the_paper_example(L: list[float], gamma: float, rate: float) -> None:
    found = rates_of(scene(observer=certified(L, gamma)))
    assert found.rate == pytest.approx(rate, abs=6e-4)
    assert found.time_constant == pytest.approx(1 / found.rate)
    assert (found.period, found.periodic, found.never) == (1.0, True, ())


def test_the_fastest_gains_are_delicate() -> None:
    """There three multipliers meet: four digits of the gains are not enough to keep the rate."""
    rounded = rates_of(scene(observer=certified([-0.8733, 0.7567], 7.780)))
    assert rounded.rate == pytest.approx(1.427, abs=1e-3)


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize(
    ("L", "gamma", "reference", "duration"),
    [
        ([12.0, 15.0], 2.0, {"kind": "sine", "amplitude": 5.0, "frequency": 1.0}, 60.0),
        ([2.0, 3.0], 10.0, {"kind": "sine", "amplitude": 5.0, "frequency": 1.0}, 20.0),
        ([1.0, 1.5], 10.0, {"kind": "sine", "amplitude": 2.0, "frequency": 1.0}, 20.0),
        ([1.0, 0.5], 3.0, TWO_SINES, 36.0),
    ],
)
def test_the_loop_decays_at_the_rate_predicted(
    sampled: bool, L: list[float], gamma: float, reference: dict[str, Any], duration: float
) -> None:
    """The real loop's error, seen once a period, falls at -ln rho / T within 2 % in the end."""
    simulation = {"duration": duration} | (SAMPLED if sampled else {"step": 2e-3})
    scenario = scene(
        observer=certified(L, gamma, widths0=[0.5, 0.7], width_max=3.0),
        reference=reference,
        sensor={"right": 1.3, "left": 0.8},
        simulation=simulation,
    )
    predicted = rates_of(scenario)
    run = simulate(scenario, check_step=False)
    errors = np.hstack([run.x - run.x_hat, run.info.widths - run.d_hat])
    error = np.linalg.norm(errors, axis=1)[:: round(predicted.period / run.info.step)]
    t = np.arange(error.size) * predicted.period
    late = (t > 0.4 * duration) & (error > 1e-9)
    assert late.sum() >= 3
    decay = -np.polyfit(t[late], np.log(error[late]), 1)[0]
    assert decay == pytest.approx(predicted.rate, rel=0.02)


def test_two_outputs_decay_at_the_rate_predicted() -> None:
    """With a complex slowest pair the decay is read off in the slow plane, over whole turns."""
    scenario = scene(
        """
        sensor = { right = [0.5, 0.2], left = [0.3, 0.6] }
        reference = { kind = "sine", amplitude = [2.0, 1.5], frequency = 0.5, phase = [0.0, 1.0] }
        observer.method = "certified"
        observer.L = [[1.0, 0.2], [0.5, 0.0], [0.0, 1.5], [0.1, 0.4]]
        observer.gamma = [2.0, 3.0]
        simulation = { duration = 30.0, step = 0.002 }
        """,
        plant=COUPLED,
    )
    predicted = rates_of(scenario)
    run = simulate(scenario, check_step=False)
    error = np.hstack([run.x - run.x_hat, run.info.widths - run.d_hat])[::1000]
    t = 2.0 * np.arange(len(error))
    late = (t > 8.0) & (np.linalg.norm(error, axis=1) > 1e-9)
    plane = np.linalg.lstsq(predicted.slow, error[late].T, rcond=None)[0]
    assert predicted.logs[0].imag == 0.0
    decay = -np.polyfit(t[late], np.log(np.linalg.norm(plane, axis=0)), 1)[0]
    assert decay == pytest.approx(predicted.rate, rel=0.02)


def test_what_dies_last_is_the_slow_direction() -> None:
    scenario = scene(simulation={"duration": 12.0, "step": 2e-3})
    run = simulate(scenario, check_step=False)
    last = np.concatenate([run.x[-1] - run.x_hat[-1], run.info.widths - run.d_hat[-1]])
    slow = rates_of(scenario).slow[:, 0]
    cosine = abs(last @ slow) / np.linalg.norm(last) / np.linalg.norm(slow)
    assert cosine == pytest.approx(1.0, abs=1e-4)


@given(seeds, st.integers(1, 4), st.integers(1, 2), st.booleans())
def test_the_monodromy_matrix_is_the_product_of_naive_transitions(
    seed: int, n: int, p: int, sampled: bool
) -> None:
    rng = np.random.default_rng(seed)
    A, _, C = random_plant(rng, n, 1, p).linear
    L = rng.normal(size=(n, p))
    gamma = adaptation_matrix(rng.uniform(0.5, 3.0, p), p)
    K, Ts = int(rng.integers(1, 8)), 0.02
    sides = rng.integers(-1, 2, (K, p)).astype(float)
    spans = rng.integers(1, 30, K).astype(float) if sampled else rng.uniform(0.01, 2.0, K)
    none = np.zeros(p)
    schedule = Schedule(
        sides, spans, Ts if sampled else None, True, 0.0, none, none, none, np.ones((p, 2))
    )
    F, _ = error_matrices(A, C, L, gamma, sides)
    M, size = matrix_product(span_transitions(F, schedule))
    naive = np.eye(n + 2 * p)
    for side, span in zip(sides.astype(int), spans, strict=True):
        S, on = branch_pattern(tuple(side)), np.diag(np.abs(side))
        f = np.block([[A - L @ on @ C, L @ S], [gamma @ S.T @ C, -gamma @ S.T @ S]])
        if sampled:
            naive = np.linalg.matrix_power(np.eye(n + 2 * p) + Ts * f, int(span)) @ naive
        else:
            naive = expm(f * span) @ naive
    assert M * np.exp(size) == pytest.approx(naive, rel=1e-9, abs=1e-9 * np.abs(naive).max())


def test_a_long_span_beside_a_short_one_holds_the_integrals_of_each() -> None:
    """G and GG by the equation of Lyapunov that an integral of Phi'H Phi solves."""
    rng, none = np.random.default_rng(0), np.zeros(1)
    F = rng.normal(size=(3, 2, 2)) - 3 * np.eye(2)
    H, lengths = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([0.01, 1.0, 30.0])
    schedule = Schedule(
        np.zeros((3, 1)), lengths, None, True, 0.0, none, none, none, np.ones((1, 2))
    )
    whole, plain = integrate_spans(F, [H, 2 * H], schedule, 1), integrate_spans(F, [H], schedule)
    assert (plain.G[0] == whole.G[0]).all()
    assert (whole.G[1] == 2 * whole.G[0]).all()
    assert (len(whole.GG), len(plain.GG)) == (1, 0)
    for k, (f, length) in enumerate(zip(F, lengths, strict=True)):
        Phi = expm(f * length)
        G = solve_continuous_lyapunov(f.T, Phi.T @ H @ Phi - H)
        GG = solve_continuous_lyapunov(f.T, G - length * H)
        assert whole.Phi[k] == pytest.approx(Phi, abs=1e-12)
        assert whole.G[0, k] == pytest.approx(G, rel=1e-9)
        assert whole.GG[0, k] == pytest.approx(GG, rel=1e-9)


def test_a_run_that_does_not_repeat_is_predicted_by_its_recorded_sides() -> None:
    """The error at the end of a recorded run is the product of transitions times the first."""
    scenario = scene(
        reference={
            "kind": "sines",
            "components": [
                {"amplitude": 2.0, "frequency": 0.6},
                {"amplitude": 1.5, "frequency": 2**0.5},
            ],
        },
        observer=certified([1.0, 0.5], 3.0, widths0=[0.5, 0.7]),
        simulation={"duration": 6.0, **SAMPLED},
    )
    run, problem = simulate(scenario), resolve_scenario(scenario)
    schedule = schedule_of_record(run.z[:-1], problem.sensor, 1e-2, 1e-2)
    error = np.hstack([run.x - run.x_hat, run.info.widths - run.d_hat])
    gains = constant_gains(problem.observer, problem.model)
    assert gains is not None
    F, _ = error_matrices(
        (problem.model.linear.A - np.eye(2)) / 1e-2,
        problem.model.linear.C,
        gains[0],
        adaptation_matrix(gains[1], 1),
        schedule.sides,
    )
    M, size = matrix_product(span_transitions(F, schedule))
    assert M @ error[0] * np.exp(size) == pytest.approx(error[-1], abs=1e-9)
    found = error_decay_rates(problem.model.linear, *gains, schedule)
    assert (found.periodic, found.period) == (False, pytest.approx(6.0))
    assert not schedule_of(scenario).periodic


def test_recorded_and_planned_rates_agree() -> None:
    scenario = scene(simulation={"duration": 12.0, "step": 1e-3})
    run, problem = simulate(scenario, check_step=False), resolve_scenario(scenario)
    schedule = schedule_of_record(run.z[8000:], problem.sensor, 1e-3, None)
    gains = constant_gains(problem.observer, problem.model)
    assert gains is not None
    assert error_decay_rates(problem.model.linear, *gains, schedule).rate == pytest.approx(
        rates_of(scenario).rate, rel=1e-3
    )


def test_a_long_record_does_not_underflow() -> None:
    scenario = scene(reference={"kind": "sine", "amplitude": 5.0, "frequency": 1.0})
    problem, once = resolve_scenario(scenario), merge_equal_neighbours(schedule_of(scenario))
    long = once._replace(sides=np.tile(once.sides, (3000, 1)), spans=np.tile(once.spans, 3000))
    gains = constant_gains(problem.observer, problem.model)
    assert gains is not None
    assert error_decay_rates(problem.model.linear, *gains, long).rate == pytest.approx(
        rates_of(scenario).rate, rel=1e-6
    )


def test_sampled_rates_tend_to_the_continuous_one() -> None:
    """An error of first order: sides change at samples only."""
    exact = rates_of(scene()).rate
    for step in (1e-2, 1e-3, 1e-4):
        sampled = rates_of(scene(simulation={"time": "sampled", "step": step}))
        assert sampled.rate == pytest.approx(exact, abs=0.1 * step)


@pytest.mark.parametrize(
    ("changes", "never"),
    [
        (
            {"plant": {"integrators": 2}, "observer": certified([3.0, 2.0], 1.0)},
            ("x[0]", "centre[0]"),
        ),
        ({"plant": {"integrators": 1}, "observer": certified([3.0], 1.0)}, ("x[0]", "centre[0]")),
        (
            {"reference": {"kind": "sine", "amplitude": 2.0, "frequency": 1.0, "offset": 2.0}},
            ("left[0]",),
        ),
        (
            {"reference": {"kind": "sine", "amplitude": 0.9, "frequency": 1.0}},
            ("right[0]", "left[0]"),
        ),
        ({"sensor": {"kind": "jump"}}, ()),
    ],
)
def test_errors_that_never_die_are_named_and_set_apart(
    changes: dict[str, Any], never: tuple[str, ...]
) -> None:
    found = rates_of(scene(**changes))
    assert found.never == never
    assert found.rate > 0.05
    assert (found.logs.real < -1e-6).all()


def test_a_silent_sensor_leaves_the_plants_own_rate() -> None:
    silent = scene(reference={"kind": "sine", "amplitude": 0.5, "frequency": 1.0})
    assert rates_of(silent).rate == pytest.approx(1.0, rel=1e-6)


def test_errors_that_grow_have_a_negative_rate() -> None:
    assert -10 < rates_of(scene(observer=certified([-3.0, 0.0], 1.0))).rate < 0
    boundless = rates_of(scene(observer=certified([-2000.0, 0.0], 1.0)))
    assert (boundless.rate, boundless.time_constant) == (-np.inf, np.inf)


@pytest.mark.parametrize("amplitude", [1.0 + 1e-7, 1.5, 5.0, 1e4])
def test_sides_change_where_the_sine_says(amplitude: float) -> None:
    found = schedule_of(scene(reference={"kind": "sine", "amplitude": amplitude, "frequency": 1.0}))
    first = np.arcsin(1 / amplitude) / (2 * np.pi)
    assert np.cumsum(found.spans) == pytest.approx(
        [first, 0.5 - first, 0.5 + first, 1 - first, 1.0], abs=1e-12
    )
    assert found.sides.ravel().tolist() == [0.0, 1.0, 0.0, -1.0, 0.0]
    assert (found.low[0], found.high[0]) == (pytest.approx(-amplitude), pytest.approx(amplitude))


def test_sides_of_a_trapezoid_and_of_a_touch() -> None:
    found = merge_equal_neighbours(
        schedule_of(
            scene(reference={"kind": "trapezoid", "amplitude": 2.0, "rise": 1.0, "hold": 1.0})
        )
    )
    assert found.spans == pytest.approx([0.5, 2.0, 1.0, 2.0, 0.5], abs=1e-12)
    touching = schedule_of(
        scene(reference={"kind": "trapezoid", "amplitude": 1.0, "rise": 1.0, "hold": 1.0})
    )
    assert not touching.sides.any()


@given(seeds, st.integers(1, 5))
def test_no_crossing_of_a_sum_of_sines_is_missed(seed: int, tones: int) -> None:
    """Against all roots of the trigonometric polynomial, from its companion matrix."""
    rng = np.random.default_rng(seed)
    amplitude, phase = rng.normal(size=tones), rng.uniform(0, 6, tones)
    components = []
    for k, (a, f) in enumerate(zip(amplitude, phase, strict=True), 1):
        components.append(Tone(amplitude=a, frequency=float(k), phase=f))
    signal = build_exosystem("r", Sines(components=components), 1)
    level = rng.uniform(-1, 1) * np.abs(amplitude).sum() * 0.7
    found = level_crossing_times(signal, signal.Q[0], level, np.array([0.0, 1.0]))
    polynomial = np.zeros(2 * tones + 1, complex)  # z^tones (r - level), z = e^{2 pi j t}
    for k, (a, f) in enumerate(zip(amplitude, phase, strict=True), 1):
        polynomial[tones + k] += a * np.exp(1j * f) / 2j
        polynomial[tones - k] -= a * np.exp(-1j * f) / 2j
    polynomial[tones] -= level
    z = np.roots(polynomial[::-1])
    expected = np.sort(np.angle(z[np.abs(np.abs(z) - 1) < 1e-6]) / (2 * np.pi) % 1.0)
    assert found == pytest.approx(expected, abs=1e-6)
    assert signal.output_at(found)[:, 0] == pytest.approx(level, abs=1e-9)


def test_crossings_of_samples(tmp_path: Any) -> None:
    path = tmp_path / "r.csv"
    path.write_text("t,r\n0,0\n1,2\n2,-2\n3,2\n")
    lines = build_exosystem("r", Samples(path=str(path), smooth=False), 1)
    assert level_crossing_times(lines, lines.Q[0], 1.0, lines.corners) == pytest.approx(
        [0.5, 1.25, 2.75], abs=1e-12
    )
    spline = build_exosystem("r", Samples(path=str(path)), 1)
    found = level_crossing_times(spline, spline.Q[0], 1.0, spline.corners)
    assert found.size == 3
    assert spline.output_at(found)[:, 0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("signal", "period"),
    [
        (Sine(amplitude=1.0, frequency=0.3), 1 / 0.3),
        (Sines(components=[Tone(amplitude=1.0, frequency=f) for f in (0.5, 0.2)]), 10.0),
        (Sines(components=[Tone(amplitude=1.0, frequency=f) for f in (1 / 3, 0.25, 0.5)]), 12.0),
        (Sines(components=[Tone(amplitude=1.0, frequency=f) for f in (1.0, 2**0.5)]), None),
        (Trapezoid(amplitude=1.0, rise=0.5, hold=0.25), 2.5),
    ],
)
def test_periods(signal: Any, period: float | None) -> None:
    assert build_exosystem("r", signal, 1).period == (
        None if period is None else pytest.approx(period)
    )


def test_the_gain_is_the_most_that_one_pass_makes_of_an_error() -> None:
    """By plain exponentials, in the balanced units that it is stated in."""
    scenario = scene()
    schedule = merge_equal_neighbours(schedule_of(scenario))
    problem = resolve_scenario(scenario)
    gains = constant_gains(problem.observer, problem.model)
    assert gains is not None
    found = error_decay_rates(problem.model.linear, *gains, schedule)
    F, _ = error_matrices(
        problem.model.linear.A,
        problem.model.linear.C,
        gains[0],
        adaptation_matrix(gains[1], 1),
        schedule.sides,
    )
    units = unobservable_changes(problem.model.linear, schedule.branch_visits()).scale
    M = np.eye(4)
    for matrix, span in zip(F, schedule.spans, strict=True):
        M = expm(matrix * span) @ M
    assert found.gain == pytest.approx(np.linalg.norm(M * units / units[:, None], 2), rel=1e-9)
    ends = np.abs(np.random.default_rng(0).normal(size=(4, 1000)))
    assert (np.linalg.norm(M * units / units[:, None] @ ends, axis=0)).max() <= (
        found.gain * np.linalg.norm(ends, axis=0).max()
    )


def test_what_does_not_move_grows_as_time_and_its_square() -> None:
    schedule = visiting([True], [True])
    still = integrate_spans(np.zeros((3, 2, 2)), [np.eye(2)], schedule, 1)
    for k, t in enumerate(schedule.spans):
        np.testing.assert_allclose(still.G[0, k], t * np.eye(2), rtol=1e-12)
        np.testing.assert_allclose(still.GG[0, k], t**2 / 2 * np.eye(2), rtol=1e-12)
