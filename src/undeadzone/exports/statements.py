"""A graph as the statements of a C function; what is used twice becomes a const local."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from undeadzone.compile.graph import Graph
from undeadzone.exports.expressions import Expressions, Style
from undeadzone.exports.instructions import BINARY, OWN, SELECT, is_condition, uses_of

WIDTH = 100  # columns of a line of C
LONGEST = 150  # characters of an expression that is not split into locals
INDENT = "    "
_REPEATED = (ca.OP_SQ,)  # instructions whose operand is written more than once
_SIGNS = (*BINARY, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV)
_APART = frozenset((SELECT, *OWN))  # what is computed before a selection, not inside it
SMALL = 300  # nodes up to which no sum or product stands in a selection (cppcheck's MISRA 12.1)


class Names(NamedTuple):
    """What a graph's inputs and results are called in C.

    Attributes:
        inputs: the expression of each input entry, by its text in the graph.
        results: for each result, where each of its entries goes (an lvalue).
        locals: for each result, the local that holds each of its entries.
        meanings: further names of locals, by their places.
    """

    inputs: dict[str, str]
    results: list[list[str]]
    locals: list[list[str]]
    meanings: dict[int, str]


class Body(NamedTuple):
    """The statements of a C function.

    Attributes:
        lines: the statements, indented and wrapped.
        functions: the export's own functions that they call.
    """

    lines: list[str]
    functions: set[str]


def body(graph: Graph, style: Style, names: Names) -> Body:
    """The statements that compute a graph's results and store them."""
    expressions = Expressions(graph, style, names.inputs)
    lines = _locals(graph, expressions, _labels(graph, names))
    if lines:
        lines.append("")
    for places, targets in zip(graph.results, names.results, strict=True):
        for place, target in zip(places, targets, strict=True):
            lines += wrapped(f"{target} = {expressions.value(place).text};")
    return Body(lines, expressions.functions)


def returned(graph: Graph, style: Style, inputs: dict[str, str], labels: dict[int, str]) -> Body:
    """The statements of a function that returns a graph's only result.

    Args:
        graph: the graph.
        style: how numbers and functions are written.
        inputs: the expression of each input entry, by its text in the graph.
        labels: names of locals, by their places.
    """
    expressions = Expressions(graph, style, inputs)
    lines = _locals(graph, expressions, labels)
    lines += wrapped(f"return {expressions.value(graph.results[0][0]).text};")
    return Body(lines, expressions.functions)


def _locals(graph: Graph, expressions: Expressions, labels: dict[int, str]) -> list[str]:
    """The statements that make the locals; `expressions` knows their names from then on."""
    uses = uses_of(graph)
    repeated = _repeated(graph)
    lines: list[str] = []
    for place, node in enumerate(graph.nodes):
        if not uses[place] or not node.operands:
            continue
        text = expressions.text(place).text
        needed = uses[place] > 1 or place in labels or place in repeated
        if needed or len(text) > LONGEST:
            name = labels.get(place, f"v{place}")
            kind = "bool" if is_condition(node) else expressions.style.real
            lines += wrapped(f"const {kind} {name} = {text};")
            expressions.names[place] = name
    return lines


def _labels(graph: Graph, names: Names) -> dict[int, str]:
    """The locals named after the results that they hold; the first result of a node names it."""
    labels: dict[int, str] = {}
    for places, results in zip(graph.results, names.locals, strict=True):
        for place, name in zip(places, results, strict=True):
            if graph.nodes[place].operands:
                labels.setdefault(place, name)
    return names.meanings | labels


def _repeated(graph: Graph) -> set[int]:
    """The nodes that stand apart: written twice otherwise, or a computation inside a selection."""
    repeated: set[int] = set()
    apart = _APART.union(_SIGNS) if len(graph.nodes) <= SMALL else _APART
    for node in graph.nodes:
        if node.op in _REPEATED:
            repeated.update(node.operands)
        if node.op == SELECT:
            for operand in node.operands[1:]:
                if graph.nodes[operand].op in apart:
                    repeated.add(operand)
    return {place for place in repeated if graph.nodes[place].operands}


def wrapped(statement: str) -> list[str]:
    """A statement in lines of at most `WIDTH` columns, broken before operators and after commas."""
    line = INDENT + statement
    lines: list[str] = []
    while len(line) > WIDTH:
        cut = _break(line)
        if cut < 0:
            break
        lines.append(line[:cut].rstrip())
        line = 2 * INDENT + line[cut:].lstrip()
    return [*lines, line]


def _break(line: str) -> int:
    """Where to break a line that is too long; -1: nowhere."""
    start = 2 * len(INDENT) + 4
    best = -1
    for sign in ("+", "-", "*", "/", "?", ":", "&&", "||", "="):
        best = max(best, line.rfind(f" {sign} ", start, WIDTH - 1))
    comma = line.rfind(", ", start, WIDTH - 1)
    return max(best, comma + 1 if comma >= 0 else -1)
