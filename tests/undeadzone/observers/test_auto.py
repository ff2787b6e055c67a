"""The observer that is chosen from what is claimed.

Which one, that it is that one, that it never sees the truth, that it leads.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from scenes import PAPER_PLANT, scene
from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import Sensor, Zone, resolve
from undeadzone.observers import Auto, Censored, Certified, HighGain
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import System, sample_plant
from undeadzone.simulation.simulate import simulate
from undeadzone.util import tree
from undeadzone_arena.contest.leaderboard import compute_regrets
from undeadzone_arena.contest.methods import Method
from undeadzone_arena.contest.scenario_sets import arena_scenarios
from undeadzone_arena.contest.trials import score_methods

RANGE = [0.3, 2.0]
NOTHING_ELSE = {"disturbance": 0.0, "bias": 0.0, "tolerance": 0.0}
MODEL = sample_plant(PAPER_PLANT, 0.01)
PENDULUM = system(
    Plant(states=["a", "w"], f=["w", "-g * sin(a) - w + u"], h=["a"], parameters={"g": 9.81})
)
INTEGRATORS = system(Plant(integrators=2))


def zone(kind: Any = "deadzone", right: float = 1.0, left: float = 0.6) -> Zone:
    return resolve(Sensor(right=right, left=left, noise=0.01, kind=kind), 1, 0.01)


@pytest.mark.parametrize(
    ("options", "model", "kind", "expected"),
    [
        ({}, MODEL, "deadzone", Censored),
        ({}, MODEL, "jump", Censored),
        (NOTHING_ELSE, MODEL, "deadzone", Censored),
        ({}, sample_plant(PENDULUM, 0.01), "deadzone", Censored),
        ({}, sample_plant(INTEGRATORS, 0.01), "deadzone", Censored),
        ({}, PAPER_PLANT, "deadzone", HighGain),
        (NOTHING_ELSE, PAPER_PLANT, "deadzone", Certified),
        (NOTHING_ELSE | {"tolerance": {"A[1,0]": 0.1}}, PAPER_PLANT, "deadzone", HighGain),
        (NOTHING_ELSE | {"bias": [0.2]}, PAPER_PLANT, "deadzone", HighGain),
        (NOTHING_ELSE, INTEGRATORS, "deadzone", HighGain),
        (NOTHING_ELSE, PENDULUM, "deadzone", HighGain),
        ({}, PAPER_PLANT, "jump", HighGain),
        (NOTHING_ELSE, PAPER_PLANT, "jump", Certified),
    ],
)
def test_which_observer_is_chosen(
    options: dict[str, Any], model: System, kind: str, expected: type
) -> None:
    chosen = Auto(right=RANGE, **options).choose_observer(model, zone(kind))
    assert type(chosen) is expected
    chosen.build(model, zone(kind))


def test_every_assumption_is_passed_on() -> None:
    options = {
        "right": RANGE,
        "left": [0.1, 1.0],
        "noise": 0.02,
        "x_std": 0.7,
        "drift": 0.01,
        "disturbance": 1.2,
        "correlation_time": 0.3,
        "bias": 0.4,
    }
    options |= {"calibrated": 0.2, "tolerance": {"A[1,0]": 0.1}, "glitches": 0.1, "centre": 0.0}
    assert set(options) == set(Auto.__struct_fields__)
    chosen = Auto(**options).choose_observer(MODEL, zone())
    assert {name: getattr(chosen, name) for name in options} == options


@pytest.mark.parametrize("time", ["continuous", "sampled"])
def test_it_runs_as_the_one_that_it_chooses(time: str) -> None:
    scenario = scene(
        observer={"method": "auto", "right": RANGE},
        sensor={"noise": 0.01},
        simulation={"time": time, "step": 0.005, "duration": 3.0},
    )
    model = PAPER_PLANT if time == "continuous" else sample_plant(PAPER_PLANT, 0.005)
    assert isinstance(scenario.observer, Auto)
    chosen = scenario.observer.choose_observer(model, zone())
    runs = [
        simulate(msgspec.structs.replace(scenario, observer=observer), check_step=False)
        for observer in (scenario.observer, chosen)
    ]
    assert runs[0].info.method == "auto"
    np.testing.assert_array_equal(runs[0].d_hat, runs[1].d_hat)
    assert np.ptp(runs[0].d_hat[:, 0]) > 0


def test_exact_assumptions_in_continuous_time_come_with_a_certificate() -> None:
    run = simulate(
        scene(observer={"method": "auto", "right": RANGE} | NOTHING_ELSE), check_step=False
    )
    assert run.info.certified


@pytest.mark.parametrize("model", [MODEL, PAPER_PLANT])
@pytest.mark.parametrize("kind", ["deadzone", "jump"])
def test_the_true_widths_are_not_looked_at(model: System, kind: str) -> None:
    built = [
        Auto(right=RANGE).build(model, zone(kind, *widths)).params
        for widths in ((0.4, 1.9), (1.0, 0.6))
    ]
    np.testing.assert_array_equal(*(tree.pack_tree(params) for params in built))


def test_ranges_are_required() -> None:
    with pytest.raises(InputError, match="right"):
        scene(observer={"method": "auto"})


def test_with_ranges_alone_it_is_ahead_of_tuned_rivals() -> None:
    grounds = {
        name: arena_scenarios("held_out")[name] for name in ("mismatch_weak", "jump", "dropout")
    }
    unsaid = {"observer.disturbance": None, "observer.bias": None, "observer.drift": None}
    results = score_methods(
        ["kalman", "adaptive_inverse"], grounds, (0,), processes=1
    ) + score_methods({"roughly": Method(Auto, fixed=unsaid)}, grounds, (0,))
    regret = compute_regrets(results)
    for name in ("kalman", "adaptive_inverse"):
        assert (regret["roughly"] < np.nan_to_num(regret[name], nan=1.0)).all()
