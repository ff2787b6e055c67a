"""Bounds on what a CasADi SX graph can be on boxes of its inputs (Moore 1966).

Every bound is rounded outwards. Functions take intervals of any shape and act entry by entry.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile.casadi_reader import Program, evaluate_program, program
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats

PAD = 16 * np.finfo(float).eps  # relative error of NumPy's elementary functions, amply
SLACK = 1e-12  # of an argument of sine or cosine, relative: far more than its rounding
POWERS = 16  # whole exponents up to it are computed by products
SMOOTH = (
    "a condition, sign, abs, min or max changes within the bounds; "
    "only smooth functions can be bounded"
)


class Interval(NamedTuple):
    """What lies between two numbers, entry by entry.

    Attributes:
        low: the least value.
        high: the greatest value.
    """

    low: Floats
    high: Floats


def _outward(low: Floats, high: Floats) -> Interval:
    """Return wider by a rounding; what is not a number has no bound."""
    return Interval(
        np.where(np.isnan(low), -np.inf, np.nextafter(low, -np.inf)),
        np.where(np.isnan(high), np.inf, np.nextafter(high, np.inf)),
    )


def _bound_if(condition: np.ndarray, a: Interval) -> Interval:
    """Return the interval where the condition holds, no bound elsewhere."""
    return Interval(np.where(condition, a.low, -np.inf), np.where(condition, a.high, np.inf))


def _zero_where(condition: np.ndarray, a: Interval) -> Interval:
    """Return 0 where the condition holds, the interval elsewhere."""
    return Interval(np.where(condition, 0.0, a.low), np.where(condition, 0.0, a.high))


def _sum_towards(a: Floats, b: Floats, infinity: float) -> Floats:
    """Return a + b, rounded towards an infinity where it is not exact."""
    total = a + b
    part = total - a
    exact = (a - (total - part)) + (b - part) == 0
    rounded = np.where(exact, total, np.nextafter(total, infinity))
    return np.where(np.isnan(total), infinity, rounded)


# Arithmetic


def add(a: Interval, b: Interval) -> Interval:
    """Return a + b."""
    return Interval(_sum_towards(a.low, b.low, -np.inf), _sum_towards(a.high, b.high, np.inf))


def subtract(a: Interval, b: Interval) -> Interval:
    """Return a - b."""
    return add(a, negative(b))


def negative(a: Interval) -> Interval:
    """Return -a."""
    return Interval(-a.high, -a.low)


def twice(a: Interval) -> Interval:
    """Return 2 a, which is exact."""
    return Interval(2 * a.low, 2 * a.high)


def product(a: Interval, b: Interval) -> Interval:
    """Return a b.

    0 times infinity is no number, but then another end is 0, or both infinities are.
    """
    products = [one * other for one, other in itertools.product(a, b)]
    ends = _outward(np.fmin.reduce(products), np.fmax.reduce(products))
    return _zero_where(_is_zero(a) | _is_zero(b), ends)


def _is_zero(a: Interval) -> np.ndarray:
    """Return whether a can only be 0."""
    return (a.low == 0) & (a.high == 0)


def quotient(a: Interval, b: Interval) -> Interval:
    """Return a / b."""
    return product(a, inverse(b))


def inverse(a: Interval) -> Interval:
    """Return 1 / a; no bound where a may be 0."""
    away = (a.low > 0) | (a.high < 0)
    return _bound_if(away, _outward(1 / a.high, 1 / a.low))


def square(a: Interval) -> Interval:
    """Return a^2, which is nowhere negative."""
    size = absolute(a)
    low = np.maximum(np.nextafter(size.low**2, -np.inf), 0.0)
    return Interval(low, np.nextafter(size.high**2, np.inf))


def absolute(a: Interval) -> Interval:
    """Return |a|."""
    least = np.maximum(np.maximum(a.low, -a.high), 0.0)
    return Interval(least, np.maximum(-a.low, a.high))


def power(a: Interval, b: Interval) -> Interval:
    """Return a^b: whole numbers b by products, others as exp(b log a)."""
    exponent = float(np.ravel(b.low)[0])
    fixed = ((b.low == exponent) & (b.high == exponent)).all()
    if not fixed or exponent != round(exponent) or not 1 <= abs(exponent) <= POWERS:
        return exp(product(b, log(a)))
    whole = _whole_power(a, round(abs(exponent)))
    return whole if exponent > 0 else inverse(whole)


def _whole_power(a: Interval, exponent: int) -> Interval:
    """Return a^n, n = 1, 2, ..., by squares of squares."""
    if exponent == 1:
        return a
    even = square(_whole_power(a, exponent // 2))
    return even if exponent % 2 == 0 else product(a, even)


# Elementary functions


def rising(
    function: Callable[[Floats], Floats],
    a: Interval,
    least: float = -np.inf,
    greatest: float = np.inf,
) -> Interval:
    """Return a function that rises on its domain [least, greatest]; no bound beyond."""
    low, high = function(a.low), function(a.high)
    inside = (a.low >= least) & (a.high <= greatest)
    padded = _outward(low - PAD * np.abs(low), high + PAD * np.abs(high))
    return _bound_if(inside, padded)


exp = partial(rising, np.exp)
"""e^a."""
log = partial(rising, np.log, least=np.nextafter(0, 1))
"""log a, for a > 0."""
sqrt = partial(rising, np.sqrt, least=0.0)
"""The square root of a, for a >= 0."""
asin = partial(rising, np.arcsin, least=-1.0, greatest=1.0)
"""arcsin a, for |a| <= 1."""


def acos(a: Interval) -> Interval:
    """Return arccos a, which falls, for |a| <= 1."""
    return negative(rising(lambda x: -np.arccos(x), a, -1.0, 1.0))


def cosh(a: Interval) -> Interval:
    """Return cosh a = cosh |a|."""
    return rising(np.cosh, absolute(a))


def tan(a: Interval) -> Interval:
    """Return tan a = sin a / cos a."""
    return quotient(sin(a), cos(a))


def _wave(function: Callable[[Floats], Floats], top: float, a: Interval) -> Interval:
    """Return a wave of period 2 pi that is 1 at `top` and -1 half a period later."""
    at_low, at_high = function(a.low), function(a.high)
    endless = ~(np.isfinite(a.low) & np.isfinite(a.high))
    least = np.maximum(np.minimum(at_low, at_high) - PAD, -1.0)
    greatest = np.minimum(np.maximum(at_low, at_high) + PAD, 1.0)
    low = np.where(_reaches(a, top + np.pi) | endless, -1.0, least)
    high = np.where(_reaches(a, top) | endless, 1.0, greatest)
    return Interval(low, high)


def _reaches(a: Interval, angle: float) -> np.ndarray:
    """Return whether a may be an angle or differ from it by whole turns."""
    slack = SLACK * (1 + np.maximum(np.abs(a.low), np.abs(a.high)))
    first = np.ceil((a.low - slack - angle) / (2 * np.pi))
    last = np.floor((a.high + slack - angle) / (2 * np.pi))
    return last >= first


sin = partial(_wave, np.sin, np.pi / 2)
"""sin a."""
cos = partial(_wave, np.cos, 0.0)
"""cos a."""


# Conditions (1 where they hold, 0 where they do not) and kinks


def _decide(yes: np.ndarray, no: np.ndarray) -> Interval:
    """Return 1 where yes, 0 where no. Raises InputError where neither."""
    if not np.all(yes | no):
        raise InputError(SMOOTH)
    return Interval(np.where(yes, 1.0, 0.0), np.where(yes, 1.0, 0.0))


def less(a: Interval, b: Interval) -> Interval:
    """Return a < b."""
    return _decide(a.high < b.low, a.low >= b.high)


def at_most(a: Interval, b: Interval) -> Interval:
    """Return a <= b."""
    return _decide(a.high <= b.low, a.low > b.high)


def equal(a: Interval, b: Interval) -> Interval:
    """Return a == b."""
    return _decide(_coincide(a, b), _apart(a, b))


def unequal(a: Interval, b: Interval) -> Interval:
    """Return a != b."""
    return _decide(_apart(a, b), _coincide(a, b))


def _coincide(a: Interval, b: Interval) -> np.ndarray:
    """Return whether a and b can only be the same number."""
    return (a.low == a.high) & (b.low == b.high) & (a.low == b.low)


def _apart(a: Interval, b: Interval) -> np.ndarray:
    """Return whether a and b have no number in common."""
    return (a.high < b.low) | (a.low > b.high)


def negation(a: Interval) -> Interval:
    """Not a."""
    return _decide(a.high == 0, a.low != 0)


def both(a: Interval, b: Interval) -> Interval:
    """Return both conditions."""
    return Interval(a.low * b.low, a.high * b.high)


def sign(a: Interval) -> Interval:
    """Return the sign of a, where it is decided."""
    positive = _decide(a.low > 0, a.high < 0).low
    return Interval(2 * positive - 1, 2 * positive - 1)


def minimum(a: Interval, b: Interval) -> Interval:
    """Return min(a, b)."""
    return Interval(np.minimum(a.low, b.low), np.minimum(a.high, b.high))


def maximum(a: Interval, b: Interval) -> Interval:
    """Return max(a, b)."""
    return Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high))


def gate_value(condition: Interval, value: Interval) -> Interval:
    """Return the value where the condition holds, else 0."""
    return _zero_where(condition.low == 0, value)


_RISING = {"atan": np.arctan, "sinh": np.sinh, "tanh": np.tanh}  # everywhere
# Bounds on an instruction from those on its operands.
_BOUNDS: dict[str, Callable[..., Interval]] = {
    **{"assign": lambda a: a, "add": add, "sub": subtract, "neg": negative, "twice": twice},
    **{"mul": product, "div": quotient, "inv": inverse, "sq": square, "fabs": absolute},
    **{"sign": sign, "pow": power, "constpow": power, "sqrt": sqrt, "exp": exp, "log": log},
    **{"sin": sin, "cos": cos, "tan": tan, "asin": asin, "acos": acos, "cosh": cosh},
    **{word: partial(rising, of) for word, of in _RISING.items()},
    **{"fmin": minimum, "fmax": maximum, "lt": less, "le": at_most, "eq": equal, "ne": unequal},
    **{"not": negation, "and": both, "or": maximum, "if_else_zero": gate_value},
}


def enclosure(function: ca.Function) -> Callable[[Sequence[Interval]], list[Interval]]:
    """Bounds on the outputs of a function, true for every point of a box of its inputs.

    Args:
        function: of SX, with dense outputs.

    Returns:
        bounds(boxes): from an interval (entries x boxes) per input to one (entries x boxes) per
        output. It raises InputError where a condition or a kink is not decided on a whole box.

    Raises:
        InputError: an instruction without bounds.
    """
    lines = program(function)
    for line in lines.lines:
        if line.word not in (*_BOUNDS, "input", "const"):
            raise InputError(f"no bounds are known for the function {line.word}")
    return partial(_enclose_outputs, lines, function.name_in())


def _enclose_outputs(
    lines: Program, names: Sequence[str], boxes: Sequence[Interval]
) -> list[Interval]:
    """Bounds on the outputs of a function, given its inputs' names and boxes."""
    shape = np.broadcast_shapes(*(box.low.shape[1:] for box in boxes))

    def read(name: str, entry: int) -> Interval:
        box = boxes[names.index(name)]
        return Interval(box.low[entry], box.high[entry])

    def constant(value: float) -> Interval:
        return Interval(np.array(value), np.array(value))

    with np.errstate(all="ignore"):
        results = evaluate_program(lines, read, constant, lambda word, *of: _BOUNDS[word](*of))
    return [_stack_intervals(entries, shape) for entries in results]


def _stack_intervals(entries: list[Interval], shape: tuple[int, ...]) -> Interval:
    """Return several intervals in one (entries x boxes)."""
    low = np.stack([np.broadcast_to(entry.low, shape) for entry in entries])
    high = np.stack([np.broadcast_to(entry.high, shape) for entry in entries])
    return Interval(low, high)
