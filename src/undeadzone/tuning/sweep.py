"""A metric over a grid of numbers of observer and controller, every point on the same runs, all points as lanes."""

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
    """axes: values by address; cost: the statistic of the metric, an axis each, inf where a point is refused; margin: of the certificate, inf if not asked."""

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
    """What a scenario costs at every point of a grid of values by address; what: metric, statistic and runs, default those of its [tune].

    seed: of the runs, drawn as its [ensemble] says. The first point must be possible. Raises InputError and its kinds.
    """
    what = what or scenario.tune or Tune()
    known = numbers(scenario)
    axes = {
        name: series(address, values)
        for address, values in grid.items()
        for name in named(address, known)
    }
    if not axes:
        raise InputError(
            "sweep: nothing to sweep; give values by address, such as {'observer.gamma': [1.0, 10.0]}"
        )
    meshes = np.meshgrid(*axes.values(), indexing="ij")
    points = np.stack([mesh.ravel() for mesh in meshes], axis=1)
    probes = [
        np.where(np.arange(len(axes)) == i, axis[k], points[0])
        for i, axis in enumerate(axes.values())
        for k in (0, axis.size // 2, -1)
    ]
    on = objective(
        what,
        [scenario],
        [Frame()],
        list(axes),
        np.stack(probes),
        what.runs,
        what.seed if what.seed is not None else seed,
    )
    candidates = on.problems(points)
    cost = np.full(len(points), np.inf)
    possible = [k for k, problems in enumerate(candidates) if problems is not None]
    cost[possible] = on.costs(
        [problems for problems in candidates if problems is not None], threads
    )
    return Sweep(
        axes, *(values.reshape(meshes[0].shape) for values in (cost, on.margins(candidates)))
    )
