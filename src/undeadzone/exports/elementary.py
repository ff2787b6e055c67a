"""Elementary functions that give the same bits on every processor, for C and in Python.

Each is a formula (`tracing`), which becomes C and the Python replica alike.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from undeadzone.exports.coefficients import numbers
from undeadzone.exports.formulas import FUNCTIONS
from undeadzone.exports.instructions import BITWISE, uses_of
from undeadzone.exports.replica import replica
from undeadzone.exports.tracing import Formula, traced


def formula(name: str, single: bool) -> Formula:
    """The graph of an elementary function in a precision."""
    function = FUNCTIONS[name]
    return traced(functools.partial(function.build, numbers(single)), function.inputs)


def needed(names: set[str]) -> list[str]:
    """The functions and those that they call, in the order of `FUNCTIONS`."""
    closed = {name for name in names if name in FUNCTIONS}
    while True:
        more = set(closed)
        for name in closed:
            more.update(FUNCTIONS[name].needs)
        if more == closed:
            return [name for name in FUNCTIONS if name in closed]
        closed = more


def bitwise(names: list[str], single: bool) -> set[str]:
    """The functions of a number's bits that these functions call."""
    words: set[str] = set()
    for name in names:
        graph = formula(name, single).graph
        uses = uses_of(graph)
        used = {node.op for place, node in enumerate(graph.nodes) if uses[place]}
        words.update(BITWISE[op] for op in used & BITWISE.keys())
    return words


@functools.cache
def python(single: bool) -> dict[str, Callable[..., Any]]:
    """The functions in NumPy's float32 or float64, of numbers or arrays, by name."""
    functions: dict[str, Callable[..., Any]] = {}
    for name in FUNCTIONS:
        functions[name] = _python(name, single, functions)
    return functions


def _python(
    name: str, single: bool, functions: dict[str, Callable[..., Any]]
) -> Callable[..., Any]:
    """One function; those that it calls are made before."""
    shape = formula(name, single)
    evaluate = replica(shape.graph, single, functions)

    def function(*arguments: Any) -> Any:
        return evaluate(dict(zip(shape.inputs, arguments, strict=True)))[0][0]

    return function
