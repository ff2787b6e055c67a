"""Graphs as one WebAssembly module, written byte by byte: no compiler is needed.

Every instruction is the one of IEEE 754 double precision, so that the numbers are those of the
simulation; elementary functions are the export's own. Binary format: WebAssembly Core
Specification 1.0, section 5.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import casadi as ca

from undeadzone.compile.graph import Graph, Node
from undeadzone.errors import InputError
from undeadzone.exports import elementary
from undeadzone.exports.expressions import held
from undeadzone.exports.formulas import FUNCTIONS
from undeadzone.exports.instructions import (
    EXPONENT,
    FRACTION,
    OWN,
    POWER,
    SELECT,
    TRUNCATED,
    is_condition,
    uses_of,
)
from undeadzone.exports.replica import DOUBLE
from undeadzone.exports.wasm_bytes import F64, I32, name_of, section, signed, type_of, unsigned

REAL = 8  # bytes of a number
PAGE = 65536  # bytes of a page of memory
DEEPEST = 60  # nesting of an expression, beyond which a local holds a part of it
_MAGIC = b"\0asm\x01\0\0\0"

_NUMBERS = {  # f64 -> f64
    ca.OP_ADD: b"\xa0",
    ca.OP_SUB: b"\xa1",
    ca.OP_MUL: b"\xa2",
    ca.OP_DIV: b"\xa3",
    ca.OP_COPYSIGN: b"\xa6",
    ca.OP_FABS: b"\x99",
    ca.OP_NEG: b"\x9a",
    ca.OP_CEIL: b"\x9b",
    ca.OP_FLOOR: b"\x9c",
    ca.OP_SQRT: b"\x9f",
    TRUNCATED: b"\x9d",
}
_COMPARED = {ca.OP_EQ: b"\x61", ca.OP_NE: b"\x62", ca.OP_LT: b"\x63", ca.OP_LE: b"\x65"}
_LOGIC = {ca.OP_NOT: b"\x45", ca.OP_AND: b"\x71", ca.OP_OR: b"\x72"}
_AS_NUMBER, _SELECTED = b"\xb7", b"\x1b"
_SAME = (ca.OP_ASSIGN, ca.OP_LIFT)


class Function(NamedTuple):
    """A graph that reads its inputs from memory and writes its results there.

    Attributes:
        name: what it is exported as.
        graph: the graph.
        inputs: where each input entry stands [bytes], by its text in the graph.
        results: where each entry of each result goes [bytes].
    """

    name: str
    graph: Graph
    inputs: dict[str, int]
    results: list[list[int]]


def module(functions: Sequence[Function], size: int) -> bytes:
    """The module: it exports the functions, and the memory as "memory".

    Args:
        functions: what it computes.
        size: bytes of memory that they use.

    Raises:
        InputError: an instruction that WebAssembly has not.
    """
    own = elementary.needed(_called(function.graph for function in functions))
    calls = {name: len(functions) + k for k, name in enumerate(own)}
    bodies = [_stored(function, calls) for function in functions]
    bodies += [_returned(name, calls) for name in own]
    types = [type_of(0, 0), type_of(1, 1), type_of(2, 1)]
    kinds = [0] * len(functions) + [len(FUNCTIONS[name].inputs) for name in own]
    pages = -(-size // PAGE)
    exports = [name_of(each.name) + b"\0" + unsigned(k) for k, each in enumerate(functions)]
    exports.append(name_of("memory") + b"\x02\0")
    sections = [
        section(1, types),
        section(3, [unsigned(kind) for kind in kinds]),
        section(5, [b"\0" + unsigned(pages)]),
        section(7, exports),
        section(10, [unsigned(len(body)) + body for body in bodies]),
    ]
    return _MAGIC + b"".join(sections)


def _called(graphs: Iterable[Graph]) -> set[str]:
    """The functions of the export that graphs call. Raises InputError."""
    names: set[str] = set()
    for graph in graphs:
        uses = uses_of(graph)
        for place, node in enumerate(graph.nodes):
            if uses[place] and node.op in (ca.OP_FMOD, ca.OP_REMAINDER):
                raise InputError("export: a remainder of a division has no WebAssembly instruction")
            if uses[place] and node.op in OWN and node.op not in _NUMBERS:
                names.add(OWN[node.op])
    return names


def _stored(function: Function, calls: dict[str, int]) -> bytes:
    """The body of a function between places in memory."""
    writer = _Writer(function.graph, function.inputs, {}, calls)
    code = writer.locals_set()
    for places, targets in zip(function.graph.results, function.results, strict=True):
        for place, target in zip(places, targets, strict=True):
            code += b"\x41\0" + writer.number(place) + b"\x39\x03" + unsigned(target)
    return writer.declared() + code + b"\x0b"


def _returned(name: str, calls: dict[str, int]) -> bytes:
    """The body of an elementary function."""
    shape = elementary.formula(name, single=False)
    arguments = {text: k for k, text in enumerate(shape.inputs)}
    writer = _Writer(shape.graph, {}, arguments, calls)
    code = writer.locals_set() + writer.number(shape.graph.results[0][0])
    return writer.declared() + code + b"\x0b"


class _Writer:
    """The instructions of a graph's nodes; what is used more than once stays in a local."""

    def __init__(
        self,
        graph: Graph,
        inputs: dict[str, int],
        arguments: dict[str, int],
        calls: dict[str, int],
    ) -> None:
        self.graph = graph
        self.nodes = graph.nodes
        self.inputs = inputs
        self.calls = calls
        self.locals: dict[int, int] = {}
        self.first = len(arguments)
        for place, node in enumerate(graph.nodes):
            if node.op == ca.OP_INPUT and node.text in arguments:
                self.locals[place] = arguments[node.text]
        self.reals, self.conditions = self._kept()

    def _kept(self) -> tuple[list[int], list[int]]:
        """The nodes that a local holds: numbers, and conditions."""
        uses = uses_of(self.graph)
        squared: set[int] = set()
        for node in self.nodes:
            if node.op == ca.OP_SQ:
                squared.update(node.operands)
        depths: list[int] = []
        reals: list[int] = []
        conditions: list[int] = []
        for place, node in enumerate(self.nodes):
            depth = 1 + max((depths[operand] for operand in node.operands), default=0)
            often = uses[place] > (2 if node.op == ca.OP_CONST else 1) and not _is_short(node)
            needed = often or place in squared or depth > DEEPEST or node.text.startswith("s")
            depths.append(0 if needed else depth)
            if needed and uses[place] and place not in self.locals:
                (conditions if is_condition(node) else reals).append(place)
        return reals, conditions

    def declared(self) -> bytes:
        """The declaration of the locals."""
        groups = [(len(self.reals), F64), (len(self.conditions), I32)]
        used = [unsigned(count) + bytes([kind]) for count, kind in groups if count]
        return unsigned(len(used)) + b"".join(used)

    def locals_set(self) -> bytes:
        """The instructions that fill the locals, each after those that it needs."""
        numbers = {}
        for k, place in enumerate([*self.reals, *self.conditions]):
            numbers[place] = self.first + k
        code = b""
        for place in sorted(numbers):
            code += self._raw(place) + b"\x21" + unsigned(numbers[place])
            self.locals[place] = numbers[place]
        return code

    def number(self, place: int) -> bytes:
        """A node as a number."""
        code = self._raw(place)
        return code + _AS_NUMBER if is_condition(self.nodes[place]) else code

    def condition(self, place: int) -> bytes:
        """A node as a condition."""
        code = self._raw(place)
        if is_condition(self.nodes[place]):
            return code
        return code + _constant(0.0) + _COMPARED[ca.OP_NE]

    def _raw(self, place: int) -> bytes:
        """A node as it is."""
        node = self.nodes[place]
        if place in self.locals:
            return b"\x20" + unsigned(self.locals[place])
        if node.op == ca.OP_CONST:
            return _constant(float(node.text))
        if node.op == ca.OP_INPUT:
            return b"\x41\0\x2b\x03" + unsigned(self.inputs[node.text])
        if node.op in _LOGIC:
            return b"".join(map(self.condition, node.operands)) + _LOGIC[node.op]
        if node.op in (SELECT, ca.OP_IF_ELSE_ZERO):
            return self._selected(*node.operands)
        return self._computed(node.op, [self.number(operand) for operand in node.operands])

    def _selected(self, condition: int, yes: int, no: int | None = None) -> bytes:
        """A selection; without `no`, of 0."""
        other = _constant(0.0) if no is None else self.number(no)
        return self.number(yes) + other + self.condition(condition) + _SELECTED

    def _computed(self, op: int, values: list[bytes]) -> bytes:
        """An instruction on numbers."""
        code = b"".join(values)
        if op in _NUMBERS:
            return code + _NUMBERS[op]
        if op in _COMPARED:
            return code + _COMPARED[op]
        if op in _SAME:
            return code
        if op == ca.OP_SQ:
            return code + code + _NUMBERS[ca.OP_MUL]
        if op == ca.OP_TWICE:
            return code + _constant(2.0) + _NUMBERS[ca.OP_MUL]
        if op == ca.OP_INV:
            return _constant(1.0) + code + _NUMBERS[ca.OP_DIV]
        if op in _BITS:
            return code + _BITS[op]
        return code + b"\x10" + unsigned(self.calls[OWN[op]])


def _is_short(node: Node) -> bool:
    """Whether a node is a constant of a few bytes."""
    return node.op == ca.OP_CONST and len(_constant(float(node.text))) < REAL


def _constant(value: float) -> bytes:
    """A number; a small whole one is converted, which takes three bytes in place of nine."""
    value = held(value, single=False)
    bits = struct.pack("<d", value)
    if abs(value) < 64 and bits == struct.pack("<d", int(value)):
        return b"\x41" + signed(int(value)) + _AS_NUMBER
    return b"\x44" + bits


def _long(value: int) -> bytes:
    """A 64-bit integer."""
    return b"\x42" + signed(value)


_RAISED = b"\xbd" + _long((DOUBLE.bias << DOUBLE.mantissa) - DOUBLE.half) + b"\x7c"
_MANTISSA = _long(DOUBLE.mantissa)
_BITS = {
    POWER: b"\xfc\x06" + _long(DOUBLE.bias) + b"\x7c" + _MANTISSA + b"\x86\xbf",
    EXPONENT: _RAISED + _MANTISSA + b"\x88\xba" + _constant(float(DOUBLE.bias)) + b"\xa1",
    FRACTION: _RAISED
    + _long((1 << DOUBLE.mantissa) - 1)
    + b"\x83"
    + _long(DOUBLE.half)
    + b"\x7c\xbf",
}
