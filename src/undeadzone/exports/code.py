"""A step as graphs ready to print: rewritten for C, and split at what depends on the input."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import NamedTuple

import casadi as ca

from undeadzone.compile.graph import Graph, Node, listed
from undeadzone.exports.instructions import require_known, uses_of
from undeadzone.exports.parts import Step
from undeadzone.exports.rewrite import rewritten


class Phases(NamedTuple):
    """A step in two calls.

    Attributes:
        estimate: results (out, carry); nothing in it depends on the input.
        advance: results (next,); its inputs named c are the carry.
        carried: how many numbers pass from one to the other.
    """

    estimate: Graph
    advance: Graph
    carried: int


class Code(NamedTuple):
    """What is printed.

    Attributes:
        step: the step it came from.
        single: whether numbers are float, else double.
        graph: results (next, out).
        phases: the same in two calls; None where no input acts from outside.
    """

    step: Step
    single: bool
    graph: Graph
    phases: Phases | None

    @property
    def hash(self) -> str:
        """Of the graph, its numbers and the precision, 16 hexadecimal digits."""
        nodes = [(node.op, node.operands, node.text) for node in self.graph.nodes]
        fields = (self.step.state, self.step.inputs, self.step.outputs, self.step.params)
        numbers = (self.step.start.tolist(), self.step.defaults.tolist(), self.step.Ts)
        text = repr((self.single, nodes, self.graph.results, fields, numbers))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def code(step: Step, single: bool) -> Code:
    """A step's graphs in a precision.

    Args:
        step: the step.
        single: whether numbers are float.

    Raises:
        InputError: an instruction that the export cannot print.
    """
    graph = listed(step.function)
    require_known("export", graph)
    graph = rewritten(graph)
    phases = None
    if step.acting:
        phases = split(graph, {f"w{k}" for k in step.acting})
    return Code(step, single, graph, phases)


def split(graph: Graph, acting: Iterable[str]) -> Phases:
    """A graph of results (next, out) in two: before the inputs are known, and after.

    Args:
        graph: the graph.
        acting: texts of the input entries that are known late; `out` must not depend on them.
    """
    late = _late(graph.nodes, set(acting))
    following, out = graph.results
    uses = uses_of(Graph(graph.nodes, [following], []))
    needed: list[int] = []
    for place in sorted(late):
        if uses[place]:
            needed += graph.nodes[place].operands
    carried: dict[int, int] = {}
    for place in [*needed, *following]:
        if place not in late and _is_computed(graph.nodes[place]):
            carried.setdefault(place, len(carried))
    estimate = Graph(graph.nodes, [list(out), list(carried)], [])
    nodes = list(graph.nodes)
    for place, entry in carried.items():
        nodes[place] = Node(ca.OP_INPUT, (), f"c{entry}")
    advance = Graph(nodes, [list(following)], [])
    return Phases(estimate, advance, len(carried))


def _late(nodes: list[Node], acting: set[str]) -> set[int]:
    """The nodes that depend on those inputs."""
    late: set[int] = set()
    for place, node in enumerate(nodes):
        is_acting = node.op == ca.OP_INPUT and node.text in acting
        if is_acting or any(operand in late for operand in node.operands):
            late.add(place)
    return late


def _is_computed(node: Node) -> bool:
    """Whether a node must be carried: constants, states and parameters are there anyway."""
    if node.op == ca.OP_CONST:
        return False
    return node.op != ca.OP_INPUT or node.text.startswith("w")
