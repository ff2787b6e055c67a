"""Attempts to break a certificate: random and adversarial switching on the exact error dynamics.

The input u cancels in the errors, but it moves z across the edges at will: an adversary with the
input has every side sequence at hand. So the errors are driven by arbitrary sequences of modes: a
vertex (or a mixture of them), a side pattern, and the share theta of the innovation that the
silence innovation leaves.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.convergence.floquet import matrix_exponentials, matrix_powers
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    Storage,
    branch_pattern,
    largest_growth_rate,
)
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, Integers

ROUNDING = 1e-9  # of V: what V may rise by in one switch before it counts
GROUPS = 200  # of trajectories, which share their modes; one in 20 takes the worst mode on offer
OFFERED = 24  # modes that such a group chooses from
TINY = 1e-300
LARGEST_LOG = 700.0  # beyond it e^x overflows


class SwitchMode(NamedTuple):
    """Error dynamics between two switches.

    Attributes:
        vertices: weights of the vertices.
        S: the sides read (p x 2p).
        theta: share of the innovation that is left of each output (p).
        seconds: for how long [s].
    """

    vertices: Floats
    S: Floats
    theta: Floats
    seconds: float


class Attack(NamedTuple):
    """Outcome of an attack on V.

    Attributes:
        broken: whether V rose beyond rounding.
        rise: by how much of itself V rose at most in one switch.
        start: the errors `[x~; d~]` from which `mode` raises V by `rise`.
        mode: the worst one.
        growth: the largest V(end)/V(0) of a trajectory.
        trajectories: how many there were.
    """

    broken: bool
    rise: float
    start: Floats
    mode: SwitchMode
    growth: float
    trajectories: int


class Cycle(NamedTuple):
    """Periodic branch sequence along which the error grows.

    Attributes:
        factor: by which it grows in a period (above 1 it is a proof of divergence).
        seconds: the period [s].
        modes: of the period, one after another.
    """

    factor: float
    seconds: float
    modes: tuple[SwitchMode, ...]


def falsify(
    errors: Dynamics,
    V: Storage,
    trajectories: int = 100_000,
    switches: int = 60,
    seed: int = 0,
    library: int = 160,
) -> Attack:
    """Try to make V rise along random and adversarial switching.

    A trajectory in twenty always takes the worst of 24 modes.

    The others switch at random. They start at random, and at the directions that single modes raise
    most. The errors are kept in coordinates where V is the squared length, and at length 1, so that
    rounding stays that of one step.

    Args:
        errors: the error dynamics.
        V: the storage that is supposed to fall.
        trajectories: how many, at least.
        switches: of each trajectory.
        seed: of all that is random.
        library: how many modes there are to choose from.

    Raises:
        InputError: where V is not positive definite.
    """
    rng = np.random.default_rng(seed)
    modes = _mode_library(errors, rng, library)
    if not np.linalg.eigvalsh(V.P)[0] > 0:
        raise InputError("V: its P is not positive definite, there is nothing to break")
    # V = |T e|^2 for the errors e of [x~; d~] that it sees; a width that it does not see is known.
    seen, M = V.visible_errors
    T = np.linalg.cholesky(M).T
    inverse = np.linalg.inv(T)
    maps = mode_transitions(errors, modes, lambda F: T @ F[np.ix_(seen, seen)] @ inverse)
    size = -(-trajectories // GROUPS)
    states = _start_errors(rng, maps, size)
    rise = -np.inf
    start = states[0, 0]
    mode = modes[0]
    log = np.zeros((GROUPS, size))  # of V along each trajectory
    for _ in range(switches):
        modes_of_paths, following = _switch_modes(rng, maps, states)
        lengths = np.einsum("gij,gij->gi", following, following)
        at = np.unravel_index(np.argmax(lengths), lengths.shape)
        if lengths[at] - 1 > rise:
            rise = float(lengths[at] - 1)
            start = states[at]
            mode = modes[modes_of_paths[at]]
        log += np.log(np.maximum(lengths, TINY))
        states = following / np.sqrt(np.maximum(lengths, TINY))[..., None]
    worst = np.zeros(seen.size)
    worst[seen] = inverse @ start
    largest = float(np.exp(min(log.max(), LARGEST_LOG)))
    return Attack(rise > ROUNDING, rise, worst, mode, largest, GROUPS * size)


def _start_errors(rng: np.random.Generator, maps: Floats, size: int) -> Floats:
    """Return errors of length 1 (groups x size x N). A map raises the first of each group most."""
    shape = (GROUPS, size, maps.shape[-1])
    states = rng.normal(size=shape) * 10 ** rng.uniform(-1, 1, shape)
    states[:, 0] = np.linalg.svd(maps)[2][rng.integers(len(maps), size=GROUPS), 0]
    states /= np.linalg.norm(states, axis=2, keepdims=True)
    return states


def _switch_modes(
    rng: np.random.Generator, maps: Floats, states: Floats
) -> tuple[Integers, Floats]:
    """Return (modes, errors after the switch): random modes, in a group of 20 the worst on
    offer.
    """
    groups, size = states.shape[:2]
    drawn = np.asarray(rng.integers(len(maps), size=groups))
    modes_of_paths = np.repeat(drawn[:, None], size, axis=1)
    following = states @ maps[drawn].transpose(0, 2, 1)
    offered = rng.choice(len(maps), min(OFFERED, len(maps)), replace=False)
    for g in range(groups // 20):
        tried = states[g] @ maps[offered].transpose(0, 2, 1)
        pick = np.argmax(np.einsum("mij,mij->mi", tried, tried), axis=0)
        following[g] = tried[pick, np.arange(size)]
        modes_of_paths[g] = offered[pick]
    return modes_of_paths, following


def diverge(errors: Dynamics, seed: int = 0, tries: int = 2000) -> Cycle:
    """Search at random for the periodic branch sequence of fastest growth.

    Its times are refined in continuous time. The factor is the largest modulus of the period's
    eigenvalues on `[x~; d~]`. A width that is not read counts 1.

    Args:
        errors: the error dynamics.
        seed: of the search.
        tries: how many sequences are tried.
    """
    from scipy.optimize import minimize

    rng = np.random.default_rng(seed)
    modes = _mode_library(errors, rng, 120)
    maps = mode_transitions(errors, modes)
    times = np.array([mode.seconds for mode in modes])
    chosen = np.zeros(0, int)
    fastest = -np.inf
    for _ in range(tries):
        cycle = rng.integers(len(modes), size=rng.integers(1, 6))
        rate = _cycle_rate(maps[cycle], times[cycle])
        if not chosen.size or rate > fastest:
            chosen = cycle
            fastest = rate

    def timed(logs: Floats) -> list[SwitchMode]:
        """Return the modes of the cycle with times from their logarithms."""
        seconds = np.exp(np.clip(logs, np.log(times.min()), np.log(times.max())))
        return [modes[k]._replace(seconds=float(s)) for k, s in zip(chosen, seconds, strict=True)]

    def loss(logs: Floats) -> float:
        """Return the negative growth rate of the cycle [1/s]."""
        cycle = timed(logs)
        return -_cycle_rate(
            mode_transitions(errors, cycle), np.array([mode.seconds for mode in cycle])
        )

    logs = np.log(times[chosen])
    if errors.Ts is None:
        logs = minimize(loss, logs, method="Nelder-Mead", options={"maxiter": 150}).x
    modes_of_cycle = timed(logs)
    seconds = sum(mode.seconds for mode in modes_of_cycle)
    factor = float(np.exp(min(-loss(logs) * seconds, LARGEST_LOG)))
    return Cycle(factor, seconds, tuple(modes_of_cycle))


def _cycle_rate(maps: Floats, times: Floats) -> float:
    """Return the growth rate of a period of maps (K x N x N) with times (K) [s], in 1/s."""
    period = np.linalg.multi_dot([np.eye(maps.shape[1]), *maps[::-1]])
    return float(np.log(max(np.abs(np.linalg.eigvals(period)).max(), TINY)) / times.sum())


def error_generator(errors: Dynamics, mode: SwitchMode) -> Floats:
    """Return F of `[x~; d~]' = F [x~; d~]` in a mode (delta form if sampled) [1/s]."""
    A = np.tensordot(mode.vertices, np.stack(errors.A), 1)
    innovation = mode.theta[:, None] * np.hstack([errors.C, -mode.S])
    innovation[~mode.S.any(axis=1)] = 0.0
    widths = errors.gamma.shape[0]
    top = np.hstack([A, np.zeros((len(A), widths))])
    free = np.vstack([top, np.zeros((widths, len(A) + widths))])
    return np.asarray(free + np.vstack([-errors.L, errors.gamma @ mode.S.T]) @ innovation)


def mode_transitions(
    errors: Dynamics, modes: list[SwitchMode], moved: Callable[[Floats], Floats] = np.asarray
) -> Floats:
    """Return the exact maps of `[x~; d~]` over the modes' times (K x N x N).

    Sampled, times are whole samples.

    Args:
        errors: the error dynamics.
        modes: one for each map.
        moved: F -> F in the coordinates that are required.
    """
    F = np.stack([moved(error_generator(errors, mode)) for mode in modes])
    seconds = np.array([mode.seconds for mode in modes])
    if errors.Ts is None:
        return matrix_exponentials(F * seconds[:, None, None])
    return matrix_powers(
        np.eye(F.shape[-1]) + errors.Ts * F, np.round(seconds / errors.Ts).astype(int)
    )


def _mode_library(errors: Dynamics, rng: np.random.Generator, count: int) -> list[SwitchMode]:
    """Return modes of every branch pattern at every vertex, then random modes, from short to
    long.

    The random ones mix vertices and have shares theta below 1.
    """
    p = errors.C.shape[0]
    vertices = len(errors.A)
    times = _mode_durations(errors, rng, count)
    corners = list(itertools.product((1, 0, -1), repeat=p))
    modes = []
    for k in range(count):
        if k < count // 2:
            sides = corners[k % len(corners)]
            weights = np.eye(vertices)[(k // len(corners)) % vertices]
            theta = np.ones(p)
        else:
            sides = corners[rng.integers(len(corners))]
            weights = rng.dirichlet(np.full(vertices, 0.5))
            theta = np.where(rng.random(p) < 0.5, 1.0, rng.random(p))
        modes.append(SwitchMode(weights, branch_pattern(sides), theta, float(times[k])))
    return modes


def _mode_durations(errors: Dynamics, rng: np.random.Generator, count: int) -> Floats:
    """Return random times [s] from below the fastest rate to above the slowest, on a log
    scale.
    """
    corrected = [np.linalg.eigvals(A - errors.L @ errors.C) for A in errors.A]
    fast = max(float(np.abs(poles).max()) for poles in corrected)
    fast += float(np.abs(errors.gamma).max())
    slow = max(min(abs(largest_growth_rate(A, errors.Ts)) for A in errors.A), 1e-3 * fast)
    times = 10 ** rng.uniform(np.log10(1e-2 / fast), np.log10(3 / slow), count)
    if errors.Ts is not None:
        times = errors.Ts * np.clip(np.round(times / errors.Ts), 1, 1000)
    return np.asarray(times)
