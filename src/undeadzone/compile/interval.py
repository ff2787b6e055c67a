"""Bounds of a CasADi SX graph on boxes of its inputs (Moore 1966).

Every bound is rounded outwards. Functions take intervals of any shape and act entry by entry.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile.casadi_reader import Program, evaluate_program, read_program
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats

PAD = 16 * np.finfo(float).eps  # relative error of NumPy's elementary functions, amply
SLACK = 1e-12  # of an argument of sine or cosine, relative: far more than its rounding
POWERS = 16  # whole exponents up to it are computed by products
SMOOTH = (
    "a condition, sign, abs, min or max changes within the bounds. "
    "Only smooth functions can be bounded"
)


class Interval(NamedTuple):
    """Interval between two numbers, entry by entry.

    Attributes:
        low: the least value.
        high: the greatest value.
    """

    low: Floats
    high: Floats


def _round_outward(low: Floats, high: Floats) -> Interval:
    """Return the bounds widened by a rounding. A bound that is not a number becomes infinite."""
    return Interval(
        np.where(np.isnan(low), -np.inf, np.nextafter(low, -np.inf)),
        np.where(np.isnan(high), np.inf, np.nextafter(high, np.inf)),
    )


def _unbound_unless(condition: np.ndarray, a: Interval) -> Interval:
    """Return the interval if the condition holds, else an unbounded interval, entry by entry."""
    return Interval(np.where(condition, a.low, -np.inf), np.where(condition, a.high, np.inf))


def _set_zero_where(condition: np.ndarray, a: Interval) -> Interval:
    """Return 0 if the condition holds, else the interval, entry by entry."""
    return Interval(np.where(condition, 0.0, a.low), np.where(condition, 0.0, a.high))


def _round_sum_towards(a: Floats, b: Floats, infinity: float) -> Floats:
    """Return a + b, rounded towards an infinity unless exact."""
    total = a + b
    part = total - a
    exact = (a - (total - part)) + (b - part) == 0
    rounded = np.where(exact, total, np.nextafter(total, infinity))
    return np.where(np.isnan(total), infinity, rounded)


# Arithmetic


def add_intervals(a: Interval, b: Interval) -> Interval:
    """Return a + b."""
    return Interval(
        _round_sum_towards(a.low, b.low, -np.inf), _round_sum_towards(a.high, b.high, np.inf)
    )


def subtract_intervals(a: Interval, b: Interval) -> Interval:
    """Return a - b."""
    return add_intervals(a, negate_interval(b))


def negate_interval(a: Interval) -> Interval:
    """Return -a."""
    return Interval(-a.high, -a.low)


def double_interval(a: Interval) -> Interval:
    """Return 2 a, which is exact."""
    return Interval(2 * a.low, 2 * a.high)


def multiply_intervals(a: Interval, b: Interval) -> Interval:
    """Return a b.

    0 times infinity is not a number, but then another end is 0, or both infinities are.
    """
    products = list(itertools.starmap(operator.mul, itertools.product(a, b)))
    ends = _round_outward(np.fmin.reduce(products), np.fmax.reduce(products))
    return _set_zero_where(_is_zero(a) | _is_zero(b), ends)


def _is_zero(a: Interval) -> np.ndarray:
    """Return whether a can only be 0."""
    return (a.low == 0) & (a.high == 0)


def divide_intervals(a: Interval, b: Interval) -> Interval:
    """Return a / b."""
    return multiply_intervals(a, invert_interval(b))


def invert_interval(a: Interval) -> Interval:
    """Return 1 / a, unbounded if a may be 0."""
    away = (a.low > 0) | (a.high < 0)
    return _unbound_unless(away, _round_outward(1 / a.high, 1 / a.low))


def square_interval(a: Interval) -> Interval:
    """Return a^2, which is nowhere negative."""
    size = absolute_interval(a)
    low = np.maximum(np.nextafter(size.low**2, -np.inf), 0.0)
    return Interval(low, np.nextafter(size.high**2, np.inf))


def absolute_interval(a: Interval) -> Interval:
    """Return |a|."""
    least = np.maximum(np.maximum(a.low, -a.high), 0.0)
    return Interval(least, np.maximum(-a.low, a.high))


def interval_power(a: Interval, b: Interval) -> Interval:
    """Return a^b, by products for integers b, else as exp(b log a)."""
    exponent = float(np.ravel(b.low)[0])
    fixed = ((b.low == exponent) & (b.high == exponent)).all()
    if not fixed or exponent != round(exponent) or not 1 <= abs(exponent) <= POWERS:
        return exp(multiply_intervals(b, log(a)))
    whole = _integer_power(a, round(abs(exponent)))
    return whole if exponent > 0 else invert_interval(whole)


def _integer_power(a: Interval, exponent: int) -> Interval:
    """Return a^n, n = 1, 2, ..., by squares of squares."""
    if exponent == 1:
        return a
    even = square_interval(_integer_power(a, exponent // 2))
    return even if exponent % 2 == 0 else multiply_intervals(a, even)


# Elementary functions


def bound_increasing(
    function: Callable[[Floats], Floats],
    a: Interval,
    least: float = -np.inf,
    greatest: float = np.inf,
) -> Interval:
    """Return bounds of a function that increases on [least, greatest] (unbounded beyond this
    domain).
    """
    low = function(a.low)
    high = function(a.high)
    inside = (a.low >= least) & (a.high <= greatest)
    padded = _round_outward(low - PAD * np.abs(low), high + PAD * np.abs(high))
    return _unbound_unless(inside, padded)


exp = partial(bound_increasing, np.exp)
"""e^a."""
log = partial(bound_increasing, np.log, least=np.nextafter(0, 1))
"""log a, for a > 0."""
sqrt = partial(bound_increasing, np.sqrt, least=0.0)
"""The square root of a, for a >= 0."""
asin = partial(bound_increasing, np.arcsin, least=-1.0, greatest=1.0)
"""arcsin a, for |a| <= 1."""


def acos(a: Interval) -> Interval:
    """Return arccos a, a decreasing function, for |a| <= 1."""
    return negate_interval(bound_increasing(lambda x: -np.arccos(x), a, -1.0, 1.0))


def cosh(a: Interval) -> Interval:
    """Return cosh a = cosh |a|."""
    return bound_increasing(np.cosh, absolute_interval(a))


def tan(a: Interval) -> Interval:
    """Return tan a = sin a / cos a."""
    return divide_intervals(sin(a), cos(a))


def _bound_wave(function: Callable[[Floats], Floats], top: float, a: Interval) -> Interval:
    """Return bounds of a wave of period 2 pi that is 1 at `top` and -1 half a period later."""
    at_low = function(a.low)
    at_high = function(a.high)
    endless = ~(np.isfinite(a.low) & np.isfinite(a.high))
    least = np.maximum(np.minimum(at_low, at_high) - PAD, -1.0)
    greatest = np.minimum(np.maximum(at_low, at_high) + PAD, 1.0)
    low = np.where(_can_reach_angle(a, top + np.pi) | endless, -1.0, least)
    high = np.where(_can_reach_angle(a, top) | endless, 1.0, greatest)
    return Interval(low, high)


def _can_reach_angle(a: Interval, angle: float) -> np.ndarray:
    """Return whether a may equal an angle up to whole turns."""
    slack = SLACK * (1 + np.maximum(np.abs(a.low), np.abs(a.high)))
    first = np.ceil((a.low - slack - angle) / (2 * np.pi))
    last = np.floor((a.high + slack - angle) / (2 * np.pi))
    return last >= first


sin = partial(_bound_wave, np.sin, np.pi / 2)
"""sin a."""
cos = partial(_bound_wave, np.cos, 0.0)
"""cos a."""


# Conditions (1 if they hold, else 0) and kinks


def _decide_condition(yes: np.ndarray, no: np.ndarray) -> Interval:
    """Return 1 where `yes` holds and 0 where `no` holds. Raise InputError if neither holds."""
    if not np.all(yes | no):
        raise InputError(SMOOTH)
    return Interval(np.where(yes, 1.0, 0.0), np.where(yes, 1.0, 0.0))


def compare_less(a: Interval, b: Interval) -> Interval:
    """Return the condition a < b."""
    return _decide_condition(a.high < b.low, a.low >= b.high)


def compare_at_most(a: Interval, b: Interval) -> Interval:
    """Return the condition a <= b."""
    return _decide_condition(a.high <= b.low, a.low > b.high)


def compare_equal(a: Interval, b: Interval) -> Interval:
    """Return the condition a == b."""
    return _decide_condition(_is_same_number(a, b), _is_disjoint(a, b))


def compare_unequal(a: Interval, b: Interval) -> Interval:
    """Return the condition a != b."""
    return _decide_condition(_is_disjoint(a, b), _is_same_number(a, b))


def _is_same_number(a: Interval, b: Interval) -> np.ndarray:
    """Return whether a and b can only be the same number."""
    return (a.low == a.high) & (b.low == b.high) & (a.low == b.low)


def _is_disjoint(a: Interval, b: Interval) -> np.ndarray:
    """Return whether a and b have no number in common."""
    return (a.high < b.low) | (a.low > b.high)


def negate_condition(a: Interval) -> Interval:
    """Return the negation of a condition."""
    return _decide_condition(a.high == 0, a.low != 0)


def join_conditions(a: Interval, b: Interval) -> Interval:
    """Return the conjunction of two conditions."""
    return Interval(a.low * b.low, a.high * b.high)


def interval_sign(a: Interval) -> Interval:
    """Return the sign of a. Raise InputError if it is not decided."""
    positive = _decide_condition(a.low > 0, a.high < 0).low
    return Interval(2 * positive - 1, 2 * positive - 1)


def interval_minimum(a: Interval, b: Interval) -> Interval:
    """Return min(a, b)."""
    return Interval(np.minimum(a.low, b.low), np.minimum(a.high, b.high))


def interval_maximum(a: Interval, b: Interval) -> Interval:
    """Return max(a, b)."""
    return Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high))


def gate_interval(condition: Interval, value: Interval) -> Interval:
    """Return the value if the condition holds, else 0."""
    return _set_zero_where(condition.low == 0, value)


_RISING = {"atan": np.arctan, "sinh": np.sinh, "tanh": np.tanh}  # everywhere
# Bounds on an instruction from those on its operands.
_BOUNDS: dict[str, Callable[..., Interval]] = {
    **{
        "assign": lambda a: a,
        "add": add_intervals,
        "sub": subtract_intervals,
        "neg": negate_interval,
        "twice": double_interval,
    },
    **{
        "mul": multiply_intervals,
        "div": divide_intervals,
        "inv": invert_interval,
        "sq": square_interval,
        "fabs": absolute_interval,
    },
    **{
        "sign": interval_sign,
        "pow": interval_power,
        "constpow": interval_power,
        "sqrt": sqrt,
        "exp": exp,
        "log": log,
    },
    **{"sin": sin, "cos": cos, "tan": tan, "asin": asin, "acos": acos, "cosh": cosh},
    **{word: partial(bound_increasing, of) for word, of in _RISING.items()},
    **{
        "fmin": interval_minimum,
        "fmax": interval_maximum,
        "lt": compare_less,
        "le": compare_at_most,
        "eq": compare_equal,
        "ne": compare_unequal,
    },
    **{
        "not": negate_condition,
        "and": join_conditions,
        "or": interval_maximum,
        "if_else_zero": gate_interval,
    },
}


def build_enclosure(function: ca.Function) -> Callable[[Sequence[Interval]], list[Interval]]:
    """Build a function that bounds the outputs of a function for every point of a box of its
    inputs.

    Args:
        function: of SX, with dense outputs.

    Returns:
        bounds(boxes): from an interval (entries x boxes) per input to one (entries x boxes) per
        output. It raises InputError if a condition or a kink is not decided on a whole box.

    Raises:
        InputError: an instruction without bounds.
    """
    lines = read_program(function)
    for line in lines.lines:
        if line.word not in (*_BOUNDS, "input", "const"):
            raise InputError(f"no bounds are known for the function {line.word}")
    return partial(_bound_outputs, lines, function.name_in())


def _bound_outputs(
    lines: Program, names: Sequence[str], boxes: Sequence[Interval]
) -> list[Interval]:
    """Return bounds of the outputs of a function, given the names and boxes of its inputs."""
    shape = np.broadcast_shapes(*(box.low.shape[1:] for box in boxes))

    def read(name: str, entry: int) -> Interval:
        """Return the interval of an input entry."""
        box = boxes[names.index(name)]
        return Interval(box.low[entry], box.high[entry])

    def constant(value: float) -> Interval:
        """Return the interval of a constant."""
        return Interval(np.array(value), np.array(value))

    with np.errstate(all="ignore"):
        results = evaluate_program(lines, read, constant, lambda word, *of: _BOUNDS[word](*of))
    return [_stack_intervals(entries, shape) for entries in results]


def _stack_intervals(entries: list[Interval], shape: tuple[int, ...]) -> Interval:
    """Stack several intervals into a single interval (entries x boxes)."""
    low = np.stack([np.broadcast_to(entry.low, shape) for entry in entries])
    high = np.stack([np.broadcast_to(entry.high, shape) for entry in entries])
    return Interval(low, high)
