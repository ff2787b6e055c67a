"""Search for the maximum of a likelihood: many starts, heat, Levenberg-Marquardt steps.

Far from the truth a silent reading has the density 0 and no slope. Heat is further noise and
further disturbance: the hot likelihood has a slope everywhere, and cools down to the true one.
Derivatives are differences between lanes, of a share of each number's own deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.stats import qmc

from undeadzone.util.answers import MemoryAnswers
from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.fitting.problem import FitProblem

STARTS: Final = 64  # points, of which the best are followed
HOT: Final = 0.2  # heat of the first stage, in the rms of readings and inputs
STAGES: Final = ((1.0, 8, 3), (1.0, 4, 6), (0.2, 4, 6), (0.04, 2, 6), (0.0, 2, 25))
AGAIN: Final = ((0.04, 2, 6), (0.0, 2, 25))  # from the answer, once more
DAMPINGS: Final = (1e-2, 1.0, 1e3)  # factors that each step tries
STUCK: Final = 1e6  # damping beyond which a search ends, and its growth without a gain
DIFFERENCE: Final = 0.02  # of a derivative, in deviations of the number
FIRST_DIFFERENCE: Final = 1e-4  # of the first one, in ranges
LARGEST_DIFFERENCE: Final = 2e-3  # in ranges
LONGEST: Final = 0.35  # step, in ranges
GAIN: Final = 0.01  # of the log likelihood below which a step is the last one, twice
DIVERGED: Final = 1e3  # of a log density, beyond which a reading contains no information
AT_END: Final = 1e-9  # share of a range, within which a number lies at its end


class Slope(NamedTuple):
    """Derivatives of a likelihood at a point.

    Attributes:
        value: log likelihood, the prior included.
        gradient: of it (k).
        information: about the numbers (k x k).
        scores: derivative of the log density of each reading (k x readings).
    """

    value: float
    gradient: Floats
    information: Floats
    scores: Floats


class Peaks(NamedTuple):
    """Peaks of searches from several starts, the best first.

    Attributes:
        points: coordinates (peaks x k).
        values: log likelihoods (peaks).
    """

    points: Floats
    values: Floats

    def keep_best(self, count: int) -> Peaks:
        """Return the best peaks."""
        order = np.argsort(-self.values, kind="stable")[:count]
        return Peaks(self.points[order], self.values[order])


def measure_slope(
    problem: FitProblem, point: Floats, steps: Floats, heat: tuple[float, float] = (0.0, 0.0)
) -> Slope:
    """Return the derivatives at a point (k), by differences of `steps` (k).

    The information of a sure reading is that of a normal distribution about its prediction, that of
    a silent one the square of its score.
    """
    moves = np.vstack([np.zeros(point.size), np.diag(steps)])
    records = problem.record_lanes(point + moves, heat)
    rows = [part.reshape(len(moves), -1) for part in records]
    scores, moved, wider = ((part[1:] - part[0]) / steps[:, None] for part in rows)
    density, _, log_std = (part[0] for part in rows)
    sure = (problem.whole.side.ravel() != 0) | (problem.kind == "plain")
    seen = np.isfinite(problem.whole.y.ravel()) & (np.abs(density) < DIVERGED)
    unsure = np.nan_to_num(scores[:, seen & ~sure])
    used = seen & sure
    shown = np.nan_to_num(moved[:, used] / np.exp(log_std[used]))
    wider = np.nan_to_num(wider[:, used])
    information = shown @ shown.T + 2 * wider @ wider.T + unsure @ unsure.T
    values = problem.decode_points(point[None])[0]
    slope = np.where(problem.is_log, values, 1.0)
    pull = (values - [each.start for each in problem.free]) / problem.prior_std**2
    information += np.diag((slope / problem.prior_std) ** 2)
    value = density.sum() + problem.log_prior(point[None])[0]
    return Slope(float(value), scores.sum(axis=1) - pull * slope, information, scores)


def diagonal_of(problem: FitProblem, information: Floats) -> Floats:
    """Return the diagonal of an information, with a floor from the ranges."""
    span = problem.high - problem.low
    return np.maximum(np.diag(information), 1e-12 / span**2)


def climb(
    problem: FitProblem,
    point: Floats,
    heat: tuple[float, float],
    most: int,
    frozen: Flags,
    tick: Callable[[int], None],
) -> tuple[Floats, float]:
    """Return the peak near a point, and its log likelihood, by Levenberg-Marquardt steps.

    Args:
        problem: the numbers.
        point: the start, within the ranges (k).
        heat: as of `FitProblem.record_lanes`.
        most: steps at most.
        frozen: flags of the numbers that stay (k).
        tick: called after each step.
    """
    span = problem.high - problem.low
    steps = FIRST_DIFFERENCE * span
    damping, value = 1e-2, -np.inf
    small = 0  # last steps that hardly gained
    for turn in range(most):
        slope = measure_slope(problem, point, steps, heat)
        value = slope.value
        units = DIFFERENCE / np.sqrt(diagonal_of(problem, slope.information))
        steps = np.clip(units, 1e-9 * span, LARGEST_DIFFERENCE * span)
        moves = [_damped_step(problem, point, slope, damping * each, frozen) for each in DAMPINGS]
        trials = point + np.clip(moves, -LONGEST * span, LONGEST * span)
        trials = np.clip(trials, problem.low, problem.high)
        found = problem.evaluate_points(trials, heat)
        best = int(np.argmax(found))
        gain = found[best] - value
        damping *= DAMPINGS[best] if gain > 0 else STUCK
        if gain > 0:
            point, value = trials[best], float(found[best])
            damping = min(max(damping, 1e-7), 1e6)
        small = small + 1 if gain < GAIN and turn > 0 else 0
        tick(1)
        if small > 1 or damping > STUCK:
            break
    return point, value


def _damped_step(
    problem: FitProblem, point: Floats, slope: Slope, damping: float, frozen: Flags
) -> Floats:
    """Return a step. Numbers at an end from which the likelihood falls stay."""
    span = problem.high - problem.low
    at_low = (point <= problem.low + AT_END * span) & (slope.gradient < 0)
    at_high = (point >= problem.high - AT_END * span) & (slope.gradient > 0)
    moving = np.flatnonzero(~(frozen | at_low | at_high))
    step = np.zeros(point.size)
    if not moving.size:
        return step
    units = 1 / np.sqrt(diagonal_of(problem, slope.information)[moving])
    even = slope.information[np.ix_(moving, moving)] * np.outer(units, units)
    pull = units * slope.gradient[moving]
    step[moving] = units * np.linalg.solve(even + max(damping, 1e-9) * np.eye(moving.size), pull)
    return step


def search_maximum(
    problem: FitProblem,
    seed: int,
    tick: Callable[[int], None],
    answers: MemoryAnswers,
    name: str = "",
) -> Peaks:
    """Return the peaks of the searches, the best first.

    Args:
        problem: the numbers.
        seed: of the starts.
        tick: called after each step.
        answers: stages that are known, or are to be saved.
        name: of the search among others.
    """
    low, high = problem.low, problem.high
    points = low + (high - low) * qmc.Sobol(low.size, seed=seed).random(STARTS)
    points[0] = problem.start
    noises = np.array([each.is_noise for each in problem.free])
    points[:, noises] = problem.start[noises]
    sizes = float(np.nanstd(problem.whole.y)), float(np.nanstd(problem.whole.u))

    def run_stage(place: str, peaks: Peaks, stage: tuple[float, int, int]) -> Peaks:
        """Return the peaks of a stage, known or computed."""
        share, count, most = stage
        heat = (share * HOT * sizes[0], share * HOT * sizes[1])

        def compute_stage(missing: list[int]) -> Any:
            """Yield the peaks of the stage."""
            chosen = peaks.keep_best(count).points
            frozen = noises & (share > 0)
            found = [climb(problem, point, heat, most, frozen, tick) for point in chosen]
            yield 0, [[point.tolist(), value] for point, value in found]

        (found,) = answers.compute_missing([[name, place, *stage]], compute_stage)
        return Peaks(*map(np.array, zip(*found, strict=True))).keep_best(count)

    heat = (HOT * sizes[0], HOT * sizes[1])
    peaks = Peaks(points, problem.evaluate_points(points, heat))
    for k, stage in enumerate(STAGES):
        peaks = run_stage(f"stage {k}", peaks, stage)
    again = peaks
    for k, stage in enumerate(AGAIN):
        again = run_stage(f"again {k}", again, stage)
    both = np.concatenate([peaks.points, again.points])
    return Peaks(both, np.concatenate([peaks.values, again.values])).keep_best(len(both))
