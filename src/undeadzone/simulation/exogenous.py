"""Exogenous inputs along a run: targets, disturbance and noise, one row per step."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from undeadzone.feedforward.targets import Target, flat_targets, invert_targets, linear_targets
from undeadzone.scenario.problem import Problem
from undeadzone.signals import exosystem as signals
from undeadzone.signals import noise
from undeadzone.simulation.loop import RUNGE_KUTTA, ZOH_INPUTS, instants
from undeadzone.util.arrays import Floats, Integers, require_vector

NUDGE: Final = 1e-9  # of a step: a reference's corners on the grid belong to the step that follows
INSTANTS: Final = (0.0, 0.5, 1.0)  # of a continuous step, as fractions of it


class _Grid(NamedTuple):
    """The starts of a run's steps, and the random disturbance along them.

    Attributes:
        rows: number of each step (N).
        refine: rows per step of the scenario.
        step: between two rows [s].
        knots: the random disturbance at the scenario's samples, between which it runs straight.
    """

    rows: Integers
    refine: int
    step: float
    knots: Floats

    @property
    def lower(self) -> Integers:
        """Return the scenario's sample at or before each row (N)."""
        return self.rows // self.refine


def exogenous(
    problem: Problem, refine: int = 1, run: int | None = 0, seed: int | None = None
) -> Floats:
    """Return the exogenous inputs of a run: one row per step, and one for the last instant.

    A row is in the order of `loop.Exogenous`, of one instant in sampled time and of three in
    continuous time. With Taylor series (simulation.order above 4) the coefficients of a step stand
    in place of the instants.

    Args:
        problem: the problem to simulate.
        refine: rows per step.
        run: number of the run, which determines noise and random disturbance (None: 0 in their
            place).
        seed: of the random numbers (None: the scenario's).
    """
    simulation = problem.scenario.simulation
    plant = problem.plant
    rows = np.arange(problem.steps * refine + 1)
    seed = simulation.seed if seed is None else seed
    zoh_inputs = np.zeros((rows.size, ZOH_INPUTS * plant.p))
    if run is not None:
        zoh_inputs[:] = np.hstack(_draw_zoh_inputs(problem, seed, run))[rows // refine]
    grid = _Grid(rows, refine, simulation.step / refine, knots_of(problem, run, seed))
    if plant.Ts is not None:
        return np.hstack(_at_samples(problem, grid, zoh_inputs))
    if simulation.order > RUNGE_KUTTA:
        return np.hstack(_taylor_coefficients(problem, grid, zoh_inputs))
    return np.hstack(_at_instants(problem, grid, zoh_inputs))


def knots_of(problem: Problem, run: int | None, seed: int | None = None) -> Floats:
    """Return the random disturbance at the scenario's samples, between which it runs straight.

    Args:
        problem: the problem to simulate.
        run: number of the run (None: 0 in its place).
        seed: of the random numbers (None: the scenario's).

    Returns:
        A row for each sample, and one more ((N + 2) x m), or 0 if there is no random disturbance.
    """
    simulation = problem.scenario.simulation
    random = None if run is None else random_disturbance(problem)
    if random is None:
        return np.zeros((problem.steps + 2, problem.plant.m))
    seed = simulation.seed if seed is None else seed
    return noise.stationary_first_order_noise(
        seed, problem.steps + 2, *random, simulation.step, run or 0
    )


def _at_samples(problem: Problem, grid: _Grid, zoh_inputs: Floats) -> list[Floats]:
    """Return the inputs of each step in sampled time: targets at its start, w at its middle."""
    t = grid.rows * grid.step
    w = _disturbance(problem, grid, t + grid.step / 2, 0.5)
    return [*targets(problem, t), w, zoh_inputs]


def _at_instants(problem: Problem, grid: _Grid, zoh_inputs: Floats) -> list[Floats]:
    """Return the inputs at the start, middle and end of each step, one after the other."""
    parts: list[Floats] = []
    for fraction in INSTANTS:
        nudged = min(max(fraction, NUDGE), 1 - NUDGE)
        t = (grid.rows + nudged) * grid.step
        w = _disturbance(problem, grid, t, fraction)
        parts += [*targets(problem, t), w, zoh_inputs]
    return parts


def _taylor_coefficients(problem: Problem, grid: _Grid, zoh_inputs: Floats) -> list[Floats]:
    """Return the Taylor coefficients of the inputs over each step, a block (N x inputs) an order.

    With the step h, coefficient k is the k-th derivative times h^k / k!. Inputs that are constant
    over a step have order 0 only.

    Args:
        problem: the problem to simulate.
        grid: starts of the steps.
        zoh_inputs: inputs that are constant over a step (N x 5p).
    """
    # At a corner of the reference on the grid, the step that follows has its derivatives from the
    # right. They are taken NUDGE steps after the start.
    t = (grid.rows + NUDGE) * grid.step
    coefficients = []
    for k in range(problem.scenario.simulation.order):
        scale = grid.step**k / math.factorial(k)
        reference = linear_targets(problem.model, problem.reference, problem.tracked, t, k)
        scaled = [scale * value for value in reference[:3]]  # r, x_ref, u_ff
        if problem.disturbance is not None:
            w = scale * problem.disturbance.output_at(t, k)
        elif k == 0:
            w = _disturbance(problem, grid, t, 0.0)
        else:  # w is linear between two knots: order 1 is its slope, all higher orders are 0
            w = (grid.knots[grid.lower + 1] - grid.knots[grid.lower]) * (k == 1) / grid.refine
        zoh_part = zoh_inputs if k == 0 else np.zeros_like(zoh_inputs)
        coefficients.append(np.hstack([*scaled, w, zoh_part]))
    # Expand about the start of the step instead of the instant NUDGE later. Terms of NUDGE^2 are
    # below rounding: c_k(0) = c_k(NUDGE) - (k + 1) NUDGE c_(k+1).
    for k in range(len(coefficients) - 1):
        coefficients[k] = coefficients[k] - (k + 1) * NUDGE * coefficients[k + 1]
    return coefficients


def _disturbance(problem: Problem, grid: _Grid, t: Floats, fraction: float) -> Floats:
    """Return w at the instants t [s], which are at that fraction of their steps (N x m)."""
    if problem.disturbance is not None:
        return problem.disturbance.output_at(t)
    share = (grid.rows % grid.refine + fraction)[:, None] / grid.refine
    return interpolate_line(grid.knots[grid.lower], grid.knots[grid.lower + 1], share)


def _draw_zoh_inputs(problem: Problem, seed: int, run: int) -> list[Floats]:
    """Draw the inputs that each step holds constant: the last entries of `loop.Exogenous`.

    Args:
        problem: the problem to simulate.
        seed: of the random numbers.
        run: number of the run.

    Returns:
        For each step and the last instant: standard normal noise before the zone and after it (N x
        p each), relative growth of the widths, right then left (N x 2p), and NaN for a missing
        reading, else 0 (N x p).
    """
    sensor = problem.sensor
    p = problem.plant.p

    def normal(stream: int, size: Floats, channels: int) -> Floats:
        """Return standard normal numbers of a stream (N x channels), 0 if all sizes are 0."""
        shape = problem.steps + 1, channels
        return (
            noise.standard_normal_numbers(seed, stream, *shape, run)
            if size.any()
            else np.zeros(shape)
        )

    increments = normal(noise.WEAR, sensor.drift, 2 * p) * wear_deviations(problem)
    # The logarithm of a width is a random walk, so that no width becomes negative.
    growth = width_drift(np.cumsum(increments, axis=0))
    missing = missing_mask(normal(noise.LOSS, sensor.dropout, p), sensor.dropout)
    return [
        normal(noise.BEFORE, sensor.noise_before, p),
        normal(noise.AFTER, sensor.noise, p),
        growth,
        missing,
    ]


def widths(problem: Problem, exogenous: Floats) -> Floats:
    """Return the true d_r, d_l at the start of each step (N x 2 x p)."""
    p = problem.plant.p
    count = instants(problem.plant.Ts, problem.scenario.simulation.order)
    first = exogenous[:, : exogenous.shape[1] // count]
    wear = first[:, -3 * p : -p]
    return np.stack([problem.sensor.right, problem.sensor.left]) * (1 + wear.reshape(-1, 2, p))


def wear_deviations(problem: Problem) -> Floats:
    """Return the standard deviation of a step's increment of log width: right, then left (2p)."""
    return np.tile(problem.sensor.drift * np.sqrt(problem.scenario.simulation.step), 2)


def width_drift(walk: Floats) -> Floats:
    """Return the relative growth of an edge as the logarithm of its width has moved by `walk`."""
    return np.expm1(walk)


def missing_mask(normal: Floats, dropout: Floats) -> Floats:
    """Return NaN if a reading is missing, else 0 (... x p).

    Args:
        normal: standard normal numbers (... x p) (the lowest ones are missing).
        dropout: probability that a reading is missing (p).
    """
    if not dropout.any():
        return np.zeros_like(normal)
    from scipy.special import ndtri

    return np.where(normal < ndtri(dropout), np.nan, 0.0)


def random_disturbance(problem: Problem) -> tuple[Floats, float] | None:
    """Return (rms (m), correlation time [s]) of a random disturbance, or None without it.

    It runs in straight lines between the samples of the time grid.
    """
    signal = problem.scenario.disturbance
    if not isinstance(signal, signals.Random):
        return None
    rms = np.broadcast_to(np.asarray(signal.rms, float).ravel(), problem.plant.m)
    return rms, signal.correlation_time


def interpolate_line(first: Floats, last: Floats, fraction: Floats | float) -> Floats:
    """Return the straight line from first to last, exactly first at fraction 0 and last at 1."""
    return first * (1.0 - fraction) + last * fraction


def targets(problem: Problem, t: Floats) -> Target:
    """Return targets with the controller's feedforward along them.

    u_ff of a sampled nonlinear model is that of the middle of the step.

    Args:
        problem: the problem to simulate.
        t: times (N) [s].
    """
    target = _targets_at(problem, t)
    plan = problem.controller.plan
    if problem.model.nonlinear and problem.model.Ts is not None:
        target = target._replace(u_ff=_targets_at(problem, t + problem.model.Ts / 2).u_ff)
    planned = np.empty((t.size, 0)) if plan is None else plan.along(plan.params, target)
    return target._replace(plan=planned)


def _targets_at(problem: Problem, t: Floats) -> Target:
    """Return targets at times t [s], by the method that the model allows."""
    if not problem.model.nonlinear:
        return linear_targets(problem.model, problem.reference, problem.tracked, t)
    if problem.path is not None:
        return flat_targets(problem.flow, problem.path, problem.tracked, t)
    n = problem.model.n
    x_eq = problem.scenario.plant.x_eq
    start = require_vector("plant.x_eq", np.zeros(n) if x_eq is None else x_eq, n)
    return invert_targets(problem.flow, problem.reference, problem.tracked, t, start)
