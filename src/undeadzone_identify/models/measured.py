"""Numbers of a fitted model with 95 % intervals, from every stage of its fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models.estimates import (
    EstimateCovariance,
    Interval,
    central_differences,
    perturb_each,
    perturbation_steps,
)
from undeadzone_identify.models.least_squares import FittedModel, Model

FINEST = 2e-4  # rms of its signal: no interval of a width is narrower


class Stage(Protocol):
    """Log likelihood or sum of squares that a stage of a fit maximises."""

    free: Integers

    def robust_covariance(self, theta: Floats) -> EstimateCovariance:
        """Return the robust covariance (I1) of the free parameters."""


Stages = Sequence[tuple[Stage, Floats]]
WIDTHS = np.array(list(DIRECTIONS.values()))


class Measured(NamedTuple):
    """Widths of an element, scaled.

    Attributes:
        intervals: right, left, width, centre.
        degrees: least degrees of freedom of these.
    """

    intervals: dict[str, Interval]
    degrees: float

    def scale_by(self, factor: float) -> dict[str, Interval]:
        """Return the intervals in other units."""
        return {name: one.scale_by(factor) for name, one in self.intervals.items()}


def measure_levels(
    levels: Callable[[Floats], Floats], stages: Stages, misfits: Sequence[Floats] = ()
) -> Measured:
    """Measure right, left, width and centre of an element.

    The values are those of the last stage, unless an earlier one knows the width more exactly. A
    half interval is the widest of the stages' up to it. By how much the first and the last stage
    differ, and how far the largest misfit moves the number, is added in quadrature.

    Args:
        levels: right and left by theta.
        stages: objective and theta of each stage.
        misfits: changes of the free parameters of the first stage by remainders of the model.
    """
    halves = []
    values = []
    moved = np.zeros(len(WIDTHS))
    for place, (target, theta) in enumerate(stages):
        rows = WIDTHS @ level_slopes(levels, theta, target.free)
        spread = target.robust_covariance(theta)
        halves.append(list(map(spread.half_and_degrees, rows)))
        values.append(WIDTHS @ levels(theta))
        if place == 0 and misfits:
            moved = np.abs(rows @ np.array(misfits).T).max(axis=1)
    intervals = {}
    least = math.inf
    widest = list(DIRECTIONS).index("width")
    last = np.argmin([stage[widest][0] for stage in halves])
    for k, (name, row) in enumerate(DIRECTIONS.items()):
        half, degrees = max(stage[k] for stage in halves[: last + 1])
        apart = values[-1][k] - values[0][k]
        wider = math.hypot(half, apart, moved[k], heaviest(row) * FINEST)
        intervals[name] = Interval.from_half_width(float(values[last][k]), wider)
        least = min(least, degrees)
    return Measured(intervals, least)


def measure_fit(
    fit: FittedModel[Model],
    misfits: Sequence[Floats] = (),
    levels: Callable[[Floats], Floats] | None = None,
) -> Measured:
    """Measure the element of a model: simulation errors first, then prediction errors.

    Args:
        fit: least squares of the readings.
        misfits: as for `measure_levels`.
        levels: right and left by theta; None: those of the model.
    """
    later = fit.prediction_fit
    stages = [(one.squares, one.theta) for one in (fit, later)]
    return measure_levels(levels or fit.model.levels, stages, misfits)


def level_slopes(levels: Callable[[Floats], Any], theta: Floats, free: Integers) -> Floats:
    """Return the derivatives of levels, or of one number, by the free parameters (K x free).

    Args:
        levels: K numbers by theta, as right and left.
        theta: parameters (P).
        free: places of the free parameters.
    """
    steps = perturbation_steps(theta[free])
    points = perturb_each(theta, free, steps)[1:]
    return central_differences(np.array(list(map(levels, points))), steps).T
