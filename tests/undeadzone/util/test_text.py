"""Intervals as text: quantiles of a Gaussian that is cut to a declared range."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import truncnorm

import undeadzone as uz
from scenes import scene
from undeadzone.util.text import HALF_95, format_with_interval, interval_95


@given(st.floats(-1.0, 3.0), st.floats(0.01, 10.0))
def test_an_interval_holds_95_percent_of_the_gaussian_cut_to_its_range(
    value: float, std: float
) -> None:
    low, high = interval_95(value, std, 0.0, 2.0)
    cut = truncnorm(-value / std, (2.0 - value) / std, loc=value, scale=std)
    assert 0.0 <= low <= min(max(value, 0.0), 2.0) <= high <= 2.0
    if cut.cdf(2.0) > 0 and value - HALF_95 * std >= 0.0 and value + HALF_95 * std <= 2.0:
        assert (low, high) == (value - HALF_95 * std, value + HALF_95 * std)
    else:  # one end may be moved so that the interval holds the value
        assert cut.cdf(high) - cut.cdf(low) >= 0.95 - 1e-6


def test_a_range_that_excludes_the_estimate_is_the_interval() -> None:
    assert interval_95(9.0, 0.1, 0.0, 2.0) == (0.0, 2.0)
    assert interval_95(1.0, math.inf, 0.0, 2.0) == (0.0, 2.0)


def test_a_number_without_a_range_has_a_symmetrical_interval() -> None:
    assert interval_95(1.0, 0.5) == pytest.approx((1 - 0.5 * HALF_95, 1 + 0.5 * HALF_95))
    assert format_with_interval(1.0, 0.577) == "1.00 [-0.13, 2.13]"
    assert format_with_interval(1.0, 0.577, 0.0, 2.0) == "1.00 [0.12, 1.88]"


@pytest.mark.parametrize("method", ["kalman", "censored", "auto"])
def test_a_run_shows_widths_inside_the_declared_range(method: str) -> None:
    run = uz.simulate(
        scene(
            observer={"method": method, "right": [0.0, 2.0], "left": [0.2, 1.5]},
            simulation={"time": "sampled", "step": 0.01, "duration": 0.5},
        )
    )
    assert run.info.ranges == [[0.0, 2.0], [0.2, 1.5]]
    text = str(run)
    for name, low, high in (("d_right", 0.0, 2.0), ("d_left", 0.2, 1.5)):
        (line,) = (line for line in text.splitlines() if line.startswith(name))
        ends = line[line.index("[") + 1 : line.index("]")].split(",")
        assert low <= float(ends[0]) <= float(ends[1]) <= high
    assert np.isfinite(run.d_hat).all()


def test_digits_that_no_fixed_place_shows_are_the_first_four() -> None:
    assert format_with_interval(1234.0, 600.0) == "1234 [58.02, 2410]"
    assert format_with_interval(1e-5, 1e-6) == "1e-05 [8.04e-06, 1.196e-05]"
    assert format_with_interval(1e-4, 1e-13) == "0.0001 [0.0001, 0.0001]"
