"""Times as people and loggers write them: ISO 8601, dates, times of day, seconds since 1970.

Numbers in a unit of time are none of these: see `names.SECONDS`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import date
from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats

DAY: Final = 86_400.0  # [s]
NOON: Final = 12  # [h]
LONGEST_NIGHT: Final = 3600.0  # [s] over midnight without a sample; else a time is wrong
CENTURY: Final = 2000  # of years that are written with two digits
FIRST_DAY: Final = date(1970, 1, 1).toordinal()
# Least times without a unit that count ms, us and ns since 1970.
SINCE_1970: Final = (1e11, 1e14, 1e17)
PARTS: Final = np.array([1.0, 1e-3, 1e-6, 1e-9])  # [s]
_DATE: Final = r"(?P<a>\d{1,4})(?P<dot>[-./])(?P<b>\d{1,2})(?P=dot)(?P<c>\d{1,4})"
_CLOCK: Final = (
    r"(?P<h>\d{1,2}):(?P<min>\d{2})(?::(?P<s>\d{2}(?:[.,]\d+)?))?\s*(?P<half>[AaPp][Mm])?"
    r"\s*(?P<zone>[Zz]|[-+]\d{2}:?\d{2})?"
)
STAMP: Final = re.compile(rf"(?=.)(?:{_DATE})?(?:(?:^|[Tt ]\s*){_CLOCK})?")
MONTHS: Final = (
    "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec"
    "|jan|feb|mär|apr|mai|jun|jul|aug|sep|okt|nov|dez"
)
_MONTH: Final = re.compile(rf"(?i)(?<=\d)[-/. ]*({MONTHS})[a-z]*[-/., ]*(?=\d)")


class Stamps(NamedTuple):
    """How the times of a log are written.

    Attributes:
        dated: whether with a date; else they are times of day.
        day_first: whether 3/4/2026 is in April; None: it is not known, and no such date is read.
    """

    dated: bool
    day_first: bool | None

    def seconds(self, text: str) -> float | None:
        """Return a time [s], since 1970 or since midnight; None if it cannot be read.

        Args:
            text: date and time of day as written; what has no zone counts as UTC.
        """
        found = _match_stamp(text)
        if found is None or (found["a"] is not None) != self.dated:
            return None
        day = _day(found, self.day_first) if self.dated else 0
        of_day = _of_day(found)
        return None if day is None or of_day is None else day * DAY + of_day


def stamps_of(texts: Iterable[str]) -> Stamps | None:
    """Return the notation of times; None if they cannot be read.

    Args:
        texts: the first ones.
    """
    found = list(filter(None, map(_match_stamp, texts)))
    if not found:
        return None
    return Stamps(found[0]["a"] is not None, _find_day_first(found))


def _find_day_first(found: list[re.Match[str]]) -> bool | None:
    """Return whether the day stands ahead of the month; None: it is not known.

    A number above 12 is a day. Where none is, the dates of many times follow one another.

    Args:
        found: times.
    """
    dates = {one.group("a", "dot", "b", "c"): one for one in found if one["a"] is not None}
    for a, _, b, _ in dates:
        if max(int(a), int(b)) > NOON:
            return int(a) > NOON
    if 2 * len(dates) > len(found):
        return None
    gaps = [_longest_gap(dates.values(), is_first) for is_first in (True, False)]
    return gaps[0] <= gaps[1] if min(gaps) <= 1 else None


def _longest_gap(dates: Iterable[re.Match[str]], day_first: bool) -> float:
    """Return the longest time between two dates [days]."""
    days = np.unique(np.array([_day(one, day_first) for one in dates], float))
    return max(np.diff(days), default=0.0)


def _match_stamp(text: str) -> re.Match[str] | None:
    """Return the parts of a time; a month by its name, as in 12-Jun-24, is a number there."""
    text = text.strip()
    return STAMP.fullmatch(text) or STAMP.fullmatch(
        _MONTH.sub(lambda one: f".{MONTHS.index(one[1].lower()) // 4 % 12 + 1}.", text)
    )


def is_ambiguous(text: str, stamps: Stamps) -> bool:
    """Return whether the month of a date is ambiguous, as in 3/4/2026."""
    found = _match_stamp(text)
    if found is None or found["a"] is None or stamps.day_first is not None:
        return False
    return found["dot"] != "." and len(found["a"]) < 4


def to_seconds(t: Floats, unit: float | None) -> Floats:
    """Return times in seconds: as large as ms, us or ns since 1970 are, they are these.

    Args:
        t: times (N).
        unit: length of their unit [s], 1 without one; None: they count samples, and stay.
    """
    if unit == 1.0:
        return t * PARTS[np.digitize(np.abs(t), SINCE_1970)]
    return t * (unit or 1.0)


def over_midnight(t: Floats, before: float) -> Floats:
    """Return times of day that go on after midnight [s].

    Args:
        t: times of day (N) [s]; NaN if one is missing.
        before: the last time before these [s], days counted; NaN: there is none.
    """
    known = np.isfinite(t)
    falls = np.diff(t[known], prepend=before % DAY) < LONGEST_NIGHT - DAY
    out = t.copy()
    out[known] += DAY * (np.nan_to_num(before // DAY) + np.cumsum(falls))
    return out


def _day(found: re.Match[str], day_first: bool | None) -> int | None:
    """Return days since 1970; None for an impossible or ambiguous date."""
    if len(found["a"]) == 4:
        order = "abc"
    elif found["dot"] == "." or day_first:
        order = "cba"
    elif day_first is None:
        return None
    else:
        order = "cab"
    year, month, day = (int(found[key]) for key in order)
    try:
        return date(year + CENTURY * (year < 100), month, day).toordinal() - FIRST_DAY
    except ValueError:
        return None


def _of_day(found: re.Match[str]) -> float | None:
    """Return seconds since midnight, UTC if a zone is named; None if there is no such
    time.
    """
    if found["h"] is None:
        return 0.0
    hour = int(found["h"])
    minute = int(found["min"])
    second = float((found["s"] or "0").replace(",", "."))
    if found["half"]:
        if not 1 <= hour <= NOON:
            return None
        hour = hour % NOON + (NOON if found["half"].lower() == "pm" else 0)
    if hour > 23 or minute > 59 or second >= 61:
        return None
    return 3600.0 * hour + 60.0 * minute + second - _zone(found["zone"])


def _zone(text: str | None) -> float:
    """How far a zone's clocks are ahead of UTC [s]."""
    if text is None or text in "Zz":
        return 0.0
    return 3600.0 * int(text[:3]) + 60.0 * int(text[0] + text[-2:])
