"""Paths of joints or of an arm's tip: through points, around circles, along figures of eight.

A path is a value and its derivatives at any time.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Literal, NamedTuple

import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_array,
    require_matrix,
    require_number,
    require_series,
    require_vector,
)
from undeadzone.util.toml import Kind, OptionTable

Space = Literal["joint", "task"]
ORDER = 4  # derivatives of a turning path

# The angle turned after a share of the ramp: its slope is the quintic from 0 to 1.
START = np.polynomial.Polynomial([0, 0, 0, 0, 2.5, -3, 1])


class Quintic(Kind, frozen=True, kw_only=True, tag="quintic"):
    """Path through points, at rest at both ends, with least mean square jerk.

    It is the quintic spline with speed and acceleration 0 at the ends (Flash, Hogan 1985, for two
    points): four times continuously differentiable. It may swing beyond the points if the times do
    not suit them. It is held before and after.

    References:
        T. Flash, N. Hogan (1985), doi:10.1523/JNEUROSCI.05-07-01688.1985

    Attributes:
        points: the points, a row per point (K x channels).
        times: times of the points, increasing (K) [s].
        repeat: whether the path starts again (if so, the last point is also the first one, at time
            0).
        space: joint, or task: coordinates of an arm's tip [m].
    """

    points: Array
    times: Array
    repeat: bool = False
    space: Space = "joint"


class Swing(OptionTable, frozen=True, kw_only=True):
    """Motion of an arm's joints before a path of its tip begins: through points, and back.

    Attributes:
        points: positions of the joints between two stays at the start of the path (K x joints)
            [rad].
        times: times of the points, increasing from above 0 (K) [s].
        until: when the path of the tip begins [s].
    """

    points: Array
    times: Array
    until: float


class _Turn(OptionTable, frozen=True, kw_only=True):
    """Path around a centre in a plane, in two or three coordinates.

    Attributes:
        centre: centre of the path (2 or 3).
        period: time of one turn [s].
        normal: normal of the plane in three coordinates (3) (default: z). Seen from its tip the
            path turns anticlockwise. Phase 0 lies in the horizontal direction z x normal, for a
            vertical normal in the direction x.
        ramp: the path starts from rest, its speed rising as a quintic for this time [s] (default: a
            quarter of the period, 0: at full speed).
        space: task: coordinates of an arm's tip [m], or joint.
        swing: motion that an arm's joints make first, for a path of its tip (default: nothing).
    """

    centre: Array
    period: float
    normal: Array | None = None
    ramp: float | None = None
    space: Space = "task"
    swing: Swing | None = None


class Circle(_Turn, frozen=True, kw_only=True, tag_field="kind", tag="circle"):
    """Circle around `centre`, a turn per period, in two or three coordinates.

    Attributes:
        radius: radius of the circle.
        phase: angle at which it starts [rad].
    """

    radius: float
    phase: float = 0.0


class FigureEight(_Turn, frozen=True, kw_only=True, tag_field="kind", tag="figure_eight"):
    """Figure of eight from `centre`, a turn per period, in two or three coordinates.

    It is width / 2 sin(angle) across and height / 2 sin(2 angle) along its plane. Across is the
    direction that phase 0 has in a circle.

    Attributes:
        width: size across.
        height: size along.
    """

    width: float
    height: float


Path = Quintic | Circle | FigureEight


class Curve(NamedTuple):
    """Path as a function of time.

    Attributes:
        derivatives: t (N) [s] -> the value and its derivatives (N x order x channels).
        closure: the derivative that follows the last, as a combination of those (order).
        corners: as in `Exosystem` [s].
        period: as in `Exosystem` [s].
    """

    derivatives: Callable[[Floats], Floats]
    closure: Floats
    corners: Floats
    period: float | None


def build_curve(key: str, path: Path, channels: int) -> Curve:
    """Build the curve of a path.

    Args:
        key: name of the path in messages.
        path: the path in words.
        channels: number of coordinates.

    Raises:
        InputError: or a subclass, that names the key.
    """
    match path:
        case Quintic():
            return _quintic_curve(key, path, channels)
        case Circle():
            across, along = _plane_directions(key, path, channels)
            radius = require_number(f"{key}.radius", path.radius, above=0.0)
            phase = require_number(f"{key}.phase", path.phase)
            gains = radius * np.exp(1j * phase) * (across - 1j * along)[None]
            return _turning_curve(key, path, np.array([1]), gains)
        case FigureEight():
            width = require_number(f"{key}.width", path.width, above=0.0)
            height = require_number(f"{key}.height", path.height, above=0.0)
            across, along = _plane_directions(key, path, channels)
            gains = -0.5j * np.stack([width * across, height * along])
            return _turning_curve(key, path, np.array([1, 2]), gains)


def _quintic_curve(key: str, path: Quintic, channels: int) -> Curve:
    """Return the curve through points."""
    from scipy.interpolate import make_interp_spline

    points, times = _require_points(key, path, channels)
    at_rest = [(1, np.zeros(channels)), (2, np.zeros(channels))]
    spline = make_interp_spline(times, points, k=5, bc_type=(at_rest, at_rest))
    start, end = times[[0, -1]]

    def derivatives(t: Floats) -> Floats:
        """Return the value and five derivatives at times t [s] (N x 6 x channels)."""
        at = np.mod(t, end) if path.repeat else t
        inside = np.clip(at, start, end)
        moving = ((at >= start) & (at < end))[:, None]
        values = [spline(inside, order) * (moving | (order == 0)) for order in range(6)]
        return np.stack(values, axis=1)

    return Curve(derivatives, np.zeros(6), times, float(end) if path.repeat else None)


def _require_points(key: str, path: Quintic, channels: int) -> tuple[Floats, Floats]:
    """Return points (K x channels) and times (K) [s], or raise."""
    points = require_array(f"{key}.points", path.points)
    if points.ndim == channels == 1:
        points = points[:, None]
    points = require_matrix(f"{key}.points", points, None, channels, "a row per point")
    times = require_series(f"{key}.times", path.times)
    if times.size != len(points) or times.size < 2:
        raise ShapeError(
            f"{key}.times: expected one time per point and two points or more, "
            f"found {times.size} times and {len(points)} points"
        )
    if (np.diff(times) <= 0).any():
        raise InputError(f"{key}.times: must increase from point to point")
    if path.repeat and (times[0] != 0 or (points[0] != points[-1]).any()):
        raise InputError(
            f"{key}.repeat: the first time must be 0 and the last point the first one again, "
            "so that the path can repeat"
        )
    return points, times


def _plane_directions(key: str, path: Circle | FigureEight, channels: int) -> tuple[Floats, Floats]:
    """Return the directions of the sine and of the cosine: of phase 0 and of a quarter turn
    later.
    """
    if channels not in (2, 3):
        be = "is" if channels == 1 else "are"
        raise ShapeError(
            f"{key}: a path in a plane needs two or three coordinates, there {be} {channels}"
        )
    if channels == 2:
        if path.normal is not None:
            raise InputError(f"{key}.normal: has no meaning in two coordinates. Remove it")
        return np.array([1.0, 0.0]), np.array([0.0, 1.0])
    z = np.array([0.0, 0.0, 1.0])
    normal = z if path.normal is None else require_vector(f"{key}.normal", path.normal, 3)
    if not normal.any():
        raise InputError(f"{key}.normal: must not be zero")
    normal = normal / np.linalg.norm(normal)
    across = np.cross(z, normal)
    if np.linalg.norm(across) > 1e-9:
        across = across / np.linalg.norm(across)
    else:
        across = np.array([1.0, 0.0, 0.0])
    return across, np.cross(normal, across)


def _turning_curve(
    key: str, path: Circle | FigureEight, harmonics: np.ndarray, gains: np.ndarray
) -> Curve:
    """Return the curve centre + the real part of the sum of gains e^(i harmonics angle).

    The angle turns ever faster during the ramp, then evenly. Then the closure is exact: s^3 (s^2 +
    w^2) and s (s^2 + w^2) (s^2 + 4 w^2) vanish on one and on two harmonics.

    Args:
        key: name of the path in messages.
        path: the path in words.
        harmonics: multiples of the angle (K).
        gains: complex, of the harmonics (K x channels).
    """
    centre = require_vector(f"{key}.centre", path.centre, gains.shape[1], "one per coordinate")
    period = require_number(f"{key}.period", path.period, above=0.0)
    ramp = period / 4 if path.ramp is None else require_number(f"{key}.ramp", path.ramp, least=0.0)
    w = 2 * np.pi / period  # [rad/s]

    def derivatives(t: Floats) -> Floats:
        """Return the value and ORDER derivatives at times t [s] (N x (ORDER + 1) x
        channels).
        """
        angle = [part[:, None] for part in _angle_derivatives(t, w, ramp)]
        values = (_wave_derivatives(harmonics, angle) @ gains).real
        values[:, 0] += centre
        return values

    closure = _harmonic_closure(harmonics, w)
    if ramp:
        return Curve(derivatives, closure, np.array([0.0, ramp]), None)
    return Curve(derivatives, closure, np.empty(0), period)


def _angle_derivatives(t: Floats, w: float, ramp: float) -> list[Floats]:
    """Return the angle [rad] and its derivatives at times t [s].

    It turns evenly with w [rad/s] after the ramp [s].
    """
    if ramp == 0:
        return [w * t, np.full_like(t, w), *[np.zeros_like(t)] * (ORDER - 1)]
    share = np.clip(t / ramp, 0, 1)
    angle = [w * ramp ** (1 - order) * START.deriv(order)(share) for order in range(ORDER + 1)]
    angle[0] = angle[0] + w * np.maximum(t - ramp, 0)
    angle[-1] = angle[-1] * ((t >= 0) & (t < ramp))  # jumps there
    return angle


def _wave_derivatives(harmonics: np.ndarray, angle: list[Floats]) -> np.ndarray:
    """Return the waves e^(i harmonics angle) and their derivatives (N x order x K).

    By Leibniz' rule on wave' = i harmonics angle' wave. angle: the angle and its derivatives (N x 1
    each).
    """
    waves = [np.exp(1j * harmonics * angle[0])]
    for order in range(ORDER):
        terms = [comb(order, k) * angle[k + 1] * waves[order - k] for k in range(order + 1)]
        waves.append(1j * harmonics * sum(terms))
    return np.stack(waves, axis=1)


def _harmonic_closure(harmonics: np.ndarray, w: float) -> Floats:
    """Return c (ORDER + 1) with x^(ORDER + 1) = sum of c_k x^(k) for a sum of harmonics of w.

    Args:
        harmonics: factors h of the frequency; sines of h w are roots of s^2 + (h w)^2.
        w: frequency [rad/s].
    """
    characteristic = np.array([1.0])  # polynomial in s, highest power first
    for harmonic in harmonics:
        characteristic = np.polymul(characteristic, np.array([1.0, 0.0, (harmonic * w) ** 2]))
    lowest_first = -characteristic[:0:-1]  # fewer harmonics: the rest are roots at s = 0
    closure = np.zeros(ORDER + 1)
    closure[-lowest_first.size :] = lowest_first
    return closure
