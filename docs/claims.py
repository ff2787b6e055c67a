"""Writes docs/paper*.md, and what other pages say of the paper's claims, from the audit.

A page that speaks of a claim has two marks, `<!-- claim KEY -->` and `<!-- /claim -->`; what stands
between them is written here, and nobody else says whether a claim holds. KEY `all` counts them,
`letters` is the table of letters.

Run: python docs/claims.py
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Final

from undeadzone_paper import Paper, audit
from undeadzone_paper.claims import (
    HOW,
    Claim,
    claims_on,
    value_text,
    verdict_counts_text,
)
from undeadzone_paper.equations import (
    ASSUMPTIONS,
    DIAGRAMS,
    FIGURES,
    LETTERS_HEAD,
    STAND_INS,
    read_letters,
)
from undeadzone_paper.theorem import DEFINITION, count_theorem

ROOT: Final = Path(__file__).parents[1]
DOCS: Final = ROOT / "docs"
NUMBERED: Final = "paper_numbers.md"  # page of equations, figures and letters
REPAIRED: Final = "paper_repaired.md"  # page of the statements that hold after repair
MARKED: Final = re.compile(r"(<!-- claim ([\w-]+) -->\n).*?(?=<!-- /claim -->)", re.S)
WIDTH: Final = 100
BAR: Final = "\u2223"  # in place of | within a cell
ORDER: Final = ("holds", "holds after repair", "does not hold", "not shown")
HEAD: Final = """# The paper's claims

*Which statements of the paper hold if they are computed?*

`undeadzone paper` computes its sentences, equations (1)-(42) and Theorem 4.1, and draws figures 1
to 8 as printed and repaired, from equal starts. `python docs/claims.py` writes this page, [the
statements that hold after repair](paper_repaired.md) and [the numbers](paper_numbers.md) from the
results. The words, limits and reasons stand in `src/undeadzone_paper/claims.toml`, the runs in
`runs.toml` beside it, the computations in `trials.py` and `both_sides.py`.

To run the paper's methods with other numbers, write `observer.method = "printed"` and
`controller.method = "printed"`, law (29), or `"pd"`, law (42), into a scenario:
`examples/paper_printed.toml` has the paper's own. `time undeadzone paper` shows its effort: 16 CPU
seconds, of which figures take four. `python -m benchmarks paper_recomputed` recomputes ten
verdicts, drawn by a seed, by a script that shares no code with the audit.
"""
HEAD_REPAIRED: Final = """# The paper's claims that hold after repair

*Which statements of the paper hold once their equations are repaired?*

[The paper's claims](paper.md) has the others, and how all were computed.
"""
NUMBERS: Final = """# The paper's equations, figures and letters

*Which of its equations and figures were computed, and what was found?*

[The paper's claims](paper.md) has the statements, and how all were computed.

## By number

Both sides of each equation are computed along a run, and the largest difference is shown: as
printed along the run of Theorem 4.1 (law (29), d - d^ given, started at x1 = 5 with d^ = d), mended
along the repaired run. A dash means that no repair is needed, or that none exists.
"""
SHAPES: Final = """Where printed shapes do not agree, the least that makes them agree stands in:
"""
LETTERS: Final = """## Letters

The paper's letters, those of this package, the keys of a scenario, and the fields of exported C
code (`in` is read, `out` is written).
"""


def wrapped(text: str, indent: str = "") -> str:
    """A paragraph in lines; none begins with a sign that would make it a list or a quotation."""
    kept = re.sub(r" ([-+<>=|]) ", "\u00a0\\1\u00a0", text)
    lines = textwrap.wrap(
        kept, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines).replace("\u00a0", " ") + "\n"


def capital(words: str) -> str:
    """Words as a sentence begins."""
    return words[0].upper() + words[1:]


def escape_brackets(quotation: str) -> str:
    """Return a quotation in which the paper's references, such as [16], are no links."""
    return quotation.replace("[", "\\[").replace("]", "\\]")


def page_of(claim: Claim) -> str:
    """Return the page that describes a claim."""
    return REPAIRED if claim.verdict == "holds after repair" else "paper.md"


def pages(paper: Paper) -> dict[Path, str]:
    """Return docs/paper.md and its two companions."""
    ranked = sorted(paper.claims, key=lambda claim: ORDER.index(claim.verdict))
    parts = {
        "paper.md": [HEAD, wrapped(f"{verdict_counts_text(paper.claims)} {HOW}")],
        REPAIRED: [HEAD_REPAIRED],
        NUMBERED: [*numbered(paper), LETTERS, letters_table()],
    }
    for verdict, group in groupby(ranked, key=lambda claim: claim.verdict):
        claims = list(group)
        parts[page_of(claims[0])].append(f"## {capital(verdict)}\n")
        parts[page_of(claims[0])] += [section(claim) for claim in claims]
    return {DOCS / name: "\n".join(texts) for name, texts in parts.items()}


def numbered(paper: Paper) -> list[str]:
    """The paper's equations, figures, assumptions and theorem, each with what was found."""
    texts = [claim.text for claim in paper.claims]
    places = {claim.text.id: page_of(claim) for claim in paper.claims}
    equations = []
    for entry in paper.summary()["equations"]:
        equations.append(
            (
                f"({entry['number']})",
                entry["what"],
                entry["compares"],
                number(entry["printed"]),
                number(entry["mended"]),
                f"{entry['status']}: {entry['reason']}",
                links(entry["claims"], places),
            )
        )
    figures = [
        (f"figure {key}", words, files(key), links(claims_on("figure", key, texts), places))
        for key, words in {**DIAGRAMS, **FIGURES}.items()
    ]
    assumed = [
        (f"A{key}", words, "", links(claims_on("assumption", key, texts), places))
        for key, words in ASSUMPTIONS.items()
    ]
    counts = [tuple(map(str, count)) for count in count_theorem(paper.evidence.theorem)]
    heads = (
        ("equation", "what", "both sides", "as printed", "mended", "used", "found"),
        ("number", "what", "files", "found"),
        ("d - d^", "law", "plant", "readings", "diverge", "end right", "leave d^ = d"),
    )
    return [
        NUMBERS,
        table(heads[0], equations),
        SHAPES,
        table(("equation", "stand-in"), STAND_INS.items()),
        table(heads[1], figures + assumed),
        "### Theorem 4.1 with its own law\n",
        "As printed: diverges; repaired: [proved to the bits](proof.md) of the C that runs.\n",
        wrapped(DEFINITION),
        table(heads[2], counts),
    ]


def files(figure: int) -> str:
    """The files that `undeadzone paper` writes for a figure of the paper."""
    if figure in DIAGRAMS:
        return f"figure_{figure}.svg"
    beside = ", tracking_2sin.svg" * (figure in (3, 4))
    return f"figure_{figure}.svg, figure_{figure}_2sin.svg{beside}"


def number(value: float | None) -> str:
    """A difference in three digits, 0 where it is rounding."""
    return "–" if value is None else value_text(value)


def links(ids: list[str], places: dict[str, str]) -> str:
    """Return links to claims on their pages."""
    return ", ".join(f"[{name}]({places[name]}#{name})" for name in ids)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown, in which a bar within a cell is none of its own."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', BAR) for cell in line)} |\n" for line in lines)


def letters_table() -> str:
    """The paper's letters."""
    rows = (
        (paper, meaning, ours, code(key), code(field))
        for paper, meaning, ours, key, field in read_letters()
    )
    return table(LETTERS_HEAD, rows)


def code(names: str) -> str:
    """Names set as code."""
    return ", ".join(f"`{name}`" for name in names.split(", ") if name)


def section(claim: Claim) -> str:
    """What is claimed, in whose words, what was measured, and why it came out so."""
    text = claim.text
    return "\n".join(
        [
            f"### {text.id}\n",
            wrapped(f"{text.claim}. The paper, {text.where}: “{escape_brackets(text.words)}”."),
            wrapped(f"*{capital(claim.verdict)}.* {text.why}"),
            wrapped(f"Measured: {claim.numbers_text}."),
        ]
    )


def line(claim: Claim, path: Path) -> str:
    """What another page says of a claim: an entry of a list.

    Args:
        claim: that is spoken of
        path: of that page
    """
    link = f"{'../' * (len(path.relative_to(DOCS).parts) - 1)}{page_of(claim)}#{claim.text.id}"
    told = f"“{claim.text.claim}”, {claim.text.where}: [{claim.verdict}]({link})."
    return wrapped(f"* {told} {claim.text.why}", "  ")


def filled(path: Path, paper: Paper) -> str:
    """A page with what stands between its marks."""
    claims = {claim.text.id: claim for claim in paper.claims}

    def told(mark: re.Match[str]) -> str:
        key = mark[2]
        if key == "letters":
            return f"{mark[1]}\n{letters_table()}\n"
        if key == "all":
            return mark[1] + wrapped(verdict_counts_text(paper.claims))
        return mark[1] + line(claims[key], path)

    return MARKED.sub(told, path.read_text(encoding="utf-8"))


def marked() -> list[Path]:
    """The pages that have marks."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [path for path in pages if MARKED.search(path.read_text(encoding="utf-8"))]


def main() -> None:
    """Write the pages."""
    paper = audit()
    for path, text in pages(paper).items():
        path.write_text(text, encoding="utf-8")
    for path in marked():
        path.write_text(filled(path, paper), encoding="utf-8")


if __name__ == "__main__":
    main()
