"""The arena: what methods know, what a run is worth, regret and places, tuning, the command.

One method more is entered by being listed.
"""

from __future__ import annotations

import json
import math
import shutil
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import assume, given
from hypothesis import strategies as st

from documents import ROOT
from scenes import scene, slopes, tables_of
from undeadzone.cli import group
from undeadzone.errors import FileError, InputError
from undeadzone.observers.luenberger import Luenberger
from undeadzone.registry import OBSERVERS
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario
from undeadzone.signals import noise
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation.simulate import close_problem, simulate
from undeadzone.util import toml
from undeadzone_arena.contest import leaderboard
from undeadzone_arena.contest import tune as tuning
from undeadzone_arena.contest import tuned_file as tuned
from undeadzone_arena.contest.contest import arena, run_contest
from undeadzone_arena.contest.effort import effort_text
from undeadzone_arena.contest.entry import enter_method, read_knob_numbers
from undeadzone_arena.contest.leaderboard import (
    CAP,
    compress_regret,
    compute_regrets,
    regret_intervals,
)
from undeadzone_arena.contest.methods import (
    METHODS,
    method_registry,
    methods_for_scenarios,
    middle_knobs,
)
from undeadzone_arena.contest.metric import Result, RunMetrics, _has_diverged
from undeadzone_arena.contest.page import arena_figures, arena_page
from undeadzone_arena.contest.prior_knowledge import build_setting, scenario_assumptions
from undeadzone_arena.contest.scenario_sets import SETS, Kind, arena_scenarios, scenarios_from_files
from undeadzone_arena.contest.traces import trace_runs
from undeadzone_arena.contest.trials import run_trial, score_methods
from undeadzone_arena.contest.words import leaderboard_blocks
from undeadzone_studies.ensemble.binding import bind_ensemble, build_run_noise

SHORT = {"time": "sampled", "step": 1e-2, "duration": 3.0}
DECLARED = tables_of("""
right = [0.3, 2.0]
disturbance = 1.0
correlation_time = 0.5
bias = 0.2
calibrated = 0.5
tolerance = 0.05
drift = 0.005
""")
KNOW_THE_TRUTH = {"full_state", "informed", "oracle"}


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What an arena keeps meanwhile lies in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)


def small(**changes: Any) -> Scenario:
    """Three seconds of the paper's loop at 100 Hz, noisy, with a model that is off."""
    base = tables_of("""
        sensor = { right = 1.2, left = 0.7, noise = 0.02 }
        model = { A = [[0.0, 1.0], [-1.1, -2.0]] }
        controller = { method = "state_feedback", poles = [-10.0, -10.0] }
        """) | {"declared": DECLARED, "simulation": SHORT}
    return scene(**base | changes)


def result(
    method: str,
    scenario: str,
    seed: int,
    tracking: float | None,
    diverged: bool = False,
    **more: Any,
) -> Result:
    worth = {
        "estimation": 0.1,
        "width": None,
        "centre": None,
        "coverage": None,
        "settling": 1.0,
        "effort": 1.0,
        "slew": 1.0,
        "cost": 1e-6,
    }
    found = (
        None
        if tracking is None
        else RunMetrics(**worth | more, tracking=tracking, diverged=diverged)
    )
    return Result(method=method, scenario=scenario, seed=seed, worth=found)


# --- What the sensor may do besides


def test_readings_are_lost_and_widths_drift_at_the_given_rates() -> None:
    scenario = small(
        sensor={"right": 1.0, "left": 0.5, "noise": 0.02, "dropout": 0.3, "drift": 0.1},
        simulation={**SHORT, "duration": 20.0},
    )
    problem = resolve_scenario(scenario)
    walks = np.array(
        [
            np.log(inputs.widths(problem, inputs.exogenous(problem, run=run))[:, :, 0] / [1.0, 0.5])
            for run in range(200)
        ]
    )
    steps = np.diff(walks, axis=1)
    assert np.std(steps) == pytest.approx(0.1 * np.sqrt(1e-2), rel=0.01)
    assert (
        abs(np.corrcoef(steps[:, :-1].ravel(), steps[:, 1:].ravel())[0, 1]) < 0.01
    )  # a step knows nothing of the one before
    assert (
        abs(np.corrcoef(steps[:, :, 0].ravel(), steps[:, :, 1].ravel())[0, 1]) < 0.01
    )  # nor one edge of the other
    assert np.std(walks[:, -1]) == pytest.approx(0.1 * np.sqrt(20.0), rel=0.15)
    run = simulate(scenario)
    lost = np.isnan(run.y[:, 0])
    assert lost.mean() == pytest.approx(0.3, abs=0.04)
    assert not run.side[lost].any()
    assert run.side[~lost].any()
    assert np.isfinite(run.x_hat).all()


@pytest.mark.parametrize("time", ["sampled", "continuous"])
def test_what_is_not_used_leaves_a_run_as_it_was(time: str) -> None:
    plain = small(sensor={"noise": 0.02}, simulation={**SHORT, "time": time})
    unused = small(
        sensor={"noise": 0.02, "drift": 0.0, "dropout": 0.0}, simulation={**SHORT, "time": time}
    )
    assert np.array_equal(simulate(plain).z, simulate(unused).z)
    lossy = simulate(
        small(
            sensor={"noise": 0.02, "dropout": 0.2, "drift": 0.05},
            simulation={**SHORT, "time": time},
        )
    )
    assert not np.array_equal(lossy.z, simulate(plain).z)


def test_lost_readings_and_wear_leave_the_order_of_integration() -> None:
    sensor = {"noise": 0.02, "dropout": 0.2, "drift": 0.05}
    steps = [5e-3, 2.5e-3]
    errors = [
        simulate(
            small(sensor=sensor, simulation={"step": step, "duration": 3.0})
        ).info.integration_error
        for step in steps
    ]
    assert slopes(steps, errors)[0] > 3.5


def test_an_ensemble_draws_lost_readings_and_wear_as_single_runs_do() -> None:
    scenario = msgspec.structs.replace(
        small(sensor={"noise": 0.02, "dropout": 0.3, "drift": 0.1}), ensemble=Vary(runs=4)
    )
    problem = resolve_scenario(scenario)
    loop = close_problem(problem)
    own = build_run_noise(problem, loop, bind_ensemble(problem, loop))
    runs = np.array([3, 0])
    supply = own.noise_supply(runs)
    assert supply is not None
    source = supply(np.arange(2))
    found = np.concatenate([source(0, 100), source(100, problem.steps + 1 - 100)])
    for lane, run in enumerate(runs):
        expected = inputs.exogenous(problem, run=int(run))[:, own.entries]
        assert np.array_equal(found[:, :, lane], expected, equal_nan=True)
        assert np.isnan(expected).any()
    assert len({noise.AFTER, noise.BEFORE, noise.DISTURBANCE, noise.WEAR, noise.LOSS}) == 5


# --- Scenarios and what methods are told


def test_scenarios_are_many_and_different() -> None:
    tuning_on, held_out = arena_scenarios("tuning"), arena_scenarios("held_out")
    assert len(tuning_on) >= 10
    assert {
        "nominal",
        "noise_after",
        "noise_before",
        "mismatch_weak",
        "mismatch_strong",
        "asymmetric",
        "disturbance",
        "bias",
        "amplitude_large",
    } <= set(held_out)
    assert {
        "amplitude_large",
        "amplitude_small",
        "amplitude_grazing",
        "unstable",
        "integrator",
        "third_order",
        "fourth_order",
        "jump",
        "drift",
        "dropout",
    } <= set(held_out)
    plain = [
        toml.to_toml(msgspec.structs.replace(scenario, title=""))
        for scenario in [*tuning_on.values(), *held_out.values()]
    ]
    assert len(set(plain)) == len(plain)
    assert {each.simulation.duration for each in held_out.values()} == {20.0}


def test_plays_and_both_ends_have_what_such_sensors_have() -> None:
    plays, both_ends = (arena_scenarios(kind).values() for kind in ("plays", "both_ends"))
    held_out = [*plays, *both_ends]
    assert {each.sensor.kind for each in plays} == {"play"}
    assert all(each.actuator is not None for each in both_ends)
    assert any(each.sensor.range is not None for each in held_out)
    assert any(each.sensor.quantum for each in held_out)
    assert any(each.sensor.load_friction for each in held_out)
    assert any(each.actuator and each.sensor.kind == "play" for each in held_out)


@pytest.mark.parametrize("chosen", SETS)
def test_scenarios_declare_what_covers_the_truth(chosen: str) -> None:
    tuning_on, held_out = (arena_scenarios(kind).values() for kind in SETS[chosen])
    truth = attrgetter("plant", "sensor", "actuator", *["reference"] * (chosen == "dead_zones"))
    assert not {repr(truth(each)) for each in tuning_on} & {repr(truth(each)) for each in held_out}
    for scenario in [*tuning_on, *held_out]:
        assert scenario.declared is not None
        low, high = scenario.declared.right
        assert low < np.min([scenario.sensor.right, scenario.sensor.left])
        assert high > np.max([scenario.sensor.right, scenario.sensor.left])
        assert scenario.simulation.time == "sampled"
        if scenario.actuator is not None:
            assumed = scenario.model.actuator
            assert assumed.right[0] < scenario.actuator.right < assumed.right[1]
            assert assumed.left[0] < scenario.actuator.left < assumed.left[1]


def test_methods_for_actuators_are_entered_where_there_is_one() -> None:
    needing = {name for name, method in METHODS.items() if method.compensator}
    assert needing == set(methods_for_scenarios(arena_scenarios("both_ends").values())) - set(
        methods_for_scenarios(arena_scenarios("held_out").values())
    )


def test_who_estimates_both_ends_beats_who_ignores_one() -> None:
    """On the valve and its tank; what knows the actuator is ahead of all."""
    of = {"valve": arena_scenarios("both_ends")["valve_both_ends"]}
    names = ["kalman", "actuator_inverse_blind", "robust_adaptive_blind"]
    found = {each.method: each.worth for each in score_methods(names, of, (0,), processes=1)}
    J = {name: worth.tracking for name, worth in found.items() if worth is not None}
    assert J["informed"] < J["full_state"] < 1.5 * J["kalman"]
    assert J["kalman"] < 0.5 * min(J[name] for name in names[1:])


@pytest.mark.parametrize("name", sorted(set(METHODS) - KNOW_THE_TRUTH))
def test_no_contestant_knows_the_truth(name: str) -> None:
    """Other widths and another plant behind the same model leave its options as they are."""

    def options(scenario: Scenario) -> str:
        found = enter_method(METHODS[name], build_setting(scenario))
        return repr(
            [
                msgspec.to_builtins(part, enc_hook=lambda number: number.tolist())
                for part in (found.observer, found.controller, found.compensator, found.model)
            ]
        )

    unsure = {"right": [0.0, 3.0], "left": [0.0, 3.0]}
    model = {"A": [[0.0, 1.0], [-1.0, -2.0]], "B": [[0.0], [1.0]], "actuator": unsure}
    ends = {"model": model, "observer": {"method": "kalman", "right": [0.0, 2.0]}}
    other = tables_of("""
        A = [[0.0, 1.0], [-1.4, -1.7]]
        B = [[0.0], [1.2]]
        C = [[1.0, 0.0]]
        x0 = [0.9, 0.1]
        """)
    truth = small(**ends, actuator={"right": 1.0, "left": 2.0})
    assert options(truth) == options(
        small(
            **ends,
            actuator={"right": 0.3, "left": 0.1},
            plant=other,
            sensor={"right": 0.5, "left": 1.6, "noise": 0.02, "drift": 0.1, "dropout": 0.1},
        )
    )


def test_without_a_declaration_the_observer_of_the_scenario_says_what_is_known() -> None:
    assert scenario_assumptions(small()).tolerance == 0.05
    certified = scenario_assumptions(
        small(
            declared=None,
            observer={"method": "certified", "L": [1.0, 1.5], "gamma": 1.0, "width_max": 2.5},
        )
    )
    assert np.array_equal(certified.right, [0.0, 2.5])
    censored = scenario_assumptions(
        small(declared=None, observer={"method": "censored", "right": [0.2, 1.9], "bias": 0.3})
    )
    assert np.array_equal(censored.right, [0.2, 1.9])
    assert censored.bias == 0.3
    assert (
        scenario_assumptions(
            small(declared=None, observer={"method": "luenberger", "L": [1.0, 1.0]})
        ).right[1]
        > 1.2
    )


# --- Every method, and what its runs are worth


@pytest.fixture(scope="module")
def everyone() -> list[Result]:
    return score_methods(list(method_registry()), {"small": small()}, (0,), numbers={}, processes=1)


@pytest.mark.parametrize("name", sorted(method_registry()))
def test_every_method_runs_or_says_why_not(name: str, everyone: list[Result]) -> None:
    (found,) = [each for each in everyone if each.method == name]
    if found.worth is None:
        assert found.reason
        assert ":" in found.reason
    else:
        assert found.worth.diverged or (
            math.isfinite(found.worth.tracking) and math.isfinite(found.worth.estimation)
        )
        assert found.worth.cost > 0


def test_every_observer_is_in_the_arena() -> None:
    assert set(OBSERVERS.list_options()) <= {
        method.observer for method in method_registry().values()
    }


def test_a_run_is_worth_what_its_signals_say() -> None:
    ground = build_setting(
        small(
            sensor={"right": 1.2, "left": 0.7, "noise": 0.02, "drift": 0.1},
            simulation={**SHORT, "duration": 10.0},
        )
    )
    worth = run_trial("ekf", METHODS["ekf"], "small", ground, [5])[0].worth
    scenario = enter_method(METHODS["ekf"], ground)
    run = simulate(
        msgspec.structs.replace(
            scenario, simulation=msgspec.structs.replace(scenario.simulation, seed=5)
        )
    )
    tail, problem = slice(800, None), resolve_scenario(scenario)
    truth = inputs.widths(problem, inputs.exogenous(problem, seed=5))[-1, :, 0]
    error, off = run.z - run.r, run.d_hat[-1] - truth
    assert worth is not None
    assert run.d_std is not None
    assert worth.tracking == pytest.approx(np.sqrt(np.mean(error[tail] ** 2)), rel=1e-12)
    assert worth.estimation == pytest.approx(
        np.sqrt(np.mean((run.z - run.z_hat)[tail] ** 2)), rel=1e-12
    )
    assert worth.width == pytest.approx(abs(off.sum()) / truth.sum(), rel=1e-12)
    assert worth.centre == pytest.approx(abs(off[0] - off[1]) / truth.sum(), rel=1e-12)
    assert worth.coverage == np.mean(np.abs(off) <= 1.96 * run.d_std[-1])
    assert worth.effort == pytest.approx(np.sqrt(np.mean(run.u**2)), rel=1e-12)
    assert worth.slew == pytest.approx(np.sqrt(np.mean(np.diff(run.u, axis=0) ** 2)), rel=1e-12)
    assert worth.settling is not None
    late = run.t >= worth.settling
    assert np.abs(error[late]).max() <= 0.1 * np.abs(run.r).max()
    assert np.abs(error[~late]).max() > 0.1 * np.abs(run.r).max()


def test_unknown_bias_leaves_no_error_of_the_centre_to_report() -> None:
    ground = build_setting(
        small(disturbance={"kind": "step", "amplitude": 0.5}, simulation={**SHORT, "duration": 6.0})
    )
    worth = run_trial("kalman", METHODS["kalman"], "small", ground, [0])[0].worth
    assert worth is not None
    assert worth.width is not None
    assert worth.centre is None


def test_processes_give_what_one_process_gives() -> None:
    grounds = {f"{noise}": small(sensor={"noise": noise}) for noise in (0.01, 0.1)}
    names = ["luenberger", "ekf"]
    alone, together = (
        score_methods(names, grounds, (0, 1), numbers={}, processes=count) for count in (1, 2)
    )

    def plain(results: list[Result]) -> list[Any]:
        return [
            (
                r.method,
                r.scenario,
                r.seed,
                None if r.worth is None else msgspec.structs.replace(r.worth, cost=0.0),
            )
            for r in results
        ]

    assert plain(alone) == plain(together)
    assert (
        len({r.worth.tracking for r in alone if r.worth is not None and r.method == "ekf"}) == 4
    )  # each seed, each scenario


# --- Regret and places


def test_regret_by_hand() -> None:
    results = []
    for scenario, scale in (("a", 1.0), ("b", 10.0)):
        for seed in (0, 1):
            results += [
                result("informed", scenario, seed, 0.1 * scale, zone=scale),
                result("full_state", scenario, seed, 0.1 * scale, zone=scale),
                result("luenberger", scenario, seed, 1.1 * scale, zone=scale),
            ]
            tracking = (0.2 + 0.1 * seed) * scale
            results.append(
                result("good", scenario, seed, tracking, coverage=1.0 - seed, zone=scale)
            )
            lost = scenario == "b"
            results.append(result("lost", scenario, seed, 1e3, diverged=lost, zone=scale))
            picky = 0.1 * scale if scenario == "a" else None
            results.append(result("picky", scenario, seed, picky, zone=scale))
    found = compute_regrets(results)
    assert np.allclose(found["good"], [[0.1, 0.2], [0.1, 0.2]])
    large = CAP - (CAP / 2) ** 2 / (1e3 - 0.1)
    assert np.allclose(found["lost"], [[large, large], [CAP, CAP]], rtol=1e-15)
    assert np.isnan(found["picky"]).tolist() == [[False, False], [True, True]]
    rows = {row.method: row for row in leaderboard.rank_methods(results, leaderboard.FRAME)}
    assert list(rows) == ["informed", "full_state", "good", "picky", "luenberger", "lost"]
    assert rows["good"].median_regret == pytest.approx(0.15)
    assert rows["good"].coverage == 0.5
    assert (rows["good"].behind, rows["good"].behind_interval) == (0.0, (0.0, 0.0))
    assert rows["lost"].behind == pytest.approx((large + CAP) / 2 - 0.15)
    assert rows["picky"].median_regret == pytest.approx(0.5)
    assert (
        rows["picky"].worst_regret,
        rows["picky"].worst_scenario,
        rows["picky"].not_applicable,
    ) == (pytest.approx(1.0), "b", 0.5)
    assert (rows["lost"].diverged, rows["lost"].worst_regret) == (0.5, CAP)
    assert (rows["full_state"].reference, rows["good"].reference) == (True, False)


@given(
    J=st.lists(st.floats(1e-9, 1e9), min_size=2, max_size=2, unique=True),
    lines=st.lists(st.floats(1e-9, 1e9), min_size=3, max_size=3),
    lost=st.lists(st.booleans(), min_size=3, max_size=3),
    zone=st.floats(1e-6, 1e6),
)
def test_the_smaller_error_ranks_ahead_whatever_the_lines_do(
    J: list[float], lines: list[float], lost: list[bool], zone: float
) -> None:
    """Also where the naive observer beats full state, or a line diverges."""
    best, other = sorted(J)
    assume(other - best > 1e-3 * zone and other < 1e6 * zone and max(lines) < 1e6 * zone)
    results = [result("best", "a", 0, best, zone=zone), result("other", "a", 0, other, zone=zone)]
    for name, value, gone in zip(leaderboard.FRAME, lines, lost, strict=True):
        results.append(result(name, "a", 0, value, diverged=gone, zone=zone))
    results.append(result("gone", "a", 0, 1e300, diverged=True, zone=zone))
    found = compute_regrets(results)
    assert -CAP < found["best"] < found["other"] < found["gone"] == CAP
    ranked = [row.method for row in leaderboard.rank_methods(results, leaderboard.FRAME)]
    own = [name for name in ranked if name not in leaderboard.FRAME]
    assert own == ["best", "other", "gone"]


def test_regrets_are_themselves_while_they_are_small() -> None:
    values = np.array([-7.0, -5.0, 0.0, 0.3, 5.0, 5.001, 50.0, np.inf])
    found = compress_regret(values)
    assert np.array_equal(found[1:5], values[1:5])
    assert (np.diff(found) > 0).all()
    assert found[-1] == CAP


def test_no_line_is_better_than_knowing_everything() -> None:
    """`informed` runs the true plant without its disturbance, whatever the model believes."""
    gusty = {"kind": "sine", "amplitude": 3.0, "frequency": 0.4}
    ground = build_setting(small(disturbance=gusty))
    J = {}
    for name in ("informed", "full_state", "luenberger", "printed", "fuzzy_feedback_blind"):
        worth = run_trial(name, METHODS[name], "small", ground, [3])[0].worth
        assert worth is not None
        J[name] = worth.tracking
    assert min(J, key=lambda name: J[name]) == "informed"
    assert J["informed"] < 0.05 * J["full_state"]


def test_intervals_hold_the_median_as_often_as_they_say() -> None:
    """Of log-normal scenarios with noisy seeds: the true median is 1."""
    rng = np.random.default_rng(1)
    covered = 0
    for k in range(100):
        scenario = np.exp(rng.normal(size=(20, 1)))
        median, worst = regret_intervals(scenario * (1 + 0.05 * rng.normal(size=(20, 3))), seed=k)
        covered += median.low <= 1.0 <= median.high
        assert median.low <= median.value <= median.high
        assert worst.low <= worst.value * (1 + 1e-12)
    assert 88 <= covered <= 100
    alike, worst = regret_intervals(np.repeat(np.arange(5.0)[:, None], 3, axis=1))
    assert worst == (4.0, 4.0, 4.0)
    assert (alike.low, alike.value, alike.high) == (0.0, 2.0, 4.0)


# --- Tuning


def test_every_method_gets_the_same_budget_and_the_search_finds_the_least() -> None:
    for name in ("kalman", "adaptive_inverse", "oracle", "walcott_zak"):
        knobs, seen = METHODS[name].knobs, []
        best = {
            address: knob.low * (knob.high / knob.low) ** 0.7 for address, knob in knobs.items()
        }

        def cost(given: Any, best: dict[str, float] = best, seen: list[Any] = seen) -> float:
            seen.append(given)
            return float(sum(np.log(given[address] / best[address]) ** 2 for address in best))

        found = tuning.best_candidate(METHODS[name], cost, 60, 0)
        assert len(seen) == found.candidates == 60
        assert seen[0] == middle_knobs(METHODS[name])
        assert found.regret == min(map(cost, seen[:60])) < 0.15 * found.before
        assert all(knob.low <= found.knobs[address] <= knob.high for address, knob in knobs.items())
        assert found == tuning.best_candidate(METHODS[name], cost, 60, 0)


def test_the_line_that_knows_everything_has_regret_0_and_the_naive_one_is_a_zone_off() -> None:
    ground = {"small": build_setting(small())}
    frame = score_methods((), {"small": small()}, [7], processes=1)
    assert tuning.mean_regret(METHODS["informed"], ground, frame, [7], {}) == 0
    assert 0 < tuning.mean_regret(METHODS["full_state"], ground, frame, [7], {}) < 0.3
    assert 0.7 < tuning.mean_regret(METHODS["luenberger"], ground, frame, [7], {}) < 1.3
    jumping = small(sensor={"kind": "jump", "noise": 0.02})
    jump = {"small": build_setting(jumping)}
    frame = score_methods((), {"small": jumping}, [7], processes=1)
    assert tuning.mean_regret(METHODS["kalman"], jump, frame, [7], {}) == CAP


@pytest.mark.parametrize(
    ("file", "kind"), [("tuned.toml", "tuning"), ("tuned_both_ends.toml", "both_ends_tuning")]
)
def test_the_stored_numbers_are_those_of_the_knobs(file: str, kind: Kind) -> None:
    stored = tuned.load_tuned(ROOT / "src" / "undeadzone_arena" / "contest" / file)
    assert set(stored.scenarios) == set(arena_scenarios(kind))
    assert set(read_knob_numbers()) == {name for name, method in METHODS.items() if method.knobs}
    assert stored.budget == 60
    for name, found in stored.methods.items():
        assert found.candidates == stored.budget
        assert found.regret <= found.before
        assert set(found.knobs) == set(METHODS[name].knobs)
        assert all(
            METHODS[name].knobs[address].low <= value <= METHODS[name].knobs[address].high
            for address, value in found.knobs.items()
        )


def test_tuned_numbers_are_saved_and_bad_files_named(tmp_path: Path) -> None:
    path, found = (
        tmp_path / "tuned.toml",
        tuned.TunedMethod(regret=0.1, before=0.2, candidates=3, knobs={"observer.L": 0.1 + 0.2}),
    )
    first = tuned.Tuned(budget=3, seeds=[1], search=0, scenarios=["a"], methods={"one": found})
    tuned.save_tuned(first, path)
    tuned.save_tuned(msgspec.structs.replace(first, methods={"two": found}), path)
    assert tuned.load_tuned(path).methods == {"one": found, "two": found}
    path.write_text("budget = 'no'")
    for name in ("tuned.toml", "absent.toml"):
        with pytest.raises(FileError, match=name):
            read_knob_numbers(tmp_path / name)


# --- The command and the page


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(toml.to_toml(small()))
    return path


def run(*arguments: str | Path) -> Any:
    return CliRunner().invoke(group, ["arena", *map(str, arguments)], catch_exceptions=False)


def test_the_template_leaves_certified_a_gain_that_is_certified(tmp_path: Path) -> None:
    """Sampled at 100 Hz the tuned multiple is too large: it was run, and diverged."""
    text = (ROOT / "src/undeadzone/template.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    for old, new in (
        ("duration = 20.0 ", "duration = 5.0 "),
        ("frequency = 0.2 ", "frequency = 1.0 "),
        ("left = 0.6 ", "left = 1.0 "),
        ("right = [0.0, 2.0] ", "right = [0.0, 3.0] "),
        ("# alpha = 10.0 ", "alpha = 10.0 "),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    done = json.loads(run(path, "--methods", "certified", "--seeds", "1", "--json").stdout)
    (row,) = [row for row in done["leaderboard"] if row["method"] == "certified"]
    assert row["median_regret"] < 0.1


def test_json_has_every_run_and_every_method(mine: Path) -> None:
    done = json.loads(run(mine, "--methods", "ekf,certified", "--seeds", "2", "--json").stdout)
    assert {(r["method"], r["scenario"], r["seed"]) for r in done["results"]} == {
        (method, "mine", seed)
        for method in (*leaderboard.FRAME, "ekf", "certified")
        for seed in (0, 1)
    }
    assert {"median_regret", "worst_regret", "median_interval", "worst_interval", "cost"} <= set(
        done["leaderboard"][0]
    )
    of = {(r["method"], r["seed"]): r for r in done["results"]}
    least, own = (of[method, 1]["tracking"] for method in ("informed", "ekf"))
    zone = of["ekf", 1]["zone"]
    assert of["ekf", 1]["regret"] == pytest.approx((own - least) / zone, rel=1e-12)
    assert zone == pytest.approx(small().sensor.right / 2 + small().sensor.left / 2)
    assert done["files"] == []


def test_a_user_picks_a_method_for_a_plant(mine: Path, tmp_path: Path) -> None:
    done = run(
        mine, "--methods", "ekf,printed,particle_filter", "--seeds", "1", "--out", tmp_path / "out"
    )
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert sum(line.split()[1:2] == ["ekf"] for line in lines) == 1
    best = next(line.split()[1] for line in lines if line.startswith("1 "))
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        "results.json",
        "costs.json",
        "report.html",
        "leaderboard.svg",
        "scenarios.svg",
        "trajectories.svg",
        "cost.svg",
        f"mine-{best}.toml",
    }
    again = simulate(read(tmp_path / "out" / f"mine-{best}.toml"))
    stored = json.loads((tmp_path / "out" / "results.json").read_text())
    tail = slice(int(0.8 * again.t.size), None)
    (row,) = [each for each in stored["results"] if each["method"] == best]
    assert row["tracking"] == pytest.approx(
        float(np.sqrt(np.mean((again.z - again.r)[tail] ** 2))), rel=1e-9
    )


def test_mistakes_are_named(mine: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"methods: there is no 'ekff'\. Did you mean 'ekf'"):
        run(mine, "--methods", "ekff")
    other = tmp_path / "b" / "mine.toml"
    other.parent.mkdir()
    shutil.copy(mine, other)
    with pytest.raises(InputError, match="the same file name"):
        scenarios_from_files([mine, other])
    other = other.with_name("other.toml")
    other.write_text(mine.read_text().replace("step =", "step = -1 #"))
    with pytest.raises(InputError, match=r"^other: simulation\.step: must be greater than 0"):
        run(mine, other, "--methods", "kalman")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--methods", ","], "expected names with commas between them, found ','"),
        (["--methods", ""], "expected names with commas between them"),
        (["--budget", "5"], "--budget has no effect without --tune"),
        (["--tune", "--seeds", "2"], "--seeds has no effect with --tune"),
        (["--tune", "--html"], "--html has no effect with --tune"),
    ],
)
def test_options_that_would_do_nothing_are_refused(options: list[str], expected: str) -> None:
    done = run(*options)
    assert done.exit_code == 2
    assert expected in done.output


def test_gears_are_refused_by_their_name() -> None:
    """Else a width of 0 was blamed, which nobody wrote."""
    geared = read(ROOT / "examples" / "two_link_gears.toml")
    with pytest.raises(InputError, match=r"arm\.gears: the arena has no gears with gaps"):
        build_setting(geared)


def test_tune_writes_what_the_arena_reads(mine: Path, tmp_path: Path) -> None:
    done = run(
        mine,
        "--tune",
        "--methods",
        "oracle,luenberger",
        "--budget",
        "5",
        "--processes",
        "1",
        "--out",
        tmp_path,
    )
    assert "oracle" in done.stdout
    found = tuned.load_tuned(tmp_path / "tuned.toml")
    assert list(found.methods) == ["oracle"]
    assert found.methods["oracle"].candidates == found.budget == 5
    assert found.scenarios == ["mine"]
    table = json.loads(
        run(
            mine,
            "--methods",
            "oracle",
            "--seeds",
            "1",
            "--json",
            "--tuned",
            tmp_path / "tuned.toml",
        ).stdout
    )
    lines = {"informed", "full_state", "luenberger", "oracle"}
    assert {row["method"] for row in table["leaderboard"]} == lines


def test_the_page_shows_the_numbers_of_the_contest() -> None:
    contest = run_contest(
        ["ekf", "kalman", "printed"],
        {"small": small(), "jump": small(sensor={"kind": "jump", "noise": 0.02})},
        (0,),
        {},
        1,
    )
    runs = trace_runs(contest, "small")
    drawn_ = arena_figures(contest, runs)
    assert set(drawn_) == {"leaderboard", "scenarios", "trajectories", "cost"}
    table = drawn_["scenarios"].axes[0]
    texts = [text.get_text() for text in table.texts]
    assert len(texts) == 2 * len(contest.rows)
    assert texts.count("–") == 2  # kalman, ekf on the jump sensor
    page = arena_page(contest, {})
    for row in contest.rows:
        assert row.method in page
        assert f"{row.worst_regret:.4g}" in page
    assert "'kalman' cannot use" in page.replace("&#x27;", "'")
    for trace in runs:
        worth = next(
            r.worth for r in contest.results if (r.method, r.scenario) == (trace.method, "small")
        )
        assert worth is not None
        tail = slice(int(0.8 * trace.t.size), None)
        assert worth.diverged or np.sqrt(np.mean((trace.z - trace.r)[tail] ** 2)) == pytest.approx(
            worth.tracking, rel=1e-9
        )


class Stubborn(Luenberger, frozen=True, kw_only=True, tag="stubborn"):
    """An observer of a user's own, that no package registers."""


def test_an_observer_of_ones_own_enters_without_being_installed(tmp_path: Path) -> None:
    mine = Stubborn(L=[[4.0], [4.0]])
    contest = arena([small()], {"mine": mine}, methods=["certified"], seeds=[0, 1])
    places = {row.method: row for row in contest.rows}
    assert {"mine", "certified", "informed"} <= places.keys()
    assert places["mine"].not_applicable == 0
    (title,) = contest.scenarios
    assert contest.scenario("mine", title).observer == mine
    assert contest.replay("mine", title)[1].z.size > 100
    contest.save(tmp_path / "results.json")
    results = json.loads((tmp_path / "results.json").read_text())
    assert {row["method"] for row in results["results"]} >= {"mine", "certified"}
    with pytest.raises(InputError, match="'kalman' is in the catalogue"):
        arena([small()], {"kalman": mine})


def test_a_method_that_does_not_apply_says_why() -> None:
    """Of one or a few in full; of many their names."""
    others = dict.fromkeys(leaderboard.Row.__annotations__, 1.0)
    row: Any = leaderboard.Row
    refused = [row(**others | {"method": name, "reference": False}) for name in "abcd"]
    reasons = {row.method: f"{row.method} needs poles" for row in refused}
    blocks = leaderboard_blocks(refused[:1], 1, 1, reasons)
    assert "not applicable: a: a needs poles" in blocks
    assert "not applicable (--json has the reasons): a, b, c, d" in leaderboard_blocks(
        refused, 1, 1, reasons
    )


def test_a_run_has_diverged_though_it_began_well() -> None:
    problem = resolve_scenario(small())
    still = np.zeros((4, 1))
    gone = still + np.array([[0.0], [0.0], [1e30], [np.nan]])
    estimate = SimpleNamespace(x=np.zeros((4, problem.model.n)), z=still, right=still, left=still)
    fine: Any = SimpleNamespace(z=still, x=estimate.x, u=still, estimate=estimate)
    assert not _has_diverged(problem, fine)
    for rows in (gone, gone[[0, 1, 2, 2]], gone[[0, 3, 3, 0]]):
        far: Any = SimpleNamespace(**vars(fine) | {"z": rows})
        assert _has_diverged(problem, far)


def test_the_effort_names_every_run() -> None:
    grounds = {"one": small(), "two": small(sensor={"right": 0.5, "left": 0.5})}
    effort = effort_text(["naive", "kalman", "oracle"], grounds, 5, "seed", 1)
    assert effort.startswith("3 methods x 2 scenarios x 5 seeds = 30 runs; ")
