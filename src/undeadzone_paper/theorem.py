"""Theorem 4.1 with its own control law (29), in every variant of the printed equations.

A variant is one way to read the printed equations. It picks the plant, L, the observer with or
without B u, the sign of chi_l, the start, d^(0), the sign of (29), and whether d - d^ is given, as
the proof has it, or estimated. For either of the last the loop's graph is built once. Plant, gains
and signs are its run-time parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product
from math import prod
from typing import Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.simulation.loop import Outputs
from undeadzone_paper.example import (
    ALPHA,
    DURATION,
    READINGS,
    STARTED,
    D,
    example_as_printed,
)
from undeadzone_paper.law import PrintedLaw
from undeadzone_paper.measures import largest_absolute
from undeadzone_paper.observer import Printed
from undeadzone_paper.printed import count_outcomes, first_divergence, gain_by_name, run_family

STEP: Final = 5e-3  # [s]
LAST: Final = 2.0  # [s] over which errors are read
RIGHT: Final = 0.05  # errors of widths and state up to which a run ends right
NEAR_REST: Final = 0.01  # x1(0); at 0 rounding would decide about a loop that begins at the truth
UNEQUAL: Final = 0.2  # d^(0) that is not d

PLANTS: Final = {
    "(39)": READINGS["omega_n = 1"].plant,
    "(15)": Plant(companion=[0.0, 0.0]),
}
GAINS: Final = {"printed": "(40)", "placed": "the poles"}
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

READINGS_OF_THEOREM: Final = prod(len(choice) for choice in CHOICES)


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


class TheoremOutcome(NamedTuple):
    """Outcome of a variant.

    Attributes:
        variant: which one
        width_error: largest |d^ - d|, last 2 s (None: diverged)
        state_error: largest |x^ - x|, last 2 s (None: diverged)
        diverged_at: when a signal leaves its limit [s] (None: never)
    """

    variant: TheoremVariant
    width_error: float | None
    state_error: float | None
    diverged_at: float | None

    @property
    def worst_error(self) -> float:
        """Return the larger of both errors, infinite if the run diverges."""
        if self.width_error is None or self.state_error is None:
            return np.inf
        return max(self.width_error, self.state_error)

    @property
    def flags(self) -> tuple[bool, ...]:
        """Return whether it diverges, ends right, leaves true widths: what is counted."""
        return self.diverged_at is not None, self.worst_error <= RIGHT, self.leaves_widths

    @property
    def leaves_widths(self) -> bool:
        """Return whether a run that begins at d^ = d and survives ends with wrong widths."""
        return self.variant.width == D and (self.width_error or 0.0) > RIGHT


class TheoremCount(NamedTuple):
    """Counts of the outcomes of one law and plant."""

    mismatch: str
    law: str
    plant: str
    total: int
    diverge: int
    end_right: int
    leave_true_widths: int


def example_of_theorem(variant: TheoremVariant) -> Scenario:
    """Build the scenario of a variant, r = 5 sin 2 pi t."""
    L = gain_by_name(variant.L, system(PLANTS[variant.plant]))
    return example_as_printed(5.0) | {
        "title": "Theorem 4.1: observer (16), (17), adaptation (25), law (29)",
        "plant": msgspec.structs.replace(PLANTS[variant.plant], x0=[variant.x1, 0.0]),
        "observer": Printed(
            L=L,
            alpha=ALPHA,
            widths0=variant.width,
            feed_input=variant.feeds_input,
            left_sign=variant.left_sign,
        ),
        "controller": PrintedLaw(
            L=L,
            widths=D if variant.mismatch == GIVEN else None,
            alpha=ALPHA,
            sign=LAWS[variant.law],
            left_sign=variant.left_sign,
        ),
        "simulation": Simulation(duration=DURATION, step=STEP),
    }


def run_theorem(progress: Callable[[int], None] | None = None) -> list[TheoremOutcome]:
    """Run every variant: 2 mismatches x 2 signs x 64.

    Args:
        progress: called with the number of steps just done
    """
    outcomes: list[TheoremOutcome] = []
    for mismatch in (GIVEN, ESTIMATED):
        variants = [TheoremVariant(mismatch, *choice) for choice in product(LAWS, *CHOICES)]
        runs = run_family([example_of_theorem(variant) for variant in variants], progress)
        outcomes += [_build_outcome(*pair) for pair in zip(variants, runs, strict=True)]
    return outcomes


def _build_outcome(variant: TheoremVariant, signal: Outputs) -> TheoremOutcome:
    """Compute the outcome of a variant from its signals."""
    end = first_divergence(signal)
    if end is not None:
        return TheoremOutcome(variant, None, None, end * STEP)
    last = slice(-round(LAST / STEP), None)
    widths = np.hstack([signal.estimate.right, signal.estimate.left])[last]
    states = (signal.estimate.x - signal.x)[last]
    return TheoremOutcome(variant, largest_absolute(widths - D), largest_absolute(states), None)


def count_theorem(outcomes: Iterable[TheoremOutcome]) -> list[TheoremCount]:
    """Count the outcomes per knowledge of d - d^, law and plant, in their order."""
    return [TheoremCount(*row) for row in count_outcomes(outcomes, 3)]


def select_outcomes(
    outcomes: Iterable[TheoremOutcome], mismatch: str, law: str = AS_PRINTED
) -> list[TheoremOutcome]:
    """Select the outcomes by knowledge of d - d^ and by law."""
    variant = mismatch, law
    return [outcome for outcome in outcomes if outcome.variant[:2] == variant]


def count_diverging(outcomes: Iterable[TheoremOutcome]) -> int:
    """Count the runs that diverge."""
    return sum(outcome.diverged_at is not None for outcome in outcomes)


def is_kindest(variant: TheoremVariant) -> bool:
    """Return whether a variant is the kindest: B u, chi_bar mended, begun outside the zone."""
    return variant.feeds_input and variant.left_sign > 0 and variant.x1 == STARTED
