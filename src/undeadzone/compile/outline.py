"""Outlining of a long step into functions of some thousand instructions each.

LLVM takes the longer for an instruction the longer its function is. The inputs of a function, and
its results for a later function or for the end of the step, stand in a frame: vectors of doubles.
"""

from __future__ import annotations

import heapq
import itertools
from collections import defaultdict
from collections.abc import Callable, Container, Iterator
from typing import Final

from undeadzone.compile.graph import STILL, Node
from undeadzone.compile.machine import Form
from undeadzone.compile.print_llvm import Names, Text, from_double, print_lanes, to_double
from undeadzone.compile.schedule import Branch

_POINTERS: Final = ("frame", "sp", "sq")

Order = list[Node | Branch]


class OutlinedStep:
    """Step of a group of lanes as several functions.

    Args:
        order: instructions of the step, in order.
        results: nodes of its results.
        form: form of the kernel.
        name: name of the function that calls them.
    """

    def __init__(self, order: Order, results: list[Node], form: Form, name: str) -> None:
        self._name = name
        self._orders = list(_cut_order(order, form.piece))
        self._lanes = form.lanes
        self._piece_of_node: dict[Node, int] = {}
        for at, piece in enumerate(self._orders):
            self._piece_of_node.update(dict.fromkeys(_flat_instructions(piece), at))
        self._last = self._last_uses(results)
        self._places: dict[Node, int] = {}
        self._given = self._assign_places() * form.lanes  # numbers of the frame
        calls = [node for node in self._piece_of_node if node.op == "apply"]
        self.numbers = self._given + max([len(call.args) for call in calls], default=0)
        self._calls: dict[Node, int] = {}
        for call in calls:
            self._calls[call] = self.numbers
            self.numbers += int(call.text.rpartition(".")[2])

    def _last_uses(self, results: list[Node]) -> dict[Node, int]:
        """Return, for each value passed between functions, the last function that uses it.

        The end of the step counts as a further function.
        """
        last: dict[Node, int] = {}
        for at, piece in enumerate(self._orders):
            for node in _all_operands(piece):
                if node.level >= STILL and self._piece_of_node.get(node) != at:
                    last[node] = at
        return last | {node: len(self._orders) for node in results if node in self._piece_of_node}

    def _assign_places(self) -> int:
        """Assign a place in the frame to each value that needs it. Return the number of places."""
        begin: dict[int, list[Node]] = defaultdict(list)
        end: dict[int, list[Node]] = defaultdict(list)
        for node, last in self._last.items():
            begin[self._piece_of_node.get(node, -1)].append(node)
            end[last].append(node)
        free: list[int] = []
        fresh = itertools.count()
        for at in range(-1, len(self._orders)):
            for node in begin[at]:
                self._places[node] = heapq.heappop(free) if free else next(fresh)
            for node in end[at]:
                heapq.heappush(free, self._places[node])
        return next(fresh)

    def print_calls(self, text: Text, source: Names) -> Names:
        """Print the calls. Return the source of names for the results.

        Args:
            text: destination of the output (%frame, %sp and %sq are defined).
            source: names what functions are given.
        """
        for node in self._last:
            if node not in self._piece_of_node:
                self._print_frame_store(text, node, source(node))
        for at in range(len(self._orders)):
            text.append_line(f"call void @{self._name}.piece{at}({_pointer_arguments('ptr')})")
        return self._frame_source(text, self._piece_of_node, source)

    def outlined_texts(
        self, declared: dict[str, str], tables: Callable[[Text], Names]
    ) -> list[str]:
        """Return the texts of the functions.

        Args:
            declared: declarations of the module, by name.
            tables: gives what names values of lower levels in a function, from %sp and %sq.
        """
        numbered = enumerate(self._orders)
        calls = self._calls, self._given
        texts = [Text(self._lanes, declared, "t", *calls) for _ in self._orders]
        return [self._outlined_text(at, piece, texts[at], tables) for at, piece in numbered]

    def _outlined_text(
        self, at: int, piece: Order, text: Text, tables: Callable[[Text], Names]
    ) -> str:
        """Return the text of a function, in which values of the frame are loaded at every
        use.
        """
        text.block = "entry"
        names_of: dict[Node, str] = {}
        frame = self._frame_source(text, self._places, tables(text))

        def source(node: Node) -> str:
            """Return the name of a value."""
            return names_of[node] if node in names_of else frame(node)

        for instruction in piece:
            (names,) = print_lanes(text, [instruction], [source], False)
            for node in instruction.leaving if isinstance(instruction, Branch) else (instruction,):
                names_of[node] = names(node)
                if node in self._places:
                    self._print_frame_store(text, node, names_of[node])
        arguments = _pointer_arguments("ptr noalias")
        head = f"define internal void @{self._name}.piece{at}({arguments}) noinline #0 {{"
        return "\n".join([head, "entry:", *text.lines, "  ret void", "}"])

    def _print_frame_store(self, text: Text, node: Node, name: str) -> None:
        """Print the instructions that store a value in the frame."""
        address = text.address_of("%frame", self._places[node] * self._lanes)
        text.store(to_double(text, node, name, vector=True), address, vector=True)

    def _frame_source(self, text: Text, within: Container[Node], otherwise: Names) -> Names:
        """Return the source of names for values of the frame, and otherwise the given
        source.
        """

        def source(node: Node) -> str:
            """Return the name of a value."""
            if node not in within:
                return otherwise(node)
            address = text.address_of("%frame", self._places[node] * self._lanes)
            return from_double(text, node, text.load(address, vector=True), vector=True)

        return source


def _pointer_arguments(kind: str) -> str:
    """Return the arguments that every function has, as text."""
    return ", ".join([f"{kind} %{name}" for name in _POINTERS])


def _flat_instructions(order: Order) -> Iterator[Node]:
    """Yield all instructions, including those inside branches."""
    for item in order:
        yield from item.nodes if isinstance(item, Branch) else (item,)


def _all_operands(order: Order) -> Iterator[Node]:
    """Yield the operands of all instructions and the truths of all branches."""
    for item in order:
        if isinstance(item, Branch):
            yield item.truth
    for node in _flat_instructions(order):
        yield from node.args


def _cut_order(order: Order, piece: int) -> Iterator[Order]:
    """Yield the instructions in parts of about `piece` instructions."""
    part: Order = []
    length = 0
    for item in itertools.chain.from_iterable(_split_branch(item, piece) for item in order):
        part.append(item)
        length += len(item.nodes) if isinstance(item, Branch) else 1
        if length >= piece:
            yield part
            part = []
            length = 0
    if part:
        yield part


def _split_branch(item: Node | Branch, piece: int) -> Iterator[Node | Branch]:
    """Yield a branch as branches that are not longer than a function."""
    if not isinstance(item, Branch) or len(item.nodes) <= piece:
        yield item
        return
    required = set(item.leaving)
    parts = []
    for end in range(len(item.nodes), 0, -piece):
        nodes = item.nodes[max(0, end - piece) : end]
        parts.append(item._replace(nodes=nodes, leaving=[n for n in nodes if n in required]))
        required.update(*(node.args for node in nodes))
    yield from reversed(parts)
