"""The observer and the controller of a scenario that names none (docs/decisions.md)."""

from __future__ import annotations

from typing import Final

import numpy as np

from undeadzone.catalogue import CONTROLLERS, OBSERVERS, ControllerOptions, ObserverOptions
from undeadzone.observers.parts.claims import Claims
from undeadzone.plants.options import Plant
from undeadzone.plants.robots.options import ElasticJoint
from undeadzone.sensor import Sensor

VAGUE: Final = 3.0  # in largest widths: where the widths lie if nothing is declared
BANDWIDTH: Final = 10.0  # of a rigid arm [rad/s]


def vague_claims(sensor: Sensor) -> Claims:
    """That the widths lie between 0 and `VAGUE` times the largest; nothing else is claimed."""
    largest = float(max(np.max(sensor.right), np.max(sensor.left)))
    return Claims(right=[0.0, VAGUE * (largest or 1.0)])


def usual_observer(sensor: Sensor, declared: Claims | None) -> ObserverOptions:
    """`auto`, with what is declared.

    Args:
        sensor: the dead zone, whose widths count if nothing is declared.
        declared: the claims of the scenario.
    """
    claims = vague_claims(sensor) if declared is None else declared
    return OBSERVERS.made("auto", **claims.claims())


def usual_controller(plant: Plant, sampled: bool) -> ControllerOptions:
    """What follows a reference with this kind of plant: no option depends on units.

    Args:
        plant: the plant.
        sampled: whether time is sampled.
    """
    if plant.arm is None:
        return CONTROLLERS.made("state_feedback")
    if not isinstance(plant.arm, ElasticJoint):
        return CONTROLLERS.made("computed_torque", bandwidth=BANDWIDTH)
    return CONTROLLERS.made("lqr" if sampled else "state_feedback")
