"""Formulas with Python's operators become graphs, written once for C and for its replica."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca

from undeadzone.compile.graph import Graph
from undeadzone.exports.instructions import EXPONENT, FRACTION, OWN, POWER, SELECT, TRUNCATED
from undeadzone.exports.rewriting import Rewriting

_CODES = {word: code for code, word in OWN.items()} | {"pow": ca.OP_POW}


class Traced:
    """A number of a formula; its operators write the graph down."""

    def __init__(self, nodes: Rewriting, place: int) -> None:
        self.nodes = nodes
        self.place = place

    def __add__(self, other: Traced | float) -> Traced:
        """The sum."""
        return self._with(ca.OP_ADD, other)

    def __radd__(self, other: float) -> Traced:
        """The sum."""
        return self._constant(other)._with(ca.OP_ADD, self)

    def __sub__(self, other: Traced | float) -> Traced:
        """The difference."""
        return self._with(ca.OP_SUB, other)

    def __rsub__(self, other: float) -> Traced:
        """The difference."""
        return self._constant(other)._with(ca.OP_SUB, self)

    def __mul__(self, other: Traced | float) -> Traced:
        """The product."""
        return self._with(ca.OP_MUL, other)

    def __rmul__(self, other: float) -> Traced:
        """The product."""
        return self._constant(other)._with(ca.OP_MUL, self)

    def __truediv__(self, other: Traced | float) -> Traced:
        """The quotient."""
        return self._with(ca.OP_DIV, other)

    def __rtruediv__(self, other: float) -> Traced:
        """The quotient."""
        return self._constant(other)._with(ca.OP_DIV, self)

    def __neg__(self) -> Traced:
        """The negative."""
        return self._with(ca.OP_NEG)

    def __lt__(self, other: Traced | float) -> Traced:
        """Where one number is smaller."""
        return self._with(ca.OP_LT, other)

    def __gt__(self, other: float) -> Traced:
        """Where one number is larger."""
        return self._constant(other)._with(ca.OP_LT, self)

    def equals(self, other: Traced | float) -> Traced:
        """Where two numbers are equal."""
        return self._with(ca.OP_EQ, other)

    def unlike(self, other: Traced | float) -> Traced:
        """Where two numbers differ, or one is NaN."""
        return self._with(ca.OP_NE, other)

    def either(self, other: Traced) -> Traced:
        """Where one of two conditions holds."""
        return self._with(ca.OP_OR, other)

    def chosen(self, yes: Traced | float, no: Traced | float) -> Traced:
        """`yes` where this condition holds, else `no`."""
        return self._with(SELECT, yes, no)

    def call(self, word: str, *others: Traced | float) -> Traced:
        """Another function of the export."""
        return self._with(_CODES[word], *others)

    def sqrt(self) -> Traced:
        """The square root."""
        return self._with(ca.OP_SQRT)

    def truncated(self) -> Traced:
        """The number without its fraction; smaller than 2^31 (single) or 2^63."""
        return self._with(TRUNCATED)

    def power(self) -> Traced:
        """2 to the power of a whole number, in the normal range."""
        return self._with(POWER)

    def exponent(self) -> Traced:
        """n of x = 2^n f, 1/sqrt(2) <= f < sqrt(2), of a positive normal number."""
        return self._with(EXPONENT)

    def fraction(self) -> Traced:
        """f of x = 2^n f."""
        return self._with(FRACTION)

    def _with(self, op: int, *others: Traced | float) -> Traced:
        places = [self.place]
        for other in others:
            traced = other if isinstance(other, Traced) else self._constant(other)
            places.append(traced.place)
        return Traced(self.nodes, self.nodes.kept(op, places))

    def _constant(self, value: float) -> Traced:
        return Traced(self.nodes, self.nodes.constant(value))


class Formula(NamedTuple):
    """A function of one or two numbers.

    Attributes:
        graph: one result, of inputs whose texts are their names.
        inputs: the names of its arguments.
    """

    graph: Graph
    inputs: list[str]


def traced(function: Callable[..., Traced], inputs: Sequence[str]) -> Formula:
    """The graph of a formula.

    Args:
        function: takes one `Traced` for each input.
        inputs: names of the arguments.
    """
    nodes = Rewriting([], {})
    arguments = [Traced(nodes, nodes.kept(ca.OP_INPUT, [], name)) for name in inputs]
    result = function(*arguments)
    return Formula(Graph(nodes.nodes, [[result.place]], [[]]), list(inputs))


def polynomial(x: Traced, coefficients: Sequence[float]) -> Traced:
    """coefficients[0] + coefficients[1] x + ..., by Horner's rule."""
    *lower, last = coefficients
    value: Traced | float = last
    for coefficient in reversed(lower):
        value = coefficient + x * value
    assert isinstance(value, Traced)
    return value
