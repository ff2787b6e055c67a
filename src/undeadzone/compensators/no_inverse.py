"""No compensation: the controller's input is the command, or 0 while it coasts."""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.actuator import Belief
from undeadzone.compensators.parts.coasting import Coasts, coasted, coasting
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.plants.system import System


class NoInverse(
    Coasts, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="none"
):
    """u = v: the dead zone of the actuator is left to the feedback."""

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """The compensator for a model.

        Args:
            model: the model of the plant, continuous or sampled.
            belief: what is known of the actuator.

        Raises:
            InputError: for an option that it cannot take.
        """
        numbers, first = coasting(self, model)

        def step(q: Any, s: Any, v: Any, estimate: Estimate, reading: Reading) -> tuple[Any, Any]:
            return coasted(q, s, ca.SX(v), estimate, reading)

        return Compensator(numbers, lambda q: first, step)
