"""One step of the paper's loop on each engine: the virtual machine, one lane, a thousand lanes."""

from __future__ import annotations

import msgspec
import numpy as np

import undeadzone as uz
from benchmarks.engine.integration_error import scenario
from benchmarks.markdown import head, row
from benchmarks.timing import medians
from undeadzone.compile import interpret, lanes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import prepare
from undeadzone.util import tree

LANES = 1000


def table(rounds: int = 5) -> str:
    """Medians over interleaved rounds, one thread, nothing recorded."""
    columns = ("loop", "engine", "ns per step and run", "times faster than the virtual machine")
    lines = ["## Engines\n", *head(*columns)]
    for name in ("continuous", "sampled"):
        problem = scenario(1e-3, silence=False)
        simulation = msgspec.structs.replace(problem.simulation, duration=1.0, time=name)
        lines += _rows(name, msgspec.structs.replace(problem, simulation=simulation), rounds)
    return "\n".join([*lines, ""])


def _rows(name: str, problem: uz.Scenario, rounds: int) -> list[str]:
    """A row for each engine."""
    loop, state, exogenous = prepare(resolve_scenario(problem))
    params = tree.pack_tree(loop.params)
    alone = lanes.build_kernel(loop.step, record=[], width=1)
    many = lanes.build_kernel(loop.step, record=[], width=lanes.WIDTH)
    states = np.tile(state, (LANES, 1))
    programs = {
        "virtual machine": lambda: interpret.run_interpreted(loop.step, state, exogenous, params),
        "lanes, one run": lambda: lanes.run_lanes(alone, state, exogenous, params, threads=1),
        f"lanes, {LANES} runs": lambda: lanes.run_lanes(many, states, exogenous, params, threads=1),
    }
    runs = (1, 1, LANES)
    seconds = medians(programs, rounds)
    unit = seconds["virtual machine"] / len(exogenous)
    rows = []
    for (engine, value), count in zip(seconds.items(), runs, strict=True):
        each = value / count / len(exogenous)
        rows.append(row(name, engine, f"{1e9 * each:.3g}", f"{unit / each:.3g}"))
    return rows
