"""Attempts to break a certificate: random and adversarial switching on the exact error dynamics.

The input u cancels in the errors, but it moves z across the edges at will: an adversary with the input has every side
sequence at hand. So the errors are driven by arbitrary sequences of modes: a vertex (or a mixture of them), a side
pattern, and the share theta of the innovation that the silence innovation leaves.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.convergence.floquet import exponential, power
from undeadzone.analysis.error_dynamics import Dynamics, Storage, growth, pattern
from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats

ROUNDING = 1e-9  # of V: what V may rise by in one switch before it counts


class Mode(NamedTuple):
    """What holds between two switches: weights of the vertices, S (p x 2p), theta (p), and for how long [s]."""

    vertices: Floats
    S: Floats
    theta: Floats
    seconds: float


class Attack(NamedTuple):
    """The outcome: whether V rose beyond rounding, by how much of itself at most in one switch, and what it took.

    start: the errors [x~; d~] from which `mode` raises V by `rise`; growth: the largest V(end)/V(0) of a trajectory.
    """

    broken: bool
    rise: float
    start: Floats
    mode: Mode
    growth: float
    trajectories: int


class Cycle(NamedTuple):
    """A periodic side sequence along which the error grows by `factor` a period of `seconds`: proof of divergence if above 1."""

    factor: float
    seconds: float
    modes: tuple[Mode, ...]


def falsify(
    given: Dynamics,
    V: Storage,
    trajectories: int = 100_000,
    switches: int = 60,
    seed: int = 0,
    library: int = 160,
) -> Attack:
    """Try to make V rise. One trajectory in twenty always takes the worst of 24 modes, the others switch at random.

    They start at random, and at the directions that single modes raise most. The errors are kept in coordinates where V
    is the squared length, and at length 1, so that rounding stays that of one step.
    """
    rng = np.random.default_rng(seed)
    modes = _library(given, rng, library)
    kept, forward, back = _square_root(V)
    maps = passages(given, modes, lambda F: forward @ F[np.ix_(kept, kept)] @ back)
    groups = 200
    size = -(-trajectories // groups)
    states = rng.normal(size=(groups, size, len(forward))) * 10 ** rng.uniform(
        -1, 1, (groups, size, len(forward))
    )
    states[:, 0] = np.linalg.svd(maps)[2][rng.integers(len(modes), size=groups), 0]
    states /= np.linalg.norm(states, axis=2, keepdims=True)
    rise, start, mode, log = -np.inf, states[0, 0], modes[0], np.zeros((groups, size))
    for _ in range(switches):
        taken = np.repeat(rng.integers(len(modes), size=groups)[:, None], size, axis=1)
        following = states @ maps[taken[:, 0]].transpose(0, 2, 1)
        offered = rng.choice(len(modes), min(24, len(modes)), replace=False)
        for g in range(groups // 20):
            tried = states[g] @ maps[offered].transpose(0, 2, 1)
            pick = np.argmax(np.einsum("mij,mij->mi", tried, tried), axis=0)
            following[g], taken[g] = tried[pick, np.arange(size)], offered[pick]
        lengths = np.einsum("gij,gij->gi", following, following)
        at = np.unravel_index(np.argmax(lengths), lengths.shape)
        if lengths[at] - 1 > rise:
            rise, start, mode = float(lengths[at] - 1), states[at], modes[taken[at]]
        log += np.log(np.maximum(lengths, 1e-300))
        states = following / np.sqrt(np.maximum(lengths, 1e-300))[..., None]
    errors = np.zeros(kept.size)
    errors[kept] = back @ start
    return Attack(
        rise > ROUNDING, rise, errors, mode, float(np.exp(min(log.max(), 700.0))), groups * size
    )


def diverge(given: Dynamics, seed: int = 0, tries: int = 2000) -> Cycle:
    """The periodic side sequence of fastest growth that a random search finds, its times refined in continuous time.

    factor is the largest modulus of the period's eigenvalues on [x~; d~]; a width that is not read counts 1.
    """
    from scipy.optimize import minimize

    rng = np.random.default_rng(seed)
    modes = _library(given, rng, 120)
    maps = passages(given, modes)
    times = np.array([mode.seconds for mode in modes])

    def rate(maps: Floats, times: Floats) -> float:
        product = np.linalg.multi_dot([np.eye(maps.shape[1]), *maps[::-1]])
        return float(np.log(max(np.abs(np.linalg.eigvals(product)).max(), 1e-300)) / times.sum())

    tried = (rng.integers(len(modes), size=rng.integers(1, 6)) for _ in range(tries))
    chosen = max(tried, key=lambda cycle: rate(maps[cycle], times[cycle]))

    def timed(logs: Floats) -> list[Mode]:
        seconds = np.exp(np.clip(logs, np.log(times.min()), np.log(times.max())))
        return [modes[k]._replace(seconds=float(s)) for k, s in zip(chosen, seconds, strict=True)]

    def growth_rate(logs: Floats) -> float:
        cycle = timed(logs)
        return rate(passages(given, cycle), np.array([mode.seconds for mode in cycle]))

    logs = np.log(times[chosen])
    if given.Ts is None:
        logs = minimize(
            lambda logs: -growth_rate(logs), logs, method="Nelder-Mead", options={"maxiter": 150}
        ).x
    cycle = timed(logs)
    seconds = sum(mode.seconds for mode in cycle)
    return Cycle(float(np.exp(min(growth_rate(logs) * seconds, 700.0))), seconds, tuple(cycle))


def generator(given: Dynamics, mode: Mode) -> Floats:
    """F of [x~; d~]' = F [x~; d~] in a mode (delta form if sampled)."""
    A = np.tensordot(mode.vertices, np.stack(given.A), 1)
    innovation = mode.theta[:, None] * np.hstack([given.C, -mode.S])
    innovation[~mode.S.any(axis=1)] = 0.0
    widths = given.gamma.shape[0]
    free = np.vstack(
        [np.hstack([A, np.zeros((len(A), widths))]), np.zeros((widths, len(A) + widths))]
    )
    return np.asarray(free + np.vstack([-given.L, given.gamma @ mode.S.T]) @ innovation)


def passages(
    given: Dynamics, modes: list[Mode], moved: Callable[[Floats], Floats] = lambda F: F
) -> Floats:
    """The maps of [x~; d~] over the modes' times, exactly (whole samples if sampled), in coordinates where F is moved(F)."""
    F = np.stack([moved(generator(given, mode)) for mode in modes])
    seconds = np.array([mode.seconds for mode in modes])
    if given.Ts is None:
        return exponential(F * seconds[:, None, None])
    return power(np.eye(F.shape[-1]) + given.Ts * F, np.round(seconds / given.Ts).astype(int))


def _library(given: Dynamics, rng: np.random.Generator, count: int) -> list[Mode]:
    """Modes of every side pattern at every vertex, then random ones with mixed vertices and shares, from short to long."""
    p, vertices = given.C.shape[0], len(given.A)
    fast = max(
        float(np.abs(np.linalg.eigvals(A - given.L @ given.C)).max()) for A in given.A
    ) + float(np.abs(given.gamma).max())
    slow = max(min(abs(growth(A, given.Ts)) for A in given.A), 1e-3 * fast)
    times = 10 ** rng.uniform(np.log10(1e-2 / fast), np.log10(3 / slow), count)
    if given.Ts is not None:
        times = given.Ts * np.clip(np.round(times / given.Ts), 1, 1000)
    corners = list(itertools.product((1, 0, -1), repeat=p))
    found = []
    for k in range(count):
        sides = corners[k % len(corners)] if k < count // 2 else corners[rng.integers(len(corners))]
        at = (
            np.eye(vertices)[(k // len(corners)) % vertices]
            if k < count // 2
            else rng.dirichlet(np.full(vertices, 0.5))
        )
        theta = np.ones(p) if k < count // 2 else np.where(rng.random(p) < 0.5, 1.0, rng.random(p))
        found.append(Mode(at, pattern(sides), theta, float(times[k])))
    return found


def _square_root(V: Storage) -> tuple[np.ndarray, Floats, Floats]:
    """(which of [x~; d~] V sees, T with V = |T [x~; d~]|^2 on these, its inverse); a width that V does not see is known.

    Raises InputError where P is not positive definite.
    """
    n, seen = len(V.P), np.diag(V.R) > 0
    if not np.linalg.eigvalsh(V.P)[0] > 0:
        raise InputError("V: its P is not positive definite, there is nothing to break")
    T = np.zeros((n + seen.sum(), n + seen.sum()))
    T[:n, :n], T[n:, n:] = np.linalg.cholesky(V.P).T, np.linalg.cholesky(V.R[np.ix_(seen, seen)]).T
    return np.concatenate([np.ones(n, bool), seen]), T, np.linalg.inv(T)
