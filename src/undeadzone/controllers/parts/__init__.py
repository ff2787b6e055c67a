"""Parts shared by several controllers."""

from __future__ import annotations

from typing import Any

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Estimate
from undeadzone.plants.system import System


def require_square(method: str, model: System) -> None:
    """Raise InputError if the model has unequal numbers of inputs and outputs."""
    if model.m != model.p:
        raise InputError(
            f"controller.method: '{method}' needs as many inputs as outputs, the plant has "
            f"{model.m} and {model.p}"
        )


def select_tracked_output(method: str, estimate: Estimate, target: Target) -> Any:
    """Return z^ of the tracked outputs (p): all outputs in order.

    Raises InputError.
    """
    z = estimate.z
    if z.shape[0] != target.r.shape[0]:
        raise InputError(
            f"tracked: controller.method = '{method}' follows every output. "
            f"Expected {z.shape[0]} tracked outputs, found {target.r.shape[0]}"
        )
    return z
