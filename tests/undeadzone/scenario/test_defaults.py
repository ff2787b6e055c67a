"""What is left out: gains that listen, the observer and controller that nobody names."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from documents import EXAMPLES
from scenes import scene, tables_of
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.controllers import LQR, ComputedTorque, StateFeedback
from undeadzone.errors import InputError
from undeadzone.observers import Auto, Certified, Kalman
from undeadzone.observers.adaptive.gain import default_adaptation, default_gain
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.results.feedback import describe_feedback, has_weak_feedback
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert, read, read_for_logs
from undeadzone.scenario.schema import Units
from undeadzone.simulation.feedback import feedback_shares
from undeadzone.simulation.simulate import simulate

BARE: dict[str, Any] = tables_of("""
plant = { A = [[0.0, 1.0], [-1.0, -2.0]], B = [[0.0], [1.0]], C = [[1.0, 0.0]] }
sensor = { right = 1.0, left = 0.7 }
reference = { kind = "sine", amplitude = 5.0, frequency = 0.5 }
""")


def plant(unit: float) -> System:
    """The same plant in another unit of time."""
    return system(
        Plant(A=[[0.0, 1.0], [-4 * unit**2, -1.2 * unit]], B=[[0.0], [1.0]], C=[[1.0, 0.0]])
    )


@pytest.mark.parametrize("unit", [1e-5, 1.0, 1e4])
def test_default_gains_are_those_of_the_plant_in_any_unit_of_time(unit: float) -> None:
    L, own = default_gain(plant(1.0))[:, 0], default_gain(plant(unit))[:, 0]
    np.testing.assert_allclose(own / [unit, unit**2], L, rtol=1e-6)
    assert default_adaptation(plant(unit)) == pytest.approx(6.0 * unit)


@pytest.mark.parametrize("Ts", [None, 1e-3, 0.1, 0.5])
def test_default_gains_are_certified_and_strong(Ts: float | None) -> None:
    model = plant(1.0) if Ts is None else sample_plant(plant(1.0), Ts)
    L, gamma = default_gain(model), np.array([default_adaptation(model)])
    assert certify(model.linear, L, gamma, Ts).certified
    at_rest = -plant(1.0).linear.C @ np.linalg.solve(plant(1.0).linear.A, L)
    if Ts in (None, 1e-3):
        assert at_rest[0, 0] == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(("Ts", "gamma"), [(0.01, 6.0), (0.25, 2.0)])
def test_widths_adapt_by_at_most_a_half_in_a_sample(Ts: float, gamma: float) -> None:
    """Three mean poles of 2 1/s are 6 1/s, of which samples of 0.25 s leave 2 1/s."""
    assert default_adaptation(sample_plant(plant(1.0), Ts)) == pytest.approx(gamma, rel=0.01)


def test_kalman_corrects_a_wrong_model_unless_the_disturbance_is_0() -> None:
    """With 10 % off in the friction; an assumed disturbance of 0 trusts the model."""
    wrong = {"model": {"A": [[0.0, 1.0], [-1.0, -1.8]]}}
    time = {"simulation": {"time": "sampled", "step": 0.01, "duration": 12.0}}
    error, shares = {}, {}
    for name, options in {"usual": {}, "deaf": {"disturbance": 0.0}}.items():
        observer = {"method": "kalman", "right": [0.0, 3.0]} | options
        scenario = convert(BARE | wrong | time | {"observer": observer})
        run = simulate(scenario)
        error[name] = run.rms_estimation
        shares[name] = feedback_shares(resolve_scenario(scenario), run)
    assert error["usual"] < 0.1 < error["deaf"]
    assert not has_weak_feedback(shares["usual"])
    assert has_weak_feedback(shares["deaf"])


def test_an_observer_without_gain_follows_its_model_alone() -> None:
    scenario = scene("""
        observer = { method = "luenberger", L = [0.0, 0.0] }
        simulation = { duration = 12.0 }
        """)
    (share,) = feedback_shares(resolve_scenario(scenario), None)
    assert share == pytest.approx(0.0, abs=0.01)
    assert describe_feedback([share]).startswith("OPEN LOOP")
    assert not describe_feedback([0.9, None]).startswith("OPEN LOOP")


def test_an_output_at_rest_tells_nothing_of_listening() -> None:
    still = scene(
        """
        reference = { kind = "sine", amplitude = 0.0, frequency = 1.0 }
        simulation = { duration = 2.0 }
        """,
        plant={**BARE["plant"], "x0": [0.0, 0.0]},
    )
    assert np.isnan(feedback_shares(resolve_scenario(still), None)).all()
    assert not has_weak_feedback([None])


def test_a_scenario_that_names_neither_gets_the_usual_ones() -> None:
    scenario = convert(BARE)
    assert isinstance(scenario.observer, Auto)
    assert np.array_equal(np.ravel(scenario.observer.right), [0.0, 3.0])
    assert isinstance(scenario.controller, StateFeedback)
    declared = convert(BARE | {"declared": {"right": [0.2, 1.5], "bias": 0.1}})
    assert isinstance(declared.observer, Auto)
    assert (list(declared.observer.right), declared.observer.bias) == ([0.2, 1.5], 0.1)
    for time in ("continuous", "sampled"):
        step = 1e-3 if time == "continuous" else 0.01
        run = simulate(
            convert(BARE | {"simulation": {"time": time, "step": step, "duration": 10.0}}),
            check_step=False,
        )
        assert run.rms_tracking < 0.1


@pytest.mark.parametrize(
    ("arm", "time", "expected"),
    [
        ("one_link", "continuous", ComputedTorque),
        ("elastic_joint", "sampled", LQR),
        ("elastic_joint", "continuous", StateFeedback),
    ],
)
def test_arms_get_controllers_of_their_own(arm: str, time: str, expected: type) -> None:
    scenario = convert(BARE | {"plant": {"arm": {"kind": arm}}, "simulation": {"time": time}})
    assert isinstance(scenario.controller, expected)


def test_along_a_log_a_range_must_come_from_somewhere(tmp_path: Any) -> None:
    path = tmp_path / "log.toml"
    path.write_text("[plant]\nsecond_order = { zeta = 0.5, omega_n = 4.0, gain = 16.0 }\n")
    with pytest.raises(InputError, match=r"observer: missing. Name one and the range"):
        read_for_logs(path)


def test_options_keep_what_is_given() -> None:
    model = plant(1.0)
    given = Certified(L=[1.0, 1.5], gamma=10.0).build(model, resolve_scenario(scene()).sensor)
    assert given.traits.L is not None
    assert np.array_equal(given.traits.L[:, 0], [1.0, 1.5])
    assert Kalman(right=[0.0, 1.0]).disturbance is None


def test_states_of_an_arm_are_angles_then_rates() -> None:
    arm = read(EXAMPLES / "two_link.toml")
    arm = msgspec.structs.replace(arm, units=Units())  # the file names its own
    assert resolve_scenario(arm).scenario.units.state == ["rad", "rad", "rad/s", "rad/s"]
