"""Motion behind readings, and the four offsets that separate play from dead zone.

The side of a play is made out before any model is asked, by three rules, by what the sensor
promises (docs/play.md): of exact readings the sign of their change, of an encoder its ticks, of
noisy readings the slope of those before.

Dead zone, play, both or neither? A linear filter has an offset a (sign, direction) of readings. A
play (c) that a dead zone (d) follows, or that follows one, reads z + beta with

    beta = (-c_r - d_r, c_l - d_r, -c_r + d_l, c_l + d_l)                                    (O1)

for + right, + left, - right, - left: + and - the sign of y, right and left its direction. So

    c_r + c_l = (-b1 + b2 - b3 + b4) / 2,  d_r + d_l = (-b1 - b2 + b3 + b4) / 2,
    b1 - b2 - b3 + b4 = 0                                                                    (O2)

The last one tests that nothing else is there. Of the centres only their sum shows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.nonlinearities.play import detect_tick
from undeadzone.util.arrays import Flags, Floats, Integers, rows_since_start
from undeadzone_identify.models.kalman import WHITE, observer_form_matrices
from undeadzone_identify.models.plant import PlantSimulator, input_noise_gain

SURE = 5.5  # standard deviations of a slope: one false side in a gap's log ruins its estimate
WINDOWS = (4, 6, 8, 12, 16, 24, 32)
REPEATED_SHARE = 0.01  # share of readings equal to the one before that shows a sensor without noise
CHATTER = 0.05  # share of ticks that are taken back at once, from which ticks are noise
REVERSED_SHARE = 0.35  # share of ticks that another way follows, where noise is larger than a step
NAMES = ("neither", "dead_zone", "play", "both")
WIDTHS = 0.5 * np.array([[-1.0, 1, -1, 1], [-1.0, -1, 1, 1], [2.0, -2, -2, 2]])  # (O2)
THERE = 5.0  # standard deviations from which a width is there
LEAST = 0.02  # of the readings' rms, below which a width is no matter
BEYOND = 8.0  # standard deviations of the noise from which the sign of a reading is sure
VAGUE = 3.0  # rms of the readings: standard deviation of an offset, and of z, at first
FAINTEST = 1e-3  # least noise and disturbance that the filter is told, in rms of y
AT_FIRST = 5.0  # standard deviation of a state at first, in rms of y

# --- Sides


class MotionRule(NamedTuple):
    """Rule by which readings show motion.

    Attributes:
        noise: rms of their white noise [y]; 0 of exact readings and of an encoder.
        quantum: of an encoder [y]; 0 of other readings.
        window: readings over which a slope is taken; 1 where each change counts.
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
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        quantum: smallest common spacing of the readings, 0 if there is none.
        longest: window over which z may be taken as monotone [samples].

    Returns:
        The rule. For noisy readings its window is the one that decides the direction most often.
    """
    change, known = reading_changes(y, ok, start)
    active = change[known & (y != 0)]
    if (  # exact readings or an encoder's: some repeat, and none go to and fro
        active.size
        and (active == 0).mean() > REPEATED_SHARE
        and not _has_chatter(np.where(known, change, 0.0))
    ):
        return MotionRule(0.0, quantum, 1)
    rms = float(np.hypot(white_noise_rms(y, ok, start), quantum / np.sqrt(12)))
    best, most = WINDOWS[0], -1
    for window in WINDOWS:
        count = int(np.count_nonzero(motion_sides(y, ok, start, MotionRule(rms, 0.0, window))))
        if count > most and (window == WINDOWS[0] or window <= longest):
            best, most = window, count
    return MotionRule(rms, 0.0, best)


def motion_sides(y: Floats, ok: Flags, start: Integers, how: MotionRule) -> Integers:
    """Return +1 for a sure motion to the right, -1 to the left, 0 if unsure (N).

    Args:
        y: readings (N).
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        how: the rule.
    """
    if how.noise:
        moved = preceding_move(y, ok, start, how.window)
        least = SURE * how.noise * np.sqrt(12 / how.window)
    else:
        change, known = reading_changes(y, ok, start)
        moved = np.where(known, change, 0.0)
        least = how.quantum / 2
    return ok * (1 * (moved > least) - 1 * (moved < -least))


def preceding_move(y: Floats, ok: Flags, start: Integers, window: int) -> Floats:
    """Return the slope of the `window` preceding readings times the window (N); 0 if unknown."""
    weights = np.arange(window) - (window - 1) / 2
    weights *= window / (weights @ weights)
    slope = np.convolve(np.where(ok, y, 0.0), weights[::-1])[: y.size]
    whole = np.convolve(1.0 * ok, np.ones(window))[: y.size] > window - 0.5
    own = rows_since_start(start, y.size) >= window - 1
    moved = np.zeros(y.size)
    moved[1:] = (slope * (whole & own))[:-1]
    moved[start] = 0.0
    return moved


def white_noise_rms(y: Floats, ok: Flags, start: Integers) -> float:
    """Return the rms of the white noise of readings, by the median of their third differences."""
    known = ok & (y != 0)  # what is silent has none
    difference = y
    for _ in range(3):
        difference = np.append(0.0, np.diff(difference))
        known = known & np.append(False, known[:-1])
    known = known & (rows_since_start(start, y.size) >= 3)
    if not known.any():
        return 0.0
    return float(np.median(np.abs(difference[known])) / 0.6745 / np.sqrt(20))


def reading_changes(y: Floats, ok: Flags, start: Integers) -> tuple[Floats, Flags]:
    """Return changes from the previous reading (N), and the flags of known changes (N)."""
    change = np.append(0.0, np.diff(y))
    known = ok & np.append(False, ok[:-1])
    known[start] = False
    return change, known


def _has_chatter(change: Floats) -> bool:
    """Return whether many ticks reverse within two readings: noise about boundaries."""
    ticks = np.flatnonzero(change)
    if ticks.size < 10:
        return False
    before, after = change[ticks[:-1]], change[ticks[1:]]
    turned = (before * after < 0) & (np.diff(ticks) <= 2)
    return bool((turned & (before == -after)).mean() > CHATTER or turned.mean() > REVERSED_SHARE)


def samples_between_turns(z: Floats) -> float:
    """Return the mean number of samples between two turns of a smooth signal."""
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
        side: direction of each reading that was used, 0 of others (N).
        heard: the readings; those of an encoder where z was when they came (N) [y].
    """

    beta: Floats
    covariance: Floats
    rms: float
    side: Integers
    heard: Floats

    @property
    def play_and_zone_widths(self) -> Floats:
        """Return c_r + c_l, d_r + d_l, and the unexplained rest (3) [y]."""
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
    """Return the class for widths of play and dead zone; each counts from 5 deviations on.

    Args:
        widths: c_r + c_l, d_r + d_l, ... [y].
        std: their standard deviations [y].
        rms: of the readings [y].
    """
    play, zone = widths[:2] > np.maximum(THERE * std[:2], LEAST * rms)
    return NAMES[int(zone) + 2 * int(play)]


def offset_classes(y: Floats, side: Integers, noise: float) -> Integers:
    """Return the index of each reading's offset, 0 to 3; -1 if unsure (N)."""
    positive = y > BEYOND * noise
    negative = y < -BEYOND * noise
    known = (positive | negative) & (side != 0)
    return np.where(known, 2 * negative + (side < 0), -1)


def estimate_four_offsets(
    plant: MovingPlant, u: Floats, y: Floats, ok: Flags, start: Integers, how: MotionRule
) -> FourOffsets:
    """Estimate the four offsets along a log by a Kalman filter on the readings of sure motion.

    Args:
        plant: with its disturbance.
        u: inputs (N x m).
        y: readings (N).
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        how: readings show motion.

    Returns:
        The offsets with their covariance. A side that readings show counts where the filter's own
        z moves the same way: after a turn a window still says what was.
    """
    n = plant.H.size
    rms = float(np.sqrt(np.mean(y[ok] ** 2)))
    moves = motion_sides(y, ok, start, how)
    first = set(start.tolist())
    X, P = np.zeros(n + 4), np.zeros((n + 4, n + 4))
    P[n:, n:] = (VAGUE * rms) ** 2 * np.eye(4)
    F = np.eye(n + 4)
    F[:n, :n] = plant.F
    drive = u @ plant.B.T
    side, heard = np.zeros(y.size, int), y.copy()
    which = offset_classes(y, moves, max(how.noise, how.quantum / BEYOND))
    z = 0.0
    for t in range(y.size):
        if t in first:
            X[:n], P[:n, :], P[:, :n] = 0.0, 0.0, 0.0
            P[:n, :n] = plant.at_first
            z = 0.0
        moved = float(plant.H @ X[:n] - z)
        if moves[t] and (how.window == 1 or moved * moves[t] > 0):
            side[t] = moves[t]
            heard[t], variance = _reading_and_variance(y[t], moves[t], moved, how, plant.noise)
            k = which[t]
            if k >= 0:
                h = np.zeros(n + 4)
                h[:n], h[n + k] = plant.H, 1.0
                gain = P @ h
                S = float(h @ gain) + variance
                X += gain * ((heard[t] - h @ X) / S)
                P -= np.outer(gain, gain / S)
        z = float(plant.H @ X[:n])
        X[:n] = plant.F @ X[:n] + drive[t]
        P = F @ P @ F.T
        P[:n, :n] += plant.Q
        P = 0.5 * (P + P.T)
    return FourOffsets(X[n:].copy(), P[n:, n:].copy(), rms, side, heard)


def _reading_and_variance(
    y: float, side: int, moved: float, how: MotionRule, noise: float
) -> tuple[float, float]:
    """Return a reading and its variance; for a tick, the position of z between two boundaries."""
    if not how.quantum:
        return float(y), noise**2
    when, variance = detect_tick(np, y, side, moved, how.quantum)
    return float(when), float(variance) + noise**2


# --- With a plant that was fitted


def four_offsets_along(
    simulator: PlantSimulator, theta: Floats, rms: float, quantum: float
) -> FourOffsets:
    """Estimate the four offsets for a fitted plant, its parameters taken as known.

    Args:
        simulator: the plant, with its data.
        theta: its numbers.
        rms: of the residual.
        quantum: of the readings, scaled.
    """
    data = simulator.data
    z = simulator.simulate_z(theta)
    longest = samples_between_turns(z) / 8
    how = detect_motion_rule(data.y, data.ok, data.start, quantum, longest)
    plant = to_moving_plant(simulator, theta, rms, white_noise_rms(data.y, data.ok, data.start))
    return estimate_four_offsets(plant, data.u, data.y, data.ok, data.start, how)


def to_moving_plant(
    simulator: PlantSimulator, theta: Floats, rms: float, noise: float
) -> MovingPlant:
    """Convert a fitted plant to that of the four-offsets filter.

    Args:
        simulator: the plant.
        theta: its numbers.
        rms: of the residual: white noise at the inputs makes as much of z.
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
