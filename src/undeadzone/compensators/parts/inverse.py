"""The inverse of a dead zone of the actuator, and which widths it uses."""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.actuator import Belief, Drive
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate


def known_drive(belief: Belief | None) -> Drive:
    """The believed actuator. Raises InputError where there is none."""
    if belief is None:
        raise InputError(
            "compensator: there is no actuator to compensate; add [actuator] or [model.actuator]"
        )
    return belief.drive


def beyond(drive: Drive, estimate: Estimate) -> tuple[Any, Any]:
    """(b_r^, b_l^) (m each): those of the observer, else those that are believed."""
    if estimate.actuator_right_std.shape[0]:
        return estimate.actuator_right, estimate.actuator_left
    return drive.right, drive.left


def inverted(drive: Drive, v: Any, right: Any, left: Any) -> Any:
    """The command u (m) for which v (m) enters the plant: v / m_r + b_r, v / m_l - b_l, or 0.

    Args:
        drive: the believed actuator, for its slopes.
        v: what shall enter (m).
        right, left: b_r, b_l, or the part of them that is added (m) [u].
    """
    u = ca.if_else(v > 0, v / drive.slope_right + right, 0.0)
    return u + ca.if_else(v < 0, v / drive.slope_left - left, 0.0)
