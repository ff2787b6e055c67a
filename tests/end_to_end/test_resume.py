"""Tuning and the arena go on where something stopped them; kill -9 changes nothing."""

from __future__ import annotations

import functools
import json
import multiprocessing
import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from tests.scenes import scene

import commands
from commands import Done, undeadzone
from records import dead_zone
from traps import refuse_link
from undeadzone.errors import FileError, InputError, Terminated
from undeadzone.scenario.reader import digests
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Range, Tune
from undeadzone.util.answers import Answers
from undeadzone.util.own_files import write_own_file
from undeadzone_arena.contest.contest import run_contest
from undeadzone_identify import pipeline
from undeadzone_identify.pipeline import identify
from undeadzone_identify.selection.widths import profile_likelihood
from undeadzone_studies.tuning.tune import tune

PROBLEM = {"a": 1}
FORK = multiprocessing.get_context("fork")


def squares(
    path: Path, resume: bool = True, computed: list[int] | None = None, stop: int | None = None
) -> list[Any]:
    """The squares of 0 to 9; told: those computed; stop: where SIGTERM comes."""

    def compute(missing: list[int]) -> Iterator[tuple[int, int]]:
        for k in missing:
            if k == stop:
                raise Terminated
            if computed is not None:
                computed.append(k)
            yield k, k * k

    answers = Answers(path, PROBLEM, "squares", resume)
    with answers.hold_file():
        return answers.compute_missing(list(range(10)), compute)


# --- The file


def test_stored_results_are_not_computed_again(tmp_path: Path) -> None:
    path, computed = tmp_path / "kept", list[int]()
    words = f"5 squares are kept in {path}; continue with resume=True"
    with pytest.raises(Terminated, match=words):
        squares(path, computed=computed, stop=5)
    assert squares(path, computed=computed) == [k * k for k in range(10)]
    assert computed == list(range(10))


@pytest.mark.parametrize("link", ["symlink_to", "hardlink_to"])
def test_nothing_is_written_through_links(tmp_path: Path, link: str) -> None:
    refuse_link(tmp_path / "kept", link, squares)


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_file_gives_right_answers_or_none(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("kept") / "kept"
    squares(path)
    content = bytearray(path.read_bytes())
    first = content.index(b"\n")
    place = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        del content[place:]
    else:
        content[place] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        answers = [squares(path), squares(path)]
    except FileError:
        assert place <= first
        return
    assert answers == [[k * k for k in range(10)]] * 2


def test_what_cannot_be_continued_is_refused(tmp_path: Path, monkeypatch: Any) -> None:
    path = tmp_path / "kept"
    squares(path)
    with pytest.raises(
        FileError, match=r"squares of a stopped run are there\. Continue it with resume=True"
    ):
        squares(path, resume=False)
    with pytest.raises(InputError, match=r"holds another problem \(a: 1 there, 2 here\)"):
        Answers(path, {"a": 2}, "squares", True)
    monkeypatch.setattr("undeadzone.util.answers.package_versions", lambda: {"numpy": "1.0"})
    with pytest.raises(InputError, match="numpy"):
        squares(path)
    path.write_text('{"somebody": "else"}\n')
    with pytest.raises(FileError, match="Choose another name or delete it"):
        squares(path)
    assert path.read_text() == '{"somebody": "else"}\n'


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    first = Answers(tmp_path / "kept", PROBLEM, "squares")
    with first.hold_file():
        with pytest.raises(FileError, match="another process is writing it"):
            squares(tmp_path / "kept")
        (tmp_path / "kept").unlink()
        with pytest.raises(FileError, match="it was removed"):
            first.compute_missing([1], lambda missing: iter([(0, 1)]))


def test_a_stop_before_the_first_result_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(Terminated):
        squares(tmp_path / "kept", stop=0)
    assert list(tmp_path.iterdir()) == []


def test_files_that_a_scenario_names_count(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("0,0\n1,1\n")
    named = scene(reference={"kind": "csv", "path": str(path)})
    before = digests(named)
    path.write_text("0,0\n1,2\n")
    assert list(before) == ["reference.path"]
    assert digests(named) != before


# --- Killed


def killed(work: Callable[[], object], path: Path, rng: random.Random) -> None:
    """Kill a process that works, once it has kept something, at any instant."""
    process = FORK.Process(target=work)
    process.start()
    before = path.stat().st_size if path.exists() else 0
    while process.is_alive() and not (path.exists() and path.stat().st_size > before + 100):
        time.sleep(0.002)
    time.sleep(rng.uniform(0, 0.05))
    process.kill()
    process.join()


@pytest.mark.parametrize("was_there", [True, False])
def test_what_is_stopped_before_its_first_answer_leaves_nothing(
    was_there: bool, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    if was_there:
        folder.mkdir()
    answers = Answers(folder / "some.partial", {}, "answers")
    with pytest.raises(KeyboardInterrupt), answers.hold_file():
        raise KeyboardInterrupt
    assert list(tmp_path.rglob("*")) == [folder] * was_there


def small() -> Scenario:
    return scene("""
        sensor = { noise = 0.01 }
        simulation = { time = "sampled", step = 0.01, duration = 0.5 }
        observer = { method = "certified", L = [1.0, 1.5], gamma = 10.0 }
        """)


def tuned(keep: Path | None) -> dict[str, Any]:
    """What tuning two numbers finds."""
    between = Range(between=(0.1, 100.0), log=True)
    entries = {"observer.gamma": between, "controller.alpha": between}
    what = Tune(entries=entries, runs=2, held_out=2, budget=20)
    return tune(small(), what, keep=keep, resume=True, threads=1).summary()


def test_a_search_that_is_killed_again_and_again_finds_the_same(tmp_path: Path) -> None:
    whole, path, rng = tuned(None), tmp_path / "tuned.toml.partial", random.Random(3)
    for _ in range(3):
        killed(functools.partial(tuned, path), path, rng)
    assert path.exists()
    assert json.dumps(tuned(path)) == json.dumps(whole)


def contest(keep: Path | None) -> list[dict[str, Any]]:
    """The results of a contest but for seconds."""
    methods = ["certified", "kalman", "printed", "adaptive_inverse"]
    result = run_contest(methods, {"mine": small()}, [0, 1], {}, 1, keep=keep, resume=True)
    return [{**row, "cost": 0.0} for row in result.summary()["results"]]


def test_a_contest_that_is_killed_again_and_again_ends_the_same(tmp_path: Path) -> None:
    whole, path, rng = contest(None), tmp_path / "results.json.partial", random.Random(4)
    for _ in range(3):
        killed(functools.partial(contest, path), path, rng)
    assert contest(path) == whole


def logged() -> dict[str, np.ndarray | float]:
    """A log of a first-order plant behind a dead zone."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(50), 10)
    z = lfilter([0.0, 0.2], [1.0, -0.8], u) + 0.05 * rng.standard_normal(u.size)
    return {"t": 0.1, "u": u, "y": dead_zone(z, 0.3, 0.2)}


def identified(keep: Path | None) -> str:
    """All numbers that a log gives."""
    found = identify(**logged(), order="1-2", keep=keep, resume=True)
    return json.dumps(found.numbers())


def test_an_identification_that_is_killed_again_and_again_finds_the_same(tmp_path: Path) -> None:
    whole, path, rng = identified(None), tmp_path / "identify.json.partial", random.Random(5)
    sizes = []
    for _ in range(4):
        killed(functools.partial(identified, path), path, rng)
        sizes.append(path.stat().st_size)
    assert sizes == sorted(set(sizes))  # each goes on where the one before was killed
    assert identified(path) == whole
    size_before = path.stat().st_size
    assert identified(path) == whole
    assert path.stat().st_size == size_before  # nothing was climbed to again


def test_a_later_profile_of_a_stored_answer_is_computed(tmp_path: Path) -> None:
    path = tmp_path / "identify.json.partial"
    found = identify(**logged(), order=1, keep=path)
    fall = profile_likelihood(found.answer.fit, "right", np.array([found.answer.fit.right + 0.02]))
    assert fall[0] < 0
    again = identify(**logged(), order=1)
    assert fall == profile_likelihood(
        again.answer.fit, "right", np.array([again.answer.fit.right + 0.02])
    )


def test_a_log_that_is_refused_keeps_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, log = tmp_path / "identify.json.partial", logged()
    with pytest.raises(InputError, match="no reading lies beyond"):
        identify(**log | {"y": np.maximum(log["y"], 0.0)}, integrators=1, keep=path)
    assert not path.exists()
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "_identify_logs", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            identify(**log, keep=path)
    assert not path.exists(), "what fails once would fail again"
    identify(**log, order=1, keep=path)
    with pytest.raises(FileError, match="Continue it with resume=True"):
        identify(**log, order=1, keep=path)
    with pytest.raises(InputError, match=r"another problem \(options.order: 1 there, 2 here"):
        identify(**log, order=2, keep=path, resume=True)


# --- The command

COMMAND = [*commands.COMMAND, "arena"]
METHODS = "luenberger,high_gain,certified,super_twisting"


def arena(scenario: Path, out: Path, *more: str) -> Done:
    """The command, to its end."""
    return undeadzone("arena", scenario, "--methods", METHODS, "--out", out, *more)


def test_a_refused_log_leaves_no_folder(tmp_path: Path) -> None:
    """An empty one stayed behind; what someone made stays."""
    (tmp_path / "short.csv").write_text("t,y,u\n0,1,2\n")
    (tmp_path / "mine").mkdir()
    for options in ([], ["--out", "mine"]):
        assert undeadzone("identify", "short.csv", *options, cwd=tmp_path).returncode == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "short.csv"]


def stopped(how: int, partial: Path, command: list[str], cwd: Path) -> tuple[int, str]:
    """Exit code and messages of a command that is stopped once it has kept something."""
    with subprocess.Popen(
        command, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=restore_signals,
    ) as process:  # fmt: skip
        while process.poll() is None and not (partial.exists() and _answers(partial) >= 1):
            time.sleep(0.002)
        process.send_signal(how)
        _, output = process.communicate(timeout=60)
        return process.returncode, output


def _answers(partial: Path) -> int:
    """How many lines follow the first one."""
    return partial.read_bytes().count(b"\n") - 1


def restore_signals() -> None:
    """A background job ignores SIGINT unless it is told otherwise."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    return small().save(tmp_path / "mine.toml")


def test_arena_tune_is_killed_and_goes_on(mine: Path, tmp_path: Path) -> None:
    """Kill -9 leaves the file with what is done, and --resume ends as if nothing had happened."""
    tuning = ("--tune", "--budget", "4", "--processes", "1")
    whole = arena(mine, tmp_path / "whole", *tuning)
    assert whole.returncode == 0, whole.stderr
    assert "3 methods x 1 scenario x 4 candidates = 12 runs" in whole.stderr
    out = tmp_path / "killed"
    command = [*COMMAND, str(mine), "--methods", METHODS, "--out", str(out), *tuning]
    code, _ = stopped(signal.SIGKILL, out / "tuned.toml.partial", command, tmp_path)
    assert code == -signal.SIGKILL
    assert not (out / "tuned.toml").exists()
    refused = arena(mine, out, *tuning)
    assert refused.returncode == 2
    assert "--resume" in refused.stderr
    resumed = arena(mine, out, *tuning, "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert (out / "tuned.toml").read_text() == (tmp_path / "whole/tuned.toml").read_text()
    assert not (out / "tuned.toml.partial").exists()


@pytest.mark.parametrize(
    ("command", "name"), [("tune", "tuned.toml"), ("identify", "identify.json")]
)
def test_what_is_finished_is_not_replaced_by_resuming_it(
    command: str, name: str, tmp_path: Path
) -> None:
    """It was searched for anew, and the file replaced."""
    scenario, log, folder = tmp_path / "a.toml", tmp_path / "a.csv", tmp_path / "mine"
    assert undeadzone("init", str(scenario)).returncode == 0
    named = logged()
    np.savetxt(
        log, np.column_stack([named["t"] * np.arange(len(named["u"])), named["u"], named["y"]]),
        delimiter=",", header="t,u,y", comments="",
    )  # fmt: skip
    folder.mkdir()
    finished = folder / name
    write_own_file("{}\n", finished)
    before = finished.read_bytes()
    given = scenario if command == "tune" else log
    refused = undeadzone(command, str(given), "--out", str(folder), "--resume")
    assert refused.returncode == 2
    assert f"{finished}: is finished. Leave --resume out to replace it" in refused.stderr
    assert finished.read_bytes() == before


@pytest.mark.parametrize("command", ["tune", "ensemble", "arena"])
def test_a_resume_that_finds_nothing_says_so(command: str, mine: Path, tmp_path: Path) -> None:
    """It began anew without a word, though the folder that was meant may be another one."""
    mine.write_text(mine.read_text() + '\n[ensemble]\n"sensor.right" = { uniform = [0.5, 1.5] }\n')
    more = {
        "tune": ["--over", "observer.gamma=1:20", "--runs", "2", "--budget", "4", "--no-figures"],
        "ensemble": ["--runs", "2", "--no-figures"],
        "arena": ["--methods", METHODS.split(",")[0], "--seeds", "1", "--processes", "1"],
    }
    done = undeadzone(command, mine, "--out", tmp_path / "other", "--resume", *more[command])
    assert done.returncode in (0, 1), done.stderr
    assert f"--resume: there is no {tmp_path / 'other'}" in done.stderr
    assert "Begins anew" in done.stderr


def test_arena_stores_finished_runs_by_default(mine: Path, tmp_path: Path) -> None:
    command = [*COMMAND, str(mine), "--methods", METHODS, "--seeds", "6"]
    partial = tmp_path / "arena-results/results.json.partial"
    code, output = stopped(signal.SIGINT, partial, command, tmp_path)
    assert code == 130, output
    assert "6 methods x 1 scenario x 6 seeds = 36 runs; less than a minute" in output
    assert "continue with --resume" in output
    done = undeadzone(*command[len(COMMAND) - 1 :], "--resume", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "high_gain" in done.stdout
    assert not partial.parent.exists()
