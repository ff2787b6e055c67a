"""The paper's observer and law on a one-link arm behind gears, beside `contact`."""

from __future__ import annotations

import numpy as np
import pytest

import once
from undeadzone.linalg.matrices import Matrices
from undeadzone.plants.options import linear_matrices
from undeadzone_paper.arm import HALF_GAP, WORDS, ArmRuns, hanging_arm, run_arm


@pytest.fixture(scope="module")
def arm() -> ArmRuns:
    return once.audit()[0].evidence.arm


def test_the_linear_arm_is_that_of_uniform_rods() -> None:
    """1.2 kg, 0.5 m, a motor of 0.08 kg m^2: J = 0.18, m g c = 2.943."""
    linear: Matrices = linear_matrices(hanging_arm())
    np.testing.assert_allclose(linear.A, [[0, 1], [-2.943 / 0.18, -0.4 / 0.18]])
    np.testing.assert_allclose(linear.B, [[0], [1 / 0.18]])


def test_contact_follows_within_a_tenth_of_the_gap_and_the_printed_pair_not_at_all(
    arm: ArmRuns,
) -> None:
    assert arm.contact_tracking < HALF_GAP / 10
    assert arm.contact_estimation < HALF_GAP / 10
    for words in WORDS.values():
        assert arm.tracking[words] > 4 * HALF_GAP
        assert arm.estimation[words] > HALF_GAP


def test_the_runs_repeat(arm: ArmRuns) -> None:
    assert run_arm() == arm
