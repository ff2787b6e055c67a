"""The instructions of the C printer: CasADi's, a selection, four that look at a number's bits."""

from __future__ import annotations

from collections import Counter

import casadi as ca

from undeadzone.compile.graph import CONDITIONS, Graph, Node
from undeadzone.errors import InputError

SELECT = -1
"""Operands (condition, yes, no): yes where the condition holds, else no."""

TRUNCATED, POWER, EXPONENT, FRACTION = -2, -3, -4, -5
"""x without its fraction; 2^x of a whole x; n and f of x = 2^n f, 1/sqrt(2) <= f < sqrt(2)."""

BITWISE = {TRUNCATED: "truncated", POWER: "power", EXPONENT: "exponent", FRACTION: "fraction"}

_WORDS = (
    "exp", "expm1", "log", "log1p", "erf", "sin", "cos", "tan", "asin", "acos", "atan",
    "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "atan2", "pow", "hypot", "fabs", "floor",
    "ceil", "sign", "fmin", "fmax",
)  # fmt: skip

LIBRARY = {
    ca.OP_SQRT: "sqrt",
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
    ca.OP_COPYSIGN: "copysign",
}
"""Functions of the C library whose results IEEE 754 fixes to the last bit."""

OWN = {getattr(ca, f"OP_{word.upper()}"): word for word in _WORDS} | {ca.OP_CONSTPOW: "pow"}
"""Functions that the export brings along."""

BINARY = {
    ca.OP_ADD: "+",
    ca.OP_SUB: "-",
    ca.OP_MUL: "*",
    ca.OP_DIV: "/",
    ca.OP_LT: "<",
    ca.OP_LE: "<=",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
    ca.OP_AND: "&&",
    ca.OP_OR: "||",
}

_OTHERS = {
    ca.OP_ASSIGN,
    ca.OP_LIFT,
    ca.OP_NEG,
    ca.OP_INV,
    ca.OP_SQ,
    ca.OP_TWICE,
    ca.OP_NOT,
    ca.OP_IF_ELSE_ZERO,
    ca.OP_INPUT,
    ca.OP_CONST,
    SELECT,
}

KNOWN = frozenset(LIBRARY) | frozenset(OWN) | frozenset(BINARY) | frozenset(BITWISE) | _OTHERS

COUNTED = {
    ca.OP_ADD: "add",
    ca.OP_SUB: "add",
    ca.OP_NEG: "negate",
    ca.OP_MUL: "multiply",
    ca.OP_SQ: "multiply",
    ca.OP_TWICE: "multiply",
    ca.OP_DIV: "divide",
    ca.OP_INV: "divide",
    ca.OP_NOT: "logic",
    ca.OP_AND: "logic",
    ca.OP_OR: "logic",
    ca.OP_LT: "compare",
    ca.OP_LE: "compare",
    ca.OP_EQ: "compare",
    ca.OP_NE: "compare",
    ca.OP_IF_ELSE_ZERO: "select",
    SELECT: "select",
}
"""What each instruction counts as in the manifest; functions count by their names."""


def require_known(name: str, graph: Graph) -> None:
    """Refuse a graph with an instruction that C here has no words for.

    Args:
        name: of the graph, for the message.
        graph: the graph.

    Raises:
        InputError: names the instruction.
    """
    unknown = {node.op for node in graph.nodes} - KNOWN
    if not unknown:
        return
    words = [word for word in dir(ca) if word.startswith("OP_")]
    missing = [word for word in words if getattr(ca, word) in unknown]
    raise InputError(f"{name}: the C export has no instruction {', '.join(sorted(missing))}")


def is_condition(node: Node) -> bool:
    """Whether a node is 1 or 0."""
    return node.op in CONDITIONS


def uses_of(graph: Graph) -> Counter[int]:
    """How often each node is used by results and by nodes that are themselves used."""
    uses: Counter[int] = Counter()
    for result in graph.results:
        uses.update(result)
    for place in reversed(range(len(graph.nodes))):
        if uses[place]:
            uses.update(graph.nodes[place].operands)
    return uses


def operations(graph: Graph) -> dict[str, int]:
    """How many operations of each kind one evaluation takes, by their names."""
    uses = uses_of(graph)
    counts: Counter[str] = Counter()
    for place, node in enumerate(graph.nodes):
        if uses[place] and node.operands:
            counts[COUNTED.get(node.op) or LIBRARY.get(node.op) or OWN.get(node.op, "copy")] += 1
    return dict(sorted(counts.items()))
