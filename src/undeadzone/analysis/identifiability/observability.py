"""What readings along one run tell of x(0) and the widths of a nonlinear plant: its linearisation along the run, in square-root form.

docs/identifiability.md says why. The unknowns are [x(0); d; beta; theta]: d = [right, left] per output, beta a constant input
bias, theta uncertain parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.analysis.identifiability.linear import DIRECTIONS, PRESENT, Invisible
from undeadzone.engine.interpret import mapped
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, Integers

ROUNDING = 1e-12  # singular value, of columns of length 1, of a state that no reading feels
TOLERANCE = 1e-9, 1e-4  # share of information that counts as none, with exact steps and with others
BLOCK = 64  # steps whose readings are compressed at once, unless
GROWTH = 5.0  # they may grow more than e^5-fold
CAP = 1e6  # times what readings weigh within blocks: nothing need be known better, and growth must not overflow
WORK = 5e7  # products and sums spent on exact derivatives; more, and samples are thinned


class LinearisedRun(NamedTuple):
    """A run linearised: steps (K x s x s) and outputs (K x p x s) of [x; beta; theta] at the samples `kept` (K).

    tolerance: share of a direction's information, all else known, that the steps' errors may feign.
    """

    steps: Floats
    outputs: Floats
    kept: Integers
    tolerance: float


class Observability(NamedTuple):
    """What a run tells of the constants c = [d; beta; theta] (2p + b + t), x(0) unknown.

    root (N x N): root' root is the information matrix of [x(0); c]; hidden: the changes of c that no reading shows, if x(0) changes by
    `follow` (n x c) times that of c; singular: shares of the information that c would have with x(0) known, direction by
    direction, square roots; covariance: the least that an unbiased estimator of c has (Cramer-Rao), on the complement of `hidden`.
    """

    root: Floats
    hidden: Invisible
    follow: Floats
    singular: Floats
    tolerance: float
    covariance: Floats

    @property
    def gap(self) -> tuple[float, float]:
        """The largest share that counts as none, and the smallest that does not: the further apart, the surer."""
        null = self.singular <= self.tolerance
        return float(self.singular[null].max(initial=0.0)), float(
            self.singular[~null].min(initial=np.inf)
        )

    def std(self, i: int) -> dict[str, float]:
        """Deviations of right, left, width, centre of output i; infinite where no reading tells."""
        pair = self.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        return {
            name: float(np.sqrt(np.array(g) @ pair @ np.array(g)))
            if self.hidden.width(i, name)
            else np.inf
            for name, g in DIRECTIONS.items()
        }


def observability(
    model: System,
    x: Floats,
    u: Floats,
    side: Floats,
    step: float,
    variance: Floats,
    bias: Floats | None = None,
    uncertain: Sequence[str] = (),
    prior: Floats | None = None,
) -> Observability:
    """The observability Gramian over the noise (variance (p), of z) along states x (N x n), inputs u (N x m), sides (N x p), as a root.

    bias: directions (m x b) of unknown constant inputs; uncertain: names of unknown parameters; prior (n): standard deviation of
    x(0) as far as it is known beforehand, infinite where it is not.
    """
    n, p = model.n, model.p
    course = linearised(
        model, x, u, step, np.zeros((model.m, 0)) if bias is None else bias, uncertain
    )
    root = _root(course, side, variance, n)
    if prior is not None:
        start = (
            np.eye(n, root.shape[1])[np.isfinite(prior)]
            / np.asarray(prior)[np.isfinite(prior), None]
        )
        root = np.asarray(np.linalg.qr(np.vstack([root, start]), mode="r"))
    size = np.linalg.norm(root, axis=0)
    size[n : n + 2 * p] = np.repeat(size[n : n + 2 * p].reshape(p, 2).max(axis=1), 2)
    scale = 1 / np.where(size > 0, size, 1.0)
    states, constants = np.split(root * scale, [n], axis=1)
    U, s, V = np.linalg.svd(states, full_matrices=False)
    felt = s > ROUNDING
    U, explained = U[:, felt], U[:, felt].T @ constants
    _, singular, W = np.linalg.svd(constants - U @ explained)
    known = singular > course.tolerance
    spread = scale[n:, None] * W[known].T / singular[known]
    follow = -scale[:n, None] * (V[felt].T / s[felt]) @ explained / scale[n:]
    return Observability(
        root,
        Invisible(W[~known].T, scale[n:], 0, max(PRESENT, 10 * course.tolerance)),
        follow,
        singular,
        course.tolerance,
        spread @ spread.T,
    )


def linearised(
    model: System, x: Floats, u: Floats, step: float, bias: Floats, uncertain: Sequence[str] = ()
) -> LinearisedRun:
    """The plant's linearisation along a run.

    A sampled plant's is exact at every sample, unless that costs too much. In continuous time, and for large sampled plants, steps
    span 2 samples, or as many as the work allows, by a fourth-order Magnus expansion (Iserles, Norsett 1999); over a step
    of a sampled plant with the mean of its inputs.
    """
    rates = _derivatives(model, model.move if model.rate is None else model.rate, bias, uncertain)
    work = rates.n_instructions() * len(x)
    if model.Ts is not None and (model.rate is None or 8 * work <= WORK):
        steps, outputs = _along(
            _derivatives(model, model.move, bias, uncertain), model, x, u, uncertain
        )
        return _course(steps, outputs, np.arange(len(x)), TOLERANCE[0])
    stride = 2 * max(1, int(np.ceil(1.5 * work / WORK)))
    first = np.arange(0, len(x), stride)
    last = np.minimum(first + stride, len(x) - 1)
    places = first, (first + last) // 2, last
    inputs = [u[at] for at in places]
    if model.Ts is not None:
        inputs = [np.add.reduceat(u, first) / np.diff(first, append=len(x))[:, None]] * 3
    (A0, outputs), (A1, _), (A2, _) = (
        _along(rates, model, x[at], w, uncertain) for at, w in zip(places, inputs, strict=True)
    )
    A0, A1, A2 = (np.pad(A, [(0, 0), (0, A.shape[2] - A.shape[1]), (0, 0)]) for A in (A0, A1, A2))
    h = step * (last - first)[:, None, None]
    steps = _expm(h / 6 * (A0 + 4 * A1 + A2) - h**2 / 12 * (A0 @ A2 - A2 @ A0))
    return _course(steps[:, : model.n], outputs, first, TOLERANCE[1])


def _derivatives(model: System, move: Any, bias: Floats, uncertain: Sequence[str]) -> ca.Function:
    """([x; u], theta) -> the derivatives of move and of the output by [x; beta; theta], one column after the other."""
    x, u, theta = (
        ca.SX.sym(name, size)
        for name, size in (("x", model.n), ("u", model.m), ("theta", len(uncertain)))
    )
    params = model.params
    if model.nonlinear:
        params = ca.SX(params)
        for k, name in enumerate(uncertain):
            params[model.names.index(name)] = theta[k]
    moved, output = move(params, x, u), ca.SX(model.output(params, x))
    by = ca.vertcat(x, theta)
    A, C = ca.jacobian(moved, by), ca.jacobian(output, by)
    n, b = model.n, bias.shape[1]
    A = ca.horzcat(A[:, :n], ca.jacobian(moved, u) @ bias, A[:, n:])
    C = ca.horzcat(C[:, :n], ca.SX(model.p, b), C[:, n:])
    return ca.Function(
        "derivatives",
        [ca.vertcat(x, u), theta],
        [ca.densify(ca.vec(ca.vertcat(A, C)))],
        {"cse": True},
    )


def _along(
    function: ca.Function, model: System, x: Floats, u: Floats, uncertain: Sequence[str]
) -> tuple[Floats, Floats]:
    """The derivatives of move and of the output at each x and u (rows), from `_derivatives`."""
    theta = np.array([model.params[model.names.index(name)] for name in uncertain])
    values = mapped(function, len(x))(np.hstack([x, u]), theta)
    found = values.reshape(len(x), -1, model.n + model.p).transpose(0, 2, 1)
    return found[:, : model.n], found[:, model.n :]


def _course(steps: Floats, outputs: Floats, kept: Integers, tolerance: float) -> LinearisedRun:
    """The course, up to where a derivative is not finite; the constants stay as they are."""
    good = np.isfinite(steps).all(axis=(1, 2)) & np.isfinite(outputs).all(axis=(1, 2))
    end, n, s = good.size if good.all() else int(good.argmin()), *steps.shape[1:]
    constants = np.broadcast_to(np.eye(s)[n:], (end, s - n, s))
    return LinearisedRun(
        np.concatenate([steps[:end], constants], axis=1), outputs[:end], kept[:end], tolerance
    )


def _root(course: LinearisedRun, side: Floats, variance: Floats, n: int) -> Floats:
    """R (N x N), R'R the information on [x(0); d; beta; theta]: backward from block to block, no product of readings formed.

    Where the plant's growth tells a direction CAP times better than all readings do within their blocks, it is left at that, which
    hides nothing and changes what the others tell by 1 / CAP^2.
    """
    K, p, s = course.outputs.shape
    N, moving = s + 2 * p, np.r_[:n, n + 2 * p : s + 2 * p]
    if not K:
        return np.zeros((N, N))
    side = (
        side[: course.kept[-1] + max(1, course.kept[-1] - course.kept[-2]) // 2 + 1]
        if K > 1
        else side[:1]
    )
    nearest = np.minimum(
        np.searchsorted((course.kept[1:] + course.kept[:-1]) / 2, np.arange(len(side)), "right"),
        K - 1,
    )
    weight = np.stack(
        [
            np.add.reduceat(side == value, np.unique(nearest, return_index=True)[1], axis=0)
            for value in (1.0, -1.0)
        ],
        axis=2,
    )
    weight = np.sqrt(weight / variance[:, None])
    growth = float(np.log(np.linalg.norm(course.steps, axis=(1, 2)).max() / np.sqrt(s)))
    length = int(np.clip(GROWTH / max(growth, 1e-9), 1, BLOCK))
    blocks = -(-K // length)
    pad = [(0, blocks * length - K), (0, 0), (0, 0)]
    C, weight = (
        np.pad(part, pad).reshape(blocks, length, *part.shape[1:])
        for part in (course.outputs, weight)
    )
    F = np.concatenate([course.steps, np.broadcast_to(np.eye(s), (pad[0][1], s, s))]).reshape(
        blocks, length, s, s
    )
    rows, S = np.zeros((blocks, length, p, 2, N)), np.broadcast_to(np.eye(s), (blocks, s, s))
    for k in range(length):
        rows[:, k, :, :, moving] = np.moveaxis((C[:, k] @ S)[:, :, None], 3, 0)
        S = F[:, k] @ S
    for i in range(p):
        rows[:, :, i, 0, n + 2 * i], rows[:, :, i, 1, n + 2 * i + 1] = -1.0, 1.0
    own = np.linalg.qr((rows * weight[..., None]).reshape(blocks, -1, N), mode="r")
    size = np.linalg.norm(own, axis=(0, 1))
    size = np.where(size > 0, np.maximum(size, 1e-9 * size.max()), 1.0)
    root, T = np.zeros((0, N)), np.eye(N)
    for block in range(blocks)[::-1]:
        T[np.ix_(moving, moving)] = S[block]
        _, singular, V = np.linalg.svd(
            np.vstack([root @ (T * size[:, None] / size), own[block] / size]), full_matrices=False
        )
        root = np.minimum(singular, CAP)[:, None] * V
    return np.pad(root * size, [(0, N - len(root)), (0, 0)])


def _expm(X: Floats) -> Floats:
    """e^X of each of many matrices."""
    norm = float(np.abs(X).sum(axis=1).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(norm / 0.5)))) if norm else 0
    X, one = X / 2.0**halvings, np.eye(X.shape[-1])
    found = one + X / 13
    for order in range(12, 0, -1):
        found = one + X @ found / order
    for _ in range(halvings):
        found = found @ found
    return found


def symmetric(model: System, change: Floats) -> bool:
    """Whether the motion is the same from everywhere along a constant change of the state (n)."""
    still = np.eye(model.n) if model.Ts is not None and model.rate is None else 0.0
    function = _derivatives(
        model, model.move if model.rate is None else model.rate, np.zeros((model.m, 0)), ()
    )
    x, u = np.split(np.random.default_rng(0).normal(size=(8, model.n + model.m)), [model.n], axis=1)
    A = _along(function, model, x, u, ())[0] - still
    return bool((np.abs(A @ change) <= 1e-9 * np.abs(A).max() * np.abs(change).max()).all())
