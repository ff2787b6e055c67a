"""What readings along one run tell of x(0) and the widths of a nonlinear plant.

The plant is linearised along the run, and the observability Gramian kept as a square root;
docs/identifiability.md says why. The unknowns are [x(0); d; beta; theta]: d = [right, left] per
output, beta a constant input bias, theta uncertain parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.identifiability.linear import PRESENT, Invisible
from undeadzone.analysis.identifiability.linearised_run import linearised
from undeadzone.analysis.identifiability.square_root import root
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats

ROUNDING = 1e-12  # singular value, of columns of length 1, of a state that no reading feels


class Observability(NamedTuple):
    """What a run tells of the constants c = [d; beta; theta] (2p + b + t), x(0) unknown.

    Attributes:
        root: root' root is the information matrix of [x(0); c] (N x N).
        hidden: the changes of c that no reading shows, if x(0) changes by `follow` times that of c.
        follow: (n x c).
        singular: shares of the information that c would have with x(0) known, direction by
            direction, square roots.
        tolerance: shares up to this count as none.
        covariance: the least that an unbiased estimator of c has (Cramer-Rao), on the complement of
            `hidden`.
    """

    root: Floats
    hidden: Invisible
    follow: Floats
    singular: Floats
    tolerance: float
    covariance: Floats

    @property
    def gap(self) -> tuple[float, float]:
        """The largest share that counts as none, and the smallest that does not.

        The further apart, the surer.
        """
        null = self.singular <= self.tolerance
        none = float(self.singular[null].max(initial=0.0))
        return none, float(self.singular[~null].min(initial=np.inf))

    def std(self, i: int) -> dict[str, float]:
        """Deviations of right, left, width, centre of output i; infinite where no reading tells."""
        own = slice(2 * i, 2 * i + 2)
        return self.hidden.deviations(i, self.covariance[own, own])


def observability(
    model: System,
    x: Floats,
    u: Floats,
    side: Floats,
    step: float,
    variance: Floats,
    bias: Floats | None = None,
    uncertain: Sequence[str] = (),
    told: Floats | None = None,
) -> Observability:
    """The observability Gramian over the noise along a run, as a root, and what it tells.

    Args:
        model: the plant (n states, m inputs, p outputs).
        x: states (N x n).
        u: inputs (N x m).
        side: +1, 0, -1 of each output (N x p).
        step: time between two samples [s].
        variance: of the noise of z (p).
        bias: directions (m x b) of unknown constant inputs.
        uncertain: names of unknown parameters.
        told: what is known of [x(0); d] beforehand (`beforehand`).
    """
    n, p = model.n, model.p
    bias = np.zeros((model.m, 0)) if bias is None else bias
    run = linearised(model, x, u, step, bias, uncertain)
    R = root(run, side, variance, n)
    if told is not None and told.size:
        R = _told(R, told)
    scale = _units(R, n, p)
    states, constants = np.split(R * scale, [n], axis=1)
    U, s, V = np.linalg.svd(states, full_matrices=False)
    felt = s > ROUNDING
    # What changes of x(0) explain of the constants' readings; the rest tells the constants.
    U, explained = U[:, felt], U[:, felt].T @ constants
    _, singular, W = np.linalg.svd(constants - U @ explained)
    known = singular > run.tolerance
    spread = scale[n:, None] * W[known].T / singular[known]
    follow = -scale[:n, None] * (V[felt].T / s[felt]) @ explained / scale[n:]
    hidden = Invisible(W[~known].T, scale[n:], 0, max(PRESENT, 10 * run.tolerance))
    return Observability(R, hidden, follow, singular, run.tolerance, spread @ spread.T)


def _told(R: Floats, told: Floats) -> Floats:
    """The root with what is known beforehand."""
    rows = np.pad(told, [(0, 0), (0, R.shape[1] - told.shape[1])])
    return np.asarray(np.linalg.qr(np.vstack([R, rows]), mode="r"))


def _units(R: Floats, n: int, p: int) -> Floats:
    """Units in which the columns of R have length 1; the widths of an output share theirs."""
    size = np.linalg.norm(R, axis=0)
    widths = slice(n, n + 2 * p)
    size[widths] = np.repeat(size[widths].reshape(p, 2).max(axis=1), 2)
    return 1 / np.where(size > 0, size, 1.0)
