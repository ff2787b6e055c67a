"""Sampling designs: points of the unit cube as a function of (seed, run) alone.

A Latin hypercube and Saltelli's design depend on the number of runs too.
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, Integers

# Added to the seed, which is below 2^63: these numbers differ from those of the noise.
STREAM: Final = 1 << 64
# kinds of random words of a column
NUMBERS = 0
ORDER = 1
BITS: Final = 32  # of a Sobol point


def design_points(
    sampling: str, seed: int, first: int, count: int, entries: int, runs: int
) -> Floats:
    """Return points inside the open unit cube (count x entries).

    Args:
        sampling: "random", "latin_hypercube", "sobol" or "saltelli".
        seed: of the design.
        first, count: the runs first .. first + count.
        entries: dimensions of the cube.
        runs: of the whole design.

    Raises:
        InputError: a number of runs or entries that the design does not allow.
    """
    if runs < 1:
        raise InputError(f"ensemble.runs: expected 1 or more, found {runs}")
    if sampling == "saltelli":
        return _saltelli_points(seed, first, count, entries, runs)
    if sampling == "sobol":
        return _sobol_points(seed, first, count, entries)
    columns = [_uniform_column(seed, first, count, column) for column in range(entries)]
    if sampling == "latin_hypercube":
        columns = [
            _stratify_column(u, seed, first, column, runs) for column, u in enumerate(columns)
        ]
    return np.stack(columns, axis=1) if columns else np.empty((count, 0))


def _uniform_column(seed: int, first: int, count: int, column: int) -> Floats:
    """Return random odd multiples of 2^-53 (count): never 0 or 1."""
    generator = np.random.Philox(key=STREAM + seed, counter=[first // 4, 0, column, NUMBERS])
    words = generator.random_raw(count + first % 4)[first % 4 :]
    return ((words >> np.uint64(12)) + 0.5) * 2.0**-52


def _stratify_column(u: Floats, seed: int, first: int, column: int, runs: int) -> Floats:
    """Return a point of each run in its own of `runs` equal intervals, at the share u."""
    interval = permute_runs(seed, column, runs)[first : first + u.size]
    return np.minimum((interval + u) / runs, np.nextafter(1.0, 0.0))


@functools.lru_cache(maxsize=64)
def permute_runs(seed: int, column: int, runs: int) -> Integers:
    """Return a random permutation of 0 .. runs - 1 for a column of a design (runs)."""
    generator = np.random.Philox(key=STREAM + seed, counter=[0, 0, column, ORDER])
    return np.random.Generator(generator).permutation(runs)


def _sobol_points(seed: int, first: int, count: int, entries: int) -> Floats:
    """Return scrambled Sobol points in the unit cube (count x entries).

    The points lie on a grid of 2^-BITS. They are moved to the middle of their cells: a
    coordinate 0 would give an infinite normal quantile.

    Args:
        seed: of the scrambling.
        first: index of the first point in the sequence.
        count: number of points.
        entries: dimension of the cube.
    """
    if entries == 0 or count == 0:
        return np.empty((count, entries))
    from scipy.stats import qmc  # importing it takes longer than most runs

    if entries > qmc.Sobol.MAXDIM:
        raise InputError(
            f"ensemble.sampling: Sobol points have at most {qmc.Sobol.MAXDIM} dimensions, "
            f"found {entries}. Use random"
        )
    if first + count > 2 ** (BITS - 1):
        raise InputError(
            f"runs: [ensemble] or [tune] needs {first + count}, Sobol points are "
            f"2^{BITS - 1}. Use random"
        )
    design = qmc.Sobol(entries, bits=BITS, rng=seed)
    if first:
        design.fast_forward(first)
    power_of_two = 1 << (count - 1).bit_length()  # SciPy warns of other numbers of points
    return design.random(power_of_two)[:count] + 0.5**BITS / 2


def _saltelli_points(seed: int, first: int, count: int, entries: int, runs: int) -> Floats:
    """Return the design of Saltelli et al. (2010), from two halves A and B of Sobol points.

    The runs of A come first, then those of B, of A with column 1 of B, of A with column 2 of B, ...

    References:
        A. Saltelli and others (2010), doi:10.1016/j.cpc.2009.09.018
    """
    matrices = entries + 2
    _require_saltelli(entries, runs)
    each = runs // matrices
    parts = []
    for matrix in range(first // each, -(-(first + count) // each)):
        start = max(first, matrix * each)
        stop = min(first + count, (matrix + 1) * each)
        both = _sobol_points(seed, start - matrix * each, stop - start, 2 * entries)
        columns = np.arange(entries) + entries * (matrix == 1)
        if matrix >= 2:
            columns[matrix - 2] += entries
        parts.append(both[:, columns])
    return np.concatenate(parts) if parts else np.empty((0, entries))


def _require_saltelli(entries: int, runs: int) -> None:
    """Raise InputError unless `runs` make up Saltelli's design of `entries`."""
    matrices = entries + 2
    if entries == 0:
        raise InputError("ensemble.sampling: saltelli needs an entry that varies, found none")
    if runs % matrices:
        power = 2 ** max(0, int(np.log2(runs / matrices)))
        raise InputError(
            f"ensemble.runs: saltelli with {entries} varied entries needs a multiple of {matrices} "
            f"runs, at best times a power of 2 ({matrices * power} or {2 * matrices * power}), "
            f"found {runs}"
        )
