"""The exact inverse of an actuator's dead zone: it jumps across the zone where v changes sign."""

from __future__ import annotations

from typing import Any, NamedTuple

from undeadzone.compensators.parts.coasting import (
    Coasts,
    beyond,
    coasted,
    coasting,
    inverted,
    known_drive,
)
from undeadzone.ends.actuator import Belief, Drive
from undeadzone.errors import InputError
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.plants.system import System


class ZoneInverse(Coasts, frozen=True, kw_only=True, tag="inverse"):
    """u = v / m_r + b_r^ for v > 0, v / m_l - b_l^ for v < 0; sampled time only.

    The widths are those that the observer estimates, else those of [model.actuator].
    """

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """The compensator for a model."""
        if model.Ts is None:
            raise InputError(
                "compensator.method: the jump of 'inverse' slides in continuous time; use "
                "'smooth_inverse', or sampled time"
            )
        numbers, first = coasting(self, model)

        def step(q: Params, s: Any, v: Any, estimate: Estimate, reading: Reading) -> Any:
            u = inverted(q.drive, v, *beyond(q.drive, estimate))
            return coasted(q.coasts, s, u, estimate, reading)

        return Compensator(Params(known_drive(belief), numbers), lambda q: first, step)


class Params(NamedTuple):
    """Numbers of the compensator: the believed actuator, and those of coasting."""

    drive: Drive
    coasts: Any
