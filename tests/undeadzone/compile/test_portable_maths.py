"""The elementary functions of the export against extended precision."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from undeadzone.compile.elementary import (
    FUNCTIONS,
    build_elementary,
    called_functions,
    required_functions,
)
from undeadzone.compile.numpy_reference import elementary_functions
from undeadzone.compile.print_c import Style, elementary_texts

POINTS = 100_000
LONG: Any = np.longdouble
needs_extended = pytest.mark.skipif(
    np.finfo(LONG).nmant <= 52, reason="long double is no wider than double on this machine"
)

# Range, errors in units of the last place (single, double).
BARS: dict[str, tuple[tuple[float, float], float, float]] = {
    "exp": ((-80.0, 80.0), 4, 2), "log": ((1e-6, 1e3), 4, 2),
    "sin": ((-100.0, 100.0), 4, 2), "cos": ((-100.0, 100.0), 4, 2),
    "expm1": ((-5.0, 5.0), 4, 4), "log1p": ((-0.9, 10.0), 4, 4), "tan": ((-100.0, 100.0), 4, 4),
    "atan": ((-50.0, 50.0), 4, 2), "asin": ((-1.0, 1.0), 4, 4), "acos": ((-1.0, 1.0), 4, 4),
    "sinh": ((-30.0, 30.0), 4, 4), "cosh": ((-30.0, 30.0), 4, 4), "tanh": ((-10.0, 10.0), 4, 4),
    "asinh": ((-50.0, 50.0), 4, 4), "acosh": ((1.0, 50.0), 4, 4), "atanh": ((-0.99, 0.99), 4, 4),
}  # fmt: skip
NUMPY = {
    "asin": "arcsin",
    "acos": "arccos",
    "atan": "arctan",
    "asinh": "arcsinh",
    "acosh": "arccosh",
    "atanh": "arctanh",
}


def real(single: bool) -> Any:
    return np.float32 if single else np.float64


def points(low: float, high: float, single: bool) -> Any:
    """Random numbers of a range, half of them small ones."""
    rng = np.random.default_rng(0)
    spread = rng.uniform(low, high, POINTS // 2)
    small = spread * 2.0 ** -rng.uniform(0, 12, POINTS // 2)
    inside = np.clip(np.concatenate([spread, small]), low, high)
    return inside.astype(real(single))


@needs_extended
@pytest.mark.parametrize("single", [True, False], ids=["single", "double"])
@pytest.mark.parametrize("name", BARS)
def test_errors_in_units_of_the_last_place(name: str, single: bool) -> None:
    (low, high), *bars = BARS[name]
    x = points(low, high, single)
    with np.errstate(all="ignore"):
        values = elementary_functions(real(single).__name__)[name](x)
        expected = getattr(np, NUMPY.get(name, name))(x.astype(LONG))
        unit = np.spacing(np.abs(expected.astype(real(single))))
        error = np.abs(values.astype(LONG) - expected) / np.maximum(unit, np.finfo(x.dtype).tiny)
    assert values.dtype == x.dtype
    assert float(error.max()) < bars[0 if single else 1]


def test_erf_and_atan2_and_pow() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-5, 5, (2, 20_000))
    with np.errstate(all="ignore"):
        for single, bar in ((True, 3e-7), (False, 1e-15)):
            kind = real(single)
            a, b = x.astype(kind), y.astype(kind)
            expected = np.array([math.erf(value) for value in a.astype(float)])
            assert np.abs(elementary_functions(kind.__name__)["erf"](a) - expected).max() < bar
            expected = np.arctan2(a.astype(float), b.astype(float))
            assert (
                np.abs(elementary_functions(kind.__name__)["atan2"](a, b) - expected).max()
                < 2 * bar
            )
            expected = np.abs(a.astype(float)) ** b.astype(float)
            error = np.abs(elementary_functions(kind.__name__)["pow"](np.abs(a), b) / expected - 1)
            assert error.max() < 16 * np.finfo(kind).eps * 8


def test_erf_by_the_exponential_of_its_square() -> None:
    """Absolute errors as of erf itself, whatever the argument; in double it is erf."""
    f = elementary_functions("float32")
    x = np.concatenate([points(-6.0, 6.0, True), np.float32([0.0, 1e-30, 1e30, np.inf, -np.inf])])
    with np.errstate(all="ignore"):
        values = f["erf_by_exp"](x, f["exp"](-(x * x)))
        assert np.isnan(f["erf_by_exp"](np.float32(np.nan), np.float32(np.nan)))
    expected = np.array([math.erf(value) for value in x.tolist()])
    assert values.dtype == np.float32
    assert np.abs(values - expected).max() < 3e-7
    assert values[-5] == 0
    assert values[-3:].tolist() == [1.0, 1.0, -1.0]
    double, y = elementary_functions("float64"), np.array([0.3])
    assert double["erf_by_exp"](y, np.nan * y) == double["erf"](y)


def test_exp_in_single_is_never_subnormal() -> None:
    """To 2^-126 it is exact to its last places, and 0 from there on."""
    x = np.linspace(-120.0, -80.0, 20_001, dtype=np.float32)
    with np.errstate(all="ignore"):
        values = elementary_functions("float32")["exp"](x)
    exact = np.exp(x.astype(float))
    positive = values > 0
    assert (values[positive] >= np.finfo(np.float32).tiny).all()
    assert np.abs(values[positive] / exact[positive] - 1).max() < 3e-7
    assert exact[~positive].max() < 2 * np.finfo(np.float32).tiny


@pytest.mark.parametrize("single", [True, False], ids=["single", "double"])
def test_edges(single: bool) -> None:
    f, kind = elementary_functions(real(single).__name__), real(single)
    inf, nan = kind(np.inf), kind(np.nan)
    with np.errstate(all="ignore"):
        assert f["exp"](inf) == inf
        assert f["exp"](-inf) == 0
        assert f["log"](kind(0)) == -inf
        assert f["log"](inf) == inf
        assert (
            abs(
                f["log"](np.finfo(kind).smallest_subnormal)
                - math.log(float(np.finfo(kind).smallest_subnormal))
            )
            < 1e-4
        )
        assert np.isnan(f["log"](kind(-1)))
        for name in ("exp", "log", "erf", "sin", "cos", "tanh", "atan"):
            assert np.isnan(f[name](nan)), name
        assert f["erf"](inf) == 1
        assert f["tanh"](-inf) == -1
        assert f["erf"](kind(0)) == 0
        assert f["pow"](kind(-2), kind(3)) == pytest.approx(-8, rel=1e-5)
        assert np.isnan(f["pow"](kind(-2), kind(0.5)))
        assert f["floor"](kind(-0.5)) == -1
        assert f["ceil"](kind(2.5)) == 3


def test_a_function_brings_along_what_it_calls_and_nothing_else() -> None:
    assert required_functions({"log1p"}) == ["log", "log1p"]
    assert required_functions({"bits"}) == []
    texts = elementary_texts(["exp"], {"exp"}, Style("float32", "o"))
    assert [text.split("(")[0].split()[-1] for text in texts] == ["o_bits", "o_number", "o_exp"]
    assert len(elementary_texts(["hypot"], {"hypot"}, Style("float32", "o"))) == 1
    order = list(FUNCTIONS)
    for name in FUNCTIONS:
        calls = called_functions([build_elementary(name, "float64").results]) & FUNCTIONS.keys()
        assert all(order.index(other) < order.index(name) for other in calls)
