"""Curves in pieces, each as a function of time: a trapezoid, straight lines, a spline.

Such a function `derivatives(t)` gives the value and its derivatives (len(t) x order x channels).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from undeadzone.support.arrays import Floats

Derivatives = Callable[[Floats], Floats]


def trapezoid(corners: Floats, amplitude: Floats) -> Derivatives:
    """A periodic trapezoid between plus and minus its amplitude, with one derivative.

    Args:
        corners: times of its corners in one period, the first at 0 (6) [s].
        amplitude: amplitude of each channel (channels).
    """
    levels = np.array([0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    slopes = np.diff(levels) / np.where(np.diff(corners) > 0, np.diff(corners), np.inf)

    def derivatives(t: Floats) -> Floats:
        phase = np.mod(t, corners[-1])
        piece = np.clip(np.searchsorted(corners, phase, side="right") - 1, 0, 4)
        value = levels[piece] + slopes[piece] * (phase - corners[piece])
        return np.stack([value, slopes[piece]], axis=1)[:, :, None] * amplitude

    return derivatives


def lines(t: Floats, values: Floats) -> Derivatives:
    """Straight lines between samples, with one derivative; held at the ends.

    Args:
        t: times of the samples (N) [s].
        values: the samples (N x channels).
    """
    slopes = np.diff(values, axis=0) / np.diff(t)[:, None]

    def derivatives(at: Floats) -> Floats:
        inside = np.clip(at, t[0], t[-1])
        piece = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, t.size - 2)
        moving = ((at >= t[0]) & (at < t[-1]))[:, None]
        value = values[piece] + slopes[piece] * (inside - t[piece])[:, None]
        return np.stack([value, slopes[piece] * moving], axis=1)

    return derivatives


def spline(t: Floats, values: Floats) -> Derivatives:
    """A cubic spline through samples, with three derivatives; held at the ends.

    Args:
        t: times of the samples (N) [s].
        values: the samples (N x channels).
    """
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(t, values, bc_type="natural" if t.size < 4 else "not-a-knot")

    def derivatives(at: Floats) -> Floats:
        inside = np.clip(at, t[0], t[-1])
        moving = ((at >= t[0]) & (at <= t[-1]))[:, None]
        slopes = [curve(inside, order) * moving for order in range(1, 4)]
        return np.stack([curve(inside, 0), *slopes], axis=1)

    return derivatives
