"""Claims that the readings refute: scores, names, words, bits."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from benchmarks.filters import false_assumptions as benchmark
from benchmarks.filters.coverage_by_assumption import ASSUMPTIONS

import undeadzone as uz
from undeadzone.interfaces import (
    ASSUMPTION_CHECKS,
    Estimate,
    Reading,
    describe_rejected_assumptions,
    describe_unknowns,
    list_rejected_assumptions,
)
from undeadzone.observers.filtering.innovation_tests import (
    FORETOLD,
    Scores,
    assumption_fields,
    assumption_ratios,
    score_squares,
    start_scores,
    update_scores,
)
from undeadzone.simulation.consistency import Alarm, Own

TS, RATE, N = 0.01, 2.0, 2500
RIGHT, LEFT, NOISE = 1.0, 0.7, 0.02


def test_names_stand_in_order_of_the_bits_but_for_the_likeliest() -> None:
    names = list(ASSUMPTION_CHECKS)
    assert list_rejected_assumptions(0.0, 0.0) == []
    assert list_rejected_assumptions(float(2 ** len(ASSUMPTION_CHECKS) - 1), 3.0) == [
        names[2],
        *names[:2],
        *names[3:],
    ]


def test_the_likeliest_is_described_in_full_and_the_others_by_name() -> None:
    assert describe_rejected_assumptions([]) == []
    gust = f"{ASSUMPTION_CHECKS['gust'].words}: {ASSUMPTION_CHECKS['gust'].cure()}"
    assert describe_rejected_assumptions(["gust"]) == [gust]
    described = describe_rejected_assumptions(["gust", "noise", "range"])
    assert described == [gust, "the same readings contradict noise, range"]


def test_no_option_is_advised_that_the_method_does_not_have() -> None:
    cure = ASSUMPTION_CHECKS["gust"].cure
    assert cure() == "raise observer.disturbance, observer.bias or observer.drift"
    assert cure(uz.Kalman.__struct_fields__) == "raise observer.disturbance or observer.drift"
    assert ASSUMPTION_CHECKS["glitches"].cure(["right"]) == "look at the sensor"
    assert ASSUMPTION_CHECKS["noise"].cure(["right"]) == "raise sensor.noise"


def test_a_filter_names_unknowns_without_an_option() -> None:
    described = describe_unknowns(uz.Kalman.__struct_fields__)
    assert "a constant at the input (observer.bias) or an error of the model" in described
    for knowing in (uz.Censored, uz.Auto, uz.Extended, uz.Luenberger):
        assert not describe_unknowns(knowing.__struct_fields__)


def test_bits_and_the_likeliest() -> None:
    found = assumption_fields({"noise": ca.SX(30.0), "dynamics": ca.SX(9.0), "gust": ca.SX(0.9)})
    bits, suspect = float(found["claims"]), float(found["suspect"])
    assert not float(found["consistent"])
    names = list(ASSUMPTION_CHECKS)
    assert list_rejected_assumptions(bits, suspect) == ["dynamics", "noise"]
    assert bits == 2.0 ** names.index("noise") + 2.0 ** names.index("dynamics")


def test_what_is_no_number_is_not_consistent() -> None:
    found = assumption_fields({"noise": ca.SX(0.5), "gust": ca.SX(np.nan)})
    assert not float(found["consistent"])
    assert list_rejected_assumptions(float(found["claims"]), float(found["suspect"])) == ["gust"]
    own, column = Own(), {name: np.array([[float(value)]]) for name, value in found.items()}
    own.add(Estimate(*[np.zeros((1, 1))] * len(Estimate._fields))._replace(**column))
    assert list_rejected_assumptions(*own.last) == ["gust"]


def doubts(**changes: Any) -> SimpleNamespace:
    """Numbers of the tests, for one output but for the changes."""
    usual = {"keep": 0.99, "means": np.zeros(3), "run": 20.0, "push": np.eye(1), "stays": 0.0}
    usual |= {"noisy": 1.0, "reach": 1.0, "limit": 3.3**2, "most": 2.3}
    return SimpleNamespace(**usual | changes)


def followed(regress: Callable[[Any], Any], count: int = 400) -> dict[str, list[float]]:
    """Ratios after so many innovations in 200 runs at once, each an output of its own."""
    lanes, rng = 200, np.random.default_rng(3)
    doubt = doubts(means=np.array([0.1, 0.5, 0.96]), push=np.eye(lanes))
    q: Any = SimpleNamespace(doubt=doubt, slope=1.0)
    symbols = Scores(*[ca.SX.sym(name, lanes) for name in Scores._fields])
    nu, y, u = (ca.SX.sym(name, lanes) for name in ("nu", "y", "u"))
    after = update_scores(q, symbols, nu, nu, 1.0, 0.0, Reading(y, 0.0), u)
    step = ca.Function("step", [*symbols, nu, y, u], list(after))
    state: list[Any] = list(start_scores(lanes))
    for _ in range(count):
        own = Scores(*[ca.DM(part).full().ravel() for part in state])
        draws = rng.normal(size=(2, lanes))
        state = step.call([*state, rng.normal(size=lanes) + regress(own), *draws])
    parts = [ca.DM(part).full().ravel() for part in state]
    found: dict[str, list[float]] = {}
    for lane in range(lanes):
        one = Scores(*[ca.SX(part[lane]) for part in parts])
        for name, ratio in assumption_ratios(doubt, one).items():
            found.setdefault(name, []).append(float(ratio))
    return found


def test_scores_of_white_innovations_refute_nothing() -> None:
    ratios = followed(lambda own: 0.0)
    false = [np.mean(np.array(ratio) > 1) for ratio in ratios.values()]
    assert max(false) <= 0.03
    for name in ("slope", "dynamics"):
        assert 0.7 <= np.mean(ratios[name]) * 3.3**2 <= 1.4  # squares of normal numbers


@pytest.mark.parametrize(
    ("name", "regress"),
    [
        ("slope", lambda own: 1.1 * (own.brisk - own.slow)),
        ("dynamics", lambda own: 1.3 * (own.quick - own.brisk)),
    ],
)
def test_a_score_finds_what_innovations_depend_on(name: str, regress: Callable[[Any], Any]) -> None:
    ratios = followed(regress)
    assert np.mean(np.array(ratios[name]) > 1) >= 0.95


@pytest.mark.parametrize(
    ("refused", "y", "found"),
    [
        ((1, 1, 1, 0), (9.0, 9.0), True),
        ((1, 1, 1, 0), (9.0, 9.9), True),
        ((1, 1, 1, 0), (9.0, 11.7), False),  # glitches: they do not agree
        ((1, 1, 1, 0), (0.0, 0.0), False),  # a silence agrees with any other
        ((1, 1, 0, 0), (9.0, 9.0), False),  # never three in a row
        ((1,), (9.0, 9.0), False),  # one row, however long
        ((1, 1, 1, *(0,) * 20), (9.0, 9.0), True),
        ((1, 1, 1, *(0,) * 600), (9.0, 9.0), False),  # too seldom
    ],
)
def test_readings_are_refused_in_rows_again_and_again(
    refused: tuple[int, ...], y: tuple[float, float], found: bool
) -> None:
    """Readings are y, in turn, and 9 beyond what was foretold."""
    doubt = doubts()
    q: Any = SimpleNamespace(doubt=doubt, slope=1.0)
    each = Scores(*[ca.SX.sym(name) for name in Scores._fields])
    e, refuse, read = ca.SX.sym("e"), ca.SX.sym("refuse"), ca.SX.sym("y")
    after = update_scores(q, each, e, e, 1 - refuse, refuse, Reading(read, 0.0), ca.SX(0.0))
    step = ca.Function("step", [*each, e, refuse, read], list(after))
    state: list[Any] = list(start_scores(1))
    rng, is_refused = np.random.default_rng(0), np.resize(refused, 650)
    for k, one in enumerate(is_refused):
        state = step.call([*state, 9.0 if one else rng.normal(), float(one), y[k % 2]])
    ratio = assumption_ratios(doubt, Scores(*[ca.SX(part) for part in state]))["sensor"]
    assert (float(ratio) > 1) is found


# --- In a loop and a log


def log(lag: float = 0.0, noise: float = 1.0, offset: float = 0.0) -> tuple[Any, Any]:
    """Readings and inputs of a plant of first order, with something that nobody claims."""
    rng, t = np.random.default_rng(0), TS * np.arange(N)
    u = 6.0 * np.sin(1.3 * t) + 3.0 * np.sin(3.1 * t + 1.0)
    decay = np.exp(-TS / lag) if lag else 0.0
    x = moved = 0.0
    y = np.empty(N)
    for k in range(N):
        y[k] = x - min(max(x, -LEFT), RIGHT) + offset + noise * NOISE * rng.normal()
        moved = decay * moved + (1 - decay) * u[k]
        x = np.exp(-RATE * TS) * x + (1 - np.exp(-RATE * TS)) * moved
    return y, u


def scenario(**options: Any) -> uz.Scenario:
    """The filter of that plant, which is told all else."""
    return uz.Scenario(
        plant=uz.Plant(A=[[-RATE]], B=[[RATE]], C=[[1]]),
        sensor=uz.Sensor(right=RIGHT, left=LEFT, noise=NOISE),
        observer=uz.Extended(**({"right": [0.3, 2.0], "disturbance": 0.1} | options)),
        reference=uz.Sine(amplitude=1.0, frequency=0.3),
        controller=uz.StateFeedback(poles=[-3.0]),
        simulation=uz.Simulation(duration=1.0, time="sampled", step=TS),
    )


@pytest.mark.parametrize(
    ("name", "wrong", "options"),
    [
        ("", {}, {}),
        ("", {"noise": 4.0}, {}),  # which the filter learns
        ("dynamics", {"lag": 0.03}, {}),
        ("sensor", {"offset": -0.3}, {}),
        ("range", {}, {"right": [0.3, 0.8], "left": [0.3, 2.0]}),
    ],
)
def test_a_log_names_the_false_assumption(
    name: str, wrong: dict[str, float], options: dict[str, Any]
) -> None:
    y, u = log(**wrong)
    result = uz.estimate(scenario(**options), y=y, u=u, smoothing=False)
    assert result.info.claims[:1] == [name][: bool(name)]
    assert result.consistent is not bool(name)
    if name:
        described = describe_rejected_assumptions([name], uz.Extended.__struct_fields__)
        assert described[0] in repr(result)
        assert result.summary()["claims"][0] == name


@pytest.mark.parametrize(("assumptions", "least"), [("told", 0.75), ("ranges alone", 0.85)])
def test_glued_logs_are_named_and_covered(assumptions: str, least: float) -> None:
    """Their states jump: where z has gone since is hardly known, and the intervals show that."""
    glued = benchmark.ROWS["glued from 21 pieces"]
    posed = benchmark.posed_of(glued, 1, 40, 77, benchmark.ASSUMED_WORLDS[0])
    found = benchmark.part(ASSUMPTIONS[assumptions], posed)
    named = found.suspects == 1 + list(ASSUMPTION_CHECKS).index("sensor")
    assert np.mean(found.suspects > 0) >= 0.7
    assert named.mean() >= 0.7
    assert 1 - found.misses.mean(axis=0).max() >= least


@pytest.mark.parametrize("length", [3, 7])
def test_an_alarm_takes_its_delay_in_blocks_of_any_length(length: int) -> None:
    alarm = Alarm(1.0, 1.0)
    assert Alarm(300.0, 300.0).limit < Alarm(1.0, 1.0, 864e3).limit < alarm.limit  # a month
    for unfit, alarms in ((0, 0), (alarm.limit - 1, 0), (0, 0), (alarm.limit, 1), (9, 1)):
        fits = np.arange(unfit + alarm.limit) >= unfit
        for k in range(0, len(fits), length):
            alarm.add(fits[k : k + length])
            assert alarm.is_due == (alarm.count > 0)
        assert alarm.count == alarms


def of_scores(y: float, last: float, slope: float, refused: float = 0.0, **sums: Any) -> Any:
    """Scores of one output after a reading that is not what was foretold."""
    doubt = doubts(keep=0.5, stays=0.1, noisy=0, push=np.zeros((1, 1)), reach=100.0, run=9)
    q = SimpleNamespace(doubt=doubt, slope=slope)
    before = start_scores(1)._replace(last=np.array([last]), **sums)
    zero = ca.SX(1, 1)
    nu = ca.SX(FORETOLD + 1)
    reading = Reading(ca.SX(y), ca.SX(1.0))
    return update_scores(q, before, nu, nu, zero, ca.SX(refused), reading, zero)


def test_the_level_of_stuck_readings_is_in_units_of_z() -> None:
    """A sensor of slope 4 that is stuck at 8 rests at z = 2."""
    assert float(of_scores(8.0, 8.0, 4.0).rest) == pytest.approx(0.5 * 2.0)


@pytest.mark.parametrize(("y", "expected"), [(8.0, 0.5), (0.0, 0.0)])
def test_a_silent_sensor_is_not_mistaken_for_a_stuck_one(y: float, expected: float) -> None:
    assert float(of_scores(y, y, 1.0).stuck) == expected


def test_scores_of_small_inputs_are_normal_numbers_too() -> None:
    many = start_scores(1)._replace(count=np.array([1e6]), lift=np.ones(1), rise=np.ones(1))
    few = many._replace(lift_square=np.full(1, 0.25), rise_square=np.full(1, 4.0))
    found = score_squares(few)
    assert float(found["slope"]) == pytest.approx(4.0)
    assert float(found["dynamics"]) == pytest.approx(0.25)


@pytest.mark.parametrize(("y", "last", "row"), [(8.0, 8.1, 4), (8.0, -8.0, 1), (0.0, 0.1, 1)])
def test_a_row_of_refused_readings_goes_on_where_they_agree_and_not_through_silence(
    y: float, last: float, row: int
) -> None:
    after = of_scores(y, last, 1.0, refused=1.0, row=np.full(1, 3.0))
    assert float(after.row) == row
