"""Friction level of a joint, by the torque that moves it and the way in which it moves.

    torque = F sign(v) + B v + J a + g + s sin q + c cos q

v and a are slopes of lines through few samples at their own times, so no regular step is needed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.looks.jackknife import leave_groups_out
from undeadzone_identify.models.estimates import Interval

NEAR = 4  # samples before and after one, through which a line is fitted
FEWEST = 200  # samples
MOVING = 100  # samples that move
ONE_WAY = 0.1  # share of the moving samples that go either way, at least
SLOW = 0.02  # of fast motion, up to which a joint stands still
FAST = 0.95  # quantile of the speed that is fast motion
TURN = 20.0  # range of a position in radians, beyond which it is not an angle that a weight feels
ROUNDS = 6  # of the robust fit
HUBER = 2.0  # residual, from which a sample counts less [rms]
BLOCKS = 12  # of the jackknife
LIKE = 1.1  # rms of the best fit, up to which one with fewer parts may be the true one
EXPLAINED = 0.5  # of the torque, that the fit explains at least
PAYS = 0.15  # of what is left without the sign, that the sign explains at least
SURE = 0.75  # of the torque, from which a level is measured
NARROW = 0.5  # of a level, that its interval has at most if it is measured


class FrictionLevel(NamedTuple):
    """Torque that friction takes, whichever way a joint moves.

    Attributes:
        level: with the interval over blocks, slow and fast motion, and models alike [torque].
        slow, fast: level of the slower and of the faster half of the motion [torque].
        rest: level of torque between both ways [torque].
        explained: share of the torque that the fit explains.
        gain: share of what is left without sign(v), that it explains.
        samples: that move.
    """

    level: Interval
    slow: float
    fast: float
    rest: float
    explained: float
    gain: float
    samples: int

    @property
    def is_measured(self) -> bool:
        """Return whether fit and interval suffice for a number without doubt."""
        return self.explained > SURE and self.level.half_width < NARROW / 2 * self.level.value


def friction_level(t: Floats, torque: Floats, y: Floats, y_is_speed: bool) -> FrictionLevel | None:
    """Return the friction level of a joint; None if torque and motion show none.

    Args:
        t: times (N).
        torque: or current (N).
        y: position or speed (N).
        y_is_speed: which of them.
    """
    there = np.isfinite(t) & np.isfinite(torque) & np.isfinite(y)
    there &= np.diff(np.maximum.accumulate(t), prepend=-np.inf) > 0
    t, torque, y = t[there], torque[there], y[there]
    if t.size < FEWEST:
        return None
    v = y if y_is_speed else local_slopes(t, y)
    q = cumulative_trapezoid(v, t, initial=0) if y_is_speed else y
    parts = np.column_stack(
        [np.sign(v), v, np.ones(t.size), local_slopes(t, v), np.sin(q), np.cos(q)]
    )
    noise = float(np.median(np.abs(np.diff(v, 2)))) / 0.6745 / math.sqrt(6)
    moves = np.abs(v) > 3 * noise + SLOW * np.quantile(np.abs(v), FAST)
    ahead = float(np.mean(v[moves] > 0)) if moves.any() else 0.0
    if moves.sum() < MOVING or not ONE_WAY <= ahead <= 1 - ONE_WAY:
        return None
    turns = np.ptp(q) < TURN
    kinds = [[0, 1, 2], [0, 1, 2, 3], *([[0, 1, 2, 4, 5], [0, 1, 2, 3, 4, 5]] if turns else [])]
    return _level_of(parts[moves], torque[moves], np.abs(v[moves]), kinds)


def local_slopes(t: Floats, x: Floats) -> Floats:
    """Return the slope of the line through each sample and its neighbours (N) [x/t]."""
    places = np.arange(t.size)[:, None] + np.arange(-NEAR, NEAR + 1)
    near = np.clip(places, 0, t.size - 1)
    times = t[near] - t[near].mean(axis=1, keepdims=True)
    return np.asarray((times * x[near]).sum(axis=1) / (times**2).sum(axis=1))


def _level_of(
    parts: Floats, torque: Floats, speed: Floats, kinds: list[list[int]]
) -> FrictionLevel | None:
    """Return the level by the best of several models, and the hull of all that fit alike.

    Args:
        parts: sign of v, and what else takes torque (N x 6).
        torque: (N).
        speed: |v| (N).
        kinds: columns of each model; the last has all of them.
    """
    size = torque.size
    columns = parts / np.maximum(np.sqrt(np.mean(parts**2, axis=0)), 1e-300)
    weights = _robust_weights(columns[:, kinds[-1]], torque)

    def fit(kind: list[int], use: Flags) -> Floats:
        rows = columns[use][:, kind] * weights[use, None]
        return np.linalg.lstsq(rows, torque[use] * weights[use], rcond=1e-9)[0]

    def left(kind: list[int]) -> float:
        return float(np.var(weights * (torque - columns[:, kind] @ fit(kind, every))))

    every = np.ones(size, bool)
    full = kinds[-1]
    rest = left(full)
    explained = 1 - rest / max(float(np.var(weights * torque)), 1e-300)
    gain = 1 - rest / max(left(full[1:]), 1e-300)
    blocks = np.arange(size) * BLOCKS // size
    alike = [kind for kind in kinds if left(kind) <= LIKE**2 * rest]
    levels = [leave_groups_out(lambda use, k=kind: fit(k, use)[0], blocks) for kind in alike]
    fast = speed > np.median(speed)
    halves = [float(fit(full, use)[0]) for use in (~fast, fast)]
    low = min(*halves, *(one.low for one in levels))
    high = max(*halves, *(one.high for one in levels))
    if explained < EXPLAINED or gain < PAYS or low <= 0:
        return None
    level = Interval(levels[-1].value, low, high)
    return FrictionLevel(level, *halves, float(fit(full, every)[2]), explained, gain, size)


def _robust_weights(columns: Floats, torque: Floats) -> Floats:
    """Return the root weights of Huber's fit of torque on columns (N)."""
    weights = np.ones(torque.size)
    for _ in range(ROUNDS):
        rows = columns * weights[:, None]
        e = torque - columns @ np.linalg.lstsq(rows, torque * weights, rcond=1e-9)[0]
        rms = float(np.median(np.abs(e))) / 0.6745
        weights = np.sqrt(np.minimum(1, HUBER * rms / np.maximum(np.abs(e), 1e-300)))
    return weights
