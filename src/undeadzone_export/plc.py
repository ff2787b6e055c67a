"""Export as Structured Text of IEC 61131-3: functions, function blocks and the self-test."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.compile import elementary, portable_maths
from undeadzone.compile.graph import Node, Results
from undeadzone.compile.print_c import (
    INDENT,
    Expressions,
    Local,
    Style,
    find_locals,
    local_statements,
    wrap_statement,
)
from undeadzone.compile.print_st import (
    ST,
    TYPES,
    assign_number,
    initial_literal,
    statement_operands,
)
from undeadzone.compile.repeats import Part, find_calls, outline_parts, outline_repeats
from undeadzone.util.arrays import Floats
from undeadzone.util.text import to_one_line
from undeadzone_export.code import Code
from undeadzone_export.exported_step import (
    Field,
    field_entries,
    make_distinct,
    member_entries,
    name_entries,
)
from undeadzone_export.selftest_vectors import Vectors
from undeadzone_export.source import Labels, local_meanings

STATEMENTS: Final = 1000  # of one function block; what has more is divided
INPUTS, OUTPUTS, LOCALS = "VAR_INPUT", "VAR_OUTPUT", "VAR"


class PlcVariable(NamedTuple):
    """Variable of a program organisation unit.

    Attributes:
        name: its name.
        kind: its type.
        meaning: its meaning (empty: as its name).
        start: its value at first, of an array that of each entry (empty: that of its type).
    """

    name: str
    kind: str
    meaning: str = ""
    start: tuple[str, ...] = ()

    @property
    def is_array(self) -> bool:
        """Return whether the variable is an array."""
        return len(self.start) > 1


class PlcUnit(NamedTuple):
    """Program organisation unit.

    Attributes:
        keyword: FUNCTION, FUNCTION_BLOCK or PROGRAM.
        name: its name.
        meaning: its purpose.
        variables: by their sections.
        lines: its statements.
        returns: the type of a function (empty of others).
    """

    keyword: str
    name: str
    meaning: str
    variables: dict[str, list[PlcVariable]]
    lines: list[str]
    returns: str = ""


class PlcExport(NamedTuple):
    """Program organisation units of an export.

    Attributes:
        units: functions and blocks, each after those that it uses. The last is the observer.
        test: the program that compares with the reference.
    """

    units: list[PlcUnit]
    test: PlcUnit

    @property
    def block_count(self) -> int:
        """Return the number of function blocks."""
        return [unit.keyword for unit in self.units].count("FUNCTION_BLOCK")


def export_plc(code: Code, labels: Labels, vectors: Vectors) -> PlcExport:
    """Build the program organisation units of an export.

    Args:
        code: the nodes to print.
        labels: the words that its files share.
        vectors: the reference vectors of the self-test.

    Raises:
        InputError: an operation that the language has not.
    """
    style = Style(code.dtype_name, labels.prefix, ST)
    block = _BlockBuilder(code, labels, style)
    names = elementary.required_functions(block.function_names, code.dtype_name, portable_maths.OWN)
    functions = [function_unit(name, style) for name in names]
    blocks = block.build_units()
    return PlcExport([*functions, *blocks], _selftest_unit(code, labels, vectors, blocks[-1]))


def function_unit(name: str, style: Style) -> PlcUnit:
    """Build the unit of an elementary function.

    Args:
        name: one of `portable_maths.OWN`.
        style: how numbers and functions are written.
    """
    part = elementary.build_elementary(name, style.kind, portable_maths.OWN)
    expressions = Expressions(style, {node.text: node.text for node in part.inputs})
    found = find_locals([part.results], expressions, {})
    called = f"{style.prefix}_{name}"
    result = wrap_statement(f"{called} := {expressions.write_node(part.results[0]).text};")
    given = [PlcVariable(node.text, style.real_type) for node in part.inputs]
    declared = [PlcVariable(local.name, TYPES[local.node.kind]) for local in found]
    variables = {INPUTS: given, LOCALS: declared}
    meaning = str(portable_maths.OWN.functions[name].__doc__).strip()
    return PlcUnit(
        "FUNCTION", called, meaning, variables, [*local_statements(found), *result], style.real_type
    )


class _BlockBuilder:
    """Builder of the observer's function block, whole or in parts.

    Args:
        code: the nodes to print.
        labels: the words that its files share.
        style: how numbers and functions are written.
    """

    def __init__(self, code: Code, labels: Labels, style: Style) -> None:
        self.code, self.labels, self.style = code, labels, style
        step, real = code.step, style.real_type
        fields = (step.inputs, step.outputs, step.params)
        states, readings = member_entries(step.state), range(step.readings)
        names = [
            *([f"{name}_{k}" for name, k in member_entries(field)] for field in fields),
            [f"{name}_was_{k}" for name, k in states],
            list(map("missing_{}".format, readings)),
            list(map("read_{}".format, readings)),
            [f"next_{name}_{k}" for name, k in states],
        ]
        # The language takes names that differ by capitals alone for one.
        flat = iter(make_distinct(list(itertools.chain(*names)), str.lower))
        named = [list(itertools.islice(flat, len(each))) for each in names]
        self.inputs, self.outputs, self.params, self.states = named[:4]
        self.missing, self.read, self.following = named[4:]
        given = [*self.read, *self.inputs[step.readings :]]
        self.entries = name_entries(s=self.states, w=given, p=self.params)
        repeats = outline_parts(code.parts)
        self.results = outline_repeats(code.results, repeats)
        self.repeats = [_Repeat(part, repeats, labels, style) for part in repeats]
        labelled = local_meanings(self.results, step, 1)
        for nodes, targets in zip(self.results, (self.following, self.outputs), strict=True):
            for node, name in zip(nodes, targets, strict=True):
                if node.args:
                    labelled[node] = name
        inner = _Inner(f"fb_{labels.prefix}", self.results, repeats, self.entries, style)
        self.inner = inner.write(labelled)
        self._expressions = inner.expressions
        self.real = real

    @property
    def function_names(self) -> set[str]:
        """Return the functions that the blocks call."""
        every = [self._expressions, *(repeat.expressions for repeat in self.repeats)]
        return set().union(*(each.functions for each in every))

    def build_units(self) -> list[PlcUnit]:
        """Build the blocks of repeated parts, the parts of the block, if any, and the block."""
        own = itertools.chain(*(repeat.units for repeat in self.repeats))
        return [*own, *self.inner.units, self._main_block()]

    def _main_block(self) -> PlcUnit:
        """Build the block that users call."""
        output_names, step = set(self.outputs), self.code.step
        copied, stored = self._memory_assignments()
        variables = {
            INPUTS: self._input_variables(),
            OUTPUTS: self._field_variables(self.outputs, step.outputs),
            LOCALS: [
                *self._variables_with_start(self.states, step.state, step.start),
                *[PlcVariable(text, self.real) for text in [*self.read, *copied]],
                *[each for each in self.inner.variables if each.name not in output_names],
            ],
        }
        states = zip(self.states, step.start.tolist(), strict=True)
        start = itertools.chain(*[assign_number(*each, self.code.dtype_name) for each in states])
        text = [
            *_if_statement("reset", start),
            *self._reading_statements(),
            *self.inner.lines,
            *_output_assignments(self.results[1], self.outputs, self._expressions),
        ]
        text += [f"{INDENT}{each} := {source};" for each, source in copied.items()]
        text += _if_statement("NOT hold", stored)
        meaning = f"{to_one_line(self.labels.title)}: {self.labels.part}, every {step.Ts:g} s."
        return PlcUnit("FUNCTION_BLOCK", f"fb_{self.labels.prefix}", meaning, variables, text)

    def _input_variables(self) -> list[PlcVariable]:
        """Return the input variables of the block."""
        step = self.code.step
        missing = [
            PlcVariable(text, "BOOL", f"TRUE: there is no reading {k}")
            for k, text in enumerate(self.missing)
        ]
        return [
            PlcVariable("reset", "BOOL", "TRUE: start anew with this sample"),
            PlcVariable("hold", "BOOL", "TRUE: show the estimate, remember nothing; call again"),
            *self._field_variables(self.inputs, step.inputs),
            *missing,
            *self._variables_with_start(self.params, step.params, step.defaults),
        ]

    def _field_variables(self, names: list[str], fields: list[Field]) -> list[PlcVariable]:
        """Return variables for the numbers of fields."""
        each = zip(names, field_entries(fields), strict=True)
        return [PlcVariable(name, self.real, field.meaning) for name, (field, _) in each]

    def _variables_with_start(
        self, names: list[str], fields: list[Field], values: Floats
    ) -> list[PlcVariable]:
        """Return variables for the numbers of fields, with their start values."""
        starts = [(initial_literal(value, self.code.dtype_name),) for value in values.tolist()]
        known = zip(self._field_variables(names, fields), starts, strict=True)
        return [each._replace(start=start) for each, start in known]

    def _reading_statements(self) -> list[str]:
        """Return statements that replace a missing reading by a number out of range."""
        lines = []
        for missing, read, y in zip(self.missing, self.read, self.inputs, strict=False):
            lines += [f"{INDENT}{read} := {y};"]
            lines += _if_statement(missing, assign_number(read, np.inf, self.code.dtype_name))
        return lines

    def _memory_assignments(self) -> tuple[dict[str, str], list[str]]:
        """Return copies of states that move to another, and the assignments to the memory."""
        copied, stored = {}, []
        for node, state, name in zip(self.results[0], self.states, self.following, strict=True):
            text = self._expressions.write_node(node).text
            if text in self.states and text != state:
                copied[name], text = text, name
            if text != state:
                stored.append(f"{state} := {text};")
        return copied, stored


class _Written(NamedTuple):
    """Inside of a block.

    Attributes:
        units: its parts, if it is divided.
        variables: variables of the block.
        lines: its statements.
    """

    units: list[PlcUnit]
    variables: list[PlcVariable]
    lines: list[str]


class _Inner:
    """Writer of the statements of a block, whole or in parts, with calls of repeated parts.

    Args:
        name: of the block.
        results: nodes that it computes.
        repeats: all repeated parts.
        entries: the expression of each input.
        style: how numbers and functions are written.
    """

    def __init__(
        self,
        name: str,
        results: Results,
        repeats: list[Part],
        entries: dict[str, str],
        style: Style,
    ) -> None:
        self.name, self.results, self.entries, self.prefix = name, results, entries, style.prefix
        self.expressions = Expressions(style, entries)
        self.expressions.calls = self._call_repeat
        self._inputs = {part.name: part.inputs for part in repeats}
        self._calls = find_calls(results)

    def _call_repeat(self, name: str, node: Node, expressions: Expressions) -> list[str]:
        """Return the statements that call a repeated part and copy its results, which get names."""
        pairs = zip(self._inputs[node.text], node.args, strict=True)
        given = ", ".join(f"{to.text} := {expressions.write_node(arg).text}" for to, arg in pairs)
        lines = wrap_statement(f"{node.text}({given});")
        for k, result in self._calls[node].items():
            expressions.names[result] = f"{name}_{k}"
            lines.append(f"{INDENT}{name}_{k} := {node.text}.r{k};")
        return lines

    def _declare(self, found: Iterable[Local]) -> list[PlcVariable]:
        """Return the variables of locals, for a call those of its results."""
        node_names = self.expressions.names
        variables = []
        for local in found:
            given = self._calls.get(local.node, {0: local.node})
            variables += [PlcVariable(node_names[one], TYPES[one.kind]) for one in given.values()]
        return variables

    def write(self, labels: dict[Node, str]) -> _Written:
        """Write the statements.

        Args:
            labels: names of some nodes.
        """
        found = find_locals(self.results, self.expressions, labels)
        called = dict.fromkeys(node.text for node in self._calls)
        instances = [PlcVariable(each, f"fb_{self.prefix}_{each}") for each in called]
        if len(found) <= STATEMENTS:
            return _Written([], [*self._declare(found), *instances], local_statements(found))
        node_names = self.expressions.names
        shared = set(itertools.chain(*self.results))
        parts: list[tuple[list[Local], list[Node]]] = []
        for is_call, run in itertools.groupby(found, lambda local: local.node in self._calls):
            many = list(run)
            size = 1 if is_call else STATEMENTS
            for part in (many[start : start + size] for start in range(0, len(many), size)):
                inside = {local.node for local in part}
                read = itertools.chain(*[statement_operands(local, node_names) for local in part])
                given = list(dict.fromkeys(node for node in read if node not in inside))
                shared.update(given)
                parts.append((part, given))
        units, lines = list[PlcUnit](), list[str]()
        for part, given in parts:
            if part[0].node in self._calls:
                lines += part[0].lines
                continue
            meaning = f"Part {len(units) + 1} of those that the block calls."
            unit = (f"{self.name}_part_{len(units) + 1}", meaning)
            variables = self._part_variables(part, given, shared)
            units.append(PlcUnit("FUNCTION_BLOCK", *unit, variables, local_statements(part)))
            lines += _call_part(units[-1])
        own = [local for local in found if local.node in shared or local.node in self._calls]
        instances += [PlcVariable(_instance_name(unit), unit.name) for unit in units]
        return _Written(units, [*self._declare(own), *instances], lines)

    def _part_variables(
        self, part: list[Local], given: list[Node], shared: set[Node]
    ) -> dict[str, list[PlcVariable]]:
        """Return the variables of a part, by section.

        Args:
            part: the repeated part.
            given: nodes that it reads.
            shared: nodes that are read outside of the part that computes them.
        """
        node_names = self.expressions.names
        read = [
            PlcVariable(node_names.get(node) or self.entries[node.text], TYPES[node.kind])
            for node in given
        ]
        variables: dict[str, list[PlcVariable]] = {INPUTS: read, OUTPUTS: [], LOCALS: []}
        for local in part:
            section = OUTPUTS if local.node in shared else LOCALS
            variables[section] += self._declare([local])
        return variables


class _Repeat:
    """Block of a repeated part.

    Args:
        part: the repeated part.
        repeats: all repeated parts.
        labels: the words that all files share.
        style: how numbers and functions are written.

    Attributes:
        units: its parts, if it is divided, and the block.
        expressions: how it is written.
    """

    def __init__(self, part: Part, repeats: list[Part], labels: Labels, style: Style) -> None:
        name = f"fb_{labels.prefix}_{part.name}"
        entries = {each.text: each.text for each in part.inputs}
        inner = _Inner(name, [part.results], repeats, entries, style)
        outputs = {node: f"r{k}" for k, node in enumerate(part.results) if node.args}
        written, self.expressions = inner.write(outputs), inner.expressions
        names = [f"r{k}" for k in range(len(part.results))]
        lines = [*written.lines, *_output_assignments(part.results, names, self.expressions)]
        output_variables = [
            PlcVariable(text, TYPES[node.kind])
            for text, node in zip(names, part.results, strict=True)
        ]
        variables = {
            INPUTS: [PlcVariable(each.text, TYPES[each.kind]) for each in part.inputs],
            OUTPUTS: output_variables,
            LOCALS: [each for each in written.variables if each.name not in names],
        }
        meaning = "Parts that the block computes several times, on other numbers."
        self.units = [
            *written.units,
            PlcUnit("FUNCTION_BLOCK", name, meaning, variables, lines),
        ]


def _output_assignments(
    nodes: Iterable[Node], names: list[str], expressions: Expressions
) -> list[str]:
    """Return assignments to the outputs that no local of the same name fills."""
    lines = []
    for node, name in zip(nodes, names, strict=True):
        text = expressions.write_node(node).text
        lines += wrap_statement(f"{name} := {text};") * (text != name)
    return lines


def _instance_name(part: PlcUnit) -> str:
    """Return the name of the instance of a part."""
    return f"own_{part.name[part.name.rindex('part_') :]}"


def _call_part(part: PlcUnit) -> list[str]:
    """Return the statements that call a part and copy its outputs."""
    instance = _instance_name(part)
    given = ", ".join(f"{each.name} := {each.name}" for each in part.variables[INPUTS])
    lines = wrap_statement(f"{instance}({given});")
    lines += [f"{INDENT}{each.name} := {instance}.{each.name};" for each in part.variables[OUTPUTS]]
    return lines


def _if_statement(truth: str, statements: Iterable[str]) -> list[str]:
    """Return statements under a condition."""
    inner = [wrap_statement(statement, 2 * INDENT) for statement in statements]
    return [f"{INDENT}IF {truth} THEN", *itertools.chain(*inner), f"{INDENT}END_IF;"]


def _selftest_unit(code: Code, labels: Labels, vectors: Vectors, block: PlcUnit) -> PlcUnit:
    """Build the self-test: one sample a cycle, each output compared with its reference."""
    samples, kind = len(vectors.states), code.dtype_name
    given, expected = vectors.inputs.view(kind), vectors.outputs.view(kind)
    names = [each.name for each in block.variables[INPUTS] if each.kind != "BOOL"]
    arguments, checks, tables = [], [], []
    for k, name in enumerate(names[: given.shape[1]]):
        values, absent = np.nan_to_num(given[:, k]), np.isnan(given[:, k])
        tables.append(_number_array(f"given_{name}", values, kind))
        arguments.append(f"{name} := given_{name}[sample]")
        if absent.any():
            truths = tuple(str(each).upper() for each in absent.tolist())
            tables.append(_array(f"no_{name}", "BOOL", truths))
            arguments.append(f"missing_{k} := no_{name}[sample]")
    for k, each in enumerate(block.variables[OUTPUTS]):
        tables.append(_number_array(f"expected_{each.name}", expected[:, k], kind))
        wrong = f"block.{each.name} <> expected_{each.name}[sample]"
        checks.append(f"IF {wrong} THEN failures := failures + 1; END_IF;")
    calls = [f"block(hold := {truth}, {', '.join(arguments)});" for truth in ("TRUE", "FALSE")]
    outputs = [
        PlcVariable("done", "BOOL", f"TRUE after {samples} cycles"),
        PlcVariable("passed", "BOOL", "TRUE then: every output agrees with its reference"),
        PlcVariable("failures", "INT", "outputs that differ"),
    ]
    own = [PlcVariable("sample", "INT", "the next one"), PlcVariable("block", block.name), *tables]
    lines = [
        *_if_statement(f"sample < {samples}", [*calls, *checks, "sample := sample + 1;"]),
        f"{INDENT}done := sample = {samples};",
        f"{INDENT}passed := done AND (failures = 0);",
    ]
    meaning = f"Self-test of {block.name}, one sample a cycle: done, then passed."
    return PlcUnit(
        "PROGRAM", f"{labels.prefix}_test", meaning, {OUTPUTS: outputs, LOCALS: own}, lines
    )


def _number_array(name: str, values: Any, kind: str) -> PlcVariable:
    """Return an array variable of numbers."""
    texts = tuple(initial_literal(value, kind) for value in values.tolist())
    return _array(name, TYPES[kind], texts)


def _array(name: str, kind: str, texts: tuple[str, ...]) -> PlcVariable:
    """Return an array variable."""
    return PlcVariable(name, f"ARRAY [0..{len(texts) - 1}] OF {kind}", "", texts)
