"""From the options of a plant to a `System`.

Plants are x' = f(x, u), z = h(x): linear ones (14), (15), (37)-(39) and known nonlinear ones share
one shape. Formulas in a scenario file, such as "-g / l * sin(angle) + torque", are read safely into
CasADi expressions.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.linalg.matrices import Matrices
from undeadzone.plants.options import Plant, linear_matrices
from undeadzone.plants.system import System, linearise_plant
from undeadzone.util.arrays import (
    LARGEST,
    Array,
    Floats,
    require_number,
    require_vector,
)
from undeadzone.util.text import suggest_name

# Each form by its leading key, and the keys that belong to it.
_FORMS = {
    "A": ("B", "C"),
    "second_order": (),
    "companion": (),
    "integrators": (),
    "transfer_function": (),
    "f": ("h", "states", "inputs", "parameters", "x_eq", "u_eq"),
    "arm": ("parameters", "x_eq", "u_eq"),
    "kind": (),
}
_BINARY: dict[type, Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type, Any] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
_ELSEWHERE = {"abs": "fabs", "min": "fmin", "max": "fmax"}  # what CasADi calls by another name
_OF_ONE = "sin cos tan asin acos atan sinh cosh tanh exp log sqrt abs sign"  # with one argument
_OF_TWO = ("min", "max", "atan2")  # with two
_NAMES = (*_OF_ONE.split(), *_OF_TWO)
_FUNCTIONS = {name: getattr(ca, _ELSEWHERE.get(name, name)) for name in _NAMES}
_CONSTANTS = {"pi": math.pi}
LATEST = 1000  # samples by which an input may act late


def system(plant: Plant, key: str = "plant") -> System:
    """Return the continuous-time `System` of a plant.

    Args:
        plant: the plant in words.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if not 0 <= plant.delay <= LATEST:
        raise InputError(f"{key}.delay: expected 0 to {LATEST} samples, found {plant.delay}")
    return _build_undelayed(plant, key)._replace(delay=plant.delay)


def _build_undelayed(plant: Plant, key: str) -> System:
    """Return the `System` of a plant whose input acts at once. Raises InputError."""
    form = _require_one_form(plant, key)
    if plant.f is not None:
        return _build_nonlinear(plant, key)
    if plant.arm is not None:
        from undeadzone.plants.robots.build import build_robot_plant

        return build_robot_plant(plant, plant.arm, key)
    linear = linear_matrices(plant, key)
    if not all(np.abs(part).max(initial=0.0) < LARGEST**2 for part in linear):
        raise InputError(f"{key}.{form}: its numbers are too far apart to compute with")
    return System(linear, _move_linear, _output_linear, linear, nonlinear=False)


def initial_state(plant: Plant, system: System) -> Floats:
    """Return x(0) (n), zeros by default, for gears also from a state of the links alone.

    Raises ShapeError.
    """
    if system.gears is not None:
        from undeadzone.plants.robots.build import require_geared_start

        return require_geared_start(system.gears, plant.x0, "plant.x0")
    return _vector_or_zeros("plant.x0", plant.x0, system.n, "one per state")


def _require_one_form(plant: Plant, key: str) -> str:
    """Return the leading key of the plant's form.

    Raises InputError if keys of another form are given.
    """
    forms = [form for form in _FORMS if getattr(plant, form) is not None]
    if len(forms) != 1:
        present = " and ".join(forms) or "none"
        raise InputError(f"{key}: give exactly one form ({', '.join(_FORMS)}), found {present}")
    (form,) = forms
    known = {form, *_FORMS[form], "x0", "delay"}
    for name in Plant.__struct_fields__:
        value = getattr(plant, name)
        absent = value is None or (name == "parameters" and not value)
        if not absent and name not in known:
            raise InputError(
                f"{key}.{name}: has no meaning for a plant given by {form}. Remove one of them"
            )
    return form


def _move_linear(params: Matrices, x: Any, u: Any) -> Any:
    """Return x' (or x+) = A x + B u."""
    return params.A @ x + params.B @ u


def _output_linear(params: Matrices, x: Any) -> Any:
    """Return z = C x."""
    return params.C @ x


# Of a nonlinear plant: how many states, how many inputs, (params, x, u) -> x', (params, x) -> z.
_Functions = tuple[int, int, Callable[[Any, Any, Any], Any], Callable[[Any, Any], Any]]


def _build_nonlinear(plant: Plant, key: str) -> System:
    """Return the system of formulas, or of Python callables, f and h."""
    names = list(plant.parameters)
    if callable(plant.f) != callable(plant.h):
        raise InputError(f"{key}: f and h must both be formulas or both be callables")
    n, m, move, output = (
        _wrap_callables(plant, key) if callable(plant.f) else _build_formulas(plant, key)
    )
    params = np.array(
        [require_number(f"{key}.parameters.{name}", plant.parameters[name]) for name in names]
    )
    x_eq = _vector_or_zeros(f"{key}.x_eq", plant.x_eq, n, "one per state")
    u_eq = _vector_or_zeros(f"{key}.u_eq", plant.u_eq, m, "one per input")
    return linearise_plant(key, params, move, output, x_eq, u_eq)._replace(names=tuple(names))


def _wrap_callables(plant: Plant, key: str) -> _Functions:
    """Return the functions of a plant that contains f and h as Python callables."""
    if plant.states is not None:
        n = len(plant.states)
    elif plant.x0 is not None:
        n = np.size(plant.x0)
    else:
        raise InputError(f"{key}: a plant given by callables needs x0 or states, to know its order")
    m = len(plant.inputs) if plant.inputs is not None else 1

    def move(params: Any, x: Any, u: Any) -> Any:
        """Return x' by the callable f."""
        return ca.SX(plant.f(x, u))

    def output(params: Any, x: Any) -> Any:
        """Return z by the callable h."""
        return ca.SX(plant.h(x))

    return n, m, move, output


def _build_formulas(plant: Plant, key: str) -> _Functions:
    """Return the functions of a plant that contains f and h as formulas in a scenario."""
    _require_formulas(plant, key)
    states = plant.states or []
    inputs = plant.inputs or ["u"]
    names = list(plant.parameters)

    def scope(params: Any, x: Any) -> dict[str, Any]:
        """Return the values of states and parameters by name."""
        values = [*ca.vertsplit(x), *ca.vertsplit(params)]
        return dict(zip([*states, *names], values, strict=True))

    def move(params: Any, x: Any, u: Any) -> Any:
        """Return x' by the formulas f."""
        bound = scope(params, x) | dict(zip(inputs, ca.vertsplit(u), strict=True))
        return _evaluate_column(f"{key}.f", plant.f, bound)

    def output(params: Any, x: Any) -> Any:
        """Return z by the formulas h."""
        return _evaluate_column(f"{key}.h", plant.h, scope(params, x))

    return len(states), len(inputs), move, output


def _evaluate_column(key: str, formulas: list[str], names: dict[str, Any]) -> Any:
    """Return the values of formulas, as a CasADi column."""
    values = [evaluate_formula(f"{key}[{i}]", text, names) for i, text in enumerate(formulas)]
    return ca.vertcat(*values)


def _require_formulas(plant: Plant, key: str) -> None:
    """Raise InputError or ShapeError unless f and h are formulas.

    There must be one of f per state, and no name may come twice.
    """
    states = plant.states
    inputs = plant.inputs or ["u"]
    names = list(plant.parameters)
    if not (isinstance(plant.f, list) and isinstance(plant.h, list) and states):
        raise InputError(f"{key}: formulas need lists f and h and the names in states (and inputs)")
    if len(plant.f) != len(states):
        raise ShapeError(
            f"{key}.f: expected {len(states)} formulas (one per state), found {len(plant.f)}"
        )
    if len({*states, *inputs, *names}) < len(states) + len(inputs) + len(names):
        raise InputError(f"{key}: a name is used twice among states, inputs and parameters")
    if not all(isinstance(text, str) for text in [*plant.f, *plant.h]) or not plant.h:
        raise InputError(
            f"{key}: every entry of f and h must be a formula in quotes, and h must not be empty"
        )


def _vector_or_zeros(key: str, value: Array | None, size: int, why: str) -> Floats:
    """Return a vector of that size from the user, or zeros.

    Raises ShapeError.
    """
    return np.zeros(size) if value is None else require_vector(key, value, size, why)


class _Formula(NamedTuple):
    """Formula to be evaluated: the key of its place, its text, the values of its names."""

    key: str
    text: str
    names: Mapping[str, Any]


def evaluate_formula(key: str, text: str, names: Mapping[str, Any]) -> Any:
    """Return the value of a formula of arithmetic and elementary functions.

    Args:
        key: key of the formula, for messages.
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
        return _finite_value(formula, tree.body)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise _formula_error(formula, "cannot be read") from None
    except (NotImplementedError, TypeError):  # of CasADi
        raise _formula_error(formula, "a function does not take these arguments") from None
    except (ZeroDivisionError, OverflowError):
        raise _formula_error(formula, "a constant part is not a finite real number") from None


def _finite_value(formula: _Formula, node: ast.expr) -> Any:
    """Return the value of a part of a formula.

    Raises OverflowError if it is not finite and real.
    """
    value = _evaluate_node(formula, node)
    if isinstance(value, complex) or (isinstance(value, float) and not math.isfinite(value)):
        raise OverflowError
    return value


def _evaluate_node(formula: _Formula, node: ast.expr) -> Any:
    """Return the value of a part of a formula, finite or not."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id=name):
            return _lookup_name(formula, name)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](_finite_value(formula, left), _finite_value(formula, right))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
            return _UNARY[type(op)](_finite_value(formula, operand))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            if name not in _FUNCTIONS:
                raise _unknown_name_error(formula, name, list(_FUNCTIONS))
            if len(args) != (2 if name in _OF_TWO else 1):  # CasADi does not always refuse them
                raise _formula_error(formula, "a function has the wrong number of arguments")
            return _FUNCTIONS[name](*[_finite_value(formula, arg) for arg in args])
    raise _formula_error(
        formula,
        f"found {ast.unparse(node)!r:.80}",
        ". Only numbers, names, + - * / ** and elementary functions are allowed",
    )


def _lookup_name(formula: _Formula, name: str) -> Any:
    """Return the value of a name. The plant's own names hide the constants."""
    if name in formula.names:
        return formula.names[name]
    if name in _CONSTANTS:
        return _CONSTANTS[name]
    raise _unknown_name_error(formula, name, [*formula.names, *_CONSTANTS])


def _unknown_name_error(formula: _Formula, name: str, known: list[str]) -> InputError:
    """Return the error for an unknown name, with the nearest known name."""
    advice = suggest_name(name, known, "Known names:")
    return _formula_error(formula, f"unknown name {name!r}", f". {advice}")


def _formula_error(formula: _Formula, what: str, advice: str = "") -> InputError:
    """Return the error for a formula."""
    return InputError(f"{formula.key}: {what} in formula {formula.text!r:.80}{advice}")
