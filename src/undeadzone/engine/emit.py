"""A CasADi SX graph printed as straight-line Python that numba compiles: one assignment per instruction, no branches.

Every instruction means to the last bit what it means on CasADi's virtual machine, NaN, infinities and the sign of
zero included; elementary functions are those of the C library, as there.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import casadi as ca

from undeadzone.errors import InputError

HELPERS = '''
import math
from math import inf, nan

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

remainder = types.ExternalFunction("remainder", types.float64(types.float64, types.float64))


@intrinsic
def select(context, condition, yes, no):
    """yes where the condition holds, else no, without a branch."""
    return types.float64(types.boolean, types.float64, types.float64), lambda context, builder, signature, args: builder.select(*args)


@intrinsic
def fma(context, a, b, c):
    """a * b + c, rounded once."""
    return types.float64(types.float64, types.float64, types.float64), lambda context, builder, signature, args: builder.fma(*args)
'''

_FORMS = {
    ca.OP_ASSIGN: "{0}", ca.OP_LIFT: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}", ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}", ca.OP_INV: "1.0 / {0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}", ca.OP_FABS: "abs({0})",
    ca.OP_LT: "select({0} < {1}, 1.0, 0.0)", ca.OP_LE: "select({0} <= {1}, 1.0, 0.0)",
    ca.OP_EQ: "select({0} == {1}, 1.0, 0.0)", ca.OP_NE: "select({0} != {1}, 1.0, 0.0)",
    ca.OP_NOT: "select({0} == 0.0, 1.0, 0.0)",
    ca.OP_AND: "select(({0} != 0.0) & ({1} != 0.0), 1.0, 0.0)", ca.OP_OR: "select(({0} != 0.0) | ({1} != 0.0), 1.0, 0.0)",
    ca.OP_IF_ELSE_ZERO: "select({0} != 0.0, {1}, 0.0)",
    ca.OP_FMIN: "select(({0} <= {1}) | ({1} != {1}), {0}, {1})", ca.OP_FMAX: "select(({0} >= {1}) | ({1} != {1}), {0}, {1})",
    ca.OP_SIGN: "select({0} < 0.0, -1.0, select({0} > 0.0, 1.0, {0}))",
    ca.OP_FLOOR: "np.floor({0})", ca.OP_CEIL: "np.ceil({0})",
    ca.OP_FMOD: "np.fmod({0}, {1})", ca.OP_REMAINDER: "remainder({0}, {1})", ca.OP_CONSTPOW: "math.pow({0}, {1})",
    **{getattr(ca, f"OP_{name.upper()}"): f"math.{name}({{0}}, {{1}})" for name in ("pow", "atan2", "hypot", "copysign")},
    **{getattr(ca, f"OP_{name.upper()}"): f"math.{name}({{0}})" for name in (
        "sqrt", "exp", "expm1", "log", "log1p", "erf", "sin", "cos", "tan", "asin", "acos", "atan",
        "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    )},
}  # fmt: skip


class Code(NamedTuple):
    """Straight-line Python.

    reads: the entries of each input that it needs, named s3 for entry 3 of input s; statements: in order;
    results: for each output, the name that holds each entry in the end.
    """

    reads: list[list[int]]
    statements: list[str]
    results: list[list[str]]


class _Node(NamedTuple):
    """An instruction whose operands are the numbers of earlier ones."""

    op: int
    name: str
    operands: list[int]


def straight_line(graph: ca.Function, fused: bool = False) -> Code:
    """The code of an SX function with dense outputs.

    fused: write a product that is only added to or taken from something as one `fma`; faster, and rounded once where
    the virtual machine rounds twice. Raises InputError that names an instruction it cannot print.
    """
    nodes, reads, results = _nodes(graph)
    folded = _folded(nodes, results) if fused else {}
    gone = set(folded.values())
    statements = [
        f"{node.name} = {_product_sum(nodes, k, folded[k]) if k in folded else _expression(nodes, node)}"
        for k, node in enumerate(nodes)
        if node.operands and k not in gone
    ]
    return Code(reads, statements, [[nodes[k].name for k in result] for result in results])


def _nodes(graph: ca.Function) -> tuple[list[_Node], list[list[int]], list[list[int]]]:
    """(nodes, entries read of each input, nodes of each output); every node is assigned once, unlike CasADi's work vector."""
    nodes: list[_Node] = []
    holds: dict[int, int] = {}
    reads: list[list[int]] = [[] for _ in range(graph.n_in())]
    results = [[0] * graph.nnz_out(i) for i in range(graph.n_out())]
    for k in range(graph.n_instructions()):
        op, sources, targets = graph.instruction_id(k), graph.instruction_input(k), graph.instruction_output(k)
        if op == ca.OP_OUTPUT:
            results[targets[0]][targets[1]] = holds[sources[0]]
            continue
        if op == ca.OP_INPUT:
            reads[sources[0]].append(sources[1])
            node = _Node(op, f"{graph.name_in(sources[0])}{sources[1]}", [])
        elif op == ca.OP_CONST:
            node = _Node(op, repr(graph.instruction_constant(k)), [])
        elif op in _FORMS:
            node = _Node(op, f"v{k}", [holds[source] for source in sources])
        else:
            name = next(name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == op)
            raise InputError(f"{graph.name()}: the lanes engine has no instruction {name}; run this graph on the engine 'interpret'")
        holds[targets[0]] = len(nodes)
        nodes.append(node)
    return nodes, reads, results


def _expression(nodes: list[_Node], node: _Node) -> str:
    return _FORMS[node.op].format(*(nodes[operand].name for operand in node.operands))


def _folded(nodes: list[_Node], results: list[list[int]]) -> dict[int, int]:
    """For each sum or difference that can take one in, the product that is used nowhere else."""
    uses = Counter(operand for node in nodes for operand in node.operands) + Counter(k for result in results for k in result)
    found = {}
    for k, node in enumerate(nodes):
        if node.op in (ca.OP_ADD, ca.OP_SUB):
            products = [operand for operand in node.operands if nodes[operand].op in (ca.OP_MUL, ca.OP_SQ) and uses[operand] == 1]
            if products:
                found[k] = products[-1]
    return found


def _product_sum(nodes: list[_Node], k: int, product: int) -> str:
    """The sum or difference k with its operand `product` taken in."""
    a, b = (nodes[operand].name for operand in nodes[k].operands)
    x, y = (nodes[nodes[product].operands[i]].name for i in (0, -1))
    minus = "-" if nodes[k].op == ca.OP_SUB else ""
    return f"fma({x}, {y}, {minus}{b})" if product == nodes[k].operands[0] else f"fma({minus}{x}, {y}, {a})"
