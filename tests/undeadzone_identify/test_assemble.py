"""Answers, in the units of the log."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

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
