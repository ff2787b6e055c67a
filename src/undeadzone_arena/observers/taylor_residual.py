"""Taylor network that approximates the offset subtracted from z by the sensor."""

from __future__ import annotations

import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array
from undeadzone_arena.approximators import build_monomials
from undeadzone_arena.observers.parts.learned_residual import (
    LearnedOptions,
    build_residual_observer,
)


class TaylorResidual(LearnedOptions, frozen=True, kw_only=True, tag="taylor_residual"):
    """Multidimensional Taylor network (Yan and Kang 2017): z - y / m = W'phi(z^).

    phi are the powers of z^ / reach up to `degree`.

    Attributes:
        reach: |z| up to which it holds, one or one per output [z] (beyond it, the powers stay
            constant).
        degree: highest power.
    """

    reach: Array
    degree: int = 7

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        basis = build_monomials("observer.degree", np.ones(1), self.degree)
        return build_residual_observer(model, sensor, self, self.reach, basis)
