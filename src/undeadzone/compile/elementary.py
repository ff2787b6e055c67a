"""Elementary functions as plain arithmetic, which LLVM vectorises over lanes.

They are sin, cos, exp, log, erf and tanh of a number. `traced` calls these functions with its own
`select`, `fma`, `bits`, `number` and `polynomial`; there is no branch and no call in them, and
every operation rounds once by IEEE 754, so that all processors and lane widths give the same
bits. Errors stay below 1 ulp (erf 1.5, tanh 3); NaN, infinities, zeros of either sign and subnormal
numbers mean what they mean in C. The polynomials are of least largest error, by Remez's exchange in
60 digits, with the weight that is named for each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # from `traced`

    def select(condition: Any, yes: Any, no: Any) -> Any:
        """Yes where the condition holds, else no."""

    def fma(a: Any, b: Any, c: Any) -> Any:
        """a * b + c, rounded once."""

    def bits(x: Any) -> Any:
        """The bits of a number, as an unsigned integer."""

    def number(x: Any) -> Any:
        """The number that has these bits."""

    def polynomial(x: Any, coefficients: tuple[float, ...]) -> Any:
        """coefficients[0] + coefficients[1] x + ..."""


FUNCTIONS = ("sin", "cos", "exp", "log", "erf", "tanh")

# A number to which it is added becomes an integer, in two's complement in the last bits of the sum.
SHIFT = 1.5 * 2.0**52

# Parts of a number: bits of the mantissa, the bit of the sign.
MANTISSA = np.uint64(52)
SIGN = np.uint64(1 << 63)

# Of a count of quarter turns: the bit that swaps sine and cosine, the one that changes the sign,
# and how far that one lies from the bit of a sign.
ODD = np.uint64(1)
HALF_TURN = np.uint64(2)
TO_SIGN = np.uint64(62)

# Bits of 1, of sqrt(1/2), and those of a mantissa.
ONE = np.uint64(0x3FF << 52)
LEAST = np.uint64(0x3FE6A09E667F3BCD)
FRACTION = np.uint64((1 << 52) - 1)

# Bits of 2^52: with an integer in its mantissa it is 2^52 more than that. COUNTED takes off 2^52
# and the bias of an exponent.
COUNT = np.uint64(0x433 << 52)
COUNTED = 2.0**52 + 1023

# The largest argument of sine and cosine, 2 / pi, and pi / 2 in three parts.
FAR = 2.0**45
TURNS = 0.6366197723675814
QUARTER = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591698e-33)

# (sin r - r) / r^3 by powers of r^2, |r| <= 1.005 pi/4; weight 1 / sin: 2^-58.
SIN = (
    -0.1666666666666663,
    0.008333333333321867,
    -0.00019841269829351657,
    2.7557313527695806e-06,
    -2.505073154586686e-08,
    1.5895209746055687e-10,
)
# (cos r - 1 + r^2 / 2) / r^4 by powers of r^2, |r| <= 1.005 pi/4; weight 1 / cos: 2^-64.
COS = (
    0.041666666666666595,
    -0.0013888888888873385,
    2.480158728900059e-05,
    -2.7557314207741605e-07,
    2.0875702934427074e-09,
    -1.135856184094998e-11,
)

# log 2 in two parts, and 1 / log 2.
LN2 = (0.6931471805599453, 2.3190468138462996e-17)
DOUBLINGS = 1.4426950408889634

# (e^r - 1 - r) / r^2 by powers of r, |r| <= log(2) / 2; weight r: 2^-61.
EXP = (
    0.5,
    0.16666666666666677,
    0.0416666666666667,
    0.008333333333321617,
    0.0013888888888866694,
    0.00019841269886157698,
    2.4801587360795128e-05,
    2.755724418270308e-06,
    2.755724258742789e-07,
    2.5109044640515566e-08,
    2.0924488510003118e-09,
)

# log 2 with 11 zero bits at the end of the first part.
LN2_SHORT = (0.6931471805598903, 5.497923018708371e-14)

# (2 artanh(s) / s - 2) / s^2 by powers of s^2, s = f / (2 + f), sqrt(1/2) <= 1 + f < sqrt(2);
# weight s^2: 2^-58.
LOG = (
    0.6666666666666734,
    0.3999999999941394,
    0.2857142874256638,
    0.22222198553420341,
    0.1818356542424928,
    0.15314020709753456,
    0.14796265152338745,
)

# Where erf rounds to 1. 2 / sqrt(pi) is the sum of HEAD and ERF[0].
CERTAIN = 5.93
HEAD = 1.1283791670955126

# -log(1 - erf a) / a by powers of a in [0, CERTAIN]; weight a (1 - erf a) / erf a: 2^-57.
ERF = (
    9.76117611312222e-18,
    0.6366197723675836,
    0.10277260330178874,
    -0.019128447005068803,
    -0.00020919469486840712,
    0.001696206385974935,
    -0.0005901255541723382,
    2.5878609143621217e-05,
    6.449184749408079e-05,
    -2.9724018709271747e-05,
    3.407222134222892e-06,
    2.8351939834190592e-06,
    -1.7416005899555316e-06,
    3.3640688952601167e-07,
    1.3715495743723908e-07,
    -1.417478513980929e-07,
    6.572760629362529e-08,
    -2.0960695130725553e-08,
    4.997190901466319e-09,
    -9.081181835126703e-10,
    1.248248513746862e-10,
    -1.2609178042862588e-11,
    8.844158337298547e-13,
    -3.8498487535343996e-14,
    7.832682749273684e-16,
)


def turned(x: Any) -> Any:
    """Sine and cosine of r, |x| = n pi/2 + r, |r| <= pi/4, and bits that end with n.

    Beyond 2^45 those of 0. r is found as a sum of two numbers, the first of which may be as small
    as 2^-60.
    """
    a = abs(x)
    a = select(a <= FAR, a, 0.0 * a)
    shifted = fma(a, TURNS, SHIFT)
    n = shifted - SHIFT
    first, second = fma(-n, QUARTER[0], a), n * QUARTER[1]
    r = first - second
    lost_bits = ((first - r) - second) - fma(n, QUARTER[1], -second)
    rest = fma(-n, QUARTER[2], lost_bits)
    z = r * r
    sine = r + fma(z * r, polynomial(z, SIN), rest)
    half = 0.5 * z
    most = 1.0 - half  # of the cosine; what it lost by rounding comes with the smaller terms
    cosine = most + fma(z * z, polynomial(z, COS), ((1.0 - most) - half) - r * rest)
    return sine, cosine, bits(shifted)


def sin(x: Any) -> Any:
    """Sine; within 1 ulp up to |x| = 2^45 (1/250 between neighbouring numbers), 0 beyond."""
    sine, cosine, n = turned(x)
    value = select((n & ODD) != np.uint64(0), cosine, sine)
    return number(bits(value) ^ ((n & HALF_TURN) << TO_SIGN) ^ (bits(x) & SIGN))


def cos(x: Any) -> Any:
    """Cosine; within 1 ulp up to |x| = 2^45, 1 beyond."""
    sine, cosine, n = turned(x)
    value = select((n & ODD) != np.uint64(0), sine, cosine)
    return number(bits(value) ^ (((n + ODD) & HALF_TURN) << TO_SIGN))


def power(shifted: Any) -> Any:
    """2^n of n + SHIFT, n from -1022 to 1023."""
    return number((bits(shifted) << MANTISSA) + ONE)


def raised(x: Any) -> Any:
    """n and e^r - 1 of x = n log 2 + r, |r| <= log(2) / 2."""
    n = fma(x, DOUBLINGS, SHIFT) - SHIFT
    r = fma(-n, LN2[1], fma(-n, LN2[0], x))
    return n, fma(r * r, polynomial(r, EXP), r)


def exp(x: Any) -> Any:
    """Exponential; 2^n in two factors, so that the largest numbers and subnormal ones come out."""
    x = select(x > 750.0, 750.0, x)
    n, part = raised(select(x < -750.0, -750.0, x))
    half = fma(n, 0.5, SHIFT)
    scale = power(half)
    return fma(scale, part, scale) * power(n - (half - SHIFT) + SHIFT)


def log(x: Any) -> Any:
    """Natural logarithm n log 2 + log(1 + f); -inf of 0, NaN of negative numbers."""
    small = x < 2.0**-1022
    word = bits(select(small, x * 2.0**54, x)) + (ONE - LEAST)
    n = number((word >> MANTISSA) | COUNT) - select(small, COUNTED + 54.0, COUNTED)
    f = number((word & FRACTION) + LEAST) - 1.0
    s = f / (2.0 + f)
    z = s * s
    whole = n * LN2_SHORT[0]
    high = whole + f
    smaller = fma(n, LN2_SHORT[1], -s * fma(-z, polynomial(z, LOG), f))
    value = high + ((f - (high - whole)) + smaller)
    value = select(x > 0.0, value, select(x == 0.0, -np.inf, np.nan))
    return select(x < np.inf, value, x)


def lost(g: Any) -> Any:
    """1 - e^-g of 0 <= g <= 700."""
    n, part = raised(-g)
    scale = power(n + SHIFT)
    return fma(-scale, part, 1.0 - scale)


def signed(value: Any, x: Any) -> Any:
    """A number that is not negative, with the sign of x."""
    return number(bits(value) | (bits(x) & SIGN))


def erf(x: Any) -> Any:
    """Error function, as 1 - e^-g(|x|)."""
    a = abs(x)
    a = select(a > CERTAIN, CERTAIN, a)
    return signed(lost(fma(a, HEAD, a * polynomial(a, ERF))), x)


def tanh(x: Any) -> Any:
    """Hyperbolic tangent, as q / (2 - q), q = 1 - e^-2|x|."""
    a = abs(x)
    q = lost(2.0 * select(a > 20.0, 20.0, a))
    return signed(q / (2.0 - q), x)
