"""The certificate of a nonlinear model on a box of states and inputs: one V for all Jacobians there; proofs in docs/certificate.md.

By the mean value theorem the error obeys x~' = A(t) x~ - L e, A(t) in the convex hull of df/dx over the box, as long as x,
x^ and u stay in it. V is sought at some of these Jacobians, the vertices, and then proved for all: interval arithmetic
bounds df/dx on parts of the box, which are halved until the bound suffices or a Jacobian is found that V misses.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone import tree
from undeadzone.arrays import Floats
from undeadzone.design.errordynamics import Dynamics, adaptation
from undeadzone.design.passivity import Certificate, certify_dynamics
from undeadzone.design.semidefinite import minimise, symmetric
from undeadzone.engine.interval import Interval, enclosure
from undeadzone.errors import InputError, StructureError
from undeadzone.plant import System
from undeadzone.region import Box

PARTS = 200_000  # of the box that are looked at before a proof is given up
AT_ONCE = 2048  # of these in one evaluation
ROUNDS = 12  # searches for V, each with Jacobians that the last V missed
WORST = 8  # of those that are added in a round
CORNERS = 16  # of the box that the first search takes
CURE = "; the width can be identified, the centre not: add a spring, gravity, an absolute reference pulse or a known start"


def certify_on(model: System, L: Floats, gamma: Floats, box: Box, parts: int = PARTS) -> Certificate:
    """Whether gains L (n x p), gamma (p), both [1/s], are certified while x, x^ and u stay in a box; of a sampled model too.

    Its dynamics hold the vertices, and its margin is that at them. A 'no' names the point of the box where there is no V, or says
    that the proof was given up after so many parts. Raises InputError for a model that is not smooth on the box.
    """
    return _certified(model, L, gamma, box, _slopes(model, box), parts)


def design_on(model: System, gamma: Floats, box: Box) -> Certificate:
    """Certified gains for a box: L = P^-1 C' with A'P + PA <= -2 w I for every Jacobian A, w the largest of their sizes.

    For a linear model `passivity.passive_gain`. Raises InputError for a sampled model, StructureError where no V exists.
    """
    if model.Ts is not None:
        raise InputError("design_on: takes a model in continuous time; `certify_on` then judges its gains in sampled time")
    found = _slopes(model, box)
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
        raise StructureError("no gains were found on the region: the Jacobians are too far apart for the solver")
    return _certified(model, np.linalg.solve(symmetric(solution, n), model.linear.C.T), gamma, box, found, PARTS)


class Slopes(NamedTuple):
    """A = df/dx (delta form if sampled) at points (N x (n + m)), and its bounds on boxes of them: N x n x n."""

    at: Callable[[Floats], Floats]
    bounds: Callable[[Box], Interval]


def _slopes(model: System, box: Box) -> Slopes:
    """The Jacobian of a model. Raises InputError where the model is not smooth on a box, or its output bends."""
    n = model.n
    p, params = tree.symbols(model.params, "p")
    w = ca.SX.sym("w", n + model.m)
    moved, z = model.move(params, w[:n], w[n:]), model.output(params, w[:n])
    if any(ca.which_depends(z, w, 2, True)):
        raise InputError("region: a certificate needs outputs that are affine in the state")
    A = ca.jacobian(moved, w)[:, :n]
    A = A if model.Ts is None else (A - np.eye(n)) / model.Ts
    function = ca.Function("slopes", [p, w], [ca.densify(A)], {"cse": True})
    numbers = tree.pack(model.params)
    bound, value = enclosure(function), enclosure(ca.Function("moved", [p, w], [ca.densify(moved)], {"cse": True}))
    fixed = Interval(numbers[:, None], numbers[:, None])

    def at(points: Floats) -> Floats:
        columns = np.broadcast_to(numbers[:, None], (numbers.size, len(points)))
        return function(columns, points.T).full().reshape(n, len(points), n).transpose(1, 0, 2)

    def bounds(part: Box) -> Interval:
        (found,) = bound([fixed, Interval(part.low.T, part.high.T)])
        return Interval(*(side.reshape(n, n, -1).transpose(2, 1, 0) for side in found))

    whole = Interval(box.low[:, None], box.high[:, None])
    try:
        bound([fixed, whole])
        value([fixed, whole])
    except InputError as error:
        raise InputError(f"region: the model cannot be certified on it: {error}") from None
    return Slopes(at, bounds)


def _certified(model: System, L: Floats, gamma: Floats, box: Box, slopes: Slopes, parts: int) -> Certificate:
    points = _start(box)
    for _ in range(ROUNDS):
        points = points[_different(slopes.at(points))]
        given = Dynamics(tuple(slopes.at(points)), model.linear.C, L, adaptation(gamma, model.p), model.Ts)
        found = certify_dynamics(given)
        if not found.certified:
            return found._replace(reason=_why(found, points, model.n))
        missed = _missed(found, slopes, box, parts)
        if not missed.size:
            return found
        points = np.vstack([points, missed])
        if np.isnan(points).any():
            break
    return found._replace(certified=False, reason=f"not proved: one V serves the Jacobians at {len(given.A)} points, but not surely on all of the region")


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
    return np.sort(np.unique(np.round(A / scale, 12).reshape(len(A), -1), axis=0, return_index=True)[1])


def _why(found: Certificate, points: Floats, n: int) -> str:
    """The reason, with the point of the box that has it if one alone does: the centre before the worst."""
    own = [certify_dynamics(found.dynamics._replace(A=(A,))) for A in found.dynamics.A]
    failing = [k for k, one in enumerate(own) if not one.certified]
    if not failing:
        return found.reason.replace("the vertices share", "the Jacobians on the region share")
    k = 0 if failing[0] == 0 else min(failing, key=lambda k: own[k].margin)
    singular = np.linalg.svd(found.dynamics.A[k], compute_uv=False)
    return f"at {_point(points[k], n)} {own[k].reason}{CURE * bool(singular[-1] < 1e-9 * singular[0])}"


def _point(point: Floats, n: int) -> str:
    x, u = (", ".join(f"{value:.4g}" for value in part + 0.0) for part in (point[:n], point[n:]))
    return f"x = [{x}], u = [{u}]"


class _Form(NamedTuple):
    """-M of the certificate at A = mean + sum c_k E_k: identity - sum c_k slope_k, in coordinates that make it so.

    entries: of A that vary; size: |slope_k|, no less than +-slope_k; rounding: of all that.
    """

    mean: Floats
    entries: tuple[Floats, ...]
    identity: Floats
    slope: Floats
    size: Floats
    rounding: float

    def least(self, A: Floats, spread: Floats | float = 0.0) -> Floats:
        """The least eigenvalue of -M for every A (N x n x n) within +-spread of these, less the rounding; -inf where they have no bound."""
        rows, columns = self.entries
        c = A[:, rows, columns] - self.mean[rows, columns]
        r = np.broadcast_to(spread, A.shape)[:, rows, columns]
        bounded = (np.isfinite(c) & np.isfinite(r)).all(axis=1)
        M = self.identity - np.tensordot(c[bounded], self.slope, 1) - np.tensordot(r[bounded], self.size, 1)
        found = np.full(len(A), -np.inf)
        found[bounded] = np.linalg.eigvalsh(M)[:, 0] - self.rounding
        return found


def _form(found: Certificate, bounds: Interval) -> _Form:
    """The certificate's M as a function of A, whose entries lie within bounds (n x n)."""
    given, P, W = found.dynamics, found.P, found.W
    mean = np.mean(given.A, axis=0)
    n, sampled = len(P), 0.0 if given.Ts is None else np.sqrt(given.Ts)
    largest = np.maximum(np.abs(bounds.low), np.abs(bounds.high))
    inequality = given.inequality(W)._replace(A=(mean,))
    (M,), (size,) = inequality.matrices(P), inequality._replace(A=(np.where(np.isfinite(largest), largest, np.abs(mean)),)).magnitudes(P)
    T = np.linalg.inv(np.linalg.cholesky(-M)).T
    rows, columns = np.nonzero(bounds.low < bounds.high)
    slope = np.zeros((rows.size, *M.shape))
    for X, i, j in zip(slope, rows, columns, strict=True):
        X[j, :n] += P[i]
        X[:n, j] += P[i]
        if sampled:
            X[j, -n:] += sampled * P[i]
            X[-n:, j] += sampled * P[i]
    slope = T.T @ slope @ T
    values, vectors = np.linalg.eigh((slope + slope.transpose(0, 2, 1)) / 2)
    absolute = (vectors * np.abs(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    rounding = 8 * (len(M) + 4) * np.finfo(float).eps * (np.linalg.norm(np.abs(T.T) @ size @ np.abs(T)) + len(M))
    return _Form(mean, (rows, columns), -T.T @ M @ T, slope, absolute, float(rounding))


def _missed(found: Certificate, slopes: Slopes, box: Box, parts: int) -> Floats:
    """Points (K x (n + m)) of a box whose Jacobians the certificate's V misses or nearly does; none if it is proved, NaN if that is open."""
    whole = slopes.bounds(Box(box.low[None], box.high[None]))
    form = _form(found, Interval(whole.low[0], whole.high[0]))
    enough = float(form.least(np.array(found.dynamics.A)).min()) / 2
    weight = _weight(form, slopes, box)
    low, high = box.low[None], box.high[None]
    while low.size and parts > 0:
        (rest_low, low), (rest_high, high) = ((side[:-AT_ONCE], side[-AT_ONCE:]) for side in (low, high))
        parts -= len(low)
        A = slopes.bounds(Box(low, high))
        with np.errstate(invalid="ignore"):
            middle = (A.low + A.high) / 2
            spread = np.nextafter(np.maximum(A.high - middle, middle - A.low), np.inf)
        open_ = ~(form.least(middle, spread) > 0)
        low, high = low[open_], high[open_]
        centre = (low + high) / 2
        depth = form.least(slopes.at(centre)) if centre.size else np.zeros(0)
        if (short := depth < enough).any():
            return centre[short][np.argsort(depth[short])[:WORST]]
        k, split = np.arange(len(low)), np.argmax(weight * (high - low), axis=1)
        below, above = high.copy(), low.copy()
        below[k, split] = above[k, split] = centre[k, split]
        low, high = np.vstack([rest_low, low, above]), np.vstack([rest_high, below, high])
    return np.full((int(low.size > 0), box.low.size), np.nan)


def _weight(form: _Form, slopes: Slopes, box: Box) -> Floats:
    """How much -M changes with each coordinate of a box, per unit of it."""
    rng, size, rows = np.random.default_rng(0), box.low.size, 24
    width = box.high - box.low
    points = np.repeat(box.low + width * rng.uniform(size=(rows, 1, size)), 3 * size, axis=1)
    for d in range(size):
        points[:, 3 * d : 3 * d + 3, d] = [box.low[d], box.low[d] + width[d] / 2, box.high[d]]
    A = slopes.at(points.reshape(-1, size))[:, *form.entries].reshape(rows, size, 3, -1)
    return np.ptp(A, axis=2).max(axis=0) @ np.linalg.norm(form.slope, axis=(1, 2)) / width + 1e-300
