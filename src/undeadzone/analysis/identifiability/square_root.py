"""The information that a run's readings hold, as a square root: no product of readings is formed.

The unknowns are [x(0); d; beta; theta]: d = [right, left] per output, beta a constant input bias,
theta uncertain parameters.
"""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.identifiability.linearised_run import LinearisedRun
from undeadzone.support.arrays import Floats, Integers

BLOCK = 64  # steps whose readings are compressed at once, unless
GROWTH = 5.0  # they may grow more than e^5-fold
CAP = 1e6  # times what readings weigh in blocks: nothing need be known better, nor may it overflow


def root(run: LinearisedRun, side: Floats, variance: Floats, n: int) -> Floats:
    """R (N x N), R'R the information on [x(0); d; beta; theta]: backward from block to block.

    Where the plant's growth tells a direction CAP times better than all readings do within their
    blocks, it is left at that, which hides nothing and changes what the others tell by 1 / CAP^2.

    Args:
        run: the plant, linearised along the run (K kept samples).
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
    weight = _in_blocks(reading_weights(run.kept, side, variance), length)
    rows, transitions = _block_rows(run, n, length)
    weighted = rows * weight[..., None]
    own = np.asarray(np.linalg.qr(weighted.reshape(len(rows), -1, N), mode="r"))
    return _backward(own, transitions, _moving(n, p, s))


def reading_weights(kept: Integers, side: Floats, variance: Floats) -> Floats:
    """Weights (K x p x 2) of the readings on the [right, left] side nearest to each kept sample.

    A weight is the root of (how many there are / variance).

    Args:
        kept: the samples (K).
        side: +1, 0, -1 at every sample (rows x p).
        variance: of a reading's noise (p).
    """
    K = len(kept)
    if K > 1:
        side = side[: kept[-1] + max(1, kept[-1] - kept[-2]) // 2 + 1]
    else:
        side = side[:1]
    halfway = (kept[1:] + kept[:-1]) / 2
    nearest = np.minimum(np.searchsorted(halfway, np.arange(len(side)), "right"), K - 1)
    first = np.unique(nearest, return_index=True)[1]
    counts = [np.add.reduceat(side == value, first, axis=0) for value in (1.0, -1.0)]
    return np.asarray(np.sqrt(np.stack(counts, axis=2) / variance[:, None]))


def _in_blocks(values: Floats, length: int) -> Floats:
    """Values (K x ...) in blocks of that length, the last one filled up with 0."""
    blocks = -(-len(values) // length)
    missing = [(0, blocks * length - len(values)), (0, 0), (0, 0)]
    return np.pad(values, missing).reshape(blocks, length, *values.shape[1:])


def _block_rows(run: LinearisedRun, n: int, length: int) -> tuple[Floats, Floats]:
    """(rows of the readings by the unknowns at their block's start, transition over each block).

    The rows (blocks x length x p x 2 x N) come for the right and the left side.
    """
    K, p, s = run.outputs.shape
    N = s + 2 * p
    C = _in_blocks(run.outputs, length)
    blocks = len(C)
    still = np.broadcast_to(np.eye(s), (blocks * length - K, s, s))
    F = np.concatenate([run.steps, still]).reshape(blocks, length, s, s)
    rows = np.zeros((blocks, length, p, 2, N))
    S = np.broadcast_to(np.eye(s), (blocks, s, s))  # transition from the block's start
    for k in range(length):
        rows[:, k, :, :, _moving(n, p, s)] = np.moveaxis((C[:, k] @ S)[:, :, None], 3, 0)
        S = F[:, k] @ S
    for i in range(p):
        rows[:, :, i, 0, n + 2 * i] = -1.0
        rows[:, :, i, 1, n + 2 * i + 1] = 1.0
    return rows, S


def _moving(n: int, p: int, s: int) -> Integers:
    """Where [x; beta; theta] (s) stands among the unknowns: all but the widths."""
    return np.r_[:n, n + 2 * p : s + 2 * p]


def _backward(own: Floats, transitions: Floats, moving: Integers) -> Floats:
    """The root (N x N) of all blocks' information, from the last block to the first.

    Args:
        own: root of each block's own information (blocks x rows x N).
        transitions: over each block (blocks x s x s), of the unknowns `moving`.
        moving: which unknowns these are (s of N).
    """
    N = own.shape[2]
    size = np.linalg.norm(own, axis=(0, 1))
    size = np.where(size > 0, np.maximum(size, 1e-9 * size.max()), 1.0)
    total, T = np.zeros((0, N)), np.eye(N)
    for block in range(len(own))[::-1]:
        T[np.ix_(moving, moving)] = transitions[block]
        later = total @ (T * size[:, None] / size)
        both = np.vstack([later, own[block] / size])
        _, singular, V = np.linalg.svd(both, full_matrices=False)
        total = np.minimum(singular, CAP)[:, None] * V
    return np.pad(total * size, [(0, N - len(total)), (0, 0)])
