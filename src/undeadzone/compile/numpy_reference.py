"""Reference evaluator of nodes in NumPy's float32 or float64, with the bits of exported code."""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np

from undeadzone.compile.elementary import FUNCTIONS, build_elementary
from undeadzone.compile.graph import LANGUAGES, Results, required_nodes
from undeadzone.compile.repeats import Part

Evaluate = Callable[[dict[str, Any]], list[list[Any]]]


def reference_evaluator(results: Results, parts: Iterable[Part] = ()) -> Evaluate:
    """Return the results as a function of inputs by name (numbers or arrays of a type).

    Args:
        results: the nodes. There is at least one.
        parts: functions that they call, each after those that it calls.
    """
    (kind,) = {node.kind for node in itertools.chain(*results)}
    functions = dict(elementary_functions(kind))
    for part in parts:
        functions[part.name] = _build_part(part, functions)
    return _build_evaluator(results, functions)


def _build_part(part: Part, functions: dict[str, Callable[..., Any]]) -> Callable[..., list[Any]]:
    """Return a part as a function. The functions that it calls are built before."""
    evaluate = _build_evaluator([part.results], functions)
    names = [node.text for node in part.inputs]
    return lambda *arguments: evaluate(dict(zip(names, arguments, strict=True)))[0]


@functools.cache
def elementary_functions(kind: str) -> dict[str, Callable[..., Any]]:
    """Return the elementary functions of numbers or arrays in float32 or float64, by name."""
    functions: dict[str, Callable[..., Any]] = dict(_LIBRARY)

    def build_function(name: str) -> Callable[..., Any]:
        """Return a function. The functions that it calls are built before."""
        part = _build_part(build_elementary(name, kind), functions)
        return lambda *arguments: part(*arguments)[0]

    for name in FUNCTIONS:
        functions[name] = build_function(name)
    return functions


def _build_evaluator(results: Results, functions: dict[str, Callable[..., Any]]) -> Evaluate:
    """Return the results as a function that calls the given elementary functions.

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
            if node.op == "part":
                operation: Callable[..., Any] = operator.itemgetter(int(node.text))
            else:
                is_call = node.op in ("call", "apply")
                operation = functions[node.text] if is_call else own[node.op]
            indices: list[Any] = [places[one] for one in node.args]
            if len(indices) == 1:  # of it a slice, so that there is a sequence
                indices = [slice(indices[0], indices[0] + 1)]
            steps.append((place, operation, operator.itemgetter(*indices)))

    def evaluate(entries: dict[str, Any]) -> list[list[Any]]:
        """Evaluate the results, given the inputs by name."""
        values = begun.copy()
        for place, name in inputs:
            values[place] = entries[name]
        for place, operation, operands in steps:
            values[place] = operation(*operands(values))
        return [[values[places[node]] for node in result] for result in results]

    return evaluate


def _select_value(truth: Any, yes: Any, no: Any) -> Any:
    """Select one of two numbers by a truth, entry by entry for arrays."""
    if isinstance(truth, np.ndarray):
        return np.where(truth, yes, no)
    return yes if truth else no


def _ieee_remainder(x: Any, y: Any) -> Any:
    """Return x - n y with n the integer nearest to x / y, as C's `remainder`."""
    if not np.isfinite(x) or y == 0 or np.isnan(y):
        return x.dtype.type(np.nan)
    return x.dtype.type(math.remainder(float(x), float(y)))


_PYTHON: Final = LANGUAGES["python"]
_OPERATIONS: Final[dict[str, Callable[..., Any]]] = {
    **dict(zip(_PYTHON, operator.attrgetter(*_PYTHON.values())(operator), strict=True)),
    **{"not": np.logical_not, "select": _select_value},
}
_LIBRARY: Final[dict[str, Callable[..., Any]]] = {
    "fabs": np.abs,
    "sqrt": np.sqrt,
    "fmod": np.fmod,
    "remainder": _ieee_remainder,
    "copysign": np.copysign,
}
