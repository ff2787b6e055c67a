"""Verdicts on the paper's claims.

Their text stands in `claims.toml`, once. The measured numbers come from `trials`. A verdict follows
from two measured numbers and a limit alone: the claim holds as printed, holds after repair, or does
not hold. Anything that the paper announces and does not contain is not shown.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from undeadzone.util.arrays import to_json_value
from undeadzone_paper.equations import read_words
from undeadzone_paper.evidence import CONDITIONS, Evidence
from undeadzone_paper.trials import ClaimNumbers, measure_claims

Verdict = Literal["holds", "holds after repair", "does not hold", "not shown"]
TINY: Final = 1e-12  # below it a number is rounding


class ClaimText(NamedTuple):
    """Text of a claim. `claims.toml` explains each entry.

    Attributes:
        id: its name in this audit
        where: place in the paper
        words: the paper's
        claim: tested statement
        quantity: what tests it
        limit: bound of the quantity
        why: the reason for the verdict, with {names} of numbers
        announced: whether the quantity counts announcements of the paper that no figure shows
        ours: whether the quantity and its limit are this audit's reading, not a figure's claim
        works: whether the claim is that the design works
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
    works: bool = False


class Claim(NamedTuple):
    """Claim with its measured numbers. An infinite value is a diverging run.

    Attributes:
        text: the claim in words
        printed: its quantity as printed, by case. The worst counts (empty: there is none)
        repaired: its quantity as repaired (None: there is nothing to repair)
    """

    text: ClaimText
    printed: dict[str, float]
    repaired: float | None

    @property
    def worst_printed(self) -> float | None:
        """Return the quantity as printed in the worst case, or None if there is none."""
        return max(self.printed.values(), default=None)

    @property
    def verdict(self) -> Verdict:
        """Return the verdict that follows from the numbers."""
        if _is_within(self.worst_printed, self.text.limit):
            return "holds"
        if self.text.announced:
            return "not shown"
        return (
            "holds after repair" if _is_within(self.repaired, self.text.limit) else "does not hold"
        )

    @property
    def numbers_text(self) -> str:
        """Return the numbers as text."""
        cases = [f"{value_text(value)} {case}".strip() for case, value in self.printed.items()]
        first = ", ".join(cases) or "none"
        limit = f"limit {self.text.limit:g}"
        if self.repaired is None:
            return f"{self.text.quantity}: {first}; {limit}"
        repaired = value_text(self.repaired)
        return f"{self.text.quantity}: as printed {first}; repaired {repaired}; {limit}"

    def summary(self) -> dict[str, Any]:
        """Return the claim ready for JSON, with None for missing or infinite values."""
        numbers = {"printed": self.worst_printed, "repaired": self.repaired}
        words = {"measured": self.numbers_text, "verdict": self.verdict}
        return {**self.text._asdict(), **to_json_value(numbers), **words}


HOW: Final = (
    "A verdict is computed: the measured number against its limit, as printed first (the worst "
    "case counts), then repaired."
)


COUNTS: Final[str] = (
    "{first} Of {works} such, {working[holds after repair]} hold after repair, "
    "{working[does not hold]} do not hold. Of all {total} statements {counts[holds]} hold as "
    "printed, {counts[holds after repair]} after repair, {counts[does not hold]} do not hold, "
    "{counts[not shown]} are announced and not shown."
)


def verdict_counts_text(claims: Iterable[Claim]) -> str:
    """Return the counts of the verdicts, first of the claims that the design works."""
    claims = list(claims)
    working = Counter(claim.verdict for claim in claims if claim.text.works)
    counts = Counter(claim.verdict for claim in claims)
    hold = working["holds"]
    first = "No statement" if hold == 0 else f"{hold} statement{'s' * (hold > 1)}"
    return COUNTS.format(
        first=f"{first} that the design works hold{'s' * (hold < 2)} as printed.",
        working=working,
        works=working.total(),
        counts=counts,
        total=counts.total(),
    )


def value_text(value: float) -> str:
    """Return a value as text."""
    if not np.isfinite(value):
        return "diverges"
    return f"{value if abs(value) > TINY else 0.0:.3g}"


def _is_within(value: float | None, limit: float) -> bool:
    """Return whether a value exists and is at most its limit."""
    return value is not None and value <= limit


def read_claim_texts() -> list[ClaimText]:
    """Read all claims from `claims.toml`. Conditions of the runs are filled in."""
    found = []
    for key, entry in read_words("claims.toml").items():
        text = ClaimText(id=key, **entry)
        quantity = text.quantity.format(**CONDITIONS)
        found.append(text._replace(quantity=quantity, why=" ".join(text.why.split())))
    return found


PLACES: Final = {
    "equation": r"\((\d+)\)(?:-\((\d+)\))?",  # "(34)" or "(30)-(36)"
    "figure": r"figures? ([1-8])(?: and ([1-8]))?",  # "figure 2" or "figures 3 and 4"
    "assumption": r"A([1-4])()",
}
"""How the places of claims name what is numbered: the first, and the last if there are several."""


def claims_on(kind: str, number: int, claims: Iterable[ClaimText]) -> list[str]:
    """Return the ids of the claims on an equation, a figure or an assumption.

    Args:
        kind: one of `PLACES`
        number: of the equation, the figure or the assumption
        claims: all of them
    """
    return [claim.id for claim in claims if number in _numbers_in(claim.where, PLACES[kind])]


def _numbers_in(where: str, pattern: str) -> set[int]:
    """Return the numbers that a place names."""
    named: set[int] = set()
    for first, last in re.findall(pattern, where):
        named.update(range(int(first), int(last or first) + 1))
    return named


def judge_claims(evidence: Evidence) -> list[Claim]:
    """Decide every claim by its measured numbers."""
    numbers = measure_claims(evidence)
    return [_build_claim(text, numbers[text.id]) for text in read_claim_texts()]


def _build_claim(text: ClaimText, measured: ClaimNumbers) -> Claim:
    """Build a claim with its numbers and those of its reason."""
    why = text.why.format(**CONDITIONS, **measured.named)
    return Claim(text._replace(why=why), measured.printed, measured.repaired)
