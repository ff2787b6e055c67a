"""Paths through points, around circles and figures of eight, of joints or of an arm's tip: a value and its derivatives at any time."""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.support.arrays import Array, Floats, array, matrix, scalar, series, vector

Space = Literal["joint", "task"]
ORDER = 4  # derivatives of a turning path
START = np.polynomial.Polynomial(
    [0, 0, 0, 0, 2.5, -3, 1]
)  # turned after a share of the ramp: its slope is the quintic from 0 to 1


class Quintic(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="quintic",
):
    """Through `points` (K x channels) at `times` (K) [s], at rest at both ends: the path of least mean square jerk.

    That is the quintic spline with speed and acceleration 0 at the ends (Flash, Hogan 1985, for two points): four times continuously differentiable; it may
    swing beyond the points where the times do not suit them. Held before and after; repeat: from the start again, which then is the last point, at time 0.
    space: joint, or task: coordinates of an arm's tip [m].
    """

    points: Array
    times: Array
    repeat: bool = False
    space: Space = "joint"


class _Turn(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    centre: Array
    period: float
    normal: Array | None = None
    ramp: float | None = None
    space: Space = "task"


class Circle(
    _Turn, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="circle"
):
    """Around `centre` at `radius`, once per period [s], from `phase` [rad], in two or three coordinates.

    normal: of its plane in three coordinates (default: z), seen from whose tip it turns anticlockwise. Phase 0 lies in the horizontal direction z x normal,
    for a vertical normal in the direction x. ramp [s]: it starts from rest, its speed rising as a quintic (default: a quarter of the period; 0: at full speed).
    space: task: coordinates of an arm's tip [m]; or joint.
    """

    radius: float
    phase: float = 0.0


class FigureEight(
    _Turn,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="figure_eight",
):
    """width / 2 sin(angle) across and height / 2 sin(2 angle) along its plane, from `centre`, once per period [s].

    Across is the direction that phase 0 has in a circle; normal, ramp and space as there.
    """

    width: float
    height: float


Path = Quintic | Circle | FigureEight


class Curve(NamedTuple):
    """derivatives(t): the value and its derivatives (len(t) x order x channels); corners, period [s] as in `signals.Exosystem`.

    closure: the derivative that follows the last, as a combination of those (order).
    """

    derivatives: Callable[[Floats], Floats]
    closure: Floats
    corners: Floats
    period: float | None


def curve(key: str, path: Path, channels: int) -> Curve:
    """The curve of a path with that many channels. Raises InputError, ShapeError."""
    match path:
        case Quintic():
            return _quintic(key, path, channels)
        case Circle():
            across, along = _plane(key, path, channels)
            radius, phase = (
                scalar(f"{key}.radius", path.radius, above=0.0),
                scalar(f"{key}.phase", path.phase),
            )
            return _turning(
                key, path, np.array([1]), radius * np.exp(1j * phase) * (across - 1j * along)[None]
            )
        case FigureEight():
            width, height = (
                scalar(f"{key}.{name}", getattr(path, name), above=0.0)
                for name in ("width", "height")
            )
            across, along = _plane(key, path, channels)
            return _turning(
                key, path, np.array([1, 2]), -0.5j * np.stack([width * across, height * along])
            )


def _quintic(key: str, path: Quintic, channels: int) -> Curve:
    from scipy.interpolate import make_interp_spline

    points = array(f"{key}.points", path.points)
    points = matrix(
        f"{key}.points",
        points[:, None] if points.ndim == channels == 1 else points,
        None,
        channels,
        "a row per point",
    )
    times = series(f"{key}.times", path.times)
    if times.size != len(points) or times.size < 2:
        raise ShapeError(
            f"{key}.times: expected one time per point and two points or more, found {times.size} times and {len(points)} points"
        )
    if (np.diff(times) <= 0).any():
        raise InputError(f"{key}.times: must increase from point to point")
    if path.repeat and (times[0] != 0 or (points[0] != points[-1]).any()):
        raise InputError(
            f"{key}.repeat: the first time must be 0 and the last point the first one again, so that the path can repeat"
        )
    at_rest = [(1, np.zeros(channels)), (2, np.zeros(channels))]
    spline = make_interp_spline(times, points, k=5, bc_type=(at_rest, at_rest))
    start, end = times[[0, -1]]

    def derivatives(t: Floats) -> Floats:
        at = np.mod(t, end) if path.repeat else t
        inside, moving = np.clip(at, start, end), ((at >= start) & (at < end))[:, None]
        return np.stack(
            [spline(inside, order) * (moving | (order == 0)) for order in range(6)], axis=1
        )

    return Curve(derivatives, np.zeros(6), times, float(end) if path.repeat else None)


def _plane(key: str, path: Circle | FigureEight, channels: int) -> tuple[Floats, Floats]:
    """The directions of the sine and of the cosine: of phase 0 and of a quarter turn later."""
    if channels not in (2, 3):
        raise ShapeError(
            f"{key}: a path in a plane needs two or three coordinates, there {'is' if channels == 1 else 'are'} {channels}"
        )
    if channels == 2:
        if path.normal is not None:
            raise InputError(f"{key}.normal: has no meaning in two coordinates; remove it")
        return np.array([1.0, 0.0]), np.array([0.0, 1.0])
    z = np.array([0.0, 0.0, 1.0])
    normal = z if path.normal is None else vector(f"{key}.normal", path.normal, 3)
    if not normal.any():
        raise InputError(f"{key}.normal: must not be zero")
    normal = normal / np.linalg.norm(normal)
    across = np.cross(z, normal)
    across = (
        across / np.linalg.norm(across)
        if np.linalg.norm(across) > 1e-9
        else np.array([1.0, 0.0, 0.0])
    )
    return across, np.cross(normal, across)


def _turning(
    key: str, path: Circle | FigureEight, harmonics: np.ndarray, gains: np.ndarray
) -> Curve:
    """centre + the real part of the sum of gains (K x channels) e^{i harmonics angle}, whose angle turns ever faster during the ramp, then evenly.

    Once the angle turns evenly the closure is exact: s^3 (s^2 + w^2) and s (s^2 + w^2) (s^2 + 4 w^2) vanish on one and on two harmonics.
    """
    centre = vector(f"{key}.centre", path.centre, gains.shape[1], "one per coordinate")
    period = scalar(f"{key}.period", path.period, above=0.0)
    ramp = period / 4 if path.ramp is None else scalar(f"{key}.ramp", path.ramp, least=0.0)
    w = 2 * np.pi / period
    factors = [np.array([1.0, 0.0, (harmonic * w) ** 2]) for harmonic in harmonics]
    closure = np.zeros(ORDER + 1)
    known = -(factors[0] if len(factors) == 1 else np.polymul(*factors))[
        :0:-1
    ]  # lowest derivative first
    closure[-known.size :] = known

    def turned(t: Floats) -> list[Floats]:
        """The angle and its derivatives."""
        if ramp == 0:
            return [w * t, np.full_like(t, w), *[np.zeros_like(t)] * (ORDER - 1)]
        share = np.clip(t / ramp, 0, 1)
        found = [w * ramp ** (1 - order) * START.deriv(order)(share) for order in range(ORDER + 1)]
        found[0] = found[0] + w * np.maximum(t - ramp, 0)
        return [*found[:-1], found[-1] * ((t >= 0) & (t < ramp))]

    def derivatives(t: Floats) -> Floats:
        angle = [part[:, None] for part in turned(t)]
        waves = [np.exp(1j * harmonics * angle[0])]
        for order in range(ORDER):  # Leibniz on wave' = i harmonics angle' wave
            waves.append(
                1j
                * harmonics
                * sum(comb(order, k) * angle[k + 1] * waves[order - k] for k in range(order + 1))
            )
        found = (np.stack(waves, axis=1) @ gains).real
        found[:, 0] += centre
        return found

    return Curve(
        derivatives,
        closure,
        np.array([0.0, ramp]) if ramp else np.empty(0),
        None if ramp else period,
    )
