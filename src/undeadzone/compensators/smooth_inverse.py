"""Smooth inverse of an actuator's dead zone: its step is spread over a small abs(v)."""

from __future__ import annotations

import numpy as np

from undeadzone.compensators.parts.coasting import Coasts, build_zone_inverse, require_drive
from undeadzone.interfaces import Compensator
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, require_positive

SOFT = 0.1  # of the mean width: |v| over which the step is spread, unless it is given


class SmoothZoneInverse(
    Coasts, frozen=True, kw_only=True, tag_field="method", tag="smooth_inverse"
):
    """`ZoneInverse` with b^ clip(abs(v) / soft, 0, 1) for b^, to spare the actuator.

    Attributes:
        soft: |v| from which the whole width is added, one or one per input [u] (default a tenth of
            the mean width that is known, or of the middle of its range).
    """

    soft: Array | None = None

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model. Raises InputError, ShapeError."""
        drive = require_drive(belief)
        usual = SOFT * np.maximum((drive.right + drive.left) / 2, 1e-12)
        given = usual if self.soft is None else self.soft
        soft = require_positive("compensator.soft", given, model.m, "one per input")
        return build_zone_inverse(self, model, drive, soft)
