"""A step as nodes ready to print: in one, and split at what depends on the input."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from collections.abc import Iterable
from typing import Final, NamedTuple

from undeadzone.compile.graph import LANES, Node, Nodes, Results, required_nodes, to_condition
from undeadzone.compile.lower import build_portable_nodes
from undeadzone.compile.print_c import TYPES
from undeadzone_export.exported_step import Field, Step

_COUNTED: Final = {
    **{"add": "add", "sub": "add", "neg": "negate", "mul": "multiply", "div": "divide"},
    **{"not": "logic", "and": "logic", "or": "logic", "select": "select"},
    **{"lt": "compare", "le": "compare", "eq": "compare", "ne": "compare"},
}


class Phases(NamedTuple):
    """A step in two calls.

    Attributes:
        estimate: results (out, carry); nothing in it depends on the input.
        advance: results (next,); its inputs named c are the carry.
        carried: how many numbers pass from one to the other.
    """

    estimate: Results
    advance: Results
    carried: int


class Code(NamedTuple):
    """What is printed.

    Attributes:
        step: the step it came from.
        single: whether numbers are float, else double.
        results: next and out.
        phases: the same in two calls; None where no input acts from outside.
    """

    step: Step
    single: bool
    results: Results
    phases: Phases | None

    @property
    def kind(self) -> str:
        """Return NumPy's name of the type of numbers."""
        return "float32" if self.single else "float64"

    @property
    def real(self) -> str:
        """Return the type of numbers in C."""
        return TYPES[self.kind]

    @property
    def number_carried(self) -> int:
        """How many numbers pass from one phase to the other."""
        return 0 if self.phases is None else self.phases.carried

    @property
    def structs(self) -> dict[str, list[Field]]:
        """Return the fields of each struct, by the end of its name."""
        step, meaning = self.step, "from estimate to advance; not part of the memory"
        carry = [Field("carry", self.number_carried, meaning)] if self.number_carried else []
        fields = {"state": [*step.state, *carry], "in": step.inputs, "out": step.outputs}
        return fields | ({"params": step.params} if step.params else {})

    @property
    def hash(self) -> str:
        """Of the nodes, their numbers and the precision, 16 hexadecimal digits."""
        order = required_nodes(itertools.chain(*self.results))
        nodes = [(n.op, [arg.number for arg in n.args], n.text, n.kind, n.number) for n in order]
        fields = (self.step.state, self.step.inputs, self.step.outputs, self.step.params)
        numbers = (self.step.start.tolist(), self.step.defaults.tolist(), self.step.Ts)
        results = [[node.number for node in result] for result in self.results]
        text = repr((nodes, results, fields, numbers))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def code(step: Step, single: bool) -> Code:
    """Return a step's nodes in a precision.

    Args:
        step: the step.
        single: whether numbers are float.

    Raises:
        InputError: an instruction that the export cannot print.
    """
    results = build_portable_nodes(step.function, "float32" if single else "float64")
    phases = split_results(results, {f"w{k}" for k in step.acting}) if step.acting else None
    return Code(step, single, results, phases)


def split_results(results: Results, acting: Iterable[str]) -> Phases:
    """Return results (next, out) in two: before the inputs are known, and after.

    Args:
        results: the nodes.
        acting: names of the inputs that are known late; `out` must not depend on them.
    """
    following, out = results
    order = required_nodes(following)
    late: set[Node] = set()
    used: list[Node] = []
    for node in order:
        if node.text in acting or not late.isdisjoint(node.args):
            late.add(node)
            used += node.args
    used.sort(key=lambda node: node.number)
    carried: dict[Node, int] = {}
    for node in [*used, *following]:
        if node not in late and _is_computed(node):
            carried.setdefault(node, len(carried))
    nodes = Nodes()
    copies: dict[Node, Node] = {}
    for node, entry in carried.items():
        copies[node] = nodes.intern_input(f"c{entry}", LANES, node.kind)
    for node in required_nodes(following, carried):
        args = [copies[arg] for arg in node.args]
        copies[node] = nodes.intern(node.op, *args, text=node.text, kind=node.kind)
    return Phases([out, list(carried)], [[copies[node] for node in following]], len(carried))


def _is_computed(node: Node) -> bool:
    """Return whether a node must be carried: constants, states and parameters are there anyway."""
    if node.op == "const":
        return False
    return node.op != "input" or node.text.startswith("w")


def operations(results: Results) -> dict[str, int]:
    """How many operations of each kind one evaluation takes, by their names."""
    counts: Counter[str] = Counter()
    for node in required_nodes(itertools.chain(*results)):
        if node.args and to_condition(node) is None:  # a truth as a number is the truth itself
            counts[node.text or _COUNTED[node.op]] += 1
    return dict(sorted(counts.items()))
