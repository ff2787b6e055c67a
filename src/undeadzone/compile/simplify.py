"""Simplification rules: the same values by fewer instructions.

A truth value, or truth, has the type bool. In a CasADi graph it is a number, 1 or 0.

`ExactRules` changes no bit. `PortableRules`, for exported code, may change the sign of zero and the
value of 0 times infinity: conditions select instead of multiplying by 0 and 1, and only results may
be NaN. `FusedRules`, for fused lanes, changes the rounding: conditions move into products, and
steady factors are collected.
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
    """Rules that preserve every bit: those of truth values and selections.

    Args:
        nodes: graph to which nodes are added.
        real: NumPy's name of the type of numbers.
        granted: assumptions on params that the rules use (grows); None: they use none.
    """

    def __init__(
        self,
        nodes: Nodes,
        real: str = "float64",
        granted: dict[KernelAssumption, None] | None = None,
    ) -> None:
        self.nodes = nodes
        self.real = real
        self.granted = granted
        self.zero = nodes.intern_constant(0.0, real)
        self.one = nodes.intern_constant(1.0, real)
        self.no = nodes.intern_constant(0, "bool")
        self.yes = nodes.intern_constant(1, "bool")
        self._implied: dict[tuple[Node, Node], bool] = {}

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers, in which true is 1 and false is 0.

        Args:
            word: operation or function, by CasADi's name.
            args: its operands.
        """
        if word in _COMPARED:
            return self.to_number(self.compare_numbers(word, *args))
        operators: dict[str, Callable[..., Node]] = {
            "not": self.build_not,
            "and": self.build_and,
            "or": self.build_or,
        }
        if word in operators:
            return self.to_number(operators[word](*map(self.to_truth, args)))
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
        """Return a truth value as the number 1 or 0."""
        if truth.constant_value is not None:
            return self.one if truth.constant_value else self.zero
        return self.nodes.intern("select", truth, self.one, self.zero)

    def to_truth(self, number: Node) -> Node:
        """Return the truth value of a number: whether it is not 0."""
        return to_condition(number) or self.compare_numbers("ne", number, self.zero)

    def build_not(self, truth: Node) -> Node:
        """Return the negation of a truth value."""
        if truth.constant_value is not None:
            return self.no if truth.constant_value else self.yes
        return truth.args[0] if truth.op == "not" else self.nodes.intern("not", truth)

    def build_and(self, a: Node, b: Node) -> Node:
        """Return the conjunction of two truth values."""
        for truth, other in ((a, b), (b, a)):
            if truth.constant_value is not None:
                return other if truth.constant_value else self.no
            if self.implies(truth, other):
                return truth
        return self.nodes.intern("and", a, b)

    def build_or(self, a: Node, b: Node) -> Node:
        """Return the disjunction of two truth values."""
        for truth, other in ((a, b), (b, a)):
            if truth.constant_value is not None:
                return self.yes if truth.constant_value else other
            if self.implies(truth, other):
                return other
        return self.nodes.intern("or", a, b)

    def implies(self, premise: Node, conclusion: Node) -> bool:
        """Return whether a truth value is known to imply another.

        The result is cached: truth values share their parts, so a pair is met on many paths.
        """
        if (premise, conclusion) not in self._implied:
            self._implied[premise, conclusion] = self._check_implication(premise, conclusion)
        return self._implied[premise, conclusion]

    def _check_implication(self, premise: Node, conclusion: Node) -> bool:
        """Return `implies` by recursion over the parts of conjunctions and disjunctions."""
        if premise is conclusion or conclusion.constant_value == 1.0:
            return True
        all_or_any = {"and": all, "or": any}
        any_or_all = {"and": any, "or": all}
        if conclusion.op in all_or_any and all_or_any[conclusion.op](
            self.implies(premise, part) for part in conclusion.args
        ):
            return True
        if premise.op in any_or_all:
            return any_or_all[premise.op](self.implies(part, conclusion) for part in premise.args)
        return (
            premise.op == "lt"
            and conclusion.op == "ne"
            and set(premise.args) == set(conclusion.args)
        )

    def compare_numbers(self, word: str, a: Node, b: Node) -> Node:
        """Return the truth of a comparison of numbers."""
        compare = _COMPARED[word]
        (x, y) = (a.constant_value, b.constant_value)
        (truth_a, truth_b) = map(to_condition, (a, b))
        if x is not None and y is not None:
            return self.yes if compare(x, y) else self.no
        if truth_a is not None and y is not None:
            return self._choose_truth(truth_a, compare(1.0, y), compare(0.0, y))
        if truth_b is not None and x is not None:
            return self._choose_truth(truth_b, compare(x, 1.0), compare(x, 0.0))
        if truth_a is not None and truth_b is not None and word in ("eq", "ne"):
            return self._compare_truths(word, truth_a, truth_b)
        if y == 0.0 and _truths_of_difference(a):
            return self._compare_difference(word, *_truths_of_difference(a)[::-1])
        if x == 0.0 and _truths_of_difference(b):
            return self._compare_difference(word, *_truths_of_difference(b))
        return self.nodes.intern(word, a, b, kind="bool")

    def _choose_truth(self, truth: Node, yes: bool, no: bool) -> Node:
        """Return one of two known truths, selected by a third truth."""
        if yes == no:
            return self.yes if yes else self.no
        return truth if yes else self.build_not(truth)

    def _compare_truths(self, word: str, a: Node, b: Node) -> Node:
        """Return whether exactly one of two truths holds, negated for `eq`."""
        unequal = self.nodes.intern("ne", a, b)
        return unequal if word == "ne" else self.build_not(unequal)

    def _compare_difference(self, word: str, more: Node, less: Node) -> Node:
        """Return the truth of 0 < [more] - [less], or of another comparison of these truths."""
        exclusive = self._is_exclusive(more, less) or self._is_exclusive(less, more)
        if word in ("eq", "ne") and exclusive:
            some = self.build_or(more, less)
            return some if word == "ne" else self.build_not(some)
        if word in ("eq", "ne"):
            return self._compare_truths(word, more, less)
        if word == "le":
            return self.build_or(more, self.build_not(less))
        return more if exclusive else self.build_and(more, self.build_not(less))

    def _is_exclusive(self, a: Node, b: Node) -> bool:
        """Return whether two truths exclude each other.

        They do if a contains high < y, and b contains y < low, with low <= high.
        """
        for above in _find_conjuncts(a):
            for below in _find_conjuncts(b):
                assumption = assumptions.exclusion_assumption(above, below)
                if assumption is None:
                    continue
                if assumption.is_evident:
                    return True
                if assumption.is_open and self.granted is not None:
                    self.granted[assumption] = None
                    return True
        return False

    # --- Selections

    def select_number(self, truth: Node, yes: Node, no: Node) -> Node:
        """Return the selection of two numbers by a truth."""
        if truth.constant_value is not None:
            return yes if truth.constant_value else no
        inner = to_condition(yes)
        if inner is not None and no is self.zero:
            return self.to_number(self.build_and(truth, inner))
        yes = self._simplify_under(truth, yes)
        if yes.op == "select" and yes.args[2] is no:
            return self.select_number(self.build_and(truth, yes.args[0]), yes.args[1], no)
        return yes if yes is no else self.nodes.intern("select", truth, yes, no)

    def _simplify_under(self, truth: Node, number: Node) -> Node:
        """Return a number for the case that a truth holds, with decided selections removed."""
        if number.op == "select" and self.implies(truth, number.args[0]):
            return self._simplify_under(truth, number.args[1])
        if number.op == "neg":
            return self.nodes.intern("neg", self._simplify_under(truth, number.args[0]))
        return number


class PortableRules:
    """Rules for exported code.

    A value that may be NaN is a node `select(valid, number, NaN)`. Each instruction on such values
    gives another node of this form, so that the exported code computes with numbers only.
    """

    def __init__(self, nodes: Nodes, real: str) -> None:
        self.nodes = nodes
        self.real = real
        self.exact = ExactRules(nodes, real)
        self.nan = nodes.intern_constant(math.nan, real)
        self.largest = round_to_type(math.inf, real)

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers, in which true is 1 and false is 0."""
        numbers, valid = zip(*map(self._number_and_validity, args), strict=True)
        if all(condition is self.exact.yes for condition in valid):
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
                self._build_valid(word, *numbers), *zip(numbers, valid, strict=True)
            )
        all_valid = valid[0] if len(valid) == 1 else self.exact.build_and(*valid)
        if word not in _COMPARED:
            return self._nan_unless(all_valid, self._build_valid(word, *numbers))
        numbers = tuple(self.exact._simplify_under(all_valid, number) for number in numbers)
        comparison = self.exact.compare_numbers(word, *numbers)
        if word == "ne":
            return self.exact.to_number(
                self.exact.build_or(self.exact.build_not(all_valid), comparison)
            )
        return self.exact.to_number(self.exact.build_and(all_valid, comparison))

    def build_constant(self, value: float) -> Node:
        """Return the node of a constant."""
        return self.nodes.intern_constant(round_to_type(value, self.real), self.real)

    def is_number(self, node: Node) -> bool:
        """Return whether no rule makes a node NaN."""
        return self._number_and_validity(node)[1] is self.exact.yes

    def _number_and_validity(self, node: Node) -> tuple[Node, Node]:
        """Return the number of a node, and the truth that it is not NaN."""
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
        number, valid = self._number_and_validity(node)
        invalid = self.exact.build_not(valid)
        return self.exact.to_number(self.exact.build_or(invalid, self.exact.to_truth(number)))

    def _gate_valid(self, truth: Node, number: Node, valid: Node) -> Node:
        """Return a number if a truth holds, else 0; NaN if the truth holds and it is not valid."""
        gated = self._select_positive(truth, number, self.exact.zero)
        if self.exact.implies(truth, valid):
            return gated
        return self._nan_unless(self.exact.build_or(self.exact.build_not(truth), valid), gated)

    def _extreme_of_valid(self, extreme: Node, a: tuple[Node, Node], b: tuple[Node, Node]) -> Node:
        """Return the extreme of two values, the other one if one is NaN.

        Args:
            extreme: the minimum or maximum of both numbers.
            a, b: number of each value, and the truth that it is valid.
        """
        if a[1] is b[1]:
            return self._nan_unless(a[1], extreme)
        only_a = self.exact.select_number(b[1], extreme, a[0])
        chosen = self.exact.select_number(a[1], only_a, b[0])
        return self._nan_unless(self.exact.build_or(a[1], b[1]), chosen)

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
        """Return the selection of two numbers by a truth; a negation of the truth swaps them."""
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
        """Return a sum, as a single selection if opposite truth values select its terms."""
        zero = self.exact.zero
        for term, other in ((a, b), (b, a)):
            if term is zero:
                return other
            if term.op == "neg":
                return self.nodes.intern("sub", other, term.args[0])
        if a.op == "select" and b.op == "select" and a.args[0] is b.args[0]:
            (truth, first, second) = a.args
            (_, third, fourth) = b.args
            if second is zero and third is zero:
                return self.exact.select_number(truth, first, fourth)
            if first is zero and fourth is zero:
                return self.exact.select_number(truth, third, second)
        return self._build_commutative("add", a, b)

    def _build_commutative(self, word: str, a: Node, b: Node) -> Node:
        """Return a sum or product, equal for both orders of the operands."""
        return self.nodes.intern(word, *sorted((a, b), key=lambda node: node.number))

    def _build_extreme(self, word: str, a: Node, b: Node) -> Node:
        """Return the minimum or maximum of two numbers, a selection if one is constant."""
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

    Infinity becomes the largest number. Other numbers beyond the type are mapped to its upper half,
    in their order, so that comparisons have the same result as in double. A number that is too
    small for float32 becomes the least normal number.
    """
    if math.isnan(value):
        return value
    limits = np.finfo(real)
    size = abs(value)
    largest = float(limits.max)
    smallest = float(limits.tiny)
    if math.isinf(value):
        return math.copysign(largest, value)
    if size > largest:
        position = math.log(size) / math.log(
            np.finfo(float).max
        )  # of all numbers of double, 0 to 1
        size = largest / 2 * (1 + position)
        return math.copysign(float(np.dtype(real).type(size)), value)
    if real == "float32" and 0 < size < smallest:
        return math.copysign(smallest, value)
    return float(np.dtype(real).type(value))


class FusedRules:
    """Rules for fused lanes. Steady values, of constants and params, do not change by the step."""

    def __init__(self, nodes: Nodes, granted: dict[KernelAssumption, None]) -> None:
        self.nodes = nodes
        self.exact = ExactRules(nodes, granted=granted)
        self.real = self.exact.real
        self.two = nodes.intern_constant(2.0)

    def build_instruction(self, word: str, *args: Node) -> Node:
        """Return the node of an instruction on numbers, in which true is 1 and false is 0."""
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
        """Return the product a b, with all steady factors multiplied first.

        A condition as a factor becomes a selection.
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
        """Return a value if a truth holds, else 0, with its steady factor and sign outside."""
        factor, rest = _split_steady_factor(value)
        if factor is not None:
            return self.nodes.intern("mul", factor, self._gate_gathered(truth, rest))
        if value.op == "neg":
            return self.nodes.intern("neg", self._gate_gathered(truth, value.args[0]))
        return self.exact.select_number(truth, value, self.exact.zero)


def _find_conjuncts(truth: Node) -> list[Node]:
    """Return the truth values of which a truth value is the conjunction."""
    if truth.op != "and":
        return [truth]
    return _find_conjuncts(truth.args[0]) + _find_conjuncts(truth.args[1])


def _truths_of_difference(number: Node) -> tuple[Node, ...]:
    """Return the truth values a and b of a number [a] - [b]; an empty tuple for another number."""
    if number.op != "sub":
        return ()
    conditions = list(map(to_condition, number.args))
    return tuple(truth for truth in conditions if truth is not None) if all(conditions) else ()


def _is_steady(number: Node) -> bool:
    """Return whether a number depends on constants and params alone."""
    return number.level < SHARED


def _split_steady_factor(number: Node) -> tuple[Node | None, Node]:
    """Return the steady factor of a product and the rest; None and the number without one."""
    if not _is_steady(number) and number.op == "mul" and _is_steady(number.args[0]):
        return number.args[0], number.args[1]
    return None, number
