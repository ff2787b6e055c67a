"""Numbers of a scenario from logs: likelihood, addresses, search, intervals, command."""

from __future__ import annotations

import functools
import itertools
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from benchmarks.identify.fit import CASES, Case, colour
from benchmarks.identify.logs.strangers import zone
from scipy.linalg import toeplitz
from scipy.signal import dlsim
from scipy.stats import multivariate_normal

import undeadzone as uz
from commands import undeadzone
from documents import EXAMPLES
from undeadzone.errors import InputError
from undeadzone.scenario.reader import parse, read
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_identify.fitting import search
from undeadzone_identify.fitting.checks import check_scores
from undeadzone_identify.fitting.estimates import prepare_fit, read_logs
from undeadzone_identify.fitting.free import complete_tables
from undeadzone_identify.fitting.joint import put_gears, read_place, write_arm
from undeadzone_identify.fitting.problem import FitProblem, build_model, pack_scenario
from undeadzone_identify.fitting.result import FittedNumber
from undeadzone_identify.fitting.search import climb
from walks import Walk, commands_in

STEP = 0.02
TEXT = """
[plant]
A = [[0.0, 1.0], [-9.0, -1.5]]
B = [[0.0], [9.0]]
C = [[1.0, 0.0]]
[sensor]
right = 0.3
left = 0.2
noise = 0.01
[actuator]
right = 0.1
left = 0.0
[disturbance]
kind = "random"
rms = 0.02
correlation_time = 0.2
[reference]
kind = "sine"
amplitude = 0.0
frequency = 1.0
[observer]
method = "extended"
right = [0.0, 1.0]
[simulation]
time = "sampled"
step = 0.02
"""
FORMULAS = TEXT.replace(
    TEXT[TEXT.index("A =") : TEXT.index("[sensor]")],
    """
states = ["q", "v"]
f = ["v", "-k * q - b * v + g * u"]
h = ["q"]
parameters = { k = 9.0, b = 1.5, g = 9.0 }
""",
)
ARM = """
[plant.arm]
kind = "one_link"
[plant.arm.gears]
half = [0.01]
inertia = [0.02]
contact = 300.0
measured = "motor"
"""
GEARED = TEXT.replace(TEXT[TEXT.index("[plant]") : TEXT.index("[sensor]")], ARM).replace(
    "right = 0.3\nleft = 0.2", "right = 0.0\nleft = 0.0"
)


def make_log(
    seed: int = 1, count: int = 600, right: float = 0.3, left: float = 0.2, start: float = 0.1
) -> dict[str, Floats]:
    """Simulate TEXT."""
    rng = np.random.default_rng(seed)
    scenario = parse(TEXT)
    t = STEP * np.arange(count)
    u = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.11, 0.37, 0.9))
    w = colour(rng, count, STEP, scenario.disturbance)
    matrices = (*build_model(scenario).params, 0.0, STEP)
    z = dlsim(matrices, zone(u, start, 0.0) + w)[1][:, 0]
    return {"t": t, "u": u, "y": zone(z, right, left) + 0.01 * rng.standard_normal(count)}


def pose(text: str, free: dict[str, Any], log: Any = None, x0: Any = "free") -> FitProblem:
    scenario, besides = complete_tables(parse(text), free)
    model = build_model(scenario)
    logs = read_logs(scenario, model, make_log() if log is None else log, None, False)
    return prepare_fit(scenario, model, logs, free | dict.fromkeys(besides), x0, 1)


def encode(problem: FitProblem, value: float) -> Floats:
    return np.where(problem.is_log, np.log(value), value)[None]


def exact_likelihood(text: str, log: dict[str, Floats], spread: Floats) -> float:
    """The joint normal density of all readings, from x(0), a disturbance and noise."""
    A, B, C = build_model(parse(text)).params
    memory = np.exp(-STEP / 0.2)
    F = np.block([[A, B], [np.zeros((1, 2)), np.array([[memory]])]])
    count = len(log["y"])
    rows = np.array([[*C[0], 0.0] @ np.linalg.matrix_power(F, k) for k in range(count)])
    forced, stirred = (
        toeplitz([0.0, *rows[:-1] @ b], np.zeros(count)) for b in ([*B[:, 0], 0.0], [0.0, 0.0, 1.0])
    )
    cov = rows * [*spread**2, 0.02**2] @ rows.T + 0.01**2 * np.eye(count)
    cov += 0.02**2 * (1 - memory**2) * stirred @ stirred.T
    return float(multivariate_normal.logpdf(log["y"], forced @ log["u"], cov))


def test_without_a_zone_the_likelihood_is_that_of_the_kalman_filter() -> None:
    text = TEXT.replace("right = 0.3\nleft = 0.2", "right = 0.0\nleft = 0.0")
    text = text.replace("right = 0.1\nleft = 0.0", "right = 0.0\nleft = 0.0")
    log = make_log(right=0.0, left=0.0, start=0.0)
    problem = pose(text, {"plant.A[1,0]": None}, log)
    assert problem.kind == "plain"
    expected = exact_likelihood(text, log, problem.spread)
    assert problem.evaluate_points(problem.start[None])[0] == pytest.approx(expected, rel=1e-7)


def names_of(problem: FitProblem) -> list[str]:
    like = pack_scenario(problem.scenario, problem.model, problem.zone)
    return tree.number_addresses(like)


@pytest.mark.parametrize(
    ("text", "address", "packed"),
    [
        (TEXT, "plant.A[1,1]", ["plant.A[1,1]"]),
        (TEXT, "sensor.right", ["right[0]"]),
        (TEXT, "actuator.left", ["drive.left[0]"]),
        (TEXT, "disturbance.rms", ["rms[0]"]),
        (TEXT, "disturbance.correlation_time", ["correlation_time[0]"]),
        (TEXT, "sensor.noise", ["after[0]"]),
        (FORMULAS, "plant.k", ["plant[0]"]),
        (GEARED, "plant.arm.gears.half[0]", None),
        (GEARED, "plant.parameters.m", None),
    ],
)
def test_an_address_of_each_class_moves_its_number(
    text: str, address: str, packed: list[str] | None
) -> None:
    problem = pose(text, {address: (0.011, 0.5)}, x0="known")
    _, params = problem.to_lanes(encode(problem, 0.25), (0.0, 0.0), 0)
    found = [names_of(problem)[slot] for slot, _ in problem.bound.slots[0]]
    assert found == packed or (packed is None and found[0].startswith("plant["))
    if text == TEXT and address.startswith("plant"):
        return
    assert params[0, names_of(problem).index(found[0])] == pytest.approx(0.25)


def test_a_plant_is_built_anew_where_an_address_is_no_entry() -> None:
    table = "transfer_function = { numerator = [9.0], denominator = [2.0, 3.0, 18.0] }\n"
    text = TEXT.replace(TEXT[TEXT.index("A =") : TEXT.index("[sensor]")], table)
    problem = pose(text, {"plant.transfer_function.denominator[0]": (1.0, 4.0)})
    assert problem.built == (0,)
    _, params = problem.to_lanes(encode(problem, 1.0), (0.0, 0.0), 0)
    other = build_model(parse(text.replace("[2.0, 3.0", "[1.0, 3.0")))
    assert pytest.approx(other.params.A, abs=1e-12) == params[0, :4].reshape(2, 2).T


def test_the_truth_is_found_and_is_consistent() -> None:
    free = {"plant.A[1,:]": None, "sensor.right": None, "sensor.left": (0.0, 1.0)}
    found = uz.fit(parse(TEXT), [make_log(3), make_log(4)], free, threads=1)
    truth = {"plant.A[1,0]": -9.0, "plant.A[1,1]": -1.5, "sensor.right": 0.3, "sensor.left": 0.2}
    for name, value in truth.items():
        number = found.by_address[name]
        assert number.low < value < number.high
        assert number.value == pytest.approx(value, rel=0.1)
    assert found.consistent
    assert found.scenario.sensor.right == found.by_address["sensor.right"].value


def test_threads_change_no_bit() -> None:
    again = uz.fit(parse(TEXT), make_log(), "sensor.right=0..1", threads=2)
    assert again.numbers == fit_width().numbers


def test_a_wrong_model_is_contradicted() -> None:
    text = TEXT.replace("right = 0.1", "right = 0.6")
    found = uz.fit(parse(text), make_log(), {"sensor.right": (0.0, 1.0)}, threads=1)
    assert not found.consistent
    assert "contradicts" in found.agreement


def test_a_reading_of_one_sign_tests_its_shape_once() -> None:
    """|z| is -z then: odd scores at the start are no shape."""
    u, z, scores = np.random.default_rng(0).normal(0.0, 1.0, (3, 2000, 1))
    scores[1:3] = -7.0
    assert check_scores(u, z - 9.0, scores)["shape"] > 0.01
    assert check_scores(u, z - 9.0, scores + 0.2 * z)["shape"] < 1e-6


def test_silence_alone_bounds_a_width_from_below() -> None:
    log = make_log() | {"y": np.zeros(600)}
    text = TEXT.replace("left = 0.2", "left = 6.0")
    found = uz.fit(parse(text), log, {"sensor.right": (0.0, 6.0)}, threads=1)
    assert "no reading passed the right edge: only d_r > " in found.numbers[0].note
    assert found.numbers[0].low > 0.5
    assert found.numbers[0].high == 6.0


def test_a_number_that_no_reading_shows_is_said() -> None:
    text = FORMULAS.replace("+ g * u", "+ g * s * u").replace("g = 9.0", "g = 3.0, s = 3.0")
    found = uz.fit(parse(text), make_log(), "plant.g,plant.s,sensor.right=0..1", threads=1)
    notes = {each.name: each.note for each in found.numbers}
    assert "the log does not determine it" in notes["plant.parameters.g"]
    assert "only the product with plant.parameters.s is known" in notes["plant.parameters.g"]


def test_a_delay_is_found() -> None:
    log = make_log()
    late = log | {"u": np.roll(log["u"], -2)}
    found = uz.fit(parse(TEXT), late, "sensor.right=0..1,plant.delay=1..2", threads=1)
    assert found.delay == found.scenario.plant.delay == 2


def test_several_kinds_of_silence_of_a_scenario_are_free_by_themselves() -> None:
    text = TEXT.replace("noise = 0.01\n", "")
    text = text[: text.index("[disturbance]")] + text[text.index("[reference]") :]
    found = uz.fit(parse(text), make_log(), "sensor.right=0..1", threads=1)
    assert found.besides == ("disturbance.rms", "sensor.noise")
    assert found.by_address["sensor.noise"].value == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize(
    ("free", "message"),
    [
        ("plant.mas", "is not a number of the scenario"),
        ("plant.A[7,7]", r"There is plant.A\[0,0\]"),
        ("plant.A[0,0]", "is 0 in the scenario"),
        ("sensor.right=1..0", "expected a range lo..hi"),
        ("sensor.right=1", "expected ADDRESS or ADDRESS=lo..hi"),
        ("sensor.right,sensor.right[0]", "is not a number"),
        ("simulation.step", "is not a number of the scenario"),
        ("", "nothing to fit"),
        ("plant.delay=0..5", "name another number"),
    ],
)
def test_errors_name_the_address(free: str, message: str) -> None:
    with pytest.raises(uz.InputError, match=message):
        uz.fit(parse(TEXT), make_log(), free)


def test_too_few_readings_are_refused() -> None:
    with pytest.raises(uz.InputError, match="fewer than 20"):
        uz.fit(parse(TEXT), make_log(count=30), {"plant.A[1,:]": None})


@functools.cache
def fit_width() -> uz.Fitted:
    return uz.fit(parse(TEXT), make_log(), "sensor.right=0..1", threads=1)


def write_log(path: Path, log: dict[str, Floats], head: str = "t,u,y") -> None:
    """Write a log as a file."""
    np.savetxt(path, np.column_stack([*log.values()]), delimiter=",", header=head, comments="")


def test_a_user_follows_what_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walk = Walk(tmp_path)
    write_log(tmp_path / "log.csv", make_log())
    (tmp_path / "mine.toml").write_text(TEXT)
    line = "undeadzone fit mine.toml log.csv --free sensor.right=0..1"
    climbs: Any = itertools.chain(
        [climb] * 15, itertools.repeat(Mock(side_effect=KeyboardInterrupt))
    )
    with monkeypatch.context() as patched:
        patched.setattr(search, "climb", lambda *given: next(climbs)(*given))
        stopped = undeadzone(*line.split()[1:], cwd=tmp_path)
    assert "--resume" in stopped.stderr, stopped
    printed = walk.run(f"{line} --resume")
    found = re.search(r"sensor.right +(\S+)", printed)
    assert found is not None
    assert float(found[1]) == pytest.approx(fit_width().numbers[0].value, rel=1e-5)
    assert uz.read(tmp_path / "mine-fit/fitted.toml").sensor.left == 0.2
    (last,) = commands_in(printed)
    assert re.search(r"consistent +yes", walk.run(last))


@pytest.mark.long("test_the_truth_is_found_and_is_consistent")
def test_a_log_of_a_motor_leads_to_its_gap(tmp_path: Path) -> None:
    case = CASES["servo of MuJoCo, torque and motor encoder"]
    truth = dict(zip(case.free, [0.01, 0.012, 0.05, 0.018, 0.003], strict=True))
    moved = Case(*case[:3], lambda _: truth, (0.3, 0.2, 0.2), (0.7, 1.9, 3.3), 800)
    (log,) = moved.record(np.random.default_rng(0))[1]
    walk = Walk(tmp_path)
    log = {"t": 0.005 * np.arange(800), **log}
    write_log(tmp_path / "motor.csv", log, "t,torque [N m],motor angle [rad]")
    (line,) = commands_in(walk.run("undeadzone identify motor.csv --out out --no-figures", 1))
    hint = walk.run(f"{line} --no-figures --out out")
    (option,) = re.findall("with (--arm .*) these gears", hint)
    option = option.replace("ARM.toml", str(EXAMPLES / "two_link_gears.toml")).replace("NAME", "q2")
    fitted = walk.run(f"{line} --no-figures --out arm {option}")
    assert "does not contradict" in fitted
    found = [float(value) for value in re.findall(r"plant\S+ +(\S+)", fitted)]
    assert found == pytest.approx([*truth.values()][:4], rel=0.05)
    (last,) = commands_in(fitted)
    tips = re.findall(r"tip - tip\^ +(\S+) m .*encoders alone (\S+) m", walk.run(last))
    assert float(tips[0][0]) < 0.1 * float(tips[0][1])


def test_fitted_gears_become_those_of_a_joint(tmp_path: Path) -> None:
    """What the log does not determine stays, as do the other joints."""
    arm = EXAMPLES / "two_link_gears.toml"
    numbers = []
    for name, value, shown in (("half[0]", 0.02, True), ("inertia", 0.05, False), ("m", 3.0, True)):
        where = ("plant.parameters." if name == "m" else "plant.arm.gears.") + name
        numbers.append(FittedNumber(where, value, 0.9 * value, value, 0.0, 1.0, 0.5, shown))
    found: Any = SimpleNamespace(numbers=numbers)
    place = read_place(arm, "q2")
    written = read(write_arm(found, place, tmp_path, False))
    gears = written.plant.arm.gears
    assert np.array_equal(gears.half, [0.05, 0.02])
    assert np.array_equal(gears.inertia, place.arm.plant.arm.gears.inertia)
    assert np.array_equal(written.observer.half, place.arm.observer.half)
    with pytest.raises(InputError, match=r"q3: The arm has q1, q2"):
        read_place(arm, "q3")
    with pytest.raises(InputError, match=r"two_link\.toml: plant\.arm\.gears: missing"):
        read_place(EXAMPLES / "two_link.toml", "q1")
    found.numbers = numbers[1:]
    with pytest.raises(InputError, match="the logs determine no number of plant"):
        put_gears(found, place)
