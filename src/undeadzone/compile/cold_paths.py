"""Cold paths of a step: separate functions, called if a lane of a group needs the result."""

from __future__ import annotations

import itertools
from typing import Final

from undeadzone.compile.graph import (
    SHARED,
    STEADY,
    STILL,
    Node,
    operands_at_level,
    per_call_nodes,
    required_nodes,
)
from undeadzone.compile.machine import LARGE, Form, Shape
from undeadzone.compile.print_llvm import (
    TYPES,
    Names,
    Text,
    entry_source,
    from_double,
    print_lanes,
    print_once,
)
from undeadzone.compile.schedule import lane_instructions, order_instructions

_POINTERS: Final = ("before", "next", "flag", "row", "own", "w", "rare")


class ColdPaths:
    """Cold paths of a kernel.

    A group's vectors go to them and come back through memory: of the states before the step those
    that they read, of the states after it those that they write.

    Args:
        shape, form: of the kernel.
        parts: next, flag of each.
    """

    def __init__(self, shape: Shape, form: Form, parts: list[list[list[Node]]]) -> None:
        self._shape = shape
        self._form = form
        self._results = [[*following, *flag] for following, flag in parts]
        self._orders = [_order_part(results, form) for results in self._results]
        self._written = len(parts[0][0]) if parts else 0
        everything = required_nodes(itertools.chain(*self._results))
        inputs = [node.text for node in everything if node.op == "input"]
        self._read = sorted(int(text[1:]) for text in inputs if text[0] == "s")
        self._uses = list(map(self._steady_uses, range(len(parts))))
        self.steady = list(dict.fromkeys(itertools.chain(*self._uses)))

    @property
    def group_arrays(self) -> list[tuple[str, int]]:
        """Return the arrays of each group with their numbers of vectors."""
        return [("before", len(self._read)), ("next", self._written), ("flag", 1)]

    def _steady_uses(self, part: int) -> list[Node]:
        """Return the steady values that a part uses."""
        order = self._orders[part]
        results = self._results[part]
        shared = [
            node
            for node in required_nodes(operands_at_level(order, results, SHARED))
            if node.level == SHARED
        ]
        return [*operands_at_level(order, results, STEADY), *operands_at_level(shared, [], STEADY)]

    def print_cold_call(
        self, text: Text, following: list[list[str]], flags: list[str]
    ) -> tuple[str, list[list[str]]]:
        """Print the call for groups in which a flag is set.

        Args:
            text: destination of the output.
            following: the names of the states after the step, for each group.
            flags: the names of conditions, for each group.

        Returns:
            The label of the last block, and the names of the states after it.
        """
        marks = list(map(text.any_lane, flags))
        some = marks[0]
        for mark in marks[1:]:
            some = text.add(f"or i1 {some}, {mark}")
        text.append_line(f"br i1 {some}, label %rarely, label %after, !prof !0")
        text.label("rarely")
        came = "rarely"
        merged = []
        for u, (flag, mark) in enumerate(zip(flags, marks, strict=True)):
            with text.print_if(mark, f"rare{u}"):
                changed = self._print_group_call(text, u, following[u], flag)
            values = list(following[u])
            for i, name in enumerate(changed):
                sources = f"[{values[i]}, %{came}], [{name}, %rare{u}.do]"
                values[i] = text.add(f"phi {text.type('double')} {sources}")
            merged.append(values)
            came = text.block
        text.append_line("br label %after")
        return came, merged

    def _print_group_call(self, text: Text, u: int, following: list[str], flag: str) -> list[str]:
        """Print the call for a single group. Return the names of the states that the call
        writes.
        """
        for i, place in enumerate(self._read):
            text.store(f"%s{u}_{place}", self._vector_address(text, f"%before{u}", i), vector=True)
        for i in range(self._written):
            text.store(following[i], self._vector_address(text, f"%next{u}", i), vector=True)
        one = text.splat("1.0", "double")
        condition = text.print_select(flag, text.type("double"), one, text.zero())
        text.store(condition, f"%flag{u}", vector=True)
        row = f"%row{u}_0"
        own = f"%own{u}_0" if self._shape.exogenous else "%own"
        given = (f"%before{u}", f"%next{u}", f"%flag{u}", row, own, "%w", "%rare")
        pointers = ", ".join(f"ptr {name}" for name in given)
        text.append_line(f"call void @rare0(i64 %lanes, {pointers})")
        changed = []
        for i in range(self._written):
            changed.append(text.load(self._vector_address(text, f"%next{u}", i), vector=True))
        return changed

    def _vector_address(self, text: Text, base: str, i: int) -> str:
        """Return the address of a vector of an array."""
        return text.address_of(base, i * self._form.lanes)

    def cold_function_texts(self, declared: dict[str, str]) -> list[str]:
        """Return the texts of the functions, given the declarations of the module."""
        return [self._cold_function_text(part, declared) for part in range(len(self._results))]

    def _cold_function_text(self, part: int, declared: dict[str, str]) -> str:
        """Return the text of a part: states if the flag is set, a new flag, then the next part."""
        text = Text(self._form.lanes, declared)
        results = self._results[part]
        vector = text.type("double")
        order = self._orders[part]
        have: dict[Node, str] = {}
        for place, node in enumerate(self.steady):
            if node in self._uses[part]:
                have[node] = from_double(text, node, text.load(text.address_of("%rare", place)))
        print_once(text, operands_at_level(order, results, SHARED), have, entry_source(text, "w"))
        (names,) = print_lanes(text, order, [self._cold_source(text, have)], False)
        old = text.load("%flag", vector=True)
        flagged = text.add(f"fcmp une {vector} {old}, {text.zero()}")
        for i, node in enumerate(results[:-1]):
            address = self._vector_address(text, "%next", i)
            usual = text.load(address, vector=True)
            chosen = text.print_select(flagged, vector, names(node), usual)
            text.store(chosen, address, vector=True)
        if part + 1 < len(self._results):
            # Of a lane that needs this part.
            flag = text.print_select(flagged, vector, names(results[-1]), text.zero())
            text.store(flag, "%flag", vector=True)
            again = text.any_lane(text.add(f"fcmp une {vector} {flag}, {text.zero()}"))
            given = ", ".join(f"ptr %{name}" for name in _POINTERS)
            with text.print_if(again, "again"):
                text.append_line(f"call void @rare{part + 1}(i64 %lanes, {given})")
        text.append_line("ret void")
        pointers = ", ".join(f"ptr noalias %{name}" for name in _POINTERS)
        head = f"define internal void @rare{part}(i64 %lanes, {pointers}) noinline #0 {{"
        return "\n".join([head, *text.lines, "}"])

    def _cold_source(self, text: Text, have: dict[Node, str]) -> Names:
        """Return the source of names for values of lower levels and for inputs of the
        lanes.
        """

        def source(node: Node) -> str:
            """Return the name of a value."""
            if node.level < STILL:
                return text.splat(have[node], TYPES[node.kind])
            place = int(node.text[1:])
            if node.text[0] == "s":
                return text.load(
                    self._vector_address(text, "%before", self._read.index(place)), vector=True
                )
            if node.text[0] == "p":
                base = "%row"
                row = self._shape.sizes[0] + self._shape.params.index(place)
            elif place in self._shape.exogenous:
                base = "%own"
                row = self._shape.exogenous.index(place)
            else:
                return text.load(text.address_of("%w", place))
            return text.load(text.address_of(base, text.add(f"mul i64 %lanes, {row}")), vector=True)

        return source


def _order_part(results: list[Node], form: Form) -> list[Node]:
    """Return the instructions of a part in order. A group goes alone and has all registers."""
    small = len(lane_instructions(results)) <= LARGE
    order = order_instructions(results, form.registers * form.streams if small else 0)
    return [*per_call_nodes(order, results), *order]
