"""Identifiable widths: verdicts against brute force, deviations against filters, cures that "
"cure."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from scenes import PAPER_PLANT, random_plant, scene, seeds, table, tables_of
from undeadzone.analysis.branch_schedule import Schedule, plan_schedule
from undeadzone.analysis.error_dynamics import branch_pattern
from undeadzone.analysis.identifiability.disturbance import first_order_inputs, unknown_bias
from undeadzone.analysis.identifiability.information import (
    ReadingConditions,
    information_matrix,
    optimal_deviations,
)
from undeadzone.analysis.identifiability.linear import (
    DIRECTIONS,
    WidthIdentifiability,
    find_remedies,
    null_space_basis,
    remedy_to_reach_edges,
    unobservable_changes,
    unobservable_subspace,
    width_identifiability,
)
from undeadzone.analysis.identifiability.two_elements import sensor_actuator_identifiability
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.plants.options import Plant, TransferFunction, linear_matrices
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Random
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_design.synthesis.check import check

CHAIN = linear_matrices(Plant(integrators=2))
WIDTHS = np.array([1.0, 0.7])


def visiting(right: list[bool], left: list[bool], Ts: float | None = None) -> Schedule:
    """A schedule that visits those sides long enough, and that is all that is said of it."""
    sides = np.array([np.zeros(len(right)), np.array(right, float), -np.array(left, float)])
    spans = np.array([0.3, 0.5, 0.7]) if Ts is None else np.array([20.0, 30.0, 40.0])
    high, low = np.where(right, 2.0, 0.9), np.where(left, -2.0, -0.9)
    return Schedule(
        sides,
        spans,
        Ts,
        True,
        0.0 if Ts is None else 1.0,
        low,
        (high + low) / 2,
        high,
        np.ones((len(right), 2)),
    )


def plan(scenario: Scenario) -> tuple[Matrices, Schedule]:
    problem = resolve_scenario(scenario)
    return problem.model.linear, plan_schedule(
        problem.model,
        problem.reference,
        problem.tracked,
        problem.sensor,
        scenario.simulation.duration,
    )


def flags(verdict: WidthIdentifiability) -> tuple[bool, ...]:
    return verdict[:4]


@given(seeds, st.integers(1, 4), st.booleans(), st.booleans())
def test_the_centre_is_known_exactly_when_A_is_nonsingular(
    seed: int, n: int, singular: bool, sampled: bool
) -> None:
    A, B, C = random_plant(np.random.default_rng(seed), n).linear
    if singular:
        A = np.where(np.arange(n) == 0, 0.0, A)
    plant, Ts = Matrices(A, B, C), 0.01 if sampled else None
    (found,) = width_identifiability(
        plant if Ts is None else zoh(plant, Ts), visiting([True], [True], Ts)
    )
    assert flags(found) == (not singular, not singular, True, not singular)
    assert ("A is singular (an integrator), only the width" in " ".join(found.reasons)) == singular


@pytest.mark.parametrize(
    "plant", [CHAIN, linear_matrices(Plant(integrators=1)), PAPER_PLANT.linear]
)
@pytest.mark.parametrize(("right", "left"), list(product([True, False], repeat=2)))
def test_verdict_of_each_visit(plant: Matrices, right: bool, left: bool) -> None:
    integrator = np.linalg.matrix_rank(plant.A) < len(plant.A)
    (found,) = width_identifiability(plant, visiting([right], [left]))
    assert flags(found) == (
        right and not integrator,
        left and not integrator,
        right and left,
        right and left and not integrator,
    )
    assert sum("never reached" in reason for reason in found.reasons) == (not right) + (not left)
    assert ("cannot be separated from a shift" in " ".join(found.reasons)) == (
        integrator and right != left
    )


@pytest.mark.parametrize("Ts", [None, 1e-3, 0.1])
def test_an_unknown_bias_hides_the_centre_unless_the_output_does_not_feel_it(
    Ts: float | None,
) -> None:
    """C A^-1 B = 0 is a zero at s = 0: a constant input then leaves no trace in z."""
    for plant, felt in (
        (PAPER_PLANT.linear, True),
        (
            linear_matrices(
                Plant(
                    transfer_function=TransferFunction(
                        numerator=[1.0, 0.0], denominator=[1.0, 2.0, 1.0]
                    )
                )
            ),
            False,
        ),
    ):
        model = plant if Ts is None else zoh(plant, Ts)
        (found,) = width_identifiability(model, visiting([True], [True], Ts), bias=model.B)
        assert flags(found) == (not felt, not felt, True, not felt)
        assert (
            "constant input bias, centre and bias cannot be separated" in " ".join(found.reasons)
        ) == felt


def test_a_jump_sensor_tells_each_edge_that_is_passed() -> None:
    (found,) = width_identifiability(CHAIN, visiting([True], [False]), jump=True)
    assert flags(found) == (True, False, False, False)


def test_each_output_is_judged_by_itself() -> None:
    """Of an integrator and a stable part, each behind a dead zone, the first loses its centre."""
    found = width_identifiability(
        Matrices(np.diag([0.0, -1.0]), np.ones((2, 1)), np.eye(2)),
        visiting([True, True], [True, True]),
    )
    assert [verdict.centre for verdict in found] == [False, True]
    assert [verdict.width for verdict in found] == [True, True]


def test_a_state_that_only_a_silent_output_sees_is_not_determined() -> None:
    plant = Matrices(np.diag([-1.0, -2.0]), np.ones((2, 1)), np.eye(2))
    hidden = unobservable_changes(plant, np.array([[True, True], [False, False]]))
    assert [hidden.is_state_known(0), hidden.is_state_known(1)] == [True, False]
    assert hidden.names_of_undetermined == ("x[1]", "right[1]", "left[1]")


@given(seeds, st.integers(1, 4), st.booleans())
def test_verdicts_do_not_depend_on_units(seed: int, n: int, singular: bool) -> None:
    """States, outputs, inputs and time in other units, by factors from 1e-4 to 1e4."""
    rng = np.random.default_rng(seed)
    A, B, C = random_plant(rng, n).linear
    if singular:
        A = np.where(np.arange(n) == 0, 0.0, A)
    state = 10.0 ** rng.uniform(-4, 4, n)
    output = 10.0 ** rng.uniform(-4, 4)
    time = 10.0 ** rng.uniform(-4, 4)
    scaled = Matrices(time * A * state / state[:, None], B / state[:, None], output * C * state)
    (found,) = width_identifiability(scaled, visiting([True], [True]))
    assert (found.width, found.centre) == (True, not singular)


def sensitivities(plant: Matrices, x0: Floats, u: Floats, widths: Floats, step: float) -> Floats:
    """d y_k / d [x0; d] (N x p x (n + 2p)) by central differences of the simulated plant."""
    n, p = len(plant.A), len(plant.C)

    def readings(unknown: Floats) -> Floats:
        x, d = unknown[:n], unknown[n:].reshape(p, 2)
        found = []
        for now in u:
            found.append(deadzone(plant.C @ x, d[:, 0], d[:, 1]))
            x = plant.A @ x + plant.B @ now
        return np.array(found)

    centre, moves = np.concatenate([x0, widths.ravel()]), np.eye(n + 2 * p) * step
    return np.stack(
        [(readings(centre + move) - readings(centre - move)) / (2 * step) for move in moves], axis=2
    )


@pytest.mark.parametrize(
    "changes",
    [
        {},
        tables_of("""
            plant = { integrators = 2, x0 = [0.2, 0.0] }
            observer = { method = "certified", L = [3.0, 2.0] }
            """),
        tables_of("""
            plant = { companion = [0.0, 2.0, 3.0] }
            observer = { method = "certified", L = [3.0, 2.0, 0.0] }
            """),
        {"reference": {"kind": "sine", "amplitude": 2.0, "frequency": 1.0, "offset": 2.0}},
        tables_of("""
            plant.A = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -2.0, -1.0]]
            plant.B = [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]
            plant.C = [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0]]
            observer = { method = "certified", L = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]] }
            """),
    ],
)
def test_the_invisible_directions_are_the_kernel_of_the_brute_force_gramian(
    changes: dict[str, Any],
) -> None:
    """Perturb x(0) and the widths under the loop's input, square the change of the readings."""
    p = len(changes.get("plant", {}).get("C", [0]))
    scenario = scene(
        **changes,
        sensor={"right": [1.0] * p, "left": [0.7] * p},
        simulation={"time": "sampled", "step": 2e-2, "duration": 4.0},
    )
    run, problem = simulate(scenario), resolve_scenario(scenario)
    plant, widths = problem.model.linear, np.tile(WIDTHS, (p, 1))
    rows = np.concatenate(sensitivities(plant, run.x[0], run.u, widths, 1e-5))
    visited = np.stack([(run.side == side).sum(axis=0) > 4 for side in (1, -1)], axis=1)
    hidden = unobservable_changes(plant, visited, 2e-2)
    _, singular, rotation = np.linalg.svd(rows)
    kernel = rotation[int((singular > 1e-6 * singular[0]).sum()) :].T
    found = np.linalg.qr(hidden.basis * hidden.scale[:, None])[0]
    assert found.shape == kernel.shape
    assert found @ found.T == pytest.approx(kernel @ kernel.T, abs=1e-5)
    assert len(run.info.identifiable) == p
    for i, verdict in enumerate(run.info.identifiable):
        own = kernel[len(plant.A) + 2 * i :][:2]
        for name, g in DIRECTIONS.items():
            assert verdict[name] == (not (np.abs(np.array(g) @ own) > 1e-6).any())


@pytest.mark.parametrize("bias", [False, True])
def test_deviations_are_those_of_the_brute_force_gramian(bias: bool) -> None:
    """Sampled, without process noise: sigma times the root of the inverse of the summed squares."""
    scenario = scene("""
        sensor = { left = 0.7 }
        simulation = { time = "sampled", step = 0.02, duration = 3.0 }
        """)
    linear, schedule = plan(scenario)
    found = optimal_deviations(
        linear,
        schedule,
        ReadingConditions(np.array([0.05]), 2e-2, 3.0, bias=linear.B if bias else None),
    )
    run = simulate(
        scene(
            """
            sensor = { left = 0.7 }
            simulation = { time = "sampled", step = 0.02, duration = 12.0 }
            """,
            plant={**PAPER, "x0": [0.0, 0.0]},
        )
    )
    later = slice(450, 600)  # three whole periods, the transients gone
    rows = np.concatenate(sensitivities(linear, run.x[450], run.u[later], WIDTHS[None], 1e-5))
    if bias:
        tail = np.zeros((len(rows), 1))
        x = np.zeros(2)
        for k in range(len(rows)):
            tail[k] = linear.C @ x if run.side[450 + k, 0] else 0.0
            x = linear.A @ x + linear.B[:, 0]
        rows = np.hstack([rows, tail])
    covariance = 0.05**2 * np.linalg.pinv(rows.T @ rows, rcond=1e-9)
    for name, g in DIRECTIONS.items():
        if bias and name != "width":
            assert found.widths[0][name] == np.inf
        else:
            assert found.widths[0][name] == pytest.approx(
                float(np.sqrt(np.array(g) @ covariance[2:4, 2:4] @ np.array(g))), rel=1e-4
            )
    assert list(map(found.hidden.is_state_known, range(2))) == [not bias, True]


PAPER = tables_of("""
A = [[0.0, 1.0], [-1.0, -2.0]]
B = [[0.0], [1.0]]
C = [[1.0, 0.0]]
""")


def test_continuous_information_is_the_integral_of_squared_sensitivities() -> None:
    linear, schedule = plan(scene(sensor={"left": 0.7}, simulation={"duration": 1.0}))
    found = information_matrix(linear, schedule, ReadingConditions(np.array([0.2]), 1e-3, 1.0))
    fine = zoh(linear, 1e-5)
    total, Phi, k = np.zeros((4, 4)), np.eye(2), 0
    ends = np.cumsum(schedule.spans)
    for k in range(100_000):
        t = (k + 0.5) * 1e-5
        side = schedule.sides[min(np.searchsorted(ends, t), len(ends) - 1), 0]
        if side:
            row = np.concatenate([linear.C[0] @ Phi, [-max(side, 0.0), max(-side, 0.0)]])
            total += np.outer(row, row) * 1e-5 / (0.04 * 1e-3)
        Phi = fine.A @ Phi
    assert found == pytest.approx(total, rel=1e-3, abs=1e-3 * np.abs(total).max())


def test_deviations_with_process_noise_are_those_of_a_kalman_filter() -> None:
    """A Kalman filter on [x; d] over the same sides, its prior vague, ends with that variance."""
    scenario = scene("""
        sensor = { left = 0.7 }
        simulation = { time = "sampled", step = 0.02, duration = 6.0 }
        """)
    linear, schedule = plan(scenario)
    Q = np.zeros((4, 4))
    Q[:2, :2] = 0.3 * linear.B @ linear.B.T
    found = optimal_deviations(
        linear, schedule, ReadingConditions(np.array([0.05]), 2e-2, 6.0, process=Q[:2, :2])
    )
    F, P = np.eye(4), 1e6 * np.eye(4)
    F[:2, :2] = linear.A
    for side in np.tile(np.repeat(schedule.sides[:, 0], schedule.spans.astype(int)), 6):
        if side:
            row = np.array([*linear.C[0], -max(side, 0.0), max(-side, 0.0)])
            K = P @ row / (row @ P @ row + 0.05**2)
            rest = np.eye(4) - np.outer(K, row)
            P = rest @ P @ rest.T + 0.05**2 * np.outer(K, K)
        P = F @ P @ F.T + Q
    for name, g in DIRECTIONS.items():
        assert found.widths[0][name] == pytest.approx(
            float(np.sqrt(np.array(g) @ P[2:, 2:] @ np.array(g))), rel=1e-3
        )


def test_continuous_and_sampled_deviations_agree_for_short_samples() -> None:
    for process in (None, 0.2 * PAPER_PLANT.linear.B @ PAPER_PLANT.linear.B.T):
        linear, schedule = plan(scene(sensor={"left": 0.7}))
        one = optimal_deviations(
            linear, schedule, ReadingConditions(np.array([0.05]), 1e-3, 10.0, process=process)
        )
        linear, schedule = plan(
            scene(sensor={"left": 0.7}, simulation={"time": "sampled", "step": 1e-3})
        )
        other = optimal_deviations(
            linear,
            schedule,
            ReadingConditions(
                np.array([0.05]), 1e-3, 10.0, process=None if process is None else process * 1e-3
            ),
        )
        assert [one.widths[0][name] for name in DIRECTIONS] == pytest.approx(
            [other.widths[0][name] for name in DIRECTIONS], rel=0.02
        )


def test_fast_and_slow_poles_over_a_long_run_do_not_overflow() -> None:
    linear, schedule = plan(
        scene("""
            plant = { A = [[-0.05, 0.0], [0.0, -400.0]], B = [[1.0], [400.0]], C = [[1.0, 1.0]] }
            """)
    )
    found = optimal_deviations(linear, schedule, ReadingConditions(np.array([0.05]), 1e-3, 1e4))
    assert 0 < found.widths[0]["centre"] < 1.0


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_a_disturbance_beside_exact_readings_is_that_of_a_square_root_filter(noise: float) -> None:
    """Readings so good that information in double precision would lose the centre.

    The square root of P by QR does not.
    """
    linear, schedule = plan(scene())
    process = linear.B @ linear.B.T
    (found,) = optimal_deviations(
        linear, schedule, ReadingConditions(np.array([noise]), 1e-3, 10.0, process=process)
    ).widths
    h, F = 5e-3, np.zeros((4, 4))
    F[:2, :2] = linear.A
    Phi, root, spread = expm(F * h), 10.0 * np.eye(4), np.zeros((4, 1))
    spread[:2] = linear.B * np.sqrt(h)
    sigma = max(noise, 1e-4) * np.sqrt(1e-3 / h)
    for _ in range(10):
        for sides, span in zip(schedule.sides, schedule.spans, strict=True):
            row = np.hstack([linear.C * abs(sides), -branch_pattern(tuple(sides.astype(int)))])
            for _ in range(round(span / h)):
                if sides.any():
                    joint = np.block(
                        [[np.full((1, 1), sigma), row @ root], [np.zeros((4, 1)), root]]
                    )
                    root = np.linalg.qr(joint.T, mode="r").T[1:, 1:]
                root = np.linalg.qr(np.hstack([Phi @ root, spread]).T, mode="r").T
    d = (root @ root.T)[2:, 2:]
    assert found["right"] == pytest.approx(np.sqrt(d[0, 0]), rel=0.03)
    assert found["centre"] == pytest.approx(np.sqrt(d[0, 0] + d[1, 1] - 2 * d[0, 1]) / 2, rel=0.03)


def test_noise_widens_in_proportion_and_time_narrows_as_its_root() -> None:
    linear, schedule = plan(scene())
    one = optimal_deviations(
        linear, schedule, ReadingConditions(np.array([0.05]), 1e-3, 100.0)
    ).widths[0]["width"]
    noisier = optimal_deviations(
        linear, schedule, ReadingConditions(np.array([0.1]), 1e-3, 100.0)
    ).widths[0]["width"]
    longer = optimal_deviations(
        linear, schedule, ReadingConditions(np.array([0.05]), 1e-3, 400.0)
    ).widths[0]["width"]
    assert noisier == pytest.approx(2 * one, rel=1e-9)
    assert longer == pytest.approx(one / 2, rel=0.02)


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize(
    ("amplitude", "offset"),
    [(0.9, 0.0), (0.5, 1.2), (2.0, 1.5), (-3.0, 2.5), (1.0, 9.0)],
)
def test_the_cure_cures_and_less_does_not(sampled: bool, amplitude: float, offset: float) -> None:
    time = {"time": "sampled", "step": 1e-2} if sampled else {}

    def judge(amplitude: float, offset: float) -> tuple[WidthIdentifiability, Any]:
        linear, schedule = plan(
            scene(
                reference={
                    "kind": "sine",
                    "amplitude": amplitude,
                    "frequency": 0.2,
                    "offset": offset,
                },
                simulation={"duration": 10.0, **time},
            )
        )
        return width_identifiability(linear, schedule)[0], find_remedies(linear, schedule)

    before, (cure,) = judge(amplitude, offset)
    assert not before.centre
    assert cure.shift is None
    after, none = judge(cure.factor * amplitude, offset)
    assert after.centre
    assert none == []
    assert not judge(cure.factor * amplitude / 1.06, offset)[0].centre


def test_a_lopsided_reference_is_shifted_where_that_is_the_smaller_change() -> None:
    """A sum of sines that dwells near its least value: scaling moves the far end more."""
    tones = [
        {"amplitude": 2.0, "frequency": 0.5, "phase": np.pi / 2},
        {"amplitude": 0.9, "frequency": 1.0, "phase": np.pi / 2},
    ]
    linear, schedule = plan(
        scene(reference={"kind": "sines", "components": tones}, sensor={"left": 1.6})
    )
    (cure,) = find_remedies(linear, schedule)
    assert cure.shift is not None
    assert cure.shift < 0
    moved = plan(
        scene(
            reference={"kind": "sines", "components": tones, "offset": cure.shift},
            sensor={"left": 1.6},
        )
    )
    assert width_identifiability(*moved)[0].centre
    assert find_remedies(*moved) == []


def test_remedies_of_a_constant_reference_and_of_an_integrator() -> None:
    (cure,) = find_remedies(*plan(scene(reference={"kind": "step", "amplitude": 0.0})))
    assert "let output 0 move: a swing of 1.05 about 0" in cure.text
    (cure,) = find_remedies(CHAIN, visiting([True], [True]))
    assert (cure.factor, cure.shift) == (None, None)
    assert cure.text.startswith("no reference can: let the plant pass a place of known z")
    (cure,) = find_remedies(PAPER_PLANT.linear, visiting([True], [True]), bias=PAPER_PLANT.linear.B)
    assert "calibrate the input" in cure.text


def test_a_run_says_what_its_constant_disturbance_hides() -> None:
    for disturbance, hides in (
        ({"kind": "step", "amplitude": 0.5}, True),
        ({"kind": "sine", "amplitude": 0.5, "frequency": 0.3}, False),
        ({"kind": "sine", "amplitude": 0.5, "frequency": 0.3, "offset": 0.1}, True),
    ):
        (verdict,) = simulate(
            scene(disturbance=disturbance, simulation={"duration": 4.0})
        ).info.identifiable
        assert set(verdict) == {
            "right",
            "left",
            "width",
            "centre",
            "reasons",
            "std",
            "second",
            "crossings",
            "narrowed",
        }
        assert (verdict["width"], verdict["centre"]) == (True, not hides)


def test_what_outputs_do_not_observe() -> None:
    """Of three modes in random coordinates the outputs see the second one only."""
    T = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    A, C = T @ np.diag([-1.0, -2.0, -3.0]) @ T.T / 3, np.array([[0.0, 1.0, 0.0]]) @ T.T
    U = unobservable_subspace(A, C, 1e-11)
    expected = T[:, [0, 2]]
    assert pytest.approx(expected @ expected.T, abs=1e-9) == U @ U.T
    assert unobservable_subspace(A, np.ones((1, 3)) @ T.T, 1e-11).shape == (3, 0)
    assert null_space_basis(np.zeros((0, 2)), 1e-11).tolist() == [[1.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_only_readings_that_arrive_count(time: str) -> None:
    """Nothing arrives: no edge is known, although z passes both; half of it: the same verdict."""
    simulation = {"duration": 6.0, "step": 0.01, "time": time}
    for dropout, known in ((0.9999999, False), (0.5, True)):
        scenario = scene(sensor={"dropout": dropout}, simulation=simulation)
        run = simulate(scenario, check_step=False)
        (verdict,) = run.info.identifiable
        summary = check(scenario).summary()
        for judged in (verdict, summary["identifiable"]):
            assert [judged[name] for name in ("right", "left", "width", "centre")] == [known] * 4
        if not known:
            assert "too few readings arrive from beyond d_r" in verdict["reasons"][0]
            assert "too few readings arrive from beyond d_r" in summary["reasons"][0]


def test_lost_readings_widen_by_the_root_of_their_share() -> None:
    checks = (check(scene(sensor={"noise": 0.01, "dropout": p})) for p in (0.0, 0.75))
    whole, half = (verdict.known[0].std for verdict in checks)
    assert half["right"] == pytest.approx(2 * whole["right"], rel=1e-9)


def test_only_readings_of_a_nonlinear_plant_that_arrive_count() -> None:
    pendulum = {
        "f": ["w", "-9 * sin(q) - w + M"],
        "h": ["q"],
        "states": ["q", "w"],
        "inputs": ["M"],
    }
    changes: dict[str, Any] = tables_of("""
        reference = { kind = "sine", amplitude = 1.0, frequency = 0.5 }
        controller = { method = "state_feedback", poles = [-5.0, -6.0] }
        observer = { method = "extended", right = [0.0, 1.0], left = [0.0, 1.0] }
        simulation = { time = "sampled", step = 0.01, duration = 4.0 }
        """) | {"plant": pendulum}
    for dropout, known in ((0.9999999, False), (0.5, True)):
        sensor = {"right": 0.3, "left": 0.2, "noise": 1e-3, "dropout": dropout}
        (verdict,) = simulate(scene(sensor=sensor, **changes)).info.identifiable
        assert (verdict["right"], verdict["left"]) == (known, known)


SLOW = {
    "before": {"kind": "step", "amplitude": 0.0, "before": 0.5, "time": 100.0},
    "trapezoid": {"kind": "trapezoid", "amplitude": 0.5, "rise": 1e-3, "hold": 1e3},
    "slow sine": {"kind": "sine", "amplitude": 0.5, "frequency": 1e-4, "phase": 1.5},
    "csv": {"kind": "csv", "path": "constant.csv", "smooth": False},
}


@pytest.mark.parametrize("kind", SLOW)
def test_whatever_is_constant_hides_the_centre(kind: str, tmp_path: Path) -> None:
    (tmp_path / "constant.csv").write_text("t,w\n0,0.5\n1,0.5\n", encoding="utf-8")
    tables = table(disturbance=SLOW[kind], simulation={"duration": 8.0, "step": 0.01})
    scenario = convert(tables, tmp_path)
    (verdict,) = simulate(scenario, check_step=False).info.identifiable
    for judged in (verdict, check(scenario).summary()["identifiable"]):
        known = [judged[name] for name in ("right", "left", "width", "centre")]
        assert known == [False, False, True, False]
    assert "constant input bias" in verdict["reasons"][0]


def test_a_disturbance_that_swings_hides_nothing(tmp_path: Path) -> None:
    t = np.linspace(0, 8, 801)
    rows = "\n".join(f"{a},{np.sin(2 * np.pi * a)}" for a in t)
    (tmp_path / "constant.csv").write_text(f"t,w\n{rows}\n", encoding="utf-8")
    swings: list[dict[str, Any]] = [
        SLOW["csv"],
        {"kind": "sine", "amplitude": 0.5, "frequency": 1.0},
        {"kind": "trapezoid", "amplitude": 0.5, "rise": 0.1, "hold": 0.4},
        {"kind": "random", "rms": 0.1, "correlation_time": 0.1},
    ]
    for disturbance in swings:
        tables = table(disturbance=disturbance, simulation={"duration": 8.0, "step": 0.01})
        assert check(convert(tables, tmp_path)).known[0].centre


def test_a_linear_plant_and_the_same_as_formulas_get_one_verdict() -> None:
    """Both edges are visited, and noise leaves more than the widths: no, practically."""
    common: dict[str, Any] = tables_of("""
        sensor = { right = 0.05, left = 0.05, noise = 0.05 }
        reference = { kind = "sine", amplitude = 5.0, frequency = 0.05 }
        controller = { method = "state_feedback", poles = [-1.0, -1.2] }
        observer = { method = "luenberger", L = [1.0, 1.0] }
        simulation = { duration = 20.0, step = 0.01, time = "sampled" }
        """)
    formulas = {"f": ["v", "-0.0001 * q - 0.2 * v + u"], "h": ["q"], "states": ["q", "v"]}
    plants = (
        tables_of("""
            A = [[0.0, 1.0], [-0.0001, -0.2]]
            B = [[0.0], [1.0]]
            C = [[1.0, 0.0]]
            """),
        formulas | {"inputs": ["u"]},
    )
    deviations = []
    for plant in plants:
        (verdict,) = simulate(scene(plant=plant, **common)).info.identifiable
        assert [verdict[name] for name in ("right", "width", "centre")] == [False, True, False]
        assert "practically not" in verdict["reasons"][0]
        deviations.append(verdict["std"]["centre"])
    assert deviations[0] == pytest.approx(deviations[1], rel=0.02)
    summary = check(scene(plant=plants[0], **common)).summary()
    assert not summary["identifiable"]["centre"]
    assert "practically not" in summary["reasons"][-1]


def beside_white(rms: float, correlation_time: float) -> list[dict[str, float]]:
    """Deviations of the widths beside a disturbance, and beside white noise of its intensity."""
    model, schedule = plan(scene())
    noise, white = np.array([0.01]), 2 * rms**2 * correlation_time * model.B @ model.B.T
    colour = first_order_inputs(model.B, np.array([rms]), correlation_time)
    return [
        optimal_deviations(
            model, schedule, ReadingConditions(noise, 1e-2, 20.0, **{name: value})
        ).widths[0]
        for name, value in (("colour", colour), ("process", white))
    ]


def test_a_slow_random_disturbance_is_no_worse_than_an_offset_of_its_rms() -> None:
    """The plant's gain at 0 is 1: the centre is off by the rms at most."""
    rms = 0.1
    for correlation_time in (1.0, 1e2, 1e4):
        coloured, stand_in = beside_white(rms, correlation_time)
        assert coloured["centre"] <= rms * 1.001
        assert coloured["centre"] <= stand_in["centre"] * 1.001
    assert coloured["centre"] == pytest.approx(rms, rel=1e-2)
    assert stand_in["centre"] > 10 * coloured["centre"]


def test_a_fast_random_disturbance_is_white() -> None:
    coloured, stand_in = beside_white(1.0, 1e-3)
    for name in ("right", "centre"):
        assert coloured[name] == pytest.approx(stand_in[name], rel=0.01)


def test_a_sampled_random_disturbance_is_the_continuous_one() -> None:
    """Its rms stays what it is: e^-2Ts/tau of the variance is kept, the rest is new."""
    found = []
    for simulation in ({"step": 0.01}, {"step": 0.01, "time": "sampled"}):
        model, schedule = plan(scene(simulation=simulation))
        B = model.B
        colour = first_order_inputs(B, np.array([0.3]), 0.2)
        noise = np.array([0.01])
        found.append(
            optimal_deviations(
                model, schedule, ReadingConditions(noise, 0.01, 20.0, colour=colour)
            ).widths[0]
        )
    for name in ("right", "width", "centre"):
        assert found[1][name] == pytest.approx(found[0][name], rel=0.03)


def test_a_random_disturbance_leaves_no_bias() -> None:
    gusts = Random(rms=1.0, correlation_time=0.1)
    assert unknown_bias(gusts, np.ones((2, 1)), 10.0) is None
    assert unknown_bias(None, np.ones((2, 1)), 10.0) is None


@pytest.mark.parametrize("mean", [0.3, -0.3])
def test_a_swing_that_cures_reaches_both_edges(mean: float) -> None:
    still = visiting([True], [True])._replace(
        low=np.array([mean]), mean=np.array([mean]), high=np.array([mean])
    )
    swing, about = map(
        float, re.findall(r"of (\S+) about (\S+) reaches", remedy_to_reach_edges(still, 0).text)[0]
    )
    assert about == mean
    assert mean + swing > 1.0
    assert mean - swing < -1.0


@pytest.mark.parametrize("larger", [0, 1])
def test_readings_without_noise_are_as_exact_as_the_larger_edge(larger: int) -> None:
    stds = []
    for levels in ([1.0, 1.0], [8.0, 8.0], np.eye(2)[larger] * 7 + 1):
        schedule = visiting([True], [True])._replace(levels=np.array([levels]))
        known = optimal_deviations(
            PAPER_PLANT.linear, schedule, ReadingConditions(np.zeros(1), 0.01, 15.0)
        )
        stds.append(known.widths[0]["width"])
    assert stds[1] == pytest.approx(8 * stds[0], rel=1e-9)
    assert stds[2] == pytest.approx(stds[1], rel=1e-9)


def test_a_bias_that_does_nothing_tells_as_much_of_an_actuator() -> None:
    drive: Any = SimpleNamespace(slope_right=1.0, slope_left=1.0)
    modes, schedule = np.array([[1.0], [-1.0], [0.0]]), visiting([True], [True])
    without, with_bias = (
        sensor_actuator_identifiability(PAPER_PLANT.linear, schedule, modes, drive, bias)
        for bias in (None, np.zeros((2, 1)))
    )
    assert without.inputs == with_bias.inputs
    assert without.inputs[0].width
    assert without.outputs == with_bias.outputs


def test_a_jump_tells_nothing_of_widths_by_its_readings() -> None:
    hidden = unobservable_changes(PAPER_PLANT.linear, np.array([[True, True]]), jump=True)
    assert not hidden.is_width_known(0, "right")
    assert not hidden.is_width_known(0, "left")
    seen = unobservable_changes(
        PAPER_PLANT.linear, visiting([True], [True]).branch_visits(2), jump=False
    )
    assert seen.is_width_known(0, "right")


@pytest.mark.parametrize(("quiet", "remedy"), [(0.0, "a shift of the state"), (1.0, "coast:")])
def test_every_actuator_has_to_fall_silent(quiet: float, remedy: str) -> None:
    """The first of two does. If the second does not, the advice is to let it coast."""
    plant = Matrices(np.array([[0.0, 1.0], [0.0, -1.0]]), np.eye(2), np.array([[1.0, 0.0]]))
    drive: Any = SimpleNamespace(slope_right=np.ones(2), slope_left=np.ones(2))
    modes = np.array([[1.0, 1.0], [-1.0, -1.0], [0.0, quiet]])
    found = sensor_actuator_identifiability(plant, visiting([True], [True]), modes, drive)
    assert not found.outputs[0].centre
    assert remedy in found.outputs[0].reasons[0]


def test_a_mean_that_is_rounding_is_0() -> None:
    swing = visiting([True], [True])._replace(
        low=np.array([-0.5]), mean=np.array([1e-13]), high=np.array([0.5])
    )
    assert "about its mean, 0, " in remedy_to_reach_edges(swing, 0).text
