"""Truths that no model holds: what is seen is said, and nothing is named."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from benchmarks.identify.logs.names import make
from benchmarks.identify.logs.strangers import ALL, STEP, lags, walk, zone
from click.testing import CliRunner

import undeadzone as uz
from further import further
from records import dead_zone, holds, write_log
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.chain import INPUTS, ChainModel
from undeadzone_identify.models.elements import MapModel, limited_zone_map
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.results.assemble import ODDS_OF, withhold_poor_fit
from undeadzone_identify.selection.adequacy import Remainder, largest_remainder
from undeadzone_identify.selection.alternatives import Findings
from undeadzone_identify.selection.decision import MODELS, build_verdict


def identify_log(u: Floats, y: Floats, **more: object) -> uz.Identified:
    answer = uz.identify(t=STEP, u=u, y=y, **more)
    assert isinstance(answer, uz.Identified)
    return answer


def of_kind(kind: str, seed: int) -> uz.Identified:
    log = ALL[kind].make(np.random.default_rng(seed))
    return identify_log(log.u, log.y, **log.options)


def test_a_joint_that_rubs_is_named_with_its_friction() -> None:
    """The servo's predictor excludes a gap: its fit is that of friction, in the input's unit."""
    answer = of_kind("joint, friction .3", 1)
    assert answer.verdict == "friction"
    value, low, high = answer.numbers()["friction"]
    assert low < 0.3 < high
    assert value == pytest.approx(0.3, rel=0.03)
    assert "friction" in str(answer.summary())
    assert "crossings" not in str(answer.summary())
    assert answer.numbers()["held_out"]["fit"] > 0.99


def test_another_curve_of_the_input_has_no_name_and_no_odds(tmp_path: Path) -> None:
    """A soft limit of the input: nothing known holds it; the command says what it saw."""
    rng = np.random.default_rng(1)
    u = walk(rng, 2400)
    y = lags(np.tanh(2 * u)) + 0.02 * rng.standard_normal(u.size)
    log = tmp_path / "log.csv"
    write_log(log, "t,u,y", STEP, u, y)
    words = ["identify", str(log), "--json", "--no-figures", "--out", str(tmp_path)]
    assert group.main(words, standalone_mode=False) == 0
    saved = json.loads((tmp_path / "identify.json").read_text())
    assert saved["verdict"] == "unclear"
    assert saved["answer"]["effects"] == {"input shape": {}}
    assert saved["answer"]["grade"] == "indicated"
    assert saved["odds"] == {}
    assert saved["width"] is None
    assert "depends on the size of the input" in saved["reasons"][0]
    assert "Record steps" in saved["reasons"][1]
    assert not (tmp_path / "log.toml").exists()


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("line", {"saturation"}),
        *further(
            ("fan", {"input_curve"}),
            ("play ahead, 12", {"input_play"}),
            ("tank", {"unclear"}),
            ("friction that falls", {"friction", "unclear"}),
        ),
    ],
)
def test_limits_of_the_readings_hide_nothing_between_them(kind: str, words: set[str]) -> None:
    """Limits are the answer by their own test alone: it must see whatever else is there."""
    log = ALL[kind].make(np.random.default_rng(8501))
    limited = np.clip(log.y, *np.quantile(log.y, [0.06, 0.92]))
    assert identify_log(log.u, limited, **log.options).verdict in words


@pytest.mark.long("undeadzone_identify/test_names_of_logs.py::test_a_log_has_its_name")
def test_a_slow_disturbance_is_no_remainder() -> None:
    """It explains most of the residual of a line, but depends on no signal."""
    rng = np.random.default_rng(4)
    u = walk(rng)
    slow = walk(rng, u.size, 100.0)
    answer = identify_log(u, lags(u) + 0.2 * slow + 0.02 * rng.standard_normal(u.size))
    assert answer.verdict == "none"


@pytest.mark.long("test_a_dead_zone_leaves_nothing")
@pytest.mark.parametrize(("truth", "seed"), [("sensor and input", 9304), ("play and zone", 9303)])
def test_a_disturbance_ahead_of_a_zone_is_no_curve(truth: str, seed: int) -> None:
    """It rounds the corners in the mean: of long logs 6 % were left, and nothing was named."""
    log = make(seed, truth)
    last = slice(-5000, None)
    word = "both" if truth == "play and zone" else "two_zones"
    answer = uz.identify(t=log.step, u=log.u[last], y=log.y[last])
    assert isinstance(answer, uz.Identified)
    assert answer.verdict == word
    left = {one.on: one for one in answer.answer.found.remainders}
    assert max(left[on].share for on in ("output", "behind")) < 0.02


@pytest.mark.long("test_a_dead_zone_leaves_nothing")
def test_the_order_behind_two_zones_is_not_that_of_a_zone_of_the_sensor() -> None:
    """Static maps hold no zone of the input: with theirs a third lag of the plant was left."""
    log = make(9501, "sensor and input")
    answer = identify_log(log.u[:3000], log.y[:3000])
    assert answer.verdict == "two_zones"
    places = answer.answer.found.places
    assert places["two_zones"].model.n > places["dead_zone"].model.n
    assert all(one.share < 0.02 for one in answer.answer.found.remainders)


@pytest.mark.long("undeadzone_identify/test_names_of_logs.py::test_a_log_has_its_name")
def test_a_curve_of_the_sensor_is_not_late_by_the_delay_of_a_zone() -> None:
    """In a loop a zone's model is late by a sample. What is left is the encoder's rounding."""
    log = make(9308, "cubic")
    answer = identify_log(log.u[:2500], log.y[:2500])
    assert answer.verdict == "other"
    assert answer.answer.found.delay == 0
    assert answer.numbers()["held_out"]["error"] == pytest.approx(0.03 / np.sqrt(12), rel=0.1)


@pytest.mark.long("test_a_joint_that_rubs_is_named_with_its_friction")
def test_friction_may_leave_more_than_a_tenth_by_the_output() -> None:
    """It holds the plant at readings of which an encoder shows few: 14 % depend on them here."""
    log = make(10016, "friction")
    answer = identify_log(log.u, log.y)
    assert answer.verdict == "friction"
    _, low, high = answer.numbers()["friction"]
    assert low < log.widths[0] < high


def test_a_dead_zone_leaves_nothing() -> None:
    rng = np.random.default_rng(2)
    u = walk(rng)
    z = lags(u)
    y = dead_zone(z, 0.5, 0.35) + 0.02 * rng.standard_normal(u.size)
    answer = identify_log(u, y)
    assert answer.verdict == "dead_zone"
    assert holds(answer.width, 0.85)


# --- Everyday truths


def test_a_filter_behind_the_zone_is_no_friction(tmp_path: Path) -> None:
    """It has widths with intervals, and a scenario whose observer runs along the log."""
    log = ALL["zone, mean of 4"].make(np.random.default_rng(1))
    answer = identify_log(log.u, log.y)
    assert answer.verdict == "filtered_zone"
    assert answer.zone
    assert answer.width is not None
    assert log.width is not None
    assert holds(answer.width, log.width)
    late = answer.numbers()["shape"]["lag"]
    assert 0 < late[1] < late[2] < 1.5 * STEP  # the plant holds the rest, which is a pure delay
    path = tmp_path / "zone.toml"
    path.write_text(answer.scenario())
    record = pd.DataFrame({"t": STEP * np.arange(log.u.size), "y": log.y, "u": log.u})
    estimated = uz.estimate(path, record).to_pandas().filter(like="z")
    assert np.isfinite(estimated.to_numpy()).all()
    assert not estimated.empty


@pytest.mark.long("test_a_filter_behind_the_zone_is_no_friction")
def test_a_lag_behind_the_zone_has_its_time_constant() -> None:
    shape = of_kind("zone, lag of 3", 1).numbers()["shape"]
    assert shape["lag"][1] < STEP * 0.7 / 0.3 < shape["lag"][2]


def sensed_zone(rounding: float, slope: float) -> tuple[Floats, Floats, Floats]:
    """Return input, output and readings of a zone with round edges and a left side of a slope."""
    rng = np.random.default_rng(5)
    u = walk(rng)
    z = lags(u)
    up, down = rounding * np.logaddexp(0, np.array([z - 0.5, -z - 0.4]) / rounding)
    return u, z, up - slope * down + 0.01 * rng.standard_normal(u.size)


@pytest.mark.parametrize(("rounding", "slope"), [(0.06, 1.0), *further((1e-3, 0.9))])
def test_the_shape_of_a_sensor_is_estimated_and_written(rounding: float, slope: float) -> None:
    """The scenario's assumptions come from the log, and lie beside the true shape."""
    u, _, y = sensed_zone(rounding, slope)
    answer = identify_log(u, y)
    shape = answer.numbers()["shape"]
    assert shape["rounding"][1] <= rounding <= shape["rounding"][2]
    assert shape["slope"][1] - 0.005 < slope < shape["slope"][2] + 0.005
    assert "edges round over" in str(answer.summary())
    sensor = tomllib.loads(answer.scenario())["sensor"]
    assert sensor["rounding"] == pytest.approx(rounding, abs=0.02)
    assert sensor["slope_std"] == pytest.approx(abs(1 - slope), abs=0.01)


def test_a_limit_of_the_rate_is_named_and_has_no_scenario() -> None:
    answer = of_kind("rate limit of the input", 3)
    assert answer.verdict == "input_rate"
    with pytest.raises(InputError, match="rate"):
        answer.scenario()


def test_pulses_count_from_the_middle_of_their_zone() -> None:
    """Pulses of 1500 us that mean rest: the zone is from 1478 to 1527."""
    answer = of_kind("pulses about 1500", 3)
    assert answer.verdict == "input_zone"
    middle = answer.numbers()["input_zero"]
    assert answer.right is not None
    assert answer.left is not None
    assert middle + answer.right.low < 1527 < middle + answer.right.high
    assert middle - answer.left.high < 1478 < middle - answer.left.low


def test_an_undecided_log_has_a_bound_and_an_option_that_decides() -> None:
    """A short log: a zone of the input or a curve; `place` gives the width."""
    rng = np.random.default_rng(1)
    u = walk(rng, 300)
    y = lags(zone(u, 0.4, 0.3)) + 0.1 * rng.standard_normal(u.size)
    answer = identify_log(u, y)
    assert answer.verdict == "undecided"
    assert answer.account.grade == "bounded"
    assert answer.account.limits["input loss"] > 0.7
    placed = identify_log(u, y, place="actuator")
    assert placed.verdict == "input_zone"
    assert holds(placed.width, 0.7)


@pytest.mark.parametrize("samples", [4.0, *further(0.0)])
def test_a_lag_ahead_of_the_zone_withholds_the_name(samples: float) -> None:
    """A curve or a zone of the late input imitates it well: only lags ahead of it show that."""
    rng = np.random.default_rng(7001)
    u = walk(rng)
    late = lags(u, samples, 1) if samples else u
    y = lags(zone(late, 0.4, 0.3)) + 0.02 * rng.standard_normal(u.size)
    answer = identify_log(u, y)
    if not samples:
        assert answer.verdict == "input_zone"
        assert holds(answer.width, 0.7)
        return
    assert answer.verdict == "unclear"
    assert "the input a few samples before" in answer.answer.reasons[0]
    assert "Record its output" in answer.answer.reasons[1]
    assert not answer.numbers()["odds"]


# --- What a name must explain


def test_distance_from_neutral_vanishes_for_what_passes_the_input() -> None:
    """Each element of the input passes a multiple of u with its neutral numbers."""
    u = walk(np.random.default_rng(3), 300)
    for name, element in INPUTS.items():
        if element.neutral:
            passed = element.passes(u, np.array(element.neutral))
            assert np.polyval(np.polyfit(u, passed, 1), u) == pytest.approx(passed, abs=1e-5), name


@pytest.mark.parametrize("word", [*MODELS, *ODDS_OF, "unreached"])
def test_no_word_stands_whose_own_held_out_share_is_below_a_half(word: str) -> None:
    """Whatever the word: of static models, of chains."""
    found = Findings(build_verdict(word), 0, (), {"none": 1.0})
    assert withhold_poor_fit(found, 0.5).verdict.word == word
    poor = withhold_poor_fit(found, 0.49)
    assert poor.verdict.word == "unclear"
    assert not poor.odds
    assert "49 %" in poor.verdict.reasons[0]


def test_a_loop_whose_readings_nothing_foretells_has_no_name(tmp_path: Path) -> None:
    """A controller that answers to noise: that its valve follows cannot be known."""
    rng = np.random.default_rng(2)
    pv = 50 + rng.standard_normal(700)
    op = 40 - 0.3 * (pv - 50) - 0.05 * np.cumsum(pv - 50)
    log = tmp_path / "loop.csv"
    write_log(log, "time,OP,PV,SP", 1.0, op, pv, np.full(700, 50.0))
    answer = uz.identify(log)
    assert answer.verdict == "noise"
    assert "see to the transmitter" in answer.account.remedies[0]


@pytest.mark.long("test_limits_that_no_reading_reaches_are_not_reported")
def test_limits_behind_a_zone_are_no_jump() -> None:
    """The zone is 0.5 and 0.35 wide, its readings end at -0.6 and 0.8."""
    answer = of_kind("zone that ends", 8201)
    assert answer.verdict == "saturation"
    reason = answer.answer.reasons[-1]
    found = re.findall(r"at (\S+) and (\S+),.* (\S+) right and (\S+) left", reason)[0]
    assert [*map(float, found)] == pytest.approx([-0.6, 0.8, 0.5, 0.35], abs=0.01)


def test_limits_that_no_reading_reaches_are_not_reported() -> None:
    reason = of_kind("limit of one side", 8301).answer.reasons[-1]
    assert re.fullmatch(r"the readings end at 0\.(79|8)\d*", reason)


@pytest.mark.parametrize(
    "parts",
    [
        *({"element": name} for name in INPUTS),
        {"taps": 4},
        {"zone": True, "taps": 4},
        {"zone": True, "lags": True},
        {"zone": True, "lags": True, "shaped": True},
    ],
    ids=str,
)
def test_derivatives_of_a_chain_are_its_slopes(parts: dict[str, Any]) -> None:
    """Two records: each begins with its own state, and with element and filter at rest."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal((300, 1)), axis=0) / 5
    start, whole = np.array([0, 120]), np.ones(300, bool)
    data = RecordData(u, 0.0 * u[:, 0], whole, start, 0 * whole, False, np.ones(1), 1.0)
    model = ChainModel(PlantSimulator(data, 2), **parts)
    own = np.clip(np.linspace(0.3, 0.6, model.low.size), model.low, model.high)
    theta = np.concatenate([[-1.3, 0.4, 0.3, 0.2, 0.1, -0.1, 0.2, 0.05], own])
    if model.shaped:
        theta[model.shape] = 0.8, 0.05
    model.free = model.free[1:]  # as a model with a number that is known
    readings, rows = model.slopes(theta)
    np.testing.assert_array_equal(readings, model.noise_free_readings(model.output(theta), theta))
    for column, place in zip(rows.T, model.free, strict=True):
        step = 1e-6 * np.eye(theta.size)[place]
        above, below = (
            model.noise_free_readings(model.output(one), one)
            for one in (theta + step, theta - step)
        )
        np.testing.assert_allclose(column, (above - below) / 2e-6, atol=1e-4 * np.ptp(column))


@pytest.mark.parametrize("level", [0.0, 0.3])
def test_limits_include_the_level_of_the_readings(level: float) -> None:
    """A zone between limits has no negative width: it would be a jump, and is not shown."""
    u = np.random.default_rng(3).standard_normal((400, 1))
    whole = np.ones(400, bool)
    data = RecordData(u, 0.0 * u[:, 0], whole, np.zeros(1, int), 0 * whole, False, np.ones(1), 1.0)
    theta = np.array([-0.5, 1.0, 0.0, -0.2, -0.1, 0.8, 0.6])  # a, b, x0, widths, limits
    z = PlantSimulator(data, 1).simulate_z(theta[:3])
    simulator = PlantSimulator(data._replace(y=np.clip(z, -0.6, 0.8) + level), 1)
    model = MapModel(simulator, "saturation", limited_zone_map)
    model.has_level = level != 0
    theta = model.project_to_bounds(theta)
    assert theta[3:].tolist() == [0.0, 0.0, 0.8, 0.6]
    expected = f"the readings end at {level - 0.6:.3g} and {level + 0.8:.3g}"
    assert model.describe_limits(theta, 1.0) == expected


def test_an_edge_that_the_input_never_passes_has_a_lower_bound_only(tmp_path: Path) -> None:
    """A heater does nothing below 0: the end of the input is no edge."""
    log = ALL["heater"].make(np.random.default_rng(8201))
    t = np.arange(log.u.size) * STEP
    pd.DataFrame({"t": t, "u": log.u, "y": log.y}).to_csv(tmp_path / "log.csv", index=False)
    words = ["identify", str(tmp_path / "log.csv"), "--out", str(tmp_path), "--no-figures"]
    run = CliRunner().invoke(group, words, standalone_mode=False)
    assert run.return_value == 0
    assert "Record an input that passes it" in run.stdout
    found = json.loads((tmp_path / "identify.json").read_text())
    assert found["verdict"] == "input_zone"
    assert found["right"][1] < 0 < found["right"][2]
    assert found["left"] == [pytest.approx(-log.u.min())] * 2 + [None]
    assert found["width"] is None


@pytest.mark.parametrize("quantum", [0.2, *further(0.002)])
def test_rounded_readings_are_not_those_of_a_recorder(quantum: float) -> None:
    """Coarse ones repeat as well, and move by one spacing or more."""
    rng = np.random.default_rng(5)
    u = walk(rng)
    y = quantum * np.round(lags(u) / quantum)
    assert identify_log(u, y).verdict in ("none", "operating_point")


@pytest.mark.parametrize(("step", "noise"), [(0.6, 0.01), *further((0.3, 0.05))])
def test_noise_behind_a_coarse_sensor_hides_no_steps(step: float, noise: float) -> None:
    """They were a jump, or a play, with 1.00."""
    rng = np.random.default_rng(7103)
    u = walk(rng)
    readings = step * np.round(lags(u) / step) + noise * rng.standard_normal(u.size)
    answer = identify_log(u, readings)
    assert answer.verdict == "none"
    assert f"larger than any zone ({step:g})" in answer.answer.reasons[0]
    assert any("the readings gather about steps of" in one for one in answer.answer.remarks)


@pytest.mark.long("test_noise_behind_a_coarse_sensor_hides_no_steps")
def test_a_zone_behind_blurred_steps_goes_from_its_log_to_an_estimate(tmp_path: Path) -> None:
    """The scenario that is written explains the log itself, with its noise about the steps."""
    rng = np.random.default_rng(5)
    u = walk(rng, 2000)
    readings = 0.1 * np.round(zone(lags(u)) / 0.1) + 0.015 * rng.standard_normal(u.size)
    log, out = tmp_path / "log.csv", tmp_path / "out"
    columns = {"t": STEP * np.arange(u.size), "u": u, "y": readings}
    pd.DataFrame(columns).to_csv(log, index=False)
    runner = CliRunner()
    done = runner.invoke(group, ["identify", str(log), "--no-figures", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "gather about steps of 0.1" in done.output
    files = [str(out / "log.toml"), str(log), "--out", str(out)]
    done = runner.invoke(group, ["estimate", *files, "--no-figures", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["consistent"]
    for (low, high), truth in zip(found["ranges"], (0.5, 0.35), strict=True):
        assert low < truth < high


@pytest.mark.long("test_noise_behind_a_coarse_sensor_hides_no_steps")
def test_steps_that_noise_blurs_are_no_jump() -> None:
    rng = np.random.default_rng(7104)
    u = walk(rng)
    answer = identify_log(u, 0.6 * np.round(lags(u) / 0.6) + 0.18 * rng.standard_normal(u.size))
    assert answer.verdict == "unclear"
    assert "the place of the output between equal steps" in answer.answer.reasons[0]
    assert not answer.numbers()["odds"]


def test_a_gate_that_passes_large_readings_whole_is_a_jump() -> None:
    answer = of_kind("noise gate", 7111)
    assert answer.verdict == "jump"
    left = {one.on: one.share for one in answer.answer.found.remainders}
    assert left["steps"] < 0.03


@pytest.mark.parametrize(
    ("word", "on", "share", "is_left"),
    [
        ("jump", "output", 0.2, False),
        ("jump", "steps", 0.06, True),
        ("jump", "steps", 0.04, False),
        ("jump", "output", 0.3, True),
        ("jump", "behind", 0.4, False),
        ("jump", "input", 0.15, False),
        ("jump", "input", 0.3, True),
        ("friction", "output", 0.18, False),
        ("friction", "output", 0.25, True),
        ("friction", "turns of the output", 0.05, False),
        ("friction", "turns of the output", 0.15, True),
        ("friction", "rate of the input", 0.06, False),
        ("input_zone", "beside", 0.03, True),
        ("input_zone", "beside", 0.02, False),
        ("input_curve", "ahead", 0.03, True),
        ("input_curve", "ahead", 0.02, False),
        ("input_zone", "rate of the output", 0.04, False),
        ("dead_zone", "output", 0.09, True),
        ("dead_zone", "spring", 0.03, True),
        ("dead_zone", "spring", 0.02, False),
    ],
)
def test_coarse_models_may_leave_more(word: str, on: str, share: float, is_left: bool) -> None:
    left = Remainder(on, share, 1e-6, np.zeros(1))
    assert (largest_remainder([left], word) is left) == is_left
