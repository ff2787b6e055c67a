"""Arms as plants of scenarios, end to end.

Parameters, limits, stops, quantised readings, tips, ensembles, engines, the page and the animation.
"""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from test_engines import compiled, distance, generated, parts
from test_report import Auditor
from test_run_ensemble import table

from commands import undeadzone as command
from documents import EXAMPLES
from requirements import import_package
from scenes import scene, tables_of
from undeadzone.compile import interpret
from undeadzone.errors import InputError, StepError
from undeadzone.nonlinearities.sensor import quantise, side
from undeadzone.plants.build import system
from undeadzone.plants.options import URDF, OneLink, Plant, TwoLink
from undeadzone.plants.robots.arm import evaluate_rows, inverse_dynamics
from undeadzone.report import animation, run_figures
from undeadzone.report.run_figures import overview
from undeadzone.report.run_page import write_run as write
from undeadzone.results.run import FRAMES, Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import parse
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import labels as method_labels
from undeadzone.simulation.simulate import simulate
from undeadzone_studies.ensemble.batch import prepare_batch
from undeadzone_studies.ensemble.run_ensemble import replay_in_batch

RIGHT, LEFT = np.array([0.05, 0.08]), np.array([0.03, 0.06])
START = [-1.7, 1.4, 0.0, 0.0]
FILTER: dict[str, Any] = {
    "method": "extended",
    "right": [0.0, 0.15],
    "start": START,
    "x_std": 0.01,
    "disturbance": 0.1,
}
SAMPLED: dict[str, Any] = {"time": "sampled", "step": 1e-3, "substeps": 1}


def two_link(
    duration: float = 0.4, arm: Any = None, plant: Any = None, sensor: Any = None, **changes: Any
) -> Scenario:
    """A two-link arm behind dead zones in both joints, on a figure eight of its tip."""
    base: dict[str, Any] = tables_of("""
        reference.kind = "figure_eight"
        reference.centre = [0.2351, -0.4853]
        reference.width = 0.3
        reference.height = 0.2
        reference.period = 4.0
        controller = { method = "computed_torque", bandwidth = 12.0 }
        """) | {
        "plant": {"arm": {"kind": "two_link", "reference": [-1.65, 1.2]} | (arm or {}), "x0": START}
        | (plant or {}),
        "sensor": {"right": RIGHT.tolist(), "left": LEFT.tolist(), "noise": 0.001} | (sensor or {}),
        "observer": FILTER,
        "simulation": SAMPLED | {"duration": duration},
    }
    return scene(**base | changes)


def falling(duration: float, arm: dict[str, Any]) -> Run:
    """One link, let go: a controller of no force, its state known."""
    return simulate(
        two_link(
            duration,
            plant={"arm": {"kind": "one_link"} | arm, "x0": [0.0, 0.0]},
            sensor={"right": 0.05, "left": 0.03, "noise": 0.0},
            reference={"kind": "step", "amplitude": 0.0},
            observer={"method": "full_state"},
            controller={"method": "pd", "k_p": 0.0, "k_d": 0.0},
        )
    )


@pytest.fixture(scope="module")
def both() -> tuple[Run, Run]:
    """A run, and the same arm whose observer knows of no dead zone."""
    named = [two_link(observer=FILTER | more) for more in ({}, {"blind": True})]
    names = method_labels(named[0].observer, named[1].observer)
    runs = [simulate(one) for one in named]
    first, second = (labelled(run, name) for run, name in zip(runs, names, strict=True))
    return first, second


def labelled(run: Run, name: str) -> Run:
    return dataclasses.replace(run, info=msgspec.structs.replace(run.info, label=name))


# --- The plant and what is believed of it


def test_parameters_change_the_plant_by_name_and_the_model_its_own() -> None:
    problem = resolve_scenario(
        two_link(
            plant={"parameters": {"payload": 0.5, "f1": 0.4}},
            model={"parameters": {"payload": 0.2}},
        )
    )
    plant = dict(zip(problem.plant.names, problem.plant.params, strict=True))
    model = dict(zip(problem.model.names, problem.model.params, strict=True))
    assert (plant["payload"], plant["f1"], plant["m1"]) == (0.5, 0.4, 3.0)
    assert model == plant | {"payload": 0.2}
    x, u = np.array([0.3, -0.8, 1.0, -0.5]), np.array([2.0, 1.0])
    loaded = system(Plant(arm=TwoLink(), parameters={"payload": 0.5}))
    plain = system(Plant(arm=TwoLink(), parameters={"payload": 0.0}))
    assert loaded.arm is not None
    needed = [
        inverse_dynamics(
            one.arm, one.params, x[:2], x[2:], np.array(one.move(one.params, x, u)).ravel()[2:]
        )
        for one in (loaded, plain)
        if one.arm is not None
    ]
    np.testing.assert_allclose(np.array(needed).reshape(2, 2), [u, u], rtol=1e-12)
    assert (
        np.abs(np.array(loaded.move(loaded.params, x, u) - plain.move(plain.params, x, u))).max()
        > 0.1
    )


def test_a_negative_mass_of_a_urdf_s_body_is_refused() -> None:
    import_package("adam")
    with pytest.raises(InputError, match=r"plant\.parameters\.m3: must not be negative"):
        system(Plant(arm=URDF(path=str(EXAMPLES / "ur5.urdf")), parameters={"m3": -2.0}))


# --- Torques and stops


def test_steep_friction_asks_for_shorter_steps() -> None:
    with pytest.raises(
        StepError, match=r"mode at 4092 1/s .* Use simulation.substeps = (\d+)"
    ) as error:
        simulate(two_link(plant={"parameters": {"f2": 10.0}}))
    enough = int(re.findall(r"substeps = (\d+)", str(error.value))[0])
    run = simulate(
        two_link(
            plant={"parameters": {"f2": 10.0}},
            simulation=SAMPLED | {"duration": 0.4, "substeps": enough},
        )
    )
    assert run.divergence_time is None
    assert run.rms_tip is not None
    assert run.rms_tip < 1e-3


def test_torques_saturate_for_plant_and_observer_alike() -> None:
    """An exact filter whose start is known sees no innovation while the motors saturate.

    It gets the torque that they give.
    """
    limit = np.array([12.0, 3.2])
    observer = FILTER | {
        "start": [-2.2, 1.9, 0.0, 0.0],
        "x_std": 1e-6,
        "disturbance": 0.0,
        "noise": 0.001,
    }
    sensor = {"right": 0.0, "left": 0.0, "noise": 0.0}
    run = simulate(
        two_link(
            plant={"x0": observer["start"]},
            arm={"torque_max": limit.tolist()},
            observer=observer | {"right": [0.0, 1e-6]},
            sensor=sensor,
        )
    )
    assert (np.abs(run.u) <= limit).all()
    assert (np.abs(run.u) == limit).mean(axis=0).min() > 0.01
    assert np.abs(run.x - run.x_hat).max() < 1e-5
    free = simulate(
        two_link(
            plant={"x0": observer["start"]},
            observer=observer | {"right": [0.0, 1e-6]},
            sensor=sensor,
        )
    )
    assert (np.abs(free.u).max(axis=0) > limit).all()


def test_stops_hold_a_falling_arm_and_take_its_energy() -> None:
    free = falling(2.0, {})
    run = falling(2.0, {"limits": [-1.0, 3.0], "stops": [2000.0, 20.0]})
    assert free.x[:, 0].min() < -2.5
    assert -1.1 < run.x[:, 0].min() < -1.0
    assert run.x[-1, 0] == pytest.approx(-1.0, abs=0.01)
    arm = system(Plant(arm=OneLink()))
    p = dict(zip(arm.names, arm.params, strict=True))
    energy = (p["m"] * p["c"] ** 2 + p["I"]) / 2 * run.x[:, 1] ** 2 + p["m"] * p["g"] * p[
        "c"
    ] * np.sin(run.x[:, 0])
    touched = int(np.argmax(run.x[:, 0] < -1.0))
    assert np.ptp(energy[:touched]) < 1e-6 * np.ptp(energy)
    assert energy[-1] < energy[0] - 1.0
    assert abs(run.x[-1, 1]) < 0.05


# --- Readings


def test_quantised_readings_are_multiples_whose_side_and_noise_count_the_quantum() -> None:
    quantum = 2 * np.pi / 4096
    run = simulate(two_link(sensor={"quantum": quantum, "noise": 0.0}))
    steps = run.y / quantum
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len(np.unique(run.y)) > 20
    truth = np.where(run.z > 0, np.maximum(run.z - RIGHT, 0), np.minimum(run.z + LEFT, 0))
    assert np.abs(run.y - truth).max() <= quantum / 2 + 1e-12
    assert run.info.threshold == pytest.approx([quantum / 2] * 2)
    assert np.array_equal(run.side, side(run.y, np.array(run.info.threshold)))
    assert np.array_equal(run.side, np.sign(np.round(steps)))

    def variance(quantum: float) -> Any:
        scenario = two_link(sensor={"quantum": quantum, "noise": 0.01})
        return resolve_scenario(scenario).observer.params.R

    coarse, fine = variance(0.1), variance(0.0)
    np.testing.assert_allclose(coarse - fine, 0.1**2 / 12, rtol=1e-9)


def test_rounding_is_to_the_nearest_and_none_without_a_quantum() -> None:
    np.testing.assert_allclose(
        quantise(np.array([0.24, 0.26, -0.26, 0.3]), np.array([0.5, 0.5, 0.5, 0.0])),
        [0.0, 0.5, -0.5, 0.3],
    )


def test_an_arm_whose_speed_is_measured() -> None:
    plant = {"arm": {"kind": "two_link", "measured": "velocity"}}
    run = simulate(
        two_link(
            plant=plant, sensor={"kind": "jump", "noise": 0.0}, observer={"method": "full_state"}
        )
    )
    np.testing.assert_array_equal(run.z, run.x[:, 2:])
    inside = (run.z <= RIGHT) & (run.z >= -LEFT)
    assert inside.any()
    assert (run.y[inside] == 0).all()
    np.testing.assert_array_equal(run.y[~inside], run.z[~inside])
    assert np.abs(run.r[-1] - run.x[-1, 2:]).max() < 0.05


# --- Tips


def test_the_tip_that_should_be_is_the_path(both: tuple[Run, Run]) -> None:
    run, blind = both
    path = resolve_scenario(two_link()).scenario.reference
    assert run.tip is not None
    assert run.tip_r is not None
    assert path.centre is not None
    angle = 2 * np.pi * run.t[-1] / 4.0
    ramped = run.tip_r - np.array(path.centre)
    assert np.abs(ramped[:, 0]).max() <= 0.15 + 1e-9
    np.testing.assert_allclose(
        ramped[:, 1], 0.1 * np.sin(2 * np.arcsin(ramped[:, 0] / 0.15)), atol=1e-9
    )
    assert 0 < np.arcsin(ramped[-1, 0] / 0.15) < angle
    body = resolve_scenario(two_link()).plant.arm
    assert body is not None
    np.testing.assert_allclose(
        run.tip, evaluate_rows(body.tip, body.values, run.x[:, :2]), atol=1e-15
    )
    assert run.rms_tip == pytest.approx(
        np.sqrt(np.mean(np.sum((run.tip - run.tip_r) ** 2, axis=1)))
    )
    assert blind.rms_tip is not None
    assert run.rms_tip < blind.rms_tip / 3


def test_files_keep_tips_and_csv_leaves_poses_out(both: tuple[Run, Run], tmp_path: Path) -> None:
    run = both[0]
    assert run.poses is not None
    assert run.poses.shape == (round(0.4 * FRAMES) + 1, 3, 3)
    np.testing.assert_array_equal(run.poses[:, -1, :2], run.tip[:: round(1 / FRAMES / 1e-3)])
    for name in ("run.npz", "run.csv"):
        again = Run.load(run.save(tmp_path / name))
        for part in ("tip", "tip_hat", "tip_r"):
            np.testing.assert_array_equal(getattr(again, part), getattr(run, part))
        assert (again.info.joints, again.observer_name) == (["q1", "q2"], "extended")
        assert (again.poses is None) == (name == "run.csv")
    np.testing.assert_array_equal(Run.load(tmp_path / "run.npz").poses, run.poses)


VARIED = {
    "sensor.right": {"uniform": [0.02, 0.1]},
    "plant.parameters.l1": {"uniform": [0.38, 0.42]},
    "plant.parameters.payload": {"uniform": [0.0, 1.0]},
}


def test_the_tip_s_error_in_an_ensemble_is_that_of_the_run_itself() -> None:
    fleet = prepare_batch(
        two_link(0.3, observer={"method": "full_state"}, ensemble={"runs": 8} | VARIED)
    )
    values = fleet.binding.draw_columns(0, 8, 8)
    column = table(fleet, fleet.rows_of_runs(np.arange(8), values))["rms_tip"]
    assert np.ptp(column) > 1e-3
    assert [replay_in_batch(fleet, k).rms_tip for k in (0, 3, 7)] == pytest.approx(
        column[[0, 3, 7]], rel=1e-9
    )


# --- Engines


def test_machine_lanes_and_c_agree_on_an_arm(tmp_path: Path) -> None:
    plant = {"parameters": {"payload": 0.5, "f1": 0.3}}
    arm = {"torque_max": [8.0, 5.0], "limits": [[-2.0, -1.5], [0.5, 2.5]], "stops": [500.0, 5.0]}
    scenario = two_link(
        0.1, plant=plant, arm=arm, sensor={"quantum": 1e-3}, observer={"method": "full_state"}
    )
    step, state, exogenous, params, _ = parts(scenario)
    expected = interpret.run_interpreted(step, state, exogenous, params)
    assert max(map(distance, compiled(step, state, exogenous, params), expected)) < 1e-12
    assert (
        max(
            map(
                distance,
                interpret.run_interpreted(generated(step, tmp_path), state, exogenous, params),
                expected,
            )
        )
        < 1e-14
    )


# --- Figures, page and animation


def test_figures_of_an_arm_have_their_panels(both: tuple[Run, Run]) -> None:
    figure = run_figures.plot_tip(*both)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "The tip, last half of the run",
        "Distance of the tip from its desired place",
        "Torques",
    ]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "path",
        "extended, blind",
        "extended",
    ]
    assert [text.get_text() for text in figure.axes[1].get_legend().get_texts()] == [
        "extended",
        "extended, blind",
    ]
    assert len(figure.axes[2].lines) == 2
    planes = run_figures.plot_phase(both[0])
    assert [axes.get_title(loc="left") for axes in planes.axes] == ["q1", "q2"]
    zone = planes.axes[0].patches[0].get_x(), planes.axes[0].patches[0].get_width()
    assert zone == pytest.approx((-1.65 - 0.03, 0.08))
    assert len(overview(both[0]).axes) == 6


def test_a_speed_has_no_dead_zone_in_the_phase_plane() -> None:
    run = simulate(
        two_link(
            0.1,
            plant={"arm": {"kind": "two_link", "measured": "velocity"}},
            observer={"method": "full_state"},
        )
    )
    assert not run_figures.plot_phase(run).axes[0].patches


def test_the_page_plays_the_arm_from_itself_alone(both: tuple[Run, Run], tmp_path: Path) -> None:
    written = write(both[0], tmp_path, True, both[1])
    assert [path.name for path in written] == [
        "run.npz",
        "run.csv",
        "figure.svg",
        "tip.svg",
        "phase.svg",
        "report.html",
    ]
    text = written[-1].read_text(encoding="utf-8")
    found = Auditor(text)
    assert found.tags.count("script") == found.tags.count("canvas") == 1
    assert found.tags.count("img") == 3
    image = ("data:image/svg+xml;base64,", "#")
    assert all(address.startswith(image) for address in found.addresses)
    assert not {"link", "iframe", "object"} & set(found.tags)
    assert not re.search(
        r"fetch\(|XMLHttpRequest|import|https?:|url\(", text.replace("!important", "")
    )
    page_data = json.loads(
        re.search(r"play\(document\.currentScript\.parentElement, (.*)\);</script>", text)[1]
    )  # type: ignore[index]
    np.testing.assert_allclose(page_data["arms"][1]["frames"], both[0].poses, atol=5.1e-5)
    assert len(page_data["arms"]) == 2
    assert "extended, blind" in found.text


def test_what_a_title_says_cannot_leave_the_script(both: tuple[Run, Run]) -> None:
    nasty = dataclasses.replace(
        both[0], info=msgspec.structs.replace(both[0].info, label="</script><b>")
    )
    found = Auditor(animation.animation_canvas(nasty).text)
    assert found.tags.count("script") == 1
    assert "b" not in found.tags


# --- The command


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    text = (EXAMPLES / "two_link.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("duration = 20.0", "duration = 0.3"))
    return tmp_path / "mine.toml"


def test_a_comparison_is_reported_in_json(scenario: Path) -> None:
    done = command("run", scenario, "--no-figures", "--json", cwd=scenario.parent)
    assert done.stderr == ""
    result = json.loads(done.stdout)
    assert result["rms_tip"] < result["compare"]["rms_tip"]
    assert result["compare"]["method"] == "extended"


def test_observers_are_labelled_by_method_or_by_what_differs() -> None:
    def names(first: dict[str, Any], second: dict[str, Any]) -> tuple[str, str]:
        return method_labels(*(two_link(observer=one).observer for one in (first, second)))

    assert names(FILTER | {"noise": 0.002}, FILTER | {"blind": True}) == (
        "extended",
        "extended, blind",
    )
    assert names(FILTER | {"noise": 0.002}, FILTER) == ("extended, noise = 0.002", "extended")
    assert names(FILTER | {"uncertain": {"payload": 0.5}}, FILTER) == (
        "extended, uncertain payload",
        "extended",
    )
    assert names(FILTER, {"method": "kalman", "right": [0.0, 0.1]}) == ("extended", "kalman")
    assert names(FILTER, FILTER) == ("extended", "extended")


SWING = """
[plant.arm]
kind = "one_link"
reference = -1.2
[plant]
x0 = [-1.57, 0.0]
[sensor]
right = 0.1
left = 0.05
noise = 0.001
[reference]
kind = "sine"
amplitude = 0.3
frequency = 0.5
offset = -1.57
[observer]
method = "extended"
right = [0.0, 0.3]
start = [-1.57, 0.0]
x_std = 0.01
noise = 0.002
[simulation]
time = "sampled"
duration = 4.0
step = 0.005
substeps = 1
"""


def verdict_of(scenario: Scenario) -> tuple[bool, str]:
    """Whether a run tells the widths, and why not."""
    run = simulate(scenario)
    return run.fully_identifiable, " ".join(run.info.identifiable[0]["reasons"])


def test_a_verdict_names_the_position_at_which_both_edges_are_reached() -> None:
    scenario = parse(SWING)
    known, why = verdict_of(scenario)
    assert not known
    found = re.search(r"plant\.arm\.reference = (\S+) would do, as any from (\S+) to (\S+):", why)
    assert found is not None
    for reference in map(float, found.groups()):
        known, why = verdict_of(scenario.replace("plant.arm.reference", reference))
        assert known, why
    least, most = float(found[2]), float(found[3])
    for reference in (least - 0.04, most + 0.04):
        assert not verdict_of(scenario.replace("plant.arm.reference", reference))[0]


def test_a_verdict_says_where_no_position_helps() -> None:
    scenario = parse(SWING) | {"sensor": {"right": 0.5, "left": 0.4}}
    known, why = verdict_of(scenario | {"observer": {"right": [0.0, 1.0]}})
    assert not known
    assert "whatever plant.arm.reference is: move further" in why
