"""Intervals that cover what they say, against closed forms.

Sensitivities against known indices and naive twins.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import stats

from undeadzone.util.arrays import Floats
from undeadzone_studies.statistics.intervals import (
    LEVEL,
    QUANTILES,
    Extreme,
    Interval,
    binomial_quantile,
    describe,
    deviation_interval,
    jackknife_error,
    mean_interval,
    proportion,
    quantile_interval,
    student_half_width,
)
from undeadzone_studies.statistics.sensitivity import (
    estimate_sobol_indices,
    first_order_by_chance,
    first_order_indices,
    rank_correlations,
    saltelli_indices,
    sensitivities_of_runs,
)

TRIALS = 400
SLACK = 3.5 * np.sqrt(LEVEL * (1 - LEVEL) / TRIALS)  # of a coverage counted in so many trials


def covers(interval: Interval | Extreme, truth: float) -> bool:
    assert isinstance(interval, Interval)
    return interval.low <= truth <= interval.high


def extreme(statistic: Interval | Extreme) -> Extreme:
    assert isinstance(statistic, Extreme)
    return statistic


@pytest.mark.parametrize(
    "law",
    [stats.norm(3.0, 0.5), stats.expon(), stats.uniform()],
    ids=["normal", "exponential", "uniform"],
)
def test_intervals_cover_the_truth_as_often_as_they_say(law: stats.rv_continuous) -> None:
    random = np.random.default_rng(1)
    truth = {"mean": law.mean(), "std": law.std()}
    truth |= {name: law.ppf(share) for name, share in QUANTILES.items()}
    trials = [describe(law.rvs(1000, random_state=random)) for _ in range(TRIALS)]
    for name, value in truth.items():
        coverage = np.mean([covers(statistics[name], value) for statistics in trials])
        exact = name in QUANTILES
        assert coverage > LEVEL - SLACK - (0 if exact else 0.02), name
        assert coverage < 0.995, name


@pytest.mark.parametrize("n", [1, 20, 99, 1000])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.99])
def test_the_interval_of_a_quantile_has_its_coverage_whatever_the_distribution(
    n: int, share: float
) -> None:
    """Values are ranks: X_(low) <= q < X_(high) iff low <= number of runs below q < high."""
    value, low, high = quantile_interval(np.arange(1.0, n + 1), share)
    below = np.arange(n + 1)
    inside = (below >= max(low, 0)) & (below < min(high, n + 1))
    assert stats.binom.pmf(below[inside], n, share).sum() >= LEVEL
    assert low <= value <= high


@pytest.mark.parametrize("n", [1, 7, 100])
@pytest.mark.parametrize("level", [0.025, 0.3, 0.975])
def test_binomial_is_the_quantile_of_its_distribution(n: int, level: float) -> None:
    for share in (0.05, 0.5, 0.99):
        assert binomial_quantile(n, share, level) == stats.binom.ppf(level, n, share)


def test_what_the_runs_do_not_bound_is_infinite() -> None:
    assert quantile_interval(np.arange(100.0), 0.99).high == np.inf
    assert quantile_interval(np.arange(100.0), 0.05).low > -np.inf
    assert quantile_interval(np.arange(20.0), 0.05).low == -np.inf
    assert mean_interval(np.array([1.0])).high == np.inf


@pytest.mark.parametrize("count", [0, 3, 50, 100])
def test_shares_have_the_bounds_of_clopper_and_pearson(count: int) -> None:
    exact = stats.binomtest(count, 100).proportion_ci(LEVEL, "exact")
    assert proportion(count, 100) == pytest.approx((count / 100, exact.low, exact.high), abs=1e-12)


def test_extremes_say_what_share_lies_beyond_them() -> None:
    random = np.random.default_rng(2)
    trials = [describe(random.random(50)) for _ in range(TRIALS)]
    least = [extreme(trial["min"]) for trial in trials]
    largest = [extreme(trial["max"]) for trial in trials]
    coverage = np.mean([one.value <= one.beyond for one in least])
    assert abs(coverage - LEVEL) < SLACK
    coverage = np.mean([1 - one.value <= one.beyond for one in largest])
    assert abs(coverage - LEVEL) < SLACK


def test_infinite_values_have_quantiles_but_no_mean() -> None:
    statistics = describe(np.r_[np.arange(70.0), np.full(30, np.inf)])
    assert statistics["median"] == quantile_interval(np.arange(100.0), 0.5)
    assert statistics["p95"].value == statistics["max"].value == np.inf
    assert np.isnan([*statistics["mean"], *statistics["std"]]).all()


def test_a_column_without_spread_is_known_exactly() -> None:
    statistics = describe(np.full(500, 2.5))
    assert statistics["mean"] == statistics["median"] == (2.5, 2.5, 2.5)
    assert deviation_interval(np.full(500, 2.5)) == (0.0, 0.0, 0.0)


def mean_of_rows(column: Floats, rows: Floats) -> Floats:
    return np.asarray(column[rows].mean())


def test_the_jackknife_finds_the_standard_error_of_a_mean() -> None:
    random = np.random.default_rng(3)
    squares = []
    for column in random.exponential(size=(200, 400)):
        estimate = partial(mean_of_rows, column)
        squares.append(float(jackknife_error(estimate, 400)) ** 2)
    assert np.mean(squares) == pytest.approx(1 / 400, rel=0.1)


def ishigami(X: Floats) -> Floats:
    """Indices: first 0.3139, 0.4424, 0; total 0.5576, 0.4424, 0.2437 (Ishigami and Homma 1990)."""
    return np.sin(X[..., 0]) + 7 * np.sin(X[..., 1]) ** 2 + 0.1 * X[..., 2] ** 4 * np.sin(X[..., 0])


FIRST, TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)


def design(n: int, d: int, seed: int) -> Floats:
    """A, B, AB_1, ..., AB_d ((d + 2) x n x d), uniform on [-pi, pi]."""
    A, B = np.random.default_rng(seed).uniform(-np.pi, np.pi, (2, n, d))
    return np.stack([A, B, *(np.where(np.arange(d) == i, B, A) for i in range(d))])


@pytest.mark.parametrize("n", [500, 20_000])
def test_ishigami_from_given_data(n: int) -> None:
    X = np.random.default_rng(4).uniform(-np.pi, np.pi, (n, 3))
    entries = sensitivities_of_runs(X, ishigami(X))
    for one, truth in zip(entries, FIRST, strict=True):
        assert covers(one.first_order, truth)
        assert one.first_order.high - one.first_order.low < 6 / np.sqrt(n)
    assert entries[0].first_order.value > entries[0].floor
    assert entries[1].partial.p > 0.01  # x_1 decides most and shows in no rank correlation
    assert entries[0].spearman.p < 1e-9


def test_ishigami_from_saltellis_design() -> None:
    entries = saltelli_indices(ishigami(design(4096, 3, seed=5)))
    for one, first, total in zip(entries, FIRST, TOTAL, strict=True):
        assert covers(one.first, first)
        assert covers(one.total, total)
        assert one.total.high - one.total.low < 0.12


def test_indices_are_those_of_scipy() -> None:
    blocks = ishigami(design(256, 3, seed=6))
    values = {"f_A": blocks[:1], "f_B": blocks[1:2], "f_AB": blocks[2:, None]}
    twin = stats.sobol_indices(func=values, n=256)
    expected = [twin.first_order, twin.total_order]
    np.testing.assert_allclose(estimate_sobol_indices(blocks), expected, rtol=1e-12, atol=1e-14)


def test_rows_with_a_run_that_diverged_are_left_out_of_the_design() -> None:
    blocks = ishigami(design(300, 3, seed=7))
    spoilt = blocks.copy()
    spoilt[[0, 2, 4], [5, 99, 200]] = np.nan
    assert saltelli_indices(spoilt) == saltelli_indices(np.delete(blocks, [5, 99, 200], axis=1))


def linear(n: int, weights: Floats, seed: int) -> tuple[Floats, Floats]:
    """Gaussian X and y = X w + noise of variance 1 - |w|^2."""
    random = np.random.default_rng(seed)
    X = random.standard_normal((n, len(weights)))
    return X, X @ weights + np.sqrt(1 - weights @ weights) * random.standard_normal(n)


def test_linear_gaussian_closed_forms() -> None:
    """Variance share w^2; Spearman's correlation (6/pi) asin(w/2)."""
    weights = np.array([0.9, -0.3, 0.0])
    trials = [sensitivities_of_runs(*linear(400, weights, seed)) for seed in range(100)]
    slack = 3.5 * np.sqrt(LEVEL * (1 - LEVEL) / 100)
    for i, w in enumerate(weights):
        rank = 6 / np.pi * np.arcsin(w / 2)
        correlations = [trial[i].spearman for trial in trials]
        coverage = np.mean([one.low <= rank <= one.high for one in correlations])
        assert coverage > LEVEL - slack
        assert np.mean([covers(trial[i].first_order, w**2) for trial in trials]) > LEVEL - slack
    idle = [trial[2] for trial in trials]
    assert np.mean([one.partial.low <= 0 <= one.partial.high for one in idle]) > LEVEL - slack
    assert np.mean([one.partial.p < 1 - LEVEL for one in idle]) < 1 - LEVEL + slack
    assert np.mean([one.first_order.value > one.floor for one in idle]) < 1 - LEVEL + slack


def test_the_index_of_given_data_is_unbiased() -> None:
    weights = np.array([0.95, 0.0])
    trials = np.array([first_order_indices(*linear(300, weights, seed)) for seed in range(200)])
    error = trials.std(axis=0) / np.sqrt(200)
    assert (np.abs(trials.mean(axis=0) - weights**2) < 4 * error).all()


def residual(others: Floats, column: Floats) -> Floats:
    """What a linear regression leaves of a column."""
    return column - others @ np.linalg.lstsq(others, column)[0]


def test_rank_correlations_are_those_of_textbooks() -> None:
    """The partial one is of what regressions on the ranks of the other entries leave of x and y.

    There are ties.
    """
    X, y = linear(150, np.array([0.5, 0.4, 0.1]), seed=8)
    X[:, 1] = np.round(X[:, 1])
    X[:, 2] += X[:, 0]
    ranks, goal = stats.rankdata(X, axis=0), stats.rankdata(y)
    spearman, partial_ones = rank_correlations(X, y)
    for i in range(3):
        others = np.column_stack([np.ones(150), np.delete(ranks, i, axis=1)])
        left_of_x = residual(others, ranks[:, i])
        left_of_y = residual(others, goal)
        assert spearman[i] == pytest.approx(stats.spearmanr(X[:, i], y).statistic, abs=1e-12)
        assert partial_ones[i] == pytest.approx(np.corrcoef(left_of_x, left_of_y)[0, 1], abs=1e-9)


def test_sensitivities_without_information_are_empty_or_0() -> None:
    X = np.random.default_rng(9).random((100, 2))
    assert sensitivities_of_runs(X[:30], X[:30, 0]) == []
    assert sensitivities_of_runs(X, np.ones(100)) == []
    assert saltelli_indices(X[:30].T.repeat(2, axis=0)) == []
    X[:, 1] = 3.0
    idle = sensitivities_of_runs(X, X[:, 0])[1]
    assert idle.spearman.value == idle.partial.value == idle.first_order.value == 0
    assert sensitivities_of_runs(X, X[:, 0])[0].spearman[:3] == (1.0, 1.0, 1.0)


def test_chance_grows_as_runs_get_fewer() -> None:
    y = np.random.default_rng(10).standard_normal(5000)
    assert (
        first_order_by_chance(y[:100])
        > 2 * first_order_by_chance(y[:1000])
        > 4 * first_order_by_chance(y)
        > 0
    )


def test_the_variance_of_a_deviation_is_that_of_textbooks() -> None:
    """var(s^2) = mu_4 / n - s^4 (n - 3) / (n (n - 1)), as for any independent sample."""
    column = np.sort(np.array([0.1, 0.4, 0.5, 0.9, 1.3, 2.6]))
    n, s = column.size, float(np.std(column, ddof=1))
    fourth = float(np.mean((column - column.mean()) ** 4))
    variance = fourth / n - s**4 * (n - 3) / (n * (n - 1))
    half = student_half_width(n - 1) * np.sqrt(variance) / s**2 / 2
    found = deviation_interval(column)
    np.testing.assert_allclose([found.low, found.high], [s * np.exp(-half), s * np.exp(half)])
