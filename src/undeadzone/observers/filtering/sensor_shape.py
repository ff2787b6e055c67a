"""Shape of a sensor in a filter: round edges, a slope that is a little off, readings that are late.

A reading on side s of the zone, of a z that is foretold to lie zeta beyond its edge and to move by
v in a sample, is

    y / m = z - s d + gamma s zeta + rho s exp(-zeta / l) - tau v + noise.

rho is an unknown constant of the filter. gamma and tau are not, and rho is not in a small filter: a
column S = d mean / d b of each such doubt b is the shift of the mean if the sensor differed a
little, and the displayed covariance contains var(b) S S' besides
(docs/filter_extensions.md, "Sensor shape").
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.nonlinearities.sensor import Zone
from undeadzone.numerics.deadzone_update import FAR, FIXED_AT_EDGE, LENGTH
from undeadzone.observers.filtering.constant_states import add_constants, zone_numbers
from undeadzone.observers.filtering.gaussian_filter import (
    Augmentation,
    Params,
    Setup,
    ShapeLayout,
)
from undeadzone.observers.filtering.prior import Prior
from undeadzone.plants.system import System, time_scale
from undeadzone.util.arrays import Floats

ROUND = 0.07  # rounding of an edge, in the smaller middle of the ranges, by default
SLOPE = 0.06  # relative error of the slope by default
# delay by default: in quarter periods, at most in samples
LATE = 0.25
LATEST = 5.0
AT_EDGE = 0.8  # deviation of a reading at its edge, in `rounding`, if that is an unknown


class ShapeAssumptions(NamedTuple):
    """Shape of the sensor as a filter assumes it, with defaults (0: exact).

    Attributes:
        rounding: how far about an edge the characteristic is round (p) [z].
        slope_std: relative standard deviation of the slope (p) [1].
        lag: standard deviation of a delay behind the zone (p) [samples].
        learns: whether the rounding is an unknown of the filter.
    """

    rounding: Floats
    slope_std: Floats
    lag: Floats
    learns: bool

    @property
    def deviations(self) -> dict[str, Floats]:
        """Return the standard deviations of the doubts by name, of those that are not exact."""
        at_edge = AT_EDGE if self.learns else FIXED_AT_EDGE
        every = {"slope": self.slope_std, "rounding": at_edge * self.rounding, "lag": self.lag}
        return {name: std for name, std in every.items() if std.any()}

    @property
    def learned(self) -> tuple[str, ...]:
        """Return the names of the doubts that are unknowns of the filter.

        The slope is not one of them: with a large z it would take disturbances and errors of the
        model for its own, and the estimate of z would be three times as far off.
        """
        named = ("rounding",) if self.learns else ()
        return tuple(name for name in named if name in self.deviations)

    @property
    def fixed(self) -> tuple[str, ...]:
        """Return the names of the doubts that have a column each."""
        return tuple(name for name in self.deviations if name not in self.learned)


class ShapeNumbers(NamedTuple):
    """Parameters of a filter for the shape of the sensor.

    Attributes:
        gate: |y| up to which a round edge reads (p) [y].
        length: over which an edge is round (p) [z].
        doubt: standard deviations of the columns, output by output of each doubt.
    """

    gate: Floats
    length: Floats
    doubt: Floats


def resolve_shape(
    sensor: Zone, prior: Prior, model: System, learns: bool, blind: bool
) -> ShapeAssumptions:
    """Return the shape of a sensor as a filter assumes it.

    Sensors that jump or move are exact. So is, by default, a sensor beside an actuator whose widths
    are estimated: an error of the slope would leave next to nothing known of them.

    Args:
        sensor: as the filter takes it (keys with value None have defaults).
        prior: of the filter, for its ranges.
        model: the sampled model.
        learns: whether the rounding becomes an unknown of the filter.
        blind: whether it takes readings for z itself, and so assumes nothing about the sensor.
    """
    p = model.p
    Ts = model.Ts
    assert Ts is not None
    if sensor.kind != "deadzone" or sensor.moves or blind:
        return ShapeAssumptions(np.zeros(p), np.zeros(p), np.zeros(p), learns)
    middles = prior.ranges.mean(axis=1).reshape(2, p).min(axis=0)
    late = min(LATE * time_scale(model.continuous, Ts) / Ts, LATEST)
    usual = 1.0 if zone_numbers(model.actuator) is None else 0.0
    return ShapeAssumptions(
        rounding=usual * ROUND * middles if sensor.rounding is None else sensor.rounding,
        slope_std=np.full(p, usual * SLOPE) if sensor.slope_std is None else sensor.slope_std,
        lag=np.full(p, usual * late) if sensor.lag is None else sensor.lag / Ts,
        learns=learns,
    )


def widen_gate(setup: Setup, q: Params) -> Params:
    """Return the filter's numbers with a gate within which round edges read, too."""
    if "rounding" not in setup.shape.learned + setup.shape.fixed:
        return q
    return q._replace(gate=ca.fmax(q.gate, q.shape.gate))


def add_shape_states(
    inner: Augmentation, model: System, shape: ShapeAssumptions
) -> tuple[Augmentation, ShapeLayout]:
    """Return the motion with the rounding among its last unknowns, and where that stands."""
    first = model.n + 2 * model.p + len(inner.cov)
    layout = ShapeLayout(first, shape.learned, shape.fixed)
    if shape.learned:
        std = np.concatenate([shape.deviations[name] for name in shape.learned])
        inner = add_constants(inner, std**2)
    return inner, layout


def shape_numbers(sensor: Zone, shape: ShapeAssumptions) -> ShapeNumbers | None:
    """Return the parameters of a filter for the shape of its sensor, or None if it is exact."""
    deviations = shape.deviations
    if not deviations:
        return None
    none: list[Floats] = [np.empty(0)]
    doubt = np.concatenate(none + [deviations[name] for name in shape.fixed])
    round_edge = shape.rounding > 0
    length = LENGTH * np.where(round_edge, shape.rounding, 1.0)
    return ShapeNumbers(shape.rounding * sensor.slope, length, doubt)


def shape_effects(
    q: Any, names: tuple[str, ...], i: int, side: Any, beyond: Any, ahead: Any
) -> list[Any]:
    """Return by how much a reading of output i changes per doubt of each name [z].

    Args:
        q: the filter's numbers.
        names: of the doubts.
        i: number of the output.
        side: on which it is read.
        beyond: its expected value [z].
        ahead: by how much z moves in a sample [z].
    """
    every = {"slope": lambda: beyond, "lag": lambda: -ahead}
    every["rounding"] = lambda: side * ca.exp(-ca.fmin(ca.fabs(beyond) / q.shape.length[i], FAR))
    return [every[name]() for name in names]


def add_shape_terms(
    setup: Setup, q: Any, i: int, side: Any, foretold: Any, sight: tuple[Any, Any], at: Any
) -> tuple[Any, Any]:
    """Return (the expected reading [z], its row (1 x N)), with the sensor's shape.

    Args:
        setup: the filter.
        q: its numbers.
        i: number of the output.
        side: on which it is read.
        foretold: reading of an exact sensor, before any reading of the sample [z].
        sight: expected reading of an exact sensor, and its row.
        at: mean of `[x; d; extra]` (N).
    """
    expected, h = sight
    layout = setup.shape
    if not layout.learned:
        return expected, h
    beyond = ca.if_else(side * foretold > 0, foretold, 0.0)
    effects = shape_effects(q, layout.learned, i, side, beyond, 0.0)
    row = ca.SX(h)
    for k, effect in enumerate(effects):
        place = layout.first + k * setup.model.p + i
        expected += effect * at[place]
        row[place] = effect
    return expected, row


def start_columns(setup: Setup) -> Floats:
    """Return the columns before the first reading, stacked."""
    size = setup.model.n + 2 * setup.model.p + len(setup.augmentation.cov)
    return np.zeros(size * len(setup.shape.fixed) * setup.model.p)


def arrange_columns(setup: Setup, columns: Any) -> Any:
    """Return the columns as a matrix (N x their number)."""
    count = len(setup.shape.fixed) * setup.model.p
    return ca.reshape(ca.SX(columns), columns.shape[0] // max(count, 1), count)


def move_columns(
    setup: Setup, q: Any, i: int, columns: Any, gain: Any, h: Any, effects: list[Any]
) -> Any:
    """Return the columns after a reading of output i, moved as the mean was.

    Args:
        setup: the filter.
        q: its numbers.
        i: number of the output.
        columns: before the reading (N x their number).
        gain: by which the reading moved the mean (N).
        h: row of the reading (1 x N).
        effects: of each doubt on the reading [z].
    """
    phi = ca.SX(1, columns.shape[1])
    for k, effect in enumerate(effects):
        phi[k * setup.model.p + i] = effect
    return columns + gain @ (phi - h @ columns)


def column_variance(q: Any, columns: Any) -> Any:
    """Return the covariance that the doubts of the columns make (N x N)."""
    wide = columns @ ca.diag(q.shape.doubt)
    return wide @ wide.T
