"""What is claimed of a plant and its sensor: options that several observers share."""

from __future__ import annotations

from typing import Any

import msgspec

from undeadzone.observers.parts.doubt import GLITCHES
from undeadzone.support.arrays import Array


class Claims(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is claimed of a plant and its sensor; what is not claimed is doubted, and 0 is a claim.

    Attributes:
        right, left: ranges [lo, hi] of d_r and d_l, one or one per output [z]; left defaults to
            that of right.
        centre: claimed range [lo, hi] of d_r - d_l, a number where it is known (0: a symmetric
            zone), or one range per output [z]; default: what the ranges of d_r and d_l say.
        noise: rms of a reading on an active side, one or one per output [z]; default the sensor's.
        x_std: standard deviation of x(0) about 0, one or one per state; default what shows
            in z as five times the largest width.
        drift: random walk of the widths [z / sqrt(s)]; default a 400th of the largest width in
            1 / |pole| of the plant.
        disturbance: rms that a coloured input disturbance may have, one or one per input [u];
            default what moves z by half of the largest width, rms, in a quarter period of the
            plant and 1 / |pole| for each further pole.
        correlation_time: correlation time of the disturbance, first-order noise [s]; default a 16th
            of the plant's period, 12.5 samples if it only integrates.
        bias: rms of an unknown constant at the input, one or one per input [u]; default a quarter
            of the disturbance's.
        calibrated: probability that there is no bias.
        tolerance: relative rms error of the model: of every entry of A and B but in rows that only
            say x_i' = x_j, or of some, as { "A[1,0]" = 0.1 }; of every parameter of a nonlinear
            plant.
        glitches: probability that a reading is wrong, whatever the sensor promises; 0 takes all
            readings for right, as textbooks do, and shows no wider intervals where they do not fit.
    """

    right: Array
    left: Array | None = None
    centre: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: float | None = None
    disturbance: Array | None = None
    correlation_time: float | None = None
    bias: Array | None = None
    calibrated: float = 0.7
    tolerance: float | dict[str, float] = 0.05
    glitches: float = GLITCHES

    def claims(self) -> dict[str, Any]:
        """The claims by name."""
        return {name: getattr(self, name) for name in Claims.__struct_fields__}
