"""Records of real machines and loops with labels: is a name right, or withheld?

RECORDS_FOLDER: the records, asked without options. The answers are as sure as the labels: files
`S_*.csv`, `isdb_S_*.csv` are loops whose valve sticks, `N_*.csv`, `isdb_N_*.csv` of valves that do
not; RECORDS_LABELS: a table of others (columns file, options, right; words that are right,
separated by spaces), by default `labels.csv` in the folder. Nothing of the records is kept. A
false name above .8 is an error: exit code 1.
"""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import undeadzone as uz
from benchmarks.markdown import head, row

NO_NAME = ("undecided", "unclear", "unreached", "refused")
SURE = 0.8  # odds above which no name may be wrong
ODDS_OF = {"operating_point": "none"}
STICKS = ("stiction", "input_play", "friction")
MOVES = ("none", "operating_point", "input_curve", "other", "external", "tight_tuning")


class Outcome(NamedTuple):
    """What `identify` made of a log.

    Attributes:
        kind: of the truth, or the record's name.
        verdict: the word.
        is_right: whether it is one of the truth's.
        false_odds: the largest odds of a word that is none of the truth's, named or not.
        holds: whether the interval of the width holds the truth's; None where none is given.
        seconds: CPU.
        why: first reason.
    """

    kind: str
    verdict: str
    is_right: bool
    false_odds: float
    holds: bool | None
    seconds: float
    why: str

    @property
    def is_wrong(self) -> bool:
        """Whether another name is given."""
        return not self.is_right and self.verdict not in NO_NAME


def ask(kind: str, right: tuple[str, ...], width: float | None, **log: Any) -> Outcome:
    """Ask `identify` of a log.

    Args:
        kind: of the truth.
        right: words that are right.
        width: of what they name; None: not asked.
        log: arguments of `identify`.
    """
    began = time.process_time()
    try:
        answer = uz.identify(**log)
    except uz.UndeadzoneError as error:
        spent = time.process_time() - began
        return Outcome(kind, "refused", False, 0.0, None, spent, str(error)[:120])
    if not hasattr(answer, "answer"):
        return Outcome(kind, "refused", False, 0.0, None, 0.0, "several outputs")
    odds, known = answer.numbers()["odds"], {ODDS_OF.get(word, word) for word in right}
    false = [share for word, share in odds.items() if word not in known]
    is_right, holds = answer.verdict in right, None
    if not is_right and ODDS_OF.get(answer.verdict, answer.verdict) not in (*NO_NAME, *odds):
        false.append(1.0)  # a name without odds is said for certain
    if is_right and width is not None and answer.width is not None:
        holds = bool(answer.width.low <= width <= answer.width.high)
    why = next(iter(answer.answer.reasons), "")
    spent = time.process_time() - began
    return Outcome(kind, answer.verdict, is_right, max(false, default=0.0), holds, spent, why)


def records(folder: Path) -> Iterator[Outcome]:
    """Yield the outcomes of the labelled records of a folder and its folders.

    Args:
        folder: where the records are.
    """
    named = os.environ.get("RECORDS_LABELS")
    labels = {}
    for table in [Path(named)] if named else folder.rglob("labels.csv"):
        with table.open(newline="") as file:
            labels |= {one["file"]: one for one in csv.DictReader(file)}
    for path in sorted(folder.rglob("*")):
        options: dict[str, Any] = {}
        name = path.name.removeprefix("isdb_")
        if path.name in labels:
            options = dict(pair.split("=", 1) for pair in labels[path.name]["options"].split())
            right = tuple(labels[path.name]["right"].split())
        elif name.startswith(("S_", "N_")) and path.suffix == ".csv":
            right = STICKS if name.startswith("S_") else MOVES
        else:
            continue
        yield ask(path.stem, right, None, log=path, **options)


def table_lines(every: list[Outcome]) -> list[str]:
    """Return the sums of outcomes."""
    count, holds = len(every), [one.holds for one in every if one.holds is not None]
    right = sum(one.is_right for one in every)
    wrong = [one for one in every if one.is_wrong]
    surely = sum(one.false_odds > SURE for one in wrong)
    printed = sum(one.false_odds > SURE and not one.is_right for one in every)
    names = (
        "logs",
        "right",
        "withheld",
        "wrong",
        f"wrong above {SURE}",
        "printed so",
        "widths held",
    )
    cells = [count, right, count - right - len(wrong), len(wrong), surely, printed]
    hits = f"{sum(holds)} of {len(holds)}"
    spent = float(np.mean([one.seconds for one in every])) if every else 0.0
    numbers = (*(str(cell) for cell in cells), hits, f"{spent:.1f}")
    return [*head(*names, "CPU s"), row(*numbers)]


def each(every: list[Outcome]) -> list[str]:
    """Return a row of each outcome."""
    lines = head("kind", "verdict", "", "false odds", "CPU s", "why")
    for one in every:
        mark = "right" if one.is_right else "WRONG" if one.is_wrong else ""
        numbers = (f"{one.false_odds:.2f}", f"{one.seconds:.1f}", one.why[:100])
        lines.append(row(one.kind, one.verdict, mark, *numbers))
    return lines


def table() -> str:
    """Return the section of RESULTS.md. Raise SystemExit: a false name."""
    every = list(records(Path(os.environ["RECORDS_FOLDER"])))
    lines = ["## Records", "", *table_lines(every), "", *each(every), ""]
    false = [one.kind for one in every if one.is_wrong and one.false_odds > SURE]
    if false:
        raise SystemExit("\n".join([*lines, f"false names: {', '.join(false)}"]))
    return "\n".join(lines)
