"""Oracle: the certified observer with the true widths, a reference for the value of known
widths.
"""

from __future__ import annotations

import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.adaptive.branch_observer import build_branch_observer
from undeadzone.observers.adaptive.gain import innovation_gain
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array


class Oracle(Options, frozen=True, kw_only=True, tag="oracle"):
    """Known-width observer: it has the sensor's true widths and adapts nothing.

    Attributes:
        L: gains (n x p) [1/s], as in `Certified` (default P^-1 C').
        silence: use also that a silent sensor bounds z.
    """

    L: Array | None = None
    silence: bool = False

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model, continuous or sampled."""
        widths = np.stack([sensor.right, sensor.left], axis=1)
        gain = innovation_gain(self.L, model)
        gamma = np.zeros(model.p)
        start = np.zeros(model.n)
        limit = np.full(model.p, np.inf)
        return build_branch_observer(model, sensor, gain, gamma, start, widths, limit, self.silence)
