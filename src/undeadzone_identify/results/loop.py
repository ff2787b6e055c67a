"""Result of `identify` of a control loop: why it swings, by all records of its valve."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

from undeadzone.util.arrays import to_json_value
from undeadzone_identify.logs.log import Log
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.account import (
    BOUNDED,
    INDICATED,
    NAMED,
    OPEN,
    Account,
    Numbers,
)
from undeadzone_identify.results.formats import describe_interval, unit_suffix
from undeadzone_identify.results.lines import measure_lines
from undeadzone_identify.results.result import SpokenWithoutPlant
from undeadzone_identify.selection.decision import VALVE
from undeadzone_identify.selection.loop import LoopFindings

BY = "evidence of the loop"
GOOD = 1.6  # |sensitivity| of a loop that is tuned well
WORDS = {  # name and effect of a cause
    "stiction": ("The valve sticks", "stick"),
    "input_play": ("Backlash ahead of the plant", "input reversal"),
    "tight_tuning": ("The loop is tuned too tightly", "tuning"),
    "external": ("An oscillation from outside", "outside"),
    "limits": ("OP rests at its limit", "limit"),
    "noise": ("PV is noise, or a few levels", "noise"),
    "none": ("The valve follows", ""),
}
CAUSES = {"sticks": "the valve sticks", "tight_tuning": "tight tuning", "external": "from outside"}


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class IdentifiedLoop(SpokenWithoutPlant):
    """Cause of a control loop's swing, with S and J of its valve whether it is named or not.

    Attributes:
        logs: records of the loop.
        found: what they say together.

    See Also:
        identify
    """

    no_scenario = "the answer to a loop is the cause of its swing, without a plant"
    logs: tuple[Log, ...]
    found: LoopFindings

    @property
    def verdict(self) -> str:
        """Return stiction, input_play, tight_tuning, external, limits, noise, none or
        undecided.
        """
        return self.found.word

    @property
    def width(self) -> Interval | None:
        """Return S of a valve that is named, as (value, low, high) [u]; None without."""
        return self.found.stick if self.verdict in VALVE else None

    @property
    def unit(self) -> str:
        """Return the unit of OP: % where it has none and lies within 0 to 100."""
        first = self.logs[0]
        is_share = first.u.min() >= -5 and 5 < first.u.max() <= 105
        return "%" if first.input_unit == "1" and is_share else first.input_unit

    @functools.cached_property
    def account(self) -> Account:
        """Return effect, remedy, what is not decided, and the largest S that could hide."""
        found, units = self.found, (self.unit, self.logs[0].output_units[0])
        sizes: Numbers = {"S": found.stick, "J": found.jump}
        doubts = found.remarks[-1:] if found.is_thinned else ("no cause has odds of 90 %",)
        likely = WORDS.get(next(iter(found.odds)), ("", "stick"))
        name, effect = WORDS.get(found.word, ("", likely[1]))
        numbers = {
            "stick": sizes,
            "input reversal": {"gap": found.stick},
            "outside": _exact(period=found.median("period")),
            "tuning": _exact(
                sensitivity=math.exp(found.median("sensitivity")), **{"divide by": self.divisor}
            ),
        }.get(effect, {})
        is_open = found.word == "undecided"
        grade = NAMED if numbers else OPEN
        if is_open:
            grade = INDICATED
        if not effect:
            grade = BOUNDED
        there = {effect: numbers} if effect else {}
        others = {"stick": sizes} if is_open and effect != "stick" else {}
        limits = {} if found.word in VALVE else {"stick": found.stick.high}
        return Account(
            grade, there, BY, units, None, others, doubts * is_open, limits=limits, name=name
        )

    @property
    def divisor(self) -> float:
        """Return by what to divide the controller's gain for a sensitivity of GOOD.

        Near its limit C G is about -1 + 1 / S at the period.
        """
        sensitivity = max(math.exp(self.found.median("sensitivity")), 1.0)
        return max((1 - 1 / sensitivity) / (1 - 1 / GOOD), 1.0)

    @property
    def about(self) -> str:
        """Return the name of the middle of the swing: SP where PV meets SP."""
        return "SP" if self.found.is_met else "mean PV"

    @property
    def share(self) -> float | None:
        """Return the rms of the swing over its middle, None of a PV about 0."""
        share = self.found.median("share")
        return share if share < 1 else None

    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the answer, as `--json` prints."""
        found, first = self.found, self.logs[0]
        fields = ("begin", "expected", "period", "error", "travel")
        rows = [
            {name: getattr(one, name) for name in fields} | {"ellipse": one.number("ellipse")}
            for one in found.swings
        ]
        period = found.median("period")
        numbers = {
            "zone": False,
            "verdict": self.verdict,
            "found": self.headline(),
            "answer": self.account.to_json(),
            "odds": found.odds,
            "width": None if self.width is None else list(self.width),
            "right": None,
            "left": None,
            "loop": {
                "S": list(found.stick),
                "J": list(found.jump),
                "shape": found.median("ellipse"),
                "period": period if math.isfinite(period) else None,
                "regularity": math.exp(found.median("regularity")),
                "sensitivity": math.exp(found.median("sensitivity")),
                "error": found.median("error"),
                "cost": self.share,
                "about": self.about,
                "travel": found.median("travel"),
                "exception": found.exception,
            },
            "records": rows,
            "record": {"samples": sum(log.t.size for log in self.logs), "records": len(rows)},
            "units": {"input": self.unit, "output": first.output_units[0]},
            "remarks": [*found.remarks],
        }
        certain = self.account.is_certain
        lines = measure_lines(numbers, None, first.u[:, 0]) if certain else None
        return to_json_value(numbers | {"lines": lines})

    @property
    def size_in_words(self) -> str:
        """Return S and J with their intervals, and the ellipse."""
        found, unit = self.found, f"{unit_suffix(self.unit)} of OP"
        stick, jump = (describe_interval(one, "") for one in (found.stick, found.jump))
        return f"S {stick}, J {jump}{unit} (ellipse {100 * found.median('ellipse'):.0f} %)"

    def summary(self) -> dict[str, Any]:
        """Return the answer in words, as the command prints."""
        found, first = self.found, self.logs[0]
        unit, reading = unit_suffix(self.unit), unit_suffix(first.output_units[0])
        samples = sum(log.t.size for log in self.logs)
        count = len(found.swings)
        lines: dict[str, Any] = {"record": f"{samples} samples in {count} part{'s' * (count > 1)}"}
        lines |= self.account.summary()
        odds = (
            f"{CAUSES.get(word, word)} {100 * share:.0f} %" for word, share in found.odds.items()
        )
        lines["odds"] = ", ".join(odds)
        lines["if it sticks"] = self.size_in_words
        lines["loop"] = self.swing_in_words
        travel = f"the stem travels {read_number(found.median('travel'))}{unit} a day"
        cost = cost_in_words(
            f"{read_number(found.median('error'))}{reading}", self.share, self.about
        )
        lines["cost"] = f"rms of PV - {self.about} {cost}; {travel}"
        if len(found.swings) > 1:
            lines["by record"] = [
                f"{k}: S by the ellipse {read_number(one.expected)}{unit}"
                f" ({100 * one.number('ellipse'):.0f} %), rms {read_number(one.error)}{reading}"
                for k, one in enumerate(found.swings, 1)
            ]
        notes = [one for one in found.remarks if one not in self.account.doubts]
        if notes:
            lines["note"] = notes
        return lines

    @property
    def swing_in_words(self) -> str:
        """Return whether the loop swings regularly, and how long its period is."""
        r, period = math.exp(self.found.median("regularity")), self.found.median("period")
        unit = "samples" if self.logs[0].counted else "s"
        how = (
            f"swings regularly, period {read_number(period)} {unit}"
            if r > 1
            else "no regular swing"
        )
        return f"{how} (r {read_number(r, 2)})"

    drawn = ("undeadzone_identify.figures", "loop_over_time", "loop_ellipse")


def cost_in_words(size: str, share: float | None, about: str) -> str:
    """Return the rms of a swing with its share of the middle, as the result has them."""
    beside = "PV is about 0" if share is None else f"{read_number(100 * share, 2)} % of {about}"
    return f"{size} ({beside})"


def read_number(x: float, digits: int = 3) -> str:
    """Return a number of some digits as a person reads it, without a power of ten."""
    return f"{float(f'{x:.{digits}g}'):,.10g}"


def _exact(**numbers: float) -> Numbers:
    """Return numbers without an interval, rounded as a person reads them; infinite ones not."""
    there = {name.replace("_", " "): float(f"{x:.2g}") for name, x in numbers.items()}
    return {name: Interval(x, x, x) for name, x in there.items() if math.isfinite(x)}
