"""What a filter does where its belief cannot be right: it opens it, or begins anew.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.numerics.gaussian import Gaussian, to_upper_entries
from undeadzone.observers.filtering.gaussian_filter import Params
from undeadzone.plants.system import System
from undeadzone.util.arrays import Flags

TOO_MANY = 0.75  # share of refused readings of late from which the belief is wrong, not they
RECENT = 0.1  # what is left of `Patience.opened` while it counts
LIMIT = 1e100  # of all numbers of a belief: beyond it, it is lost


class RejectionRate(NamedTuple):
    """What is kept of refused readings.

    Attributes:
        share: mean share of refused readings of late (p).
        opened: 1 where the belief was opened just now, fading after that (1).
    """

    share: Any
    opened: Any


def start_rejection_rate(p: int) -> RejectionRate:
    """No reading was refused so far; p: number of outputs."""
    return RejectionRate(np.zeros(p), np.zeros(1))


def inflate_covariance(
    q: Params,
    model: System,
    constants: int,
    entries: ca.Sparsity,
    cov: Any,
    patience: RejectionRate,
    used: Any,
    trust: Any,
) -> tuple[Any, RejectionRate]:
    """Return the covariance (its `triangle`), opened where most readings of late were refused.

    It then gains the prior's variances of state, disturbance and bias; of widths and errors of the
    model too where it was opened not long ago.

    Args:
        q: the filter's numbers.
        model: the model.
        constants: how many of the last unknowns are errors of the model.
        entries: entries of the covariance that are kept.
        cov: the covariance (its `triangle`).
        patience: what is kept of refused readings.
        used: whether readings were used (p).
        trust: probability that a reading was not wrong (p).
    """
    refused = trust < 0.5
    forget = q.doubt.forget
    mean = forget * patience.share + (1 - forget) * refused
    share = ca.if_else(ca.logic_or(used, refused), mean, patience.share)
    opens = ca.mmax(share) > TOO_MANY
    moving = moving_ones(model, constants, entries)
    again = ca.logic_and(opens, patience.opened > RECENT)
    for gain, gained in ((opens, moving), (again, variances(entries) & ~moving)):
        cov = cov + ca.if_else(gain, ca.DM(1.0 * gained) * q.cov, 0.0)
    return cov, RejectionRate(
        share=ca.if_else(opens, 0.0, share),
        opened=ca.if_else(opens, 1.0, q.doubt.keep * patience.opened),
    )


def variances(entries: ca.Sparsity) -> Flags:
    """Which entries that are kept are variances."""
    rows, columns = entries.get_triplet()
    return np.array(rows) == np.array(columns)


def moving_ones(model: System, constants: int, entries: ca.Sparsity) -> Flags:
    """Which entries that are kept are variances of a state, a disturbance or a bias."""
    n, known = model.n, model.n + 2 * model.p
    rows = np.array(entries.get_triplet()[0])
    last = entries.size1() - constants
    return variances(entries) & ((rows < n) | ((rows >= known) & (rows < last)))


def reset_if_invalid(q: Params, entries: ca.Sparsity, belief: Gaussian) -> tuple[Any, Any, Any]:
    """Return the belief if it is one of finite numbers and positive variances, else the prior.

    Args:
        q: the filter's numbers.
        entries: entries of the covariance that are kept.
        belief: about [x; d; extra].

    Returns:
        (mean, covariance (its `triangle`), 1 where it is the prior).
    """
    cov = to_upper_entries(belief.cov, entries)
    every = ca.densify(ca.diag(belief.cov))
    # Covariances are not larger than variances; one that is no number shows in their sum.
    size = ca.sum1(ca.fabs(ca.vertcat(belief.mean, every))) + ca.fabs(ca.sum1(cov))
    fine = ca.logic_and(size < LIMIT, ca.mmin(every >= 0.0))
    mean = ca.if_else(fine, belief.mean, q.mean)
    return mean, ca.if_else(fine, cov, q.cov), ca.logic_not(fine)
