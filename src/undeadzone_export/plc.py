"""An export as Structured Text of IEC 61131-3: functions, function blocks and the self-test."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.compile import elementary, portable_maths
from undeadzone.compile.graph import Node
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
from undeadzone.util.arrays import Floats
from undeadzone.util.text import one_line
from undeadzone_export.code import Code
from undeadzone_export.exported_step import Field, distinct, entries, members, numbers_of
from undeadzone_export.selftest_vectors import Vectors
from undeadzone_export.source import Labels, meanings

STATEMENTS: Final = 1000  # of one function block; what has more is divided
INPUTS, OUTPUTS, LOCALS = "VAR_INPUT", "VAR_OUTPUT", "VAR"


class Variable(NamedTuple):
    """A variable.

    Attributes:
        name: what it is called.
        kind: its type.
        meaning: what it is; empty: its name says it.
        start: its value at first, of an array that of each entry; empty: that of its type.
    """

    name: str
    kind: str
    meaning: str = ""
    start: tuple[str, ...] = ()

    @property
    def is_array(self) -> bool:
        """Return whether it holds several values."""
        return len(self.start) > 1


class Unit(NamedTuple):
    """A program organisation unit.

    Attributes:
        keyword: FUNCTION, FUNCTION_BLOCK or PROGRAM.
        name: what it is called.
        meaning: what it does.
        variables: by their sections.
        lines: its statements.
        returns: the type of a function; empty of others.
    """

    keyword: str
    name: str
    meaning: str
    variables: dict[str, list[Variable]]
    lines: list[str]
    returns: str = ""


class Exported(NamedTuple):
    """The units of an export.

    Attributes:
        units: functions and blocks, each after those that it uses; the last is the observer.
        test: the program that compares with the reference.
    """

    units: list[Unit]
    test: Unit

    @property
    def blocks(self) -> int:
        """How many function blocks it has."""
        return [unit.keyword for unit in self.units].count("FUNCTION_BLOCK")


def export_plc(code: Code, labels: Labels, vectors: Vectors) -> Exported:
    """Return an export as units.

    Args:
        code: what is printed.
        labels: the words that its files share.
        vectors: the reference vectors of the self-test.

    Raises:
        InputError: an operation that the language has not.
    """
    style = Style(code.kind, labels.prefix, ST)
    block = _Block(code, labels, style)
    names = elementary.required_functions(block.called_blocks, code.kind, portable_maths.OWN)
    functions = [function_unit(name, style) for name in names]
    blocks = block.units()
    return Exported([*functions, *blocks], _test(code, labels, vectors, blocks[-1]))


def function_unit(name: str, style: Style) -> Unit:
    """Return an elementary function.

    Args:
        name: one of `bitless.OWN`.
        style: how numbers and functions are written.
    """
    shape = elementary.build_formula(name, style.kind, portable_maths.OWN)
    expressions = Expressions(style, {text: text for text in shape.inputs})
    found = find_locals([[shape.result]], expressions, {})
    called = f"{style.prefix}_{name}"
    result = wrap_statement(f"{called} := {expressions.write_node(shape.result).text};")
    given = [Variable(text, style.real_type) for text in shape.inputs]
    variables = {INPUTS: given, LOCALS: list(map(_declare_variable, found))}
    meaning = str(portable_maths.OWN.functions[name].__doc__).strip()
    return Unit(
        "FUNCTION", called, meaning, variables, [*local_statements(found), *result], style.real_type
    )


class _Block:
    """The observer's function block, whole or in parts.

    Args:
        code: what is printed.
        labels: the words that its files share.
        style: how numbers and functions are written.
    """

    def __init__(self, code: Code, labels: Labels, style: Style) -> None:
        self.code, self.labels, self.style = code, labels, style
        step, real = code.step, style.real_type
        fields = (step.inputs, step.outputs, step.params)
        names = [[f"{name}_{k}" for name, k in members(field)] for field in fields]
        names += [[f"{name}_was_{k}" for name, k in members(step.state)]]
        names += [[f"missing_{k}" for k in range(step.readings)]]
        names += [[f"read_{k}" for k in range(step.readings)]]
        names += [[f"next_{name}_{k}" for name, k in members(step.state)]]
        # The language takes names that differ by capitals alone for one.
        flat = iter(distinct(list(itertools.chain(*names)), str.lower))
        named = [list(itertools.islice(flat, len(each))) for each in names]
        self.inputs, self.outputs, self.params, self.states = named[:4]
        self.missing, self.read, self.following = named[4:]
        given = [*self.read, *self.inputs[step.readings :]]
        self.entries = entries(s=self.states, w=given, p=self.params)
        labelled = meanings(code.results, step, 1)
        for nodes, wanted in zip(code.results, (self.following, self.outputs), strict=True):
            for node, name in zip(nodes, wanted, strict=True):
                if node.args:
                    labelled[node] = name
        self._expressions = Expressions(style, self.entries)
        self.locals = find_locals(code.results, self._expressions, labelled)
        self.held = self._expressions.names
        self.real = real

    @property
    def called_blocks(self) -> set[str]:
        """Return the functions that it calls."""
        return self._expressions.functions

    def units(self) -> list[Unit]:
        """Return the parts, if there are any, and the block."""
        name = f"fb_{self.labels.prefix}"
        if len(self.locals) <= STATEMENTS:
            return [self._whole(name, self.locals, [], local_statements(self.locals))]
        shared = set(itertools.chain(*self.code.results))
        parts = []
        for start in range(0, len(self.locals), STATEMENTS):
            part = self.locals[start : start + STATEMENTS]
            inside = {local.node for local in part}
            read = itertools.chain(*[statement_operands(local, self.held) for local in part])
            given = {node: None for node in read if node not in inside}
            shared.update(given)
            parts.append((part, given))
        units = []
        for place, (part, given) in enumerate(parts):
            meaning = f"Part {place + 1} of {len(parts)}: the block calls it."
            variables = self._of_part(part, list(given), shared)
            unit = (f"{name}_part_{place + 1}", meaning, variables, local_statements(part))
            units.append(Unit("FUNCTION_BLOCK", *unit))
        own = [local for local in self.locals if local.node in shared]
        calls = list(itertools.chain(*map(_call, units)))
        return [*units, self._whole(name, own, units, calls)]

    def _of_part(
        self, part: list[Local], given: list[Node], shared: set[Node]
    ) -> dict[str, list[Variable]]:
        """Return the variables of a part.

        Args:
            part: what it computes.
            given: what it reads.
            shared: what is read outside of the part that computes it.
        """
        names = [self.held.get(node) or self.entries[node.text] for node in given]
        variables: dict[str, list[Variable]] = {INPUTS: [], OUTPUTS: [], LOCALS: []}
        for node, name in zip(given, names, strict=True):
            variables[INPUTS].append(Variable(name, TYPES[node.kind]))
        for local in part:
            section = OUTPUTS if local.node in shared else LOCALS
            variables[section].append(_declare_variable(local))
        return variables

    def _whole(self, name: str, own: list[Local], parts: list[Unit], lines: list[str]) -> Unit:
        """Return the block that is called."""
        shown, step = set(self.outputs), self.code.step
        held = [_declare_variable(local) for local in own if local.name not in shown]
        held += [Variable(f"part_{k + 1}", part.name) for k, part in enumerate(parts)]
        read = [Variable(text, self.real) for text in self.read]
        copied, stored = self._store_states()
        held += [Variable(text, self.real) for text in copied]
        variables = {
            INPUTS: self._inputs(),
            OUTPUTS: self._fields(self.outputs, step.outputs),
            LOCALS: [*self._initial_variables(self.states, step.state, step.start), *read, *held],
        }
        states = zip(self.states, step.start.tolist(), strict=True)
        start = itertools.chain(*[assign_number(*each, self.code.kind) for each in states])
        text = [*_if("reset", start), *self._readings(), *lines, *self._assign_outputs()]
        text += [f"{INDENT}{each} := {source};" for each, source in copied.items()]
        text += _if("NOT hold", stored)
        meaning = f"{one_line(self.labels.title)}: {self.labels.part}, every {step.Ts:g} s."
        return Unit("FUNCTION_BLOCK", name, meaning, variables, text)

    def _inputs(self) -> list[Variable]:
        """Return the inputs of the block."""
        step = self.code.step
        missing = [
            Variable(text, "BOOL", f"TRUE: there is no reading {k}")
            for k, text in enumerate(self.missing)
        ]
        return [
            Variable("reset", "BOOL", "TRUE: start anew with this sample"),
            Variable("hold", "BOOL", "TRUE: show the estimate, remember nothing; call again"),
            *self._fields(self.inputs, step.inputs),
            *missing,
            *self._initial_variables(self.params, step.params, step.defaults),
        ]

    def _fields(self, names: list[str], fields: list[Field]) -> list[Variable]:
        """Return variables of the numbers of fields."""
        each = zip(names, numbers_of(fields), strict=True)
        return [Variable(name, self.real, field.meaning) for name, (field, _) in each]

    def _initial_variables(
        self, names: list[str], fields: list[Field], values: Floats
    ) -> list[Variable]:
        """Return variables of the numbers of fields, with their values at first."""
        starts = [(initial_literal(value, self.code.kind),) for value in values.tolist()]
        known = zip(self._fields(names, fields), starts, strict=True)
        return [each._replace(start=start) for each, start in known]

    def _readings(self) -> list[str]:
        """Return statements that make one that is missing too large to be there."""
        lines = []
        for missing, read, y in zip(self.missing, self.read, self.inputs, strict=False):
            lines += [f"{INDENT}{read} := {y};"]
            lines += _if(missing, assign_number(read, np.inf, self.code.kind))
        return lines

    def _assign_outputs(self) -> list[str]:
        """Return assignments to outputs that no local of their name fills."""
        lines = []
        for node, name in zip(self.code.results[1], self.outputs, strict=True):
            text = self._expressions.write_node(node).text
            if text != name:
                lines += wrap_statement(f"{name} := {text};")
        return lines

    def _store_states(self) -> tuple[dict[str, str], list[str]]:
        """Return (copies of states that others take over, assignments to the memory)."""
        copied, stored = {}, []
        for node, state, name in zip(
            self.code.results[0], self.states, self.following, strict=True
        ):
            text = self._expressions.write_node(node).text
            if text in self.states and text != state:
                copied[name], text = text, name
            if text != state:
                stored.append(f"{state} := {text};")
        return copied, stored


def _declare_variable(local: Local) -> Variable:
    """Return the variable of a local."""
    return Variable(local.name, TYPES[local.node.kind])


def _call(part: Unit) -> list[str]:
    """Return a call of a part, and what it gives."""
    instance = part.name[part.name.rindex("part_") :]
    given = ", ".join(f"{each.name} := {each.name}" for each in part.variables[INPUTS])
    lines = wrap_statement(f"{instance}({given});")
    lines += [f"{INDENT}{each.name} := {instance}.{each.name};" for each in part.variables[OUTPUTS]]
    return lines


def _if(truth: str, statements: Iterable[str]) -> list[str]:
    """Return statements under a truth."""
    inner = [wrap_statement(statement, 2 * INDENT) for statement in statements]
    return [f"{INDENT}IF {truth} THEN", *itertools.chain(*inner), f"{INDENT}END_IF;"]


def _test(code: Code, labels: Labels, vectors: Vectors, block: Unit) -> Unit:
    """Return the self-test: one sample a cycle, each output compared with its reference."""
    samples, kind = len(vectors.states), code.kind
    given, expected = vectors.inputs.view(kind), vectors.outputs.view(kind)
    names = [each.name for each in block.variables[INPUTS] if each.kind != "BOOL"]
    arguments, checks, tables = [], [], []
    for k, name in enumerate(names[: given.shape[1]]):
        values, absent = np.nan_to_num(given[:, k]), np.isnan(given[:, k])
        tables.append(_table(f"given_{name}", values, kind))
        arguments.append(f"{name} := given_{name}[sample]")
        if absent.any():
            truths = tuple(str(each).upper() for each in absent.tolist())
            tables.append(Variable(f"no_{name}", f"ARRAY [0..{samples - 1}] OF BOOL", "", truths))
            arguments.append(f"missing_{k} := no_{name}[sample]")
    for k, each in enumerate(block.variables[OUTPUTS]):
        tables.append(_table(f"expected_{each.name}", expected[:, k], kind))
        wrong = f"block.{each.name} <> expected_{each.name}[sample]"
        checks.append(f"IF {wrong} THEN failures := failures + 1; END_IF;")
    calls = [f"block(hold := {truth}, {', '.join(arguments)});" for truth in ("TRUE", "FALSE")]
    told = [
        Variable("done", "BOOL", f"TRUE after {samples} cycles"),
        Variable("passed", "BOOL", "TRUE then: every output agrees with its reference"),
        Variable("failures", "INT", "outputs that differ"),
    ]
    own = [Variable("sample", "INT", "the next one"), Variable("block", block.name), *tables]
    lines = [
        *_if(f"sample < {samples}", [*calls, *checks, "sample := sample + 1;"]),
        f"{INDENT}done := sample = {samples};",
        f"{INDENT}passed := done AND (failures = 0);",
    ]
    meaning = f"Self-test of {block.name}, one sample a cycle: done, then passed."
    return Unit("PROGRAM", f"{labels.prefix}_test", meaning, {OUTPUTS: told, LOCALS: own}, lines)


def _table(name: str, values: Any, kind: str) -> Variable:
    """Return an array of numbers."""
    texts = tuple(initial_literal(value, kind) for value in values.tolist())
    return Variable(name, f"ARRAY [0..{len(texts) - 1}] OF {TYPES[kind]}", "", texts)
