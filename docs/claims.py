"""Writes docs/paper.md, and what other pages say of the paper's claims, from the audit.

A page that speaks of a claim has two marks, `<!-- claim KEY -->` and `<!-- /claim -->`; what stands
between them is written here, and nobody else says whether a claim holds. KEY `all` counts them.

Run: python docs/claims.py
"""

from __future__ import annotations

import re
import textwrap
from itertools import groupby
from pathlib import Path
from typing import Final

from undeadzone_paper import Paper, audit
from undeadzone_paper.claims import HOW, Claim, verdict_counts_text

ROOT: Final = Path(__file__).parents[1]
PAGE: Final = ROOT / "docs" / "paper.md"
MARKED: Final = re.compile(r"(<!-- claim ([\w-]+) -->\n).*?(?=<!-- /claim -->)", re.S)
WIDTH: Final = 100
ORDER: Final = ("holds", "holds after repair", "does not hold", "not shown")
HEAD: Final = """# The paper's claims

What does the paper claim, and what is left of it when it is computed? `undeadzone paper` computes
all of it, draws figures 3 to 8 as printed and repaired, and places every equation in the code;
`python docs/claims.py` writes this page from its numbers. The words, limits and reasons stand in
`src/undeadzone_paper/claims.toml`, the computations in `trials.py` beside it.
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


def page(paper: Paper) -> str:
    """docs/paper.md."""
    ranked = sorted(paper.claims, key=lambda claim: ORDER.index(claim.verdict))
    parts = [HEAD, wrapped(f"{verdict_counts_text(paper.claims)} {HOW}")]
    for verdict, claims in groupby(ranked, key=lambda claim: claim.verdict):
        parts.append(f"## {capital(verdict)}\n")
        parts += [section(claim) for claim in claims]
    return "\n".join(parts)


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
    link = f"{'../' * (len(path.relative_to(PAGE.parent).parts) - 1)}{PAGE.name}#{claim.text.id}"
    told = f"“{claim.text.claim}”, {claim.text.where}: [{claim.verdict}]({link})."
    return wrapped(f"* {told} {claim.text.why}", "  ")


def filled(path: Path, paper: Paper) -> str:
    """A page with what stands between its marks."""
    claims = {claim.text.id: claim for claim in paper.claims}

    def told(mark: re.Match[str]) -> str:
        key = mark[2]
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
    PAGE.write_text(page(paper), encoding="utf-8")
    for path in marked():
        path.write_text(filled(path, paper), encoding="utf-8")


if __name__ == "__main__":
    main()
