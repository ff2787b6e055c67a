"""filterpy's filters of [x; d_r; d_l], z the first of n x: (filter, what gives it a reading)."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.filters.problems.random_plants import STEP
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.util.arrays import Floats


def extended(n: int) -> Any:
    """filterpy's EKF on [x; d_r; d_l], its branch of the dead zone the predicted one."""
    from filterpy.kalman import ExtendedKalmanFilter

    rival = ExtendedKalmanFilter(n + 2, 1)

    def slope(v: Floats) -> Floats:
        right, left = float(v[0] > v[n]), float(v[0] < -v[n + 1])
        return np.concatenate([[right + left], np.zeros(n - 1), [-right, left]])[None, :]

    def reading(v: Floats) -> Floats:
        return np.array([deadzone(v[0], v[n], v[n + 1])])

    def correct(y: float) -> None:
        rival.update(np.array([y]), slope, reading)

    return rival, correct


def unscented(n: int) -> Any:
    """filterpy's UKF on [x; d_r; d_l], alpha 1, beta 2, kappa 0.5."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    points = MerweScaledSigmaPoints(n + 2, 1.0, 2.0, 0.5)

    def reading(v: Floats) -> Floats:
        return np.array([deadzone(v[0], v[n], v[n + 1])])

    def move(v: Floats, dt: float, F: Floats, G: Floats) -> Floats:
        return F @ v + G

    rival = UnscentedKalmanFilter(n + 2, 1, STEP, reading, move, points)
    return rival, lambda y: rival.update(np.array([y]))
