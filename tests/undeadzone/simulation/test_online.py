"""Live use gives what the sampled loop gives, and survives what a real log holds."""

from __future__ import annotations

import copy
import pickle
import threading
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from test_engines import OBSERVERS, small

import undeadzone as uz
from scenes import scene
from undeadzone.compile import cache

PLANT = uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]], x0=[0.5, 0])
SENSOR = uz.Sensor(right=1.3, left=0.6, noise=0.02)
OBSERVER = uz.Certified(L=[1.0, 1.5], gamma=10.0, widths0=[0.2, 0.2], width_max=3.0)
STEP = 1e-2


def recorded() -> uz.Run:
    return uz.simulate(
        uz.Scenario(
            plant=PLANT,
            sensor=SENSOR,
            observer=OBSERVER,
            reference=uz.Sine(amplitude=5.0, frequency=1.0),
            controller=uz.StateFeedback(poles=[-10.0, -10.0]),
            simulation=uz.Simulation(duration=4.0, time="sampled", step=STEP),
        )
    )


def test_replays_a_recorded_run_exactly() -> None:
    run = recorded()
    online = uz.Online(OBSERVER, PLANT, SENSOR, STEP)
    for k in range(run.t.size):
        live = online.update(run.y[k], run.u[k])
        np.testing.assert_allclose(live.x, run.x_hat[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            np.concatenate([live.right, live.left]), run.d_hat[k], rtol=0, atol=1e-12
        )
        np.testing.assert_array_equal(online.side, run.side[k])
    assert (online.samples, online.missing) == (run.t.size, 0)


@pytest.mark.parametrize("missing", [np.nan, np.inf, -np.inf])
def test_missing_samples_are_predicted_and_counted(missing: float) -> None:
    online = uz.Online(OBSERVER, PLANT, SENSOR, STEP)
    before = online.update(2.0, 1.0)
    gap = online.update(missing, 1.0)
    after = online.update(missing, 1.0)
    assert online.missing == 2
    assert np.isfinite(np.concatenate(after)).all()
    assert (gap.innovation == 0).all()
    assert (online.side == 0).all()
    np.testing.assert_array_equal(gap.z_inverse, gap.z)
    np.testing.assert_array_equal(after.right, gap.right)
    assert (after.x != before.x).all()


def test_missing_input_is_replaced_by_the_last_one() -> None:
    holding, given = (uz.Online(OBSERVER, PLANT, SENSOR, STEP) for _ in range(2))
    holding.update(2.0, 3.0)
    given.update(2.0, 3.0)
    holding.update(2.0, np.nan)
    given.update(2.0, 3.0)
    np.testing.assert_array_equal(holding.update(2.0, 0.0).x, given.update(2.0, 0.0).x)


def test_estimates_are_copies() -> None:
    online = uz.Online(OBSERVER, PLANT, SENSOR, STEP)
    first = online.update(2.0, 1.0)
    earlier = first.x.copy()
    online.update(2.0, 1.0)
    np.testing.assert_array_equal(first.x, earlier)


def test_refuses_what_a_scenario_would_refuse() -> None:
    with pytest.raises(uz.InputError, match="step"):
        uz.Online(OBSERVER, PLANT, SENSOR, 0.0)
    with pytest.raises(uz.StructureError, match="unobservable"):
        uz.Online(OBSERVER, msgspec.structs.replace(PLANT, C=[[0, 0]]), SENSOR, STEP)
    with pytest.raises(uz.StepError, match=r"observer\.gamma"):
        uz.Online(OBSERVER, PLANT, SENSOR, 0.5)


@pytest.mark.parametrize("method", ["certified", "kalman"])
def test_a_compiled_step_has_every_bit_of_the_virtual_machine(method: str) -> None:
    of = small("sampled", observer={"method": method} | OBSERVERS[method][1])
    parts = (of.observer, of.plant, of.sensor, of.simulation.step)
    plain, compiled, blocks = uz.Online(*parts), *(uz.Online(*parts, compiled=True) for _ in "ab")
    compiled.settle()
    plain.settle()
    assert (plain.engine, compiled.engine) == ("virtual machine", "compiled")
    random = np.random.default_rng(3)
    y, u = random.normal(size=(2, 300, 1)) * 2
    y[np.abs(y) < 0.5], y[::17], u[::23] = 0.0, np.nan, np.inf
    every, sides = blocks.update_many(y, u)
    for k in range(len(y)):
        compiled.update_into(float(y[k, 0]), float(u[k, 0]))
        for one, two, three in zip(plain.update(y[k], u[k]), compiled.latest, every, strict=True):
            np.testing.assert_array_equal(one, two)
            np.testing.assert_array_equal(one, three[k])
        assert (plain.side == compiled.side).all()
        assert (plain.side == sides[k]).all()
    assert plain.missing == compiled.missing == blocks.missing == 18


def test_latest_is_one_view_and_unknown_before_the_first_sample() -> None:
    for compiled in (False, True):
        online = uz.Online(OBSERVER, PLANT, SENSOR, STEP, compiled=compiled)
        latest = online.latest
        assert np.isnan(latest.x).all()
        assert (online.side == 0).all()
        assert online.update_into(2.0, 1.0) is None
        first = latest.z.copy()
        online.update_into(np.array([2.5]), np.array([1.0]))
        assert latest is online.latest
        assert latest.z != first


def test_several_outputs_and_inputs_compiled() -> None:
    plant = uz.Plant(A=-np.eye(2), B=np.eye(2), C=np.eye(2))
    sensor = uz.Sensor(right=[1.0, 1.0], left=[1.0, 1.0])
    one, two = (
        uz.Online(uz.Certified(gamma=1.0), plant, sensor, STEP, compiled=c) for c in (False, True)
    )
    for k in range(20):
        y, u = np.array([np.sin(k), np.nan]), np.array([1.0, -k])
        np.testing.assert_array_equal(one.update(y, u).x, two.update(y, u).x)
    two.settle()
    assert (two.missing, two.engine) == (20, "compiled")


def test_samples_run_before_the_code_is_there_and_every_bit_stays(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The virtual machine, then code of no effort, then the best one: exchanged between samples."""
    monkeypatch.setenv("UNDEADZONE_CACHE", str(tmp_path))
    cache.load_or_compile.cache_clear()
    gates = [threading.Event(), threading.Event()]
    compile_text, efforts = cache.compile_text, []

    def wait_and_compile(text: str, effort: int) -> Any:
        gates[len(efforts)].wait(60)
        efforts.append(effort)
        return compile_text(text, effort)

    monkeypatch.setattr(cache, "compile_text", wait_and_compile)
    monkeypatch.setattr(cache, "LONG", 10)
    parts = (OBSERVER, PLANT, SENSOR, STEP)
    plain, online = uz.Online(*parts), uz.Online(*parts, compiled=True)
    engines = []
    y = np.random.default_rng(5).normal(size=(90, 1)) * 3
    for k, sample in enumerate(y):
        if k % 30 == 0 and k:
            gates[k // 30 - 1].set()
            for _ in range(60_000):
                if online.engine != engines[-1]:
                    break
                time.sleep(0.001)
        engines.append(online.engine)
        np.testing.assert_array_equal(plain.update(sample, 1.0).x, online.update(sample, 1.0).x)
    first = "virtual machine, while the step is compiled"
    assert engines == [first] * 30 + ["compiled, first form"] * 30 + ["compiled"] * 30
    assert efforts == [0, 3]
    online.settle()
    cache.load_or_compile.cache_clear()


def test_what_cannot_be_compiled_runs_on_the_virtual_machine_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise uz.InputError("no instruction OP_OF_TOMORROW")

    monkeypatch.setattr(cache, "load_or_compile", refuse)
    monkeypatch.setattr(cache, "read_cached_block", lambda *_: None)
    online = uz.Online(OBSERVER, PLANT, SENSOR, STEP, compiled=True)
    online.settle()
    assert online.engine == "virtual machine: no instruction OP_OF_TOMORROW"
    assert np.isfinite(online.update(2.0, 1.0).x).all()


def test_it_can_be_copied_and_pickled() -> None:
    """What it is made of holds functions: it is built again, and goes on where it was."""
    online = uz.Online(OBSERVER, PLANT, SENSOR, STEP)
    for k in range(30):
        online.update(0.3 * k, 1.0)
    again = [pickle.loads(pickle.dumps(online)), copy.deepcopy(online)]
    first = online.update(np.nan, 0.5)
    for other in again:
        assert repr(other.update(np.nan, 0.5)) == repr(first)
        assert (other.samples, other.missing) == (31, 1)


def test_a_check_can_be_copied_and_pickled() -> None:
    found = uz.check(scene())
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert again.summary() == found.summary()


def test_a_block_may_be_of_plain_lists_and_what_is_masked_is_missing() -> None:
    """Lists were taken for rows of y and u in turn, what is masked for a reading."""
    y, u = [2.0, 2.5, 3.0], [1.0, 0.5, 0.0]
    one, many = (uz.Online(OBSERVER, PLANT, SENSOR, STEP) for _ in range(2))
    z = [one.update(*sample).z for sample in zip(y, u, strict=True)]
    np.testing.assert_array_equal(many.update_many(y, u)[0].z, z)
    hidden = np.ma.array([9.0], mask=[True])
    assert repr(one.update(hidden, 1.0)) == repr(many.update(np.nan, 1.0))
    assert one.missing == 1
    with pytest.raises(uz.ShapeError, match="as many rows, found"):
        many.update_many(np.zeros((3, 1)), np.zeros((2, 1)))


@pytest.mark.parametrize(
    ("plant", "sensor", "message"),
    [
        (OBSERVER, SENSOR, r"plant: expected uz.Plant\(A=.*\), found Certified"),
        (PLANT, None, r"sensor: expected uz.Sensor\(...\), found NoneType"),
    ],
)
def test_wrong_parts_are_named(plant: Any, sensor: Any, message: str) -> None:
    with pytest.raises(uz.InputError, match=message):
        uz.Online(OBSERVER, plant, sensor, STEP)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("simulation", {"step": 0.01}, r"simulation: expected uz.Simulation\(...\), found dict"),
        ("simulation", uz.Simulation(time="discrete"), "simulation.time: unknown choice"),  # type: ignore[arg-type]
        ("simulation", uz.Simulation(time="smpled"), "'smpled'. Did you mean 'sampled'"),  # type: ignore[arg-type]
        ("simulation", uz.Simulation(seed=1.5), "simulation.seed: expected a whole number"),  # type: ignore[arg-type]
        ("plant", msgspec.structs.replace(PLANT, A=np.ma.array(np.eye(2), mask=np.eye(2))), "A: "),
    ],
)
def test_a_scenario_of_a_program_is_read_as_closely_as_a_file(
    key: str, value: Any, message: str
) -> None:
    """An unknown word of time was taken for continuous."""
    with pytest.raises(uz.InputError, match=message):
        uz.simulate(msgspec.structs.replace(scene(), **{key: value}))
    with pytest.raises(uz.InputError, match="scenario: expected"):
        uz.design(None)  # type: ignore[arg-type]
