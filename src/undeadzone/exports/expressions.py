"""A node as a C expression, with parentheses wherever precedence is not plain."""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile.graph import Graph
from undeadzone.exports.instructions import (
    BINARY,
    BITWISE,
    LIBRARY,
    OWN,
    SELECT,
    is_condition,
)

LARGEST, LEAST = 3.4028234663852886e38, 1.1754943508222875e-38  # FLT_MAX, FLT_MIN
_SUMS, _PRODUCTS = (ca.OP_ADD, ca.OP_SUB), (ca.OP_MUL, ca.OP_SQ, ca.OP_TWICE)


class Style(NamedTuple):
    """How numbers and functions are written.

    Attributes:
        single: whether the numbers are float, else double.
        prefix: what the names of the export's own functions begin with.
    """

    single: bool
    prefix: str

    @property
    def real(self) -> str:
        """The type of a number in C."""
        return "float" if self.single else "double"


class Text(NamedTuple):
    """A C expression.

    Attributes:
        text: the expression.
        op: the instruction of its outermost operator; None: it needs no parentheses anywhere.
    """

    text: str
    op: int | None = None


def held(value: float, single: bool) -> float:
    """A number as its type holds it; beyond float stand its largest and least normal numbers."""
    if not single:
        return math.copysign(np.finfo(float).max, value) if math.isinf(value) else value
    if math.isnan(value):
        return value
    size = abs(value)
    if size > LARGEST:
        return math.copysign(LARGEST, value)
    if 0 < size < LEAST:
        return math.copysign(LEAST, value)
    return float(np.float32(value))


def literal(value: float, single: bool) -> str:
    """A number in C; its text means these bits and no others."""
    if math.isnan(value):
        return "NAN" if single else "(double)NAN"
    kept = held(value, single)
    sign = "-" if math.copysign(1.0, kept) < 0 else ""
    size = abs(kept)
    if size == (LARGEST if single else np.finfo(float).max):
        return sign + ("FLT_MAX" if single else "DBL_MAX")
    if single and size == LEAST:
        return f"{sign}FLT_MIN"
    if single:
        return f"{sign}{_decimal(str(np.float32(size)))}f"
    return sign + _decimal(repr(size))


def _decimal(text: str) -> str:
    """A decimal number with a point or an exponent."""
    return text if "." in text or "e" in text else f"{text}.0"


class Expressions:
    """The C expressions of a graph's nodes.

    Args:
        graph: the graph.
        style: how numbers and functions are written.
        inputs: the C expression of each input entry, by its text in the graph.

    Attributes:
        names: the locals that hold nodes, by place.
        functions: the functions used so far.
    """

    def __init__(self, graph: Graph, style: Style, inputs: dict[str, str]) -> None:
        self.nodes = graph.nodes
        self.style = style
        self.inputs = inputs
        self.names: dict[int, str] = {}
        self.functions: set[str] = set()

    def value(self, place: int) -> Text:
        """A node as a number."""
        text = self.text(place)
        if not is_condition(self.nodes[place]):
            return text
        one, zero = self._literal(1.0), self._literal(0.0)
        return Text(f"{_inside(text)} ? {one} : {zero}", SELECT)

    def condition(self, place: int) -> Text:
        """A node as a condition."""
        node = self.nodes[place]
        if is_condition(node):
            return self.text(place)
        if node.op == ca.OP_CONST:
            return Text("true" if float(node.text) else "false")
        zero = self._literal(0.0)
        return Text(f"{_operand(self.value(place), ca.OP_NE)} != {zero}", ca.OP_NE)

    def text(self, place: int) -> Text:
        """A node as it is."""
        node = self.nodes[place]
        if place in self.names:
            return Text(self.names[place])
        if node.op == ca.OP_INPUT:
            return Text(self.inputs[node.text])
        if node.op == ca.OP_CONST:
            text = self._literal(float(node.text))
            return Text(text, ca.OP_NEG if text.startswith("-") else None)
        return self._composed(node.op, node.operands)

    def _composed(self, op: int, operands: tuple[int, ...]) -> Text:
        """An instruction on its operands."""
        if op == SELECT:
            condition = self.condition(operands[0])
            yes, no = (self.value(operand) for operand in operands[1:])
            return Text(f"{_inside(condition)} ? {_inside(yes)} : {_inside(no)}", op)
        if op in (ca.OP_AND, ca.OP_OR):
            a, b = (_operand(self.condition(operand), op) for operand in operands)
            return Text(f"{a} {BINARY[op]} {b}", op)
        if op == ca.OP_NOT:
            return Text(f"!{_operand(self.condition(operands[0]), op)}", op)
        values = [self.value(operand) for operand in operands]
        if op in BINARY:
            a, b = _operand(values[0], op), _operand(values[1], op, second=True)
            return Text(f"{a} {BINARY[op]} {b}", op)
        return self._unary(op, values)

    def _unary(self, op: int, values: list[Text]) -> Text:
        """An instruction that C has no sign for, or a negation."""
        first = _operand(values[0], op)
        if op == ca.OP_NEG:
            return Text(f"-{first}", op)
        if op == ca.OP_INV:
            denominator = _operand(values[0], ca.OP_DIV, second=True)
            return Text(f"{self._literal(1.0)} / {denominator}", ca.OP_DIV)
        if op == ca.OP_TWICE:
            return Text(f"{self._literal(2.0)} * {first}", ca.OP_MUL)
        if op == ca.OP_SQ:
            return Text(f"{first} * {first}", ca.OP_MUL)
        return Text(f"{self._function(op)}({', '.join(value.text for value in values)})")

    def _function(self, op: int) -> str:
        """The name of a function in C, which is noted as used."""
        if op in LIBRARY:
            name = LIBRARY[op]
            return f"{name}f" if self.style.single else name
        name = BITWISE.get(op) or OWN[op]
        self.functions.add(name)
        return f"{self.style.prefix}_{name}"

    def _literal(self, value: float) -> str:
        return literal(value, self.style.single)


def _inside(text: Text) -> str:
    """An expression as a part of a selection."""
    return text.text if text.op is None else f"({text.text})"


def _operand(text: Text, op: int, second: bool = False) -> str:
    """An operand; only sums of sums and products of products go without parentheses."""
    if text.op is None or (text.op == ca.OP_NEG and op in BINARY and not second):
        return text.text
    alike = op in _SUMS and text.op in _SUMS
    alike = alike or (op == ca.OP_MUL and text.op in _PRODUCTS)
    alike = alike or (op == text.op and op in (ca.OP_AND, ca.OP_OR))
    return text.text if alike and not second else f"({text.text})"
