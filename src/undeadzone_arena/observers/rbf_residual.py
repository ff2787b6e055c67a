"""Radial basis functions that approximate the offset subtracted from z by the sensor."""

from __future__ import annotations

import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array
from undeadzone_arena.approximators import build_gaussians
from undeadzone_arena.observers.parts.learned_residual import (
    LearnedOptions,
    build_residual_observer,
)


class RBFResidual(LearnedOptions, frozen=True, kw_only=True, tag="rbf_residual"):
    """Sanner and Slotine (1992): z - y / m = W'phi(z^), phi Gaussians.

    Gaussian networks for direct adaptive control.

    References:
        R. M. Sanner, J.-J. E. Slotine (1992), doi:10.1109/72.165588

    Attributes:
        reach: |z| up to which the Gaussians lie, one or one per output [z].
        centres: number of Gaussians, at least 2.
        overlap: overlap of neighbours, standard deviation in spacings.
    """

    reach: Array
    centres: int = 9
    overlap: float = 0.7

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        basis = build_gaussians("observer.centres", np.ones(1), self.centres, self.overlap, False)
        return build_residual_observer(model, sensor, self, self.reach, basis)
