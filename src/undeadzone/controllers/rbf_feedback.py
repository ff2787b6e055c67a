"""Adaptive output feedback with radial basis functions."""

from __future__ import annotations

import msgspec

from undeadzone.controllers.parts.learned_feedback import approximating
from undeadzone.interfaces import Controller
from undeadzone.numerics.approximators import gaussians
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, scalar


class RBFFeedback(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="rbf_feedback",
):
    """Sanner and Slotine (1992), Lewis, Yesildirek and Liu (1996): b u = r^(n) - W'phi(x^) - feedback, phi Gaussians at `centres` places per axis.

    It makes y / m, or what the observer makes of it (`z_inverse`), follow r: with an observer that is blind to the dead zone, the wrong output.
    reach: |z|, |z'|, ... up to which the Gaussians lie (one per derivative below the relative degree). speed, bandwidth [1/s]: of its
    observer and of the error, default 40 and 10 times the fastest pole; gain [1/s^2], leak [1/s]: of the weights.
    overlap: of neighbours, standard deviation in spacings.
    """

    reach: Array
    centres: int = 5
    overlap: float = 0.7
    speed: float | None = None
    bandwidth: float | None = None
    gain: float | None = None
    leak: float | None = None

    def build(self, model: System) -> Controller:
        """The controller for a linear model of one input and one output. Raises InputError, ShapeError, StructureError."""
        overlap = scalar("controller.overlap", self.overlap, above=0.0)
        return approximating(
            model,
            self.reach,
            lambda reach: gaussians("controller.centres", reach, self.centres, overlap, False),
            self.speed,
            self.bandwidth,
            self.gain,
            self.leak,
        )
