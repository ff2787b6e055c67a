"""How the integration error of the paper's loop falls with the step: with located switching, and with its silence innovation."""

from __future__ import annotations

import math

import msgspec

import undeadzone as uz

STEPS = (8e-3, 4e-3, 2e-3, 1e-3)


def scenario(step: float, silence: bool) -> uz.Scenario:
    """The paper's repaired example over 5 s."""
    return uz.Scenario(
        plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]], x0=[0.5, 0]),
        sensor=uz.Sensor(right=1.0, left=1.0),
        reference=uz.Sine(amplitude=5.0, frequency=1.0),
        observer=uz.Certified(
            L=[1.0, 1.5], gamma=10.0, widths0=[0.2, 0.2], width_max=3.0, silence=silence
        ),
        controller=uz.StateFeedback(alpha=10.0),
        simulation=uz.Simulation(duration=5.0, step=step),
    )


def table() -> str:
    """Errors against half the step, and the order between neighbours."""
    lines = [
        "## Accuracy\n",
        "| step [s] | error | order | error with silence innovation | order |",
        "|---|---|---|---|---|",
    ]
    before: tuple[float, ...] = ()
    for step in STEPS:
        errors = tuple(
            msgspec.structs.asdict(uz.simulate(scenario(step, silence)).info)["integration_error"]
            for silence in (False, True)
        )
        orders = (
            [f"{math.log2(b / a):.1f}" for a, b in zip(errors, before, strict=True)]
            if before
            else ["", ""]
        )
        lines.append(
            f"| {step:g} | {errors[0]:.2g} | {orders[0]} | {errors[1]:.2g} | {orders[1]} |"
        )
        before = errors
    return "\n".join([*lines, ""])
