"""A graph as Python in NumPy's float32 or float64: the bits that the C must give."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile.graph import CONDITIONS, Graph, Node
from undeadzone.exports.expressions import held
from undeadzone.exports.instructions import BINARY, BITWISE, LIBRARY, OWN, SELECT, uses_of

Numbers = np.ndarray[Any, np.dtype[Any]]


class Arithmetic(NamedTuple):
    """A floating-point type.

    Attributes:
        single: whether it is float32, else float64.
        real: the type.
        word: the unsigned integer of its size.
        mantissa: bits of its fraction.
        bias: what its exponent is stored above.
        half: bits of sqrt(1/2).
    """

    single: bool
    real: Any
    word: Any
    mantissa: int
    bias: int
    half: int


SINGLE = Arithmetic(True, np.float32, np.uint32, 23, 127, 0x3F3504F3)
DOUBLE = Arithmetic(False, np.float64, np.uint64, 52, 1023, 0x3FE6A09E667F3BCD)


def arithmetic(single: bool) -> Arithmetic:
    """The floating-point type of a precision."""
    return SINGLE if single else DOUBLE


def replica(
    graph: Graph, single: bool, functions: dict[str, Callable[..., Any]]
) -> Callable[..., list[Any]]:
    """The graph as a function of the entries of its inputs, by name, to its results.

    Args:
        graph: the graph, as the C is printed from it.
        single: whether to compute in float32, else float64.
        functions: the export's own functions in this arithmetic, by name.

    Returns:
        Takes a dictionary from the texts of the input entries to numbers or arrays of that type;
        gives a list of values per result.
    """
    kind = arithmetic(single)
    uses = uses_of(graph)
    lines = ["def evaluate(entries):"]
    constants: dict[str, Any] = {}
    for place, node in enumerate(graph.nodes):
        if not uses[place]:
            continue
        if node.op == ca.OP_CONST:
            constants[f"v{place}"] = kind.real(held(float(node.text), single))
        else:
            lines.append(f"    v{place} = {_expression(graph, node)}")
    for k, result in enumerate(graph.results):
        entries = ", ".join(_number(graph, place) for place in result)
        lines.append(f"    result{k} = [{entries}]")
    names = ", ".join(f"result{k}" for k in range(len(graph.results)))
    lines.append(f"    return [{names}]")
    scope: dict[str, Any] = {**constants, **_library(kind), **functions}
    exec("\n".join(lines), scope)
    evaluate: Callable[..., list[Any]] = scope["evaluate"]
    return evaluate


def _expression(graph: Graph, node: Node) -> str:
    """The Python expression of an instruction."""
    if node.op == ca.OP_INPUT:
        return f"entries[{node.text!r}]"
    if node.op == SELECT:
        condition = _condition(graph, node.operands[0])
        yes, no = (_number(graph, operand) for operand in node.operands[1:])
        return f"select({condition}, {yes}, {no})"
    if node.op in (ca.OP_AND, ca.OP_OR):
        a, b = (_condition(graph, operand) for operand in node.operands)
        return f"{a} {'&' if node.op == ca.OP_AND else '|'} {b}"
    if node.op == ca.OP_NOT:
        return f"negated({_condition(graph, node.operands[0])})"
    values = [_number(graph, operand) for operand in node.operands]
    if node.op in BINARY:
        return f"{values[0]} {BINARY[node.op]} {values[1]}"
    if node.op in _PLAIN:
        return _PLAIN[node.op].format(*values)
    name = LIBRARY.get(node.op) or BITWISE.get(node.op) or OWN[node.op]
    return f"{name}({', '.join(values)})"


_PLAIN = {
    ca.OP_NEG: "-{0}",
    ca.OP_INV: "one / {0}",
    ca.OP_TWICE: "two * {0}",
    ca.OP_SQ: "{0} * {0}",
}


def _number(graph: Graph, place: int) -> str:
    """A node as a number."""
    if graph.nodes[place].op in CONDITIONS:
        return f"select(v{place}, one, zero)"
    return f"v{place}"


def _condition(graph: Graph, place: int) -> str:
    """A node as a condition."""
    return f"v{place}" if graph.nodes[place].op in CONDITIONS else f"(v{place} != zero)"


def _library(kind: Arithmetic) -> dict[str, Any]:
    """What the expressions call, in a floating-point type."""
    real = kind.real

    def select(condition: Any, yes: Any, no: Any) -> Any:
        if isinstance(condition, np.ndarray):
            return np.where(condition, yes, no)
        return yes if condition else no

    def power(x: Any) -> Any:
        exponents = np.asarray(x).astype(np.int64) + kind.bias
        return (exponents.astype(kind.word) << kind.word(kind.mantissa)).view(real)[()]

    def exponent(x: Any) -> Any:
        return (_raised(x, kind) >> kind.word(kind.mantissa)).astype(real) - real(kind.bias)

    def fraction(x: Any) -> Any:
        mask = kind.word((1 << kind.mantissa) - 1)
        return ((_raised(x, kind) & mask) + kind.word(kind.half)).view(real)[()]

    return {
        "one": real(1.0),
        "two": real(2.0),
        "zero": real(0.0),
        "select": select,
        "negated": np.logical_not,
        "truncated": np.trunc,
        "power": power,
        "exponent": exponent,
        "fraction": fraction,
        "sqrt": np.sqrt,
        "fmod": np.fmod,
        "remainder": _remainder,
        "copysign": np.copysign,
    }


def _raised(x: Any, kind: Arithmetic) -> Any:
    """The bits of positive numbers, moved so that the exponent changes at sqrt(2)."""
    one = kind.bias << kind.mantissa
    bits = np.asarray(x, kind.real).view(kind.word)
    return bits + kind.word(one - kind.half)


def _remainder(x: Any, y: Any) -> Any:
    """x - n y with n the whole number nearest to x / y, as C has it."""
    import math

    if not np.isfinite(x) or y == 0 or np.isnan(y):
        return x.dtype.type(np.nan)
    return x.dtype.type(math.remainder(float(x), float(y)))
