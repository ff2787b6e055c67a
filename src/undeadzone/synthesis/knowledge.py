"""What the readings of a scenario can tell: the sides along its course, verdicts, expected deviations, cures."""

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
from undeadzone.analysis.side_schedule import Schedule, planned, recorded
from undeadzone.controllers import StateFeedback
from undeadzone.scenario.problem import Problem
from undeadzone.signals.exosystem import Random
from undeadzone.simulation.run import Run


def trial_run(problem: Problem) -> Run | None:
    """A run of the scenario where its course must be simulated: a nonlinear plant, or a controller that does not make z follow r."""
    if not problem.model.nonlinear and isinstance(problem.scenario.controller, StateFeedback):
        return None
    from undeadzone.simulation.simulate import simulate

    return simulate(problem.scenario, check_step=False)


def plan(problem: Problem, run: Run | None) -> Schedule:
    """The sides along a run, or along the reference where there is none."""
    if run is None:
        return planned(
            problem.model,
            problem.reference,
            problem.tracked,
            problem.sensor,
            problem.scenario.simulation.duration,
        )
    return recorded(run.z, problem.sensor, run.info.step, problem.model.Ts)


def knowledge(problem: Problem, schedule: Schedule, run: Run | None) -> list[Knowledge]:
    """What can be known of each output, and how well after the scenario's duration with its sensor noise.

    A step, or the offset of sines, as disturbance counts as an unknown bias; a random one as white process noise of its
    low-frequency density, 2 rms^2 times its correlation time. Of a nonlinear plant what its run tells, random disturbances left out.
    """
    model, sensor, scenario = problem.model, problem.sensor, problem.scenario
    if model.nonlinear and run is not None:
        unsaid = dict.fromkeys(DIRECTIONS, np.inf)
        return [
            Knowledge(**{**verdict, "std": verdict["std"] or unsaid}, cures=[])
            for verdict in run.info.identifiable
        ]
    linear, jump = model.linear, sensor.kind == "jump"
    bias, process = unknown_bias(scenario.disturbance, linear.B), None
    if isinstance(scenario.disturbance, Random):
        density = (
            2
            * np.asarray(scenario.disturbance.rms, float) ** 2
            * scenario.disturbance.correlation_time
        )
        process = (
            linear.B
            * np.broadcast_to(density, model.m)
            @ linear.B.T
            / (1.0 if model.Ts is None else model.Ts)
        )
    found = verdicts(linear, schedule, bias, jump)
    help_ = cures(linear, schedule, bias, jump)
    std = (
        [{} for _ in found]
        if jump
        else deviations(
            linear,
            schedule,
            sensor.rms,
            scenario.simulation.step,
            scenario.simulation.duration,
            bias,
            process,
        ).widths
    )
    return [
        Knowledge(
            **verdict._asdict() | {"reasons": list(verdict.reasons), "std": std[i]},
            cures=[cure.text for cure in help_ if cure.output == i],
        )
        for i, verdict in enumerate(found)
    ]


def determined(problem: Problem, schedule: Schedule) -> list[bool]:
    """Which states the readings along a schedule determine; of a nonlinear model none are listed."""
    if problem.model.nonlinear:
        return []
    linear = problem.model.linear
    bias = unknown_bias(problem.scenario.disturbance, linear.B)
    hidden = invisible(
        linear, schedule.visited(problem.model.n), schedule.Ts, bias, problem.sensor.kind == "jump"
    )
    return [hidden.state(i) for i in range(problem.model.n)]
