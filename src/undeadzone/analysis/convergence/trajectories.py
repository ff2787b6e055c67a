"""V along chosen trajectories of the error: random switching, adversaries, a schedule of sides; how long it takes to fall."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from undeadzone.analysis.convergence.falsify import Cycle, Mode, passages
from undeadzone.analysis.convergence.floquet import error_matrices, power, product, transitions
from undeadzone.analysis.error_dynamics import Dynamics, Storage, pattern
from undeadzone.analysis.side_schedule import Schedule, merged
from undeadzone.support.arrays import Floats

SWITCHES, PIECES = (
    120,
    10,
)  # of a course; pieces between two switches, unless that is less than a sample
RANDOM = 12  # random courses
WINDOW = 8  # switches: in every so many a fair adversary takes each full side pattern at least once


class Trajectory(NamedTuple):
    """V (N) along one trajectory, relative to V(0), at t (N) [s], and what switches it."""

    kind: str
    t: Floats
    V: Floats


def trajectories(
    given: Dynamics, V: Storage, schedule: Schedule, seconds: float, seed: int = 0
) -> list[Trajectory]:
    """V from one random error, for about `seconds`: random ones, an adversary, a fair one, and the schedule.

    An adversary switches to what leaves V largest. The fair one must also read every output on both of its sides, each
    combination once in every window of time: that is what convergence needs (docs/certificate.md).
    """
    rng = np.random.default_rng(seed)
    p = given.C.shape[0]
    step = seconds / SWITCHES / PIECES
    if given.Ts is not None:
        step = given.Ts * max(1, round(step / given.Ts))
    count = max(1, round(seconds / SWITCHES / step))
    sides = np.array(list(itertools.product((1, -1, 0), repeat=p)))
    full = np.flatnonzero(sides.all(axis=1))
    modes = [_mode(given, row, step) for row in sides]
    pieces = passages(given, modes)
    held = power(pieces, np.full(len(modes), count))
    window = max(WINDOW, 2 * len(full))
    start = _start(V, rng)

    def adversary(fair: bool) -> list[int]:
        error, chosen, owed = start, list[int](), list[int]()
        for k in range(SWITCHES):
            if fair and k % window == 0:
                owed = [*full]
            allowed = np.array(owed) if len(owed) == window - k % window else np.arange(len(modes))
            taken = int(allowed[np.argmax(_value(V, held[allowed] @ error))])
            owed = [mode for mode in owed if mode != taken]
            error = held[taken] @ error
            chosen.append(taken)
        return chosen

    def random() -> Any:
        return np.repeat(
            rng.integers(len(modes), size=SWITCHES), rng.integers(1, window + 1, SWITCHES)
        )[:SWITCHES]

    def course(kind: str, chosen: Any) -> Trajectory:
        return _course(
            kind, V, start, pieces[np.repeat(chosen, count)], np.full(SWITCHES * count, step)
        )

    found = [course("random", random()) for _ in range(RANDOM)]
    found += [course("adversary", adversary(False)), course("fair adversary", adversary(True))]
    return [
        *found,
        trajectory("reference", given, V, start, _passes(given, schedule, seconds), step),
    ]


def trajectory(
    kind: str, given: Dynamics, V: Storage, start: Floats, modes: list[Mode], step: float
) -> Trajectory:
    """V from an error [x~; d~] along modes, seen every `step` [s] or so, and at every switch."""
    counts = [
        max(1, round(mode.seconds / (step if given.Ts is None else given.Ts))) for mode in modes
    ]
    pieces = [
        mode._replace(seconds=mode.seconds / count)
        for mode, count in zip(modes, counts, strict=True)
    ]
    return _course(
        kind,
        V,
        start,
        np.repeat(passages(given, pieces), counts, axis=0),
        np.repeat([piece.seconds for piece in pieces], counts),
    )


def growing(given: Dynamics, cycle: Cycle) -> Floats:
    """The error [x~; d~] that a cycle multiplies most: an eigenvector of its period."""
    period = np.linalg.multi_dot(
        [np.eye(given.L.shape[0] + given.gamma.shape[0]), *passages(given, [*cycle.modes])[::-1]]
    )
    values, vectors = np.linalg.eig(period)
    return np.asarray(vectors[:, np.argmax(np.abs(values))].real)


def settling(given: Dynamics, V: Storage, schedule: Schedule, share: float = 0.01) -> float | None:
    """The time [s], in whole passes of the schedule, after which sqrt(V) is at most that share of what it was, whatever the error.

    For V that never rises. None where some errors stay, or fall for more than 2^20 passes.
    """
    from scipy.linalg import eigh

    seen, M = _seen(V)
    F, _ = error_matrices(given.A[0], given.C, given.L, given.gamma, merged(schedule).sides)
    once, size = product(transitions(F, merged(schedule)))
    passes = [np.asarray(once * np.exp(size))[np.ix_(seen, seen)]]

    def left(E: Floats) -> float:
        return float(np.sqrt(max(eigh(E.T @ M @ E, M, eigvals_only=True)[-1], 0.0)))

    while left(passes[-1]) > share:
        if len(passes) > 20:
            return None
        passes.append(passes[-1] @ passes[-1])
    count, done = 0, np.eye(len(M))
    for k in range(
        len(passes) - 2, -1, -1
    ):  # the most passes that do not suffice, by their binary digits
        if left(passes[k] @ done) > share:
            count, done = count + 2**k, passes[k] @ done
    return (count + 1) * schedule.duration


def _mode(given: Dynamics, sides: Floats, seconds: float) -> Mode:
    """A mode at the mean of the vertices with the whole innovation."""
    vertices = len(given.A)
    return Mode(
        np.full(vertices, 1 / vertices),
        pattern(tuple(sides.astype(int))),
        np.ones(given.C.shape[0]),
        seconds,
    )


def _passes(given: Dynamics, schedule: Schedule, seconds: float) -> list[Mode]:
    """The modes of a schedule, passed again and again, for that time or up to a sample more."""
    once = [
        _mode(given, sides, span * (given.Ts or 1.0))
        for sides, span in zip(*merged(schedule)[:2], strict=True)
    ]
    found, left = list[Mode](), seconds
    while left > 0:
        mode = once[len(found) % len(once)]
        rest = left if given.Ts is None else given.Ts * np.ceil(left / given.Ts)
        found.append(mode._replace(seconds=min(mode.seconds, rest)))
        left -= mode.seconds
    return found


def _start(V: Storage, rng: np.random.Generator) -> Floats:
    """A random error of V = 1, every direction alike where V is the squared length; what V does not see is 0."""
    seen, M = _seen(V)
    direction = rng.normal(size=len(M))
    error = np.zeros(seen.size)
    error[seen] = np.linalg.solve(np.linalg.cholesky(M).T, direction / np.linalg.norm(direction))
    return error


def _seen(V: Storage) -> tuple[np.ndarray, Floats]:
    """(which of [x~; d~] V sees, M with V = e'M e on these)."""
    n, d = len(V.P), np.diag(V.R) > 0
    M = np.zeros((n + d.sum(), n + d.sum()))
    M[:n, :n], M[n:, n:] = V.P, V.R[np.ix_(d, d)]
    return np.concatenate([np.ones(n, bool), d]), M


def _value(V: Storage, errors: Floats) -> Floats:
    return V.value(*np.split(errors, [len(V.P)], axis=1))


def _course(kind: str, V: Storage, start: Floats, maps: Floats, seconds: Floats) -> Trajectory:
    errors = [start]
    for M in maps:
        errors.append(M @ errors[-1])
    along = _value(V, np.array(errors))
    return Trajectory(kind, np.concatenate([[0.0], np.cumsum(seconds)]), along / along[0])
