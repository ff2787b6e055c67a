"""Widths at the input and at both ends, name and order told: how often intervals hold.

LOOPS_LOGS: logs a row (20); LOOPS_FIRST: seed of the first (500).
"""

from __future__ import annotations

import itertools
import os
from functools import partial

import numpy as np

from benchmarks.identify.logs.loops import LoopLog, make
from benchmarks.markdown import head, row
from benchmarks.results import commit, share
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import Options, log_from_arrays
from undeadzone_identify.logs.prepare import prepare_log
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.measured import measure_fit
from undeadzone_identify.models.plant import PlantSimulator
from undeadzone_identify.models.zone_fit import fit_zone
from undeadzone_identify.selection.location import find_zone_locations


def errors(log: LoopLog) -> list[tuple[float, float]]:
    """Error and half interval of each width, in shares of it; none where nothing fits."""
    grid = to_grid([log_from_arrays(log.step, log.u, log.y)])
    prepared = prepare_log(grid, Options(order=str(log.order)))
    data = prepared.data
    fit = fit_zone(PlantSimulator(data, log.order), prepared.limits)
    truth = {"input": log.input / data.u_scale[0]}
    if log.sensor.any():
        truth["sensor"] = log.sensor / data.y_scale
    places = find_zone_locations(fit, prepared.quantum)
    zoned = places.get("two_zones" if log.sensor.any() else "input_zone")
    if zoned is None:
        return []
    measured = list[Interval]()
    for part in truth:
        levels = partial(zoned.model.part_numbers, name=part)
        intervals = measure_fit(zoned, levels=levels).intervals
        measured += [intervals["right"], intervals["left"]]
    pairs = zip(measured, np.concatenate([*truth.values()]), strict=True)
    return [((one.value - width) / width, one.half_width / width) for one, width in pairs]


def table() -> str:
    """The section of RESULTS.md."""
    first = int(os.environ.get("LOOPS_FIRST", "500"))
    count = int(os.environ.get("LOOPS_LOGS", "20"))
    lines = head("log", "loop", "widths", "error", "90 %", "half", "held")
    for kind, closed in itertools.product(("input zone", "both ends"), (True, False)):
        found = []
        for seed in range(first, first + count):
            found += errors(make(seed, kind, 0.1, closed))
        off, half = np.abs(np.array(found)).T
        cells = [f"{number:.3f}" for number in (*np.quantile(off, [0.5, 0.9]), np.median(half))]
        where = "closed" if closed else "open"
        lines.append(row(kind, where, str(off.size), *cells, share((off < half).tolist())))
    return "\n".join(
        [
            "## Zones of the input and of both ends, name and order told",
            "",
            f"{count} logs a row at commit {commit()}: random loops on y or none"
            " (`benchmarks/identify/logs/loops.py`), disturbance 0.1. Errors and half"
            " intervals in shares of the true width.",
            "",
            *lines,
            "",
        ]
    )
