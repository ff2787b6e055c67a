"""The Arduino library on an emulated Uno: its self-test, with the vectors in flash."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from test_engines import OBSERVERS, small

import undeadzone as uz
from requirements import require
from scenes import scene
from undeadzone.scenario.schema import Scenario
from undeadzone_export import exporting

UNO = Path(__file__).parents[1] / "emulator" / "uno.c"
TOOLS = {"avr-gcc": "gcc-avr, avr-libc", "simavr": "simavr"}
CHIP = ["-mmcu=atmega328p", "-DF_CPU=16000000UL", "-DARDUINO=10819"]
FLASH, MEMORY = 32_256, 2_048  # [bytes]


def case(name: str) -> Scenario:
    if name == "certified":
        return scene(simulation={"time": "sampled"})
    return small("sampled", observer={"method": name} | OBSERVERS[name][1])


@pytest.mark.parametrize("level", ["-Os", "-O2"])
@pytest.mark.parametrize("name", ["certified", "rbf_residual"])
def test_the_self_test_agrees_on_an_uno(
    name: str, level: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without functions and with them; vectors, code and stack fit the board."""
    require("emulator", [package for tool, package in TOOLS.items() if shutil.which(tool) is None])
    monkeypatch.setattr(exporting, "STEPS", 600)
    uz.export(case(name), "arduino", tmp_path / "lib", name="o")
    example = tmp_path / "lib" / "examples" / "o_test"
    sources = [UNO, tmp_path / "lib" / "src" / "o.c", example / "o_test.c"]
    program = tmp_path / "uno.elf"
    options = [*CHIP, level, "-std=gnu99", "-Wall", "-Werror", "-I", tmp_path / "lib" / "src"]
    subprocess.run(["avr-gcc", *options, "-o", program, *sources, "-lm"], check=True)
    sizes = subprocess.run(["avr-size", program], capture_output=True, text=True, check=True)
    text, data, bss = map(int, sizes.stdout.splitlines()[1].split()[:3])
    assert text + data < FLASH
    assert data + bss < MEMORY / 2
    command = ["simavr", "-m", "atmega328p", "-f", "16000000", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert "every bit agrees" in done.stdout + done.stderr
