"""From the log of a loop or of a servo to compiled C in one command, and what the C is worth."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks.identify.logs.servo import Servo, input_at_random, recorded
from benchmarks.identify.logs.strangers import walk, zone
from benchmarks.identify.logs.valves import ValveLoop, make
from click.testing import CliRunner

from records import write_log
from requirements import needs
from undeadzone.cli import group

pytestmark = needs("compiler", "gcc")
SIZE = 800


def invoke(*words: str) -> str:
    result = CliRunner().invoke(group, list(words))
    assert result.exit_code == 0, result.output
    return result.output


def write_loop(loop: ValveLoop, path: Path) -> None:
    write_log(path, "time,OP,PV,SP", 1.0, loop.op, loop.pv, loop.sp)


def compiled(snippet: Path, name: str) -> Callable[[float], float]:
    """Return the function of a snippet, compiled with warnings as errors."""
    source, library = snippet.with_name("call.c"), snippet.with_name("call.so")
    source.write_text(f"{snippet.read_text()}float call(float x) {{ return {name}(x); }}\n")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, source, "-o", library], check=True)
    call = ctypes.CDLL(str(library)).call
    call.restype, call.argtypes = ctypes.c_float, [ctypes.c_float]
    return lambda x: float(call(float(x)))


def error_of(loop: ValveLoop) -> float:
    """Return the rms of the control error, without the start."""
    return float(np.std((loop.sp - loop.pv)[SIZE // 4 :]))


def test_a_valve_with_play_ends_in_firmware_and_lines_that_lessen_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lines of the answer are compiled and run along OP."""
    monkeypatch.chdir(tmp_path)
    loop = make(3, "dead band", SIZE)
    write_loop(loop, Path("loop.csv"))
    printed = invoke("identify", "loop.csv", "--no-figures", "--out", "o", "--chain", "fw")
    assert "return wanted + lead;" in printed
    assert "commanded() of snippet.h compiles" in printed
    with_lines = make(3, "dead band", SIZE, compiled(Path("fw/snippet/snippet.h"), "commanded"))
    assert error_of(with_lines) < 0.9 * error_of(loop)


def test_a_valve_that_sticks_is_named_and_gets_no_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dead band of its integral part ended the cycle of 1 of 6 such loops: it is not offered."""
    monkeypatch.chdir(tmp_path)
    write_loop(make(1, "stiction", SIZE), Path("loop.csv"))
    printed = invoke("identify", "loop.csv", "--no-figures", "--out", "o")
    numbers = json.loads(Path("o/identify.json").read_text())
    assert numbers["verdict"] == "stiction"
    assert "see to packing" in printed
    assert "in C" not in printed


def test_a_servo_by_current_and_encoder_ends_in_firmware(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No option is needed: the names tell what drives and what is read."""
    monkeypatch.chdir(tmp_path)
    servo = Servo(6.0, 8.0, 0.0, 0.0, 0.12, 0.03, 0.002, 1, 0.0, 0.0)
    draw = np.random.default_rng(1)
    command, torque = input_at_random(draw, 1600), 0.03 * draw.standard_normal(1600)
    u, y = recorded(servo, 0.005, command, torque, np.zeros(1600), False)
    write_log("servo.csv", "t [s],current [A],encoder [rad]", 0.005, u, y)
    printed = invoke("identify", "servo.csv", "--no-figures", "--out", "o", "--chain", "fw")
    assert "every bit agrees" in printed
    low, high = json.loads(Path("o/identify.json").read_text())["width"][1:]
    assert low < servo.gap < high
    assert "static float commanded" in printed
    assert Path("fw/firmware/servo.c").exists()


@pytest.mark.long(
    "undeadzone_identify/test_identify_plants.py::test_the_width_of_an_integrating_plant"
)
def test_an_unstable_plant_is_said_to_be_one_and_estimate_finds_the_width(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only stable plants are identified: what the answer advises leads to the width."""
    monkeypatch.chdir(tmp_path)
    draw, size, z = np.random.default_rng(0), 1200, 0.0
    r, u, y = 2 * walk(draw, size, 30.0), np.empty(size), np.empty(size)
    for k in range(size):
        y[k] = float(zone(np.array(z), 0.5, 0.5)) + 0.02 * draw.standard_normal()
        u[k] = 3.0 * (r[k] - y[k])
        z = 1.03 * z + 0.06 * u[k]
    write_log("loop.csv", "t,u,y", 0.01, u, y)
    told = CliRunner().invoke(group, ["identify", "loop.csv", "--no-figures", "--out", "o"])
    why = " ".join(told.output.split())
    pole = float(re.search(r"seems unstable \(a pole of \+(\S+) 1/s\)", why)[1])  # type: ignore[index]
    assert pole == pytest.approx(100 * np.log(1.03), rel=0.02)
    assert "let `undeadzone estimate` find the widths" in why
    gain = 0.06 * pole / np.expm1(0.01 * pole)
    Path("model.toml").write_text(
        f"[plant]\nA = [[{pole}]]\nB = [[{gain}]]\nC = [[1.0]]\n[sensor]\nnoise = 0.02\n"
        '[observer]\nmethod = "censored"\nright = [0.0, 2.0]\n'
        '[simulation]\ntime = "sampled"\nstep = 0.01\nduration = 12.0\n'
    )
    printed = invoke("estimate", "model.toml", "loop.csv", "--no-figures", "--out", "e", "--json")
    numbers = json.loads(printed)
    assert numbers["consistent"]
    assert numbers["d_right"] + numbers["d_left"] == pytest.approx(1.0, rel=0.1)
