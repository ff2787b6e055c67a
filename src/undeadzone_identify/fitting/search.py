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
SAME: Final = 0.01  # share of the ranges to which peaks of one value are told apart
POPULATION: Final = 32  # places of x(0) for each of its numbers
FITTEST: Final = 4  # one place in so many is one of the fittest, towards which others move
TURNS: Final = 24  # of an evolution, at each heat
PULLS: Final = (0.0, 0.0, 0.0, 0.7)  # shares of the way to one of the fittest
MOVES: Final = (0.3, 0.6, 1.0)  # factors of a difference of two places


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

    def keep_best(self, count: int, span: Floats) -> Peaks:
        """Return the best peaks, in order, each of them once.

        Args:
            count: at most.
            span: sizes of the ranges, in coordinates (k).
        """
        rows = np.column_stack([-self.values / GAIN, self.points / (SAME * span)])
        _, order = np.unique(np.round(rows), axis=0, return_index=True)
        return Peaks(self.points[order[:count]], self.values[order[:count]])


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
    return Slope(value, scores.sum(axis=1) - pull, information, scores)


def diagonal_of(problem: FitProblem, information: Floats) -> Floats:
    """Return the diagonal of an information, with a floor from the ranges."""
    return np.maximum(np.diag(information), 1e-12 / problem.span**2)


def choose_steps(problem: FitProblem, information: Floats, share: float) -> Floats:
    """Return steps of differences, a share of each number's deviation (k)."""
    steps = share / np.sqrt(diagonal_of(problem, information))
    return np.clip(steps, 1e-9 * problem.span, LARGEST_DIFFERENCE * problem.span)


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
    span = problem.span
    steps = FIRST_DIFFERENCE * span
    damping = 1e-2
    small = 0  # last steps that hardly gained
    for turn in range(most):
        slope = measure_slope(problem, point, steps, heat)
        value = slope.value
        steps = choose_steps(problem, slope.information, DIFFERENCE)
        moves = [_damped_step(problem, point, slope, damping * each, frozen) for each in DAMPINGS]
        trials = point + np.clip(moves, -LONGEST * span, LONGEST * span)
        trials = np.clip(trials, problem.low, problem.high)
        found = problem.evaluate_points(trials, heat)
        best = np.argmax(found)
        gain = found[best] - value
        damping *= DAMPINGS[best] if gain > 0 else STUCK
        if gain > 0:
            point, value = trials[best], found[best]
            damping = np.clip(damping, 1e-7, 1e6)
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
    near = np.abs(point - ends) <= AT_END * problem.span
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
    span = problem.span
    points = problem.low + span * qmc.Sobol(span.size, seed=seed).random(STARTS)
    points[0] = problem.start
    noises = np.array([each.is_noise for each in problem.free])
    started = np.array([each.is_start for each in problem.free])
    hot = HOT * np.array([*map(np.nanstd, problem.whole[2:4])])
    points[:, noises] = problem.start[noises]
    points[:, started] = evolve_start(problem, problem.start, started, hot, seed)[1, started]

    def run_stage(place: int, peaks: Peaks, share: float, count: int, most: int) -> Peaks:
        """Return the peaks of a stage, known or computed."""

        def compute_stage(missing: list[int]) -> Any:
            """Yield the peaks of the stage."""
            frozen = noises & (share > 0)
            found = []
            for point in peaks.keep_best(count, span).points:
                if place == _PLAN["evolved"]:  # x(0) by the numbers found
                    others = evolve_start(problem, point, started, hot, seed)
                    point = others[np.argmax(problem.evaluate_points(others, share * hot))]
                top, value = climb(problem, point, share * hot, most, frozen, tick)
                found.append([top.tolist(), value])
            yield 0, found

        (found,) = answers.compute_missing([[name, place, share, count, most]], compute_stage)
        return Peaks(*map(np.array, zip(*found, strict=True)))

    peaks = Peaks(points, problem.evaluate_points(points, hot))
    for k, stage in enumerate(_PLAN["stages"]):
        peaks = run_stage(k, peaks, *stage)
    return peaks.keep_best(STARTS, span)


def evolve_start(
    problem: FitProblem, point: Floats, started: Flags, hot: Floats, seed: int
) -> Floats:
    """Return a point, then others with the x(0) that the first readings show (points x k).

    The best one comes first.

    A climb from one place would end with a load at the wrong side of its gap. Places spread over
    the ranges evolve by differences, those of each log by its own likelihood. Source:
    doi:10.1023/A:1008202821328

    Args:
        problem: the numbers.
        point: values of all other numbers (k).
        started: flags of the numbers of x(0) (k).
        hot: noise and disturbance of a heat of 1.
        seed: of the places.
    """
    if not started.any():
        return np.tile(point, (2, 1))
    rng = np.random.default_rng(seed)
    logs = np.arange(len(problem.logs))
    ends = np.array([problem.low, problem.high])
    low, high = ends[:, started].reshape(2, logs.size, -1)
    size = POPULATION * low.shape[1]
    points = np.tile(point, (size, 1))
    trials = rng.uniform(low, high, (size, *low.shape))
    places = trials
    for count, share in _PLAN["first"]:
        part, heat = problem.keep_first(count), np.array(share) * hot
        values = np.full((size, logs.size), -np.inf)
        for _ in range(TURNS):
            points[:, started] = trials.reshape(size, -1)
            found = part.weigh_logs(points, heat) + problem.log_prior(points)[:, None]
            better = found > values
            places[better], values[better] = trials[better], found[better]
            order = np.argsort(-values, axis=0)
            places, values = places[order, logs], values[order, logs]
            near, one, other = (
                places[rng.integers(most, size=values.shape), logs]
                for most in (size // FITTEST, size, size)
            )
            pull, push = (rng.choice(each, (*values.shape, 1)) for each in (PULLS, MOVES))
            trials = np.clip(places + pull * (near - places) + push * (one - other), low, high)
        trials = places
    points[:, started] = places.reshape(size, -1)
    return np.vstack([point, points[: size // FITTEST]])
