"""The output deadzone, equations (1)-(13) as corrected in docs/model.md.

The widths d_r, d_l are positive, and the reading is y = m (z - Sat z). Every function takes NumPy
arrays or CasADi expressions alike. z is the true output, y the reading, right = d_r and left = d_l
the widths (unit of z), m the slope (unit of y per unit of z).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities import play
from undeadzone.nonlinearities.limits import (
    Limits,
    at_limit,
    limits_of,
    require_range,
    require_readings,
)
from undeadzone.nonlinearities.play import KEY, Ahead, gaps_of
from undeadzone.util.arrays import (
    LARGEST,
    Array,
    Floats,
    require_array,
    require_nonnegative,
    require_number,
    require_vector,
)
from undeadzone.util.toml import OptionTable

# sides; 0 is silent, twice a side is at the limit of its readings
RIGHT = 1.0
LEFT = -1.0
# Weights of d_r and d_l, or of c_r and c_l, in what is known of a pair of widths. The centre is the
# middle of the interval from -d_l to d_r.
DIRECTIONS = {"right": (1.0, 0.0), "left": (0.0, 1.0), "width": (1.0, 1.0), "centre": (0.5, -0.5)}
SHAPE = ("rounding", "slope_std", "lag")  # what observers may assume of a sensor's shape
FALSE_ALARMS = 0.01  # rate at which noise may exceed a default threshold, in poles of the plant


def heaviest(weights: Sequence[float]) -> float:
    """Return the largest size among the weights of a sum: 1 of a width, 0.5 of a centre.

    Limits and roundings that one edge has are those of the sum times this.
    """
    return max(map(abs, weights))


def _ops(*values: Any) -> Any:
    """Return CasADi when any value is a CasADi expression, else NumPy.

    fmax, fmin and tanh have the same names in both.
    """
    if any(type(value).__module__.startswith("casadi") for value in values):
        import casadi

        return casadi
    return np


def saturation(z: Any, right: Any, left: Any) -> Any:
    """Return sat z of (4): z limited to [-d_l, d_r]."""
    ops = _ops(z, right, left)
    return ops.fmax(ops.fmin(z, right), -left)


def deadzone(z: Any, right: Any, left: Any, slope: Any = 1.0) -> Any:
    """Return the reading y = m (z - Sat z) of (1), (3), (14); exactly 0 inside the zone."""
    return slope * (z - saturation(z, right, left))


def zone(z: Any, right: Any, left: Any) -> Any:
    """Return the place of the true output: +1 beyond d_r, -1 below -d_l, 0 inside."""
    return 1.0 * (z > right) - 1.0 * (z < -left)


def jump(z: Any, right: Any, left: Any, slope: Any = 1.0) -> Any:
    """Return the reading of a jump sensor: m z outside the zone, 0 inside (velocity sensors)."""
    return slope * z * (1.0 * (z > right) + 1.0 * (z < -left))


def present(y: Any) -> Any:
    """Return 1 if a reading is a finite number, 0 if it is missing (NaN, infinite).

    CasADi takes y == y for true, so the reading is compared with large numbers.
    """
    return 1.0 * (y < 1e300) * (y > -1e300)


def side(y: Any, threshold: Any = 0.0, limits: Limits | None = None) -> Any:
    """Return the measured side: +1 if y > threshold, -1 if y < -threshold, else 0.

    0 is silent, also for NaN. +2 and -2 are at the limits of the range, if there are any: there z
    is at least, or at most, the reading.
    """
    measured = 1.0 * (y > threshold) - 1.0 * (y < -threshold)
    return measured if limits is None else measured + at_limit(y, limits)


def indicators(y: Any, sharpness: Any) -> tuple[Any, Any]:
    """Return the paper's smooth (chi_r, chi_l) of (8)-(10), sgn replaced by tanh(k_s y).

    Both are 1/2 at y = 0. sharpness is k_s [1/y].
    """
    sign = _ops(y, sharpness).tanh(sharpness * y)
    return (1.0 + sign) / 2.0, (1.0 - sign) / 2.0


def quantise(y: Any, quantum: Any) -> Any:
    """Return the reading rounded to a multiple of its quantum (an encoder's), itself where that is
    0.
    """
    ops = _ops(y, quantum)
    step = quantum + (quantum == 0)
    rounded = step * ops.floor(y / step + 0.5)
    return y * (quantum == 0) + rounded * (quantum != 0)


def offset(side: Any, right: Any, left: Any) -> Any:
    """Return chi_bar d of (12) with chi_bar = [chi_r, -chi_l].

    The dead zone subtracts it from z on that side (+1, -1; 0 where silent).
    """
    return right * (side > 0) - left * (side < 0)


def branch(z: Any, zone: Any, right: Any, left: Any, slope: Any, kind: str) -> Any:
    """Return the reading on a given branch, continued beyond its edge.

    It is m (z - chi_bar d), m z for a jump sensor, 0 inside.

    Args:
        z: true output.
        zone: the branch, +1, -1, or 0 inside.
        right, left: widths d_r, d_l [z].
        slope: m [y/z].
        kind: "deadzone" or "jump".
    """
    shift = 0.0 if kind == "jump" else offset(zone, right, left)
    return slope * (z - shift) * (zone != 0)


def inverse(
    y: Any, side: Any, right: Any, left: Any, slope: Any = 1.0, kind: str = "deadzone"
) -> Any:
    """Return the deadzone inverse (26): y / m + chi_bar d on the measured side.

    It is y / m inside the zone, for the jump kind and for an encoder beside gears.

    Args:
        y: reading.
        side: the measured side, +1, -1, or 0 where silent.
        right, left: widths d_r, d_l [z].
        slope: m [y/z].
        kind: as of a `Zone`.
    """
    shift = 0.0 if kind in ("jump", "gears") else offset(side, right, left)
    return y / slope + shift


def edges(
    right: Any, left: Any, slope: Any, kind: str, threshold: Any, noise: Any = 0.0
) -> tuple[Any, Any]:
    """Return (z_r, z_l): the measured side is right above z_r and left below -z_l.

    Noise beyond the threshold moves an edge across the zone: then the zone itself reads as that
        side.

    Args:
        right, left: widths d_r, d_l [z].
        slope: m [y/z].
        kind: "deadzone" or "jump".
        threshold: |y| that counts as silent [y].
        noise: a number added to y [y].
    """
    right_margin = (threshold - noise) / slope
    left_margin = (threshold + noise) / slope
    return _edge(right, left, right_margin, kind), _edge(left, right, left_margin, kind)


def _edge(own: Any, other: Any, margin: Any, kind: str) -> Any:
    """Return |z| from which a side is read.

    Args:
        own, other: widths of this side and of the other [z].
        margin: the threshold less noise towards this side, over the slope [z]; negative where noise
            alone exceeds the threshold.
        kind: "deadzone" or "jump".
    """
    if kind == "jump":
        ops = _ops(own, other, margin)
        outer = ops.fmax(own, margin)
        inner = ops.fmin(-other, margin)
    else:
        outer = own + margin
        inner = margin - other
    return outer * (margin >= 0) + inner * (margin < 0)


def saturation_bound(right: Any, left: Any) -> Any:
    """Return the least d_M of (2) as corrected, d_r + d_l <= d_M; it bounds |Sat z| too, as (13)
    asks.
    """
    return right + left


def noise_threshold(noise: Floats, step: float, rate: float) -> Floats:
    """Return |y| below which a reading counts as silent (p) [y].

    White noise of that rms then gives `rate` false alarms per second.

    Args:
        noise: rms of the reading's noise (p) [y].
        step: time between readings [s].
        rate: false alarms [1/s].
    """
    if not noise.any():
        return np.zeros_like(noise)
    from statistics import NormalDist

    chance = min(0.5, max(rate * step / 2.0, np.finfo(float).tiny))
    return np.asarray(noise * -NormalDist().inv_cdf(chance), float)


class Sensor(OptionTable, frozen=True, kw_only=True):
    """An output deadzone of p outputs; each array is one number or one per output.

    Example:
        >>> sensor = uz.Sensor(right=1.0, left=0.6, noise=0.01)
        >>> sensor.right, sensor.left
        (1.0, 0.6)

    See Also:
        Actuator, Scenario

    Attributes:
        right, left: widths d_r, d_l of the dead zone, or gaps c_r, c_l of a play (p) [z]; inf: the
            zone has no edge on that side (of a dead zone or a jump).
        kind: "deadzone": the reading is m (z - Sat z); "jump": it is m z outside the zone, as of
            velocity sensors; "play", or its other name "backlash" (sampled time): the reading
            holds while z crosses the gap.
        slope: m, the reading per true output (p) [y/z].
        noise: rms of the noise added after the deadzone (p) [y].
        noise_before: rms of the noise added to z ahead of the deadzone (p) [z]; not of a play.
        threshold: |y| that counts as silent (p) [y]; default: from noise, false_alarm_rate and
            quantum. Of a play: the change of y over `window` that counts as motion.
        false_alarm_rate: rate at which noise alone may exceed the default threshold [1/s]; default
            a hundredth of the plant's mean pole, of a play a millionth.
        quantum: the reading is rounded to its multiples, as an encoder's (p) [y]; sampled time
            only.
        drift: log d_r and log d_l walk at random, each for itself, by drift sqrt(t) rms
            (p) [1/sqrt(s)].
        dropout: probability that a reading is missing (p), below 1.
        range: [lo, hi], lo < 0 < hi: where readings end, after noise and rounding; one pair, or one
            per output (p x 2) [y]; -inf and inf are no limits; default: none. A reading at its
            limit only bounds z from one side; of a play it is missing.
        start: reading of a play before the first sample (p) [y]; the first one is the nearest
            possible to it. Of a play ahead of a dead zone what would be read without the zone.
        window: time over which a play's motion is judged where readings are noisy [s]; default a
            25th of the plant's period.
        play: [c_r, c_l], gaps of a play ahead of a dead zone, or one such pair per output (p x 2);
            sampled time; default: there is none [z].
        load_friction: input that Coulomb friction behind a play takes while it moves, of a plant of
            one input and one output; a pair is a range, which observers estimate [u].
        load_inertia: input that a load behind a play takes per acceleration; it shows whether the
            load rests in its gap (p) [u s^2/z].
        rounding: how far about an edge observers take the characteristic for round, 0 if its edges
            are sharp (p) [z] (default 7 % of the smaller middle of the declared ranges). A
            simulated sensor has sharp edges.
        slope_std: relative standard deviation of the slope to observers, alike on both sides; 0:
            it is known (p) [1]; default 0.06. A simulated sensor has `slope` itself.
        lag: standard deviation of an unknown delay behind the zone to observers; 0: it reads at
            once (p) [s]; default 5 samples, at most a 16th of the plant's period. A simulated
            sensor reads at once. Beside an actuator whose widths are estimated the default of all
            three is 0.
    """

    right: Array
    left: Array
    kind: Literal["deadzone", "jump", "play", "backlash"] = "deadzone"
    slope: Array = 1.0
    noise: Array = 0.0
    noise_before: Array = 0.0
    threshold: Array | None = None
    false_alarm_rate: float | None = None
    quantum: Array = 0.0
    drift: Array = 0.0
    dropout: Array = 0.0
    range: list[float | list[float]] | None = None
    start: Array = 0.0
    window: float | None = None
    play: Array | None = None
    load_friction: Array = 0.0
    load_inertia: Array = 0.0
    rounding: Array | None = None
    slope_std: Array | None = None
    lag: Array | None = None

    def __post_init__(self) -> None:
        """Store the kind "backlash" under its one internal name, "play"."""
        if self.kind == "backlash":
            msgspec.structs.force_setattr(self, "kind", "play")


class Zone(msgspec.Struct, frozen=True):
    """A `Sensor` checked and spread over p outputs, with its silence threshold decided.

    Attributes:
        kind: "deadzone", "jump" or "play"; "gears" of encoders beside gears.
        right, left: widths d_r, d_l, of a play or gears their gaps, at t = 0 (p) [z] (`LARGEST`: no
            edge).
        slope: m (p) [y/z].
        noise: rms of the noise after the deadzone (p) [y].
        noise_before: rms of the noise ahead of the deadzone (p) [z].
        threshold: |y| that counts as silent (p) [y]; of a play the change over `window` readings
            that counts as motion.
        drift: rms of the random walks of log d_r and log d_l (p) [1/sqrt(s)].
        dropout: probability that a reading is missing (p).
        quantum: the reading is rounded to its multiples (p) [y]; 0: it is not.
        low, high: least and largest reading (p) [y]; -inf, inf: no limit.
        start: level of a play before the first sample (p) [z].
        window: readings over which a play's motion is judged.
        friction: of the load behind a play (p) [u].
        inertia: of the same (p) [u s^2/z].
        friction_std: standard deviation of the friction, to an observer that is not told (p) [u].
        play: ahead of the dead zone; None: there is none.
        rounding: of the edges, to an observer (p) [z]; None: its default.
        slope_std: relative one of the slope, to an observer (p); None: its default.
        lag: deviation of a delay behind the zone, to an observer (p) [s]; None: its default.
    """

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
    low: Floats
    high: Floats
    start: Floats
    window: int
    friction: Floats
    inertia: Floats
    friction_std: Floats
    play: Ahead | None = None
    rounding: Floats | None = None
    slope_std: Floats | None = None
    lag: Floats | None = None

    @property
    def absent(self) -> np.ndarray:
        """Return whether the right and the left edge do not exist (2 x p)."""
        return np.stack([self.right, self.left]) == LARGEST

    @property
    def widest(self) -> Floats:
        """Return the largest width that exists (p) [z]."""
        return np.where(self.absent, 0.0, [self.right, self.left]).max(axis=0)

    @property
    def moves(self) -> bool:
        """Return whether it is a play, or has one: its readings depend on the motion of z."""
        return self.kind == "play" or self.play is not None

    @property
    def limits(self) -> Limits | None:
        """Return the limits of the readings, or None if no output has any."""
        return limits_of(self.low, self.high)

    @property
    def rms(self) -> Floats:
        """Return the rms error of a reading on an active side (p) [z].

        The sum of noise ahead of and after the zone, and rounding.
        """
        noise = np.hypot(self.noise / self.slope, self.noise_before)
        rounding = self.quantum / self.slope / np.sqrt(12)
        return np.hypot(noise, rounding)


def with_edges_beyond(sensor: Zone, z: Floats) -> Zone:
    """Return the sensor with finite widths, that of an edge that does not exist beyond all outputs.

    Args:
        sensor: the dead zone.
        z: outputs (N x p).
    """
    beyond = 2 * np.abs(z).max(axis=0)
    widths = np.where(sensor.absent, beyond, [sensor.right, sensor.left])
    return msgspec.structs.replace(sensor, right=widths[0], left=widths[1])


def _width(key: str, value: Array, p: int) -> Floats:
    """Return the widths of one side (p). Raises InputError, ShapeError."""
    given = np.clip(require_array(key, value, infinite=True), -LARGEST, LARGEST)
    widths = require_vector(key, given, p, f"one per output, the plant has {p}")
    if (widths < 0).any():
        raise InputError(
            f"{key}: must not be negative, found {widths.min():g}. It is a width, from 0 to the "
            "edge on that side"
        )
    return widths


def resolve(sensor: Sensor, p: int, step: float, pace: float = 1.0) -> Zone:
    """Return the checked sensor of a plant.

    Args:
        sensor: the sensor in a user's words.
        p: number of the plant's outputs.
        step: time between readings [s], for the default threshold.
        pace: how fast the plant moves [1/s], for the default rate of false alarms.

    Raises:
        InputError: or a subclass, that names the key.
    """
    why = f"one per output, the plant has {p}"
    right = _width("sensor.right", sensor.right, p)
    left = _width("sensor.left", sensor.left, p)
    slope = require_vector("sensor.slope", sensor.slope, p, why)
    if (slope <= 0).any():
        raise InputError(f"sensor.slope: must be positive (A3), found {slope.min():g}")
    noise = require_nonnegative("sensor.noise", sensor.noise, p, why)
    before = require_nonnegative("sensor.noise_before", sensor.noise_before, p, why)
    drift = require_nonnegative("sensor.drift", sensor.drift, p, why)
    dropout = require_nonnegative("sensor.dropout", sensor.dropout, p, why)
    quantum = require_nonnegative("sensor.quantum", sensor.quantum, p, why)
    if (dropout >= 1).any():
        raise InputError(f"sensor.dropout: must be a probability below 1, found {dropout.max():g}")
    start = require_vector("sensor.start", sensor.start, p, why) / slope
    window = _window(sensor, step, pace)
    rate = (play.FALSE_ALARMS if sensor.kind == "play" else FALSE_ALARMS) * pace
    if sensor.false_alarm_rate is not None:
        rate = require_number("sensor.false_alarm_rate", sensor.false_alarm_rate, above=0.0)
    if sensor.threshold is not None:
        threshold = require_nonnegative("sensor.threshold", sensor.threshold, p, why)
    elif sensor.kind == "play":
        threshold = _motion(noise, quantum, window, step, rate)
    else:
        threshold = np.asarray(noise_threshold(noise, step, rate) + quantum / 2, float)
    low, high = require_range("sensor.range", sensor.range, p)
    require_readings(low, high, threshold)
    numbers = (slope, noise, before, threshold, drift, dropout, quantum, low, high)
    load = _load(sensor, p)
    ahead = _ahead(sensor, p, _motion(noise, quantum, window, step, play.FALSE_ALARMS * pace))
    shape = [_shape(name, sensor, p) for name in SHAPE]
    zone = Zone(sensor.kind, right, left, *numbers, start, window, *load, ahead, *shape)
    if zone.absent.all(axis=0).any() or (zone.absent.any() and zone.moves):
        raise InputError(
            "sensor.right, left: inf, no edge, stands for one of two edges of a dead zone or a jump"
            " without a play. Give a number"
        )
    return zone


def _shape(name: str, sensor: Sensor, p: int) -> Floats | None:
    """Return what observers are to assume of the sensor's shape (p); None: their default.

    Raises InputError, ShapeError.
    """
    given = getattr(sensor, name)
    if given is None:
        return None
    value = require_nonnegative(f"sensor.{name}", given, p, f"one per output, the plant has {p}")
    if value.any() and (sensor.kind != "deadzone" or sensor.play is not None):
        raise InputError(
            f"sensor.{name}: only a dead zone without a play has one, found {value.max():g}. "
            "Leave it out, or set it to 0"
        )
    return value


def _motion(noise: Floats, quantum: Floats, window: int, step: float, rate: float) -> Floats:
    """Return change of a reading over the window that noise alone exceeds at a rate [1/s] (p)
    [y].
    """
    # the least-squares slope over the window, times the window, has this rms
    spread = np.sqrt(12 / window)
    rms = np.hypot(noise, quantum / np.sqrt(12))
    return np.asarray(spread * noise_threshold(rms, step, rate))


def _ahead(sensor: Sensor, p: int, threshold: Floats) -> Ahead | None:
    """Return the play ahead of the dead zone, or None if there is none. Raises InputError."""
    if sensor.play is None:
        return None
    if sensor.kind != "deadzone":
        raise InputError(
            f'{KEY}: stands ahead of kind = "deadzone", found "{sensor.kind}". A play alone has '
            "its gaps in sensor.right and sensor.left"
        )
    (right, left), ranges = gaps_of(sensor.play, p)
    if ranges is None and not right.any() and not left.any():
        return None
    return Ahead(right, left, ranges, threshold)


def _load(sensor: Sensor, p: int) -> tuple[Floats, Floats, Floats]:
    """Return (friction, inertia, std of the friction) behind a play (p each). Raises InputError."""
    why = f"one per output, the plant has {p}"
    friction = sensor.load_friction
    std = np.zeros(p)
    if np.size(friction) == 2:
        ends = require_nonnegative("sensor.load_friction", friction, 2, "[least, largest]")
        if p != 1 or ends[0] > ends[1]:
            raise InputError(
                "sensor.load_friction: expected a number or [least, largest] of a single output, "
                f"found {ends.tolist()} for {p}"
            )
        friction = ends.mean()
        std = np.diff(ends) / np.sqrt(12)
    known = require_nonnegative("sensor.load_friction", friction, p, why)
    inertia = require_nonnegative("sensor.load_inertia", sensor.load_inertia, p, why)
    for name, given in (("load_friction", known), ("load_inertia", inertia)):
        if sensor.kind != "play" and given.any():
            raise InputError(f"sensor.{name}: only a play has a load behind it. Leave it out")
    if ((inertia > 0) & (known == 0)).any():
        raise InputError(
            "sensor.load_friction: a load with inertia and without friction coasts through its "
            "gap. Give both, or neither"
        )
    return known, inertia, std


def _window(sensor: Sensor, step: float, pace: float) -> int:
    """Return readings over which a play's motion is judged. Raises InputError."""
    if sensor.kind != "play" and sensor.play is None:
        for name, given in (("start", np.any(sensor.start)), ("window", sensor.window)):
            if given:
                raise InputError(f"sensor.{name}: only a play has one. Leave it out")
        return 1
    if np.any(sensor.noise_before):
        raise InputError(
            "sensor.noise_before: noise ahead of a play drives it like a ratchet, which no method "
            "here knows. Give sensor.noise"
        )
    if sensor.window is None:
        return play.readings_of_motion(step, pace)
    count = round(require_number("sensor.window", sensor.window, above=0.0) / step)
    if count < play.FEWEST:
        raise InputError(
            f"sensor.window: must last at least {play.FEWEST} samples of {step:g} s, found "
            f"{sensor.window:g} s"
        )
    return count
