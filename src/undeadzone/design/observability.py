"""What readings along one run tell of x(0) and the widths of a nonlinear plant: its linearisation along the run, in square-root form.

docs/identifiability.md says why. The unknowns are [x(0); d; beta; theta]: d = [right, left] per output, beta a constant input
bias, theta uncertain parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.arrays import Floats, Integers
from undeadzone.design.identifiability import DIRECTIONS, Invisible
from undeadzone.engine.interpret import mapped
from undeadzone.plant import System

TOLERANCE = 1e-9  # singular value, of columns of length 1, below which a direction is invisible
BLOCK = 32  # steps whose readings are compressed at once, unless
GROWTH = 16.0  # they may grow more than e^16-fold
CAP = 1e3  # times what all readings weigh: nothing need be known better, and growth must not overflow
WORK = 1e8  # products and sums spent on exact derivatives; more, and samples are thinned


class Course(NamedTuple):
    """A run linearised: steps (K x s x s) and outputs (K x p x s) of [x; beta; theta] at the samples `kept` (K)."""

    steps: Floats
    outputs: Floats
    kept: Integers


class Observability(NamedTuple):
    """What a run tells. root (N x N): root' root is the information matrix of [x(0); d; beta; theta].

    hidden: what no reading shows; singular: values of root with columns of length 1, those below 1e-9 of which count as 0;
    covariance (N x N): least that an unbiased estimator has (Cramer-Rao), on the complement of `hidden`.
    """

    root: Floats
    hidden: Invisible
    singular: Floats
    covariance: Floats

    @property
    def gap(self) -> tuple[float, float]:
        """The largest singular value that counts as 0, and the smallest that does not: the further apart, the surer."""
        null = self.singular <= TOLERANCE
        return float(self.singular[null].max(initial=0.0)), float(self.singular[~null].min(initial=np.inf))

    def std(self, i: int) -> dict[str, float]:
        """Deviations of right, left, width, centre of output i; infinite where no reading tells."""
        first = self.hidden.n + 2 * i
        pair = self.covariance[first : first + 2, first : first + 2]
        return {name: float(np.sqrt(np.array(g) @ pair @ np.array(g))) if self.hidden.width(i, name) else np.inf for name, g in DIRECTIONS.items()}


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
    """The observability Gramian over the noise, along states x (N x n), inputs u (N x m) and sides (N x p), as its root."""
    course = linearised(model, x, u, step, np.zeros((model.m, 0)) if bias is None else bias, uncertain)
    root = _root(course, side, variance, model.n)
    if prior is not None:
        start = np.eye(model.n, root.shape[1])[np.isfinite(prior)] / np.asarray(prior)[np.isfinite(prior), None]
        root = np.asarray(np.linalg.qr(np.vstack([root, start]), mode="r"))
    n, p = model.n, model.p
    size = np.linalg.norm(root, axis=0)
    size[n : n + 2 * p] = np.repeat(size[n : n + 2 * p].reshape(p, 2).max(axis=1), 2)
    scale = 1 / np.where(size > 0, size, 1.0)
    _, singular, V = np.linalg.svd(root * scale)
    seen = singular > TOLERANCE
    spread = scale[:, None] * V[seen].T / singular[seen]
    return Observability(root, Invisible(V[~seen].T, scale, n), singular, spread @ spread.T)


def linearised(model: System, x: Floats, u: Floats, step: float, bias: Floats, uncertain: Sequence[str] = ()) -> Course:
    """The plant's linearisation along a run.

    A sampled plant's is exact at every sample, unless that costs too much. In continuous time, and for large sampled
    plants, steps span an even number of samples (2, or what the work allows) by a fourth-order Magnus expansion
    with the input's mean over the step.
    """
    rates = _derivatives(model, model.move if model.rate is None else model.rate, bias, uncertain)
    work = rates.n_instructions() * len(x)
    if model.Ts is not None and (model.rate is None or 8 * work <= WORK):
        steps, outputs = _along(_derivatives(model, model.move, bias, uncertain), model, np.hstack([x, u]), uncertain)
        return _course(steps, outputs, np.arange(len(x)), np.eye(steps.shape[2]))
    stride = 2 * max(1, int(np.ceil(1.5 * work / WORK)))
    kept = np.arange(0, len(x), stride)
    first, last = kept, np.minimum(kept + stride, len(x) - 1)
    middle = (first + last) // 2
    total = np.vstack([np.zeros(u.shape[1]), np.cumsum(u, axis=0)])
    mean = (total[np.maximum(last, first + 1)] - total[first]) / np.maximum(last - first, 1)[:, None]
    (A0, outputs), (A1, _), (A2, _) = (_along(rates, model, np.hstack([x[at], mean]), uncertain) for at in (first, middle, last))
    h = step * (last - first)[:, None, None]
    A0, A1, A2 = (np.pad(A, [(0, 0), (0, A.shape[2] - A.shape[1]), (0, 0)]) for A in (A0, A1, A2))
    steps = _expm(h / 6 * (A0 + 4 * A1 + A2) - h**2 / 12 * (A0 @ A2 - A2 @ A0))
    return _course(steps[:, : model.n], outputs, kept, np.eye(steps.shape[2]))


def _derivatives(model: System, move: Any, bias: Floats, uncertain: Sequence[str]) -> ca.Function:
    """([x; u], theta) -> the derivatives of move and of the output by [x; beta; theta], one column after the other."""
    x, u, theta = (ca.SX.sym(name, size) for name, size in (("x", model.n), ("u", model.m), ("theta", len(uncertain))))
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
    return ca.Function("derivatives", [ca.vertcat(x, u), theta], [ca.densify(ca.vec(ca.vertcat(A, C)))], {"cse": True})


def _along(function: ca.Function, model: System, rows: Floats, uncertain: Sequence[str]) -> tuple[Floats, Floats]:
    """The derivatives of move and of the output at rows [x; u], from `_derivatives`."""
    theta = np.array([model.params[model.names.index(name)] for name in uncertain])
    values = mapped(function, len(rows))(rows, theta)
    found = values.reshape(len(rows), -1, model.n + model.p).transpose(0, 2, 1)
    return found[:, : model.n], found[:, model.n :]


def _course(steps: Floats, outputs: Floats, kept: Integers, one: Floats) -> Course:
    """The course, up to where a derivative is not finite; constants stay, as in the rows of `one`."""
    good = np.isfinite(steps).all(axis=(1, 2)) & np.isfinite(outputs).all(axis=(1, 2))
    end = good.size if good.all() else int(good.argmin())
    constants = np.broadcast_to(one[steps.shape[1] :], (end, len(one) - steps.shape[1], len(one)))
    return Course(np.concatenate([steps[:end], constants], axis=1), outputs[:end], kept[:end])


def _root(course: Course, side: Floats, variance: Floats, n: int) -> Floats:
    """R (N x N), R'R the information on [x(0); d; beta; theta]: backward from block to block, no product of readings formed.

    Row by row it is scaled down where the plant's growth makes it huge: that hides nothing, and loses only what is known CAP
    times better than from all readings at once.
    """
    K, p, s = course.outputs.shape
    N, moving = s + 2 * p, np.r_[:n, n + 2 * p : s + 2 * p]
    if not K:
        return np.zeros((N, N))
    side = side[: course.kept[-1] + max(1, course.kept[-1] - course.kept[-2]) // 2 + 1] if K > 1 else side[:1]
    nearest = np.minimum(np.searchsorted((course.kept[1:] + course.kept[:-1]) / 2, np.arange(len(side)), "right"), K - 1)
    weight = np.stack([np.add.reduceat(side == value, np.unique(nearest, return_index=True)[1], axis=0) for value in (1.0, -1.0)], axis=2)
    weight = np.sqrt(weight / variance[:, None])
    growth = float(np.log(np.linalg.norm(course.steps, axis=(1, 2)).max() / np.sqrt(s)))
    length = int(np.clip(GROWTH / max(growth, 1e-9), 1, BLOCK))
    blocks = -(-K // length)
    pad = [(0, blocks * length - K), (0, 0), (0, 0)]
    C, weight = (np.pad(part, pad).reshape(blocks, length, *part.shape[1:]) for part in (course.outputs, weight))
    F = np.concatenate([course.steps, np.broadcast_to(np.eye(s), (pad[0][1], s, s))]).reshape(blocks, length, s, s)
    rows, S = np.zeros((blocks, length, p, 2, N)), np.broadcast_to(np.eye(s), (blocks, s, s))
    for k in range(length):
        rows[:, k, :, :, moving] = np.moveaxis((C[:, k] @ S)[:, :, None], 3, 0)
        S = F[:, k] @ S
    for i in range(p):
        rows[:, :, i, 0, n + 2 * i], rows[:, :, i, 1, n + 2 * i + 1] = -1.0, 1.0
    own = np.linalg.qr((rows * weight[..., None]).reshape(blocks, -1, N), mode="r")
    limit = CAP * float(np.linalg.norm(own))
    root, T = np.zeros((0, N)), np.eye(N)
    for block in range(blocks)[::-1]:
        T[np.ix_(moving, moving)] = S[block]
        root = np.asarray(np.linalg.qr(np.vstack([root @ T, own[block]]), mode="r"))
        root /= np.maximum(1.0, np.linalg.norm(root, axis=1) / limit)[:, None]
    return np.pad(root, [(0, N - len(root)), (0, 0)])


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
    function = _derivatives(model, model.move if model.rate is None else model.rate, np.zeros((model.m, 0)), ())
    A = _along(function, model, np.random.default_rng(0).normal(size=(8, model.n + model.m)), ())[0] - still
    return bool((np.abs(A @ change) <= 1e-9 * np.abs(A).max() * np.abs(change).max()).all())
