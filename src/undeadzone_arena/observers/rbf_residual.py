"""A radial basis function network learns what the sensor takes off z."""

from __future__ import annotations

import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, scalar
from undeadzone_arena.approximators import gaussians
from undeadzone_arena.observers.parts.learned_residual import LearnedOptions, residual


class RBFResidual(LearnedOptions, frozen=True, kw_only=True, tag="rbf_residual"):
    """Sanner and Slotine (1992): z - y / m = W'phi(z^), phi Gaussians.

    Gaussian networks for direct adaptive control.

    Attributes:
        reach: |z| up to which the Gaussians lie, one or one per output [z].
        centres: number of Gaussians, at least 2.
        overlap: overlap of neighbours, standard deviation in spacings.
    """

    reach: Array
    centres: int = 9
    overlap: float = 0.7

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model, continuous or sampled."""
        overlap = scalar("observer.overlap", self.overlap, above=0.0)
        basis = gaussians("observer.centres", np.ones(1), self.centres, overlap, False)
        return residual(model, sensor, self, self.reach, basis)
