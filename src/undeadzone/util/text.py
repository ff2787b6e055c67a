"""Text of others, made fit to be printed: nothing in it steers a terminal or begins a line."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
from typing import Any, Final

# Controls, invisible formats (which also turn the direction of writing), half characters, line and
# paragraph separators.
UNPRINTABLE: Final = ("Cc", "Cf", "Cs", "Zl", "Zp")
HALF_95: Final = 1.959964  # standard deviations in half of a 95 % interval
LEAST_MASS: Final = 1e-9  # of a Gaussian inside of a range, below which its quantiles mean nothing
_ASKED: Final = re.compile(r"^@\?([a-z_]+)@(.*\n)", re.MULTILINE)
_WORD: Final = re.compile("@([a-z_]+)@")


def printable(text: str) -> str:
    """Return a text in which every control character stands as its escape, such as \\x1b or \\n."""
    return text if text.isprintable() else "".join(map(_printable, text))


def one_line(text: str) -> str:
    """Return a text that is `printable`, its line ends and runs of blanks as single blanks."""
    return printable(" ".join(text.split()))


def label(words: str, unit: str) -> str:
    """Return words and unit, the unit left out where it is 1."""
    return words if unit == "1" else f"{words} [{unit}]"


def with_unit(words: str, unit: str) -> str:
    """Return words and unit behind them, the unit left out where it is 1."""
    return words if unit == "1" else f"{words} {unit}"


def count_noun(number: int, what: str) -> str:
    """Return a number of things: "1 run", "2 runs"."""
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
    low, high = value - half, value + half
    if least <= low and high <= most:
        return low, high
    if math.isinf(std):
        return least, most
    from statistics import NormalDist

    unit = NormalDist()
    below, above = unit.cdf((least - value) / std), unit.cdf((most - value) / std)
    if above - below < LEAST_MASS:
        return least, most
    quantiles = [unit.inv_cdf(below + share * (above - below)) for share in (0.025, 0.975)]
    low, high = (value + std * quantile for quantile in quantiles)
    inside = min(max(value, least), most)
    return max(least, min(low, inside)), min(most, max(high, inside))


def with_interval(
    value: float | None, std: float | None, least: float = -math.inf, most: float = math.inf
) -> str:
    """Return a value and its 95 % interval, to the place of the second digit of its deviation.

    Args:
        value: the number; None: there is none.
        std: its standard deviation; None: not known.
        least, most: ends of the range in which it is known to lie.
    """
    if value is None or std is None or not math.isfinite(value):
        return f"{_short(value)} (no interval)"
    if std == 0.0:
        return _short(value)
    place = 1 - math.floor(math.log10(std)) if std < math.inf else -1
    form = ".4g" if place < 0 or abs(value) < 1e-4 or place > 12 else f".{place}f"
    return bracket_interval(value, *interval_95(value, std, least, most), form)


def bracket_interval(value: float, low: float, high: float, form: str) -> str:
    """Return a value and its interval: 0.98 [0.55, 1.41]; `form` as `format` takes it."""
    return f"{value:{form}} [{low:{form}}, {high:{form}}]"


def _short(value: float | None) -> str:
    """Return a number to four digits; nan where there is none."""
    return "nan" if value is None else f"{value:.4g}"


def json_line(text: str) -> str:
    """Return a JSON text in which every control character stands as its JSON escape.

    JSON itself demands that below 0x20 only; terminals obey others too.
    """
    return text if text.isprintable() else "".join(map(_in_json, text))


def fill_words(text: str, words: Mapping[str, Any]) -> str:
    """Return a text: each `@word@` is filled in, a line that begins with `@?word@` needs its truth.

    Args:
        text: of lines.
        words: what stands for each word, as text.
    """
    lines = _ASKED.sub(lambda line: line[2] if words[line[1]] else "", text)
    return _WORD.sub(lambda word: str(words[word[1]]), lines)


def _printable(character: str) -> str:
    """Return a character, or its escape in Python."""
    hidden = unicodedata.category(character) in UNPRINTABLE
    return character.encode("unicode_escape").decode() if hidden else character


def _in_json(character: str) -> str:
    """Return a character, or its escape in JSON (two of them beyond 0xffff)."""
    if unicodedata.category(character) not in UNPRINTABLE:
        return character
    units = character.encode("utf-16-be", "surrogatepass")
    halves = [units[i : i + 2].hex() for i in range(0, len(units), 2)]
    return "".join(f"\\u{half}" for half in halves)
