"""All that a report shows of a scenario's gains.

That is their certificate, their rate, attempts to break them, and what can be known.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.design_file import Knowledge
from undeadzone.analysis.certificate.nearest import nearest
from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.analysis.convergence.falsify import Attack, Cycle, diverge, falsify
from undeadzone.analysis.convergence.floquet import Rates, rates
from undeadzone.analysis.convergence.trajectories import (
    Trajectory,
    growing,
    settling,
    trajectories,
    trajectory,
)
from undeadzone.analysis.error_dynamics import Dynamics, Storage
from undeadzone.analysis.side_schedule import Schedule
from undeadzone.errors import StructureError
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem, constant_gains
from undeadzone.simulation.listening import listening
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.knowledge import knowledge, plan, trial_run

CONSTANTS: Final = 6  # time constants that a trajectory lasts
TRIES: Final = 600  # of the search for a growing cycle
PERIODS: Final = 5  # of the cycle shown
GROWS: Final = 1 + 1e-6  # factor above which a cycle is one that grows
POINTS: Final = 100  # shown of each mode of an attack, and of each period of a cycle


class Gains(NamedTuple):
    """Constant gains and what they are worth.

    The dynamics are those of the errors that matter: a jump sensor's readings do not hold d, so
    that its widths are left out.

    Attributes:
        L: gain of x^ (n x p) [1/s].
        gamma: gain of the widths (p) [1/s].
        certificate: the proof that V never rises, or why there is none.
        rates: how fast the error dies along the reference.
        settled: time after which every error is at most 1 % of what it was, in size sqrt(V) [s];
            None: none of that is sure.
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
    """Attempts to make V rise.

    Attributes:
        attack: the falsifier's.
        cycle: the periodic side sequence of fastest growth; None: the gains are certified.
        courses: trajectories of the error.
    """

    attack: Attack
    cycle: Cycle | None
    courses: list[Trajectory]


class Assessment(NamedTuple):
    """What a scenario's gains are worth, and what its readings can tell.

    Attributes:
        problem: the scenario's parts.
        run: a run of it, where one was needed.
        schedule: of its sides.
        known: what can be known of each output.
        gains: of a linear plant, where they are constant.
        listens: how strongly readings move each z^ (`simulation.listening`); empty: not measured.
    """

    problem: Problem
    run: Run | None
    schedule: Schedule
    known: list[Knowledge]
    gains: Gains | None
    listens: tuple[float, ...] = ()


def assess(problem: Problem, listen: bool = False) -> Assessment:
    """The assessment of a problem.

    Args:
        problem: the scenario's parts.
        listen: whether to measure how strongly readings move z^, by two runs.
    """
    run = trial_run(problem)
    schedule = plan(problem, run)
    known = knowledge(problem, schedule, run)
    constant = constant_gains(problem.observer, problem.model)
    if constant is None or problem.model.nonlinear:
        gains = None
    else:
        gains = _gains(problem, schedule, *constant)
    listens = tuple(listening(problem, run)) if listen else ()
    return Assessment(problem, run, schedule, known, gains, listens)


def attack(assessment: Assessment, seed: int = 0) -> Attacks | None:
    """Attempts to break the gains of an assessment, which take seconds.

    Args:
        assessment: of a scenario.
        seed: of the random numbers.

    Returns:
        The attempts; None where no V exists that could be tried.
    """
    gains = assessment.gains
    if gains is None or not np.linalg.eigvalsh(gains.V.P)[0] > 0:
        return None
    dynamics, V = gains.dynamics, gains.V
    attempt = falsify(dynamics, V, seed=seed)
    cycle = None if gains.certificate.certified else diverge(dynamics, seed, TRIES)
    duration = assessment.problem.scenario.simulation.duration
    longest = max(duration, assessment.schedule.duration)
    settling_time = CONSTANTS / max(abs(gains.rates.rate), 1e-300)
    span = min(settling_time, longest)  # [s]
    drawn = trajectories(dynamics, V, assessment.schedule, span, seed)
    if attempt.broken:
        interval = attempt.mode.seconds / POINTS
        drawn.append(trajectory("attack", dynamics, V, attempt.start, [attempt.mode], interval))
    if cycle is not None and cycle.factor > GROWS:
        start, modes = growing(dynamics, cycle), PERIODS * [*cycle.modes]
        drawn.append(trajectory("cycle", dynamics, V, start, modes, cycle.seconds / POINTS))
    return Attacks(attempt, cycle, drawn)


def _gains(problem: Problem, schedule: Schedule, L: Floats, gamma: Floats) -> Gains:
    """What gains L (n x p), gamma (p) [1/s] are worth on a schedule of sides."""
    linear, Ts, jump = problem.model.linear, problem.model.Ts, problem.sensor.kind == "jump"
    certificate = certify(linear, L, gamma, Ts)
    dynamics, V = certificate.dynamics, certificate.V
    if jump:
        dynamics = dynamics._replace(gamma=0 * dynamics.gamma)
        V = V._replace(gamma=0 * V.gamma)
    speed = rates(linear, L, gamma, schedule, jump)
    settled, near = None, None
    if certificate.certified:
        settled = settling(dynamics, V, schedule)
    else:
        near = _nearest(problem, schedule, L, gamma)
    return Gains(L, gamma, certificate, speed, settled, near, dynamics, V)


def _nearest(problem: Problem, schedule: Schedule, L: Floats, gamma: Floats) -> Gains | None:
    """Certified gains near to L (n x p), gamma (p) [1/s]; None where none were found."""
    try:
        certificate = nearest(problem.model.linear, L, gamma, problem.model.Ts).certificate
    except StructureError:
        return None
    if not certificate.certified:
        return None
    dynamics = certificate.dynamics
    return _gains(problem, schedule, dynamics.L, np.diag(dynamics.gamma)[::2])
