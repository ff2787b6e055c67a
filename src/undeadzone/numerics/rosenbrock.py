"""Rosenbrock step for stiff equations: one linear system a stage, and no limit to its stiffness."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

GAMMA = 1 - 1 / math.sqrt(2)  # with which the stiffest modes are gone after a step


def rosenbrock_change(
    rate: Callable[[Any], Any], solve: Callable[[Any], Any], x: Any, h: Any
) -> Any:
    """Return the increment of x over a step of x' = rate(x), of second order for any matrix A.

    It is L-stable for the part of the rate that A describes (Verwer et al. 1999, ROS2). The rest is
    stable as in an explicit method of two stages.

    Args:
        rate: the right-hand side.
        solve: returns (I - GAMMA h A)^-1 times a column, A near the Jacobian of the rate.
        x: the state at the beginning.
        h: length of the step [s].

    References:
        J. G. Verwer, E. J. Spee, J. G. Blom, W. Hundsdorfer (1999), doi:10.1137/S1064827597326651
    """
    k1 = solve(rate(x))
    k2 = solve(rate(x + h * k1) - 2 * k1)
    return h / 2 * (3 * k1 + k2)
