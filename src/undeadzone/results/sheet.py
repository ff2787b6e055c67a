"""A sheet: numbers of a result, each said once for JSON, a terminal, a notebook and a page.

A row has a value and whatever is known of it. JSON takes key and value; a terminal and a notebook
take label and `words`; a page takes title and `cell`, as `report.html.estimates` sets them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.util.arrays import finite
from undeadzone.util.text import label, with_interval, with_unit


class Row(NamedTuple):
    """A number of a result.

    Attributes:
        label: what a terminal calls it.
        title: what a page calls it.
        value: the number.
        unit: its unit; 1: it has none.
        std: its standard deviation; None: not known.
        true: the truth; None: nobody knows it.
        key: of the number in a summary; empty: it stands there otherwise.
        form: of the number where it has no deviation.
        note: what a terminal says behind it.
        least, most: ends of the range in which the number is known to lie.
    """

    label: str
    title: str
    value: float | None
    unit: str = "1"
    std: float | None = None
    true: float | None = None
    key: str = ""
    form: str = ".6g"
    note: str = ""
    least: float = -math.inf
    most: float = math.inf

    @property
    def value_with_interval(self) -> str:
        """Return the value, with its 95 % interval where that is known; nan where there is none."""
        if self.std is None:
            return number(finite(self.value), self.form)
        return with_interval(finite(self.value), finite(self.std), self.least, self.most)

    @property
    def words(self) -> str:
        """Return the value with all that is known of it."""
        truth = "" if self.true is None else f" (true {self.true:.6g})"
        return f"{with_unit(self.value_with_interval, self.unit)}{truth}{self.note}"

    @property
    def cell(self) -> Any:
        """Return the value as a page has it: a number, or words where its interval is known."""
        return self.value if self.std is None else self.value_with_interval

    @property
    def head(self) -> str:
        """Return the title with the unit."""
        return label(self.title, self.unit)


def number(value: float | None, form: str = ".4g", none: str = "nan") -> str:
    """Return a number as text.

    Args:
        value: the number.
        form: as `format` takes it.
        none: what stands where there is none.
    """
    return none if value is None else format(value, form)


def within(value: str, low: str, high: str) -> str:
    """Return a value and its interval as text; an end that is not known is empty."""
    if not low and not high:
        return value
    if not high:
        return f"{value} ({low} or more)"
    if not low:
        return f"{value} ({high} or less)"
    return value if value == low == high else f"{value} [{low}, {high}]"


def in_text(rows: Iterable[Row]) -> dict[str, str]:
    """Return rows as a terminal and a notebook show them."""
    return {row.label: row.words for row in rows}


def in_json(rows: Iterable[Row]) -> dict[str, float | None]:
    """Return rows as a summary has them."""
    return {row.key: row.value for row in rows}


def on_page(rows: Iterable[Row]) -> dict[str, Any]:
    """Return rows as a page shows them one below the other."""
    return {row.head: row.cell for row in rows}


def of_each(
    final: Mapping[str, Any],
    name: str,
    unit: str,
    true: Sequence[float] | None = None,
    ranges: Sequence[Sequence[float]] = (),
) -> list[list[Row]]:
    """What is found of each output's zone or play, or of each actuator; nothing of none.

    Args:
        final: last values by name, a number or one each: of right and left, of their deviations
            where known, of gaps that of the sum.
        name: of the widths: d of a zone, b of an actuator, gap of a play ahead of a zone.
        unit: of all.
        true: right and left of each in turn; None: nobody knows them.
        ranges: [lo, hi] within which right and left of each in turn are known to lie; empty: at
            least 0.
    """
    sides = [f"{name}_right", f"{name}_left"]
    heads = [*sides, *(f"{side}_std" for side in sides), f"{name}_std"]
    known = [np.ravel(final[head]) for head in heads if final.get(head) is not None]
    found = np.array(known).T.tolist()
    truths = [None] * len(found) if true is None else np.reshape(true, (-1, 2)).tolist()
    ends = (
        np.reshape(ranges, (-1, 2, 2)).tolist() if ranges else [[[0.0, math.inf]] * 2] * len(found)
    )
    return [_of_one(name, *one, unit) for one in zip(found, truths, ends, strict=False)]


def _of_one(
    name: str,
    found: Sequence[float],
    true: Sequence[float] | None,
    ranges: Sequence[Sequence[float]],
    unit: str,
) -> list[Row]:
    """What is found of one zone, play or actuator; of gaps their sum too, which is told better.

    Args:
        name: of the widths.
        found: right and left; their deviations where known; of gaps that of the sum.
        true: right and left; None: nobody knows them.
        ranges: [lo, hi] of right and left.
        unit: of all.
    """
    letter = "c" if name == "gap" else name
    rows = []
    for k, side in enumerate(("right", "left")):
        std = found[2 + k] if len(found) > 2 else None
        truth = None if true is None else true[k]
        row = Row(f"{name}_{side}", f"{letter}_{side[0]}^", found[k], unit, std, truth)
        rows.append(row._replace(least=ranges[k][0], most=ranges[k][1]))
    if name == "gap":
        title = " + ".join(row.title for row in rows)
        total = None if true is None else sum(true)
        rows.append(Row("gap_right + gap_left", title, sum(found[:2]), unit, found[4], total))
    return rows
