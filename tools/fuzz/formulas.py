"""Formulas of a plant: from the grammar, and damaged."""

from __future__ import annotations

import functools
import random
from pathlib import Path

from tools.fuzz.case import Case
from tools.fuzz.damage import NUMBERS, bent
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant

NAMES = ("x", "v", "u", "k", "pi", "nothing", "__import__", "sin", "e")
CALLS = ("sin", "cos", "tan", "asin", "atan2", "exp", "log", "sqrt", "abs", "sign", "min", "eval")
BETWEEN = ("+", "-", "*", "/", "**", "//", "%", "<", " and ", "@", "if")


def case(draw: random.Random) -> Case:
    """A plant of two states whose second equation is a random formula."""
    formula = _formula(draw, 0)
    kind = "grammar"
    if draw.random() < 0.3:
        kind = "damaged"
        formula = bent(draw, formula.encode()).decode("utf-8", "replace")
    if draw.random() < 0.02:
        kind = "deep"
        formula = draw.choice(("(", "-", "sin(", "x+", "2**")) * draw.choice((50, 2000, 100_000))
        formula += "x"
    return Case(kind, {}, call=functools.partial(_build, formula))


def _build(formula: str, folder: Path) -> None:
    """A plant with a formula."""
    plant = Plant(
        states=["x", "v"], f=["v", formula], h=["x"], parameters={"k": 2.0}, x0=[0.1, 0.0]
    )
    model = system(plant)
    assert (model.n, model.m, model.p) == (2, 1, 1)


def _formula(draw: random.Random, depth: int) -> str:
    """A formula, mostly of the grammar."""
    kind = draw.randrange(8 if depth < 5 else 3)
    if kind == 0:
        return draw.choice(NAMES[:5] if draw.random() < 0.95 else NAMES)
    if kind == 1:
        return draw.choice(("0", "1", "2.5", "1e-9", "1e400", "0x10", "1_0", "1j", "True"))
    if kind == 2:
        return f"{draw.choice(NUMBERS):.3g}" if draw.random() < 0.2 else draw.choice(NAMES[:4])
    if kind == 3:
        return f"-{_formula(draw, depth + 1)}"
    if kind == 4:
        arguments = [_formula(draw, depth + 1) for _ in range(draw.choice((1, 1, 1, 2, 2, 0)))]
        return f"{draw.choice(CALLS)}({', '.join(arguments)})"
    sign = draw.choice(BETWEEN[:5] if draw.random() < 0.95 else BETWEEN)
    return f"({_formula(draw, depth + 1)} {sign} {_formula(draw, depth + 1)})"
