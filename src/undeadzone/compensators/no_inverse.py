"""Compensator without an inverse: the command is the controller's input, or 0 during a coast."""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.compensators.parts.coasting import Coasts, apply_coasting, start_coasting
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.plants.system import System


class NoInverse(Coasts, frozen=True, kw_only=True, tag="none"):
    """Identity u = v: the feedback alone copes with the actuator's dead zone."""

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model."""
        numbers, first = start_coasting(self, model)

        def step(q: Any, s: Any, v: Any, estimate: Estimate, reading: Reading) -> tuple[Any, Any]:
            """Return the next state, and v or 0 as the command u (m)."""
            return apply_coasting(q, s, ca.SX(v), estimate, reading)

        return Compensator(numbers, lambda q: first, step)
