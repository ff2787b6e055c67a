"""Values with intervals by leaving groups of rows out."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from undeadzone.util.arrays import Flags, Integers
from undeadzone_identify.models.estimates import Interval, student_quantile


def leave_groups_out(estimate: Callable[[Flags], float], groups: Integers) -> Interval:
    """Return an estimate with its 95 % interval by the jackknife over groups.

    Args:
        estimate: value of the rows that are flagged.
        groups: number of the group of each row (N).
    """
    ids = np.unique(groups)
    values = np.array([estimate(groups != one) for one in ids])
    error = math.sqrt((ids.size - 1) * float(np.var(values)))
    half = student_quantile(max(ids.size - 1.0, 1.0)) * error
    return Interval.from_half_width(estimate(np.ones(groups.size, bool)), half)
