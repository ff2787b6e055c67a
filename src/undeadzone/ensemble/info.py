"""What an ensemble knows besides its columns."""

from __future__ import annotations

from typing import Final

import msgspec

from undeadzone.scenario.schema import Units

IN_OUTPUT_UNIT: Final = (
    "rms_",
    "peak_",
    "d_",
    "sensor.right",
    "sensor.left",
    "sensor.noise",
    "reference.amplitude",
)


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """What an ensemble knows besides its columns.

    Attributes:
        title: of the scenario
        method: of the observer
        time: "continuous" or "sampled"
        step: time step [s]
        duration: of a run [s]
        seed: of the values and of the noise
        sampling: how the values were drawn
        runs: number of runs
        tolerance: of |z - r| for settling, as a share of the largest |r|
        tracked: the outputs that follow a reference
        widths: the nominal right and left width of each output in turn (2p)
        scenario: the scenario as TOML; with a run's number it replays the run
        version: of undeadzone
        recorded: number of the first runs, those behind the bands
        numbers: a digest of what all runs share
        units: of output and input
    """

    title: str
    method: str
    time: str
    step: float
    duration: float
    seed: int
    sampling: str
    runs: int
    tolerance: float
    tracked: list[int]
    widths: list[float]
    scenario: str
    version: str
    recorded: int = 0
    numbers: str = ""
    units: Units = Units()


def unit_of_column(name: str, units: Units) -> str:
    """The unit of a column, 1 also where it is not known; units: of output and input."""
    if name.endswith("(relative)"):
        return "1"
    stem = name.partition("[")[0]
    known = {"settling_time": "s", "rms_input": units.input, "rms_tip": "m"}
    if stem in known:
        return known[stem]
    return units.output if stem.startswith(IN_OUTPUT_UNIT) else "1"
