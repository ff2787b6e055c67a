"""The certificate of a nonlinear model on a box of states and inputs: one V for all Jacobians there; proofs in docs/certificate.md.

By the mean value theorem the error obeys x~' = A(t) x~ - L e, A(t) in the convex hull of df/dx over the box, as long as x,
x^ and u stay in it. V is sought at some of these Jacobians, the vertices, and then proved for all: interval arithmetic
bounds df/dx on parts of the box, which are halved until the bound suffices or a Jacobian is found that V misses.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.jacobian_bounds import Slopes, slopes_on
from undeadzone.analysis.certificate.passivity import Certificate, certify_dynamics
from undeadzone.analysis.error_dynamics import Dynamics, adaptation
from undeadzone.engine.interval import Interval
from undeadzone.errors import InputError, StructureError
from undeadzone.numerics.semidefinite import minimise, symmetric
from undeadzone.plants.region import Box
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, Integers

PARTS = 200_000  # of the box that are looked at before a proof is given up
AT_ONCE = 2048  # of these in one evaluation
ROUNDS = 12  # searches for V, each with Jacobians that the last V missed
WORST = 8  # of those that are added in a round
CORNERS = 16  # of the box that the first search takes
CURE = "; the Jacobian there is singular: width identifiable, centre not: add a spring, gravity, an absolute reference pulse, or a known start"


def certify_on(
    model: System, L: Floats, gamma: Floats, box: Box, parts: int = PARTS
) -> Certificate:
    """Whether gains L (n x p), gamma (p), both [1/s], are certified while x, x^ and u stay in a box; of a sampled model too.

    Its dynamics hold the vertices, and its margin is that at them. A 'no' names the point of the box where there is no V, or says
    that the proof was given up after so many parts. Raises InputError for a model that is not smooth on the box.
    """
    return _certified(model, L, gamma, box, slopes_on(model, box), parts)


def design_on(model: System, gamma: Floats, box: Box) -> Certificate:
    """Certified gains for a box: L = P^-1 C' with A'P + PA <= -2 w I for every Jacobian A, w the largest of their sizes.

    For a linear model `passivity.passive_gain`. Raises InputError for a sampled model, StructureError where no V exists.
    """
    if model.Ts is not None:
        raise InputError(
            "design_on: takes a model in continuous time; `certify_on` then judges its gains in sampled time"
        )
    found = slopes_on(model, box)
    none = _certified(model, np.zeros((model.n, model.p)), gamma, box, found, PARTS)
    if not none.certified:
        raise StructureError(f"no gains can be certified on the region: {none.reason}")
    vertices, n = none.dynamics.A, model.n
    q = 2 * max(float(np.linalg.norm(A, 2)) for A in vertices)

    def blocks(x: Floats) -> list[Floats]:
        P = symmetric(x, n)
        return [P, *(-A.T @ P - P @ A - q * np.eye(n) for A in vertices)]

    trace = np.eye(n)[np.triu_indices(n)]
    solution = minimise(trace, blocks)
    if solution is None:
        raise StructureError(
            "no gains were found on the region: the Jacobians are too far apart for the solver"
        )
    return _certified(
        model, np.linalg.solve(symmetric(solution, n), model.linear.C.T), gamma, box, found, PARTS
    )


def _certified(
    model: System, L: Floats, gamma: Floats, box: Box, slopes: Slopes, parts: int
) -> Certificate:
    points = _start(box)
    for _ in range(ROUNDS):
        points = points[_different(slopes.at(points))]
        given = Dynamics(
            tuple(slopes.at(points)), model.linear.C, L, adaptation(gamma, model.p), model.Ts
        )
        found = certify_dynamics(given)
        if not found.certified:
            return found._replace(reason=_why(found, points, model.n))
        missed = _missed(found, slopes, box, parts)
        if not missed.size:
            return found
        points = np.vstack([points, missed])
        if np.isnan(points).any():
            break
    return found._replace(
        certified=False,
        reason=f"not proved: one V serves the Jacobians at {len(given.A)} points, but not surely on all of the region",
    )


def _start(box: Box) -> Floats:
    """The centre of a box, then corners of it, drawn if there are many."""
    size = box.low.size
    if 2**size <= CORNERS:
        corners = np.array(list(itertools.product((0.0, 1.0), repeat=size)))
    else:
        corners = np.random.default_rng(0).integers(2, size=(CORNERS, size)).astype(float)
    return np.vstack([(box.low + box.high) / 2, box.low + corners * (box.high - box.low)])


def _different(A: Floats) -> Floats:
    """The first of each set of equal matrices, as their numbers."""
    scale = max(float(np.abs(A).max()), 1e-300)
    return np.sort(
        np.unique(np.round(A / scale, 12).reshape(len(A), -1), axis=0, return_index=True)[1]
    )


def _why(found: Certificate, points: Floats, n: int) -> str:
    """The reason, with the point of the box that has it if one alone does: the centre before the worst."""
    own = [certify_dynamics(found.dynamics._replace(A=(A,))) for A in found.dynamics.A]
    failing = [k for k, one in enumerate(own) if not one.certified]
    if not failing:
        margin = f" (largest margin found {found.margin:.4g})" if np.isfinite(found.margin) else ""
        return f"each Jacobian on the region has a V, but they share none{margin}: more damping or a smaller region would help"
    k = 0 if failing[0] == 0 else min(failing, key=lambda k: own[k].margin)
    singular = np.linalg.svd(found.dynamics.A[k], compute_uv=False)
    return (
        f"at {_point(points[k], n)} {own[k].reason}{CURE * bool(singular[-1] < 1e-9 * singular[0])}"
    )


def _point(point: Floats, n: int) -> str:
    x, u = (", ".join(f"{value:.4g}" for value in part + 0.0) for part in (point[:n], point[n:]))
    return f"x = [{x}], u = [{u}]"


class _Form(NamedTuple):
    """-M of the certificate as a function of the entries c of A that vary: identity - sum (c - mean)_k slope_k, in coordinates that make it so.

    size: |slope_k|, no less than +-slope_k; rounding: of the identity, and of each slope per unit of c.
    """

    mean: Floats
    identity: Floats
    slope: Floats
    size: Floats
    rounding: tuple[float, Floats]

    def depth(self, c: Floats, loose: Floats | float = 0.0, turns: Floats | float = 0.0) -> Floats:
        """The least eigenvalue of -M, less rounding, for every c (N x K) within +-loose and turns (N x (n + m) x K) of these; -inf if unbounded."""
        c = c - self.mean
        total = (
            np.abs(c) + loose + np.abs(turns).sum(axis=1) if np.ndim(turns) else np.abs(c) + loose
        )
        bounded = np.isfinite(total).all(axis=1)
        M = self.identity - np.tensordot(c[bounded], self.slope, 1)
        if np.ndim(turns):
            M = (
                M
                - np.tensordot(np.asarray(loose)[bounded], self.size, 1)
                - _absolute(np.tensordot(np.asarray(turns)[bounded], self.slope, 1)).sum(axis=1)
            )
        found = np.full(len(c), -np.inf)
        found[bounded] = (
            np.linalg.eigvalsh(M)[:, 0] - self.rounding[0] - total[bounded] @ self.rounding[1]
        )
        return found


def _absolute(M: Floats) -> Floats:
    """(M^2)^(1/2) of symmetric matrices, no less than +-M."""
    values, vectors = np.linalg.eigh((M + M.swapaxes(-1, -2)) / 2)
    return (vectors * np.abs(values)[..., None, :]) @ vectors.swapaxes(-1, -2)


def _form(found: Certificate, entries: tuple[Integers, Integers]) -> _Form:
    """The certificate's M as a function of these entries of A."""
    given, P = found.dynamics, found.P
    mean = np.mean(given.A, axis=0)
    inequality = given.inequality(found.W)._replace(A=(mean,))
    (M,), (size,) = inequality.matrices(P), inequality.magnitudes(P)
    T = np.linalg.inv(np.linalg.cholesky(-M)).T
    n, X = len(P), np.zeros((entries[0].size, *M.shape))
    for slope, i, j in zip(X, *entries, strict=True):
        for start, share in ((0, 1.0), (len(M) - n, np.sqrt(given.Ts or 0.0))):
            slope[j, start : start + n] += share * P[i]
            slope[start : start + n, j] += share * P[i]
    slope = T.T @ X @ T
    unit = 8 * (len(M) + len(X) + 4) * np.finfo(float).eps
    around = [np.linalg.norm(np.abs(T.T) @ np.abs(part) @ np.abs(T)) for part in (size, *X)]
    return _Form(
        mean[entries],
        -T.T @ M @ T,
        slope,
        _absolute(slope),
        (unit * (around[0] + len(M)), unit * np.array(around[1:])),
    )


def _missed(found: Certificate, slopes: Slopes, box: Box, parts: int) -> Floats:
    """Points (K x (n + m)) of a box whose Jacobians the certificate's V misses or nearly does; none if it is proved, NaN if that is open."""
    bounds, bends = slopes.bounds()
    if not slopes.entries[0].size:
        return np.zeros((0, box.low.size))
    form = _form(found, slopes.entries)
    enough = float(form.depth(np.array(found.dynamics.A)[:, *slopes.entries]).min()) / 2
    low, high = box.low[None], box.high[None]
    while low.size and parts > 0:
        (later_low, low), (later_high, high) = (
            (side[:-AT_ONCE], side[-AT_ONCE:]) for side in (low, high)
        )
        parts -= len(low)
        centre = (low + high) / 2
        reach = np.nextafter(np.maximum(high - centre, centre - low), np.inf)[:, :, None]
        c, loose = (part[:, 0] for part in _middle(bounds(Box(centre, centre))))
        turns, doubt = (part * reach for part in _middle(bends(Box(low, high))))
        open_ = ~(form.depth(c, loose + doubt.sum(axis=1), turns) > 0)
        low, high, centre = low[open_], high[open_], centre[open_]
        depth = form.depth(c[open_])
        if (short := depth < enough).any():
            return centre[short][np.argsort(depth[short])[:WORST]]
        weight = np.linalg.norm(form.slope, axis=(1, 2))
        effect = (np.abs(turns) + doubt)[open_] @ weight
        share = np.where(
            np.isfinite(effect).all(axis=1, keepdims=True),
            effect,
            (high - low) / (box.high - box.low),
        )
        k, split = np.arange(len(low)), np.argmax(share, axis=1)
        below, above = high.copy(), low.copy()
        below[k, split] = above[k, split] = centre[k, split]
        low, high = np.vstack([later_low, low, above]), np.vstack([later_high, below, high])
    return np.full((int(low.size > 0), box.low.size), np.nan)


def _middle(bound: Interval) -> tuple[Floats, Floats]:
    """(middle, half width) of bounds; not finite where there are none."""
    with np.errstate(invalid="ignore"):
        middle = (bound.low + bound.high) / 2
        return middle, np.nextafter(np.maximum(bound.high - middle, middle - bound.low), np.inf)
