"""Audit of the paper as one value, and its numbers for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import starmap
from typing import Any, Final, NamedTuple

from undeadzone.results.run import Run
from undeadzone.util.arrays import to_json_value
from undeadzone_paper.both_sides import BothSides, compare_sides
from undeadzone_paper.claims import Claim, claims_on, judge_claims
from undeadzone_paper.equations import EQUATIONS, read_letters
from undeadzone_paper.evidence import NOMINAL, RESTING, Evidence, gather_evidence
from undeadzone_paper.facts import Fact, compute_facts
from undeadzone_paper.measures import largest_absolute, width_convergence_rate
from undeadzone_paper.printed import (
    DEFINITION,
    LAST,
    ZONE_FLAGS,
    Outcome,
    VariantCount,
    count_outcomes,
    run_variants,
)
from undeadzone_paper.theorem import count_theorem


class Paper(NamedTuple):
    """Results of the audit.

    Attributes:
        evidence: the runs on which claims are judged
        variants: what each variant of the example as printed does
        facts: numbers beside their closed forms
        claims: the paper's claims judged
        sides: both sides of each equation, by its number
    """

    evidence: Evidence
    variants: list[Outcome]
    facts: list[Fact]
    claims: list[Claim]
    sides: dict[int, BothSides]

    @property
    def count_variants(self) -> list[VariantCount]:
        """Count the variants by plant and start."""
        return list(starmap(VariantCount, count_outcomes(self.variants, 2, ZONE_FLAGS)))

    def summary(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON.

        `printed` is the literal example with r = 5 sin 2 pi t, `repaired` its repair.
        """
        names = ("repaired", "repaired_2sin", "repaired_sampled")
        repaired = dict(zip(names, self.evidence.repaired["both times"], strict=True))
        texts = [claim.text for claim in self.claims]
        summary: dict[str, Any] = {
            "printed": _numbers_as_printed(self.evidence.printed[NOMINAL][RESTING][0]),
            **{
                name: {**run.summary(), "rate": width_convergence_rate(run)}
                for name, run in repaired.items()
            },
            "variants": {
                "definition": DEFINITION,
                "counts": self.count_variants,
            },
            "facts": self.facts,
            "verdicts": dict(Counter(claim.verdict for claim in self.claims)),
            "claims": [claim.summary() for claim in self.claims],
            "theorem": count_theorem(self.evidence.theorem),
            "arm": self.evidence.arm,
            "equations": [
                {
                    **equation._asdict(),
                    **self.sides[equation.number]._asdict(),
                    "claims": claims_on("equation", equation.number, texts),
                }
                for equation in EQUATIONS
            ],
            "letters": read_letters(),
        }
        return dict(to_json_value(summary))


def audit(progress: Callable[[int], None] | None = None) -> Paper:
    """Run the example in every variant and repaired, and decide the claims.

    Args:
        progress: called with the number of steps just done
    """
    evidence = gather_evidence(progress)
    return Paper(
        evidence,
        run_variants(progress),
        compute_facts(),
        judge_claims(evidence),
        compare_sides(evidence),
    )


LISTED: Final = ("rms_tracking", "rms_estimation", "d_right", "d_left", "integration_error")


def _numbers_as_printed(run: Run) -> dict[str, Any]:
    """Return the numbers of a run as printed."""
    steady = run.t >= run.t[-1] - LAST
    numbers = {
        "max_abs_z": largest_absolute(run.z[steady]),
        "peak_abs_z": largest_absolute(run.z),
        "max_abs_y": largest_absolute(run.y),
    }
    return numbers | {name: value for name, value in run.summary().items() if name in LISTED}
