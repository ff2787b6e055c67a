"""The paper about the software: its citations exist, and its numbers are those of RESULTS.md."""

from __future__ import annotations

import re

from benchmarks.markdown import parted

from packed import ROOT

PAPER = (ROOT / "docs/joss/paper.md").read_text(encoding="utf-8")
ENTRIES = dict(
    re.findall(
        r"@\w+\{(\w+),.*doi = \{([^}]+)\}", (ROOT / "docs/joss/paper.bib").read_text("utf-8")
    )
)
RESULTS = (ROOT / "benchmarks/RESULTS.md").read_text(encoding="utf-8")


def test_every_citation_has_an_entry_with_a_doi_and_every_entry_is_cited() -> None:
    cited = set(re.findall(r"@([A-Z]\w+)", PAPER))
    assert cited == set(ENTRIES)


def test_sections_and_length_are_those_of_the_journal() -> None:
    """Its disclosure of generative AI is missing: docs/release.md leaves it to the authors."""
    parts = "Summary, Statement of need, State of the field, Software design"
    parts += ", Research impact statement, References"
    assert re.findall(r"^# (.*)$", PAPER, re.MULTILINE) == parts.split(", ")
    assert 750 <= len(PAPER.split()) <= 1750


def test_dois_agree_with_the_page_of_references() -> None:
    listed = (ROOT / "docs/references.md").read_text(encoding="utf-8")
    missing = [doi for doi in ENTRIES.values() if f"[doi:{doi}]" not in listed]
    assert not missing


def test_numbers_are_those_of_the_results() -> None:
    exact = parted(RESULTS)["## Filters beside the exact posterior"]
    ratios = [float(value) for value in re.findall(r"\| all \| `censored` \| (\d\.\d+)", exact)]
    assert f"{min(ratios):.3f} to {max(ratios):.3f}" in PAPER
    rightly, wrongly = re.findall(r"right class (\S+), wrong (\S+ of \d+)", RESULTS)[0]
    assert f"| {rightly}, {wrongly} |" in PAPER
    broken = parted(RESULTS)["## Attempts to break certificates"]
    rows = re.findall(r"^\| \d+ \| (\d+) \| (\d+) \| (\d+) \|", broken, re.MULTILINE)
    designs = sum(int(row[0]) for row in rows)
    assert (
        f"that broke one of {designs} certified designs | {sum(int(r[2]) for r in rows)} |" in PAPER
    )
