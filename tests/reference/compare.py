"""Answers of today beside the frozen ones: what moved, for better or for worse."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from .fields import Fields

BETTER, WORSE, MOVED, SAME = "better", "worse", "moved", ""
# Fields, relative, absolute; the first row that matches. Intervals: a tenth of their width.
TOLERANCES = (
    ("odds.*", 0.0, 0.02),
    ("false_odds", 0.0, 0.02),
    ("*largest_rise_of_V", 0.1, 1e-9),  # rounding alone, where the certificate holds
    ("*integration_error", 0.1, 1e-9),
    ("*.std.*", 0.01, 1e-12),
    ("*float_against_double*.error", 0.5, 1e-7),  # the largest of many roundings
    ("*", 1e-3, 1e-9),
)
SHARE_OF_INTERVAL = 0.1
MISSING = {"odds.*": 0.0}  # value of fields that are left out; of others None
RANKS: dict[str, tuple[Any, ...]] = {  # from worst to best
    "word": ("wrong", "withheld", "right"),
    "holds": (False, None, True),
}
VERDICTS = ("error", "exit", "word", "verdict")  # where one moves, numbers are of something else
LEAST_INTERVAL = 3  # value, low, high


class Case(NamedTuple):
    """Case as a file keeps it.

    Attributes:
        fields: of the answer.
        truth: of some of them.
        cpu: time that it took [s].
    """

    fields: Fields
    truth: Fields
    cpu: float = 0.0


class Move(NamedTuple):
    """Field that moved.

    Attributes:
        how: better, worse or moved.
        case: its family and name.
        field: its key.
        before, after: values.
        truth: that is known; None: none is.
    """

    how: str
    case: str
    field: str
    before: Any
    after: Any
    truth: Any = None

    def __str__(self) -> str:
        """Return the line that is printed."""
        known = "" if self.truth is None else f", truth {_show(self.truth)}"
        change = f"{_show(self.before)} -> {_show(self.after)}"
        return f"{self.how:6}  {self.case}  {self.field}: {change}{known}"


def _show(value: Any) -> str:
    """Return a value as a line has it."""
    if isinstance(value, list):
        return f"[{', '.join(_show(one) for one in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def compare_case(name: str, before: Case, after: Case) -> list[Move]:
    """Return what moved in a case.

    Args:
        name: its family and name.
        before: frozen.
        after: of today.
    """
    moves = []
    for field in sorted({*before.fields, *after.fields}):
        old, new = (_value(case.fields, field) for case in (before, after))
        truth = after.truth.get(field)
        how = judge(field, old, new, truth, before.fields.get("word") == "right")
        if how:
            moves.append(Move(how, name, field, old, new, truth))
    failed = "error" in before.fields or "error" in after.fields
    if before.truth != after.truth and not failed:
        moves.append(Move(MOVED, name, "truth", before.truth, after.truth))
    verdicts = [one for one in moves if one.field in VERDICTS]
    numbers = len(moves) - len(verdicts)
    if verdicts and numbers:
        return [*verdicts, Move(MOVED, name, "other fields that moved", 0, numbers)]
    return verdicts or moves


def _value(fields: Fields, field: str) -> Any:
    """Return a field, or what it means that it is left out."""
    if field in fields:
        return fields[field]
    return next((one for key, one in MISSING.items() if fnmatch.fnmatch(field, key)), None)


def judge(field: str, before: Any, after: Any, truth: Any = None, is_right: bool = True) -> str:
    """Return how a field moved; "" if it did not.

    Args:
        field: its key.
        before: its frozen value.
        after: its value today.
        truth: its right value; None: not known.
        is_right: whether the verdict is, without which a truth is of something else.
    """
    if before == after:
        return SAME
    ranks = RANKS.get(field, ())
    if before in ranks and after in ranks:
        return BETTER if ranks.index(after) > ranks.index(before) else WORSE
    if field == "error" and None in (before, after):
        return BETTER if after is None else WORSE
    old, new = _numbers(before), _numbers(after)
    if old is not None and new is not None and len(old) == len(new):
        spans = zip(old, new, _tolerances(field, old), strict=True)
        if all(abs(one - other) <= most or one == other for one, other, most in spans):
            return SAME
    number = isinstance(truth, int | float) and is_right
    return _judge_number(old, new, float(truth)) if number else MOVED


def _numbers(value: Any) -> list[float] | None:
    """Return numbers as a list, open ends of an interval as infinite; None: they are none."""
    if isinstance(value, list) and is_interval(value):
        ends = (-math.inf, math.inf)
        low, high = (end if one is None else one for one, end in zip(value[1:], ends, strict=True))
        return [value[0], low, high]
    each = value if isinstance(value, list) else [value]
    numeric = all(isinstance(one, int | float) and not isinstance(one, bool) for one in each)
    return [float(one) for one in each] if each and numeric else None


def is_interval(value: Sequence[Any]) -> bool:
    """Return whether a list is a value between its bounds."""
    if len(value) != LEAST_INTERVAL or not isinstance(value[0], int | float):
        return False
    low = -math.inf if value[1] is None else value[1]
    high = math.inf if value[2] is None else value[2]
    return bool(low <= value[0] <= high and low < high)


def _tolerances(field: str, values: list[float]) -> list[float]:
    """Return the tolerance of each number of a field."""
    if is_interval(values) and math.isfinite(values[2] - values[1]):
        return [SHARE_OF_INTERVAL * (values[2] - values[1])] * len(values)
    relative, absolute = next(row[1:] for row in TOLERANCES if fnmatch.fnmatch(field, row[0]))
    sizes = [abs(one) if math.isfinite(one) else 0.0 for one in values]
    return [max(relative * size, absolute) for size in sizes]


def _judge_number(before: list[float] | None, after: list[float] | None, truth: float) -> str:
    """Return whether a number came nearer to its truth; an interval first has to hold it."""
    old, new = _merit(before, truth), _merit(after, truth)
    if new == old:
        return MOVED
    return BETTER if new > old else WORSE


def _merit(values: list[float] | None, truth: float) -> tuple[float, float]:
    """Return what is larger for a better number: none is better than a false interval."""
    if values is None:
        return (0.0, 0.0)
    error = abs(values[0] - truth)
    if not is_interval(values):
        return (1.0, -error)
    holds = 1.0 if values[1] <= truth <= values[2] else -1.0
    return (holds, -error - (values[2] - values[1]) / 2)
