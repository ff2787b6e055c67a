"""Contacts of gears along a planned torque, and crossings that show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from undeadzone.analysis.identifiability import flanks
from undeadzone.analysis.identifiability.flanks import (
    StrikeDetector,
    flank_visits,
    gap_identifiability,
    torque_free_position,
)
from undeadzone.analysis.identifiability.linear import WidthIdentifiability
from undeadzone.plants.robots.arm import build_arm
from undeadzone.plants.robots.build import build_two_link
from undeadzone.plants.robots.geared import Coupling, Geared, Gears, build_geared_arm


def first_verdict(
    gears: Geared, speeds: Sequence[float], groups: Sequence[Sequence[int]] = ((0,), (1,))
) -> WidthIdentifiability:
    """The verdict on the first of two links that crosses its gap at these speeds of its motor."""
    rows = 10 * (len(speeds) + 1)
    x, path = np.zeros((rows, 8)), np.zeros((rows, 3, 2))
    x[:, 0] = 0.06 * np.repeat((-1.0) ** np.arange(len(speeds) + 1), 10)
    x[9:-1:10, 4] = speeds
    detector = StrikeDetector(groups, np.full(2, 0.01), 0.2, 1e-3, np.full(2, 1e-4), 50.0)
    return gap_identifiability(gears, gears.values, x, path, 1e-3, detector, bool)[0]


def test_a_load_of_one_sign_presses_on_one_flank() -> None:
    tau = np.concatenate([np.zeros(500), np.ones(500), np.zeros(500)])[:, None]
    assert flank_visits(tau, 0.01).tolist() == [[True, False]]


@pytest.mark.parametrize(
    ("groups", "visible", "known"),
    [
        ([(0,), (1,)], 4, True),
        ([(0,), (1,)], 3, False),
        ([(0, 1)], 3, True),
        ([(0,), (1,)], 0, False),
    ],
)
def test_joint_by_joint_most_crossings_have_to_show(
    groups: Sequence[Sequence[int]], visible: int, known: bool
) -> None:
    """The first link crosses five times, so often fast enough for its strike to show."""
    gears = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))
    verdict = first_verdict(gears, [1.0] * visible + [1e-6] * (5 - visible), groups)
    assert verdict.width == known
    assert verdict.crossings == visible
    if visible and not known:
        assert "2 of 5 crossings show no strike: its link floats in the gap" in verdict.reasons[0]


@pytest.mark.parametrize(("inertia", "known"), [(4e-4, True), (1e-4, False)])
def test_no_gap_is_known_beside_a_motor_that_friction_stops_at_once(
    inertia: float, known: bool
) -> None:
    """Friction of 0.05 N m fades in 0.4 and in 0.1 samples of 1 ms."""
    motors = Gears(half=0.05, inertia=[0.08, inertia], friction=[0.0, 0.05])
    gears = build_geared_arm(build_two_link(), motors)
    verdict = first_verdict(gears, [1.0])
    assert verdict.width == known
    if not known:
        assert (
            "friction stops the light motor of q2 (inertia 0.0001) within 0.1"
            in (verdict.reasons[0])
        )


@pytest.mark.parametrize(
    ("ratios", "known"), [((6.0, 8.1), False), ((1.9, 8.1), True), ((6.0, 7.9), True)]
)
def test_a_joint_that_moves_with_a_lost_one_is_lost(
    monkeypatch: pytest.MonkeyPatch, ratios: tuple[float, float], known: bool
) -> None:
    gears = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))
    couplings = [Coupling(ratios[0], 1), Coupling(ratios[1], 0)]
    monkeypatch.setattr(flanks, "largest_couplings", lambda *_: couplings)
    verdict = first_verdict(gears, [1.0])
    assert verdict.width == known
    assert known or "moves with q2 (coupling 6), whose own gap" in verdict.reasons[0]


def test_a_joint_is_free_of_torque_where_its_link_stands_upright_or_hangs() -> None:
    """The second link, however the first one stands; the nearer of both positions."""
    arm = build_arm(build_two_link())
    for first in (-2.0, -0.7, 0.4):
        for upright in (-0.5, 0.5):
            upright_angle = upright * np.pi - first
            found = torque_free_position(arm, arm.values, np.array([first, upright_angle + 0.9]), 1)
            assert found == pytest.approx(upright_angle, abs=1e-5)
