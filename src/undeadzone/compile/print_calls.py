"""Calls of repeated parts in C: differences between copies are passed, by address if possible.

Numbers that stand in an array in the same order for each copy, as states do, are passed by their
address. Results go to the places that the caller gives. Only the rest is copied into arrays.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Final, NamedTuple

from undeadzone.compile.graph import Node, Results
from undeadzone.compile.print_c import (
    TYPES,
    Body,
    Expressions,
    Names,
    Style,
    build_body,
    wrap_statement,
)
from undeadzone.compile.repeats import Part, Row, find_calls

FEW: Final = 2  # numbers below which an array is copied: an address would cost as much


class Place(NamedTuple):
    """Entry of an array.

    Attributes:
        array: its expression.
        number: of the entry.
        text: the entry itself.
    """

    array: str
    number: int
    text: str


class _Parameter(NamedTuple):
    """Parameter of a function, an array.

    Attributes:
        name: its name in the function, and behind a prefix at a call.
        kind: of its entries.
        entries: numbers of the arguments or results that it holds, by their indices.
        array: array into which it points (empty for a copy).
        starts: the first index there for each call.
        is_shared: whether all calls have the same copy.
    """

    name: str
    kind: str
    entries: dict[int, int]
    array: str = ""
    starts: tuple[int, ...] = ()
    is_shared: bool = False

    @property
    def entry_count(self) -> int:
        """Return the number of entries."""
        return 1 + max(self.entries.values())

    def texts(self) -> dict[int, str]:
        """Return the expression of each entry in the function."""
        return {number: f"{self.name}[{k}]" for number, k in self.entries.items()}


class CalledPart:
    """Function of a repeated part and its calls.

    Args:
        part: the function.
        calls: the nodes of its calls.
        taken: of each call, the node of each result that is used.
        places: where inputs and wanted results stand.
    """

    def __init__(
        self,
        part: Part,
        calls: list[Node],
        taken: list[dict[int, Node]],
        places: Mapping[Node, Place],
    ) -> None:
        self.part, self._calls, self._taken = part, calls, taken
        self.name = part.name
        self._places, self._has_shared = places, False
        given = list(zip(*[call.args for call in calls], strict=True))
        self._given = self._parameters("a", given)
        wanted = [tuple(each.get(k, node) for each in taken) for k, node in enumerate(part.results)]
        self._results = self._parameters("r", wanted)

    def _parameters(self, letter: str, rows: list[Row]) -> list[_Parameter]:
        """Return the parameters of arguments or results, which are given as rows of the calls."""
        groups = defaultdict[tuple[object, ...], list[int]](list)
        for number, row in enumerate(rows):
            groups[self._common_array(row)].append(number)
        copies = defaultdict[tuple[bool, str], list[int]](list)
        found: list[_Parameter] = []
        for (array, *steps), numbers in groups.items():
            if array and len(numbers) >= FEW:
                at = {number: self._places[rows[number][0]].number for number in numbers}
                first, name = min(at.values()), f"{letter}{len(found)}"
                starts = tuple(first + int(str(step)) for step in steps)
                entries = {number: index - first for number, index in at.items()}
                kind = rows[numbers[0]][0].kind
                found.append(_Parameter(name, kind, entries, str(array), starts))
                continue
            for number in numbers:
                row = rows[number]
                copies[letter == "a" and len(set(row)) == 1, row[0].kind].append(number)
        for (is_shared, kind), numbers in copies.items():
            entries = {number: k for k, number in enumerate(numbers)}
            name = f"{letter}{len(found)}"
            found.append(_Parameter(name, kind, entries, is_shared=is_shared))
        return found

    def _common_array(self, row: Row) -> tuple[object, ...]:
        """Return the array of a row's nodes and their distances from the first, or ("",).

        A truth has no array: where it stands among numbers, its address has another type.
        """
        if not row[0].is_real:
            return ("",)
        places = [self._places.get(node) for node in row]
        known = [place for place in places if place is not None]
        if len(known) < len(row) or len({place.array for place in known}) > 1:
            return ("",)
        return known[0].array, *[place.number - known[0].number for place in known]

    def print_function(self, style: Style, calls: Calls) -> Body:
        """Return the text of the function, with the functions that it calls.

        Args:
            style: how numbers and functions are written.
            calls: of other parts in it.
        """
        inputs: dict[str, str] = {}
        for parameter in self._given:
            texts = parameter.texts()
            inputs |= {self.part.inputs[number].text: text for number, text in texts.items()}
        stored: dict[int, str] = {}
        for parameter in self._results:
            stored |= parameter.texts()
        numbers = range(len(self.part.results))
        names = [[stored[k] for k in numbers]], [[f"out_{k}" for k in numbers]]
        body = build_body([self.part.results], style, Names(inputs, *names, {}, {}, calls))
        declared = [f"const {TYPES[each.kind]} *restrict {each.name}" for each in self._given]
        declared += [f"{TYPES[each.kind]} *restrict {each.name}" for each in self._results]
        head = wrap_statement(f"static void {style.prefix}_{self.name}({', '.join(declared)})", "")
        return Body([*head, "{", *body.lines, "}"], body.functions)

    def print_call(self, name: str, node: Node, expressions: Expressions) -> list[str]:
        """Return the statements of a call. Its results get their names.

        Args:
            name: first part of the names of its arrays.
            node: of the call.
            expressions: how nodes are written.
        """
        k, lines, passed = self._calls.index(node), list[str](), []
        for each in self._given:
            copy = f"{self.part.name if each.is_shared else name}_{each.name}"
            if not each.array and not (each.is_shared and self._has_shared):
                texts = ", ".join(
                    expressions.write_node(node.args[number]).text for number in each.entries
                )
                lines += wrap_statement(
                    f"const {TYPES[each.kind]} {copy}[{each.entry_count}] = {{ {texts} }};"
                )
            passed.append(_address(each, k) or copy)
        self._has_shared = True
        for each in self._results:
            copy = f"{name}_{each.name}"
            if not each.array:
                lines += wrap_statement(f"{TYPES[each.kind]} {copy}[{each.entry_count}];")
            for number, index in each.entries.items():
                result = self._taken[k].get(number)
                if result is not None:
                    own = f"{copy}[{index}]"
                    expressions.names[result] = self._places[result].text if each.array else own
            passed.append(_address(each, k) or copy)
        function = f"{expressions.style.prefix}_{self.name}"
        return [*lines, *wrap_statement(f"{function}({', '.join(passed)});")]


def _address(parameter: _Parameter, k: int) -> str:
    """Return where call k finds its entries, or "" of a copy."""
    if not parameter.array or not parameter.starts[k]:
        return parameter.array
    return f"{parameter.array} + {parameter.starts[k]}"


class Calls:
    """Calls of repeated parts in a graph.

    Args:
        parts: all functions.
        results: the graph.
        places: where inputs and wanted results stand.
    """

    def __init__(
        self, parts: list[Part], results: Results, places: Mapping[Node, Place] | None = None
    ) -> None:
        calls = defaultdict[str, list[Node]](list)
        taken = find_calls(results)
        for node in taken:
            calls[node.text].append(node)
        self.parts: dict[str, CalledPart] = {}
        for part in parts:
            if part.name in calls:
                own = calls[part.name]
                results_of = [taken[call] for call in own]
                self.parts[part.name] = CalledPart(part, own, results_of, places or {})

    def __call__(self, name: str, node: Node, expressions: Expressions) -> list[str]:
        """Return the statements of a call."""
        return self.parts[node.text].print_call(name, node, expressions)

    def print_functions(self, parts: list[Part], style: Style, names: set[str]) -> list[Body]:
        """Return the texts of the functions, each after those that it calls.

        Args:
            parts: all functions.
            style: how numbers and functions are written.
            names: of the functions that are printed (grows): each caller has its own.
        """
        found: list[Body] = []
        for called in self.parts.values():
            inner = Calls(parts, [called.part.results])
            found += inner.print_functions(parts, style, names)
            while called.name in names:
                called.name += "_"
            names.add(called.name)
            found.append(called.print_function(style, inner))
        return found
