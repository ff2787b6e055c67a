"""Python functions of numbers, traced into nodes: their operators make one each.

`elementary` and `philox` are written once: lanes, C, WebAssembly and NumPy's arrays get the same
arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from undeadzone.compile.graph import Node, Nodes


def lifted(nodes: Nodes, x: Any, kind: str) -> Node:
    """Return the node of a number: a value's, of NumPy's own kind, or Python's of a kind."""
    if isinstance(x, Value):
        return x.node
    return nodes.constant(x, x.dtype.name if isinstance(x, np.generic) else kind)


def _operator(op: str, kind: str = "") -> Callable[[Value, Any], Value]:
    """Return an operator with a value on the left, whose result is of a kind."""
    return lambda a, other: Value(a.nodes, a.nodes.intern(op, a.node, a.lifted(other), kind=kind))


def _swap_operands(op: str, kind: str = "") -> Callable[[Value, Any], Value]:
    """Return an operator with a value on the right, whose result is of a kind."""
    return lambda b, other: Value(b.nodes, b.nodes.intern(op, b.lifted(other), b.node, kind=kind))


class Value:
    """A number whose operators make nodes.

    Args:
        nodes: where they are made.
        node: the number.
    """

    __array_ufunc__ = None  # NumPy's numbers leave operators to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, nodes: Nodes, node: Node) -> None:
        self.nodes, self.node = nodes, node

    def lifted(self, other: Any) -> Node:
        """Return the node of another number."""
        return lifted(self.nodes, other, self.node.kind)

    def __invert__(self) -> Value:
        """Return all bits turned."""
        every = int(np.iinfo(self.node.kind).max)
        return self ^ every

    def __neg__(self) -> Value:
        """Return the number with the other sign."""
        return Value(self.nodes, self.nodes.intern("neg", self.node))

    def __abs__(self) -> Value:
        """Return the number without its sign."""
        return Value(self.nodes, self.nodes.intern("call", self.node, text="fabs"))

    __add__ = _operator("add")
    __radd__ = _swap_operands("add")
    __sub__ = _operator("sub")
    __rsub__ = _swap_operands("sub")
    __mul__ = _operator("mul")
    __rmul__ = _swap_operands("mul")
    __truediv__ = _operator("div")
    __rtruediv__ = _swap_operands("div")
    __and__ = _operator("and")
    __or__ = _operator("or")
    __xor__ = _operator("xor")
    __lshift__ = _operator("shl")
    __rshift__ = _operator("shr")
    __lt__ = _operator("lt", "bool")
    __le__ = _operator("le", "bool")
    __gt__ = _swap_operands("lt", "bool")
    __ge__ = _swap_operands("le", "bool")
    __eq__ = _operator("eq", "bool")  # type: ignore[assignment]
    __ne__ = _operator("ne", "bool")  # type: ignore[assignment]

    def view(self, kind: Kind) -> Value:
        """Return the same bits as another kind of number."""
        return self.cast("view", kind.name)

    def cast(self, op: str, kind: str) -> Value:
        """This number as one of another type, by value (convert) or by bits (view)."""
        if kind == self.node.kind:
            return self
        return Value(self.nodes, self.nodes.intern(op, self.node, kind=kind))


class Kind(NamedTuple):
    """A kind of number, which converts into itself as NumPy's do.

    Attributes:
        name: NumPy's.
    """

    name: str

    def __call__(self, x: Value) -> Value:
        """Return a number of this kind."""
        return x.cast("convert", self.name)


class Numpy:
    """What traced functions call besides operators, by NumPy's names.

    Args:
        nodes: where nodes are made.
        real: kind of Python's numbers.
    """

    float64, float32 = Kind("float64"), Kind("float32")
    int32, uint32, uint64 = Kind("int32"), Kind("uint32"), Kind("uint64")

    def __init__(self, nodes: Nodes, real: str = "float64") -> None:
        self.nodes, self.real = nodes, real

    def where(self, truth: Value, yes: Any, no: Any) -> Value:
        """Return one of two numbers."""
        operands = [lifted(self.nodes, x, self.real) for x in (yes, no)]
        return Value(self.nodes, self.nodes.intern("select", truth.node, *operands))

    def sqrt(self, x: Value) -> Value:
        """Return the square root."""
        return self.call("sqrt", x)

    def call(self, name: str, *args: Any) -> Value:
        """Return a function by its name."""
        operands = [lifted(self.nodes, x, self.real) for x in args]
        return Value(self.nodes, self.nodes.intern("call", *operands, text=name))
