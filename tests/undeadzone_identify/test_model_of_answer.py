"""`Identified` as a model: it simulates, predicts, and goes to python-control and pandas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import undeadzone as uz
from requirements import import_package
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats
from undeadzone_identify.results.model import follow_play

STEP, LATE = 0.05, 2


def plant(u: Floats) -> Floats:
    """Return the output of a lag that acts `LATE` samples late, from rest (N)."""
    late = np.concatenate([np.zeros(LATE), u[: u.size - LATE]])
    return np.asarray(lfilter([0.0, 0.1], [1.0, -0.9], late))


def levels(seed: int, count: int) -> Floats:
    """Return random levels, each held for ten samples (10 count)."""
    return np.repeat(np.random.default_rng(seed).normal(0.0, 2.0, count), 10)


def behind_zone(z: Floats, seed: int) -> Floats:
    """Return readings behind a zone from -0.3 to 0.5, with noise (N)."""
    noise = 0.005 * np.random.default_rng(seed).standard_normal(z.size)
    return np.asarray(z - np.clip(z, -0.3, 0.5) + noise)


@pytest.fixture(scope="module")
def found() -> Any:
    """Return the answer to a log of a sensor's dead zone."""
    u = levels(1, 100)
    return uz.identify(t=STEP, u=u, y=behind_zone(plant(u), 2), order=1, delay=LATE)


def test_it_simulates_another_input(found: Any) -> None:
    u = levels(3, 50)
    z = plant(u)
    simulated = found.simulate(u)
    assert np.abs(simulated.z - z).max() < 0.02
    assert np.abs(simulated.y - (z - np.clip(z, -0.3, 0.5))).max() < 0.02
    assert simulated.t[-1] == pytest.approx(STEP * (u.size - 1))


def test_it_predicts_another_log_one_sample_ahead(found: Any) -> None:
    u = levels(4, 50)
    z = plant(u)
    y = behind_zone(z, 5)
    predicted = found.predict(u=u, y=y)
    speaks = (np.abs(y) > 0.05) & np.isfinite(predicted.y) & (np.arange(u.size) > 50)
    errors = (predicted.y - y)[speaks]
    assert speaks.sum() > 100
    assert 0.004 < np.std(errors) < 0.008, "the noise of the sensor, and little more"
    assert np.std(errors / predicted.y_std[speaks]) == pytest.approx(1.0, abs=0.3)
    inside = (z < 0.4) & (z > -0.2)
    assert np.isnan(predicted.y[inside]).mean() > 0.95, "silence is not predicted by itself"
    # of two steps at once: a prediction of y does not use that y
    changed = y.copy()
    changed[-1] += 0.01
    again = found.predict(u=u, y=changed)
    assert again.y[-1] == pytest.approx(predicted.y[-1], nan_ok=True)


def test_python_control_takes_it(found: Any) -> None:
    control = import_package("control")
    system = found.to_control()
    u = levels(6, 20)
    response = control.forced_response(system, inputs=u)
    assert response.outputs == pytest.approx(found.simulate(u).z, abs=1e-9)
    assert (system.dt, system.input_labels, system.output_labels) == (STEP, ["u"], ["y"])
    own = uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0]).to_control()
    assert np.asarray(own.A) == pytest.approx(np.array([[0, 1], [-1, -2]]))


def test_pandas_takes_the_log_and_the_hidden_output(found: Any) -> None:
    import_package("pandas")
    frame = found.to_pandas()
    assert list(frame.columns) == ["u", "y", "z", "z_std"]
    assert frame.index.name == "t"
    assert frame["z"].to_numpy() == pytest.approx(found.states().z)
    assert np.std(frame["z"] - plant(frame["u"].to_numpy())) < 0.02


def test_a_zone_of_the_input_and_a_gap_are_simulated() -> None:
    u = levels(7, 100)
    driven = u - np.clip(u, -0.4, 0.7)
    noise = 0.005 * np.random.default_rng(8).standard_normal(u.size)
    found = uz.identify(t=STEP, u=u, y=plant(driven) + noise, order=1, delay=LATE)
    assert found.verdict == "input_zone"
    assert np.abs(found.simulate(u).y - plant(driven)).max() < 0.05
    with pytest.raises(InputError, match="expected finite rows of 1"):
        found.simulate(np.ones((3, 2)))


def test_an_input_that_counts_from_elsewhere_is_that_of_the_log() -> None:
    u = 1504.0 + 100.0 * levels(10, 150)
    driven = (u - 1504.0) - np.clip(u - 1504.0, -26.0, 27.0)
    noise = 0.4 * np.random.default_rng(11).standard_normal(u.size)
    found = uz.identify(t=STEP, u=u, y=0.4 * plant(driven) + noise, order=1, delay=LATE)
    assert found.verdict == "input_zone"
    assert np.std(found.simulate(u).y - 0.4 * plant(driven)) < 0.5
    import_package("pandas")
    assert found.to_pandas()["u"].to_numpy() == pytest.approx(u)


def test_a_gap_holds_until_it_is_crossed() -> None:
    z = np.array([0.0, 1.0, 0.5, -0.5, -0.9, 0.0])
    assert follow_play(z, 0.4, 0.6) == pytest.approx([0.0, 0.6, 0.6, 0.1, -0.3, -0.3])


def test_a_verdict_without_a_model_says_so() -> None:
    rng = np.random.default_rng(9)
    found = uz.identify(t=STEP, u=rng.normal(size=400), y=rng.normal(size=400), order=1, delay=0)
    assert found.verdict not in ("dead_zone", "play")
    if found.verdict == "none":
        pytest.skip("noise is a plant of gain 0")
    with pytest.raises(InputError, match=f"simulate: the verdict is {found.verdict}"):
        found.simulate(np.ones(3))
