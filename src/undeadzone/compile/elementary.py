"""Elementary functions as plain arithmetic: a single text for fused lanes and for exported code.

They have no branches and no loops, so that LLVM vectorises them over lanes. Exported code calls
them. Every operation rounds once by IEEE 754, so that all processors and lane widths give the same
bits. In lanes a b + c is rounded once, which chips without such an instruction and WebAssembly
cannot do at a bearable price: exported code rounds the product, too, and gives other last bits.

Errors of fused lanes stay below 1 ulp (erf 1.5, tanh 3). NaN, infinities, zeros of either sign and
subnormal numbers mean the same as in C. Docstrings are the comments of the exported C.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

from undeadzone.compile.coefficients import DOUBLE, SINGLE, Numbers
from undeadzone.compile.graph import LANES, Node, Nodes, Results, count_uses
from undeadzone.compile.repeats import Part
from undeadzone.compile.trace import Numpy, Value


class Maths:
    """Functions of an arithmetic that the elementary functions use besides operators.

    Args:
        nodes: where nodes are made.
        numbers: of the arithmetic.
        inline: whether the functions here stand in each other's place, and are not called.
        bitless: whether the language shows no bits of a number, see `bitless`.
    """

    def __init__(
        self, nodes: Nodes, numbers: Numbers, inline: bool = False, bitless: bool = False
    ) -> None:
        self.nodes, self.c, self._inline, self.bitless = nodes, numbers, inline, bitless
        self._numpy = Numpy(nodes, numbers.kind)
        self.select, self.sqrt = self._numpy.where, self._numpy.sqrt

    def call(self, name: str, *args: Any) -> Any:
        """Return the value of a function given by its name."""
        if self._inline and name in FUNCTIONS:
            return FUNCTIONS[name](self, *args)
        return self._numpy.call(name, *args)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once if the arithmetic supports it."""
        return self.call("fma", a, b, c) if self.c.fused else a * b + c

    def bits(self, x: Any) -> Any:
        """Return the bits of a number as an unsigned integer."""
        return x.cast("view", self.c.word)

    def from_bits(self, x: Any) -> Any:
        """Return the number with the given bits."""
        return x.cast("view", self.c.kind)

    def polynomial(self, x: Any, coefficients: tuple[float, ...]) -> Any:
        """Return the polynomial coefficients[0] + coefficients[1] x + ....

        Even and odd powers apart, so that half as many roundings wait for each other.
        """
        square, halves = x * x, []
        for *lower, value in (coefficients[0::2], coefficients[1::2]):
            for coefficient in reversed(lower):
                value = self.fma(value, square, coefficient)
            halves.append(value)
        return self.fma(halves[1], x, halves[0])


# --- Steps of the functions


def reduce_angle(m: Maths, x: Any) -> Any:
    """Return sine and cosine of r, |x| = n pi/2 + r, |r| <= pi/4, and bits that end with n, or
    n itself.

    Beyond the largest argument those of 0. r is found as a sum of two numbers, the first of which
    may be as small as 2^-60.
    """
    c, a = m.c, abs(x)
    a = m.select(a <= c.far, a, 0.0 * a)
    shifted = m.fma(a, 2 / math.pi, c.shift)
    n = shifted - c.shift
    first, second = m.fma(-n, c.quarter[0], a), n * c.quarter[1]
    r = first - second
    lost_bits = (first - r) - second
    if c.fused:
        lost_bits = lost_bits - m.fma(n, c.quarter[1], -second)
    rest = m.fma(-n, c.quarter[2], lost_bits)
    if not c.fused:  # parts are short, and so the rest is not small
        whole = r + rest
        r, rest = whole, (r - whole) + rest
    z = r * r
    sine = r + m.fma(z * r, m.polynomial(z, c.sin), rest)
    half = 0.5 * z
    most = 1.0 - half  # of the cosine; its rounding error comes with the smaller terms
    cosine = most + m.fma(z * z, m.polynomial(z, c.cos), ((1.0 - most) - half) - r * rest)
    return sine, cosine, n if m.bitless else m.bits(shifted)


def shifted_power(m: Maths, shifted: Any, less: Any = None) -> Any:
    """Return 2^n from n + shift, in the normal range, or 2^(n - k) if `less` is k + shift."""
    if m.bitless:
        return m.call("power", shifted - (m.c.shift if less is None else less))
    bits = m.bits(shifted) if less is None else m.bits(shifted) - m.bits(less)
    return m.from_bits((bits << m.c.mantissa) + m.c.one_bits)


def halved_power(m: Maths, n: Any, shifted: Any) -> Any:
    """Return 2^(n - 1), 0 of the least n, from n and n + shift."""
    if m.bitless:
        return m.select(n < 1.5 - m.c.bias, 0.0, m.call("power", n - 1.0))
    return m.from_bits((m.bits(shifted) << m.c.mantissa) + (m.c.one_bits - (1 << m.c.mantissa)))


def reduce_exponent(m: Maths, x: Any) -> Any:
    """Return n, n + shift and e^r - 1 for x = n log 2 + r, |r| <= log(2) / 2."""
    c = m.c
    shifted = m.fma(x, 1 / math.log(2), c.shift)
    n = shifted - c.shift
    r = m.fma(-n, c.log2[1], m.fma(-n, c.log2[0], x))
    return n, shifted, m.fma(r * r, m.polynomial(r, c.exp), r)


def clip_exponent(m: Maths, x: Any) -> Any:
    """Return an argument of exp, clipped where exp becomes infinite or 0."""
    x = m.select(x > m.c.most, m.c.most, x)
    return m.select(x < m.c.least, m.c.least, x)


def one_minus_exp(m: Maths, g: Any) -> Any:
    """Return 1 - e^-g for g >= 0 so small that e^-g is a normal number."""
    _, shifted, part = reduce_exponent(m, -g)
    scale = shifted_power(m, shifted)
    return m.fma(-scale, part, 1.0 - scale)


# --- The functions


def sign(m: Maths, x: Any) -> Any:
    """Return sign: -1, 0 or 1."""
    return m.select(x < 0.0, -1.0, m.select(x > 0.0, 1.0, x))


def smaller_of(m: Maths, x: Any, y: Any) -> Any:
    """Return the smaller of two numbers."""
    return m.select((x < y) | (y != y), x, y)


def larger_of(m: Maths, x: Any, y: Any) -> Any:
    """Return the larger of two numbers."""
    return m.select((y < x) | (y != y), x, y)


def floor(m: Maths, x: Any) -> Any:
    """Return the largest whole number that is not larger."""
    a = abs(x)
    near = m.call("copysign", (a + m.c.first_whole) - m.c.first_whole, x)
    return m.select(a < m.c.first_whole, near - m.select(x < near, 1.0, 0.0 * a), x)


def ceil(m: Maths, x: Any) -> Any:
    """Return the smallest whole number that is not smaller."""
    return -m.call("floor", -x)


def exp(m: Maths, x: Any) -> Any:
    """Return exponential, with 2^n in two factors, so that the largest numbers come out, and
    subnormal ones in double.
    """
    n, shifted, part = reduce_exponent(m, clip_exponent(m, x))
    if m.c.flushes:
        scale = halved_power(m, n, shifted)
        half_value = m.fma(scale, part, scale)
        return half_value + half_value
    half = m.fma(n, 0.5, m.c.shift)
    scale = shifted_power(m, half)
    return m.fma(scale, part, scale) * shifted_power(m, shifted, half)


def expm1(m: Maths, x: Any) -> Any:
    """Return e^x - 1, from half of it."""
    most = (m.c.bias + 1.25) * math.log(2)  # infinite, by the largest n that has a power
    n, _, part = reduce_exponent(m, m.select(x < -50.0, -50.0, m.select(x > most, most, x)))
    half = shifted_power(m, n + (m.c.shift - 1.0))
    return 2.0 * m.fma(half, part, half - 0.5)


def split_mantissa(m: Maths, x: Any) -> Any:
    """Return n and f of x = 2^n (1 + f), sqrt(1/2) <= 1 + f < sqrt(2)."""
    if m.bitless:
        return m.call("exponent", x), m.call("fraction", x) - 1.0
    c = m.c
    lift, counted = c.mantissa + 2, c.first_whole + c.bias
    small = x < 2.0 ** (1 - c.bias)
    word = m.bits(m.select(small, x * 2.0**lift, x)) + (c.one_bits - c.half)
    count = (c.bias + c.mantissa) << c.mantissa  # the bits of `whole`, to which n is added
    n = m.from_bits((word >> c.mantissa) | count) - m.select(small, counted + lift, counted)
    return n, m.from_bits((word & ((1 << c.mantissa) - 1)) + c.half) - 1.0


def log(m: Maths, x: Any) -> Any:
    """Return natural logarithm n log 2 + log(1 + f), -infinity of 0, NaN of negative numbers."""
    c = m.c
    n, f = split_mantissa(m, x)
    s = f / (2.0 + f)
    z = s * s
    whole = n * c.log2_short[0]
    high = whole + f
    smaller = m.fma(n, c.log2_short[1], -s * m.fma(-z, m.polynomial(z, c.log), f))
    value = high + ((f - (high - whole)) + smaller)
    edge = m.select(x == 0.0, -math.inf, math.nan)
    return m.select(x <= c.largest_finite, m.select(x > 0.0, value, edge), x)


def log1p(m: Maths, x: Any) -> Any:
    """Return log(1 + x)."""
    u = 1.0 + x
    gap = u - 1.0
    zero = gap == 0.0
    return m.select(zero, x, m.call("log", u) * (x / m.select(zero, 1.0, gap)))


def erf(m: Maths, x: Any) -> Any:
    """Return error function, as 1 - e^-g(|x|)."""
    c, a = m.c, abs(x)
    a = m.select(a > c.certain, c.certain, a)
    value = one_minus_exp(m, m.fma(a, c.head, a * m.polynomial(a, c.erf)))
    return m.call("copysign", value, x)


def erf_by_exp(m: Maths, x: Any, e: Any) -> Any:
    """Return error function from e = e^-x^2, as (1 - e) + e |x| t p(t), t = 1 / (2 + |x|)."""
    c, a = m.c, abs(x)
    if not c.erf_by_exp:
        return m.call("erf", x)
    a = m.select(a > c.certain, c.certain, a)
    t = 1.0 / (2.0 + a)
    value = (1.0 - e) + (e * a) * (t * m.polynomial(t, c.erf_by_exp))
    return m.call("copysign", value, x)


def sin(m: Maths, x: Any) -> Any:
    """Return sine, 0 of |x| above 8000 (float) or 1e5 (double)."""
    sine, cosine, n = reduce_angle(m, x)
    value = m.select((n & 1) != 0, cosine, sine)
    return m.from_bits(m.bits(value) ^ ((n & 2) << (m.c.bits - 2)) ^ (m.bits(x) & m.c.sign))


def cos(m: Maths, x: Any) -> Any:
    """Return cosine, 1 of |x| above 8000 (float) or 1e5 (double)."""
    sine, cosine, n = reduce_angle(m, x)
    value = m.select((n & 1) != 0, sine, cosine)
    return m.from_bits(m.bits(value) ^ (((n + 1) & 2) << (m.c.bits - 2)))


def tan(m: Maths, x: Any) -> Any:
    """Return tangent, 0 of |x| above 8000 (float) or 1e5 (double)."""
    sine, cosine, n = reduce_angle(m, x)
    odd = (n & 1) != 0
    value = m.select(odd, cosine, sine) / m.select(odd, sine, cosine)
    return m.from_bits(m.bits(value) ^ (n << (m.c.bits - 1)) ^ (m.bits(x) & m.c.sign))


def atan(m: Maths, x: Any) -> Any:
    """Return arc tangent."""
    c, a = m.c, abs(x)
    # The polynomial needs |r| <= tan(pi/8). By the addition theorem, with x >= 0:
    #   x > tan(3 pi/8): atan x = pi/2 + atan r, r = -1 / x
    #   x > tan(pi/8):   atan x = pi/4 + atan r, r = (x - 1) / (x + 1)
    #   else:            atan x = atan r, r = x
    far, middle = a > math.tan(3 * math.pi / 8), a > math.tan(math.pi / 8)
    numerator, denominator = m.select(far, -1.0, a - 1.0), m.select(far, a, a + 1.0)
    r = m.select(middle, numerator, a) / m.select(middle, denominator, 1.0)
    z = r * r
    # pi/2 and pi/4 are sums of two numbers, so that the last bits are right.
    angle = m.select(far, c.pi2[0], m.select(middle, c.pi4[0], 0.0 * z))
    angle_rest = m.select(far, c.pi2[1], m.select(middle, c.pi4[1], 0.0 * z))
    return m.call("copysign", angle + ((r * z * m.polynomial(z, c.atan) + angle_rest) + r), x)


def atan2(m: Maths, y: Any, x: Any) -> Any:
    """Return angle of (y, x)."""
    right, zero = m.c.pi2[0], x == 0.0
    quotient = m.call("atan", y / m.select(zero, 1.0, x))
    turned = m.select(y < 0.0, quotient - 2 * right, quotient + 2 * right)
    upright = m.select(y < 0.0, -right, m.select(y > 0.0, right, 0.0 * y))
    return m.select(zero, upright, m.select(x < 0.0, turned, quotient))


def asin(m: Maths, x: Any) -> Any:
    """Return arc sine."""
    return m.call("atan2", x, m.sqrt((1.0 - x) * (1.0 + x)))


def acos(m: Maths, x: Any) -> Any:
    """Return arc cosine."""
    return m.call("atan2", m.sqrt((1.0 - x) * (1.0 + x)), x)


def sinh(m: Maths, x: Any) -> Any:
    """Return hyperbolic sine."""
    a = abs(x)
    t, half = m.call("expm1", a), m.call("exp", a * 0.5)
    near = 0.5 * (t + t / (t + 1.0))
    return m.call("copysign", m.select(a < 20.0, near, (0.5 * half) * half), x)


def cosh(m: Maths, x: Any) -> Any:
    """Return hyperbolic cosine."""
    a = abs(x)
    e, half = m.call("exp", a), m.call("exp", a * 0.5)
    return m.select(a < 20.0, 0.5 * (e + 1.0 / e), (0.5 * half) * half)


def tanh(m: Maths, x: Any) -> Any:
    """Return hyperbolic tangent, as q / (2 - q), q = 1 - e^-2|x|."""
    a = abs(x)
    q = one_minus_exp(m, 2.0 * m.select(a > 20.0, 20.0, a))
    return m.call("copysign", q / (2.0 - q), x)


def asinh(m: Maths, x: Any) -> Any:
    """Return inverse of sinh."""
    a = abs(x)
    far = a > 1e8
    b = m.select(far, 1.0, a)
    near = m.call("log1p", b + b * b / (1.0 + m.sqrt(b * b + 1.0)))
    return m.call("copysign", m.select(far, m.call("log", a) + math.log(2), near), x)


def acosh(m: Maths, x: Any) -> Any:
    """Return inverse of cosh."""
    far = x > 1e8
    t = m.select(far, 1.0, x - 1.0)
    near = m.call("log1p", t + m.sqrt(2.0 * t + t * t))
    return m.select(far, m.call("log", x) + math.log(2), near)


def atanh(m: Maths, x: Any) -> Any:
    """Return inverse of tanh."""
    a = abs(x)
    return m.call("copysign", 0.5 * m.call("log1p", 2.0 * a / (1.0 - a)), x)


def power_of(m: Maths, x: Any, y: Any) -> Any:
    """Return x^y as e^(y log x): its relative error grows with |y log x|."""
    half = y * 0.5
    size = m.call("exp", y * m.call("log", abs(x)))
    signed = m.select(m.call("floor", half) == half, size, -size)
    negative = m.select(m.call("floor", y) == y, signed, math.nan)
    one = (y == 0.0) | (x == 1.0)
    return m.select(one, 1.0, m.select(x < 0.0, negative, size))


def hypot(m: Maths, x: Any, y: Any) -> Any:
    """Return sqrt(x^2 + y^2)."""
    a, b = abs(x), abs(y)
    more, less = m.select(b < a, a, b), m.select(b < a, b, a)
    ratio = less / m.select(more == 0.0, 1.0, more)
    return more * m.sqrt(1.0 + ratio * ratio)


# --- As graphs

_OWN: Final = (
    *(sign, floor, ceil, exp, expm1, log, log1p, erf, erf_by_exp),
    *(sin, cos, tan, atan, atan2, asin, acos),
    *(sinh, cosh, tanh, asinh, acosh, atanh, hypot),
)
FUNCTIONS: Final[dict[str, Callable[..., Any]]] = {
    "fmin": smaller_of,
    "fmax": larger_of,
    **{function.__name__: function for function in _OWN},
    "pow": power_of,
}
"""By C's names, in an order in which each calls earlier ones only."""

LANES_OWN: Final = ("sin", "cos", "exp", "log", "erf", "tanh")
"""Those that take the C library's place in fused lanes."""


@dataclass(frozen=True, eq=False)
class FunctionSet:
    """Elementary functions of a target language.

    Attributes:
        functions: by their names, in an order in which each calls earlier ones only.
        bitless: whether it shows no bits of a number.
    """

    functions: dict[str, Callable[..., Any]]
    bitless: bool


OF_WORDS: Final = FunctionSet(FUNCTIONS, bitless=False)


@functools.cache
def build_elementary(name: str, kind: str, own: FunctionSet = OF_WORDS) -> Part:
    """Return a function in float32 or float64, with one result, without fused operations."""
    function, nodes = own.functions[name], Nodes()
    texts = list(inspect.signature(function).parameters)[1:]
    inputs = [nodes.intern_input(text, LANES, kind) for text in texts]
    numbers = SINGLE if kind == SINGLE.kind else DOUBLE
    arguments = [Value(nodes, node) for node in inputs]
    value = function(Maths(nodes, numbers, bitless=own.bitless), *arguments)
    return Part(name, inputs, [value.node])


def called_functions(results: Results) -> set[str]:
    """Return the names of the functions that the results call, including the C library's."""
    return {node.text for node in count_uses(results) if node.op == "call"}


def inline_functions(
    nodes: Nodes, numbers: Numbers, names: Iterable[str]
) -> dict[str, Callable[..., Node]]:
    """Return builders that replace a call of a function by its instructions, by its name.

    Args:
        nodes: graph that receives the instructions.
        numbers: constants of the arithmetic.
        names: names of the functions.
    """
    maths = Maths(nodes, numbers, inline=True)

    def build_function(name: str) -> Callable[..., Node]:
        """Return the builder of a function."""
        return lambda *args: maths.call(name, *[Value(nodes, arg) for arg in args]).node

    return {name: build_function(name) for name in names}


def required_functions(
    names: set[str], kind: str = DOUBLE.kind, own: FunctionSet = OF_WORDS
) -> list[str]:
    """Return the functions and all functions that these call, callees first."""
    found = set(names)
    for name in reversed(own.functions):
        if name in found:
            found |= called_functions([build_elementary(name, kind, own).results])
    return [name for name in own.functions if name in found]
