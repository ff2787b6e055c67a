"""Logs of plants behind a zone, and what `identify` makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.identify.logs.strangers import zone as dead_zone  # noqa: F401
from scipy.signal import lfilter

import undeadzone as uz
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.plant import RecordData


def steps(rng: np.random.Generator, size: int, hold: int = 12) -> Floats:
    """Random levels, each held for so many samples."""
    return np.repeat(rng.standard_normal(size // hold + 1), hold)[:size]


def second_order(u: Floats) -> Floats:
    """The output of a plant of second order."""
    return np.asarray(lfilter([0.0, 0.05, 0.03], [1.0, -1.6, 0.68], u))


def driven(seed: int, size: int = 1000) -> tuple[np.random.Generator, Floats, Floats]:
    """Random steps u, and the output z of a second-order plant."""
    rng = np.random.default_rng(seed)
    u = steps(rng, size)
    return rng, u, second_order(u)


def logged(
    u: Floats, y: Floats, starts: tuple[int, ...] = (0,), silent_zeros: bool = False
) -> RecordData:
    """A record as it is, without scales."""
    side, ok = np.sign(y).astype(int), np.ones(y.size, bool)
    return RecordData(u[:, None], y, ok, np.array(starts), side, silent_zeros, np.ones(1), 1.0)


def identify_log(log: Any, **more: object) -> uz.Identified:
    """What a log says where nothing else is told."""
    answer = uz.identify(t=log.step, u=log.u, y=log.y, **more)
    assert isinstance(answer, uz.Identified)
    return answer


def identify_second_order(u: Floats, y: Floats, **more: object) -> uz.Identified:
    """What a log says of a plant of second order without a delay."""
    answer = uz.identify(t=0.05, u=u, y=y, **{"order": 2, "delay": 0} | more)
    assert isinstance(answer, uz.Identified)
    return answer


def holds(interval: Any, truth: float) -> bool:
    """Whether an interval holds the truth."""
    return bool(interval.low <= truth <= interval.high)


def holds_both(answer: Any, right: float, left: float) -> bool:
    """Whether the intervals of both edges hold the truth."""
    return holds(answer.right, right) and holds(answer.left, left)


def write_log(path: Path | str, header: str, step: float, *columns: Floats) -> None:
    """Write columns behind their times to a CSV file."""
    table = np.column_stack([step * np.arange(len(columns[0])), *columns])
    np.savetxt(path, table, delimiter=",", header=header, comments="")
