"""Instructions printed as LLVM's text, of one number or of a vector of lanes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final

from undeadzone.compile.ops import CONSTANT, STILL, Op, needed
from undeadzone.compile.schedule import Branch

_INTRINSICS: Final = ("fma", "sqrt", "fabs", "floor", "ceil")
_CONVERSIONS: Final = (
    *("bitcast", "trunc", "zext", "sext", "fpext", "fptrunc"),
    *("sitofp", "uitofp", "fptosi", "fptoui"),
)
_SIZE: Final = {"double": 8, "i64": 8, "float": 4, "i32": 4}
_NOTHING: Final = {"double": "0.0", "float": "0.0", "i64": "0", "i32": "0", "i1": "false"}
_SHORT: Final = {"double": "f64", "float": "f32"}

Names = Callable[[Op], str]


class Text:
    """The body of a function, line by line.

    Args:
        lanes: of a vector; 1 for plain numbers.
        declared: what the module declares, by name; functions share it.
        prefix: of the names of values, another one for each part of a function.
    """

    def __init__(self, lanes: int, declared: dict[str, str], prefix: str = "t") -> None:
        self.lanes, self.declared = lanes, declared
        self.lines: list[str] = []
        self.block = ""  # the label of the block that is being printed
        self._prefix, self._fresh = prefix, 0

    def line(self, text: str) -> None:
        """Add a line that gives no value."""
        self.lines.append(f"  {text}")

    def label(self, name: str) -> None:
        """Begin a block of instructions."""
        self.block = name
        self.lines.append(f"{name}:")

    def add(self, text: str) -> str:
        """Add a line; the name of its value."""
        self._fresh += 1
        name = f"%{self._prefix}.{self._fresh}"
        self.lines.append(f"  {name} = {text}")
        return name

    def type(self, of_one: str, vector: bool = True) -> str:
        """The type of a vector of lanes, or of one number."""
        return f"<{self.lanes} x {of_one}>" if vector and self.lanes > 1 else of_one

    def at(self, base: str, index: int | str) -> str:
        """The address of an entry of an array."""
        if index == 0:
            return base
        return self.add(f"getelementptr double, ptr {base}, i64 {index}")

    def load(self, address: str, of_type: str = "double", vector: bool = False) -> str:
        """The numbers at an address."""
        return self.add(f"load {self.type(of_type, vector)}, ptr {address}, align {_SIZE[of_type]}")

    def store(self, name: str, address: str, vector: bool = False) -> None:
        """Keep numbers at an address."""
        self.line(f"store {self.type('double', vector)} {name}, ptr {address}, align 8")

    def splat(self, name: str, of_type: str) -> str:
        """A number in every lane."""
        if self.lanes == 1:
            return name
        vector = self.type(of_type)
        one = self.add(f"insertelement {vector} poison, {of_type} {name}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.add(f"shufflevector {vector} {one}, {vector} poison, {zeros}")

    def literal(self, op: Op, vector: bool = True) -> str:
        """A constant."""
        text = {"i1 0": "false", "i1 1": "true"}.get(f"{op.type} {op.text}", op.text)
        if not vector or self.lanes == 1:
            return text
        return f"<{', '.join([f'{op.type} {text}'] * self.lanes)}>"

    def zero(self) -> str:
        """0.0 in every lane."""
        return "zeroinitializer" if self.lanes > 1 else "0.0"

    def print(self, op: Op, names: Names, vector: bool = True) -> str:
        """Print an instruction; the name of its value.

        Args:
            op: the instruction, neither input nor constant.
            names: of its operands.
            vector: in every lane, else once.
        """
        args = [names(arg) for arg in op.args]
        value, kind = self.type(op.args[-1].type, vector), op.kind
        if kind == "select":
            return self._choice(args[0], value, args[1], args[2], vector)
        if kind in ("least", "most"):
            relation = "olt" if kind == "least" else "ogt"
            better = self.add(f"fcmp {relation} {value} {args[0]}, {args[1]}")
            return self._choice(better, value, args[0], args[1], vector)
        if kind in _INTRINSICS:
            return self._intrinsic(op, args, vector)
        if kind == "call":
            return self._call(op, args, vector)
        if kind in _CONVERSIONS:
            return self.add(f"{kind} {value} {args[0]} to {self.type(op.type, vector)}")
        return self.add(f"{kind} {value} {', '.join(args)}")

    def _choice(self, condition: str, value: str, yes: str, no: str, vector: bool) -> str:
        """One of two values of a type."""
        truth = self.type("i1", vector)
        return self.add(f"select {truth} {condition}, {value} {yes}, {value} {no}")

    def _intrinsic(self, op: Op, args: list[str], vector: bool) -> str:
        """A call of what LLVM makes instructions of."""
        value = self.type(op.type, vector)
        lanes = f"v{self.lanes}" if vector and self.lanes > 1 else ""
        name = f"llvm.{op.kind}.{lanes}{_SHORT[op.type]}"
        self.declared[name] = f"declare {value} @{name}({', '.join([value] * len(args))})"
        given = ", ".join([f"{value} {arg}" for arg in args])
        return self.add(f"call {value} @{name}({given})")

    def _call(self, op: Op, args: list[str], vector: bool) -> str:
        """Calls of a C function, lane by lane."""
        numbers = ", ".join(["double"] * len(args))
        self.declared[op.text] = f"declare double @{op.text}({numbers})"
        if not vector or self.lanes == 1:
            return self._called(op.text, args)
        value, whole = self.type("double"), "poison"
        for lane in range(self.lanes):
            parts = [self.add(f"extractelement {value} {arg}, i64 {lane}") for arg in args]
            one = self._called(op.text, parts)
            whole = self.add(f"insertelement {value} {whole}, double {one}, i64 {lane}")
        return whole

    def _called(self, function: str, args: list[str]) -> str:
        """A call of a C function."""
        return self.add(f"call double @{function}({', '.join([f'double {x}' for x in args])})")

    def any(self, condition: str) -> str:
        """Whether a condition holds in any lane."""
        if self.lanes == 1:
            return condition
        bits = self.add(f"bitcast {self.type('i1')} {condition} to i{self.lanes}")
        return self.add(f"icmp ne i{self.lanes} {bits}, 0")


def once(text: Text, wanted: Iterable[Op], have: dict[int, str], source: Names) -> None:
    """Print as plain numbers what is wanted, and what that needs beyond what is there.

    Args:
        text: where it is printed.
        wanted: values of levels below the lanes'.
        have: the names of values that are there, by number; grows.
        source: prints an input.
    """

    def name(op: Op) -> str:
        return text.literal(op, False) if op.level == CONSTANT else have[op.number]

    for op in needed(wanted, have):
        if op.kind == "const":
            continue
        have[op.number] = source(op) if op.kind == "input" else text.print(op, name, False)


def kept(text: Text, op: Op, name: str) -> str:
    """A plain value as a double, the form in which tables keep it."""
    if op.type == "i1":
        return text.add(f"select i1 {name}, double 1.0, double 0.0")
    if op.type == "i64":
        return text.add(f"bitcast i64 {name} to double")
    return name


def plain(text: Text, op: Op, name: str, vector: bool = False) -> str:
    """A double of a table as the value that it is."""
    double = text.type("double", vector)
    if op.type == "i1":
        return text.add(f"fcmp une {double} {name}, {text.zero() if vector else '0.0'}")
    if op.type == "i64":
        return text.add(f"bitcast {double} {name} to {text.type('i64', vector)}")
    return name


def in_lanes(
    text: Text, order: Sequence[Op | Branch], sources: list[Names], every_use: bool
) -> list[Names]:
    """Print the lanes' instructions for several groups of lanes side by side.

    Args:
        text: where they are printed.
        order: of the instructions; branches for one group only.
        sources: for each group, what names an input of lanes, or a value of a lower level.
        every_use: values of lower levels are named anew at every use.

    Returns:
        For each group, what names its values.
    """
    have: list[dict[int, str]] = [{} for _ in sources]

    def name(op: Op, group: int) -> str:
        if op.level == CONSTANT:
            return text.literal(op)
        if op.number in have[group]:
            return have[group][op.number]
        found = sources[group](op)
        if op.level >= STILL:
            have[group][op.number] = found
        elif not every_use:
            for each in have:
                each[op.number] = found
        return found

    def namer(group: int) -> Names:
        return lambda op: name(op, group)

    namers = [namer(group) for group in range(len(sources))]
    for op in order:
        if isinstance(op, Branch):
            _branch(text, op, have[0], namers[0])
            continue
        for group, named in enumerate(namers):
            have[group][op.number] = text.print(op, named)
    return namers


def _branch(text: Text, branch: Branch, have: dict[int, str], name: Names) -> None:
    """Print a branch for one group; where it is not taken, its values are 0, which no lane uses."""
    condition = name(branch.condition)
    if not branch.holds:
        ones = text.splat("true", "i1")
        condition = text.add(f"xor {text.type('i1')} {condition}, {ones}")
    before, number = dict(have), branch.ops[0].number
    came = text.block
    text.line(f"br i1 {text.any(condition)}, label %needed{number}, label %past{number}")
    text.label(f"needed{number}")
    for op in branch.ops:
        have[op.number] = text.print(op, name)
    values = [have[op.number] for op in branch.leaving]
    text.line(f"br label %past{number}")
    text.label(f"past{number}")
    have.clear()
    have.update(before)  # what was loaded in the branch is not there beyond it
    for op, value in zip(branch.leaving, values, strict=True):
        kind = text.type(op.type)
        nothing = "zeroinitializer" if text.lanes > 1 else _NOTHING[op.type]
        sources = f"[{value}, %needed{number}], [{nothing}, %{came}]"
        have[op.number] = text.add(f"phi {kind} {sources}")


def entries_of(text: Text, array: str) -> Names:
    """What loads an input, such as p3, from entry 3 of an array."""
    return lambda op: text.load(text.at(f"%{array}", int(op.text[1:])))
