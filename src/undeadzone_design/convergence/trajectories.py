"""V along chosen trajectories of the error: random switching, adversaries, a schedule.

How long V takes to fall stands here too.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule, merge_equal_neighbours
from undeadzone.analysis.convergence.floquet import (
    error_matrices,
    matrix_powers,
    matrix_product,
    span_transitions,
)
from undeadzone.analysis.error_dynamics import Dynamics, Storage, branch_pattern
from undeadzone.util.arrays import Floats, Integers
from undeadzone_design.convergence.falsify import Cycle, SwitchMode, mode_transitions

SWITCHES = 120  # of a trajectory
PIECES = 10  # between two switches, unless that is less than a sample
RANDOM = 12  # random trajectories
WINDOW = 8  # switches: in every so many a fair adversary takes each full side pattern at least once
DOUBLINGS = 20  # of the number of passes, after which an error is taken to stay


class Trajectory(NamedTuple):
    """V along a single trajectory.

    Attributes:
        kind: what switches it.
        t: times (N) [s].
        V: relative to V(0) (N).
    """

    kind: str
    t: Floats
    V: Floats


class _Moves(NamedTuple):
    """Choices of an adversary at a switch: a mode per branch pattern.

    Attributes:
        maps: of the error until the next switch (modes x N x N).
        full: modes in which every output is read.
        window: switches in which a fair adversary takes each of these once.
    """

    maps: Floats
    full: Integers
    window: int


def simulate_trajectories(
    errors: Dynamics, V: Storage, schedule: Schedule, seconds: float, seed: int = 0
) -> list[Trajectory]:
    """Return V from a random error along random, adversarial and fair switching, and a
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
    modes = [_mean_vertex_mode(errors, row, step) for row in sides]
    pieces = mode_transitions(errors, modes)
    full = np.flatnonzero(sides.all(axis=1))
    interval_maps = matrix_powers(pieces, np.full(len(modes), count))
    moves = _Moves(interval_maps, full, max(WINDOW, 2 * len(full)))
    start = _random_unit_error(V, rng)
    chosen = [("random", _random_modes(rng, moves)) for _ in range(RANDOM)]
    chosen.append(("adversary", _adversary_modes(V, start, moves, fair=False)))
    chosen.append(("fair adversary", _adversary_modes(V, start, moves, fair=True)))
    times = np.full(SWITCHES * count, step)
    repeated = [(kind, pieces[np.repeat(order, count)]) for kind, order in chosen]
    drawn = [_trajectory_along_maps(kind, V, start, maps, times) for kind, maps in repeated]
    along = _modes_of_schedule(errors, schedule, seconds)
    return [*drawn, trajectory_along_modes("reference", errors, V, start, along, step)]


def _random_modes(rng: np.random.Generator, moves: _Moves) -> Integers:
    """Return random modes at every switch, each lasting up to a window."""
    modes = rng.integers(len(moves.maps), size=SWITCHES)
    durations = rng.integers(1, moves.window + 1, SWITCHES)
    return np.repeat(modes, durations)[:SWITCHES]


def _adversary_modes(V: Storage, start: Floats, moves: _Moves, fair: bool) -> Integers:
    """Return the modes at every switch that leave V largest.

    A fair adversary also takes every full mode once per window.
    """
    error = start
    chosen: list[int] = []
    owed: list[int] = []  # full modes that are still to be taken in this window
    for k in range(SWITCHES):
        if fair and k % moves.window == 0:
            owed = [*moves.full]
        in_debt = len(owed) == moves.window - k % moves.window
        allowed = np.array(owed) if in_debt else np.arange(len(moves.maps))
        worst = int(allowed[np.argmax(_value(V, moves.maps[allowed] @ error))])
        owed = [mode for mode in owed if mode != worst]
        error = moves.maps[worst] @ error
        chosen.append(worst)
    return np.array(chosen)


def trajectory_along_modes(
    kind: str, errors: Dynamics, V: Storage, start: Floats, modes: list[SwitchMode], step: float
) -> Trajectory:
    """Return V from an error along modes.

    Args:
        kind: name of the trajectory.
        errors: the error dynamics.
        V: the storage.
        start: the error `[x~; d~]` (n + 2p).
        modes: one after another.
        step: V is seen every so many seconds or so, and at every switch [s].
    """
    least = step if errors.Ts is None else errors.Ts
    counts = [max(1, round(mode.seconds / least)) for mode in modes]
    pieces = []
    for mode, count in zip(modes, counts, strict=True):
        pieces.append(mode._replace(seconds=mode.seconds / count))
    maps = np.repeat(mode_transitions(errors, pieces), counts, axis=0)
    times = np.repeat([piece.seconds for piece in pieces], counts)
    return _trajectory_along_maps(kind, V, start, maps, times)


def most_growing_error(errors: Dynamics, cycle: Cycle) -> Floats:
    """Return the error `[x~; d~]` that a cycle multiplies most: an eigenvector of its period."""
    identity = np.eye(errors.L.shape[0] + errors.gamma.shape[0])
    period = np.linalg.multi_dot([identity, *mode_transitions(errors, [*cycle.modes])[::-1]])
    values, vectors = np.linalg.eig(period)
    return np.asarray(vectors[:, np.argmax(np.abs(values))].real)


def worst_settling_time(
    errors: Dynamics, V: Storage, schedule: Schedule, share: float = 0.01
) -> float | None:
    """Return the time until sqrt(V) is at most `share` of its start for every error [s], or
    None.

    For V that never rises.

    Args:
        errors: the error dynamics.
        V: the storage.
        schedule: of the sides.
        share: of sqrt(V) at the start.

    Returns:
        The time in whole passes of the schedule [s], or None if some errors stay, or need more than
        2^20 passes.
    """
    seen, M = V.visible_errors
    F, _ = error_matrices(
        errors.A[0], errors.C, errors.L, errors.gamma, merge_equal_neighbours(schedule).sides
    )
    once, size = matrix_product(span_transitions(F, merge_equal_neighbours(schedule)))
    passes = [np.asarray(once * np.exp(size))[np.ix_(seen, seen)]]  # 1, 2, 4, ... of them
    while _largest_error_share(passes[-1], M) > share:
        if len(passes) > DOUBLINGS:
            return None
        passes.append(passes[-1] @ passes[-1])
    # The most passes that do not suffice, by their binary digits.
    count = 0
    done = np.eye(len(M))
    for k in range(len(passes) - 2, -1, -1):
        if _largest_error_share(passes[k] @ done, M) > share:
            count = count + 2**k
            done = passes[k] @ done
    return (count + 1) * schedule.total_duration


def _largest_error_share(E: Floats, M: Floats) -> float:
    """Return the largest |E e| / |e| over all e, with |e|^2 = e'M e."""
    from scipy.linalg import eigh

    return float(np.sqrt(max(eigh(E.T @ M @ E, M, eigvals_only=True)[-1], 0.0)))


def _mean_vertex_mode(errors: Dynamics, sides: Floats, seconds: float) -> SwitchMode:
    """Return a mode at the mean of the vertices with the whole innovation."""
    vertices = len(errors.A)
    p = errors.C.shape[0]
    S = branch_pattern(tuple(sides.astype(int)))
    return SwitchMode(np.full(vertices, 1 / vertices), S, np.ones(p), seconds)


def _modes_of_schedule(errors: Dynamics, schedule: Schedule, seconds: float) -> list[SwitchMode]:
    """Return the modes of a schedule, repeated for a time [s], up to a sample more."""
    once = []
    for sides, span in zip(*merge_equal_neighbours(schedule)[:2], strict=True):
        once.append(_mean_vertex_mode(errors, sides, span * (errors.Ts or 1.0)))
    modes: list[SwitchMode] = []
    left = seconds
    while left > 0:
        mode = once[len(modes) % len(once)]
        rest = left if errors.Ts is None else errors.Ts * np.ceil(left / errors.Ts)
        modes.append(mode._replace(seconds=min(mode.seconds, rest)))
        left -= mode.seconds
    return modes


def _random_unit_error(V: Storage, rng: np.random.Generator) -> Floats:
    """Return a random error of V = 1, isotropic if V is the squared length.

    What V does not see is 0.
    """
    seen, M = V.visible_errors
    direction = rng.normal(size=len(M))
    error = np.zeros(seen.size)
    error[seen] = np.linalg.solve(np.linalg.cholesky(M).T, direction / np.linalg.norm(direction))
    return error


def _value(V: Storage, errors: Floats) -> Floats:
    """Return V (N) of errors `[x~; d~]` (N rows)."""
    return V.evaluate_storage(*np.split(errors, [len(V.P)], axis=1))


def _trajectory_along_maps(
    kind: str, V: Storage, start: Floats, maps: Floats, times: Floats
) -> Trajectory:
    """Return V along maps of the error (K x N x N) with times (K) [s]."""
    errors = [start]
    for M in maps:
        errors.append(M @ errors[-1])
    values = _value(V, np.array(errors))
    return Trajectory(kind, np.concatenate([[0.0], np.cumsum(times)]), values / values[0])
