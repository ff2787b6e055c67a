"""Recovery of a filter from a wrong estimate: covariance inflation and reset to the prior.

The mathematics is in docs/filter_extensions.md, "Outliers".
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
RECENT = 0.1  # least `RejectionRate.opened` that counts
LIMIT = 1e100  # of all numbers of a belief: beyond it, it is lost


class RejectionRate(NamedTuple):
    """Running record of rejected measurements.

    Attributes:
        share: mean share of refused readings of late (p).
        opened: 1 if the covariance was inflated just now, fading after that (1).
    """

    share: Any
    opened: Any


def start_rejection_rate(p: int) -> RejectionRate:
    """Return the record before the first reading (p: number of outputs)."""
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
    missed: Any,
) -> tuple[Any, RejectionRate]:
    """Inflate the covariance (see `to_upper_entries`) if most recent measurements were rejected.

    Return the covariance with the new record.

    It then gains the prior's variances of state, disturbance and bias, and those of widths and
    errors of the model too if it was inflated not long ago. A state gains at least the square of
    what would explain the refused reading, so that a jump of any size is believed at once.

    Args:
        q: the filter's numbers.
        model: the model.
        constants: how many of the last unknowns are errors of the model.
        entries: entries of the covariance that are kept.
        cov: the covariance (see `to_upper_entries`).
        patience: record of rejected readings.
        used: whether readings were used (p).
        trust: probability that a reading was not wrong (p).
        missed: by how much the prediction misses the readings (p) [z].
    """
    refused = trust < 0.5
    forget = q.doubt.forget
    mean = forget * patience.share + (1 - forget) * refused
    share = ca.if_else(ca.logic_or(used, refused), mean, patience.share)
    opens = ca.mmax(share) > TOO_MANY
    moving = dynamic_variance_mask(model, constants, entries)
    again = ca.logic_and(opens, patience.opened > RECENT)
    jump = ca.mmax(ca.if_else(refused, ca.fabs(missed), 0.0))
    unit = ca.vertcat(q.doubt.units, np.zeros(entries.size1() - model.n))
    least = (jump * unit[entries.row()]) ** 2
    still = variance_mask(entries) & ~moving
    for gain, gained, of in ((opens, moving, ca.fmax(q.cov, least)), (again, still, q.cov)):
        cov = cov + ca.if_else(gain, ca.DM(1.0 * gained) * of, 0.0)
    return cov, RejectionRate(
        share=ca.if_else(opens, 0.0, share),
        opened=ca.if_else(opens, 1.0, q.doubt.keep * patience.opened),
    )


def variance_mask(entries: ca.Sparsity) -> Flags:
    """Return flags of the stored covariance entries: true for variances."""
    rows, columns = entries.get_triplet()
    return np.array(rows) == np.array(columns)


def dynamic_variance_mask(model: System, constants: int, entries: ca.Sparsity) -> Flags:
    """Return flags of the stored variances of states, disturbances and biases."""
    n = model.n
    known = model.n + 2 * model.p
    rows = np.array(entries.get_triplet()[0])
    last = entries.size1() - constants
    return variance_mask(entries) & ((rows < n) | ((rows >= known) & (rows < last)))


def reset_if_invalid(q: Params, entries: ca.Sparsity, belief: Gaussian) -> tuple[Any, Any, Any]:
    """Return the estimate if finite with non-negative variances, or the prior if not.

    Args:
        q: the filter's numbers.
        entries: entries of the covariance that are kept.
        belief: about `[x; d; extra]`.

    Returns:
        (mean, covariance (see `to_upper_entries`), 1 if it is the prior).
    """
    cov = to_upper_entries(belief.cov, entries)
    every = ca.densify(ca.diag(belief.cov))
    # Covariances are not larger than variances. One that is not a number shows in their sum.
    size = ca.sum1(ca.fabs(ca.vertcat(belief.mean, every))) + ca.fabs(ca.sum1(cov))
    fine = ca.logic_and(size < LIMIT, ca.mmin(every >= 0.0))
    mean = ca.if_else(fine, belief.mean, q.mean)
    return mean, ca.if_else(fine, cov, q.cov), ca.logic_not(fine)
