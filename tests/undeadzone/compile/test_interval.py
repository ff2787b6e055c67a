"""Interval arithmetic: no point of a box escapes, and bounds of smooth functions are tight."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from undeadzone.compile import interval as arithmetic
from undeadzone.compile.interval import SMOOTH, Interval
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats

UNARY: dict[str, Callable[[Any], Any]] = {
    "negative": np.negative,
    "absolute": np.abs,
    "square": np.square,
    "inverse": np.reciprocal,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "cosh": np.cosh,
}
BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": np.add,
    "subtract": np.subtract,
    "product": np.multiply,
    "quotient": np.divide,
    "minimum": np.minimum,
    "maximum": np.maximum,
}
ends = st.floats(-20.0, 20.0)


def box(a: float, b: float) -> Interval:
    """The interval between two numbers."""
    return Interval(np.array(min(a, b)), np.array(max(a, b)))


def within(a: Interval) -> Floats:
    """Points of an interval, its ends among them."""
    share = np.linspace(0.0, 1.0, 41)
    return np.clip(a.low + share * (a.high - a.low), a.low, a.high)


# Functions of the module whose names say of what they are.
NAMES = {
    "add": "add_intervals",
    "subtract": "subtract_intervals",
    "negative": "negate_interval",
    "product": "multiply_intervals",
    "quotient": "divide_intervals",
    "inverse": "invert_interval",
    "square": "square_interval",
    "absolute": "absolute_interval",
    "minimum": "interval_minimum",
    "maximum": "interval_maximum",
}


def holds(bound: Interval, values: Floats) -> bool:
    """Whether all values that are numbers lie between the bounds."""
    values = values[~np.isnan(values)]
    return bool(((bound.low <= values) & (values <= bound.high)).all())


@pytest.mark.parametrize("name", UNARY)
@given(ends, ends)
def test_no_value_of_a_function_escapes(name: str, a: float, b: float) -> None:
    x = box(a, b)
    with np.errstate(all="ignore"):
        assert holds(getattr(arithmetic, NAMES.get(name, name))(x), UNARY[name](within(x)))


@pytest.mark.parametrize("name", BINARY)
@given(ends, ends, ends, ends)
def test_no_value_of_an_operation_escapes(
    name: str, a: float, b: float, c: float, d: float
) -> None:
    x, y = box(a, b), box(c, d)
    with np.errstate(all="ignore"):
        values = BINARY[name](within(x)[:, None], within(y))
        assert holds(getattr(arithmetic, NAMES.get(name, name))(x, y), values.ravel())


@pytest.mark.parametrize("exponent", [1, 2, 3, 7, -1, -2, 0.5, 17])
@given(st.floats(0.1, 3.0), st.floats(0.1, 3.0))
def test_no_power_escapes(exponent: float, a: float, b: float) -> None:
    x = box(a, b)
    assert holds(arithmetic.interval_power(x, box(exponent, exponent)), within(x) ** exponent)


def test_waves_reach_their_peaks_where_the_interval_does() -> None:
    assert arithmetic.sin(box(0.0, 2.0)).high == 1.0
    assert arithmetic.sin(box(0.0, 1.5)).high == pytest.approx(np.sin(1.5))
    assert arithmetic.cos(box(3.0, 4.0)).low == -1.0
    assert arithmetic.cos(box(-0.1, 7.0)) == (-1.0, 1.0)


def test_beyond_its_domain_a_function_has_no_bound() -> None:
    with np.errstate(all="ignore"):
        assert arithmetic.log(box(-1.0, 1.0)) == (-np.inf, np.inf)
        assert arithmetic.asin(box(0.0, 1.1)) == (-np.inf, np.inf)
        assert arithmetic.invert_interval(box(-1.0, 1.0)) == (-np.inf, np.inf)


def test_nothing_times_anything_is_nothing() -> None:
    with np.errstate(all="ignore"):
        assert arithmetic.multiply_intervals(box(0.0, 0.0), box(-np.inf, np.inf)) == (0.0, 0.0)


def test_what_is_exact_is_not_widened() -> None:
    assert arithmetic.add_intervals(box(0.5, 1.0), box(0.25, 2.0)) == (0.75, 3.0)
    assert arithmetic.double_interval(box(0.1, 0.2)) == (0.2, 0.4)


def test_conditions_are_decided_or_refused() -> None:
    assert arithmetic.compare_less(box(0.0, 1.0), box(2.0, 3.0)).low == 1.0
    assert arithmetic.compare_at_most(box(2.0, 3.0), box(0.0, 1.0)).high == 0.0
    assert arithmetic.compare_equal(box(1.0, 1.0), box(1.0, 1.0)).low == 1.0
    assert arithmetic.compare_unequal(box(1.0, 1.0), box(2.0, 3.0)).low == 1.0
    assert arithmetic.interval_sign(box(-2.0, -1.0)).high == -1.0
    with pytest.raises(InputError, match=SMOOTH):
        arithmetic.compare_less(box(0.0, 2.0), box(1.0, 3.0))


def test_the_exact_exponential_lies_between_its_bounds() -> None:
    """In forty digits: NumPy's own value is rounded."""
    with localcontext() as context:
        context.prec = 40
        for x in np.linspace(-20.0, 20.0, 401):
            bound = arithmetic.exp(box(x, x))
            assert Decimal(float(bound.low)) < Decimal(float(x)).exp() < Decimal(float(bound.high))
            assert float(bound.high - bound.low) <= 1e-14 * float(bound.high)
