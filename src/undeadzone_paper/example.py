"""The paper's example, (37)-(42), in all its readings, as printed and as repaired."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.controllers import PD, StateFeedback
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Certified
from undeadzone.plants.options import Plant, SecondOrder
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.signals.exosystem import Sine
from undeadzone_paper.observer import Printed

OMEGA: Final = 2 * np.pi  # [rad/s] of the reference, and the omega_n that the text gives
D: Final = 1.0  # d_r = d_l
L_PRINTED: Final = (-1.25, -1.62)  # (40)
POLES: Final = (-4.0, -10.0)  # that (40) is said to place
L_POLES: Final = (12.0, 15.0)  # that does place them, for (39)
L_REPAIRED: Final = (1.0, 1.5)
ALPHA: Final = 10.0  # weight of the control gain in (34)
AMPLITUDES: Final = (5.0, 2.0)  # r = 5 sin 2 pi t in the text, theta_d = 2 sin 2 pi t in figures
DURATION: Final = 20.0  # [s]
STARTED: Final = 5.0  # x1(0) of the runs that begin outside the zone


class PlantReading(NamedTuple):
    """One reading of (37)-(39): its plant and its source."""

    plant: Plant
    words: str


READINGS: Final = {
    "omega_n = 1": PlantReading(
        Plant(second_order=SecondOrder(zeta=1.0, omega_n=1.0)), "(38), (39)"
    ),
    "omega_n = 2 pi": PlantReading(
        Plant(second_order=SecondOrder(zeta=1.0, omega_n=OMEGA)), "(37) with omega_n^2 x"
    ),
    "stiffness 2 pi": PlantReading(
        Plant(companion=[OMEGA, 2 * OMEGA]), "(37) as printed, omega_n x"
    ),
    "unity DC gain": PlantReading(
        Plant(second_order=SecondOrder(zeta=1.0, omega_n=OMEGA, gain=OMEGA**2)),
        "(37) with omega_n^2 x = omega_n^2 u",
    ),
}


def example_as_printed(amplitude: float, x1: float = 0.0) -> Scenario:
    """Build the example as printed:

    (16), (41) without B u, (25), (42), plant (39), d^(0) = d (A2).

    Args:
        amplitude: of r = amplitude sin 2 pi t
        x1: x1(0), x2(0) = 0
    """
    return Scenario(
        title=f"As printed, r = {amplitude:g} sin 2πt",
        plant=Plant(A=[[0.0, 1.0], [-1.0, -2.0]], B=[[0.0], [1.0]], C=[[1.0, 0.0]], x0=[x1, 0.0]),
        sensor=Sensor(right=D, left=D),
        reference=Sine(amplitude=amplitude, frequency=1.0),
        observer=Printed(L=L_PRINTED, alpha=ALPHA, widths0=D),
        controller=PD(L=L_PRINTED, alpha=ALPHA),
        simulation=Simulation(duration=DURATION),
    )


def example_as_repaired(amplitude: float) -> Scenario:
    """Build the example as repaired, r = amplitude sin 2 pi t.

    The observer knows u and the measured side, and feedforward makes z follow r.
    """
    return example_as_printed(amplitude, x1=0.5) | {
        "title": f"Repaired, r = {amplitude:g} sin 2πt",
        "observer": Certified(L=L_REPAIRED, gamma=10.0, widths0=[0.2, 0.2], width_max=3.0),
        "controller": StateFeedback(alpha=ALPHA),
    }
