"""Fuzzy system that approximates the offset subtracted from z by the sensor."""

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


class FuzzyResidual(LearnedOptions, frozen=True, kw_only=True, tag="fuzzy_residual"):
    """Wang (1993): z - y / m = W'phi(z^), phi the firing strengths of fuzzy sets.

    They are a universal approximator (Wang and Mendel 1992).

    References:
        L.-X. Wang, J. M. Mendel (1992), doi:10.1109/72.159070

    Attributes:
        reach: |z| up to which the sets lie, one or one per output [z].
        rules: number of fuzzy sets, at least 2.
        overlap: overlap of neighbours, standard deviation in spacings.
    """

    reach: Array
    rules: int = 9
    overlap: float = 0.7

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        basis = build_gaussians("observer.rules", np.ones(1), self.rules, self.overlap, True)
        return build_residual_observer(model, sensor, self, self.reach, basis)
