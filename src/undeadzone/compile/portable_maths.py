"""Elementary functions for a language without access to the bits of a number, such as Structured
Text.

Powers of two, exponents and fractions are found by exact products and sums, so that all bits are
those of `elementary`. Docstrings are the comments of the exported text.
"""

from __future__ import annotations

import math
from typing import Any, Final

from undeadzone.compile.elementary import FUNCTIONS, FunctionSet, Maths, reduce_angle


def absolute_value(m: Maths, x: Any) -> Any:
    """Return the number without its sign."""
    return m.select(x > 0.0, x, 0.0 - x)


def copy_sign(m: Maths, x: Any, y: Any) -> Any:
    """Return |x| with the sign of y. Only where x is 0, too, does a 0 have one."""
    a = abs(x)
    zero = (a == 0.0) & (y == 0.0)
    return m.select(zero, y, m.select(y < 0.0, -a, a))


def exponent_steps(m: Maths) -> tuple[float, ...]:
    """Return the exponents, largest first, whose partial sums cover the exponents of all
    numbers.
    """
    return (120.0,) * (m.c.bias // 120) + (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 1.0)


def power_of_two(m: Maths, x: Any) -> Any:
    """Return 2^x of a whole number x."""
    left: Any = abs(x)
    value: Any = 1.0
    for step in exponent_steps(m):
        more = left >= step
        left = m.select(more, left - step, left)
        value = m.select(more, value * 2.0**step, value)
    return m.select(x < 0.0, 1.0 / value, value)


def split_exponent(m: Maths, x: Any) -> Any:
    """Return n and 2^-n x. The latter lies in [edge, 2 edge) with edge^2 = 1/2."""
    edge = math.sqrt(0.5)
    n: Any = 0.0
    for step in exponent_steps(m):
        large = x >= edge * 2.0**step
        x = m.select(large, x * 2.0**-step, x)
        n = m.select(large, n + step, n)
    for step in exponent_steps(m):
        small = x < edge * 2.0 ** (1.0 - step)
        x = m.select(small, x * 2.0**step, x)
        n = m.select(small, n - step, n)
    return n, x


def binary_exponent(m: Maths, x: Any) -> Any:
    """Return n of x = 2^n f, sqrt(1/2) <= f < sqrt(2)."""
    return split_exponent(m, x)[0]


def binary_fraction(m: Maths, x: Any) -> Any:
    """Return f of x = 2^n f, sqrt(1/2) <= f < sqrt(2)."""
    return split_exponent(m, x)[1]


def modulo_four(m: Maths, n: Any) -> Any:
    """Return n modulo 4 for an integer n >= 0."""
    return n - 4.0 * (((0.25 * n - 0.375) + m.c.shift) - m.c.shift)


def extend_odd(m: Maths, value: Any, x: Any) -> Any:
    """Return the value of an odd function at x, given its value at |x|."""
    return m.select(x > 0.0, value, m.select(x < 0.0, -value, x))


def turn_angle(m: Maths, x: Any) -> tuple[Any, Any, Any]:
    """Return sine and cosine of x but for their signs, and the quadrant."""
    along, across, n = reduce_angle(m, x)
    q = modulo_four(m, n)
    crossed = (q == 1.0) | (q == 3.0)
    return m.select(crossed, across, along), m.select(crossed, along, across), q


def portable_sine(m: Maths, x: Any) -> Any:
    """Return sine, 0 of |x| above 8000 (float) or 1e5 (double)."""
    value, _, q = turn_angle(m, x)
    return extend_odd(m, m.select(q > 1.5, -value, value), x)


def portable_cosine(m: Maths, x: Any) -> Any:
    """Return cosine, 1 of |x| above 8000 (float) or 1e5 (double)."""
    _, value, q = turn_angle(m, x)
    return m.select((q > 0.5) & (q < 2.5), -value, value)


def portable_tangent(m: Maths, x: Any) -> Any:
    """Return tangent, 0 of |x| above 8000 (float) or 1e5 (double)."""
    up, down, q = turn_angle(m, x)
    value = up / down
    return extend_odd(m, m.select((q == 1.0) | (q == 3.0), -value, value), x)


OWN: Final = FunctionSet(
    {
        "fabs": absolute_value,
        "copysign": copy_sign,
        "power": power_of_two,
        "exponent": binary_exponent,
        "fraction": binary_fraction,
        **FUNCTIONS,
        "sin": portable_sine,
        "cos": portable_cosine,
        "tan": portable_tangent,
    },
    bitless=True,
)
