"""No compensation: the controller's input is the command, or 0 while it coasts."""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.compensators.parts.coasting import Coasts, coast_input, coasting
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.plants.system import System


class NoInverse(Coasts, frozen=True, kw_only=True, tag="none"):
    """u = v: the dead zone of the actuator is left to the feedback."""

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model."""
        numbers, first = coasting(self, model)

        def step(q: Any, s: Any, v: Any, estimate: Estimate, reading: Reading) -> tuple[Any, Any]:
            return coast_input(q, s, ca.SX(v), estimate, reading)

        return Compensator(numbers, lambda q: first, step)
