"""How well a log excites both edges: samples and visits a side, silence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.identification.likelihood import Readings
from undeadzone.identification.log import Flags
from undeadzone.support.arrays import Floats

FEW_VISITS = 3  # below these an edge is hardly reached


class Excitation(NamedTuple):
    """What a log says of each edge.

    Attributes:
        samples: readings beyond the right and the left edge.
        visits: how many times each edge was passed.
        silent: share of silent readings.
        longest: samples of the longest silence.
    """

    samples: tuple[int, int]
    visits: tuple[int, int]
    silent: float
    longest: int


def excitation(readings: Readings, z: Floats, right: float, left: float, ahead: bool) -> Excitation:
    """How a log excites the edges.

    Args:
        readings: the record.
        z: output of the fitted plant (N).
        right, left: fitted widths.
        ahead: whether readings show their side: noise ahead of the zone.

    Returns:
        Counts of samples and visits, and the share of silence.
    """
    side = readings.side if ahead else 1 * (z > right) - 1 * (z < -left)
    side = np.where(readings.ok, side, 0)
    silent = readings.ok & (side == 0)
    samples = (int((side > 0).sum()), int((side < 0).sum()))
    visits = (_runs(side > 0), _runs(side < 0))
    return Excitation(samples, visits, float(silent.sum() / readings.ok.sum()), _longest(silent))


def _runs(flags: Flags) -> int:
    """How many runs of True there are."""
    return int(flags[0]) + int((np.diff(flags.astype(int)) > 0).sum())


def _longest(flags: Flags) -> int:
    """The length of the longest run of True."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int((ends[1::2] - ends[::2]).max(initial=0))
