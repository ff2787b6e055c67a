"""Adaptive output feedback with radial basis functions."""

from __future__ import annotations

from undeadzone.interfaces import Controller
from undeadzone.plants.system import System
from undeadzone_arena.approximators import build_gaussians
from undeadzone_arena.controllers.learned_feedback import FeedbackOptions, build_learned_feedback


class RBFFeedback(FeedbackOptions, frozen=True, kw_only=True, tag="rbf_feedback"):
    """Sanner and Slotine (1992): b u = r^(n) - W'phi(x^) - feedback, phi Gaussians.

    Also Lewis, Yesildirek and Liu (1996). The Gaussians stand at `centres` places per axis. It
    makes y / m, or the observer's inverse of it (`z_inverse`), follow r: with an observer that is
    blind to the dead zone, the wrong output.

    References:
        R. M. Sanner, J.-J. E. Slotine (1992), doi:10.1109/72.165588
        F. L. Lewis, A. Yesildirek, K. Liu (1996), doi:10.1109/72.485674

    Attributes:
        centres: number of Gaussians per axis, at least 2.
        overlap: overlap of neighbours, standard deviation in spacings.
    """

    centres: int = 5
    overlap: float = 0.7

    def build(self, model: System) -> Controller:
        """Build the controller for a linear model with a single input and a single output."""
        return build_learned_feedback(
            model,
            self,
            lambda reach: build_gaussians(
                "controller.centres", reach, self.centres, self.overlap, False
            ),
        )
