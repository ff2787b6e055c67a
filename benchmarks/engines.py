"""One step of the paper's loop on each engine: CasADi's virtual machine, lanes alone and lanes of a thousand runs."""

from __future__ import annotations

import statistics
import time

import msgspec
import numpy as np

import undeadzone as uz
from benchmarks.accuracy import scenario
from undeadzone.engine import interpret, lanes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import prepare
from undeadzone.support import tree

LANES = 1000


def table(rounds: int = 5) -> str:
    """Medians over interleaved rounds, one thread, nothing recorded."""
    lines = [
        "## Engines\n",
        "| loop | engine | ns per step and run | times faster than the virtual machine |",
        "|---|---|---|---|",
    ]
    for name in ("continuous", "sampled"):
        problem = scenario(1e-3, silence=False)
        simulation = msgspec.structs.replace(problem.simulation, duration=1.0, time=name)
        lines += _rows(name, msgspec.structs.replace(problem, simulation=simulation), rounds)
    return "\n".join([*lines, ""])


def _rows(name: str, problem: uz.Scenario, rounds: int) -> list[str]:
    loop, state, exogenous = prepare(resolve_scenario(problem))
    params = tree.pack(loop.params)
    alone, many = (lanes.build(loop.step, record=[], width=width) for width in (1, lanes.WIDTH))
    states = np.tile(state, (LANES, 1))
    engines = {
        "virtual machine": (1, lambda: interpret.run(loop.step, state, exogenous, params)),
        "lanes, one run": (1, lambda: lanes.run(alone, state, exogenous, params, threads=1)),
        f"lanes, {LANES} runs": (
            LANES,
            lambda: lanes.run(many, states, exogenous, params, threads=1),
        ),
    }
    times: dict[str, list[float]] = {engine: [] for engine in engines}
    for _ in range(rounds):
        for engine, (runs, go) in engines.items():
            began = time.perf_counter()
            go()
            times[engine].append((time.perf_counter() - began) / runs / len(exogenous))
    medians = {engine: statistics.median(values) for engine, values in times.items()}
    unit = medians["virtual machine"]
    return [
        f"| {name} | {engine} | {1e9 * value:.3g} | {unit / value:.3g} |"
        for engine, value in medians.items()
    ]
