"""The ranges of the widths that identification tells an observer."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student

import undeadzone as uz
from records import dead_zone
from undeadzone.errors import InputError
from undeadzone_identify.logs.prepare import jump_edge_below
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.likelihood import Readings
from undeadzone_identify.results.assemble import Answer, _widen_to_rounding, prior_width_range
from undeadzone_identify.selection import widths
from undeadzone_identify.selection.widths import measure_excitation

RIGHT, LEFT = 0.4, 0.9


def log(left_swings: int) -> tuple[np.ndarray, np.ndarray]:
    """u and y (800) of a first-order plant that swings to the left a few times only."""
    rng = np.random.default_rng(4)
    u = np.abs(np.repeat(rng.standard_normal(40), 20))
    u[20 * np.linspace(3, 37, left_swings).astype(int)[:, None] + np.arange(20)] = -1.6
    z = lfilter([0.0, 0.2], [1.0, -0.8], u)
    e = z + 0.03 * rng.standard_normal(z.size)
    return u, dead_zone(e, RIGHT, LEFT)


@pytest.fixture(scope="module")
def answer() -> Answer:
    u, y = log(left_swings=4)
    found = uz.identify(t=0.05, u=u, y=y, order=1, place="sensor", delay=0)
    assert isinstance(found, uz.Identified)
    assert found.verdict == "dead_zone"
    return found.answer


def growth(degrees: float) -> float:
    return float(student.ppf(0.9995, degrees) / student.ppf(0.975, degrees))


def test_the_range_grows_with_the_quantile_of_its_degrees(answer: Answer) -> None:
    degrees = answer.widths.degrees
    assert degrees["left"] < degrees["right"]  # passed 4 times, and 20 times or more
    for side, edge in (("right", answer.right), ("left", answer.left)):
        assert edge is not None
        low, high = prior_width_range(answer, side)
        assert (high - low) / (edge.high - edge.low) == pytest.approx(growth(degrees[side]))
        assert low < edge.low
        assert edge.high < high
    assert growth(degrees["left"]) > 1.08 * growth(40.0)  # about as for 1000 samples


def test_each_half_of_an_interval_grows_by_itself(answer: Answer) -> None:
    edge = Interval(0.5, 0.4, 0.8)
    factor = growth(answer.widths.degrees["left"])
    bounds = prior_width_range(answer._replace(left=edge), "left")
    assert bounds == pytest.approx((max(0.5 - 0.1 * factor, 0.0), 0.5 + 0.3 * factor))


def test_bounds_of_the_user_hold(answer: Answer) -> None:
    edge = Interval(0.5, 0.4, math.inf)
    open_ended = answer._replace(left=edge)
    with pytest.raises(InputError, match="no upper bound of the left"):
        prior_width_range(open_ended, "left")
    u, y = log(left_swings=4)
    found = uz.identify(
        t=0.05, u=u, y=y, order=1, place="sensor", delay=0, left="0.88,0.92", right=RIGHT
    )
    assert isinstance(found, uz.Identified)
    low, high = prior_width_range(found.answer, "left")
    assert 0.88 <= low < high <= 0.92
    assert prior_width_range(found.answer, "right") == pytest.approx((RIGHT, RIGHT), rel=1e-5)


def test_the_range_of_a_jump_edge_holds() -> None:
    """Of 4000 edges about 4 lie below the 99.9 % interval; 200 below that of 95 %."""
    rng = np.random.default_rng(1)
    below = {"low": 0, "lowest": 0}
    for _ in range(4000):
        edge = jump_edge_below(np.sort(rng.exponential(1.0, 24)))  # the edge is 0
        below["low"] += edge.low > 0
        below["lowest"] += edge.lowest > 0
    assert 140 <= below["low"] <= 260
    assert 0 < below["lowest"] <= 14


def test_visits_of_each_edge_are_counted() -> None:
    z = np.array([0.0, 2.0, 2.0, 0.0, 0.0, 2.0, -2.0, -2.0, -2.0, 0.0])
    whole = np.ones(z.size, bool)
    found = measure_excitation(
        Readings(z, np.sign(z).astype(int), whole, whole), z, 1.0, 1.0, False
    )
    assert found.samples == (3, 3)
    assert found.visits == (2, 1)
    assert found.silent == pytest.approx(0.4)
    assert found.longest == 2


@pytest.mark.parametrize("value", [0.0, 0.4, 1e6])
def test_a_range_is_wider_than_rounding(value: float) -> None:
    low, high = _widen_to_rounding(value, value)
    assert 0 <= low <= value < high
    assert _widen_to_rounding(0.3, 0.5) == (0.3, 0.5)


@pytest.mark.parametrize("value", [1.2, 1.5])
def test_an_edge_is_widened_by_its_likelihood_about_its_reported_value(
    monkeypatch: pytest.MonkeyPatch, value: float
) -> None:
    """Readings of rms 2 and an edge that was fitted at 0.6 of it; one is reported 0.3 off."""
    monkeypatch.setattr(
        widths, "profile_likelihood", lambda fit, side, values: -8.0 * (values - 0.6) ** 2
    )
    spread = SimpleNamespace(variance_and_degrees=lambda row: (1.0, 1e9), naive=np.eye(1))
    objective = SimpleNamespace(
        robust_covariance=lambda theta: spread, width_weights=lambda *pair: np.ones(1)
    )
    fit: Any = SimpleNamespace(objective=objective, theta=None, right=0.6, left=9.0)
    edge = Interval(value, value - 0.4, value + 0.4)
    found = widths.widen_by_profile(fit, "right", edge, 2.0)
    half = 2.0 * 1.96 / 4.0  # 16 is the curvature, and its root the reciprocal deviation
    assert (found.low, found.high) == pytest.approx((value - half, value + half), rel=0.02)
    assert value - found.low == pytest.approx(found.high - value)


@pytest.mark.parametrize(("half", "expected"), [(0.3, 0.3), (4.8, 0.06), (0.0, 0.06)])
def test_a_singular_stage_widens_no_interval(half: float, expected: float) -> None:
    """Single samples gave 0.75 [-4.0, 5.5], the filter half intervals of 0.06.

    A half interval of 0 is that of a known width: no other is compared with it.
    """
    halves = (0.06, half)
    stages = [widths._Stage((0.4, 1.1), {"right": one}, {"right": 12.0}) for one in halves]
    assert widths._widest_stage(stages, "right").halves["right"] == expected
