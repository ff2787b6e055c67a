"""Cost of a filter's assumptions on the sensor's shape: their share of a width's interval."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from undeadzone.nonlinearities.sensor import SHAPE
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats


def compute_shape_costs(problem: Problem) -> tuple[dict[str, float], ...]:
    """Return the deviation of each output's width at the end of a run, and its parts [z].

    A part is the variance that would be lost if the sensor were exact in that respect. Empty for an
    observer that does not allow for a shape.

    Args:
        problem: the checked parts of a scenario.
    """
    if getattr(problem.observer.params, "shape", None) is None:
        return ()
    whole = _final_variances(problem, {})
    parts = {name: whole - _final_variances(problem, {name: 0.0}) for name in SHAPE}
    costs = []
    for i, variance in enumerate(whole):
        each = {name: float(np.sqrt(max(lost[i], 0.0))) for name, lost in parts.items()}
        costs.append({"width": float(np.sqrt(variance)), **each})
    return tuple(costs)


def _final_variances(problem: Problem, changes: dict[str, Any]) -> Floats:
    """Return the variance of each width at the end of a run with another assumed sensor (p)."""
    scenario = problem.scenario
    sensor = msgspec.structs.replace(scenario.sensor, **changes)
    run: Run = simulate(msgspec.structs.replace(scenario, sensor=sensor), check_step=False)
    assert run.width_std is not None
    return np.asarray(run.width_std[-1] ** 2)
