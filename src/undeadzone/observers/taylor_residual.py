"""A multidimensional Taylor network that learns what the sensor takes off z."""

from __future__ import annotations

import msgspec
import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.numerics.approximators import monomials
from undeadzone.observers.parts.learned_residual import residual
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array


class TaylorResidual(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="taylor_residual",
):
    """Multidimensional Taylor network (Yan and Kang 2017): z - y / m = W'phi(z^), phi the powers of z^ / reach up to `degree`.

    reach: |z| up to which it holds, one or one per output [z]; beyond, the powers stay as they are.
    L, poles [1/s] or speed [1/s]: of A - L C (default: a speed of 6 mean poles of the plant, fewer beyond second order); gain [1/s], leak:
    of the normalised gradient (default: 30 times the fastest pole) with e-modification; filtered: learn by the
    sensitivity of the error, so that fast poles do less harm; false is the law as published.
    """

    reach: Array
    degree: int = 7
    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    gain: float | None = None
    leak: float = 0.0
    filtered: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StructureError."""
        basis = monomials("observer.degree", np.ones(1), self.degree)
        return residual(model, sensor, self, basis)
