"""Text of a kernel: a step for many lanes as LLVM instructions.

Groups of lanes are outermost and time is inside, so that a group's states stay in registers. Values
that all lanes share are computed once: steady values once a call, values of each step for a chunk
of steps ahead. Both stand in tables of plain numbers, small enough for the nearest cache.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import casadi as ca

from undeadzone.compile.assumptions import KernelAssumption
from undeadzone.compile.cold_paths import ColdPaths
from undeadzone.compile.graph import (
    LANES,
    SHARED,
    STEADY,
    STILL,
    Node,
    Nodes,
    operands_at_level,
    per_call_nodes,
    required_nodes,
    to_condition,
)
from undeadzone.compile.lower import Arithmetic, lower_function
from undeadzone.compile.machine import ONE, Form, Machine, Shape
from undeadzone.compile.outline import OutlinedStep
from undeadzone.compile.print_llvm import (
    Names,
    Text,
    entry_source,
    from_double,
    print_lanes,
    print_once,
    to_double,
)
from undeadzone.compile.schedule import (
    Branch,
    gather_branches,
    lane_instructions,
    order_instructions,
)

_ARGUMENTS: Final = ("work", "exogenous", "params", "own", "outputs")
_PAGE: Final = 4096  # bytes
_APART: Final = 256  # numbers between the tables and the rest of the stack
_TABLE: Final = 2048  # numbers of a table of a chunk of steps: 16 KB
_STEPS: Final = 64  # of a chunk, at most
_FEWEST: Final = 4
_FOR_EVER: Final = 2**62
_UNLIKELY: Final = '!0 = !{!"branch_weights", i32 1, i32 100}'


class _Table:
    """Row of plain numbers that lanes read.

    Args:
        every_use: each use has an entry for itself. LLVM then makes it an operand of the
            instruction that uses it, whereas a shared entry would occupy a register, or be spilled.
    """

    def __init__(self, every_use: bool) -> None:
        self.entries: list[Node] = []
        self._places: dict[Node, int] = {}
        self._every_use = every_use

    def place_of_use(self, node: Node) -> int:
        """Return the index of the entry that a use of a value reads, after adding it if needed."""
        if self._every_use or node not in self._places:
            self._places[node] = len(self.entries)
            self.entries.append(node)
        return self._places[node]

    def print_fill(self, text: Text, base: str, have: dict[Node, str]) -> None:
        """Print the instructions that store the values."""
        forms: dict[Node, str] = {}
        for place, node in enumerate(self.entries):
            if node not in forms:
                forms[node] = to_double(text, node, have[node])
            text.store(forms[node], text.address_of(base, place))


class KernelPrinter:
    """Printer of the function `block`.

    Args:
        shape, form: of the kernel.
        usual: next, out, flag if there are rare parts.
        parts: next, flag of each rare part.
        name: of the function.
    """

    def __init__(
        self,
        shape: Shape,
        form: Form,
        usual: list[list[Node]],
        parts: list[list[list[Node]]],
        name: str,
    ) -> None:
        self.shape = shape
        self.form = form
        self.name = name
        self.following = usual[0]
        self.out = usual[1]
        self.flag = (to_condition(usual[2][0]) or usual[2][0]) if parts else None
        self.declared: dict[str, str] = {}
        self.rare = ColdPaths(shape, form, parts)
        self.slots = form.slots and form.lanes > 1
        self.steady, self.shared = _Table(self.slots), _Table(self.slots)
        self.groups = range(form.streams)
        self.results = [*self.following, *self.out, *([self.flag] if self.flag else [])]
        self.order = order_instructions(self.results, form.registers)
        self.body: list[Node | Branch] = list(self.order)
        if form.branches and form.streams == 1:
            self.body = gather_branches(self.order, self.results, form.branches)
        is_cut = form.is_cut(len(self.order)) or any(node.op == "apply" for node in self.order)
        self.pieces = OutlinedStep(self.body, self.results, form, name) if is_cut else None
        self.still = per_call_nodes(self.order, self.results)
        self.have: dict[Node, str] = {}  # steady values, plain
        self.own: list[Names] = []  # of values that lanes compute once

    def print_module(self, called: Iterable[KernelPrinter]) -> str:
        """Return the text of the module, with functions that this function calls."""
        lines = []
        for each in (*called, self):
            lines += each.print_function("void" if each is self else "internal void")
            self.declared |= each.declared
        lines += [
            *self.declared.values(),
            'attributes #0 = { nounwind "prefer-vector-width"="512" }',
            *([_UNLIKELY] if self.flag else []),
        ]
        return "\n".join(lines)

    def print_function(self, head: str) -> list[str]:
        """Return the lines of the function, which begins with linkage and type, and its pieces."""
        entry = self._new_text("e")
        self._print_steady(entry)
        group = self._print_groups()
        body = self._print_step()
        functions = (
            self.pieces.outlined_texts(self.declared, self._table_source) if self.pieces else []
        )
        steps = max(_FEWEST, min(_STEPS, _TABLE // max(1, len(self.shared.entries))))
        steps = steps if self.shared.entries else _FOR_EVER
        tables = self._print_tables(entry, steps)
        arguments = ", ".join([f"ptr noalias %{array}" for array in _ARGUMENTS])
        return [
            *self.rare.cold_function_texts(self.declared),
            *functions,
            f"define {head} @{self.name}(i64 %steps, i64 %lanes, {arguments}) #0 {{",
            "entry:",
            # At a fixed place beside spilled numbers: where a number of the one has the same last
            # bits of its address as one of the other, the processor takes them for the same.
            f"  %scratch = alloca {self._scratch_type(tables)}",
            *entry.lines,
            *self._print_chunks(steps),
            *group,
            *self._print_time_head(),
            *body,
            *self._print_loop_ends(),
            "}",
        ]

    def _scratch_type(self, numbers: int) -> str:
        """Return type and alignment of the array that holds tables of the given total
        size.
        """
        if self.form.lanes == 1:
            return f"[{numbers + 1} x double], align 8"
        return f"[{numbers + _APART} x double], align {_PAGE}"

    def _new_text(self, prefix: str) -> Text:
        """Return the text of a new part of the function."""
        return Text(self.form.lanes, self.declared, prefix)

    def _print_steady(self, text: Text) -> None:
        """Print the steady values, once a call."""
        required = [
            *operands_at_level([*self.still, *self.order], self.results, STEADY),
            *self.rare.steady,
        ]
        for node in required_nodes(operands_at_level(self.order, self.results, SHARED)):
            if node.level == SHARED:
                required += [arg for arg in node.args if arg.level == STEADY]
        print_once(text, required, self.have, entry_source(text, "params"))

    def _print_tables(self, text: Text, steps: int) -> int:
        """Print the addresses of the tables and fill the steady tables. Return the total
        size [numbers].
        """
        lanes = self.form.lanes
        streams = self.form.streams
        text.append_line("%steady = getelementptr double, ptr %scratch, i64 0")
        at = _round_to_cache_line(len(self.steady.entries))
        text.append_line(f"%table = getelementptr double, ptr %scratch, i64 {at}")
        at += _round_to_cache_line(len(self.shared.entries) * steps if self.shared.entries else 0)
        text.append_line(f"%rare = getelementptr double, ptr %scratch, i64 {at}")
        at += _round_to_cache_line(len(self.rare.steady))
        if self.pieces:
            text.append_line(f"%frame = getelementptr double, ptr %scratch, i64 {at}")
            at += _round_to_cache_line(self.pieces.numbers)
        for u in range(streams if self.flag else 0):
            for name, count in self.rare.group_arrays:
                text.append_line(f"%{name}{u} = getelementptr double, ptr %scratch, i64 {at}")
                at += _round_to_cache_line(count * lanes)
        self.steady.print_fill(text, "%steady", self.have)
        for place, node in enumerate(self.rare.steady):
            text.store(to_double(text, node, self.have[node]), text.address_of("%rare", place))
        text.append_line("%none = icmp slt i64 %steps, 1")
        text.append_line("br i1 %none, label %end, label %chunk")
        return at

    def _print_chunks(self, steps: int) -> list[str]:
        """Print the loop over chunks of steps with the table of shared values."""
        text = self._new_text("c")
        text.label("chunk")
        text.append_line("%first = phi i64 [0, %entry], [%last, %chunked]")
        text.append_line(f"%far = add i64 %first, {steps}")
        text.append_line("%short = icmp slt i64 %steps, %far")
        text.append_line("%last = select i1 %short, i64 %steps, i64 %far")
        if self.shared.entries:
            with text.print_loop("ahead", "%first", "%last") as ahead:
                self._print_shared_row(text, ahead)
        text.append_line("br label %groups")
        text.label("groups")
        text.append_line("br label %group")
        return text.lines

    def _print_shared_row(self, text: Text, step: str) -> None:
        """Print a row of the table of shared values."""
        at = text.add(f"mul i64 {step}, {self.shape.sizes[1]}")
        text.append_line(f"%pa = getelementptr double, ptr %exogenous, i64 {at}")
        row = text.add(f"sub i64 {step}, %first")
        have = dict(self.have)
        place = text.add(f"mul i64 {row}, {len(self.shared.entries)}")
        print_once(text, self.shared.entries, have, entry_source(text, "pa"))
        self.shared.print_fill(text, text.address_of("%table", place), have)

    def _print_groups(self) -> list[str]:
        """Print the loop over groups up to the loop over time."""
        text = self._new_text("g")
        vector = text.type("double")
        (states, _, _) = self.shape.sizes
        text.label("group")
        text.append_line("%g = phi i64 [0, %groups], [%g_next, %grouped]")
        text.append_line(f"%g_next = add i64 %g, {self.form.lanes * self.form.streams}")
        for u in self.groups:
            text.append_line(f"%g{u} = add i64 %g, {u * self.form.lanes}")
            _print_row_addresses(
                text, "work", f"%g{u}", f"row{u}_", states + len(self.shape.params)
            )
            for i in range(states):
                text.append_line(f"%s{u}_{i}_0 = load {vector}, ptr %row{u}_{i}, align 8")
            for i in range(len(self.shape.params)):
                text.append_line(f"%p{u}_{i} = load {vector}, ptr %row{u}_{states + i}, align 8")
        sources = [self._per_call_source(text, u) for u in self.groups]
        self.own = print_lanes(text, self.still, sources, False)
        text.append_line("br label %time")
        return text.lines

    def _per_call_source(self, text: Text, u: int) -> Names:
        """Return the source of names for a lane's own params and for shared values, before
        the loop over time.
        """

        def source(node: Node) -> str:
            """Return the name of a value."""
            if node.level == STILL:
                return f"%p{u}_{self.shape.params.index(int(node.text[1:]))}"
            if self.form.lanes == 1:
                return self.have[node]
            return self._table_source(text, "%steady")(node)

        return source

    def _print_time_head(self) -> list[str]:
        """Print the head of the loop over time."""
        text = self._new_text("h")
        text.label("time")
        text.append_line("%k = phi i64 [%first, %group], [%k_next, %after]")
        for u in self.groups:
            for i in range(self.shape.sizes[0]):
                sources = f"[%s{u}_{i}_0, %group], [%m{u}_{i}, %after]"
                text.append_line(f"%s{u}_{i} = phi {text.type('double')} {sources}")
        text.append_line("%k_next = add i64 %k, 1")
        if self.steady.entries or self.pieces:
            text.append_line('%sp = call ptr asm "", "=r,0,r"(ptr %steady, i64 %k)')
        if self.shared.entries or self.pieces:
            text.append_line("%kr = sub i64 %k, %first")
            text.append_line(f"%kt = mul i64 %kr, {len(self.shared.entries)}")
            text.append_line("%sq = getelementptr double, ptr %table, i64 %kt")
        if self.form.lanes == 1 or self.flag:
            text.append_line(f"%kw = mul i64 %k, {self.shape.sizes[1]}")
            text.append_line("%w = getelementptr double, ptr %exogenous, i64 %kw")
        for array, entries in (("own", self.shape.exogenous), ("outputs", self.shape.record)):
            if not entries:
                continue
            text.append_line(f"%k_{array} = mul i64 %k, {len(entries)}")
            text.append_line(f"%j_{array} = mul i64 %k_{array}, %lanes")
            for u in self.groups:
                text.append_line(f"%i_{array}{u} = add i64 %j_{array}, %g{u}")
                _print_row_addresses(text, array, f"%i_{array}{u}", f"{array}{u}_", len(entries))
        return text.lines

    def _print_step(self) -> list[str]:
        """Print a step and the calls of the cold paths."""
        text = self._new_text("b")
        text.block = "time"
        sources = [self._lane_source(text, u) for u in self.groups]
        if self.pieces:
            sources = [self.pieces.print_calls(text, sources[0])]
        names = print_lanes(text, [] if self.pieces else self.body, sources, self.slots)
        vector = text.type("double")
        for u in self.groups:
            for i, node in enumerate(self.out):
                text.store(names[u](node), f"%outputs{u}_{i}", vector=True)
        merged = [[list(map(names[u], self.following)) for u in self.groups]]
        came = [text.block]
        if self.flag:
            last, changed = self.rare.print_cold_call(
                text, merged[0], self._cold_path_flags(text, names)
            )
            came.append(last)
            merged.append(changed)
        else:
            text.append_line("br label %after")
        text.label("after")
        for u in self.groups:
            for i in range(self.shape.sizes[0]):
                pairs = zip(merged, came, strict=True)
                options = ", ".join(f"[{values[u][i]}, %{block}]" for values, block in pairs)
                text.append_line(f"%m{u}_{i} = phi {vector} {options}")
        return text.lines

    def _cold_path_flags(self, text: Text, names: list[Names]) -> list[str]:
        """Return the conditions of the cold paths, for each group."""
        assert self.flag is not None
        flags = [name(self.flag) for name in names]
        if self.flag.kind == "bool":
            return flags
        return [text.add(f"fcmp une {text.type('double')} {x}, {text.zero()}") for x in flags]

    def _lane_source(self, text: Text, u: int) -> Names:
        """Return the source of names for values of lower levels and for inputs of the
        lanes of a group.
        """
        shape = self.shape

        def source(node: Node) -> str:
            """Return the name of a value."""
            if node.level == STEADY and self.form.lanes == 1:
                return self.have[node]
            if node.level == STILL:
                return self.own[u](node)
            if node.level < LANES:
                return self._table_source(text)(node)
            place = int(node.text[1:])
            if node.text[0] == "s":
                return f"%s{u}_{place}"
            if place in shape.exogenous:
                row = shape.exogenous.index(place)
                return text.load(f"%own{u}_{row}", vector=True)
            return text.load(text.address_of("%w", place))

        return source

    def _table_source(self, text: Text, steady: str = "%sp") -> Names:
        """Return the function that prints how a value is read from a table into all lanes.

        Values of level `STEADY` are in a table that is filled once a call. Those of level `SHARED`
        are in a table at %sq that is filled for each step.

        Args:
            text: the text to which the loads are added.
            steady: LLVM's name of the address of the first table.
        """

        def load_from_table(node: Node) -> str:
            """Print the load of a value and return its name."""
            table, address = (self.steady, steady) if node.level == STEADY else (self.shared, "%sq")
            number = text.load(text.address_of(address, table.place_of_use(node)))
            return from_double(text, node, text.splat(number, "double"), True)

        return load_from_table

    def _print_loop_ends(self) -> list[str]:
        """Print the ends of all loops."""
        text = self._new_text("z")
        text.append_line("%done = icmp eq i64 %k_next, %last")
        text.append_line("br i1 %done, label %grouped, label %time")
        text.label("grouped")
        for u in self.groups:
            for i in range(self.shape.sizes[0]):
                text.store(f"%m{u}_{i}", f"%row{u}_{i}", vector=True)
        text.append_line("%done_g = icmp sge i64 %g_next, %lanes")
        text.append_line("br i1 %done_g, label %chunked, label %group")
        text.label("chunked")
        text.append_line("%more = icmp slt i64 %last, %steps")
        text.append_line("br i1 %more, label %chunk, label %end")
        text.label("end")
        text.append_line("ret void")
        return text.lines


def _print_row_addresses(text: Text, base: str, first: str, name: str, count: int) -> None:
    """Print the addresses of rows of an array, each `lanes` numbers after the previous row."""
    before = f"ptr %{base}, i64 {first}"
    for i in range(count):
        text.append_line(f"%{name}{i} = getelementptr double, {before}")
        before = f"ptr %{name}{i}, i64 %lanes"


def _round_to_cache_line(numbers: int) -> int:
    """Return a count of numbers, rounded up to whole cache lines."""
    return -(-numbers // 8) * 8


# Of the arguments of a kernel: steps, lanes, and flat arrays.
KINDS: Final = ("int64", "int64", *["float64*"] * 5)


class KernelText(NamedTuple):
    """Text of a kernel.

    Attributes:
        text: LLVM text, which defines `block`.
        form: how lanes are computed.
        promises: its assumptions about params.
    """

    text: str
    form: Form
    promises: tuple[KernelAssumption, ...]


class KernelGraphs(NamedTuple):
    """Step with its known inputs substituted.

    Attributes:
        usual: next, out, flag if there are rare parts, of s, w and p.
        rare: next, flag of s, w and p.
    """

    usual: ca.Function
    rare: tuple[ca.Function, ...]


def build_graphs(
    step: ca.Function,
    rare: Sequence[ca.Function],
    shape: Shape,
    w: Mapping[int, float],
    p: Mapping[int, float],
) -> KernelGraphs:
    """Return the functions that a kernel computes.

    Args:
        step, rare: as for `lanes.build`.
        shape: sizes for which it is compiled.
        w, p: known values of these inputs.
    """
    columns = list(itertools.starmap(ca.SX.sym, zip("swp", shape.sizes, strict=True)))
    inputs = [columns[0], _substitute_known(columns[1], w), _substitute_known(columns[2], p)]
    following, out, *flag = (ca.densify(ca.SX(value)) for value in step(*inputs))
    usual = _build_graph(columns, [following, out[list(shape.record)], *flag])
    results = ([ca.densify(ca.SX(value)) for value in part(*inputs)] for part in rare)
    return KernelGraphs(usual, tuple(_build_graph(columns, result) for result in results))


def print_kernel(
    functions: KernelGraphs,
    shape: Shape,
    machine: Machine,
    arithmetic: Arithmetic,
    width: int,
    form: Form | None = None,
    name: str = "block",
) -> KernelText:
    """Return the text of a kernel.

    Args:
        functions: functions that it computes.
        shape: sizes for which it is compiled.
        machine: for which form is chosen.
        arithmetic: how it rounds.
        width: lanes of a block, at most.
        form: arrangement of the lanes (default: as suits machine, graph and width).
        name: of the function that the text defines.
    """
    nodes = Nodes()
    if form is None and width == 1:
        form = ONE
    one = form is not None and form.lanes == 1

    def level(name: str) -> int:
        """Return how often an input changes."""
        place = int(name[1:])
        if name[0] == "p":
            return STILL if place in shape.params else STEADY
        return LANES if one or name[0] == "s" or place in shape.exogenous else SHARED

    promises: dict[KernelAssumption, None] = {}
    callees: dict[str, ca.Function] | None = {} if one else None
    usual = lower_function(functions.usual, nodes, level, arithmetic, promises, callees)
    parts = [lower_function(part, nodes, level, arithmetic, promises) for part in functions.rare]
    if form is None:
        results = [*itertools.chain(*usual)]
        form = machine.choose_form(len(lane_instructions(results)), width)
    block = KernelPrinter(shape, form, usual, parts, name)
    called: list[KernelPrinter] = []
    while callees and len(called) < len(callees):
        title, function = [*callees.items()][len(called)]
        callee_results = lower_function(function, Nodes(), level, arithmetic, promises, callees)
        flat = [*itertools.chain(*callee_results)]
        of = Shape((0, function.nnz_in(), 0), (), (), tuple(range(len(flat))))
        called.append(KernelPrinter(of, form, [[], flat], [], title))
    return KernelText(block.print_module(called), form, tuple(promises))


def _substitute_known(column: ca.SX, known: Mapping[int, float]) -> ca.SX:
    """Return a column with known values in place of its known entries."""
    return ca.vertcat(*(known.get(i, column[i]) for i in range(column.numel())))


def _build_graph(columns: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """Return the function of s, w and p with the given results."""
    names = [f"result{i}" for i in range(len(results))]
    return ca.Function("graph", columns, results, ["s", "w", "p"], names)
