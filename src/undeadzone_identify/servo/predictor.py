"""Predictor of a servo behind a play, with measurement updates, for many parameter sets at once.

A motor, its slow torque d and its current i, in physical coordinates, sampled exactly:

    z' = v,   v' = -p v - k z + g (i - f sign v + o + d + w),   i' = p_e (u(t - delay) - i)    (S1)

**Friction** takes g f dt a sample from v and lets it rest at 0 where what drives it is less. At
rest the spread of v loses as much, and no torque enters once it is 0. Friction of the load is felt
besides where the gear pushes it, and not in the gap.                                          (S2)

**Ticks.** Of an encoder, or of exact readings, each change is a tick. Its side s says the contact,
its boundary B where the level was:

    e = B + s (c + w) / 2 - z^,  w = min(|v^| dt, q),  variance P_zz + w^2 / 12 + (q / 10)^2   (S3)

Where the motor turned within the sample, B + s c / 2 is its peak, and z has fallen back since.
Between two ticks nothing is known. A tick is a stopping time, so the errors' mean is 0 whenever it
comes.

**Noise.** The output of the play is a level l with a Gaussian's moments of its own:
l+ = l + Dz(z+ - l), with the mean, the slope and the rest of the variance of a dead zone Dz of a
Gaussian.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.compile import lanes
from undeadzone.nonlinearities.play import apply_backlash
from undeadzone.numerics.gaussian import normal_cdf_and_hazard

LATEST = 8  # samples by which the input may be late at most
WIDTH = 64  # lanes of a kernel
SURE = 0.1  # standard deviation of where a tick is, in quanta
UNKNOWN = 1e4  # variance of z where a tick is to tell nothing of it but where it is
SLOWEST = 1e-9  # rate after a tick against which the prediction moved

PLANT = (
    *("a00", "a01", "a02", "a03", "a10", "a11", "a12", "a13", "a22", "a33"),
    *("b00", "b10", "b30", "b01", "b11"),
    *("q00", "q01", "q11", "q02", "q12", "q22"),
)
OTHERS = (
    *("friction", "load", "offset", "gap", "rms", "quantum"),
    *("step", "first_v", "first_d", "free"),
)
NUMBERS = (*PLANT, *OTHERS)  # then the weights of u(t), u(t - 1), ...
MEAN = 4  # z, v, d, i
COVARIANCE = 6  # numbers of the upper part of the covariance of z, v, d
SEEN = ("error", "log_s", "z", "v")  # what a kernel tells of each sample
DEGREES = 6.0  # of freedom of an error
WORST = -1e6  # log density of an error that is no number


def build_lane(numbers: Any) -> Any:
    """Return the parameters of a lane by name, and the weights of its inputs as `taps`."""
    named = dict(zip(NUMBERS, ca.vertsplit(numbers[: len(NUMBERS)]), strict=True))
    return SimpleNamespace(**named, taps=numbers[len(NUMBERS) :])


class _Motion(NamedTuple):
    """Motion of a motor in a sample.

    Attributes:
        x: the mean of z, v, d, i after it.
        rests: whether it came to rest.
        brake: loss of v at rest by friction.
    """

    x: list[Any]
    rests: Any
    brake: Any


def step_motor(lane: Any, x: list[Any], u: Any, torque: Any, contact: Any) -> _Motion:
    """Return the mean of the motor's state one sample later.

    Args:
        lane: its numbers.
        x: z, v, d, i.
        u: the input that acts.
        torque: that acts besides, in units of the input.
        contact: share of the sample in which the gear pushes the load, with the sign of its way.
    """
    z, v, d, i = x
    push = lane.a10 * z + lane.a12 * d + lane.a13 * i + lane.b10 * u + lane.b11 * torque
    rolled = lane.a00 * z + lane.a01 * v + lane.a02 * d + lane.a03 * i + lane.b00 * u
    rolled = rolled + lane.b01 * torque
    sign = ca.if_else(v == 0, ca.sign(push), ca.sign(v))
    friction = lane.friction + lane.load * ca.fmax(sign * contact, 0.0)
    turned = lane.friction + lane.load * ca.fmax(-sign * contact, 0.0)  # once it turned
    rubs = lane.friction + lane.load > 0
    ahead = lane.a11 * v + push - sign * ca.fabs(lane.b11) * friction
    passes = ca.logic_and(ahead * sign < 0, rubs)
    brake = ca.fabs(lane.b11) * ca.if_else(v == 0, friction, turned)
    stops = ca.logic_or(v == 0, passes)
    rests = ca.logic_and(rubs, ca.logic_and(stops, ca.fabs(push) <= brake))
    before = ca.fabs(v) / ca.fmax(ca.fabs(v) + ca.fabs(ahead), 1e-300)  # share until it stops
    drag = sign * ca.if_else(passes, before * friction - (1 - before) * turned, friction)
    slid_z = rolled - ca.fabs(lane.b01) * drag
    slid_v = lane.a11 * v + push - ca.fabs(lane.b11) * drag
    stopped = z + 0.5 * before * v * lane.step * ca.if_else(v == 0, 0.0, 1.0)
    new_z = ca.if_else(rests, stopped, slid_z)
    new_v = ca.if_else(rests, 0.0, slid_v)
    return _Motion([new_z, new_v, lane.a22 * d, lane.a33 * i + lane.b30 * u], rests, brake)


def contact_share(lane: Any, z: Any, v: Any, level: Any) -> Any:
    """Return the share of a sample in which the gear pushes the load, with the motion's sign.

    Args:
        lane: its numbers.
        z, v: of the motor.
        level: of the load.
    """
    apart = z - level
    half = lane.gap / 2
    swept = ca.fabs(v) * lane.step
    beyond = ca.sign(v) * apart + swept - half
    moving = ca.sign(v) * ca.fmax(ca.fmin(beyond / ca.fmax(swept, 1e-300), 1.0), 0.0)
    resting = ca.if_else(ca.fabs(apart) >= half * (1 - 1e-9), ca.sign(apart), 0.0)
    return ca.if_else(v == 0, resting, moving)


def drag_load(lane: Any, level: Any, z: Any) -> Any:
    """Return the level of the load after the motor has dragged it."""
    return apply_backlash(
        ca,
        z,
        level,
        lane.gap / 2,
        lane.gap / 2,
    )


def _propagate_covariance(lane: Any, P: Any, motion: _Motion) -> Any:
    """Return the covariance of z, v, d one sample later and the transition matrix."""
    rests = motion.rests
    deviation = ca.sqrt(ca.fmax(P[1, 1], 0.0))
    retained = ca.fmax(1 - motion.brake / ca.fmax(deviation, 1e-300), 0.0)
    retained = ca.if_else(deviation > 0, retained, 0.0)
    loose = ca.if_else(rests, ca.if_else(retained > 0, 1.0, 0.0), 1.0)
    sliding = [[lane.a00, lane.a01, lane.a02], [lane.a10, lane.a11, lane.a12], [0, 0, lane.a22]]
    resting = [[1, lane.a01 * loose, 0], [0, retained, 0], [0, 0, lane.a22]]
    F = ca.if_else(rests, ca.blockcat(resting), ca.blockcat(sliding))
    own = [getattr(lane, name) for name in PLANT[-COVARIANCE:]]
    acts = ca.diag(ca.vertcat(loose, loose, 1))
    return F @ P @ F.T + acts @ _from_upper_part(ca.vertcat(*own)) @ acts, F


def _from_upper_part(entries: Any) -> Any:
    """Build a covariance of z, v, d from its upper part."""
    return ca.triu2symm(ca.SX(ca.Sparsity.upper(3), entries))


def _upper_part(P: Any) -> Any:
    """Return the upper part of a covariance of z, v, d."""
    return ca.triu(ca.densify(P)).nz[:]


def _initial_covariance(lane: Any, variance: Any) -> Any:
    """Return the covariance of z, v, d at the start of a record."""
    return ca.diag(ca.vertcat(variance, lane.first_v, lane.first_d))


class _Before(NamedTuple):
    """Servo ahead of a reading.

    Attributes:
        lane: its parameters.
        was: the state a sample before.
        x: the mean of z, v, d, i.
        P: the covariance of z, v, d.
        F: their transition.
        signals: of the sample beside the inputs.
    """

    lane: Any
    was: Any
    x: Any
    P: Any
    F: Any
    signals: list[Any]


def student_log_density(error: Any, log_s: Any) -> Any:
    """Return Student's log density of an error on CasADi expressions, less a constant.

    Args:
        error: of a prediction.
        log_s: logarithm of its standard deviation.
    """
    squares = (error * ca.exp(-log_s)) ** 2
    found = -log_s - (DEGREES + 1) / 2 * ca.log1p(squares / DEGREES)
    return ca.if_else(ca.fabs(found) < -WORST, found, WORST)


def _build_predictor(
    update: Callable[[_Before], tuple[Any, Any]], own: int, signals: int, sums: bool
) -> lanes.Kernel:
    """Build a kernel that outputs all of `SEEN`, or the sum of the errors' log densities.

    Args:
        update: it returns the state after a reading, and `SEEN`.
        own: numbers of the state besides mean and covariance, the level of the load first.
        signals: beside the inputs; the last one is whether the error counts.
        sums: whether log densities of errors are added up, and nothing is recorded.
    """
    state = ca.SX.sym("s", MEAN + COVARIANCE + own)
    exogenous = ca.SX.sym("w", LATEST + 1 + signals)
    numbers = ca.SX.sym("p", len(NUMBERS) + LATEST + 1)
    lane = build_lane(numbers)
    mean, upper, behind = ca.vertsplit(state, [0, MEAN, MEAN + COVARIANCE, state.numel()])
    acting = ca.dot(lane.taps, exogenous[: LATEST + 1])
    contact = contact_share(lane, mean[0], mean[1], behind[0])
    motion = step_motor(
        lane,
        ca.vertsplit(mean),
        acting,
        lane.offset,
        contact,
    )
    P, F = _propagate_covariance(lane, _from_upper_part(upper), motion)
    *rest, counts = ca.vertsplit(exogenous[LATEST + 1 :])
    after, seen = update(
        _Before(
            lane,
            state,
            ca.vertcat(*motion.x),
            P,
            F,
            rest,
        )
    )
    if sums:
        total = ca.SX.sym("total")
        gained = ca.if_else(counts != 0, student_log_density(seen[0], seen[1]), 0.0)
        state, after = ca.vertcat(state, total), ca.vertcat(after, total + gained)
        seen = ca.SX(0, 1)
    step = ca.Function("servo", [state, exogenous, numbers], [after, seen])
    return lanes.build_kernel(step, params=range(numbers.numel()), width=WIDTH, fused=True)


@cache
def tick_predictor(sums: bool = False) -> lanes.Kernel:
    """Build the predictor of ticks.

    Args:
        sums: whether log densities of errors are added up in the last state, and nothing is
            recorded; else all of `SEEN` is.

    Returns:
        A kernel whose inputs are u(t), u(t - 1), ..., the side of a tick or 0, its boundary,
        whether it is a reversal, whether it is the first of a record, whether a record starts, and
        whether its error counts; whose lanes differ in `NUMBERS` and in how late the input acts.
        Errors are of ticks alone; a free one forgets z at a reversal, so that nothing is known of
        the gap.
    """
    return _build_predictor(_hear_tick, 1, 6, sums)


def _hear_tick(before: _Before) -> tuple[Any, Any]:
    """Return the state after a sample with a tick or without, and `SEEN`."""
    lane, was, moved, P = before[:4]
    side, boundary, turns, first, starts = before.signals
    x = ca.if_else(starts, 0.0, moved)
    P = ca.if_else(starts, _initial_covariance(lane, 0.0), P)
    swept = ca.fmin(ca.fabs(x[1]) * lane.step, lane.quantum)
    swept = ca.fmax(swept, SURE * lane.quantum)
    turned = ca.logic_and(was[1] * side > 0, x[1] * side < 0)
    slower = ca.fabs(x[1]) + ca.fabs(was[1])  # within the sample, past a peak
    fallen = ca.if_else(turned, 0.5 * x[1] ** 2 * lane.step / ca.fmax(slower, 1e-300), 0.0)
    R = swept**2 / 12 + lane.rms**2 + fallen**2
    at = boundary + side * ((swept + lane.gap) / 2 - fallen)
    forgets = ca.logic_or(first, ca.logic_and(turns, lane.free))
    P[0, 0] = P[0, 0] + ca.if_else(ca.logic_and(side != 0, forgets), UNKNOWN, 0.0)
    S = P[0, 0] + R
    error = at - x[0]
    seen = ca.vertcat(error, 0.5 * ca.log(S), x[0], x[1])
    gain = ca.if_else(side != 0, P[:, 0] / S, 0.0)
    updated = x[:3] + gain * error
    left = ca.if_else(side != 0, R / S, 1.0)
    along = left * P[:, 0]
    P = P - gain @ P[0, :]
    P[:, 0] = along
    P[0, :] = along.T
    against = ca.logic_and(side != 0, updated[1] * side <= 0)
    against = ca.logic_and(against, ca.logic_not(turned))
    updated[1] = ca.if_else(against, side * SLOWEST, updated[1])
    dragged = drag_load(lane, was[-1], updated[0])
    level = ca.if_else(side != 0, updated[0] - side * lane.gap / 2, dragged)
    level = ca.if_else(starts, 0.0, level)
    return ca.vertcat(updated, x[3], _upper_part(P), level), seen


@cache
def noise_predictor(sums: bool = False) -> lanes.Kernel:
    """Build the predictor of noisy readings.

    Args:
        sums: whether log densities of errors are added up in the last state, and nothing is
            recorded; else all of `SEEN` is.

    Returns:
        A kernel whose inputs are u(t), u(t - 1), ..., the reading, whether there is one, whether a
        record starts, and whether its error counts; whose lanes differ in `NUMBERS` and in how
        late the input acts.
    """
    return _build_predictor(_hear_reading, 5, 4, sums)


def _hear_reading(before: _Before) -> tuple[Any, Any]:
    """Return the state after a sample with a noisy reading or without, and `SEEN`."""
    lane, was, moved, P, F, (reading, there, starts) = before
    level, *of_level = ca.vertsplit(was[MEAN + COVARIANCE :])
    with_level = F @ ca.vertcat(*of_level[:3])
    own = of_level[3]
    R = lane.rms**2
    x = ca.if_else(starts, ca.vertcat(reading, 0.0, 0.0, 0.0), moved)
    P = ca.if_else(starts, _initial_covariance(lane, lane.gap**2 / 12 + R), P)
    level = ca.if_else(starts, reading, level)
    own = ca.if_else(starts, R, own)
    with_level = ca.if_else(starts, ca.vertcat(R, 0.0, 0.0), with_level)
    apart = ca.fmax(P[0, 0] - 2 * with_level[0] + own, 1e-300)
    mean, slope, rest = dead_zone_moments(x[0] - level, apart, lane.gap / 2)
    slope, rest, mean = ca.vertsplit(ca.if_else(starts, 0.0, ca.vertcat(slope, rest, mean)))
    level = level + mean
    own = (1 - slope) ** 2 * own + 2 * slope * (1 - slope) * with_level[0]
    own = own + slope**2 * P[0, 0] + rest
    with_level = (1 - slope) * with_level + slope * P[:, 0]
    S = own + R
    error = reading - level
    is_read = ca.logic_and(there, ca.logic_not(starts))
    seen = ca.vertcat(error, 0.5 * ca.log(S), x[0], x[1])
    gain = ca.if_else(is_read, with_level / S, ca.SX.zeros(3))
    gain_own = ca.if_else(is_read, own / S, 0.0)
    after = x[:3] + gain * error
    P = P - gain @ with_level.T
    with_level = with_level - gain * own
    level = level + gain_own * error
    own = own - gain_own * own
    return ca.vertcat(
        after,
        x[3],
        _upper_part(P),
        level,
        with_level,
        own,
    ), seen


def dead_zone_moments(mean: Any, variance: Any, half: Any) -> tuple[Any, Any, Any]:
    """Return the moments of a Gaussian after a dead zone, on CasADi expressions.

    Args:
        mean, variance: of the Gaussian.
        half: half the zone.

    Returns:
        The mean, the slope, and what of the variance the slope does not explain.
    """
    s = ca.sqrt(variance)
    beyond = ca.vertcat(mean - half, -mean - half) / s  # either edge
    mass, hazard = normal_cdf_and_hazard(beyond)
    density = mass * hazard
    above, below = ca.vertsplit(s * (beyond * mass + density))
    squares = variance * ca.sum1((beyond**2 + 1) * mass + beyond * density)
    passed, slope = above - below, ca.sum1(mass)
    rest = ca.fmax(squares - passed**2 - slope**2 * variance, 0.0)
    return passed, slope, rest
