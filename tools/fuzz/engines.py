"""The same loop on CasADi's virtual machine, on compiled lanes and as compiled C: the same bits.

Lanes have elementary functions of their own, within 3 units of the last place: a loop that uses
some is compared to 1e-9 of the size of its signals.
"""

from __future__ import annotations

import functools
import random
import subprocess
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
from tests.undeadzone.compile.test_engines import distance, identical

from tools.fuzz.case import Case
from tools.fuzz.valid import Table, scenario
from undeadzone.compile import interpret, lanes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.simulation.simulate import prepare
from undeadzone.util import tree

CLOSE: Final = 1e-9  # of the size of a signal
OURS: Final = {
    getattr(ca, f"OP_{name}")
    for name in (
        *("SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH", "TANH", "EXP", "LOG"),
        *("ATAN2", "POW", "CONSTPOW", "ERF", "LOG1P", "EXPM1", "HYPOT"),
    )
    if hasattr(ca, f"OP_{name}")
}


def case(draw: random.Random) -> Case:
    """A scenario of any kind, run on three engines."""
    tables = scenario(draw, in_python=False)
    kind = f"{tables['observer']['method']}, {tables['simulation']['time']}"
    return Case(kind, {}, call=functools.partial(_compared, tables))


def _compared(tables: Table, folder: Path) -> None:
    """Run a scenario three times, and compare every bit of signals and final state."""
    problem = resolve_scenario(convert(tables))
    loop, state, exogenous = prepare(problem)
    params = tree.pack_tree(loop.params)
    expected = interpret.run_interpreted(loop.step, state, exogenous, params)
    in_c = interpret.run_interpreted(_in_c(loop.step, folder), state, exogenous, params)
    assert all(map(identical, in_c, expected)), "C differs from the virtual machine"
    outputs, finals = lanes.run_lanes(
        lanes.build_kernel(loop.step, width=8), state, exogenous, params
    )
    results = outputs[0], finals[0]
    if _elementary(loop.step):
        far = max(map(distance, results, expected))
        assert far < CLOSE or _diverged(expected), f"lanes differ by {far:.1e}"
    else:
        assert all(map(identical, results, expected)), "lanes differ from the virtual machine"


def _diverged(values: Any) -> bool:
    """Whether signals left all bounds: rounding then decides where."""
    return not all(np.abs(part).max(initial=0.0) < 1e9 for part in values)


def _elementary(step: ca.Function) -> bool:
    """Whether a graph holds functions that lanes have their own of."""
    codes = {step.instruction_id(k) for k in range(step.n_instructions())}
    return bool(codes & OURS)


def _in_c(step: ca.Function, folder: Path) -> ca.Function:
    """A step as compiled C."""
    generator = ca.CodeGenerator("step")
    generator.add(step)
    generator.generate(f"{folder}/")
    options = ["-O1", "-ffp-contract=off", "-fno-builtin", "-fPIC", "-shared"]
    files = [str(folder / "step.c"), "-o", str(folder / "step.so")]
    subprocess.run(["gcc", *options, *files, "-lm"], check=True)
    return ca.external("step", str(folder / "step.so"))
