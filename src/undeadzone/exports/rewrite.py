"""A graph rewritten for C: conditions and selections in place of products with 0 and 1.

Every bit is kept but the sign of zero. A value that is NaN where a condition fails travels as the
pair (condition, number), so that the code computes with numbers alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca

from undeadzone.compile.graph import CONDITIONS, Graph, Node
from undeadzone.exports.rewriting import Rewriting

_LOGIC = (ca.OP_NOT, ca.OP_AND, ca.OP_OR)


class Value(NamedTuple):
    """What a node of the old graph is in the new one.

    Attributes:
        place: the new node; a number in any case.
        only: the condition without which the value is NaN; None: it is never NaN for that reason.
    """

    place: int
    only: int | None = None


def rewritten(graph: Graph) -> Graph:
    """The same values of conditions, selections and numbers; NaN is left in results alone."""
    nodes = Rewriting([], {})
    values: list[Value] = []
    for node in graph.nodes:
        values.append(_value(nodes, node, [values[operand] for operand in node.operands]))
    results = []
    for result in graph.results:
        results.append([_outgoing(nodes, values[place]) for place in result])
    return Graph(nodes.nodes, results, graph.reads)


def _value(nodes: Rewriting, node: Node, operands: list[Value]) -> Value:
    """A node of the old graph, whose operands are known."""
    if node.op == ca.OP_CONST and math.isnan(float(node.text)):
        return Value(nodes.constant(0.0), nodes.constant(0.0))
    if all(operand.only is None for operand in operands):
        places = [operand.place for operand in operands]
        return Value(nodes.made(node.op, places, node.text))
    if node.op in CONDITIONS:
        return Value(_compared(nodes, node.op, operands))
    if node.op == ca.OP_IF_ELSE_ZERO:
        return _gated(nodes, *operands)
    if node.op in (ca.OP_FMIN, ca.OP_FMAX):
        return _least(nodes, node.op, *operands)
    only = _all(nodes, [operand.only for operand in operands])
    return Value(nodes.made(node.op, [operand.place for operand in operands]), only)


def _outgoing(nodes: Rewriting, value: Value) -> int:
    """The node of a result."""
    if value.only is None:
        return value.place
    return nodes.selected(value.only, value.place, nodes.constant(math.nan))


def _compared(nodes: Rewriting, op: int, operands: list[Value]) -> int:
    """A condition on such values: no comparison with NaN holds but !=, and NaN is true."""
    only = _all(nodes, [operand.only for operand in operands])
    places = [operand.place for operand in operands]
    if op in _LOGIC:
        truths = [_true(nodes, operand) for operand in operands]
        return nodes.made(op, truths)
    plain = nodes.made(op, [nodes.under(only, place) for place in places])
    if op == ca.OP_NE:
        return nodes.either(nodes.negated(only), plain)
    return nodes.both(only, plain)


def _true(nodes: Rewriting, value: Value) -> int:
    """Such a value as a condition."""
    truth = nodes.truth(value.place)
    return truth if value.only is None else nodes.either(nodes.negated(value.only), truth)


def _gated(nodes: Rewriting, gate: Value, value: Value) -> Value:
    """A value where the gate holds, else 0."""
    condition = _true(nodes, gate)
    place = nodes.selected(condition, value.place, nodes.constant(0.0))
    if value.only is None or nodes.implies(condition, value.only):
        return Value(place)
    return Value(place, nodes.either(nodes.negated(condition), value.only))


def _least(nodes: Rewriting, op: int, a: Value, b: Value) -> Value:
    """The smaller or larger of two values; a number beats NaN."""
    both = nodes.made(op, [a.place, b.place])
    if a.only == b.only:
        return Value(both, a.only)
    if a.only is None or b.only is None:
        only = a.only if b.only is None else b.only
        assert only is not None
        return Value(nodes.selected(only, both, b.place if b.only is None else a.place))
    first = nodes.selected(b.only, both, a.place)
    return Value(nodes.selected(a.only, first, b.place), nodes.either(a.only, b.only))


def _all(nodes: Rewriting, conditions: list[int | None]) -> int:
    """Where all conditions hold; there is at least one."""
    known = [condition for condition in conditions if condition is not None]
    result = known[0]
    for condition in known[1:]:
        result = nodes.both(result, condition)
    return result
