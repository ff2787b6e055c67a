"""All that a report shows of gains: certificate, rate, attempts to break it, courses of V, what can be known."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.arrays import Floats
from undeadzone.design.design import Known, knowledge, plan
from undeadzone.design.errordynamics import Dynamics, Storage, pattern
from undeadzone.design.falsify import Attack, Cycle, Mode, diverge, falsify, generator
from undeadzone.design.floquet import Rates, exponential, power, rates
from undeadzone.design.limits import Nearest, nearest
from undeadzone.design.passivity import Certificate, certify
from undeadzone.design.schedule import Schedule, merged
from undeadzone.errors import StructureError
from undeadzone.problem import Problem, constant_gains

POINTS, HOLD = 1200, 10  # of a course; points between two switches
RANDOM = 12  # random courses
TRIES = 600  # of the search for a growing cycle


class Course(NamedTuple):
    """V (N) along one trajectory, relative to V(0), at t (N) [s]; kind: random, adversary, reader, reference, attack or cycle."""

    kind: str
    t: Floats
    V: Floats


class Gains(NamedTuple):
    """What constant gains L (n x p), gamma (p), both [1/s], are worth along a schedule.

    nearest: the nearest certified gains where these are not, if there are any; attack: the attempt to make V rise; cycle:
    the periodic side sequence of fastest growth, where not certified; both absent, with the courses, if not asked for.
    """

    L: Floats
    gamma: Floats
    certificate: Certificate
    rates: Rates
    nearest: Nearest | None
    attack: Attack | None = None
    cycle: Cycle | None = None
    courses: tuple[Course, ...] = ()


class Account(NamedTuple):
    """A problem with its schedule, what can be known of each output, and its gains where they are constant."""

    problem: Problem
    schedule: Schedule
    known: list[Known]
    gains: Gains | None


def account(problem: Problem, attacked: bool = False, seed: int = 0) -> Account:
    """The account of a problem; attacked: with attempts to break the certificate, and V along the worst trajectories (seconds)."""
    schedule = plan(problem)
    found, model = None, problem.model
    given = None if model.nonlinear else constant_gains(problem.observer, model)
    if given is not None:
        certificate = certify(model.linear, *given, model.Ts)
        speed = rates(model.linear, *given, schedule, problem.sensor.kind == "jump")
        found = Gains(*given, certificate, speed, None if certificate.certified else _nearest(problem, *given))
        if attacked and np.linalg.eigvalsh(certificate.P)[0] > 0:
            attack = falsify(certificate.dynamics, certificate.V, seed=seed)
            cycle = None if certificate.certified else diverge(certificate.dynamics, seed, TRIES)
            found = found._replace(attack=attack, cycle=cycle, courses=_courses(found._replace(attack=attack, cycle=cycle), problem, schedule, seed))
    return Account(problem, schedule, knowledge(problem, schedule), found)


def courses(given: Dynamics, V: Storage, schedule: Schedule, seconds: float, seed: int = 0) -> tuple[Course, ...]:
    """V from one random error: under random switching, under adversaries, and along the schedule, for about `seconds`.

    Every switch of an adversary is the one that leaves V largest; the reader may not leave an output silent.
    """
    rng = np.random.default_rng(seed)
    p, vertices = given.C.shape[0], np.ones(len(given.A)) / len(given.A)
    step = seconds / POINTS if given.Ts is None else given.Ts * max(1, round(seconds / POINTS / given.Ts))
    corners = np.array(list(itertools.product((1, 0, -1), repeat=p)))
    reading = corners.all(axis=1)
    shares = np.repeat([1.0, 0.5], len(corners))
    modes = [Mode(vertices, pattern(tuple(sides)), np.full(p, share), step) for sides, share in zip(np.tile(corners, (2, 1)), shares, strict=True)]
    maps = np.stack([_map(given, mode) for mode in modes])
    full = np.flatnonzero(np.tile(reading, 2) & (shares == 1.0))
    start = _start(V, rng)
    switches = POINTS // HOLD

    def course(kind: str, choose: Floats | None, allowed: Floats) -> Course:
        held = np.linalg.matrix_power(maps[allowed], HOLD)
        error, errors = start, [start]
        for k in range(switches):
            mode = allowed[np.argmax(_value(V, held @ error))] if choose is None else choose[k]
            for _ in range(HOLD):
                error = maps[mode] @ error
                errors.append(error)
        return _course(kind, V, np.arange(len(errors)) * step, np.array(errors))

    found = [course("random", np.repeat(rng.integers(len(modes), size=switches), rng.integers(1, 20))[:switches], full) for _ in range(RANDOM)]
    return (*found, course("adversary", None, np.arange(len(modes))), course("reader", None, full), _along(given, V, schedule, seconds, start))


def _courses(found: Gains, problem: Problem, schedule: Schedule, seed: int) -> tuple[Course, ...]:
    given, V = found.certificate.dynamics, found.certificate.V
    wanted = 6 * found.rates.time_constant
    seconds = min(max(wanted, schedule.duration), max(problem.scenario.simulation.duration, schedule.duration))
    drawn = courses(given, V, schedule, seconds, seed)
    if found.attack is not None and found.attack.broken:
        drawn += (_repeated("attack", given, V, found.attack.start, (found.attack.mode,), 1),)
    if found.cycle is not None and found.cycle.factor > 1 + 1e-6:
        drawn += (_repeated("cycle", given, V, _growing(given, found.cycle), found.cycle.modes, 6),)
    return drawn


def _nearest(problem: Problem, L: Floats, gamma: Floats) -> Nearest | None:
    try:
        return nearest(problem.model.linear, L, gamma, problem.model.Ts)
    except StructureError:
        return None


def _along(given: Dynamics, V: Storage, schedule: Schedule, seconds: float, start: Floats) -> Course:
    """The course along the schedule, passed as often as the time asks, at its switches and between them."""
    passed = merged(schedule)
    step = seconds / POINTS
    unit = 1.0 if given.Ts is None else given.Ts
    t, error, times, errors = 0.0, start, [0.0], [start]
    pieces = []
    for sides, span in zip(passed.sides, passed.spans * unit, strict=True):
        count = max(1, round(span / step)) if given.Ts is None else round(span / given.Ts)
        mode = Mode(np.ones(len(given.A)) / len(given.A), pattern(tuple(sides.astype(int))), np.ones(given.C.shape[0]), span / count)
        pieces.append((_map(given, mode), count, span / count))
    while t < seconds:
        for M, count, piece in pieces:
            for _ in range(count):
                error, t = M @ error, t + piece
                times.append(t)
                errors.append(error)
    return _course("reference", V, np.array(times), np.array(errors))


def _repeated(kind: str, given: Dynamics, V: Storage, start: Floats, modes: tuple[Mode, ...], times: int) -> Course:
    error, t, errors = start, [0.0], [start]
    for mode in modes * times:
        count = 60 if given.Ts is None else max(1, round(mode.seconds / given.Ts))
        M = _map(given, mode._replace(seconds=mode.seconds / count))
        for _ in range(count):
            error = M @ error
            errors.append(error)
            t.append(t[-1] + mode.seconds / count)
    return _course(kind, V, np.array(t), np.array(errors))


def _growing(given: Dynamics, cycle: Cycle) -> Floats:
    """The error that a cycle multiplies most: an eigenvector of its period."""
    M = np.eye(given.C.shape[1] + given.gamma.shape[0])
    for mode in cycle.modes:
        M = _map(given, mode) @ M
    values, vectors = np.linalg.eig(M)
    grown = vectors[:, np.argmax(np.abs(values))]
    return np.asarray(grown.real if np.linalg.norm(grown.real) >= np.linalg.norm(grown.imag) else grown.imag)


def _map(given: Dynamics, mode: Mode) -> Floats:
    """What a mode does to [x~; d~] in its time, exactly."""
    F = generator(given, mode)
    if given.Ts is None:
        return exponential(F[None] * mode.seconds)[0]
    return power((np.eye(len(F)) + given.Ts * F)[None], np.array([round(mode.seconds / given.Ts)]))[0]


def _start(V: Storage, rng: np.random.Generator) -> Floats:
    """A random error with V = 1, in a direction that is uniform where V is the squared length; 0 in what V does not see."""
    M = _weight(V)
    seen = np.diag(M) > 0
    error = np.zeros(len(M))
    direction = rng.normal(size=seen.sum())
    error[seen] = np.linalg.solve(np.linalg.cholesky(M[np.ix_(seen, seen)]).T, direction / np.linalg.norm(direction))
    return error


def _weight(V: Storage) -> Floats:
    n = len(V.P)
    M = np.zeros((n + len(V.R), n + len(V.R)))
    M[:n, :n], M[n:, n:] = V.P, V.R
    return M


def _value(V: Storage, errors: Floats) -> Floats:
    n = len(V.P)
    return V.value(errors[..., :n], errors[..., n:])


def _course(kind: str, V: Storage, t: Floats, errors: Floats) -> Course:
    value = _value(V, errors)
    return Course(kind, t, value / value[0])
