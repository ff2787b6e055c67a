"""A CasADi SX graph as instructions of a kernel.

Every instruction means to the last bit what it means on CasADi's virtual machine, NaN, infinities
and the sign of zero included; elementary functions are those of the C library, as there. Fused,
sums of products round once per product, and functions of `elementary` take the C library's place,
so that all of a lane is vectorised.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import casadi as ca

from undeadzone.compile import elementary, promises, traced
from undeadzone.compile.graph import CONDITIONS, Graph, Node, listed, shortened
from undeadzone.compile.ops import Op, Ops
from undeadzone.compile.promises import Promise
from undeadzone.compile.terms import SUMS, Counted, Term, counted, taken_in, terms
from undeadzone.errors import InputError

# Functions of the C library, of one number and of two.
_OF_ONE: Final = (
    *("exp", "expm1", "log", "log1p", "erf", "sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
_OF_TWO: Final = ("pow", "atan2", "hypot", "copysign", "fmod", "remainder")


def _instruction(word: str) -> int:
    """CasADi's number of an instruction."""
    return int(getattr(ca, f"OP_{word.upper()}"))


_CALLED: Final = {
    ca.OP_CONSTPOW: "pow",
    **{_instruction(word): word for word in (*_OF_ONE, *_OF_TWO)},
}
_OURS: Final = {_instruction(word): word for word in elementary.FUNCTIONS}
_PLAIN: Final = {
    ca.OP_ADD: "fadd",
    ca.OP_SUB: "fsub",
    ca.OP_MUL: "fmul",
    ca.OP_DIV: "fdiv",
    ca.OP_NEG: "fneg",
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "fabs",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
}
_RELATIONS: Final = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
_SIMILAR: Final = (ca.OP_ASSIGN, ca.OP_LIFT, ca.OP_INV, ca.OP_SQ, ca.OP_TWICE, ca.OP_SIGN)
_CHOICES: Final = (ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO)
_KNOWN: Final = {
    *(*_CALLED, *_PLAIN, *_SIMILAR, *_CHOICES, *CONDITIONS),
    *(ca.OP_INPUT, ca.OP_CONST),
}

Levels = Callable[[str], int]  # how often an input, such as s3, is new


def lowered(
    function: ca.Function, ops: Ops, levels: Levels, fused: bool, granted: dict[Promise, None]
) -> list[list[Op]]:
    """The results of a function as instructions.

    Args:
        function: with dense outputs; its inputs named p are finite numbers.
        ops: where instructions are made.
        levels: of its inputs.
        fused: lower the graph `graph.shortened`, sums of products with one rounding per product
            (`fma`) and functions of `elementary`: faster, and rounded otherwise than on the virtual
            machine.
        granted: promises that are taken for granted, which fused lanes do; grows.

    Raises:
        InputError: an instruction that the engine lacks; it names it.
    """
    graph = listed(function)
    _require_known(function.name(), graph)
    graph = shortened(graph) if fused else graph
    lines = counted(graph)
    taken = taken_in(lines) if fused else set()
    ours = traced.functions(elementary, ops) if fused else {}
    lowering = _Lowering(lines, taken, ops, levels, ours, granted if fused else None, {}, {})
    for k in range(len(graph.nodes)):
        if lines.uses[k] and k not in taken:
            lowering.lower(k, fused)
    return [[lowering.values[k] for k in result] for result in graph.results]


def _require_known(title: str, graph: Graph) -> None:
    """Raise InputError that names an instruction that the engine lacks."""
    unknown = {node.op for node in graph.nodes} - _KNOWN
    for word in dir(ca):
        if word.startswith("OP_") and getattr(ca, word) in unknown:
            raise InputError(
                f"{title}: the lanes engine has no instruction {word}; "
                "run this graph on the engine 'interpret'"
            )


class _Lowering(NamedTuple):
    """A graph on the way.

    Attributes:
        lines: its nodes, counted.
        taken: nodes that are a part of the one sum that uses them.
        ops: where instructions are made.
        levels: of inputs.
        ours: functions that take the C library's place, by name.
        granted: promises that are taken for granted; None if nothing may be.
        values: the number that each node is.
        truths: the truth of each condition.
    """

    lines: Counted
    taken: set[int]
    ops: Ops
    levels: Levels
    ours: dict[str, Any]
    granted: dict[Promise, None] | None
    values: dict[int, Op]
    truths: dict[int, Op]

    def lower(self, k: int, fused: bool) -> None:
        """Make the instructions of a node."""
        node = self.lines.nodes[k]
        if node.op in CONDITIONS:
            self.truths[k] = self._condition(node)
            one, zero = self.ops.number(1.0), self.ops.number(0.0)
            self.values[k] = self.ops.selected(self.truths[k], one, zero)
        elif fused and node.op in SUMS:
            self.values[k] = self._sum(k)
        elif node.op in (ca.OP_FMIN, ca.OP_FMAX):
            self.values[k] = self._extreme(node, fused)
        else:
            self.values[k] = self._value(node)

    def _truth(self, k: int) -> Op:
        """That a node is not 0."""
        if k in self.truths:
            return self.truths[k]
        return self.ops.compared("une", self.values[k], self.ops.number(0.0))

    def _value(self, node: Node) -> Op:
        """The value of a node that is no condition."""
        ops, operands = self.ops, [self.values[k] for k in node.operands]
        if node.op == ca.OP_INPUT:
            return ops.input(node.text, self.levels(node.text))
        if node.op == ca.OP_CONST:
            return ops.number(float(node.text))
        if node.op == ca.OP_IF_ELSE_ZERO:
            return ops.selected(self._truth(node.operands[0]), operands[1], ops.number(0.0))
        if node.op in _PLAIN:
            return ops.made(_PLAIN[node.op], *operands)
        if node.op in _SIMILAR:
            return self._similar(node.op, operands[0])
        word = _OURS.get(node.op, "")
        if word in self.ours:
            result: traced.Value = self.ours[word](traced.Value(ops, operands[0]))
            return result.op
        return ops.made("call", *operands, text=_CALLED[node.op])

    def _similar(self, op: int, x: Op) -> Op:
        """What is made of instructions that LLVM has."""
        ops = self.ops
        if op == ca.OP_INV:
            return ops.made("fdiv", ops.number(1.0), x)
        if op == ca.OP_SQ:
            return ops.made("fmul", x, x)
        if op == ca.OP_TWICE:
            return ops.made("fmul", ops.number(2.0), x)
        if op != ca.OP_SIGN:
            return x
        zero = ops.number(0.0)
        positive = ops.selected(ops.compared("olt", zero, x), ops.number(1.0), x)
        return ops.selected(ops.compared("olt", x, zero), ops.number(-1.0), positive)

    def _extreme(self, node: Node, fused: bool) -> Op:
        """The lesser or greater of two numbers, the first of equals; the other of NaN and one."""
        ops = self.ops
        least = node.op == ca.OP_FMIN
        first, second = node.operands
        a, b = self.values[first], self.values[second]
        if self._is_number(first):
            return ops.made("least" if least else "most", b, a)
        if self._is_number(second) and (fused or self._is_not_zero(second)):
            return ops.made("least" if least else "most", a, b)  # the sign of zero apart
        better = ops.compared("ole" if least else "oge", a, b)
        if not self._is_number(second):
            better = ops.made("or", better, ops.compared("uno", b, b))
        return ops.selected(better, a, b)

    def _is_number(self, k: int) -> bool:
        """Whether a node cannot be NaN."""
        node = self.lines.nodes[k]
        if node.op == ca.OP_INPUT:
            return node.text.startswith("p")
        return node.op == ca.OP_CONST and node.text != "nan"

    def _is_not_zero(self, k: int) -> bool:
        """Whether a node is a constant other than 0."""
        node = self.lines.nodes[k]
        return node.op == ca.OP_CONST and float(node.text) != 0.0

    def _condition(self, node: Node) -> Op:
        """The truth of a condition."""
        ops, nodes = self.ops, self.lines.nodes
        a, b = node.operands[0], node.operands[-1]
        if node.op == ca.OP_NOT:
            return ops.inverted(self._truth(a))
        if node.op in (ca.OP_AND, ca.OP_OR):
            return ops.made("and" if node.op == ca.OP_AND else "or", self._truth(a), self._truth(b))
        if a in self.truths and b in self.truths and node.op in (ca.OP_EQ, ca.OP_NE):
            return self._unequal(self.truths[a], self.truths[b], node.op == ca.OP_EQ)
        if node.op == ca.OP_LT and nodes[a].text == "0.0" and b in self.truths:
            return self.truths[b]
        for zero, other, swapped in ((a, b, False), (b, a, True)):
            if nodes[zero].text == "0.0" and self._is_difference(other):
                return self._sign(node.op, nodes[other], swapped)
        return ops.compared(_RELATIONS[node.op], self.values[a], self.values[b])

    def _unequal(self, a: Op, b: Op, inverted: bool) -> Op:
        """Whether one of two conditions holds alone; inverted, whether not."""
        unequal = self.ops.made("xor", a, b)
        return self.ops.inverted(unequal) if inverted else unequal

    def _is_difference(self, k: int) -> bool:
        """Whether a node is a difference of conditions."""
        node = self.lines.nodes[k]
        return node.op == ca.OP_SUB and all(part in self.truths for part in node.operands)

    def _sign(self, op: int, difference: Node, swapped: bool) -> Op:
        """Whether 0 is less than, ... a difference of conditions; swapped, that than 0."""
        ops = self.ops
        a, b = (self.truths[part] for part in difference.operands)
        if op in (ca.OP_EQ, ca.OP_NE):
            return self._unequal(a, b, op == ca.OP_EQ)
        more, less = (b, a) if swapped else (a, b)
        if op == ca.OP_LT and self._exclusive(more, less):
            return more
        return ops.made("and" if op == ca.OP_LT else "or", more, ops.inverted(less))

    def _exclusive(self, one: Op, other: Op) -> bool:
        """Whether two conditions exclude each other, which may be a promise from now on."""
        promise = promises.apart(one, other) or promises.apart(other, one)
        if promise is None or self.granted is None:
            return False
        self.granted[promise] = None
        return True

    def _sum(self, k: int) -> Op:
        """A sum, term by term.

        A term is added as soon as it is known, and what it needs can be forgotten; a plain one
        comes first where it costs no waiting, for a product then needs no instruction of its own;
        one under a condition is added where it holds: a single masked instruction where the
        processor has them.
        """
        ops = self.ops
        waiting = sorted(terms(self.lines, self.taken, k, False), key=Term.order)
        first = min(waiting[:2], key=Term.effort)
        waiting.remove(first)
        total = self._signed(first)
        if first.factor is not None:
            total = ops.made("fmul", self._factor(first.factor), total)
        if first.condition is not None:
            total = ops.selected(self._truth(first.condition), total, ops.number(0.0))
        for term in waiting:
            more = self._plus(total, term)
            if term.condition is not None:
                more = ops.selected(self._truth(term.condition), more, total)
            total = more
        return total

    def _factor(self, factor: int) -> Op:
        """The factor of a term."""
        return self.ops.number(2.0) if factor < 0 else self.values[factor]

    def _signed(self, term: Term) -> Op:
        """The value of a term with its sign."""
        value = self.values[term.value]
        return self.ops.made("fneg", value) if term.minus else value

    def _plus(self, total: Op, term: Term) -> Op:
        """A sum and one term more."""
        if term.factor is not None:
            return self.ops.made("fma", self._factor(term.factor), self._signed(term), total)
        return self.ops.made("fsub" if term.minus else "fadd", total, self.values[term.value])
