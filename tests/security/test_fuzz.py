"""A short run of the fuzzers, always the same inputs; and what they found stays mended."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator

import pytest
from tests.scenes import tables_of
from tools.fuzz.__main__ import NAMES, maker
from tools.fuzz.case import Case, End, stream
from tools.fuzz.isolated import results
from tools.fuzz.judge import complaint
from tools.fuzz.perform import perform
from tools.fuzz.scenarios import text

CASES = {
    "formulas": 150,
    "designs": 60,
    "journals": 15,
    "options": 15,
    "scenarios": 400,
    "commands": 20,
    "streams": 15,
    "splits": 5,
    "identify_logs": 12,
    "arms": 120,
    "folders": 8,
    "engines": 4,
    "number_formats": 300,
    "pipes": 3,
    "entry_points": 4,
    "arguments": 8,
    "exports": 1,
}


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    """Leave the signals of this process as they were."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def test_every_fuzzer_has_its_share() -> None:
    assert list(CASES) == list(NAMES)


@pytest.mark.parametrize("name", CASES)
def test_inputs_lead_to_results_or_to_one_line(name: str) -> None:
    make = maker(name)
    wrong = {}
    for index in range(CASES[name]):
        case = make(stream(name, 7, index))
        end = perform(case)
        if complaint(case, end):
            wrong[index] = complaint(case, end), end.err[-500:]
    assert not wrong


@pytest.mark.parametrize("name", CASES)
def test_an_input_is_the_same_again(name: str) -> None:
    make = maker(name)
    one, two = make(stream(name, 7, 3)), make(stream(name, 7, 3))
    assert one.files == two.files
    assert one.command == two.command
    assert one.stdin == two.stdin


COMMAND = Case("", {}, ["run", "mine.toml"])


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (End(0, "rms z - r  0.1\n", ""), ""),
        (End(1, "diverges at 3 s\n", ""), ""),
        (End(2, "", "undeadzone: plant.A: wrong\n"), ""),
        (End(2, "", "undeadzone: plant.A: wrong\nmore\n"), "a refusal of 2 lines"),
        (End(2, "", ""), "a refusal of 0 lines"),
        (End(70, "", "undeadzone: internal error"), "exit code 70"),
        (End(0, "rms z - r  nan\n", ""), "success with NaN"),
        (End(0, "rms z - r  1\x1b[2J\n", ""), "control characters"),
        (End(0, "", "RuntimeWarning: overflow\n"), "a traceback or a warning"),
        (End(0, "", "", "from C\n"), "a library wrote past Python"),
    ],
)
def test_the_judge_sees_what_is_wrong(end: End, words: str) -> None:
    assert complaint(COMMAND, end) == words


def test_json_is_judged_as_json() -> None:
    case = COMMAND._replace(command=["run", "mine.toml", "--json"])
    assert complaint(case, End(0, '{"a": null}\n', "")) == ""
    assert complaint(case, End(0, '{"a": NaN}\n', "")) == "no JSON"
    assert complaint(case, End(0, "words\n", "")) == "no JSON"


def test_a_case_that_kills_its_process_is_a_result_and_the_next_one_runs() -> None:
    def deadly(draw: object) -> Case:
        return Case("deadly", {}, call=lambda folder: os.kill(os.getpid(), signal.SIGKILL))

    until = time.monotonic() + 0.2
    every = list(results("deadly", deadly, 0, 0, until))
    assert [result.index for result in every] == list(range(len(every)))
    assert all(result.complaint == "died: status or signal 9" for result in every)


# --- What they found


def test_a_run_that_diverges_at_once_is_not_exported() -> None:
    tables = tables_of("""
        plant = { integrators = 2 }
        sensor = { right = 0.85, left = 0.63, noise = 0.01 }
        reference = { kind = "sine", amplitude = 2.1, frequency = 1.0 }
        observer = { method = "kalman", right = [0.1, 1.0] }
        controller = { method = "rbf_feedback", reach = 3.0, centres = 3, speed = 4.6e18 }
        simulation = { duration = 2.4, step = 0.02, time = "sampled" }
        """)
    case = Case("", {"mine.toml": text(tables)}, ["export", "mine.toml", "--out", "out"])
    end = perform(case)
    assert end.code == 2, end.err
    assert "the run leaves +-1e+06 at its first sample" in end.err


@pytest.mark.parametrize("column", ["y", "u"])
def test_a_column_whose_squares_vanish_identifies_nothing(column: str) -> None:
    scale = {"y": 1.0, "u": 1.0} | {column: 1e-200}
    rows = [f"{0.02 * k:.2f},{scale['y'] * (k % 7 - 3)},{scale['u'] * (k % 5)}" for k in range(150)]
    log = "\n".join(["t,y,u", *rows]).encode()
    case = Case("", {"log.csv": log}, ["identify", "log.csv", "--no-figures", "--out", "out"])
    end = perform(case)
    assert end.code == 2, end.err
    assert "vanish once squared. Use another unit" in end.err


def test_what_is_printed_past_python_is_seen() -> None:
    case = Case("loud", {}, call=lambda folder: os.write(1, b"loud"))
    assert perform(case).native == "loud"
    sys.stdout.flush()
