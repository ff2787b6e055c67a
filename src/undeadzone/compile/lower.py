"""Lowering of a graph's nodes to the instructions of a kernel.

Without fusion every instruction gives the bits that it gives on CasADi's virtual machine, NaN,
infinities and the sign of zero included. Elementary functions are those of the C library, as there.
Fused, sums of products round once per product, and functions of `elementary` take the C library's
place, so that all of a lane is vectorised.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import casadi as ca

from undeadzone.compile import elementary
from undeadzone.compile.assumptions import KernelAssumption
from undeadzone.compile.casadi_reader import build_nodes
from undeadzone.compile.coefficients import DOUBLE, FUSED, SINGLE
from undeadzone.compile.graph import (
    CONSTANT,
    LANES,
    SHARED,
    Node,
    Nodes,
    Results,
    count_uses,
    required_nodes,
    to_condition,
)
from undeadzone.compile.repeats import Part
from undeadzone.compile.simplify import ExactRules, FusedRules, PortableRules

SUMS: Final = ("add", "sub", "neg")

Levels = Callable[[str], int]  # how often an input, such as s3, is new


class Arithmetic(NamedTuple):
    """Rounding of a kernel.

    Attributes:
        fused: gather steady values, sums of products with one rounding per product (`fma`), and
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
    granted: dict[KernelAssumption, None],
    callees: dict[str, ca.Function] | None = None,
) -> Results:
    """Return the results of a function as instructions.

    Args:
        function: with dense outputs. Its inputs named p are finite numbers.
        nodes: where instructions are made.
        levels: of its inputs.
        arithmetic: how it rounds.
        granted: promises that are taken for granted, which fused lanes do (grows).
        callees: functions of which calls stay calls, by names that end with the number of results
            (grows; None: none does).

    Raises:
        InputError: names an instruction that the engine lacks.
    """
    fused = arithmetic.fused
    rules = FusedRules(Nodes(), granted) if fused else ExactRules(Nodes())

    def keep_call(called: ca.Function, args: list[Node]) -> list[Node] | None:
        """Return the nodes of the results of a call, if it stays one."""
        if callees is None:
            return None
        count, intern = called.nnz_out(), rules.nodes.intern
        name = f"called{called.__hash__()}.{count}"
        callees[name] = called
        one = intern("apply", *args, text=name, kind=rules.real, level=LANES)
        return [intern("part", one, text=str(k)) for k in range(count)]

    results = build_nodes(function, rules, keep_call)
    counts = count_uses(results)
    order = sorted(counts, key=lambda node: node.number)
    absorbed = _absorbed_nodes(order, counts) if fused else set()
    lowering = _Lowering(
        nodes, levels, absorbed, fused, _library_replacements(nodes, arithmetic), {}
    )
    for node in order:
        if node not in absorbed:
            lowering.values[node] = lowering.lower_node(node)
    return [[lowering.values[node] for node in result] for result in results]


def _library_replacements(nodes: Nodes, arithmetic: Arithmetic) -> dict[str, Callable[..., Node]]:
    """Return the functions that replace those of the C library, by name."""
    if arithmetic.fused:
        return elementary.inline_functions(nodes, FUSED, (*elementary.LANES_OWN, "sign"))
    names = elementary.FUNCTIONS if arithmetic.portable else ("sign",)
    return elementary.inline_functions(nodes, DOUBLE, names)


def build_portable_nodes(
    function: ca.Function, kind: str, parts: list[Part] | None = None
) -> Results:
    """Return the results of a function for printers of code that runs without this package.

    Args:
        function: with dense outputs.
        kind: NumPy's name of the type of numbers: float32 or float64.
        parts: gets the functions of which calls stay calls, each after those that it calls (None:
            none does).

    Raises:
        InputError: names an instruction that no code can be made of.
    """
    return _PortableLowering(kind, parts).build_results(function)[0]


class _PortableLowering:
    """Lowering of a function and of those that it calls.

    Args:
        kind, parts: as above.
    """

    def __init__(self, kind: str, parts: list[Part] | None) -> None:
        self._kind, self._parts = kind, parts
        self._bodies: dict[int, Part | None] = {}  # None: its results may be NaN

    def build_results(self, function: ca.Function) -> tuple[Results, bool]:
        """Return the results, and whether no rule makes one of them NaN."""
        rules = PortableRules(Nodes(), self._kind)

        def keep_call(called: ca.Function, args: list[Node]) -> list[Node] | None:
            """Return the nodes of the results of a call among numbers, if it stays one."""
            if self._parts is None or not all(map(rules.is_number, args)):
                return None
            part = self._body_of(called)
            if part is None:
                return None
            intern, given = rules.nodes.intern, [args[int(one.text[1:])] for one in part.inputs]
            one = intern("apply", *given, text=part.name, kind="call", level=LANES)
            real = rules.real
            count = range(len(part.results))
            return [intern("part", one, text=str(k), kind=real) for k in count]

        results = build_nodes(function, rules, keep_call)
        are_numbers = all(map(rules.is_number, itertools.chain(*results)))
        if self._kind == SINGLE.kind:
            results = _use_exponentials_in_erf(results)
        return results, are_numbers

    def _body_of(self, called: ca.Function) -> Part | None:
        """Return the function of a call, with the inputs that it needs."""
        key = called.__hash__()
        if key not in self._bodies:
            assert self._parts is not None
            built, are_numbers = self.build_results(called)
            results = list(itertools.chain(*built))
            inputs = [node for node in required_nodes(results) if node.op == "input"]
            part = Part(f"shared_{len(self._parts)}", inputs, results)
            if are_numbers:
                self._parts.append(part)
            self._bodies[key] = part if are_numbers else None
        return self._bodies[key]


def _use_exponentials_in_erf(results: Results) -> Results:
    """Return results whose erf x takes e^-x^2 along, if that is computed anyhow."""
    order = required_nodes(itertools.chain(*results))
    exponentials = {}
    for node in order:
        if node.text == "exp" and node.args[0].op == "neg":
            (square,) = node.args[0].args
            if square.op == "mul" and square.args[0] is square.args[1]:
                exponentials[square.args[0]] = node
    if not exponentials:
        return results
    nodes, new = Nodes(), dict[Node, Node]()

    def copy_node(node: Node) -> Node:
        """Return the copy of a node, in which an erf gets its exponential."""
        if node not in new:
            text, args = node.text, node.args
            if text == "erf":
                (x,) = args
                found = exponentials.get(x.args[0] if x.op == "neg" else x)
                text, args = ("erf_by_exp", (x, found)) if found is not None else (text, args)
            copies = map(copy_node, args)
            new[node] = nodes.intern(node.op, *copies, text=text, kind=node.kind, level=node.level)
        return new[node]

    for node in order:
        copy_node(node)
    return [[new[node] for node in result] for result in results]


class Term(NamedTuple):
    """Term of a sum, factor * value, or 0 if its truth does not hold.

    Attributes:
        place: number of the last node that it needs.
        minus: whether it is subtracted.
        factor: None without one.
        value: number that is added, or multiplied by the factor.
        truth: None without one.
    """

    place: int
    minus: bool
    factor: Node | None
    value: Node
    truth: Node | None

    def sort_key(self) -> tuple[int, bool, int, int]:
        """Return the sort key of a term: terms are added in ascending order."""
        factor = -1 if self.factor is None else self.factor.number
        return self.place, self.minus, factor, self.value.number

    def start_effort(self) -> tuple[bool, bool, bool]:
        """Return the extra instructions that a term needs at the start of a sum, as a sort
        key.
        """
        return self.truth is not None, self.factor is not None, self.minus


def _is_gate(node: Node) -> bool:
    """Return whether a node selects a number or 0 by a truth and is not a truth as a number."""
    return node.op == "select" and node.args[2].constant_value == 0.0 and to_condition(node) is None


def _absorbed_nodes(order: list[Node], counts: Counter[Node]) -> set[Node]:
    """Return the nodes that are part of the only sum that uses them."""
    absorbed: set[Node] = set()
    for node in reversed(order):
        is_part = node in absorbed and node.op == "mul"
        if node.level < SHARED or not (node.op in SUMS or is_part):
            continue
        for part in node.args if node.op in SUMS else node.args[-1:]:
            is_term = part.op in (*SUMS, "mul") and node.op in SUMS
            if counts[part] == 1 and part.level >= SHARED and (is_term or _is_gate(part)):
                absorbed.add(part)
    return absorbed


def _sum_terms(absorbed: set[Node], node: Node, minus: bool) -> Iterator[Term]:
    """Yield the terms of a sum."""
    for place, part in enumerate(node.args):
        turned = minus != (node.op == "neg" or (node.op == "sub" and place == 1))
        if part not in absorbed:
            yield Term(part.number, turned, None, part, None)
        elif part.op in SUMS:
            yield from _sum_terms(absorbed, part, turned)
        else:
            yield _to_term(absorbed, part, turned)


def _to_term(absorbed: set[Node], part: Node, minus: bool) -> Term:
    """Return a product, or a value selected by a truth, as a term."""
    factor, gate = (part.args[0], part.args[1]) if part.op == "mul" else (None, part)
    if gate in absorbed and gate.op == "select":
        truth, value, _ = gate.args
        needed = [truth, value, *([factor, gate] if factor is not None else [])]
        return Term(max(node.number for node in needed), minus, factor, value, truth)
    return Term(max(node.number for node in part.args), minus, factor, gate, None)


class _Lowering(NamedTuple):
    """State of the lowering of a graph.

    Attributes:
        nodes: where instructions are made.
        levels: of inputs.
        absorbed: nodes that are a part of the one sum that uses them.
        fused: whether sums of products round once per product.
        ours: functions that take the C library's place, by name.
        values: what each node is.
    """

    nodes: Nodes
    levels: Levels
    absorbed: set[Node]
    fused: bool
    ours: dict[str, Callable[..., Node]]
    values: dict[Node, Node]

    def lower_node(self, node: Node) -> Node:
        """Return the instruction of a node."""
        args = [self.values[arg] for arg in node.args if arg in self.values]
        if node.op == "input":
            return self.nodes.intern_input(node.text, self.levels(node.text), node.kind)
        if self.fused and node.op in SUMS:
            return self._lower_sum(node)
        if node.text in ("fmin", "fmax"):
            return self._lower_extreme(node.text, *args)
        if node.text in self.ours:
            return self.ours[node.text](*args)
        level = LANES if node.op == "apply" else CONSTANT
        return self.nodes.copy_node(node, args, level)

    def _lower_extreme(self, word: str, a: Node, b: Node) -> Node:
        """Return the minimum or maximum of two numbers, the first of equals, the number if
        the operand beside it is NaN.
        """
        intern, op = self.nodes.intern, "least" if word == "fmin" else "most"
        if _is_never_nan(a):
            return intern(op, b, a)
        if _is_never_nan(b) and (self.fused or b.constant_value):
            return intern(op, a, b)  # the sign of zero apart
        better = intern("le", *((a, b) if word == "fmin" else (b, a)), kind="bool")
        if not _is_never_nan(b):
            better = intern("or", better, intern("ne", b, b, kind="bool"))
        return intern("select", better, a, b)

    def _lower_sum(self, node: Node) -> Node:
        """Return a sum, built term by term.

        A term is added as soon as it is known, so that its operands can be forgotten. A plain term
        comes first if it costs no waiting, as a product then needs no instruction of its own. A
        term under a truth is added if the truth holds, by a single masked instruction if the
        processor has them.
        """
        intern = self.nodes.intern
        waiting = sorted(_sum_terms(self.absorbed, node, False), key=Term.sort_key)
        first = min(waiting[:2], key=Term.start_effort)
        waiting.remove(first)
        total = self._signed_value(first)
        if first.factor is not None:
            total = intern("mul", self.values[first.factor], total)
        if first.truth is not None:
            zero = self.nodes.intern_constant(0.0)
            total = intern("select", self.values[first.truth], total, zero)
        for term in waiting:
            more = self._add_term(total, term)
            if term.truth is not None:
                more = intern("select", self.values[term.truth], more, total)
            total = more
        return total

    def _signed_value(self, term: Term) -> Node:
        """Return the value of a term with its sign."""
        value = self.values[term.value]
        return self.nodes.intern("neg", value) if term.minus else value

    def _add_term(self, total: Node, term: Term) -> Node:
        """Return a sum with a further term added."""
        if term.factor is not None:
            factors = self.values[term.factor], self._signed_value(term)
            return self.nodes.intern("call", *factors, total, text="fma")
        return self.nodes.intern("sub" if term.minus else "add", total, self.values[term.value])


def _is_never_nan(node: Node) -> bool:
    """Return whether a node cannot be NaN: a parameter, or a constant other than NaN."""
    if node.op == "input":
        return node.text.startswith("p")  # parameters are finite, other inputs may be missing
    return node.op == "const" and node.text != "nan"
