"""Logs rebuilt after public reports: is the name right, without any option?

REPORTS_FIRST: the first seed (1); REPORTS_SEEDS: of each kind (1); REPORTS_KINDS: kinds, separated
by semicolons. A name is wrong if the truth has another, and surely wrong with odds above 0.9.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import undeadzone as uz
from benchmarks.identify.logs.public_reports import KINDS, Report
from benchmarks.markdown import head, row

SURE = 0.9
NO_NAME = ("undecided", "unclear", "refused")


class Outcome(NamedTuple):
    """Answer of `identify` to a report's log.

    Attributes:
        verdict: the word; refused: an error.
        word: right, withheld or wrong.
        odds: of the verdict's word; 0 without.
        width: as found, with its interval; None: not given.
        holds: whether it holds the truth; None where either is missing.
        seconds: CPU.
        why: first reason, or the error.
    """

    verdict: str
    word: str
    odds: float
    width: tuple[float, float, float] | None
    holds: bool | None
    seconds: float
    why: str


def outcome_of(report: Report, path: Path) -> Outcome:
    """Return the answer of `identify` to a report's file, without any option.

    Args:
        report: the log with its truth.
        path: where the file goes.
    """
    pd.DataFrame(report.columns).to_csv(path, index=False)
    began = time.process_time()
    try:
        found = uz.identify(str(path))
    except uz.InputError as error:
        spent = time.process_time() - began
        return Outcome("refused", "withheld", 0.0, None, None, spent, str(error).split(": ", 1)[1])
    spent = time.process_time() - began
    verdict, numbers = found.verdict, found.numbers()
    is_motion = isinstance(found, uz.IdentifiedMotion)
    gap = found.answer.gap if is_motion else found.width
    width = None if gap is None or verdict in NO_NAME else (gap.value, gap.low, gap.high)
    word = "right" if verdict in report.right else "withheld" if verdict in NO_NAME else "wrong"
    holds = None
    if width is not None and report.width is not None and word == "right":
        holds = bool(width[1] <= report.width <= width[2])
    reasons = numbers.get("reasons") or [""]
    odds = max((numbers.get("odds") or {}).values(), default=0.0)
    return Outcome(verdict, word, odds, width, holds, spent, reasons[0])


def table() -> str:
    """Return the section of RESULTS.md."""
    first, count = (int(os.environ.get(f"REPORTS_{key}", 1)) for key in ("FIRST", "SEEDS"))
    requested = os.environ.get("REPORTS_KINDS", ";".join(KINDS)).split(";")
    lines = head("report", "truth", "verdicts", "right", "withheld", "wrong (> .9)", "width held",
                 "CPU s")  # fmt: skip
    every = []
    with tempfile.TemporaryDirectory() as folder:
        for name in requested:
            reports = [
                KINDS[name](np.random.default_rng([list(KINDS).index(name), 25, first + k]))
                for k in range(count)
            ]
            own = [outcome_of(one, Path(folder) / "report.csv") for one in reports]
            every += own
            words, holds = [one.word for one in own], [one.holds for one in own]
            known = [one for one in holds if one is not None]
            wrong = [one for one in own if one.word == "wrong"]
            sure = sum(one.odds > SURE for one in wrong)
            lines.append(
                row(
                    name,
                    " or ".join(reports[0].right),
                    ", ".join(one.verdict for one in own),
                    str(words.count("right")),
                    str(words.count("withheld")),
                    f"{len(wrong)} ({sure})",
                    f"{sum(known)} of {len(known)}" if known else "-",
                    f"{np.median([one.seconds for one in own]):.1f}",
                )
            )
    words = [one.word for one in every]
    sure = sum(one.word == "wrong" and one.odds > SURE for one in every)
    known = [one.holds for one in every if one.holds is not None]
    total = (
        f"{words.count('right')} of {len(every)} right, {words.count('withheld')} withheld, "
        f"{words.count('wrong')} wrong, {sure} of these with odds above {SURE:g}; the width lies in"
        f" its interval in {sum(known)} of {len(known)}."
    )
    about = (
        f"{len(requested)} kinds of public reports, rebuilt with numbers of our own, {count} of "
        f"each from seed {first}, given to `identify` as a file without any option."
    )
    return "\n".join(["## Reports", "", about, "", *lines, "", total, ""])
