"""What a user may say about a log before it is identified."""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from undeadzone.errors import InputError

MOST_POLES = 8
MOST_LATE = 1000  # samples


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known or asked, besides the log.

    Attributes:
        order: orders of the plant to try, as "2" or "1-4"; default 1-4.
        right, left: widths as in "0.5" (known), "0.2,1.0" (bounds) or "inf" (no edge on that
            side) [y]; default: from the log.
        offset: rms of a constant offset of the output [y], or "free": then the width alone has an
            interval; default 0, none.
        held_out: share of the log, at its end, that checks the fit; default 0.3.
        noise: before (ahead of the zone), after, or auto: from exact zeros in the log.
        place: where the zone is: sensor if the user knows, auto to find out.
        kind: deadzone, jump (readings are not shifted), play, or auto: they are told apart.
        delay: samples by which the input acts late: auto, or a number that belongs to the
            recording.
        zero: what the sensor reads inside its zone [y]; it is taken off every reading.
        threshold: |y| up to which a reading counts as silent [y]; default: half the quantum.
        integrators: how many poles of the plant are integrators, as one of a motor's position.
        resample: step [s] onto which an irregular log is put; default: none.
    """

    order: str = "1-4"
    right: str | None = None
    left: str | None = None
    offset: str = "0"
    held_out: float = 0.3
    noise: Literal["before", "after", "auto"] = "auto"
    place: Literal["sensor", "auto"] = "auto"
    kind: Literal["deadzone", "jump", "play", "auto"] = "auto"
    delay: str = "auto"
    zero: float = 0.0
    threshold: float | None = None
    resample: float | None = None
    integrators: int = 0

    def orders(self) -> range:
        """The orders to try. Raises InputError."""
        parts = self.order.split("-")
        try:
            ends = [int(part) for part in parts]
        except ValueError:
            ends = []
        if len(ends) not in (1, 2) or not 1 <= ends[0] <= ends[-1] <= MOST_POLES:
            raise InputError(
                f"order: expected a number or a range within 1 to {MOST_POLES}, as 2 or 1-4;"
                f" found {self.order!r}"
            )
        return range(max(ends[0], self.integrators), max(ends[-1], self.integrators) + 1)

    def offset_rms(self) -> float | None:
        """The rms of an unknown output offset [y]; None where it is free. Raises InputError."""
        if self.offset == "free":
            return None
        try:
            rms = float(self.offset)
        except ValueError:
            rms = math.nan
        if not (math.isfinite(rms) and rms >= 0):
            raise InputError(f"offset: expected an rms >= 0 or free, found {self.offset!r}")
        return rms

    def bounds(self, side: Literal["right", "left"]) -> tuple[float, float]:
        """Least and largest width of a side [y]; equal where it is known. Raises InputError."""
        text = self.right if side == "right" else self.left
        if text is None:
            return (-math.inf, math.inf)
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (1, 2) or not 0 <= numbers[0] <= numbers[-1]:
            raise InputError(
                f"{side}: expected a width, two bounds or inf, as 0.5, 0.2,1.0 or inf;"
                f" found {text!r}"
            )
        return (numbers[0], numbers[-1])

    def checked(self) -> Options:
        """These options, every one of them usable. Raises InputError."""
        if self.integrators not in (0, 1, 2):
            raise InputError(f"integrators: expected 0, 1 or 2, found {self.integrators}")
        if self.kind == "jump" and self.integrators:
            raise InputError("kind: a jump sensor's readings show z; it has no --integrators")
        if self.delay != "auto" and not (self.delay.isdigit() and int(self.delay) <= MOST_LATE):
            raise InputError(
                f"delay: expected auto or samples up to {MOST_LATE}, found {self.delay!r}"
            )
        if not math.isfinite(self.zero):
            raise InputError(f"zero: expected a number, found {self.zero:g}")
        self.orders()
        self.offset_rms()
        self.bounds("right")
        self.bounds("left")
        if not 0.1 <= self.held_out <= 0.5:
            raise InputError(f"held_out: expected 0.1 to 0.5, found {self.held_out:g}")
        if self.threshold is not None and not 0 <= self.threshold < math.inf:
            raise InputError(f"threshold: must not be negative, found {self.threshold:g}")
        return self
