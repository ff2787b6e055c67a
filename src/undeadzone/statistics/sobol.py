"""Sobol points scrambled as SciPy scrambles them, bit for bit, each at once: SciPy walks there from the first, and its import takes longer than most runs."""

from __future__ import annotations

import functools
import operator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from undeadzone.support.arrays import Floats, Integers

BITS: Final = 32
DIMENSIONS: Final = 21201


def points(seed: int, first: int, count: int, dimensions: int) -> Floats:
    """Points first .. first + count (count x dimensions, at most `DIMENSIONS`), at the lower corners of their cells of 2^-32."""
    directions, shift = _scrambled(seed, dimensions)
    index = np.arange(first, first + count, dtype=np.uint64)
    gray = index ^ (index >> np.uint64(1))
    found = np.tile(shift, (count, 1))
    for bit in range((first + count - 1).bit_length()):
        found[(gray >> np.uint64(bit)) & np.uint64(1) == 1] ^= directions[:, bit]
    return found * 2.0**-BITS


@functools.lru_cache(maxsize=4)
def _scrambled(seed: int, dimensions: int) -> tuple[Any, Any]:
    """The direction numbers (dimensions x BITS) under random lower triangular matrices, and a random shift, Matousek (1998)."""
    (rng,) = np.random.default_rng(seed).spawn(1)
    shift = rng.integers(2, size=(dimensions, BITS), dtype=np.uint32) @ (
        np.uint32(1) << np.arange(BITS, dtype=np.uint32)
    )
    matrices = np.tril(
        rng.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32), -1
    ) | np.eye(BITS, dtype=np.uint32)
    places = np.arange(BITS - 1, -1, -1, dtype=np.uint32)  # of digits, the most significant first
    digits = (_directions(dimensions)[:, None, :] >> places[:, None]) & np.uint32(1)
    return ((matrices @ digits & np.uint32(1)) << places[:, None]).sum(
        axis=1, dtype=np.uint32
    ), shift


def _directions(dimensions: int) -> Integers:
    """The direction numbers (dimensions x BITS) of Joe, Kuo (2008): SciPy's table, continued by the recurrence of each primitive polynomial."""
    package = find_spec("scipy.stats")
    assert package is not None
    assert package.origin is not None
    with np.load(Path(package.origin).with_name("_sobol_direction_numbers.npz")) as table:
        polynomials, initial = (
            table["poly"][:dimensions].tolist(),
            table["vinit"][:dimensions].tolist(),
        )
    rows = []
    for polynomial, row in zip(polynomials, initial, strict=True):
        degree = polynomial.bit_length() - 1
        row = row[:degree] if degree else [1] * BITS
        for j in range(len(row), BITS):
            terms = [
                row[j - k] << k for k in range(1, degree + 1) if polynomial >> (degree - k) & 1
            ]
            row.append(functools.reduce(operator.xor, terms, row[j - degree]))
        rows.append(row)
    return np.array(rows, np.uint32) << np.arange(BITS - 1, -1, -1, dtype=np.uint32)
