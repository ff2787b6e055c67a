"""Adaptive output feedback with a multidimensional Taylor network."""

from __future__ import annotations

from undeadzone.controllers.parts.learned_feedback import FeedbackOptions, approximating
from undeadzone.interfaces import Controller
from undeadzone.numerics.approximators import monomials
from undeadzone.plants.system import System


class TaylorFeedback(
    FeedbackOptions,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="taylor_feedback",
):
    """Multidimensional Taylor network (Yan and Kang 2017): b u = r^(n) - W'phi(x^) - feedback.

    phi are the monomials of x^ / reach up to `degree`. It makes y / m, or what the observer makes
    of it (`z_inverse`), follow r: with an observer that is blind to the dead zone, the wrong
    output.

    Attributes:
        degree: highest degree of a monomial.
    """

    degree: int = 3

    def build(self, model: System) -> Controller:
        """The controller for a linear model of one input and one output.

        Args:
            model: the model that it computes with.

        Raises:
            InputError: for an option that it cannot take, or a model that it is not for.
            ShapeError: for an option of another shape.
            StructureError: for a model on which it does not exist.
        """
        return approximating(
            model, self, lambda reach: monomials("controller.degree", reach, self.degree)
        )
