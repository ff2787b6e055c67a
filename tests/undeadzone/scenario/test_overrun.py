"""What is behind a play has inertia and friction: is it a play at all, and what does it take?"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from benchmarks.loops.behind_play import gap_error
from benchmarks.loops.plants.two_masses import GAIN, TAU, TS, TURN, two_masses

import undeadzone as uz
from scenes import scene, tables_of
from undeadzone.errors import InputError
from undeadzone.scenario.overrun import decelerations
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import build_exosystem
from undeadzone.simulation.simulate import simulate

SINE = {"kind": "sine", "amplitude": 1.0, "frequency": 0.5}
MOTOR = {"A": [[0.0, 1.0], [0.0, -1 / TAU]], "B": [[0.0], [GAIN]], "C": [[1.0, 0.0]]}


def motor(sensor: dict[str, Any], **changes: Any) -> Scenario:
    """A motor that drives a load through gears."""
    tables: dict[str, Any] = tables_of("""
        observer = { method = "kalman", right = [0.0, 0.2], disturbance = 0.05 }
        controller = { method = "state_feedback", poles = [-20.0, -21.0] }
        """) | {
        "plant": MOTOR,
        "sensor": {"kind": "play", "right": 0.06, "left": 0.04, "noise": 1e-3} | sensor,
        "reference": SINE,
        "simulation": {"time": "sampled", "step": TS, "duration": 12.0},
    }
    return scene(**tables | changes)


# The overrun number


def test_check_prints_the_overrun_number() -> None:
    verdict = uz.check(motor({"load_inertia": 1e-3, "load_friction": 0.02}))
    assert verdict.overrun == (pytest.approx(1e-3 * TURN / 0.02, rel=1e-3),)
    assert verdict.summary()["overrun"] == verdict.overrun[0]
    assert "J a / f = 0.493" in repr(verdict)
    assert "overrun" not in uz.check(motor({"load_friction": 0.02})).summary()


def test_a_load_that_coasts_is_refused_before_the_run() -> None:
    with pytest.raises(InputError, match="out of reach for a play at the sensor"):
        simulate(motor({"load_inertia": 2.1e-3, "load_friction": 0.02}))
    simulate(motor({"load_inertia": 2.0e-3, "load_friction": 0.02}))


@pytest.mark.parametrize(("inertia", "coasts"), [(1e-3, False), (4e-3, True)])
def test_live_use_warns_of_a_load_that_coasts(inertia: float, coasts: bool) -> None:
    """Where a run would be refused; once."""
    plain = motor({"load_friction": 0.02}).replace("simulation.duration", 3.0)
    run = simulate(plain)
    sensor = plain.replace("sensor.load_inertia", inertia).sensor
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        online = uz.Online(plain.observer, plain.plant, sensor, TS)
        online.update_many(run.y[:1000], run.u[:1000])
        for y, u in zip(run.y[1000:], run.u[1000:], strict=True):
            online.update(y, u)
    assert ["coasts through its gap" in str(warning.message) for warning in caught] == [
        True
    ] * coasts


def test_a_reference_with_corners_tells_no_deceleration() -> None:
    corners = {"kind": "trapezoid", "amplitude": 1.0, "rise": 0.5, "hold": 1.0}
    verdict = uz.check(motor({"load_inertia": 1.0, "load_friction": 0.02}, reference=corners))
    assert verdict.overrun == (None,)
    assert "corners" in repr(verdict)
    reference = build_exosystem("reference", motor({}, reference=corners).reference, 1)
    for step in (0.007, 0.0073, 0.0204):  # corners lie between samples
        assert np.isnan(decelerations(reference, 8.0, step)).all()


@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_the_deceleration_of_a_sum_is_the_largest_against_its_motion(step: float) -> None:
    tones = [{"amplitude": 1.0, "frequency": 0.5}, {"amplitude": 0.3, "frequency": 1.5}]
    reference = build_exosystem(
        "reference", motor({}, reference={"kind": "sines", "components": tones}).reference, 1
    )
    t = np.linspace(0, 2, 200_001)
    w = 2 * np.pi * np.array([0.5, 1.5])
    rate = np.cos(np.outer(t, w)) @ (w * [1.0, 0.3])
    bend = -np.sin(np.outer(t, w)) @ (w**2 * [1.0, 0.3])
    assert decelerations(reference, 8.0, step)[0] == pytest.approx(
        (-bend * np.sign(rate)).max(), rel=0.03
    )


# Friction


def test_friction_acts_on_the_motor_while_y_moves() -> None:
    """The same input with and without: what z loses is what friction took."""
    exact = {"noise": 0.0}
    plain = simulate(motor(exact, controller={"method": "state_feedback", "K": [[0.0, 0.0]]}))
    rubbed = simulate(
        motor(
            exact | {"load_friction": 0.02},
            controller={"method": "state_feedback", "K": [[0.0, 0.0]]},
        )
    )
    A, B = resolve_scenario(motor(exact)).plant.linear[:2]
    x = plain.x[0]
    for k in range(len(plain.t) - 1):
        x = A @ x + B @ (plain.u[k] - 0.02 * rubbed.side[k])
    np.testing.assert_allclose(rubbed.x[-1], x, atol=1e-9)
    assert np.abs(rubbed.z - plain.z).max() > 0.01


def test_unmodelled_friction_makes_the_gap_small_and_estimated_friction_does_not() -> None:
    """Two masses at an overrun number of 0.1, four gaps (docs/play.md has the table)."""
    friction = 0.02
    logs = [two_masses(0.1 * friction / TURN, friction, seed) for seed in range(4)]
    untold = np.median([gap_error(log, 0.0) for log in logs])
    with_friction = np.median([gap_error(log, friction) for log in logs])
    estimated = np.median([gap_error(log, [0.0, 0.1]) for log in logs])
    assert untold < -0.05
    assert abs(with_friction) < 0.04
    assert abs(estimated) < 0.04
