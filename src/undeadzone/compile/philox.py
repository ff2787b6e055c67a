"""Standard normal numbers from counters, with equal bits in NumPy arrays and in compiled lanes.

Only sums, products, square roots, selections and operations on bits, each rounded once by IEEE 754:
no elementary function of a library. Numbers are NumPy's, or values of `trace` with other functions
than NumPy's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

# Of a word of 64 bits: its lower half, and how far the upper one is shifted.
LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)

# Philox: factors of a round, and its increment of the key.
ROUNDS = 10
MULTIPLY_A = np.uint64(0xD2511F53)
MULTIPLY_C = np.uint64(0xCD9E8D57)
RAISE_LOW = np.uint64(0x9E3779B9)
RAISE_HIGH = np.uint64(0xBB67AE85)

UNIT = np.float32(2.0**-32)  # of a word, and of a quarter turn
HALVE = np.float32(0.5)
ONE = np.float32(1.0)
UPPER = np.uint32(0xC0000000)  # words from 3/4 on
THREE_QUARTERS = np.int32(0x3F400000)  # the bits of 0.75
EXPONENT = np.int32(-0x800000)  # bits of the exponent in a float
DOUBLING = np.float32(-1.3862943611198906 * 2.0**-23)  # -2 log 2, for an exponent at its place
# bits of a word that choose an axis
SIGN = np.uint32(0x80000000)
SWAP = np.uint32(0x40000000)

# Polynomials of least relative error (Remez): -2 log(1 + f) / f for f in [-1/4, 1/2], 1.7e-7.
LOG = np.array(
    [
        *(-2.000000294, 1.000004305, -0.6665952924, 0.4995358186),
        *(-0.4021606699, 0.3474444435, -0.2826373141, 0.1329212015),
    ],
    np.float32,
)
# sin(pi t / 2) / t and cos(pi t / 2) by powers of t^2, |t| <= 1/2, 3e-8.
SIN = np.array([1.570796322, -0.6459634602, 0.07968003277, -0.004601657887], np.float32)
COS = np.array([1.0, -1.233696662, 0.2535949467, -0.02039858178], np.float32)


def philox(a: Any, b: Any, c: Any, d: Any, key: Any, m: Any = np) -> Any:
    """Return four random words of 32 bits: Philox4x32-10 of Salmon et al. (2011).

    References:
        J. K. Salmon and others (2011), doi:10.1145/2063384.2063405

    Args:
        a, b, c, d: the counter, four words of 32 bits (uint64).
        key: 64 bits (uint64).
        m: where functions come from: NumPy, or `trace.Numpy`.
    """
    low = key & LOW
    high = key >> HALF
    for _ in range(ROUNDS):
        x = MULTIPLY_A * a
        y = MULTIPLY_C * c
        a = (y >> HALF) ^ b ^ low
        b = y & LOW
        c = (x >> HALF) ^ d ^ high
        d = x & LOW
        low = (low + RAISE_LOW) & LOW
        high = (high + RAISE_HIGH) & LOW
    return m.uint32(a), m.uint32(b), m.uint32(c), m.uint32(d)


def box_muller(a: Any, b: Any, m: Any = np) -> Any:
    """Return two independent standard normal numbers (float32): radius sqrt(-2 log u), angle
    from b.

    u = (a + 1/2) / 2^32. From 3/4 on it is taken as 1 - v, v as precise as a small u, so that small
    radii (from 1.5e-5) are as fine as large ones (up to 6.76). The angle lies within pi/4 of an
    axis, which two bits of b choose.

    Args:
        a, b: two random words (uint32).
        m: where functions come from: NumPy, or `trace.Numpy`.
    """
    # u = 2^e (1 + f), e = 0 if u is 1 - v.
    upper = a >= UPPER
    x = m.float32((m.float32(m.where(upper, m.uint32(~a), a)) + HALVE) * UNIT)
    exponent = m.where(upper, np.int32(0), m.int32(x.view(m.int32) - THREE_QUARTERS) & EXPONENT)
    f = m.where(upper, -x, m.int32(x.view(m.int32) - exponent).view(m.float32) - ONE)
    log = (LOG[7] * f + LOG[6]) * f + LOG[5]
    log = (log * f + LOG[4]) * f + LOG[3]
    log = (log * f + LOG[2]) * f + LOG[1]
    log = log * f + LOG[0]
    radius = m.sqrt(log * f + DOUBLING * m.float32(exponent))
    # t in (-1/2, 1/2), in quarter turns from an axis.
    t = m.float32(m.uint32((b << np.uint32(2)) | np.uint32(2)).view(m.int32)) * UNIT
    q = t * t
    sine = radius * ((((SIN[3] * q + SIN[2]) * q + SIN[1]) * q + SIN[0]) * t)
    positive = m.float32(radius * (((COS[3] * q + COS[2]) * q + COS[1]) * q + COS[0]))
    cosine = m.uint32(positive.view(m.uint32) ^ (b & SIGN)).view(m.float32)
    swap = (b & SWAP) != np.uint32(0)
    return m.where(swap, sine, cosine), m.where(swap, cosine, sine)
