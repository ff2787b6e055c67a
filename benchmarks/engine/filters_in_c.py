"""Ensembles of the recommended filters beside the same filters printed as C and compiled by gcc."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import undeadzone as uz
from benchmarks.firmware.emulated_c import ROOT
from benchmarks.markdown import head, row
from benchmarks.timing import least
from undeadzone.compile import lanes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_export import accuracy, exported_step
from undeadzone_export.code import build_code, count_operations
from undeadzone_export.exported_step import ExportedStep
from undeadzone_export.selftest_vectors import record_inputs

RUNS, STEPS = 1000, 50
OPTIONS = ("-O3", "-march=native", "-ffp-contract=fast")
NOTE = f"""us per step and run, of {RUNS} runs over {STEPS} readings each of its own, on one thread:
least CPU time of interleaved rounds. C is what `export` prints in double, in a loop over the
runs, compiled with `{" ".join(OPTIONS)}`; lanes are what `ensemble` computes in.
"""


def table(rounds: int = 5) -> str:
    """The table."""
    columns = ("filter", "operations", "gcc", "lanes", "lanes / gcc")
    lines = ["## Ensembles of filters\n", NOTE, *head(*columns)]
    for name, scenario in cases().items():
        lines.append(_row(name, scenario, rounds))
    return "\n".join([*lines, ""])


def cases() -> dict[str, Scenario]:
    """Scenarios by the name of their row."""
    return {
        "`auto`, the template": uz.read(ROOT / "src" / "undeadzone" / "template.toml"),
        "`extended`, two links": uz.read(ROOT / "examples" / "two_link.toml"),
    }


def _row(name: str, scenario: Scenario, rounds: int) -> str:
    """One filter."""
    problem = resolve_scenario(scenario)
    step = exported_step.build_step(problem)
    rows = record_inputs(problem, step)
    readings = np.stack([rows[k % len(rows) :][:STEPS] for k in range(RUNS)])
    with tempfile.TemporaryDirectory() as folder:
        ways = {"gcc": by_gcc(step, readings, Path(folder)), "lanes": in_lanes(step, readings)}
        seconds = least(ways, rounds, time.process_time)
    each = {way: 1e6 * value / RUNS / STEPS for way, value in seconds.items()}
    count = f"{sum(count_operations(build_code(step, False).results).values()):,}"
    ratios = (f"{each['gcc']:.3g}", f"{each['lanes']:.3g}", f"{each['lanes'] / each['gcc']:.2f}")
    return row(name, count, *ratios)


def by_gcc(step: ExportedStep, readings: Floats, folder: Path) -> Callable[[], Floats]:
    """The filter in C, run after run."""
    compiled = accuracy.CompiledStep(build_code(step, False), folder, OPTIONS)

    def run() -> Floats:
        ends = []
        for each in readings:
            compiled.reset_memory()
            ends.append(compiled(each)[-1])
        return np.stack(ends)

    return run


def in_lanes(step: ExportedStep, readings: Floats) -> Callable[[], Floats]:
    """The filter as ensembles compute it, all runs side by side."""
    count, inputs = len(readings), readings.shape[2]
    kernel = lanes.build_kernel(
        step.function, exogenous=range(inputs), record=(), fused=True, fast_start=False
    )
    states = np.tile(step.start, (count, 1))
    own = np.ascontiguousarray(readings.transpose(1, 2, 0))
    shared = np.zeros((readings.shape[1], inputs))

    def run() -> Floats:
        return lanes.run_lanes(kernel, states, shared, step.defaults, own, threads=1)[1]

    return run
