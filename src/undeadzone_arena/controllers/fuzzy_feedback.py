"""Adaptive fuzzy output feedback."""

from __future__ import annotations

from undeadzone.interfaces import Controller
from undeadzone.plants.system import System
from undeadzone_arena.approximators import build_gaussians
from undeadzone_arena.controllers.learned_feedback import FeedbackOptions, build_learned_feedback


class FuzzyFeedback(FeedbackOptions, frozen=True, kw_only=True, tag="fuzzy_feedback"):
    """Wang (1993), Tong and Li (2009): b u = r^(n) - W'phi(x^) - feedback, phi of fuzzy sets.

    phi are the firing strengths of `rules` fuzzy sets per axis. It makes y / m, or the observer's
    inverse of it (`z_inverse`), follow r: with an observer that is blind to the dead zone, the
    wrong output.

    Attributes:
        rules: number of fuzzy sets per axis, at least 2.
        overlap: overlap of neighbours, standard deviation in spacings.
    """

    rules: int = 5
    overlap: float = 0.7

    def build(self, model: System) -> Controller:
        """Build the controller for a linear model with a single input and a single output."""
        return build_learned_feedback(
            model,
            self,
            lambda reach: build_gaussians(
                "controller.rules", reach, self.rules, self.overlap, True
            ),
        )
