"""Coefficients and constants of the elementary functions in each arithmetic.

The polynomials of float64 are of least largest error, by Remez's exchange in 60 digits, with the
weight that is named for each. Those of float32 need a third of the terms. They stand in
coefficients.toml.
"""

from __future__ import annotations

from typing import Final

import msgspec

from undeadzone.util.files import read_table


class Numbers(msgspec.Struct, frozen=True):
    """Arithmetic with the constants and coefficients of its elementary functions.

    Attributes:
        kind: of a number.
        word: of its bits.
        fused: whether a b + c is rounded once. If not, the parts of constants are short, so that
            their products with whole numbers are exact.
        mantissa: bits of it.
        bias: of the exponent.
        half: bits of sqrt(1/2).
        far: largest argument of sine, cosine and tangent.
        quarter: pi / 2 in three parts.
        sin: (sin r - r) / r^3 by powers of r^2, |r| <= 1.005 pi/4 (weight 1 / sin).
        cos: (cos r - 1 + r^2 / 2) / r^4 by powers of r^2, |r| <= 1.005 pi/4 (weight 1 / cos).
        most, least: arguments of exp beyond which it is infinite, or 0.
        log2: log 2 in two parts.
        exp: (e^r - 1 - r) / r^2 by powers of r, |r| <= log(2) / 2 (weight r).
        log2_short: the same parts, the first of them short.
        log: (2 artanh(s) / s - 2) / s^2 by powers of s^2, s = f / (2 + f), sqrt(1/2) <= 1 + f <
            sqrt(2) (weight s^2).
        certain: where erf rounds to 1.
        head: 2 / sqrt(pi), with the first of `erf`.
        erf: -log(1 - erf a) / a - head by powers of a in [0, certain] (weight a (1 - erf a) / erf
            a).
        erf_by_exp: (1 - e^a^2 (1 - erf a)) / (a t) by powers of t = 1 / (2 + a) (weight a t e^-a^2)
            (empty: the exponential is of no use to erf).
        flushes: whether exp is 0 of arguments up to `least`, so that no result is subnormal.
        atan: (atan(x) / x - 1) / x^2 by powers of x^2, |x| <= tan(pi / 8).
        pi4, pi2: pi / 4 and pi / 2, each as a number and its rest.
    """

    kind: str
    word: str
    fused: bool
    mantissa: int
    bias: int
    half: int
    far: float
    quarter: tuple[float, float, float]
    sin: tuple[float, ...]
    cos: tuple[float, ...]
    most: float
    least: float
    log2: tuple[float, float]
    exp: tuple[float, ...]
    log2_short: tuple[float, float]
    log: tuple[float, ...]
    certain: float
    head: float
    erf: tuple[float, ...]
    atan: tuple[float, ...]
    pi4: tuple[float, float]
    pi2: tuple[float, float]
    erf_by_exp: tuple[float, ...] = ()
    flushes: bool = False

    @property
    def bits(self) -> int:
        """Return the number of bits of a word."""
        return int(self.word[4:])

    @property
    def sign(self) -> int:
        """Return the word with only the sign bit set."""
        return 1 << (self.bits - 1)

    @property
    def one_bits(self) -> int:
        """Return the bits of the number 1."""
        return self.bias << self.mantissa

    @property
    def largest_finite(self) -> float:
        """Return the largest finite number."""
        return (2.0 - 0.5**self.mantissa) * 2.0**self.bias

    @property
    def first_whole(self) -> float:
        """Return 2^mantissa, the size from which numbers have no fraction."""
        return 2.0**self.mantissa

    @property
    def shift(self) -> float:
        """Return the number whose addition rounds a small number to an integer in the last
        bits of the sum.
        """
        return 1.5 * self.first_whole


_TABLES: Final = read_table(__file__)
DOUBLE: Final = msgspec.convert(_TABLES["double"], Numbers)
FUSED: Final = msgspec.convert(_TABLES["double"] | _TABLES["fused"], Numbers)
SINGLE: Final = msgspec.convert(_TABLES["single"], Numbers)
