"""Nodes as Structured Text of IEC 61131-3: what a language without bits of numbers prints.

Each selection is an IF with a statement in either branch. In single precision each operation that
rounds has a statement of its own: compilers that keep an expression in a wider type round where it
is stored, and of + - * / and square roots of floats in double or wider that gives float's bits.
"""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np

from undeadzone.compile.graph import Node
from undeadzone.compile.portable_maths import OWN
from undeadzone.compile.print_c import (
    INDENT,
    WIDTH,
    Expressions,
    Grammar,
    Local,
    Text,
    wrap_statement,
)
from undeadzone.errors import InputError

TYPES: Final = {"float64": "LREAL", "float32": "REAL", "bool": "BOOL"}
_SIGNS: Final = {
    **{"add": "+", "sub": "-", "mul": "*", "div": "/"},
    **{"lt": "<", "le": "<=", "eq": "=", "ne": "<>"},
}
_OF_TRUTHS: Final = {"and": "AND", "or": "OR", "ne": "XOR"}
_ROUNDED: Final = ("add", "sub", "mul", "div", "call")
_LIMITS: Final = np.finfo(np.float32)  # beyond them some compilers read no LREAL, such as matiec
_SCALE: Final = 2.0**120


def literal(value: float, kind: str) -> str:
    """Return a number with its type in an expression; its text means these bits and no others.

    Of infinity, and of NaN, it is the largest number.
    """
    size = _storable_number(value, kind)
    text = f"{TYPES[kind]}#{_digits(abs(size), kind)}"
    return f"-{text}" if math.copysign(1.0, size) < 0 else text


def assign_number(name: str, value: float, kind: str) -> list[str]:
    """Return statements that store a number; beyond the range of REAL they are exact products."""
    size, factor = _storable_number(value, kind), 1.0
    count = 0
    while kind == "float64" and abs(size) > float(_LIMITS.max):
        size, factor, count = size / _SCALE, _SCALE, count + 1
    while kind == "float64" and 0.0 < abs(size) < float(_LIMITS.tiny):
        size, factor, count = size * _SCALE, 1.0 / _SCALE, count + 1
    more = f"{name} := {name} * {literal(factor, kind)};"
    return [f"{name} := {literal(size, kind)};", *[more] * count]


def initial(value: float, kind: str) -> str:
    """Return a number in a declaration, without its type, which stands beside it."""
    size = _storable_number(value, kind)
    return ("-" if math.copysign(1.0, size) < 0 else "") + _digits(abs(size), kind)


def _storable_number(value: float, kind: str) -> float:
    """Return a number that can be written down."""
    largest = float(np.finfo(kind).max)
    return largest if math.isnan(value) else max(-largest, min(value, largest))


def _digits(size: float, kind: str) -> str:
    """Return the digits of a number, with a point and a capital E."""
    text = str(np.float32(size)) if kind == "float32" else repr(float(size))
    mantissa, letter, power = text.partition("e")
    whole = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{whole}{letter.upper()}{power}"


def _constant(node: Node) -> Text:
    """What is written down."""
    if node.kind == "bool":
        return Text("TRUE" if node.value else "FALSE")
    text = literal(float(node.text), node.kind)
    return Text(text, "neg" if text.startswith("-") else "")


def _library(name: str, kind: str) -> str:
    """Return a function that the standard has. Raises InputError for others."""
    if name != "sqrt":
        raise InputError(f"export: Structured Text has no function {name} of {TYPES[kind]}")
    return "SQRT"


def _apart(order: list[Node]) -> set[Node]:
    """Return selections, long constants, and in single precision what rounds inside an
    expression.
    """
    apart: set[Node] = set()
    for node in order:
        if node.op == "select" or len(_store_constant(node)) > 1:
            apart.add(node)
        if node.op != "select":
            apart.update(arg for arg in node.args if _rounds(arg))
    return apart


def _store_constant(node: Node) -> list[str]:
    """Return the statements that store a constant; none for other nodes."""
    is_number = node.op == "const" and node.is_real
    return assign_number("", float(node.text), node.kind) if is_number else []


def _rounds(node: Node) -> bool:
    """Return whether a node is a float that an operation rounds."""
    return node.kind == "float32" and node.op in _ROUNDED


def _statement(name: str, node: Node, expressions: Expressions) -> list[str]:
    """What fills a local: an assignment, or one in each branch of an IF."""
    if node.op == "const":
        return [INDENT + line for line in assign_number(name, float(node.text), node.kind)]
    if node.op != "select":
        return wrap_statement(f"{name} := {expressions.text(node).text};")
    truth, yes, no = (expressions.text(arg).text for arg in node.args)
    heads = (f"IF {truth} THEN", f"{name} := {yes};", "ELSE", f"{name} := {no};", "END_IF;")
    line = INDENT + " ".join(heads)
    if len(line) <= WIDTH:
        return [line]
    indents = (INDENT, 2 * INDENT, INDENT, 2 * INDENT, INDENT)
    pairs = zip(heads, indents, strict=True)
    return list(itertools.chain(*[wrap_statement(head, indent) for head, indent in pairs]))


ST: Final = Grammar(
    TYPES, _SIGNS, _OF_TRUTHS, "NOT ", OWN, _constant, _library, apart=_apart, statement=_statement
)


def reads(local: Local, held: dict[Node, str]) -> list[Node]:
    """Return the inputs and the other locals' nodes that the statement of a local reads.

    Args:
        local: the local.
        held: the names of all locals.
    """
    found: dict[Node, None] = {}
    waiting = list(reversed(local.node.args))
    while waiting:
        node = waiting.pop()
        if node in held or node.op == "input":
            found[node] = None
        else:
            waiting.extend(reversed(node.args))
    return list(found)
