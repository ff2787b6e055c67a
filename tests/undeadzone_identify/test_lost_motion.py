"""Two positions: what is lost when it turns round, at the times of the readings; the few lines."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from benchmarks.identify.logs.lost_motion import (
    KINDS,
    MotionLog,
    axis_at_rest,
    axis_on_one_flank,
    follow,
    goal_and_current,
    jittered,
    noisy_and_late,
    pulses_and_star,
    two_encoders,
    wrong_ratio,
)

import undeadzone as uz
from further import further
from requirements import needs
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone_identify.logs.log import Options, read_log
from undeadzone_identify.models.lost_motion import (
    MotionFit,
    Positions,
    Structure,
    lag_signal,
    reversal_blocks,
)
from undeadzone_identify.selection.lost_motion import find_lost_motion

SEEDS = 20
FEW = 16  # of 20 intervals hold at least: below it lies 1.6 % of fair ones of 90 %


def identified(log: MotionLog, **more: Any) -> uz.IdentifiedMotion:
    """Return the answer to a log, which must be one of two positions."""
    found = uz.identify(pd.DataFrame(log.columns), **more)
    assert isinstance(found, uz.IdentifiedMotion)
    return found


@pytest.mark.parametrize(
    "make", [axis_at_rest, pulses_and_star, *further(two_encoders, noisy_and_late, jittered)]
)
def test_a_gap_is_found_and_its_interval_holds(make: Any) -> None:
    """Without an option, at rest or moving, with irregular times, noise, counts, a late reading."""
    covered = 0
    for seed in range(SEEDS):
        log = make(np.random.default_rng([5, seed]))
        found = identified(log)
        assert found.verdict == "play"
        assert found.gap.value == pytest.approx(log.lost, rel=0.05)
        covered += found.gap.low <= log.lost <= found.gap.high
    assert covered >= FEW


@pytest.mark.parametrize("make", [wrong_ratio, axis_on_one_flank])
def test_a_verdict_of_no_gap_has_a_bound(make: Any) -> None:
    for seed in range(5):
        found = identified(make(np.random.default_rng(seed)))
        assert found.verdict == "none"
        assert found.width is None
        assert 0 < found.gap.high < 0.02
        assert found.account.limits == {"input reversal": found.gap.high}
        assert f"{found.gap.high:.3g}" in found.summary()["at most"][0]


def test_a_servo_loses_gap_and_friction_together_and_a_current_tells_them_apart() -> None:
    """The sum is named as a sum; with a current gap and friction have intervals that hold."""
    log = goal_and_current(np.random.default_rng(3))
    assert log.gap is not None
    assert log.lost is not None
    both = identified(log)
    parts = both.answer.parts
    assert parts is not None
    assert parts.gap.low <= log.gap <= parts.gap.high
    assert parts.friction.low <= log.lost - log.gap <= parts.friction.high
    assert both.headline().startswith("Backlash: ")
    assert re.search(r"gap .* rad, friction .* rad$", both.headline())
    del log.columns["current [A]"]
    alone = identified(log)
    assert alone.answer.parts is None
    assert alone.headline().startswith("Lost motion, gap and friction together: gap ")
    assert alone.numbers()["lost_motion"]["with_friction"]
    assert alone.gap.low <= log.lost <= alone.gap.high


def test_a_current_that_follows_no_error_tells_nothing_apart() -> None:
    log = goal_and_current(np.random.default_rng(3))
    noise = np.random.default_rng(0).standard_normal(log.columns["current [A]"].size)
    log.columns["current [A]"] = noise
    found = identified(log)
    assert found.answer.parts is None
    assert "Lost motion" in found.headline()


def test_single_pulses_are_summed() -> None:
    """A mount's file has the pulses one by one; each moves the reading after it."""
    log = pulses_and_star(np.random.default_rng(2))
    total = log.columns.pop("pulses [ms]")
    log.columns["pulses [ms]"] = np.diff(total, append=total[-1])
    log.columns["star [arcsec]"] = log.columns.pop("star [arcsec]")
    found = identified(log)
    assert found.answer.is_summed
    assert log.lost is not None
    assert found.gap.low <= log.lost <= found.gap.high


def test_a_plant_with_dynamics_is_left_to_the_fit_of_plants() -> None:
    """A lag of ten samples, and a dead zone of the sensor, are no two positions."""
    t = 0.1 * np.arange(600)
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(60), 10)
    z = lag_signal(u, t, 1.0, 1)
    zone = np.maximum(u - 0.5, 0) + np.minimum(u + 0.5, 0)
    for y in (z, zone, z + 0.05 * rng.standard_normal(600)):
        frame = pd.DataFrame({"t": t, "u": u, "y": y})
        found, stands = find_lost_motion(read_log(frame), Options())
        assert found is not None
        assert not stands


def test_what_no_plant_fits_has_an_answer_and_the_reason() -> None:
    """Noise at irregular times ends in no error: nothing can be said, and why."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.5, 1.5, 160))
    signals = {"motor [deg]": rng.standard_normal(160), "joint [deg]": rng.standard_normal(160)}
    found = uz.identify(pd.DataFrame({"t [s]": t, **signals}))
    assert isinstance(found, uz.IdentifiedMotion)
    assert found.verdict == "unclear"
    assert any("irregular step" in reason for reason in found.summary()["doubt"])
    with pytest.raises(InputError, match="two positions have no plant"):
        found.scenario()


def test_the_profile_is_that_of_a_closer_scan() -> None:
    """The best gap, delay and lag lie where a dense scan of all three has its least square."""
    t = np.sort(np.random.default_rng(4).uniform(0, 20, 400))
    u = np.sin(t)
    y = 2 * follow(np.interp(t - 0.03, t, u), 0.2) + 1
    fit = MotionFit(Positions(t, u, y), Structure(late=True))
    found = fit.fit()
    gaps = np.linspace(0.15, 0.25, 21)
    least = min(float(fit.squares(gaps, late, 0.0).min()) for late in np.linspace(0, 0.1, 21))
    assert found.squares <= least + 1e-20
    assert found.gap == pytest.approx(0.2, abs=1e-3)
    assert found.delay == pytest.approx(0.03, abs=2e-3)
    assert found.gain == pytest.approx(2, abs=2e-3)
    assert found.level == pytest.approx(1, abs=5e-3)


def test_lags_at_irregular_times_are_those_of_a_regular_grid() -> None:
    t = 0.01 * np.arange(500)
    u = np.sin(3 * t)
    regular = lag_signal(u, t, 0.1, 2)
    moved = t + np.where(np.arange(500) % 2, 1e-3, 0.0)
    assert np.abs(lag_signal(np.sin(3 * moved), moved, 0.1, 2) - regular).max() < 0.02


def test_strokes_end_where_the_input_turns_by_more_than_the_gap() -> None:
    u = np.concatenate([np.linspace(0, 10, 50), np.linspace(10, 9.6, 5), np.linspace(9.6, 10, 5)])
    u = np.concatenate([u, np.linspace(10, 2, 40)])
    assert reversal_blocks(u, 0.5)[-1] == 1
    assert reversal_blocks(u, 0.0)[-1] == 3


# --- From a log to compiled C in one command


def write_table(log: MotionLog, path: Path) -> None:
    """Write a log as CSV."""
    pd.DataFrame(log.columns).to_csv(path, index=False)


@needs("compiler", "gcc")
def test_from_a_log_of_two_positions_to_compiled_c_in_one_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The C reduces what a simulated axis loses more than tenfold; screen, JSON, page agree."""
    monkeypatch.chdir(tmp_path)
    log = noisy_and_late(np.random.default_rng(8))
    assert log.lost is not None
    write_table(log, Path("servo.csv"))
    words = ["identify", "servo.csv", "--chain", "fw"]
    assert group.main(words, standalone_mode=False) == 0
    out = capsys.readouterr().out
    numbers = json.loads(Path("servo-identify/identify.json").read_text())
    head = numbers["found"]
    assert head.startswith("Backlash: ")
    assert head in " ".join(out.split())
    page = Path("servo-identify/report.html").read_text()
    assert f'<span class="yes">{head}</span>' in page
    assert "return wanted + lead;" in out
    assert "END_FUNCTION_BLOCK" in page
    source = Path("fw/snippet/snippet.h").read_text()
    Path("axis.c").write_text(source + "float call(float x) { return commanded(x); }\n")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, "axis.c", "-o", "axis.so"], check=True)
    call = ctypes.CDLL(str(tmp_path / "axis.so")).call
    call.restype, call.argtypes = ctypes.c_float, [ctypes.c_float]
    goal = 30 * np.sin(0.01 * np.arange(3000))
    commanded = np.array([call(float(one)) for one in goal])

    def lost(command: np.ndarray) -> float:
        at, most = float(goal[0]), 0.0
        for aim, one in zip(goal, command, strict=True):
            at = max(min(at, one), one - log.lost)
            most = max(most, abs(at - aim))
        return most

    assert lost(commanded) < 0.1 * lost(goal)


def test_a_page_is_not_red_where_something_was_found(tmp_path: Path) -> None:
    """And it is where nothing can be said; several kinds of two positions have a figure."""
    log = axis_at_rest(np.random.default_rng(1))
    write_table(log, tmp_path / "a.csv")
    words = ["identify", str(tmp_path / "a.csv"), "--out", str(tmp_path / "o")]
    assert group.main(words, standalone_mode=False) == 0
    page = (tmp_path / "o" / "report.html").read_text()
    assert 'class="no"' not in page
    assert (tmp_path / "o" / "overview.svg").exists()


def test_every_kind_of_the_benchmark_names_its_columns_by_titles(tmp_path: Path) -> None:
    """A torque and an angle q alone need --columns."""
    for name, make in KINDS.items():
        log = make(np.random.default_rng(0)) if "goal" not in name else None
        if log is None:
            continue
        write_table(log, tmp_path / "log.csv")
        named = "y=q,u=torque" if "q [rad]" in log.columns else None
        assert read_log(tmp_path / "log.csv", named).y.shape[1] == 1


def test_without_a_gap_a_chain_ends_with_no_and_writes_no_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_table(wrong_ratio(np.random.default_rng(1)), Path("a.csv"))
    words = ["identify", "a.csv", "--no-figures", "--chain", "fw"]
    assert group.main(words, standalone_mode=False) == 1
    assert "it takes a scenario or a certain gap" in capsys.readouterr().out
    assert not Path("fw/snippet").exists()
