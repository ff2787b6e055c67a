"""Controllers with the observer's estimates of an arm's gears in place of the model's parameters.

Gaps, friction and payload stand among the parameters of the model. The observer's estimates of them
take the place of the model's, sample by sample (certainty equivalence): the gaps are its widths,
right = half + centre and left = half - centre, the others its theta.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.plants.system import System


def use_gear_estimates(
    controller: Controller, model: System, uncertain: tuple[str, ...]
) -> Controller:
    """Return the controller with estimated gears.

    For an arm without gears return the controller itself.

    Args:
        controller: whose params have the model's parameters as `model`, if it uses them.
        model: the model that it was built for.
        uncertain: names of the parameters that the observer estimates, as theta.
    """
    gears = model.gears
    if gears is None:
        return controller
    N = gears.joint_count
    shared = [name for name in uncertain if name in model.names]  # all but wear
    places = list(map(model.names.index, shared))
    found = list(map(uncertain.index, shared))
    halves, centres = ([f"{name}{i + 1}" for i in range(N)] for name in ("half", "centre"))
    gaps = list(map(model.names.index, (*halves, *centres)))

    def step(p: Any, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
        """Return the state and u (m) of the controller with the estimated parameters."""
        known = ca.SX(p.model)
        known[places] = estimate.theta[found]
        right = estimate.right[:N]
        left = estimate.left[:N]
        known[gaps] = ca.vertcat(right + left, right - left) / 2
        return controller.step(p._replace(model=known), s, estimate, target)

    return controller._replace(step=step)
