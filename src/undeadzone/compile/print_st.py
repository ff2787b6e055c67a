"""Nodes as Structured Text of IEC 61131-3, a language without access to the bits of numbers.

Each selection is an IF with a statement in either branch. In single precision each operation that
rounds has a statement of its own: compilers that keep an expression in a wider type round when it
is stored, and of + - * / and square roots of floats in double or wider that gives float's bits.
"""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np

from undeadzone.compile.graph import LANGUAGES, Node
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

TYPES, _SIGNS, _OF_TRUTHS = LANGUAGES["st"].values()
_ROUNDED: Final = ("add", "sub", "mul", "div", "call")
_LIMITS: Final = np.finfo(np.float32)  # beyond them some compilers read no LREAL, such as matiec
_SCALE: Final = 2.0**120


def st_literal(value: float, kind: str) -> str:
    """Return a number with its type for an expression that represents exactly these bits.

    Of infinity, and of NaN, it is the largest number.
    """
    size = _clip_to_type(value, kind)
    text = f"{TYPES[kind]}#{_decimal_digits(abs(size), kind)}"
    return f"-{text}" if math.copysign(1.0, size) < 0 else text


def assign_number(name: str, value: float, kind: str) -> list[str]:
    """Return statements that store a number. Beyond the range of REAL they are exact products."""
    size = _clip_to_type(value, kind)
    factor = 1.0
    count = 0
    while kind == "float64" and abs(size) > float(_LIMITS.max):
        size = size / _SCALE
        factor = _SCALE
        count = count + 1
    while kind == "float64" and 0.0 < abs(size) < float(_LIMITS.tiny):
        size = size * _SCALE
        factor = 1.0 / _SCALE
        count = count + 1
    more = f"{name} := {name} * {st_literal(factor, kind)};"
    return [f"{name} := {st_literal(size, kind)};", *[more] * count]


def initial_literal(value: float, kind: str) -> str:
    """Return a number for a declaration, without its type, which the declaration contains."""
    size = _clip_to_type(value, kind)
    return ("-" if math.copysign(1.0, size) < 0 else "") + _decimal_digits(abs(size), kind)


def _clip_to_type(value: float, kind: str) -> float:
    """Return a number clipped to the range of its type, NaN as the largest number."""
    largest = float(np.finfo(kind).max)
    return largest if math.isnan(value) else max(-largest, min(value, largest))


def _decimal_digits(size: float, kind: str) -> str:
    """Return the digits of a number, with a point and a capital E."""
    text = str(np.float32(size)) if kind == "float32" else repr(float(size))
    mantissa, letter, power = text.partition("e")
    whole = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{whole}{letter.upper()}{power}"


def _st_constant(node: Node) -> Text:
    """Return the text of a constant."""
    if node.kind == "bool":
        return Text("TRUE" if node.constant_value else "FALSE")
    text = st_literal(float(node.text), node.kind)
    return Text(text, "neg" if text.startswith("-") else "")


def _st_library_name(name: str, kind: str) -> str:
    """Return the name of a function of the standard. Raise InputError for other functions."""
    if name != "sqrt":
        raise InputError(f"export: Structured Text has no function {name} of {TYPES[kind]}")
    return "SQRT"


def _nodes_in_locals(order: list[Node]) -> set[Node]:
    """Return selections, long constants and, in single precision, operands that are rounded."""
    apart: set[Node] = set()
    for node in order:
        if node.op == "select" or len(_constant_statements(node)) > 1:
            apart.add(node)
        if node.op != "select":
            apart.update(arg for arg in node.args if _is_rounded_float(arg))
    return apart


def _constant_statements(node: Node) -> list[str]:
    """Return the statements that store a constant, "" for other nodes."""
    is_number = node.op == "const" and node.is_real
    return assign_number("", float(node.text), node.kind) if is_number else []


def _is_rounded_float(node: Node) -> bool:
    """Return whether a node is a float that an operation rounds."""
    return node.kind == "float32" and node.op in _ROUNDED


def _st_statement(name: str, node: Node, expressions: Expressions) -> list[str]:
    """Return the statement that fills a local: an assignment, or an IF with an assignment per
    branch.
    """
    if node.op == "apply":
        return expressions.calls(name, node, expressions)
    if node.op == "const":
        return [INDENT + line for line in assign_number(name, float(node.text), node.kind)]
    if node.op != "select":
        return wrap_statement(f"{name} := {expressions.write_node(node).text};")
    truth, yes, no = (expressions.write_node(arg).text for arg in node.args)
    heads = (f"IF {truth} THEN", f"{name} := {yes};", "ELSE", f"{name} := {no};", "END_IF;")
    line = INDENT + " ".join(heads)
    if len(line) <= WIDTH:
        return [line]
    indents = (INDENT, 2 * INDENT, INDENT, 2 * INDENT, INDENT)
    pairs = zip(heads, indents, strict=True)
    return list(itertools.chain(*itertools.starmap(wrap_statement, pairs)))


ST: Final = Grammar(
    TYPES,
    _SIGNS,
    _OF_TRUTHS,
    "NOT ",
    OWN,
    _st_constant,
    _st_library_name,
    apart=_nodes_in_locals,
    statement=_st_statement,
)


def statement_operands(local: Local, names: dict[Node, str]) -> list[Node]:
    """Return the inputs and the nodes of further locals that the statement of a local reads.

    Args:
        local: the local.
        names: the names of all locals.
    """
    found: dict[Node, None] = {}
    waiting = list(reversed(local.node.args))
    while waiting:
        node = waiting.pop()
        if node in names or node.op == "input":
            found[node] = None
        else:
            waiting.extend(reversed(node.args))
    return list(found)
