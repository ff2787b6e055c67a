"""Nothing that is shown depends on the units of time, of z and of u."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import undeadzone as uz
from scenes import seeds
from undeadzone.linalg.hold import discretise_noise, zoh, zoh_slopes
from undeadzone.linalg.matrices import Matrices, companion_form
from undeadzone.nonlinearities.sensor import resolve
from undeadzone.observers.filtering.prior import Assumptions, build_prior
from undeadzone.plants.build import system
from undeadzone.plants.system import (
    moving_poles,
    plant_pace,
    sample_plant,
    state_units,
    time_scale,
)
from undeadzone.results.scales import plant_scales
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.scenario.schema import Scenario
from undeadzone_studies.ensemble.metrics import Tally, metric_rows

POLES = -np.array([1.0, 1.5, 2.0, 3.0])  # [1/s]
MISMATCH = np.array([1.05, 0.95, 1.05, 0.95])  # of the model's coefficients
OBSERVERS = {
    "kalman": {"right": [0.0, 2.0], "disturbance": 0.1},
    "censored": {"right": [0.0, 2.0]},
    "extended": {"right": [0.0, 2.0]},
    "certified": {},
}


def scenario(time: float, z: float, u: float, method: str, duration: float = 3.0) -> Scenario:
    """The same fourth-order problem in units of which the usual ones hold `time`, `z` and `u`."""
    scale = {"observer.right": z, "observer.disturbance": u}
    options = {
        name: (np.array(value) * scale[f"observer.{name}"]).tolist()
        for name, value in OBSERVERS[method].items()
    }

    def matrices(shares: Any) -> dict[str, Any]:
        A, B, C = companion_form(np.poly(POLES / time)[:0:-1] * shares)
        gain = np.prod(POLES / time) * z / u
        return {"A": A.tolist(), "B": (gain * B).tolist(), "C": C.tolist()}

    return convert(
        {
            "title": "Fourth order",
            "plant": matrices(1.0),
            "model": matrices(MISMATCH),
            "sensor": {"right": 0.4 * z, "left": 0.7 * z, "noise": 0.01 * z},
            "reference": {"kind": "sine", "amplitude": 3.0 * z, "frequency": 0.3 / time},
            "disturbance": {"kind": "random", "rms": 0.2 * u, "correlation_time": 0.3 * time},
            "observer": {"method": method, **options},
            "controller": {"method": "state_feedback", "poles": (1.5 * POLES / time).tolist()},
            "simulation": {"time": "sampled", "duration": duration * time, "step": 0.02 * time},
        }
    )


def scaled_signals(run: uz.Run, time: float, z: float) -> dict[str, np.ndarray]:
    """What a run shows, in the usual units."""
    of_states = z * time ** -np.arange(4.0)
    signals = {"z_hat": run.z_hat / z, "d_hat": run.d_hat / z, "x_hat": run.x_hat / of_states}
    if run.d_std is not None:
        signals |= {"d_std": run.d_std / z, "x_std": run.x_std / of_states}
    return signals


@pytest.mark.parametrize("method", OBSERVERS)
def test_a_run_is_the_same_in_any_units(method: str) -> None:
    usual = scaled_signals(uz.simulate(scenario(1.0, 1.0, 1.0, method)), 1.0, 1.0)
    units = [(1e-6, 1e-6, 1e6), (1e6, 1e6, 1e-6)]
    for time, z, u in units[: 1 if method == "censored" else 2]:  # which is slow to build
        run = uz.simulate(scenario(time, z, u, method))
        for name, signal in scaled_signals(run, time, z).items():
            size = np.abs(usual[name]).max(axis=0)
            assert (np.abs(signal - usual[name]) <= 1e-6 * size).all(), (name, time, z, u)


@pytest.mark.parametrize("time", [1e-6, 1e6])
def test_a_check_is_the_same_in_any_units(time: float) -> None:
    usual = uz.check(scenario(1.0, 1.0, 1.0, "certified")).summary()
    other = uz.check(scenario(time, 1e6, 1e-6, "certified")).summary()
    for name in ("certified", "never", "states", "identifiable", "reasons", "cures"):
        assert other[name] == usual[name], name
    assert other["margin"] == pytest.approx(usual["margin"], rel=1e-6)
    assert other["rate"] * time == pytest.approx(usual["rate"], rel=1e-6)
    assert other["frequency"] * time == pytest.approx(usual["frequency"], rel=1e-6)
    assert other["l2_gain"]["noise"] == pytest.approx(usual["l2_gain"]["noise"], rel=1e-4)
    for name, std in usual["std"].items():
        assert other["std"][name] / 1e6 == pytest.approx(std, rel=2e-6), name


def test_states_that_are_large_in_their_unit_have_not_diverged() -> None:
    """In microseconds the third derivative of z is beyond 1e18, which no ensemble calls lost."""
    problem = resolve_scenario(scenario(1e-6, 1.0, 1.0, "kalman"))
    scales = plant_scales(problem)
    states = 10 * scales.states[None]
    assert states.max() > 1e18
    one, none = np.ones((1, 1)), np.zeros((1, 0))
    tally = Tally(one, one, one, one, one, one, one, one, none, none)
    for factor, lost in ((1.0, 0.0), (1e12, 1.0), (np.nan, 1.0)):
        assert metric_rows(tally, factor * states, scales, 10, 5, 1)[0, -1] == lost


def random_plant(rng: np.random.Generator, n: int) -> Matrices:
    """A plant of mean poles near 1, observable and controllable as good as surely."""
    A = rng.normal(size=(n, n)) / np.sqrt(n) - 0.7 * np.eye(n)
    return Matrices(A, rng.normal(size=(n, 2)), rng.normal(size=(2, n)))


def in_units(linear: Matrices, states: np.ndarray, time: float) -> Matrices:
    """The plant with states and time counted in other units."""
    A, B, C = linear
    return Matrices(A / states[:, None] * states / time, B / states[:, None] / time, C * states)


@given(seeds, st.integers(1, 5), st.floats(-6, 6), st.floats(-4, 4))
@settings(max_examples=60, deadline=None)
def test_sampling_does_not_depend_on_units(seed: int, n: int, decades: float, step: float) -> None:
    """Hold, its slopes and the noise of a step, for states in units of powers of time too."""
    rng = np.random.default_rng(seed)
    usual, time, Ts = random_plant(rng, n), 10.0**decades, 2.0**step
    states = time ** -np.arange(n, dtype=float) * 10 ** rng.uniform(-1, 1, n)
    other = in_units(usual, states, time)
    square, across = states / states[:, None], 1 / states[:, None]
    both = np.hstack([square, np.tile(across, 2)])
    direction = rng.normal(size=(n, n + 2))
    W = usual.B @ usual.B.T
    pairs = [
        (zoh(usual, Ts).A * square, zoh(other, Ts * time).A),
        (zoh(usual, Ts).B * across, zoh(other, Ts * time).B),
        (
            zoh_slopes(np.hstack(usual[:2]), [direction], Ts) * both,
            zoh_slopes(np.hstack(other[:2]), [direction * both / time], Ts * time),
        ),
        (
            discretise_noise(usual.A, W, Ts)[1] / np.outer(states, states),
            discretise_noise(other.A, W / np.outer(states, states) / time, Ts * time)[1],
        ),
    ]
    scales = [square, across, both, 1 / np.outer(states, states)]
    for (expected, found), scale in zip(pairs, scales, strict=True):
        size = np.abs(expected / scale).max()
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9 * size)


def test_slopes_of_a_fast_companion_are_those_of_the_slow_one() -> None:
    """By differences of the exponential of the slow plant, scaled."""
    n, time, Ts, h = 4, 1e-4, 0.02, 1e-6
    slow = companion_form(np.poly(POLES)[:0:-1])
    states = time ** -np.arange(n, dtype=float)
    fast = companion_form(np.poly(POLES / time)[:0:-1])
    for row, column in ((3, 0), (3, 3)):
        direction = np.zeros((n, n + 1))
        direction[row, column] = fast.A[row, column]
        found = zoh_slopes(np.hstack(fast[:2]), [direction], Ts * time)[:, :n]
        ends = []
        for sign in (1, -1):
            A = slow.A.copy()
            A[row, column] *= 1 + sign * h
            ends.append(expm(A * Ts))
        expected = (ends[0] - ends[1]) / 2 / h
        scaled = found * states / states[:, None]
        np.testing.assert_allclose(scaled, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@given(seeds, st.integers(1, 5), st.floats(-6, 6))
@settings(max_examples=60, deadline=None)
def test_the_pace_of_a_plant_follows_its_unit_of_time(seed: int, n: int, decades: float) -> None:
    rng = np.random.default_rng(seed)
    usual, time = random_plant(rng, n), 10.0**decades
    states = 10 ** rng.uniform(-3, 3, n)
    other = in_units(usual, states, time)
    assert plant_pace(other) * time == pytest.approx(plant_pace(usual), rel=1e-9)
    assert time_scale(other) / time == pytest.approx(time_scale(usual), rel=1e-9)
    assert state_units(other) * states == pytest.approx(state_units(usual), rel=1e-9)


def test_the_scale_of_the_input_is_that_of_the_continuous_plant() -> None:
    """However fast it is sampled; in a unit twice as large it is half the number."""
    inputs = []
    for step, u in ((1e-2, 1.0), (1e-3, 1.0), (1e-3, 0.5)):
        given = scenario(1.0, 1.0, u, "kalman")
        simulation = uz.Simulation(time="sampled", duration=3.0, step=step)
        changed = msgspec.structs.replace(given, simulation=simulation)
        inputs.append(plant_scales(resolve_scenario(changed)).input)
    assert inputs[1] == pytest.approx(inputs[0], rel=0.05)
    assert inputs[2] == pytest.approx(inputs[1] / 2, rel=1e-6)


def test_a_pole_that_must_be_stabilised_counts_twice() -> None:
    stable, unstable = (Matrices(np.array([[a]]), np.eye(1), np.eye(1)) for a in (-3.0, 3.0))
    assert time_scale(stable) == pytest.approx(np.pi / 6)
    assert time_scale(unstable) == pytest.approx(np.pi / 12)
    swing = Matrices(np.array([[0.0, 1.0], [-9.0, 0.0]]), np.eye(2)[:, 1:], np.eye(2)[:1])
    assert time_scale(swing) == pytest.approx(np.pi / 6)


@pytest.mark.parametrize("time", [1e-6, 1.0, 1e3])
def test_a_chain_of_integrators_has_the_time_of_its_samples(time: float) -> None:
    """What a filter assumes of it is the same in any unit of time."""
    chain = Matrices(np.eye(2, k=1), np.eye(2)[:, 1:], np.eye(2)[:1])
    assert time_scale(chain) == 1.0
    assert time_scale(chain, 0.01 * time) == pytest.approx(0.5 * time)
    assert plant_pace(chain, 0.01 * time) == pytest.approx(np.pi / time)
    np.testing.assert_allclose(state_units(chain, 0.01 * time), [1.0, np.pi / time])
    built = []
    for unit in (1.0, time):
        plant = uz.Plant(A=chain.A, B=chain.B / unit**2, C=chain.C)
        model = sample_plant(system(plant), 0.01 * unit)
        sensor = resolve(uz.Sensor(right=1.0, left=1.0, noise=0.1), 1, 0.01 * unit)
        prior = build_prior(Assumptions(right=[0.0, 2.0]), model, sensor, wear=0.1)
        built.append(prior)
    np.testing.assert_allclose(built[1].std * [1.0, time, 1.0, 1.0], built[0].std)
    np.testing.assert_allclose(built[1].drift, built[0].drift)


def test_integrators_and_slow_poles_are_distinguished_in_any_unit_of_time() -> None:
    for rate in (1e-8, 1.0, 1e8):
        motor = np.array([[0.0, 1.0], [0.0, -rate]])
        built = system(uz.Plant(A=motor, B=[[0.0], [rate]], C=[[1.0, 0.0]]))
        assert moving_poles(built) == pytest.approx([rate])
    equal = companion_form(np.poly(-np.full(4, 2.5))[:0:-1])
    assert plant_pace(equal) == pytest.approx(2.5, rel=1e-12)
    assert state_units(equal) == pytest.approx(2.5 ** np.arange(4), rel=1e-12)
