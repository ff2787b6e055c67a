"""The play ahead of a dead zone in a filter: what its gaps take off z (docs/play.md).

A reading on side s of the zone that moves to the side m is y / m = z - chi_s d - chi_m c. The gaps
c_r, c_l are known, or stand among the unknowns and walk as the widths do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Reading
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.parts.further_constants import with_constants
from undeadzone.observers.parts.gaussian_filter import Augmentation
from undeadzone.sensor import Zone, offset
from undeadzone.support.arrays import Floats


class Gaps(NamedTuple):
    """Numbers of a filter about the gaps.

    Attributes:
        middle: the gaps, or the middles of their ranges: all c_r, then all c_l (2p) [z].
        ranges: these (2p x 2) [z]; empty where the gaps are known.
        std: standard deviations of the gaps at first (2p) [z]; empty where they are known.
        drift: variance that they gain each step, as the widths do (2p) [z^2]; empty likewise.
    """

    middle: Floats
    ranges: Floats
    std: Floats
    drift: Floats


def numbers_of(sensor: Zone, drift: Floats) -> Gaps | None:
    """The numbers of a filter about the play ahead of the zone; None: there is none.

    Args:
        sensor: as the filter takes it.
        drift: variance that the widths of the zone gain each step (2p) [z^2].
    """
    if sensor.play is None:
        return None
    middle = np.concatenate([sensor.play.right, sensor.play.left])
    ranges = sensor.play.ranges
    if ranges is None:
        return Gaps(middle, np.empty((0, 2)), np.empty(0), np.empty(0))
    return Gaps(middle, ranges, np.diff(ranges, axis=1).ravel() / np.sqrt(12), drift)


def with_gaps(inner: Augmentation, gaps: Gaps | None) -> Augmentation:
    """The motion with the gaps' errors as its last unknowns, if they are not known."""
    if gaps is None or not gaps.std.size:
        return inner

    def noise(q: Any, x: Any, u: Any) -> tuple[Any, Any]:
        of_x, of_extra = inner.noise(q, x, u)
        return of_x, ca.diagcat(of_extra, ca.diag(q.gaps.drift))

    return with_constants(inner, gaps.std**2)._replace(noise=noise)


def place(q: Any, size: int) -> slice:
    """Where the gaps' errors stand among the unknowns: ahead of an actuator's widths.

    Args:
        q: the filter's numbers.
        size: how many unknowns there are, with the state.
    """
    end = size if q.zones is None else size - q.zones.middle.shape[0]
    return slice(end - q.gaps.std.shape[0], end)


def gaps_at(q: Any, X: Any) -> Any:
    """The gaps, all c_r, then all c_l (2p) [z], at [x; d; extra]."""
    if not q.gaps.std.shape[0]:
        return q.gaps.middle
    return q.gaps.middle + X[place(q, X.shape[0])]


def taken_by_play(q: Any, i: int, contact: Any, X: Any) -> Any:
    """What the play ahead of the zone of output i takes off z in a contact; 0 without one."""
    if q.gaps is None:
        return 0.0
    gaps = gaps_at(q, X)
    return offset(contact, gaps[i], gaps[gaps.shape[0] // 2 + i])


def with_play(q: Any, estimated: Estimate, shown: Gaussian, reading: Reading) -> Estimate:
    """The estimate with the gaps of the play ahead of the zone, if there is one.

    Its inverse adds the gap of a reading that moves.
    """
    if q.gaps is None:
        return estimated
    gaps, p = gaps_at(q, shown.mean), estimated.z.shape[0]
    unknown = q.gaps.std.shape[0]
    if unknown:
        gaps = ca.fmax(ca.fmin(gaps, q.gaps.ranges[:, 1]), q.gaps.ranges[:, 0])
        estimated = estimated._replace(**_deviations(q, shown, p))
    contact = ca.if_else(reading.side != 0, reading.motion, 0.0)
    inverse = estimated.z_inverse + offset(contact, gaps[:p], gaps[p:])
    return estimated._replace(z_inverse=inverse, gap_right=gaps[:p], gap_left=gaps[p:])


def _deviations(q: Any, shown: Gaussian, p: int) -> dict[str, Any]:
    """Standard deviations of the gaps and of their sums, as fields of an estimate."""
    part = place(q, shown.mean.shape[0])
    cov = shown.cov[part, part]
    variances, between = ca.diag(cov), ca.diag(cov[:p, p:])
    of_width = variances[:p] + variances[p:] + 2 * between
    std = ca.sqrt(ca.fmax(variances, 0.0))
    return {
        "gap_right_std": std[:p],
        "gap_left_std": std[p:],
        "gap_std": ca.sqrt(ca.fmax(of_width, 0.0)),
    }
