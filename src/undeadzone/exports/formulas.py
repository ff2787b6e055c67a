"""The elementary functions as formulas of + - * /, comparisons, square roots and a number's bits.

No step is fused, so that every processor gives the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from undeadzone.exports.coefficients import Numbers
from undeadzone.exports.tracing import Traced, polynomial


class Elementary(NamedTuple):
    """An elementary function.

    Attributes:
        meaning: what it computes, its range and its error.
        build: (numbers of the precision, argument, ...) -> the value.
        inputs: names of the arguments.
        needs: the other functions that it calls.
    """

    meaning: str
    build: Callable[..., Traced]
    inputs: tuple[str, ...] = ("x",)
    needs: tuple[str, ...] = ()


def _whole(x: Traced) -> Traced:
    """The nearest whole number; of a half, the one further from 0."""
    return (x + (x < 0.0).chosen(-0.5, 0.5)).truncated()


def _limited(x: Traced, most: float) -> Traced:
    """A number in [-most, most]; NaN becomes -most."""
    return (x > -most).chosen((x < most).chosen(x, most), -most)


def _absolute(x: Traced) -> Traced:
    return (x < 0.0).chosen(-x, x)


def _signed(value: Traced, x: Traced) -> Traced:
    """A value with the sign of x."""
    return (x < 0.0).chosen(-value, value)


def _exp(c: Numbers, x: Traced) -> Traced:
    a = (x > c.overflow).chosen(c.overflow, x)
    least = c.underflow - 1.0
    n = _whole((a > least).chosen(a, least) * (1 / math.log(2)))
    r = (a - n * c.log2[0]) - n * c.log2[1]
    e = 1.0 + (r + r * r * polynomial(r, c.exp))
    half = (n * 0.5).truncated()
    value = (e * half.power()) * (n - half).power()
    return (x < c.underflow).chosen(0.0, value)


def _expm1(c: Numbers, x: Traced) -> Traced:
    small = x + x * x * polynomial(x, c.exp)
    near = (_absolute(x) < 0.34).chosen(1.0, 0.0)
    return near.unlike(0.0).chosen(small, x.call("exp") - 1.0)


def _log(c: Numbers, x: Traced) -> Traced:
    small = x < c.least
    normal = small.chosen(x * 2.0**c.lift, x)
    shift = small.chosen(c.lift, 0.0)
    n = normal.exponent() - shift
    f = normal.fraction() - 1.0
    s = f / (2.0 + f)
    z = s * s
    value = n * c.log2[0] + (f - (s * (f - z * polynomial(z, c.log)) - n * c.log2[1]))
    edge = x.equals(0.0).chosen(-1.0 / (x * x), math.nan)
    finite = (x > 0.0).chosen(value, edge)
    return (x > math.inf).chosen(x, finite)  # in C beyond the largest number


def _log1p(c: Numbers, x: Traced) -> Traced:
    u = 1.0 + x
    gap = u - 1.0
    zero = gap.equals(0.0)
    return zero.chosen(x, u.call("log") * (x / zero.chosen(1.0, gap)))


def _erf(c: Numbers, x: Traced) -> Traced:
    a = _limited(_absolute(x), c.certain)
    near = a * polynomial(a * a, c.erf_near)
    far = 1.0 - (-(a * polynomial(a, c.erf_far))).call("exp")
    return x.unlike(x).chosen(x, _signed((a < 0.5).chosen(near, far), x))


def _quadrant(c: Numbers, x: Traced) -> tuple[Traced, Traced, Traced]:
    """(sin r, cos r, n mod 4) of x = n pi/2 + r."""
    n = _whole(_limited(x, c.furthest) * (2 / math.pi))
    r = ((x - n * c.quarter[0]) - n * c.quarter[1]) - n * c.quarter[2]
    z = r * r
    sine = r + r * z * polynomial(z, c.sin)
    cosine = (1.0 - 0.5 * z) + z * z * polynomial(z, c.cos)
    quarters = n * 0.25
    whole = quarters.truncated()
    below = whole - (quarters < whole).chosen(1.0, 0.0)
    return sine, cosine, n - 4.0 * below


def _sin(c: Numbers, x: Traced) -> Traced:
    sine, cosine, k = _quadrant(c, x)
    value = k.equals(1.0).either(k.equals(3.0)).chosen(cosine, sine)
    return (k > 1.5).chosen(-value, value)


def _cos(c: Numbers, x: Traced) -> Traced:
    sine, cosine, k = _quadrant(c, x)
    odd = k.equals(1.0)
    value = odd.either(k.equals(3.0)).chosen(sine, cosine)
    return odd.either(k.equals(2.0)).chosen(-value, value)


def _tan(c: Numbers, x: Traced) -> Traced:
    sine, cosine, k = _quadrant(c, x)
    odd = k.equals(1.0).either(k.equals(3.0))
    return odd.chosen(-cosine, sine) / odd.chosen(sine, cosine)


def _atan(c: Numbers, x: Traced) -> Traced:
    a = _absolute(x)
    far, middle = a > math.tan(3 * math.pi / 8), a > math.tan(math.pi / 8)
    above = far.chosen(-1.0, a - 1.0)
    below = far.chosen(a, a + 1.0)
    r = middle.chosen(above, a) / middle.chosen(below, 1.0)
    z = r * r
    base = far.chosen(c.pi2[0], middle.chosen(c.pi4[0], 0.0))
    rest = far.chosen(c.pi2[1], middle.chosen(c.pi4[1], 0.0))
    return _signed(base + ((r * z * polynomial(z, c.atan) + rest) + r), x)


def _atan2(c: Numbers, y: Traced, x: Traced) -> Traced:
    zero = x.equals(0.0)
    quotient = (y / zero.chosen(1.0, x)).call("atan")
    turned = (y < 0.0).chosen(quotient - 2 * c.pi2[0], quotient + 2 * c.pi2[0])
    across = (x < 0.0).chosen(turned, quotient)
    up = (y > 0.0).chosen(c.pi2[0], 0.0)
    upright = (y < 0.0).chosen(-c.pi2[0], up)
    return zero.chosen(upright, across)


def _asin(c: Numbers, x: Traced) -> Traced:
    return x.call("atan2", ((1.0 - x) * (1.0 + x)).sqrt())


def _acos(c: Numbers, x: Traced) -> Traced:
    return ((1.0 - x) * (1.0 + x)).sqrt().call("atan2", x)


def _sinh(c: Numbers, x: Traced) -> Traced:
    a = _absolute(x)
    t = a.call("expm1")
    half = (a * 0.5).call("exp")
    near = 0.5 * (t + t / (t + 1.0))
    return _signed((a < 20.0).chosen(near, (0.5 * half) * half), x)


def _cosh(c: Numbers, x: Traced) -> Traced:
    a = _absolute(x)
    e = a.call("exp")
    half = (a * 0.5).call("exp")
    return (a < 20.0).chosen(0.5 * (e + 1.0 / e), (0.5 * half) * half)


def _tanh(c: Numbers, x: Traced) -> Traced:
    t = (-2.0 * _limited(_absolute(x), 20.0)).call("expm1")
    return x.unlike(x).chosen(x, _signed(-t / (t + 2.0), x))


def _asinh(c: Numbers, x: Traced) -> Traced:
    a = _absolute(x)
    far = a > 1e8
    b = far.chosen(1.0, a)
    near = (b + b * b / (1.0 + (b * b + 1.0).sqrt())).call("log1p")
    return _signed(far.chosen(a.call("log") + math.log(2), near), x)


def _acosh(c: Numbers, x: Traced) -> Traced:
    far = x > 1e8
    t = far.chosen(1.0, x - 1.0)
    near = (t + (2.0 * t + t * t).sqrt()).call("log1p")
    return far.chosen(x.call("log") + math.log(2), near)


def _atanh(c: Numbers, x: Traced) -> Traced:
    a = _absolute(x)
    return _signed(0.5 * (2.0 * a / (1.0 - a)).call("log1p"), x)


def _pow(c: Numbers, x: Traced, y: Traced) -> Traced:
    a = _absolute(x)
    size = (y * a.call("log")).call("exp")
    whole = y.call("floor").equals(y)
    half = y * 0.5
    even = half.call("floor").equals(half)
    negative = whole.chosen(even.chosen(size, -size), math.nan)
    value = (x < 0.0).chosen(negative, size)
    one = y.equals(0.0).either(x.equals(1.0))
    return one.chosen(1.0, value)


def _hypot(c: Numbers, x: Traced, y: Traced) -> Traced:
    a, b = _absolute(x), _absolute(y)
    more = (b < a).chosen(a, b)
    less = (b < a).chosen(b, a)
    none = more.equals(0.0)
    ratio = less / none.chosen(1.0, more)
    return more * (1.0 + ratio * ratio).sqrt()


def _floor(c: Numbers, x: Traced) -> Traced:
    large = 2.0**22 if c.least > 1e-300 else 2.0**51
    t = _limited(x, large).truncated()
    down = t - (x < t).chosen(1.0, 0.0)
    return (_absolute(x) < large).chosen(down, x)


def _ceil(c: Numbers, x: Traced) -> Traced:
    return -(-x).call("floor")


def _sign(c: Numbers, x: Traced) -> Traced:
    return (x < 0.0).chosen(-1.0, (x > 0.0).chosen(1.0, x))


def _fmin(c: Numbers, x: Traced, y: Traced) -> Traced:
    return (x < y).either(y.unlike(y)).chosen(x, y)


def _fmax(c: Numbers, x: Traced, y: Traced) -> Traced:
    return (y < x).either(y.unlike(y)).chosen(x, y)


TWO = ("x", "y")
FUNCTIONS: dict[str, Elementary] = {
    "fabs": Elementary("Absolute value.", lambda c, x: _absolute(x)),
    "sign": Elementary("Sign: -1, 0 or 1.", _sign),
    "fmin": Elementary("The smaller of two numbers.", _fmin, TWO),
    "fmax": Elementary("The larger of two numbers.", _fmax, TWO),
    "floor": Elementary("The largest whole number that is not larger.", _floor),
    "ceil": Elementary("The smallest whole number that is not smaller.", _ceil, needs=("floor",)),
    "exp": Elementary("Exponential; 0 for a result below the normal numbers.", _exp),
    "expm1": Elementary("e^x - 1.", _expm1, needs=("exp",)),
    "log": Elementary("Natural logarithm; -infinity of 0, NaN of less.", _log),
    "log1p": Elementary("log(1 + x).", _log1p, needs=("log",)),
    "erf": Elementary("Error function.", _erf, needs=("exp",)),
    "sin": Elementary("Sine; |x| below 8000 (float) or 1e5 (double).", _sin),
    "cos": Elementary("Cosine; |x| below 8000 (float) or 1e5 (double).", _cos),
    "tan": Elementary("Tangent; |x| below 8000 (float) or 1e5 (double).", _tan),
    "atan": Elementary("Arc tangent.", _atan),
    "atan2": Elementary("Angle of (y, x).", _atan2, ("y", "x"), ("atan",)),
    "asin": Elementary("Arc sine.", _asin, needs=("atan2",)),
    "acos": Elementary("Arc cosine.", _acos, needs=("atan2",)),
    "sinh": Elementary("Hyperbolic sine.", _sinh, needs=("expm1", "exp")),
    "cosh": Elementary("Hyperbolic cosine.", _cosh, needs=("exp",)),
    "tanh": Elementary("Hyperbolic tangent.", _tanh, needs=("expm1",)),
    "asinh": Elementary("Inverse of sinh.", _asinh, needs=("log1p", "log")),
    "acosh": Elementary("Inverse of cosh.", _acosh, needs=("log1p", "log")),
    "atanh": Elementary("Inverse of tanh.", _atanh, needs=("log1p",)),
    "pow": Elementary(
        "x^y as e^(y log x): its relative error grows with |y log x|.",
        _pow,
        TWO,
        ("exp", "log", "floor"),
    ),
    "hypot": Elementary("sqrt(x^2 + y^2).", _hypot, TWO),
}
"""In an order in which each calls earlier ones only."""
