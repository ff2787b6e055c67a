"""Exact inverse of an actuator's dead zone, with a jump across the zone at a sign change of v."""

from __future__ import annotations

from undeadzone.compensators.parts.coasting import Coasts, build_zone_inverse, require_drive
from undeadzone.errors import InputError
from undeadzone.interfaces import Compensator
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.plants.system import System


class ZoneInverse(Coasts, frozen=True, kw_only=True, tag="inverse"):
    """Inverse u = v / m_r + b_r^ for v > 0, v / m_l - b_l^ for v < 0, sampled time only.

    The widths are those that the observer estimates, else those of [model.actuator].
    """

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model. Raises InputError in continuous time."""
        if model.Ts is None:
            raise InputError(
                "compensator.method: the jump of 'inverse' slides in continuous time. Use "
                "'smooth_inverse', or sampled time"
            )
        return build_zone_inverse(self, model, require_drive(belief))
