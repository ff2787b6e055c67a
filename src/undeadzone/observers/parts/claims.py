"""What is claimed of a plant and its sensor: options that several observers share."""

from __future__ import annotations

from typing import Any

import msgspec

from undeadzone.support.arrays import Array


class Claims(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Claims about what is unknown, explained at `Censored`; what is not given is doubted, and 0 is a claim."""

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: float | None = None
    disturbance: Array | None = None
    correlation_time: float | None = None
    bias: Array | None = None
    calibrated: float = 0.7
    tolerance: float | dict[str, float] = 0.05

    def claims(self) -> dict[str, Any]:
        """The claims by name."""
        return {name: getattr(self, name) for name in Claims.__struct_fields__}
