"""What an input may lead to: a result, or one line that says what is wrong with it."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from tools.fuzz.case import Case, End

NOT_A_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:nan|inf)(?![\w.])", re.IGNORECASE)
ANNOUNCED = "arena: "  # how many runs there are, before them
LEFT_OUT = "; it is left out"  # a package that is broken
HELP = {"--help", "--help-all"}  # words, whatever else is asked
LOGS = ("watch", "estimate")  # their table is on stderr, and a missing reading is NaN


def complaint(case: Case, end: End) -> str:
    """What is wrong with an end; empty if nothing is."""
    if end.left:
        return end.left
    if end.native:
        return "a library wrote past Python"
    if end.code not in (0, 1, 2):
        return f"exit code {end.code}"
    if "Traceback" in end.err or "Warning" in end.err:
        return "a traceback or a warning"
    if end.code == 2:
        return _of_refusal(case, end)
    return "" if case.command is None else _of_result(case.command, end)


def _of_refusal(case: Case, end: End) -> str:
    """What is wrong with a refusal."""
    lines = [line for line in end.err.splitlines() if not line.endswith(LEFT_OUT)]
    if len(lines) != 1:
        return f"a refusal of {len(lines)} lines"
    if not lines[0].startswith("undeadzone"):
        return "a refusal without its head"
    return _controls(lines[0])


def _of_result(command: Sequence[str], end: End) -> str:
    """What is wrong with a result."""
    streaming = any(word in command for word in LOGS)
    words = [line for line in end.err.splitlines() if not _is_announced(line)]
    if words and not streaming:
        return "words on stderr beside a result"
    if not HELP.isdisjoint(command):
        return _controls(end.out.replace("\n", ""))
    if "--json" in command:
        return _of_json(end.out, "watch" in command)
    if end.code == 0 and not streaming and NOT_A_NUMBER.search(end.out):
        return "success with NaN"
    return _controls(end.out.replace("\n", ""))


def _is_announced(line: str) -> bool:
    """Whether a line may stand on stderr beside a result."""
    return line.startswith(ANNOUNCED) or (line.endswith(LEFT_OUT) and line.isprintable())


def _of_json(text: str, lines: bool) -> str:
    """What is wrong with JSON."""

    def refuse(constant: str) -> None:
        raise ValueError(constant)

    try:
        for part in text.splitlines() if lines else [text]:
            json.loads(part, parse_constant=refuse)
    except ValueError:
        return "no JSON"
    return ""


def _controls(text: str) -> str:
    """Whether a text could steer a terminal."""
    return "" if text.isprintable() else "control characters"
