"""Files of the audit: its numbers as JSON, its variants as CSV, figures 1-8, its page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path

from undeadzone.report.html import Origin
from undeadzone.util.files import write_text
from undeadzone_paper.audit import Paper
from undeadzone_paper.page import write_audit_figures, write_audit_page
from undeadzone_paper.printed import Outcome, Variant


def write(
    paper: Paper,
    folder: Path,
    figures: bool = True,
    progress: Callable[[int], None] | None = None,
    origin: Origin | None = None,
) -> list[Path]:
    """Write paper.json and variants.csv, and figures 1-8 and report.html if wanted.

    Args:
        paper: the audit
        folder: folder of the files (created if needed)
        figures: whether figures and report are written, too
        progress: called with 1 for each figure written
        origin: data to compute the same again (None: unknown)

    Returns:
        The paths of the files.

    Raises:
        FileError: a file cannot be written
    """
    numbers = json.dumps(paper.summary(), indent=2, allow_nan=False) + "\n"
    written = [
        write_text(numbers, folder / "paper.json"),
        _write_variants(paper.variants, folder / "variants.csv"),
    ]
    if figures:
        pictures = write_audit_figures(paper, folder, progress)
        page = write_audit_page(paper, pictures, folder / "report.html", origin)
        written += [*pictures, page]
    return written


def _write_variants(outcomes: list[Outcome], path: Path) -> Path:
    """Write a line for each variant and its outcome."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow([*Variant._fields, *Outcome._fields[1:6]])
    writer.writerows([*outcome.variant, *outcome[1:6]] for outcome in outcomes)
    return write_text(text.getvalue(), path)
