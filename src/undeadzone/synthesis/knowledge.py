"""What the readings of a scenario can tell.

That is the sides along its reference or its run, verdicts, expected deviations, and cures.
"""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.certificate.design_file import Knowledge
from undeadzone.analysis.identifiability.information import deviations
from undeadzone.analysis.identifiability.linear import (
    DIRECTIONS,
    cures,
    invisible,
    unknown_bias,
    verdicts,
)
from undeadzone.analysis.side_schedule import Schedule, arriving, planned, recorded
from undeadzone.controllers import StateFeedback
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem
from undeadzone.signals.exosystem import Random
from undeadzone.simulation.run import Run
from undeadzone.support.arrays import Floats


def trial_run(problem: Problem) -> Run | None:
    """A run of the scenario, where its sides cannot be told without one; else None.

    They cannot for a nonlinear plant, nor for a controller that does not make z follow r.
    """
    if not problem.model.nonlinear and isinstance(problem.scenario.controller, StateFeedback):
        return None
    from undeadzone.simulation.simulate import simulate

    return simulate(problem.scenario, check_step=False)


def plan(problem: Problem, run: Run | None) -> Schedule:
    """The sides along a run, or along the reference where there is none."""
    model, sensor = problem.model, problem.sensor
    if run is not None:
        return recorded(run.z, sensor, run.info.step, model.Ts, np.isfinite(run.y))
    simulation = problem.scenario.simulation
    schedule = planned(model, problem.reference, problem.tracked, sensor, simulation.duration)
    return arriving(schedule, sensor.dropout, simulation.step, simulation.duration, model.n)


def knowledge(problem: Problem, schedule: Schedule, run: Run | None) -> list[Knowledge]:
    """What can be known of each output, and how well after the scenario's duration.

    A step, or the offset of sines, as disturbance counts as an unknown bias; a random one as white
    process noise of its low-frequency density, 2 rms^2 times its correlation time. Of a nonlinear
    plant this is what its run tells, random disturbances left out.

    Args:
        problem: the scenario's parts.
        schedule: of its sides.
        run: of it, where one was needed.
    """
    if problem.model.nonlinear and run is not None:
        return _known_from_run(run)
    linear, jump = problem.model.linear, problem.sensor.kind == "jump"
    bias = _bias(problem)
    judged = verdicts(linear, schedule, bias, jump)
    remedies = cures(linear, schedule, bias, jump)
    if jump:
        std: list[dict[str, float]] = [{} for _ in judged]
    else:
        std = _deviations(problem, schedule, bias, run)
    known = []
    for i, verdict in enumerate(judged):
        fields = verdict._asdict() | {"reasons": list(verdict.reasons), "std": std[i]}
        texts = [remedy.text for remedy in remedies if remedy.output == i]
        known.append(Knowledge(**fields, cures=texts))
    return known


def _bias(problem: Problem) -> Floats | None:
    """The directions of constant inputs that the scenario's disturbance leaves unknown."""
    scenario = problem.scenario
    duration = scenario.simulation.duration
    return unknown_bias(scenario.disturbance, problem.model.linear.B, duration)


def _known_from_run(run: Run) -> list[Knowledge]:
    """What the run of a nonlinear plant tells of each output."""
    unknown = dict.fromkeys(DIRECTIONS, np.inf)
    known = []
    for verdict in run.info.identifiable:
        fields = {**verdict, "std": verdict["std"] or unknown}
        known.append(Knowledge(**fields, cures=[]))
    return known


def _deviations(
    problem: Problem, schedule: Schedule, bias: Floats | None, run: Run | None
) -> list[dict[str, float]]:
    """The standard deviations of each output's widths that no unbiased estimate can beat [z].

    A run's schedule knows already which readings arrived.
    """
    simulation = problem.scenario.simulation
    process = _process_noise(problem.model, problem.scenario.disturbance)
    return deviations(
        problem.model.linear,
        schedule,
        problem.sensor.rms,
        simulation.step,
        simulation.duration,
        bias,
        process,
        None if run is not None else 1 - problem.sensor.dropout,
    ).widths


def _process_noise(model: System, disturbance: object) -> Floats | None:
    """The density (n x n) of the white noise that a random disturbance counts as; else None."""
    if not isinstance(disturbance, Random):
        return None
    B, Ts = model.linear.B, 1.0 if model.Ts is None else model.Ts
    density = 2 * np.asarray(disturbance.rms, float) ** 2 * disturbance.correlation_time
    return np.asarray(B * np.broadcast_to(density, model.m) @ B.T / Ts)


def determined(problem: Problem, schedule: Schedule) -> list[bool]:
    """Which states the readings along a schedule determine (n); none are listed if nonlinear."""
    model, jump = problem.model, problem.sensor.kind == "jump"
    if model.nonlinear:
        return []
    bias = _bias(problem)
    hidden = invisible(model.linear, schedule.visited(model.n), schedule.Ts, bias, jump)
    return [hidden.state(i) for i in range(model.n)]
