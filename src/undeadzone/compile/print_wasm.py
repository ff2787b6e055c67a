"""Return the module, which exports the functions and the memory as "memory".

Every instruction is the one of IEEE 754 double precision. Elementary functions are those of
exported C, and repeated parts are functions, as there. Binary format: WebAssembly Core
Specification 2.0, section 5, of which it needs functions with several results.
"""

import itertools
import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from undeadzone.compile import elementary
from undeadzone.compile.graph import (
    LANGUAGES,
    Node,
    Results,
    count_uses,
    required_nodes,
    to_condition,
)
from undeadzone.compile.repeats import Part, find_calls
from undeadzone.errors import InputError

KIND: Final = "float64"
REAL: Final = 8  # bytes of a number
PAGE: Final = 65536  # bytes of a page of memory
DEEPEST: Final = 60  # nesting of an expression, beyond which a local holds a part of it
_MAGIC: Final = b"\0asm\x01\0\0\0"
_TABLES: Final = LANGUAGES["wasm"]
_TYPES: Final = _TABLES["types"]
_AS_NUMBER, _SELECTED = b"\xb7", b"\x1b"


class Function(NamedTuple):
    """Function whose inputs and results are stored in memory.

    Attributes:
        name: its exported name.
        results: the nodes.
        inputs: where each input stands [bytes], by its name.
        targets: where each entry of each result goes [bytes].
    """

    name: str
    results: Results
    inputs: dict[str, int]
    targets: list[list[int]]


class _Callee(NamedTuple):
    """Function that others call.

    Attributes:
        number: its index in the module.
        outputs: how many results it has.
    """

    number: int
    outputs: int


def build_module(functions: Sequence[Function], size: int, parts: Sequence[Part] = ()) -> bytes:
    """Return the module: it exports the functions, and the memory as "memory".

    Args:
        functions: functions that it computes.
        size: bytes of memory that they use.
        parts: functions of repeated parts, which they call.

    Raises:
        InputError: an instruction that WebAssembly has not.
    """
    inner = [*_elementary_parts(functions, parts), *parts]
    callees = {
        part.name: _Callee(len(functions) + k, len(part.results)) for k, part in enumerate(inner)
    }
    bodies = [_memory_body(function, callees) for function in functions]
    bodies += [_part_body(part, callees) for part in inner]
    types = [_encode_type([], [])] * len(functions)
    types += [_encode_type(part.inputs, part.results) for part in inner]
    known = list(dict.fromkeys(types))
    exports = [
        _encode_name(each.name) + b"\0" + _encode_unsigned(k) for k, each in enumerate(functions)
    ]
    exports.append(_encode_name("memory") + b"\x02\0")
    sections = [
        _encode_section(1, known),
        _encode_section(3, [_encode_unsigned(known.index(each)) for each in types]),
        _encode_section(5, [b"\0" + _encode_unsigned(-(-size // PAGE))]),
        _encode_section(7, exports),
        _encode_section(10, [_encode_unsigned(len(body)) + body for body in bodies]),
    ]
    return _MAGIC + b"".join(sections)


def _elementary_parts(functions: Sequence[Function], parts: Sequence[Part]) -> list[Part]:
    """Return the elementary functions that are called and not built into WebAssembly.

    Raise InputError for one that it cannot compute.
    """
    results = [*itertools.chain(*[each.results for each in functions])]
    names = elementary.called_functions([*results, *[part.results for part in parts]])
    if names & {"fmod", "remainder"}:
        raise InputError("export: a remainder of a division has no WebAssembly instruction")
    needed = [
        name for name in elementary.required_functions(names) if name not in _TABLES["functions"]
    ]
    return [elementary.build_elementary(name, KIND) for name in needed]


def _memory_body(function: Function, callees: dict[str, _Callee]) -> bytes:
    """Return the body of a function from and to memory."""
    writer = _Writer(function.results, function.inputs, {}, callees)
    code = writer.fill_locals()
    for nodes, targets in zip(function.results, function.targets, strict=True):
        for node, target in zip(nodes, targets, strict=True):
            code += b"\x41\0" + writer.encode_node(node) + b"\x39\x03" + _encode_unsigned(target)
    return writer.local_declaration() + code + b"\x0b"


def _part_body(part: Part, callees: dict[str, _Callee]) -> bytes:
    """Return the body of a function from its arguments to its results."""
    arguments = {node.text: k for k, node in enumerate(part.inputs)}
    writer = _Writer([part.results], {}, arguments, callees)
    code = writer.fill_locals() + b"".join(map(writer.encode_node, part.results))
    return writer.local_declaration() + code + b"\x0b"


class _Writer:
    """Writer of the instructions of nodes. A value that is used more than once is stored in a
    local.

    Args:
        results: the nodes.
        inputs: where each input stands [bytes], by its name.
        arguments: numbers of the inputs that are arguments.
        callees: the functions that it may call, by name.
    """

    def __init__(
        self,
        results: Results,
        inputs: dict[str, int],
        arguments: dict[str, int],
        callees: dict[str, _Callee],
    ) -> None:
        self._inputs, self._callees, self._first = inputs, callees, len(arguments)
        self._locals: dict[Node, int] = {}
        self._calls = find_calls(results)
        for node in required_nodes(itertools.chain(*results)):
            if node.op == "input" and node.text in arguments:
                self._locals[node] = arguments[node.text]
        self._nodes_by_type = self._local_nodes(results)

    def _local_nodes(self, results: Results) -> dict[str, list[Node]]:
        """Return the nodes that a local holds, by their types."""
        counts = count_uses(results)
        depths: dict[Node, int] = {}
        by_type: dict[str, list[Node]] = {kind: [] for kind in _TYPES}
        for node in sorted(counts, key=lambda node: node.number):
            depth = 1 + max([depths[arg] for arg in node.args], default=0)
            often = counts[node] > (2 if node.op == "const" else 1) and not _is_short(node)
            is_state = node.op == "input" and node.text.startswith("s")  # results overwrite it
            holds = often or depth > DEEPEST or is_state or node.op in ("part", "apply")
            depths[node] = 0 if holds else depth
            if holds and node.op != "apply" and node not in self._locals:
                by_type[node.kind].append(node)
        return by_type

    def local_declaration(self) -> bytes:
        """Return the declaration of the locals."""
        counts = {_TYPES[kind]: len(nodes) for kind, nodes in self._nodes_by_type.items() if nodes}
        groups = [_encode_unsigned(count) + bytes([kind]) for kind, count in counts.items()]
        return _encode_unsigned(len(groups)) + b"".join(groups)

    def fill_locals(self) -> bytes:
        """Return the instructions that fill the locals, each after the locals that it
        needs.
        """
        nodes = itertools.chain(*self._nodes_by_type.values())
        numbers = {node: self._first + k for k, node in enumerate(nodes)}
        self._locals |= {node: place for node, place in numbers.items() if node.op == "part"}
        code = b""
        for node in sorted([*numbers, *self._calls], key=lambda node: node.number):
            if node.op == "apply":
                code += self._encode_call(node)
            elif node.op != "part":
                code += self.encode_node(node) + b"\x21" + _encode_unsigned(numbers[node])
                self._locals[node] = numbers[node]
        return code

    def _encode_call(self, node: Node) -> bytes:
        """Return the instructions that call a repeated part and fill the locals of its results."""
        called, parts = self._callees[node.text], self._calls[node]
        code = b"".join(map(self.encode_node, node.args)) + b"\x10"
        code += _encode_unsigned(called.number)
        for k in reversed(range(called.outputs)):  # the last one is on top
            is_used = k in parts
            code += b"\x21" + _encode_unsigned(self._locals[parts[k]]) if is_used else b"\x1a"
        return code

    def encode_node(self, node: Node) -> bytes:
        """Return the instructions of a node."""
        if node in self._locals:
            return b"\x20" + _encode_unsigned(self._locals[node])
        if node.op == "const":
            return _encode_constant(node)
        if node.op == "input":
            return b"\x41\0\x2b\x03" + _encode_unsigned(self._inputs[node.text])
        truth = to_condition(node)
        if truth is not None:
            return self.encode_node(truth) + _AS_NUMBER
        if node.op == "select":
            condition, yes, no = map(self.encode_node, node.args)
            return yes + no + condition + _SELECTED
        values = b"".join(map(self.encode_node, node.args))
        if node.op != "call":
            return values + bytes([_TABLES[node.args[0].kind][node.op]])
        if node.text in _TABLES["functions"]:
            return values + bytes([_TABLES["functions"][node.text]])
        return values + b"\x10" + _encode_unsigned(self._callees[node.text].number)


def _is_short(node: Node) -> bool:
    """Return whether a node is a constant of a few bytes."""
    return node.op == "const" and len(_encode_constant(node)) < REAL


def _encode_constant(node: Node) -> bytes:
    """Return the code of a constant.

    A small integer is converted: three bytes in place of nine.
    """
    if node.kind == "bool":
        return b"\x41" + _encode_signed(int(node.text))
    if not node.is_real:
        word = int(node.text)
        return b"\x42" + _encode_signed(word - (1 << 64) if word >> 63 else word)
    value = float(node.text)
    bits = struct.pack("<d", value)
    if abs(value) < 64 and bits == struct.pack("<d", int(value)):
        return b"\x41" + _encode_signed(int(value)) + _AS_NUMBER
    return b"\x44" + bits


# --- The smallest parts of a module


def _encode_signed(value: int) -> bytes:
    """Return a signed integer in LEB128."""
    code = bytearray()
    while True:
        low, value = value & 0x7F, value >> 7
        if value == -(low >> 6):
            code.append(low)
            return bytes(code)
        code.append(low | 0x80)


def _encode_unsigned(value: int) -> bytes:
    """Return an unsigned integer in LEB128."""
    code = bytearray()
    while value > 0x7F:
        code.append((value & 0x7F) | 0x80)
        value >>= 7
    return bytes([*code, value])


def _encode_name(text: str) -> bytes:
    """Return a name, preceded by its length."""
    return _encode_unsigned(len(text)) + text.encode()


def _encode_type(arguments: list[Node], results: list[Node]) -> bytes:
    """Return the type of a function."""
    code = b"\x60"
    for nodes in (arguments, results):
        code += _encode_unsigned(len(nodes)) + bytes([_TYPES[node.kind] for node in nodes])
    return code


def _encode_section(number: int, entries: list[bytes]) -> bytes:
    """Return a section of the module."""
    content = _encode_unsigned(len(entries)) + b"".join(entries)
    return bytes([number]) + _encode_unsigned(len(content)) + content
