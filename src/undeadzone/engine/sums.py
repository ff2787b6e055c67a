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
    """A graph about to be printed.

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
        factor: empty without one.
        value: what is added, or multiplied by the factor.
        condition: empty without one.
    """

    place: int
    minus: bool
    factor: str
    value: str
    condition: str


def lines_of(graph: Graph) -> Lines:
    """A graph, counted."""
    uses: Counter[int] = Counter()
    for result in graph.results:
        uses.update(result)
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
        is_part = k in taken and node.op == ca.OP_MUL
        if not lines.uses[k] or k in lines.steady or not (node.op in SUMS or is_part):
            continue
        parts = _PARTS if node.op in SUMS else (ca.OP_IF_ELSE_ZERO,)
        for part in node.operands:
            used_once = lines.uses[part] == 1 and part not in lines.steady
            if used_once and lines.nodes[part].op in parts:
                taken.add(part)
    return taken


def summed(lines: Lines, taken: set[int]) -> dict[int, list[str]]:
    """The statements of all sums by the node after which they stand."""
    statements: dict[int, list[str]] = {}
    for k, node in enumerate(lines.nodes):
        if node.op in SUMS and lines.uses[k] and k not in taken:
            for place, statement in _sum(k, sorted(_terms(lines, taken, k, False))):
                statements.setdefault(place, []).append(statement)
    return statements


def _sum(k: int, terms: list[Term]) -> Iterator[tuple[int, str]]:
    """The statements of the sum k, each with the node after which it stands.

    A term is added as soon as it is known, and what it needs can be forgotten; a plain one comes
    first where it costs no waiting, for a product then needs no instruction of its own; one under a
    condition is added where it holds, which is a single masked instruction where the processor has
    them.
    """
    first = min(terms[:2], key=_effort)
    others = [term for term in terms if term is not first]
    place = first.place
    text = _signed(first)
    if first.factor:
        text = f"{first.factor} * {text}"
    if first.condition:
        text = f"select({first.condition}, {text}, 0.0)"
    for i, term in enumerate(others):
        place = max(place, term.place)
        if term.condition:
            yield place, f"t{k}_{i} = {text}"
            text = f"t{k}_{i}"
        more = _plus(text, term)
        if term.condition:
            more = f"select({term.condition}, {more}, {text})"
        yield place, f"u{k}_{i} = {more}"
        text = f"u{k}_{i}"
    yield k, f"v{k} = {text}"


def _effort(term: Term) -> tuple[bool, bool]:
    """What a term needs to stand first in a sum."""
    return term.condition != "", term.factor != ""


def _signed(term: Term) -> str:
    """The value of a term with its sign."""
    return f"-{term.value}" if term.minus else term.value


def _plus(text: str, term: Term) -> str:
    """A sum and one term more."""
    if term.factor:
        return f"fma({term.factor}, {_signed(term)}, {text})"
    return f"{text} {'-' if term.minus else '+'} {term.value}"


def _terms(lines: Lines, taken: set[int], k: int, minus: bool) -> Iterator[Term]:
    """What a sum consists of."""
    node = lines.nodes[k]
    for place, part in enumerate(node.operands):
        turned = node.op == ca.OP_NEG or (node.op == ca.OP_SUB and place == 1)
        if part not in taken:
            yield Term(part, minus != turned, "", name(lines, part), "")
        elif lines.nodes[part].op in SUMS:
            yield from _terms(lines, taken, part, minus != turned)
        else:
            yield _product(lines, taken, part, minus != turned)


def _product(lines: Lines, taken: set[int], part: int, minus: bool) -> Term:
    """A product, a square, a double or what stands under a condition, as a term."""
    node = lines.nodes[part]
    factor, gate = name(lines, node.operands[0]), node.operands[-1]
    if node.op == ca.OP_TWICE:
        factor = "2.0"
    elif node.op == ca.OP_IF_ELSE_ZERO:
        factor, gate = "", part
    if gate in taken and lines.nodes[gate].op == ca.OP_IF_ELSE_ZERO:
        condition, value = lines.nodes[gate].operands
        place = max(*node.operands, condition, value)
        return Term(place, minus, factor, name(lines, value), truth(lines, condition))
    return Term(max(node.operands), minus, factor, name(lines, node.operands[-1]), "")
