"""The actuator ahead of the plant: limit, rate limit, dead zone (docs/actuator.md).

u is the controller's command, and the plant's input is

    m_r (u - b_r) for u > b_r,   m_l (u + b_l) for u < -b_l,   0 between,

after a limit on u and on its rate. For a play it is the level that the limited command drags along:
u - c_r while it moves right in contact, u + c_l while it moves left. Functions take NumPy arrays or
CasADi expressions alike.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.limits import pairs
from undeadzone.nonlinearities.play import apply_backlash
from undeadzone.util.arrays import (
    LARGEST,
    Array,
    Floats,
    require_array,
    require_nonnegative,
    require_ranges,
)
from undeadzone.util.toml import OptionTable

Pairs = list[float | list[float]]


class Actuator(OptionTable, frozen=True, kw_only=True):
    """Actuator between the command u and the plant's m inputs: one number, or one per input.

    Example:
        >>> uz.Actuator(right=0.3, left=0.2).right
        0.3

    See Also:
        Sensor, Scenario, ZoneInverse

    Attributes:
        kind: "deadzone", or "play" (sampled time): the plant's input follows the command once it
            has crossed a gap, as behind a linkage or in a valve that turns.
        right, left: widths b_r, b_l of the dead zone, or gaps c_r, c_l of a play (m) [u] (of a play
            only c_r + c_l matters once it has moved).
        slope: [m_r, m_l], input of the plant per command beyond the zone, one pair, or one per
            input (m x 2); default 1; a play has none.
        limit: [lo, hi], between which the command stays [u], one pair, or one per input (default
            none).
        rate: [falling, rising], largest rates of the command [u/s], one pair, or one per input;
            sampled time only; default none; a play has none.
    """

    kind: Literal["deadzone", "play"] = "deadzone"
    right: Array = 0.0
    left: Array = 0.0
    slope: Pairs | None = None
    limit: Pairs | None = None
    rate: Pairs | None = None


class ActuatorModel(OptionTable, frozen=True, kw_only=True):
    """The actuator as observer and compensator know it. Absent keys are the actuator's own.

    Attributes:
        kind: as in [actuator].
        right, left: widths b_r, b_l (m) [u] (if the observer shall estimate them, a range [lo, hi],
            or a list of one range per input). Gaps of a play are numbers.
        slope: as in [actuator].
        limit: as in [actuator].
        rate: as in [actuator].
    """

    kind: Literal["deadzone", "play"] | None = None
    right: Array | None = None
    left: Array | None = None
    slope: Pairs | None = None
    limit: Pairs | None = None
    rate: Pairs | None = None


class Drive(NamedTuple):
    """A checked actuator.

    Attributes:
        right, left: widths b_r, b_l (m) [u].
        slope_right, slope_left: m_r, m_l (m).
        low, high: limits of the command (m) [u] (`LARGEST`: no limit).
        fall, rise: largest rates of the command (m) [u/s] (`LARGEST`: no limit).
        gap_right, gap_left: c_r, c_l of a play (m) [u] (empty: there is none).
    """

    right: Any
    left: Any
    slope_right: Any
    slope_left: Any
    low: Any
    high: Any
    fall: Any
    rise: Any
    gap_right: Any
    gap_left: Any

    @property
    def is_play(self) -> bool:
        """Return whether the input of the plant depends on past commands."""
        return bool(self.gap_right.shape[0])

    @property
    def has_rate_limit(self) -> bool:
        """Return whether the rate of the command has a limit."""
        return bool((np.minimum(self.fall, self.rise) < LARGEST).any())


class Belief(NamedTuple):
    """Knowledge about an actuator.

    Attributes:
        drive: its numbers (of widths that are not known the middle of their range).
        ranges: [lo, hi] of all b_r, then of all b_l (2m x 2) [u] (None: the widths are known).
    """

    drive: Drive
    ranges: Floats | None


def through_line(line: Any, u: Any) -> tuple[Any, Any]:
    """Return (the line of delays after a command u (m), the command that leaves it), in CasADi.

    Args:
        line: commands under way, the oldest first (delay m) (empty: a command leaves at once).
        u: the command (m).
    """
    commands = ca.vertcat(line, u)
    return commands[u.shape[0] :], commands[: u.shape[0]]


def within_limits(ops: Any, u: Any, drive: Drive) -> Any:
    """Return the command kept within its limits (m)."""
    return ops.fmax(ops.fmin(u, drive.high), drive.low)


def within_rate(ops: Any, u: Any, last: Any, drive: Drive, step: Any) -> Any:
    """Return the command kept within its rate (m).

    Args:
        ops: the module of fmax and fmin, NumPy or CasADi.
        u: command (m) [u].
        last: the one before (m) [u].
        drive: the actuator.
        step: time between both [s].
    """
    return ops.fmax(ops.fmin(u, last + step * drive.rise), last - step * drive.fall)


def pass_command(ops: Any, u: Any, last: Any, drive: Drive, step: Any) -> tuple[Any, Any]:
    """Return (the next state, the command after limits, rate and play) for a command.

    Args:
        ops: the module of fmax and fmin, NumPy or CasADi.
        u: command (m) [u].
        last: previous command of a limited rate, or level of a play (m), else empty.
        drive: the actuator.
        step: time since the command before [s].
    """
    passed = within_limits(ops, u, drive)
    if drive.is_play:
        passed = apply_backlash(ops, passed, last, drive.gap_right, drive.gap_left)
    elif last.shape[0]:
        passed = within_rate(ops, passed, last, drive, step)
    return (passed if last.shape[0] else last), passed


def command_memory(drive: Drive, m: int, sampled: bool) -> Floats:
    """Return the memory of an actuator before its first command: zeros (m), or empty.

    Args:
        drive: the actuator.
        m: number of inputs.
        sampled: whether time is; a rate has no limit else.
    """
    return np.zeros(m if drive.is_play or (drive.has_rate_limit and sampled) else 0)


def input_range(drive: Drive) -> tuple[Floats, Floats]:
    """Return the least and the largest input of the plant that the limits leave (m each)."""
    if drive.is_play:
        return drive.low + drive.gap_left, drive.high - drive.gap_right
    return through_zone(np, drive.low, drive), through_zone(np, drive.high, drive)


def through_zone(ops: Any, u: Any, drive: Drive) -> Any:
    """Return the plant's input (m) for a command that passed limits, rate and play."""
    if drive.is_play:
        return u
    over = drive.slope_right * ops.fmax(u - drive.right, 0.0)
    return over + drive.slope_left * ops.fmin(u + drive.left, 0.0)


def resolve_actuator(actuator: Actuator | ActuatorModel, m: int, key: str = "actuator") -> Drive:
    """Return the checked actuator of a plant with m inputs.

    Args:
        actuator: in a user's words.
        m: number of inputs.
        key: of its table, for messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    why = f"one per input, the plant has {m}"
    right = require_nonnegative(f"{key}.right", _width_or_zero(actuator.right), m, why)
    left = require_nonnegative(f"{key}.left", _width_or_zero(actuator.left), m, why)
    slopes = pairs(f"{key}.slope", actuator.slope, m, [1.0, 1.0], "[m_r, m_l]", "input")
    if not (slopes > 0).all():
        raise InputError(f"{key}.slope: must be positive, found {slopes.min():g}")
    ends = pairs(f"{key}.limit", actuator.limit, m, [-LARGEST, LARGEST], "[lo, hi]", "input")
    low, high = ends.T
    if not ((low < 0) & (high > 0)).all():
        raise InputError(f"{key}.limit: expected lo < 0 < hi, found {actuator.limit}")
    any_rate = [LARGEST, LARGEST]
    rates = pairs(f"{key}.rate", actuator.rate, m, any_rate, "[falling, rising]", "input")
    if not (rates > 0).all():
        raise InputError(
            f"{key}.rate: expected two positive rates [falling, rising], found {actuator.rate}"
        )
    limits = np.clip(ends, -LARGEST, LARGEST)
    rates = np.minimum(rates, LARGEST)
    gaps = np.empty((2, 0))
    if actuator.kind == "play":
        for name in ("slope", "rate"):
            if getattr(actuator, name) is not None:
                raise InputError(f'{key}.{name}: kind = "play" has none. Leave it out')
        gaps = np.stack([right, left])
        right = np.zeros(m)
        left = np.zeros(m)
    return Drive(right, left, *slopes.T, *limits.T, *rates.T, *gaps)


def believe_actuator(given: ActuatorModel | None, m: int) -> Belief | None:
    """Return the knowledge about the actuator, or None without one.

    Args:
        given: as a user tells it; an absent width is 0.
        m: number of inputs.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if given is None:
        return None
    key = "model.actuator"
    ranges = {}
    for side in SIDES:
        interval = _range(f"{key}.{side}", _width_or_zero(getattr(given, side)), m)
        if interval is not None:
            ranges[side] = interval
    if ranges and given.kind == "play":
        side = next(iter(ranges))
        raise InputError(
            f"{key}.{side}: the gaps of a play must be known numbers, found a range "
            f"{getattr(given, side)}. Give a number, `undeadzone identify` measures it from a log"
        )
    if not ranges:
        return Belief(resolve_actuator(given, m, key), None)
    for side, other in (SIDES, SIDES[::-1]):
        if side not in ranges:
            raise InputError(
                f"{key}.{side}: must be a range too where {other} is one. Write "
                f"{side} = [lo, hi], narrow if it is known"
            )
    middles = {side: interval.mean(axis=1).tolist() for side, interval in ranges.items()}
    drive = resolve_actuator(msgspec.structs.replace(given, **middles), m, key)
    return Belief(drive, np.concatenate([*ranges.values()]))


SIDES = ("right", "left")


def _width_or_zero(width: Any) -> Any:
    """Return a width, or 0 if none is given."""
    return 0.0 if width is None else width


def _range(key: str, value: Any, m: int) -> Floats | None:
    """Ranges of one side (m x 2), or None if the widths are numbers. Raises InputError."""
    given = require_array(key, value)
    if given.shape not in ((2,), (m, 2)) or (given.ndim == 1 and m == 2):
        return None
    ranges = np.broadcast_to(given, (m, 2))
    require_ranges(key, ranges, value)
    return ranges
