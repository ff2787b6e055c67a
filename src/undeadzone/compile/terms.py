"""Sums of products: which nodes of a graph are terms of the one sum that uses them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple

import casadi as ca

from undeadzone.compile.graph import Graph, Node, steady

SUMS: Final = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)
TWO: Final = -1  # the factor of a double
_PARTS: Final = (*SUMS, ca.OP_MUL, ca.OP_SQ, ca.OP_TWICE, ca.OP_IF_ELSE_ZERO)


class Counted(NamedTuple):
    """A graph about to be lowered.

    Attributes:
        nodes: its nodes.
        steady: the numbers of steady ones.
        uses: how often each node is used by an output or by a node that matters.
    """

    nodes: list[Node]
    steady: set[int]
    uses: Counter[int]


class Term(NamedTuple):
    """A term of a sum, factor * value, or 0 where its condition does not hold.

    Attributes:
        place: the last node that it needs.
        minus: whether it is subtracted.
        factor: a node, `TWO`, or None without one.
        value: the node that is added, or multiplied by the factor.
        condition: a node, or None without one.
    """

    place: int
    minus: bool
    factor: int | None
    value: int
    condition: int | None

    def order(self) -> tuple[int, bool, int, int]:
        """When it is added."""
        factor = -2 if self.factor is None else self.factor
        return self.place, self.minus, factor, self.value

    def effort(self) -> tuple[bool, bool, bool]:
        """What it needs to stand first in a sum."""
        return self.condition is not None, self.factor is not None, self.minus


def counted(graph: Graph) -> Counted:
    """A graph, counted."""
    uses: Counter[int] = Counter()
    for result in graph.results:
        uses.update(result)
    for k in reversed(range(len(graph.nodes))):
        if uses[k]:
            uses.update(graph.nodes[k].operands)
    return Counted(graph.nodes, steady(graph.nodes), uses)


def taken_in(lines: Counted) -> set[int]:
    """The nodes that are a part of the one sum that uses them."""
    taken: set[int] = set()
    for k in reversed(range(len(lines.nodes))):
        node = lines.nodes[k]
        is_part = k in taken and node.op == ca.OP_MUL
        if not lines.uses[k] or k in lines.steady or not (node.op in SUMS or is_part):
            continue
        parts = _PARTS if node.op in SUMS else (ca.OP_IF_ELSE_ZERO,)
        for part in node.operands:
            used_once = lines.uses[part] == 1 and part not in lines.steady
            if used_once and lines.nodes[part].op in parts:
                taken.add(part)
    return taken


def terms(lines: Counted, taken: set[int], k: int, minus: bool) -> Iterator[Term]:
    """What a sum consists of."""
    node = lines.nodes[k]
    for place, part in enumerate(node.operands):
        turned = node.op == ca.OP_NEG or (node.op == ca.OP_SUB and place == 1)
        if part not in taken:
            yield Term(part, minus != turned, None, part, None)
        elif lines.nodes[part].op in SUMS:
            yield from terms(lines, taken, part, minus != turned)
        else:
            yield _product(lines, taken, part, minus != turned)


def _product(lines: Counted, taken: set[int], part: int, minus: bool) -> Term:
    """A product, a square, a double or what stands under a condition, as a term."""
    node = lines.nodes[part]
    factor: int | None = node.operands[0]
    gate = node.operands[-1]
    if node.op == ca.OP_TWICE:
        factor = TWO
    elif node.op == ca.OP_IF_ELSE_ZERO:
        factor, gate = None, part
    if gate in taken and lines.nodes[gate].op == ca.OP_IF_ELSE_ZERO:
        condition, value = lines.nodes[gate].operands
        place = max(*node.operands, condition, value)
        return Term(place, minus, factor, value, condition)
    return Term(max(node.operands), minus, factor, node.operands[-1], None)
