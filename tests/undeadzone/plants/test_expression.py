"""Formulas: equal to Python's own arithmetic on random expressions; nothing else gets in."""

from __future__ import annotations

import math
from contextlib import suppress

import casadi as ca
import pytest
from hypothesis import given
from hypothesis import strategies as st

from undeadzone.errors import InputError
from undeadzone.plants.build import _FUNCTIONS, evaluate_formula

NUMPY_NAMES = {
    name: getattr(math, name) for name in ("sin", "cos", "tanh", "atan", "atan2", "pi")
} | {"abs": abs, "min": min, "max": max}
leaves = st.sampled_from(["x", "y", "pi", "2", "0.5", "1e-1"])
formulas = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        st.tuples(inner, inner).map(lambda t: f"{t[0]} / (2 + sin({t[1]}))"),
        st.tuples(st.sampled_from(["sin", "cos", "tanh", "atan", "abs", "-", "+"]), inner).map(
            lambda t: f"{t[0]}({t[1]})"
        ),
        st.tuples(st.sampled_from(["min", "max", "atan2"]), inner, inner).map(
            lambda t: f"{t[0]}({t[1]}, {t[2]})"
        ),
        inner.map(lambda text: f"({text}) ** 2"),
    ),
    max_leaves=12,
)


@given(formulas, st.floats(-3, 3), st.floats(-3, 3))
def test_equals_pythons_arithmetic_in_numbers_and_symbols(text: str, x: float, y: float) -> None:
    expected = eval(text, {"__builtins__": {}}, NUMPY_NAMES | {"x": x, "y": y})
    symbols = ca.SX.sym("x"), ca.SX.sym("y")
    function = ca.Function(
        "f", [*symbols], [evaluate_formula("f", text, dict(zip("xy", symbols, strict=True)))]
    )
    assert float(evaluate_formula("f", text, {"x": x, "y": y})) == pytest.approx(
        expected, rel=1e-12, abs=1e-12
    )
    assert float(function(x, y)) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-2 ** 2", -4.0),
        ("2 * pi", 2 * math.pi),
        ("sqrt(2)", math.sqrt(2)),
        (" 1 + 1\n", 2.0),
        ("(1\n + 1)", 2.0),
        ("sign(-3) + exp(0) + log(1)", 0.0),
    ],
)
def test_values(text: str, value: float) -> None:
    assert float(evaluate_formula("f", text, {})) == pytest.approx(value)


def test_names_of_the_plant_hide_constants() -> None:
    assert evaluate_formula("f", "pi", {"pi": 3.0}) == 3.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("angel", "unknown name 'angel' in formula 'angel'. Did you mean 'angle'"),
        ("zzz", "unknown name 'zzz' in formula 'zzz'. Known names: angle, pi"),
        ("sinn(angle)", "Did you mean 'sin'"),
        ("__import__('os')", "unknown name '__import__'"),
        ("angle.__class__", "found 'angle.__class__' in formula .*. Only numbers, names"),
        ("(lambda: 1)()", "Only numbers, names"),
        ("[1]", "Only numbers, names"),
        ("'text'", "Only numbers, names"),
        ("True", "Only numbers, names"),
        ("angle if angle else 1", "Only numbers, names"),
        ("angle > 0", "Only numbers, names"),
        ("sin(angle, angle)", "wrong number of arguments"),
        ("sin()", "wrong number of arguments"),
        ("atan2(1)", "wrong number of arguments"),
        ("atan2(angle)", "wrong number of arguments"),
        ("atan2(1, 2, 3)", "wrong number of arguments"),
        ("min(angle)", "wrong number of arguments"),
        ("(1).__class__", "Only numbers, names"),
        ("f'{angle}'", "Only numbers, names"),
        ("abs(*angle)", "Only numbers, names"),
        ("angle[0]", "Only numbers, names"),
        ("(yield)", "cannot be read|Only numbers, names"),
        ("eval('1')", "unknown name 'eval'"),
        ("angle(1)", "unknown name 'angle'"),
        ("sin(x=angle)", "Only numbers, names"),
        ("1 +", "cannot be read"),
        ("", "cannot be read"),
        ("a = 1", "cannot be read"),
        ("\0", "cannot be read"),
        ("(" * 500 + "1" + ")" * 500, "cannot be read"),
        ("+".join(["angle"] * 5000), "cannot be read"),
        ("1 / 0", "not a finite real number"),
        ("10 ** 400", "not a finite real number"),
        ("1e999", "not a finite real number"),
        ("(-1) ** 0.5", "not a finite real number"),
        ("sqrt(-1)", "not a finite real number"),
        ("log(0) * 0", "not a finite real number"),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=f"(?s)^plant.f.0.: .*{words}") as error:
        evaluate_formula("plant.f[0]", text, {"angle": ca.SX.sym("angle")})
    assert len(str(error.value)) < 300


def test_what_python_would_warn_of_is_not_printed(recwarn: pytest.WarningsRecorder) -> None:
    with pytest.raises(InputError):
        evaluate_formula("f", "abs(1)if 1else 2", {})
    assert not list(recwarn)


ARGUMENTS = ("1", "angle", "-2.5", "0")


@pytest.mark.parametrize("name", _FUNCTIONS)
@pytest.mark.parametrize("count", range(4))
def test_functions_of_any_number_of_arguments(name: str, count: int) -> None:
    for first in ARGUMENTS:
        text = f"{name}({', '.join([first, '1', '0.5'][:count])})"
        with suppress(InputError):
            value = evaluate_formula("f", text, {"angle": ca.SX.sym("angle")})
            assert isinstance(value, float | ca.SX), text


@given(st.text(max_size=30))
def test_any_text_is_a_value_or_an_input_error(text: str) -> None:
    with suppress(InputError):
        assert isinstance(evaluate_formula("f", text, {"x": ca.SX.sym("x")}), float | ca.SX)
