"""Fields of an answer: the numbers and words of a command's `--json` in one flat table."""

from __future__ import annotations

import fnmatch
from typing import Any, NamedTuple

import numpy as np

Fields = dict[str, Any]

SKIPPED = {  # pattern of keys: why their values are no answer
    **dict.fromkeys(("schema", "*version", "*hash", "title", "numbers"), "of program and file"),
    **dict.fromkeys(("files", "written", "source"), "paths"),
    "claims.*.id": "part of the key",
    "*narrowed": "follows from the deviation and the declared range",
    "*noise_assumed*": "of the scenario",
    **dict.fromkeys(("boards.*.flash", "boards.*.measured"), "of the compilers that are here"),
    **dict.fromkeys(("*seconds", "leaderboard.*.cost", "results.*.cost"), "times"),
    **dict.fromkeys(
        (
            *("found", "reasons", "remarks", "*.reasons", "*.remarks", "cures", "why_unreadable"),
            *(f"claims.*.{key}" for key in ("where", "words", "claim", "quantity", "measured")),
            *(
                "claims.*.why",
                "boards.*.why",
                "letters",
                "proof",
                "answer.by",
                "answer.doubts",
                "answer.remedies",
            ),
        ),
        "prose, which may be worded anew",
    ),
    **dict.fromkeys(("answer.units*", "answer.never_tried"), "of the log, beside others of it"),
    **dict.fromkeys(
        ("*alternatives", "*levels", "*left_over", "*offsets", "*orders", "*stages"),
        "steps of today's identification, which another method has not",
    ),
}
INTERVALS = (  # keys of lists that are a value between its bounds; other lists of three are split
    *("right", "left", "width", "centre", "zone_width", "friction", "gap", "gain"),
    *("S", "J", "jump_of_reading", "lag", "rounding", "slope"),
)
MANY = 12  # entries from which a list is described by its extremes
DIGITS = 6
LEAST_ODDS = 0.01  # below which a word is left out: `compare.MISSING` is its value
BOUNDS = ("value", "low", "high")  # keys of an interval in a table


class Answer(NamedTuple):
    """Answer of a case.

    Attributes:
        fields: of the answer, by their keys in a row.
        truth: of those fields whose right value is known: a number, or the words that are right.
    """

    fields: Fields
    truth: Fields


def flatten(value: Any, key: str = "") -> Fields:
    """Return numbers and words by their keys, `a.b` for b in a. What is null is left out.

    Args:
        value: from JSON.
        key: of the value; "" for all.
    """
    name = key.rpartition(".")[2]
    if value is None or any(fnmatch.fnmatch(key, one) for one in SKIPPED):
        return {}
    if isinstance(value, dict):
        if tuple(value) == BOUNDS:
            return {key: [round_number(one) for one in value.values()]}
        rows = list(value.items())
        if name == "odds":
            rows = [(word, share) for word, share in rows if share >= LEAST_ODDS]
        return _merge(flatten(one, f"{key}.{word}" if key else word) for word, one in rows)
    if isinstance(value, list):
        return _flatten_list(value, key)
    return {key: round_number(value)}


def _merge(tables: Any) -> Fields:
    """Return the rows of all tables."""
    merged: Fields = {}
    for one in tables:
        merged |= one
    return merged


def _flatten_list(value: list[Any], key: str) -> Fields:
    """Return a list as it is; a long one by its count and its extremes."""
    if value and all(isinstance(one, dict) for one in value):
        if all("id" in one for one in value):
            return _merge(flatten(one, f"{key}.{one['id']}") for one in value)
        if len(value) <= MANY:
            return _merge(flatten(one, f"{key}.{k}") for k, one in enumerate(value))
        rows = [flatten(one) for one in value]
        columns = {name: [row.get(name) for row in rows] for name in rows[0]}
        return _merge(_describe(column, f"{key}.{name}") for name, column in columns.items())
    if any(isinstance(one, str) for one in value):
        return {key: ", ".join(map(str, value))}
    entries = np.ravel(np.array(value, dtype=object)).tolist()
    if len(entries) > MANY or any(isinstance(one, list | dict) for one in entries):
        return _describe(value, key)
    if len(entries) == len(BOUNDS) and key.rpartition(".")[2] not in INTERVALS:
        return _merge(flatten(one, f"{key}.{k}") for k, one in enumerate(entries))
    return {key: [round_number(one) for one in entries]}


def _describe(column: list[Any], key: str) -> Fields:
    """Return count and extremes of numbers; of others the count alone."""
    fields: Fields = {f"{key}.count": len(column)}
    try:
        numbers = np.array(column, dtype=float)
    except (TypeError, ValueError):
        return fields
    if numbers.size and np.isfinite(numbers).all():
        fields[f"{key}.lowest"] = round_number(float(numbers.min()))
        fields[f"{key}.highest"] = round_number(float(numbers.max()))
    return fields


def round_number(value: Any) -> Any:
    """Return a number of few digits; other values as they are."""
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
