"""Theorem 4.1 with its own control law (29), in every variant of the printed equations.

A variant is one way to read the printed equations. It picks the plant, L, the observer with or
without B u, the sign of chi_l, the start, d^(0), the sign of (29), and whether d - d^ is given, as
the proof has it, or estimated. For either of the last the loop's graph is built once. Plant, gains
and signs are its run-time parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product, starmap
from math import prod
from typing import Final, NamedTuple

import msgspec

from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone_paper.example import (
    ALPHA,
    DURATION,
    READINGS,
    STARTED,
    D,
    example_as_printed,
)
from undeadzone_paper.law import PrintedLaw
from undeadzone_paper.printed import (
    STEP,
    Outcome,
    count_outcomes,
    gain_by_name,
    observer_of_variant,
    run_all,
)

NEAR_REST: Final = 0.01  # x1(0); at 0 rounding would decide about a loop that begins at the truth
UNEQUAL: Final = 0.2  # d^(0) that is not d

PLANTS: Final = {
    "(39)": READINGS["omega_n = 1"].plant,
    "(15)": Plant(companion=[0.0, 0.0]),
}
GAINS: Final = ("printed", "placed")
GIVEN = "given"
ESTIMATED = "estimated"
AS_PRINTED = "(29) as printed"
OTHER_SIGN = "with the sign of the left half of (42)"
LAWS: Final = {AS_PRINTED: 1.0, OTHER_SIGN: -1.0}  # and their signs

DEFINITION: Final = (
    "A reading of the equations picks plant, L, B u in the observer or not, the sign of chi_l, "
    "x1(0) and d^(0). The law needs d - d^: given, as the proof has it, or estimated by (28) with "
    "x^ = x. A run ends right if widths and state are off by at most 0.05 over the last 2 s. "
    "Runs begin at x1(0) = 5 or nearly at rest, at 0.01: exactly at the truth, an unstable error "
    "would be left to rounding."
)

CHOICES: Final = (PLANTS, GAINS, (False, True), (-1.0, 1.0), (NEAR_REST, STARTED), (D, UNEQUAL))
"""Choices of a variant beside the law and its knowledge of d - d^, in the order of its fields."""

READINGS_OF_THEOREM: Final = prod(map(len, CHOICES))


class TheoremVariant(NamedTuple):
    """Variant of the theorem: one way to read its printed equations.

    Attributes:
        mismatch: how the law knows d - d^
        law: one of `LAWS`
        plant: one of `PLANTS`
        L: one of `GAINS`
        feeds_input: whether the observer has B u
        left_sign: -1 as printed, +1 with a signed d_l
        x1: x1(0)
        width: d^(0)
    """

    mismatch: str
    law: str
    plant: str
    L: str
    feeds_input: bool
    left_sign: float
    x1: float
    width: float


class TheoremCount(NamedTuple):
    """Counts of the outcomes of one law and plant."""

    mismatch: str
    law: str
    plant: str
    total: int
    diverge: int
    end_right: int
    leave_true_widths: int


ERROR_FLAGS: Final = ("diverges", "ends_right", "leaves_true_widths")
"""What is counted of outcomes, in the order of `TheoremCount`."""


def example_of_theorem(variant: TheoremVariant) -> Scenario:
    """Build the scenario of a variant, r = 5 sin 2 pi t."""
    L = gain_by_name(variant.L, system(PLANTS[variant.plant]))
    return example_as_printed(5.0) | {
        "title": "Theorem 4.1: observer (16), (17), adaptation (25), law (29)",
        "plant": msgspec.structs.replace(PLANTS[variant.plant], x0=[variant.x1, 0.0]),
        "observer": observer_of_variant(variant, L, variant.width),
        "controller": PrintedLaw(
            L=L,
            widths=D if variant.mismatch == GIVEN else None,
            alpha=ALPHA,
            sign=LAWS[variant.law],
            left_sign=variant.left_sign,
        ),
        "simulation": Simulation(duration=DURATION, step=STEP),
    }


def run_theorem(progress: Callable[[int], None] | None = None) -> list[Outcome]:
    """Run every variant: 2 mismatches x 2 signs x 64.

    Args:
        progress: called with the number of steps just done
    """
    outcomes: list[Outcome] = []
    for mismatch in (GIVEN, ESTIMATED):
        variants = [TheoremVariant(mismatch, *choice) for choice in product(LAWS, *CHOICES)]
        outcomes += run_all(variants, example_of_theorem, progress)
    return outcomes


def count_theorem(outcomes: Iterable[Outcome]) -> list[TheoremCount]:
    """Count the outcomes per knowledge of d - d^, law and plant, in their order."""
    return list(starmap(TheoremCount, count_outcomes(outcomes, 3, ERROR_FLAGS)))


def select_outcomes(
    outcomes: Iterable[Outcome], mismatch: str, law: str = AS_PRINTED
) -> list[Outcome]:
    """Select the outcomes by knowledge of d - d^ and by law."""
    variant = mismatch, law
    return [outcome for outcome in outcomes if outcome.variant[:2] == variant]


def is_kindest(variant: TheoremVariant) -> bool:
    """Return whether a variant is the kindest: B u, chi_bar mended, begun outside the zone."""
    return variant.feeds_input and variant.left_sign > 0 and variant.x1 == STARTED
