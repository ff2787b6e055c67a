"""Elementary functions of a language that shows no bits of a number, such as Structured Text.

Powers of two, exponents and fractions are found by exact products and sums, so that all bits are
those of `elementary`. Docstrings are the comments of the exported text.
"""

from __future__ import annotations

import math
from typing import Any, Final

from undeadzone.compile.elementary import FUNCTIONS, Maths, Own, reduce_angle


def positive(m: Maths, x: Any) -> Any:
    """Return the number without its sign."""
    return m.select(x > 0.0, x, 0.0 - x)


def with_sign(m: Maths, x: Any, y: Any) -> Any:
    """Return |x| with the sign of y; only where x is 0, too, does a 0 have one."""
    a = abs(x)
    zero = (a == 0.0) & (y == 0.0)
    return m.select(zero, y, m.select(y < 0.0, -a, a))


def steps(m: Maths) -> tuple[float, ...]:
    """Return exponents whose sums are all those of numbers, largest first."""
    return (120.0,) * (m.c.bias // 120) + (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 1.0)


def two_to(m: Maths, x: Any) -> Any:
    """Return 2^x of a whole number x."""
    left: Any = abs(x)
    value: Any = 1.0
    for step in steps(m):
        more = left >= step
        left = m.select(more, left - step, left)
        value = m.select(more, value * 2.0**step, value)
    return m.select(x < 0.0, 1.0 / value, value)


def scale_to_edge(m: Maths, x: Any) -> Any:
    """Return n and 2^-n x, which lies in [edge, 2 edge), edge^2 = 1/2."""
    edge = math.sqrt(0.5)
    n: Any = 0.0
    for step in steps(m):
        large = x >= edge * 2.0**step
        x, n = m.select(large, x * 2.0**-step, x), m.select(large, n + step, n)
    for step in steps(m):
        small = x < edge * 2.0 ** (1.0 - step)
        x, n = m.select(small, x * 2.0**step, x), m.select(small, n - step, n)
    return n, x


def exponent(m: Maths, x: Any) -> Any:
    """Return n of x = 2^n f, sqrt(1/2) <= f < sqrt(2)."""
    return scale_to_edge(m, x)[0]


def fraction(m: Maths, x: Any) -> Any:
    """Return f of x = 2^n f, sqrt(1/2) <= f < sqrt(2)."""
    return scale_to_edge(m, x)[1]


def quarter(m: Maths, n: Any) -> Any:
    """Return n modulo 4 of a whole number that is not negative."""
    return n - 4.0 * (((0.25 * n - 0.375) + m.c.shift) - m.c.shift)


def odd(m: Maths, value: Any, x: Any) -> Any:
    """Return the value of an odd function at |x|, as it is at x."""
    return m.select(x > 0.0, value, m.select(x < 0.0, -value, x))


def sine(m: Maths, x: Any) -> Any:
    """Return sine; 0 of |x| above 8000 (float) or 1e5 (double)."""
    along, across, n = reduce_angle(m, x)
    q = quarter(m, n)
    value = m.select((q == 1.0) | (q == 3.0), across, along)
    return odd(m, m.select(q > 1.5, -value, value), x)


def cosine(m: Maths, x: Any) -> Any:
    """Return cosine; 1 of |x| above 8000 (float) or 1e5 (double)."""
    along, across, n = reduce_angle(m, x)
    q = quarter(m, n)
    value = m.select((q == 1.0) | (q == 3.0), along, across)
    return m.select((q > 0.5) & (q < 2.5), -value, value)


def tangent(m: Maths, x: Any) -> Any:
    """Return tangent; 0 of |x| above 8000 (float) or 1e5 (double)."""
    along, across, n = reduce_angle(m, x)
    q = quarter(m, n)
    crossed = (q == 1.0) | (q == 3.0)
    value = m.select(crossed, across, along) / m.select(crossed, along, across)
    return odd(m, m.select(crossed, -value, value), x)


OWN: Final = Own(
    {
        "fabs": positive,
        "copysign": with_sign,
        "power": two_to,
        "exponent": exponent,
        "fraction": fraction,
        **FUNCTIONS,
        "sin": sine,
        "cos": cosine,
        "tan": tangent,
    },
    bitless=True,
)
