"""Rows of Markdown tables, and the sections that tables stand in."""

from __future__ import annotations

import re


def row(*cells: str) -> str:
    """One row."""
    return f"| {' | '.join(cells)} |"


def head(*names: str) -> list[str]:
    """The names of the columns, and the line below them."""
    return [row(*names), "|" + "---|" * len(names)]


def parted(text: str) -> dict[str, str]:
    """The sections of a page by title, from `## ` on; what stands before the first is none."""
    _, *sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    return {section.partition("\n")[0]: section for section in sections}
