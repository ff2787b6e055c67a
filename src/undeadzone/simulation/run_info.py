"""What a run knows besides its signals."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from undeadzone.scenario.schema import Units


class IntegrationError(NamedTuple):
    """By how much a run differs from its twin of half the step.

    Attributes:
        largest: difference of x, x^, d^.
        share: of the largest |z|: the largest difference of z, z^, d^.
    """

    largest: float
    share: float


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
        integration_share: the same error of z, z^ and d^ as a share of the largest |z|; above 1 %
            the run is no result. None: not measured.
        scales: sizes of the plant's own: of its states (n), then of its outputs and its inputs,
            1e12 times which a signal has diverged; empty: 1 of each.
        identifiable: what the readings tell of each output's widths, and why not all.
        seconds: that the run took [s].
        units: names of units.
        joints: names of an arm's joints; empty without an arm.
        uncertain: the parameters that the observer estimates, and their true values.
        label: what tells its observer from one that it is compared with; empty: the method does.
        adapts: whether the observer estimates the widths.
        scenario: what was run, as TOML; empty where no text can hold it.
        version: of undeadzone.
        seed: of every random number.
        gains: of the observer L (n x p) and gamma (p), of the controller K (m x n), where constant;
            in sampled time L and gamma are those of one step.
        listens: share of an error of the model that z^ follows, of each output; None where it
            cannot be told; empty: not measured (`simulation.listening`).
        sensor: its kind.
        actuator: true [right, left] of each actuator whose widths are estimated (2m) [u].
        gaps: true [c_r, c_l] of the play ahead of each dead zone, where they are estimated (2p)
            [z].
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
    integration_share: float | None = None
    scales: list[float] = []
    listens: list[float | None] = []
    sensor: str = "deadzone"
    actuator: list[float] = []
    gaps: list[float] = []
    scenario: str = ""
    version: str = ""
    seed: int = 0
    gains: dict[str, list[Any]] = {}
