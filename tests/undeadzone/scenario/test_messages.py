"""Mistakes that people make, each with a message that says what to write instead."""

from __future__ import annotations

import difflib
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

import undeadzone as uz
from commands import undeadzone
from documents import EXAMPLES
from undeadzone.errors import InputError
from undeadzone.scenario.reader import parse, read, read_for_logs

TEMPLATE = files("undeadzone").joinpath("template.toml").read_text(encoding="utf-8")
A, NOISE = "A = [[0.0, 1.0], [-1.0, -2.0]]", "noise = 0.01 "
PARTS: dict[str, Any] = {
    "plant": uz.Plant(A=-1, B=1, C=1),
    "sensor": uz.Sensor(right=1.0, left=1.0),
    "reference": uz.Sine(amplitude=1.0, frequency=1.0),
}


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (A, "A = [0 1; -4 -2]", "write A = [[0, 1], [-4, -2]], or put MATLAB's matrix in quotes"),
        (A, "A = [0 1\n -4 -2]", "rows in brackets, commas between numbers"),
        (A, "A = [0, 1, -4, -2]", "plant.A: expected a matrix (a list of rows)"),
        (A, f"{A}\nD = [[1.0]]", "plant.D: unknown key"),
        (A, f"{A}\nD = [[0.0]]", "Direct feedthrough is not supported"),
        (A, "num = [1]", "Write numerator"),
        ("step = 0.01 ", "dt = 0.01 ", "The sample time is simulation.step"),
        ("step = 0.01 ", "Ts = 0.01 ", "The sample time is simulation.step"),
        ("step = 0.01 ", "fs = 100 ", "simulation.step = 1 / fs"),
        ("step = 0.01 ", "step = 10 ", "10 s is too coarse for reference"),
        ('time = "sampled"', 'time = "discrete"', "Write sampled"),
        ("right = 1.0 ", "upper = 1.0 ", "sensor.right"),
        ("right = 1.0 ", "d_r = 1.0 ", "Write right"),
        ("left = 0.6 ", "left = -1.0 ", "It is a width, from 0 to the edge on that side"),
        ('method = "auto"', 'method = "UKF"', "Did you mean 'ukf'?"),
        ('method = "state_feedback"', 'method = "PID"', "Did you mean 'pid'?"),
        ("# alpha = 10.0 ", "Kp = 10.0 ", "unknown key"),
        (NOISE, "noise = 0,01 ", "write a decimal point, 0.01"),
        (NOISE, "noise = .01 ", "write a digit on both sides of the point"),
        (NOISE, "noise = 1/100 ", "write the number itself"),
        (NOISE, "noise = 0.01; ", "leave the ; out"),
        (NOISE, "noise: 0.01 ", "write = in place of :"),
        (NOISE, "noise = None ", "leave the key out"),
        (NOISE, "noise = 5 mm ", "write the number alone"),
        ("# A scenario", "% A scenario", "remarks begin with #"),
        ('title = "My plant"', "title = “My plant”", "write straight quotes"),
        ('method = "auto"', "method = auto", "put words in quotes"),
        ("[plant]", "[Plant]", "Did you mean 'plant'?"),
        ("[observer]", "[filter]", "The table of the observer is [observer]"),
        ("[reference]", "[setpoint]", "The table of the wanted output is [reference]"),
        ('method = "auto"', 'method = "UnscentedKalman"', "Did you mean 'ukf'?"),
        ('method = "auto"', 'method = "extended_kalman_filter"', "Did you mean 'ekf'?"),
        ('method = "auto"', 'method = "kf"', "Did you mean 'kalman'?"),
    ],
)
def test_a_mistake_in_a_scenario_names_its_cure(old: str, new: str, expected: str) -> None:
    assert old in TEMPLATE
    with pytest.raises(InputError, match=re.escape(expected)) as caught:
        uz.simulate(parse(TEMPLATE.replace(old, new, 1)))
    assert "\n" not in str(caught.value)


def test_an_unknown_table_gets_no_wild_guess() -> None:
    with pytest.raises(InputError, match=r"noise: unknown key\. Known keys: actuator, behind_play"):
        parse(f"{TEMPLATE}\n[noise]\nrms = 1.0\n")


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("log.csv", "t,u,y\n0,1,2\n", "A log goes to undeadzone identify"),
        ("a.py", "import undeadzone\n", "Run a program with python"),
        ("a.urdf", "<robot/>\n", "undeadzone arm shows a robot"),
        ("a.json", "{}\n", "A scenario is a TOML file"),
        ("a.toml", "title = 'Kühler'".encode("latin-1"), "Save it as UTF-8"),
        ("b.toml", TEMPLATE.encode("utf-16"), "Save it as UTF-8"),
    ],
)
def test_the_message_on_another_file_names_the_remedy(
    tmp_path: Path, name: str, content: str | bytes, expected: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    for reader in (read, read_for_logs):
        with pytest.raises(InputError, match=re.escape(expected)) as caught:
            reader(path)
        assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    "content",
    [
        TEMPLATE.encode("utf-8-sig"),
        TEMPLATE.replace("\n", "\r\n").encode(),
        TEMPLATE.replace(" = ", "\t=\t").encode(),
        TEMPLATE.replace(A, 'A = "[0 1; -1 -2]"').encode(),
    ],
    ids=["BOM", "CRLF", "tabs", "MATLAB"],
)
def test_what_editors_do_changes_nothing(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    assert str(read(path)) == str(parse(TEMPLATE))


IN_WORDS = {  # whose cure is a choice
    "fly away",
    "identify mine.toml",
    "export mine.toml --to rust",
    "fit mine.toml log.csv --free width",
    "arm log.csv",
}


def follow_cure(words: list[str], message: str) -> list[str] | None:
    """The call that a message proposes: a command, a name in place of a like one, an option."""
    if found := re.search(r"undeadzone ((?:run|estimate) .*)", message):
        return found[1].split()
    if found := re.search(r"Did you mean '(.+?)'", message):
        (wrong,) = difflib.get_close_matches(found[1], words, 1, 0.0)
        return [found[1] if word == wrong else word for word in words]
    if found := re.search(r"Leave (--\w+) out", message):
        return [word for word in words if word != found[1]]
    if found := re.search(r"(?:Use|Give) (--\w+)", message):
        return [*words, found[1], "0.02"]
    return None


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("mine.toml", "To run this scenario: undeadzone run mine.toml"),
        ("simulate mine.toml", "Did you mean 'run'?"),
        ("indentify log.csv --order 1", "Did you mean 'identify'?"),
        ("arenas --help", "No such command 'arenas'. Did you mean 'arena'?"),
        ("run mine", "mine: cannot read: No such file or directory. Did you mean 'mine.toml'?"),
        ("estimate log.csv mine.toml", "undeadzone estimate mine.toml log.csv"),
        ("init --example pendulm", "Did you mean 'pendulum'?"),
        ("design mine.toml --marginn 0.1", "Did you mean '--margin'?"),
        ("identify log.csv half.csv --order 2", "Use --resample STEP"),
        ("identify log.csv --kind jump --order 1", "Give --threshold, "),
        ("identify log.csv --resume --out done --order 1", "Leave --resume out"),
        ("fly away", "No such command 'fly'."),
        ("identify mine.toml", "this is a scenario, no log"),
        ("export mine.toml --to rust", "Expected one of c, arduino, fmu2"),
        ("fit mine.toml log.csv --free width", "The widths are sensor.right and sensor.left"),
        ("arm log.csv", "A robot is a URDF file"),
    ],
)
def test_a_mistake_on_the_command_line_names_a_cure_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(TEMPLATE)
    rows = (EXAMPLES / "samples.csv").read_text().splitlines(keepends=True)
    (tmp_path / "log.csv").write_text("".join(rows))
    (tmp_path / "half.csv").write_text("".join(rows[:1] + rows[1::2]))
    if "done" in words:
        undeadzone("identify", "log.csv", "--out", "done", "--order", "1")
    wrong = undeadzone(*words.split())
    assert wrong.returncode == 2
    assert expected in wrong.stderr
    cured = follow_cure(words.split(), wrong.stderr)
    if cured is not None:
        assert undeadzone(*cured).returncode <= 1
    assert (cured is None) == (words in IN_WORDS)


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("Sensor", {"width": 1.0}, "Sensor: .* 'width'. The widths are sensor.right and"),
        ("Sensor", {"rigth": 1.0, "left": 1.0}, "Did you mean 'right'?"),
        ("Simulation", {"dt": 0.01}, "The sample time is simulation.step"),
        ("PID", {"Kp": 1.0}, "Did you mean 'k_p'?"),
        ("Sine", {"amp": 1.0}, "Options: amplitude, frequency, offset, phase"),
        ("UnscentedKalman", {}, "Did you mean 'UKF'?"),
        ("load", {}, "uz.read reads a scenario"),
    ],
)
def test_a_mistake_in_a_program_names_its_cure(
    name: str, options: dict[str, Any], expected: str
) -> None:
    with pytest.raises((TypeError, AttributeError), match=expected.replace("?", "[?]")):
        getattr(uz, name)(**options)
    with pytest.raises(TypeError, match=r"Write names, Sensor\(right="):
        uz.Sensor(1.0)  # type: ignore[misc]


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ({"plant": 5}, "plant: expected uz.Plant"),
        ({"sensor": 1.0}, "sensor: expected uz.Sensor"),
        ({"reference": 5.0}, "reference: expected a signal such as uz.Sine"),
        ({"observer": "kalman"}, "observer: expected options such as uz.Auto"),
        ({"controller": "pid"}, "controller: expected options"),
        (
            {"observer": uz.Auto},
            "expected options such as uz.Auto(right=[0.0, 2.0]), found the class",
        ),
        ({"observer": uz.PD()}, "observer: expected options such as uz.Auto"),
        ({"controller": uz.Certified()}, "controller: expected options"),
        ({"model": PARTS["plant"]}, "model: expected uz.Model(...), found Plant"),
        ({"disturbance": 0.5}, "disturbance: expected uz.Sine(...), found float"),
        ({"actuator": {}}, "actuator: expected uz.Actuator(...), found dict"),
        ({"compensator": "inverse"}, "compensator: expected options such as uz.Smooth"),
        ({"compare": uz.Kalman}, "compare: expected options such as uz.Auto"),
        ({"units": "mm"}, "units: expected uz.Units(...), found str"),
        ({"simulation": 10.0}, "simulation: expected uz.Simulation(...), found float"),
        ({"sensor": uz.Sensor(right="1", left=1.0)}, "sensor.right: expected numbers"),
    ],
)
def test_a_part_of_the_wrong_kind_is_named(parts: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=re.escape(expected)):
        uz.Scenario(**(PARTS | parts))


@pytest.mark.parametrize("tracked", [0, "0", [1], [0, 0], [], ["0"], None])
def test_tracked_outputs_are_numbers_of_outputs(tracked: Any) -> None:
    scenario = uz.Scenario(**PARTS, tracked=tracked, simulation=uz.Simulation(duration=0.01))
    if tracked is None:
        assert uz.simulate(scenario).info.tracked == [0]
        return
    with pytest.raises(InputError, match="tracked: expected different output numbers from 0 to 0"):
        uz.simulate(scenario)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"seed": -1}, "seed: expected a whole number from 0 to 2^63 - 2, found -1"),
        ({"seed": 1.5}, "seed: expected a whole number"),
        ({"seed": None}, "seed: expected a whole number"),
        ({"margin": "0.1"}, "margin: expected numbers"),
        (
            {"maximise": "fast"},
            "maximise: expected 'knee', 'rate' or uz.Weights(...), found 'fast'",
        ),
        ({"maximise": (1.0, 0.0, 0.0)}, "maximise: expected"),
        ({"maximise": uz.Weights(noise=-1.0)}, "maximise.noise: must be at least 0"),
    ],
)
def test_an_option_of_design_is_refused_by_its_name(options: dict[str, Any], expected: str) -> None:
    scenario = uz.Scenario(**PARTS, controller=uz.StateFeedback())
    with pytest.raises(InputError, match=re.escape(expected)):
        uz.design(scenario, **options)


@pytest.mark.parametrize("name", [None, 3, ["a.toml"]])
@pytest.mark.parametrize(
    "take",
    [
        uz.read,
        uz.Run.load,
        uz.Estimation.load,
        uz.Ensemble.load,
        uz.Design.load,
        uz.Scenario(**PARTS).save,
        lambda name: uz.run_ensemble(uz.Scenario(**PARTS, ensemble=uz.Vary()), [name]),
    ],
)
def test_what_is_no_name_of_a_file_is_refused(take: Any, name: Any) -> None:
    with pytest.raises(uz.FileError):
        take(name)


def test_only_scenarios_are_simulated() -> None:
    for wrong in ("mine.toml", {"plant": 1}, None):
        with pytest.raises(InputError, match=re.escape('uz.read("mine.toml")')):
            uz.simulate(wrong)  # type: ignore[arg-type]


def test_a_sample_of_another_size_is_refused() -> None:
    online = uz.Online(uz.Auto(right=[0.0, 1.0]), PARTS["plant"], PARTS["sensor"], step=0.01)
    for y, u in (([1.0, 2.0], 1.0), (1.0, [1.0, 2.0]), ("far", 1.0)):
        with pytest.raises(InputError, match="expected y and u with 1 and 1 numbers"):
            online.update(y=y, u=u)
    assert online.samples == 0


@pytest.mark.parametrize("observer", [uz.Auto, None, "auto", uz.PD()])
def test_live_use_takes_the_options_of_an_observer(observer: Any) -> None:
    with pytest.raises(InputError, match=r"observer: expected options such as uz\.Auto"):
        uz.Online(observer, PARTS["plant"], PARTS["sensor"], step=0.01)


@pytest.mark.parametrize("state", [[], [1.0], None, "far", 1.0])
def test_a_state_of_another_size_is_refused_and_changes_nothing(state: Any) -> None:
    online = uz.Online(uz.Certified(), PARTS["plant"], PARTS["sensor"], step=0.01)
    online.update(2.0, 1.0)
    before = online.state
    with pytest.raises(uz.ShapeError, match=f"state: expected the {before.size} numbers"):
        online.state = state
    assert (online.state == before).all()
    online.state = list(before)
    assert (online.state == before).all()


def test_check_says_that_widths_without_gain_keep_their_error() -> None:
    """Rate and bounds are of x^ alone then; the oracle has no error to keep."""
    reasons_of = {}
    for name, observer in {
        "still": uz.Certified(gamma=0.0),
        "adapting": uz.Certified(gamma=1.0),
        "true": uz.Certified(gamma=0.0, widths0=[1.0, 1.0]),
        "oracle": uz.Oracle(),
    }.items():
        check = uz.check(uz.Scenario(**PARTS, observer=observer))
        reasons_of[name] = [reason for reason in check.reasons if reason.startswith("gamma = 0")]
        assert all(reason in str(check) for reason in reasons_of[name])
    assert [name for name, reasons in reasons_of.items() if reasons] == ["still"]


def test_a_range_that_excludes_the_truth_is_reported() -> None:
    """The output was 0.5 and an interval that excludes 1.0: plausible, and wrong."""
    text = TEMPLATE.replace("right = [0.0, 2.0]", "right = [0.0, 0.5]\nleft = [0.2, 3.0]")
    run = uz.simulate(parse(text) | {"simulation": {"duration": 3.0}})
    assert not run.fully_identifiable
    (verdict,) = run.info.identifiable
    assert not verdict["right"]
    assert verdict["left"]
    assert verdict["reasons"] == [
        "a false assumption: the right width is 1, observer.right says 0 to 0.5"
    ]
    assert uz.simulate(parse(TEMPLATE)).fully_identifiable


def test_an_actuator_range_that_excludes_the_truth_is_reported() -> None:
    """The output was 1.0 and an interval that excludes 1.2: plausible, and wrong."""
    path = EXAMPLES / "valve_both_ends.toml"
    valve = parse(path.read_text()) | {"simulation": {"duration": 3.0}}
    assert valve.actuator.right == 1.2
    message, short = (
        "a false assumption: model.actuator excludes",
        {"simulation": {"duration": 3.0}},
    )
    for width, is_false in (([0.0, 1.0], True), (1.0, True), ([0.0, 3.0], False), (1.2, False)):
        left = 0.8 if isinstance(width, float) else [0.0, 3.0]
        assumptions = {"model": {"actuator": {"right": width, "left": left}}}
        (verdict,) = uz.simulate(valve | assumptions | short).info.identifiable
        assert any(reason.startswith(message) for reason in verdict["reasons"]) == is_false
        assert not (is_false and verdict["right"])
