"""What is wrong with a text that is no TOML: the line, and what to write instead."""

from __future__ import annotations

import re

from undeadzone.support.arrays import matlab

# What people write, by what such a line holds, and what to write instead.
HABITS = (
    (r"[\u2018\u2019\u201c\u201d\u201e]", 'write straight quotes, "..."'),
    (r"^\s*(%|//|;|/\*)", "remarks begin with #"),
    (r"=\s*-?\d+,\d+\s*(#|$)", "write a decimal point, 0.01"),
    (r"=\s*[-+]?(\.\d|\d+\.(\D|$))", "write a digit on both sides of the point, 0.5"),
    (r"=\s*[-+]?\d+\s*[/*^]", "write the number itself; formulas stand in plant.f alone"),
    (r"=[^#\"']*;\s*(#|$)", "leave the ; out"),
    (r"^\s*[\w.]+\s*:\s", "write = in place of :"),
    (r"=\s*(None|null|NULL|nil)\b", "leave the key out"),
    (r"=\s*(True|False|TRUE|FALSE|yes|no|on|off)\b", "write true or false"),
    (r"=\s*[-+]?[\d.]+(e[-+]?\d+)?\s*[a-zA-Z]+", "write the number alone; [units] has the units"),
    (r"=\s*[A-Za-z]", "put words in quotes"),
)
OPEN = r"^\s*([\w.]+)\s*=\s*\[\s*[-+.\de]+(\s+[-+.\de]+)+\s*(#.*|%.*)?$"  # A = [0 1


def invalid_toml(text: str, message: str) -> str:
    """The message about a text that is no TOML, with its line.

    Args:
        text: that was read.
        message: of tomllib.
    """
    said, _, where = message.partition(" (at ")
    place = re.match(r"line (\d+), column (\d+)", where)
    if place is None:
        return f"not valid TOML: {message}"
    number = int(place[1])
    lines = text.splitlines()
    line = lines[number - 1].strip() if number <= len(lines) else ""
    full = f"line {number}, column {place[2]}: not valid TOML: {said[:1].lower()}{said[1:]}"
    if line:
        full += f" in {line!r:.80}"
    return full + (_as_lists(line) or _habit(line))


def _as_lists(line: str) -> str:
    """How a line in MATLAB's notation, A = [0 1; -1 -2], is written in TOML; else nothing."""
    assignment = re.match(r"\s*([\w.]+)\s*=\s*(\[[^\[\]\"=]*\])\s*;?\s*(#.*|%.*)?$", line)
    if assignment is None:
        return ""
    try:
        rows = matlab(assignment[2])
    except ValueError:
        return ""
    listed = [f"[{', '.join(f'{entry:g}' for entry in row)}]" for row in rows]
    return f"; write {assignment[1]} = [{', '.join(listed)}], or put MATLAB's matrix in quotes"


def _habit(line: str) -> str:
    """What to write in place of what a line holds; nothing where that is not known."""
    if re.match(OPEN, line):
        return "; write [[0, 1], [-1, -2]]: rows in brackets, commas between numbers"
    for pattern, advice in HABITS:
        if re.search(pattern, line):
            return f"; {advice}"
    return ""
