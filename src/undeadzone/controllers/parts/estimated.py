"""What a controller knows of an arm's gears is what the observer makes of them.

Half gaps, friction and payload stand among the parameters of the model; those that the observer
estimates take the place of the model's, sample by sample (certainty equivalence).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.plants.system import System


def with_estimates(controller: Controller, model: System, uncertain: tuple[str, ...]) -> Controller:
    """The controller of an arm with gears, told what is estimated; of another plant as it is.

    Args:
        controller: whose params have the model's parameters as `model`, if it uses them.
        model: the model that it was built for.
        uncertain: names of the parameters that the observer estimates, as theta.
    """
    if model.gears is None or not uncertain or not hasattr(controller.params, "model"):
        return controller
    places = [model.names.index(name) for name in uncertain]

    def step(p: Any, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
        known = ca.SX(p.model)
        known[places] = estimate.theta
        return controller.step(p._replace(model=known), s, estimate, target)

    return controller._replace(step=step)
