"""How readings move."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone_identify.models.motion import _has_chatter, are_exact


def test_ticks_that_reverse_at_once_are_noise() -> None:
    rising = np.tile([1.0, 0.0, 0.0], 40)
    turns = rising.copy()
    turns[1::15] = -2.0  # at once, but by another move than the one before
    assert not _has_chatter(turns)
    back = rising.copy()
    back[1::15] = -1.0
    assert _has_chatter(back)


@pytest.mark.parametrize(("backward", "noise"), [(1, False), (2, True)])
def test_more_than_one_reversed_turn_in_twenty_is_noise(backward: int, noise: bool) -> None:
    """Each tick back is two turns, of 40 and of 41 pairs of ticks."""
    change = np.tile([1.0, 0.0, 0.0], 40)
    change[1 + 30 * np.arange(backward)] = -1.0
    assert _has_chatter(change) is noise


def test_a_change_across_a_missing_reading_is_none() -> None:
    """An encoder counts down, and its reading before every tick is missing."""
    count = 200
    y = 50.0 - np.repeat(np.arange(count // 10), 10)
    ok = np.ones(count, bool)
    ok[8::10] = False
    assert are_exact(y, ok, np.array([0]))
