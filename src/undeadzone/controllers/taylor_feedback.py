"""Adaptive output feedback with a multidimensional Taylor network."""

from __future__ import annotations

import msgspec

from undeadzone.controllers.parts.learned_feedback import approximating
from undeadzone.interfaces import Controller
from undeadzone.numerics.approximators import monomials
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array


class TaylorFeedback(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="taylor_feedback",
):
    """Multidimensional Taylor network (Yan and Kang 2017): b u = r^(n) - W'phi(x^) - feedback, phi the monomials of x^ / reach up to `degree`.

    It makes y / m, or what the observer makes of it (`z_inverse`), follow r: with an observer that is blind to the dead zone, the wrong output.
    reach: |z|, |z'|, ... up to which they hold (one per derivative below the relative degree). speed, bandwidth [1/s]: of its
    observer and of the error, default 40 and 10 times the fastest pole; gain [1/s^2], leak [1/s]: of the weights.
    """

    reach: Array
    degree: int = 3
    speed: float | None = None
    bandwidth: float | None = None
    gain: float | None = None
    leak: float | None = None

    def build(self, model: System) -> Controller:
        """The controller for a linear model of one input and one output. Raises InputError, ShapeError, StructureError."""
        return approximating(
            model,
            self.reach,
            lambda reach: monomials("controller.degree", reach, self.degree),
            self.speed,
            self.bandwidth,
            self.gain,
            self.leak,
        )
