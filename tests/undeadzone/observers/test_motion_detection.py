"""Straight lines through the last readings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from undeadzone.observers.filtering.motion_detection import update_line


def test_a_line_goes_through_the_first_two_readings() -> None:
    sensor: Any = SimpleNamespace(noise=np.array([0.1]))
    q: Any = SimpleNamespace(gains=(0.01, 0.0001), window=50.0)
    level, slope, known = ca.SX(1, 1), ca.SX(1, 1), ca.SX(1, 1)
    for y in (2.0, 5.0, 8.0):
        state: Any = SimpleNamespace(level=level, slope=slope, known=known)
        level, slope, known = update_line(sensor, q, state, ca.SX(y), ca.SX(1.0))
        assert float(level) == pytest.approx(y)
    assert float(slope) == pytest.approx(3.0)
    assert float(known) == 3.0


def test_a_line_rests_on_one_reading_less_where_one_is_missing() -> None:
    sensor: Any = SimpleNamespace(noise=np.array([0.1]))
    q: Any = SimpleNamespace(gains=(0.01, 0.0001), window=50.0)
    state: Any = SimpleNamespace(level=ca.SX(8.0), slope=ca.SX(3.0), known=ca.SX(3.0))
    level, slope, known = update_line(sensor, q, state, ca.SX(0.0), ca.SX(0.0))
    assert [float(level), float(slope), float(known)] == [11.0, 3.0, 2.0]
