"""Calls of repeated parts in C, with arguments passed by address if possible.

Arguments that are consecutive entries of an array for each call, as states are, are passed by
address. Results are written to the places of the caller's results. Other arguments and results are
copied through local arrays.
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

FEW: Final = 2  # entries below which an array is copied: an address would cost as much


class Place(NamedTuple):
    """Entry of an array.

    Attributes:
        array: expression of the array in C.
        number: index of the entry.
        text: expression of the entry in C.
    """

    array: str
    number: int
    text: str


class _Parameter(NamedTuple):
    """Parameter of a function: an array of some of its arguments or results.

    Attributes:
        name: name in the function, and with a prefix at a call.
        kind: type of its entries.
        entries: index in the parameter of each argument or result, by number.
        array: array of the caller into which it points; empty for a copy.
        starts: first index in that array for each call.
        is_shared: whether all calls have the same values, and so one copy.
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
        """Return the expression of each argument or result in the function, by number."""
        return {number: f"{self.name}[{k}]" for number, k in self.entries.items()}


class CalledPart:
    """Function of a repeated part and its calls.

    Args:
        part: the function.
        calls: nodes of its calls.
        used: node of each result that is used, by number, for each call.
        places: array entries of inputs and results of the caller.
    """

    def __init__(
        self,
        part: Part,
        calls: list[Node],
        used: list[dict[int, Node]],
        places: Mapping[Node, Place],
    ) -> None:
        self.part, self._calls, self._used = part, calls, used
        self.name = part.name
        self._places, self._has_shared = places, False
        arguments = list(zip(*[call.args for call in calls], strict=True))
        self._arguments = self._group_parameters("a", arguments)
        results = [
            tuple(nodes.get(k, node) for nodes in used) for k, node in enumerate(part.results)
        ]
        self._results = self._group_parameters("r", results)

    def _group_parameters(self, letter: str, rows: list[Row]) -> list[_Parameter]:
        """Return the parameters that pass the arguments or the results.

        Args:
            letter: first letter of their names, a for arguments, r for results.
            rows: nodes of each argument or result at the calls.
        """
        groups = defaultdict[tuple[object, ...], list[int]](list)
        for number, row in enumerate(rows):
            groups[self._common_array(row)].append(number)
        copies = defaultdict[tuple[bool, str], list[int]](list)
        parameters: list[_Parameter] = []
        for (array, *steps), numbers in groups.items():
            if array and len(numbers) >= FEW:
                at = {number: self._places[rows[number][0]].number for number in numbers}
                first, name = min(at.values()), f"{letter}{len(parameters)}"
                starts = tuple(first + int(str(step)) for step in steps)
                entries = {number: index - first for number, index in at.items()}
                kind = rows[numbers[0]][0].kind
                parameters.append(_Parameter(name, kind, entries, str(array), starts))
                continue
            for number in numbers:
                row = rows[number]
                copies[letter == "a" and len(set(row)) == 1, row[0].kind].append(number)
        for (is_shared, kind), numbers in copies.items():
            entries = {number: k for k, number in enumerate(numbers)}
            name = f"{letter}{len(parameters)}"
            parameters.append(_Parameter(name, kind, entries, is_shared=is_shared))
        return parameters

    def _common_array(self, row: Row) -> tuple[object, ...]:
        """Return the array that has all nodes of a row, and their distances from the first one.

        It is ("",) if there is no such array. A truth has none: among numbers, its address would
        have another type.
        """
        if not row[0].is_real:
            return ("",)
        places = list(map(self._places.get, row))
        known = [place for place in places if place is not None]
        if len(known) < len(row) or len({place.array for place in known}) > 1:
            return ("",)
        return known[0].array, *[place.number - known[0].number for place in known]

    def print_function(self, style: Style, calls: Calls) -> Body:
        """Return the text of the function, with the functions that it calls.

        Args:
            style: how numbers and functions are written.
            calls: calls of other parts in it.
        """
        inputs: dict[str, str] = {}
        for parameter in self._arguments:
            texts = parameter.texts()
            inputs |= {self.part.inputs[number].text: text for number, text in texts.items()}
        result_texts: dict[int, str] = {}
        for parameter in self._results:
            result_texts |= parameter.texts()
        numbers = range(len(self.part.results))
        names = [[result_texts[k] for k in numbers]], [[f"out_{k}" for k in numbers]]
        body = build_body([self.part.results], style, Names(inputs, *names, {}, {}, calls))
        declared = [
            f"const {TYPES[parameter.kind]} *restrict {parameter.name}"
            for parameter in self._arguments
        ]
        declared += [
            f"{TYPES[parameter.kind]} *restrict {parameter.name}" for parameter in self._results
        ]
        head = wrap_statement(f"static void {style.prefix}_{self.name}({', '.join(declared)})", "")
        return Body([*head, "{", *body.lines, "}"], body.functions)

    def print_call(self, name: str, node: Node, expressions: Expressions) -> list[str]:
        """Return the statements of a call, and name its results in `expressions`.

        Args:
            name: prefix of the names of its arrays.
            node: node of the call.
            expressions: writer of nodes, with the names of results.
        """
        k, lines, arguments = self._calls.index(node), list[str](), []
        for parameter in self._arguments:
            copy = f"{self.part.name if parameter.is_shared else name}_{parameter.name}"
            if not parameter.array and not (parameter.is_shared and self._has_shared):
                texts = ", ".join(
                    expressions.write_node(node.args[number]).text for number in parameter.entries
                )
                declared = f"const {TYPES[parameter.kind]} {copy}[{parameter.entry_count}]"
                lines += wrap_statement(f"{declared} = {{ {texts} }};")
            arguments.append(_address(parameter, k) or copy)
        self._has_shared = True
        for parameter in self._results:
            copy = f"{name}_{parameter.name}"
            if not parameter.array:
                lines += wrap_statement(f"{TYPES[parameter.kind]} {copy}[{parameter.entry_count}];")
            for number, index in parameter.entries.items():
                result = self._used[k].get(number)
                if result is not None:
                    own = f"{copy}[{index}]"
                    expressions.names[result] = (
                        self._places[result].text if parameter.array else own
                    )
            arguments.append(_address(parameter, k) or copy)
        function = f"{expressions.style.prefix}_{self.name}"
        return [*lines, *wrap_statement(f"{function}({', '.join(arguments)});")]


def _address(parameter: _Parameter, k: int) -> str:
    """Return the address that call k passes for a parameter, or "" for a copy."""
    if not parameter.array or not parameter.starts[k]:
        return parameter.array
    return f"{parameter.array} + {parameter.starts[k]}"


class Calls:
    """Calls of repeated parts in a graph.

    Args:
        parts: all functions.
        results: results of the graph.
        places: array entries of inputs and results.
    """

    def __init__(
        self, parts: list[Part], results: Results, places: Mapping[Node, Place] | None = None
    ) -> None:
        calls = defaultdict[str, list[Node]](list)
        used = find_calls(results)
        for node in used:
            calls[node.text].append(node)
        self.parts: dict[str, CalledPart] = {}
        for part in parts:
            if part.name in calls:
                own = calls[part.name]
                used_results = [used[call] for call in own]
                self.parts[part.name] = CalledPart(part, own, used_results, places or {})

    def __call__(self, name: str, node: Node, expressions: Expressions) -> list[str]:
        """Return the statements of a call."""
        return self.parts[node.text].print_call(name, node, expressions)

    def print_functions(self, parts: list[Part], style: Style, names: set[str]) -> list[Body]:
        """Return the texts of the functions, each after those that it calls.

        Args:
            parts: all functions.
            style: how numbers and functions are written.
            names: names of the printed functions (grows): each caller has functions of its own.
        """
        bodies: list[Body] = []
        for called in self.parts.values():
            inner = Calls(parts, [called.part.results])
            bodies += inner.print_functions(parts, style, names)
            while called.name in names:
                called.name += "_"
            names.add(called.name)
            bodies.append(called.print_function(style, inner))
        return bodies
