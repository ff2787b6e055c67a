"""Direction of motion by readings, and the four offsets that separate play from dead zone.

The contact side of a play follows from the direction of motion, before any plant is fitted. The
rule depends on the sensor (docs/play.md): for exact readings it is the sign of their change, for an
encoder its ticks, for noisy readings the slope of the preceding readings.

Dead zone, play, both or neither? A linear filter has an offset a (sign, direction) of readings. A
play (c) that a dead zone (d) follows, or that follows one, reads z + beta with

    beta = (-c_r - d_r, c_l - d_r, -c_r + d_l, c_l + d_l)                                    (O1)

for + right, + left, - right, - left: + and - the sign of y, right and left its direction. So

    c_r + c_l = (-b1 + b2 - b3 + b4) / 2,  d_r + d_l = (-b1 - b2 + b3 + b4) / 2,
    b1 - b2 - b3 + b4 = 0                                                                    (O2)

The last equation tests the model. Only the sum of both centres is identifiable.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.nonlinearities.play import detect_tick
from undeadzone.util.arrays import Flags, Floats, Integers, rows_since_start
from undeadzone_identify.models.kalman import WHITE, observer_form_matrices
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.models.plant import PlantSimulator, input_noise_gain

SURE = 5.5  # standard deviations of a slope: one false side in a gap's log ruins its estimate
WINDOWS = (4, 6, 8, 12, 16, 24, 32)
REPEATED_SHARE = 0.01  # share of readings equal to the one before that shows a sensor without noise
CHATTER = 0.05  # share of ticks that the next tick undoes, above which ticks are noise
REVERSED_SHARE = 0.35  # share of ticks that a reversed tick follows, above which ticks are noise
NAMES = ("neither", "dead_zone", "play", "both")
WIDTHS = 0.5 * np.array([[-1.0, 1, -1, 1], [-1.0, -1, 1, 1], [2.0, -2, -2, 2]])  # (O2)
THERE = 5.0  # standard deviations above which a width is significant
LEAST = 0.02  # least width that is relevant [rms of the readings]
BEYOND = 8.0  # standard deviations of the noise above which the sign of a reading is sure
VAGUE = 3.0  # prior standard deviation of an offset [rms of the readings]
FAINTEST = 1e-3  # least noise and disturbance that the filter assumes [rms of y]
AT_FIRST = 5.0  # prior standard deviation of a state [rms of y]

# --- Sides


class MotionRule(NamedTuple):
    """Rule by which readings show motion.

    Attributes:
        noise: rms of their white noise [y]; 0 for exact readings and for an encoder.
        quantum: quantum of an encoder [y]; 0 for other readings.
        window: number of readings of a slope; 1 if single changes show motion.
    """

    noise: float
    quantum: float
    window: int


def detect_motion_rule(
    y: Floats, ok: Flags, start: Integers, quantum: float, longest: float = np.inf
) -> MotionRule:
    """Detect the rule by which the readings of a log show motion.

    Args:
        y: readings (N).
        ok: flags of the readings that are not missing (N).
        start: first sample of each record (R).
        quantum: smallest common spacing of the readings [y], 0 if there is none.
        longest: longest window over which z may be assumed monotone [samples].

    Returns:
        The rule. For noisy readings its window decides the direction most often.
    """
    change, known = reading_changes(y, ok, start)
    active = change[known & (y != 0)]
    # Exact readings, and those of an encoder, repeat and do not chatter.
    if (
        active.size
        and (active == 0).mean() > REPEATED_SHARE
        and not _has_chatter(np.where(known, change, 0.0))
    ):
        return MotionRule(0.0, quantum, 1)
    rms = float(np.hypot(white_noise_rms(y, ok, start), quantum / np.sqrt(12)))
    best = WINDOWS[0]
    largest = -1
    for window in WINDOWS:
        count = int(np.count_nonzero(motion_sides(y, ok, start, MotionRule(rms, 0.0, window))))
        if count > largest and (window == WINDOWS[0] or window <= longest):
            best = window
            largest = count
    return MotionRule(rms, 0.0, best)


def motion_sides(y: Floats, ok: Flags, start: Integers, rule: MotionRule) -> Integers:
    """Return the direction of motion: +1 right, -1 left, 0 if uncertain (N).

    Args:
        y: readings (N).
        ok: flags of the readings that are not missing (N).
        start: first sample of each record (R).
        rule: rule by which the readings show motion.
    """
    if rule.noise:
        move = preceding_move(y, ok, start, rule.window)
        # A slope over w readings has the variance 12 s^2 / w^3; it is multiplied by w here.
        threshold = SURE * rule.noise * np.sqrt(12 / rule.window)
    else:
        change, known = reading_changes(y, ok, start)
        move = np.where(known, change, 0.0)
        threshold = rule.quantum / 2
    return ok * (1 * (move > threshold) - 1 * (move < -threshold))


def preceding_move(y: Floats, ok: Flags, start: Integers, window: int) -> Floats:
    """Return the motion over the preceding readings (N) [y]; 0 if one of them is missing.

    It is the least-squares slope of the `window` readings before each, times the window.
    """
    weights = np.arange(window) - (window - 1) / 2
    weights *= window / (weights @ weights)
    slope = np.convolve(np.where(ok, y, 0.0), weights[::-1])[: y.size]
    whole = np.convolve(1.0 * ok, np.ones(window))[: y.size] > window - 0.5
    own = rows_since_start(start, y.size) >= window - 1
    move = np.zeros(y.size)
    move[1:] = (slope * (whole & own))[:-1]
    move[start] = 0.0
    return move


def white_noise_rms(y: Floats, ok: Flags, start: Integers) -> float:
    """Return the rms of the white noise of readings [y], by the median of third differences.

    A third difference removes motion; its variance is 20 times that of white noise. The median of
    absolute values of a Gaussian is 0.6745 standard deviations.
    """
    known = ok & (y != 0)  # readings inside a zone have no noise
    difference = y
    for _ in range(3):
        difference = np.append(0.0, np.diff(difference))
        known = known & np.append(False, known[:-1])
    known = known & (rows_since_start(start, y.size) >= 3)
    if not known.any():
        return 0.0
    return float(np.median(np.abs(difference[known])) / 0.6745 / np.sqrt(20))


def reading_changes(y: Floats, ok: Flags, start: Integers) -> tuple[Floats, Flags]:
    """Return changes from the previous reading (N), and flags of the known changes (N)."""
    change = np.append(0.0, np.diff(y))
    known = ok & np.append(False, ok[:-1])
    known[start] = False
    return change, known


def _has_chatter(change: Floats) -> bool:
    """Return whether many ticks reverse within two samples, as noise at a boundary makes them.

    Args:
        change: changes of the readings, 0 if unknown (N).
    """
    ticks = np.flatnonzero(change)
    if ticks.size < 10:
        return False
    tick = change[ticks[:-1]]
    following = change[ticks[1:]]
    reverses = (tick * following < 0) & (np.diff(ticks) <= 2)
    undone = (reverses & (tick == -following)).mean()
    return bool(undone > CHATTER or reverses.mean() > REVERSED_SHARE)


def samples_between_turns(z: Floats) -> float:
    """Return the mean number of samples between two reversals of a smooth signal (N)."""
    rising = np.diff(z) > 0
    return z.size / max(int(np.count_nonzero(rising[1:] != rising[:-1])), 1)


# --- The four offsets


class MovingPlant(NamedTuple):
    """Sampled plant x+ = F x + B u + noise of covariance Q, z = H x.

    Attributes:
        F: (n x n).
        B: (n x m).
        H: (n).
        Q: (n x n).
        at_first: covariance of x at the start of a record (n x n).
        noise: rms of the readings' white noise [y].
    """

    F: Floats
    B: Floats
    H: Floats
    Q: Floats
    at_first: Floats
    noise: float


class FourOffsets(NamedTuple):
    """Estimate of the four offsets.

    Attributes:
        beta: the four offsets (4) [y].
        covariance: (4 x 4).
        rms: of the readings [y].
        side: direction of motion at each reading that was used, 0 at others (N).
        corrected: readings; for the ticks of an encoder the position at which they came (N) [y].
    """

    beta: Floats
    covariance: Floats
    rms: float
    side: Integers
    corrected: Floats

    @property
    def play_and_zone_widths(self) -> Floats:
        """Return c_r + c_l, d_r + d_l, and the contradiction of (O2), which should be 0 (3) [y]."""
        return WIDTHS @ self.beta

    @property
    def width_deviations(self) -> Floats:
        """Return the standard deviations of the three widths (3) [y]."""
        return np.sqrt(np.maximum(np.diag(WIDTHS @ self.covariance @ WIDTHS.T), 0.0))

    @property
    def element_name(self) -> str:
        """Return the class: neither, dead_zone, play or both."""
        return name_by_widths(self.play_and_zone_widths, self.width_deviations, self.rms)


def name_by_widths(widths: Floats, std: Floats, rms: float) -> str:
    """Return the class (neither, dead_zone, play, both) for the widths of play and dead zone.

    A width counts if it is significant and relevant.

    Args:
        widths: c_r + c_l, d_r + d_l, ... [y].
        std: their standard deviations [y].
        rms: of the readings [y].
    """
    play, zone = widths[:2] > np.maximum(THERE * std[:2], LEAST * rms)
    return NAMES[int(zone) + 2 * int(play)]


def offset_classes(y: Floats, side: Integers, noise: float) -> Integers:
    """Return the index of each reading's offset in (O1), 0 to 3; -1 if uncertain (N).

    Args:
        y: readings (N).
        side: direction of motion (N).
        noise: rms of the noise of the readings [y].
    """
    positive = y > BEYOND * noise
    negative = y < -BEYOND * noise
    known = (positive | negative) & (side != 0)
    return np.where(known, 2 * negative + (side < 0), -1)


def estimate_four_offsets(
    plant: MovingPlant, u: Floats, y: Floats, ok: Flags, start: Integers, rule: MotionRule
) -> FourOffsets:
    """Estimate the four offsets along a log by a Kalman filter.

    The filter's state is [x; beta]. It uses readings at which the direction of motion is certain.
    After a reversal a window of readings still shows the old direction, so the predicted z must
    move the same way.

    Args:
        plant: plant with its disturbance.
        u: inputs (N x m).
        y: readings (N).
        ok: flags of the readings that are not missing (N).
        start: first sample of each record (R).
        rule: rule by which the readings show motion.

    Returns:
        The offsets with their covariance.
    """
    n = plant.H.size
    rms = root_mean_square(y[ok])
    directions = motion_sides(y, ok, start, rule)
    first = set(start.tolist())
    X = np.zeros(n + 4)
    P = np.zeros((n + 4, n + 4))
    P[n:, n:] = (VAGUE * rms) ** 2 * np.eye(4)
    F = np.eye(n + 4)
    F[:n, :n] = plant.F
    drive = u @ plant.B.T
    side = np.zeros(y.size, int)
    corrected = y.copy()
    classes = offset_classes(y, directions, max(rule.noise, rule.quantum / BEYOND))
    z = 0.0
    for t in range(y.size):
        if t in first:
            X[:n] = 0.0
            P[:n, :] = 0.0
            P[:, :n] = 0.0
            P[:n, :n] = plant.at_first
            z = 0.0
        move = float(plant.H @ X[:n] - z)  # predicted change of z in the sample
        if directions[t] and (rule.window == 1 or move * directions[t] > 0):
            side[t] = directions[t]
            corrected[t], variance = _correct_tick(y[t], directions[t], move, rule, plant.noise)
            k = classes[t]
            if k >= 0:  # Kalman update with y = H x + beta_k + e
                h = np.zeros(n + 4)
                h[:n] = plant.H
                h[n + k] = 1.0
                Ph = P @ h
                S = float(h @ Ph) + variance
                X += Ph * ((corrected[t] - h @ X) / S)
                P -= np.outer(Ph, Ph / S)
        z = float(plant.H @ X[:n])
        X[:n] = plant.F @ X[:n] + drive[t]
        P = F @ P @ F.T
        P[:n, :n] += plant.Q
        P = 0.5 * (P + P.T)
    return FourOffsets(X[n:].copy(), P[n:, n:].copy(), rms, side, corrected)


def _correct_tick(
    y: float, side: int, move: float, rule: MotionRule, noise: float
) -> tuple[float, float]:
    """Return a reading and its variance; for a tick of an encoder, the position of the tick.

    Args:
        y: reading [y].
        side: direction of motion, +1 or -1.
        move: predicted change of z in the sample [y].
        rule: rule by which the readings show motion.
        noise: rms of the noise of a reading [y].
    """
    if not rule.quantum:
        return float(y), noise**2
    position, variance = detect_tick(np, y, side, move, rule.quantum)
    return float(position), float(variance) + noise**2


# --- With a fitted plant


def four_offsets_along(
    simulator: PlantSimulator, theta: Floats, rms: float, quantum: float
) -> FourOffsets:
    """Estimate the four offsets for a fitted plant, its parameters taken as known.

    Args:
        simulator: linear plant with its data.
        theta: its parameters (P).
        rms: rms of the residual of the fit, scaled.
        quantum: quantum of the readings, scaled.
    """
    data = simulator.data
    z = simulator.simulate_z(theta)
    longest = samples_between_turns(z) / 8
    rule = detect_motion_rule(data.y, data.ok, data.start, quantum, longest)
    plant = to_moving_plant(simulator, theta, rms, white_noise_rms(data.y, data.ok, data.start))
    return estimate_four_offsets(plant, data.u, data.y, data.ok, data.start, rule)


def to_moving_plant(
    simulator: PlantSimulator, theta: Floats, rms: float, noise: float
) -> MovingPlant:
    """Convert a fitted plant to that of the four-offsets filter.

    Args:
        simulator: linear plant with its data.
        theta: its parameters (P).
        rms: rms of z by the disturbance, white noise at the inputs: that of the residual.
        noise: rms of the readings' white noise.
    """
    layout = simulator.layout
    numbers = ca.DM(
        np.append(layout.full_denominator(theta[layout.denominator])[1:], theta[layout.numerators])
    )
    F, B, G, H = (
        part.full() for part in observer_form_matrices(layout.n, layout.m, WHITE, numbers)
    )
    power = 1.0
    if not layout.integrators:
        power = input_noise_gain(theta[layout.denominator], theta[layout.numerators], layout.n, 0.0)
    q = max(rms, FAINTEST) / math.sqrt(max(power, 1e-9))
    return MovingPlant(F, B, H[0], q**2 * G, AT_FIRST**2 * np.eye(layout.n), max(noise, FAINTEST))
