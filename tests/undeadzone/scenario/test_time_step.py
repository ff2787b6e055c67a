"""Sample times that a system does not allow."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.errors import StepError
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.scenario.time_step import sample_within_limits


def test_a_part_that_overflows_is_refused_though_others_are_finite() -> None:
    """A chain of integrators in tiny units: within a sample the first one leaves all numbers."""
    A, B = np.diag([1e50] * 6, 1), np.eye(7)[:, -2:]
    plant = system(Plant(A=A.tolist(), B=B.tolist(), C=np.eye(7)[:1].tolist()))
    with pytest.raises(StepError, match="matrices overflow"):
        sample_within_limits("plant", plant, 100.0, 1)
