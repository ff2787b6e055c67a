"""The period of a sum of sines."""

from __future__ import annotations

import math
from fractions import Fraction


def common_period(frequencies: list[float]) -> float | None:
    """The least common period [s] of frequencies [Hz].

    None if their ratios are not those of whole numbers up to 1000.
    """
    first = frequencies[0]
    ratios = [Fraction(frequency / first).limit_denominator(1000) for frequency in frequencies]
    for frequency, ratio in zip(frequencies, ratios, strict=True):
        if abs(frequency / first - ratio) > 1e-12 * ratio:
            return None
    cycles = Fraction(
        math.lcm(*(ratio.denominator for ratio in ratios)),
        math.gcd(*(ratio.numerator for ratio in ratios)),
    )
    return float(cycles) / first
