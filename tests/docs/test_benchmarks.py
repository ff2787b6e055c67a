"""Commands of benchmarks on pages and beside tables exist, and name what the tables depend on."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from benchmarks import __main__ as benches

from packed import ROOT

READ = ("*.md", "benchmarks/**/*.md", "benchmarks/**/*.py", "docs/**/*.md", "src/**/*.py")


@pytest.fixture(scope="module")
def text() -> str:
    """All pages and all source, in one line."""
    paths = [path for pattern in READ for path in ROOT.glob(pattern)]
    return re.sub(r"\s+", " ", "\n".join(path.read_text(encoding="utf-8") for path in paths))


def test_every_command_on_a_page_is_a_bench(text: str) -> None:
    named = set(re.findall(r"python -m benchmarks ([a-z]\w*)", text))
    assert len(named) > 50
    assert not named - benches.find_benches().keys()


def test_every_module_on_a_page_exists(text: str) -> None:
    named = set(re.findall(r"python -m (benchmarks\.[\w.]*\w)(?![\w.{])", text))
    assert len(named) > 1
    assert [name for name in named if not (ROOT / f"{name.replace('.', '/')}.py").exists()] == []


def test_a_name_is_of_one_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benches, "HERE", tmp_path)
    for folder in ("gears", "loops"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "gaps.py").write_text("\ndef table(): ...\n")
        (tmp_path / folder / "logs.py").write_text("def make(): ...\n")
    with pytest.raises(ValueError, match="two benches have the name gaps"):
        benches.find_benches()
    (tmp_path / "loops" / "gaps.py").unlink()
    assert benches.find_benches() == {"gaps": tmp_path / "gears" / "gaps.py"}


def test_the_command_of_a_table_has_the_variables_that_it_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "gaps.py"
    path.write_text('os.environ.get(f"ROWS_{key}", 1)\nos.environ["GAPS"]\n')
    for name in ("ROWS_FIRST", "GAPS", "OTHER"):
        monkeypatch.setenv(name, "7")
    assert benches.write_command("gaps", path) == "GAPS=7 ROWS_FIRST=7 python -m benchmarks gaps"


def test_arguments_of_a_table_are_options(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "certificates --plants 1 --trajectories 10 --switches 3"
    monkeypatch.setattr("sys.argv", ["benchmarks", *words.split()])
    assert benches.main() == 0
    text = capsys.readouterr().out
    assert "10 trajectories of 3 switches" in text
    assert f"python -m benchmarks {words}" in text
    with pytest.raises(SystemExit):
        benches.make_table(benches.find_benches()["certificates"], ["--plant", "many"])


def test_an_unknown_name_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", "gaps"])
    assert benches.main() == 2
    assert capsys.readouterr().err.startswith("no bench gaps; benches: arena_effort, ")
