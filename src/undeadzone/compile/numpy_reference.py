"""Nodes computed in NumPy's float32 or float64: the bits that exported code must give."""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from undeadzone.compile.elementary import FUNCTIONS, formula
from undeadzone.compile.graph import Results, required_nodes

Evaluate = Callable[[dict[str, Any]], list[list[Any]]]


def replica(results: Results) -> Evaluate:
    """Return results as a function of inputs by their names, numbers or arrays of a type.

    Args:
        results: the nodes; there is at least one.
    """
    (kind,) = {node.kind for node in itertools.chain(*results)}
    return _evaluator(results, elementary(kind))


@functools.cache
def elementary(kind: str) -> dict[str, Callable[..., Any]]:
    """Return the elementary functions in float32 or float64, of numbers or arrays, by name."""
    functions: dict[str, Callable[..., Any]] = dict(_LIBRARY)
    for name in FUNCTIONS:
        functions[name] = _elementary(name, kind, functions)
    return functions


def _elementary(
    name: str, kind: str, functions: dict[str, Callable[..., Any]]
) -> Callable[..., Any]:
    """Return one function; those that it calls are made before."""
    shape = formula(name, kind)
    evaluate = _evaluator([[shape.result]], functions)

    def function(*arguments: Any) -> Any:
        return evaluate(dict(zip(shape.inputs, arguments, strict=True)))[0][0]

    return function


def _evaluator(results: Results, functions: dict[str, Callable[..., Any]]) -> Evaluate:
    """Return results as a function, where these functions are called.

    The graph is read once, since it is computed many times: operands are places in a list.
    """
    order = required_nodes(itertools.chain(*results))
    places = {node: place for place, node in enumerate(order)}
    begun: list[Any] = [None] * len(order)
    inputs, steps = [], []
    for node, place in places.items():
        if node.op == "input":
            inputs.append((place, node.text))
        elif node.op == "const":
            number = float(node.text) if node.is_real else int(node.text)
            begun[place] = np.dtype(node.kind).type(number)
        else:
            own = _OPERATIONS | {"view": operator.methodcaller("view", node.kind)}
            operation = functions[node.text] if node.op == "call" else own[node.op]
            taken: list[Any] = [places[one] for one in node.args]
            if len(taken) == 1:  # of it a slice, so that there is a sequence
                taken = [slice(taken[0], taken[0] + 1)]
            steps.append((place, operation, operator.itemgetter(*taken)))

    def evaluate(entries: dict[str, Any]) -> list[list[Any]]:
        values = begun.copy()
        for place, name in inputs:
            values[place] = entries[name]
        for place, operation, operands in steps:
            values[place] = operation(*operands(values))
        return [[values[places[node]] for node in result] for result in results]

    return evaluate


def _select(truth: Any, yes: Any, no: Any) -> Any:
    """Return one of two numbers, or of each two of arrays."""
    if isinstance(truth, np.ndarray):
        return np.where(truth, yes, no)
    return yes if truth else no


def _remainder(x: Any, y: Any) -> Any:
    """Return x - n y with n the whole number nearest to x / y, as C has it."""
    if not np.isfinite(x) or y == 0 or np.isnan(y):
        return x.dtype.type(np.nan)
    return x.dtype.type(math.remainder(float(x), float(y)))


_OPERATIONS: Final[dict[str, Callable[..., Any]]] = {
    **{"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv},
    **{"lt": operator.lt, "le": operator.le, "eq": operator.eq, "ne": operator.ne},
    **{"and": operator.and_, "or": operator.or_, "xor": operator.xor, "neg": operator.neg},
    **{"shl": operator.lshift, "shr": operator.rshift, "not": np.logical_not, "select": _select},
}
_LIBRARY: Final[dict[str, Callable[..., Any]]] = {
    "fabs": np.abs,
    "sqrt": np.sqrt,
    "fmod": np.fmod,
    "remainder": _remainder,
    "copysign": np.copysign,
}
