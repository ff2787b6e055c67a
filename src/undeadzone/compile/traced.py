"""Python functions of numbers, traced into instructions: their operators make one each.

`elementary` and `philox` are written once: NumPy's arrays, C and lanes run the same text.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.compile.ops import Op, Ops

# LLVM's types of NumPy's numbers; integers have a sign or not.
_TYPES: Final[dict[str, tuple[str, bool]]] = {
    "float64": ("double", True),
    "float32": ("float", True),
    "int64": ("i64", True),
    "uint64": ("i64", False),
    "int32": ("i32", True),
    "uint32": ("i32", False),
}
_BITS: Final = {"double": 64, "float": 32, "i64": 64, "i32": 32, "i1": 1}
_FLOATS: Final = ("double", "float")


def _of_two(a: Value, floating: str, integer: str, other: Any) -> Value:
    """An instruction of a number and another one: NumPy's of its own type, Python's a double."""
    b = other if isinstance(other, Value) else constant(a.ops, other)
    kind = floating if a.op.type in _FLOATS else integer
    return Value(a.ops, a.ops.made(kind, a.op, b.op), a.signed)


def _operator(floating: str, integer: str) -> Callable[[Value, Any], Value]:
    """An operator with a value on the left."""
    return lambda a, other: _of_two(a, floating, integer, other)


def _swapped(floating: str, integer: str) -> Callable[[Value, Any], Value]:
    """An operator with a value on the right and a constant on the left."""
    return lambda b, other: _of_two(constant(b.ops, other), floating, integer, b)


def _comparison(floating: str, integer: str) -> Callable[[Value, Any], Value]:
    """A comparison with a value on the left."""

    def compared(a: Value, other: Any) -> Value:
        b = other if isinstance(other, Value) else constant(a.ops, other)
        if a.op.type in _FLOATS:
            return Value(a.ops, a.ops.compared(floating, a.op, b.op))
        sign = "" if integer in ("eq", "ne") else "us"[a.signed]
        return Value(a.ops, a.ops.made(f"icmp {sign}{integer}", a.op, b.op, of_type="i1"))

    return compared


class Value:
    """A number whose operators make instructions.

    Args:
        ops: where they are made.
        op: the number.
        signed: whether an integer has a sign.
    """

    __array_ufunc__ = None  # NumPy's numbers leave operators to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, ops: Ops, op: Op, signed: bool = True) -> None:
        self.ops, self.op, self.signed = ops, op, signed

    def __invert__(self) -> Value:
        """All bits turned."""
        return _of_two(self, "", "xor", Value(self.ops, self.ops.word(-1, self.op.type)))

    def __neg__(self) -> Value:
        """The number with the other sign."""
        return Value(self.ops, self.ops.made("fneg", self.op))

    def __abs__(self) -> Value:
        """The number without its sign."""
        return Value(self.ops, self.ops.made("fabs", self.op))

    __add__ = _operator("fadd", "add")
    __radd__ = _swapped("fadd", "add")
    __sub__ = _operator("fsub", "sub")
    __rsub__ = _swapped("fsub", "sub")
    __mul__ = _operator("fmul", "mul")
    __rmul__ = _swapped("fmul", "mul")
    __truediv__ = _operator("fdiv", "")
    __rtruediv__ = _swapped("fdiv", "")
    __and__ = _operator("", "and")
    __or__ = _operator("", "or")
    __xor__ = _operator("", "xor")
    __lshift__ = _operator("", "shl")
    __rshift__ = _operator("", "lshr")
    __lt__ = _comparison("olt", "lt")
    __le__ = _comparison("ole", "le")
    __gt__ = _comparison("ogt", "gt")
    __ge__ = _comparison("oge", "ge")
    __eq__ = _comparison("oeq", "eq")  # type: ignore[assignment]
    __ne__ = _comparison("une", "ne")  # type: ignore[assignment]

    def view(self, kind: Kind) -> Value:
        """The same bits as another kind of number."""
        if kind.type == self.op.type:
            return Value(self.ops, self.op, kind.signed)
        return Value(self.ops, self.ops.made("bitcast", self.op, of_type=kind.type), kind.signed)


class Kind(NamedTuple):
    """A kind of number, which converts into itself as NumPy's do.

    Attributes:
        name: NumPy's.
        type: LLVM's.
        signed: of an integer, whether it has a sign.
    """

    name: str
    type: str
    signed: bool

    def __call__(self, x: Any) -> Any:
        """A number of this kind."""
        if not isinstance(x, Value):
            return getattr(np, self.name)(x)
        if x.op.type == self.type:
            return Value(x.ops, x.op, self.signed)
        return Value(x.ops, x.ops.made(self._conversion(x), x.op, of_type=self.type), self.signed)

    def _conversion(self, x: Value) -> str:
        """LLVM's name of a conversion."""
        wider = _BITS[self.type] > _BITS[x.op.type]
        if self.type in _FLOATS and x.op.type in _FLOATS:
            return "fpext" if wider else "fptrunc"
        if self.type in _FLOATS:
            return "sitofp" if x.signed else "uitofp"
        if x.op.type in _FLOATS:
            return "fptosi" if self.signed else "fptoui"
        if not wider:
            return "trunc"
        return "sext" if x.signed else "zext"


KINDS: Final = {name: Kind(name, *what) for name, what in _TYPES.items()}


def constant(ops: Ops, x: Any) -> Value:
    """A number of NumPy's or Python's as a value."""
    kind = KINDS[np.asarray(x).dtype.name]
    if kind.type in _FLOATS:
        return Value(ops, ops.number(float(x), kind.type))
    return Value(ops, ops.word(int(x), kind.type), kind.signed)


def functions(module: ModuleType, ops: Ops) -> dict[str, Any]:
    """The functions of a module, which make instructions of the values that they are given.

    Args:
        module: `elementary` or `philox`: no branch, no loop but over constants.
        ops: where they are made.
    """
    space = dict(vars(module))
    space.update(_arithmetic(ops))
    for name, function in vars(module).items():
        if isinstance(function, FunctionType) and name not in _NAMES:
            space[name] = FunctionType(function.__code__, space, name)
    return space


_NAMES: Final = ("select", "fma", "bits", "number", "polynomial")


def _arithmetic(ops: Ops) -> dict[str, Any]:
    """What modules that are traced call besides operators."""

    def op_of(x: Any) -> Op:
        return x.op if isinstance(x, Value) else constant(ops, x).op

    def select(condition: Any, yes: Any, no: Any) -> Value:
        signed = all(value.signed for value in (yes, no) if isinstance(value, Value))
        return Value(ops, ops.selected(condition.op, op_of(yes), op_of(no)), signed)

    def fma(a: Any, b: Any, c: Any) -> Value:
        return Value(ops, ops.made("fma", op_of(a), op_of(b), op_of(c)))

    def sqrt(x: Value) -> Value:
        return Value(ops, ops.made("sqrt", x.op))

    def bits(x: Value) -> Value:
        return x.view(KINDS["uint64"])

    def number(x: Value) -> Value:
        return x.view(KINDS["float64"])

    def polynomial(x: Value, coefficients: tuple[float, ...]) -> Value:
        """Even and odd powers apart, so that half as many roundings wait for each other."""
        square = x * x
        halves: list[Value] = []
        for *lower, last in (coefficients[0::2], coefficients[1::2]):
            value = constant(ops, last)
            for coefficient in reversed(lower):
                value = fma(value, square, coefficient)
            halves.append(value)
        return fma(halves[1], x, halves[0])

    numpy = SimpleNamespace(**KINDS, sqrt=sqrt, inf=np.inf, nan=np.nan)
    made = (select, fma, bits, number, polynomial)
    return {"np": numpy, **{function.__name__: function for function in made}}
