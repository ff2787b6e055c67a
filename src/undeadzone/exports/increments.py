"""Sums in increments for single precision: c x + ... with c near 1 is x + ((c - 1) x + ...).

A number near 1 holds c - 1 to a few digits only; c - 1 by itself is held to all of them. At 1 ms,
0.9999995f would hold a drift of -5e-7 to 12 %.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from undeadzone.engine.graph import Graph
from undeadzone.exports.instructions import uses_of
from undeadzone.exports.rewriting import Rewriting

NEAR = 0.25  # |c - 1| below which c x is written as an increment of x


class _Term(NamedTuple):
    """A term of a sum.

    Attributes:
        place: the node.
        minus: whether it is subtracted.
    """

    place: int
    minus: bool


def in_increments(graph: Graph) -> Graph:
    """The graph with its sums in increments; values change by rounding."""
    growing = _growing(graph)
    nodes = Rewriting([], {})
    places: list[int] = []
    for place, node in enumerate(graph.nodes):
        if place in growing:
            places.append(_sum(graph, nodes, _terms(graph, place, growing), places))
        else:
            operands = [places[operand] for operand in node.operands]
            places.append(nodes.kept(node.op, operands, node.text))
    results = [[places[place] for place in result] for result in graph.results]
    return Graph(nodes.nodes, results, graph.reads)


def _growing(graph: Graph) -> dict[int, bool]:
    """Products c x with c near 1, and sums of such: whether each goes into the sum that uses it."""
    uses = uses_of(graph)
    growing: dict[int, bool] = {}
    for place, node in enumerate(graph.nodes):
        is_sum = node.op in (ca.OP_ADD, ca.OP_SUB)
        joined = is_sum and any(growing.get(operand, False) for operand in node.operands)
        if joined or _growth(graph, place) is not None:
            growing[place] = uses[place] == 1
    return growing


def _terms(graph: Graph, place: int, growing: dict[int, bool], minus: bool = False) -> list[_Term]:
    """The terms of a sum, those of the growing sums inside it included."""
    node = graph.nodes[place]
    if node.op == ca.OP_MUL:
        return [_Term(place, minus)]
    first, second = node.operands
    terms: list[_Term] = []
    for operand, negative in ((first, minus), (second, minus != (node.op == ca.OP_SUB))):
        if growing.get(operand, False):
            terms += _terms(graph, operand, growing, negative)
        else:
            terms.append(_Term(operand, negative))
    return terms


def _growth(graph: Graph, place: int) -> tuple[float, int] | None:
    """(c - 1, x) of a product c x with c near 1."""
    node = graph.nodes[place]
    if node.op != ca.OP_MUL:
        return None
    for factor, value in (node.operands, node.operands[::-1]):
        if graph.nodes[factor].op == ca.OP_CONST:
            excess = float(graph.nodes[factor].text) - 1.0
            if 0 < abs(excess) < NEAR:
                return excess, value
    return None


def _sum(graph: Graph, nodes: Rewriting, terms: list[_Term], places: list[int]) -> int:
    """The node of a sum: what changes little stays whole, all else is added up before it."""
    whole: list[_Term] = []
    rest: list[_Term] = []
    for term in terms:
        growth = _growth(graph, term.place)
        if growth is None:
            rest.append(_Term(places[term.place], term.minus))
            continue
        excess, value = growth
        product = nodes.kept(ca.OP_MUL, [nodes.constant(excess), places[value]])
        whole.append(_Term(places[value], term.minus))
        rest.append(_Term(product, term.minus))
    return _added(nodes, [*whole, _Term(_added(nodes, rest), False)])


def _added(nodes: Rewriting, terms: list[_Term]) -> int:
    """Terms added in order, but the first that is not subtracted before all others."""
    positive = [k for k, term in enumerate(terms) if not term.minus]
    start = positive[0] if positive else 0
    total = terms[start].place
    if not positive:
        total = nodes.kept(ca.OP_NEG, [total])
    for k, term in enumerate(terms):
        if k != start:
            total = nodes.kept(ca.OP_SUB if term.minus else ca.OP_ADD, [total, term.place])
    return total
