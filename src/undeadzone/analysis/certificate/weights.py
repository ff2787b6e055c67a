"""The weights of the outputs under which error dynamics have the largest margin.

For one A the margin of a W is a least eigenvalue over frequencies, found without a solver. Every
worst frequency and direction bounds it for all W, by a ratio of linear functions of W: cutting
planes, in which no P occurs, however far apart the plant's time constants are. For several A one P
must do, so that W and P are searched together.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate import positive_real
from undeadzone.analysis.dissipation import LEAST, Inequality, optimise
from undeadzone.analysis.error_dynamics import Dynamics
from undeadzone.numerics.semidefinite import minimise
from undeadzone.support.arrays import Floats

SEARCHES: Final = 20  # steps of Dinkelbach's iteration, at most
CUTS: Final = 200  # rounds of cutting planes, at most
ENOUGH: Final = 1e-6  # of the margin: how much better another W may be


class Weights(NamedTuple):
    """Weights W (p), their margin and the frequency [rad/s] where it is attained."""

    W: Floats
    margin: float
    frequency: float | None


class _Cuts(NamedTuple):
    """The margin of weights q of the groups is at most over @ q / under @ q, in every row."""

    over: Floats
    under: Floats

    def at(self, q: Floats) -> float:
        """The least of these bounds for q."""
        return float((self.over @ q / (self.under @ q)).min())

    def joined(self, others: _Cuts) -> _Cuts:
        """Both."""
        return _Cuts(*(np.vstack(rows) for rows in zip(self, others, strict=True)))


def margin(errors: Dynamics, W: Floats) -> tuple[float, float]:
    """(margin for this W, frequency [rad/s] where it is attained); exact, without a solver.

    Args:
        errors: error dynamics with one stable A.
        W: weights of the outputs (p).
    """
    found, _ = _worst(errors, W)
    return found.margin, found.frequency or 0.0


def best_weights(errors: Dynamics) -> Weights:
    """The weights that maximise the margin, with mean 1 over their groups."""
    if len(errors.A) > 1:
        return _shared(errors)
    equal = np.ones(errors.groups.shape[1])
    best, cuts = _worst(errors, errors.groups @ equal)
    if equal.size == 1:
        return best
    for _ in range(CUTS):
        q = _promising(cuts, best.margin)
        if q is None:
            break
        trial, more = _worst(errors, errors.groups @ q)
        cuts = cuts.joined(more)
        best = max(best, trial, key=lambda one: one.margin)
    return best


def _worst(errors: Dynamics, W: Floats) -> tuple[Weights, _Cuts]:
    """The margin of W, and what it says of other weights."""
    (A,), C, L, _, Ts = errors
    root = np.sqrt(W)
    found, over, under = [], [], []
    for step in errors.steps:
        D = np.eye(root.size) - step / 2
        G = positive_real.response(A, C * root[:, None], L / root, D, Ts)
        worst = positive_real.worst(G)
        found.append(Weights(W, worst.value, G.frequency(worst.w)))
        v = worst.direction / root
        plain = positive_real.response(A, C, L, D, Ts).values(np.array([worst.w]))[0]
        terms = np.real(v.conj() * (plain @ v)) @ errors.groups, np.abs(v) ** 2 @ errors.groups
        size = max(float(np.abs(terms).max()), LEAST)
        over.append(terms[0] / size)
        under.append(terms[1] / size)
    return min(found, key=lambda one: one.margin), _Cuts(np.array(over), np.array(under))


def _promising(cuts: _Cuts, best: float) -> Floats | None:
    """The weights of the groups that the cuts bound least; None if `best` is as good."""
    groups, found, level = cuts.over.shape[1], None, best + ENOUGH * max(1.0, abs(best))
    for _ in range(SEARCHES):
        q = _deep(cuts, level, groups)
        if q is None or not cuts.at(q) > level:
            break
        found, level = q, cuts.at(q)
    return found


def _deep(cuts: _Cuts, level: float, groups: int) -> Floats | None:
    """q >= 0 of mean 1 that maximises the least of (over - level under) @ q."""
    rows = cuts.over - level * cuts.under

    def blocks(x: Floats) -> list[Floats]:
        q = np.append(x[:-1], groups - x[:-1].sum())
        return [rows @ q - x[-1], q - LEAST]

    # Affine in x, as `minimise` wants it: the last weight follows from the others.
    solution = minimise(-np.eye(groups)[-1], blocks)
    if solution is None:
        return None
    return np.maximum(np.append(solution[:-1], groups - solution[:-1].sum()), LEAST)


def _shared(errors: Dynamics) -> Weights:
    """The weights for several A, of one P.

    The largest m with M + 2m diag(0, W) <= 0 for some P is quasi-convex in W: Dinkelbach's
    iteration, one LMI a step.
    """
    best = Weights(np.ones(errors.C.shape[0]), -np.inf, None)
    shift = 0.0
    for _ in range(SEARCHES):
        deepest = _deepest(errors, shift)
        if deepest is None:
            break
        P, W = deepest
        trial = Weights(W, _reached(errors, P, W), None)
        gain = trial.margin - best.margin
        if gain > 0:
            best = trial
        if not gain >= ENOUGH * max(1.0, abs(best.margin)):
            break
        shift = best.margin
    return best


def _deepest(errors: Dynamics, shift: float) -> tuple[Floats, Floats] | None:
    """(P, W) of largest t such that M + 2 diag(0, shift W + t I) <= 0; None if there is none."""
    groups, none = errors.groups, np.zeros((errors.L.shape[0], 0))

    def weights(q: Floats) -> Floats:
        return groups @ np.append(q[:-1], groups.shape[1] - q[:-1].sum())

    def family(q: Floats) -> Inequality:
        W = weights(q)
        return errors.extended(W, none, [(1, 1, np.diag(2 * (shift * W + q[-1])))])

    def positive(P: Floats, q: Floats) -> list[Floats]:
        return [weights(q) - LEAST]

    start = np.append(np.ones(groups.shape[1] - 1), 0.0)
    solution = optimise(family, -np.eye(start.size)[-1], start, positive, passes=1)
    if solution is None:
        return None
    return solution.P, np.maximum(weights(solution.q), LEAST)


def _reached(errors: Dynamics, P: Floats, W: Floats) -> float:
    """The largest m with M + 2m diag(0, W) <= 0 for every M at this P; -inf if there is none."""
    n, p = errors.L.shape
    least = np.inf
    for M in errors.inequality(W).matrices(P):
        e = np.arange(n, n + p)  # the rows of the innovation
        rest = np.delete(np.arange(len(M)), e)
        if not np.linalg.eigvalsh(M[np.ix_(rest, rest)])[-1] < 0:
            return -np.inf
        cross = M[np.ix_(rest, e)]
        corner = M[np.ix_(e, e)] - cross.T @ np.linalg.solve(M[np.ix_(rest, rest)], cross)
        least = min(least, float(np.linalg.eigvalsh(-corner / np.sqrt(np.outer(W, W)) / 2)[0]))
    return least
