"""A metric over a grid of numbers of observer and controller; all points meet the same runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.support.arrays import Floats, series
from undeadzone.tuning.objective import Frame, objective
from undeadzone.tuning.parameters import named, numbers


class Sweep(NamedTuple):
    """What a scenario costs over a grid.

    Attributes:
        axes: values by address
        cost: the statistic of the metric (an axis for each number); inf where a point is refused
        margin: of the certificate, in the same shape; inf if it was not asked for
    """

    axes: dict[str, Floats]
    cost: Floats
    margin: Floats


def sweep(
    scenario: Scenario,
    grid: Mapping[str, npt.ArrayLike],
    what: Tune | None = None,
    *,
    seed: int = 0,
    threads: int | None = None,
) -> Sweep:
    """What a scenario costs at every point of a grid, on runs drawn as its [ensemble] says.

    Args:
        scenario: with or without the tables [tune] and [ensemble]
        grid: values by address, such as {"observer.gamma": [1.0, 10.0]}; the first point must be
            possible
        what: metric, statistic, number of runs, whether certificates are asked for; default: the
            [tune] of the scenario
        seed: of the runs, unless `what` has one
        threads: on which to compute; default: one per processor

    Returns:
        The axes, and cost and margin at every point.

    Raises:
        InputError: or a subclass, for what is wrong with the scenario.
    """
    what = what or scenario.tune or Tune()
    axes = _axes(scenario, grid)
    meshes = np.meshgrid(*axes.values(), indexing="ij")
    points = np.stack([mesh.ravel() for mesh in meshes], axis=1)
    if what.seed is not None:
        seed = what.seed
    probes = _probes(axes, points[0])
    on = objective(what, [scenario], [Frame()], list(axes), probes, what.runs, seed)
    candidates = on.problems(points)
    chosen, possible = [], []
    for k, problems in enumerate(candidates):
        if problems is not None:
            chosen.append(k)
            possible.append(problems)
    cost = np.full(len(points), np.inf)
    cost[chosen] = on.costs(possible, threads)
    shape = meshes[0].shape
    return Sweep(axes, cost.reshape(shape), on.margins(candidates).reshape(shape))


def _axes(scenario: Scenario, grid: Mapping[str, npt.ArrayLike]) -> dict[str, Floats]:
    """The values of each number that the addresses of a grid stand for. Raises InputError."""
    known = numbers(scenario)
    axes = {}
    for address, values in grid.items():
        for name in named(address, known):
            axes[name] = series(address, values)
    if not axes:
        raise InputError(
            "sweep: nothing to sweep; give values by address, such as "
            "{'observer.gamma': [1.0, 10.0]}"
        )
    return axes


def _probes(axes: Mapping[str, Floats], first: Floats) -> Floats:
    """Points (rows) that move each number alone: to its first, middle and last value."""
    probes = []
    for i, axis in enumerate(axes.values()):
        for value in (axis[0], axis[axis.size // 2], axis[-1]):
            probe = first.copy()
            probe[i] = value
            probes.append(probe)
    return np.stack(probes)
