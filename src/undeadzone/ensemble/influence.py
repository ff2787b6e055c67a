"""What a metric owes to each varied entry: correlations and Sobol indices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from undeadzone.statistics import sensitivity
from undeadzone.statistics.intervals import Interval
from undeadzone.statistics.sensitivity import Correlation
from undeadzone.support.arrays import Floats

JUDGED: Final = 2**16  # runs from which sensitivities are found


class Sensitivity(NamedTuple):
    """What a metric owes to one varied entry.

    Attributes:
        spearman: rank correlation
        partial: partial rank correlation, the other entries being held
        first_order: first-order Sobol index, from the design if it is Saltelli's, else from the
            runs as they are
        floor: first_order that chance alone reaches once in twenty; None under Saltelli's design
        total_order: total Sobol index; None but under Saltelli's design
    """

    spearman: Correlation
    partial: Correlation
    first_order: Interval
    floor: float | None
    total_order: Interval | None

    @property
    def influence(self) -> float:
        """The share of the variance (of that of the ranks if larger) that comes from the entry."""
        return max(self.spearman.value**2, (self.total_order or self.first_order).value)


def sensitivities(
    varied: Mapping[str, Floats], values: Floats, independent: slice, sampling: str
) -> dict[str, Sensitivity]:
    """The sensitivities by entry, the most influential first; none for too few runs.

    Args:
        varied: the values of the varied entries (runs each)
        values: of the metric (runs); runs without a finite one are left out
        independent: the runs that are independent of each other
        sampling: how the values were drawn
    """
    kept = np.flatnonzero(np.isfinite(values[independent]))[:JUDGED]
    entries = np.column_stack([column[kept] for column in varied.values()])
    from_runs = sensitivity.given(entries, values[kept])
    by_entry = [Sensitivity(*each, None) for each in from_runs]
    if sampling == "saltelli":
        blocks = values.reshape(len(varied) + 2, -1)[:, :JUDGED]
        by_entry = [
            one._replace(first_order=index.first, floor=None, total_order=index.total)
            for one, index in zip(by_entry, sensitivity.saltelli(blocks), strict=False)
        ]
    pairs = zip(varied, by_entry, strict=False)
    return dict(sorted(pairs, key=lambda pair: -pair[1].influence))
