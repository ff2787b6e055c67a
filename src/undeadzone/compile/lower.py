"""Nodes of a graph as the instructions of a kernel.

Without fusion every instruction means to the last bit what it means on CasADi's virtual machine,
NaN, infinities and the sign of zero included; elementary functions are those of the C library, as
there. Fused, sums of products round once per product, and functions of `elementary` take the C
library's place, so that all of a lane is vectorised.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import casadi as ca

from undeadzone.compile import elementary
from undeadzone.compile.assumptions import Promise
from undeadzone.compile.casadi_reader import list_results
from undeadzone.compile.coefficients import DOUBLE, FUSED
from undeadzone.compile.graph import SHARED, Node, Nodes, Results, condition, uses
from undeadzone.compile.simplify import Exact, Gathered, Plain

SUMS: Final = ("add", "sub", "neg")

Levels = Callable[[str], int]  # how often an input, such as s3, is new


class Arithmetic(NamedTuple):
    """How a kernel rounds.

    Attributes:
        fused: gather what is steady, sums of products with one rounding per product (`fma`), and
            functions of `elementary`: faster, and rounded otherwise than on the virtual machine.
        portable: functions of `elementary` as exported code has them, without `fma`.
    """

    fused: bool = False
    portable: bool = False


def lower_function(
    function: ca.Function,
    nodes: Nodes,
    levels: Levels,
    arithmetic: Arithmetic,
    granted: dict[Promise, None],
) -> Results:
    """Return the results of a function as instructions.

    Args:
        function: with dense outputs; its inputs named p are finite numbers.
        nodes: where instructions are made.
        levels: of its inputs.
        arithmetic: how it rounds.
        granted: promises that are taken for granted, which fused lanes do; grows.

    Raises:
        InputError: an instruction that the engine lacks; it names it.
    """
    fused = arithmetic.fused
    rules = Gathered(Nodes(), granted) if fused else Exact(Nodes())
    results = list_results(function, rules)
    counts = uses(results)
    order = sorted(counts, key=lambda node: node.number)
    taken = _absorbed_nodes(order, counts) if fused else set()
    lowering = _Lowering(nodes, levels, taken, fused, _own(nodes, arithmetic), {})
    for node in order:
        if node not in taken:
            lowering.values[node] = lowering.lower(node)
    return [[lowering.values[node] for node in result] for result in results]


def _own(nodes: Nodes, arithmetic: Arithmetic) -> dict[str, Callable[..., Node]]:
    """Return the functions that take the C library's place."""
    if arithmetic.fused:
        return elementary.inline_functions(nodes, FUSED, (*elementary.LANES_OWN, "sign"))
    names = elementary.FUNCTIONS if arithmetic.portable else ("sign",)
    return elementary.inline_functions(nodes, DOUBLE, names)


def portable(function: ca.Function, kind: str) -> Results:
    """Return the results of a function for printers of code that runs without this package.

    Args:
        function: with dense outputs.
        kind: NumPy's name of the type of numbers: float32 or float64.

    Raises:
        InputError: an instruction that no code can be made of; it names it.
    """
    return list_results(function, Plain(Nodes(), kind))


class Term(NamedTuple):
    """A term of a sum, factor * value, or 0 where its truth does not hold.

    Attributes:
        place: number of the last node that it needs.
        minus: whether it is subtracted.
        factor: None without one.
        value: what is added, or multiplied by the factor.
        truth: None without one.
    """

    place: int
    minus: bool
    factor: Node | None
    value: Node
    truth: Node | None

    def order(self) -> tuple[int, bool, int, int]:
        """When it is added."""
        factor = -1 if self.factor is None else self.factor.number
        return self.place, self.minus, factor, self.value.number

    def effort(self) -> tuple[bool, bool, bool]:
        """What it needs to stand first in a sum."""
        return self.truth is not None, self.factor is not None, self.minus


def _is_gate(node: Node) -> bool:
    """Return whether a node is a number where a truth holds, else 0, and not a truth as a
    number.
    """
    return node.op == "select" and node.args[2].value == 0.0 and condition(node) is None


def _absorbed_nodes(order: list[Node], counts: Counter[Node]) -> set[Node]:
    """Return the nodes that are a part of the one sum that uses them."""
    taken: set[Node] = set()
    for node in reversed(order):
        is_part = node in taken and node.op == "mul"
        if node.level < SHARED or not (node.op in SUMS or is_part):
            continue
        for part in node.args if node.op in SUMS else node.args[-1:]:
            is_term = part.op in (*SUMS, "mul") and node.op in SUMS
            if counts[part] == 1 and part.level >= SHARED and (is_term or _is_gate(part)):
                taken.add(part)
    return taken


def _terms(taken: set[Node], node: Node, minus: bool) -> Iterator[Term]:
    """What a sum consists of."""
    for place, part in enumerate(node.args):
        turned = minus != (node.op == "neg" or (node.op == "sub" and place == 1))
        if part not in taken:
            yield Term(part.number, turned, None, part, None)
        elif part.op in SUMS:
            yield from _terms(taken, part, turned)
        else:
            yield _product(taken, part, turned)


def _product(taken: set[Node], part: Node, minus: bool) -> Term:
    """Return a product or what stands under a truth, as a term."""
    factor, gate = (part.args[0], part.args[1]) if part.op == "mul" else (None, part)
    if gate in taken and gate.op == "select":
        truth, value, _ = gate.args
        needed = [truth, value, *([factor, gate] if factor is not None else [])]
        return Term(max(node.number for node in needed), minus, factor, value, truth)
    return Term(max(node.number for node in part.args), minus, factor, gate, None)


class _Lowering(NamedTuple):
    """A graph on the way.

    Attributes:
        nodes: where instructions are made.
        levels: of inputs.
        taken: nodes that are a part of the one sum that uses them.
        fused: whether sums of products round once per product.
        ours: functions that take the C library's place, by name.
        values: what each node is.
    """

    nodes: Nodes
    levels: Levels
    taken: set[Node]
    fused: bool
    ours: dict[str, Callable[..., Node]]
    values: dict[Node, Node]

    def lower(self, node: Node) -> Node:
        """Return the instructions of a node."""
        args = [self.values[arg] for arg in node.args if arg in self.values]
        if node.op == "input":
            return self.nodes.input(node.text, self.levels(node.text), node.kind)
        if self.fused and node.op in SUMS:
            return self._sum(node)
        if node.text in ("fmin", "fmax"):
            return self._extreme(node.text, *args)
        if node.text in self.ours:
            return self.ours[node.text](*args)
        return self.nodes.intern(node.op, *args, text=node.text, kind=node.kind)

    def _extreme(self, word: str, a: Node, b: Node) -> Node:
        """Return the lesser or greater of two numbers, the first of equals; the other of NaN and
        one.
        """
        made, op = self.nodes.intern, "least" if word == "fmin" else "most"
        if _is_number(a):
            return made(op, b, a)
        if _is_number(b) and (self.fused or b.value):
            return made(op, a, b)  # the sign of zero apart
        better = made("le", *((a, b) if word == "fmin" else (b, a)), kind="bool")
        if not _is_number(b):
            better = made("or", better, made("ne", b, b, kind="bool"))
        return made("select", better, a, b)

    def _sum(self, node: Node) -> Node:
        """Return a sum, term by term.

        A term is added as soon as it is known, and what it needs can be forgotten; a plain one
        comes first where it costs no waiting, for a product then needs no instruction of its own;
        one under a truth is added where it holds: a single masked instruction where the processor
        has them.
        """
        made = self.nodes.intern
        waiting = sorted(_terms(self.taken, node, False), key=Term.order)
        first = min(waiting[:2], key=Term.effort)
        waiting.remove(first)
        total = self._signed_value(first)
        if first.factor is not None:
            total = made("mul", self.values[first.factor], total)
        if first.truth is not None:
            zero = self.nodes.constant(0.0)
            total = made("select", self.values[first.truth], total, zero)
        for term in waiting:
            more = self._plus(total, term)
            if term.truth is not None:
                more = made("select", self.values[term.truth], more, total)
            total = more
        return total

    def _signed_value(self, term: Term) -> Node:
        """Return the value of a term with its sign."""
        value = self.values[term.value]
        return self.nodes.intern("neg", value) if term.minus else value

    def _plus(self, total: Node, term: Term) -> Node:
        """Return a sum and one term more."""
        if term.factor is not None:
            factors = self.values[term.factor], self._signed_value(term)
            return self.nodes.intern("call", *factors, total, text="fma")
        return self.nodes.intern("sub" if term.minus else "add", total, self.values[term.value])


def _is_number(node: Node) -> bool:
    """Return whether a node cannot be NaN."""
    if node.op == "input":
        return node.text.startswith("p")
    return node.op == "const" and node.text != "nan"
