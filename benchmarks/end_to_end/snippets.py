"""Few lines of ten machines, from their logs: the error at work beside nothing, and an expert's.

An expert has the true widths and writes one line for each side, with nothing inside a zone.
SNIPPETS: names of machines, by commas (all).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.end_to_end.cases import SEED, load_snippet, run_command, write_log
from benchmarks.end_to_end.machines import (
    BAND,
    CASES,
    DEAD_BAND,
    GAP,
    LOST,
    STAR,
    ZONE,
    Case,
    Correct,
    hold_levels,
    rms,
)
from benchmarks.identify.logs.strangers import lags, zone
from benchmarks.markdown import head, row
from undeadzone.util.arrays import Floats
from undeadzone_export.snippet import Lost, load_lines

COUNTS, EDGES, TARE, COUNTED = 4120.0, (3300.0, 2050.0), 84_231.0, 90.0  # of a load cell, in counts
PULSES = (1486.0, 1522.0)  # between which a continuous servo rests [us]


def _cell(behind: float, tare: float) -> Case:
    """Return a load cell in counts: with noise behind the zone, else ahead of it."""

    def read(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
        """Return force, z and readings."""
        force = hold_levels(rng, 8000, 60, 6.0)
        z, noise = COUNTS * lfilter([0.0, 0.2], [1.0, -0.8], force), rng.standard_normal(8000)
        seen = zone(z + (COUNTED - behind) * noise, *EDGES) + behind * noise
        return force, z + tare, np.round(seen) + tare

    def record(rng: np.random.Generator) -> Floats:
        """Return times, force and readings at 80 Hz."""
        force, _, y = read(rng)
        return np.column_stack([np.arange(8000) / 80, force, y])

    def use(rng: np.random.Generator, correct: Correct) -> float:
        """Return the rms error of the corrected reading [counts]."""
        _, z, y = read(rng)
        return rms([correct(float(one)) for one in y] - z)

    return Case("", "t,force_command,reading", "counts", "counts", record, lambda _: (), use)


def _band(low: float, high: float) -> Case:
    """Return a drive that rests in a band of its command; its speed is read."""

    def passes(pulses: Any) -> Any:
        """Return pulses behind the band, from its middle."""
        return zone(np.asarray(pulses) - (low + high) / 2, *[(high - low) / 2] * 2)

    def record(rng: np.random.Generator) -> Floats:
        """Return times, pulses and speed at 50 Hz."""
        pulses = np.round(1500 + hold_levels(rng, 3000, 40, 200.0))
        speed = lags(passes(pulses), 4.0, 1) + 0.01 * rng.standard_normal(3000)
        return np.column_stack([0.02 * np.arange(3000), pulses, speed])

    def use(_: np.random.Generator, correct: Correct) -> float:
        """Return the rms error of the speed at work [us of pulses]."""
        wanted = 100 * np.sin(0.05 * np.arange(1000))
        pulses = [correct(float(one)) for one in wanted + (low + high) / 2]
        return rms(passes(pulses) - wanted)

    return Case("", "t,pulse_us,speed", "us", "us", record, lambda _: (), use)


def _about(right: float, left: float, rest: float = 0.0) -> Callable[[], Correct]:
    """Return an expert's lines of a zone: an edge is added on either side of its rest."""
    return lambda: lambda x: x + right * (x > rest) - left * (x < rest)


def _of_gap(gap: float) -> Callable[[], Correct]:
    """Return an expert's lines of a gap: it is added while the command rises."""
    width = (gap, gap, gap)
    return lambda: load_lines(Lost("backlash", width, width, width, "", ""))


MACHINES: dict[str, tuple[Case, Callable[[], Correct]]] = {
    "load_cell": (CASES["load_cell"], _about(*ZONE)),
    "cell, noise ahead": (_cell(0.0, 0.0), _about(*EDGES)),
    "cell, noise behind": (_cell(COUNTED, 0.0), _about(*EDGES)),
    "cell, raw counts": (_cell(0.0, TARE), _about(*EDGES, TARE)),
    "speed_controller": (CASES["speed_controller"], _about(*BAND)),
    "continuous servo": (_band(*PULSES), _about(18.0, 18.0, 1504.0)),
    "hobby_servo": (CASES["hobby_servo"], _of_gap(LOST)),
    "two_encoders": (CASES["two_encoders"], _of_gap(GAP)),
    "mount": (CASES["mount"], _of_gap(STAR)),
    "valve": (CASES["valve"], _of_gap(DEAD_BAND)),
}


def compare_lines(name: str, folder: Path) -> str:
    """Return the row of a machine: errors at work with nothing, the lines, and an expert's.

    Args:
        name: of the machine.
        folder: for its files.
    """
    case, expert = MACHINES[name]
    log, out = write_log(name, case, folder), folder / f"{name} answer"
    run_command("identify", log, "--out", out, "--no-figures")
    run_command("export", out / "identify.json", "--to", "snippet", "--out", out / "few")
    errors = [
        f"{case.use(np.random.default_rng(SEED + 2), one):.3g}"
        for one in (float, load_snippet(out / "few"), expert())
    ]
    return row(name.replace("_", " "), case.error_unit, *errors)


def table() -> str:
    """Return the section of RESULTS.md."""
    names = os.environ.get("SNIPPETS", ";".join(MACHINES)).split(";")
    ends = ("nothing", "printed lines", "expert, true widths")
    lines = ["## Few lines", "", *head("machine", "unit", *ends)]
    with tempfile.TemporaryDirectory() as folder:
        lines += [compare_lines(name, Path(folder)) for name in names]
    return "\n".join([*lines, ""])
