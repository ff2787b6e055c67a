"""The path of a robot's joints that a scenario's reference asks for, checked before anything runs."""

from __future__ import annotations

from undeadzone import signals
from undeadzone.errors import InputError
from undeadzone.plant import System
from undeadzone.scenario import Scenario
from undeadzone.signals import Exosystem


def followed(scenario: Scenario, model: System, step: float) -> Exosystem:
    """The path of the flat coordinates: the joints' (elastic joint: the link's). Raises InputError, TrackingError where it cannot be followed."""
    if getattr(scenario.reference, "space", "joint") == "joint":
        return signals.exosystem("reference", scenario.reference, model.m)
    raise InputError("reference.space")
