"""Times of programs in interleaved rounds, so that all of them meet the same machine."""

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any


def medians(
    programs: Mapping[str, Callable[[], Any]],
    rounds: int,
    uncounted: int = 0,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """The median time of each program [s].

    Args:
        programs: by name
        rounds: of which each runs every program once
        uncounted: rounds before these, which compile and warm up
        clock: tells the time [s]
    """
    times = _times(programs, rounds, uncounted, clock)
    return {name: statistics.median(values) for name, values in times.items()}


def least(
    programs: Mapping[str, Callable[[], Any]],
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """The least time of each program [s], for rounds so short that some are not disturbed.

    Args:
        programs: by name
        rounds: of which each runs every program once
        clock: tells the time [s]
    """
    return {name: min(values) for name, values in _times(programs, rounds, 1, clock).items()}


def _times(
    programs: Mapping[str, Callable[[], Any]],
    rounds: int,
    uncounted: int,
    clock: Callable[[], float],
) -> dict[str, list[float]]:
    """The times of each program [s] in the rounds that count."""
    times: dict[str, list[float]] = {name: [] for name in programs}
    for k in range(uncounted + rounds):
        for name, program in programs.items():
            began = clock()
            program()
            seconds = clock() - began
            if k >= uncounted:
                times[name].append(seconds)
    return times
