"""Instructions of a kernel, each once, and how often each has to be computed."""

from __future__ import annotations

import struct
from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Final

# How often: never, once a call, once a step for all lanes, once a call in every lane, once a step
# in every lane.
CONSTANT: Final = 0
STEADY: Final = 1
SHARED: Final = 2
STILL: Final = 3
LANES: Final = 4


@dataclass(slots=True, eq=False)
class Op:
    """An instruction.

    Attributes:
        kind: LLVM's name of it; besides: const, input, call, and least and most (of two numbers,
            the second where one is NaN or both are equal).
        args: its operands.
        text: of an input, its name; of a call, the C function; of a constant, its value as LLVM
            writes it.
        type: LLVM's type of its value in one lane.
        level: how often it has to be computed.
        number: of instructions before it.
    """

    kind: str
    args: tuple[Op, ...]
    text: str
    type: str
    level: int
    number: int


class Ops:
    """A growing list of instructions in which none stands twice."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], Op] = {}

    def made(self, kind: str, *args: Op, text: str = "", of_type: str = "", level: int = 0) -> Op:
        """An instruction, the one that is there if it is.

        Args:
            kind, args, text: as of `Op`.
            of_type: of its value; empty for that of its last operand.
            level: the least that it may have.
        """
        of_type = of_type or args[-1].type
        key = (kind, text, of_type, *(arg.number for arg in args))
        op = self._known.get(key)
        if op is None:
            levels = {level, *(arg.level for arg in args)}
            level = max(levels)
            if kind != "const":
                level = max(level, STEADY)
            if level == STILL and SHARED in levels:
                level = LANES
            op = self._known[key] = Op(kind, args, text, of_type, level, len(self._known))
        return op

    def number(self, value: float, of_type: str = "double") -> Op:
        """A constant number; of a float, the double of the same value."""
        (word,) = struct.unpack("<Q", struct.pack("<d", value))
        return self.made("const", text=f"0x{word:016X}", of_type=of_type)

    def word(self, value: int, of_type: str) -> Op:
        """A constant integer or, of type i1, truth."""
        return self.made("const", text=str(value), of_type=of_type)

    def input(self, name: str, level: int, of_type: str = "double") -> Op:
        """What a kernel is given."""
        return self.made("input", text=name, of_type=of_type, level=level)

    def inverted(self, condition: Op) -> Op:
        """Whether a condition does not hold."""
        return self.made("xor", condition, self.word(1, "i1"))

    def selected(self, condition: Op, yes: Op, no: Op) -> Op:
        """One of two values."""
        return self.made("select", condition, yes, no)

    def compared(self, relation: str, a: Op, b: Op) -> Op:
        """A comparison of numbers, such as olt, ordered and less."""
        return self.made(f"fcmp {relation}", a, b, of_type="i1")


def needed(results: Iterable[Op], known: Container[int] = ()) -> list[Op]:
    """What results need beyond what is known by number, in order of their numbers."""
    seen: dict[int, Op] = {}
    waiting = list(results)
    while waiting:
        op = waiting.pop()
        if op.number not in seen and op.number not in known:
            seen[op.number] = op
            waiting.extend(op.args)
    return [seen[number] for number in sorted(seen)]


def used(order: Iterable[Op], results: Iterable[Op], level: int) -> list[Op]:
    """The values of a level that some instructions or results use directly, by number."""
    found: dict[int, Op] = {op.number: op for op in results}
    for op in order:
        for arg in op.args:
            found[arg.number] = arg
    return [found[number] for number in sorted(found) if found[number].level == level]


def still(order: Iterable[Op], results: Iterable[Op]) -> list[Op]:
    """The instructions of lanes that some instructions or results need once a call."""
    ops = needed(used(order, results, STILL))
    return [op for op in ops if op.level == STILL and op.kind != "input"]
