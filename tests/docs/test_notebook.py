"""Results in an executed notebook: tables and figures, bars that leave nothing behind."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import pytest

from undeadzone.util import progress

TESTS = Path(__file__).parents[1]
BEGIN = """
import matplotlib
import numpy as np
import once
import pytest
import undeadzone as uz
from scenes import scene
from undeadzone.util import progress
from undeadzone_arena.contest.contest import run_contest
once.in_haste(pytest.MonkeyPatch())
progress.PATIENCE = 0.0
progress.PAUSE = 0.0
short = {"time": "sampled", "step": 1e-2, "duration": 2.0}
s = scene(
    title="Mine",
    simulation=short,
    ensemble={"runs": 16, "sensor.right": {"uniform": [0.5, 1.5]}},
    tune={"runs": 2, "held_out": 2, "budget": 4, "observer.gamma": {"between": [1.0, 20.0]}},
)
log = uz.simulate(s | {"simulation": {"duration": 8.0}})
"""
RESULTS = {
    "run": "uz.simulate(s)",
    "ensemble": "uz.run_ensemble(s)",
    "check": "uz.check(s)",
    "design": "uz.design(s, 'rate')",
    "tuned": "uz.tune(s)",
    "estimation": "uz.estimate(s, y=log.y, u=log.u)",
    "identified": "uz.identify(t=log.t, u=log.u, y=log.y, order=2, delay=0)",
    "contest": "run_contest(['luenberger'], {'mine': s}, (0,), {}, 1)",
}
WORDS = {
    "run": "rms z - r",
    "ensemble": "settled",
    "check": "certified",
    "design": "proof P",
    "tuned": "held-out runs",
    "estimation": "consistent",
    "identified": "found",
    "contest": "median regret",
}


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """The outputs of each cell, by name."""
    command = f'"{sys.executable}" -m undeadzone'
    codes = {"begin": BEGIN, "scenario": "s"}
    for name, code in RESULTS.items():
        codes[name] = f"{name} = {code}\n{name}"
        codes[f"plot {name}"] = (
            f"axes = matplotlib.figure.Figure().subplots()\n"
            f"{name}.plot(ax=axes) is axes.figure, axes.has_data(),"
            f" {name}.plot('{name}.svg').axes != []"
        )
    codes["command"] = f"s.save('mine.toml')\n!{command} ensemble mine.toml --no-figures"
    codes["script"] = "bar = uz.simulate(s, progress=lambda done: None)"
    book = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, codes.values())])
    folder = tmp_path_factory.mktemp("notebook")
    path = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
    client = nbclient.NotebookClient(
        book, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    client.execute(env=os.environ | {"PYTHONPATH": path})
    outputs = [cell.outputs for cell in book.cells]
    assert sorted(file.stem for file in folder.glob("*.svg")) == sorted(RESULTS)
    return dict(zip(codes, outputs, strict=True))


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_shows_a_table_and_a_figure_once(name: str, cells: dict[str, list[Any]]) -> None:
    results = [output for output in cells[name] if output.output_type == "execute_result"]
    assert len(results) == 1
    html, text = results[0].data["text/html"], results[0].data["text/plain"]
    assert html.count("<img") == 1
    assert WORDS[name] in html
    assert WORDS[name] in text
    assert "array(" not in text
    assert not [output for output in cells[name] if output.output_type == "stream"]


@pytest.mark.parametrize("name", RESULTS)
def test_a_plot_takes_axes_or_a_path(name: str, cells: dict[str, list[Any]]) -> None:
    (result,) = cells[f"plot {name}"]
    assert result.data["text/plain"] == "(True, True, True)"


def test_a_scenario_shows_its_tables(cells: dict[str, list[Any]]) -> None:
    (result,) = cells["scenario"]
    assert "[sensor]" in result.data["text/html"]


def bars(outputs: list[Any]) -> list[Any]:
    """What was displayed beside the result."""
    return [output for output in outputs if output.output_type == "display_data"]


@pytest.mark.parametrize("name", ["run", "ensemble", "design", "tuned", "identified"])
def test_a_bar_is_one_display_that_ends_empty(name: str, cells: dict[str, list[Any]]) -> None:
    (bar,) = bars(cells[name])
    assert bar.data == {"text/plain": "", "text/html": ""}


def test_no_bar_beside_a_callback(cells: dict[str, list[Any]]) -> None:
    assert cells["script"] == []


def test_a_command_in_a_cell_prints_its_table_once(cells: dict[str, list[Any]]) -> None:
    streams = [output for output in cells["command"] if output.output_type == "stream"]
    text = "".join(stream.text for stream in streams)
    assert text.count("rms z - r, last 2 s") == 1
    assert "\x1b[2K" not in text  # nothing is wiped out, as a bar on a terminal is
    assert "\x1b[?25" not in text


def test_a_bar_counts_and_says_how_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[Any, ...]] = []

    class Place:
        def draw(self, *words: Any) -> None:
            drawn.append(words)

        def clear(self) -> None:
            drawn.append(())

    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    with progress._show_bar(Place(), "running", 10, "runs") as advance:
        advance(3)
        advance(4)
    assert drawn.pop() == ()
    steps = [words for words in drawn if words[0] == "running"]
    assert [words[1] for words in steps] == [3, 7]
    assert steps[0][3].endswith("runs/s")
    assert {words[0] for words in drawn} <= {"running", progress.SETTING_UP}


def test_no_bar_before_patience_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "PATIENCE", 1e9)
    with progress._show_bar(progress._NotebookBar(), "running", 10, None) as advance:
        advance(10)
