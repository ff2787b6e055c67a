"""All direct looks at a log, before any dynamics: each has its preconditions, or sees nothing."""

from __future__ import annotations

from typing import NamedTuple

from undeadzone.logs.kinds import kind_of
from undeadzone_identify.logs.log import Log
from undeadzone_identify.looks.map import RestMap, map_at_rest
from undeadzone_identify.looks.pushes import FrictionLevel, friction_level
from undeadzone_identify.looks.rate import map_of_rate
from undeadzone_identify.looks.rests import FreePlay, free_play_between_rests
from undeadzone_identify.looks.rows import known_samples
from undeadzone_identify.looks.stillness import ends_of_readings, longest_stillness
from undeadzone_identify.models.estimates import Interval


class Looks(NamedTuple):
    """What is seen directly in a log; None where a look sees nothing.

    Attributes:
        at_rest: the map of readings over commands at rest.
        of_rate: the map of the reading's rate, of an output that integrates.
        stillness: largest travel of the command while the reading stood still [u].
        rests: two rests at one goal.
        friction: level of the friction that a torque overcomes.
        ends: limits of the readings, by "upper" and "lower" [y].
    """

    at_rest: RestMap | None = None
    of_rate: RestMap | None = None
    stillness: float = 0.0
    rests: FreePlay | None = None
    friction: FrictionLevel | None = None
    ends: dict[str, Interval] = {}


def look_at(log: Log) -> Looks:
    """Look at a log with one input and one output.

    Args:
        log: with any times.

    Returns:
        What is seen; nothing of a log with several inputs.
    """
    if log.u.shape[1] > 1 or log.y.shape[1] > 1:
        return Looks()
    t, u, y = known_samples(log.t, log.u[:, 0], log.y[:, 0])
    kind = kind_of(log.inputs[0], log.input_unit)
    read = kind_of(log.outputs[0], log.output_units[0])
    if kind == "torque":
        moves = read in ("position", "speed")
        return Looks(friction=friction_level(t, u, y, read == "speed") if moves else None)
    at_rest = map_at_rest(t if log.has_clock else None, u, y)
    is_seen = at_rest is not None and (
        bool(at_rest.flats) or at_rest.rows.how in ("table", "holds")
    )
    of_rate = None if is_seen else map_of_rate(t, u, y)
    return Looks(
        None if of_rate is not None and of_rate.flats else at_rest,
        of_rate,
        longest_stillness(t, u, y),
        free_play_between_rests(t, u, y) if kind == "goal" and read == "position" else None,
        ends=ends_of_readings(t, u, y),
    )
