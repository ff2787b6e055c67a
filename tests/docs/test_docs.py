"""What the documentation shows is run: blocks of Python, consoles with their numbers, pages."""

from __future__ import annotations

import functools
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import once
from commands import Done, undeadzone
from documents import DOCS, ROOT, script_of_docs
from undeadzone.registry import CONTROLLERS, OBSERVERS
from undeadzone.scenario.reader import read
from undeadzone_arena.contest.leaderboard import FRAME
from undeadzone_arena.contest.methods import methods_for_scenarios

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CONTRIBUTING = ROOT / "CONTRIBUTING.md"
SUMMARY = "## Summary: best and worst figure of each subject"
CONSOLES = script_of_docs("consoles")
SHOWN = dict(CONSOLES.PRINTED.findall("".join(page.read_text() for page in PAGES)))
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")


def blocks(kind: str) -> list[tuple[str, str]]:
    """Name and text of every fenced block of a kind."""
    named = []
    for page in PAGES:
        texts = re.findall(rf"```{kind}\n(.*?)```", page.read_text(), re.S)
        named += [(f"{page.name}:{i}", text) for i, text in enumerate(texts)]
    return named


@pytest.mark.parametrize(("name", "code"), blocks("python"))
def test_python_blocks_run_and_print_what_they_show(
    name: str, code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(CONSOLES.link_inputs(tmp_path))
    once.in_haste(monkeypatch)  # in the one block that asks for a front
    exec(compile(code, name, "exec"), {"__name__": "__main__"})
    if code in SHOWN:
        same(capsys.readouterr().out, SHOWN[code])


def test_pictures_are_of_what_there_is_today() -> None:
    """Each carries its title, and stands on a page."""
    folder, pages = ROOT / "docs/figures", "".join(page.read_text() for page in PAGES)
    titles = {}
    for path in sorted(folder.iterdir()):
        if path.suffix in (".png", ".gif"):
            with Image.open(path) as picture:
                titles[path.name] = str(picture.info.get("Title", picture.info.get("comment", "")))
    assert all(f"figures/{name})" in pages for name in titles)
    gears, zones = (read(ROOT / f"examples/{name}.toml") for name in ("two_link_gears", "two_link"))
    entered = {*FRAME, *methods_for_scenarios([read(ROOT / "examples/load_cell_limited.toml")])}
    assert titles["two_link_gears.png"] == f"{gears.title}: the tip"
    assert titles["two_link.gif"] == str(zones.title.encode())
    assert titles["leaderboard.png"].startswith(f"{len(entered)} methods, 1 scenario")
    drawn = {f"{name}.png" for name in script_of_docs("pictures").PICTURES}
    assert titles.keys() == drawn | {"two_link.gif", "live.gif"}
    small = [f"figures/{path.parent.name}/{path.name})" for path in folder.glob("[tw]r*/*.svg")]
    assert len(small) == 13
    assert all(name in pages for name in small)


@pytest.mark.parametrize(("name", "text"), blocks("console"))
def test_console_blocks_show_what_happens(name: str, text: str, tmp_path: Path) -> None:
    CONSOLES.link_inputs(tmp_path)
    for command, expected in CONSOLES.COMMAND.findall(text):
        alone = command.startswith("run examples/") and command.endswith("--no-figures")
        done = ran_once(command) if alone else undeadzone(*shlex.split(command), cwd=tmp_path)
        same(done.stdout, expected, done.stderr)


def same(printed: str, expected: str, why: str = "") -> None:
    """Compare what is shown with what was expected: words exactly, numbers to 2 %."""
    assert NUMBER.sub("#", printed.rstrip()) == NUMBER.sub("#", expected.rstrip()), why
    for word, other in zip(NUMBER.findall(printed), NUMBER.findall(expected), strict=True):
        # an integration error is known to its order of magnitude
        b = float(other)
        assert float(word) == pytest.approx(b, rel=0.02 if abs(b) > 1e-7 else 10.0)


@functools.cache
def ran_once(command: str) -> Done:
    """A command that writes nothing, which several pages may show."""
    return undeadzone(*shlex.split(command), cwd=ROOT)


def test_scenario_page_is_up_to_date() -> None:
    module = script_of_docs("reference")
    written = {path: path.read_text(encoding="utf-8") for path in DOCS.glob("scenario*.md")}
    assert written == module.pages(), "run: python docs/reference.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_has_at_most_3000_words(page: Path) -> None:
    assert len(page.read_text(encoding="utf-8").split()) <= 3000


def test_the_first_keys_are_25_that_a_scenario_has() -> None:
    text = (ROOT / "docs" / "keys.md").read_text(encoding="utf-8").partition("Five")[0]
    keys = re.findall(r"`([a-z]+)\.([A-Za-z]\w*)`", text)
    assert len(set(keys)) == len(keys) == 25
    every = "".join(page.read_text(encoding="utf-8") for page in DOCS.glob("scenario*.md"))
    tables = dict(re.findall(r"\n## \[(\w+)\]\n(.*?)(?=\n## |\n# |\Z)", every, re.DOTALL))
    for table, key in keys:
        assert re.search(rf"\| \**{key}\** \||\*\*{key}\*\* = ", tables[table]), f"{table}.{key}"


@pytest.mark.parametrize("page", [CONTRIBUTING, *PAGES], ids=lambda page: page.name)
def test_links_point_to_files(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_who_contributes_reads_four_kilobytes() -> None:
    """Details are on docs/testing.md and docs/architecture.md."""
    assert CONTRIBUTING.stat().st_size <= 4096


def test_every_method_has_its_row_and_its_equations() -> None:
    """A method that is recommended has a page, and the others have sections of a page."""
    folder = ROOT / "docs/methods"
    row = re.compile(r"^\| \[(\w+)\]\((\w+\.md)(#?)(\w*)\) .* \| (yes)? \|$", re.M)
    table = row.findall((folder / "index.md").read_text(encoding="utf-8"))
    assert sorted(name for name, *_ in table) == sorted(
        {*OBSERVERS.list_tags(), *CONTROLLERS.list_tags()}
    )
    for name, page, mark, anchor, recommended in table:
        assert recommended == ("" if anchor else "yes")
        assert f"#{mark} {anchor or name}\n" in (folder / page).read_text(encoding="utf-8")


def test_every_doi_of_the_code_is_in_the_references() -> None:
    """A docstring that cites a publication names its DOI, and docs/references.md describes it."""
    listed = set(re.findall(r"\[doi:(\S+)\]", (ROOT / "docs/references.md").read_text()))
    sources = [path.read_text() for path in (ROOT / "src").rglob("*.py")]
    cited = {doi for text in sources for doi in re.findall(r"\bdoi:(\S+)", text)}
    assert len(cited) > 30
    assert cited <= listed


def test_the_summary_of_the_results_quotes_their_tables() -> None:
    """A table that is written anew needs its row of the summary read again."""
    from benchmarks.markdown import parted  # the copies of other tests have no benchmarks

    sections = parted((ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8"))
    by_anchor = {slugify(title.removeprefix("## ")): text for title, text in sections.items()}
    rows = [line for line in sections[SUMMARY].splitlines() if "](#" in line]
    assert len(rows) == 10
    for line in rows:
        _, subject, tables, *figures, _ = (cell.strip() for cell in line.split("|"))
        quoted = "".join(by_anchor[anchor] for anchor in re.findall(r"\]\(#([^)]+)\)", tables))
        for figure in re.findall(r"\d[\d.,e-]*\d|\d", " ".join(figures)):
            assert re.search(rf"(?<![\d.]){re.escape(figure)}(?![\d.]*\d)", quoted), (
                subject,
                figure,
            )


def slugify(title: str) -> str:
    """Return the anchor of a heading, as mkdocs makes it."""
    words = re.sub(r"[^\w\s-]", "", title.replace("`", "")).strip().lower()
    return re.sub(r"[-\s]+", "-", words)


SHORT = sorted([*(ROOT / "docs/howto").glob("*.md"), *(ROOT / "docs/trades").glob("*.md")])


def links(page: Path) -> set[Path]:
    """The pages to which a page links."""
    targets = re.findall(r"\]\(([^)#:]+\.md)[)#]", page.read_text(encoding="utf-8"))
    return {(page.parent / target).resolve() for target in targets}


@pytest.mark.parametrize("page", SHORT, ids=lambda page: page.stem)
def test_a_page_for_a_reader_is_short_and_runs(page: Path) -> None:
    """It has code that a test above runs, and at most 60 lines beside it."""
    text = page.read_text(encoding="utf-8")
    assert re.search(r"^```(python|console)$", text, re.MULTILINE)
    if page.parent.name == "trades":
        assert f"](../figures/trades/{page.stem}.svg)" in text
        assert re.search(r"\]\(\S+\.(csv|toml|h)\)", text)
        text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    assert len(text.splitlines()) <= 60


def test_home_leads_to_every_page_in_two_clicks() -> None:
    """It has the symptoms of the front page."""
    home = ROOT / "docs" / "index.md"
    near = links(home)
    assert {page for page in PAGES if page.parent.name == "trades"} <= near
    reached = near.union({home, ROOT / "docs/joss/paper.md"}, *map(links, near))
    assert {*PAGES[1:]} <= reached
    symptoms = re.findall(r"^(\| an? .*? \|)", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(symptoms) >= 6
    assert all(symptom in home.read_text() for symptom in symptoms)
