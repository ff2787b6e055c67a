"""All variants of the example as printed: exits from the zone, moves of d^, divergence.

A variant picks L of three, the observer with or without B u, the sign of sigma, the sign of the PD
law (the two halves of (42) contradict each other) and the sign convention of d_l: 48 for each plant
and start. The loop's graph is built once. Plant, gains and signs are its run-time parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product
from typing import Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.controllers import PD
from undeadzone.linalg.poles import observer_gain
from undeadzone.plants.build import system
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Simulation
from undeadzone.simulation.loop import Loop, Outputs
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
from undeadzone_paper.observer import Printed

STEP: Final = 5e-3  # [s]
DURATION: Final = 12.0  # [s]; what diverges has done so by then
LAST: Final = 4.0  # [s] over which the steady amplitude is read
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
    """Outcome of a variant.

    Attributes:
        variant: which one
        steady: max |z| over the last 4 s (None: diverged)
        peak: max |z| over all, up to its divergence
        leaves_zone: whether z leaves the dead zone
        moves_widths: whether d^ moves
        diverged_at: when a signal leaves +-LIMIT [s] (None: never)
    """

    variant: Variant
    steady: float | None
    peak: float
    leaves_zone: bool
    moves_widths: bool
    diverged_at: float | None


class VariantCount(NamedTuple):
    """Counts of outcomes over the variants of one plant and start."""

    plant: str
    start: str
    total: int
    leave_zone: int
    move_widths: int
    diverge: int


def run_variants(progress: Callable[[int], None] | None) -> list[Outcome]:
    """Run every variant, 4 plants x 3 starts x 48, with r = 5 sin 2 pi t.

    Args:
        progress: called with the number of steps just done
    """
    simulation = Simulation(duration=DURATION, step=STEP)
    problem = resolve_scenario(
        msgspec.structs.replace(example_as_printed(5.0), simulation=simulation)
    )
    loop, _, exogenous = prepare(problem)
    run = engine_for(loop, "auto", len(exogenous))
    outcomes = []
    for plant, name in product(READINGS, GAINS):
        with_gains = _with_gains(loop, problem, plant, name)
        for choice in product(STARTS, (False, True), (1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)):
            start, feeds_input, sigma, pd_sign, left_sign = choice
            variant = Variant(plant, start, name, feeds_input, sigma, pd_sign, left_sign)
            with_signs, state = _with_signs(with_gains, variant)
            signal = outputs_of(Start(with_signs, state, exogenous), progress, run)
            outcomes.append(_build_outcome(variant, signal))
    return outcomes


def gain_by_name(name: str, model: System) -> Floats:
    """Return L by name (2): (40), its negative, or the gain that places the poles of (40)."""
    if name == "placed":
        return observer_gain(model.linear, POLES, None)
    return np.array(L_PRINTED) * {"printed": 1.0, "negated": -1.0}[name]


def count_outcomes(outcomes: Iterable[Outcome]) -> list[VariantCount]:
    """Count the outcomes per plant and start, in their order."""
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in outcomes:
        key = outcome.variant.plant, outcome.variant.start
        groups.setdefault(key, []).append(outcome)
    return [_count_group(*key, group) for key, group in groups.items()]


def _count_group(plant: str, start: str, outcomes: list[Outcome]) -> VariantCount:
    """Count the outcomes of one plant and start."""
    return VariantCount(
        plant,
        start,
        total=len(outcomes),
        leave_zone=sum(outcome.leaves_zone for outcome in outcomes),
        move_widths=sum(outcome.moves_widths for outcome in outcomes),
        diverge=sum(outcome.diverged_at is not None for outcome in outcomes),
    )


def _with_gains(loop: Loop, problem: Problem, plant: str, name: str) -> Loop:
    """Return the loop with a reading of the plant and the gains L of a name."""
    model = system(READINGS[plant].plant)
    L = gain_by_name(name, model)
    observer = Printed(L=L, alpha=ALPHA).build(model, problem.sensor)
    law = PD(L=L, alpha=ALPHA).build(model)
    params = loop.params._replace(
        plant=model.params, observer=observer.params, controller=law.params
    )
    return loop._replace(params=params)


def _with_signs(loop: Loop, variant: Variant) -> tuple[Loop, Floats]:
    """Return the loop with a variant's signs, and its packed initial state."""
    x1, width = STARTS[variant.start]
    observer = loop.params.observer
    law = loop.params.controller
    observer = observer._replace(
        sigma=np.float64(variant.sigma),
        feed_input=np.float64(variant.feeds_input),
        left_sign=np.float64(variant.left_sign),
    )
    law = law._replace(k_p=variant.pd_sign * law.k_p, k_d=variant.pd_sign * law.k_d)
    params = loop.params._replace(observer=observer, controller=law)
    widths = np.array([width])
    state = loop.state._replace(
        plant=np.array([x1, 0.0]),
        observer=loop.state.observer._replace(right=widths, left=widths),
    )
    return loop._replace(params=params), tree.pack_tree(state)


def _build_outcome(variant: Variant, signal: Outputs) -> Outcome:
    """Compute the outcome from the signals up to their divergence."""
    diverged = first_divergence(signal)
    end = len(signal.z) if diverged is None else diverged
    z = np.abs(signal.z[:end, 0])
    widths = np.hstack([signal.estimate.right, signal.estimate.left])[:end]
    steady = float(z[-round(LAST / STEP) :].max())
    return Outcome(
        variant,
        steady=None if diverged is not None else steady,
        peak=float(z.max()),
        leaves_zone=bool(z.max() > D),
        moves_widths=bool(np.abs(widths - widths[0]).max() > MOVED),
        diverged_at=None if diverged is None else diverged * STEP,
    )


def first_divergence(signal: Outputs) -> int | None:
    """Return the number of the first sample with a signal beyond `LIMIT`, or None."""
    largest = np.abs(np.hstack([*signal[:-1], *signal.estimate])).max(axis=1)
    bad = np.flatnonzero(~(largest < LIMIT))
    return int(bad[0]) if bad.size else None
