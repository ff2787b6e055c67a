"""Result of `identify` where a look at the log alone gives the answer: no plant is fitted."""

from __future__ import annotations

import dataclasses
from typing import Any

from undeadzone.util.arrays import to_json_value
from undeadzone_identify.logs.log import Log
from undeadzone_identify.looks.first import Looks
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.account import Account
from undeadzone_identify.results.result import SpokenWithoutPlant


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class IdentifiedAtRest(SpokenWithoutPlant):
    """Effect that a log shows without any dynamics, such as a band in its map at rest.

    Attributes:
        log: which log.
        looks: what is seen directly.
        account: effect, cost, remedy, what is not decided, and the largest that could hide.

    See Also:
        identify
    """

    no_scenario = "the map at rest has no plant: record steps of the command"
    log: Log
    looks: Looks
    account: Account

    @property
    def verdict(self) -> str:
        """Return the effect as a word: input_loss, loss, low_end, ...; none or unclear without."""
        without = "none" if self.account.limits else "unclear"
        return next(iter(self.account.effects), without).replace(" ", "_")

    @property
    def width(self) -> Interval | None:
        """Return the width of the band, or of the gap, as (value, low, high); None without one."""
        numbers = self.account.first_numbers
        return numbers.get("width", numbers.get("gap"))

    @property
    def right(self) -> Interval | None:
        """Return the upper edge of the band [u]; None without one."""
        return self.account.first_numbers.get("upper")

    @property
    def left(self) -> Interval | None:
        """Return the lower edge of the band [u]; None without one."""
        return self.account.first_numbers.get("lower")

    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the answer, as `--json` prints."""
        log = self.log
        numbers = {
            "zone": False,
            "verdict": self.verdict,
            "found": self.headline(),
            "answer": self.account.to_json(),
            "width": None if self.width is None else list(self.width),
            "map": self.looks.at_rest and self.looks.at_rest.nodes.tolist(),
            "record": {"samples": int(log.t.size)},
            "units": {"input": log.input_unit, "output": log.output_units[0]},
            "remarks": [*log.remarks],
        }
        return to_json_value(numbers)

    def summary(self) -> dict[str, Any]:
        """Return the answer in words, as the command prints."""
        log = self.log
        names = f"{log.inputs[0]} [{log.input_unit}], {log.outputs[0]} [{log.output_units[0]}]"
        lines: dict[str, Any] = {"record": f"{log.t.size} samples, {names}"}
        lines |= self.account.summary() | {"by": self.account.by}
        if log.remarks:
            lines["note"] = [*log.remarks]
        return lines

    drawn = ("undeadzone_identify.figures", "at_rest", "map_at_rest")
