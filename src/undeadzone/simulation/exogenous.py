"""What comes from outside along a run: targets, disturbance and noise, one row per step."""

from __future__ import annotations

import math

import numpy as np

from undeadzone.feedforward.targets import Target, flat_targets, inverted_targets, linear_targets
from undeadzone.scenario.problem import Problem
from undeadzone.signals import exosystem as signals
from undeadzone.signals import noise
from undeadzone.simulation.loop import HELD, RUNGE_KUTTA
from undeadzone.support.arrays import Floats, Integers, vector

NUDGE = 1e-9  # of a step: corners of a reference on the grid belong to the step that follows them
INSTANTS = (0.0, 0.5, 1.0)  # of a continuous step, as fractions of it


def exogenous(
    problem: Problem, refine: int = 1, run: int | None = 0, seed: int | None = None
) -> Floats:
    """One row per step, and one for the last instant, in the order of `loop.Exogenous`; three instants if continuous.

    With Taylor series (simulation.order above 4) the coefficients of a step stand in place of the instants.

    refine: rows per step; run, seed: of the noise and the random disturbance (None: 0 in their place; the scenario's).
    """
    simulation, plant = problem.scenario.simulation, problem.plant
    starts = np.arange(problem.steps * refine + 1)
    step = simulation.step / refine
    seed = simulation.seed if seed is None else seed
    held = np.zeros((starts.size, HELD * plant.p))
    knots: Floats = np.zeros((problem.steps + 2, plant.m))
    if run is not None:
        held[:] = np.hstack(_held(problem, seed, run))[starts // refine]
        if (random := random_disturbance(problem)) is not None:
            knots = noise.coloured(seed, problem.steps + 2, *random, simulation.step, run)

    def disturbance(t: Floats, fraction: float) -> Floats:
        """w at the instants t [s], which are at that fraction of their steps."""
        if problem.disturbance is not None:
            return problem.disturbance.value(t)
        lower, rest = starts // refine, (starts % refine + fraction)[:, None] / refine
        return between(knots[lower], knots[lower + 1], rest)

    if plant.Ts is not None:
        return np.hstack(
            [*_targets(problem, starts * step), disturbance(starts * step + step / 2, 0.5), held]
        )
    if simulation.order > RUNGE_KUTTA:
        return np.hstack(_coefficients(problem, starts, refine, knots, held))
    instants = [((starts + min(max(c, NUDGE), 1 - NUDGE)) * step, c) for c in INSTANTS]
    return np.hstack(
        [part for t, c in instants for part in (*_targets(problem, t), disturbance(t, c), held)]
    )


def _coefficients(
    problem: Problem, starts: Integers, refine: int, knots: Floats, held: Floats
) -> list[Floats]:
    """The exogenous inputs of each step as Taylor coefficients, one after the other; what is held has the first alone."""
    step = problem.scenario.simulation.step / refine
    lower, rest = starts // refine, (starts % refine)[:, None] / refine
    t, parts = (starts + NUDGE) * step, []
    for k in range(problem.scenario.simulation.order):
        scale = step**k / math.factorial(k)
        targets = linear_targets(problem.model, problem.reference, problem.tracked, t, k)
        if problem.disturbance is not None:
            w = scale * problem.disturbance.value(t, k)
        else:
            w = (
                between(knots[lower], knots[lower + 1], rest)
                if k == 0
                else (knots[lower + 1] - knots[lower]) * (k == 1) / refine
            )
        parts.append(
            np.hstack(
                [
                    *(scale * part for part in targets[:3]),
                    w,
                    held if k == 0 else np.zeros_like(held),
                ]
            )
        )
    for k in range(len(parts) - 1):
        parts[k] = (
            parts[k] - (k + 1) * NUDGE * parts[k + 1]
        )  # from the nudged instant back to the step's start
    return parts


def _held(problem: Problem, seed: int, run: int) -> list[Floats]:
    """What keeps its value within a step, a row each: the last entries of `loop.Exogenous`."""
    sensor, p = problem.sensor, problem.plant.p

    def normal(stream: int, size: Floats, channels: int) -> Floats:
        shape = problem.steps + 1, channels
        return noise.gaussian(seed, stream, *shape, run) if size.any() else np.zeros(shape)

    walk = worn(np.cumsum(normal(noise.WEAR, sensor.drift, 2 * p) * strides(problem), axis=0))
    missing = lost(normal(noise.LOSS, sensor.dropout, p), sensor.dropout)
    return [
        normal(noise.BEFORE, sensor.noise_before, p),
        normal(noise.AFTER, sensor.noise, p),
        walk,
        missing,
    ]


def widths(problem: Problem, exogenous: Floats) -> Floats:
    """The true d_r, d_l at the start of each step (N x 2 x p)."""
    p = problem.plant.p
    wear = exogenous[:, : exogenous.shape[1] // (1 if problem.plant.Ts is not None else 3)][
        :, -3 * p : -p
    ]
    return np.stack([problem.sensor.right, problem.sensor.left]) * (1 + wear.reshape(-1, 2, p))


def strides(problem: Problem) -> Floats:
    """By how much, rms, the logarithm of each width moves in a step: right, then left (2p)."""
    return np.tile(problem.sensor.drift * np.sqrt(problem.scenario.simulation.step), 2)


def worn(walk: Floats) -> Floats:
    """How much wider an edge is, relative, once the logarithm of its width has moved so far."""
    return np.expm1(walk)


def lost(normal: Floats, dropout: Floats) -> Floats:
    """NaN where standard normal numbers (... x p) are so low as happens with that probability, else 0."""
    from scipy.special import ndtri

    return (
        np.where(normal < ndtri(dropout), np.nan, 0.0) if dropout.any() else np.zeros_like(normal)
    )


def random_disturbance(problem: Problem) -> tuple[Floats, float] | None:
    """(rms (m), correlation time [s]) of a random disturbance, which runs in straight lines between samples of the time grid."""
    signal = problem.scenario.disturbance
    if not isinstance(signal, signals.Random):
        return None
    return np.broadcast_to(
        np.asarray(signal.rms, float).ravel(), problem.plant.m
    ), signal.correlation_time


def between(first: Floats, last: Floats, fraction: Floats | float) -> Floats:
    """The straight line from first to last at a fraction of the way, exactly first at 0 and last at 1."""
    return first * (1.0 - fraction) + last * fraction


def _targets(problem: Problem, t: Floats) -> Target:
    """Targets at times t [s], with what the controller plans along them; u_ff of a sampled nonlinear model is that of the middle of the step."""
    target, plan = _followed(problem, t), problem.controller.plan
    if problem.model.nonlinear and problem.model.Ts is not None:
        target = target._replace(u_ff=_followed(problem, t + problem.model.Ts / 2).u_ff)
    return target._replace(
        plan=np.empty((t.size, 0)) if plan is None else plan.along(plan.params, target)
    )


def _followed(problem: Problem, t: Floats) -> Target:
    if not problem.model.nonlinear:
        return linear_targets(problem.model, problem.reference, problem.tracked, t)
    if problem.path is not None:
        return flat_targets(problem.flow, problem.path, problem.tracked, t)
    eq = problem.scenario.plant.x_eq
    start = np.zeros(problem.model.n) if eq is None else vector("plant.x_eq", eq, problem.model.n)
    return inverted_targets(problem.flow, problem.reference, problem.tracked, t, start)
