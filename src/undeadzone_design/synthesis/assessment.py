"""Assessment of a scenario's gains and of the identifiability from its readings, for reports.

Of the gains: their certificate, their rate, attempts to break them. Of the readings: the sides
along the reference or a run, verdicts, expected deviations, and cures.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.branch_schedule import (
    Schedule,
    drop_rare_branches,
    plan_schedule,
    schedule_of_record,
)
from undeadzone.analysis.certificate.design_file import Knowledge
from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.analysis.convergence.floquet import Rates, error_decay_rates
from undeadzone.analysis.error_dynamics import Dynamics, Storage
from undeadzone.analysis.identifiability.linear import (
    Remedy,
    find_remedies,
    remedy_to_reach_edges,
    unobservable_along,
)
from undeadzone.analysis.identifiability.two_elements import append_gaps
from undeadzone.controllers.state_feedback import StateFeedback
from undeadzone.errors import InputError, StructureError
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem, constant_gains
from undeadzone.simulation.feedback import feedback_shares
from undeadzone.simulation.identifiability import (
    actuator_unknown,
    constant_inputs,
    gaps_known,
    linear_verdicts,
    mark_excluded_widths,
    readings_of,
)
from undeadzone.util.arrays import Floats
from undeadzone.util.progress import ignore_progress
from undeadzone_design.certificate.nearest import nearest_certified_gains
from undeadzone_design.convergence.falsify import Attack, Cycle, diverge, falsify
from undeadzone_design.convergence.trajectories import (
    Trajectory,
    most_growing_error,
    simulate_trajectories,
    trajectory_along_modes,
    worst_settling_time,
)

CONSTANTS: Final = 6  # time constants that a trajectory lasts
TRIES: Final = 600  # of the search for a growing cycle
PERIODS: Final = 5  # of the cycle shown
GROWS: Final = 1 + 1e-6  # factor above which a cycle is one that grows
POINTS: Final = 100  # shown of each mode of an attack, and of each period of a cycle


class Gains(NamedTuple):
    """Constant gains with their certificate and rates.

    The dynamics are those of the errors that matter: a jump sensor's readings do not hold d, so
    that its widths are left out.

    Attributes:
        L: gain of x^ (n x p) [1/s].
        gamma: gain of the widths (p) [1/s].
        certificate: the proof that V never rises, or why there is none.
        rates: how fast the error dies along the reference.
        settled: time after which every error is at most 1 % of its initial size sqrt(V) [s] (None:
            not proved).
        nearest: certified gains near to these, if these are not certified.
        dynamics: of the error.
        V: the storage function.
    """

    L: Floats
    gamma: Floats
    certificate: Certificate
    rates: Rates
    settled: float | None
    nearest: Gains | None
    dynamics: Dynamics
    V: Storage


class Attacks(NamedTuple):
    """Attempts to increase V.

    Attributes:
        attack: the falsifier's.
        cycle: the periodic side sequence of fastest growth (None: the gains are certified).
        courses: trajectories of the error.
    """

    attack: Attack
    cycle: Cycle | None
    courses: list[Trajectory]


class Assessment(NamedTuple):
    """Assessment of a scenario's gains and of the identifiability from its readings.

    Attributes:
        problem: the scenario's parts.
        run: a run of it, if one was needed.
        schedule: of its sides.
        known: identifiability of each output.
        gains: of a linear plant, if they are constant.
        listens: how strongly readings move each z^ (`simulation.feedback`, empty: not measured).
    """

    problem: Problem
    run: Run | None
    schedule: Schedule
    known: list[Knowledge]
    gains: Gains | None
    listens: tuple[float, ...] = ()


def assess_problem(problem: Problem, listen: bool = False) -> Assessment:
    """Return the assessment of a problem.

    Args:
        problem: the scenario's parts.
        listen: whether to measure how strongly readings move z^, by two runs.
    """
    run = simulate_trial_run(problem)
    schedule = plan_branches(problem, run)
    known = assess_identifiability(problem, schedule, run)
    constant = constant_gains(problem.observer, problem.model)
    if constant is None or problem.model.nonlinear:
        gains = None
    else:
        gains = _assess_gains(problem, schedule, *constant)
    listens = tuple(feedback_shares(problem, run)) if listen else ()
    return Assessment(problem, run, schedule, known, gains, listens)


def attack_gains(assessment: Assessment, seed: int = 0) -> Attacks | None:
    """Return attempts to falsify the gains of an assessment. They take seconds.

    Args:
        assessment: of a scenario.
        seed: of the random numbers.

    Returns:
        The attempts, or None if no V exists that could be tried.
    """
    gains = assessment.gains
    if gains is None or not np.linalg.eigvalsh(gains.V.P)[0] > 0:
        return None
    dynamics = gains.dynamics
    V = gains.V
    attempt = falsify(dynamics, V, seed=seed)
    cycle = None if gains.certificate.certified else diverge(dynamics, seed, TRIES)
    duration = assessment.problem.scenario.simulation.duration
    longest = max(duration, assessment.schedule.total_duration)
    settling_time = CONSTANTS / max(abs(gains.rates.rate), 1e-300)
    span = min(settling_time, longest)  # [s]
    drawn = simulate_trajectories(dynamics, V, assessment.schedule, span, seed)
    if attempt.broken:
        interval = attempt.mode.seconds / POINTS
        drawn.append(
            trajectory_along_modes("attack", dynamics, V, attempt.start, [attempt.mode], interval)
        )
    if cycle is not None and cycle.factor > GROWS:
        start = most_growing_error(dynamics, cycle)
        modes = PERIODS * [*cycle.modes]
        drawn.append(
            trajectory_along_modes("cycle", dynamics, V, start, modes, cycle.seconds / POINTS)
        )
    return Attacks(attempt, cycle, drawn)


def _assess_gains(problem: Problem, schedule: Schedule, L: Floats, gamma: Floats) -> Gains:
    """Return the certificate and rates of gains L (n x p), gamma (p) [1/s] on a schedule of
    branches.
    """
    linear = problem.model.linear
    Ts = problem.model.Ts
    jump = problem.sensor.kind == "jump"
    certificate = certify(linear, L, gamma, Ts)
    dynamics = certificate.dynamics
    V = certificate.V
    if jump:
        dynamics = dynamics._replace(gamma=0 * dynamics.gamma)
        V = V._replace(gamma=0 * V.gamma)
    speed = error_decay_rates(linear, L, gamma, schedule, jump)
    settled = None
    near = None
    if certificate.certified:
        settled = worst_settling_time(dynamics, V, schedule)
    else:
        near = _find_nearest_gains(problem, schedule, L, gamma)
    return Gains(L, gamma, certificate, speed, settled, near, dynamics, V)


def _find_nearest_gains(
    problem: Problem, schedule: Schedule, L: Floats, gamma: Floats
) -> Gains | None:
    """Return certified gains near to L (n x p), gamma (p) [1/s], or None if the search found
    no gains.
    """
    try:
        certificate = nearest_certified_gains(
            problem.model.linear, L, gamma, problem.model.Ts
        ).certificate
    except StructureError:
        return None
    if not certificate.certified:
        return None
    dynamics = certificate.dynamics
    return _assess_gains(problem, schedule, dynamics.L, np.diag(dynamics.gamma)[::2])


def simulate_trial_run(problem: Problem) -> Run | None:
    """Return a run of the scenario if its branches depend on a run, else None.

    It is needed for a nonlinear plant, for a controller that does not make z follow r, and for the
    modes of an actuator whose widths are estimated.
    """
    if (
        not actuator_unknown(problem)
        and not problem.model.nonlinear
        and isinstance(problem.scenario.controller, StateFeedback)
    ):
        return None
    from undeadzone.simulation.simulate import simulate

    deviations = msgspec.structs.replace(problem.scenario, operating_point=None)
    return simulate(deviations, check_step=False, progress=ignore_progress)


def plan_branches(problem: Problem, run: Run | None) -> Schedule:
    """Return the branches along a run, or along the reference without a run."""
    model = problem.model
    sensor = problem.sensor
    if run is not None:
        return schedule_of_record(run.z, sensor, run.info.step, model.Ts, np.isfinite(run.y))
    simulation = problem.scenario.simulation
    schedule = plan_schedule(model, problem.reference, problem.tracked, sensor, simulation.duration)
    return drop_rare_branches(
        schedule, sensor.dropout, simulation.step, simulation.duration, model.n
    )


def assess_identifiability(
    problem: Problem, schedule: Schedule, run: Run | None
) -> list[Knowledge]:
    """Return the identifiability of each output, with deviations after the scenario's
    duration.

    A disturbance counts as unknown in the class of its kind. For a nonlinear plant this is the
    identifiability from its run.

    Args:
        problem: the scenario's parts.
        schedule: of its sides.
        run: of it, if one was needed.
    """
    if run is not None and (problem.model.nonlinear or actuator_unknown(problem)):
        return _identifiability_from_run(run)
    if problem.sensor.absent.any():
        raise InputError("sensor.left: inf, no edge: `undeadzone run` shows what is known of one")
    linear = problem.model.linear
    jump = problem.sensor.kind == "jump"
    if problem.sensor.play is None:
        remedies = find_remedies(linear, schedule, constant_inputs(problem), jump)
    else:
        remedies = find_joint_remedies(problem, schedule)
    # The schedule of a run knows already which readings arrived.
    arrive = np.ones(problem.model.p) if run is not None else 1 - problem.sensor.dropout
    known = []
    verdicts = linear_verdicts(problem, schedule, arrive)
    if problem.sensor.play is not None:
        verdicts = mark_excluded_widths(problem, verdicts)
    for i, verdict in enumerate(verdicts):
        fields = verdict._asdict() | {"reasons": list(verdict.reasons), "std": verdict.std or {}}
        open_ = not (verdict.right and verdict.left)
        texts = [remedy.text for remedy in remedies if open_ and remedy.output == i]
        known.append(Knowledge(**fields, cures=texts))
    return known


def _identifiability_from_run(run: Run) -> list[Knowledge]:
    """Return the identifiability of each output from the run of a nonlinear plant."""
    unknown = dict.fromkeys(DIRECTIONS, np.inf)
    known = []
    for verdict in run.info.identifiable:
        fields = {**verdict, "std": verdict["std"] or unknown}
        known.append(Knowledge(**fields, cures=[]))
    return known


def find_joint_remedies(problem: Problem, schedule: Schedule) -> list[Remedy]:
    """Return remedies that make a backlash and a dead zone identifiable together."""
    model = problem.model
    remedies = []
    visited = schedule.branch_visits(model.n + 2 * model.p)
    for i in range(problem.model.p):
        if not visited[i].all():
            remedies.append(remedy_to_reach_edges(schedule, i))
        elif not gaps_known(problem):
            text = (
                "no reference can tell both centres apart: measure the gaps, and give them as "
                "model.play = [c_r, c_l]; or claim that of the zone: observer.centre = [lo, hi]"
            )
            remedies.append(Remedy(i, None, None, text))
    return remedies


def find_determined_states(problem: Problem, schedule: Schedule) -> list[bool]:
    """Return a mask of the states that the readings along a schedule determine (n), empty if
    nonlinear.
    """
    model = problem.model
    if model.nonlinear:
        return []
    asked = model.linear, schedule, readings_of(problem, schedule, np.ones(model.p))
    linear, sides, readings = asked if problem.sensor.play is None else append_gaps(*asked)
    jump = problem.sensor.kind == "jump"
    hidden = unobservable_along(linear, sides, readings.bias, jump, readings.prior)
    return list(map(hidden.is_state_known, range(model.n)))
