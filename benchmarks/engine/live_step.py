"""One live sample in Python and in C, as a multiple of a NumPy matrix-vector product of order 2."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import undeadzone as uz
from benchmarks.markdown import head, row
from benchmarks.timing import least
from undeadzone.registry import ObserverOptions
from undeadzone.scenario.problem import resolve_scenario
from undeadzone_export import accuracy, exported_step
from undeadzone_export.code import build_code

BLOCK = 10  # calls' worth of samples in a block
FILTER = uz.Censored(right=[0.5, 1.5], left=[0.5, 1.5])
PAPER = uz.Certified(L=[1.0, 1.5], gamma=10.0)


def table(calls: int = 500, rounds: int = 400) -> str:
    """Least of interleaved rounds of so many calls; a tenth of them for the large filter."""
    A, x = np.eye(2), np.ones(2)

    def multiply() -> None:
        for _ in range(calls):
            A @ x

    timed: dict[str, Callable[[], None]] = {"numpy A @ x, order 2": multiply}
    counts = {"numpy A @ x, order 2": calls}
    with tempfile.TemporaryDirectory() as folder:
        for name, observer in (("certified", PAPER), ("censored", FILTER)):
            count = calls if name == "certified" else calls // 10
            for word, (samples, run) in _ways(observer, count, Path(folder)).items():
                timed[f"{name}, {word}"] = run
                counts[f"{name}, {word}"] = samples
        seconds = least(timed, rounds)
    unit = next(iter(seconds.values())) / calls
    rows = []
    for name, value in seconds.items():
        each = value / counts[name]
        rows.append(row(name, f"{1e6 * each:.3g}", f"{each / unit:.2g}"))
    return "\n".join(["## Live step\n", *head("call", "us", "times numpy"), *rows, ""])


def _ways(
    observer: ObserverOptions, count: int, folder: Path
) -> dict[str, tuple[int, Callable[[], None]]]:
    """What takes samples in, by name, and how many: `count` one by one, more in a block."""
    many = BLOCK * count
    plant = uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]])
    sensor = uz.Sensor(right=1, left=1, noise=0.01)
    plain = uz.Online(observer, plant, sensor, 1e-3)
    fast = uz.Online(observer, plant, sensor, 1e-3, compiled=True)
    fast.settle()
    rows = np.tile([0.3, 1.0], (many, 1))
    scenario = uz.Scenario(
        plant=plant,
        sensor=sensor,
        observer=observer,
        reference=uz.Sine(amplitude=5.0, frequency=1.0),
        controller=uz.StateFeedback(alpha=10.0),
        simulation=uz.Simulation(time="sampled", step=1e-3, duration=1.0),
    )
    step = exported_step.build_step(resolve_scenario(scenario))
    block = partial(fast.update_many, rows[:, :1], rows[:, 1:])
    ways: dict[str, tuple[int, Callable[[], None]]] = {
        "Online.update": (count, partial(_each, plain.update, count)),
        f"Online.update, {fast.engine}": (count, partial(_each, fast.update, count)),
        f"Online.update_into, {fast.engine}": (count, partial(_each, fast.update_into, count)),
        f"Online.update_many, {fast.engine}": (many, block),
    }
    for precision in ("double", "single"):
        subfolder = folder / f"{precision}-{count}"
        subfolder.mkdir()
        exported = accuracy.CompiledStep(build_code(step, precision == "single"), subfolder)
        ways[f"exported C, {precision}"] = (many, partial(exported, rows))
    return ways


def _each(update: Callable[[float, float], object], count: int) -> None:
    """So many samples, one by one."""
    for _ in range(count):
        update(0.3, 1.0)
