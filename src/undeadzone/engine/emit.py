"""A CasADi SX graph printed as straight-line Python that numba compiles.

There is one assignment per instruction and no branch. Every instruction means to the last bit what
it means on CasADi's virtual machine, NaN, infinities and the sign of zero included; elementary
functions are those of the C library, as there. With fused sums, those of `elementary` take their
place, so that all of a lane is vectorised.
"""

from __future__ import annotations

import inspect
from typing import NamedTuple

import casadi as ca

from undeadzone.engine import elementary
from undeadzone.engine.graph import Graph, Node, listed, shortened
from undeadzone.engine.sums import SUMS, Lines, lines_of, name, summed, taken_in, truth
from undeadzone.errors import InputError

# What straight-line code calls: selection and fused multiplication without a branch.
HELPERS = '''
import math
from math import inf, nan

import numpy as np
from numba import carray, njit, types
from numba.extending import intrinsic

remainder = types.ExternalFunction("remainder", types.float64(types.float64, types.float64))


@intrinsic
def select(context, condition, yes, no):
    """yes where the condition holds, else no, without a branch."""

    def selected(context, builder, signature, args):
        return builder.select(*args)

    return types.float64(types.boolean, types.float64, types.float64), selected


@intrinsic
def fma(context, a, b, c):
    """a * b + c, rounded once."""

    def fused(context, builder, signature, args):
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), fused
'''

# What the text of `elementary` calls besides.
_ARITHMETIC = '''

@intrinsic
def bits(context, x):
    """The bits of a number."""

    def cast(context, builder, signature, args):
        return builder.bitcast(args[0], context.get_value_type(types.uint64))

    return types.uint64(types.float64), cast


@intrinsic
def number(context, x):
    """The number that has these bits."""

    def cast(context, builder, signature, args):
        return builder.bitcast(args[0], context.get_value_type(types.float64))

    return types.float64(types.uint64), cast


@intrinsic
def polynomial(context, x, coefficients):
    """coefficients[0] + coefficients[1] x + ...

    Even and odd powers apart, so that half as many roundings wait for each other.
    """

    def nested(context, builder, signature, args):
        x = args[0]
        parts = [builder.extract_value(args[1], i) for i in range(len(coefficients))]
        square, halves = builder.fmul(x, x), []
        for *lower, value in (parts[0::2], parts[1::2]):
            for part in reversed(lower):
                value = builder.fma(value, square, part)
            halves.append(value)
        return builder.fma(halves[1], x, halves[0])

    return types.float64(types.float64, coefficients), nested
'''

# Functions of the C library, of one number and of two.
_OF_ONE = (
    *("sqrt", "exp", "expm1", "log", "log1p", "erf", "sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
_OF_TWO = ("pow", "atan2", "hypot", "copysign")


def _instruction(word: str) -> int:
    """CasADi's number of an instruction."""
    return int(getattr(ca, f"OP_{word.upper()}"))


# The text of an instruction; {0} and {1} are its operands.
_FORMS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_LIFT: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_FABS: "abs({0})",
    ca.OP_SIGN: "select({0} < 0.0, -1.0, select({0} > 0.0, 1.0, {0}))",
    ca.OP_FLOOR: "np.floor({0})",
    ca.OP_CEIL: "np.ceil({0})",
    ca.OP_FMOD: "np.fmod({0}, {1})",
    ca.OP_REMAINDER: "remainder({0}, {1})",
    ca.OP_CONSTPOW: "math.pow({0}, {1})",
    **{_instruction(word): f"math.{word}({{0}}, {{1}})" for word in _OF_TWO},
    **{_instruction(word): f"math.{word}({{0}})" for word in _OF_ONE},
}

# With fused sums, the functions of `elementary`.
_FUSED = _FORMS | {_instruction(word): f"{word}({{0}})" for word in elementary.FUNCTIONS}

# Instructions whose result is 1 or 0, as conditions; {0}, {1} of the last three are conditions too.
_CONDITIONS = {
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "{0} ^ True",
    ca.OP_AND: "{0} & {1}",
    ca.OP_OR: "{0} | {1}",
}

# A comparison of a difference of conditions, {0} - {1}, with 0, which stands on the left (0) or on
# the right (1).
_SIGNS = {
    (ca.OP_LT, 1): "{1} & ({0} ^ True)",
    (ca.OP_LT, 0): "{0} & ({1} ^ True)",
    (ca.OP_LE, 1): "{1} | ({0} ^ True)",
    (ca.OP_LE, 0): "{0} | ({1} ^ True)",
    (ca.OP_EQ, 0): "{0} ^ {1} ^ True",
    (ca.OP_EQ, 1): "{0} ^ {1} ^ True",
    (ca.OP_NE, 0): "{0} ^ {1}",
    (ca.OP_NE, 1): "{0} ^ {1}",
}

# Comparisons of conditions; numba compares booleans as numbers, which costs more.
_SAME = {ca.OP_EQ: "{0} ^ {1} ^ True", ca.OP_NE: "{0} ^ {1}"}

_OTHERS = {ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO, ca.OP_INPUT, ca.OP_CONST}
_PRINTED = _OTHERS.union(_FORMS, _CONDITIONS)


class Code(NamedTuple):
    """Straight-line Python.

    Attributes:
        reads: the entries of each input that it needs, named s3 for entry 3 of input s.
        statements: in order.
        results: for each output, the name that holds each entry in the end.
    """

    reads: list[list[int]]
    statements: list[str]
    results: list[list[str]]


def helpers(fused: bool) -> str:
    """The text of what straight-line code calls."""
    if not fused:
        return HELPERS
    inlined = [
        f'{name} = njit(forceinline=True, error_model="numpy")({name})'
        for name in elementary.COMPILED
    ]
    return "\n".join([inspect.getsource(elementary), HELPERS, _ARITHMETIC, *inlined, ""])


def straight_line(function: ca.Function, fused: bool = False) -> Code:
    """The code of an SX function.

    Args:
        function: with dense outputs; its inputs named p are finite numbers.
        fused: print the graph `graph.shortened`, sums of products with one rounding per product
            (`fma`) and functions of `elementary`: faster, and rounded otherwise than on the virtual
            machine.

    Raises:
        InputError: an instruction that cannot be printed; it names it.
    """
    graph = listed(function)
    _require_printable(function.name(), graph)
    graph = shortened(graph) if fused else graph
    lines = lines_of(graph)
    taken = taken_in(lines) if fused else set()
    sums = summed(lines, taken) if fused else {}
    statements: list[str] = []
    for k, node in enumerate(graph.nodes):
        is_sum = fused and node.op in SUMS
        if node.operands and lines.uses[k] and k not in taken and not is_sum:
            statements += _statements(lines, k, _FUSED if fused else _FORMS)
        statements += sums.get(k, [])
    results = []
    for result in graph.results:
        results.append([name(lines, k) for k in result])
    return Code(graph.reads, statements, results)


def _require_printable(title: str, graph: Graph) -> None:
    """Raise InputError that names an instruction that cannot be printed."""
    unknown = {node.op for node in graph.nodes} - _PRINTED
    for word in dir(ca):
        if word.startswith("OP_") and getattr(ca, word) in unknown:
            raise InputError(
                f"{title}: the lanes engine has no instruction {word}; "
                "run this graph on the engine 'interpret'"
            )


def _statements(lines: Lines, k: int, forms: dict[int, str]) -> list[str]:
    """What computes a node; of a condition, its truth too."""
    node = lines.nodes[k]
    if node.op in _CONDITIONS:
        return [f"is_v{k} = {_condition(lines, node)}", f"v{k} = select(is_v{k}, 1.0, 0.0)"]
    return [f"v{k} = {_expression(lines, node, forms)}"]


def _expression(lines: Lines, node: Node, forms: dict[int, str]) -> str:
    """The value of a node."""
    names = [name(lines, operand) for operand in node.operands]
    if node.op == ca.OP_IF_ELSE_ZERO:
        return f"select({truth(lines, node.operands[0])}, {names[1]}, 0.0)"
    if node.op in (ca.OP_FMIN, ca.OP_FMAX):
        return _extreme(lines, node)
    return forms[node.op].format(*names)


def _extreme(lines: Lines, node: Node) -> str:
    """The lesser or greater of two numbers; the other one where one is NaN."""
    a, b = (name(lines, operand) for operand in node.operands)
    known_a, known_b = (_is_number(lines.nodes[operand]) for operand in node.operands)
    if not known_b:
        a, b = b, a  # only the second may be NaN unseen: put there what cannot be
    compared = f"{a} {'<' if node.op == ca.OP_FMIN else '>'} {b}"
    if known_a or known_b:
        return f"select({compared}, {a}, {b})"
    return f"select(({compared}) | ({b} != {b}), {a}, {b})"


def _is_number(node: Node) -> bool:
    """Whether a node cannot be NaN."""
    if node.op == ca.OP_INPUT:
        return node.text.startswith("p")
    return node.op == ca.OP_CONST and node.text != "nan"


def _condition(lines: Lines, node: Node) -> str:
    """The truth of a node of `_CONDITIONS`."""
    a, b = lines.nodes[node.operands[0]], lines.nodes[node.operands[-1]]
    if node.op in (ca.OP_NOT, ca.OP_AND, ca.OP_OR):
        return _of_truths(_CONDITIONS[node.op], lines, node)
    if node.op in _SAME and a.op in _CONDITIONS and b.op in _CONDITIONS:
        return _of_truths(_SAME[node.op], lines, node)
    if node.op == ca.OP_LT and a.text == "0.0" and b.op in _CONDITIONS:
        return truth(lines, node.operands[1])
    for place, zero, other in ((0, a, b), (1, b, a)):
        if zero.text == "0.0" and _is_difference(lines, other):
            return _of_truths(_SIGNS[node.op, place], lines, other)
    return _CONDITIONS[node.op].format(*(name(lines, operand) for operand in node.operands))


def _of_truths(form: str, lines: Lines, node: Node) -> str:
    """A form of the truths of a node's operands."""
    return form.format(*(truth(lines, operand) for operand in node.operands))


def _is_difference(lines: Lines, node: Node) -> bool:
    """Whether a node is a difference of conditions."""
    if node.op != ca.OP_SUB:
        return False
    return all(lines.nodes[part].op in _CONDITIONS for part in node.operands)
