"""The same values by fewer instructions.

`Exact` changes no bit. `Plain`, for exported code, changes the sign of zero, and what is 0 times
infinity: conditions select instead of multiplying by 0 and 1, and NaN is left in results alone.
`Gathered`, for fused lanes, rounds otherwise: conditions move into products, inverses of what is
steady and products with it are gathered.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Final

import numpy as np

from undeadzone.compile import assumptions
from undeadzone.compile.assumptions import Promise
from undeadzone.compile.casadi_reader import ARITHMETIC
from undeadzone.compile.graph import SHARED, Node, Nodes, condition

_COMPARED: Final = {"lt": operator.lt, "le": operator.le, "eq": operator.eq, "ne": operator.ne}


class Exact:
    """Rules that keep every bit: those of truths and selections.

    Args:
        nodes: where nodes are made.
        real: the type of numbers.
        granted: promises that may be taken for granted; grows. None: none may.
    """

    def __init__(
        self, nodes: Nodes, real: str = "float64", granted: dict[Promise, None] | None = None
    ) -> None:
        self.nodes, self.real, self.granted = nodes, real, granted
        self.zero, self.one = nodes.constant(0.0, real), nodes.constant(1.0, real)
        self.no, self.yes = nodes.constant(0, "bool"), nodes.constant(1, "bool")
        self._implied: dict[tuple[Node, Node], bool] = {}

    def made(self, word: str, *args: Node) -> Node:
        """Return the number that an instruction gives, where truths are 1 or 0."""
        if word in _COMPARED:
            return self.number(self.compared(word, *args))
        truths: dict[str, Callable[..., Node]] = {
            "not": self.negated,
            "and": self.both,
            "or": self.either,
        }
        if word in truths:
            return self.number(truths[word](*map(self.truth, args)))
        if word == "if_else_zero":
            return self.selected(self.truth(args[0]), args[1], self.zero)
        if word in ARITHMETIC:
            return self.nodes.intern(word, *args)
        if word in ("fmin", "fmax") and all(map(condition, args)):
            return self.made("and" if word == "fmin" else "or", *args)
        return self.nodes.intern("call", *args, text=word)

    def constant(self, value: float) -> Node:
        """Return a number that is written down."""
        return self.nodes.constant(value, self.real)

    # --- Truths

    def number(self, truth: Node) -> Node:
        """Return a truth as 1 or 0."""
        if truth.value is not None:
            return self.one if truth.value else self.zero
        return self.nodes.intern("select", truth, self.one, self.zero)

    def truth(self, number: Node) -> Node:
        """That a number is not 0."""
        return condition(number) or self.compared("ne", number, self.zero)

    def negated(self, truth: Node) -> Node:
        """Where a truth does not hold."""
        if truth.value is not None:
            return self.no if truth.value else self.yes
        return truth.args[0] if truth.op == "not" else self.nodes.intern("not", truth)

    def both(self, a: Node, b: Node) -> Node:
        """Where two truths hold."""
        for one, other in ((a, b), (b, a)):
            if one.value is not None:
                return other if one.value else self.no
            if self.implies(one, other):
                return one
        return self.nodes.intern("and", a, b)

    def either(self, a: Node, b: Node) -> Node:
        """Where one of two truths holds."""
        for one, other in ((a, b), (b, a)):
            if one.value is not None:
                return self.yes if one.value else other
            if self.implies(one, other):
                return other
        return self.nodes.intern("or", a, b)

    def implies(self, one: Node, other: Node) -> bool:
        """Return whether a truth holds only where another does, as far as that shows.

        Each pair is asked once: truths share their parts, and have more paths than nodes.
        """
        if (one, other) not in self._implied:
            self._implied[one, other] = self._implies_parts(one, other)
        return self._implied[one, other]

    def _implies_parts(self, one: Node, other: Node) -> bool:
        """Return `implies`, from the parts of two truths."""
        if one is other or other.value == 1.0:
            return True
        every, some = {"and": all, "or": any}, {"and": any, "or": all}
        if other.op in every and every[other.op](self.implies(one, part) for part in other.args):
            return True
        if one.op in some:
            return some[one.op](self.implies(part, other) for part in one.args)
        return one.op == "lt" and other.op == "ne" and set(one.args) == set(other.args)

    def compared(self, word: str, a: Node, b: Node) -> Node:
        """Return a comparison of numbers."""
        compare, (x, y), (this, that) = _COMPARED[word], (a.value, b.value), map(condition, (a, b))
        if x is not None and y is not None:
            return self.yes if compare(x, y) else self.no
        if this is not None and y is not None:
            return self._chosen(this, compare(1.0, y), compare(0.0, y))
        if that is not None and x is not None:
            return self._chosen(that, compare(x, 1.0), compare(x, 0.0))
        if this is not None and that is not None and word in ("eq", "ne"):
            return self._unequal(word, this, that)
        if y == 0.0 and _sides(a):
            return self._sign(word, *_sides(a)[::-1])
        if x == 0.0 and _sides(b):
            return self._sign(word, *_sides(b))
        return self.nodes.intern(word, a, b, kind="bool")

    def _chosen(self, truth: Node, yes: bool, no: bool) -> Node:
        """Return one of two known truths by a third."""
        if yes == no:
            return self.yes if yes else self.no
        return truth if yes else self.negated(truth)

    def _unequal(self, word: str, a: Node, b: Node) -> Node:
        """Return whether one of two truths holds alone; of eq, whether not."""
        unequal = self.nodes.intern("ne", a, b)
        return unequal if word == "ne" else self.negated(unequal)

    def _sign(self, word: str, more: Node, less: Node) -> Node:
        """Return whether 0 is less than, ... [more] - [less]."""
        exclusive = self._exclude(more, less) or self._exclude(less, more)
        if word in ("eq", "ne") and exclusive:
            some = self.either(more, less)
            return some if word == "ne" else self.negated(some)
        if word in ("eq", "ne"):
            return self._unequal(word, more, less)
        if word == "le":
            return self.either(more, self.negated(less))
        return more if exclusive else self.both(more, self.negated(less))

    def _exclude(self, a: Node, b: Node) -> bool:
        """Return whether high < y is a part of one truth and y < low of the other, low not above
        high.
        """
        for above in _conjuncts(a):
            for below in _conjuncts(b):
                promise = assumptions.apart(above, below)
                if promise is None:
                    continue
                if promise.is_evident:
                    return True
                if promise.is_open and self.granted is not None:
                    self.granted[promise] = None
                    return True
        return False

    # --- Selections

    def selected(self, truth: Node, yes: Node, no: Node) -> Node:
        """Return one of two numbers by a truth."""
        if truth.value is not None:
            return yes if truth.value else no
        inner = condition(yes)
        if inner is not None and no is self.zero:
            return self.number(self.both(truth, inner))
        yes = self._under(truth, yes)
        if yes.op == "select" and yes.args[2] is no:
            return self.selected(self.both(truth, yes.args[0]), yes.args[1], no)
        return yes if yes is no else self.nodes.intern("select", truth, yes, no)

    def _under(self, truth: Node, number: Node) -> Node:
        """Return a number where a truth holds, without a selection that the truth decides."""
        if number.op == "select" and self.implies(truth, number.args[0]):
            return self._under(truth, number.args[1])
        if number.op == "neg":
            return self.nodes.intern("neg", self._under(truth, number.args[0]))
        return number


class Plain:
    """Rules for exported code.

    A value that is NaN where a truth fails is a selection of NaN, and whatever is computed with it
    is one, too: the code computes with numbers alone.
    """

    def __init__(self, nodes: Nodes, real: str) -> None:
        self.nodes, self.real, self.exact = nodes, real, Exact(nodes, real)
        self.nan, self.largest = nodes.constant(math.nan, real), round_to_type(math.inf, real)

    def made(self, word: str, *args: Node) -> Node:
        """Return the number that an instruction gives, where truths are 1 or 0."""
        numbers, there = zip(*map(self._parts, args), strict=True)
        if all(each is self.exact.yes for each in there):
            return self._made(word, *numbers)
        if word in ("not", "and", "or"):
            return self._made(word, *map(self._truth_of_number, args))
        if word == "if_else_zero":
            return self._gated(
                self.exact.truth(self._truth_of_number(args[0])), *self._parts(args[1])
            )
        if word in ("fmin", "fmax"):
            return self._lesser(self._made(word, *numbers), *zip(numbers, there, strict=True))
        both = there[0] if len(there) == 1 else self.exact.both(*there)
        if word not in _COMPARED:
            return self._where(both, self._made(word, *numbers))
        numbers = tuple(self.exact._under(both, number) for number in numbers)
        plain = self.exact.compared(word, *numbers)
        if word == "ne":
            return self.exact.number(self.exact.either(self.exact.negated(both), plain))
        return self.exact.number(self.exact.both(both, plain))

    def constant(self, value: float) -> Node:
        """Return a number that is written down."""
        return self.nodes.constant(round_to_type(value, self.real), self.real)

    def _parts(self, node: Node) -> tuple[Node, Node]:
        """Return a number, and the truth without which it is NaN."""
        if node is self.nan:
            return self.exact.zero, self.exact.no
        if node.op != "select" or node.args[2] is not self.nan:
            return node, self.exact.yes
        truth, number, _ = node.args
        if number.op == "input":  # nothing is computed with one that is absent
            number = self.exact.selected(truth, number, self.exact.zero)
        return number, truth

    def _where(self, truth: Node, number: Node) -> Node:
        """Return a number where a truth holds, else NaN."""
        return self.exact.selected(truth, number, self.nan)

    def _truth_of_number(self, node: Node) -> Node:
        """That a number is not 0, as 1 or 0; NaN is not."""
        number, there = self._parts(node)
        absent = self.exact.negated(there)
        return self.exact.number(self.exact.either(absent, self.exact.truth(number)))

    def _gated(self, truth: Node, number: Node, there: Node) -> Node:
        """Return a number where a truth holds, else 0."""
        gated = self._selected(truth, number, self.exact.zero)
        if self.exact.implies(truth, there):
            return gated
        return self._where(self.exact.either(self.exact.negated(truth), there), gated)

    def _lesser(self, both: Node, a: tuple[Node, Node], b: tuple[Node, Node]) -> Node:
        """Return the smaller or larger of two numbers; a number beats NaN."""
        if a[1] is b[1]:
            return self._where(a[1], both)
        only_a = self.exact.selected(b[1], both, a[0])
        chosen = self.exact.selected(a[1], only_a, b[0])
        return self._where(self.exact.either(a[1], b[1]), chosen)

    def _made(self, word: str, *args: Node) -> Node:
        """Return an instruction on numbers that are no NaN."""
        if word == "mul":
            return self._product(*args)
        if word == "add":
            return self._sum(*args)
        if word in ("fmin", "fmax"):
            return self._bounded(word, *args)
        if word == "if_else_zero":
            return self._selected(self.exact.truth(args[0]), args[1], self.exact.zero)
        return self.exact.made(word, *args)

    def _selected(self, truth: Node, yes: Node, no: Node) -> Node:
        """Return one of two numbers by a truth that is no negation."""
        if truth.op == "not":
            truth, yes, no = truth.args[0], no, yes
        return self.exact.selected(truth, yes, no)

    def _product(self, a: Node, b: Node) -> Node:
        """Return a product; of a condition, a selection."""
        for factor, value in ((a, b), (b, a)):
            if factor is self.exact.one:
                return value
            truth = condition(factor)
            if truth is not None:
                return self._selected(truth, value, self.exact.zero)
        return self._either_way("mul", a, b)

    def _sum(self, a: Node, b: Node) -> Node:
        """Return a sum; of what a truth and its opposite select, one selection."""
        zero = self.exact.zero
        for one, other in ((a, b), (b, a)):
            if one is zero:
                return other
        if a.op == "select" and b.op == "select" and a.args[0] is b.args[0]:
            (truth, first, second), (_, third, fourth) = a.args, b.args
            if second is zero and third is zero:
                return self.exact.selected(truth, first, fourth)
            if first is zero and fourth is zero:
                return self.exact.selected(truth, third, second)
        return self._either_way("add", a, b)

    def _either_way(self, word: str, a: Node, b: Node) -> Node:
        """Return a sum or product, the same one whichever operand stands first."""
        return self.nodes.intern(word, *sorted((a, b), key=lambda node: node.number))

    def _bounded(self, word: str, a: Node, b: Node) -> Node:
        """Return the smaller or larger of two numbers; a selection where one is constant."""
        for number, bound in ((a, b), (b, a)):
            if bound.value is None:
                continue
            if bound.value == (self.largest if word == "fmin" else -self.largest):
                return number
            compared = (number, bound) if word == "fmin" else (bound, number)
            return self._selected(self.exact.compared("lt", *compared), number, bound)
        return self.exact.made(word, a, b)


def round_to_type(value: float, real: str) -> float:
    """Return a number as a type holds it.

    Infinity is the largest number. Other numbers beyond the type stand in its upper half, in their
    order, so that comparisons with them and among them mean what they mean in double. Of float,
    what is too small is the least normal number.
    """
    if math.isnan(value):
        return value
    limits, size = np.finfo(real), abs(value)
    most, least = float(limits.max), float(limits.tiny)
    if math.isinf(value):
        return math.copysign(most, value)
    if size > most:
        place = math.log(size) / math.log(np.finfo(float).max)  # of all numbers of double, 0 to 1
        size = most / 2 * (1 + place)
        return math.copysign(float(np.dtype(real).type(size)), value)
    if real == "float32" and 0 < size < least:
        return math.copysign(least, value)
    return float(np.dtype(real).type(value))


class Gathered:
    """Rules for fused lanes. Params are steady, whether lanes share them or not."""

    def __init__(self, nodes: Nodes, granted: dict[Promise, None]) -> None:
        self.nodes, self.exact = nodes, Exact(nodes, granted=granted)
        self.real, self.two = self.exact.real, nodes.constant(2.0)

    def made(self, word: str, *args: Node) -> Node:
        """Return the number that an instruction gives, where truths are 1 or 0."""
        if word == "if_else_zero":
            return self._gated(self.exact.truth(args[0]), args[1])
        if word == "div" and _is_steady(args[1]) and not _is_steady(args[0]):
            inverse = self.nodes.intern("div", self.exact.one, args[1])
            return self._product(inverse, args[0])
        if word == "mul":
            return self._product(*args)
        return self.exact.made(word, *args)

    def constant(self, value: float) -> Node:
        """Return a number that is written down."""
        return self.exact.constant(value)

    def _product(self, a: Node, b: Node) -> Node:
        """Return a b, with what is steady ahead and in one factor, where no condition is a
        factor.
        """
        for factor, value in ((a, b), (b, a)):
            truth = condition(factor)
            if truth is not None:
                return self._gated(truth, value)
        for factor, value in ((a, b), (b, a)):
            is_doubling = factor is self.two  # exact, and so not worth gathering
            if _is_steady(factor) and not _is_steady(value) and not is_doubling:
                inner, rest = _factors(value)
                if inner is not None:
                    factor = self._product(factor, inner)
                return self.nodes.intern("mul", factor, rest)
        return self.nodes.intern("mul", a, b)

    def _gated(self, truth: Node, value: Node) -> Node:
        """Return the value where a truth holds, else 0; a steady factor and a sign stay outside."""
        factor, rest = _factors(value)
        if factor is not None:
            return self.nodes.intern("mul", factor, self._gated(truth, rest))
        if value.op == "neg":
            return self.nodes.intern("neg", self._gated(truth, value.args[0]))
        return self.exact.selected(truth, value, self.exact.zero)


def _conjuncts(truth: Node) -> list[Node]:
    """What must hold together for a truth to hold."""
    if truth.op != "and":
        return [truth]
    return _conjuncts(truth.args[0]) + _conjuncts(truth.args[1])


def _sides(number: Node) -> tuple[Node, ...]:
    """Return the truths a and b of a number [a] - [b]; empty for other numbers."""
    if number.op != "sub":
        return ()
    truths = [condition(arg) for arg in number.args]
    return tuple(truth for truth in truths if truth is not None) if all(truths) else ()


def _is_steady(number: Node) -> bool:
    """Return whether a number depends on constants and params alone."""
    return number.level < SHARED


def _factors(number: Node) -> tuple[Node | None, Node]:
    """Return the steady factor and the rest of a product that has one; else None and the number."""
    if not _is_steady(number) and number.op == "mul" and _is_steady(number.args[0]):
        return number.args[0], number.args[1]
    return None, number
