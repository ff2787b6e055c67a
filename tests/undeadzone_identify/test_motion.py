"""How readings move."""

from __future__ import annotations

import numpy as np

from undeadzone_identify.models.motion import _has_chatter


def test_ticks_that_are_taken_back_at_once_are_noise() -> None:
    rising = np.tile([1.0, 0.0, 0.0], 40)
    turns = rising.copy()
    turns[1::15] = -2.0  # at once, but by another move than the one before
    assert not _has_chatter(turns)
    back = rising.copy()
    back[1::15] = -1.0
    assert _has_chatter(back)
