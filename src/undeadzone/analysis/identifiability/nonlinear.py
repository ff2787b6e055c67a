"""Identifiability for nonlinear plants: widths that readings along a run determine, with reasons.

The plant is linearised along the run. The information that the readings hold of the unknowns
`[x(0); d; beta; theta]` is kept as a square root: no product of readings is formed. d = [right,
left] per output, beta a constant input bias, theta uncertain parameters. docs/identifiability.md
derives it.

Prior information on x(0) and on centres, as rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import (
    noiseless_reading,
    reading_levels,
    schedule_of_record,
)
from undeadzone.analysis.identifiability import linear
from undeadzone.analysis.identifiability.indistinguishable import indistinguishable_widths
from undeadzone.analysis.identifiability.information import EXACT, edge_scale
from undeadzone.analysis.identifiability.linear import (
    describe_rare_exactness,
    describe_unreached_edges,
)
from undeadzone.analysis.identifiability.linearised_run import (
    LinearisedRun,
    linearise_run,
    symmetric,
)
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats, Integers


def prior_rows(
    n: int, p: int, start_std: Floats | None, centre_std: Floats | None, least: float
) -> Floats:
    """Return rows (k x n + 2p) on `[x(0); d]` whose squares are the prior information.

    Args:
        n: number of states.
        p: number of outputs.
        start_std: standard deviations of x(0), infinite if unknown (n) (None: all unknown).
        centre_std: those of each (d_r - d_l)/2 (p), infinite if unknown (None: all unknown).
        least: deviation of a d_r - d_l that is known exactly [z].
    """
    rows = []
    eye = np.eye(n + 2 * p)
    if start_std is not None:
        known = np.flatnonzero(np.isfinite(start_std) & (start_std > 0))
        rows += [eye[i] / start_std[i] for i in known]
    if centre_std is not None:
        for i in np.flatnonzero(np.isfinite(centre_std)):
            row = (eye[n + 2 * i] - eye[n + 2 * i + 1]) / 2
            rows.append(row / max(float(centre_std[i]), least / 2))
    return np.array(rows).reshape(len(rows), n + 2 * p)


# --- Information in the readings along a run

LIMIT = 1e9  # beyond this a state has diverged
SHARE = 1e-3  # of the largest change: less is not named
CURES = "a known start, an absolute reference pulse, a spring or gravity would separate them"
ROUNDING = 1e-12  # singular value, of columns of length 1, of a state that no reading feels
BLOCK = 64  # steps whose readings are compressed at once, unless
GROWTH = 5.0  # they may grow more than e^5-fold
CAP = 1e6  # cap on information, relative to that of readings in blocks, against overflow


def width_identifiability_along(
    model: System,
    x: Floats,
    u: Floats,
    z: Floats,
    sensor: Zone,
    step: float,
    bias: Floats | None = None,
    bias_std: Floats | None = None,
    uncertain: Sequence[str] = (),
    prior: Floats | None = None,
    arrived: np.ndarray | None = None,
    centre: Floats | None = None,
) -> list[linear.WidthIdentifiability]:
    """Return the identifiability of each output's widths from readings along a run.

    A width is also unknown if the expected deviation exceeds it. Only the part of a run before it
    diverges counts.

    Args:
        model: the plant (n states, m inputs, p outputs).
        x: states (N x n).
        u: inputs (N x m).
        z: outputs (N x p).
        sensor: the dead zone.
        step: time between two rows [s].
        bias: directions (m x b) of unknown constant inputs.
        bias_std: their standard deviations, infinite if unknown (b, the default).
        uncertain: names of parameters that are unknown.
        prior: prior standard deviation of x(0), infinite if unknown (n).
        arrived: flags of the readings that are not missing (N x p) (None: all).
        centre: prior standard deviation of each (d_r - d_l)/2, infinite if unknown (p).
    """
    arrived = np.ones(z.shape, dtype=bool) if arrived is None else arrived
    bias = np.zeros((model.m, 0)) if bias is None else bias
    diverged = np.flatnonzero(~(np.abs(np.hstack([x, u])).max(axis=1) < LIMIT))
    finite = slice(max(1, int(diverged[0])) if diverged.size else None)
    x = x[finite]
    u = u[finite]
    z = z[finite]
    arrived = arrived[finite]
    schedule = schedule_of_record(z, sensor, step, model.Ts, arrived)
    if sensor.kind == "jump":
        return linear.width_identifiability(model.linear, schedule, jump=True)
    side = np.where(arrived, noiseless_reading(z, sensor).side, 0.0)
    rows = prior_rows(
        model.n, model.p, prior, centre, float(np.sqrt(reading_variance(sensor).min()))
    )
    if bias_std is not None:
        from scipy.linalg import block_diag

        rows = block_diag(rows, np.diag(1 / bias_std)[np.isfinite(bias_std)])
    known = observability_along(
        model, x, u, side, step, reading_variance(sensor), bias, uncertain, rows
    )
    visited = np.stack([(side > 0).any(axis=0), (side < 0).any(axis=0)], axis=1)
    biases = bias.shape[1]
    constants = np.zeros((model.m, known.hidden.scale.size))
    constants[:, 2 * model.p : 2 * model.p + biases] = bias
    number = np.arange(known.hidden.scale.size)  # widths, then biases, then parameters
    first = 2 * model.p + biases
    names = ", ".join(uncertain)
    causes = {
        linear.BIAS: (number >= 2 * model.p) & (number < first),
        f"with {names} uncertain the {{quantity}} cannot be separated from them": number >= first,
    }
    judged = []
    for i, (right, left) in enumerate(zip(sensor.right, sensor.left, strict=True)):
        shift = partial(_describe_state_shift, model, known, i)
        confounded = linear.confounding_reason(known.hidden, visited[i], i, causes, shift)
        reasons = (
            *describe_unreached_edges(schedule, visited, i),
            *filter(None, [confounded]),
            *describe_rare_exactness(schedule, i),
        )
        found = known.hidden, known.covariance, i, np.array([right, left])
        second = indistinguishable_widths(*found, known.follow, constants)
        flags = known.hidden.width_flags(i)
        verdict = linear.WidthIdentifiability(
            **flags,
            reasons=reasons,
            second=second,
        )
        std = known.output_deviations(i)
        swing = float(np.ptp(z[:, i]))
        judged.append(linear.limit_to_deviations(verdict, std, right, left, swing))
    return judged


def reading_variance(sensor: Zone) -> Floats:
    """Return the variance of a reading's noise (p) as noise of z, never 0."""
    return np.maximum(sensor.rms, EXACT * edge_scale(reading_levels(sensor))) ** 2


def _describe_state_shift(
    model: System, known: Observability, i: int, edge: str, quantity: str, remainder: str
) -> str:
    """Describe the shift of the state that hides an edge of output i.

    Args:
        model: the plant.
        known: information of the run on the constants.
        i: the output.
        edge: edge that is not identifiable, right or left.
        quantity: name of the quantity that is not identifiable.
        remainder: phrase on the quantities that are identifiable nevertheless.
    """
    hidden = known.hidden
    own = hidden.restrict_to_part(np.arange(hidden.scale.size) // 2 == i)
    alone = not own.is_width_known(i, edge)  # hidden even if the widths of other outputs are known
    basis = own.basis if alone else hidden.basis
    # Of all hidden changes of the constants, basis basis[row] is the one that moves this edge most.
    row = 2 * i + (edge == "left")
    change = known.follow @ (hidden.scale * (basis @ basis[row]))
    change = np.where(np.abs(change) > SHARE * np.abs(change).max(), change, 0.0)
    if not change.any():
        return f"the {quantity}, bias and parameters cannot be separated"
    names = " and ".join(_state_names(model)[j] for j in np.flatnonzero(change))
    if not alone:
        return (
            f"along this run {names} can shift together with edges of several outputs "
            "and no reading changes"
        )
    if symmetric(model, change):
        return (
            f"a change of {names} as a whole alters no motion (no gravity, no spring), "
            f"{remainder}; {CURES}"
        )
    return (
        f"along this run {names} can shift with the edges and no reading changes, {remainder}. "
        f"Another motion may separate them, else {CURES}"
    )


def _state_names(model: System) -> list[str]:
    """Return the names of the states in words."""
    joints = () if model.arm is None else model.arm.chain.joints
    if 2 * len(joints) != model.n:
        return [f"x[{j}]" for j in range(model.n)]
    positions = [f"the position of joint {name}" for name in joints]
    return positions + [f"the speed of joint {name}" for name in joints]


class Observability(NamedTuple):
    """Information of a run on the constants c = `[d; beta; theta]` (2p + b + t), x(0) unknown.

    Attributes:
        root: R, with R' R the information matrix of `[x(0); c]` (N x N).
        hidden: changes of c that no reading shows, if x(0) changes by `follow` times that of c.
        follow: change of x(0) by a unit change of each constant (n x c).
        singular: singular values of the scaled root of the information on c, x(0) unknown (c) [1].
        tolerance: singular values up to this count as 0 [1].
        covariance: Cramer-Rao bound of c, on the complement of `hidden` (c x c).
    """

    root: Floats
    hidden: linear.Unobservable
    follow: Floats
    singular: Floats
    tolerance: float
    covariance: Floats

    def output_deviations(self, i: int) -> dict[str, float]:
        """Return the deviations of right, left, width, centre of output i, or inf if not
        identifiable.
        """
        return self.hidden.std_of_widths(i, self.covariance)


def observability_along(
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
    """Return the information of a run on widths, biases and parameters, x(0) being unknown.

    Args:
        model: the plant (n states, m inputs, p outputs).
        x: states (N x n).
        u: inputs (N x m).
        side: +1, 0, -1 of each output (N x p).
        step: time between two samples [s].
        variance: variance of the noise of each output (p) [y^2].
        bias: directions (m x b) of unknown constant inputs.
        uncertain: names of unknown parameters.
        prior: rows (k x q) on the first q of `[x(0); d; beta; theta]` whose squares are the prior
            information, as from `prior_rows` (None: none).
    """
    n = model.n
    p = model.p
    bias = np.zeros((model.m, 0)) if bias is None else bias
    run = linearise_run(model, x, u, step, bias, uncertain)
    R = information_root(run, side, variance, n)
    if prior is not None and prior.size:
        R = _add_prior(R, prior)
    scale = _column_units(R, n, p)
    states, constants = np.split(R * scale, [n], axis=1)
    U, s, V = np.linalg.svd(states, full_matrices=False)
    observable = s > ROUNDING
    # A change of x(0) can explain part of the effect of the constants. Only the residual of this
    # regression determines the constants.
    U, explained = U[:, observable], U[:, observable].T @ constants
    _, singular, W = np.linalg.svd(constants - U @ explained)
    known = singular > run.tolerance
    # The Cramer-Rao bound is the inverse of the information; its root has the columns W / singular.
    bound_root = scale[n:, None] * W[known].T / singular[known]
    # Least-squares change of x(0) that hides a unit change of each constant.
    follow = -scale[:n, None] * (V[observable].T / s[observable]) @ explained / scale[n:]
    hidden = linear.Unobservable(W[~known].T, scale[n:], 0, max(linear.PRESENT, 10 * run.tolerance))
    return Observability(R, hidden, follow, singular, run.tolerance, bound_root @ bound_root.T)


def _add_prior(R: Floats, prior: Floats) -> Floats:
    """Return the root of the information (N x N) with prior rows (k x q, q <= N) included."""
    rows = np.pad(prior, [(0, 0), (0, R.shape[1] - prior.shape[1])])
    return np.asarray(np.linalg.qr(np.vstack([R, rows]), mode="r"))


def _column_units(R: Floats, n: int, p: int) -> Floats:
    """Return the units in which the columns of R have length 1.

    The widths of an output share theirs.
    """
    size = np.linalg.norm(R, axis=0)
    widths = slice(n, n + 2 * p)
    size[widths] = np.repeat(size[widths].reshape(p, 2).max(axis=1), 2)
    return 1 / np.where(size > 0, size, 1.0)


def information_root(run: LinearisedRun, side: Floats, variance: Floats, n: int) -> Floats:
    """Return R (N x N), with R'R the information on `[x(0); d; beta; theta]`, backward by blocks.

    If the plant's growth determines a direction CAP times better than all readings within their
    blocks, its information is capped there. This hides nothing and changes the information on other
    directions by 1 / CAP^2.

    Args:
        run: the plant, linearised along the run (K samples).
        side: +1, 0, -1 at every sample (rows x p).
        variance: of a reading's noise (p).
        n: how many states there are.
    """
    K, p, s = run.outputs.shape
    N = s + 2 * p
    if not K:
        return np.zeros((N, N))
    growth = float(np.log(np.linalg.norm(run.steps, axis=(1, 2)).max() / np.sqrt(s)))
    length = int(np.clip(GROWTH / max(growth, 1e-9), 1, BLOCK))
    weight = _divide_into_blocks(reading_weights(run.samples, side, variance), length)
    rows, transitions = _block_rows(run, n, length)
    weighted = rows * weight[..., None]
    own = np.asarray(np.linalg.qr(weighted.reshape(len(rows), -1, N), mode="r"))
    return _accumulate_backward(own, transitions, _moving_indices(n, p, s))


def reading_weights(samples: Integers, side: Floats, variance: Floats) -> Floats:
    """Return the weights (K x p x 2) of the [right, left] readings nearest to each
    sample of a linearised run.

    A weight is the root of (how many there are / variance).

    Args:
        samples: their numbers (K).
        side: +1, 0, -1 at every sample (rows x p).
        variance: of a reading's noise (p).
    """
    K = len(samples)
    if K > 1:
        side = side[: samples[-1] + max(1, samples[-1] - samples[-2]) // 2 + 1]
    else:
        side = side[:1]
    halfway = (samples[1:] + samples[:-1]) / 2
    nearest = np.minimum(np.searchsorted(halfway, np.arange(len(side)), "right"), K - 1)
    first = np.unique(nearest, return_index=True)[1]
    counts = [np.add.reduceat(side == value, first, axis=0) for value in (1.0, -1.0)]
    return np.asarray(np.sqrt(np.stack(counts, axis=2) / variance[:, None]))


def _divide_into_blocks(values: Floats, length: int) -> Floats:
    """Divide values (K x ...) into blocks of the given length, the last padded with 0."""
    blocks = -(-len(values) // length)
    missing = [(0, blocks * length - len(values)), (0, 0), (0, 0)]
    return np.pad(values, missing).reshape(blocks, length, *values.shape[1:])


def _block_rows(run: LinearisedRun, n: int, length: int) -> tuple[Floats, Floats]:
    """Return (rows of the readings by the unknowns at block start, transition over each
    block).

    The rows (blocks x length x p x 2 x N) come for the right and the left side.
    """
    K, p, s = run.outputs.shape
    N = s + 2 * p
    C = _divide_into_blocks(run.outputs, length)
    blocks = len(C)
    still = np.broadcast_to(np.eye(s), (blocks * length - K, s, s))
    F = np.concatenate([run.steps, still]).reshape(blocks, length, s, s)
    rows = np.zeros((blocks, length, p, 2, N))
    S = np.broadcast_to(np.eye(s), (blocks, s, s))  # transition from the block's start
    for k in range(length):
        rows[:, k, :, :, _moving_indices(n, p, s)] = np.moveaxis((C[:, k] @ S)[:, :, None], 3, 0)
        S = F[:, k] @ S
    for i in range(p):
        rows[:, :, i, 0, n + 2 * i] = -1.0
        rows[:, :, i, 1, n + 2 * i + 1] = 1.0
    return rows, S


def _moving_indices(n: int, p: int, s: int) -> Integers:
    """Return the indices of `[x; beta; theta]` (s) among the unknowns: all but the widths."""
    return np.r_[:n, n + 2 * p : s + 2 * p]


def _accumulate_backward(own: Floats, transitions: Floats, moving: Integers) -> Floats:
    """Return the root (N x N) of all blocks' information, from the last block to the first.

    Args:
        own: root of each block's own information (blocks x rows x N).
        transitions: over each block (blocks x s x s), of the unknowns `moving`.
        moving: which unknowns these are (s of N).
    """
    N = own.shape[2]
    size = np.linalg.norm(own, axis=(0, 1))
    size = np.where(size > 0, np.maximum(size, 1e-9 * size.max()), 1.0)
    total = np.zeros((0, N))
    T = np.eye(N)
    for block in range(len(own))[::-1]:
        T[np.ix_(moving, moving)] = transitions[block]
        later = total @ (T * size[:, None] / size)
        both = np.vstack([later, own[block] / size])
        _, singular, V = np.linalg.svd(both, full_matrices=False)
        total = np.minimum(singular, CAP)[:, None] * V
    return np.pad(total * size, [(0, N - len(total)), (0, 0)])
