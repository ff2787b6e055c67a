"""Command line of the frozen answers."""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.results import commit

from .ask import Name, ask_cases, choose_cases
from .compare import BETTER, MOVED, SAME, WORSE, Case, Move, compare_case
from .families import FAMILIES
from .stored import Frozen, read_frozen, write_frozen

DONE, DIFFERS, REFUSED = 0, 1, 2


def main(words: Sequence[str]) -> int:
    """Return the exit code of the command.

    Args:
        words: of the command line.
    """
    options = _read_words(words)
    if options.write is not None and not options.write.strip():
        return _refuse("--write: the reason is missing. Say why the answers change")
    if options.jobs < 1:
        return _refuse(f"--jobs: expected 1 or more, found {options.jobs}")
    chosen, skipped = choose_cases(options.only)
    for family, why in skipped.items():
        sys.stderr.write(f"{family}: skipped, {why}\n")
    if not chosen and not skipped:
        families = ", ".join(FAMILIES)
        return _refuse(f"--only: no case matches {options.only!r}. The families are {families}")
    answers = ask_cases(chosen, options.jobs, _Progress(len(chosen)))
    if options.write is not None:
        return _freeze(answers, options.write.strip(), options.only)
    return _report(answers, skipped, options)


def _read_words(words: Sequence[str]) -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(prog="python -m tests.reference", description=__doc__)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--compare", action="store_true", help="print what moved; exit code 1: something did"
    )
    what.add_argument(
        "--write", metavar="REASON", help="freeze today's answers, and why they change"
    )
    parser.add_argument(
        "--only", metavar="PATTERN", default="*", help="a family, a case, or family/case"
    )
    parser.add_argument("--jobs", metavar="N", type=int, default=2, help="number of processes (2)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser.parse_args(words)


def _refuse(message: str) -> int:
    """Print why nothing is done, and return the exit code."""
    sys.stderr.write(f"reference: {message}\n")
    return REFUSED


class _Progress:
    """Line on stderr for each case that is done."""

    def __init__(self, total: int) -> None:
        self.total, self.done = total, 0

    def __call__(self, name: Name, case: Case) -> None:
        self.done += 1
        error = f", {case.fields['error']}" if "error" in case.fields else ""
        sys.stderr.write(f"{self.done}/{self.total} {'/'.join(name)}, {case.cpu} s{error}\n")


def _freeze(answers: dict[Name, Case], reason: str, pattern: str) -> int:
    """Write answers over the frozen ones of the same cases, and return the exit code."""
    try:
        of = commit()
    except (OSError, subprocess.CalledProcessError):
        return _refuse("--write: git names no commit here. Write from a checkout")
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    part = "" if pattern == "*" else f" (--only {pattern})"
    for family in {family: None for family, _ in answers}:
        fresh = {name: case for (of_case, name), case in answers.items() if of_case == family}
        frozen = read_frozen(family)
        kept = frozen.cases if part else {}
        write_frozen(family, Frozen([*frozen.written, [date, of, reason + part]], kept | fresh))
    return DONE


def find_moves(answers: dict[Name, Case], is_whole: bool) -> dict[str, list[list[Move]]]:
    """Return the moves of each case by family, none for a case that did not move.

    Args:
        answers: of today.
        is_whole: whether every case was asked, so that one that is not there any more is a move.
    """
    moves: dict[str, list[list[Move]]] = {}
    for family in {family: None for family, _ in answers}:
        frozen = read_frozen(family).cases
        fresh = {name: case for (of_case, name), case in answers.items() if of_case == family}
        moves[family] = []
        for name, case in fresh.items():
            title = f"{family}/{name}"
            known = name in frozen
            new = [Move(MOVED, title, "case", "none", "new")]
            moves[family].append(compare_case(title, frozen[name], case) if known else new)
        for name in set(frozen) - set(fresh) if is_whole else ():
            moves[family].append([Move(MOVED, f"{family}/{name}", "case", "frozen", "gone")])
    return moves


def sum_up(moves: list[Move]) -> str:
    """Return how a case moved: for the worse where any of its fields did."""
    found = {one.how for one in moves}
    return next((how for how in (WORSE, BETTER, MOVED) if how in found), SAME)


def _report(answers: dict[Name, Case], skipped: dict[str, str], options: Any) -> int:
    """Print what moved and a summary by family, and return the exit code."""
    moves = find_moves(answers, options.only == "*")
    summary = {}
    for family, every in moves.items():
        counts = Counter(sum_up(one) for one in every)
        cpu = sum(case.cpu for (of_case, _), case in answers.items() if of_case == family)
        shown = {how or "same": counts[how] for how in (SAME, BETTER, WORSE, MOVED)}
        summary[family] = {"n": len(every)} | shown | {"cpu": round(cpu, 1)}
    lines = [move for every in moves.values() for one in every for move in one]
    if options.json:
        rows = [move._asdict() for move in lines]
        found = {"moves": rows, "families": summary, "skipped": skipped}
        sys.stdout.write(f"{json.dumps(found, indent=1)}\n")
    else:
        texts = [*map(str, lines), *_summary_lines(summary, skipped)]
        sys.stdout.write("".join(f"{text}\n" for text in texts))
    return DIFFERS if lines else DONE


def _summary_lines(summary: dict[str, dict[str, float]], skipped: dict[str, str]) -> Iterator[str]:
    """Yield a row for each family and for their sum."""
    columns = ("n", "same", "better", "worse", "moved", "cpu")
    total = {key: sum(row[key] for row in summary.values()) for key in columns}
    yield f"{'family':12}" + "".join(f"{key:>8}" for key in columns) + " s"
    for family, row in (summary | {"all": total}).items():
        yield f"{family:12}" + "".join(f"{round(row[key], 1):>8}" for key in columns)
    for family, why in skipped.items():
        yield f"{family:12} skipped: {why}"
