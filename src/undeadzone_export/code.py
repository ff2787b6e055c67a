"""Step as nodes ready to print: whole, and split at the dependence on the input."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np

from undeadzone.compile.graph import LANES, Node, Nodes, Results, required_nodes, to_condition
from undeadzone.compile.lower import build_portable_nodes
from undeadzone.compile.print_c import TYPES
from undeadzone.compile.repeats import Part
from undeadzone_export.exported_step import ExportedStep, Field

_COUNTED: Final = {
    **{"add": "add", "sub": "add", "neg": "negate", "mul": "multiply", "div": "divide"},
    **{"not": "logic", "and": "logic", "or": "logic", "select": "select"},
    **{"lt": "compare", "le": "compare", "eq": "compare", "ne": "compare"},
}

_WIDE: Final = 2**20  # capacity of an edge that no cut can contain


class Phases(NamedTuple):
    """Step in two calls.

    Attributes:
        estimate: results (out, carry) (nothing in it depends on the input).
        advance: results (next,). Its inputs named c are the carry.
        carried: how many numbers pass from one to the other.
    """

    estimate: Results
    advance: Results
    carried: int


class Code(NamedTuple):
    """Nodes to print.

    Attributes:
        step: the step it came from.
        single: whether numbers are float, else double.
        results: next and out.
        phases: the same in two calls (None if no input acts from outside).
        parts: functions that they call, each after those that it calls.
    """

    step: ExportedStep
    single: bool
    results: Results
    phases: Phases | None
    parts: list[Part]

    @property
    def dtype_name(self) -> str:
        """Return NumPy's name of the type of numbers."""
        return "float32" if self.single else "float64"

    @property
    def c_type(self) -> str:
        """Return the type of numbers in C."""
        return TYPES[self.dtype_name]

    @property
    def carry_size(self) -> int:
        """Return the number of values that pass from the first phase to the second."""
        return 0 if self.phases is None else self.phases.carried

    @property
    def structs(self) -> dict[str, list[Field]]:
        """Return the fields of each struct, by the end of its name."""
        step, meaning = self.step, "from estimate to advance; not part of the memory"
        carry = [Field("carry", self.carry_size, meaning)] if self.carry_size else []
        fields = {"state": [*step.state, *carry], "in": step.inputs, "out": step.outputs}
        return fields | ({"params": step.params} if step.params else {})

    @property
    def operations(self) -> dict[str, int]:
        """Return the operations of a step by their names, those of calls included."""
        return count_operations(self.results, self.parts)

    @property
    def hash(self) -> str:
        """Return the hash of nodes, numbers and precision, 16 hexadecimal digits."""
        every = [*self.results, *[part.results for part in self.parts]]
        order = required_nodes(itertools.chain(*every))
        nodes = [(n.op, [arg.number for arg in n.args], n.text, n.kind, n.number) for n in order]
        fields = (self.step.state, self.step.inputs, self.step.outputs, self.step.params)
        numbers = (self.step.start.tolist(), self.step.defaults.tolist(), self.step.Ts)
        results = [[node.number for node in result] for result in every]
        text = repr((nodes, results, fields, numbers))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def build_code(step: ExportedStep, single: bool) -> Code:
    """Build a step's nodes in a precision.

    Args:
        step: the step.
        single: whether numbers are float.

    Raises:
        InputError: an instruction that the export cannot print.
    """
    parts: list[Part] = []
    results = build_portable_nodes(step.function, "float32" if single else "float64", parts)
    phases = split_phases(results, {f"w{k}" for k in step.acting}) if step.acting else None
    return Code(step, single, results, phases, parts)


def split_phases(results: Results, acting: Iterable[str]) -> Phases:
    """Split the results (next, out) in two: before the inputs are known, and after.

    What `out` does not need is computed where fewer numbers then pass from one to the other.

    Args:
        results: the nodes.
        acting: names of the inputs that are known late (`out` must not depend on them).
    """
    following, out = results
    late: set[Node] = set()
    needed = set(following)
    for node in required_nodes(following):
        if node.text in acting or not late.isdisjoint(node.args):
            late.add(node)
            needed.update(node.args)
    early = [node for node in required_nodes(needed - late) if _is_computed(node)]
    carried = _smallest_cut(early, needed, set(required_nodes(out)))
    nodes = Nodes()
    copies: dict[Node, Node] = {}
    for entry, node in enumerate(carried):
        copies[node] = nodes.intern_input(f"c{entry}", LANES, node.kind)
    for node in required_nodes(following, carried):
        copies[node] = nodes.copy_node(node, [copies[arg] for arg in node.args])
    return Phases([out, carried], [[copies[node] for node in following]], len(carried))


def _smallest_cut(nodes: list[Node], needed: set[Node], first: set[Node]) -> list[Node]:
    """Return the fewest values from which all that is needed can be computed.

    It is the smallest cut of a flow from the needed values down to those that only the first phase
    has. Each value is a pipe of capacity 1.

    Args:
        nodes: nodes that are known before the inputs, in the order of creation.
        needed: nodes that the second phase uses.
        first: nodes that the first phase has to compute.
    """
    from scipy.sparse import csgraph, csr_matrix

    start, end = 2 * len(nodes), 2 * len(nodes) + 1
    at = {
        node: 2 * k for k, node in enumerate(nodes)
    }  # and at the odd number behind it its operands
    pipes = [(top, top + 1, 1) for top in at.values()]
    for node, top in at.items():
        pipes += [(top + 1, at[arg], _WIDE) for arg in set(node.args) & at.keys()]
        pipes += [(start, top, _WIDE)] * (node in needed)
        pipes += [(top, top + 1, _WIDE)] * (node.op == "apply")  # no number
        pipes += [(top + 1, end, _WIDE)] * (node in first or node.op == "input")
    tails, heads, capacities = np.array(pipes, np.int32).reshape(-1, 3).T
    graph = csr_matrix((capacities, (tails, heads)), (end + 1, end + 1))
    left = graph - csgraph.maximum_flow(graph, start, end).flow
    reached = {*csgraph.breadth_first_order(left > 0, start)[0].tolist()}
    return [node for node, top in at.items() if top in reached and top + 1 not in reached]


def _is_computed(node: Node) -> bool:
    """Return whether a node must be carried. Constants, states and parameters need not be."""
    if node.op == "const":
        return False
    return node.op != "input" or node.text.startswith("w")


def count_operations(results: Results, parts: Iterable[Part] = ()) -> dict[str, int]:
    """Count the operations of each kind in one evaluation, by their names.

    Truths as numbers are the truths themselves.

    Args:
        results: the nodes.
        parts: functions whose operations count at each call, each after those that it calls.
    """
    own = dict[str, Counter[str]]()
    for part in parts:
        own[part.name] = _count_calls([part.results], own)
    return dict(sorted(_count_calls(results, own).items()))


def _count_calls(results: Results, own: dict[str, Counter[str]]) -> Counter[str]:
    """Count operations, with those of functions by name."""
    counts: Counter[str] = Counter()
    for node in required_nodes(itertools.chain(*results)):
        is_call = node.op in ("apply", "part")  # of a repeated part
        if node.args and not is_call and to_condition(node) is None:
            counts[node.text or _COUNTED[node.op]] += 1
        elif node.op == "apply":
            counts += own.get(node.text, Counter())
    return counts
