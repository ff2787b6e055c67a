"""The audit of the paper as one value, and its numbers for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.results.run import Run
from undeadzone_paper.claims import Claim, about, judge
from undeadzone_paper.equations import EQUATIONS
from undeadzone_paper.evidence import RESTING, Evidence, gather
from undeadzone_paper.facts import Fact, facts
from undeadzone_paper.measures import rate
from undeadzone_paper.printed import DEFINITION, LAST, Count, Outcome, count, run_variants

Progress = Callable[[int], None]


class Paper(NamedTuple):
    """Everything that the audit found.

    Attributes:
        evidence: the runs on which claims are judged
        variants: what each variant of the example as printed does
        facts: numbers beside their closed forms
        claims: the paper's claims judged
    """

    evidence: Evidence
    variants: list[Outcome]
    facts: list[Fact]
    claims: list[Claim]

    @property
    def counts(self) -> list[Count]:
        """Return the variants counted by plant and start."""
        return count(self.variants)

    def summary(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON.

        `printed` is the literal example with r = 5 sin 2 pi t, `repaired` its repair.
        """
        five, two = self.evidence.repaired
        texts = [claim.text for claim in self.claims]
        return {
            "printed": _numbers_as_printed(self.evidence.printed[RESTING][0]),
            "repaired": _numbers_of_repair(five),
            "repaired_2sin": _numbers_of_repair(two),
            "repaired_sampled": _numbers_of_repair(self.evidence.sampled),
            "variants": {
                "definition": DEFINITION,
                "counts": [item._asdict() for item in self.counts],
            },
            "facts": [fact._asdict() for fact in self.facts],
            "verdicts": dict(Counter(claim.verdict for claim in self.claims)),
            "claims": [claim.summary() for claim in self.claims],
            "equations": [
                {**equation._asdict(), "claims": about(equation.number, texts)}
                for equation in EQUATIONS
            ],
        }


def audit(progress: Progress | None = None) -> Paper:
    """Run the example in every variant and repaired, and judge the claims.

    Args:
        progress: called with the number of steps just done
    """
    evidence = gather(progress)
    return Paper(evidence, run_variants(progress), facts(), judge(evidence))


SHOWN: Final = ("rms_tracking", "rms_estimation", "d_right", "d_left", "integration_error")


def _numbers_as_printed(run: Run) -> dict[str, Any]:
    """Return the numbers of a run as printed."""
    steady = run.t >= run.t[-1] - LAST
    numbers = {
        "max_abs_z": float(np.abs(run.z[steady]).max()),
        "peak_abs_z": float(np.abs(run.z).max()),
        "max_abs_y": float(np.abs(run.y).max()),
    }
    return numbers | {name: value for name, value in run.summary().items() if name in SHOWN}


def _numbers_of_repair(run: Run) -> dict[str, Any]:
    """Return the numbers of a repaired run."""
    return {**run.summary(), "rate": rate(run)}
