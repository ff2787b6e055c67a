"""The widths of an actuator's dead zone as unknowns of a filter (docs/actuator.md).

u is known and the widths are not: what enters the plant, w, is a kinked function of them. With a
Gaussian belief about the width b of the side of u, a = |u|, s its deviation, al = (a - b^) / s,

    E w = (a - b^) Phi(al) + s phi(al),   dE w / db^ = -Phi(al)   (Stein),

and what is left, E w^2 - (E w)^2 - Phi(al)^2 s^2, is noise at the input. Where the side is sure
this is the exact Kalman filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.actuator import Belief
from undeadzone.interfaces import Estimate
from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.parts.further_constants import with_constants
from undeadzone.observers.parts.gaussian_filter import Augmentation
from undeadzone.support.arrays import Floats

SAME = 20.0  # steps for which an error of the side keeps its sign, and counts that much more


class Zones(NamedTuple):
    """Numbers of a filter about the dead zones of the actuators.

    Attributes:
        middle: of the claimed ranges of b_r, then of b_l (2m) [u].
        ranges: these (2m x 2) [u].
        slope_right, slope_left: m_r, m_l (m).
    """

    middle: Floats
    ranges: Floats
    slope_right: Floats
    slope_left: Floats


def zones_of(belief: Belief | None) -> Zones | None:
    """The numbers of a filter that estimates widths; None: it estimates none."""
    if belief is None or belief.ranges is None:
        return None
    drive = belief.drive
    return Zones(belief.ranges.mean(axis=1), belief.ranges, drive.slope_right, drive.slope_left)


def with_widths(inner: Augmentation, zones: Zones | None) -> Augmentation:
    """The motion with the widths' errors as its last unknowns: right ones, then left ones.

    Its u is what enters the plant; `entering` gives it.
    """
    if zones is None:
        return inner
    spread = np.diff(zones.ranges, axis=1).ravel() / np.sqrt(12)
    return with_constants(inner, spread**2)._replace(zones=spread.size)


def entering(zones: Zones | None, belief: Gaussian, u: Any) -> tuple[Callable[[Any], Any], Any]:
    """What enters the plant under a command u (m).

    Returns:
        (a function of [x; d; extra], linear in the widths' errors; the variance that it leaves
        (m)).
    """
    if zones is None:
        return lambda X: u, None
    m = u.shape[0]
    first = belief.mean.shape[0] - 2 * m
    errors, variances = belief.mean[first:], ca.diag(belief.cov)[first:]
    right = u > 0
    place = [ca.if_else(right, zones.middle[:m] + errors[:m], zones.middle[m:] + errors[m:])]
    place.append(ca.if_else(right, variances[:m], variances[m:]))
    slope = ca.if_else(right, zones.slope_right, zones.slope_left)
    sign = 1.0 * right - 1.0 * (u < 0)
    std = ca.sqrt(ca.fmax(place[1], 0.0)) + 1e-12 * (1 + ca.fabs(place[0]))
    over = ca.fabs(u) - place[0]
    alpha = over / std
    share = (1 + ca.erf(alpha / math.sqrt(2))) / 2
    density = ca.exp(-(alpha**2) / 2) / math.sqrt(2 * math.pi)
    mean = over * share + std * density
    square = (over**2 + std**2) * share + over * std * density
    left = sign**2 * slope**2 * ca.fmax(square - mean**2 - (share * std) ** 2, 0.0)

    def drive(X: Any) -> Any:
        moved = X[first:] - errors
        own = ca.if_else(right, moved[:m], moved[m:])
        return sign * slope * (mean - share * own)

    return drive, left


def with_actuator(zones: Zones | None, estimated: Estimate, shown: Gaussian) -> Estimate:
    """The estimate with the widths of the actuators, if they are estimated."""
    if zones is None:
        return estimated
    count = zones.middle.shape[0]
    widths = zones.middle + shown.mean[-count:]
    inside = ca.fmax(ca.fmin(widths, zones.ranges[:, 1]), zones.ranges[:, 0])
    std = ca.sqrt(ca.fmax(ca.diag(shown.cov)[-count:], 0.0))
    half = count // 2
    return estimated._replace(
        actuator_right=inside[:half],
        actuator_left=inside[half:],
        actuator_right_std=std[:half],
        actuator_left_std=std[half:],
    )
