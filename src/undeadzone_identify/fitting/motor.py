"""Scenario of a motor behind gears with a gap, for a log of torque and the angle of its encoder.

The gap shows in such a log by the load behind it alone: rotor and link have one inertia together in
contact, and the rotor has its own in the gap. `fit` separates them by their equations of contact.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from scipy.optimize import nnls
from scipy.signal import savgol_filter

from undeadzone.logs.kinds import kind_of
from undeadzone.util.own_files import write_own_file
from undeadzone.util.text import fill_words
from undeadzone_identify.logs.grid import Grid

WINDOW: Final = 21  # samples over which derivatives are taken
GAP: Final = 0.3  # largest half gap, in the deviation of the angle
STIFF: Final = 1.5  # frequency of a contact, in samples, ahead of the fit
SHORTEST: Final = 200  # samples
TEXT: Final = """\
# A motor behind gears with a gap, to be fitted to its log.
title = "Motor behind gears"
[plant]
x0 = [@start@, @start@, 0.0, 0.0]
[plant.arm]
kind = "one_link"
[plant.arm.gears]
half = [@half@]
inertia = [@inertia@]
viscous = [@viscous@]
contact = @contact@
measured = "motor"
[plant.parameters]
m = 1.0
l = 1.0
c = 0.0
I = @inertia@
g = 0.0
[sensor]
right = 0.0
left = 0.0
noise = @noise@
[disturbance]
kind = "random"
rms = @rms@
correlation_time = @lasting@
[observer]
method = "contact"
half = [0.0, @widest@]
[simulation]
time = "sampled"
step = @step@
substeps = 5
"""
FREE: Final = (
    "plant.arm.gears.half=0..@widest@,plant.arm.gears.inertia,plant.arm.gears.viscous,"
    "plant.parameters.I,plant.arm.gears.contact,sensor.noise,disturbance.rms"
)


def write_motor(grid: Grid, path: Path, force: bool) -> str | None:
    """Write the scenario of a motor and return its numbers to fit, None for another log.

    Args:
        grid: the log.
        path: of the scenario.
        force: whether a changed file is replaced.

    Raises:
        FileError: it cannot be written.
    """
    kinds = [kind_of(name, grid.input_unit) for name in grid.inputs]
    if kinds != ["torque"] or kind_of(grid.output, grid.output_unit) != "position":
        return None
    if grid.t.size < SHORTEST or not grid.ok.all():
        return None
    smooth, rate, change = (savgol_filter(grid.y, WINDOW, 3, k, grid.step) for k in range(3))
    pushed = savgol_filter(grid.u[:, 0], WINDOW, 3)
    (whole, rubbing), _ = nnls(np.column_stack([change, rate]), pushed)
    inertia = max(whole, 1e-3 * pushed.std() / change.std()) / 2
    widest = GAP * grid.y.std()
    words = {
        "start": grid.y[0],
        "half": widest / 3,
        "widest": widest,
        "inertia": inertia,
        "viscous": max(rubbing, inertia / 100),
        "contact": STIFF / grid.step,
        "noise": np.std(grid.y - smooth),
        "rms": pushed.std() / 100,
        "lasting": 10 * grid.step,
        "step": grid.step,
    }
    short = {name: f"{value:.6g}" for name, value in words.items()}
    write_own_file(fill_words(TEXT, short), path, force)
    return fill_words(FREE, short)
