"""A log that comes in live: wrong lines end nothing, pieces change nothing, states go on."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_hostile_files import COMMAND
from tests.live import KALMAN, STEP, WRONG_LINES, Watched, fed, line, regular, stream

from commands import forked
from documents import ROOT
from undeadzone.cli.common import SCHEMA
from undeadzone.errors import FileError
from undeadzone.logs.clock import Clock
from undeadzone.logs.samples import KINDS, Samples
from undeadzone.simulation.saved_state import load, save


@pytest.fixture(scope="module")
def lever(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("live") / "lever.toml"
    path.write_text(KALMAN)
    return path


def watch(*arguments: object, stdin: bytes) -> subprocess.CompletedProcess[bytes]:
    return forked("watch", *arguments, stdin=stdin)


@pytest.mark.parametrize("option", ["--heartbeat", "--every"])
def test_a_time_that_is_no_number_is_refused(option: str, lever: Path) -> None:
    """Of nan seconds a heartbeat said 83,000 lines a second."""
    done = watch(lever, option, "nan", stdin=b"")
    assert (done.returncode, done.stdout) == (2, b"")
    assert b"nan is not a time" in done.stderr


# --- What a line is


def placed(times: list[float], size: int = 10**6) -> tuple[Clock, list[tuple[bool, list[float]]]]:
    """The pieces that lines give that come so many at once."""
    clock = Clock(STEP, "log", strict=False)
    pieces = []
    for start in range(0, len(times) + size, size):
        t = np.array(times[start : start + size])
        lines = np.arange(start + 1, start + 1 + t.size)
        last = start >= len(times)
        for begins, part in clock.place_samples(
            Samples(t, t[:, None], t[:, None], lines), [], True, last
        ):
            pieces.append((begins, part.t.round(9).tolist()))
    return clock, pieces


@pytest.mark.parametrize("size", [1, 2, 3, 1000])
@pytest.mark.parametrize(
    ("wrong", "then", "faults"),
    [
        ([0.1], 0.2, {"time": 1}),  # one line back
        ([1e12], 0.2, {"time": 1}),
        ([0.15], 0.2, {"time": 1}),  # it would be a gap, were it not for the line after it
        ([0.195], 0.2, {"time": 1}),
        ([1e12, -3.0], 0.2, {"time": 2}),
        ([], 0.25, {}),  # a gap
        ([], 0.0, {"jump": 1}),  # the device starts again
        ([], 3600.0, {"jump": 1}),  # further than a gap may be
        ([], 0.205, {"jump": 1}),
        ([1e12], 0.0, {"time": 1, "jump": 1}),
        ([float("nan")], 0.2, {"no_time": 1}),
    ],
)
def test_a_time_is_judged_by_its_neighbours(
    size: int, wrong: list[float], then: float, faults: dict[str, int]
) -> None:
    wrong = [0.2 + t if t == 0.15 else t for t in wrong]
    clock, pieces = placed([*regular(20), *wrong, *regular(20, then)], size)
    assert clock.faults.by_kind == faults
    times = np.concatenate([t for _, t in pieces])
    begun = [t[0] for begins, t in pieces if begins]
    assert begun == ([then] if "jump" in faults else [])
    if begun:
        np.testing.assert_allclose(times, [*regular(20), *regular(20, then)])
    else:
        np.testing.assert_allclose(times, regular(times.size))
        assert times[-1] == pytest.approx(then + 19 * STEP)
        assert clock.gaps == times.size - 40


def test_only_a_line_behind_a_gap_waits() -> None:
    clock = Clock(STEP, "log", strict=False)
    answered = []
    for k, t in enumerate([0.0, 0.01, 0.02, 0.05, 0.06, 0.07]):
        at = np.array([t])
        rows = Samples(at, at[:, None], at[:, None], np.array([k]))
        answered.append(
            sum(len(piece.samples.t) for piece in clock.place_samples(rows, [], True, False))
        )
    assert answered == [1, 1, 1, 0, 4, 1]


def test_another_step_is_refused_after_21_lines(lever: Path) -> None:
    times = [2 * t for t in regular(50)]
    for cuts in ([], list(range(500))):
        _, message = fed(lever, stream(times), cuts)
        assert "0.02 s apart" in message
    with pytest.raises(FileError, match=r"t \[ms\]"):
        placed([1000 * t for t in regular(5)])
    out, message = fed(lever, stream([1.05 * t for t in regular(1500)]), [])
    assert "0.0105 s apart" in message
    assert out


def test_lines_that_are_no_text_are_counted(lever: Path) -> None:
    lines = [line(t) for t in regular(40)]
    lines[10] = b"\0\0\0\n"
    lines[20] = b"9" * 200_000 + b"\n"
    lines[21] = b"0.21,1\n"
    lines[30] = b"0.3,1,1e400\n"
    lines[31] = b",1,2\n"
    done = watch("--json", lever, stdin=b"t,y,u\n" + b"".join(lines))
    assert done.returncode == 0, done.stderr
    ended = json.loads(done.stderr)
    kinds = {"zero_bytes": 1, "too_long": 1, "values": 1, "number": 1, "no_time": 1}
    assert ended["faults"] == kinds
    assert ended["unreadable"] == 5
    assert ended["schema"] == SCHEMA
    assert [json.loads(row)["t"] for row in done.stdout.splitlines()] == pytest.approx(regular(40))


def test_strict_ends_at_the_first_fault_and_answers_what_was_good(lever: Path) -> None:
    data = stream([*regular(20), 0.1, *regular(20, 0.2)])
    done = watch("--strict", lever, stdin=data)
    assert done.returncode == 2
    assert done.stderr.startswith(b"undeadzone: stdin, line 22: t = 0.1 s fits neither")
    assert len(done.stdout.splitlines()) == 21
    jump = watch("--strict", lever, stdin=stream(regular(20) + regular(20)))
    assert jump.returncode == 2
    assert b"time goes on from there" in jump.stderr


def test_after_a_jump_the_observer_is_as_new(lever: Path) -> None:
    jumped, message = fed(lever, stream(regular(100, 7.0) + regular(100)), [])
    assert "'jump': 1" in message
    before, _ = fed(lever, stream(regular(100, 7.0)), [])
    after, _ = fed(lever, stream(regular(100)), [])
    assert jumped == before + after


# --- Pieces of the bytes

FAULTS = st.sampled_from(WRONG_LINES)


@settings(max_examples=8)
@given(
    where=st.lists(st.tuples(st.integers(0, 80), FAULTS, st.booleans()), max_size=12),
    seed=st.integers(0, 10**6),
    strict=st.booleans(),
)
def test_the_same_comes_out_in_whatever_pieces_the_bytes_come(
    lever: Path, where: list[tuple[int, bytes, bool]], seed: int, strict: bool
) -> None:
    lines = [line(t) for t in regular(80)]
    for k, fault, replaces in sorted(where, reverse=True):
        lines[k : k + replaces] = [fault]
    data = b"t,y,u\n" + b"".join(lines)
    draw = random.Random(seed)
    whole = fed(lever, data, [], strict)
    cuts = [draw.randrange(len(data)) for _ in range(draw.choice((3, 60)))]
    assert fed(lever, data, cuts, strict) == whole
    if len(data) < 5000:
        assert fed(lever, data, list(range(len(data))), strict) == whole


def test_utf_16_byte_by_byte(lever: Path) -> None:
    data = stream(regular(10)).decode().encode("utf-16")
    assert fed(lever, data, list(range(len(data)))) == fed(lever, data, [])


# --- A state that is kept


@pytest.mark.parametrize("at", [1, 30, 77])
def test_a_state_goes_on_to_the_last_bit(lever: Path, tmp_path: Path, at: int) -> None:
    times = [*regular(50), 0.2, *regular(50, 0.5), *regular(50)]
    whole = Watched(lever)
    whole.feed(stream(times))
    first = Watched(lever)
    first.feed(stream(times[:at]))
    save(tmp_path / "state", first.parts, first.follower.digest)
    answered = first.out.getvalue()
    second = Watched(lever)
    load(tmp_path / "state", second.parts, second.follower.digest)
    second.follower.go_on()
    second.feed(stream(times[at:]))
    out, message = second.ended()
    expected, words = whole.ended()
    assert answered + out == expected
    counts = message.replace(f"line {52 - at}", "line 52")  # they are counted anew
    assert counts.partition("samples=")[2] == words.partition("samples=")[2]


def test_a_state_keeps_the_day_of_times_without_a_date(lever: Path, tmp_path: Path) -> None:
    head, *lines = stream(regular(30)).splitlines(keepends=True)
    clocks = [f"23:59:59.{90 + k}" if k < 10 else f"00:00:00.{k - 10:02}" for k in range(30)]
    days = [
        clock.encode() + line[line.index(b",") :] for clock, line in zip(clocks, lines, strict=True)
    ]
    whole, first, second = Watched(lever), Watched(lever), Watched(lever)
    whole.feed(b"".join([head, *days]))
    first.feed(b"".join([head, *days[:10]]))
    save(tmp_path / "state", first.parts, first.follower.digest)
    load(tmp_path / "state", second.parts, second.follower.digest)
    second.follower.go_on()
    second.feed(b"".join([head, *days[10:]]))
    assert first.out.getvalue() + second.ended()[0] == whole.ended()[0]


@pytest.mark.parametrize("away", [(1, -1), (0, 1000), (0, -0.7)])  # swapped pairs, two loggers
def test_times_to_and_fro_end_no_watch(
    lever: Path, tmp_path: Path, away: tuple[float, float]
) -> None:
    times, state = regular(200), tmp_path / "state"
    wrong = [times[k] + (times[1] - times[0]) * away[k % 2] for k in range(200)]
    done = watch(lever, "--state", state, stdin=stream([*times[:50], *wrong, *times]))
    assert done.returncode < 2
    assert done.stdout.count(b"\n") > 200
    assert state.exists()


def test_a_byte_turned_in_a_state_changes_no_number(lever: Path, tmp_path: Path) -> None:
    whole, path, rng = Watched(lever), tmp_path / "state", np.random.default_rng(81)
    whole.feed(stream(regular(60)))
    save(path, whole.parts, whole.follower.digest)
    good = path.read_bytes()
    kept, refused = np.array(whole.follower._online.state), 0
    for at, bit in rng.integers(0, (len(good), 8), (100, 2)):
        turned = bytearray(good)
        turned[at] ^= 1 << bit
        path.write_bytes(turned)
        try:
            whole.follower._online.state = 0 * kept
            load(path, whole.parts, whole.follower.digest)
        except FileError:
            refused += 1
        else:
            assert np.array_equal(whole.follower._online.state, kept)
    assert refused > 50


def test_a_state_of_something_else_is_refused(lever: Path, tmp_path: Path) -> None:
    state = tmp_path / "state"
    done = watch(lever, "--state", state, stdin=stream(regular(30)))
    assert done.returncode == 0
    assert watch(lever, "--state", state, stdin=b"").returncode == 0
    other = tmp_path / "other.toml"
    other.write_text(KALMAN.replace("[0.0, 2.0]", "[0.0, 3.0]"))
    good = state.read_bytes()
    for path, content, words in (
        (other, good, b"the state of another observer"),
        (lever, good[:-40], b"no state saved by undeadzone"),
        (lever, b"", b"no state saved by undeadzone"),
        (lever, good.replace(b"clock.last", b"clock.tsal"), b"no state saved by undeadzone"),
    ):
        state.write_bytes(content)
        refused = watch(path, "--state", state, stdin=stream(regular(30)))
        assert refused.returncode == 2
        assert words in refused.stderr
        assert len(refused.stderr.splitlines()) == 1
        assert state.read_bytes() == content
    state.unlink()
    arrays = {"digest": np.array(["x", {}], dtype=object)}
    np.savez(tmp_path / "pickled.npz", allow_pickle=True, **arrays)
    os.rename(tmp_path / "pickled.npz", state)
    assert b"no state saved" in watch(lever, "--state", state, stdin=b"").stderr


def test_kill_9_loses_no_more_than_what_was_not_saved(lever: Path, tmp_path: Path) -> None:
    """Killed at any instant, three times; the rest goes on from samples that were answered."""
    state, rng, start, lost = tmp_path / "state", random.Random(3), 0, []
    lines = [line(t) for t in regular(4000)]
    for _ in range(3):
        command = [*COMMAND, "watch", str(lever), "--state", str(state), "--every", "0.05"]
        out = tmp_path / f"{start}.csv"
        with (
            open(out, "wb") as answers,
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=answers, stderr=subprocess.DEVNULL
            ) as running,
        ):
            assert running.stdin is not None
            running.stdin.write(b"t,y,u\n" + lines[start])
            running.stdin.flush()
            end, until = start + 1, None
            before = state.stat().st_mtime_ns if start else 0
            while until is None or time.monotonic() < until:
                running.stdin.write(lines[end])
                running.stdin.flush()
                end += 1
                if until is None and state.exists() and state.stat().st_mtime_ns > before:
                    until = time.monotonic() + rng.uniform(0, 0.3)
                time.sleep(0.002)
            running.kill()
        answered = out.read_bytes().splitlines()
        watched = Watched(lever)
        load(state, watched.parts, watched.follower.digest)
        saved = round(watched.log.clock.last / STEP) + 1
        assert start < saved <= end
        assert saved >= round(float(answered[-1].split(b",")[0]) / STEP) + 1 - 200
        lost += list(range(saved, end))
        start = end
    rest = lines[start : start + 100]
    done = watch(lever, "--state", state, stdin=b"t,y,u\n" + b"".join(rest))
    gone = set(lost)
    rows_left = [row for k, row in enumerate(lines[: start + 100]) if k not in gone]
    whole = watch(lever, stdin=b"t,y,u\n" + b"".join(rows_left))
    assert done.stdout.splitlines()[-100:] == whole.stdout.splitlines()[-100:]
    table = [[row for row in stderr.splitlines() if b"apart" not in row]
             for stderr in (done.stderr, whole.stderr)]  # fmt: skip
    assert table[0] == table[1]


@pytest.mark.parametrize("keeps", [True, False])
@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stopped_watch_keeps_all_and_prints_what_it_has(
    lever: Path, tmp_path: Path, stop: int, code: int, keeps: bool
) -> None:
    state = tmp_path / "state"
    options = ["--state", str(state)] if keeps else []
    with subprocess.Popen(
        [*COMMAND, "watch", str(lever), *options, "--heartbeat", "0.1"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as running:
        assert running.stdin is not None
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdin.write(stream(regular(40)))
        running.stdin.flush()
        for _ in range(41):
            running.stdout.readline()
        while b" 40 samples, 0 faults, 0 s" in (beat := running.stderr.readline()):
            pass  # it beats without samples, too
        assert beat.startswith(b"alive: ")
        running.send_signal(stop)
        _, printed = running.communicate(timeout=60)
    assert running.returncode == code
    assert b"40 samples, 0 missing" in printed
    assert b"consistent" in printed
    assert printed.splitlines()[-1].startswith(b"undeadzone: ")
    if keeps:
        watched = Watched(lever)
        load(state, watched.parts, watched.follower.digest)
        assert watched.follower.samples == 40


MIDWAY = """
import signal
import sys

from undeadzone.cli import main
from undeadzone.simulation.follower import Follower

count = Follower._count


def stopped(self, *arguments):
    if self.samples <= 20 < self.samples + len(arguments[0].y):
        signal.raise_signal(STOP)
    return count(self, *arguments)


Follower._count = stopped
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup a process inherits SIG_IGN
main()
"""


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_within_a_sample_loses_nothing(lever: Path, tmp_path: Path, stop: int) -> None:
    """It comes after the observer's step, before the sample is counted: the sample ends first."""
    state = tmp_path / "state"
    code = MIDWAY.replace("STOP", str(int(stop)))
    done = subprocess.run(
        [sys.executable, "-c", code, "watch", str(lever), "--state", str(state)],
        input=stream(regular(40)),
        capture_output=True,
    )
    assert done.returncode == (130 if stop == signal.SIGINT else 143), done.stderr
    watched = Watched(lever)
    load(state, watched.parts, watched.follower.digest)
    assert watched.follower.samples > 20
    assert len(done.stdout.splitlines()) == 1 + watched.follower.samples


def test_documented_kinds() -> None:
    page = (ROOT / "docs" / "watch.md").read_text(encoding="utf-8")
    assert [kind for kind in KINDS if f"`{kind}`" not in page] == []
