"""From a log to a scenario, for every sensor and plant that `identify` says it takes."""

from __future__ import annotations

import itertools
import json
import math
import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import undeadzone as uz
from commands import undeadzone
from further import further
from records import dead_zone, holds, write_log
from requirements import needs
from undeadzone.errors import InputError
from undeadzone.scenario.reader import parse
from undeadzone.util.arrays import Floats
from undeadzone_export import exporting
from undeadzone_identify.command import _next_commands
from undeadzone_identify.models.estimates import raise_eigenvalues
from undeadzone_identify.models.plant import polynomial_roots, stabilise_poles
from undeadzone_identify.results.to_scenario import _point_fields, scenario_text

STEP = 0.01
RIGHT, LEFT = 0.3, 0.2  # of the zone, of the play, of the actuator's zone
WORDS = {"zone": "dead_zone", "play": "play", "both": "both", "actuator": "input_zone"}
WORDS |= {"ends": "two_zones"}  # of actuator and sensor
# Behind noise each is in test_pipeline.py or test_alternatives.py, and in firmware below.
# Exact, a zone's stands for the actuator's, a play's for that with a zone; see also MOTORS.
STABLE = [("zone", "encoder"), ("both", "encoder"), ("ends", "exact"),
          *further(*itertools.product(["play", "actuator", "ends"], ["encoder"])),
          *further(*itertools.product(["zone", "play"], ["exact"]))]  # fmt: skip
# Every element and every step; a play of the middle one is in the test of its noise, and what
# rounding does is the same for those that have no zone of the sensor.
ROUNDED = [("zone", 0.005), ("ends", 0.016),
           *further(*itertools.product(["zone"], [0.001, 0.016]), ("play", 0.001), ("both", 0.005),
                    ("actuator", 0.016), ("ends", 0.001))]  # fmt: skip
MOTORS = [("zone", "noise"),
          *further(("play", "noise"), ("zone", "encoder"), ("zone", "exact"), ("both", "encoder"),
                   ("actuator", "exact"))]  # fmt: skip


def record(element: str, reading: str, integrates: bool, order: int = 2) -> tuple[Floats, Floats]:
    """u and y of a plant of order 1 or 2 with an element, read in one of three ways."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(60), 15)
    acting = zone(u) if element in ("actuator", "ends") else u
    acting = play(u) if element == "play ahead" else acting
    x, z = np.zeros(2), []
    spring = 0.0 if integrates else 20.0
    for force in acting:
        z.append(x[0])
        for _ in range(10):
            v = x[1] if order == 2 else 5 * (force - x[0])
            x = x + STEP / 10 * np.array([v, 20 * force - spring * x[0] - 4 * x[1]])
    y = np.array(z)
    if element in ("play", "both"):
        y = play(y)
    if element in ("zone", "both", "ends"):
        y = zone(y)
    if reading == "noise":
        y = y + 0.005 * rng.standard_normal(y.size)
    if element == "jump":
        y = np.where(zone(y) != 0, y, 0.0)
    return u, 0.01 * np.round(y / 0.01) if reading == "encoder" else y


def zone(z: Floats) -> Floats:
    """What a dead zone leaves."""
    return dead_zone(z, RIGHT, LEFT)


def play(z: Floats) -> Floats:
    """What a play leaves."""
    level, out = 0.0, []
    for value in z:
        level = min(max(level, value - RIGHT), value + LEFT)
        out.append(level)
    return np.array(out)


def read_back(answer: Any) -> str:
    """The answer's scenario, read again; or why there is none."""
    try:
        text = answer.scenario()
    except uz.InputError as error:
        return str(error)
    parse(text)
    return ""


@pytest.mark.parametrize(("element", "reading"), STABLE)
def test_a_log_of_a_stable_plant_ends_in_a_scenario(element: str, reading: str) -> None:
    u, y = record(element, reading, integrates=False)
    answer = uz.identify(t=STEP, u=u, y=y, order=2, delay=0)
    assert answer.verdict == WORDS[element]
    assert answer.width.low - 0.005 <= RIGHT + LEFT <= answer.width.high + 0.005
    assert not read_back(answer)
    followed = uz.estimate(parse(answer.scenario()), u=u, y=y)
    assert not followed.info.remarks
    assert followed.consistent, followed.info.reasons
    numbers = followed.summary()
    for side, width in (("right", RIGHT), ("left", LEFT)):
        letters = {"actuator": "b", "ends": "bd", "both": ""}.get(element, "d")
        for letter in letters:
            std = max(numbers[f"{letter}_{side}_std"], 0.002)  # half a step of the encoder
            assert abs(numbers[f"{letter}_{side}"] - width) < 3 * std


@pytest.mark.parametrize("element", ["ends", *further("zone", "actuator")])
def test_the_filter_knows_where_readings_end(element: str) -> None:
    u, y = record(element, "noise", integrates=False)
    low, high = np.quantile(y, [0.08, 0.9])
    y = np.clip(y, low, high)
    answer = uz.identify(t=STEP, u=u, y=y, order=2, delay=0)
    assert answer.verdict == WORDS[element]
    assert f"range = [{low:.9g}, {high:.9g}]" in answer.scenario()
    followed = uz.estimate(parse(answer.scenario()), u=u, y=y)
    assert not followed.info.remarks
    assert followed.consistent, followed.info.reasons
    numbers = followed.summary()
    for letter in {"zone": "d", "actuator": "b", "ends": "bd"}[element]:
        for side, width in (("right", RIGHT), ("left", LEFT)):
            error = numbers[f"{letter}_{side}"] - width
            assert abs(error) < 3 * numbers[f"{letter}_{side}_std"]


@pytest.mark.parametrize(("element", "step"), ROUNDED)
def test_a_noisy_log_that_a_converter_rounds_ends_in_a_scenario(element: str, step: float) -> None:
    """Noise of 5, 1 and .3 steps: a zero is no silence, and a tick that is taken back no motion."""
    u, y = record(element, "noise", integrates=False)
    y = step * np.round(y / step)
    answer = uz.identify(t=STEP, u=u, y=y, order=2, delay=0)
    assert answer.verdict == WORDS[element]
    assert holds(answer.width, RIGHT + LEFT)
    assert answer.width.half_width < 0.02
    scenario = parse(answer.scenario())
    assert scenario.sensor.quantum == pytest.approx(step)
    if (
        step < 0.016 or element == "zone"
    ):  # else the noise that is told is too small, and it says so
        assert uz.estimate(scenario, u=u, y=y).consistent


def test_a_quantum_that_noise_hides_is_none() -> None:
    """Else no sensor whose log was rounded for printing would ever be found stuck."""
    u, y = record("zone", "noise", integrates=False, order=1)
    answer = uz.identify(t=STEP, u=u, y=y, order=1, delay=0).answer
    noise = parse(scenario_text([answer], "told")).sensor.noise
    for quantum, expected in ((0.01 * noise, 0.0), (noise, noise)):
        grid = answer.case.grid
        grid = grid._replace(y=quantum * np.round(grid.y / quantum))
        rounded = answer._replace(case=answer.case._replace(grid=grid))
        sensor = parse(scenario_text([rounded], "told")).sensor
        assert sensor.quantum == pytest.approx(expected)
        assert math.hypot(sensor.noise, expected / math.sqrt(12)) == pytest.approx(noise)


@pytest.mark.long("test_a_quantum_that_noise_hides_is_none")
def test_rounding_is_subtracted_from_the_noise_of_a_play_once() -> None:
    u, y = record("play", "noise", integrates=False)
    answer = uz.identify(t=STEP, u=u, y=0.005 * np.round(y / 0.005), order=2, delay=0)
    sensor = parse(answer.scenario()).sensor
    element = answer.answer.element
    assert element is not None
    assert (sensor.quantum, element.noise > 0) == (pytest.approx(0.005), True)
    assert sensor.noise == pytest.approx(element.noise * answer.answer.scale)


@pytest.mark.parametrize(("element", "reading"), MOTORS)
def test_a_log_of_a_motor_ends_in_a_scenario_or_in_words(element: str, reading: str) -> None:
    u, y = record(element, reading, integrates=True)
    answer = uz.identify(t=STEP, u=u, y=y, order="1-2", integrators=1, delay=0)
    if element == "zone":
        assert answer.verdict == "dead_zone"
        assert answer.width.low - 0.005 <= RIGHT + LEFT <= answer.width.high + 0.005
    words = read_back(answer)
    assert not words or words.startswith(("scenario: ", "plant: "))


def test_an_integrator_alone_is_given_the_pace_of_its_log() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(100), 10)
    y = play(STEP * np.cumsum(8 * u)) + 0.005 * rng.standard_normal(u.size)
    answer = uz.identify(t=STEP, u=u, y=y, order=1, integrators=1)
    assert not read_back(answer)


def test_what_is_not_finite_is_refused_before_its_eigenvalues() -> None:
    with pytest.raises(uz.InputError, match="lower --order"):
        raise_eigenvalues(np.array([[1.0, np.nan], [np.nan, 1.0]]))
    wild = np.array([np.nan, 1.0])
    assert np.isinf(polynomial_roots(wild)).all()
    assert not stabilise_poles(wild).any()


def test_the_next_command_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names with blanks are quoted, a log has its columns again."""
    monkeypatch.chdir(tmp_path)
    done = undeadzone("init", "my plant.toml")
    assert shlex.split(done.stdout.split("next: ")[1]) == ["undeadzone", "run", "my plant.toml"]
    options: dict[str, Any] = {"zero": 0.0, "resample": None, "columns": "y=a b,u=c"}
    scenario, log = Path("my log.toml"), Path("my log.csv")
    estimate, run, export_ = _next_commands(scenario, (log,), options, True).split(", ")
    assert shlex.split(estimate)[1:] == [
        "estimate",
        *map(str, (scenario, log)),
        "--columns",
        "y=a b,u=c",
    ]
    assert (run, export_) == ("undeadzone run 'my log.toml'", "or undeadzone export 'my log.toml'")
    assert "estimate" in _next_commands(scenario, (log,), options | {"zero": 1.0}, True)
    assert "estimate" not in _next_commands(scenario, (log, log), options, True)
    estimate, watch = _next_commands(scenario, (log,), options, False).split(", ")  # no reference
    assert shlex.split(watch)[:3] == ["undeadzone", "watch", "my log.toml"]


@needs("compiler", "gcc")
@pytest.mark.parametrize(
    "element", ["zone", *further("play ahead", "play", "actuator", "ends", "jump")]
)
def test_a_log_ends_in_firmware(
    element: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a user goes: each command is the one that the last one named."""
    monkeypatch.setattr(exporting, "STEPS", 2000)  # of float beside double: less is refused later
    u, y = record(element, "noise", False, order=1)
    path = tmp_path / "log.csv"
    write_log(path, "t [s],u [V],y [mm]", STEP, u, y)
    found = undeadzone("identify", "log.csv", "--order", "1", "--no-figures", cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    *_, last = found.stdout.splitlines()
    assert last.split(maxsplit=1)[0] == "next"
    for command in ("estimate log.toml log.csv", "run log.toml", "export log.toml"):
        assert f"undeadzone {command}" in last
    estimated = undeadzone("estimate", "log.toml", "log.csv", "--no-figures", cwd=tmp_path)
    assert estimated.returncode in (0, 1), estimated.stderr
    ran = undeadzone("run", "log.toml", "--no-figures", cwd=tmp_path)
    assert ran.returncode in (0, 1), ran.stderr
    done = undeadzone("export", "log.toml", "--out", "fw", "--check", cwd=tmp_path)
    if element in ("zone", "jump"):  # too narrow ranges for float
        assert "observer, double" in done.stdout
    assert done.returncode == 0, done.stdout + done.stderr
    assert "every bit agrees" in done.stdout


@needs("compiler", "gcc")
def test_one_command_leads_from_a_log_to_firmware_that_has_followed_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "STEPS", 2000)
    u, y = record("zone", "noise", False, order=1)
    path = tmp_path / "log.csv"
    write_log(path, "t [s],u [V],y [mm]", STEP, u, y)
    done = undeadzone(
        "identify",
        "log.csv",
        "--order",
        "1",
        "--no-figures",
        "--chain",
        "fw",
        "--json",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    chain = json.loads(done.stdout)["chain"]
    assert (chain["identifiable"], chain["consistent"]) == ([True], True)
    assert (chain["precision"], chain["refusals"]) == ("double", [])  # its ranges are too narrow
    assert "every bit agrees" in chain["self_test"]
    z = np.array(lag(u))
    assert chain["hidden"] == pytest.approx(np.sqrt(np.mean((y - z) ** 2)), rel=0.05)
    assert chain["left"] < 0.2 * chain["hidden"]
    assert (tmp_path / "fw" / "firmware" / "Makefile").exists()
    assert (tmp_path / "fw" / "estimate.npz").exists()
    refused = undeadzone("identify", "log.csv", "--chain", "log.csv", cwd=tmp_path)
    assert refused.returncode == 2
    assert "log.csv: cannot write" in refused.stderr  # before anything is computed
    refused = undeadzone("identify", "log.csv", "log.csv", "--chain", "other", cwd=tmp_path)
    assert refused.returncode == 2
    assert "--chain follows one log" in refused.stderr
    assert not (tmp_path / "other").exists()


def test_the_next_record_narrows_the_widest_interval_as_predicted(tmp_path: Path) -> None:
    draw = np.random.default_rng(3)

    def write(name: str, u: Floats) -> None:
        y = zone(np.array(lag(u))) + 0.02 * draw.standard_normal(u.size)
        write_log(tmp_path / name, "t,u,y", STEP, u, y)

    u = np.repeat(draw.standard_normal(20), 15)
    write("first.csv", u)
    words = ("identify", "first.csv", "--order", "1", "--delay", "0", "--next", "next.csv")
    done = undeadzone(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    forecast = re.search(r"record next .*; (\w+): (\d+) % of its interval", done.stdout)
    assert forecast is not None
    page = (tmp_path / "first-identify" / "report.html").read_text(encoding="utf-8")
    assert "What to record next" in page
    table = np.loadtxt(tmp_path / "next.csv", delimiter=",", skiprows=1)
    assert table[-1, 0] == pytest.approx(30.0 - STEP)
    assert np.abs(table[:, 1]).max() <= np.abs(u).max()
    assert np.abs(np.diff(table[:, 1])).max() <= np.abs(np.diff(u)).max() + 1e-6
    refused = undeadzone(*words, cwd=tmp_path)
    assert refused.returncode == 2
    assert "next.csv: exists already" in refused.stderr
    write("second.csv", table[:, 1])
    logs = [str(tmp_path / name) for name in ("first.csv", "second.csv")]
    before, after = (uz.identify(one, order=1, delay=0) for one in (logs[0], logs))
    narrowed = getattr(after, forecast[1]).half_width / getattr(before, forecast[1]).half_width
    assert 0.5 < narrowed / (float(forecast[2]) / 100) < 2


def test_a_play_with_few_turns_is_undecided_and_the_next_log_decides() -> None:
    """It was called friction, with odds of 98 %."""
    u, y = record("play", "exact", integrates=True)
    found = uz.identify(t=STEP, u=u, y=y, order=2, delay=0)
    assert found.verdict == "undecided"
    assert any("the readings turn 4 times" in reason for reason in found.answer.reasons)
    assert found.width is None
    following = found.next_log()
    assert following.what == "right"
    x, z = np.zeros(2), []
    for force in following.u[:, 0]:
        z.append(x[0])
        for _ in range(10):
            x = x + STEP / 10 * np.array([x[1], 20 * force - 4 * x[1]])
    decided = uz.identify(t=STEP, u=following.u, y=play(np.array(z)))
    assert decided.verdict == "play"
    assert decided.width.low - 1e-4 <= RIGHT + LEFT <= decided.width.high + 1e-4


def test_nothing_is_recorded_next_where_nothing_is_gained() -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(60), 15)
    y = np.array(lag(u)) + 0.02 * rng.standard_normal(u.size)
    with pytest.raises(uz.InputError, match="of the grade named there is no interval to narrow"):
        uz.identify(t=STEP, u=u, y=y, order=1, delay=0).next_log()


def lag(u: Floats) -> list[float]:
    """z of `record` of order 1, without a zone."""
    x, z = 0.0, []
    for force in u:
        z.append(x)
        for _ in range(10):
            x += STEP / 10 * 5 * (force - x)
    return z


def answer_at_rest(point: tuple[float, float] | None) -> Any:
    """An answer about an operating point; None: about 0."""
    return SimpleNamespace(
        at_rest=point, case=SimpleNamespace(grid=SimpleNamespace(u=np.zeros((9, 2))))
    )


def test_outputs_share_the_input_of_their_operating_point() -> None:
    both = [answer_at_rest((45.0, 310.0)), answer_at_rest((45.0, -2.0))]
    fields = _point_fields(both)
    assert fields == {"rest_input": "[45.0, 0.0]", "rest_output": "[310.0, -2.0]"}
    one = [answer_at_rest(None), answer_at_rest((0.0, 3.0))]
    assert _point_fields(one)["rest_output"] == "[0.0, 3.0]"
    assert _point_fields(one[:1]) == {"rest_output": ""}
    with pytest.raises(InputError, match="under an input of 45, another under 0"):
        _point_fields([*both, one[0]])
