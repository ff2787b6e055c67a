"""How the integration error of the paper's loop falls with the step, silence innovation or not."""

from __future__ import annotations

import math

import undeadzone as uz
from benchmarks.markdown import head, row

STEPS = (8e-3, 4e-3, 2e-3, 1e-3)  # [s]


def scenario(step: float, silence: bool) -> uz.Scenario:
    """The paper's repaired example over 5 s."""
    observer = uz.Certified(
        L=[1.0, 1.5], gamma=10.0, widths0=[0.2, 0.2], width_max=3.0, silence=silence
    )
    return uz.Scenario(
        plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]], x0=[0.5, 0]),
        sensor=uz.Sensor(right=1.0, left=1.0),
        reference=uz.Sine(amplitude=5.0, frequency=1.0),
        observer=observer,
        controller=uz.StateFeedback(alpha=10.0),
        simulation=uz.Simulation(duration=5.0, step=step),
    )


def table() -> str:
    """Errors against half the step, and the order between neighbours."""
    columns = ("step [s]", "error", "order", "error with silence innovation", "order")
    plain, silent = errors(silence=False), errors(silence=True)
    lines = ["## Accuracy\n", *head(*columns)]
    for step, *cells in zip(STEPS, plain, orders(plain), silent, orders(silent), strict=True):
        error, order, silent_error, silent_order = cells
        lines.append(row(f"{step:g}", f"{error:.2g}", order, f"{silent_error:.2g}", silent_order))
    return "\n".join([*lines, ""])


def errors(silence: bool) -> list[float]:
    """The integration error of each step."""
    numbers = []
    for step in STEPS:
        error = uz.simulate(scenario(step, silence)).info.integration_error
        assert error is not None
        numbers.append(error)
    return numbers


def orders(errors: list[float]) -> list[str]:
    """The orders between neighbours, whose steps differ by a factor of 2; none before the first."""
    pairs = zip(errors[1:], errors[:-1], strict=True)
    return ["", *(f"{math.log2(coarse / fine):.1f}" for fine, coarse in pairs)]
