"""What the first compilation of a loop takes: CPU s until it can run, and until it is best."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.engine.kernels import private_cache
from benchmarks.markdown import head, row
from undeadzone.compile import cache, lanes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import close_problem
from undeadzone_studies.ensemble import metrics

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = ("paper_5sin", "pendulum", "third_order", "censored", "ur5")
CENSORED = {"method": "censored", "right": [0.1, 1.0], "left": [0.1, 1.0]}
NOTE = """CPU seconds of one thread; nothing is kept on disk. For an ensemble: the loop with its
measures; for one run: the loop alone, without vectors. The first column of times ends when the
kernel can be called, the second when it has its best code, which a thread compiles.
"""


class Spent(NamedTuple):
    """CPU seconds until a kernel can be called, and until it is best."""

    first: float
    best: float


def table() -> str:
    """Each loop once."""
    columns = ("loop", "for", "instructions", "until it runs", "until it is best")
    lines = ["## First compilation\n", NOTE, *head(*columns)]
    with private_cache():
        for name in NAMES:
            lines += _rows(name)
    return "\n".join([*lines, ""])


def _scenario(name: str) -> Scenario:
    """An example; censored is the third-order one, sampled, with that filter."""
    if name != "censored":
        return read(EXAMPLES / f"{name}.toml")
    changes = {"observer": CENSORED, "simulation": {"time": "sampled", "step": 2e-3}}
    return read(EXAMPLES / "third_order.toml") | changes


def _rows(name: str) -> list[str]:
    """A loop for an ensemble and for one run."""
    problem = resolve_scenario(_scenario(name))
    loop = close_problem(problem)
    measured = metrics.add_metrics(loop, problem)
    parts = (loop.step, ()) if loop.parts is None else loop.parts
    many = _spent(measured.step, measured.rare, record=[], fused=True)
    one = _spent(*parts, width=1)
    counts = [measured.step.n_instructions(), parts[0].n_instructions()]
    rare = [sum(part.n_instructions() for part in of) for of in (measured.rare, parts[1])]
    rows = []
    cells = zip(("ensemble", "one run"), (many, one), counts, rare, strict=True)
    for what, spent, count, more in cells:
        counts_text = f"{count}" + (f", rare {more}" if more else "")
        rows.append(row(name, what, counts_text, f"{spent.first:.2f}", f"{spent.best:.2f}"))
    return rows


def _spent(*parts: object, **options: object) -> Spent:
    """What a kernel takes."""
    cache.load_or_compile.cache_clear()
    began = time.process_time()
    kernel = lanes.build_kernel(*parts, **options)
    first = time.process_time() - began
    kernel.block.wait_until_best()
    return Spent(first, time.process_time() - began)
