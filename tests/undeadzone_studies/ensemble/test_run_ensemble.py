"""Ensembles as a whole.

A run's metrics are those of its signals, its bits depend on nothing but (scenario, seed, run), and
nothing done is lost.
"""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from test_engines import OBSERVERS, PENDULUM, TWO_OUTPUTS, distance, identical, small

from scenes import tables_of
from undeadzone.cli import main
from undeadzone.compile import interpret, lanes
from undeadzone.errors import InputError
from undeadzone.results.run import LAST, Run
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.exogenous import exogenous
from undeadzone.util.arrays import Floats
from undeadzone.util.toml import to_toml
from undeadzone_studies.ensemble.batch import Batch, prepare_batch
from undeadzone_studies.ensemble.result import Ensemble
from undeadzone_studies.ensemble.run_ensemble import (
    compute_bands,
    replay_deviation,
    replay_in_batch,
    replay_run,
    run_ensemble,
)

RUNS = 150  # more than one block of lanes
WIDTHS: dict[str, Any] = {
    "sensor.right": {"uniform": [0.3, 0.8]},
    "sensor.left": {"uniform": [0.2, 0.4]},
}
PLANT: dict[str, Any] = {
    "plant.A": {"normal": [1.0, 0.05], "relative": True},
    "plant.B + plant.C": {"normal": [1.0, 0.05], "relative": True},
}
NOISE: dict[str, Any] = {
    "sensor.noise": {"log_normal": [0.01, 0.5]},
    "sensor.noise_before": {"uniform": [0.0, 0.02]},
}
SECOND: dict[str, Any] = tables_of("""
plant = { A = [[-0.3, 1.0], [-1.0, -2.0]], B = [[0.3], [1.0]], C = [[1.0, 0.7]], x0 = [0.4, 0.2] }
observer = { method = "certified", L = [1.0, 0.5], gamma = 5.0 }
""")
GUST: dict[str, Any] = {"disturbance": {"kind": "random", "rms": 0.5, "correlation_time": 0.1}}
SWINGING: dict[str, Any] = tables_of("""
observer = { method = "certified", L = [1.0, 0.0] }
reference = { kind = "sine", amplitude = 1.0, frequency = 0.5 }
simulation = { duration = 3.0, step = 0.01, substeps = 1 }
""") | {
    "plant": PENDULUM
    | {"f": ["rate", "-g * sin(angle) - 1.5 * rate + torque"], "parameters": {"g": 9.81}}
}
SCENES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "continuous": (
        "continuous",
        GUST,
        WIDTHS | PLANT | NOISE | {"reference.amplitude": {"uniform": [1.5, 2.5]}},
    ),
    "plain": (
        "continuous",
        {"simulation": {"duration": 3.0, "step": 1e-2, "switching": "plain"}},
        WIDTHS | {"plant.x0": {"normal": [0.0, 1.0]}},
    ),
    "sampled": (
        "sampled",
        SECOND | GUST,
        WIDTHS | PLANT | NOISE | {"disturbance.rms": {"uniform": [0.1, 1.0]}},
    ),
    "two outputs": (
        "sampled",
        {"plant": TWO_OUTPUTS, "observer": {"method": "certified", "gamma": 5.0}},
        WIDTHS | PLANT | NOISE,
    ),
    "nonlinear": (
        "sampled",
        SWINGING,
        {"plant.parameters.g": {"uniform": [9.0, 10.5]}, "sensor.right": {"uniform": [0.1, 0.5]}},
    ),
    "jump": (
        "sampled",
        {"sensor": {"kind": "jump", "noise": 0.05}},
        WIDTHS | {"observer.gamma": {"uniform": [5.0, 15.0]}},
    ),
}


def vary(scenario: Scenario, entries: dict[str, Any], runs: int = RUNS, **changes: Any) -> Scenario:
    ensemble = msgspec.convert({"runs": runs, "entries": entries} | changes, Vary)
    return msgspec.structs.replace(scenario, ensemble=ensemble)


def named(name: str, runs: int = RUNS) -> Scenario:
    time, changes, entries = SCENES[name]
    return vary(small(time, **changes), entries, runs)


def table(batch: Batch, rows: Floats | None = None) -> dict[str, Floats]:
    """Rows of a batch as columns by name; default: those of its first block."""
    if rows is None:
        rows = batch.block(0)
    return dict(zip(batch.layout.columns, rows.T, strict=True))


def finals(batch: Batch, steps: int) -> Floats:
    """The states of all runs after so many steps, as the ensemble computes them."""
    runs = batch.layout.runs
    own = batch.binding.numbers.to_lanes(batch.binding.draw_columns(0, runs, runs))
    short = batch._replace(exogenous=batch.exogenous[:steps])
    return short.execute_kernel(batch.kernel, np.arange(runs), own)[1]


def metrics(run: Run, batch: Batch, tolerance: float) -> dict[str, float]:
    """What the recorded signals of a run say."""
    worst = np.abs(run.z[:, batch.problem.tracked] - run.r).max(axis=1)
    late = np.flatnonzero(worst > tolerance)
    widths = {}
    for i in range(run.z.shape[1]):
        widths[f"d_right[{i}]"] = float(run.d_hat[-1, 2 * i])
        widths[f"d_left[{i}]"] = float(run.d_hat[-1, 2 * i + 1])
    return {
        "rms_tracking": run.rms_tracking,
        "rms_estimation": run.rms_estimation,
        "peak_tracking": float(worst.max()),
        "settling_time": float(run.t[late[-1]]) if late.size else 0.0,
        "silent_fraction": run.silent_fraction,
        "rms_input": float(np.sqrt(np.sum(run.u**2, axis=1).mean())),
        "diverged": float(run.divergence_time is not None),
        **widths,
    }


# --- One run


@pytest.mark.parametrize("name", SCENES)
def test_a_replayed_run_is_the_run_of_the_ensemble(name: str) -> None:
    batch = prepare_batch(named(name))
    rows, last = table(batch), finals(batch, len(batch.exogenous) - 1)
    largest = np.abs(batch.problem.reference.output_at(batch.exogenous[:, -2])).max()
    for k in (0, 7, 149):
        run = replay_in_batch(batch, k)
        assert identical(run.x[-1], last[k, : run.x.shape[1]])
        scale = rows.get("reference.amplitude", np.full(RUNS, 2.0))[k] / 2.0
        for metric, value in metrics(run, batch, 0.02 * largest * scale).items():
            if metric.startswith("d_"):  # widths are states, equal to the bit
                assert rows[metric][k] == value, metric
            else:  # in continuous time the loop reads r 1e-9 of a step late
                assert rows[metric][k] == pytest.approx(value, rel=1e-13, abs=1e-9), metric


@pytest.mark.parametrize("name", SCENES)
def test_the_virtual_machine_agrees_with_the_same_numbers(name: str) -> None:
    batch = prepare_batch(named(name))
    last = finals(batch, len(batch.exogenous))
    problem = batch.problem
    if NOISE.keys() & problem.scenario.ensemble.entries.keys():
        ones = {"noise": np.ones(2), "noise_before": np.ones(2)}  # scaled in the loop
        problem = problem._replace(sensor=msgspec.structs.replace(problem.sensor, **ones))
    for k in (0, 7, 149):
        state, params = batch.binding.numbers.pack_lane(batch.binding.draw_columns(k, 1, RUNS)[0])
        inputs = exogenous(problem, run=k, seed=batch.binding.seed)
        expected = interpret.run_interpreted(batch.loop.step, state, inputs, params)[1]
        assert distance(last[k, : state.size, None], expected[:, None]) < 1e-12


@pytest.mark.parametrize(
    "observer", [name for name, (times, _) in OBSERVERS.items() if "sampled" in times]
)
def test_every_observer_that_is_a_graph_has_ensembles(observer: str) -> None:
    options = {"method": observer} | OBSERVERS[observer][1]
    batch = prepare_batch(vary(small("sampled", observer=options), WIDTHS, 40))
    rows, last = table(batch), finals(batch, len(batch.exogenous) - 1)
    run = replay_in_batch(batch, 39)
    assert identical(run.x[-1], last[39, :1])
    of_signals = metrics(run, batch, 0.04)
    of_row = {name: rows[name][39] for name in of_signals}
    assert of_signals == pytest.approx(of_row, rel=1e-12, abs=1e-15)
    assert np.ptp(rows["silent_fraction"]) > 0
    assert not rows["diverged"].any()


def test_an_observer_in_python_is_refused() -> None:
    scenario = small("sampled", observer={"method": "particle_filter", "right": [0.1, 1.0]})
    with pytest.raises(InputError, match=r"observer\.method: this one computes in Python"):
        prepare_batch(vary(scenario, WIDTHS))


# --- Bits


@pytest.mark.parametrize("name", ["continuous", "sampled"])
def test_neither_blocks_nor_threads_nor_the_number_of_runs_change_a_bit(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch = prepare_batch(named(name))
    rows = batch.block(0)
    assert identical(batch.block(0, threads=1), rows)
    monkeypatch.setattr(lanes, "BUFFER", 1)
    assert identical(batch.block(0, threads=3), rows)
    few = np.array([149, 3, 77])
    values = np.vstack([batch.binding.draw_columns(k, 1, RUNS) for k in few])
    assert identical(batch.rows_of_runs(few, values), rows[few])
    many = prepare_batch(named(name, 4000))
    assert many.layout.number_of_blocks == 2
    assert identical(many.block(0)[:RUNS], rows)
    finer = many._replace(layout=many.layout._replace(block=100))
    across = finer.block(20)  # runs 2000 to 2099, of two blocks of 2048
    assert identical(across, np.vstack([many.block(0)[2000:], many.block(1)[:52]]))


def test_a_file_holds_the_same_bytes_whatever_computed_it(tmp_path: Path) -> None:
    scenario = named("sampled", 300)
    progress: list[int] = []
    result = run_ensemble(scenario, tmp_path / "one.npz", progress=progress.append)
    run_ensemble(scenario, tmp_path / "two.npz", workers=1)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.npz", "two.npz"]
    assert sum(progress) == 300
    in_memory = run_ensemble(scenario)
    parquet = run_ensemble(scenario, tmp_path / "runs.parquet")
    for other in (in_memory, parquet):
        for name in (*result.varied, *result.metrics):
            assert identical(result.column(name), other.column(name)), name
        assert result.bands is not None
        assert other.bands is not None
        for name, quantiles in result.bands.quantiles.items():
            assert identical(quantiles, other.bands.quantiles[name]), name
    assert result.info == in_memory.info == parquet.info


def test_bands_are_those_of_the_first_runs() -> None:
    batch = prepare_batch(named("sampled", 300))
    bands = compute_bands(batch, 5)
    runs = [replay_in_batch(batch, k) for k in range(5)]
    error = np.sort([np.abs(run.z[:, 0] - run.r[:, 0]) for run in runs], axis=0)
    expected = error[[0, 0, 2, 4, 4]].T
    np.testing.assert_allclose(bands.quantiles["tracking[0]"], expected, rtol=1e-13, atol=1e-15)
    assert bands.t.tolist() == runs[0].t.tolist()


def test_a_replay_tells_whether_it_meets_the_ensemble(tmp_path: Path) -> None:
    result = run_ensemble(named("continuous"), tmp_path / "runs.npz")
    assert replay_deviation(result, 3) == 0.0
    metric = np.array(result.metrics["rms_tracking"])
    metric[3] *= 1 + 1e-12
    bent = Ensemble(result.varied, result.metrics | {"rms_tracking": metric}, result.info)
    assert replay_deviation(bent, 3) == pytest.approx(1e-12, rel=1e-3)
    for act in (replay_run, replay_deviation):
        with pytest.raises(InputError, match="run 150: "):
            act(result, RUNS)


# --- What happens to runs


def test_runs_that_diverge_are_counted_and_left_out() -> None:
    unstable = {"plant.A[0,0]": {"uniform": [-3.0, 60.0]}}
    open_loop = small("sampled", controller={"method": "state_feedback", "K": [[0.0]]})
    result = run_ensemble(vary(open_loop, unstable))
    lost = result.diverged
    assert 0.3 < lost.mean() < 0.9
    assert result.varied["plant.A[0,0]"][lost].min() > result.varied["plant.A[0,0]"][~lost].max()
    mean = result.summary()["metrics"]["rms_tracking"]["mean"]
    assert np.isfinite(list(mean.values())).all()
    assert all(result.diverged[run] for run in result.worst())
    run = replay_run(result, result.worst()[0])
    assert run.divergence_time is not None


def test_without_entries_runs_differ_by_their_noise_alone() -> None:
    result = run_ensemble(vary(small("sampled"), {}, 20))
    assert result.varied == {}
    assert np.unique(result.metrics["rms_estimation"]).size == 20
    quiet = small("sampled", sensor={"noise": 0.0, "noise_before": 0.0})
    alike = run_ensemble(vary(quiet, {}, 20))
    assert np.ptp(alike.metrics["rms_tracking"]) == 0


def test_noise_that_is_nominally_absent_may_vary() -> None:
    quiet = small(
        "sampled",
        sensor={"noise": 0.0, "threshold": 0.3},
        observer={"method": "oracle", "L": [20.0]},
    )
    result = run_ensemble(vary(quiet, {"sensor.noise": {"uniform": [0.0, 0.1]}}))
    assert result.sensitivities("rms_estimation")["sensor.noise[0]"].spearman.value > 0.9


def test_settling_is_within_a_share_of_the_largest_reference() -> None:
    scenario = small(
        "sampled",
        sensor={"right": 0.1, "left": 0.1, "noise": 0.0, "noise_before": 0.0},
        simulation={"duration": 6.0, "step": 1e-2},
    )
    wide = run_ensemble(vary(scenario, {}, 1, tolerance=0.1))
    narrow = run_ensemble(vary(scenario, {}, 1, tolerance=1e-9))
    assert wide.settled.all()
    assert 0 < wide.metrics["settling_time"][0] < 6.0 - LAST
    assert not narrow.settled.any()


# --- The command


class Done(NamedTuple):
    code: int
    out: str
    err: str


Call = Callable[..., Done]


@pytest.fixture
def undeadzone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """The command, in this process."""

    def call(*arguments: str | int | Path) -> Done:
        monkeypatch.setattr(sys, "argv", ["undeadzone", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            main()
        return Done(left.value.code, *capsys.readouterr())

    return call


def with_little_room(room: int, *arguments: str | int | Path) -> Done:
    """The command in a process whose files can have `room` bytes."""
    code = (
        "import resource\n"
        "from undeadzone.cli import main\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))\n"
        "main()"
    )
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(to_toml(named("sampled")))
    return path


def test_the_command_prints_what_it_found_and_how_to_see_a_run(
    undeadzone: Call, study: Path, tmp_path: Path
) -> None:
    done = undeadzone("ensemble", study, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert max(map(len, done.out.split("\n")[:-2])) < 140
    lines = done.out.splitlines()
    assert lines[0].endswith("150 runs of 3 s, random sampling, seed 0")
    command = next(line for line in lines if line.startswith("see one")).split()
    assert command[2:4] == ["undeadzone", "run"]
    written = {
        "runs.npz",
        "distributions.svg",
        "over_time.svg",
        "tornado.svg",
        "influence.svg",
        "report.html",
    }
    assert {path.name for path in (tmp_path / "out").iterdir()} == written
    seen = undeadzone(*command[3:], "--json", "--no-figures")
    assert seen.code == 0, seen.err
    found, result = json.loads(seen.out), Ensemble.load(tmp_path / "out" / "runs.npz")
    assert found["replayed"] == {"run": int(command[-1]), "deviation": 0.0}
    assert found["rms_tracking"] == pytest.approx(result.metrics["rms_tracking"].max(), rel=1e-12)


def test_json_is_one_object_with_everything(undeadzone: Call, study: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--runs", 60, "--json", "--no-figures", "--parquet", "--out", out)
    done = undeadzone("ensemble", study, *words)
    assert (done.code, done.err) == (0, "")
    found = json.loads(done.out)
    result = Ensemble.load(out / "runs.parquet")
    assert found["files"] == [str(out / "runs.parquet")]
    assert found["runs"] == 60 == result.info.runs
    median = np.sort(result.metrics["rms_tracking"])[29]
    assert found["metrics"]["rms_tracking"]["median"]["value"] == median
    assert [row["run"] for row in found["worst"]] == result.worst()


def test_some_diverged_is_exit_code_1(undeadzone: Call, study: Path, tmp_path: Path) -> None:
    unstable = {"plant.A[0,0]": {"uniform": [-3.0, 300.0]}}
    study.write_text(to_toml(vary(small("sampled"), unstable, 100)))
    done = undeadzone("ensemble", study, "--no-figures", "--out", tmp_path / "out")
    assert done.code == 1, done.err
    assert "Left out below" in done.out


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("uniform", "triangular", ["triangular", "uniform"]),
        ("sensor.right", "sensor.rihgt", ["sensor.rihgt", "sensor.right"]),
        ("sensor.right", "plant.A[5,5]", ["plant.A[5,5]", "plant.A[0,0] to plant.A[1,1]"]),
        ("runs = 150", "runs = 0", ["ensemble.runs", "1 or more", "found 0"]),
        ("[ensemble]", "[ignored]", ["ignored"]),
    ],
)
def test_a_wrong_table_is_one_clear_line(
    undeadzone: Call, study: Path, tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    text = study.read_text()
    assert old in text
    text = text.replace(old, new, 1)
    if new == "[ignored]":
        text = text.replace("[ensemble.", "[ignored.")
    study.write_text(text)
    refused(undeadzone("ensemble", study, "--out", tmp_path / "out"), *words)
    assert not (tmp_path / "out" / "runs.npz.partial").exists()


def refused(done: Done, *words: str) -> None:
    assert done.code == 2
    assert done.out == ""
    assert done.err.count("\n") == 1, done.err
    for word in words:
        assert word in done.err


def test_wrong_use_is_one_clear_line(undeadzone: Call, study: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    refused(undeadzone("ensemble", study, "--runs", 0, "--out", out), "--runs", "0 is not in")
    refused(undeadzone("ensemble", study, "--out", study), "cannot write")
    refused(
        undeadzone("ensemble", study, "--workers", 2, "--cluster", "127.0.0.1:9", "--out", out),
        "found 2 and 127.0.0.1:9",
    )
    refused(undeadzone("run", study, "--replay", 3), "not an ensemble saved by undeadzone")
    plain = tmp_path / "plain.toml"
    plain.write_text(to_toml(small("sampled")))
    refused(
        undeadzone("ensemble", plain, "--out", out), "ensemble: missing. Add a table [ensemble]"
    )
    study.write_text(study.read_text().replace("sensor.right", "sensor.rihgt"))
    refused(undeadzone("run", study, "--no-figures"), 'ensemble."sensor.rihgt"')
    assert not out.exists() or not list(out.iterdir())


def test_a_full_disk_is_noticed_and_loses_nothing(
    undeadzone: Call, study: Path, tmp_path: Path
) -> None:
    out, size = tmp_path / "out", 8 * RUNS * len(prepare_batch(named("sampled")).layout.columns)
    refused(
        with_little_room(size, "ensemble", study, "--out", out),
        "runs.npz.partial: cannot write: File too large",
    )
    assert list(out.iterdir()) == []
    refused(
        with_little_room(size + 8192, "ensemble", study, "--out", out),
        "runs.npz: cannot write: ",
        "150 of 150 runs are kept",
        "--resume",
    )
    assert [path.name for path in out.iterdir()] == ["runs.npz.partial"]
    refused(undeadzone("ensemble", study, "--out", out), "Continue it with --resume, or delete it")
    refused(
        undeadzone("ensemble", study, "--out", out, "--resume", "--runs", 9),
        "holds another problem (runs: 150 there, 9 here",
    )
    assert undeadzone("ensemble", study, "--out", out, "--resume", "--no-figures").code == 0
    assert [path.name for path in out.iterdir()] == ["runs.npz"]


# --- Interrupted

INTERRUPTIBLE = """
import sys
from undeadzone_studies.ensemble.run_ensemble import run_ensemble
from undeadzone.scenario.reader import read

def say(done):
    print(done, flush=True)

try:
    run_ensemble(read(sys.argv[1]), sys.argv[2], resume=True, progress=say)
except KeyboardInterrupt as error:
    print(error)
"""


def interrupted(study: Path, path: Path, blocks: int, how: signal.Signals) -> str:
    """What an ensemble that gets a signal after so many reports of progress says."""
    command = [sys.executable, "-c", INTERRUPTIBLE, str(study), str(path)]
    # Not ignored, even if this process runs in the background: Python looks when it starts.
    restore_sigint = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, preexec_fn=restore_sigint
    ) as running:
        assert running.stdout is not None
        for _ in range(blocks):
            running.stdout.readline()
        os.kill(running.pid, how)
        return running.communicate()[0]


def test_killed_again_and_again_it_ends_with_the_same_bytes(study: Path, tmp_path: Path) -> None:
    scenario = named("continuous", 8 * 2048 + 5)
    study.write_text(to_toml(scenario))
    run_ensemble(scenario, tmp_path / "whole.npz")
    path = tmp_path / "runs.npz"
    interrupted(study, path, 2, signal.SIGKILL)
    interrupted(study, path, 3, signal.SIGKILL)
    assert not path.exists()
    output = interrupted(study, path, 1, signal.SIGINT)
    assert f"runs are kept in {path}.partial; continue with resume=True" in output
    run_ensemble(scenario, path, resume=True)
    assert path.read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert not path.with_name("runs.npz.partial").exists()


def test_resume_leaves_a_finished_file_as_it_is(tmp_path: Path) -> None:
    path, progress = tmp_path / "runs.npz", list[int]()
    first = run_ensemble(named("sampled"), path, resume=True)
    again = run_ensemble(named("sampled"), path, resume=True, progress=progress.append)
    assert again.info == first.info
    assert progress == []
    before = path.read_bytes()
    words = (
        r"holds another problem \(runs: 150 there, 151 here.*; leave resume=True out to replace it"
    )
    with pytest.raises(InputError, match=words):
        run_ensemble(named("sampled", 151), path, resume=True, progress=progress.append)
    assert path.read_bytes() == before
    path.write_bytes(before[:-100])
    run_ensemble(named("sampled", 151), path, resume=True, progress=progress.append)
    assert progress == [151]
