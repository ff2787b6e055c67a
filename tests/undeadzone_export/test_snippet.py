"""The few lines that compensate a zone or a gap: alike in C and Python, and right on an axis."""

from __future__ import annotations

import ctypes
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from documents import EXAMPLES
from requirements import needs
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone_export.snippet import Lost, load_lines, lost_of_answer, snippet_texts

LENGTH = 20  # lines of a snippet


EXAMPLE = EXAMPLES / "motor_position.toml"


def run_export(source: Path, out: Path, *more: str) -> str:
    """Return what `undeadzone export SOURCE --to snippet` prints. Raises what it is refused by."""
    words = ["export", str(source), "--to", "snippet", "--out", str(out), *more]
    done = CliRunner().invoke(group, words, standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.output


def around(value: float) -> tuple[float, float, float]:
    """Return a width with an interval of 2 % around it."""
    return value, 0.98 * value, 1.02 * value


def lost_at_random(kind: str, rng: np.random.Generator) -> Lost:
    """Return a zone or a gap of any size between 0.001 and 1000."""
    right, left = (float(width) for width in 10 ** rng.uniform(-3, 3) * rng.uniform(0.2, 1, 2))
    width, noise = around(right + left), 0.1 * left * float(rng.integers(0, 2))
    rest = float(rng.integers(-1, 2)) * right
    given = (around(right), around(left), width, "mm", "axis.csv", 0.01 * right)
    return Lost(kind, *given, rest=rest, noise=noise)


def play(command: np.ndarray, gap: float) -> np.ndarray:
    """Return what an axis with a gap does, from its start at the low flank."""
    at, out = 0.0, []
    for u in command:
        at = max(u - gap, min(at, u))
        out.append(at)
    return np.array(out)


@needs("compiler", "gcc")
@pytest.mark.parametrize("kind", ["sensor", "actuator", "backlash"])
def test_c_and_python_say_the_same_of_50_zones(kind: str, tmp_path: Path) -> None:
    """Within 1e-6 of the largest value, and no text is longer than 20 lines."""
    rng = np.random.default_rng(7)
    cases = [lost_at_random(kind, rng) for _ in range(50)]
    texts = [snippet_texts(lost, f"f{k}") for k, lost in enumerate(cases)]
    assert all(text.count("\n") <= LENGTH for each in texts for text in each.values())
    shared = "".join(
        f"{each['snippet.h']}float call{k}(float x) {{ return f{k}(x); }}\n"
        for k, each in enumerate(texts)
    )
    source, library = tmp_path / "all.c", tmp_path / "all.so"
    source.write_text(shared)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, source, "-o", library], check=True)
    loaded = ctypes.CDLL(str(library))
    for k, (lost, each) in enumerate(zip(cases, texts, strict=True)):
        call = getattr(loaded, f"call{k}")
        call.restype, call.argtypes = ctypes.c_float, [ctypes.c_float]
        scope: dict = {}
        exec(each["snippet.py"], scope)
        python = scope[f"f{k}"]
        given = (3 * lost.width[0] * rng.standard_normal(300)).astype(np.float32)
        given[::7] = 0.0
        in_c = np.array([call(float(x)) for x in given])
        in_python = np.array([python(float(x)) for x in given])
        assert np.abs(in_c - in_python).max() <= 1e-6 * np.abs(in_python).max()


def test_an_axis_with_a_gap_goes_where_it_should() -> None:
    """With a gap known within 2 % the command's error is below 5 % of the gap, and not without."""
    rng = np.random.default_rng(3)
    t = np.arange(4000) * 0.005
    for _ in range(20):
        gap = float(10 ** rng.uniform(-2, 0))
        assumed_gap = around(gap * rng.uniform(0.98, 1.02))
        scope: dict = {}
        exec(
            snippet_texts(Lost("backlash", assumed_gap, assumed_gap, assumed_gap, "mm", "a"), "go")[
                "snippet.py"
            ],
            scope,
        )
        reference = 10 * np.sin(0.7 * t) + 4 * np.sin(1.9 * t)
        compensate = scope["go"]
        reached = play(np.array([compensate(w) for w in reference]), gap)
        assert np.abs(reached - reference)[1:].max() < 0.05 * gap
        assert np.abs(play(reference, gap) - reference).max() > 0.9 * gap


def test_an_actuator_is_never_pushed_beyond_its_zone() -> None:
    """With the low end what passes the zone is never more than what was wanted, and near to it."""
    right, left = 1.5, 0.8
    lost = Lost("actuator", (right, 1.45, 1.55), (left, 0.77, 0.83), around(2.3), "V", "m.csv")
    scope: dict = {}
    exec(snippet_texts(lost, "drive")["snippet.py"], scope)
    drive = scope["drive"]
    for reference in np.linspace(-4, 4, 801):
        u = drive(float(reference))
        passed = u - right if u > right else u + left if u < -left else 0.0
        assert abs(passed) <= abs(reference) + 1e-12
        assert abs(passed - reference) <= 0.06 or abs(reference) < 0.06


def answer(verdict: str, **changes: object) -> dict:
    """Return the parts of an identify.json that a snippet needs."""
    return {
        "verdict": verdict,
        "right": [0.8, 0.79, 0.81],
        "left": [0.5, 0.49, 0.51],
        "width": [1.3, 1.28, 1.32],
        "odds": {"a": 0.97, "b": 0.03},
        "record": {"quantum": 0.0},
        "answer": {"grade": "named", "never_tried": []},
        "lines": {"without": 0.5, "with": 0.1, "on": "held-out data"},
        "units": {"input": "V", "output": "N"},
        **changes,
    }


def test_the_command_takes_a_scenario_or_an_answer(tmp_path: Path) -> None:
    """Three texts in one folder, the numbers in the head; again into the same folder works."""
    path = tmp_path / "identify.json"
    path.write_text(json.dumps(answer("dead_zone")))
    for _ in range(2):
        run_export(path, tmp_path / "few")
    for name in ("snippet.h", "snippet.py", "snippet.st"):
        text = (tmp_path / "few" / name).read_text()
        assert "0.8 / -0.5 N (0.79..0.81, 0.49..0.51), from identify.json" in text
    report = json.loads(run_export(EXAMPLE, tmp_path / "gap", "--json"))
    assert report["kind"] == "backlash"
    assert report["width"][0] == pytest.approx(0.24)
    text = (tmp_path / "gap" / "snippet.h").read_text()
    assert "BACKLASH = 0.24" in text
    assert "Marlin" not in text, "a setting in mm"
    texts = snippet_texts(Lost("backlash", *[around(0.18)] * 3, "mm", "axis.csv"), "go")
    assert all("M425 X0.18 F1" in text for text in texts.values())


def test_a_play_of_the_actuator_is_compensated_by_its_gap(tmp_path: Path) -> None:
    """Not as a dead zone: the whole gap is added while the command rises, in units of the input."""
    scenario = tmp_path / "valve.toml"
    scenario.write_text(
        """
        plant = {A = [[-1.0]], B = [[1.0]], C = [[1.0]]}
        sensor = {right = 0.0, left = 0.0, noise = 0.01}
        actuator = {kind = "play", right = 0.3, left = 0.2}
        reference = {kind = "sine", amplitude = 1.0, frequency = 0.2}
        observer = {method = "kalman", right = [0.0, 0.1]}
        simulation = {time = "sampled", step = 0.05, duration = 2.0}
        units = {input = "%"}
        """
    )
    report = json.loads(run_export(scenario, tmp_path / "few", "--json"))
    assert report["kind"] == "backlash"
    assert report["width"][0] == pytest.approx(0.5)
    assert report["unit"] == "%"
    assert "if (wanted > before) lead = 0.5f;" in (tmp_path / "few" / "snippet.h").read_text()


def test_a_dead_band_ahead_of_the_plant_is_compensated_in_units_of_the_input() -> None:
    found = answer("input_play", right=None, left=None, width=[5.0, 4.5, 5.5])
    lost = lost_of_answer(found | {"units": {"input": "%", "output": "bar"}}, "a.json", "a.csv")
    texts = snippet_texts(lost, "commanded")
    assert (lost.kind, lost.unit, lost.width) == ("backlash", "%", (5.0, 4.5, 5.5))
    assert "if (wanted > before) lead = 5.0f;" in texts["snippet.h"]
    assert all("Smooth a noisy command first" in text for text in texts.values())
    assert all("LinuxCNC" not in text for text in texts.values()), "a valve is no axis"


def test_of_a_valve_at_fault_either_way_lines_are_written() -> None:
    """Its play or its stick band: the lines lessen the error of both (`logs/valves.py`)."""
    odds = {"input_play": 0.6, "stiction": 0.35, "none": 0.05}
    found = answer("input_play", right=None, left=None, width=[5.0, 4.5, 5.5], odds=odds)
    assert lost_of_answer(found, "a.json", "a.csv").kind == "backlash"
    with pytest.raises(InputError, match="likely to 60 %"):
        lost_of_answer(found | {"odds": {"input_play": 0.6, "none": 0.4}}, "a.json", "a.csv")


def test_no_few_lines_cure_a_valve_that_sticks() -> None:
    found = answer("stiction", right=None, left=None, width=[5.0, 4.5, 5.5])
    with pytest.raises(InputError, match="stiction"):
        lost_of_answer(found, "a.json", "a.csv")


@pytest.mark.parametrize(
    ("verdict", "kind", "unit"),
    [
        ("dead_zone", "sensor", "N"),
        ("filtered_zone", "sensor", "N"),
        ("input_zone", "actuator", "V"),
        ("play", "backlash", "N"),
        ("input_play", "backlash", "V"),
    ],
)
def test_each_verdict_is_compensated_in_its_own_unit(
    verdict: str, kind: str, unit: str, tmp_path: Path
) -> None:
    """The widths of an input are in its unit, those of a sensor in that of the readings."""
    path = tmp_path / "identify.json"
    sides = {"right": None, "left": None} if kind == "backlash" else {}
    path.write_text(json.dumps(answer(verdict, **sides)))
    report = json.loads(run_export(path, tmp_path / "few", "--json"))
    assert (report["kind"], report["unit"]) == (kind, unit)


@pytest.mark.parametrize(
    ("found", "says"),
    [
        (answer("friction", answer={"remedies": ["oil"]}), "friction, .* helps: oil"),
        (answer("undecided"), "helps: a longer record"),
        (answer("play", odds={"play": 0.6, "friction": 0.4}), "likely to 60 %"),
        (answer("dead_zone", width=None), "no widths"),
        (answer("dead_zone", left=[0.1, -0.2, 0.4]), "interval of an edge holds 0"),
        (answer("dead_zone", answer={"grade": "indicated", "never_tried": []}), "name is withheld"),
        (answer("dead_zone", answer={"grade": "named", "never_tried": ["left"]}), "never tried"),
        (answer("dead_zone", lines=None), "Identify the log again"),
        (answer("dead_zone", lines={"without": 0.1, "with": 0.2, "on": "a log"}), "do not pay"),
        ({"outputs": {}, "verdict": "dead_zone"}, "several outputs"),
        ({"none": 1}, "expected the identify.json"),
    ],
)
def test_nothing_is_written_of_what_is_not_certain(found: dict, says: str, tmp_path: Path) -> None:
    """A typed error, which the command ends with as exit code 2, says what to do."""
    path = tmp_path / "identify.json"
    path.write_text(json.dumps(found))
    with pytest.raises(InputError, match=says):
        run_export(path, tmp_path / "few")
    assert not (tmp_path / "few").exists()


@pytest.mark.parametrize(("absent", "edge"), [("left", 1.5), ("right", -0.8)])
def test_a_sensor_with_one_edge_reads_beyond_it_alone(absent: str, edge: float) -> None:
    none = (0.0, 0.0, 0.0)
    sides = {"right": (1.5, 1.2, 1.9), "left": (0.8, 0.6, 1.1)} | {absent: none}
    lost = Lost("sensor", *sides.values(), around(2.3), "V", "m.csv", 0.01, absent)
    hear, beyond = load_lines(lost), np.sign(edge)
    assert hear(0.0) == hear(-3.0 * beyond) == edge / 2
    assert hear(2.0 * beyond) == pytest.approx(2.0 * beyond + edge)


def test_the_lines_of_a_noisy_sensor_are_the_posterior_mean() -> None:
    """Beside a sum over a grid of z, about a reading at rest of 20."""
    right, left, noise, rest = 1.5, 0.8, 0.1, 20.0
    lines = load_lines(
        Lost("sensor", around(right), around(left), around(2.3), "V", "m", rest=rest, noise=noise)
    )
    z = np.linspace(-9, 9, 180_001)
    read = z - np.clip(z, -left, right)
    for y in np.linspace(-2, 2, 41):
        weight = np.exp(-0.5 * ((y - read) / noise) ** 2)
        assert lines(rest + y) == pytest.approx(rest + (weight @ z) / weight.sum(), abs=2e-3)
