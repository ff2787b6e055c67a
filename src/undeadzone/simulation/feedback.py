"""Feedback strength of z^: the remaining share of a model error that all readings show.

The same scenario runs once more with a plant whose z is 5 % larger than the model's. An observer
that follows its model alone keeps the whole error. One with strong feedback follows
(docs/observer.md).
"""

from __future__ import annotations

import dataclasses
from typing import Final

import msgspec
import numpy as np

from undeadzone.plants.system import System
from undeadzone.results.feedback import LARGER
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import Progress, Start, prepare, signals_of, simulate_scenario
from undeadzone.util.arrays import Floats, to_json_value

STILL: Final = 1e-6  # of the largest |z|: an output that moves less is not used


def measure_feedback(scenario: Scenario, progress: Progress | None = None) -> Run:
    """Return the run of a scenario, with how strongly its readings moved z^ in its info.

    Args:
        scenario: what to simulate.
        progress: called with the number of steps just done.
    """
    run, problem, start = simulate_scenario(scenario, progress=progress)
    known = to_json_value(feedback_shares(problem, run, start, progress))
    return dataclasses.replace(run, info=msgspec.structs.replace(run.info, listens=known))


def feedback_shares(
    problem: Problem, run: Run | None, start: Start | None = None, progress: Progress | None = None
) -> list[float]:
    """Return the share of a lasting error of the model that z^ follows: 1 all of it, 0 none.

    It is negative where readings make z^ worse. Errors are taken over the second half of the run.

    Args:
        problem: the scenario's parts.
        run: of the scenario, if there is one already.
        start: what that run started from, if its loop is a graph.
        progress: called with the number of steps just done.

    Returns:
        A share for each output, or NaN if an output does not move or the run diverges.
    """
    if problem.plant.gears is not None:  # links that turn further than their motors are others
        return []
    if start is None and problem.observer.python is None:
        start = prepare(problem)
    if run is None:
        signal, _ = signals_of(problem, start, progress)
        z = signal.z
        z_hat = signal.estimate.z
    else:
        z = run.z
        z_hat = run.z_hat
    other = problem._replace(plant=_larger(problem.plant))
    larger, _ = signals_of(other, _perturbed_start(start, other), progress)
    half = slice(len(z) // 2, None)
    with np.errstate(all="ignore"):
        left = (larger.z - larger.estimate.z) - (z - z_hat)
        whole = LARGER / (1 + LARGER) * _rms(larger.z[half])
        share = 1 - _rms(left[half]) / whole
        moves = whole > STILL * np.abs(larger.z).max(axis=0)
    shares: list[float] = np.where(moves & np.isfinite(share), share, np.nan).tolist()
    return shares


def _perturbed_start(start: Start | None, other: Problem) -> Start | None:
    """Return the start of a run whose plant has another output, for a linear plant reused."""
    if start is None or other.plant.nonlinear:
        return None if start is None else prepare(other)
    params = start.loop.params._replace(plant=other.plant.params)
    return start._replace(loop=start.loop._replace(params=params))


def _larger(plant: System) -> System:
    """Return the plant with a larger output."""
    if plant.nonlinear:
        output = plant.output
        return plant._replace(output=lambda params, x: (1 + LARGER) * output(params, x))
    linear = plant.linear._replace(C=(1 + LARGER) * plant.linear.C)
    return plant._replace(params=linear, linear=linear)


def _rms(values: Floats) -> Floats:
    """Return root mean squares of columns."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))
