"""Designs: uniform, stratified where they say so, the same whatever the blocks.

They are those of SciPy where it has them.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats
from undeadzone_studies.statistics.sampling import (
    BITS,
    design_points,
    permute_runs,
)

DESIGNS = ["random", "latin_hypercube", "sobol", "saltelli"]


@pytest.mark.parametrize("sampling", DESIGNS)
@settings(max_examples=40, deadline=None)
@given(data=st.data(), seed=st.integers(0, 2**63 - 1), entries=st.integers(1, 5))
def test_blocks_do_not_matter(sampling: str, data: st.DataObject, seed: int, entries: int) -> None:
    runs = 24 * (entries + 2)
    whole = design_points(sampling, seed, 0, runs, entries, runs)
    cuts = sorted(data.draw(st.lists(st.integers(0, runs), max_size=6)))
    blocks = [
        design_points(sampling, seed, a, b - a, entries, runs)
        for a, b in zip([0, *cuts], [*cuts, runs], strict=True)
    ]
    assert whole.shape == (runs, entries)
    assert np.array_equal(np.concatenate(blocks), whole)


@pytest.mark.parametrize("sampling", DESIGNS)
def test_every_column_is_uniform_inside_the_open_unit_interval(sampling: str) -> None:
    u = design_points(sampling, 5, 0, 6000, 4, 6000)
    assert u.min() > 0
    assert u.max() < 1
    assert all(stats.kstest(column, "uniform").pvalue > 1e-3 for column in u.T)


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube"])
def test_columns_and_neighbours_are_independent(sampling: str) -> None:
    u = design_points(sampling, 7, 0, 40_000, 4, 40_000)
    pairs = np.corrcoef(np.hstack([u[:-1], u[1:]]), rowvar=False) - np.eye(8)
    assert np.abs(pairs).max() < 5 / np.sqrt(len(u))


def test_random_numbers_do_not_depend_on_the_runs_or_entries_beside_them() -> None:
    few, many = (
        design_points("random", 3, 100, 50, 2, 200),
        design_points("random", 3, 100, 50, 9, 10**15),
    )
    assert np.array_equal(few, many[:, :2])
    assert not np.array_equal(few, design_points("random", 4, 100, 50, 2, 200))


@settings(deadline=None)
@given(runs=st.integers(1, 700), seed=st.integers(0, 2**63 - 1))
def test_a_latin_hypercube_has_one_run_in_each_interval_of_each_column(
    runs: int, seed: int
) -> None:
    intervals = np.floor(design_points("latin_hypercube", seed, 0, runs, 3, runs) * runs)
    assert (np.sort(intervals, axis=0) == np.arange(runs)[:, None]).all()


def test_all_permutations_come_up_about_equally_often() -> None:
    permutations = [permute_runs(seed, 1, 3) for seed in range(3000)]
    counts = np.bincount(np.array(permutations) @ [9, 3, 1], minlength=27)
    assert np.count_nonzero(counts) == 6
    assert stats.chisquare(counts[counts > 0]).pvalue > 1e-3


@pytest.mark.parametrize(("seed", "entries"), [(11, 1), (2**62, 3), (0, 300)])
def test_sobol_points_are_those_of_scipy(seed: int, entries: int) -> None:
    engine = stats.qmc.Sobol(entries, bits=BITS, rng=seed)
    expected = engine.random(256) + 2.0 ** -(BITS + 1)
    assert np.array_equal(design_points("sobol", seed, 0, 256, entries, 256), expected)
    assert np.array_equal(design_points("sobol", seed, 100, 50, entries, 256), expected[100:150])
    far = engine.fast_forward(10**6).random(10) + 2.0 ** -(BITS + 1)
    assert np.array_equal(design_points("sobol", seed, 10**6 + 256, 10, entries, 256), far)


def test_no_warning_escapes_from_blocks_of_any_size() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(design_points("sobol", 0, 0, 100, 3, 1000)) == 100
        assert len(design_points("saltelli", 0, 0, 100, 3, 1000)) == 100


def test_saltelli_is_laid_out_as_the_indices_of_scipy_need_it() -> None:
    """The indices of the Ishigami function are known.

    Alone they are 0.314, 0.442, 0, in total 0.558, 0.442, 0.244.
    """
    each, entries = 4096, 3
    runs = each * (entries + 2)
    angles = 2 * np.pi * design_points("saltelli", 2, 0, runs, entries, runs).T - np.pi
    f_A, f_B, *f_AB = _ishigami(angles).reshape(entries + 2, each)
    values = {"f_A": f_A[None], "f_B": f_B[None], "f_AB": np.array(f_AB)[:, None]}
    indices = stats.sobol_indices(func=values, n=each)
    np.testing.assert_allclose(indices.first_order.ravel(), [0.314, 0.442, 0.0], atol=0.02)
    np.testing.assert_allclose(indices.total_order.ravel(), [0.558, 0.442, 0.244], atol=0.02)


def _ishigami(x: Floats) -> Floats:
    return np.asarray(np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0]))


def test_without_entries_there_is_nothing_to_draw() -> None:
    for sampling in ("random", "latin_hypercube", "sobol"):
        assert design_points(sampling, 0, 3, 5, 0, 10).shape == (5, 0)


@pytest.mark.parametrize(
    ("sampling", "entries", "runs", "words"),
    [
        ("random", 2, 0, "ensemble.runs: expected 1 or more, found 0"),
        (
            "saltelli",
            3,
            1001,
            r"ensemble.runs: saltelli with 3 varied entries needs a multiple of 5 runs, "
            r".* a power of 2 \(640 or 1280\), found 1001",
        ),
        ("saltelli", 3, 2, r"\(5 or 10\), found 2"),
        ("saltelli", 0, 10, "ensemble.sampling: saltelli needs an entry that varies, found none"),
        (
            "sobol",
            30_000,
            10,
            "ensemble.sampling: Sobol points have at most 21201 dimensions, found 30000. "
            "Use random",
        ),
        (
            "sobol",
            2,
            2**40,
            "needs 1099511627776, Sobol points are 2\\^31. Use random",
        ),
        ("saltelli", 11_000, 11_002, "at most 21201 dimensions, found 22000"),
    ],
)
def test_designs_that_cannot_be(sampling: str, entries: int, runs: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        design_points(sampling, 0, max(0, runs - 1), 1, entries, runs)
