"""Outcomes of variants, from signals."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.interfaces import Estimate
from undeadzone.simulation.loop import Outputs
from undeadzone_paper.printed import LAST, STEP, _build_outcome


@pytest.mark.parametrize("diverged", [None, 700])
def test_an_outcome_tells_the_peak_and_the_largest_steady_amplitude(diverged: int | None) -> None:
    """A peak of 3 at first, then 0 and -0.5 by turns."""
    count = 2 * round(LAST / STEP)
    z = np.where(np.arange(count) % 2, -0.5, 0.0)[:, None]
    z[3] = 3.0
    nothing = np.zeros((count, 1))
    if diverged is not None:
        z[diverged:] = 1e300
    estimate = Estimate(*[np.zeros((count, 0))] * len(Estimate._fields))
    widths = estimate._replace(x=nothing, right=nothing, left=nothing)
    found = _build_outcome(None, Outputs(nothing, z, z, nothing, nothing, widths))
    assert found.peak == 3.0
    assert found.leaves_zone
    assert not found.moves_widths
    assert found.steady == (0.5 if diverged is None else None)
    assert found.diverged_at == (None if diverged is None else pytest.approx(diverged * STEP))
