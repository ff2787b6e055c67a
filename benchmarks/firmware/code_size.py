"""Size of exported C, its cost on a Cortex-M4F, and how long one waits for it and for a sample.

UNDEADZONE_BESIDE names the Python of another checkout, which is measured in the same run.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

import undeadzone as uz
from benchmarks.firmware import emulated_c
from benchmarks.markdown import head, row
from undeadzone.interfaces import require_graph
from undeadzone.simulation.online import build_observer, observer_graph
from undeadzone_export.boards import BOARDS

ROOT = Path(__file__).parents[2]
TEMPLATE = ROOT / "src" / "undeadzone" / "template.toml"
NOTE = """Single precision. Export: CPU seconds, the compiler included. Flash at -Os, instructions
and stack [bytes] of a step at -O2 on the emulated Cortex-M4F. An exact sensor: `rounding`,
`slope_std` and `lag` are 0.
"""
LIVE = """
import sys, time, tempfile, os
os.environ["UNDEADZONE_CACHE"] = tempfile.mkdtemp()
import numpy as np
import undeadzone as uz
of = uz.read(sys.argv[1])
began = time.process_time()
parts = of.observer, of.plant, of.sensor, of.simulation.step, of.simulation.substeps
online = uz.Online(*parts, compiled=True)
online.update(np.zeros(online.model.p), np.zeros(online.model.m))
first = time.process_time() - began
while getattr(online, "engine", "compiled").startswith("virtual"):
    time.sleep(0.001)
machine = time.process_time() - began
getattr(online, "settle", lambda: None)()
print(first, machine, time.process_time() - began)
"""
UNO_CODE = """#include "o.h"
static o_state state;
volatile float port;
int main(void)
{
    o_in in = {{0}};
    o_out out;
    o_init(&state);
    for (;;) {
        in.y[0] = port;
        in.u[0] = port;
        o_step(&state, &in, &out);
        port = out.z[0];
    }
}
"""
ASSUMPTIONS = ("right = [0.0, 2.0]", "disturbance = 0.2", "bias = 0.0")
# Observers of the template, with the keys that they do not know.
ON_UNO = {
    "certified": ASSUMPTIONS,
    "high_gain": ASSUMPTIONS,
    "kalman": ASSUMPTIONS[2:],
    "censored": (),
}


class Measured(NamedTuple):
    """What an export of a scenario takes.

    Attributes:
        seconds: CPU time of the command [s].
        source: of the C and its header [bytes].
        flash: [bytes].
        instructions: of a step, mean.
        stack: of a step [bytes].
    """

    seconds: float
    source: int
    flash: int
    instructions: int
    stack: int


def table() -> str:
    """All tables."""
    pythons = {"this": sys.executable}
    if "UNDEADZONE_BESIDE" in os.environ:
        pythons = {"beside": os.environ["UNDEADZONE_BESIDE"]} | pythons
    with _compiled_modules():
        return "\n".join([exports(pythons), waits(pythons), outputs(), uno()])


@contextmanager
def _compiled_modules() -> Iterator[None]:
    """Let Python keep the modules that it compiles, as an installation does."""
    with tempfile.TemporaryDirectory() as folder:
        given = dict(os.environ)
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = folder
        try:
            yield
        finally:
            os.environ.clear()
            os.environ.update(given)


def scenarios(folder: Path) -> dict[str, Path]:
    """The scenario files by name; those of order 4 and 8 are written into a folder."""
    found = {"template": TEMPLATE, "motor, one gap": ROOT / "examples" / "motor_position.toml"}
    for order in (4, 8):
        A = np.eye(order, k=1)
        A[-1] = -np.poly(-np.ones(order))[:0:-1]
        keys = {
            "A": A.tolist(),
            "B": np.eye(order)[:, -1:].tolist(),
            "C": np.eye(order)[:1].tolist(),
            "x0": [0.5, *[0.0] * (order - 1)],
        }
        lines = []
        for line in TEMPLATE.read_text(encoding="utf-8").splitlines():
            key = line.partition(" =")[0]
            lines.append(f"{key} = {keys[key]}" if key in keys else line)
        path = folder / f"order_{order}.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        found[f"order {order}"] = path
    return found


def with_exact_sensors(files: dict[str, Path], folder: Path) -> dict[str, Path]:
    """The same scenarios with a sensor whose shape is known exactly; a play has none."""
    found = {}
    for name, path in files.items():
        text = path.read_text(encoding="utf-8")
        if 'kind = "play"' in text:
            continue
        lines = []
        for line in text.splitlines():
            lines.append(line)
            if line.startswith("[sensor]"):
                lines += ["rounding = 0.0", "slope_std = 0.0", "lag = 0.0"]
        exact = folder / f"{path.stem}_exact.toml"
        exact.write_text("\n".join(lines), encoding="utf-8")
        found[f"{name}, exact sensor"] = exact
    return found


def exports(pythons: dict[str, str]) -> str:
    """Export of each scenario by each checkout."""
    title = "## Size of exported C\n"
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(tool) is None:
            return f"{title}\nNot measured: {tool} is not installed; `make tools`.\n"
    columns = (
        "scenario",
        "checkout",
        "export [s]",
        "C [kB]",
        "flash [kB]",
        "instructions",
        "stack",
    )
    lines = [title, NOTE, *head(*columns)]
    with tempfile.TemporaryDirectory() as scratch:
        for python in pythons.values():  # compiles the modules
            _measure(python, TEMPLATE, Path(scratch) / "out")
        files = scenarios(Path(scratch))
        exact = with_exact_sensors(files, Path(scratch))
        measured = [(name, checkout) for name in files for checkout in pythons]
        for name, checkout in (*measured, *((name, "this") for name in exact)):
            got = _measure(pythons[checkout], (files | exact)[name], Path(scratch) / "out")
            sizes = (f"{got.source / 1e3:.0f}", f"{got.flash / 1e3:.1f}")
            costs = (f"{got.instructions:,}", f"{got.stack:,}")
            lines.append(row(name, checkout, f"{got.seconds:.1f}", *sizes, *costs))
    return "\n".join([*lines, ""])


def _measure(python: str, path: Path, out: Path) -> Measured:
    """Export a scenario, build it for the microcontroller and run it in the emulator."""
    shutil.rmtree(out, ignore_errors=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [python, "-m", "undeadzone", "export", str(path), "--name", "o", "--out", str(out)]
    subprocess.run(command, capture_output=True, cwd=out.parent, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    source = sum(each.stat().st_size for each in out.glob("o*.[ch]") if "_test" not in each.name)
    build = ["arm-none-eabi-gcc", *emulated_c.CORE, *emulated_c.FLAGS[1:], "-Os", "-c", "o.c"]
    subprocess.run(build, cwd=out, check=True)
    printed = subprocess.run(
        ["arm-none-eabi-size", "o.o"], cwd=out, check=True, capture_output=True, text=True
    ).stdout
    counted = emulated_c.count_folder(out)
    return Measured(seconds, source, int(printed.split()[6]), counted.mean, counted.stack)


def waits(pythons: dict[str, str]) -> str:
    """From an empty cache to the first sample of `Online(compiled=True)`."""
    lines = [
        "## Wait for a compiled step\n",
        "`Online(compiled=True)`, empty cache, CPU seconds since the start. The virtual machine",
        "runs the first samples, then unoptimised machine code, then the fastest.\n",
    ]
    lines += head("scenario", "checkout", "first sample [s]", "machine code [s]", "fastest [s]")
    with tempfile.TemporaryDirectory() as scratch:
        files = scenarios(Path(scratch)) | {"UR5, gears": _write_geared_arm(Path(scratch))}
        for python in pythons.values():  # compiles the modules
            _wait_times(python, TEMPLATE)
        for name in ("template", "order 4", "order 8", "UR5, gears"):
            for checkout, python in pythons.items():
                times = [f"{each:.2f}" for each in _wait_times(python, files[name])]
                lines.append(row(name, checkout, *times))
    return "\n".join([*lines, ""])


def _write_geared_arm(folder: Path) -> Path:
    """The scenario that `undeadzone arm --gears` writes for a UR5."""
    urdf = ROOT / "examples" / "ur5.urdf"
    command = [sys.executable, "-m", "undeadzone", "arm", str(urdf), "--gears", "--out"]
    subprocess.run([*command, str(folder)], capture_output=True, check=True)
    return folder / "ur5.toml"


def _wait_times(python: str, path: Path) -> list[float]:
    """CPU seconds to the first sample, to machine code and to the fastest."""
    command = [python, "-c", LIVE, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def outputs() -> str:
    """Instructions of one member of the filter bank by the number of outputs."""
    lines = [
        "## Cost of several outputs\n",
        "`censored` with one level: as many plants of order 2, inputs and sensors as outputs.\n",
        *head("outputs", "numbers in the memory", "instructions", "power of the outputs"),
    ]
    before = 0
    for p in (1, 2, 4, 8):
        one = np.eye(p)
        plant = uz.Plant(
            A=np.kron(one, [[0.0, 1.0], [-1.0, -2.0]]).tolist(),
            B=np.kron(one, [[0.0], [1.0]]).tolist(),
            C=np.kron(one, [[1.0, 0.0]]).tolist(),
        )
        sensor = uz.Sensor(right=[1.0] * p, left=[0.7] * p, noise=0.02)
        observer = uz.Censored(right=[0.0, 2.0], levels=1)
        model, zone, built = build_observer(observer, plant, sensor, 5e-3, 1, None)
        graph = observer_graph(model, require_graph(built), zone)
        count = graph.step.n_instructions()
        power = f"{np.log2(count / before):.1f}" if before else ""
        lines.append(row(str(p), f"{graph.start.size:,}", f"{count:,}", power))
        before = count
    return "\n".join([*lines, ""])


def uno() -> str:
    """What an Arduino Uno can hold: linked alone, without a sketch's own code."""
    title = "## Observers on an Arduino Uno\n"
    if shutil.which("avr-gcc") is None:
        return f"{title}\nNot measured: avr-gcc is not installed; `make tools`.\n"
    board = BOARDS[0]
    lines = [
        title,
        *head("observer of the template", "flash", "memory", "fits", "flash of the board table"),
    ]
    for method in ON_UNO:
        with tempfile.TemporaryDirectory() as scratch:
            lines.append(_uno_row(method, Path(scratch)))
    note = f"An Uno has {board.flash:,} bytes of flash and {board.ram:,} of memory."
    return "\n".join([*lines, "", note, ""])


def _uno_row(method: str, folder: Path) -> str:
    """One observer, built for the processor of an Uno."""
    text = TEMPLATE.read_text(encoding="utf-8").replace('method = "auto"', f'method = "{method}"')
    unknown = ON_UNO[method]
    text = "\n".join(line for line in text.splitlines() if not line.startswith(unknown))
    (folder / "of.toml").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "undeadzone", "export", "of.toml", "--name", "o", "--json"]
    done = subprocess.run([*command, "--out", "c"], cwd=folder, capture_output=True, text=True)
    report = json.loads(done.stdout)
    (estimated,) = [each["flash"] for each in report["boards"] if each["board"] == BOARDS[0].name]
    (folder / "c" / "main.c").write_text(UNO_CODE, encoding="utf-8")
    flags = ["-mmcu=atmega328p", "-std=c99", "-Os", "-ffp-contract=off", "-ffunction-sections"]
    link = ["-Wl,--gc-sections", "-Wl,--noinhibit-exec", "o.c", "main.c", "-o", "o.elf", "-lm"]
    run = {"cwd": folder / "c", "capture_output": True, "text": True}
    subprocess.run(["avr-gcc", *flags, *link], check=False, **run)
    if not (folder / "c" / "o.elf").exists():
        return row(method, "too large", "-", "no", f"{estimated:,}")
    flash, data, zeroed = map(
        int, subprocess.run(["avr-size", "o.elf"], check=True, **run).stdout.split()[6:9]
    )
    fits = flash + data <= BOARDS[0].flash and data + zeroed < BOARDS[0].ram
    return row(
        method, f"{flash:,}", f"{data + zeroed:,}", "yes" if fits else "no", f"{estimated:,}"
    )
