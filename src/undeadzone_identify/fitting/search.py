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
from undeadzone.util.files import read_table
from undeadzone_identify.fitting.problem import FitProblem

STARTS: Final = 64  # points, of which the best are followed
HOT: Final = 0.2  # heat of the first stage, in the rms of readings and inputs
_PLAN: Final = read_table(__file__)
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

    def keep_best(self, count: int | None = None) -> Peaks:
        """Return the best peaks, in order."""
        order = np.argsort(-self.values, kind="stable")[:count]
        return Peaks(self.points[order], self.values[order])


def measure_slope(
    problem: FitProblem, point: Floats, steps: Floats, heat: Any = (0.0, 0.0)
) -> Slope:
    """Return the derivatives at a point (k), by differences of `steps` (k).

    The information of a sure reading is that of a normal distribution about its prediction, that of
    a silent one the square of its score.
    """
    moves = np.vstack([np.zeros(point.size), np.diag(steps)])
    rows = [part.reshape(len(moves), -1) for part in problem.record_lanes(point + moves, heat)]
    scores, moved, wider = (np.nan_to_num((part[1:] - part[0]) / steps[:, None]) for part in rows)
    density, _, log_std = (part[0] for part in rows)
    sure = (problem.whole.side.ravel() != 0) | (problem.kind == "plain")
    seen = np.isfinite(problem.whole.y.ravel()) & (np.abs(density) < DIVERGED)
    shown = np.hstack([moved / np.exp(log_std), np.sqrt(2) * wider])[:, np.tile(seen & sure, 2)]
    shown = np.hstack([shown, scores[:, seen & ~sure]])
    information = shown @ shown.T + np.diag(problem.prior_std**-2.0)
    pull = (point - problem.start) / problem.prior_std**2
    value = density.sum() + problem.log_prior(point[None])[0]
    return Slope(float(value), scores.sum(axis=1) - pull, information, scores)


def diagonal_of(problem: FitProblem, information: Floats) -> Floats:
    """Return the diagonal of an information, with a floor from the ranges."""
    span = problem.high - problem.low
    return np.maximum(np.diag(information), 1e-12 / span**2)


def climb(
    problem: FitProblem,
    point: Floats,
    heat: Any,
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
    ends = np.where(slope.gradient < 0, problem.low, problem.high)
    near = np.abs(point - ends) <= AT_END * (problem.high - problem.low)
    moving = np.flatnonzero(~(frozen | near))
    units = 1 / np.sqrt(diagonal_of(problem, slope.information)[moving])
    even = slope.information[np.ix_(moving, moving)] * np.outer(units, units)
    even += max(damping, 1e-9) * np.eye(moving.size)
    step = np.zeros(point.size)
    step[moving] = units * np.linalg.solve(even, units * slope.gradient[moving])
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
    hot = HOT * np.array([np.nanstd(problem.whole.y), np.nanstd(problem.whole.u)])
    started = np.array([each.is_start for each in problem.free])

    def seek_start(point: Floats) -> Floats:
        """Return a point with the x(0) that the first readings show."""
        for count, share in _PLAN["first"]:
            point, _ = climb(
                problem.keep_first(count), point, np.array(share) * hot, 25, ~started, tick
            )
        return point

    points[:, noises | started] = seek_start(problem.start)[noises | started]

    def run_stage(place: int, peaks: Peaks, share: float, count: int, most: int) -> Peaks:
        """Return the peaks of a stage, known or computed."""

        def compute_stage(missing: list[int]) -> Any:
            """Yield the peaks of the stage."""
            frozen = noises & (share > 0)
            found = []
            points = peaks.keep_best(count).points
            if place == len(_PLAN["stages"]):  # x(0) by the numbers found
                points = np.array([*map(seek_start, points)])
            for point in points:
                top, value = climb(problem, point, share * hot, most, frozen, tick)
                found.append([top.tolist(), value])
            yield 0, found

        (found,) = answers.compute_missing([[name, place, share, count, most]], compute_stage)
        return Peaks(*map(np.array, zip(*found, strict=True))).keep_best(count)

    found = [Peaks(points, problem.evaluate_points(points, hot))]
    for k, stage in enumerate(_PLAN["stages"] + _PLAN["again"]):
        found.append(run_stage(k, found[-1], *stage))
    both = zip(found[len(_PLAN["stages"])], found[-1], strict=True)
    return Peaks(*map(np.concatenate, both)).keep_best()
