"""Foreign text made safe to print: it cannot steer a terminal or begin a line."""

from __future__ import annotations

import difflib
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any, Final

# Controls, invisible formats (which also turn the direction of writing), half characters, line and
# paragraph separators.
UNPRINTABLE: Final = ("Cc", "Cf", "Cs", "Zl", "Zp")
HALF_95: Final = 1.959964  # standard deviations in half of a 95 % interval
LEAST_MASS: Final = 1e-9  # of a Gaussian inside of a range, below which its quantiles mean nothing
_CONDITIONAL_LINE: Final = re.compile(r"^@\?([a-z_]+)@(.*\n)", re.MULTILINE)
_WORD: Final = re.compile("@([a-z_]+)@")


def suggest_name(name: str, known: Iterable[str], otherwise: str, likeness: float = 0.6) -> str:
    """Return the question for the nearest of the known names, or all of them.

    Args:
        name: that is none of them. Upper and lower case count as the same.
        known: the names.
        otherwise: words ahead of all names.
        likeness: from which on a name may be meant.
    """
    lower = {each.lower(): each for each in known}
    near = difflib.get_close_matches(name.lower(), lower, 1, likeness)
    if near:
        return f"Did you mean {lower[near[0]]!r}?"
    return f"{otherwise} {', '.join(lower.values()) or 'none'}"


def escape_controls(text: str) -> str:
    r"""Return a text with every control character replaced by its escape, such as \\x1b or
    \\n.
    """
    return text if text.isprintable() else "".join(map(_escape_control, text))


def to_one_line(text: str) -> str:
    """Return a printable text on one line. Line ends and runs of blanks become single blanks."""
    return escape_controls(" ".join(text.split()))


def label_with_unit(words: str, unit: str) -> str:
    """Return words and unit in brackets. The unit 1 is left out."""
    return words if unit == "1" else f"{words} [{unit}]"


def append_unit(words: str, unit: str) -> str:
    """Return words followed by the unit. The unit 1 is left out."""
    return words if unit == "1" else f"{words} {unit}"


def count_noun(number: int, what: str) -> str:
    """Return a count with its noun: "1 run", "2 runs"."""
    return f"{number:,} {what}{'s' * (number != 1)}"


def interval_95(
    value: float, std: float, least: float = -math.inf, most: float = math.inf
) -> tuple[float, float]:
    """Return the 95 % interval of a Gaussian estimate that is known to lie in a range.

    These are the quantiles of the Gaussian cut to the range, made to hold the value itself. If the
    range excludes the Gaussian, no quantile is left and the interval is the range.

    Args:
        value: the estimate.
        std: its standard deviation.
        least, most: ends of the range.

    >>> interval_95(1.0, 0.1)
    (0.804, 1.196)
    >>> low, high = interval_95(1.0, 0.577, 0.0, 2.0)
    >>> round(low, 2), round(high, 2)
    (0.12, 1.88)
    """
    half = HALF_95 * std
    low = value - half
    high = value + half
    if least <= low and high <= most:
        return low, high
    if math.isinf(std):
        return least, most
    from statistics import NormalDist

    unit = NormalDist()
    below = unit.cdf((least - value) / std)
    above = unit.cdf((most - value) / std)
    if above - below < LEAST_MASS:
        return least, most
    quantiles = [unit.inv_cdf(below + share * (above - below)) for share in (0.025, 0.975)]
    low, high = (value + std * quantile for quantile in quantiles)
    inside = min(max(value, least), most)
    return max(least, min(low, inside)), min(most, max(high, inside))


def format_with_interval(
    value: float | None, std: float | None, least: float = -math.inf, most: float = math.inf
) -> str:
    """Return a value and its 95 % interval as text, to the second digit of the deviation.

    Args:
        value: the number (None: there is none).
        std: its standard deviation (None: not known).
        least, most: ends of the range in which it is known to lie.
    """
    if value is None or std is None or not math.isfinite(value):
        return f"{_format_4_digits(value)} (no interval)"
    if std == 0.0:
        return _format_4_digits(value)
    place = 1 - math.floor(math.log10(std)) if std < math.inf else -1
    form = ".4g" if place < 0 or abs(value) < 1e-4 or place > 12 else f".{place}f"
    return bracket_interval(value, *interval_95(value, std, least, most), form)


def bracket_interval(value: float, low: float, high: float, form: str) -> str:
    """Return a value and its interval: 0.98 [0.55, 1.41]. `form` is that of `format`."""
    return f"{value:{form}} [{low:{form}}, {high:{form}}]"


def _format_4_digits(value: float | None) -> str:
    """Return a number to four digits as text, nan for None."""
    return "nan" if value is None else f"{value:.4g}"


def escape_json_controls(text: str) -> str:
    """Return a JSON text with every control character replaced by its JSON escape.

    JSON itself demands that below 0x20 only, but terminals obey others too.
    """
    return text if text.isprintable() else "".join(map(_escape_json_control, text))


def fill_words(text: str, words: Mapping[str, Any]) -> str:
    """Return a text with each `@word@` filled in. A line `@?word@` stays only if the word is
    true.

    Args:
        text: of lines.
        words: text for each word.
    """
    lines = _CONDITIONAL_LINE.sub(lambda line: line[2] if words[line[1]] else "", text)
    return _WORD.sub(lambda word: str(words[word[1]]), lines)


def _escape_control(character: str) -> str:
    """Return a character, or its escape in Python."""
    hidden = unicodedata.category(character) in UNPRINTABLE
    return character.encode("unicode_escape").decode() if hidden else character


def _escape_json_control(character: str) -> str:
    """Return a character, or its escape in JSON (two escapes beyond 0xffff)."""
    if unicodedata.category(character) not in UNPRINTABLE:
        return character
    units = character.encode("utf-16-be", "surrogatepass")
    halves = [units[i : i + 2].hex() for i in range(0, len(units), 2)]
    return "".join(f"\\u{half}" for half in halves)
