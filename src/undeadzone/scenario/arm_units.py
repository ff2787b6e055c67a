"""The units of a scenario of an arm that names none: SI."""

from __future__ import annotations

import msgspec

from undeadzone.plants.system import System
from undeadzone.scenario.schema import Scenario, Units


def with_units(scenario: Scenario, plant: System) -> Scenario:
    """The scenario with the units of an arm where it names none.

    The outputs, inputs and states of other plants may be anything: they keep the unit 1. So do
    those of an arm with sliding joints, which has outputs of two units.

    Args:
        scenario: that was read.
        plant: its plant.
    """
    arm = plant.arm
    if arm is None or arm.chain.slides or scenario.units != Units():
        return scenario
    velocity = getattr(scenario.plant.arm, "measured", None) == "velocity"
    half = plant.n // 2
    units = Units(
        output="rad/s" if velocity else "rad",
        input="N m",
        state=half * ["rad"] + half * ["rad/s"],
    )
    return msgspec.structs.replace(scenario, units=units)
