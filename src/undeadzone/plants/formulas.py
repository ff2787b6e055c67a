"""Formulas in a scenario file, such as "-g / l * sin(angle) + torque", read safely into CasADi expressions."""

from __future__ import annotations

import ast
import difflib
import math
import operator
from collections.abc import Mapping
from typing import Any

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
    "sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "asin": ca.asin, "acos": ca.acos, "atan": ca.atan,
    "sinh": ca.sinh, "cosh": ca.cosh, "tanh": ca.tanh, "exp": ca.exp, "log": ca.log, "sqrt": ca.sqrt,
    "abs": ca.fabs, "sign": ca.sign, "min": ca.fmin, "max": ca.fmax, "atan2": ca.atan2,
}  # fmt: skip
_CONSTANTS = {"pi": math.pi}


def evaluate(key: str, text: str, names: Mapping[str, Any]) -> Any:
    """The value of formula `text` with `names` bound; only arithmetic and elementary functions. Raises InputError."""

    def fail(what: str, advice: str = "") -> InputError:
        return InputError(f"{key}: {what} in formula {text!r:.80}{advice}")

    def unknown(name: str, known: list[str]) -> InputError:
        near = difflib.get_close_matches(name, known, 1)
        return fail(
            f"unknown name {name!r}",
            f"; did you mean {near[0]!r}?" if near else f"; known names: {', '.join(known)}",
        )

    def value(node: ast.expr) -> Any:
        found = compute(node)
        if isinstance(found, complex) or (isinstance(found, float) and not math.isfinite(found)):
            raise OverflowError
        return found

    def compute(node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return float(number)
            case ast.Name(id=name):
                if name not in names and name not in _CONSTANTS:
                    raise unknown(name, [*names, *_CONSTANTS])
                return names[name] if name in names else _CONSTANTS[name]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return _BINARY[type(op)](value(left), value(right))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
                return _UNARY[type(op)](value(operand))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                if name not in _FUNCTIONS:
                    raise unknown(name, list(_FUNCTIONS))
                return _FUNCTIONS[name](*map(value, args))
        raise fail(
            f"found {ast.unparse(node)!r:.80}",
            "; only numbers, names, + - * / ** and elementary functions are allowed",
        )

    try:
        return value(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise fail("cannot be read") from None
    except (NotImplementedError, TypeError):
        raise fail("a function has the wrong number of arguments") from None
    except (ZeroDivisionError, OverflowError):
        raise fail("a constant part is not a finite real number") from None
