"""Names for locals whose meaning shows in the graph: is there a reading, which side it shows."""

from __future__ import annotations

import casadi as ca

from undeadzone.compile.graph import Graph
from undeadzone.exports.fields import members
from undeadzone.exports.instructions import is_condition
from undeadzone.exports.parts import Step

HUGE = 1e299  # what `sensor.present` compares with is larger


def meanings(graph: Graph, step: Step, out: int | None) -> dict[int, str]:
    """Names of locals, by their places.

    Args:
        graph: the graph.
        step: the step, for the names of its inputs and outputs.
        out: which result of the graph is the output; None: none of them.
    """
    names = _present(graph, step)
    if out is not None:
        for (name, k), place in zip(members(step.outputs), graph.results[out], strict=True):
            node = graph.nodes[place]
            sides = [operand for operand in node.operands if is_condition(graph.nodes[operand])]
            if name == "side" and node.op == ca.OP_SUB and len(sides) == 2:
                names[sides[0]] = f"is_right_{k}"
                names[sides[1]] = f"is_left_{k}"
                names |= _either(graph, set(sides), f"is_active_{k}")
    return names


def _either(graph: Graph, conditions: set[int], name: str) -> dict[int, str]:
    """The name of the node that holds where one of two conditions does."""
    for place, node in enumerate(graph.nodes):
        if node.op == ca.OP_OR and set(node.operands) == conditions:
            return {place: name}
    return {}


def _present(graph: Graph, step: Step) -> dict[int, str]:
    """The conditions that an input is a finite number: -1e300 < w and w < 1e300."""
    inputs = {f"w{entry}": f"{name}_{k}" for entry, (name, k) in enumerate(members(step.inputs))}
    names: dict[int, str] = {}
    for place, node in enumerate(graph.nodes):
        if node.op != ca.OP_AND:
            continue
        compared = set()
        for operand in node.operands:
            compared.add(_bounded_input(graph, operand))
        text = compared.pop()
        if not compared and text in inputs:
            names[place] = f"has_{inputs[text]}"
    return names


def _bounded_input(graph: Graph, place: int) -> str:
    """The text of the input that a node compares with a huge number; empty: it does not."""
    node = graph.nodes[place]
    if node.op != ca.OP_LT:
        return ""
    for bound, value in (node.operands, node.operands[::-1]):
        number, other = graph.nodes[bound], graph.nodes[value]
        if number.op == ca.OP_CONST and abs(float(number.text)) > HUGE and other.op == ca.OP_INPUT:
            return other.text
    return ""
