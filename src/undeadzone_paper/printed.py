"""All variants of the example as printed: exits from the zone, moves of d^, divergence.

A variant picks L of three, the observer with or without B u, the sign of sigma, the sign of the PD
law (the two halves of (42) contradict each other) and the sign convention of d_l: 48 for each plant
and start. The loop's graph is built once. Plant, gains and signs are its run-time parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import product, starmap
from operator import attrgetter
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.controllers import PD
from undeadzone.interfaces import require_graph
from undeadzone.linalg.poles import observer_gain
from undeadzone.plants.build import system
from undeadzone.plants.system import System
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.simulate import Start, engine_for, outputs_of, prepare
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_paper.example import (
    ALPHA,
    L_PRINTED,
    POLES,
    READINGS,
    STARTED,
    D,
    example_as_printed,
)
from undeadzone_paper.measures import largest_absolute
from undeadzone_paper.observer import Printed

STEP: Final = 5e-3  # [s]
DURATION: Final = 12.0  # [s]; what diverges has done so by then
LAST: Final = 4.0  # [s] over which the steady amplitude is read
LATE: Final = 2.0  # [s] over which errors are read
RIGHT: Final = 0.05  # errors of widths and state up to which a run ends right
LIMIT: Final = 1e6  # beyond it a variant has diverged
MOVED: Final = 1e-9  # change of d^ that counts as a move

GAINS: Final = ("printed", "negated", "placed")
STARTS: Final = {
    "from rest, d^(0) = 0": (0.0, 0.0),
    f"x1(0) = {STARTED:g}, d^(0) = 0": (STARTED, 0.0),
    "from rest, d^(0) = d": (0.0, D),
}

DEFINITION: Final = (
    "per plant and start: L in {(-1.25, -1.62), its negative, the one that places -4, -10} "
    "x observer with or without B u x sign of sigma x sign of the PD law x sign of d_l in (25) "
    f"= 48; diverged: a signal beyond {LIMIT:g}; steady: over the last {LAST:g} s "
    f"of {DURATION:g} s"
)


class Variant(NamedTuple):
    """One choice of all options that the paper leaves open or contradicts.

    Attributes:
        plant: one of `READINGS`
        start: one of `STARTS`
        L: one of `GAINS`
        feeds_input: whether the observer has B u
        sigma: its sign
        pd_sign: +1: -k_p (y - y^) - ..., the right half of (42) (-1: its left half, alpha B'P y~)
        left_sign: -1: (25) with d_l > 0 (+1: with a signed d_l < 0)
    """

    plant: str
    start: str
    L: str
    feeds_input: bool
    sigma: float
    pd_sign: float
    left_sign: float


class Outcome(NamedTuple):
    """Outcome of a variant of the example, or of Theorem 4.1.

    Attributes:
        variant: which one
        steady: max |z| over the last 4 s (None: diverged)
        peak: max |z| over all, up to its divergence
        leaves_zone: whether z leaves the dead zone
        moves_widths: whether d^ moves
        diverged_at: when a signal leaves +-LIMIT [s] (None: never)
        width_error: largest |d^ - d|, last 2 s (inf: diverged)
        state_error: largest |x^ - x|, last 2 s (inf: diverged)
    """

    variant: Any
    steady: float | None
    peak: float
    leaves_zone: bool
    moves_widths: bool
    diverged_at: float | None
    width_error: float
    state_error: float

    @property
    def diverges(self) -> bool:
        """Return whether a signal leaves +-LIMIT."""
        return self.diverged_at is not None

    @property
    def ends_right(self) -> bool:
        """Return whether the errors of widths and state end small."""
        return self.worst_error <= RIGHT

    @property
    def leaves_true_widths(self) -> bool:
        """Return whether a run that begins at d^ = d and survives ends with wrong widths."""
        return self.variant.width == D and RIGHT < self.width_error < np.inf

    @property
    def worst_error(self) -> float:
        """Return the larger of both errors."""
        return max(self.width_error, self.state_error)


class VariantCount(NamedTuple):
    """Counts of outcomes over the variants of one plant and start."""

    plant: str
    start: str
    total: int
    leave_zone: int
    move_widths: int
    diverge: int


ZONE_FLAGS: Final = ("leaves_zone", "moves_widths", "diverges")
"""What is counted of outcomes, in the order of `VariantCount`."""


def run_variants(progress: Callable[[int], None] | None) -> list[Outcome]:
    """Run every variant, 4 plants x 3 starts x 48, with r = 5 sin 2 pi t.

    Args:
        progress: called with the number of steps just done
    """
    signs = (1.0, -1.0)
    choices: Iterable[tuple[Any, ...]] = product(
        READINGS, GAINS, STARTS, (False, True), signs, signs, (-1.0, 1.0)
    )
    variants = [Variant(plant, start, L, *more) for plant, L, start, *more in choices]
    return run_all(variants, example_of_variant, progress)


def run_all(
    variants: list[Any], build: Callable[[Any], Scenario], progress: Callable[[int], None] | None
) -> list[Outcome]:
    """Run variants of one graph.

    Args:
        variants: of the example, or of the theorem
        build: builds the scenario of a variant
        progress: called with the number of steps just done
    """
    runs = run_family(list(map(build, variants)), progress)
    return list(starmap(_build_outcome, zip(variants, runs, strict=True)))


def example_of_variant(variant: Variant) -> Scenario:
    """Build the scenario of a variant, r = 5 sin 2 pi t."""
    x1, width = STARTS[variant.start]
    model = system(READINGS[variant.plant].plant)
    L = gain_by_name(variant.L, model)
    law = PD(L=L, alpha=ALPHA).build(model).params
    return example_as_printed(5.0) | {
        "plant": msgspec.structs.replace(READINGS[variant.plant].plant, x0=[x1, 0.0]),
        "observer": observer_of_variant(variant, L, width, variant.sigma),
        "controller": PD(k_p=variant.pd_sign * law.k_p, k_d=variant.pd_sign * law.k_d),
        "simulation": Simulation(duration=DURATION, step=STEP),
    }


def observer_of_variant(variant: Any, L: Floats, width: float, sigma: float = 1.0) -> Printed:
    """Return the observer of a variant of the example, or of the theorem, with d^(0) = width."""
    return Printed(
        L=L,
        sigma=sigma,
        alpha=ALPHA,
        widths0=width,
        feed_input=variant.feeds_input,
        left_sign=variant.left_sign,
    )


def run_family(
    scenarios: list[Scenario], progress: Callable[[int], None] | None
) -> Iterator[Outputs]:
    """Run scenarios that differ in numbers alone: all share the graph of the first.

    Args:
        scenarios: with the same reference, sensor and simulation
        progress: called with the number of steps just done
    """
    problem = resolve_scenario(scenarios[0])
    loop, _, exogenous = prepare(problem)
    run = engine_for(loop, "auto", len(exogenous) * len(scenarios))
    for scenario in scenarios:
        model = system(scenario.plant)
        observer = require_graph(scenario.observer.build(model, problem.sensor))
        params = loop.params._replace(
            plant=model.params,
            observer=observer.params,
            controller=scenario.controller.build(model).params,
        )
        state = loop.state._replace(
            plant=np.array(scenario.plant.x0), observer=observer.init(observer.params)
        )
        start = Start(loop._replace(params=params), tree.pack_tree(state), exogenous)
        yield outputs_of(start, progress, run)


def gain_by_name(name: str, model: System) -> Floats:
    """Return L by name (2): (40), its negative, or the gain that places the poles of (40)."""
    printed = np.array(L_PRINTED)
    placed = observer_gain(model.linear, POLES, None).ravel()
    return dict(zip(GAINS, (printed, -printed, placed), strict=True))[name]


def count_outcomes(
    outcomes: Iterable[Outcome], fields: int, flags: tuple[str, ...]
) -> list[tuple[Any, ...]]:
    """Count outcomes by the first fields of their variants, in their order.

    Args:
        outcomes: with their variants
        fields: how many fields of a variant name its group
        flags: what is counted

    Returns:
        Rows of these fields, the outcomes of the group, and the counts of each flag.
    """
    groups: dict[tuple[Any, ...], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(outcome.variant[:fields], []).append(outcome)
    return [(*key, len(group), *count_flags(group, flags)) for key, group in groups.items()]


def count_flags(outcomes: Iterable[Outcome], flags: tuple[str, ...]) -> list[int]:
    """Count the outcomes with each of some flags."""
    get_flags = attrgetter(*flags)
    return np.sum(list(map(get_flags, outcomes)), axis=0).tolist()


def _build_outcome(variant: Any, signal: Outputs) -> Outcome:
    """Compute the outcome from the signals up to their divergence."""
    end = _first_divergence(signal)
    z = np.abs(signal.z[:end, 0])
    widths = np.hstack([signal.estimate.right, signal.estimate.left])
    errors = (widths - D, signal.estimate.x - signal.x)
    late = [largest_absolute(error[-round(LATE / STEP) :]) for error in errors]
    return Outcome(
        variant,
        steady=float(z[-round(LAST / STEP) :].max()) if end is None else None,
        peak=float(z.max()),
        leaves_zone=bool(z.max() > D),
        moves_widths=bool(np.abs(widths[:end] - widths[0]).max() > MOVED),
        diverged_at=None if end is None else end * STEP,
        width_error=late[0] if end is None else np.inf,
        state_error=late[1] if end is None else np.inf,
    )


def _first_divergence(signal: Outputs) -> int | None:
    """Return the number of the first sample with a signal beyond `LIMIT`, or None."""
    largest = np.abs(np.hstack([*signal[:-1], *signal.estimate])).max(axis=1)
    bad = np.flatnonzero(~(largest < LIMIT))
    return int(bad[0]) if bad.size else None
