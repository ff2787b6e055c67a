"""Answers, in the units of the log."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import undeadzone as uz
from undeadzone_identify.models.kalman import NAMES
from undeadzone_identify.results.assemble import Answer


def test_both_parts_of_a_disturbance_have_the_unit_of_readings() -> None:
    """Of readings whose rms is 20, and a part that fades by e in two samples of 0.1 s."""
    model = 1
    fit = SimpleNamespace(
        rho=0.6065306597126334, objective=SimpleNamespace(kind="ahead"), disturbance_rms=0.3
    )
    answer: Any = SimpleNamespace(
        case=SimpleNamespace(grid=SimpleNamespace(step=0.1)),
        scale=20.0,
        element=None,
        fit=fit,
        found=SimpleNamespace(kalman=[SimpleNamespace(white_rms=0.05, model=model)]),
    )
    of_answer: Any = Answer.disturbance
    found = of_answer.fget(answer)
    assert found[:3] == pytest.approx((6.0, 0.2, 1.0))
    assert found[3:] == (NAMES[model], True)


def test_a_zero_that_drifts_is_in_the_intervals_of_both_edges() -> None:
    """It is ahead of the zone: the fitted edges hold its mean, and their sum does not move."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.normal(0.0, 2.0, 200), 10)
    z = lfilter([0.0, 0.1], [1.0, -0.9], u) + np.linspace(0.0, 0.15, u.size)
    y = z - np.clip(z, -0.3, 0.5) + 0.01 * rng.standard_normal(u.size)
    found = uz.identify(t=0.05, u=u, y=y, order=1)
    assert found.right.low < 0.35 < 0.5 < found.right.high
    assert found.left.low < 0.3 < 0.45 < found.left.high
    assert found.width.low < 0.8 < found.width.high < 0.85
    assert any("the zero drifts by 0." in one for one in found.numbers()["remarks"])
