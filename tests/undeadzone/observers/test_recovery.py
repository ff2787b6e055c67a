"""Filters on readings that are wrong, and on a world that is not as claimed."""

from __future__ import annotations

import math
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from benchmarks.filters import coverage, glitches
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

import undeadzone as uz
from scenes import PAPER_PLANT
from undeadzone.numerics import gaussian
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.filtering.measured_kalman import log_likelihood
from undeadzone.observers.filtering.measurement_update import Corrected
from undeadzone.plants.system import sample_plant
from undeadzone.util.arrays import Floats

TS, AT = 0.01, 500  # sample time [s], sample of the first wrong reading
PLANT = uz.Plant(A=[[0.0, 1.0], [-1.0, -2.0]], B=[[0.0], [1.0]], C=[[1.0, 0.0]])
SENSOR = uz.Sensor(right=1.0, left=0.7, noise=0.01)
FILTERS = {
    "kalman": uz.Kalman(right=[0.0, 3.0]),
    "censored": uz.Censored(right=[0.0, 3.0]),
    "extended": uz.Extended(right=[0.0, 3.0]),
}


@cache
def drive() -> tuple[Floats, Floats, Floats]:
    """(u, z, y) of the paper's plant for 12 s, |z| <= 5, its readings right."""
    model, rng, x = sample_plant(PAPER_PLANT, TS).linear, np.random.default_rng(0), np.zeros(2)
    rows = []
    for k in range(1200):
        u, z = 30 * math.cos(math.pi * k * TS), float((model.C @ x)[0])
        rows.append((u, z, z - max(min(z, 1.0), -0.7) + 0.01 * rng.normal()))
        x = model.A @ x + model.B[:, 0] * u
    u, z, y = np.array(rows).T
    return u, z, y


def watched(name: str, y: Floats) -> tuple[float, Any]:
    """(rms of z - z^ from 2 s after a wrong reading on, the last estimate); all are finite."""
    u, z, _ = drive()
    online = uz.Online(FILTERS[name], PLANT, SENSOR, TS)
    errors = []
    for k in range(len(y)):
        estimate = online.update(y[k], u[k])
        assert np.isfinite(np.concatenate(estimate)).all()
        assert 0.0 <= estimate.right[0] <= 3.0
        assert 0.0 <= estimate.left[0] <= 3.0
        errors.append(estimate.z[0] - z[k])
    return float(np.sqrt(np.mean(np.square(errors[AT + 200 :])))), estimate


@cache
def usual(name: str) -> float:
    """What the filter comes to on readings that are right."""
    return watched(name, drive()[2])[0]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(
    ("size", "count"), [(20.0, 1), (100.0, 1), (-1e6, 1), (0.99e300, 1), (20.0, 5), (1e4, 5)]
)
def test_a_glitch_is_refused_and_leaves_no_trace(name: str, size: float, count: int) -> None:
    y = drive()[2].copy()
    y[AT : AT + count] = size
    rms, last = watched(name, y)
    assert rms <= 1.2 * usual(name)
    assert abs(last.right - 1.0) < 2.5 * last.right_std
    assert abs(last.left - 0.7) < 2.5 * last.left_std
    assert last.refused == count
    assert last.restarts == 0
    assert last.consistent


@pytest.mark.parametrize("name", FILTERS)
def test_a_stuck_sensor_says_nothing_new(name: str) -> None:
    y = drive()[2].copy()
    start = AT + int(np.argmax(np.abs(y[AT : AT + 200])))
    y[start : start + 50] = y[start]
    assert watched(name, y)[0] <= 1.5 * usual(name)


@pytest.mark.parametrize("name", FILTERS)
def test_a_first_reading_that_is_wrong_is_not_for_ever(name: str) -> None:
    y = drive()[2].copy()
    y[:3] = 20.0
    rms, last = watched(name, y)
    assert rms <= 0.1  # a tenth of d_r
    assert abs(last.right - 1.0) < 2.5 * last.right_std


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("pole", [0.0, 1e-3, 1.0])
def test_a_jump_of_z_is_believed_within_60_readings(name: str, pole: float) -> None:
    online = uz.Online(FILTERS[name], uz.Plant(A=[[-pole]], B=[[1.0]], C=[[1.0]]), SENSOR, TS)
    rng = np.random.default_rng(0)
    for z in [5.0] * 500 + [-1e4] * 60:
        estimate = online.update(z - np.clip(z, -0.7, 1.0) + 0.01 * rng.normal(), pole * z)
    assert estimate.z[0] == pytest.approx(z, abs=3.0)


def test_a_belief_that_is_no_number_begins_anew_and_says_so() -> None:
    """An input that the plant cannot have drives the state beyond every number."""
    u, _, y = drive()
    online = uz.Online(FILTERS["censored"], PLANT, SENSOR, TS)
    for k in range(300):
        online.update(y[k], u[k])
    online.update(y[300], 1e200)
    for k in range(301, 310):
        estimate = online.update(y[k], u[k])
        assert np.isfinite(np.concatenate(estimate)).all()
        assert np.isfinite(online._step.state).all()
    assert estimate.restarts == 1


# --- Over random problems


@cache
def read_right() -> tuple[coverage.Problems, glitches.Outcome]:
    """Forty problems whose readings are right, and what comes of them."""
    posed = coverage.problems("both edges", glitches.SHAKEN, 2, 40, 4)
    return posed, glitches.observe(coverage.censored, posed)


@pytest.mark.parametrize(
    ("kind", "most"),
    [("one of 1e299", 1.3), ("five alike", 1.3), ("10 % are 0", 1.6), ("10 % random", 1.6)],
)
def test_wrong_readings_cost_next_to_nothing(kind: str, most: float) -> None:
    spoil, _ = glitches.KINDS[kind]
    posed, clean = read_right()
    wrong = spoil(np.random.default_rng(5), posed.y)
    outcome = glitches.observe(coverage.censored, posed._replace(y=wrong))
    assert np.median(outcome.rms / clean.rms) < 1.05
    assert np.quantile(outcome.rms / clean.rms, 0.9) < most
    assert outcome.verdict.covered().min() > clean.verdict.covered().min() - 0.04


@pytest.mark.parametrize("late", [0.0, 1.0])
def test_doubt_is_free_and_a_late_bias_is_noticed_and_covered(late: float) -> None:
    """After a step of five claimed rms intervals that were .4 to .8 right are right again."""
    posed = coverage.problems("both edges", glitches.SHAKEN._replace(late=late), 2, 100, 4)
    doubting, sure = (
        glitches.observe(build, posed)
        for build in (coverage.censored, glitches.trusting(coverage.censored))
    )
    flagged = np.mean(doubting.consistent == 0)
    least, of_sure = (one.verdict.covered().min() for one in (doubting, sure))
    if late:
        assert least > max(0.9, of_sure)
        assert flagged > 0.4
        return
    assert np.median(doubting.rms / sure.rms) < 1.02
    assert least > of_sure - 0.02
    assert flagged <= 0.1  # 8 % of many


# --- Its formulas


def numbers(*parts: Any) -> list[Floats]:
    return [np.asarray(ca.evalf(ca.SX(part)).full()) for part in parts]


@given(st.floats(-8, 8), st.floats(0.05, 3.0), st.floats(0.01, 0.4))
def test_a_reading_or_a_glitch_is_the_mixture_by_bayes(e: float, R: float, share: float) -> None:
    """One unknown of variance 2 and its reading, or a glitch of even density."""
    P, reach = 2.0, 30.0
    S = P + R
    regular = (1 - share) * norm.pdf(e, scale=np.sqrt(S))
    wrong = share / (reach + gaussian.TAIL * np.sqrt(S))
    beta, gain = regular / (regular + wrong), P / S
    odds = np.log(share / (1 - share))
    known = gaussian.update_with_outliers(
        Gaussian(ca.SX(1.0), ca.SX(P)), ca.SX(1.0), ca.SX(e), R, 1.0, odds, reach
    )
    mean, cov, trust, likely = numbers(*known.belief, known.trust, known.likely)
    spread = beta * (P - gain * P) + (1 - beta) * P + beta * (1 - beta) * (gain * e) ** 2
    assert trust[0, 0] == pytest.approx(beta, rel=1e-9)
    assert mean[0, 0] == pytest.approx(1.0 + beta * gain * e)
    assert cov[0, 0] == pytest.approx(spread)
    assert likely[0, 0] == pytest.approx((regular + wrong) / (1 - share))


@pytest.mark.parametrize("fixed", [[], [2], [1, 3]])
@pytest.mark.parametrize("k", [1, 2])
def test_the_decrease_of_a_covariance_with_some_variables_fixed(fixed: list[int], k: int) -> None:
    """The formula of the docstring, entry by entry of the upper triangle."""
    rng = np.random.default_rng(k)
    g, share = rng.normal(size=(5, k)), np.ones((5, 1))
    share[fixed] = rng.uniform(size=(len(fixed), 1))
    certain, between = (np.cov(rng.normal(size=(k, 9))).reshape(k, k) for _ in range(2))
    s = share * g
    expected = g @ certain @ g.T - (g - s) @ certain @ (g - s).T - s @ between @ s.T
    lost = gaussian.covariance_loss(
        ca.SX(g), ca.SX(share) * ca.SX(g), ca.SX(certain), ca.SX(between)
    )
    assert np.triu(*numbers(lost)) == pytest.approx(np.triu(expected))


@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_what_outputs_foretell_leaves_the_range_of_no_number(size: float) -> None:
    """In single precision the product of six densities of 1e7 would."""
    belief = Gaussian(ca.SX(1.0), ca.SX(1.0))
    one = gaussian.RobustUpdate(belief, ca.SX(0.0), ca.SX(1.0), ca.SX(1.0), ca.SX(size), ca.SX(0.0))
    both = gaussian.stack_updates([one, one])
    corrected = Corrected(belief, ca.SX(0), both.trust, both.likely)
    setup: Any = SimpleNamespace(doubts=True)
    (log,) = numbers(log_likelihood(setup, both, corrected))
    assert log[0, 0] == pytest.approx(2 * math.log(size))


@pytest.mark.parametrize("e", [1e3, -1e9, 1e299])
def test_a_huge_reading_leaves_the_belief_to_the_last_bit(e: float) -> None:
    belief = Gaussian(ca.SX([1.0, 2.0]), ca.SX(np.array([[2.0, 0.3], [0.3, 1.0]])))
    h = ca.SX([[1.0, -1.0]])
    known = gaussian.update_with_outliers(belief, h, ca.SX(e), 0.1, 1.0, -3.0, 20.0)
    for before, after in zip(numbers(*belief), numbers(*known.belief), strict=True):
        assert after == pytest.approx(before, rel=1e-15)


def test_a_chance_agrees_with_scipy() -> None:
    alpha = np.linspace(-30, 5, 701)
    chance = numbers(*gaussian.normal_cdf_and_hazard(ca.SX(alpha)))[0]
    assert np.log(chance[:, 0]) == pytest.approx(norm.logcdf(alpha), rel=1e-4)


@given(st.floats(-25, 1.5))
def test_a_silence_that_nothing_explains_is_fake(alpha: float) -> None:
    """Beyond what a thousandth explains, the belief stays."""
    belief = Gaussian(ca.SX(-alpha), ca.SX(1.0))
    bound = gaussian.Bound(ca.SX(1.0), ca.SX(-alpha), 1.0)
    known = gaussian.truncate_at_bounds(belief, [bound], 0.0, 1.6, np.log(1e-3))
    mean, cov, trust = numbers(*known.belief, known.trust)
    chance = norm.cdf(alpha)
    beta = chance / (chance + 1e-3)
    ratio = np.exp(norm.logpdf(alpha) - norm.logcdf(alpha))
    assert trust[0, 0] == pytest.approx(beta, rel=1e-3, abs=1e-9)
    assert mean[0, 0] == pytest.approx(-alpha - beta * ratio, rel=1e-3, abs=1e-3)
    assert cov[0, 0] > 0
    assert float(ca.DM(ca.evalf(ca.SX(known.used[0])))) == 1.0
