"""All that a report shows of a scenario's gains: certificate, rate, attempts to break it, and what can be known."""

from __future__ import annotations

from typing import NamedTuple

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
from undeadzone.scenario.problem import Problem, constant_gains
from undeadzone.simulation.run import Run
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.knowledge import knowledge, plan, trial_run

CONSTANTS = 6  # time constants that a course lasts
TRIES, PERIODS = 600, 5  # of the search for a growing cycle; of the cycle shown
GROWS = 1 + 1e-6  # factor above which a cycle is one that grows


class Gains(NamedTuple):
    """Constant gains L (n x p), gamma (p), both [1/s], and what they are worth; nearest: certified ones, if these are not.

    settled [s]: after which every error is at most 1 % of what it was, in size sqrt(V); None where none of that is sure.
    dynamics, V: of the errors that matter; a jump sensor's readings do not hold d, so that its widths are left out.
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
    """Attempts to make V rise: the falsifier's, the periodic side sequence of fastest growth if not certified, and courses."""

    attack: Attack
    cycle: Cycle | None
    courses: list[Trajectory]


class Assessment(NamedTuple):
    """A problem, a run of it if one was needed, its schedule of sides, what can be known of each output.

    gains: of a linear plant, where they are constant.
    """

    problem: Problem
    run: Run | None
    schedule: Schedule
    known: list[Knowledge]
    gains: Gains | None


def assess(problem: Problem) -> Assessment:
    """The account of a problem."""
    run = trial_run(problem)
    schedule = plan(problem, run)
    given = None if problem.model.nonlinear else constant_gains(problem.observer, problem.model)
    return Assessment(
        problem,
        run,
        schedule,
        knowledge(problem, schedule, run),
        None if given is None else _gains(problem, schedule, *given),
    )


def attack(of: Assessment, seed: int = 0) -> Attacks | None:
    """Attempts to break the gains of an account, which take seconds; None where no V exists that could be tried."""
    found = of.gains
    if found is None or not np.linalg.eigvalsh(found.V.P)[0] > 0:
        return None
    given, V = found.dynamics, found.V
    attack = falsify(given, V, seed=seed)
    cycle = None if found.certificate.certified else diverge(given, seed, TRIES)
    longest = max(of.problem.scenario.simulation.duration, of.schedule.duration)
    drawn = trajectories(
        given, V, of.schedule, min(CONSTANTS / max(abs(found.rates.rate), 1e-300), longest), seed
    )
    if attack.broken:
        drawn.append(
            trajectory("attack", given, V, attack.start, [attack.mode], attack.mode.seconds / 100)
        )
    if cycle is not None and cycle.factor > GROWS:
        drawn.append(
            trajectory(
                "cycle",
                given,
                V,
                growing(given, cycle),
                PERIODS * [*cycle.modes],
                cycle.seconds / 100,
            )
        )
    return Attacks(attack, cycle, drawn)


def _gains(problem: Problem, schedule: Schedule, L: Floats, gamma: Floats) -> Gains:
    linear, Ts, jump = problem.model.linear, problem.model.Ts, problem.sensor.kind == "jump"
    certificate = certify(linear, L, gamma, Ts)
    given, V = certificate.dynamics, certificate.V
    if jump:
        given, V = given._replace(gamma=0 * given.gamma), V._replace(gamma=0 * V.gamma)
    speed = rates(linear, L, gamma, schedule, jump)
    if certificate.certified:
        return Gains(L, gamma, certificate, speed, settling(given, V, schedule), None, given, V)
    return Gains(
        L, gamma, certificate, speed, None, _nearest(problem, schedule, L, gamma), given, V
    )


def _nearest(problem: Problem, schedule: Schedule, L: Floats, gamma: Floats) -> Gains | None:
    try:
        found = nearest(problem.model.linear, L, gamma, problem.model.Ts).certificate
    except StructureError:
        return None
    return (
        _gains(problem, schedule, found.dynamics.L, np.diag(found.dynamics.gamma)[::2])
        if found.certified
        else None
    )
