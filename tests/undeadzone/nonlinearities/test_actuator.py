"""Dead zones at both ends: the actuator's, known or estimated beside the sensor's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_engines import gap_of_engines, small

import undeadzone as uz
from scenes import EXACT_SENSOR, PAPER_PLANT, scene, tables_of
from undeadzone.analysis.identifiability.linear import unobservable_changes
from undeadzone.analysis.identifiability.two_elements import sensor_actuator_identifiability
from undeadzone.compile import interpret
from undeadzone.errors import InputError
from undeadzone.nonlinearities.actuator import (
    Actuator,
    ActuatorModel,
    believe_actuator,
    resolve_actuator,
    through_zone,
    within_rate,
)
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.constant_states import Zones, predict_plant_input
from undeadzone.plants.system import sample_plant
from undeadzone.report.log_page import estimation_page
from undeadzone.report.run_figures import overview
from undeadzone.report.run_page import run_page
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.simulate import outputs_of, prepare, simulate
from undeadzone.util.arrays import Floats
from undeadzone_arena.controllers.robust_adaptive import RobustAdaptive
from undeadzone_export import exported_step as export_parts
from undeadzone_export import selftest_vectors
from undeadzone_studies.ensemble.run_ensemble import replay_deviation, run_ensemble

TS = 0.01
RIGHT, LEFT = 3.0, 2.0
RANGES = {"right": [0.0, 6.0], "left": [0.0, 6.0]}
KALMAN = {"method": "kalman", "right": [0.0, 3.0], "disturbance": 0.5}
INVERSE = {"method": "inverse"}
COASTS = INVERSE | {"coast": 0.8}


def loop(**changes: Any) -> Scenario:
    """The paper's plant behind a dead zone at either end."""
    tables: dict[str, Any] = tables_of("""
        reference = { kind = "sine", amplitude = 4.0, frequency = 0.4 }
        controller = { method = "state_feedback", poles = [-6.0, -6.3] }
        disturbance = { kind = "random", rms = 0.5, correlation_time = 0.0001 }
        """) | {
        "sensor": {"right": 1.0, "left": 0.7, "noise": 0.01} | EXACT_SENSOR,
        "actuator": {"right": RIGHT, "left": LEFT},
        "model": {"actuator": RANGES},
        "compensator": COASTS,
        "observer": KALMAN,
        "simulation": {"time": "sampled", "step": TS, "duration": 20.0},
    }
    simulation = tables["simulation"] | changes.pop("simulation", {})
    return scene(**tables | changes | {"simulation": simulation})


def outputs(scenario: Scenario) -> Outputs:
    """All outputs of the loop along a run."""
    return outputs_of(prepare(resolve_scenario(scenario)))


def gap_of_commands(scenario: Scenario) -> float:
    """How far what an exported controller commands is from what the loop commands."""
    problem = resolve_scenario(scenario)
    expected = selftest_vectors.record_inputs(problem, export_parts.build_step(problem))[:, 1]
    step = export_parts.build_step(problem, "observer+controller")
    rows = selftest_vectors.record_inputs(problem, step)
    found, _ = interpret.run_interpreted(step.function, step.start, rows, step.defaults)
    return float(np.abs(found[:, 0] - expected).max() / np.abs(expected).max())


def late(run: Run, error: Floats) -> float:
    """The rms over the last quarter."""
    return float(np.sqrt(np.mean(error[3 * len(run.t) // 4 :] ** 2)))


# The element


@given(
    v=st.floats(-10, 10),
    right=st.floats(0, 3),
    left=st.floats(0, 3),
    m_r=st.floats(0.2, 4),
    m_l=st.floats(0.2, 4),
)
def test_the_inverse_undoes_the_zone(
    v: float, right: float, left: float, m_r: float, m_l: float
) -> None:
    drive = resolve_actuator(Actuator(right=right, left=left, slope=[m_r, m_l]), 1)
    u = v / m_r + right if v > 0 else v / m_l - left
    assert through_zone(np, u if v else 0.0, drive)[0] == pytest.approx(v, abs=1e-12)


def test_the_zone_lets_nothing_through_inside() -> None:
    drive = resolve_actuator(Actuator(right=1.0, left=0.5), 1)
    assert not through_zone(np, np.linspace(-0.5, 1.0, 31), drive).any()


def test_the_rate_is_limited_on_the_way_up_and_down() -> None:
    drive = resolve_actuator(Actuator(rate=[2.0, 5.0]), 1)
    up, down = (within_rate(np, u, np.zeros(1), drive, 0.1)[0] for u in (9.0, -9.0))
    assert (up, down) == (0.5, -0.2)


def test_the_loop_limits_before_it_delays_before_the_zone() -> None:
    tables = {"right": 1.0, "left": 1.0, "limit": [-4.0, 4.0], "rate": [50.0, 50.0]}
    changes = {"model": None, "compensator": {"method": "none"}, "disturbance": None}
    run = simulate(loop(actuator=tables, observer={"method": "full_state"}, **changes))
    drive = resolve_actuator(Actuator(**tables), 1)
    command, x = np.zeros(1), run.x[0]
    model = sample_plant(PAPER_PLANT, TS).linear
    for k in range(200):
        limited = np.clip(run.u[k], -4.0, 4.0)
        command = within_rate(np, limited, command, drive, TS)
        x = model.A @ x + model.B @ through_zone(np, command, drive)
        np.testing.assert_allclose(run.x[k + 1], x, atol=1e-9)


@pytest.mark.parametrize("time", ["sampled", "continuous"])
def test_a_known_zone_that_is_inverted_is_none(time: str) -> None:
    """Sampled by the exact inverse, in continuous time by one that is nearly as steep."""
    method = INVERSE if time == "sampled" else {"method": "smooth_inverse", "soft": 1e-6}
    simulation = {"time": time, "step": TS if time == "sampled" else 1e-3, "duration": 3.0}
    changes = {"observer": {"method": "full_state"}, "simulation": simulation, "model": None}
    with_zone = simulate(loop(compensator=method, **changes))
    without = simulate(loop(compensator=None, actuator=None, **changes))
    np.testing.assert_allclose(with_zone.x, without.x, atol=1e-9 if time == "sampled" else 1e-4)


# What is refused


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"compensator": INVERSE}, "slides in continuous time"),
        ({"compensator": {"method": "smooth_inverse", "coast": 0.4}}, "needs samples"),
        ({"actuator": {"rate": [1.0, 1.0]}, "compensator": None}, "actuator.rate"),
    ],
)
def test_what_needs_samples_says_so(changes: dict[str, Any], words: str) -> None:
    simulation = {"time": "continuous", "step": 1e-3}
    observer = {"method": "certified", "L": [1.0, 1.5], "gamma": 10.0}
    with pytest.raises(InputError, match=words):
        resolve_scenario(loop(simulation=simulation, observer=observer, model=None, **changes))


# The filter


def through(zones: Zones, mean: Floats, std: Floats, u: float) -> tuple[float, Floats, float]:
    """(mean, slope, variance left) of what enters the plant under a command."""
    X, cov = ca.DM(mean), ca.DM(np.diag(std**2))
    drive, left = predict_plant_input(zones, Gaussian(ca.SX(X), ca.SX(cov)), ca.SX(u))
    at = ca.SX.sym("X", len(mean))
    value = drive(at)
    f = ca.Function("f", [at], [value, ca.jacobian(value, at), left])
    enters, slope, rest = f(X)
    return float(enters), np.asarray(slope).ravel(), float(rest)


@pytest.mark.parametrize("u", [-4.0, -2.2, -0.5, 0.4, 1.9, 2.6, 5.0])
def test_the_moments_of_what_enters_are_exact(u: float) -> None:
    """Against the mean, the regression and the rest over the width's distribution, on a grid."""
    ranges = np.array([[1.0, 3.0], [0.5, 2.5]])
    zones = Zones(ranges.mean(axis=1), ranges, np.array([1.5]), np.array([0.8]))
    error, std = np.array([0.1, -0.2]), np.array([0.4, 0.6])
    enters, slope, rest = through(zones, error, std, u)
    side = 0 if u > 0 else 1
    grid = np.linspace(-9, 9, 200_001)
    weight = np.exp(-(grid**2) / 2)
    weight /= weight.sum()
    width = zones.middle[side] + error[side] + std[side] * grid
    gain = np.array([1.5, -0.8])[side]
    w = gain * np.maximum(abs(u) - width, 0.0)
    mean = weight @ w
    cross = weight @ ((w - mean) * std[side] * grid)
    expected = np.zeros(2)
    expected[side] = cross / std[side] ** 2
    assert enters == pytest.approx(mean, abs=1e-7)
    np.testing.assert_allclose(slope, expected, atol=1e-7)
    assert rest == pytest.approx(weight @ (w - mean) ** 2 - cross**2 / std[side] ** 2, abs=1e-6)


def test_widths_in_a_narrow_range_are_known_widths() -> None:
    narrow = {"right": [RIGHT - 1e-7, RIGHT + 1e-7], "left": [LEFT - 1e-7, LEFT + 1e-7]}
    known = {"right": RIGHT, "left": LEFT}
    runs = [outputs(loop(model={"actuator": one}, compensator=INVERSE)) for one in (narrow, known)]
    np.testing.assert_allclose(runs[0].estimate.x, runs[1].estimate.x, atol=1e-4)


def test_beside_unknown_actuator_widths_a_shape_is_assumed_only_if_it_is_given() -> None:
    """The default is an exact sensor; a given key has its effect."""
    widths = {"right": 1.0, "left": 0.7, "noise": 0.01}
    exact, default, wide = (
        outputs(loop(sensor=sensor)).estimate.actuator_right_std[-1, 0]
        for sensor in (widths | EXACT_SENSOR, widths, widths | {"slope_std": 0.06})
    )
    assert default == exact
    assert wide > 2 * exact


def test_coasts_tell_what_an_inverse_hides() -> None:
    """Errors of all four widths lie within claimed deviations; without coasts these are wide."""
    truth = np.array([1.0, 0.7, RIGHT, LEFT])
    widths, stds = {}, {}
    for name, compensator in (("coasts", COASTS), ("none", INVERSE)):
        e = outputs(loop(compensator=compensator, simulation={"duration": 40.0})).estimate
        found = [e.right, e.left, e.actuator_right, e.actuator_left]
        deviations = [e.right_std, e.left_std, e.actuator_right_std, e.actuator_left_std]
        widths[name] = np.concatenate([part[-1] for part in found])
        stds[name] = np.concatenate([part[-1] for part in deviations])
        assert (np.abs(widths[name] - truth) < 3 * stds[name]).all()
    assert (stds["coasts"] < 0.05).all()
    assert (stds["none"] > 0.3).all()
    # the sum of each end's widths is told without coasts as well
    sums = widths["none"][[0, 2]] + widths["none"][[1, 3]]
    np.testing.assert_allclose(sums, [1.7, RIGHT + LEFT], atol=0.05)


def test_a_log_gives_what_the_run_gave() -> None:
    scenario = loop()
    run = simulate(scenario)
    followed = uz.estimate(scenario, t=run.t, y=run.y, u=run.u)
    np.testing.assert_array_equal(followed.x_hat, run.x_hat)
    np.testing.assert_array_equal(followed.b_hat, run.b_hat)
    assert followed.summary()["b_right"] == run.b_hat[-1, 0]
    assert "b_right" in str(followed)
    assert "b_right" in estimation_page(followed, {})
    known = loop(model=None, compensator=INVERSE)
    assert "b_right" not in str(uz.estimate(known, t=run.t, y=run.y, u=run.u))


# Verdicts


def test_the_verdict_says_why_an_inverse_hides_the_centre() -> None:
    (without,) = simulate(loop(compensator=INVERSE)).info.identifiable
    assert without["width"]
    assert not without["centre"]
    assert "coast" in without["reasons"][0]
    (with_coasts,) = simulate(loop()).info.identifiable
    assert with_coasts["centre"]


def test_one_combination_is_lost_and_others_are_not() -> None:
    """b_r + b_l, d_r + d_l and d_r - d_l + G0 (b_r - b_l) are seen, G0 the gain at rest."""
    plant = PAPER_PLANT.linear
    drive = resolve_actuator(Actuator(), 1)
    drives = [plant.B @ np.array([[-1.0, 0.0]]), plant.B @ np.array([[0.0, 1.0]])]
    hidden = unobservable_changes(plant, np.array([[True, True]]), drives=drives)
    gain = float((plant.C @ np.linalg.solve(-plant.A, plant.B))[0, 0])
    assert hidden.is_pair_known({2: (1.0, 1.0)})
    assert hidden.is_pair_known({4: (1.0, 1.0)})
    assert hidden.is_pair_known({2: (1.0, -1.0), 4: (gain, -gain)})
    assert not hidden.is_pair_known({2: (1.0, -1.0), 4: (-gain, gain)})
    assert drive.slope_right == 1


def test_an_integrator_shows_its_actuator_without_coasts_and_hides_its_sensor() -> None:
    tank = {"A": [[0.0]], "B": [[1.0]], "C": [[1.0]]}
    changes = {"controller": {"method": "state_feedback", "poles": [-4.0]}, "disturbance": None}
    scenario = loop(plant=tank, compensator=INVERSE, **changes)
    e = outputs(scenario).estimate
    (verdict,) = simulate(scenario).info.identifiable
    assert not verdict["centre"]
    assert verdict["width"]
    assert e.actuator_right[-1, 0] == pytest.approx(RIGHT, abs=0.1)
    assert e.actuator_left[-1, 0] == pytest.approx(LEFT, abs=0.1)


def test_no_mode_visited_tells_nothing_of_the_actuator() -> None:
    run = simulate(loop(compensator=INVERSE))
    problem = resolve_scenario(loop())
    from undeadzone.analysis.branch_schedule import schedule_of_record

    schedule = schedule_of_record(run.z, problem.sensor, TS, TS)
    found = sensor_actuator_identifiability(
        problem.model.linear, schedule, np.zeros((0, 1)), problem.belief.drive
    )
    assert not any((found.inputs[0].right, found.inputs[0].left, found.inputs[0].width))


# Rivals


def test_robust_adaptive_control_needs_no_inverse() -> None:
    """Given the true state it follows through an unknown zone; its plain twin does not."""
    changes = tables_of("""
        compensator = { method = "none" }
        model = { actuator = { right = 0.0, left = 0.0 } }
        """)
    observer = {"method": "full_state"}
    law = {"method": "robust_adaptive", "rate": 10.0, "poles": [-6.0], "layer": 0.1}
    robust = simulate(loop(observer=observer, controller=law, **changes))
    plain = simulate(loop(observer=observer, **changes))
    assert late(robust, robust.z - robust.r) < 0.2 * late(plain, plain.z - plain.r)


def test_robust_adaptive_control_learns_as_fast_in_samples() -> None:
    """Its surface is a difference per sample, so rates count by the square of the sample time."""
    law = RobustAdaptive(rate=4.0, layer=0.1, learning=3.0, slope_learning=2.0)
    smooth = law.build(PAPER_PLANT).params
    sampled = law.build(sample_plant(PAPER_PLANT, 0.01)).params
    assert (smooth.slope, smooth.learning) == (2.0, 3.0)
    assert (sampled.slope, sampled.learning) == pytest.approx((2e-4, 3e-4))
    assert sampled.layer == pytest.approx(smooth.layer / 0.01)


def test_the_adaptive_inverse_learns_the_widths_behind_a_clean_sensor() -> None:
    """Of a plant that is fast beside its reference; behind slow ones it learns the sum slowly."""
    compensator = {"method": "adaptive_inverse", "width_max": 6.0}
    changes = tables_of("""
        plant = { A = [[-4.0]], B = [[4.0]], C = [[1.0]] }
        actuator = { right = 1.0, left = 0.7 }
        reference = { kind = "sine", amplitude = 3.0, frequency = 0.1 }
        controller = { method = "state_feedback", poles = [-8.0] }
        sensor = { right = 0.0, left = 0.0, noise = 0.0 }
        observer = { method = "full_state" }
        model = { actuator = { right = 0.0, left = 0.0 } }
        simulation = { duration = 60.0 }
        """) | {"disturbance": None}
    learnt = simulate(loop(compensator=compensator, **changes))
    none = simulate(loop(compensator={"method": "none"}, **changes))
    assert late(learnt, learnt.z - learnt.r) < 0.1 * late(none, none.z - none.r)


# Engines


@pytest.mark.parametrize("method", ["kalman", "censored"])
def test_engines_agree_to_the_last_bit(method: str) -> None:
    scenario = small(
        "sampled",
        observer={"method": method, "right": [0.1, 1.0]},
        actuator={"right": 0.4, "left": 0.3, "rate": [80.0, 60.0], "limit": [-5.0, 5.0]},
        model={"actuator": {"right": [0.0, 1.0], "left": [0.0, 1.0]}},
        compensator={"method": "smooth_inverse", "coast": 0.1, "every": 0.5},
    )
    assert gap_of_engines(scenario) == 0


def test_exported_c_passes_its_self_test(tmp_path: Path) -> None:
    scenario = loop(simulation={"duration": 2.0})
    assert uz.export(scenario, out=tmp_path / "fw", precision="double", name="o").has_passed


@pytest.mark.parametrize("method", ["none", "inverse", "smooth_inverse", "adaptive_inverse"])
def test_an_exported_controller_commands_what_the_loop_commands(method: str) -> None:
    compensator = {"method": method, "coast": 0.4, "every": 1.0}
    assert gap_of_commands(loop(compensator=compensator, simulation={"duration": 3.0})) < 1e-9


def test_figure_and_page_show_an_actuator_whose_widths_are_estimated() -> None:
    run = simulate(loop(simulation={"duration": 3.0}))
    figure = overview(run)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[-2:] == ["Command over the actuator's zone", "Widths of the actuator, truth pale"]
    assert run.b_std is not None
    widest = float((run.b_hat + 2 * run.b_std).max())
    assert figure.axes[-1].get_ylim()[1] < widest  # the first band does not stretch the axis
    assert "b_right" in run_page(run, {})
    known = simulate(loop(model=None, compensator=INVERSE, simulation={"duration": 1.0}))
    assert len(overview(known).axes) == len(titles) - 2


def test_an_ensemble_varies_the_actuator() -> None:
    vary = {"runs": 6, "actuator.right": {"uniform": [2.0, 4.0]}}
    result = run_ensemble(loop(ensemble=vary))
    assert replay_deviation(result, 2) == 0
    assert np.ptp(result.column("actuator.right[0]")) > 0.1
    assert np.median(result.column("rms_estimation")) < 0.1


def test_ranges_stand_for_their_middle_until_they_are_estimated() -> None:
    belief = believe_actuator(ActuatorModel(right=[0.0, 6.0], left=[1.0, 2.0]), 1)
    assert belief is not None
    assert belief.drive.right[0] == 3.0
    assert belief.drive.left[0] == 1.5


def test_coasts_may_end_at_any_time() -> None:
    sampled = {"time": "sampled", "step": 0.01}
    for until in (0.0, 0.5):
        resolve_scenario(loop(simulation=sampled, compensator=COASTS | {"until": until}))
    with pytest.raises(InputError, match=r"compensator\.until"):
        resolve_scenario(loop(simulation=sampled, compensator=COASTS | {"until": -0.1}))
