"""The reference line of what knowing the widths is worth: the certified observer with the true d_r, d_l."""

from __future__ import annotations

import msgspec
import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.observers.certified import measured_side
from undeadzone.observers.parts.gain import gains
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array


class Oracle(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="oracle",
):
    """Known-width observer: L (n x p) as in `Certified`; it is told the sensor's true widths and adapts nothing."""

    L: Array | None = None
    silence: bool = False

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises ShapeError."""
        widths = np.stack([sensor.right, sensor.left], axis=1)
        return measured_side(
            model,
            sensor,
            gains(self.L, model),
            np.zeros(model.p),
            np.zeros(model.n),
            widths,
            np.full(model.p, np.inf),
            self.silence,
        )
