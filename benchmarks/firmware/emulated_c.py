"""The exported C: on an emulated Cortex-M4F, and in single precision beside double."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

import undeadzone as uz
from benchmarks.markdown import head, row
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone_export import accuracy, compiler, exported_step
from undeadzone_export.code import Code, build_code
from undeadzone_export.exported_step import ExportedStep
from undeadzone_export.selftest_vectors import (
    choose_samples,
    continue_scenario,
    record_inputs,
    reference_vectors,
    selftest_source,
)
from undeadzone_export.source import Labels, build_source

ROOT = Path(__file__).parents[2]
EMULATOR = ROOT / "tests" / "emulator"
CORE = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
FLAGS = ["-O2", "-std=c99", "-ffp-contract=off", "-fno-math-errno", "-ffunction-sections"]
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow"]
LONG = 1_000_000  # steps of float beside double
RATES = (200.0, 500.0, 1000.0, 2000.0, 5000.0)  # [Hz]
ALONG = 100_000  # steps at each rate

# Instructions of a step, mean of those that the emulator counts, that each must stay below.
BARS = {
    "certified, paper example": 140,
    "censored, 2 states": 17_500,
    "extended, two links": 21_000,
    "extended, UR5, separate joints": 16_000,
}


class Counted(NamedTuple):
    """What the emulator and the compiler say of a step.

    Attributes:
        mean, most: instructions, of all steps and of the longest 20.
        stack: [bytes].
        text: of the object, with all functions [bytes].
        warnings: lines of the compiler.
        symbols: of libraries that the object needs.
    """

    mean: int
    most: int
    stack: int
    text: int
    warnings: int
    symbols: int


def table() -> str:
    """Everything."""
    return "\n".join([instructions(), bits(), precision(), covariances()])


def instructions() -> str:
    """Instructions, stack and size of the four cases on the emulated microcontroller."""
    title = "## Exported C on an emulated Cortex-M4F\n"
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(tool) is None:
            return f"{title}\nNot counted: {tool} is not installed; `make tools`.\n"
    columns = ("single precision, -O2", "instructions", "bar", "most", "stack", "object [kB]")
    lines = [title, *head(*columns, "warnings", "library symbols")]
    for name, bar in BARS.items():
        lines.append(_counted_row(name, case(name), bar))
        if not name.startswith("certified"):
            observer = msgspec.structs.replace(case(name).observer, glitches=0.0)
            plain = msgspec.structs.replace(case(name), observer=observer)
            lines.append(_counted_row(f"{name}, `glitches = 0`", plain, bar))
        if name.startswith("censored"):
            exact = {"rounding": 0.0, "slope_std": 0.0, "lag": 0.0}
            sensor = msgspec.structs.replace(case(name).sensor, **exact)
            plain = msgspec.structs.replace(case(name), sensor=sensor)
            lines.append(_counted_row(f"{name}, exact sensor", plain, bar))
    note = "Instructions are not cycles: the emulator knows no wait states."
    return "\n".join([*lines, "", note, ""])


def _counted_row(name: str, scenario: Scenario, bar: int) -> str:
    """One case."""
    counted = count(build_code(exported_step.build_step(resolve_scenario(scenario)), True))
    size = f"{counted.text / 1e3:.1f}"
    return row(name, f"{counted.mean:,}", f"{bar:,}", f"{counted.most:,}", f"{counted.stack:,}",
               size, str(counted.warnings), str(counted.symbols))  # fmt: skip


def case(name: str) -> Scenario:
    """The scenario of a case."""
    if name == "certified, paper example":
        return _sampled(uz.read(ROOT / "examples" / "paper_5sin.toml"), 1e-3)
    if name == "censored, 2 states":
        return filtered(5e-3)
    file = "two_link.toml" if name == "extended, two links" else "ur5.toml"
    return uz.read(ROOT / "examples" / file)


def filtered(step: float) -> Scenario:
    """The censored filter of the paper's plant at a sample time."""
    return uz.Scenario(
        plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]], x0=[0.5, 0]),
        sensor=uz.Sensor(right=1.0, left=0.7, noise=0.02),
        reference=uz.Sine(amplitude=3.0, frequency=0.3),
        observer=uz.Censored(right=[0.0, 2.0]),
        controller=uz.StateFeedback(poles=[-8.0, -10.0]),
        simulation=uz.Simulation(time="sampled", step=step, duration=20.0),
    )


def _sampled(scenario: Scenario, step: float) -> Scenario:
    """A scenario in sampled time."""
    simulation = msgspec.structs.replace(scenario.simulation, time="sampled", step=step)
    return msgspec.structs.replace(scenario, simulation=simulation)


def count(printed: Code) -> Counted:
    """Build a step for the microcontroller, run it in the emulator."""
    text = build_source(printed, Labels("o", "benchmark", "observer"))
    with tempfile.TemporaryDirectory() as name:
        compiler.write_sources(text.texts_by_name(), Path(name))
        return count_folder(Path(name))


def count_folder(folder: Path) -> Counted:
    """Build the export named o in a folder for the microcontroller, run it in the emulator."""
    build = ["arm-none-eabi-gcc", *CORE, *FLAGS, *WARNINGS, "-c", "-o", "o.o", "o.c"]
    built = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=True)
    numbers = re.findall(r"\d+", _emulated([str(EMULATOR / "count.c"), "o.o"], folder))
    whole = _output(["arm-none-eabi-size", "o.o"], folder).splitlines()[1].split()[0]
    needed = _output(["arm-none-eabi-nm", "-u", "o.o"], folder).splitlines()
    mean, most, stack = map(int, numbers)
    warnings = len(built.stderr.splitlines())
    return Counted(mean, most, stack, int(whole), warnings, len(needed))


def _emulated(files: list[str], folder: Path) -> str:
    """What a program prints in the emulator."""
    gcc = ["arm-none-eabi-gcc", *CORE, *FLAGS, "-I", ".", "-T", str(EMULATOR / "memory.ld")]
    link = ["-nostartfiles", "--specs=rdimon.specs", "-Wl,--gc-sections", "-o", "p"]
    every = [*gcc, *link, str(EMULATOR / "start.c"), *files, "-lm"]
    subprocess.run(every, cwd=folder, check=True)
    board = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-icount", "shift=0"]
    board += ["-semihosting-config", "enable=on,target=native", "-kernel", "p"]
    done = subprocess.run(
        board, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    return done.stdout


def bits() -> str:
    """The self-tests of the four cases on this computer and in the emulator."""
    title = "## Self-tests of the exported C: bits of outputs and memory\n"
    if shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None:
        return f"{title}\nNot run: the emulator is not installed; `make tools`.\n"
    lines = [title, *head("case", "precision", "this computer", "emulated Cortex-M4F")]
    for name in BARS:
        for word in ("single", "double"):
            lines.append(row(name, word, *tested(name, word == "single")))
    return "\n".join([*lines, ""])


def tested(name: str, single: bool) -> list[str]:
    """What the self-test of a case says on this computer and in the emulator."""
    scenario = case(name)
    simulation = msgspec.structs.replace(scenario.simulation, duration=1.0)
    problem = resolve_scenario(msgspec.structs.replace(scenario, simulation=simulation))
    step = exported_step.build_step(problem)
    rows = choose_samples(record_inputs(problem, step), step.readings)
    printed = build_code(step, single)
    text = build_source(printed, Labels("o", "benchmark", "observer"))
    files = text.texts_by_name() | {
        "o_test.c": selftest_source(printed, "o", reference_vectors(printed, rows))
    }
    with tempfile.TemporaryDirectory() as folder:
        for path, content in files.items():
            Path(folder, path).write_text(content)
        board = _emulated(["o.c", "o_test.c"], Path(folder))
    return [_verdict(part) for part in (compiler.run_selftest(files)[1], board)]


def _verdict(output: str) -> str:
    """What a self-test says, without its name."""
    return output.splitlines()[0].split(": ", 1)[1] if output else "did not run"


def _output(command: list[str], folder: Path) -> str:
    """What a program prints."""
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL
    )
    return done.stdout


class _Beside:
    """A step compiled in both precisions, and what they differ by."""

    def __init__(self, step: ExportedStep, folder: Path) -> None:
        self.step = step
        self.exact = accuracy.CompiledStep(build_code(step, False), folder)
        self.rounded = accuracy.CompiledStep(build_code(step, True), folder)
        self.places = exported_step.field_slices(step.outputs)
        self.errors = np.zeros(self.exact.outputs)
        self.smallest = [np.inf, np.inf]  # eigenvalue of a correlation matrix, double and float

    def run(self, rows: Any) -> None:
        """Both along inputs, the same for both."""
        rows = rows.astype(np.float32).astype(float)
        for start in range(0, len(rows), accuracy.CHUNK):
            piece = rows[start : start + accuracy.CHUNK]
            gap = np.abs(self.exact(piece) - self.rounded(piece)).max(axis=0)
            self.errors = np.maximum(self.errors, gap)
            for k, compiled in enumerate((self.exact, self.rounded)):
                value = accuracy.smallest_eigenvalue(self.step.state, compiled.state)
                if value is not None:
                    self.smallest[k] = min(self.smallest[k], value)

    def error(self, name: str) -> float:
        """The largest error of a field."""
        return float(self.errors[self.places[name]].max())


def precision() -> str:
    """The largest errors of float along a million steps of `certified`."""
    lines = [f"## Float beside double, {LONG:,} steps of `certified`\n"]
    lines += head("sample time [s]", "error of right", "error of left", "bar", "error of z^")
    for step in (1e-3, 1e-4):
        scenario = _sampled(uz.read(ROOT / "examples" / "paper_5sin.toml"), step)
        with tempfile.TemporaryDirectory() as name:
            both = _Beside(exported_step.build_step(resolve_scenario(scenario)), Path(name))
            rows = record_inputs(continue_scenario(scenario, LONG // 10), both.step)
            for _ in range(-(-LONG // len(rows))):
                both.run(rows)
        errors = [f"{both.error(name):.2g}" for name in ("right", "left", "z")]
        lines.append(row(f"{step:g}", *errors[:2], "1e-4", errors[2]))
    return "\n".join([*lines, ""])


def covariances() -> str:
    """The smallest eigenvalue of a correlation matrix of `censored`, by the sampling rate."""
    lines = [f"## Covariances of `censored` in float, {ALONG:,} steps at each rate\n"]
    lines += head("rate [Hz]", "least eigenvalue, double", "float", "bar", "error of right / std")
    for rate in RATES:
        scenario = filtered(1.0 / rate)
        with tempfile.TemporaryDirectory() as name:
            both = _Beside(exported_step.build_step(resolve_scenario(scenario)), Path(name))
            both.run(record_inputs(continue_scenario(scenario, ALONG), both.step)[:ALONG])
            std = both.exact(np.full((1, 2), np.nan))[0, both.places["right_std"]]
        worst = both.error("right") / float(std.min())
        values = [f"{value:.2g}" for value in both.smallest]
        lines.append(row(f"{rate:g}", *values, "above 0", f"{worst:.2g}"))
    return "\n".join([*lines, ""])
