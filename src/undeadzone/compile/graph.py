"""Nodes: the instructions of a graph, each stored once, and how often each has to be computed."""

from __future__ import annotations

import itertools
import operator
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any, Final

from undeadzone.util.files import read_table

# How often: never, once a call, once a step for all lanes, once a call in every lane, once a step
# in every lane.
CONSTANT: Final = 0
STEADY: Final = 1
SHARED: Final = 2
STILL: Final = 3
LANES: Final = 4

LANGUAGES: Final[dict[str, dict[str, Any]]] = read_table(__file__, "operations.toml")
"""Tables of each target language by kind of operands: what it calls an instruction, or a type."""


@dataclass(slots=True, eq=False, repr=False)  # its operands, written out, would fill any memory
class Node:
    """Instruction of a graph.

    Attributes:
        op: operation: add, sub, mul, div, neg, lt, le, eq, ne, and, or, xor, shl, shr of words;
            and, or, not, ne of truths; select (one of two values by a truth), convert (to another
            type), view (the same bits as another type), least and most (of two numbers, the second
            if one is NaN or both are equal); call, input, const.
        args: its operands.
        text: name of an input, function of a call, or value of a constant.
        kind: NumPy's name of the type of its value.
        level: how often it has to be computed.
        number: of nodes made before it.
    """

    op: str
    args: tuple[Node, ...]
    text: str
    kind: str
    level: int
    number: int

    @property
    def constant_value(self) -> float | None:
        """Return the number of a constant, or None for all further nodes."""
        return float(self.text) if self.op == "const" else None

    @property
    def is_real(self) -> bool:
        """Return whether the value is a floating-point number."""
        return self.kind.startswith("float")


Results = list[list[Node]]  # the nodes that each output of a graph consists of
_number: Final = operator.attrgetter("number")  # when a node was made


class Nodes:
    """Growing list of instructions without duplicates."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], Node] = {}

    def intern(self, op: str, *args: Node, text: str = "", kind: str = "", level: int = 0) -> Node:
        """Return the node for an instruction. Equal instructions share a node.

        Args:
            op, args, text: as of `Node`.
            kind: of its value (empty for that of its last operand).
            level: the least that it may have.
        """
        kind = kind or args[-1].kind
        key = (op, text, kind, *[arg.number for arg in args])
        node = self._known.get(key)
        if node is None:
            levels = {level, *[arg.level for arg in args]}
            level = max(levels)
            if level == CONSTANT and op != "const":
                level = STEADY
            if level == STILL and SHARED in levels:
                level = LANES
            node = self._known[key] = Node(op, args, text, kind, level, len(self._known))
        return node

    def copy_node(self, node: Node, args: Iterable[Node], level: int = CONSTANT) -> Node:
        """Return the node of the same instruction on other operands.

        Args:
            node: the instruction.
            args: its operands.
            level: the least that it may have.
        """
        return self.intern(node.op, *args, text=node.text, kind=node.kind, level=level)

    def intern_constant(self, value: float, kind: str = "float64") -> Node:
        """Return the node of a number, a word or a truth (1 or 0)."""
        text = repr(float(value)) if kind.startswith("float") else str(int(value))
        return self.intern("const", text=text, kind=kind)

    def intern_input(self, name: str, level: int, kind: str = "float64") -> Node:
        """Return the node of an input of the graph."""
        return self.intern("input", text=name, kind=kind, level=level)


def required_nodes(results: Iterable[Node], known: Collection[Node] = ()) -> list[Node]:
    """Return the nodes that results need beyond the known nodes, in the order of creation."""
    seen = set(known)
    new = set(results) - seen
    while new:
        seen |= new
        new = set(itertools.chain(*[node.args for node in new])) - seen
    return sorted(seen.difference(known), key=_number)


def operands_at_level(order: Iterable[Node], results: Iterable[Node], level: int) -> list[Node]:
    """Return the values of a level that some instructions or results use directly."""
    found = set(results).union(*[node.args for node in order])
    return sorted((node for node in found if node.level == level), key=_number)


def per_call_nodes(order: Iterable[Node], results: Iterable[Node]) -> list[Node]:
    """Return the lane instructions needed once a call by some instructions or results."""
    nodes = required_nodes(operands_at_level(order, results, STILL))
    return [node for node in nodes if node.level == STILL and node.op != "input"]


def count_uses(results: Results) -> Counter[Node]:
    """Return the number of uses of each node by the results and by all nodes that these need."""
    counts = Counter(itertools.chain(*results))
    for node in required_nodes(counts):
        counts.update(node.args)
    return counts


def to_condition(number: Node) -> Node | None:
    """Return the truth that a number 1 or 0 represents, or None for further numbers."""
    if number.op != "select" or (number.args[1].text, number.args[2].text) != ("1.0", "0.0"):
        return None
    return number.args[0]
