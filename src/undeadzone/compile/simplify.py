"""Simplification rules: the same values by fewer instructions.

`ExactRules` changes no bit. `PortableRules`, for exported code, changes the sign of zero, and the
value of 0 times infinity: conditions select instead of multiplying by 0 and 1, and NaN is left in
results alone. `FusedRules`, for fused lanes, rounds otherwise: conditions move into products,
inverses of steady values and products with them are gathered.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Final

import numpy as np

from undeadzone.compile import assumptions
from undeadzone.compile.assumptions import KernelAssumption
from undeadzone.compile.casadi_reader import ARITHMETIC
from undeadzone.compile.graph import SHARED, Node, Nodes, to_condition

_COMPARED: Final = {"lt": operator.lt, "le": operator.le, "eq": operator.eq, "ne": operator.ne}


class ExactRules:
    """Rules that preserve every bit: those of truths and selections.

    Args:
        nodes: where nodes are made.
        real: the type of numbers.
        granted: promises that may be taken for granted (grows). None: none may.
    """

    def __init__(
        self,
        nodes: Nodes,
        real: str = "float64",
        granted: dict[KernelAssumption, None] | None = None,
    ) -> None:
        self.nodes, self.real, self.granted = nodes, real, granted
        self.zero, self.one = nodes.intern_constant(0.0, real), nodes.intern_constant(1.0, real)
        self.no, self.yes = nodes.intern_constant(0, "bool"), nodes.intern_constant(1, "bool")
        self._implied: dict[tuple[Node, Node], bool] = {}

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers. Truths are 1 or 0."""
        if word in _COMPARED:
            return self.to_number(self.compare_numbers(word, *args))
        truths: dict[str, Callable[..., Node]] = {
            "not": self.negate_truth,
            "and": self.join_truths,
            "or": self.either_truth,
        }
        if word in truths:
            return self.to_number(truths[word](*map(self.to_truth, args)))
        if word == "if_else_zero":
            return self.select_number(self.to_truth(args[0]), args[1], self.zero)
        if word in ARITHMETIC:
            return self.nodes.intern(word, *args)
        if word in ("fmin", "fmax") and all(map(to_condition, args)):
            return self.build_instruction("and" if word == "fmin" else "or", *args)
        return self.nodes.intern("call", *args, text=word)

    def build_constant(self, value: float) -> Node:
        """Return the node of a constant."""
        return self.nodes.intern_constant(value, self.real)

    # --- Truths

    def to_number(self, truth: Node) -> Node:
        """Return a truth as the number 1 or 0."""
        if truth.constant_value is not None:
            return self.one if truth.constant_value else self.zero
        return self.nodes.intern("select", truth, self.one, self.zero)

    def to_truth(self, number: Node) -> Node:
        """Return the truth that a number is not 0."""
        return to_condition(number) or self.compare_numbers("ne", number, self.zero)

    def negate_truth(self, truth: Node) -> Node:
        """Return the negation of a truth."""
        if truth.constant_value is not None:
            return self.no if truth.constant_value else self.yes
        return truth.args[0] if truth.op == "not" else self.nodes.intern("not", truth)

    def join_truths(self, a: Node, b: Node) -> Node:
        """Return the conjunction of two truths."""
        for one, other in ((a, b), (b, a)):
            if one.constant_value is not None:
                return other if one.constant_value else self.no
            if self.implies(one, other):
                return one
        return self.nodes.intern("and", a, b)

    def either_truth(self, a: Node, b: Node) -> Node:
        """Return the disjunction of two truths."""
        for one, other in ((a, b), (b, a)):
            if one.constant_value is not None:
                return self.yes if one.constant_value else other
            if self.implies(one, other):
                return other
        return self.nodes.intern("or", a, b)

    def implies(self, one: Node, other: Node) -> bool:
        """Return whether a truth is known to imply a second truth.

        Each pair is tested once: truths share their parts, and have more paths than nodes.
        """
        if (one, other) not in self._implied:
            self._implied[one, other] = self._check_implication(one, other)
        return self._implied[one, other]

    def _check_implication(self, one: Node, other: Node) -> bool:
        """Determine `implies` from the parts of two truths."""
        if one is other or other.constant_value == 1.0:
            return True
        every, some = {"and": all, "or": any}, {"and": any, "or": all}
        if other.op in every and every[other.op](self.implies(one, part) for part in other.args):
            return True
        if one.op in some:
            return some[one.op](self.implies(part, other) for part in one.args)
        return one.op == "lt" and other.op == "ne" and set(one.args) == set(other.args)

    def compare_numbers(self, word: str, a: Node, b: Node) -> Node:
        """Return the truth of a comparison of numbers."""
        compare, (x, y), (this, that) = (
            _COMPARED[word],
            (a.constant_value, b.constant_value),
            map(to_condition, (a, b)),
        )
        if x is not None and y is not None:
            return self.yes if compare(x, y) else self.no
        if this is not None and y is not None:
            return self._choose_truth(this, compare(1.0, y), compare(0.0, y))
        if that is not None and x is not None:
            return self._choose_truth(that, compare(x, 1.0), compare(x, 0.0))
        if this is not None and that is not None and word in ("eq", "ne"):
            return self._compare_truths(word, this, that)
        if y == 0.0 and _truths_of_difference(a):
            return self._compare_difference(word, *_truths_of_difference(a)[::-1])
        if x == 0.0 and _truths_of_difference(b):
            return self._compare_difference(word, *_truths_of_difference(b))
        return self.nodes.intern(word, a, b, kind="bool")

    def _choose_truth(self, truth: Node, yes: bool, no: bool) -> Node:
        """Return one of two known truths, selected by a third truth."""
        if yes == no:
            return self.yes if yes else self.no
        return truth if yes else self.negate_truth(truth)

    def _compare_truths(self, word: str, a: Node, b: Node) -> Node:
        """Return whether exactly one of two truths holds, negated for `eq`."""
        unequal = self.nodes.intern("ne", a, b)
        return unequal if word == "ne" else self.negate_truth(unequal)

    def _compare_difference(self, word: str, more: Node, less: Node) -> Node:
        """Return the comparison of 0 with the difference [more] - [less] of two truths."""
        exclusive = self._is_exclusive(more, less) or self._is_exclusive(less, more)
        if word in ("eq", "ne") and exclusive:
            some = self.either_truth(more, less)
            return some if word == "ne" else self.negate_truth(some)
        if word in ("eq", "ne"):
            return self._compare_truths(word, more, less)
        if word == "le":
            return self.either_truth(more, self.negate_truth(less))
        return more if exclusive else self.join_truths(more, self.negate_truth(less))

    def _is_exclusive(self, a: Node, b: Node) -> bool:
        """Return whether high < y is a part of a truth and y < low of the second, low not
        above high.
        """
        for above in _find_conjuncts(a):
            for below in _find_conjuncts(b):
                promise = assumptions.exclusion_assumption(above, below)
                if promise is None:
                    continue
                if promise.is_evident:
                    return True
                if promise.is_open and self.granted is not None:
                    self.granted[promise] = None
                    return True
        return False

    # --- Selections

    def select_number(self, truth: Node, yes: Node, no: Node) -> Node:
        """Return the selection of two numbers by a truth."""
        if truth.constant_value is not None:
            return yes if truth.constant_value else no
        inner = to_condition(yes)
        if inner is not None and no is self.zero:
            return self.to_number(self.join_truths(truth, inner))
        yes = self._simplify_under(truth, yes)
        if yes.op == "select" and yes.args[2] is no:
            return self.select_number(self.join_truths(truth, yes.args[0]), yes.args[1], no)
        return yes if yes is no else self.nodes.intern("select", truth, yes, no)

    def _simplify_under(self, truth: Node, number: Node) -> Node:
        """Return a number under a truth, without the selections that the truth decides."""
        if number.op == "select" and self.implies(truth, number.args[0]):
            return self._simplify_under(truth, number.args[1])
        if number.op == "neg":
            return self.nodes.intern("neg", self._simplify_under(truth, number.args[0]))
        return number


class PortableRules:
    """Rules for exported code.

    A value that is NaN if a truth fails is a selection of NaN, and all that is computed with it is
    one, too: the code computes with numbers alone.
    """

    def __init__(self, nodes: Nodes, real: str) -> None:
        self.nodes, self.real, self.exact = nodes, real, ExactRules(nodes, real)
        self.nan, self.largest = (
            nodes.intern_constant(math.nan, real),
            round_to_type(math.inf, real),
        )

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers. Truths are 1 or 0."""
        numbers, there = zip(*map(self._number_and_validity, args), strict=True)
        if all(each is self.exact.yes for each in there):
            return self._build_valid(word, *numbers)
        if word in ("not", "and", "or"):
            return self._build_valid(word, *map(self._nonzero_number, args))
        if word == "if_else_zero":
            return self._gate_valid(
                self.exact.to_truth(self._nonzero_number(args[0])),
                *self._number_and_validity(args[1]),
            )
        if word in ("fmin", "fmax"):
            return self._extreme_of_valid(
                self._build_valid(word, *numbers), *zip(numbers, there, strict=True)
            )
        both = there[0] if len(there) == 1 else self.exact.join_truths(*there)
        if word not in _COMPARED:
            return self._nan_unless(both, self._build_valid(word, *numbers))
        numbers = tuple(self.exact._simplify_under(both, number) for number in numbers)
        plain = self.exact.compare_numbers(word, *numbers)
        if word == "ne":
            return self.exact.to_number(
                self.exact.either_truth(self.exact.negate_truth(both), plain)
            )
        return self.exact.to_number(self.exact.join_truths(both, plain))

    def build_constant(self, value: float) -> Node:
        """Return the node of a constant."""
        return self.nodes.intern_constant(round_to_type(value, self.real), self.real)

    def is_number(self, node: Node) -> bool:
        """Return whether no rule makes a node NaN."""
        return self._number_and_validity(node)[1] is self.exact.yes

    def _number_and_validity(self, node: Node) -> tuple[Node, Node]:
        """Return the number of a node, and the condition without which the node is NaN."""
        if node is self.nan:
            return self.exact.zero, self.exact.no
        if node.op != "select" or node.args[2] is not self.nan:
            return node, self.exact.yes
        truth, number, _ = node.args
        if number.op == "input":  # an absent input counts as 0
            number = self.exact.select_number(truth, number, self.exact.zero)
        return number, truth

    def _nan_unless(self, truth: Node, number: Node) -> Node:
        """Return a number if a truth holds, else NaN."""
        return self.exact.select_number(truth, number, self.nan)

    def _nonzero_number(self, node: Node) -> Node:
        """Return 1 if a number is not 0 or is NaN, else 0. The result is never NaN."""
        number, there = self._number_and_validity(node)
        absent = self.exact.negate_truth(there)
        return self.exact.to_number(self.exact.either_truth(absent, self.exact.to_truth(number)))

    def _gate_valid(self, truth: Node, number: Node, there: Node) -> Node:
        """Return a number if a truth holds, else 0, with NaN if the number is invalid."""
        gated = self._select_positive(truth, number, self.exact.zero)
        if self.exact.implies(truth, there):
            return gated
        return self._nan_unless(
            self.exact.either_truth(self.exact.negate_truth(truth), there), gated
        )

    def _extreme_of_valid(self, both: Node, a: tuple[Node, Node], b: tuple[Node, Node]) -> Node:
        """Return the minimum or maximum of two numbers. A number takes precedence over
        NaN.
        """
        if a[1] is b[1]:
            return self._nan_unless(a[1], both)
        only_a = self.exact.select_number(b[1], both, a[0])
        chosen = self.exact.select_number(a[1], only_a, b[0])
        return self._nan_unless(self.exact.either_truth(a[1], b[1]), chosen)

    def _build_valid(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers that are not NaN."""
        if word == "mul":
            return self._build_product(*args)
        if word == "add":
            return self._build_sum(*args)
        if word in ("fmin", "fmax"):
            return self._build_extreme(word, *args)
        if word == "if_else_zero":
            return self._select_positive(self.exact.to_truth(args[0]), args[1], self.exact.zero)
        return self.exact.build_instruction(word, *args)

    def _select_positive(self, truth: Node, yes: Node, no: Node) -> Node:
        """Return the selection of two numbers by a truth, with a negation of the truth
        resolved.
        """
        if truth.op == "not":
            truth, yes, no = truth.args[0], no, yes
        return self.exact.select_number(truth, yes, no)

    def _build_product(self, a: Node, b: Node) -> Node:
        """Return a product, as a selection if a factor is a condition."""
        for factor, value in ((a, b), (b, a)):
            if factor is self.exact.one:
                return value
            if factor.constant_value == -1.0:
                return self.nodes.intern("neg", value)
            truth = to_condition(factor)
            if truth is not None:
                return self._select_positive(truth, value, self.exact.zero)
        return self._build_commutative("mul", a, b)

    def _build_sum(self, a: Node, b: Node) -> Node:
        """Return a sum, as a single selection if a truth and its opposite select the
        terms.
        """
        zero = self.exact.zero
        for one, other in ((a, b), (b, a)):
            if one is zero:
                return other
            if one.op == "neg":
                return self.nodes.intern("sub", other, one.args[0])
        if a.op == "select" and b.op == "select" and a.args[0] is b.args[0]:
            (truth, first, second), (_, third, fourth) = a.args, b.args
            if second is zero and third is zero:
                return self.exact.select_number(truth, first, fourth)
            if first is zero and fourth is zero:
                return self.exact.select_number(truth, third, second)
        return self._build_commutative("add", a, b)

    def _build_commutative(self, word: str, a: Node, b: Node) -> Node:
        """Return a sum or product, equal for both orders of the operands."""
        return self.nodes.intern(word, *sorted((a, b), key=lambda node: node.number))

    def _build_extreme(self, word: str, a: Node, b: Node) -> Node:
        """Return the minimum or maximum of two numbers, as a selection if an operand is
        constant.
        """
        for number, bound in ((a, b), (b, a)):
            if bound.constant_value is None:
                continue
            if bound.constant_value == (self.largest if word == "fmin" else -self.largest):
                return number
            compared = (number, bound) if word == "fmin" else (bound, number)
            return self._select_positive(self.exact.compare_numbers("lt", *compared), number, bound)
        return self.exact.build_instruction(word, a, b)


def round_to_type(value: float, real: str) -> float:
    """Return a number rounded to a type, with finite values for infinite and large numbers.

    Infinity is the largest number. Other numbers beyond the type stand in its upper half, in their
    order, so that comparisons with them and among them have the same result as in double. For
    float, a number that is too small becomes the least normal number.
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


class FusedRules:
    """Rules for fused lanes. Params are steady, whether lanes share them or not."""

    def __init__(self, nodes: Nodes, granted: dict[KernelAssumption, None]) -> None:
        self.nodes, self.exact = nodes, ExactRules(nodes, granted=granted)
        self.real, self.two = self.exact.real, nodes.intern_constant(2.0)

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers. Truths are 1 or 0."""
        if word == "if_else_zero":
            return self._gate_gathered(self.exact.to_truth(args[0]), args[1])
        if word == "div" and _is_steady(args[1]) and not _is_steady(args[0]):
            inverse = self.nodes.intern("div", self.exact.one, args[1])
            return self._gather_product(inverse, args[0])
        if word == "mul":
            return self._gather_product(*args)
        return self.exact.build_instruction(word, *args)

    def build_constant(self, value: float) -> Node:
        """Return the node of a constant."""
        return self.exact.build_constant(value)

    def _gather_product(self, a: Node, b: Node) -> Node:
        """Return a b with the steady factors first and gathered, and without conditions as
        factors.
        """
        for factor, value in ((a, b), (b, a)):
            truth = to_condition(factor)
            if truth is not None:
                return self._gate_gathered(truth, value)
        for factor, value in ((a, b), (b, a)):
            is_doubling = factor is self.two  # exact, and so not worth gathering
            if _is_steady(factor) and not _is_steady(value) and not is_doubling:
                inner, rest = _split_steady_factor(value)
                if inner is not None:
                    factor = self._gather_product(factor, inner)
                return self.nodes.intern("mul", factor, rest)
        return self.nodes.intern("mul", a, b)

    def _gate_gathered(self, truth: Node, value: Node) -> Node:
        """Return the value if a truth holds, else 0. A steady factor and a sign stay
        outside.
        """
        factor, rest = _split_steady_factor(value)
        if factor is not None:
            return self.nodes.intern("mul", factor, self._gate_gathered(truth, rest))
        if value.op == "neg":
            return self.nodes.intern("neg", self._gate_gathered(truth, value.args[0]))
        return self.exact.select_number(truth, value, self.exact.zero)


def _find_conjuncts(truth: Node) -> list[Node]:
    """Return the truths whose conjunction is a truth."""
    if truth.op != "and":
        return [truth]
    return _find_conjuncts(truth.args[0]) + _find_conjuncts(truth.args[1])


def _truths_of_difference(number: Node) -> tuple[Node, ...]:
    """Return the truths a and b of a number [a] - [b], or an empty tuple for other numbers."""
    if number.op != "sub":
        return ()
    truths = [to_condition(arg) for arg in number.args]
    return tuple(truth for truth in truths if truth is not None) if all(truths) else ()


def _is_steady(number: Node) -> bool:
    """Return whether a number depends on constants and params alone."""
    return number.level < SHARED


def _split_steady_factor(number: Node) -> tuple[Node | None, Node]:
    """Return the steady factor and the rest of a product, None and the number without such a
    factor.
    """
    if not _is_steady(number) and number.op == "mul" and _is_steady(number.args[0]):
        return number.args[0], number.args[1]
    return None, number
