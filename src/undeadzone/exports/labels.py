"""Names for locals whose meaning shows in the nodes: is there a reading, which side it shows."""

from __future__ import annotations

import itertools

from undeadzone.compile.graph import Node, Results, condition, needed
from undeadzone.exports.fields import members
from undeadzone.exports.parts import Step

HUGE = 1e38  # what `sensor.present` compares with is larger, and so is what float holds of it


def meanings(results: Results, step: Step, out: int | None) -> dict[Node, str]:
    """Names of locals.

    Args:
        results: the nodes.
        step: the step, for the names of its inputs and outputs.
        out: which of the results is the output; None: none of them.
    """
    order = needed(itertools.chain(*results))
    names = _present(order, step)
    if out is not None:
        for (name, k), node in zip(members(step.outputs), results[out], strict=True):
            sides = [truth for truth in map(condition, node.args) if truth is not None]
            if name == "side" and node.op == "sub" and len(sides) == 2:
                names |= {sides[0]: f"is_right_{k}", sides[1]: f"is_left_{k}"}
                names |= _either(order, set(sides), f"is_active_{k}")
    return names


def _either(order: list[Node], truths: set[Node], name: str) -> dict[Node, str]:
    """The name of the node that holds where one of two truths does."""
    for node in order:
        if node.op == "or" and set(node.args) == truths:
            return {node: name}
    return {}


def _present(order: list[Node], step: Step) -> dict[Node, str]:
    """The truths that an input is a finite number: -1e300 < w and w < 1e300."""
    inputs = {f"w{entry}": f"{name}_{k}" for entry, (name, k) in enumerate(members(step.inputs))}
    names: dict[Node, str] = {}
    for node in order:
        if node.op != "and":
            continue
        compared = {_bounded_input(arg) for arg in node.args}
        text = compared.pop()
        if not compared and text in inputs:
            names[node] = f"has_{inputs[text]}"
    return names


def _bounded_input(node: Node) -> str:
    """The name of the input that a node compares with a huge number; empty: it does not."""
    if node.op != "lt":
        return ""
    for bound, value in (node.args, node.args[::-1]):
        if abs(bound.value or 0.0) > HUGE and value.op == "input":
            return value.text
    return ""
