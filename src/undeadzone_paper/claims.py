"""The paper's claims judged.

What they say stands in `claims.toml`, once; what was measured for them comes from `trials`. A
verdict follows from two measured numbers and a limit alone: the claim holds as printed, holds after
repair, or does not hold. What the paper announces and does not contain is not shown.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable
from importlib.resources import files
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from undeadzone.util.arrays import finite
from undeadzone_paper.evidence import CONDITIONS, Evidence
from undeadzone_paper.trials import Measured, measure

Verdict = Literal["holds", "holds after repair", "does not hold", "not shown"]
TINY: Final = 1e-12  # below it a number is rounding


class Text(NamedTuple):
    """A claim in words; `claims.toml` says what each entry is.

    Attributes:
        id: its name in this audit
        where: where the paper makes it
        words: the paper's
        claim: what is tested of them
        quantity: what tests it
        limit: what the quantity must not exceed
        why: the reason for the verdict, with {names} of numbers
        announced: whether the quantity counts what the paper announces and no figure shows
        ours: whether the quantity and its limit are this audit's reading, not a figure's claim
    """

    id: str
    where: str
    words: str
    claim: str
    quantity: str
    limit: float
    why: str
    announced: bool = False
    ours: bool = False


class Claim(NamedTuple):
    """A claim and what was measured for it; an infinite value: the run diverges.

    Attributes:
        text: the claim in words
        printed: its quantity as printed, by case; the worst counts; empty: no equation has it
        repaired: its quantity as repaired; None: there is nothing to repair
    """

    text: Text
    printed: dict[str, float]
    repaired: float | None

    @property
    def worst(self) -> float | None:
        """Return its quantity as printed in the worst case; None where no equation has it."""
        return max(self.printed.values(), default=None)

    @property
    def verdict(self) -> Verdict:
        """What the numbers say."""
        if _within(self.worst, self.text.limit):
            return "holds"
        if self.text.announced:
            return "not shown"
        return "holds after repair" if _within(self.repaired, self.text.limit) else "does not hold"

    @property
    def measured_in_words(self) -> str:
        """Return the numbers in words."""
        cases = [f"{value_in_words(value)} {case}".strip() for case, value in self.printed.items()]
        first = ", ".join(cases) or "in no equation"
        limit = f"limit {self.text.limit:g}"
        if self.repaired is None:
            return f"{self.text.quantity}: {first}; {limit}"
        repaired = value_in_words(self.repaired)
        return f"{self.text.quantity}: as printed {first}; repaired {repaired}; {limit}"

    def summary(self) -> dict[str, Any]:
        """Return the claim ready for JSON; values that are not finite, or not there, become
        None.
        """
        return {
            **self.text._asdict(),
            "printed": None if self.worst is None else finite(self.worst),
            "repaired": None if self.repaired is None else finite(self.repaired),
            "measured": self.measured_in_words,
            "verdict": self.verdict,
        }


HOW: Final = (
    "A verdict is computed: the measured number against its limit, as printed first (the worst "
    "case counts), then repaired."
)


def count_verdicts(claims: Iterable[Claim]) -> str:
    """How many claims hold, as a sentence."""
    counts = Counter(claim.verdict for claim in claims)
    return (
        f"Of {counts.total()} claims {counts['holds']} hold as printed, "
        f"{counts['holds after repair']} after repair, {counts['does not hold']} do not hold, "
        f"{counts['not shown']} are announced and not shown."
    )


def value_in_words(value: float) -> str:
    """Return a value in words."""
    if not np.isfinite(value):
        return "diverges"
    return f"{value if abs(value) > TINY else 0.0:.3g}"


def _within(value: float | None, limit: float) -> bool:
    """Return whether there is a value and it keeps to its limit."""
    return value is not None and value <= limit


def texts() -> list[Text]:
    """Return every claim as `claims.toml` has it; conditions of the runs are filled in."""
    file = files("undeadzone_paper").joinpath("claims.toml").read_text(encoding="utf-8")
    found = []
    for key, entry in tomllib.loads(file).items():
        text = Text(id=key, **entry)
        quantity = text.quantity.format(**CONDITIONS)
        found.append(text._replace(quantity=quantity, why=" ".join(text.why.split())))
    return found


def about(number: int, claims: Iterable[Text]) -> list[str]:
    """Return the claims that judge an equation, by their ids.

    Args:
        number: of the equation
        claims: all of them; where each stands names equations as "(34)" or "(30)-(36)"
    """
    return [claim.id for claim in claims if number in _equations(claim.where)]


def _equations(where: str) -> set[int]:
    """Return the numbers of the equations that a place names."""
    named: set[int] = set()
    for first, last in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", where):
        named.update(range(int(first), int(last or first) + 1))
    return named


def judge(evidence: Evidence) -> list[Claim]:
    """Return every claim with what was measured for it."""
    numbers = measure(evidence)
    return [_claim(text, numbers[text.id]) for text in texts()]


def _claim(text: Text, measured: Measured) -> Claim:
    """Return a claim with its numbers, and with those that its reason names."""
    why = text.why.format(**CONDITIONS, **measured.named)
    return Claim(text._replace(why=why), measured.printed, measured.repaired)
