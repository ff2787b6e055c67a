"""A CasADi SX graph printed as straight-line Python that numba compiles: one assignment per instruction, no branches.

Every instruction means to the last bit what it means on CasADi's virtual machine, NaN, infinities and the sign of
zero included; elementary functions are those of the C library, as there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca

from undeadzone.engine.graph import Graph, Node, listed, shortened, steady
from undeadzone.errors import InputError

HELPERS = '''
import math
from math import inf, nan

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

remainder = types.ExternalFunction("remainder", types.float64(types.float64, types.float64))


@intrinsic
def select(context, condition, yes, no):
    """yes where the condition holds, else no, without a branch."""
    return types.float64(types.boolean, types.float64, types.float64), lambda context, builder, signature, args: builder.select(*args)


@intrinsic
def fma(context, a, b, c):
    """a * b + c, rounded once."""
    return types.float64(types.float64, types.float64, types.float64), lambda context, builder, signature, args: builder.fma(*args)
'''

_FORMS = {
    ca.OP_ASSIGN: "{0}", ca.OP_LIFT: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}", ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}", ca.OP_INV: "1.0 / {0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}", ca.OP_FABS: "abs({0})",
    ca.OP_SIGN: "select({0} < 0.0, -1.0, select({0} > 0.0, 1.0, {0}))",
    ca.OP_FLOOR: "np.floor({0})", ca.OP_CEIL: "np.ceil({0})",
    ca.OP_FMOD: "np.fmod({0}, {1})", ca.OP_REMAINDER: "remainder({0}, {1})", ca.OP_CONSTPOW: "math.pow({0}, {1})",
    **{getattr(ca, f"OP_{name.upper()}"): f"math.{name}({{0}}, {{1}})" for name in ("pow", "atan2", "hypot", "copysign")},
    **{getattr(ca, f"OP_{name.upper()}"): f"math.{name}({{0}})" for name in (
        "sqrt", "exp", "expm1", "log", "log1p", "erf", "sin", "cos", "tan", "asin", "acos", "atan",
        "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    )},
}  # fmt: skip


# Instructions whose result is 1 or 0, as conditions; {0}, {1} of the last three are conditions too.
_CONDITIONS = {
    ca.OP_LT: "{0} < {1}", ca.OP_LE: "{0} <= {1}", ca.OP_EQ: "{0} == {1}", ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "{0} ^ True", ca.OP_AND: "{0} & {1}", ca.OP_OR: "{0} | {1}",
}  # fmt: skip

# A comparison of a difference of conditions, {0} - {1}, with 0, which stands on the left (0) or on the right (1).
_SIGNS = {
    (ca.OP_LT, 1): "{1} & ({0} ^ True)", (ca.OP_LT, 0): "{0} & ({1} ^ True)", (ca.OP_LE, 1): "{1} | ({0} ^ True)", (ca.OP_LE, 0): "{0} | ({1} ^ True)",
    **{(ca.OP_EQ, i): "{0} == {1}" for i in (0, 1)}, **{(ca.OP_NE, i): "{0} ^ {1}" for i in (0, 1)},
}  # fmt: skip


_SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)
_PARTS = (*_SUMS, ca.OP_MUL, ca.OP_SQ, ca.OP_TWICE, ca.OP_IF_ELSE_ZERO)
_PRINTED = {*_FORMS, *_CONDITIONS, ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO, ca.OP_INPUT, ca.OP_CONST}


class Code(NamedTuple):
    """Straight-line Python.

    reads: the entries of each input that it needs, named s3 for entry 3 of input s; statements: in order;
    results: for each output, the name that holds each entry in the end.
    """

    reads: list[list[int]]
    statements: list[str]
    results: list[list[str]]


class Lines(NamedTuple):
    """A graph about to be printed: its steady nodes, and how often each node is used by those that matter."""

    nodes: list[Node]
    steady: set[int]
    uses: Counter[int]


def straight_line(function: ca.Function, fused: bool = False) -> Code:
    """The code of an SX function with dense outputs, whose inputs named p are finite numbers.

    fused: print the graph `graph.shortened`, and sums of products with one rounding per product (`fma`): faster, and
    rounded otherwise than on the virtual machine. Raises InputError that names an instruction it cannot print.
    """
    graph = listed(function)
    if unknown := {node.op for node in graph.nodes} - _PRINTED:
        name = next(name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) in unknown)
        raise InputError(f"{function.name()}: the lanes engine has no instruction {name}; run this graph on the engine 'interpret'")
    graph = shortened(graph) if fused else graph
    lines = Lines(graph.nodes, steady(graph.nodes), _uses(graph))
    taken = _taken(lines) if fused else set()
    sums = _sums(lines, taken) if fused else {}
    statements: list[str] = []
    for k, node in enumerate(graph.nodes):
        if node.operands and lines.uses[k] and k not in taken:
            if node.op in _CONDITIONS:
                statements += [f"is_v{k} = {_condition(lines, node)}", f"v{k} = select(is_v{k}, 1.0, 0.0)"]
            elif not (fused and node.op in _SUMS):
                statements.append(f"v{k} = {_expression(lines, node)}")
        statements += sums.get(k, [])
    return Code(graph.reads, statements, [[_name(lines, k) for k in result] for result in graph.results])


def _uses(graph: Graph) -> Counter[int]:
    """How often each node is used by an output or by a node that matters."""
    uses = Counter(k for result in graph.results for k in result)
    for k in reversed(range(len(graph.nodes))):
        if uses[k]:
            uses.update(graph.nodes[k].operands)
    return uses


def _name(lines: Lines, k: int) -> str:
    return lines.nodes[k].text or f"v{k}"


def _expression(lines: Lines, node: Node) -> str:
    names = [_name(lines, operand) for operand in node.operands]
    if node.op == ca.OP_IF_ELSE_ZERO:
        return f"select({_truth(lines, node.operands[0])}, {names[1]}, 0.0)"
    if node.op in (ca.OP_FMIN, ca.OP_FMAX):
        # Only the second may be NaN unseen: put there what cannot be.
        a, b = names if _number(lines.nodes[node.operands[1]]) else names[::-1]
        compared = f"{a} {'<' if node.op == ca.OP_FMIN else '>'} {b}"
        known = any(_number(lines.nodes[operand]) for operand in node.operands)
        return f"select({compared}, {a}, {b})" if known else f"select(({compared}) | ({b} != {b}), {a}, {b})"
    return _FORMS[node.op].format(*names)


def _number(node: Node) -> bool:
    """Whether a node cannot be NaN."""
    return node.text.startswith("p") if node.op == ca.OP_INPUT else node.op == ca.OP_CONST and node.text != "nan"


def _condition(lines: Lines, node: Node) -> str:
    """The truth of a node of `_CONDITIONS`."""
    a, b = (lines.nodes[node.operands[i]] for i in (0, -1))
    if node.op in (ca.OP_NOT, ca.OP_AND, ca.OP_OR) or (node.op in (ca.OP_EQ, ca.OP_NE) and a.op in _CONDITIONS and b.op in _CONDITIONS):
        return _CONDITIONS[node.op].format(*(_truth(lines, operand) for operand in node.operands))
    for place, zero, other in ((0, a, b), (1, b, a)):
        if zero.text == "0.0" and other.op == ca.OP_SUB and all(lines.nodes[part].op in _CONDITIONS for part in other.operands):
            return _SIGNS[node.op, place].format(*(_truth(lines, part) for part in other.operands))
    return _CONDITIONS[node.op].format(*(_name(lines, operand) for operand in node.operands))


def _truth(lines: Lines, k: int) -> str:
    return f"is_v{k}" if lines.nodes[k].op in _CONDITIONS else f"({_name(lines, k)} != 0.0)"


def _taken(lines: Lines) -> set[int]:
    """The nodes that are printed as a part of the one sum that uses them."""
    taken: set[int] = set()
    for k in reversed(range(len(lines.nodes))):
        node = lines.nodes[k]
        if lines.uses[k] and k not in lines.steady and (node.op in _SUMS or (k in taken and node.op == ca.OP_MUL)):
            parts = _PARTS if node.op in _SUMS else (ca.OP_IF_ELSE_ZERO,)
            taken.update(part for part in node.operands if lines.uses[part] == 1 and lines.nodes[part].op in parts and part not in lines.steady)
    return taken


class Term(NamedTuple):
    """A term of a sum: the last node it needs, whether it is subtracted, factor * value, or 0 where the condition does not hold."""

    place: int
    minus: bool
    factor: str
    value: str
    condition: str


def _sums(lines: Lines, taken: set[int]) -> dict[int, list[str]]:
    """The statements of all sums by the node after which they stand.

    A term is added as soon as it is known, and what it needs can be forgotten; a plain one comes first where it costs no
    waiting, for a product then needs no instruction of its own; one under a condition is added where it holds, which is
    a single masked instruction where the processor has them.
    """
    found: dict[int, list[str]] = {}
    for k, node in enumerate(lines.nodes):
        if node.op not in _SUMS or not lines.uses[k] or k in taken:
            continue
        known = sorted(_terms(lines, taken, k, False))
        first = min(known[:2], key=lambda term: (term.condition != "", term.factor != ""))
        known.remove(first)
        place = first.place
        sign = "-" if first.minus else ""
        text = f"{first.factor} * {sign}{first.value}" if first.factor else f"{sign}{first.value}"
        text = f"select({first.condition}, {text}, 0.0)" if first.condition else text
        for i, term in enumerate(known):
            sign = "-" if term.minus else ""
            if term.condition:
                found.setdefault(max(place, term.place), []).append(f"t{k}_{i} = {text}")
                text = f"t{k}_{i}"
            more = f"fma({term.factor}, {sign}{term.value}, {text})" if term.factor else f"{text} {sign or '+'} {term.value}"
            place = max(place, term.place)
            found.setdefault(place, []).append(f"u{k}_{i} = {f'select({term.condition}, {more}, {text})' if term.condition else more}")
            text = f"u{k}_{i}"
        found.setdefault(k, []).append(f"v{k} = {text}")
    return found


def _terms(lines: Lines, taken: set[int], k: int, minus: bool) -> Iterator[Term]:
    """What a sum consists of."""
    node = lines.nodes[k]
    for place, part in enumerate(node.operands):
        inner = lines.nodes[part]
        negative = minus != (node.op == ca.OP_NEG or (node.op == ca.OP_SUB and place == 1))
        if part not in taken:
            yield Term(part, negative, "", _name(lines, part), "")
        elif inner.op in _SUMS:
            yield from _terms(lines, taken, part, negative)
        else:
            factor = "2.0" if inner.op == ca.OP_TWICE else "" if inner.op == ca.OP_IF_ELSE_ZERO else _name(lines, inner.operands[0])
            gate = part if inner.op == ca.OP_IF_ELSE_ZERO else inner.operands[-1]
            if gate in taken and lines.nodes[gate].op == ca.OP_IF_ELSE_ZERO:
                condition, value = lines.nodes[gate].operands
                yield Term(max(*inner.operands, condition, value), negative, factor, _name(lines, value), _truth(lines, condition))
            else:
                yield Term(max(inner.operands), negative, factor, _name(lines, inner.operands[-1]), "")
