"""Account of a log in five parts: the effect, what it costs, the remedy, what is not decided, and
the largest effect that could hide.

Certainty is withheld, the number never: a grade tells how sure it is.
"""

from __future__ import annotations

from itertools import starmap
from typing import Any, NamedTuple

import msgspec

from undeadzone.util.arrays import to_json_value
from undeadzone.util.files import read_table
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.formats import describe_interval, unit_suffix

NAMED = "named"  # a class of models explains the log, and no other does
MEASURED = "measured"  # the number is certain, its cause may not be
INDICATED = "indicated"  # the likeliest number, with the doubts that are printed
BOUNDED = "bounded"  # nothing was found: the largest effects that could hide
OPEN = "open"  # neither a number nor a bound
GRADES = (NAMED, MEASURED, INDICATED, BOUNDED, OPEN)
SAYS = GRADES[:-1]  # grades with a number or a bound
LEADS = {MEASURED: "Measured: ", INDICATED: "Indicated, not certain: "}


SURE = 3.0  # deviations, from which an effect is seen: 5 % among 17 classes (Bonferroni) are 2.97
LESS, SHOWS = 0.9, 0.75  # share of the straight plant's rms, below which a sure effect is worth a
# number, and any effect

ENDS = ("input", "output", "time", "none")  # whose units numbers have
STEPS = "steps of several sizes up and down past both edges, each held until the reading rests"


class Effect(msgspec.Struct, frozen=True):
    """Effect of a nonlinearity, whatever its cause.

    Attributes:
        words: what happens.
        remedy: what helps against it; empty if nothing does.
        end: whose unit its numbers have, of ENDS.
        record: what to record next if it is not certain.
    """

    words: str
    remedy: str
    end: str
    record: str = STEPS


EFFECTS = msgspec.convert(read_table(__file__)["effects"], dict[str, Effect])


class Buys(NamedTuple):
    """Rms errors on data that had no part in the fits, in the unit of the output.

    Attributes:
        without: of a straight plant.
        remaining: with the effect.
        deviations: by how many standard deviations the effect is better.
    """

    without: float
    remaining: float
    deviations: float

    @property
    def share(self) -> float:
        """Return the share of the squared error that the effect takes away."""
        return 1 - (self.remaining / max(self.without, 1e-300)) ** 2

    @property
    def is_worth(self) -> bool:
        """Return whether the effect improves the simulation so much that its number counts."""
        return self.remaining < (SHOWS, LESS)[self.is_seen] * self.without

    @property
    def is_seen(self) -> bool:
        """Return whether a test at 95 % finds the effect, whichever of all classes it is."""
        return self.deviations > SURE


Numbers = dict[str, Interval]


class Account(NamedTuple):
    """Account of a log.

    Attributes:
        grade: how sure it is: named, measured, indicated, bounded or open.
        effects: what was found, by its key in EFFECTS, with its numbers by name in the unit of its
            end; empty if nothing was.
        by: the instrument that gave them.
        units: of input and output.
        buys: the held-out errors; None if no model was compared.
        others: effects that are not excluded, with their numbers.
        doubts: why it is not certain.
        unmet: sides that the log never tried.
        limits: the largest effect that could hide (95 %), by effect.
        name: of the class that is named, in place of the effects' words; empty without.
    """

    grade: str
    effects: dict[str, Numbers]
    by: str
    units: tuple[str, str]
    buys: Buys | None = None
    others: dict[str, Numbers] = {}
    doubts: tuple[str, ...] = ()
    unmet: tuple[str, ...] = ()
    limits: dict[str, float] = {}
    name: str = ""

    @property
    def remedies(self) -> list[str]:
        """Return what helps, each remedy once."""
        return [*dict.fromkeys(EFFECTS[effect].remedy for effect in self.effects)]

    @property
    def first_numbers(self) -> Numbers:
        """Return the numbers of the first effect; none without one."""
        return next(iter(self.effects.values()), {})

    @property
    def is_certain(self) -> bool:
        """Return whether code may be written for it."""
        return self.grade == NAMED and bool(self.effects)

    @property
    def says_something(self) -> bool:
        """Return whether it holds a number or a bound."""
        return self.grade in SAYS

    def with_doubts(self, *doubts: str) -> Account:
        """Return the account with further doubts ahead of the others."""
        return self._replace(doubts=(*filter(None, doubts), *self.doubts))

    def unit_of(self, effect: str) -> str:
        """Return the unit of an effect's numbers."""
        return (*self.units, "s", "1")[ENDS.index(EFFECTS[effect].end)]

    def headline(self) -> str:
        """Return grade, effects and numbers in one line."""
        if not self.effects:
            held = self.grade == BOUNDED
            return self.name or ("Nothing hidden was found" if held else "No number can be given")
        if self.name:
            numbers = "; ".join(filter(None, starmap(self._list_numbers, self.effects.items())))
            return ": ".join(filter(None, [self.name, numbers]))
        return LEADS.get(self.grade, "") + "; ".join(self._describe(self.effects))

    def _describe(self, effects: dict[str, Numbers]) -> list[str]:
        """Return effects with their numbers as texts."""
        texts = []
        for effect, numbers in effects.items():
            parts = [EFFECTS[effect].words, self._list_numbers(effect, numbers)]
            texts.append(": ".join(filter(None, parts)))
        return texts

    def _list_numbers(self, effect: str, numbers: Numbers) -> str:
        """Return the numbers of an effect with their names as a text; empty without any."""
        suffix = unit_suffix(self.unit_of(effect))
        return ", ".join(
            f"{name} {describe_interval(one, suffix)}" for name, one in numbers.items()
        )

    def summary(self) -> dict[str, Any]:
        """Return headline and parts as lines of the terminal."""
        output = unit_suffix(self.units[1])
        lines: dict[str, Any] = {"found": self.headline()}
        if self.buys is not None:
            lines["pays"] = (
                f"held-out error {self.buys.without:.4g}{output} without it,"
                f" {self.buys.remaining:.4g}{output} with it ({100 * self.buys.share:.0f} % of the"
                f" squares, {self.buys.deviations:.1f} deviations)"
            )
        if self.effects:
            lines["remedy"] = self.remedies
        rows = self._describe(self.others)
        rows += [f"the {side} side was never tried" for side in self.unmet]
        if rows:
            lines["not decided"] = rows
        if self.limits:
            lines["at most"] = [
                f"{value:.3g}{unit_suffix(self.unit_of(effect))}: {EFFECTS[effect].words}"
                for effect, value in self.limits.items()
            ]
        if self.doubts:
            lines["doubt"] = [*self.doubts]
        if self.grade in (INDICATED, OPEN):
            wanted = [EFFECTS[effect].record for effect in self.effects or self.others]
            lines["record next"] = [*dict.fromkeys(wanted or [STEPS])]
        return lines

    def to_json(self) -> dict[str, Any]:
        """Return all parts as JSON has them."""
        return {
            "grade": self.grade,
            "effects": {key: _numbers_to_json(one) for key, one in self.effects.items()},
            "units": {"input": self.units[0], "output": self.units[1]},
            "by": self.by,
            "pays": self.buys and {**self.buys._asdict(), "share": self.buys.share},
            "remedies": self.remedies,
            "not_decided": {key: _numbers_to_json(one) for key, one in self.others.items()},
            "never_tried": [*self.unmet],
            "doubts": [*self.doubts],
            "at_most": self.limits,
        }


def _numbers_to_json(numbers: Numbers) -> dict[str, list[float | None]]:
    """Return numbers as [value, low, high], what is not finite as None."""
    return {name: to_json_value([*interval]) for name, interval in numbers.items()}
