"""The tutorials run, cell after cell, and results show themselves in notebooks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import once
import undeadzone as uz
from documents import ROOT
from scenes import scene
from undeadzone.util import shown
from undeadzone.util.text import format_with_interval

FOLDER = ROOT / "docs/tutorials"
SCRIPTS = sorted(FOLDER.glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_tutorials_run(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    once.in_haste(monkeypatch)  # test_gain_search.py searches for long
    monkeypatch.setattr("undeadzone_paper.audit", lambda: once.audit()[0])
    code = script.read_text(encoding="utf-8")
    exec(compile(code, script.name, "exec"), {"__name__": "__main__"})
    assert "nan" not in capsys.readouterr().out


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_notebook_has_the_lines_of_its_script(script: Path) -> None:
    cells = json.loads(script.with_suffix(".ipynb").read_text(encoding="utf-8"))["cells"]
    text = " ".join("".join([*cell["source"], "\n"]) for cell in cells)
    written = re.sub(r"# %%.*", "", script.read_text(encoding="utf-8"))
    assert text.replace("#", "").split() == written.replace("#", "").split(), (
        "run: python docs/site/tutorials.py"
    )


def test_every_tutorial_is_on_the_site() -> None:
    names = re.search(r"NAMES = \((.*?)\)", (FOLDER.parent / "site/tutorials.py").read_text(), re.S)
    assert names is not None
    assert sorted(re.findall(r'"(\w+)"', names[1])) == [script.stem for script in SCRIPTS]


def test_a_run_shows_its_table_and_a_figure() -> None:
    run = uz.simulate(scene(title="<b>mine</b>", simulation={"duration": 0.5, "step": 0.01}))
    assert "d_right" in str(run)
    assert "(last 0.5 s)" in str(run)
    html = run._repr_html_()
    assert "&lt;b&gt;mine&lt;/b&gt;" in html
    assert "<b>" not in html
    assert 'src="data:image/png;base64,' in html
    assert uz.plot(run)._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_blocks_are_aligned_and_escaped() -> None:
    blocks: list[shown.Block] = [
        "a & b",
        {"one": 1.0, "many": ["x", "y"]},
        [("h", "i"), ("1", "<")],
    ]
    assert shown.format_blocks(blocks) == "a & b\n\none   1\nmany  x\n      y\n\nh  i\n1  <"
    html = shown.blocks_to_html(blocks)
    assert "a &amp; b" in html
    assert "x<br>y" in html
    assert "<td>&lt;</td>" in html


@pytest.mark.parametrize(
    ("value", "std", "words"),
    [
        (0.977645, 0.16, "0.98 [0.66, 1.29]"),
        (0.0502802, 0.00086, "0.05028 [0.04859, 0.05197]"),
        (12.3456, 3.2, "12.3 [6.1, 18.6]"),
        (1234.0, 210.0, "1234 [822.4, 1646]"),
        (0.5, 0.0, "0.5"),
        (None, 0.1, "nan (no interval)"),
        (1.0, None, "1 (no interval)"),
    ],
)
def test_the_deviation_decides_an_intervals_digits(value: float, std: float, words: str) -> None:
    assert format_with_interval(value, std) == words
