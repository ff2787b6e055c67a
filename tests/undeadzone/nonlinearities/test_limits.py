"""Readings that end: at a limit of its range a reading only bounds what the sensor reads."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm
from test_engines import OBSERVERS, gap_of_engines, small

import undeadzone as uz
from records import second_order
from scenes import OnNumbers, scene
from undeadzone.analysis.branch_schedule import plan_schedule
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Reading, require_graph, to_reading
from undeadzone.logs.range_ends import RUN, RunningEnds, _UpperLimit, range_ends
from undeadzone.nonlinearities.limits import Limits
from undeadzone.nonlinearities.sensor import Sensor, Zone, deadzone, quantise, resolve
from undeadzone.observers.adaptive import branch_observer
from undeadzone.observers.filtering.measurement_update import RangeLimits, is_surely_exact
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_arena import MovingHorizon, ParticleFilter
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import Log, Options
from undeadzone_identify.logs.prepare import NEAR, prepare_log
from undeadzone_studies.ensemble.run_ensemble import replay_deviation, replay_run, run_ensemble

INF = float("inf")
TS = 0.01
FIRST = Plant(A=[[-1.0]], B=[[1.0]], C=[[1.0]])
NAIVE = ("full_state", "luenberger", "printed")  # they take every reading as it is
BOUNDED = [name for name, (times, _) in OBSERVERS.items() if "sampled" in times]
BOUNDED = [name for name in BOUNDED if name not in (*NAIVE, "auto")]  # auto: here `censored`
MISSING = ("adaptive_inverse", "inverse_network", "kalman")  # takes a limit for a missing reading
MISSING += ("fuzzy_residual", "rbf_residual", "taylor_residual")
WIDE = {"duration": 4.0, "step": 2e-3}


def first_order() -> System:
    return sample_plant(system(FIRST), TS)


def zone(**changes: Any) -> Zone:
    """A zone of one output whose readings end at -0.6 and 0.5."""
    options = {"right": 1.0, "left": 0.7, "noise": 0.01, "range": [-0.6, 0.5]} | changes
    return resolve(Sensor(**options), 1, TS)


def saturated(limits: Any, time: str = "continuous", **changes: Any) -> Run:
    """The paper's loop, noise-free, whose readings end."""
    tables = {"sensor": {"right": 0.8, "left": 1.1, "range": limits}, "simulation": WIDE}
    tables["simulation"] = tables["simulation"] | {"time": time}
    return simulate(scene(**tables | changes))


# The key


def test_a_limit_may_be_missing_on_either_side() -> None:
    assert zone(range=[-INF, INF]).limits is None
    assert zone().limits == Limits(np.array([-0.6]), np.array([0.5]))
    one_sided = zone(range=[-INF, 0.5])
    assert (one_sided.low, one_sided.high) == (-INF, 0.5)
    run = saturated([-INF, 1.0])
    assert (run.y.max(), set(np.unique(run.side))) == (1.0, {-1.0, 0.0, 1.0, 2.0})


@pytest.mark.parametrize(
    ("y", "side", "seen"),
    [
        (0.0, 0, 0.0),
        (0.3, 1, 0.3),
        (0.5, 2, 0.5),
        (0.5 * (1 - 1e-7), 2, 0.5 * (1 - 1e-7)),
        (0.5 * (1 + 1e-7), 2, 0.5 * (1 + 1e-7)),
        (0.51, 0, np.inf),
        (-0.6, -2, -0.6),
        (-20.0, 0, np.inf),
        (np.nan, 0, np.nan),
        (np.inf, 0, np.nan),
    ],
)
def test_the_side_of_a_reading_from_outside(y: float, side: int, seen: float) -> None:
    symbol = ca.SX.sym("y")
    reading = to_reading(symbol, 0.1, Limits(-0.6, 0.5))
    found_y, found_side = ca.Function("f", [symbol], [reading.y, reading.side])(y)
    assert float(found_side) == side
    assert np.array_equal(float(found_y), seen, equal_nan=True)


# Simulation


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_the_reading_is_that_of_the_dead_zone_clipped_to_the_range(time: str) -> None:
    run = saturated([-1.5, 2.0], time)
    expected = np.clip(deadzone(run.z, 0.8, 1.1), -1.5, 2.0)
    assert np.abs(run.y - expected).max() < 1e-12
    assert set(np.unique(run.side)) == {-2.0, -1.0, 0.0, 1.0, 2.0}
    assert (np.abs(run.side) == 2).sum() == ((run.y == 2.0) | (run.y == -1.5)).sum() > 100


def test_rounding_comes_before_the_range_and_a_missing_reading_stays_missing() -> None:
    sensor = {"right": 0.8, "left": 1.1, "quantum": 0.3, "dropout": 0.2, "range": [-1.6, 2.0]}
    run = simulate(scene(sensor=sensor, simulation=WIDE | {"time": "sampled"}))
    expected = np.clip(quantise(deadzone(run.z, 0.8, 1.1), 0.3), -1.6, 2.0)
    lost = np.isnan(run.y)
    assert 0.1 < lost.mean() < 0.3
    assert (run.y == expected)[~lost].all()
    assert (run.side[lost] == 0).all()
    assert (np.abs(run.side) == 2).sum() == ((run.y == 2.0) | (run.y == -1.6)).sum() > 100


def test_a_limit_is_met_inside_a_step() -> None:
    """Located, the error falls with the order of Runge and Kutta; plain, it does not."""
    observer = {"method": "luenberger", "poles": [-3.0, -4.0]}

    def error(step: float, switching: str) -> float:
        simulation = WIDE | {"step": step, "switching": switching}
        run = saturated([-1.5, 2.0], observer=observer, simulation=simulation)
        assert (np.abs(run.side) == 2).any()
        return float(run.info.integration_error or 0.0)

    coarse, fine = error(8e-3, "located"), error(4e-3, "located")
    assert 0 < 8 * fine < coarse < 1e-5
    assert error(4e-3, "plain") > 100 * fine


@settings(max_examples=3)
@given(high=st.floats(10.0, 1e6), low=st.floats(10.0, 1e6), seed=st.integers(0, 99))
def test_a_range_that_is_never_reached_changes_no_bit(high: float, low: float, seed: int) -> None:
    noise = {"noise": 0.01, "noise_before": 0.01}
    simulation = {"duration": 0.6, "step": 2e-3, "seed": seed}
    free = simulate(scene(sensor=noise, simulation=simulation))
    wide = simulate(scene(sensor=noise | {"range": [-low, high]}, simulation=simulation))
    assert_equal_bits(free, wide)


def assert_equal_bits(one: Run, other: Run) -> None:
    mine, theirs = one.columns(), other.columns()
    assert mine.keys() == theirs.keys()
    for name, value in mine.items():
        assert np.array_equal(value, theirs[name], equal_nan=True), name


@pytest.mark.parametrize("method", BOUNDED)
def test_a_range_that_is_never_reached_changes_no_bit_of_an_estimate(method: str) -> None:
    base = {"right": 0.5, "left": 0.3, "noise": 0.01, "dropout": 0.05}
    runs = []
    for sensor in (base, base | {"range": [-40.0, 50.0]}):
        observer = {"method": method} | OBSERVERS[method][1]
        runs.append(simulate(small("sampled", observer=observer, sensor=sensor)))
    assert_equal_bits(*runs)


def test_engines_agree_to_the_last_bit() -> None:
    """Sampled, the replay of an ensemble below shows it."""
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "noise_before": 0.01, "range": [-0.4, 0.6]}
    scenario = small(observer={"method": "luenberger", "L": [1.0]}, sensor=sensor)
    assert gap_of_engines(scenario) == 0


@pytest.mark.parametrize("precision", ["single", "double"])
def test_exported_c_passes_its_self_test(precision: str, tmp_path: Path) -> None:
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "range": [-INF, 0.6]}
    scenario = small("sampled", sensor=sensor)
    done = uz.export(scenario, out=tmp_path / "fw", precision=precision, name="o")
    assert done.has_passed
    assert not done.report["refusals"]


def test_an_ensemble_varies_the_limits_and_a_replay_knows_them() -> None:
    vary = {
        "runs": 8,
        "sensor.range[1]": {"uniform": [0.3, 1.0]},
        "sensor.range[0]": {"uniform": [0.5, 2.0], "relative": True},
    }
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "range": [-0.4, 0.6]}
    result = run_ensemble(small("sampled", sensor=sensor, ensemble=vary))
    assert replay_deviation(result, 3) == 0
    assert replay_run(result, 3).y.max() == result.column("sensor.range[1]")[3]
    wrong = vary | {"sensor.range[0]": {"uniform": [-1.0, -0.5]}}
    with pytest.raises(InputError, match="by a factor alone"):
        run_ensemble(small("sampled", sensor=sensor, ensemble=wrong))


# The certificate


@settings(max_examples=6)
@given(
    high=st.floats(0.05, 4.0),
    low=st.floats(0.05, 4.0),
    right=st.floats(0.1, 2.0),
    left=st.floats(0.1, 2.0),
    time=st.sampled_from(["continuous", "sampled"]),
)
def test_v_never_rises_whatever_the_range(
    high: float, low: float, right: float, left: float, time: str
) -> None:
    assert rise(high, low, right, left, time) <= 1e-9


def rise(high: float, low: float, right: float, left: float, time: str) -> float:
    """The largest rise of V in a step, relative to V at first."""
    sensor = {"right": right, "left": left, "range": [-low, high]}
    simulation = {"duration": 2.0, "step": 2e-3, "time": time}
    V = simulate(scene(sensor=sensor, simulation=simulation), check_step=False).V
    assert V is not None
    return float(np.diff(V).max() / V[0])


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_v_rises_if_a_limit_corrects_with_the_wrong_sign(
    time: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    right_one = branch_observer.drop_limit_corrections

    def wrong(correction: Any, side: Any, jump: bool) -> Any:
        return right_one(correction, -side, jump)

    monkeypatch.setattr(branch_observer, "drop_limit_corrections", wrong)
    assert rise(1.0, 1.0, 1.0, 1.0, time) > 1e-4
    monkeypatch.setattr(
        branch_observer, "drop_limit_corrections", lambda correction, side, jump: correction
    )
    assert rise(1.0, 1.0, 1.0, 1.0, time) > 1e-4


# What observers make of it


@pytest.mark.parametrize("method", BOUNDED)
def test_a_limit_that_the_estimate_is_beyond_says_nothing(method: str) -> None:
    """It is as good as a missing reading."""
    options = small("sampled", observer={"method": method} | OBSERVERS[method][1]).observer
    model = first_order()
    observer = require_graph(options.build(model, zone()))
    step = OnNumbers(observer, model)
    state = observer.init(observer.params)
    for _ in range(600):
        state, beyond = step(state, 5.0, np.nan, 0.0)
    assert beyond.z > 4.5
    missed, _ = step(state, 5.0, np.nan, 0.0)
    updated, _ = step(state, 5.0, 0.5, 2.0)
    one, other = (step(after, 5.0, np.nan, 0.0)[1] for after in (missed, updated))
    for name in ("x", "right", "left", "x_std"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-6), name


@pytest.mark.parametrize("method", [name for name in BOUNDED if name not in MISSING])
def test_a_limit_that_the_estimate_contradicts_moves_it(method: str) -> None:
    """It lies below the bound, and must rise."""
    trusting = {"glitches": 0.0} if method == "ukf" else {}  # else it is 12 deviations off, refused
    table = {"method": method} | OBSERVERS[method][1] | trusting
    options = small("sampled", observer=table).observer
    model = first_order()
    observer = require_graph(options.build(model, zone()))
    step = OnNumbers(observer, model)
    state = observer.init(observer.params)
    for _ in range(600):
        state, _ = step(state, -5.0, np.nan, 0.0)
    outcomes = []
    for y, side in ((np.nan, 0.0), (0.5, 2.0)):
        after = state
        for _ in range(250):
            after, estimate = step(after, -5.0, y, side)
        outcomes.append(estimate.x[0] - estimate.right[0])
    assert outcomes[1] > outcomes[0] + 1e-3


@pytest.mark.parametrize("end", [1.0, -1.0])
@pytest.mark.parametrize("method", ["censored", "extended"])
def test_a_bound_is_the_conditional_mean_and_variance(method: str, end: float) -> None:
    """Of z - d + v >= y, against the formulas of a truncated Gaussian computed by SciPy."""
    sensor = zone()
    assumptions = {"right": [0.1, 1.9], "x_std": 0.8, "disturbance": 0.0, "glitches": 0.0}
    if method == "censored":
        assumptions |= {"bias": 0.0, "tolerance": 0.0, "calibrated": 0.0, "levels": 1}
    options = scene(
        observer={"method": method} | assumptions, simulation={"time": "sampled"}
    ).observer
    model = first_order()
    observer = require_graph(options.build(model, sensor))
    y = 0.5 if end > 0 else -0.6
    after, _ = OnNumbers(observer, model)(observer.init(observer.params), 0.0, y, 2 * end)
    mean, _ = belief(after)
    x_var, d_var = 0.8**2, 1.8**2 / 12
    R = max(0.01, 1e-3 * 1.8) ** 2
    S = x_var + d_var + R
    alpha = (abs(y) - (0.0 - 1.0)) / np.sqrt(S)  # of end (z - end d) + v >= |y|
    shift = norm.pdf(alpha) / norm.sf(alpha) / np.sqrt(S)
    decay = np.exp(-TS)
    assert mean[0] == pytest.approx(end * decay * x_var * shift, rel=1e-6)
    place = 1 if end > 0 else 2
    assert mean[place] == pytest.approx(1.0 - d_var * shift, rel=1e-6)
    assert mean[3 - place] == pytest.approx(1.0, abs=1e-9)


def belief(state: Any) -> tuple[Floats, Floats]:
    """Mean and covariance of a filter's state."""
    inner = state.filter
    return np.ravel(inner.mean), np.ravel(inner.cov)


@pytest.mark.parametrize("method", ["kalman", "extended"])
def test_a_reading_beyond_its_range_is_refused_and_counted(method: str) -> None:
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "range": [-0.4, 0.6]}
    observer = {"method": method} | OBSERVERS[method][1]
    scenario = small("sampled", sensor=sensor, observer=observer)
    run = simulate(scenario)
    outcomes = []
    for wrong in (np.nan, 0.7, 20.0, -1e9):
        y = run.y.copy()
        y[100] = wrong
        outcomes.append(uz.estimate(scenario, t=run.t, y=y, u=run.u))
    missing, *others = outcomes
    for other in others:
        assert np.array_equal(missing.d_hat, other.d_hat)
        assert np.array_equal(missing.x_hat, other.x_hat)


def test_refused_readings_beyond_the_range_show() -> None:
    model = first_order()
    options = small("sampled", observer={"method": "kalman", "right": [0.1, 1.0]}).observer
    observer = require_graph(options.build(model, zone()))
    step, state = OnNumbers(observer, model), observer.init(observer.params)
    for y in (0.3, np.inf, 0.3):
        state, estimate = step(state, 0.0, y, 1.0 if np.isfinite(y) else 0.0)
    assert estimate.refused == 1


def test_an_estimate_of_a_log_equals_that_of_the_run_and_counts_its_limits() -> None:
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "range": [-0.4, 0.6]}
    observer = {"method": "censored"} | OBSERVERS["censored"][1]
    scenario = small("sampled", sensor=sensor, observer=observer)
    run = simulate(scenario)
    estimated = uz.estimate(scenario, t=run.t, y=run.y, u=run.u)
    assert np.array_equal(estimated.x_hat, run.x_hat)
    assert estimated.info.limited == [int((np.abs(run.side) == 2).sum())]
    assert estimated.summary()["samples_limited"] > 50


@pytest.mark.parametrize("build", [MovingHorizon, ParticleFilter])
def test_observers_in_python_take_a_limit_for_a_bound(build: Any) -> None:
    """Held at its limit the estimate rises beyond it, and is free to lie far above."""
    options = build(right=[0.2, 1.0], x_std=3.0)
    model = first_order()
    observer = options.build(model, zone(right=0.6, left=0.6)).python
    state = observer.start(0)
    for _ in range(200):
        reading = Reading(np.array([0.5]), np.array([2.0]))
        state, estimate = observer.correct(state, reading)
        state = observer.predict(state, np.array([4.0]))
    assert estimate.z[0] - estimate.right[0] > 1.0
    assert isinstance(estimate, Estimate)


@pytest.mark.parametrize(
    ("before", "last", "y", "sure"),
    [
        (0.0, 0.0, 0.5, True),  # far from silence and from the limit
        (0.0, 0.0, 0.9, False),  # near the limit, and a silent reading announces nothing
        (0.4, 0.6, 0.85, True),  # announced
        (0.4, 0.6, 0.97, True),
        (0.5, 0.72, 0.97, False),  # their line is too near to the limit
        (1.0, 1.0, 0.1, False),  # a reading at the limit announces nothing
        (1.0, 0.8, 0.5, True),
        (0.8, 0.6, 0.15, True),
        (0.8, 0.47, 0.15, True),
        (0.8, 0.4, 0.15, False),  # their line is too near to silence
    ],
)
def test_which_readings_are_surely_exact(before: float, last: float, y: float, sure: bool) -> None:
    numbers: Any = SimpleNamespace(gate=0.1, ends=RangeLimits(low=-2.0, high=1.0, gate=0.1))
    setup: Any = SimpleNamespace(is_jump_sensor=False)
    values = (ca.SX(y), ca.SX(last), ca.SX(before))
    assert bool(ca.evalf(is_surely_exact(setup, numbers, *values, ca.SX(1.0)))) == sure
    assert not bool(ca.evalf(is_surely_exact(setup, numbers, *values, ca.SX(2.0))))


# Verdicts


def test_only_exact_readings_count_for_a_verdict() -> None:
    """r = 5 sin over a period: spans between d_r and d_r + hi, by their arc sines."""
    sensor = {"right": 1.0, "left": 0.7, "range": [-0.5, 1.5]}
    problem = resolve_scenario(scene(sensor=sensor))
    schedule = plan_schedule(
        problem.model, problem.reference, problem.tracked, problem.sensor, problem.steps * 1e-3
    )
    period = schedule.spans.sum()
    right = schedule.spans @ (schedule.sides[:, 0] == 1) / period
    left = schedule.spans @ (schedule.sides[:, 0] == -1) / period
    exact = [np.arcsin((1 + 1.5) / 5) - np.arcsin(1 / 5)]
    exact.append(np.arcsin((0.7 + 0.5) / 5) - np.arcsin(0.7 / 5))
    assert (right, left) == pytest.approx((exact[0] / np.pi, exact[1] / np.pi), rel=1e-6)
    beyond = 1 - (np.arcsin(1 / 5) + np.arcsin(0.7 / 5)) / np.pi
    assert schedule.exact is not None
    assert schedule.exact[0] == pytest.approx((right + left) / beyond, rel=1e-6)


def test_a_verdict_says_that_no_reading_is_exact() -> None:
    """All readings beyond the right edge are at the limit of a jump sensor."""
    jump = {"kind": "jump", "right": 1.0, "left": 1.0, "range": [-5.0, 0.5]}
    verdict = simulate(scene(sensor=jump, observer={"method": "certified"})).info.identifiable[0]
    assert (verdict["right"], verdict["left"]) == (False, True)
    tight = {"right": 1.0, "left": 1.0, "noise": 0.0, "range": [-1e-3, 1e-3]}
    simulation = {"time": "sampled", "step": 0.01, "duration": 4.0}
    run = simulate(scene(sensor=tight, simulation=simulation))
    assert any("exact" in reason for reason in run.info.identifiable[0]["reasons"])


# Logs whose range nobody declared

TIMES = np.arange(0.0, 40.0, 0.01)
SINE = np.sin(TIMES)
SHAKY = SINE + 0.01 * np.random.default_rng(0).normal(size=SINE.size)
SHAKEN = SINE[::5] + 0.2 * np.random.default_rng(0).normal(size=SINE[::5].size)


@pytest.mark.parametrize(
    ("y", "quantum", "limits"),
    [
        (SINE, 0.0, (-INF, INF)),
        (np.round(SINE, 2), 0.01, (-INF, INF)),  # alike at the top, where it turns
        (np.round(1 - np.exp(-TIMES), 4), 0.0, (-INF, INF)),  # settled
        (np.sign(SINE), 0.0, (-INF, INF)),
        (1.0 * (TIMES > 5), 0.0, (-INF, INF)),
        (np.zeros(9), 0.0, (-INF, INF)),
        (np.clip(SINE, -0.5, 0.7), 0.0, (-0.5, 0.7)),
        (np.clip(SINE, -0.5, INF), 0.0, (-0.5, INF)),
        (np.clip(SHAKY, -0.5, 0.7), 0.0, (-0.5, 0.7)),
        (np.clip(SHAKEN, -0.5, 0.7), 0.0, (-0.5, 0.7)),
        (SHAKEN, 0.0, (-INF, INF)),
        (np.round(SHAKY, 1), 0.1, (-INF, INF)),
        (np.sin(2 * np.pi * np.arange(4000) / 20), 0.0, (-INF, INF)),  # alike in every period
        (np.tanh(50 * SINE), 0.0, (-INF, INF)),
    ],
    ids=[
        *("sine", "rounded", "settled", "square", "step", "silent", "both", "low", "noisy"),
        *("noisier", "noise", "coarse", "periodic", "bent"),
    ],
)
def test_readings_that_stick_on_their_way_show_a_range(
    y: Floats, quantum: float, limits: tuple[float, float]
) -> None:
    ok = np.isfinite(y)
    ends = range_ends(y, ok, quantum)
    assert (ends.low, ends.high) == limits
    assert ends.has_ends == bool(ends.find_readings_at_ends(y, ok).any())
    assert (
        ends.number
        == ends.find_readings_at_ends(y, ok).sum()
        == ((y == ends.low) | (y == ends.high)).sum()
    )
    draw = np.random.default_rng(1)
    running = RunningEnds()  # as a log that is watched comes in
    for block in np.split(np.arange(y.size), np.sort(draw.integers(0, y.size, 300))):
        running.add(y[block], ok[block])
    assert running.find_range_ends(quantum) == ends


def test_a_stop_tells_the_speed_before_it() -> None:
    """Readings rise by 0.01 a sample and stick at 1, which comes after 0.15 at once."""
    y = np.append(0.06 + 0.01 * np.arange(10), np.ones(2 * RUN))
    end = _UpperLimit()
    end.add(y, np.ones(y.size, bool))
    assert end._before == pytest.approx([0.15])
    assert end._speed == pytest.approx([0.01])


def test_identify_takes_them_for_missing_and_says_so() -> None:
    y, u = np.clip(SHAKY, -0.5, 0.7), np.cos(TIMES)[:, None]
    nothing = np.empty((y.size, 0))
    log = Log(
        TIMES, u, y[:, None], ("u",), ("y",), "1", ("1",), "a test", np.empty(0), False, nothing
    )
    prepared = prepare_log(to_grid([log]), Options())
    at_end = np.flatnonzero((y == -0.5) | (y == 0.7))
    beside = np.abs(np.subtract.outer(np.arange(y.size), at_end)).min(axis=1) <= NEAR
    assert np.array_equal(prepared.data.ok, ~beside)  # noise that reaches no end pulls inwards
    assert "[-0.5, 0.7]" in prepared.remarks[-1]


def test_identify_calls_what_needs_no_zone_and_ends_a_saturation() -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.normal(size=60), 15)
    z = second_order(u) + 0.01 * rng.normal(size=u.size)
    found = uz.identify(t=0.05, u=u, y=np.clip(z, -0.6, 0.7), order=2, delay=0)
    assert found.verdict == "saturation"
    assert "[-0.6, 0.7]" in found.summary()["why"][0]
    assert uz.identify(t=0.05, u=u, y=z, order=2, delay=0).verdict == "none"


def test_estimate_asks_for_the_range() -> None:
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01}
    observer = {"method": "kalman"} | OBSERVERS["kalman"][1]
    limited = small("sampled", sensor=sensor | {"range": [-0.4, 0.6]}, observer=observer)
    run = simulate(limited)
    silent_about_it = small("sampled", sensor=sensor, observer=observer)
    for scenario, remarks in ((limited, 0), (silent_about_it, 1)):
        info = uz.estimate(scenario, t=run.t, y=run.y, u=run.u, smoothing=False).info
        assert len(info.remarks) == remarks
    assert "sensor.range = [-0.4, 0.6]" in info.remarks[0]


def test_watch_asks_for_the_range(tmp_path: Path) -> None:
    y = np.clip(SINE, -0.4, 0.6)
    lines = ["t,y,u", *(f"{t!r},{r!r},0" for t, r in zip(TIMES.tolist(), y.tolist(), strict=True))]
    path = tmp_path / "watched.toml"
    path.write_text(
        '[plant]\nA = [[-1.0]]\nB = [[1.0]]\nC = [[1.0]]\n[observer]\nmethod = "kalman"\n'
        'right = [0.0, 1.0]\n[simulation]\nstep = 0.01\ntime = "sampled"\n'
    )
    result = CliRunner().invoke(group, ["watch", str(path)], input="\n".join(lines) + "\n")
    assert "sensor.range = [-0.4, 0.6]" in result.stderr
