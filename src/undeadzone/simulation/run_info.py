"""What a run knows besides its signals."""

from __future__ import annotations

from typing import Any

import msgspec

from undeadzone.scenario.schema import Units


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """What a run knows besides its signals.

    Attributes:
        title: of the scenario.
        method: of its observer.
        time: continuous or sampled.
        step: between two samples [s].
        tracked: numbers of the outputs that follow the reference.
        widths: true [right, left] of each output (2p) [z].
        threshold: |y| that counts as silent (p) [y].
        certified: whether a certificate holds; None where the method has no constant gains or the
            model is nonlinear.
        integration_error: largest difference to a run of half the step; None: not measured.
        identifiable: what the readings tell of each output's widths, and why not all.
        seconds: that the run took [s].
        units: names of units.
        joints: names of an arm's joints; empty without an arm.
        uncertain: the parameters that the observer estimates, and their true values.
        label: what tells its observer from one that it is compared with; empty: the method does.
        adapts: whether the observer estimates the widths.
    """

    title: str
    method: str
    time: str
    step: float
    tracked: list[int]
    widths: list[float]
    threshold: list[float]
    certified: bool | None
    integration_error: float | None
    identifiable: list[dict[str, Any]]
    seconds: float
    units: Units = Units()
    joints: list[str] = []
    uncertain: dict[str, float] = {}
    label: str = ""
    adapts: bool = True
