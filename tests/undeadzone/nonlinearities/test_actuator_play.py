"""Play of an actuator: simulated, known to the observer, inverted by the direction of motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_actuator import gap_of_commands
from test_engines import gap_of_engines, small

import undeadzone as uz
from scenes import EXACT_SENSOR, scene, tables_of
from undeadzone.errors import InputError
from undeadzone.nonlinearities.actuator import (
    Actuator,
    command_memory,
    input_range,
    pass_command,
    resolve_actuator,
    through_zone,
)
from undeadzone.nonlinearities.play import levels
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.run_ensemble import replay_deviation, run_ensemble

RIGHT, LEFT = 3.0, 2.0
PLAY = {"kind": "play", "right": RIGHT, "left": LEFT}


def loop(**changes: Any) -> Scenario:
    """The paper's plant behind an actuator with play."""
    tables: dict[str, Any] = tables_of("""
        observer = { method = "kalman", right = [0.0, 3.0], disturbance = 0.5 }
        reference = { kind = "sine", amplitude = 4.0, frequency = 0.4 }
        controller = { method = "state_feedback", poles = [-6.0, -6.3] }
        simulation = { time = "sampled", step = 0.01, duration = 10.0 }
        """) | {
        "sensor": {"right": 1.0, "left": 0.7, "noise": 0.01} | EXACT_SENSOR,
        "actuator": PLAY,
    }
    simulation = tables["simulation"] | changes.pop("simulation", {})
    return scene(**tables | changes | {"simulation": simulation})


def late(errors: Floats) -> float:
    """The rms over the last half."""
    return float(np.sqrt(np.mean(errors[len(errors) // 2 :] ** 2)))


def test_a_command_drags_its_level_along_a_record_within_its_limits() -> None:
    drive = resolve_actuator(Actuator(kind="play", right=0.5, left=0.3, limit=[-2.0, 1.5]), 1)
    u = np.cumsum(np.random.default_rng(1).standard_normal(400))[:, None]
    memory, passed = command_memory(drive, 1, True), []
    for command in u:
        memory, now = pass_command(np, command, memory, drive, 0.01)
        passed.append(through_zone(np, now, drive))
    clipped = np.clip(u, -2.0, 1.5)
    assert np.array_equal(passed, levels(clipped, drive.gap_right, drive.gap_left, np.zeros(1)))
    low, high = input_range(drive)
    assert (np.min(passed), np.max(passed)) == (low[0], high[0]) == (-1.7, 1.0)


def test_a_dead_zone_keeps_nothing_and_has_no_play() -> None:
    drive = resolve_actuator(Actuator(right=0.5, left=0.3), 1)
    assert not drive.is_play
    assert command_memory(drive, 1, True).size == 0
    assert input_range(drive)[1] == through_zone(np, drive.high, drive)


def test_the_inverse_of_a_known_play_leaves_little_of_it() -> None:
    usual = simulate(loop())  # inverted without being asked
    without = simulate(loop(compensator={"method": "none"}))
    none = simulate(loop(actuator=None, compensator=None))
    error = {name: late(run.z - run.r) for name, run in
             (("usual", usual), ("without", without), ("none", none))}  # fmt: skip
    assert error["usual"] < 0.3 * error["without"]
    assert error["usual"] < 0.02 + 2 * error["none"]


def test_the_observer_knows_what_enters_the_plant() -> None:
    run = simulate(loop(compensator={"method": "none"}))
    deaf = simulate(
        loop(compensator={"method": "none"}, model={"actuator": {"kind": "play", "right": 0.0}})
    )
    assert late(run.z - run.z_hat) < 0.2 * late(deaf.z - deaf.z_hat)


def test_a_command_with_hysteresis_turns_less_often() -> None:
    def turns(hold: float) -> int:
        run = simulate(loop(compensator={"method": "play_inverse", "hold": hold}))
        moves = np.diff(run.u[:, 0])
        return int((np.abs(moves) > RIGHT).sum())

    assert turns(1.0) < turns(0.0)


def test_a_play_needs_samples() -> None:
    observer = {"method": "certified", "L": [1.0, 1.5], "gamma": 10.0}
    simulation = {"time": "continuous", "step": 1e-3}
    with pytest.raises(InputError, match=r"actuator\.kind"):
        resolve_scenario(
            loop(simulation=simulation, observer=observer, compensator={"method": "none"})
        )


def test_a_known_gap_that_excludes_the_truth_is_reported() -> None:
    assumed_model = {"actuator": {"kind": "play", "right": 1.0, "left": 1.0}}
    run = simulate(loop(model=assumed_model, simulation={"duration": 3.0}))
    assert "model.actuator excludes" in str(run)
    assert "model.actuator" not in str(simulate(loop(simulation={"duration": 3.0})))


# Engines


@pytest.mark.parametrize("method", ["kalman", "censored"])
def test_engines_agree_to_the_last_bit(method: str) -> None:
    scenario = small(
        "sampled",
        observer={"method": method, "right": [0.1, 1.0]},
        actuator={"kind": "play", "right": 0.4, "left": 0.3, "limit": [-5.0, 5.0]},
    )
    assert gap_of_engines(scenario) == 0


def test_exported_c_passes_its_self_test(tmp_path: Path) -> None:
    scenario = loop(simulation={"duration": 2.0})
    assert uz.export(scenario, out=tmp_path / "fw", precision="double", name="o").has_passed


def test_an_exported_controller_commands_what_the_loop_commands() -> None:
    assert gap_of_commands(loop(simulation={"duration": 3.0})) < 1e-9


def test_a_log_gives_what_the_run_gave() -> None:
    scenario = loop()
    run = simulate(scenario)
    found = uz.estimate(scenario, t=run.t, u=run.u, y=run.y)
    assert np.abs(found.z_hat - run.z_hat).max() < 1e-9


def test_an_ensemble_varies_the_gap() -> None:
    result = run_ensemble(loop(ensemble={"runs": 4, "actuator.right": {"uniform": [2.0, 4.0]}}))
    assert replay_deviation(result, 2) == 0
    assert np.ptp(result.column("actuator.right[0]")) > 0.1
