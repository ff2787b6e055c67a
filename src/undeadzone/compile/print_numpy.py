"""Nodes as Python in NumPy's float32 or float64: the bits that exported code must give."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from undeadzone.compile.elementary import FUNCTIONS, formula
from undeadzone.compile.graph import Node, Results, needed

_FORMS: Final = {
    **{"add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}", "neg": "-{}"},
    **{"lt": "{} < {}", "le": "{} <= {}", "eq": "{} == {}", "ne": "{} != {}"},
    **{"and": "{} & {}", "or": "{} | {}", "xor": "{} ^ {}", "shl": "{} << {}", "shr": "{} >> {}"},
    **{"not": "negated({})", "select": "select({}, {}, {})"},
}

Evaluate = Callable[[dict[str, Any]], list[list[Any]]]


def replica(results: Results) -> Evaluate:
    """Results as a function of inputs by their names, numbers or arrays of a type.

    Args:
        results: the nodes from which code is printed; there is at least one.
    """
    (kind,) = {node.kind for node in itertools.chain(*results)}
    return _made(results, elementary(kind))


@functools.cache
def elementary(kind: str) -> dict[str, Callable[..., Any]]:
    """The elementary functions in float32 or float64, of numbers or arrays, by name."""
    functions: dict[str, Callable[..., Any]] = {}
    for name in FUNCTIONS:
        functions[name] = _elementary(name, kind, functions)
    return functions


def _elementary(
    name: str, kind: str, functions: dict[str, Callable[..., Any]]
) -> Callable[..., Any]:
    """One function; those that it calls are made before."""
    shape = formula(name, kind)
    evaluate = _made([[shape.result]], functions)

    def function(*arguments: Any) -> Any:
        return evaluate(dict(zip(shape.inputs, arguments, strict=True)))[0][0]

    return function


def _made(results: Results, functions: dict[str, Callable[..., Any]]) -> Evaluate:
    """Results as a function, where these functions are called."""
    lines = ["def evaluate(entries):"]
    scope: dict[str, Any] = {**_LIBRARY, **functions}
    for node in needed(itertools.chain(*results)):
        if node.op == "const":
            scope[f"v{node.number}"] = _constant(node)
        else:
            lines.append(f"    v{node.number} = {_expression(node)}")
    entries = [", ".join([f"v{node.number}" for node in result]) for result in results]
    lines.append(f"    return [{', '.join([f'[{each}]' for each in entries])}]")
    exec("\n".join(lines), scope)
    evaluate: Evaluate = scope["evaluate"]
    return evaluate


def _constant(node: Node) -> Any:
    """What is written down."""
    of_type = np.dtype(node.kind).type
    return of_type(float(node.text) if node.is_real else int(node.text))


def _expression(node: Node) -> str:
    """The Python of an instruction."""
    if node.op == "input":
        return f"entries[{node.text!r}]"
    values = [f"v{arg.number}" for arg in node.args]
    if node.op == "view":
        return f"{values[0]}.view({node.kind!r})"
    if node.op == "call":
        return f"{node.text}({', '.join(values)})"
    return _FORMS[node.op].format(*values)


def _select(truth: Any, yes: Any, no: Any) -> Any:
    """One of two numbers, or of each two of arrays."""
    if isinstance(truth, np.ndarray):
        return np.where(truth, yes, no)
    return yes if truth else no


def _remainder(x: Any, y: Any) -> Any:
    """x - n y with n the whole number nearest to x / y, as C has it."""
    if not np.isfinite(x) or y == 0 or np.isnan(y):
        return x.dtype.type(np.nan)
    return x.dtype.type(math.remainder(float(x), float(y)))


_LIBRARY: Final = {
    "select": _select,
    "negated": np.logical_not,
    "fabs": np.abs,
    "sqrt": np.sqrt,
    "fmod": np.fmod,
    "remainder": _remainder,
    "copysign": np.copysign,
}
