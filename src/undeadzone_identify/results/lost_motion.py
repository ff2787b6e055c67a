"""Result of `identify` for two positions: how much motion is lost between them."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from undeadzone.util.arrays import to_json_value
from undeadzone.util.text import HALF_95, bracket_interval
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.account import Account
from undeadzone_identify.results.formats import unit_suffix
from undeadzone_identify.results.lines import measure_lines
from undeadzone_identify.results.result import SpokenWithoutPlant
from undeadzone_identify.results.speech import account_of_motion
from undeadzone_identify.results.words import describe_shares
from undeadzone_identify.selection.lost_motion import LostMotionAnswer


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class IdentifiedMotion(SpokenWithoutPlant):
    """Motion that is lost between two positions, with its interval.

    Attributes:
        answer: every value; the properties below are its most used ones.
        right, left: None, as of a gap only the width is known.

    See Also:
        identify
    """

    right = left = None
    no_scenario = "two positions have no plant. `export --to snippet` compensates"
    answer: LostMotionAnswer

    @functools.cached_property
    def account(self) -> Account:
        """Return effect, cost, remedy, what is not decided, and the largest that could hide."""
        return account_of_motion(self.answer)

    @property
    def verdict(self) -> str:
        """Return play, none or unclear."""
        return self.answer.verdict

    @property
    def gap(self) -> Interval:
        """Return the motion that is lost at a reversal, in units of the input."""
        return self.answer.gap

    @property
    def width(self) -> Interval | None:
        """Return the lost motion with its 95 % interval, in units of the output [y].

        It is None if the verdict is not play.
        """
        lost = self.answer.gap.scale_by(abs(self.answer.found.gain))
        return lost if self.verdict == "play" else None

    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the answer, as `--json` prints."""
        one = self.answer
        found = self.answer.found
        width = self.width
        half = HALF_95 * one.gain_error
        parts = one.parts
        numbers = to_json_value(
            {
                "zone": False,
                "verdict": one.verdict,
                "found": self.headline(),
                "answer": self.account.to_json(),
                "reasons": one.reasons,
                "right": None,
                "left": None,
                "width": None if width is None else list(width),
                "odds": one.odds,
                "lost_motion": {
                    "gap": list(one.gap),
                    "gain": [found.gain, found.gain - half, found.gain + half],
                    "level": found.level,
                    "delay": found.delay,
                    "lag": found.lag * found.structure.lags,
                    "reversals": one.reversals,
                    "rms": found.rms,
                    "with_friction": one.is_goal and parts is None,
                    "parts": None if parts is None else parts._asdict(),
                },
                "record": {
                    "samples": int(one.log.t.size),
                    "readings": int(one.data.t.size),
                    "quantum": one.quantum,
                },
                "units": {"input": one.log.input_unit, "output": one.log.output_units[0]},
                "remarks": one.remarks,
            }
        )
        return numbers | {"lines": measure_lines(numbers, None, one.data.u)}

    def summary(self) -> dict[str, Any]:
        """Return the answer in words, as the command prints."""
        one = self.answer
        found = self.answer.found
        of_output = unit_suffix(one.log.output_units[0])
        names = f"{one.log.inputs[0]} [{one.log.input_unit}], {one.log.outputs[0]}"
        steps = np.diff(one.log.t)
        lines: dict[str, Any] = {
            "record": f"{one.log.t.size} samples, {np.median(steps):.4g} s"
            f" ({steps.min():.4g} to {steps.max():.4g}), {names}"
            f" [{one.log.output_units[0]}]",
        }
        lines |= self.account.summary()
        if one.odds:
            lines["odds"] = describe_shares(one.odds)
        half = HALF_95 * one.gain_error
        lines["gain"] = bracket_interval(found.gain, found.gain - half, found.gain + half, ".5g")
        if found.delay or found.lag:
            lag = f", lag {found.structure.lags} x {found.lag:.3g} s" if found.lag else ""
            lines["late"] = f"{found.delay:.3g} s{lag}"
        white = "white" if found.colour <= 1.1 else f"{found.colour:.2g} times their changes"
        lines["left"] = f"rms {found.rms:.3g}{of_output}, {white}"
        if one.remarks:
            lines["note"] = one.remarks
        return lines

    drawn = ("undeadzone_identify.figures", "lost_motion", "both_flanks")
