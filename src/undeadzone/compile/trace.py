"""Python functions of numbers, traced into nodes by operators that build a node each.

`elementary` and `philox` are written once: lanes, C, WebAssembly and NumPy's arrays get the same
arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from undeadzone.compile.graph import Node, Nodes


def to_node(nodes: Nodes, x: Any, kind: str) -> Node:
    """Return the node of a number: a traced value, a NumPy number of its own kind, or a Python
    number of `kind`.
    """
    if isinstance(x, Value):
        return x.node
    return nodes.intern_constant(x, x.dtype.name if isinstance(x, np.generic) else kind)


def _build_operator(op: str, kind: str = "") -> Callable[[Value, Any], Value]:
    """Return an operator with a value on the left, whose result is of a kind."""
    return lambda a, other: Value(
        a.nodes, a.nodes.intern(op, a.node, a.operand_node(other), kind=kind)
    )


def _build_swapped_operator(op: str, kind: str = "") -> Callable[[Value, Any], Value]:
    """Return an operator with a value on the right, whose result is of a kind."""
    return lambda b, other: Value(
        b.nodes, b.nodes.intern(op, b.operand_node(other), b.node, kind=kind)
    )


class Value:
    """Number whose operators build nodes.

    Args:
        nodes: graph that interns them.
        node: the number.
    """

    __array_ufunc__ = None  # NumPy's numbers leave operators to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, nodes: Nodes, node: Node) -> None:
        self.nodes = nodes
        self.node = node

    def operand_node(self, other: Any) -> Node:
        """Return the node of an operand."""
        return to_node(self.nodes, other, self.node.kind)

    def __invert__(self) -> Value:
        """Return the number with all bits inverted."""
        every = int(np.iinfo(self.node.kind).max)
        return self ^ every

    def __neg__(self) -> Value:
        """Return the number with the opposite sign."""
        return Value(self.nodes, self.nodes.intern("neg", self.node))

    def __abs__(self) -> Value:
        """Return the absolute value of the number."""
        return Value(self.nodes, self.nodes.intern("call", self.node, text="fabs"))

    __add__ = _build_operator("add")
    __radd__ = _build_swapped_operator("add")
    __sub__ = _build_operator("sub")
    __rsub__ = _build_swapped_operator("sub")
    __mul__ = _build_operator("mul")
    __rmul__ = _build_swapped_operator("mul")
    __truediv__ = _build_operator("div")
    __rtruediv__ = _build_swapped_operator("div")
    __and__ = _build_operator("and")
    __or__ = _build_operator("or")
    __xor__ = _build_operator("xor")
    __lshift__ = _build_operator("shl")
    __rshift__ = _build_operator("shr")
    __lt__ = _build_operator("lt", "bool")
    __le__ = _build_operator("le", "bool")
    __gt__ = _build_swapped_operator("lt", "bool")
    __ge__ = _build_swapped_operator("le", "bool")
    __eq__ = _build_operator("eq", "bool")  # type: ignore[assignment]
    __ne__ = _build_operator("ne", "bool")  # type: ignore[assignment]

    def view(self, kind: Kind) -> Value:
        """Return the same bits as another kind of number."""
        return self.cast("view", kind.name)

    def cast(self, op: str, kind: str) -> Value:
        """Return this number as another type, by value (convert) or by bits (view)."""
        if kind == self.node.kind:
            return self
        return Value(self.nodes, self.nodes.intern(op, self.node, kind=kind))


class Kind(NamedTuple):
    """Kind of number, which converts its arguments as NumPy's types do.

    Attributes:
        name: NumPy's.
    """

    name: str

    def __call__(self, x: Value) -> Value:
        """Return a number converted to this kind."""
        return x.cast("convert", self.name)


class Numpy:
    """Functions that traced code calls besides operators, by NumPy's names.

    Args:
        nodes: where nodes are made.
        real: kind of Python's numbers.
    """

    float64 = Kind("float64")
    float32 = Kind("float32")
    int32 = Kind("int32")
    uint32 = Kind("uint32")
    uint64 = Kind("uint64")

    def __init__(self, nodes: Nodes, real: str = "float64") -> None:
        self.nodes = nodes
        self.real = real

    def where(self, truth: Value, yes: Any, no: Any) -> Value:
        """Select one of two numbers by a truth."""
        operands = [to_node(self.nodes, x, self.real) for x in (yes, no)]
        return Value(self.nodes, self.nodes.intern("select", truth.node, *operands))

    def sqrt(self, x: Value) -> Value:
        """Return the square root."""
        return self.call("sqrt", x)

    def call(self, name: str, *args: Any) -> Value:
        """Return the value of a function given by its name."""
        operands = [to_node(self.nodes, x, self.real) for x in args]
        return Value(self.nodes, self.nodes.intern("call", *operands, text=name))
