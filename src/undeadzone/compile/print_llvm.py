"""Instructions printed as LLVM text, of a single number or of a vector of lanes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Final

import numpy as np

from undeadzone.compile.graph import CONSTANT, LANGUAGES, STILL, Node, required_nodes
from undeadzone.compile.schedule import Branch

_INTRINSICS: Final = ("fma", "sqrt", "fabs", "floor", "ceil", "copysign")
TYPES, _SIZES, _SHORT, _OF_REALS, _OF_WORDS, _OF_TRUTHS = LANGUAGES["llvm"].values()

Names = Callable[[Node], str]


class Text:
    """Body of a function, line by line.

    Args:
        lanes: of a vector (1 for plain numbers).
        declared: declarations of the module, by name (shared by its functions).
        prefix: of the names of values, another one for each part of a function.
        calls: where in %frame the results of each call stand.
        given: where in %frame the arguments of a call stand.
    """

    def __init__(
        self,
        lanes: int,
        declared: dict[str, str],
        prefix: str = "t",
        calls: Mapping[Node, int] = MappingProxyType({}),
        given: int = 0,
    ) -> None:
        self.lanes = lanes
        self.declared = declared
        self._calls = calls
        self._given = given
        self.lines: list[str] = []
        self.block = ""  # the label of the block that is being printed
        self._prefix = prefix
        self._fresh = 0

    def append_line(self, text: str) -> None:
        """Append a line without a value."""
        self.lines.append(f"  {text}")

    def label(self, name: str) -> None:
        """Start a block of instructions."""
        self.block = name
        self.lines.append(f"{name}:")

    def add(self, text: str) -> str:
        """Append a line, and return the name of its value."""
        self._fresh += 1
        name = f"%{self._prefix}.{self._fresh}"
        self.lines.append(f"  {name} = {text}")
        return name

    def type(self, of_one: str, vector: bool = True) -> str:
        """Return the type of a vector of lanes, or of a single number."""
        return f"<{self.lanes} x {of_one}>" if vector and self.lanes > 1 else of_one

    def address_of(self, base: str, index: int | str) -> str:
        """Return the address of an entry of an array."""
        if index == 0:
            return base
        return self.add(f"getelementptr double, ptr {base}, i64 {index}")

    def load(self, address: str, of_type: str = "double", vector: bool = False) -> str:
        """Load the numbers at an address, and return the name of the value."""
        return self.add(
            f"load {self.type(of_type, vector)}, ptr {address}, align {_SIZES[of_type]}"
        )

    def store(self, name: str, address: str, vector: bool = False) -> None:
        """Store numbers at an address."""
        self.append_line(f"store {self.type('double', vector)} {name}, ptr {address}, align 8")

    def splat(self, name: str, of_type: str) -> str:
        """Return the name of a vector with a number in every lane."""
        if self.lanes == 1:
            return name
        vector = self.type(of_type)
        one = self.add(f"insertelement {vector} poison, {of_type} {name}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.add(f"shufflevector {vector} {one}, {vector} poison, {zeros}")

    def constant_text(self, node: Node, vector: bool = True) -> str:
        """Return the text of a constant. A float is written as the double of the same
        value.
        """
        of_type = TYPES[node.kind]
        text = node.text
        if node.is_real:
            (word,) = struct.unpack("<Q", struct.pack("<d", np.dtype(node.kind).type(text)))
            text = f"0x{word:016X}"
        if of_type == "i1":
            text = "true" if text == "1" else "false"
        return self.in_every_lane(text, of_type, vector)

    def in_every_lane(self, text: str, of_type: str, vector: bool = True) -> str:
        """Return a written number repeated for every lane."""
        if not vector or self.lanes == 1:
            return text
        return f"<{', '.join([f'{of_type} {text}'] * self.lanes)}>"

    def zero(self) -> str:
        """Return the text of 0.0 in every lane."""
        return "zeroinitializer" if self.lanes > 1 else "0.0"

    def print_node(self, node: Node, names: Names, vector: bool = True) -> str:
        """Print an instruction, and return the name of its value.

        Args:
            node: the instruction, not an input or a constant.
            names: of its operands.
            vector: in every lane, else once.
        """
        if node.op == "part":
            place = self._calls[node.args[0]] + int(node.text)
            return self.load(self.address_of("%frame", place))
        args = list(map(names, node.args))
        last = node.args[-1]
        if node.op == "apply":
            return self._print_apply(node, args)
        value = self.type(TYPES[last.kind], vector)
        if node.op == "select":
            return self.print_select(args[0], value, args[1], args[2], vector)
        if node.op in ("least", "most"):
            relation = "olt" if node.op == "least" else "ogt"
            better = self.add(f"fcmp {relation} {value} {args[0]}, {args[1]}")
            return self.print_select(better, value, args[0], args[1], vector)
        if node.op == "call":
            if node.text in _INTRINSICS:
                return self._print_intrinsic(node, args, vector)
            return self._print_library_call(node.text, args, vector)
        if node.op in ("convert", "view"):
            return self._print_conversion(node, args[0], vector)
        if node.op == "not":
            return self.add(f"xor {value} {args[0]}, {self.in_every_lane('true', 'i1', vector)}")
        words = _OF_TRUTHS if last.kind == "bool" else _OF_WORDS
        word = (_OF_REALS if last.is_real else words)[node.op]
        return self.add(f"{word} {value} {', '.join(args)}")

    def print_select(
        self, condition: str, value: str, yes: str, no: str, vector: bool = True
    ) -> str:
        """Print a selection of two values of a type by a condition, and return the name of the
        value.
        """
        truth = self.type("i1", vector)
        return self.add(f"select {truth} {condition}, {value} {yes}, {value} {no}")

    def _print_conversion(self, node: Node, name: str, vector: bool) -> str:
        """Print a conversion of a number to the node's type, and return the name of the value."""
        source = node.args[0]
        old = TYPES[source.kind]
        new = TYPES[node.kind]
        if old == new:
            return name
        word = "bitcast" if node.op == "view" else _conversion_word(source, node)
        return self.add(f"{word} {self.type(old, vector)} {name} to {self.type(new, vector)}")

    def _print_intrinsic(self, node: Node, args: list[str], vector: bool) -> str:
        """Print a call of an LLVM intrinsic, and return the name of its value."""
        of_one = TYPES[node.kind]
        value = self.type(of_one, vector)
        lanes = f"v{self.lanes}" if vector and self.lanes > 1 else ""
        name = f"llvm.{node.text}.{lanes}{_SHORT[of_one]}"
        self.declared[name] = f"declare {value} @{name}({', '.join([value] * len(args))})"
        return self._print_call(name, value, args)

    def _print_library_call(self, function: str, args: list[str], vector: bool) -> str:
        """Print calls of a C function, lane by lane, and return the name of the value."""
        numbers = ", ".join(["double"] * len(args))
        self.declared[function] = f"declare double @{function}({numbers})"
        if not vector or self.lanes == 1:
            return self._print_call(function, "double", args)
        value = self.type("double")
        whole = "poison"
        for lane in range(self.lanes):
            parts = [self.add(f"extractelement {value} {arg}, i64 {lane}") for arg in args]
            one = self._print_call(function, "double", parts)
            whole = self.add(f"insertelement {value} {whole}, double {one}, i64 {lane}")
        return whole

    def _print_call(self, function: str, kind: str, args: list[str]) -> str:
        """Print a call of a function of numbers of a kind, and return the name of its value."""
        given = ", ".join([f"{kind} {arg}" for arg in args])
        return self.add(f"call {kind} @{function}({given})")

    def _print_apply(self, node: Node, args: list[str]) -> str:
        """Print a call of a function of the module. Its own value is nothing, 0."""
        for k, arg in enumerate(args):
            self.store(arg, self.address_of("%frame", self._given + k))
        given, out = (self.address_of("%frame", at) for at in (self._given, self._calls[node]))
        pointers = f"ptr null, ptr {given}, ptr null, ptr null, ptr {out}"
        self.append_line(f"call void @{node.text}(i64 1, i64 1, {pointers})")
        return self.zero()

    @contextmanager
    def print_loop(self, name: str, begin: str, end: str, stride: int = 1) -> Iterator[str]:
        """Print a loop. Its count goes from `begin` by strides while it is below `end`.

        Args:
            name: of its blocks.
            begin, end, stride: of the count. Both ends are at least 0.
        """
        came = self.block
        count = f"%{name}.count"
        self.append_line(f"br label %{name}")
        self.label(name)
        head = len(self.lines)
        self.append_line(f"%{name}.more = icmp ult i64 {count}, {end}")
        self._enter_if(f"%{name}.more", name)
        yield count
        self.append_line(f"%{name}.next = add i64 {count}, {stride}")
        self.append_line(f"br label %{name}")
        counts = f"[{begin}, %{came}], [%{name}.next, %{self.block}]"
        self.lines.insert(head, f"  {count} = phi i64 {counts}")
        self.label(f"{name}.past")

    @contextmanager
    def print_if(self, truth: str, name: str) -> Iterator[None]:
        """Print the instructions that run if a truth holds.

        Args:
            truth: the name of the truth.
            name: of its blocks.
        """
        self._enter_if(truth, name)
        yield
        self.append_line(f"br label %{name}.past")
        self.label(f"{name}.past")

    def _enter_if(self, truth: str, name: str) -> None:
        """Start the block that runs if a truth holds, with a jump past the block
        otherwise.
        """
        self.append_line(f"br i1 {truth}, label %{name}.do, label %{name}.past")
        self.label(f"{name}.do")

    def any_lane(self, condition: str) -> str:
        """Return the name of a truth that holds if a condition holds in any lane."""
        if self.lanes == 1:
            return condition
        bits = self.add(f"bitcast {self.type('i1')} {condition} to i{self.lanes}")
        return self.add(f"icmp ne i{self.lanes} {bits}, 0")


def print_once(text: Text, required: Iterable[Node], have: dict[Node, str], source: Names) -> None:
    """Print required values as plain numbers, with all further values that they need.

    Args:
        text: destination of the output.
        required: values of levels below the lanes'.
        have: the names of values that are there, which grow.
        source: prints an input.
    """

    def operand(node: Node) -> str:
        """Return the name of a plain number."""
        return text.constant_text(node, False) if node.level == CONSTANT else have[node]

    for node in required_nodes(required, have):
        if node.op == "const":
            continue
        have[node] = source(node) if node.op == "input" else text.print_node(node, operand, False)


def to_double(text: Text, node: Node, name: str, vector: bool = False) -> str:
    """Return the name of a value as a double, the form in which tables store it."""
    double = text.type("double", vector)
    if node.kind == "bool":
        one, zero = (text.in_every_lane(number, "double", vector) for number in ("1.0", "0.0"))
        return text.print_select(name, double, one, zero, vector)
    if node.kind in ("int64", "uint64"):
        return text.add(f"bitcast {text.type('i64', vector)} {name} to {double}")
    return name


def from_double(text: Text, node: Node, name: str, vector: bool = False) -> str:
    """Return the name of a table's double, converted to the type of its value."""
    double = text.type("double", vector)
    if node.kind == "bool":
        return text.add(f"fcmp une {double} {name}, {text.zero() if vector else '0.0'}")
    if node.kind in ("int64", "uint64"):
        return text.add(f"bitcast {double} {name} to {text.type('i64', vector)}")
    return name


def print_lanes(
    text: Text, order: Sequence[Node | Branch], sources: list[Names], every_use: bool
) -> list[Names]:
    """Print the lanes' instructions for several groups of lanes side by side.

    Args:
        text: destination of the output.
        order: of the instructions (branches for one group only).
        sources: for each group, what names an input of lanes, or a value of a lower level.
        every_use: values of lower levels are named anew at every use.

    Returns:
        For each group, what names its values.
    """
    have: list[dict[Node, str]] = [{} for _ in sources]

    def operand(node: Node, group: int) -> str:
        """Return the operand of a node's value in a group.

        A value below level `STILL` is common to all groups: it is loaded once, and all share its
        name unless `every_use`.
        """
        if node.level == CONSTANT:
            return text.constant_text(node)
        if node in have[group]:
            return have[group][node]
        found = sources[group](node)
        if node.level >= STILL:
            have[group][node] = found
        elif not every_use:
            for each in have:
                each[node] = found
        return found

    def namer(group: int) -> Names:
        """Return the source of names for a group."""
        return lambda node: operand(node, group)

    namers = list(map(namer, range(len(sources))))
    for node in order:
        if isinstance(node, Branch):
            _print_branch(text, node, have[0], namers[0])
            continue
        for group, named in enumerate(namers):
            have[group][node] = text.print_node(node, named)
    return namers


def _print_branch(text: Text, branch: Branch, have: dict[Node, str], name: Names) -> None:
    """Print a branch for a group.

    If the branch is skipped, its values are 0, which no lane uses.
    """
    condition = name(branch.truth)
    if not branch.holds:
        condition = text.add(
            f"xor {text.type('i1')} {condition}, {text.in_every_lane('true', 'i1')}"
        )
    before = dict(have)
    label = f"needed{branch.nodes[0].number}"
    came = text.block
    with text.print_if(text.any_lane(condition), label):
        for node in branch.nodes:
            have[node] = text.print_node(node, name)
        values = [have[node] for node in branch.leaving]
    have.clear()
    have.update(before)  # values loaded in the branch do not exist beyond it
    for node, value in zip(branch.leaving, values, strict=True):
        kind = text.type(TYPES[node.kind])
        sources = f"[{value}, %{label}.do], [zeroinitializer, %{came}]"
        have[node] = text.add(f"phi {kind} {sources}")


def entry_source(text: Text, array: str) -> Names:
    """Return a source that loads an input, such as p3, from entry 3 of an array."""
    return lambda node: text.load(text.address_of(f"%{array}", int(node.text[1:])))


def _conversion_word(source: Node, target: Node) -> str:
    """Return LLVM's name of a conversion by value."""
    wider = _SIZES[TYPES[target.kind]] > _SIZES[TYPES[source.kind]]
    has_sign = not source.kind.startswith("u")
    if source.is_real and target.is_real:
        return "fpext" if wider else "fptrunc"
    if target.is_real:
        return "sitofp" if has_sign else "uitofp"
    if source.is_real:
        return "fptoui" if target.kind.startswith("u") else "fptosi"
    if not wider:
        return "trunc"
    return "sext" if has_sign else "zext"
