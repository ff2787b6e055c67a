"""Nearly constant unknowns of a filter: gaps of a backlash ahead, widths of an actuator, friction.

The play ahead of a dead zone in a filter: what its gaps take off z (docs/play.md).

A reading on side s of the zone that moves to the side m is y / m = z - chi_s d - chi_m c. The gaps
c_r, c_l are known, or stand among the unknowns and walk as the widths do.

The widths of an actuator's dead zone as unknowns of a filter (docs/actuator.md).

u is known and the widths are not: what enters the plant, w, is a kinked function of them. With a
Gaussian belief about the width b of the side of u, a = |u|, s its deviation, al = (a - b^) / s,

    E w = (a - b^) Phi(al) + s phi(al),   dE w / db^ = -Phi(al)   (Stein),

and the rest, E w^2 - (E w)^2 - Phi(al)^2 s^2, is noise at the input. If the side is certain, this
is the exact Kalman filter.

Coulomb friction behind a play as an unknown of a filter: x' = A x + B (u - f s) (docs/play.md).

s is the side in which y moves, which the motion of the readings shows, so f enters like a width of
that side: the equations stay linear.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Reading
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.nonlinearities.sensor import Zone, offset
from undeadzone.numerics.clip import clip
from undeadzone.numerics.gaussian import Gaussian, normal_cdf, normal_density
from undeadzone.observers.filtering.gaussian_filter import Augmentation, branch_deviations
from undeadzone.observers.filtering.prior import Prior
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats

SAME = 20.0  # steps for which an error of the side keeps its sign, and counts that much more


def add_constants(
    inner: Augmentation, variance: Floats, wear: Callable[[Any], Any] | None = None
) -> Augmentation:
    """Return the motion with further last unknowns of mean 0 that change by noise alone.

    Its u is what enters the plant.

    Args:
        inner: the motion without them.
        variance: of each of them at first.
        wear: wear(numbers of the filter) is the covariance that a step adds (None: none).
    """
    from scipy.linalg import block_diag

    count = variance.size
    known = len(inner.cov)

    def change(q: Any, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
        """Return (x+ - x, extra+ - extra), 0 for the constants."""
        moved, changed = inner.change(q, x, extra[:known, :], u)
        return moved, ca.vertcat(changed, ca.SX(count, 1))

    def extended_covariances(q: Any, x: Any, u: Any) -> tuple[Any, Any]:
        """Return the covariances that a step adds to x and to extra."""
        of_x, of_extra = inner.noise(q, x, u)
        return of_x, ca.diagcat(of_extra, ca.SX(count, count) if wear is None else wear(q))

    bend = inner.bilinear
    if bend is not None:
        inner = inner._replace(bilinear=lambda q, x, extra, u: bend(q, x, extra[:known, :], u))
    cov = block_diag(inner.cov, np.diag(variance))
    return inner._replace(
        cov=cov, change=change, noise=extended_covariances, constants=inner.constants + count
    )


class Gaps(NamedTuple):
    """Parameters of a filter for the gaps.

    Attributes:
        middle: the gaps, or the middles of their ranges: all c_r, then all c_l (2p) [z].
        ranges: these (2p x 2) [z] (empty if the gaps are known).
        std: standard deviations of the gaps at first (2p) [z] (empty if they are known).
        drift: variance that they gain each step, as the widths do (2p) [z^2] (empty likewise).
    """

    middle: Floats
    ranges: Floats
    std: Floats
    drift: Floats


def gap_numbers(sensor: Zone, prior: Prior) -> Gaps | None:
    """Return the parameters of the backlash ahead of the zone, or None without a backlash.

    Args:
        sensor: as the filter takes it.
        prior: of the zone's widths, whose drift is the gaps' too.
    """
    if sensor.play is None:
        return None
    middle = np.concatenate([sensor.play.right, sensor.play.left])
    ranges = sensor.play.ranges
    if ranges is None:
        return Gaps(middle, np.empty((0, 2)), np.empty(0), np.empty(0))
    span = np.diff(ranges, axis=1).ravel()
    drift = prior.worn * span**2 if prior.worn else prior.drift
    return Gaps(middle, ranges, span / np.sqrt(12), drift)


def add_gap_states(inner: Augmentation, gaps: Gaps | None) -> Augmentation:
    """Return the motion with the errors of the gaps as its last unknowns, if they are unknown."""
    if gaps is None or not gaps.std.size:
        return inner
    return add_constants(inner, gaps.std**2, lambda q: ca.diag(q.gaps.drift))


def gap_slice(q: Any, size: int) -> slice:
    """Return the slice of the errors of the gaps, ahead of an actuator's widths.

    Args:
        q: the filter's numbers.
        size: how many unknowns there are, with the state.
    """
    end = size if q.zones is None else size - q.zones.middle.shape[0]
    return slice(end - q.gaps.std.shape[0], end)


def gap_values(q: Any, X: Any) -> Any:
    """Return the gaps, all c_r, then all c_l (2p) [z], at `[x; d; extra]`."""
    if not q.gaps.std.shape[0]:
        return q.gaps.middle
    return q.gaps.middle + X[gap_slice(q, X.shape[0])]


def information_shares(q: Any, model: System, cov: Any) -> Any:
    """Return the correlation of each width with the information from its readings (N) [1].

    The root of the share that they took from its prior variance (1 for all other variables).

    Args:
        q: the filter's numbers.
        model: the model.
        cov: covariance of `[x; d; extra]` (N x N).
    """
    n = model.n
    known = model.n + 2 * model.p
    first = q.doubt.std[n:known] ** 2
    learnt = ca.sqrt(ca.fmax(1 - ca.diag(cov)[n:known] / first, 0.0))
    shares = ca.vertcat(ca.SX.ones(n), learnt, ca.SX.ones(cov.shape[0] - known))
    if q.gaps is not None and q.gaps.std.shape[0]:
        gaps = gap_slice(q, cov.shape[0])
        shares[gaps] = ca.sqrt(ca.fmax(1 - ca.diag(cov)[gaps] / q.gaps.std**2, 0.0))
    return shares


def backlash_offset(q: Any, i: int, contact: Any, X: Any) -> Any:
    """Return the offset of the backlash ahead of output i in a contact [z], or 0."""
    if q.gaps is None:
        return 0.0
    gaps = gap_values(q, X)
    return offset(contact, gaps[i], gaps[gaps.shape[0] // 2 + i])


def add_gap_estimates(q: Any, estimated: Estimate, belief: Gaussian, reading: Reading) -> Estimate:
    """Add the gaps of the backlash ahead of the zone, with their deviations, to an estimate.

    Uncertain gaps are clipped to their ranges. z_inverse gains chi_m c, the gap on the side in
    contact, while the reading is active.

    Args:
        q: numbers of the filter.
        estimated: without gaps.
        belief: belief about `[x; d; extra]`.
        reading: the last one.
    """
    if q.gaps is None:
        return estimated
    gaps = gap_values(q, belief.mean)
    p = estimated.z.shape[0]
    if q.gaps.std.shape[0]:
        gaps = clip(gaps, *ca.horzsplit(q.gaps.ranges))
        part = gap_slice(q, belief.mean.shape[0])
        right, left, both = branch_deviations(belief.cov[part, part])
        estimated = estimated._replace(gap_right_std=right, gap_left_std=left, gap_std=both)
    contact = ca.if_else(reading.side != 0, reading.motion, 0.0)
    inverse = estimated.z_inverse + offset(contact, gaps[:p], gaps[p:])
    return estimated._replace(z_inverse=inverse, gap_right=gaps[:p], gap_left=gaps[p:])


class Zones(NamedTuple):
    """Parameters of a filter for the dead zones of the actuators.

    Attributes:
        middle: of the assumed ranges of b_r, then of b_l (2m) [u].
        ranges: these (2m x 2) [u].
        slope_right, slope_left: m_r, m_l (m).
    """

    middle: Floats
    ranges: Floats
    slope_right: Floats
    slope_left: Floats


def zone_numbers(belief: Belief | None) -> Zones | None:
    """Return the parameters of a filter for actuator widths, or None if no width is estimated."""
    if belief is None or belief.ranges is None:
        return None
    drive = belief.drive
    return Zones(belief.ranges.mean(axis=1), belief.ranges, drive.slope_right, drive.slope_left)


def add_actuator_states(inner: Augmentation, zones: Zones | None) -> Augmentation:
    """Return the motion with the actuator-width errors as its last unknowns.

    Right errors precede left errors.

    Its u is the plant's input. `predict_plant_input` returns it.
    """
    if zones is None:
        return inner
    spread = np.diff(zones.ranges, axis=1).ravel() / np.sqrt(12)
    return add_constants(inner, spread**2)._replace(zones=spread.size)


def predict_plant_input(
    zones: Zones | None, belief: Gaussian, u: Any
) -> tuple[Callable[[Any], Any], Any]:
    """Return the input of the plant under a command u (m), as mean and variance.

    Returns:
        (a function of `[x; d; extra]`, linear in the widths' errors, the variance that it leaves
        (m)).
    """
    if zones is None:
        return lambda X: u, None
    m = u.shape[0]
    first = belief.mean.shape[0] - 2 * m
    errors = belief.mean[first:]
    variances = ca.diag(belief.cov)[first:]
    right = u > 0
    place = [ca.if_else(right, zones.middle[:m] + errors[:m], zones.middle[m:] + errors[m:])]
    place.append(ca.if_else(right, variances[:m], variances[m:]))
    slope = ca.if_else(right, zones.slope_right, zones.slope_left)
    sign = 1.0 * right - 1.0 * (u < 0)
    std = ca.sqrt(ca.fmax(place[1], 0.0)) + 1e-12 * (1 + ca.fabs(place[0]))
    over = ca.fabs(u) - place[0]
    alpha = over / std
    share = normal_cdf(alpha)
    slim = normal_density(alpha)
    mean = over * share + std * slim
    square = (over**2 + std**2) * share + over * std * slim
    left = sign**2 * slope**2 * ca.fmax(square - mean**2 - (share * std) ** 2, 0.0)

    def input_at_mean(X: Any) -> Any:
        """Return the mean input of the plant at `[x; d; extra]` (m) [u]."""
        moved = X[first:] - errors
        own = ca.if_else(right, moved[:m], moved[m:])
        return sign * slope * (mean - share * own)

    return input_at_mean, left


def add_actuator_estimates(zones: Zones | None, estimated: Estimate, belief: Gaussian) -> Estimate:
    """Return the estimate with the widths of the actuators, if they are estimated."""
    if zones is None:
        return estimated
    count = zones.middle.shape[0]
    widths = zones.middle + belief.mean[-count:]
    inside = clip(widths, *ca.horzsplit(zones.ranges))
    std = ca.sqrt(ca.fmax(ca.diag(belief.cov)[-count:], 0.0))
    half = count // 2
    return estimated._replace(
        actuator_right=inside[:half],
        actuator_left=inside[half:],
        actuator_right_std=std[:half],
        actuator_left_std=std[half:],
    )


def add_friction_state(inner: Augmentation, sensor: Zone) -> Augmentation:
    """Return the motion with the friction error as its last unknown, if not known."""
    if not sensor.friction_std.any():
        return inner
    return add_constants(inner, sensor.friction_std**2)


def subtract_friction(
    sensor: Zone, after: int, drive: Callable[[Any], Any], side: Any
) -> Callable[[Any], Any]:
    """Return the input of the plant less the unknown friction.

    The input is a function of `[x; d; extra]`.

    Args:
        sensor: the play.
        after: how many unknowns stand after the friction's error.
        drive: what enters the plant without friction.
        side: in which y moves (1).
    """
    if not sensor.friction_std.any():
        return drive
    return lambda X: drive(X) - X[X.shape[0] - 1 - after] * side
