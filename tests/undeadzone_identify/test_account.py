"""Account of a log: one place makes its numbers, and screen, page and JSON have the same."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from benchmarks.identify.logs.strangers import zone
from scipy.signal import lfilter

from commands import undeadzone
from undeadzone.nonlinearities.play import levels
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.account import (
    BOUNDED,
    GRADES,
    INDICATED,
    MEASURED,
    NAMED,
    OPEN,
    SAYS,
    Account,
    Buys,
)
from undeadzone_identify.results.speech import order_of_excitation

QUICK = ("--order", "1", "--delay", "0")
STEP = 0.05
PAIR = ("V", "mm")


def driven(size: int) -> tuple[np.random.Generator, Floats, Floats]:
    """A seeded generator, steps of an input, and the output of a lag behind them."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(size // 10), 10)
    return rng, u, lag(u)


def lag(u: Floats) -> Floats:
    """The output of a lag of ten samples."""
    return np.asarray(lfilter([0, 0.1], [1, -0.9], u))


def columns(u: Floats, y: Floats) -> dict[str, Floats]:
    """Columns of a log of an input and its readings."""
    return {"t [s]": STEP * np.arange(u.size), "u [V]": u, "y [mm]": y}


def table() -> dict[str, Floats]:
    """Commands and readings of a bench: a band from -0.3 to 0.5."""
    u = np.tile(np.linspace(-2, 2, 41), 2)
    noise = 0.01 * np.random.default_rng(0).standard_normal(u.size)
    return {"command [V]": u, "reading [mm]": 3 * zone(u, 0.5, 0.3) + noise}


def sensor_zone() -> dict[str, Floats]:
    """Readings of a sensor with a zone from -0.1 to 0.2."""
    rng, u, z = driven(800)
    return columns(u, zone(z, 0.2, 0.1) + 0.01 * rng.standard_normal(z.size))


def curved_actuator() -> dict[str, Floats]:
    """An actuator whose curve no class holds, seen by three deviations."""
    rng, u, _ = driven(1200)
    return columns(u, lag(np.tanh(3 * u)) + 0.02 * rng.standard_normal(u.size))


def straight() -> dict[str, Floats]:
    """Readings of a lag alone."""
    rng, u, z = driven(800)
    return columns(u, z + 0.01 * rng.standard_normal(z.size))


def two_positions() -> dict[str, Floats]:
    """Two encoders with a gap of 0.5 between them."""
    t = STEP * np.arange(1200)
    motor = 3 * np.sin(0.7 * t)
    joint = levels(motor[:, None], np.array([0.25]), np.array([0.25]), motor[:1])[:, 0]
    noise = 0.01 * np.random.default_rng(1).standard_normal(t.size)
    return {"t [s]": t, "motor [deg]": motor, "joint [deg]": joint + noise}


def noise_alone() -> dict[str, Floats]:
    """Readings to which the input does nothing."""
    rng, u, _ = driven(800)
    return columns(u, rng.standard_normal(u.size))


class Told(NamedTuple):
    """A log, options of the command, and the account that it has."""

    make: Callable[[], dict[str, Floats]]
    options: tuple[str, ...]
    grade: str
    headline: str
    effect: str
    truth: dict[str, float]


LOGS = {
    "looks": Told(
        table, (), MEASURED, "Measured: the reading rests", "loss", {"lower": -0.3, "upper": 0.5}
    ),
    "named zone": Told(
        sensor_zone,
        QUICK,
        NAMED,
        "Dead zone of the sensor: right 0.",
        "output loss",
        {"right": 0.2, "left": 0.1, "width": 0.3},
    ),
    "indicated": Told(
        curved_actuator,
        QUICK,
        INDICATED,
        "Indicated, not certain: the input acts along a curve",
        "input shape",
        {},
    ),
    "null": Told(straight, QUICK, NAMED, "No dead zone and no backlash", "", {}),
    "lost motion": Told(
        two_positions, (), NAMED, "Backlash: gap 0.", "input reversal", {"gap": 0.5}
    ),
    "nothing": Told(noise_alone, QUICK, OPEN, "No number can be given", "", {}),
}


class Answered(NamedTuple):
    """What a log was, and what the command said of it: lines by name, and JSON."""

    told: Told
    code: int
    text: str
    numbers: dict[str, Any]
    page: str

    @property
    def answer(self) -> dict[str, Any]:
        """The account in JSON."""
        return dict(self.numbers["answer"])

    def lines(self, name: str) -> list[str]:
        """The printed lines of a name."""
        rows: list[str] = []
        inside = False
        for row in self.text.splitlines():
            inside = row.startswith(f"{name}  ") or (inside and row.startswith("  "))
            rows += [row.removeprefix(name).strip()] * inside
        return rows


@pytest.fixture(scope="module", params=LOGS)
def answered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Answered:
    """The command on a log."""
    told = LOGS[request.param]
    folder: Path = tmp_path_factory.mktemp("log")
    columns = told.make()
    rows = np.column_stack([*columns.values()])
    heads = ",".join(columns)
    np.savetxt(folder / "log.csv", rows, delimiter=",", header=heads, comments="")
    done = undeadzone("identify", "log.csv", *told.options, cwd=folder)
    assert done.stderr == ""
    written = folder / "log-identify"
    numbers = json.loads((written / "identify.json").read_text())
    page = (written / "report.html").read_text(encoding="utf-8")
    return Answered(told, done.returncode, done.stdout, numbers, page)


def test_the_account_has_its_grade_its_truth_and_its_exit_code(answered: Answered) -> None:
    told, answer = answered.told, answered.answer
    assert answer["grade"] == told.grade
    assert answered.numbers["found"].startswith(told.headline)
    assert [*answer["effects"]] == [told.effect] * bool(told.effect)
    for name, truth in told.truth.items():
        value, low, high = answer["effects"][told.effect][name]
        assert low <= truth <= high
        assert low <= value <= high
    assert answered.code == (told.grade not in SAYS)


def test_screen_page_and_json_say_the_same(answered: Answered) -> None:
    answer = answered.answer
    assert answered.lines("found") == [answered.numbers["found"]]
    assert answered.numbers["found"] in answered.page.replace("&#x27;", "'")
    assert answered.lines("remedy") == answer["remedies"]
    assert bool(answer["remedies"]) == bool(answer["effects"])
    assert answered.lines("doubt") == answer["doubts"]
    assert len(answered.lines("at most")) == len(answer["at_most"])
    assert len(answered.lines("not decided")) == len(answer["not_decided"] | {}) + len(
        answer["never_tried"]
    )
    pays = answered.lines("pays")
    assert bool(pays) == bool(answer["pays"])
    for line in pays:
        assert f"{answer['pays']['remaining']:.4g} mm with it" in line
        assert f"({100 * answer['pays']['share']:.0f} % of the squares" in line
        assert 0 < answer["pays"]["share"] < 1


def test_code_is_printed_of_what_is_certain_and_the_next_log_of_what_is_not(
    answered: Answered,
) -> None:
    grade, effects = answered.answer["grade"], answered.answer["effects"]
    assert bool(answered.lines("record next")) == (grade in (INDICATED, OPEN))
    if "static float" in answered.text:
        assert grade in (NAMED, MEASURED)
        assert effects
    assert ("log.toml" in answered.text) == (answered.told.make is sensor_zone)


def test_a_sine_excites_two_numbers_and_steps_many() -> None:
    """Of 7.3 periods, and of 80 levels (Willems 2005)."""
    sine = np.sin(np.arange(900) / 20)
    assert order_of_excitation(sine) < 2.2 < 20 < order_of_excitation(driven(800)[1])


def test_a_null_has_the_largest_effects_that_could_hide(answered: Answered) -> None:
    if answered.told.make is straight:
        assert 0 < answered.answer["at_most"]["output loss"] < 0.05
        assert answered.numbers["verdict"] == "none"
    else:
        assert answered.answer["at_most"] == {}


def test_parts_of_an_account_become_lines() -> None:
    wide = Interval(0.5, 0.4, 0.6)
    account = Account(
        INDICATED,
        {"input loss": {"width": wide}},
        "a fit",
        PAIR,
        Buys(2.0, 1.0, 3.0),
        {"output reversal": {"gap": wide}, "friction": {}},
        ("half of the log is silent",),
        ("left",),
        {"input reversal": 0.2},
    )
    lines = account.summary()
    assert lines["found"] == (
        "Indicated, not certain: a band of the input moves nothing: width 0.500 [0.400, 0.600] V"
    )
    assert lines["pays"].startswith("held-out error 2 mm without it, 1 mm with it (75 % of")
    assert lines["not decided"] == [
        "motion is lost between output and reading at each reversal: gap 0.500 [0.400, 0.600] mm",
        "friction resists the motion",
        "the left side was never tried",
    ]
    assert lines["at most"] == ["0.2 V: motion is lost after each reversal of the input"]
    assert account.with_doubts("", "first").summary()["doubt"][0] == "first"
    assert not account.is_certain
    bare = {"effects": {}, "buys": None, "others": {}, "unmet": (), "limits": {}, "doubts": ()}
    heads = {grade: account._replace(grade=grade, **bare).headline() for grade in GRADES}
    assert heads[BOUNDED] == "Nothing hidden was found"
    assert heads[OPEN] == "No number can be given"
    named = account._replace(grade=NAMED, name="Dead zone", effects={"fold": {}})
    assert named.headline() == "Dead zone"
    assert "record next" not in named.summary()
