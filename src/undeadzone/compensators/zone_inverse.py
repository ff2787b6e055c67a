"""The exact inverse of an actuator's dead zone: it jumps across the zone where v changes sign."""

from __future__ import annotations

from undeadzone.compensators.parts.coasting import Coasts, inverting, require_believed_drive
from undeadzone.errors import InputError
from undeadzone.interfaces import Compensator
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.plants.system import System


class ZoneInverse(Coasts, frozen=True, kw_only=True, tag="inverse"):
    """u = v / m_r + b_r^ for v > 0, v / m_l - b_l^ for v < 0; sampled time only.

    The widths are those that the observer estimates, else those of [model.actuator].
    """

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model."""
        if model.Ts is None:
            raise InputError(
                "compensator.method: the jump of 'inverse' slides in continuous time; use "
                "'smooth_inverse', or sampled time"
            )
        return inverting(self, model, require_believed_drive(belief))
