"""A growing list of nodes in which none stands twice, simplified as it grows.

Every bit is kept but the sign of zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca

from undeadzone.compile.graph import CONDITIONS, Node
from undeadzone.exports.instructions import SELECT

_COMPARED = {
    ca.OP_LT: lambda a, b: a < b,
    ca.OP_LE: lambda a, b: a <= b,
    ca.OP_EQ: lambda a, b: a == b,
    ca.OP_NE: lambda a, b: a != b,
}


class Rewriting(NamedTuple):
    """A growing list of nodes in which none stands twice.

    Attributes:
        nodes: the nodes so far.
        places: where each node stands.
    """

    nodes: list[Node]
    places: dict[Node, int]

    def made(self, op: int, operands: list[int], text: str = "") -> int:
        """The node of an instruction on numbers, or a simpler one of the same value."""
        if op in _COMPARED:
            return self._comparison(op, *operands)
        if op == ca.OP_NOT:
            return self.negated(self.truth(*operands))
        if op == ca.OP_AND:
            return self.both(*map(self.truth, operands))
        if op == ca.OP_OR:
            return self.either(*map(self.truth, operands))
        if op == ca.OP_MUL:
            return self._product(*operands)
        if op == ca.OP_IF_ELSE_ZERO:
            return self.selected(self.truth(operands[0]), operands[1], self.constant(0.0))
        if op == ca.OP_ADD:
            return self._sum(*operands)
        if op in (ca.OP_FMIN, ca.OP_FMAX):
            return self._bounded(op, *operands)
        if op in (ca.OP_ASSIGN, ca.OP_LIFT):
            return operands[0]
        return self.kept(op, operands, text)

    # --- Conditions

    def truth(self, place: int) -> int:
        """A number as a condition."""
        number = self.number(place)
        if number is not None:
            return self.constant(1.0 if number else 0.0)
        return place if self.is_condition(place) else self._differs(place)

    def negated(self, condition: int) -> int:
        """Where a condition does not hold."""
        number = self.number(condition)
        if number is not None:
            return self.constant(0.0 if number else 1.0)
        node = self.nodes[condition]
        if node.op == ca.OP_NOT and self.is_condition(node.operands[0]):
            return node.operands[0]
        return self.kept(ca.OP_NOT, [condition])

    def both(self, a: int, b: int) -> int:
        """Where two conditions hold."""
        for one, other in ((a, b), (b, a)):
            number = self.number(one)
            if number is not None:
                return other if number else self.constant(0.0)
            if self.implies(one, other):
                return one
        return self.kept(ca.OP_AND, [a, b])

    def either(self, a: int, b: int) -> int:
        """Where one of two conditions holds."""
        for one, other in ((a, b), (b, a)):
            number = self.number(one)
            if number is not None:
                return self.constant(1.0) if number else other
            if self.implies(one, other):
                return other
        return self.kept(ca.OP_OR, [a, b])

    def implies(self, one: int, other: int) -> bool:
        """Whether a condition holds only where another does, as far as that shows."""
        if one == other:
            return True
        this, that = self.nodes[one], self.nodes[other]
        if that.op == ca.OP_AND and all(self.implies(one, part) for part in that.operands):
            return True
        if that.op == ca.OP_OR and any(self.implies(one, part) for part in that.operands):
            return True
        if this.op == ca.OP_AND:
            return any(self.implies(part, other) for part in this.operands)
        return this.op == ca.OP_OR and all(self.implies(part, other) for part in this.operands)

    def _differs(self, place: int) -> int:
        """Where a number is not 0."""
        signs = self._signs(place)
        if signs is not None:
            return self.either(*signs)
        return self.kept(ca.OP_NE, [place, self.constant(0.0)])

    def _comparison(self, op: int, a: int, b: int) -> int:
        """A comparison of numbers."""
        x, y = self.number(a), self.number(b)
        if x is not None and y is not None:
            return self.constant(1.0 if _COMPARED[op](x, y) else 0.0)
        if op in (ca.OP_EQ, ca.OP_NE) and 0.0 in (x, y):
            other = b if x == 0.0 else a
            differs = other if self.is_condition(other) else self._differs(other)
            return differs if op == ca.OP_NE else self.negated(differs)
        if op == ca.OP_LT and x == 0.0:
            return self._above(b)
        if op == ca.OP_LT and y == 0.0:
            return self._below(a)
        return self.kept(op, [a, b])

    def _above(self, place: int) -> int:
        """Where 0 < a number."""
        if self.is_condition(place):
            return place
        signs = self._signs(place)
        if signs is not None:
            return signs[0]
        return self.kept(ca.OP_LT, [self.constant(0.0), place])

    def _below(self, place: int) -> int:
        """Where a number < 0."""
        signs = self._signs(place)
        if signs is not None:
            return signs[1]
        return self.kept(ca.OP_LT, [place, self.constant(0.0)])

    def _signs(self, place: int) -> tuple[int, int] | None:
        """(a, b) if a number is [a] - [b] of conditions that exclude each other."""
        node = self.nodes[place]
        if node.op != ca.OP_SUB or not all(map(self.is_condition, node.operands)):
            return None
        a, b = node.operands
        return (a, b) if self._exclude(a, b) or self._exclude(b, a) else None

    def _exclude(self, a: int, b: int) -> bool:
        """Whether c < y stands in a and y < c' in b, for constants c >= c'."""
        for above in self._conjuncts(a):
            for below in self._conjuncts(b):
                this, that = self.nodes[above], self.nodes[below]
                if this.op != ca.OP_LT or that.op != ca.OP_LT:
                    continue
                low, high = self.number(this.operands[0]), self.number(that.operands[1])
                same = this.operands[1] == that.operands[0]
                if same and self._not_above(that.operands[1], this.operands[0], high, low):
                    return True
        return False

    def _not_above(self, high: int, low: int, most: float | None, least: float | None) -> bool:
        """Whether `high` <= `low`: by their values, or as -a and a of a threshold a."""
        if most is not None and least is not None:
            return most <= least
        node = self.nodes[high]
        threshold = self.nodes[low].text.startswith("p")
        return node.op == ca.OP_NEG and node.operands[0] == low and threshold

    def _conjuncts(self, condition: int) -> list[int]:
        """What must hold together for a condition to hold."""
        node = self.nodes[condition]
        if node.op != ca.OP_AND:
            return [condition]
        return self._conjuncts(node.operands[0]) + self._conjuncts(node.operands[1])

    # --- Numbers

    def selected(self, condition: int, yes: int, no: int) -> int:
        """A selection."""
        number = self.number(condition)
        if number is not None:
            return yes if number else no
        node = self.nodes[condition]
        if node.op == ca.OP_NOT:
            return self.selected(node.operands[0], no, yes)
        zero = self.constant(0.0)
        if no == zero and self.is_condition(yes):
            return self.both(condition, yes)
        yes = self.under(condition, yes)
        inner = self.nodes[yes]
        if inner.op == SELECT and inner.operands[2] == no:
            return self.selected(self.both(condition, inner.operands[0]), inner.operands[1], no)
        return yes if yes == no else self.kept(SELECT, [condition, yes, no])

    def under(self, condition: int, place: int) -> int:
        """A number where a condition holds, without a selection that the condition decides."""
        node = self.nodes[place]
        if node.op == SELECT and self.implies(condition, node.operands[0]):
            return self.under(condition, node.operands[1])
        if node.op == ca.OP_NEG:
            return self.kept(ca.OP_NEG, [self.under(condition, node.operands[0])])
        return place

    def _bounded(self, op: int, a: int, b: int) -> int:
        """The smaller or larger of two numbers; a selection where one is constant."""
        for value, bound in ((a, b), (b, a)):
            number = self.number(bound)
            if number is None:
                continue
            if math.isinf(number) and (number > 0) == (op == ca.OP_FMIN):
                return value
            compared = [value, bound] if op == ca.OP_FMIN else [bound, value]
            return self.selected(self.made(ca.OP_LT, compared), value, bound)
        return self.kept(op, [a, b])

    def _product(self, a: int, b: int) -> int:
        """A product; of a condition, a selection."""
        zero = self.constant(0.0)
        for condition, value in ((a, b), (b, a)):
            if self.number(condition) == 1.0:
                return value
            if self.is_condition(condition):
                return self.selected(condition, value, zero)
        return self.kept(ca.OP_MUL, [a, b])

    def _sum(self, a: int, b: int) -> int:
        """A sum; of what two opposite conditions select, one selection."""
        zero = self.constant(0.0)
        for one, other in ((a, b), (b, a)):
            if one == zero and not self.is_condition(other):
                return other
        yes, no = self.nodes[a], self.nodes[b]
        if yes.op == SELECT and no.op == SELECT and yes.operands[0] == no.operands[0]:
            condition, first, second = yes.operands
            _, third, fourth = no.operands
            if second == zero and third == zero:
                return self.selected(condition, first, fourth)
            if first == zero and fourth == zero:
                return self.selected(condition, third, second)
        return self.kept(ca.OP_ADD, [a, b])

    # --- Nodes

    def constant(self, value: float) -> int:
        """The node of a number."""
        return self.kept(ca.OP_CONST, [], repr(float(value)))

    def number(self, place: int) -> float | None:
        """The value of a node that is constant."""
        node = self.nodes[place]
        return float(node.text) if node.op == ca.OP_CONST else None

    def is_condition(self, place: int) -> bool:
        """Whether a node is 1 or 0 by its instruction."""
        return self.nodes[place].op in CONDITIONS

    def kept(self, op: int, operands: list[int], text: str = "") -> int:
        """The place of an instruction as it is."""
        node = Node(op, tuple(operands), text)
        if node not in self.places:
            self.places[node] = len(self.nodes)
            self.nodes.append(node)
        return self.places[node]
