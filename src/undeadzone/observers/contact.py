"""Filter of contacts for arms whose encoders sit at motors, links or both, with gaps between them.

Each joint is in one of three contacts, right flank, gap or left flank; `parts.contact_modes` has
the mathematics. It finds link angles, gaps, payload and friction on the way.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from undeadzone.observers.parts.contact_modes import Contact, Drive, Layout, Numbers
from undeadzone.plants.robots.arm import acceleration
from undeadzone.plants.robots.geared import Geared

FASTEST = 0.6  # largest product of a substep and the frequency of contact


def drive_of(geared: Geared, Ts: float, substeps: int, fading: float) -> Drive:
    """What the filter asks of an arm with gears.

    Args:
        geared: the arm.
        Ts: sample time [s].
        substeps: Runge-Kutta steps in a sample.
        fading: correlation time of the unknown torque of the motors [s].
    """
    N = geared.size
    layout = Layout(N)
    names = {"half": "half", "centre": "centre", "friction": "friction"}

    def known(params: Any, x: Any) -> Any:
        column = ca.SX(params)
        for name, place in names.items():
            first = geared.names.index(f"{name}1")
            column[first : first + N] = x[layout.of(place)]
        column[geared.names.index("payload")] = x[layout.of("payload")]
        return column

    def rate(params: Any, x: Any, u: Any, contact: Contact) -> tuple[Any, Any]:
        push = x[layout.of("push")]
        dx, tau = geared.motion(known(params, x), x[: 4 * N], u + push, ca.DM(contact))
        rest = ca.SX.zeros(layout.count - 4 * N)
        rest[3 * N : 4 * N] = -push / fading
        return ca.vertcat(dx, rest), tau

    def mobility(params: Any, x: Any) -> Any:
        column = known(params, x)
        M = ca.densify(geared.arm.mass(geared.links(column), x[layout.of("link")]))
        motors = -ca.diag(1 / geared.number(column, "inertia"))
        return ca.vertcat(motors, ca.inv(M))

    readings = {
        "motor": tuple(range(N)),
        "link": tuple(range(N, 2 * N)),
        "both": tuple(range(2 * N)),
    }[geared.measured]
    return Drive(layout, rate, mobility, readings, Ts, substeps)
