"""Tuning: candidates as lanes, gradients, known optima, certificate, held-out runs, the command."""

from __future__ import annotations

import dataclasses
import json
import textwrap
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from documents import EXAMPLES
from scenes import scene, tables_of
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.cli import group
from undeadzone.errors import InputError, StructureError
from undeadzone.observers import HighGain
from undeadzone.results.scales import LIMIT
from undeadzone.scenario.address import find_option_numbers, with_numbers
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import parse, read
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Range, Tune
from undeadzone.simulation.exogenous import exogenous
from undeadzone.simulation.packed import graph
from undeadzone.simulation.simulate import outputs_of
from undeadzone.simulation.simulate import prepare as prepare_loop
from undeadzone.util import toml
from undeadzone.util.arrays import Floats
from undeadzone_arena import ParticleFilter, TaylorResidual
from undeadzone_studies.commands.tune import tune as command
from undeadzone_studies.ensemble import metrics
from undeadzone_studies.ensemble.batch import prepare_batch
from undeadzone_studies.statistics.intervals import Interval
from undeadzone_studies.tuning.candidates import (
    Frame,
    Objective,
    loss_statistic,
    metric_losses,
    metrics_from_outputs,
)
from undeadzone_studies.tuning.parameters import resolve_parameters, values_at_shares
from undeadzone_studies.tuning.result import HeldOut, HeldOutCost, Tuned, estimate_change
from undeadzone_studies.tuning.tune import (
    FORBIDDEN,
    REACH,
    Evaluation,
    Search,
    _penalise_margin,
    difference_gradient,
    sweep,
    tune,
)

GAMMA = {"observer.gamma": Range(between=(0.1, 100.0), log=True)}
GAINS = {"observer.L": Range(between=(0.01, 100.0), log=True), **GAMMA}


def gusts(**changes: Any) -> Scenario:
    """The paper's loop at 100 Hz, in gusts, with widths that vary."""
    widths = {"uniform": [0.3, 2.0]}
    scenario = scene(
        """
        sensor = { noise = 0.02 }
        simulation = { time = "sampled", step = 0.01, duration = 4.0 }
        disturbance = { kind = "random", rms = 5.0, correlation_time = 0.3 }
        """,
        ensemble={"entries": {"sensor.right": widths, "sensor.left": widths}},
    )
    return msgspec.structs.replace(scenario, **changes)


@pytest.fixture(scope="module")
def freely() -> Tuned:
    """All gains tuned, without a certificate."""
    return tune(gusts(), Tune(entries=GAINS, runs=16, held_out=64, budget=150))


def of(what: Tune, scenario: Scenario, names: list[str], probes: Any) -> Objective:
    return Objective(what, names, [scenario], [Frame()]).prepare_runs(np.array(probes, float), 0)


def test_numbers_of_the_options_by_address() -> None:
    scenario = gusts()
    known = find_option_numbers(scenario)
    assert known["observer.L[1]"].value == 1.5
    assert known["observer.gamma"].value == 10.0
    assert known["controller.poles"].value is None
    assert "observer.silence" not in known
    assert "observer.design" not in known
    changed = with_numbers(scenario, {"observer.L[1]": 7.0, "controller.alpha": 3.0})
    np.testing.assert_array_equal(changed.observer.L, [1.0, 7.0])
    assert changed.controller.alpha == 3.0
    as_before = {name: known[name] for name in ("observer.L[1]", "controller.alpha")}
    assert find_option_numbers(changed) | as_before == known


@pytest.mark.parametrize(
    ("address", "names"),
    [
        ("observer.L", ["observer.L[0]", "observer.L[1]"]),
        ("observer.L[:,0]", ["observer.L[0]", "observer.L[1]"]),
        ("observer.L[1,0]", ["observer.L[1]"]),
        ("observer.gamma[0]", ["observer.gamma"]),
    ],
)
def test_an_address_names_entries(address: str, names: list[str]) -> None:
    assert [
        p.name for p in resolve_parameters({address: Range(between=(0.0, 20.0))}, gusts())
    ] == names


def test_no_gains_of_an_unstable_plant_are_certified() -> None:
    plant = tables_of("""
        A = [[0.0, 1.0], [1.0, -2.0]]
        B = [[0.0], [1.0]]
        C = [[1.0, 0.0]]
        x0 = [0.5, 0.0]
        """)
    scenario = scene(plant=plant, observer={"method": "certified", "L": [5.0, 6.0]})
    with pytest.raises(StructureError, match="no gains can be certified: the model is unstable"):
        tune(scenario, Tune(entries={"observer.gamma": Range(between=(0.1, 10.0))}, certified=True))


def test_a_candidate_is_the_run_of_its_own_scenario() -> None:
    scenario, names = gusts(), ["observer.L[0]", "observer.L[1]", "observer.gamma"]
    on = of(Tune(entries=GAINS, runs=6), scenario, names, [[1.0, 1.5, 10.0], [2.0, 3.0, 4.0]])
    points = np.array([[1.0, 1.5, 10.0], [0.3, 8.0, 0.7], [4.0, 30.0, 20.0]])
    runs = on.test_runs[0]
    together = runs.simulate_candidates(
        [resolve_scenario(on.candidate_scenario(0, point)) for point in points]
    )
    for point, rows in zip(points, together, strict=True):
        alone = prepare_batch(with_numbers(scenario, dict(zip(names, point, strict=True))))
        expected = alone.rows_of_runs(np.arange(6), runs.values)[:, runs.values.shape[1] :]
        np.testing.assert_allclose(rows, expected, rtol=1e-9)


def test_the_gradient_by_lanes_is_that_of_single_candidates() -> None:
    what = Tune(entries=GAINS, runs=6)
    tuned = resolve_parameters(what.entries, gusts())
    on = of(what, gusts(), [p.name for p in tuned], [[1.0, 1.5, 10.0], [2.0, 3.0, 4.0]])

    def evaluate(u: Floats) -> Evaluation:
        problems = on.candidate_problems(values_at_shares(tuned, u))
        return Evaluation(on.candidate_costs(problems), np.full(len(u), np.inf))

    def difference(u: Floats, step: Floats) -> float:
        ahead, behind = evaluate((u + step)[None]).cost[0], evaluate((u - step)[None]).cost[0]
        return (ahead - behind) / (2 * step.max())

    u = np.array([0.5, 0.7, 0.4])
    worth, slopes = difference_gradient(evaluate, u)
    assert worth.cost[0] == evaluate(u[None]).cost[0]
    for direction, slope in zip(np.eye(3), slopes.cost, strict=True):
        assert slope == pytest.approx(difference(u, REACH * direction), rel=1e-12)
        assert slope == pytest.approx(difference(u, 1e-5 * direction), rel=0.1, abs=0.03)


def test_the_gradient_stays_in_the_box_and_off_what_is_refused() -> None:
    def evaluate(u: Floats) -> Evaluation:
        cost = np.where(u[:, 1] > 0.5, np.inf, (u**2).sum(axis=1))
        return Evaluation(cost, np.full(len(u), np.inf))

    worth, slopes = difference_gradient(evaluate, np.array([1.0, 0.5]))
    assert worth.cost[0] == 1.25
    np.testing.assert_allclose(slopes.cost, [2 - REACH, 1 - REACH])
    np.testing.assert_array_equal(slopes.margin, 0.0)


def test_without_certificate_a_candidate_costs_the_more_the_more_it_lacks() -> None:
    margin = np.array([0.3, 0.1, 0.0, -np.inf, np.inf])
    cost = _penalise_margin(Evaluation(np.arange(5.0), margin), 0.2)
    assert cost[0] == 0.0
    assert cost[4] == 4.0
    assert FORBIDDEN < cost[1] < cost[2] < cost[3] < np.inf


@pytest.mark.parametrize(
    ("name", "metric"), [("mean", "rms_estimation"), ("median", "rms_tracking")]
)
def test_one_gain_is_as_good_as_a_dense_sweep(name: Any, metric: str) -> None:
    what = Tune(entries=GAMMA, runs=16, held_out=16, budget=60, statistic=name, metric=metric)
    dense = sweep(gusts(), {"observer.gamma": np.geomspace(0.1, 100.0, 91)}, what)
    best = dense.axes["observer.gamma"][dense.cost.argmin()]
    assert 0.2 < best < 50.0
    found = tune(gusts(), what)
    assert found.cost[1] <= dense.cost.min() * (1 + 1e-3)
    assert np.log(found.values[0] / best) == pytest.approx(0.0, abs=0.1)
    assert len(found.trials) <= 60


def test_several_gains_are_better_than_a_grid(freely: Tuned) -> None:
    what = Tune(entries=GAINS, runs=16, held_out=64, budget=150)
    L, gamma = GAINS["observer.L"].between, GAINS["observer.gamma"].between
    axes = {"observer.L": np.geomspace(*L, 5), "observer.gamma": np.geomspace(*gamma, 5)}
    grid = sweep(gusts(), axes, what)
    assert list(grid.axes) == ["observer.L[0]", "observer.L[1]", "observer.gamma"]
    assert grid.cost.shape == (5, 5, 5)
    assert freely.cost[1] < grid.cost.min()
    assert freely.improved
    assert {trial.stage for trial in freely.trials} >= {"start", "global", "gradient"}
    assert min(trial.cost for trial in freely.trials) == freely.cost[1]


def test_the_certificate_is_satisfied_where_it_binds(freely: Tuned) -> None:
    what = Tune(entries=GAINS, runs=16, held_out=64, budget=150, certified=True, margin=0.02)
    found = tune(gusts(), what)
    model = resolve_scenario(found.scenario).model
    L, gamma = np.reshape(found.values[:2], (2, 1)), np.array(found.values[2:])
    proof = certify(model.linear, L, gamma, model.Ts)
    assert proof.certified
    assert proof.margin == pytest.approx(found.margin)
    assert 0.02 <= proof.margin < 0.1
    assert freely.cost[1] < found.cost[1]
    L, gamma = np.reshape(freely.values[:2], (2, 1)), np.array(freely.values[2:])
    assert not certify(model.linear, L, gamma, model.Ts).certified
    assert found.improved
    assert found.certified


def test_threads_change_nothing() -> None:
    what = Tune(entries=GAINS, runs=16, held_out=64, budget=40)
    one, two = (tune(gusts(), what, threads=threads) for threads in (1, 2))
    assert one.trials == two.trials
    assert one.summary() == two.summary()


def test_a_rebuilt_option_is_a_lane_too() -> None:
    scenario = gusts(observer=HighGain(epsilon=0.2))
    names, probes = ["observer.epsilon", "controller.alpha"], [[0.2, 10.0], [0.1, 5.0], [0.3, 20.0]]
    on = of(Tune(runs=4), scenario, names, probes)
    nominal, faster, too_fast = on.candidate_problems(
        np.array([[0.2, 10.0], [0.05, 3.0], [1e-4, 3.0]])
    )
    assert too_fast is None  # for the sample time
    cost = on.candidate_costs([nominal, faster])
    runs = on.test_runs[0]
    assert runs.graph == graph(faster[0])
    alone = prepare_batch(faster[0].scenario)
    lost = metric_losses("rms_tracking", runs, alone.rows_of_runs(np.arange(4), runs.values)[:, 2:])
    assert cost[1] == pytest.approx(lost.mean(), rel=1e-9)


def test_an_observer_in_python_runs_the_same_runs() -> None:
    scenario = gusts(ensemble=None)
    runs = of(Tune(runs=3), scenario, ["observer.gamma"], [[10.0], [5.0]]).test_runs[0]
    problem = resolve_scenario(scenario)
    for k, expected in enumerate(runs.simulate_candidates([problem])[0]):
        start = prepare_loop(problem)._replace(exogenous=exogenous(problem, run=k))
        metrics_of_run = metrics_from_outputs(problem, outputs_of(start))
        np.testing.assert_allclose(metrics_of_run[0], expected, rtol=1e-9)
    observer = ParticleFilter(right=[0.0, 2.0], particles=10, noise=0.1)
    particles = gusts(ensemble=None, observer=observer)
    noise = {"observer.noise": Range(between=(0.01, 1.0), log=True)}
    found = tune(particles, Tune(entries=noise, runs=2, held_out=2, budget=4))
    assert len(found.trials) == 4
    assert found.cost[1] <= found.cost[0]
    with pytest.raises(InputError, match="computes in Python"):
        tune(gusts(observer=particles.observer), Tune(entries=noise))


def test_another_structure_is_another_graph() -> None:
    graphs = []
    for degree, leak in ((5, 0.1), (5, 0.2), (7, 0.1)):
        options = TaylorResidual(reach=6.0, speed=3.0, degree=degree, leak=leak)
        graphs.append(graph(resolve_scenario(gusts(observer=options))))
    assert graphs[0] == graphs[1] != graphs[2]


def test_runs_that_diverge_cost_more_the_faster_they_do() -> None:
    runs = of(Tune(runs=2), gusts(), ["observer.gamma"], [[10.0], [5.0]]).test_runs[0]
    names = metrics.metric_names(resolve_scenario(gusts()).plant, "deadzone")
    rows = np.zeros((5, len(names)))
    rows[:, names.index("rms_tracking")] = [0.1, np.inf, np.nan, 3.0, 1e20]
    rows[:, names.index("diverged")] = [0, 1, 1, 0, 0]
    rows[:, names.index("peak_tracking")] = [1.0, 1e20, 1e20, 4.0, 1e3]
    rows[:, names.index("settling_time")] = [1.0, 3.0, 1.0, 4.0, 4.0]
    lost = metric_losses("rms_tracking", runs, rows)
    assert lost[0] == 0.1
    assert lost[3] == 3.0
    assert LIMIT == lost[4] < lost[1] < lost[2] < 2 * LIMIT
    rows[:, names.index("d_right[0]")] = 5.0
    errors = metric_losses("d_right_error[0]", runs, rows[:1, None].repeat(2, axis=1))
    np.testing.assert_allclose(errors[0], 5.0 - runs.values[:, 0])


def test_statistics_of_losses() -> None:
    lost = np.random.default_rng(0).permutation(np.arange(1.0, 101.0))[None]
    expected = {"mean": 50.5, "median": 50.0, "p95": 95.0, "worst": 100.0}
    assert {name: loss_statistic(name, lost)[0] for name in expected} == expected


def test_the_interval_of_the_change_covers_it() -> None:
    rng, covered = np.random.default_rng(1), 0
    on = of(Tune(runs=2), gusts(), ["observer.gamma"], [[10.0], [5.0]])
    for seed in range(200):
        hard = rng.exponential(size=100)
        found = estimate_change(
            on, [np.stack([hard, 0.9 * hard + 0.05 * rng.normal(size=100)])], seed
        )
        covered += found.low <= -0.1 <= found.high
    assert 0.90 <= covered / 200 <= 0.985


def test_better_means_fewer_diverge_or_a_change_that_chance_does_not_explain() -> None:
    found = tune(gusts(), Tune(entries=GAMMA, runs=4, held_out=8, budget=4))
    none, some = Interval(0.0, 0.0, 0.1), Interval(0.1, 0.0, 0.2)
    value = Interval(1.0, 0.9, 1.1)

    def improved(before: Interval, after: Interval, change: Interval) -> bool:
        held_out = HeldOut(HeldOutCost(value, before), HeldOutCost(value, after), 8)
        return dataclasses.replace(found, held_out=(held_out,), change=change).improved

    assert improved(none, none, Interval(-1.0, -2.0, -0.1))
    assert not improved(none, none, Interval(-1.0, -2.0, 0.1))
    assert not improved(none, some, Interval(-1.0, -2.0, -0.1))
    assert improved(some, none, Interval(1.0, 0.1, 2.0))
    assert improved(none, none, Interval(-1.0, -np.inf, np.inf))  # the worst of the runs


def test_several_scenarios_at_once() -> None:
    calm = gusts(title="calm", disturbance=None)
    what = Tune(entries=GAMMA, runs=8, held_out=8, budget=24)
    frames = [Frame(0.1, 2.0), Frame(0.0, 0.05)]
    found = tune([gusts(), calm], what, frames=frames)
    scores = []
    for scenario, frame in zip((gusts(), calm), frames, strict=True):
        cost = sweep(scenario, {"observer.gamma": [found.values[0], 10.0]}, what).cost
        scores.append((cost - frame.zero) / (frame.one - frame.zero))
    np.testing.assert_allclose(np.mean(scores, axis=0)[::-1], found.cost, rtol=1e-9)
    assert [scenario.title for scenario in found.scenarios] == [gusts().title, "calm"]
    assert {scenario.observer.gamma for scenario in found.scenarios} == {found.values[0]}
    assert found.runs == len(found.trials) * 8 * 2
    other = gusts(title="other", observer=HighGain())
    with pytest.raises(InputError, match="scenario 'other' has no such number"):
        tune([gusts(), other], Tune(entries={"observer.L": GAINS["observer.L"]}))
    for wrong in ([Frame(1.0, 1.0)], [Frame(), Frame()]):
        with pytest.raises(InputError, match="frames: expected one for each of 1 scenarios"):
            tune([gusts()], what, frames=wrong)


def test_runs_that_are_alike_are_one_run() -> None:
    still = scene(simulation={"time": "sampled", "step": 1e-2})
    found = tune(still, Tune(entries=GAMMA, budget=12))
    assert found.change.low == found.change.value == found.change.high
    assert found.held_out[0].runs == 1
    assert found.runs == len(found.trials)
    assert found.improved == (found.cost[1] < found.cost[0])


def test_the_command(tmp_path: Path) -> None:
    scenario = tmp_path / "mine.toml"
    what = Tune(entries=GAMMA, runs=16, held_out=64, budget=40)
    scenario.write_text(toml.to_toml(gusts(tune=what)))
    words = ["--over", "observer.L=0.01:100:log", "--json", "--out", str(tmp_path / "out")]
    run = CliRunner().invoke(group, ["tune", str(scenario), *words], standalone_mode=False)
    assert run.exception is None
    assert run.return_value == 0
    found = json.loads(run.stdout)
    assert found["improved"]
    assert found["certified"] is None
    assert found["held_out"]["seed"] == found["seed"] + 1
    assert len(found["history"]) == found["evaluations"] <= 40
    tuned = read(tmp_path / "out" / "tuned.toml")
    assert len(found["parameters"]) == 3
    assert all(
        find_option_numbers(tuned)[p["name"]].value == p["value"] for p in found["parameters"]
    )
    for name in ("history.svg", "around.svg"):
        assert (tmp_path / "out" / name).stat().st_size > 10_000
    words = ["--budget", "4", "--no-figures"]
    path = str(tmp_path / "out" / "tuned.toml")
    again = CliRunner().invoke(group, ["tune", path, *words], standalone_mode=False)
    assert again.return_value == 1
    assert "NO improvement" in again.stdout


def test_a_tuned_scenario_finds_its_files(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "r.csv").write_text("t,r\n0,0\n1,1\n2,0\n4,1\n")
    reference = {"kind": "csv", "path": str(tmp_path / "here" / "r.csv")}
    scenario = scene(reference=reference, simulation=msgspec.to_builtins(gusts().simulation))
    found = tune(scenario, Tune(entries=GAMMA, runs=2, held_out=2, budget=4))
    path = found.save(tmp_path / "there" / "deep" / "tuned.toml")
    assert resolve_scenario(read(path)).reference is not None


def example_of_the_help() -> str:
    """The table [tune] that `undeadzone tune --help` shows."""
    text = command.help or ""
    return textwrap.dedent(text.split("\b")[1].split("\n\n")[0].strip("\n"))


@pytest.mark.parametrize("certified_gains", ["", "L = [2.0, 1.0, 40.0]"])
def test_the_example_of_the_help_tunes_a_third_order_plant(certified_gains: str) -> None:
    """Gains that the scenario leaves to the method are tuned from the method's own."""
    text = (EXAMPLES / "third_order.toml").read_text(encoding="utf-8")
    text = text.replace('method = "certified" ', f'{certified_gains}\nmethod = "certified" ')
    scenario = parse(text + "\n" + example_of_the_help()) | {"simulation": {"duration": 2.0}}
    assert scenario.tune is not None
    small = msgspec.structs.replace(scenario.tune, runs=4, held_out=4, budget=12)
    tuned = tune(scenario, small, threads=1)
    names = ["observer.gamma", "observer.L[0]", "observer.L[1]", "observer.L[2]"]
    assert [parameter.name for parameter in tuned.parameters] == names
    for parameter, value in zip(tuned.parameters, tuned.values, strict=True):
        assert parameter.low <= value <= parameter.high
    assert tuned.margin is not None
    assert tuned.margin > 0


@pytest.mark.parametrize(
    ("whole", "statistic", "descends"),
    [
        ((False, False), "mean", True),
        ((True, False), "mean", False),
        ((True, True), "mean", False),
        ((False, False), "median", False),
    ],
)
def test_only_what_has_slopes_descends(
    monkeypatch: pytest.MonkeyPatch, whole: tuple[bool, bool], statistic: Any, descends: bool
) -> None:
    """A mean has them, unless one of the numbers is whole."""
    stages: list[str] = []
    for name, stage in (
        ("_evolve_candidates", "global"),
        ("_descend_slope", "gradient"),
        ("_search_near_best", "local"),
    ):
        monkeypatch.setattr(
            f"undeadzone_studies.tuning.tune.{name}", lambda *a, s=stage: stages.append(s)
        )
    search: Any = SimpleNamespace(
        objective=SimpleNamespace(what=Tune(entries=GAINS, statistic=statistic)),
        parameters=[SimpleNamespace(whole=one) for one in whole],
        evaluate_candidates=lambda *a, **more: None,
        best_shares=np.zeros(2),
        cheapest_candidate=SimpleNamespace(cost=1.0),
    )
    Search.spend_budget(search, np.zeros(2), 0)
    assert stages == ["global", *["gradient"] * descends, "local"]
