"""An observer that computes in Python, along a record."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from undeadzone.ends.limits import beyond
from undeadzone.ends.sensor import Zone, side
from undeadzone.engine.interpret import CHUNK
from undeadzone.interfaces import Estimate, InPython, Reading
from undeadzone.support.arrays import Floats


def numeric_along(
    observer: InPython,
    sensor: Zone,
    y: Floats,
    u: Floats,
    seed: int,
    progress: Callable[[int], None] | None = None,
) -> tuple[Estimate, Floats]:
    """The estimates of an observer that computes in Python.

    Args:
        observer: the observer.
        sensor: the dead zone, for its threshold and its range.
        y: readings (N x p), NaN where one is missing.
        u: inputs (N x m), NaN where the last one is held.
        seed: of its random numbers.
        progress: called with the number of steps just done.

    Returns:
        The estimates, a row for each sample in each field, and the measured sides (N x p).
    """
    state = observer.start(seed)
    held = np.zeros(u.shape[1])
    if sensor.limits is not None:
        y = np.where(beyond(y, sensor.limits), np.nan, y)
    sides = side(y, sensor.threshold, sensor.limits)
    rows = []
    for k in range(len(y)):
        held = np.where(np.isfinite(u[k]), u[k], held)
        state, estimate = observer.correct(state, Reading(y[k].copy(), sides[k].copy()))
        rows.append(estimate)
        state = observer.predict(state, held)
        if progress is not None and (k + 1) % CHUNK == 0:
            progress(CHUNK)
    return Estimate(*[np.stack(field) for field in zip(*rows, strict=True)]), sides
