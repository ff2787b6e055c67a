"""Formulas in a scenario file, read safely into CasADi expressions.

An example is "-g / l * sin(angle) + torque".
"""

from __future__ import annotations

import ast
import difflib
import math
import operator
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.errors import InputError

_BINARY: dict[type, Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type, Any] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
_FUNCTIONS = {
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": ca.asin,
    "acos": ca.acos,
    "atan": ca.atan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "exp": ca.exp,
    "log": ca.log,
    "sqrt": ca.sqrt,
    "abs": ca.fabs,
    "sign": ca.sign,
    "min": ca.fmin,
    "max": ca.fmax,
    "atan2": ca.atan2,
}
_OF_TWO = ("min", "max", "atan2")  # these take two arguments, the others one
_CONSTANTS = {"pi": math.pi}


class _Formula(NamedTuple):
    """A formula to be evaluated: the key where it stands, its text, the values of its names."""

    key: str
    text: str
    names: Mapping[str, Any]


def evaluate(key: str, text: str, names: Mapping[str, Any]) -> Any:
    """The value of a formula; only arithmetic and elementary functions.

    Args:
        key: where the formula stands, for messages.
        text: the formula.
        names: numbers or CasADi expressions, by name.

    Raises:
        InputError: the formula cannot be read, or is not finite.
    """
    formula = _Formula(key, text, names)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # of Python's own grammar: "1if 2"
            tree = ast.parse(text.strip(), mode="eval")
        return _value(formula, tree.body)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise _refused(formula, "cannot be read") from None
    except (NotImplementedError, TypeError):  # of CasADi
        raise _refused(formula, "a function does not take these arguments") from None
    except (ZeroDivisionError, OverflowError):
        raise _refused(formula, "a constant part is not a finite real number") from None


def _value(formula: _Formula, node: ast.expr) -> Any:
    """The value of a part of a formula. Raises OverflowError where that number is not finite."""
    value = _compute(formula, node)
    if isinstance(value, complex) or (isinstance(value, float) and not math.isfinite(value)):
        raise OverflowError
    return value


def _compute(formula: _Formula, node: ast.expr) -> Any:
    """The value of a part of a formula, finite or not."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id=name):
            return _named(formula, name)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](_value(formula, left), _value(formula, right))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
            return _UNARY[type(op)](_value(formula, operand))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            if name not in _FUNCTIONS:
                raise _unknown(formula, name, list(_FUNCTIONS))
            if len(args) != (2 if name in _OF_TWO else 1):  # CasADi does not always refuse them
                raise _refused(formula, "a function has the wrong number of arguments")
            return _FUNCTIONS[name](*[_value(formula, arg) for arg in args])
    raise _refused(
        formula,
        f"found {ast.unparse(node)!r:.80}",
        "; only numbers, names, + - * / ** and elementary functions are allowed",
    )


def _named(formula: _Formula, name: str) -> Any:
    """What a name stands for; the plant's own names hide the constants."""
    if name in formula.names:
        return formula.names[name]
    if name in _CONSTANTS:
        return _CONSTANTS[name]
    raise _unknown(formula, name, [*formula.names, *_CONSTANTS])


def _unknown(formula: _Formula, name: str, known: list[str]) -> InputError:
    """An unknown name, with the nearest known one."""
    near = difflib.get_close_matches(name, known, 1)
    advice = f"did you mean {near[0]!r}?" if near else f"known names: {', '.join(known)}"
    return _refused(formula, f"unknown name {name!r}", f"; {advice}")


def _refused(formula: _Formula, what: str, advice: str = "") -> InputError:
    """What is wrong with a formula."""
    return InputError(f"{formula.key}: {what} in formula {formula.text!r:.80}{advice}")
