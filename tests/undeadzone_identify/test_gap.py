"""The gap of a servo: what its crossings say of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from undeadzone_identify.servo import gap
from undeadzone_identify.servo.likelihood import At


@pytest.mark.parametrize(("apart", "doubted"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize("y_scale", [1.0, 0.05, 40.0])
def test_crossings_may_differ_by_the_noise_of_readings(
    monkeypatch: pytest.MonkeyPatch, y_scale: float, apart: float, doubted: bool
) -> None:
    """Noise of 0.02 and nothing else, in units of the readings, whatever these are."""
    monkeypatch.setattr(gap, "_slow_torque_rms", lambda one: 0.0)
    monkeypatch.setattr(gap, "reading_noise_rms", lambda log: 0.02)
    theta = np.zeros(len(At))
    theta[At.GAP] = 3.0
    fitted, allowed = 3.0 * y_scale, gap.NOISES * 0.02 * y_scale + gap.CLOSE * 3.0 * y_scale
    crossings = SimpleNamespace(median_gap=fitted - apart * allowed, median_error=0.0)
    found: Any = SimpleNamespace(
        log=SimpleNamespace(ticks=False, y_scale=y_scale),
        crossings=crossings,
        reversals=1000,
        servo=SimpleNamespace(theta=theta),
    )
    spread: Any = SimpleNamespace(error=0.0)
    reasons = gap._collect_motion_doubts(found, spread)
    assert [("crossings one by one" in one) for one in reasons] == [True] * doubted


def test_crossings_lose_the_bias_of_simulated_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated logs of a gap of 0.6 show 0.7, 0.72 and 0.75: 0.12 too much."""
    medians = iter((0.7, 0.75, 0.72))
    monkeypatch.setattr(
        gap, "find_crossings", lambda log, one: SimpleNamespace(median_gap=next(medians))
    )
    theta = np.zeros(len(At))
    theta[At.GAP] = 0.2
    logs: Any = [SimpleNamespace(y_scale=3.0)] * 3
    seen: Any = SimpleNamespace(gap=np.array([0.8, 0.9]))
    seen._replace = lambda gap: gap
    one: Any = SimpleNamespace(theta=theta)
    corrected: Any = gap._correct_crossing_bias(seen, logs, one)
    assert corrected == pytest.approx([0.68, 0.78])
