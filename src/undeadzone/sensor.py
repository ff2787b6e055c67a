"""The output deadzone, equations (1)-(13) as corrected in docs/model.md: d_r, d_l > 0 and y = m (z - Sat z).

Every function takes NumPy arrays or CasADi expressions alike. z is the true output, y the reading,
right = d_r and left = d_l the widths (unit of z), m the slope (unit of y per unit of z).
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Array, Floats, nonnegative, scalar, vector

RIGHT, LEFT = 1.0, -1.0  # sides; 0 is silent


def _ops(*values: Any) -> Any:
    """CasADi when any value is a CasADi expression, else NumPy: fmax, fmin, tanh have the same names in both."""
    if any(type(value).__module__.startswith("casadi") for value in values):
        import casadi

        return casadi
    return np


def saturation(z: Any, right: Any, left: Any) -> Any:
    """Sat z of (4): z limited to [-d_l, d_r]."""
    ops = _ops(z, right, left)
    return ops.fmax(ops.fmin(z, right), -left)


def deadzone(z: Any, right: Any, left: Any, slope: Any = 1.0) -> Any:
    """The reading y = m (z - Sat z) of (1), (3), (14); exactly 0 inside the zone."""
    return slope * (z - saturation(z, right, left))


def zone(z: Any, right: Any, left: Any) -> Any:
    """Where the true output is: +1 beyond d_r, -1 below -d_l, 0 inside."""
    return 1.0 * (z > right) - 1.0 * (z < -left)


def jump(z: Any, right: Any, left: Any, slope: Any = 1.0) -> Any:
    """The reading of a jump sensor: m z outside the zone, 0 inside (velocity sensors)."""
    return slope * z * (1.0 * (z > right) + 1.0 * (z < -left))


def present(y: Any) -> Any:
    """1 where a reading is a finite number, 0 where it is missing (NaN, infinite). CasADi takes y == y for true."""
    return 1.0 * (y < 1e300) * (y > -1e300)


def side(y: Any, threshold: Any = 0.0) -> Any:
    """The measured side: +1 where y > threshold, -1 where y < -threshold, else 0 (silent, also for NaN)."""
    return 1.0 * (y > threshold) - 1.0 * (y < -threshold)


def indicators(y: Any, sharpness: Any) -> tuple[Any, Any]:
    """The paper's smooth (chi_r, chi_l) of (8)-(10), sgn replaced by tanh(k_s y); both are 1/2 at y = 0."""
    sign = _ops(y, sharpness).tanh(sharpness * y)
    return (1.0 + sign) / 2.0, (1.0 - sign) / 2.0


def quantised(y: Any, quantum: Any) -> Any:
    """The reading rounded to a multiple of its quantum (an encoder's), itself where that is 0."""
    ops = _ops(y, quantum)
    step = quantum + (quantum == 0)
    rounded = step * ops.floor(y / step + 0.5)
    return y * (quantum == 0) + rounded * (quantum != 0)


def offset(side: Any, right: Any, left: Any) -> Any:
    """chi_bar d of (12) with chi_bar = [chi_r, -chi_l]: what the deadzone takes off z on that side."""
    return right * (side > 0) - left * (side < 0)


def branch(z: Any, zone: Any, right: Any, left: Any, slope: Any, kind: str) -> Any:
    """The reading on a given branch, continued beyond its edge: m (z - chi_bar d), m z for a jump sensor, 0 inside."""
    taken = 0.0 if kind == "jump" else offset(zone, right, left)
    return slope * (z - taken) * (zone != 0)


def inverse(
    y: Any, side: Any, right: Any, left: Any, slope: Any = 1.0, kind: str = "deadzone"
) -> Any:
    """The deadzone inverse (26): y / m + chi_bar d on the measured side, y / m where silent or of the jump kind."""
    return y / slope + (0.0 if kind == "jump" else offset(side, right, left))


def edges(
    right: Any, left: Any, slope: Any, kind: str, threshold: Any, noise: Any = 0.0
) -> tuple[Any, Any]:
    """(z_r, z_l): the side reads right above z_r and left below -z_l, given threshold and additive noise on y.

    Noise beyond the threshold moves an edge across the zone: then the zone itself reads as that side.
    """
    ops = _ops(right, left, slope, threshold, noise)

    def edge(own: Any, other: Any, margin: Any) -> Any:
        outer, inner = (
            (ops.fmax(own, margin), ops.fmin(-other, margin))
            if kind == "jump"
            else (own + margin, margin - other)
        )
        return outer * (margin >= 0) + inner * (margin < 0)

    return edge(right, left, (threshold - noise) / slope), edge(
        left, right, (threshold + noise) / slope
    )


def bound(right: Any, left: Any) -> Any:
    """The least d_M of (2) as corrected, d_r + d_l <= d_M; it bounds |Sat z| too, as (13) asks."""
    return right + left


def noise_threshold(noise: Floats, step: float, rate: float) -> Floats:
    """|y| below which a reading counts as silent, so that white noise of that rms gives `rate` false alarms per second."""
    if not noise.any():
        return np.zeros_like(noise)
    from scipy.special import ndtri

    chance = min(0.5, max(rate * step / 2.0, np.finfo(float).tiny))
    return np.asarray(noise * -ndtri(chance), float)


class Sensor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An output deadzone of p outputs; each entry is one number or one per output.

    right, left: d_r, d_l [z]; slope: m [y/z]; noise: rms added after the deadzone [y]; noise_before: rms added to z
    ahead of it [z]; threshold: |y| that counts as silent [y] (default: from noise and false_alarm_rate [1/s]).
    quantum: of the reading, which is rounded to its multiples [y], as an encoder's; sampled time only.
    drift [1/sqrt(s)]: log d_r and log d_l walk at random, each for itself, by drift sqrt(t) rms; dropout: probability
    that a reading is missing, below 1.
    """

    right: Array
    left: Array
    kind: Literal["deadzone", "jump"] = "deadzone"
    slope: Array = 1.0
    noise: Array = 0.0
    noise_before: Array = 0.0
    threshold: Array | None = None
    false_alarm_rate: float = 0.01
    quantum: Array = 0.0
    drift: Array = 0.0
    dropout: Array = 0.0


class Zone(msgspec.Struct, frozen=True):
    """A `Sensor` checked and spread over p outputs, with its silence threshold decided; right, left at t = 0."""

    kind: str
    right: Floats
    left: Floats
    slope: Floats
    noise: Floats
    noise_before: Floats
    threshold: Floats
    drift: Floats
    dropout: Floats
    quantum: Floats

    @property
    def rms(self) -> Floats:
        """What a reading on an active side is off by, rms (p) [z]: noise ahead of and after the zone, rounding."""
        return np.hypot(
            np.hypot(self.noise / self.slope, self.noise_before),
            self.quantum / self.slope / np.sqrt(12),
        )


def resolve(sensor: Sensor, p: int, step: float) -> Zone:
    """Check a sensor against p outputs at a time step [s]. Raises InputError, ShapeError."""
    why = f"one per output, the plant has {p}"
    right, left = (
        nonnegative(f"sensor.{key}", getattr(sensor, key), p, why) for key in ("right", "left")
    )
    slope = vector("sensor.slope", sensor.slope, p, why)
    if (slope <= 0).any():
        raise InputError(f"sensor.slope: must be positive (A3), found {slope.min():g}")
    noise = nonnegative("sensor.noise", sensor.noise, p, why)
    before = nonnegative("sensor.noise_before", sensor.noise_before, p, why)
    drift, dropout, quantum = (
        nonnegative(f"sensor.{key}", getattr(sensor, key), p, why)
        for key in ("drift", "dropout", "quantum")
    )
    if (dropout >= 1).any():
        raise InputError(f"sensor.dropout: must be a probability below 1, found {dropout.max():g}")
    rate = scalar("sensor.false_alarm_rate", sensor.false_alarm_rate, above=0.0)
    if sensor.threshold is None:
        threshold = np.asarray(noise_threshold(noise, step, rate) + quantum / 2, float)
    else:
        threshold = nonnegative("sensor.threshold", sensor.threshold, p, why)
    return Zone(sensor.kind, right, left, slope, noise, before, threshold, drift, dropout, quantum)
