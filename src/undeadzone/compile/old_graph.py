"""A CasADi SX function as a list of instructions, and as fewer that round differently."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

# Instructions whose result is 1 or 0.
CONDITIONS = frozenset(
    (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR),
)


class Node(NamedTuple):
    """An instruction.

    Attributes:
        op: CasADi's number of it.
        operands: numbers of earlier nodes.
        text: of an input (its name and entry) or a constant.
    """

    op: int
    operands: tuple[int, ...] = ()
    text: str = ""


class Graph(NamedTuple):
    """A function as nodes, each of which needs earlier ones only.

    Attributes:
        nodes: the instructions.
        results: the nodes that each output consists of.
        reads: the entries that are read of each input.
    """

    nodes: list[Node]
    results: list[list[int]]
    reads: list[list[int]]


def listed(function: ca.Function) -> Graph:
    """The instructions of a function with dense outputs.

    Every node is assigned once, unlike the places of CasADi's work vector.
    """
    nodes: list[Node] = []
    holds: dict[int, int] = {}  # the node that a place of the work vector holds
    reads: list[list[int]] = [[] for _ in range(function.n_in())]
    results = [[0] * function.nnz_out(i) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        sources, targets = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            results[targets[0]][targets[1]] = holds[sources[0]]
            continue
        if op == ca.OP_INPUT:
            reads[sources[0]].append(sources[1])
            node = Node(op, text=f"{function.name_in(sources[0])}{sources[1]}")
        elif op == ca.OP_CONST:
            node = Node(op, text=repr(function.instruction_constant(k)))
        else:
            node = Node(op, tuple(holds[source] for source in sources))
        holds[targets[0]] = len(nodes)
        nodes.append(node)
    return Graph(nodes, results, reads)


def steady(nodes: list[Node]) -> set[int]:
    """The nodes that depend on constants and on inputs named p alone, which are finite numbers."""
    numbers: set[int] = set()
    for k, node in enumerate(nodes):
        if _is_steady(node, numbers):
            numbers.add(k)
    return numbers


def _is_steady(node: Node, steady: set[int]) -> bool:
    """Whether a node is steady, if those among its operands are that are listed."""
    if node.operands:
        return all(operand in steady for operand in node.operands)
    return node.op == ca.OP_CONST or node.text.startswith("p")


def shortened(graph: Graph) -> Graph:
    """The same values to rounding and the sign of zero, by fewer instructions.

    Conditions move into products; inverses of what is steady and products with it are gathered.
    """
    rewriting = _Rewriting([], {}, set())
    places: list[int] = []
    for node in graph.nodes:
        operands = tuple(places[operand] for operand in node.operands)
        places.append(rewriting.made(node.op, operands, node.text))
    results = [[places[k] for k in result] for result in graph.results]
    return Graph(rewriting.nodes, results, graph.reads)


class _Rewriting(NamedTuple):
    """A growing list of nodes in which none stands twice.

    Attributes:
        nodes: the list.
        places: where each node stands in it.
        steady: the numbers of steady nodes.
    """

    nodes: list[Node]
    places: dict[Node, int]
    steady: set[int]

    def made(self, op: int, operands: tuple[int, ...], text: str = "") -> int:
        """The node of an instruction, or of what does the same with fewer."""
        if op == ca.OP_IF_ELSE_ZERO:
            return self.gated(*operands)
        if op == ca.OP_OR:
            return self.either(*operands)
        if op == ca.OP_DIV and operands[1] in self.steady and operands[0] not in self.steady:
            return self.made(ca.OP_MUL, (self.made(ca.OP_INV, operands[1:]), operands[0]))
        if op == ca.OP_MUL:
            return self.product(*operands)
        return self.kept(op, operands, text)

    def either(self, a: int, b: int) -> int:
        """Whether one of two conditions holds; 0 is one that never does."""
        if self.nodes[a].text == "0.0":
            return b
        if self.nodes[b].text == "0.0":
            return a
        return self.kept(ca.OP_OR, (a, b))

    def product(self, a: int, b: int) -> int:
        """a b, with what is steady ahead and in one factor, where no condition is a factor."""
        for factor, value in ((a, b), (b, a)):
            if self.nodes[factor].op in CONDITIONS:
                return self.gated(factor, value)
        for factor, value in ((a, b), (b, a)):
            if factor in self.steady and value not in self.steady:
                inner, rest = self.factors(value)
                if inner is not None:
                    factor = self.made(ca.OP_MUL, (factor, inner))
                return self.kept(ca.OP_MUL, (factor, rest))
        return self.kept(ca.OP_MUL, (a, b))

    def gated(self, condition: int, value: int) -> int:
        """The value where the condition holds, else 0."""
        if self.nodes[condition].op not in CONDITIONS:
            condition = self.kept(ca.OP_NE, (condition, self.kept(ca.OP_CONST, (), "0.0")))
        node = self.nodes[value]
        factor, rest = self.factors(value)
        if factor is not None:
            return self.kept(ca.OP_MUL, (factor, self.gated(condition, rest)))
        if node.op == ca.OP_NEG:
            return self.kept(ca.OP_NEG, (self.gated(condition, node.operands[0]),))
        if node.op == ca.OP_IF_ELSE_ZERO:
            inner, rest = node.operands
            both = condition
            if not self.implies(condition, inner):
                both = self.kept(ca.OP_AND, (condition, inner))
            return self.gated(both, rest)
        return self.kept(ca.OP_IF_ELSE_ZERO, (condition, value))

    def implies(self, condition: int, other: int) -> bool:
        """Whether a condition holds only where another does.

        They are the same, or a < 0 or 0 < a and a != 0.
        """
        if condition == other:
            return True
        this, that = self.nodes[condition], self.nodes[other]
        compared = this.op == ca.OP_LT and that.op == ca.OP_NE
        return compared and set(this.operands) == set(that.operands)

    def factors(self, value: int) -> tuple[int | None, int]:
        """The steady factor and the rest of a product that has one; else None and the value."""
        node = self.nodes[value]
        if value not in self.steady and node.op == ca.OP_MUL and node.operands[0] in self.steady:
            return node.operands[0], node.operands[1]
        return None, value

    def kept(self, op: int, operands: tuple[int, ...], text: str = "") -> int:
        """The place of an instruction as it is."""
        node = Node(op, operands, text)
        if node not in self.places:
            self.places[node] = len(self.nodes)
            if _is_steady(node, self.steady):
                self.steady.add(len(self.nodes))
            self.nodes.append(node)
        return self.places[node]
