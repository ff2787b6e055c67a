"""Facts about a run, and about a log after estimation, besides the signals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from undeadzone.scenario.schema import Units

if TYPE_CHECKING:
    Width = float
else:
    Width = float | None  # JSON has null for an infinite one, without an edge


def restore_widths(info: msgspec.Struct, names: Iterable[str]) -> None:
    """Put infinite widths where JSON had null.

    Args:
        info: facts as decoded.
        names: of its lists of widths.
    """
    for name in names:
        values = [{None: math.inf}.get(width, width) for width in getattr(info, name)]
        msgspec.structs.force_setattr(info, name, values)


class IntegrationError(NamedTuple):
    """Difference between a run and its repetition with half the step.

    Attributes:
        largest: difference of x, x^, d^.
        share: of the largest |z|: the largest difference of z, z^, d^.
    """

    largest: float
    share: float


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """Facts about a run besides its signals.

    Attributes:
        title: of the scenario.
        method: of its observer.
        time: continuous or sampled.
        step: between two samples [s].
        tracked: numbers of the outputs that follow the reference.
        widths: true [right, left] of each output (2p) [z].
        threshold: |y| that counts as silent (p) [y].
        certified: whether a certificate holds (None if the method has no constant gains or the
            model is nonlinear).
        integration_error: largest difference to a run of half the step (None: not measured).
        integration_share: the same error of z, z^ and d^ as a share of the largest |z| (above 1 %
            the run has no result, None: not measured).
        scales: sizes of the plant's own: of its states (n), then of its outputs and its inputs,
            1e12 times which a signal has diverged (empty: 1 of each).
        identifiable: identifiability of each output's widths from the readings, with reasons.
        seconds: that the run took [s] (0 in files, which are the same whenever they are made).
        units: names of units.
        joints: names of an arm's joints (empty without an arm).
        uncertain: the parameters that the observer estimates, and their true values.
        label: name that distinguishes its observer from the compared one (empty: the method).
        adapts: whether the observer estimates the widths.
        ranges: declared [lo, hi] of d_r and d_l of each output in turn [z] (empty: none).
        halves: declared [lo, hi] of half the gap of gears at each output (empty: none).
        tips: of gears read at the motors, rms distances from the tip over the last 2 s of that
            estimated, and of that by the encoders alone [m] (empty: other plants).
        scenario: scenario that was run, as TOML (empty if no text can hold it).
        version: of undeadzone.
        schema: number of the meanings that the names in it have (docs/json.md).
        seed: of every random number.
        gains: of the observer L (n x p) and gamma (p), of the controller K (m x n), if constant (in
            sampled time L and gamma are those of one step).
        listens: share of an error of the model that z^ follows, of each output, None if unknown,
            empty if not measured (`simulation.feedback`).
        sensor: its kind.
        actuator: true [right, left] of each actuator whose widths are estimated (2m) [u].
        gaps: true [c_r, c_l] of the play ahead of each dead zone, if they are estimated (2p) [z].
        options: names of the keys that the method takes.
        output_level, input_level: z and u at the operating point, from which widths count (p, m)
            (empty: 0).
    """

    title: str
    method: str
    time: str
    step: float
    tracked: list[int]
    widths: list[Width]
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
    ranges: list[list[float]] = []
    halves: list[list[float]] = []
    tips: list[float] = []
    integration_share: float | None = None
    scales: list[float] = []
    listens: list[float | None] = []
    sensor: str = "deadzone"
    actuator: list[float] = []
    gaps: list[float] = []
    scenario: str = ""
    version: str = ""
    schema: int | None = None
    seed: int = 0
    gains: dict[str, list[Any]] = {}
    options: list[str] = []
    output_level: list[float] = []
    input_level: list[float] = []

    def __post_init__(self) -> None:
        """Restore infinite widths."""
        restore_widths(self, ("widths",))


class LogInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Facts about a log as a whole after estimation.

    Attributes:
        title: of the scenario.
        method: of its observer.
        source: the log.
        columns: in words, which column was taken for what.
        step: between two samples [s].
        measured_step: the usual time between samples of the log [s] (None: it has no times).
        samples: how many there are, those in gaps included.
        missing: how many of them have a reading missing.
        gaps: how many of these are in gaps of the log's times.
        unreadable: lines that could not be read.
        why_unreadable: description of the first fault.
        faults: number of faulty lines by kind (docs/watch.md). Lasting jumps in time, at which the
            observer began anew, are among them.
        right, left, silent: samples on each measured side, of each output (p).
        d_right, d_left: final widths (p) [z].
        d_right_std, d_left_std: their standard deviations (p) [z] (None: the observer gives none).
        adapts: whether the observer estimates the widths.
        ranges: declared [lo, hi] of d_r and d_l of each output in turn [z] (empty: none).
        consistent: whether its innovations fit its assumptions (None: it cannot be tested).
        B: statistic of the test, about 1 if all is well.
        square: mean square of the normalised innovations, about 1 if all is well.
        used: readings that corrected the estimate.
        glitches: readings that the filter took for wrong, or beyond 4.5 standard deviations.
        silent_outside: readings that are silent although z^ is far outside the estimated zone.
        reasons: why the record is not consistent, or cannot be tested.
        claims: names of the assumptions that a filter rejects, the most probable first.
        threshold: |y| that counts as silent (p) [y].
        uncertain: names of the parameters that the observer estimates.
        joints: names of an arm's joints (empty without an arm).
        units: names of units.
        limited: samples at a limit of the range, of each output (p) (empty: there is none).
        remarks: further findings in the log, for the user.
        sensor: its kind.
        further: final gaps of plays ahead of dead zones [z] and widths of actuators [u], with their
            deviations, by name (those estimated).
        options: names of the keys that the method takes.
        output_level: z at the operating point, from which widths count (p) [z] (empty: 0).
    """

    title: str
    method: str
    source: str
    columns: str
    step: float
    measured_step: float | None
    samples: int
    missing: int
    gaps: int
    unreadable: int
    why_unreadable: str
    right: list[int]
    left: list[int]
    silent: list[int]
    d_right: list[Width]
    d_left: list[Width]
    d_right_std: list[float] | None
    d_left_std: list[float] | None
    adapts: bool
    consistent: bool | None
    B: float | None
    square: float | None
    used: int
    glitches: int
    silent_outside: int
    reasons: list[str]
    threshold: list[float]
    uncertain: list[str] = []
    joints: list[str] = []
    units: Units = Units()
    limited: list[int] = []
    remarks: list[str] = []
    claims: list[str] = []
    sensor: str = "deadzone"
    further: dict[str, Any] = {}
    ranges: list[list[float]] = []
    faults: dict[str, int] = {}
    options: list[str] = []
    output_level: list[float] = []

    def __post_init__(self) -> None:
        """Restore infinite widths, which only filters give: they give deviations too."""
        restore_widths(self, () if self.d_left_std is None else ("d_right", "d_left"))

    def summary(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON (lists for several outputs)."""
        numbers = msgspec.to_builtins(self)
        numbers |= numbers.pop("further")
        del numbers["options"]
        for name in ("right", "left", "silent", "limited"):
            numbers[f"samples_{name}"] = numbers.pop(name)
        if not self.limited:
            del numbers["samples_limited"]
        if not self.output_level:
            del numbers["output_level"]
        for name, value in numbers.items():
            if name.startswith(("d_", "samples_")) and isinstance(value, list) and len(value) == 1:
                numbers[name] = value[0]
        return dict(numbers)
