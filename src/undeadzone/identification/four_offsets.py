"""Dead zone, play, both or neither? A linear filter with an offset a (sign, direction) of readings.

A play (c) that a dead zone (d) follows, or that follows one, reads z + beta with

    beta = (-c_r - d_r, c_l - d_r, -c_r + d_l, c_l + d_l)                                    (O1)

for + right, + left, - right, - left: + and - the sign of y, right and left its direction. So

    c_r + c_l = (-b1 + b2 - b3 + b4) / 2,  d_r + d_l = (-b1 - b2 + b3 + b4) / 2,
    b1 - b2 - b3 + b4 = 0                                                                    (O2)

The last one tests that nothing else is there. Of the centres only their sum shows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.ends.play import ticked
from undeadzone.identification.log import Flags
from undeadzone.identification.motion import Sensing, sides
from undeadzone.support.arrays import Floats, Integers

NAMES = ("neither", "dead_zone", "play", "both")
WIDTHS = 0.5 * np.array([[-1.0, 1, -1, 1], [-1.0, -1, 1, 1], [2.0, -2, -2, 2]])  # (O2)
SURE = 5.0  # standard deviations from which a width is there
LEAST = 0.02  # of the readings' rms, below which a width is no matter
BEYOND = 8.0  # standard deviations of the noise from which the sign of a reading is sure
VAGUE = 3.0  # rms of the readings: standard deviation of an offset, and of z, at first


class Moving(NamedTuple):
    """A sampled plant x+ = F x + B u + noise of covariance Q, z = H x.

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


class Offsets(NamedTuple):
    """What the filter found.

    Attributes:
        beta: the four offsets (4) [y].
        covariance: (4 x 4).
        samples: readings that each of them had (4).
        rms: of the readings [y].
        side: direction of each reading that was used, 0 of others (N).
        heard: the readings; those of an encoder where z was when they came (N) [y].
    """

    beta: Floats
    covariance: Floats
    samples: Integers
    rms: float
    side: Integers
    heard: Floats

    @property
    def widths(self) -> Floats:
        """c_r + c_l, d_r + d_l, and what neither explains (3) [y]."""
        return WIDTHS @ self.beta

    @property
    def std(self) -> Floats:
        """Their standard deviations (3) [y]."""
        return np.sqrt(np.maximum(np.diag(WIDTHS @ self.covariance @ WIDTHS.T), 0.0))

    @property
    def name(self) -> str:
        """neither, dead_zone, play or both."""
        return named(self.widths, self.std, self.rms)


def named(widths: Floats, std: Floats, rms: float) -> str:
    """What widths of play and dead zone are called: each is there from 5 deviations on.

    Args:
        widths: c_r + c_l, d_r + d_l, ... [y].
        std: their standard deviations [y].
        rms: of the readings [y].
    """
    play, zone = widths[:2] > np.maximum(SURE * std[:2], LEAST * rms)
    return NAMES[int(zone) + 2 * int(play)]


def classes(y: Floats, side: Integers, noise: float) -> Integers:
    """Which of the four offsets a reading has, 0 to 3; -1 where that is not sure (N)."""
    positive = y > BEYOND * noise
    negative = y < -BEYOND * noise
    known = (positive | negative) & (side != 0)
    return np.where(known, 2 * negative + (side < 0), -1)


def four_offsets(
    plant: Moving, u: Floats, y: Floats, ok: Flags, start: Integers, how: Sensing
) -> Offsets:
    """The four offsets along a log, by a Kalman filter that uses the readings of sure motion.

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
    moves = sides(y, ok, start, how)
    first = set(start.tolist())
    X, P = np.zeros(n + 4), np.zeros((n + 4, n + 4))
    P[n:, n:] = (VAGUE * rms) ** 2 * np.eye(4)
    F = np.eye(n + 4)
    F[:n, :n] = plant.F
    drive = u @ plant.B.T
    side, heard, samples = np.zeros(y.size, int), y.copy(), np.zeros(4, int)
    which = classes(y, moves, max(how.noise, how.quantum / BEYOND))
    z = 0.0
    for t in range(y.size):
        if t in first:
            X[:n], P[:n, :], P[:, :n] = 0.0, 0.0, 0.0
            P[:n, :n] = plant.at_first
            z = 0.0
        moved = float(plant.H @ X[:n] - z)
        if moves[t] and (how.window == 1 or moved * moves[t] > 0):
            side[t] = moves[t]
            heard[t], variance = _reading(y[t], moves[t], moved, how, plant.noise)
            k = which[t]
            if k >= 0:
                h = np.zeros(n + 4)
                h[:n], h[n + k] = plant.H, 1.0
                gain = P @ h
                S = float(h @ gain) + variance
                X += gain * ((heard[t] - h @ X) / S)
                P -= np.outer(gain, gain / S)
                samples[k] += 1
        z = float(plant.H @ X[:n])
        X[:n] = plant.F @ X[:n] + drive[t]
        P = F @ P @ F.T
        P[:n, :n] += plant.Q
        P = 0.5 * (P + P.T)
    return Offsets(X[n:].copy(), P[n:, n:].copy(), samples, rms, side, heard)


def _reading(y: float, side: int, moved: float, how: Sensing, noise: float) -> tuple[float, float]:
    """A reading and its variance; of a tick, where between two boundaries z was when it came."""
    if not how.quantum:
        return float(y), noise**2
    when, variance = ticked(np, y, side, moved, how.quantum)
    return float(when), float(variance) + noise**2
