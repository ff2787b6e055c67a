"""Bounds on what a CasADi SX graph can be on boxes of its inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca
import numpy as np

from undeadzone.engine import interval_arithmetic as arithmetic
from undeadzone.engine.graph import Graph, listed
from undeadzone.engine.interval_arithmetic import Interval
from undeadzone.errors import InputError

__all__ = ["Interval", "enclosure"]


def _same(a: Interval) -> Interval:
    """a itself."""
    return a


# Bounds on an instruction from those on its operands.
_BOUNDS: dict[int, Callable[..., Interval]] = {
    ca.OP_ASSIGN: _same,
    ca.OP_ADD: arithmetic.add,
    ca.OP_SUB: arithmetic.subtract,
    ca.OP_NEG: arithmetic.negative,
    ca.OP_TWICE: arithmetic.twice,
    ca.OP_MUL: arithmetic.product,
    ca.OP_DIV: arithmetic.quotient,
    ca.OP_INV: arithmetic.inverse,
    ca.OP_SQ: arithmetic.square,
    ca.OP_FABS: arithmetic.absolute,
    ca.OP_SIGN: arithmetic.sign,
    ca.OP_POW: arithmetic.power,
    ca.OP_CONSTPOW: arithmetic.power,
    ca.OP_SQRT: arithmetic.sqrt,
    ca.OP_EXP: arithmetic.exp,
    ca.OP_LOG: arithmetic.log,
    ca.OP_SIN: arithmetic.sin,
    ca.OP_COS: arithmetic.cos,
    ca.OP_TAN: arithmetic.tan,
    ca.OP_ASIN: arithmetic.asin,
    ca.OP_ACOS: arithmetic.acos,
    ca.OP_ATAN: partial(arithmetic.rising, np.arctan),
    ca.OP_SINH: partial(arithmetic.rising, np.sinh),
    ca.OP_COSH: arithmetic.cosh,
    ca.OP_TANH: partial(arithmetic.rising, np.tanh),
    ca.OP_FMIN: arithmetic.minimum,
    ca.OP_FMAX: arithmetic.maximum,
    ca.OP_LT: arithmetic.less,
    ca.OP_LE: arithmetic.at_most,
    ca.OP_EQ: arithmetic.equal,
    ca.OP_NE: arithmetic.unequal,
    ca.OP_NOT: arithmetic.negation,
    ca.OP_AND: arithmetic.both,
    ca.OP_OR: arithmetic.maximum,
    ca.OP_IF_ELSE_ZERO: arithmetic.gated,
}


def enclosure(function: ca.Function) -> Callable[[Sequence[Interval]], list[Interval]]:
    """Bounds on the outputs of a function, true for every point of a box of its inputs.

    Args:
        function: of SX, with dense outputs.

    Returns:
        bounds(boxes): from an interval (entries x boxes) per input to one (entries x boxes) per
        output. It raises InputError where a condition or a kink is not decided on a whole box.

    Raises:
        InputError: an instruction without bounds.
    """
    graph = listed(function)
    for node in graph.nodes:
        if node.op not in _BOUNDS and node.op not in (ca.OP_INPUT, ca.OP_CONST):
            raise InputError(f"no bounds are known for the function {_name(node.op)}")
    inputs: dict[str, tuple[int, int]] = {}
    for i in range(function.n_in()):
        for k in range(function.nnz_in(i)):
            inputs[f"{function.name_in(i)}{k}"] = (i, k)
    return partial(_enclosed, graph, inputs)


def _enclosed(
    graph: Graph, inputs: dict[str, tuple[int, int]], boxes: Sequence[Interval]
) -> list[Interval]:
    """Bounds on the outputs of a graph.

    Args:
        graph: the function.
        inputs: for the text of a node that reads an input, that input and the entry of it.
        boxes: an interval (entries x boxes) per input.
    """
    shape = np.broadcast_shapes(*(box.low.shape[1:] for box in boxes))
    values: list[Interval] = []
    with np.errstate(all="ignore"):
        for node in graph.nodes:
            if node.op == ca.OP_INPUT:
                i, k = inputs[node.text]
                values.append(Interval(boxes[i].low[k], boxes[i].high[k]))
            elif node.op == ca.OP_CONST:
                constant = np.array(float(node.text))
                values.append(Interval(constant, constant))
            else:
                operands = [values[operand] for operand in node.operands]
                values.append(_BOUNDS[node.op](*operands))
    return [_stacked([values[k] for k in entries], shape) for entries in graph.results]


def _stacked(entries: list[Interval], shape: tuple[int, ...]) -> Interval:
    """Several intervals in one (entries x boxes)."""
    low = np.stack([np.broadcast_to(entry.low, shape) for entry in entries])
    high = np.stack([np.broadcast_to(entry.high, shape) for entry in entries])
    return Interval(low, high)


def _name(op: int) -> str:
    """The name of an instruction: fmod of OP_FMOD."""
    for name in dir(ca):
        if name.startswith("OP_") and getattr(ca, name) == op:
            return name.removeprefix("OP_").lower()
    raise ValueError(op)
