"""Numbers of a result, each defined once for JSON, a terminal, a notebook and a page.

A row has a value and all known facts about it. JSON takes key and value. A terminal, a notebook and
a page take label and `words`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.util.arrays import to_json_value
from undeadzone.util.text import append_unit, format_with_interval


class Row(NamedTuple):
    """Number of a result.

    Attributes:
        label: its name in words.
        value: the number.
        unit: its unit (1: none).
        std: its standard deviation (None: not known).
        true: the truth (None: unknown).
        key: of the number in a summary (empty: it stands there otherwise).
        form: of the number if it has no deviation.
        note: text behind it.
        least, most: ends of the range in which the number is known to lie.
        withheld: whether no more than that range can be known of it.
        narrowed: whether an estimate narrows that range a little.
    """

    label: str
    value: float | None
    unit: str = "1"
    std: float | None = None
    true: float | None = None
    key: str = ""
    form: str = ".6g"
    note: str = ""
    least: float = -math.inf
    most: float = math.inf
    withheld: bool = False
    narrowed: bool = False

    @property
    def value_with_interval(self) -> str:
        """Return the value as text, with its 95 % interval if known, nan if missing.

        A width whose least value is infinite is one without an edge.
        """
        if self.least == math.inf:
            return "no edge"
        if self.withheld:
            return f"[{self.least:.4g}, {self.most:.4g}] as declared"
        if self.std is None:
            return format_number(to_json_value(self.value), self.form)
        words = format_with_interval(
            to_json_value(self.value), to_json_value(self.std), self.least, self.most
        )
        return words + f", narrowed from [{self.least:.4g}, {self.most:.4g}]" * self.narrowed

    @property
    def value_in_words(self) -> str:
        """Return the value as text with interval, unit, true value and note."""
        truth = "" if self.true is None else f" (true {self.true:.6g})"
        return f"{append_unit(self.value_with_interval, self.unit)}{truth}{self.note}"


def format_number(value: float | None, form: str = ".4g", none: str = "nan") -> str:
    """Return a number as text.

    Args:
        value: the number.
        form: as `format` takes it.
        none: text for a missing value.
    """
    return none if value is None else format(value, form)


def format_bounds(value: str, low: str, high: str) -> str:
    """Return a value and its interval as text. An unknown end is an empty text."""
    if not low and not high:
        return value
    if not high:
        return f"{value} ({low} or more)"
    if not low:
        return f"{value} ({high} or less)"
    return value if value == low == high else f"{value} [{low}, {high}]"


def rows_to_text(rows: Iterable[Row]) -> dict[str, str]:
    """Return rows for a terminal or a notebook, text by label."""
    return {row.label: row.value_in_words for row in rows}


def rows_to_json(rows: Iterable[Row]) -> dict[str, float | None]:
    """Return rows for a summary, values by key."""
    return {row.key: row.value for row in rows}


def build_width_rows(
    final: Mapping[str, Any],
    name: str,
    unit: str,
    true: Sequence[float] | None = None,
    ranges: Sequence[Sequence[float]] = (),
) -> list[list[Row]]:
    """Return the rows of each output's zone or play, or of each actuator, empty if not estimated.

    Args:
        final: last values by name, a number or one each: of right and left, of their deviations
            where known, of gaps that of the sum.
        name: of the widths: d of a zone, b of an actuator, gap of a play ahead of a zone.
        unit: of all.
        true: right and left of each in turn (None: unknown).
        ranges: [lo, hi] within which right and left of each in turn are known to lie (empty: at
            least 0).
    """
    sides = [f"{name}_right", f"{name}_left"]
    heads = [*sides, *(f"{side}_std" for side in sides), f"{name}_std"]
    known = [np.ravel(final[head]) for head in heads if final.get(head) is not None]
    found = np.array(known).T.tolist()
    truths = [None] * len(found) if true is None else np.reshape(true, (-1, 2)).tolist()
    ends = (
        np.reshape(ranges, (-1, 2, 2)).tolist() if ranges else [[[0.0, math.inf]] * 2] * len(found)
    )
    return [_build_side_rows(name, *one, unit) for one in zip(found, truths, ends, strict=False)]


def _build_side_rows(
    name: str,
    found: Sequence[float],
    true: Sequence[float] | None,
    ranges: Sequence[Sequence[float]],
    unit: str,
) -> list[Row]:
    """Return the rows of a zone, play or actuator, for gaps with their more accurate sum.

    Args:
        name: of the widths.
        found: right and left, then their deviations if known (for gaps that of the sum).
        true: right and left (None: unknown).
        ranges: [lo, hi] of right and left.
        unit: of all.
    """
    rows = []
    for k, side in enumerate(("right", "left")):
        std = found[2 + k] if len(found) > 2 else None
        truth = None if true is None else true[k]
        row = Row(f"{name}_{side}", found[k], unit, std, truth)
        row = row._replace(least=ranges[k][0], most=ranges[k][1])
        absent = row._replace(unit="", true=None, least=math.inf)
        rows.append(absent if found[k] == math.inf else row)
    if name == "gap":
        total = None if true is None else sum(true)
        rows.append(Row("gap_right + gap_left", sum(found[:2]), unit, found[4], total))
    return rows


def build_gear_rows(
    widths: Sequence[Sequence[Row]],
    deviations: Sequence[float] | None,
    halves: Sequence[Sequence[float]],
    verdicts: Sequence[Mapping[str, Any]],
) -> list[list[Row]]:
    """Return the rows of the gears at each output: their gap, and their centre.

    Args:
        widths: rows of right and left, at each output.
        deviations: of right + left (None: not known).
        halves: declared [lo, hi] of half the gap (empty: none).
        verdicts: identifiability of each gap. A gap that is uncertain and not narrowed has
            its declared range.
    """
    rows = []
    for i, (right, left) in enumerate(widths):
        sides = (right.value, left.value)
        gap = right._replace(label="gap", value=_add(*sides), std=None)
        centre = right._replace(label="centre", value=_add(*sides, -1.0, 0.5))
        gap = gap._replace(true=_add(right.true, left.true), least=0.0)
        centre = centre._replace(true=_add(right.true, left.true, -1.0, 0.5), std=None)
        centre = centre._replace(least=-math.inf, most=math.inf)
        if deviations is not None and right.std is not None and left.std is not None:
            square = (right.std**2 + left.std**2) / 2 - deviations[i] ** 2 / 4
            gap = gap._replace(std=deviations[i])
            centre = centre._replace(std=math.sqrt(max(square, 0.0)))
        if halves:
            low, high = halves[i]
            narrowed = verdicts[i].get("narrowed", False)
            withheld = not (verdicts[i]["width"] or narrowed)
            gap = gap._replace(least=2 * low, most=2 * high, withheld=withheld, narrowed=narrowed)
        rows.append([gap, centre])
    return rows


def _add(
    right: float | None, left: float | None, sign: float = 1.0, share: float = 1.0
) -> float | None:
    """Return a share of right + sign left, or None without them."""
    return None if right is None or left is None else share * (right + sign * left)
