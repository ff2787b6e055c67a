"""Steps of integration, explicit and implicit, and cubic dense output, for any values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

GAMMA = 1 - 1 / math.sqrt(2)  # of `rosenbrock_change`: the stiffest modes are gone after a step


def rk4(rate: Callable[[Any, float], Any], x: Any, h: Any, k1: Any = None) -> Any:
    """Integrate x' = rate(x, c) over a step by the classical Runge-Kutta method.

    Args:
        rate: the right-hand side at the fraction c of the step, 0 <= c <= 1.
        x: the state at the beginning.
        h: length of the step [s].
        k1: rate(x, 0), if it is known.

    Returns:
        The state at the end.
    """
    return x + rk4_change(rate, x, h, k1)


def rk4_change(rate: Callable[[Any, float], Any], x: Any, h: Any, k1: Any = None) -> Any:
    """Return the increment that `rk4` adds to x."""
    k1 = rate(x, 0.0) if k1 is None else k1
    k2 = rate(x + h / 2 * k1, 0.5)
    k3 = rate(x + h / 2 * k2, 0.5)
    k4 = rate(x + h * k3, 1.0)
    return h / 6 * (k1 + k4 + 2 * (k2 + k3))


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


def hermite(x0: Any, dx0: Any, x1: Any, dx1: Any, h: Any, c: Any) -> Any:
    """Return the cubic through two points with given slopes, at the fraction c, with error O(h^4).

    Args:
        x0, x1: values at the beginning and at the end.
        dx0, dx1: slopes there [units of x per s].
        h: length of the step [s].
        c: fraction of the step.
    """
    d = x1 - x0
    return x0 + c * (h * dx0 + c * (3 * d - h * (2 * dx0 + dx1) + c * (h * (dx0 + dx1) - 2 * d)))


def hermite_slope(x0: Any, dx0: Any, x1: Any, dx1: Any, h: Any, c: Any) -> Any:
    """Return the derivative of `hermite` with respect to c."""
    d = x1 - x0
    return h * dx0 + c * (2 * (3 * d - h * (2 * dx0 + dx1)) + c * (3 * (h * (dx0 + dx1) - 2 * d)))
