"""The export that `run` and `check` propose works, also after methods without a sampled form."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from commands import undeadzone
from documents import EXAMPLES
from undeadzone.cli.output import export_command
from undeadzone.cli.run import _describe_rival
from undeadzone.controllers import StateFeedback
from undeadzone.observers.full_state import FullState
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone_paper.example import example_as_printed, example_as_repaired

EXAMPLE = EXAMPLES / "paper_printed.toml"
CHANGE = re.compile(r'(observer|controller|simulation)\.(\w+) = ("\w+")')


def _with_changes(text: str, advice: str) -> str:
    """The file with what the advice says; a method begins its table anew."""
    for table, key, value in CHANGE.findall(advice):
        line = f"{key} = {value}\n"
        if table == "simulation":
            text = text.replace("[simulation]\n", f"[simulation]\n{line}")
        else:
            text = re.sub(rf"(?ms)^\[{table}\]\n.*?(?=^\[)", f"[{table}]\n{line}\n", text)
    return text


@pytest.mark.parametrize("command", ["run", "check"])
def test_after_printed_methods_the_proposed_export_works(command: str, tmp_path: Path) -> None:
    done = undeadzone(command, EXAMPLE, "--no-figures")
    advice = done.stdout.partition("next ")[2]
    assert f"undeadzone export {EXAMPLE}" in advice
    refused = undeadzone("export", EXAMPLE, "--out", tmp_path / "refused")
    assert refused.returncode == 2
    mended = tmp_path / "mended.toml"
    mended.write_text(_with_changes(EXAMPLE.read_text(encoding="utf-8"), advice), encoding="utf-8")
    done = undeadzone("export", mended, "--out", tmp_path / "firmware", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "firmware").glob("*.c"))


@pytest.mark.parametrize(
    ("scenario", "named"),
    [
        (example_as_repaired(5.0), []),
        (
            msgspec.structs.replace(example_as_printed(5.0), controller=StateFeedback()),
            ["observer"],
        ),
        (example_as_printed(5.0), ["observer", "controller"]),  # gains by alpha are continuous
        (read(EXAMPLE), ["observer", "controller"]),
    ],
)
def test_only_methods_without_a_sampled_form_are_replaced(
    scenario: Scenario, named: list[str]
) -> None:
    (advice,) = export_command(Path("mine.toml"), scenario)
    assert [table for table, _, _ in CHANGE.findall(advice)] == [*named, "simulation"]


def test_nothing_is_proposed_where_nothing_helps() -> None:
    repaired = example_as_repaired(5.0)
    full_state = msgspec.structs.replace(repaired, observer=FullState())
    assert export_command(Path("mine.toml"), full_state) == []
    sampled = Simulation(time="sampled", step=1e-2)
    (plain,) = export_command(Path("m.toml"), msgspec.structs.replace(repaired, simulation=sampled))
    assert plain == "undeadzone export m.toml"
    coarse = msgspec.structs.replace(repaired, simulation=Simulation(step=50.0))
    assert export_command(Path("mine.toml"), coarse) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "plain: rms z - r 0.5 mm"),
        ({"rms_tip": 0.0123}, "plain: rms z - r 0.5 mm, tip 0.0123 m"),
        ({"divergence_time": 2.5}, "plain diverges at 2.5 s"),
    ],
)
def test_a_run_under_comparison_tells_its_errors(changes: dict[str, float], words: str) -> None:
    units = SimpleNamespace(units=SimpleNamespace(output="mm"))
    rival: Any = SimpleNamespace(
        observer_name="plain", divergence_time=None, rms_tip=None, rms_tracking=0.5, info=units
    )
    vars(rival).update(changes)
    assert _describe_rival(rival) == {"compared": words}
    assert _describe_rival(None) == {}
