"""Parts of a log: one record of several, the busiest stretches of a long one."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from undeadzone.identification.fit import Fit, refit
from undeadzone.identification.objective import Objective
from undeadzone.identification.plant_fit import Data, Simulator

MANY = 10_000  # samples of a log from which what costs many fits takes a part of it
STRETCH = 5_000  # samples of a stretch of that part


def part_of(data: Data, longest: int = STRETCH) -> Data:
    """The busiest stretches of a log, `MANY` samples in all; the log itself if it is no longer.

    Args:
        data: the records.
        longest: samples of a stretch.
    """
    if data.y.size <= MANY:
        return data
    stretches = []
    for record in data.records():
        stretches += _cut(record, longest)
    stretches.sort(key=lambda one: _passages(data, one), reverse=True)
    kept, count = stretches[:1], stretches[0].stop - stretches[0].start
    for one in stretches[1:]:
        count += one.stop - one.start
        if count > MANY:
            break
        kept.append(one)
    return taken(data, sorted(kept, key=lambda one: one.start))


def _cut(record: slice, longest: int) -> list[slice]:
    """A record in stretches of equal length, nearly."""
    size = record.stop - record.start
    ends = np.linspace(record.start, record.stop, -(-size // longest) + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def _passages(data: Data, part: slice) -> tuple[int, int]:
    """How often a stretch passes the edge that it passes less, and both."""
    side = data.side[part][data.ok[part]]
    right, left = (int(np.count_nonzero(np.diff(1 * (side == sign)) > 0)) for sign in (1, -1))
    return min(right, left), right + left


def taken(data: Data, parts: Sequence[slice]) -> Data:
    """Some samples of a log, each part a record of its own.

    Args:
        data: the records.
        parts: within records, in order.
    """
    kept = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    sizes = [part.stop - part.start for part in parts]
    return data._replace(
        u=data.u[kept],
        y=data.y[kept],
        ok=data.ok[kept],
        side=data.side[kept],
        start=np.cumsum([0, *sizes[:-1]]),
    )


def moved(fit: Fit, data: Data) -> Fit:
    """The fit of other records of the same plant, from where one ended.

    Args:
        fit: of some records.
        data: the others.
    """
    old = fit.objective
    simulator = Simulator(data, old.layout.n, old.layout.integrators)
    objective = Objective(simulator, old.kind, old.limits)
    theta = np.zeros(simulator.layout.size)
    theta[: old.layout.b.stop] = fit.theta[: old.layout.b.stop]
    theta[simulator.layout.right :] = fit.theta[old.layout.right :]
    return refit(Fit(objective, theta, objective.value(theta)), old.kind)


def reduced(fit: Fit) -> Fit:
    """The fit of the busiest part of a long log alone; the same fit where the log is short.

    Args:
        fit: of the log.
    """
    part = part_of(fit.objective.data)
    return fit if part is fit.objective.data else moved(fit, part)


def longest_record(fit: Fit) -> Fit:
    """The fit of the longest of several records alone, and of no more than its busiest stretch.

    Args:
        fit: of one or several records.
    """
    data = fit.objective.data
    longest = max(data.records(), key=lambda part: part.stop - part.start)
    if longest.stop - longest.start < data.y.size:
        data = taken(data, [longest])
    data = part_of(data, MANY)
    return fit if data is fit.objective.data else moved(fit, data)
