"""Which widths an inverse uses."""

from __future__ import annotations

from typing import Any

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
