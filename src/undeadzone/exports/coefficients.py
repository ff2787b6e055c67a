"""Numbers of the elementary functions in each precision; polynomials by Chebyshev's points."""

from __future__ import annotations

import math
from typing import NamedTuple

from undeadzone.compile import elementary


class Numbers(NamedTuple):
    """What the elementary functions of a precision consist of.

    Attributes:
        least: smallest normal number.
        lift: power of 2 that makes subnormal numbers normal.
        log2: log 2 as a short number, whose products with exponents are exact, and the rest.
        overflow, underflow: arguments of exp beyond which it is infinite, or 0.
        exp: (e^r - 1 - r) / r^2 by r, |r| <= log(2) / 2.
        log: (2 artanh(s) / s - 2) / s^2 by s^2.
        quarter: pi / 2 in three parts, the first two short.
        furthest: largest argument of sin and cos.
        sin, cos: (sin r / r - 1) / r^2 and (cos r - 1 + r^2 / 2) / r^4 by r^2, |r| <= pi / 4.
        atan: (atan(x) / x - 1) / x^2 by x^2, |x| <= tan(pi / 8).
        pi4, pi2: pi / 4 and pi / 2, each as a number and its rest.
        erf_near: erf(x) / x by x^2, |x| <= 1/2.
        erf_far: -log(1 - erf x) / x by x.
        certain: beyond it, erf is 1.
    """

    least: float
    lift: float
    log2: tuple[float, float]
    overflow: float
    underflow: float
    exp: tuple[float, ...]
    log: tuple[float, ...]
    quarter: tuple[float, float, float]
    furthest: float
    sin: tuple[float, ...]
    cos: tuple[float, ...]
    atan: tuple[float, ...]
    pi4: tuple[float, float]
    pi2: tuple[float, float]
    erf_near: tuple[float, ...]
    erf_far: tuple[float, ...]
    certain: float


SINGLE = Numbers(
    least=2.0**-126,
    lift=25.0,
    log2=(0.693359375, -2.12194440e-4),
    overflow=89.0,
    underflow=-87.0,
    exp=(
        0.500000001429109,
        0.16666666722230075,
        0.04166645677791302,
        0.008333297063830462,
        0.001393454452077215,
        0.00019900443813615233,
    ),
    log=(0.6666666654423972, 0.4000012995369697, 0.28549921167284736, 0.23354497929544507),
    quarter=(1.5703125, 4.837512969970703e-4, 7.54978995489188e-8),
    furthest=8000.0,
    sin=(-0.16666664542406717, 0.008332725000087459, -0.0001958289205437704),
    cos=(0.041666664538856854, -0.0013888279652855464, 2.4542922323138213e-05),
    atan=(
        -0.3333333174149294,
        0.19999533391210308,
        -0.1426365199717305,
        0.10740013674856196,
        -0.06438549020919085,
    ),
    pi4=(0.785398185253143310546875, -2.18556950e-8),
    pi2=(1.57079637050628662109375, -4.37113900e-8),
    erf_near=(
        1.1283791656118878,
        -0.3761260912683833,
        0.11282833623317186,
        -0.026757861033642506,
        0.004719314994690786,
    ),
    erf_far=(
        1.1283793774017525,
        0.6366092880881087,
        0.10285789257183475,
        -0.019391229758734675,
        0.00017951256115254473,
        0.001415167964452251,
        -0.0005404290386834937,
        0.00010678771678104139,
        -1.1481621168728888e-05,
        5.294813313490753e-07,
    ),
    certain=4.0,
)


def _erf_series() -> tuple[float, ...]:
    """erf(x) / x by x^2, the series of Maclaurin; its 14th term is below 2^-60 at x = 1/2."""
    terms = []
    for k in range(14):
        terms.append(2 / math.sqrt(math.pi) * (-1) ** k / (math.factorial(k) * (2 * k + 1)))
    return tuple(terms)


DOUBLE = Numbers(
    least=2.0**-1022,
    lift=54.0,
    log2=(6.93147180369123816490e-01, 1.90821492927058770002e-10),
    overflow=710.0,
    underflow=-708.0,
    exp=elementary.EXP,
    log=elementary.LOG,
    quarter=(1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    furthest=1e5,
    sin=elementary.SIN,
    cos=elementary.COS,
    atan=(
        -0.33333333333333304,
        0.19999999999984602,
        -0.14285714283376835,
        0.1111111094693837,
        -0.09090902661959809,
        0.07692153096600197,
        -0.06664260722067589,
        0.05857502401616057,
        -0.05092147301219989,
        0.039910338291914406,
        -0.021620254100164805,
        0.003277577170168969,
    ),
    pi4=(0.7853981633974483, 3.061616997868383e-17),
    pi2=(1.5707963267948966, 6.123233995736766e-17),
    erf_near=_erf_series(),
    erf_far=(elementary.HEAD + elementary.ERF[0], *elementary.ERF[1:]),
    certain=elementary.CERTAIN,
)


def numbers(single: bool) -> Numbers:
    """The numbers of a precision."""
    return SINGLE if single else DOUBLE
