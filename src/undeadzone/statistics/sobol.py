"""Sobol points scrambled as SciPy scrambles them, bit for bit.

Each is computed at once, where SciPy walks there from the first; and the import of SciPy's takes
longer than most runs.
"""

from __future__ import annotations

import functools
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from undeadzone.support.arrays import Floats, Integers

BITS: Final = 32
DIMENSIONS: Final = 21201


def points(seed: int, first: int, count: int, dimensions: int) -> Floats:
    """Points first .. first + count (count x dimensions), at the lower corners of their cells.

    Args:
        seed: of the scrambling.
        first: number of the first point.
        count: points.
        dimensions: at most `DIMENSIONS`; a cell has sides of 2^-BITS.
    """
    directions, shift = _scrambled(seed, dimensions)
    index = np.arange(first, first + count, dtype=np.uint64)
    gray = index ^ (index >> np.uint64(1))
    numbers = np.tile(shift, (count, 1))
    for bit in range((first + count - 1).bit_length()):
        is_set = (gray >> np.uint64(bit)) & np.uint64(1) == 1
        numbers[is_set] ^= directions[:, bit]
    return numbers * 2.0**-BITS


@functools.lru_cache(maxsize=4)
def _scrambled(seed: int, dimensions: int) -> tuple[Any, Any]:
    """Scrambled direction numbers (dimensions x BITS) and a random shift, Matousek (1998).

    The direction numbers are multiplied by random lower triangular matrices.
    """
    (rng,) = np.random.default_rng(seed).spawn(1)
    powers = np.uint32(1) << np.arange(BITS, dtype=np.uint32)
    shift = rng.integers(2, size=(dimensions, BITS), dtype=np.uint32) @ powers
    random = rng.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32)
    matrices = np.tril(random, -1) | np.eye(BITS, dtype=np.uint32)
    places = np.arange(BITS - 1, -1, -1, dtype=np.uint32)  # of digits, the most significant first
    digits = (_directions(dimensions)[:, None, :] >> places[:, None]) & np.uint32(1)
    scrambled = (matrices @ digits & np.uint32(1)) << places[:, None]
    return scrambled.sum(axis=1, dtype=np.uint32), shift


def _directions(dimensions: int) -> Integers:
    """The direction numbers (dimensions x BITS) of Joe and Kuo (2008).

    SciPy's table is continued by the recurrence of each primitive polynomial.
    """
    package = find_spec("scipy.stats")
    assert package is not None
    assert package.origin is not None
    with np.load(Path(package.origin).with_name("_sobol_direction_numbers.npz")) as table:
        polynomials = table["poly"][:dimensions].tolist()
        initial = table["vinit"][:dimensions].tolist()
    rows = [_continued(*pair) for pair in zip(polynomials, initial, strict=True)]
    return np.array(rows, np.uint32) << np.arange(BITS - 1, -1, -1, dtype=np.uint32)


def _continued(polynomial: int, initial: list[int]) -> list[int]:
    """BITS numbers that begin as given and follow the recurrence of a primitive polynomial.

    The bits of `polynomial` are its coefficients.
    """
    degree = polynomial.bit_length() - 1
    if degree == 0:
        return [1] * BITS
    row = initial[:degree]
    for j in range(degree, BITS):
        number = row[j - degree]
        for k in range(1, degree + 1):
            if polynomial >> (degree - k) & 1:
                number ^= row[j - k] << k
        row.append(number)
    return row
