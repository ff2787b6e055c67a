"""Closed loops behind a play with a dead zone after it: both unknown, against known and mistaken.

`python -m benchmarks play_and_zone --plants arm --loops 10` runs a part of the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.loops.plants.random_loops import Loops, run_loops
from benchmarks.loops.play import (
    SLIGHT,
    WORLDS,
    Options,
    Widths,
    World,
    censored,
    errors,
    kalman,
    loop,
    naive,
    ranges_alone,
    rms_and_quantum,
    take_for,
)
from benchmarks.markdown import head, row
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Kalman
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Model

READINGS = {  # noise and quantum, in amplitudes of the reference
    "noise 0.2 %": (0.002, 0.0),
    "noise 1 %": (0.01, 0.0),
    "encoder 0.3 %": (0.0, 0.0031),
}


class Entry(NamedTuple):
    """What one row runs.

    Attributes:
        options: of the observer.
        gaps: known, or estimated within the world's `gap_range`.
        mistaken: kind of the sensor that the observer takes it for; empty: what it is.
    """

    options: Options
    gaps: str = "claimed"
    mistaken: str = ""


def known(world: World, widths: Widths) -> Kalman:
    """It knows the widths of the dead zone."""
    right, left = ([max(d - SLIGHT, 0.0), d + SLIGHT] for d in widths[2:])
    return Kalman(right=right, left=left, disturbance=world.disturbance)


ROWS = {
    "both known": Entry(known, "known"),
    "gaps known, `kalman`": Entry(kalman, "known"),
    "`kalman`": Entry(kalman),
    "`censored`": Entry(censored),
    "`censored`, ranges alone": Entry(ranges_alone),
    "`kalman`, taken for a dead zone": Entry(kalman, mistaken="deadzone"),
    "`kalman`, taken for a play": Entry(kalman, mistaken="play"),
    "y taken for z": Entry(naive, "known"),
}


def posed(world: World, reading: str, entry: Entry, seed: int) -> Problem:
    """One random loop.

    Args:
        world: its family.
        reading: of `READINGS`.
        entry: what is run.
        seed: of everything random.
    """
    rng = np.random.default_rng([seed, 181])
    c_r, c_l, d_r, d_l = (float(width) for width in rng.uniform(*world.gaps, 4))
    noise, quantum = rms_and_quantum(world, READINGS[reading])
    sensor = Sensor(right=d_r, left=d_l, play=[c_r, c_l], noise=noise, quantum=quantum)
    declared = [c_r, c_l] if entry.gaps == "known" else [world.gap_range, world.gap_range]
    options = entry.options(world, (c_r, c_l, d_r, d_l))
    scenario = loop(world, sensor, options, rng, seed)
    scenario = msgspec.structs.replace(scenario, model=Model(play=declared))
    problem = resolve_scenario(scenario)
    if not entry.mistaken:
        return problem
    wrong = msgspec.structs.replace(sensor, kind=entry.mistaken, play=None)
    return take_for(problem, world, wrong, options)


def table(
    loops: int = 60, plants: Sequence[str] = (*WORLDS,), readings: Sequence[str] = (*READINGS,)
) -> str:
    """The table, of that many loops a row."""
    names = (
        "plant",
        "readings",
        "observer",
        "rms z - r",
        "ratio to both known",
        "error of the gap, median, 90 % [%]",
        "error of the zone, median, 90 % [%]",
        "gap, zone covered",
    )
    lines = ["## Play and dead zone\n", *head(*names)]
    for place in plants:
        for reading in readings:
            lines += _rows(place, WORLDS[place], reading, loops)
    about = (
        f"{loops} loops a row with random gaps, widths and starts; the last fifth of each is "
        "judged. Gap: c_r + c_l, zone: d_r + d_l. Ratio: of the rms of z - r to that of a filter "
        "that knows all four, median with a 95 % interval. Covered: by claimed 95 % intervals. "
        "Noise and quantum in shares of the reference's amplitude.\n"
    )
    return "\n".join([*lines, "", about])


def _rows(place: str, world: World, reading: str, loops: int) -> list[str]:
    """The rows of one plant and one kind of readings."""
    lines, best = [], None
    for name, entry in ROWS.items():
        ran = run_loops(
            [posed(world, reading, entry, seed) for seed in range(loops)], 0.8 * world.duration
        )
        best = ran.rms if best is None else best
        cells = errors(ran.rms, best)
        cells += ["", "", ""] if entry.options in (known, naive) else _of_widths(ran, entry)
        lines.append(row(place, reading, name, *cells))
    return lines


def _of_widths(ran: Loops, entry: Entry) -> list[str]:
    """The errors of gap and zone, and how often they are covered."""
    wrong, gap, zone = ran.errors.sum(axis=1), "", ""
    covered = f"{np.mean(np.abs(wrong) <= 1.96 * ran.width_std):.2f}"
    zone = _shares(wrong, ran.width)
    if entry.mistaken == "play":  # its widths are gaps
        true = ran.gaps.sum(axis=1)
        wrong = wrong + ran.width - true
        covered = f"{np.mean(np.abs(wrong) <= 1.96 * ran.width_std):.2f}, "
        return [_shares(wrong, true), "", covered]
    of_gap = ""
    if ran.gap_std.size:
        missed = ran.gap_errors.sum(axis=1)
        gap = _shares(missed, ran.gaps.sum(axis=1))
        of_gap = f"{np.mean(np.abs(missed) <= 1.96 * ran.gap_std):.2f}"
    return [gap, zone, f"{of_gap}, {covered}"]


def _shares(wrong: np.ndarray, true: np.ndarray) -> str:
    """Median and 90 % quantile of errors, in percent of the truth."""
    share = 100 * np.abs(wrong) / true
    return f"{np.median(share):.1f}, {np.quantile(share, 0.9):.1f}"
