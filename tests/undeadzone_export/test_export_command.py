"""`undeadzone export`: options, exit codes, what it prints."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from undeadzone.errors import InputError
from undeadzone.scenario.reader import read
from undeadzone_export import accuracy, exporting
from undeadzone_export.command import export as command

SCENARIO = """
title = "Arm joint"
plant = { A = [[0.0, 1.0], [-1.0, -2.0]], B = [[0.0], [1.0]], C = [[1.0, 0.0]], x0 = [0.5, 0.0] }
sensor = { right = 1.0, left = 1.0 }
reference = { kind = "sine", amplitude = 5.0, frequency = 1.0 }
observer = { method = "certified", L = [1.0, 1.5], gamma = 10.0 }
controller = { method = "state_feedback", alpha = 10.0 }
simulation = { time = "sampled", duration = 2.0, step = 1e-3 }
"""


@pytest.fixture(autouse=True)
def shorter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(SCENARIO)


def called(*arguments: str) -> tuple[int, Result]:
    """(the exit code, the result) of the command, as `main` takes it."""
    result = CliRunner().invoke(command, ["arm.toml", *arguments], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return int(not result.return_value), result


def test_it_writes_firmware_and_says_what_it_costs(tmp_path: Path) -> None:
    code, result = called()
    assert code == 0
    assert (tmp_path / "firmware" / "arm_joint.c").exists()
    assert "arm_joint (observer, single)" in result.stdout
    assert "15 add" in result.stdout


def test_check_alone_builds_and_runs_and_leaves_nothing(tmp_path: Path) -> None:
    code, result = called("--check")
    assert code == 0
    assert "every bit agrees" in result.stdout
    assert "float against double" in result.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml"]


def test_large_code_is_announced_before_it_is_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporting, "MANY", 20)
    code, result = called("--json")
    assert code == 0
    pattern = r"(\d+) instructions, which take about 1 minute to write, compile and compare"
    found = re.match(pattern, result.stderr)
    assert found is not None
    assert int(found[1]) > sum(json.loads(result.stdout)["operations"].values())


def test_the_announcement_does_not_wait_for_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Building its nodes alone takes minutes of a large scenario."""
    messages: list[str] = []
    monkeypatch.setattr(exporting, "MANY", 20)
    monkeypatch.setattr(exporting, "build_code", None)
    with pytest.raises(TypeError):
        exporting.export(read(Path("arm.toml")), "c", "firmware", notify=messages.append)
    assert len(messages) == 1


def test_json_is_the_report(tmp_path: Path) -> None:
    code, result = called("--json", "--out", "fw", "--tunable", "observer.gamma", "--name", "knee")
    report: dict[str, Any] = json.loads(result.stdout)
    assert code == 0
    assert report["sizes"]["params"] == 4
    assert report["operations"]["multiply"] == 9
    assert report["accuracy"]["machine"] is None
    assert report["accuracy"]["float_against_double"]["x"]["error"] < 1e-3
    assert len(report["hash"]) == 16
    assert "fw/knee.c" in report["written"]


def test_exit_code_1_writes_nothing_and_double_is_the_way_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(accuracy, "SHARE_OF_WIDTH", 0.0)
    code, result = called("--out", "fw", "--precision", "single")
    assert code == 1
    assert re.search(
        r"^REFUSED +float is not enough: .*; use --precision double$", result.stdout, re.M
    )
    assert re.search(r"^written +nothing$", result.stdout, re.M)
    assert not re.search(r"^(next|leaner) |board", result.stdout, re.M)
    assert not Path("fw").exists()
    assert called("--out", "fw", "--precision", "double")[0] == 0
    code, result = called("--out", "own")
    assert code == 0
    assert re.search(r"^double +float is not enough: left is wrong by ", result.stdout, re.M)
    assert "arm_joint (observer, double)" in result.stdout


def test_another_method_is_exported_with_a_line_for_each_key_it_lacks() -> None:
    code, result = called("--method", "kalman right=[0,2]", "--out", "fw")
    assert code == 0
    assert re.findall(r"observer\.\w+: .*", result.stdout) == [
        f"observer.{key}: the other method has no key of this meaning" for key in ("L", "gamma")
    ]


@pytest.mark.parametrize(
    "options",
    [
        ("--to", "fmu9"),
        ("--precision", "half"),
        ("--tunable", "observer.nothing"),
        ("--name", "9lives"),
        ("--out", "arm.toml"),
    ],
    ids=str,
)
def test_bad_options_are_input_errors(options: tuple[str, ...]) -> None:
    with pytest.raises(InputError):
        called(*options)


def test_an_FMU_and_a_module_are_in_double_by_default(tmp_path: Path) -> None:
    for target, file in (("fmu2", "arm_joint.fmu"), ("python", "arm_joint.py")):
        code, result = called("--to", target, "--out", target)
        assert code == 0
        assert "arm_joint (observer, double)" in result.stdout
        assert (tmp_path / target / file).exists()
    _, result = called("--to", "python", "--precision", "single", "--out", "python")
    assert "arm_joint (observer, single)" in result.stdout
    assert "ctypes.c_float" in (tmp_path / "python" / "arm_joint.py").read_text()


@pytest.mark.parametrize("out", ["arm.toml", "arm.toml/fw", "mine"])
def test_the_folder_is_looked_at_before_anything_is_computed(
    out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    monkeypatch.setattr(exporting, "resolve_scenario", lambda _: pytest.fail("computed"))
    with pytest.raises(InputError):
        called("--out", out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml", "mine"]
