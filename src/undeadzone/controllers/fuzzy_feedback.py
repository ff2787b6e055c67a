"""Adaptive fuzzy output feedback."""

from __future__ import annotations

import msgspec

from undeadzone.controllers.parts.learned_feedback import approximating
from undeadzone.interfaces import Controller
from undeadzone.numerics.approximators import gaussians
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, scalar


class FuzzyFeedback(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="fuzzy_feedback",
):
    """Wang (1993), Tong and Li (2009): b u = r^(n) - W'phi(x^) - feedback, phi the firing strengths of `rules` fuzzy sets per axis.

    It makes y / m, or what the observer makes of it (`z_inverse`), follow r: with an observer that is blind to the dead zone, the wrong output.
    reach: |z|, |z'|, ... up to which the fuzzy sets lie (one per derivative below the relative degree). speed, bandwidth [1/s]: of its
    observer and of the error, default 40 and 10 times the fastest pole; gain [1/s^2], leak [1/s]: of the weights.
    overlap: of neighbours, standard deviation in spacings.
    """

    reach: Array
    rules: int = 5
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
            lambda reach: gaussians("controller.rules", reach, self.rules, overlap, True),
            self.speed,
            self.bandwidth,
            self.gain,
            self.leak,
        )
