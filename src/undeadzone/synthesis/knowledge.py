"""What the readings of a scenario can tell.

That is the sides along its reference or its run, verdicts, expected deviations, and cures.
"""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.certificate.design_file import Knowledge
from undeadzone.analysis.identifiability.edges import Cure, reaching
from undeadzone.analysis.identifiability.linear import (
    DIRECTIONS,
    cures,
    invisible,
)
from undeadzone.analysis.identifiability.play_and_zone import states_told
from undeadzone.analysis.side_schedule import Schedule, arriving, planned, recorded
from undeadzone.controllers import StateFeedback
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.verdicts import (
    actuator_unknown,
    constant_inputs,
    gaps_known,
    linear_verdicts,
    readings_of_both,
    with_false_claims,
)
from undeadzone.support.progress import silent


def trial_run(problem: Problem) -> Run | None:
    """A run of the scenario, where its sides cannot be told without one; else None.

    They cannot for a nonlinear plant, nor for a controller that does not make z follow r, nor can
    the modes of an actuator whose widths are estimated.
    """
    if (
        not actuator_unknown(problem)
        and not problem.model.nonlinear
        and isinstance(problem.scenario.controller, StateFeedback)
    ):
        return None
    from undeadzone.simulation.simulate import simulate

    return simulate(problem.scenario, check_step=False, progress=silent)


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

    The constant part of a disturbance counts as an unknown bias, a random one by its rms and
    correlation time. Of a nonlinear
    plant this is what its run tells, random disturbances left out.

    Args:
        problem: the scenario's parts.
        schedule: of its sides.
        run: of it, where one was needed.
    """
    if run is not None and (problem.model.nonlinear or actuator_unknown(problem)):
        return _known_from_run(run)
    linear, jump = problem.model.linear, problem.sensor.kind == "jump"
    if problem.sensor.play is None:
        remedies = cures(linear, schedule, constant_inputs(problem, linear.B), jump)
    else:
        remedies = cures_of_both(problem, schedule)
    # The schedule of a run knows already which readings arrived.
    arrive = np.ones(problem.model.p) if run is not None else 1 - problem.sensor.dropout
    known = []
    verdicts = linear_verdicts(problem, schedule, arrive)
    if problem.sensor.play is not None:
        verdicts = with_false_claims(problem, verdicts)
    for i, verdict in enumerate(verdicts):
        fields = verdict._asdict() | {"reasons": list(verdict.reasons), "std": verdict.std or {}}
        open_ = not (verdict.right and verdict.left)
        texts = [remedy.text for remedy in remedies if open_ and remedy.output == i]
        known.append(Knowledge(**fields, cures=texts))
    return known


def _known_from_run(run: Run) -> list[Knowledge]:
    """What the run of a nonlinear plant tells of each output."""
    unknown = dict.fromkeys(DIRECTIONS, np.inf)
    known = []
    for verdict in run.info.identifiable:
        fields = {**verdict, "std": verdict["std"] or unknown}
        known.append(Knowledge(**fields, cures=[]))
    return known


def cures_of_both(problem: Problem, schedule: Schedule) -> list[Cure]:
    """What would tell more of a play and a dead zone."""
    model, remedies = problem.model, []
    visited = schedule.visited(model.n + 2 * model.p)
    for i in range(problem.model.p):
        if not visited[i].all():
            remedies.append(reaching(schedule, i))
        elif not gaps_known(problem):
            text = (
                "no reference can tell both centres apart: measure the gaps, and give them as "
                "model.play = [c_r, c_l]; or claim that of the zone: observer.centre = [lo, hi]"
            )
            remedies.append(Cure(i, None, None, text))
    return remedies


def determined(problem: Problem, schedule: Schedule) -> list[bool]:
    """Which states the readings along a schedule determine (n); none are listed if nonlinear."""
    model, jump = problem.model, problem.sensor.kind == "jump"
    if model.nonlinear:
        return []
    if problem.sensor.play is not None:
        readings = readings_of_both(problem, schedule, np.ones(model.p))
        return states_told(model.linear, schedule, readings)
    bias = constant_inputs(problem, model.linear.B)
    hidden = invisible(model.linear, schedule.visited(model.n), schedule.Ts, bias, jump)
    return [hidden.state(i) for i in range(model.n)]
