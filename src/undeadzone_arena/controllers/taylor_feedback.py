"""Adaptive output feedback with a multidimensional Taylor network."""

from __future__ import annotations

from undeadzone.interfaces import Controller
from undeadzone.plants.system import System
from undeadzone_arena.approximators import build_monomials
from undeadzone_arena.controllers.learned_feedback import FeedbackOptions, build_learned_feedback


class TaylorFeedback(FeedbackOptions, frozen=True, kw_only=True, tag="taylor_feedback"):
    """Multidimensional Taylor network (Yan and Kang 2017): b u = r^(n) - W'phi(x^) - feedback.

    phi are the monomials of x^ / reach up to `degree`. It makes y / m, or the observer's inverse of
    it (`z_inverse`), follow r: with an observer that is blind to the dead zone, the wrong output.

    Attributes:
        degree: highest degree of a monomial.
    """

    degree: int = 3

    def build(self, model: System) -> Controller:
        """Build the controller for a linear model with a single input and a single output."""
        return build_learned_feedback(
            model, self, lambda reach: build_monomials("controller.degree", reach, self.degree)
        )
