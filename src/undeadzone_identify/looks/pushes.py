"""Friction level of a joint, by its torque and its direction of motion.

    torque = F sign(v) + g + B v + J a + s sin q + c cos q

v and a are slopes of lines through few samples at their own times, so no regular step is needed.
Models without J, s and c count as well if they fit alike: the interval is the hull of all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.looks.rows import known_samples, noise_of
from undeadzone_identify.models.estimates import Interval, student_quantile

NEAR = 4  # samples before and after one, through which a line is fitted
FEWEST = 200  # samples
MOVING = 100  # samples that move
ONE_WAY = 0.1  # share of the moving samples that go either way, at least
SLOW = 0.02  # of fast motion, up to which a joint stands still
FAST = 0.95  # quantile of the speed that is fast motion
TURN = 20.0  # range of a position [rad], beyond which it is no angle at which a weight pulls
MODELS = ([0, 1, 2], [0, 1, 2, 3], [0, 1, 2, 4, 5], [0, 1, 2, 3, 4, 5])  # parts of each
ROUNDS = 6  # of the robust fit
HUBER = 2.0  # residual, from which a sample counts less [rms]
BLOCKS = 12  # of the jackknife
LIKE = 1.1  # variance of the largest model's residual, up to which another one fits alike
EXPLAINED = 0.5  # of the torque, that the fit explains at least
PAYS = 0.15  # of what is left without the sign, that the sign explains at least
SURE = 0.75  # of the torque, from which a level is measured
NARROW = 0.5  # of a level, that its interval has at most if it is measured


class FrictionLevel(NamedTuple):
    """Torque that friction takes, whichever way a joint moves.

    Attributes:
        level: with the hull of its intervals by models, and of slow and fast motion [torque].
        explained: share of the torque that the fit explains.
    """

    level: Interval
    explained: float

    @property
    def is_measured(self) -> bool:
        """Return whether fit and interval suffice for a number without doubt."""
        return self.explained > SURE and 2 * self.level.half_width < NARROW * self.level.value


def friction_level(t: Floats, torque: Floats, y: Floats, y_is_speed: bool) -> FrictionLevel | None:
    """Return the friction level of a joint; None if torque and motion show none.

    Args:
        t: times (N).
        torque: or current (N).
        y: position [rad] or speed, some may be missing (N).
        y_is_speed: which of them.
    """
    t, torque, y = known_samples(t, torque, y)
    new = np.diff(t, prepend=-np.inf) > 0
    t, torque, y = t[new], torque[new], y[new]
    if t.size < FEWEST:
        return None
    v = y if y_is_speed else local_slopes(t, y)
    q = cumulative_trapezoid(v, t, initial=0) if y_is_speed else y
    moves = np.abs(v) > 3 * noise_of(v) + SLOW * np.quantile(np.abs(v), FAST)
    ahead = np.mean(v[moves] > 0) if moves.sum() >= MOVING else 0.0
    if not ONE_WAY <= ahead <= 1 - ONE_WAY:
        return None
    parts = [np.sign(v), np.ones(t.size), v, local_slopes(t, v), np.sin(q), np.cos(q)]
    models = MODELS if np.ptp(q) < TURN else MODELS[:2]
    return _Fit(np.column_stack(parts)[moves], torque[moves]).level(np.abs(v[moves]), models)


def local_slopes(t: Floats, x: Floats) -> Floats:
    """Return the slope of the line through each sample and its neighbours (N) [x/t]."""
    near = np.arange(t.size)[:, None] + np.arange(-NEAR, NEAR + 1)
    near = np.clip(near, 0, t.size - 1)
    times = t[near] - t[near].mean(axis=1, keepdims=True)
    return np.asarray((times * x[near]).sum(axis=1) / (times**2).sum(axis=1))


class _Fit:
    """Robust least squares of torque on parts of a model.

    Args:
        parts: what takes torque, scaled (N x 6).
        torque: (N).
    """

    def __init__(self, parts: Floats, torque: Floats) -> None:
        self.parts = parts / np.maximum(np.sqrt(np.mean(parts**2, axis=0)), 1e-300)
        self.torque = torque
        self.every = np.ones(torque.size, bool)
        self.weights = np.ones(torque.size)
        for _ in range(ROUNDS):
            e = np.abs(self.residual(MODELS[-1]))
            large = HUBER * np.median(e) / 0.6745
            self.weights = np.sqrt(np.minimum(1, large / np.maximum(e, 1e-300)))

    def numbers(self, model: list[int], use: Flags) -> Floats:
        """Return the torque that each part of a model takes, by the samples that are flagged."""
        weights = self.weights[use]
        rows = self.parts[use][:, model] * weights[:, None]
        return np.asarray(np.linalg.lstsq(rows, self.torque[use] * weights, rcond=1e-9)[0])

    def residual(self, model: list[int]) -> Floats:
        """Return the torque that a model leaves (N)."""
        return np.asarray(self.torque - self.parts[:, model] @ self.numbers(model, self.every))

    def interval(self, model: list[int]) -> Interval:
        """Return the level with its 95 % interval, by leaving out blocks of time."""
        block = np.arange(self.torque.size) * BLOCKS // self.torque.size
        levels = [self.numbers(model, block != k)[0] for k in range(BLOCKS)]
        half = student_quantile(BLOCKS - 1) * math.sqrt((BLOCKS - 1) * np.var(levels))
        return Interval.from_half_width(float(self.numbers(model, self.every)[0]), half)

    def level(self, speed: Floats, models: tuple[list[int], ...]) -> FrictionLevel | None:
        """Return the level by the largest model, and the hull of all; None if the sign buys little.

        Args:
            speed: |v| (N).
            models: parts of each; the last one has all.
        """
        full = models[-1]
        fast = speed > np.median(speed)
        halves = [float(self.numbers(full, half)[0]) for half in (~fast, fast)]
        signless = self.residual(full[1:])
        left = [float(np.var(self.weights * self.residual(model))) for model in models]
        before = [float(np.var(self.weights * one)) for one in (self.torque, signless)]
        explained, gain = (1 - left[-1] / max(one, 1e-300) for one in before)
        alike = [model for model, one in zip(models, left, strict=True) if one <= LIKE * left[-1]]
        found = list(map(self.interval, alike))
        low = min(*halves, *(one.low for one in found))
        high = max(*halves, *(one.high for one in found))
        if min(explained - EXPLAINED, gain - PAYS, low) <= 0:
            return None
        return FrictionLevel(found[-1]._replace(low=low, high=high), explained)
