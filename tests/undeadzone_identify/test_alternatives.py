"""Which nonlinearity is it: a play, a play and a dead zone, a zone of the input."""

from __future__ import annotations

import functools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.identify.logs.names import make as make_named_log
from scipy.signal import cont2discrete, lfilter

import undeadzone as uz
from documents import script_of_docs
from further import further
from records import dead_zone, driven, holds, identify_log, identify_second_order, logged
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone.scenario.reader import read
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.elements import PlayModel, fit_play
from undeadzone_identify.models.least_squares import LeastSquares
from undeadzone_identify.models.motion import are_exact, white_noise_rms
from undeadzone_identify.models.plant import PlantSimulator, RecordData, find_input_disturbance
from undeadzone_identify.models.play_gap import find_play_gap

A, B = np.array([-1.6, 0.68]), np.array([0.05, 0.03])
STEP = 0.05
START = np.zeros(1, int)
NUMBER = r"-?\d+\.?\d*"


def through(v: Floats, gaps: tuple[float, float], widths: tuple[float, float]) -> Floats:
    """What a play and a dead zone after it read of v."""
    y, now = np.empty(v.size), 0.0
    for k, value in enumerate(v):
        now = max(min(now, value + gaps[1]), value - gaps[0])
        y[k] = now
    return dead_zone(y, widths[0], widths[1])


def disturbed(rng: np.random.Generator, rms: float, size: int = 1000) -> Floats:
    """What a first-order disturbance of the input makes of z."""
    w = lfilter([1.0], [1.0, -0.8], rng.standard_normal(size + 200))
    w = lfilter(np.append(0.0, B), np.append(1.0, A), w)[200:]
    return np.asarray(rms * w / w.std())


def test_the_white_noise_of_readings_is_seen_beside_their_motion() -> None:
    y = 0.1 * np.random.default_rng(0).standard_normal(200_000)
    whole = np.ones(y.size, bool)
    assert white_noise_rms(y, whole, START) == pytest.approx(0.1, rel=0.02)
    assert white_noise_rms(y + 0.05 * np.arange(y.size), whole, START) == pytest.approx(
        0.1, rel=0.02
    )


def test_exact_readings_and_ticks_repeat_and_do_not_chatter() -> None:
    rng, _, z = driven(3)
    whole = np.ones(z.size, bool)
    exact = through(z, (0.3, 0.2), (0.0, 0.0))
    assert are_exact(exact, whole, START)
    assert are_exact(0.05 * np.round(exact / 0.05), whole, START)
    assert not are_exact(exact + 0.02 * rng.standard_normal(z.size), whole, START)
    chattering = 0.05 * np.round((exact + 0.05 * rng.standard_normal(z.size)) / 0.05)
    assert not are_exact(chattering, whole, START)


@pytest.mark.parametrize("zone", [False, True])
@pytest.mark.parametrize("integrators", [0, 1])
def test_gradients_of_a_play(zone: bool, integrators: int) -> None:
    rng, u, z = driven(4, 300)
    y = through(z, (0.3, 0.2), (0.1, 0.2)) + 0.02 * rng.standard_normal(z.size)
    ok = rng.random(y.size) > 0.1
    data = RecordData(
        u[:, None], y, ok, np.array([0, 150]), np.sign(y).astype(int), False, np.ones(1), 1.0
    )
    model = PlayModel(PlantSimulator(data, 2, integrators), zone)
    a = A if not integrators else np.array([-0.68])
    theta = np.concatenate([a, B, [0.1, 0.05, -0.1, 0.02], [0.31, 0.23, 0.12, 0.15]])
    theta = model.project_to_bounds(theta)
    squares = LeastSquares(model)
    _, rows = squares.residual_and_slopes(theta)
    for column, index in enumerate(model.free):
        step = np.zeros(theta.size)
        step[index] = 1e-6
        if model.tied and index == model.base:
            step[index + 1] = 1e-6
        slope = (
            squares.reading_residual(theta - step) - squares.reading_residual(theta + step)
        ) / 2e-6
        smooth = np.abs(slope - rows[:, column]) < 1e-5 * (1 + np.abs(slope))
        assert smooth.mean() > 0.99  # but where a contact begins


def test_a_disturbance_is_distinguished_from_noise() -> None:
    rng, u, z = driven(5, 4000)
    layout = PlantSimulator(
        RecordData(u[:, None], z, np.ones(z.size, bool), START, 0 * START, False, np.ones(1), 1.0),
        2,
    ).layout
    plant = np.concatenate([A, B, np.zeros(2), np.zeros(4)])
    noise = 0.05 * rng.standard_normal(z.size)
    whole = np.ones(z.size, bool)
    found = find_input_disturbance(layout, plant, disturbed(rng, 0.1, 4000) + noise, whole)
    assert found.rms == pytest.approx(0.1, rel=0.15)
    assert 0.6 < found.phi < 0.95
    assert find_input_disturbance(layout, plant, noise, whole).rms < 0.02


@pytest.mark.parametrize("seed", [1, *further(2)])
def test_the_gap_of_a_play_is_found(seed: int) -> None:
    rng, u, z = driven(10 + seed)
    gaps = tuple(rng.uniform(0.1, 0.4, 2))
    w = disturbed(rng, 0.03 * (seed % 2))
    y = through(z + w, gaps, (0.0, 0.0)) + 0.01 * rng.standard_normal(z.size)
    found = uz.identify(t=STEP, u=u, y=y, order="2-3", delay=0)
    assert found.verdict == "play"
    assert not found.zone
    assert holds(found.width, sum(gaps))
    assert found.width.half_width < 0.1
    assert holds(found.centre, (gaps[0] - gaps[1]) / 2)
    assert found.numbers()["zone_width"] is None
    states = found.states()
    error = (states.z - z - w)[100:]
    assert np.mean(np.abs(error) < 1.96 * states.z_std[100:]) > 0.85


@pytest.mark.parametrize("quantum", [0.0, 0.05])
def test_a_disturbance_ahead_of_an_encoder_leaves_the_gap_right(quantum: float) -> None:
    """Gaps of least squares are too small by it; simulated logs take that off."""
    rng, u, z = driven(52)
    level = through(z + disturbed(rng, 0.08), (0.3, 0.25), (0.0, 0.0))
    data = logged(u, quantum * np.round(level / quantum) if quantum else level)
    assert are_exact(data.y, data.ok, data.start)
    gap = find_play_gap(fit_play(data, [2], 0), quantum, False).intervals["width"]
    assert holds(gap, 0.55)
    assert gap.half_width < 0.1


def test_noisy_readings_have_no_ticks() -> None:
    noisy = np.random.default_rng(0).standard_normal(400)
    data = logged(noisy, noisy)
    assert not are_exact(data.y, data.ok, data.start)


def test_a_play_with_a_dead_zone_is_both() -> None:
    rng, u, z = driven(21)
    y = through(z, (0.25, 0.15), (0.2, 0.3)) + 0.01 * rng.standard_normal(z.size)
    found = uz.identify(t=STEP, u=u, y=y, order=2)
    assert found.verdict == "both"
    assert not found.zone
    assert holds(found.width, 0.4)
    value, low, high = found.numbers()["zone_width"]
    assert low <= 0.5 <= high
    assert high - low < 0.1
    assert low < value < high
    assert found.right is None
    assert found.centre is None
    assert re.search(r"gap 0\.\d.*; width 0\.\d", found.headline())
    assert "play = [" in found.scenario()


def behind_a_disturbance(strong: float, seed: int = 22) -> tuple[Floats, Floats]:
    """u and y of a play of .5 ahead of which a disturbance of that rms of z acts."""
    rng, u, z = driven(seed)
    w = disturbed(rng, strong * float(z.std()))
    return u, through(z + w, (0.3, 0.2), (0.0, 0.0)) + 0.01 * rng.standard_normal(z.size)


def test_a_strong_disturbance_widens_a_servos_gap_or_withdraws_it() -> None:
    u, y = behind_a_disturbance(0.4)
    found = identify_second_order(u, y)
    assert found.verdict == "play"
    assert holds(found.width, 0.5)
    assert 0.05 < found.width.half_width < 0.15
    u, y = behind_a_disturbance(0.9)
    found = identify_second_order(u, y)
    assert found.verdict == "undecided"
    assert found.width is None
    assert any("hide the gap" in reason for reason in found.numbers()["reasons"])


def test_a_strong_disturbance_withdraws_the_gap_of_a_play_that_is_no_servos() -> None:
    u, y = behind_a_disturbance(0.2, 23)
    found = uz.identify(t=STEP, u=u, y=y, order=2, delay=0, place="sensor")
    assert found.verdict == "play"
    assert found.width is None
    assert found.right is None
    assert any("hide the gap" in remark for remark in found.answer.remarks)
    with pytest.raises(InputError, match="both widths must be known"):
        found.scenario()
    u, y = behind_a_disturbance(0.4)  # its interval holds no gap
    found = uz.identify(t=STEP, u=u, y=y, order=2, delay=0, place="sensor")
    assert found.verdict == "undecided"
    assert any("hide the gap" in reason for reason in found.answer.reasons)


def test_the_position_of_a_motor_shows_the_gap_and_no_centre() -> None:
    rng = np.random.default_rng(3)
    num, den, _ = cont2discrete(([1.0], [0.25, 1.0, 0.0]), 0.02)
    b, set_points = num.ravel(), np.repeat(rng.standard_normal(61), 25)[:1500]
    u, z = np.zeros(1500), np.zeros(1500)
    for k in range(1500):
        if k > 1:
            z[k] = -den[1] * z[k - 1] - den[2] * z[k - 2] + b[1:] @ u[[k - 1, k - 2]]
        u[k] = 3 * set_points[k] - 2 * z[k]
    z = z / z.std()
    y = through(z, (0.3, 0.2), (0.0, 0.0)) + 0.02 * rng.standard_normal(1500)
    found = uz.identify(t=0.02, u=u, y=y, order=2, integrators=1, delay=0)
    assert found.verdict == "play"
    assert found.centre is None
    assert holds(found.width, 0.5)
    assert any("no zero of its own" in remark for remark in found.answer.remarks)
    scenario = found.scenario()
    assert 'kind = "play"' in scenario


SHORT = 400  # samples of that record from which its play is known nearly as well


def record_of_gears() -> tuple[float, Floats, Floats]:
    """A record of gears of half width 0.4: step, u and y."""
    rng = np.random.default_rng(5)
    step, w = 0.02, 2 * math.pi * 0.8
    b, a, _ = cont2discrete(([w * w], [1, 0.8 * w, w * w]), step)
    u = lfilter([1], [1, -math.exp(-step * w * 0.7)], rng.standard_normal(1300))
    z = lfilter(b.ravel(), a, u)
    e = 0.03 * rng.standard_normal(1300)
    return step, u / z.std(), through(z / z.std(), (0.4, 0.4), (0.0, 0.0)) + e


def test_commands_take_the_scenario_of_a_play(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    step, u, y = record_of_gears()
    columns = np.column_stack([step * np.arange(y.size), u, y])
    for name, rows in (("gears.csv", columns), ("short.csv", columns[:SHORT])):
        np.savetxt(name, rows, delimiter=",", header="t [s],u [V],y [mm]", comments="")
    options = ["--order", "2", "--delay", "0", "--out", "out"]
    assert group.main(["identify", "gears.csv", *options], standalone_mode=False) == 0  # it runs
    text = capsys.readouterr().out
    assert re.search("^found +Backlash: ", text, re.MULTILINE)
    assert re.search(r"Backlash: gap 0\.\d.* mm", text)
    assert "undeadzone estimate out/gears.toml gears.csv, undeadzone run out/gears.toml" in text
    assert Path("out/element.svg").exists()
    assert Path("out/report.html").exists()
    scenario = "out/gears.toml"
    sensor = read(Path(scenario)).sensor
    assert sensor.kind == "play"
    assert 0.79 < sensor.right + sensor.left < 0.82
    more = ["--kind", "play", "--no-figures"]
    assert group.main(["identify", "short.csv", *options, *more], standalone_mode=False) == 0
    capsys.readouterr()
    assert not group.main(["run", scenario, "--no-figures"], standalone_mode=False)
    assert not group.main(["check", scenario, "--no-figures"], standalone_mode=False)
    capsys.readouterr()
    assert not group.main(
        ["estimate", scenario, "gears.csv", "--no-figures"], standalone_mode=False
    )
    assert "consistent  yes" in capsys.readouterr().out


def test_a_play_about_an_offset_says_how_to_take_it_away() -> None:
    step, u, y = record_of_gears()
    found = uz.identify(t=step, u=u, y=y + 1.0, order=2, delay=0)
    assert found.verdict == "play"
    assert found.width.low - 0.01 <= 0.8 <= found.width.high + 0.01
    assert found.centre.value == pytest.approx(-1.0, abs=0.02)
    with pytest.raises(InputError, match="--zero"):
        found.scenario()
    u, y = u[:SHORT], y[:SHORT]
    free = uz.identify(t=step, u=u, y=y, order=2, kind="play", offset="free", delay=0)
    assert math.isinf(free.centre.high)
    assert math.isfinite(free.width.high)


@functools.cache
def valve(seed: int, **more: Any) -> tuple[Any, tuple[float, float]]:
    """What is identified of a plant behind an actuator's dead zone, and the true widths."""
    rng, u, _ = driven(seed)
    widths = tuple(rng.uniform(0.2, 0.8, 2))
    passed = dead_zone(u, widths[0], widths[1])
    z = lfilter(np.append(0.0, B), np.append(1.0, A), passed)
    y = z + disturbed(rng, 0.02) + 0.01 * rng.standard_normal(z.size)
    return uz.identify(t=STEP, u=u, y=y, order=2, delay=0, **more), widths


def test_commands_take_the_scenario_of_an_actuator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    found, (right, _left) = valve(31)
    Path("valve.toml").write_text(found.scenario())
    scenario = read(Path("valve.toml"))
    assert scenario.actuator.right == pytest.approx(found.right.value)
    low, high = scenario.model.actuator.right
    assert low < right < high
    assert not group.main(["run", "valve.toml", "--no-figures"], standalone_mode=False)
    assert not group.main(["check", "valve.toml", "--no-figures"], standalone_mode=False)
    capsys.readouterr()


def test_pictures_are_up_to_date() -> None:
    module = script_of_docs("signatures")
    for name, text in module.pictures().items():
        stored = (module.FOLDER / name).read_text(encoding="utf-8")
        words, numbers = (re.sub(NUMBER, "#", one) for one in (stored, text)), []
        assert len(set(words)) == 1, "run: python docs/signatures.py"
        for one in (stored, text):
            numbers.append([float(number) for number in re.findall(NUMBER, one)])
        assert np.abs(np.subtract(*numbers)).max() < 0.2, "run: python docs/signatures.py"


def test_a_plant_that_integrates_is_neither_play_nor_friction() -> None:
    """A zone behind an integrator that was not declared had odds of .9 of both."""
    for seed, order in ((105, 2), (101, 2)):
        rng = np.random.default_rng(seed)
        u = np.repeat(2 * rng.standard_normal(36), 20)[:700]
        u -= u.mean()
        z = 0.05 * np.cumsum(lfilter([0, 0.05], [1, -0.95], u))
        y = dead_zone(z, 0.3, 0.2) + 0.003 * rng.standard_normal(z.size)
        answer = uz.identify(t=0.01, u=u, y=y, order=order)
        assert isinstance(answer, uz.Identified)
        assert answer.verdict == "unclear"
        assert "--integrators 1" in answer.answer.reasons[-1]
        assert answer.numbers()["odds"] == {}  # no model explains the readings
        assert "odds" not in answer.summary()


def test_the_steps_of_an_encoder_are_no_play() -> None:
    """An encoder's steps of 0.03 pass for a play of 0.014 with odds of 0.99."""
    log = make_named_log(8605, "operating point")
    found = identify_log(log)
    assert found.account.grade == "bounded"
