"""Sums of products, each printed as a row of fused multiplications and additions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca

from undeadzone.engine.graph import CONDITIONS, Graph, Node, steady

SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)
_PARTS = (*SUMS, ca.OP_MUL, ca.OP_SQ, ca.OP_TWICE, ca.OP_IF_ELSE_ZERO)


class Lines(NamedTuple):
    """A graph about to be printed: its steady nodes, and how often each node is used by an output or by a node that matters."""

    nodes: list[Node]
    steady: set[int]
    uses: Counter[int]


def lines_of(graph: Graph) -> Lines:
    """A graph, counted."""
    uses = Counter(k for result in graph.results for k in result)
    for k in reversed(range(len(graph.nodes))):
        if uses[k]:
            uses.update(graph.nodes[k].operands)
    return Lines(graph.nodes, steady(graph.nodes), uses)


def name(lines: Lines, k: int) -> str:
    """How a node is called."""
    return lines.nodes[k].text or f"v{k}"


def truth(lines: Lines, k: int) -> str:
    """How the truth of a node, that it is not 0, is called."""
    return f"is_v{k}" if lines.nodes[k].op in CONDITIONS else f"({name(lines, k)} != 0.0)"


def taken_in(lines: Lines) -> set[int]:
    """The nodes that are printed as a part of the one sum that uses them."""
    taken: set[int] = set()
    for k in reversed(range(len(lines.nodes))):
        node = lines.nodes[k]
        if (
            lines.uses[k]
            and k not in lines.steady
            and (node.op in SUMS or (k in taken and node.op == ca.OP_MUL))
        ):
            parts = _PARTS if node.op in SUMS else (ca.OP_IF_ELSE_ZERO,)
            taken.update(
                part
                for part in node.operands
                if lines.uses[part] == 1
                and lines.nodes[part].op in parts
                and part not in lines.steady
            )
    return taken


class Term(NamedTuple):
    """A term of a sum: the last node it needs, whether it is subtracted, factor * value, or 0 where the condition does not hold."""

    place: int
    minus: bool
    factor: str
    value: str
    condition: str


def summed(lines: Lines, taken: set[int]) -> dict[int, list[str]]:
    """The statements of all sums by the node after which they stand.

    A term is added as soon as it is known, and what it needs can be forgotten; a plain one comes first where it costs no
    waiting, for a product then needs no instruction of its own; one under a condition is added where it holds, which is
    a single masked instruction where the processor has them.
    """
    found: dict[int, list[str]] = {}
    for k, node in enumerate(lines.nodes):
        if node.op not in SUMS or not lines.uses[k] or k in taken:
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
            more = (
                f"fma({term.factor}, {sign}{term.value}, {text})"
                if term.factor
                else f"{text} {sign or '+'} {term.value}"
            )
            place = max(place, term.place)
            found.setdefault(place, []).append(
                f"u{k}_{i} = {f'select({term.condition}, {more}, {text})' if term.condition else more}"
            )
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
            yield Term(part, negative, "", name(lines, part), "")
        elif inner.op in SUMS:
            yield from _terms(lines, taken, part, negative)
        else:
            factor = (
                "2.0"
                if inner.op == ca.OP_TWICE
                else ""
                if inner.op == ca.OP_IF_ELSE_ZERO
                else name(lines, inner.operands[0])
            )
            gate = part if inner.op == ca.OP_IF_ELSE_ZERO else inner.operands[-1]
            if gate in taken and lines.nodes[gate].op == ca.OP_IF_ELSE_ZERO:
                condition, value = lines.nodes[gate].operands
                yield Term(
                    max(*inner.operands, condition, value),
                    negative,
                    factor,
                    name(lines, value),
                    truth(lines, condition),
                )
            else:
                yield Term(
                    max(inner.operands), negative, factor, name(lines, inner.operands[-1]), ""
                )
