"""The path of a robot's joints that a reference asks for, checked before anything runs."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.joint_path import joint_path, require_range, require_torque
from undeadzone.plants.system import System
from undeadzone.scenario.schema import Scenario
from undeadzone.signals import exosystem as signals
from undeadzone.signals.exosystem import Exosystem
from undeadzone.support.arrays import Floats

CHECKED = 0.01  # [s] between the instants at which a path is checked


def followed(scenario: Scenario, model: System, start: Floats, step: float) -> Exosystem:
    """The path of the flat coordinates: of the joints, or of an elastic joint's link.

    The reference gives it as such, or for the tip.

    Args:
        scenario: the scenario, for its reference and duration.
        model: model of the robot, in continuous time.
        start: the state from which the joints set out (n).
        step: between the instants at which a path of the tip is checked [s].

    Raises:
        InputError: or a subclass; TrackingError where the tip or the motors cannot follow.
    """
    reference, duration = scenario.reference, scenario.simulation.duration
    body = model.arm
    assert body is not None
    t = np.append(np.arange(0.0, duration, max(step, CHECKED)), duration)
    if getattr(reference, "space", "joint") == "joint":
        path = signals.exosystem("reference", reference, model.m)
        if model.m == body.size:
            require_range(body.chain, t, path.value(t), path.value(t, 1))
    elif model.m < body.size:
        raise InputError(
            "reference.space: the path of an elastic joint is its link's angle; use space = 'joint'"
        )
    else:
        task = signals.exosystem("reference", reference, len(body.chain.plane), task=True)
        path = joint_path(body, model.params, task, duration, step, start[: body.size])
    require_torque(model, path, t)
    return path
