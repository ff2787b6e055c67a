"""V along chosen trajectories of the error: random switching, adversaries, a schedule of sides.

How long V takes to fall stands here too.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule, merge_equal_neighbours
from undeadzone.analysis.convergence.falsify import Cycle, Mode, passages
from undeadzone.analysis.convergence.floquet import error_matrices, power, product, transitions
from undeadzone.analysis.error_dynamics import Dynamics, Storage, pattern
from undeadzone.util.arrays import Floats, Integers

SWITCHES = 120  # of a trajectory
PIECES = 10  # between two switches, unless that is less than a sample
RANDOM = 12  # random trajectories
WINDOW = 8  # switches: in every so many a fair adversary takes each full side pattern at least once
DOUBLINGS = 20  # of the number of passes, after which an error is taken to stay


class Trajectory(NamedTuple):
    """V along one trajectory.

    Attributes:
        kind: what switches it.
        t: times (N) [s].
        V: relative to V(0) (N).
    """

    kind: str
    t: Floats
    V: Floats


class _Moves(NamedTuple):
    """What an adversary can choose from at a switch: one mode per side pattern.

    Attributes:
        maps: of the error until the next switch (modes x N x N).
        full: modes in which every output is read.
        window: switches in which a fair adversary takes each of these once.
    """

    maps: Floats
    full: Integers
    window: int


def trajectories(
    errors: Dynamics, V: Storage, schedule: Schedule, seconds: float, seed: int = 0
) -> list[Trajectory]:
    """Return V from one random error: along random trajectories, an adversary's, a fair one's, a
    schedule.

    An adversary switches to what leaves V largest. The fair one must also read every output on both
    of its sides, each combination once in every window of time: that is what convergence needs
    (docs/certificate.md).

    Args:
        errors: the error dynamics.
        V: the storage.
        schedule: of the sides along the reference.
        seconds: for about how long [s].
        seed: of all that is random.
    """
    rng = np.random.default_rng(seed)
    step = seconds / SWITCHES / PIECES
    if errors.Ts is not None:
        step = errors.Ts * max(1, round(step / errors.Ts))
    count = max(1, round(seconds / SWITCHES / step))  # pieces between two switches
    sides = np.array(list(itertools.product((1, -1, 0), repeat=errors.C.shape[0])))
    modes = [_mode(errors, row, step) for row in sides]
    pieces = passages(errors, modes)
    full = np.flatnonzero(sides.all(axis=1))
    held = power(pieces, np.full(len(modes), count))
    moves = _Moves(held, full, max(WINDOW, 2 * len(full)))
    start = _start(V, rng)
    chosen = [("random", _random(rng, moves)) for _ in range(RANDOM)]
    chosen.append(("adversary", _adversary(V, start, moves, fair=False)))
    chosen.append(("fair adversary", _adversary(V, start, moves, fair=True)))
    times = np.full(SWITCHES * count, step)
    taken = [(kind, pieces[np.repeat(order, count)]) for kind, order in chosen]
    drawn = [_trajectory(kind, V, start, maps, times) for kind, maps in taken]
    along = _passes(errors, schedule, seconds)
    return [*drawn, trajectory("reference", errors, V, start, along, step)]


def _random(rng: np.random.Generator, moves: _Moves) -> Integers:
    """Return modes at every switch, each held for up to a window."""
    modes = rng.integers(len(moves.maps), size=SWITCHES)
    held = rng.integers(1, moves.window + 1, SWITCHES)
    return np.repeat(modes, held)[:SWITCHES]


def _adversary(V: Storage, start: Floats, moves: _Moves, fair: bool) -> Integers:
    """Return modes at every switch that leave V largest; a fair adversary owes the full ones,
    too.
    """
    error = start
    chosen: list[int] = []
    owed: list[int] = []  # full modes that are still to be taken in this window
    for k in range(SWITCHES):
        if fair and k % moves.window == 0:
            owed = [*moves.full]
        in_debt = len(owed) == moves.window - k % moves.window
        allowed = np.array(owed) if in_debt else np.arange(len(moves.maps))
        taken = int(allowed[np.argmax(_value(V, moves.maps[allowed] @ error))])
        owed = [mode for mode in owed if mode != taken]
        error = moves.maps[taken] @ error
        chosen.append(taken)
    return np.array(chosen)


def trajectory(
    kind: str, errors: Dynamics, V: Storage, start: Floats, modes: list[Mode], step: float
) -> Trajectory:
    """Return V from one error along modes.

    Args:
        kind: what the trajectory is called.
        errors: the error dynamics.
        V: the storage.
        start: the error [x~; d~] (n + 2p).
        modes: one after another.
        step: V is seen every so many seconds or so, and at every switch [s].
    """
    least = step if errors.Ts is None else errors.Ts
    counts = [max(1, round(mode.seconds / least)) for mode in modes]
    pieces = []
    for mode, count in zip(modes, counts, strict=True):
        pieces.append(mode._replace(seconds=mode.seconds / count))
    maps = np.repeat(passages(errors, pieces), counts, axis=0)
    times = np.repeat([piece.seconds for piece in pieces], counts)
    return _trajectory(kind, V, start, maps, times)


def growing(errors: Dynamics, cycle: Cycle) -> Floats:
    """Return the error [x~; d~] that a cycle multiplies most: an eigenvector of its period."""
    identity = np.eye(errors.L.shape[0] + errors.gamma.shape[0])
    period = np.linalg.multi_dot([identity, *passages(errors, [*cycle.modes])[::-1]])
    values, vectors = np.linalg.eig(period)
    return np.asarray(vectors[:, np.argmax(np.abs(values))].real)


def settling(errors: Dynamics, V: Storage, schedule: Schedule, share: float = 0.01) -> float | None:
    """Return the time [s] after which sqrt(V) is at most a share of what it was, whatever the
    error.

    For V that never rises.

    Args:
        errors: the error dynamics.
        V: the storage.
        schedule: of the sides.
        share: of sqrt(V) at the start.

    Returns:
        The time in whole passes of the schedule [s]; None where some errors stay, or fall for more
        than 2^20 passes.
    """
    seen, M = V.visible_errors
    F, _ = error_matrices(
        errors.A[0], errors.C, errors.L, errors.gamma, merge_equal_neighbours(schedule).sides
    )
    once, size = product(transitions(F, merge_equal_neighbours(schedule)))
    passes = [np.asarray(once * np.exp(size))[np.ix_(seen, seen)]]  # 1, 2, 4, ... of them
    while _largest_error_share(passes[-1], M) > share:
        if len(passes) > DOUBLINGS:
            return None
        passes.append(passes[-1] @ passes[-1])
    # The most passes that do not suffice, by their binary digits.
    count, done = 0, np.eye(len(M))
    for k in range(len(passes) - 2, -1, -1):
        if _largest_error_share(passes[k] @ done, M) > share:
            count, done = count + 2**k, passes[k] @ done
    return (count + 1) * schedule.duration


def _largest_error_share(E: Floats, M: Floats) -> float:
    """Return the largest |E e| / |e| over all e, with |e|^2 = e'M e."""
    from scipy.linalg import eigh

    return float(np.sqrt(max(eigh(E.T @ M @ E, M, eigvals_only=True)[-1], 0.0)))


def _mode(errors: Dynamics, sides: Floats, seconds: float) -> Mode:
    """Return a mode at the mean of the vertices with the whole innovation."""
    vertices, p = len(errors.A), errors.C.shape[0]
    S = pattern(tuple(sides.astype(int)))
    return Mode(np.full(vertices, 1 / vertices), S, np.ones(p), seconds)


def _passes(errors: Dynamics, schedule: Schedule, seconds: float) -> list[Mode]:
    """Return the modes of a schedule, passed again and again, for that time or up to a sample
    more.
    """
    once = []
    for sides, span in zip(*merge_equal_neighbours(schedule)[:2], strict=True):
        once.append(_mode(errors, sides, span * (errors.Ts or 1.0)))
    modes: list[Mode] = []
    left = seconds
    while left > 0:
        mode = once[len(modes) % len(once)]
        rest = left if errors.Ts is None else errors.Ts * np.ceil(left / errors.Ts)
        modes.append(mode._replace(seconds=min(mode.seconds, rest)))
        left -= mode.seconds
    return modes


def _start(V: Storage, rng: np.random.Generator) -> Floats:
    """Return a random error of V = 1, every direction alike where V is the squared length.

    What V does not see is 0.
    """
    seen, M = V.visible_errors
    direction = rng.normal(size=len(M))
    error = np.zeros(seen.size)
    error[seen] = np.linalg.solve(np.linalg.cholesky(M).T, direction / np.linalg.norm(direction))
    return error


def _value(V: Storage, errors: Floats) -> Floats:
    """Return V (N) of errors [x~; d~] (N rows)."""
    return V.value(*np.split(errors, [len(V.P)], axis=1))


def _trajectory(kind: str, V: Storage, start: Floats, maps: Floats, times: Floats) -> Trajectory:
    """Return V along maps of the error (K x N x N), of these times (K) [s]."""
    errors = [start]
    for M in maps:
        errors.append(M @ errors[-1])
    values = _value(V, np.array(errors))
    return Trajectory(kind, np.concatenate([[0.0], np.cumsum(times)]), values / values[0])
