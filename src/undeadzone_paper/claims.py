"""The paper's claims judged.

A verdict follows from two measured numbers and a limit alone: the claim holds as printed, holds
after repair, or does not hold. What the paper announces and does not contain is not shown.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from undeadzone.support.arrays import finite
from undeadzone_paper.claim_texts import TEXTS, Text
from undeadzone_paper.evidence import Evidence
from undeadzone_paper.trials import measure

Verdict = Literal["holds", "holds after repair", "does not hold", "not shown"]


class Claim(NamedTuple):
    """A claim and what was measured for it; an infinite value: the run diverges.

    Attributes:
        text: the claim in words
        printed: its quantity as printed, by case; the worst counts
        repaired: its quantity as repaired
    """

    text: Text
    printed: dict[str, float]
    repaired: float

    @property
    def verdict(self) -> Verdict:
        """What the numbers say."""
        if max(self.printed.values()) <= self.text.limit:
            return "holds"
        if self.text.announced:
            return "not shown"
        return "holds after repair" if self.repaired <= self.text.limit else "does not hold"

    @property
    def measured(self) -> str:
        """The numbers in words."""
        cases = [f"{_words(value)} {case}".strip() for case, value in self.printed.items()]
        repaired, limit = _words(self.repaired), f"{self.text.limit:g}"
        return (
            f"{self.text.quantity}: as printed {', '.join(cases)}; "
            f"repaired {repaired}; limit {limit}"
        )

    def summary(self) -> dict[str, Any]:
        """The claim ready for JSON; values that are not finite become None."""
        return {
            **self.text._asdict(),
            "printed": finite(max(self.printed.values())),
            "repaired": finite(self.repaired),
            "measured": self.measured,
            "verdict": self.verdict,
        }


def _words(value: float) -> str:
    """A value in words."""
    return f"{value:.3g}" if np.isfinite(value) else "diverges"


def judge(evidence: Evidence) -> list[Claim]:
    """Every claim with what was measured for it."""
    numbers = measure(evidence)
    return [Claim(text, *numbers[text.id]) for text in TEXTS]
