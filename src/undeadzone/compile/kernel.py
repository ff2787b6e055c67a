"""The text of a kernel: a step for many lanes as LLVM's instructions.

Groups of lanes are outermost and time is inside, so that a group's states stay in registers. What
all lanes share is computed once: what is steady once a call, what is new in each step for a chunk
of steps ahead. Both stand in tables of plain numbers, small enough for the nearest cache.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import casadi as ca

from undeadzone.compile.block import Block
from undeadzone.compile.graph import LANES, SHARED, STEADY, STILL, Nodes
from undeadzone.compile.lower import Arithmetic, lowered
from undeadzone.compile.machine import ONE, Form, Machine, Shape
from undeadzone.compile.promises import Promise
from undeadzone.compile.schedule import of_graph

# Of the arguments of a kernel: steps, lanes, and flat arrays.
KINDS: Final = ("int64", "int64", *["float64*"] * 5)


class Source(NamedTuple):
    """A kernel's text.

    Attributes:
        text: LLVM's; it defines `block`.
        form: how lanes are computed.
        promises: what it takes for granted of params.
    """

    text: str
    form: Form
    promises: tuple[Promise, ...]


class Graphs(NamedTuple):
    """A step in which what is known stands in its place.

    Attributes:
        usual: next, out, flag if there are rare parts, of s, w and p.
        rare: next, flag of s, w and p.
    """

    usual: ca.Function
    rare: tuple[ca.Function, ...]


def graphs(
    step: ca.Function,
    rare: Sequence[ca.Function],
    shape: Shape,
    w: Mapping[int, float],
    p: Mapping[int, float],
) -> Graphs:
    """The functions that a kernel computes.

    Args:
        step, rare: as for `lanes.build`.
        shape: what it is compiled for.
        w, p: what is known of these inputs.
    """
    columns = [ca.SX.sym(name, size) for name, size in zip("swp", shape.sizes, strict=True)]
    inputs = [columns[0], _substituted(columns[1], w), _substituted(columns[2], p)]
    following, out, *flag = (ca.densify(ca.SX(value)) for value in step(*inputs))
    usual = _graph(columns, [following, out[list(shape.record)], *flag])
    parts = []
    for part in rare:
        parts.append(_graph(columns, [ca.densify(ca.SX(value)) for value in part(*inputs)]))
    return Graphs(usual, tuple(parts))


def source(
    functions: Graphs,
    shape: Shape,
    machine: Machine,
    arithmetic: Arithmetic,
    width: int,
    form: Form | None = None,
    name: str = "block",
) -> Source:
    """The text of a kernel.

    Args:
        functions: what it computes.
        shape: what it is compiled for.
        machine: for which form is chosen.
        arithmetic: how it rounds.
        width: lanes of a block, at most.
        form: how lanes are computed; default: as suits machine, graph and width.
        name: of the function that the text defines.
    """
    nodes = Nodes()
    if form is None and width == 1:
        form = ONE
    one = form is not None and form.lanes == 1

    def level(name: str) -> int:
        """How often an input is new."""
        place = int(name[1:])
        if name[0] == "p":
            return STILL if place in shape.params else STEADY
        return LANES if one or name[0] == "s" or place in shape.exogenous else SHARED

    promises: dict[Promise, None] = {}
    usual = lowered(functions.usual, nodes, level, arithmetic, promises)
    parts = [lowered(part, nodes, level, arithmetic, promises) for part in functions.rare]
    if form is None:
        results = [*itertools.chain(*usual)]
        form = machine.form(len(of_graph(results)), width)
    block = Block(shape, form, usual, parts)
    return Source(block.printed(name), form, tuple(promises))


def _substituted(column: ca.SX, known: Mapping[int, float]) -> ca.SX:
    """A column with the entries that are known in their places."""
    return ca.vertcat(*(known.get(i, column[i]) for i in range(column.numel())))


def _graph(columns: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """The function of s, w and p with these results."""
    names = [f"result{i}" for i in range(len(results))]
    return ca.Function("graph", columns, results, ["s", "w", "p"], names)
