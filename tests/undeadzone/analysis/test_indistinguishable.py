"""What `check` says beside the truth: another one with the same readings, and none against it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.design import indistinguishable as bench
from scipy.signal import lsim

from scenes import scene, tables_of
from undeadzone.analysis.identifiability.disturbance import correlation_time, unknown_constants
from undeadzone.analysis.identifiability.indistinguishable import describe_indistinguishable
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Random, Sine
from undeadzone.util.arrays import Floats
from undeadzone.util.text import HALF_95
from undeadzone_design.synthesis.check import check

SLOW = {"kind": "sine", "amplitude": 0.2, "frequency": 0.125}
SAMPLED = {"duration": 20.0, "time": "sampled", "step": 0.01}


def assess_only_output(**changes: Any) -> Any:
    """What `check` knows of the only output."""
    given = {"sensor": {"noise": 0.01}, "simulation": SAMPLED} | changes
    (known,) = check(scene(**given)).known
    return known


@pytest.mark.parametrize("kind", bench.KINDS)
def test_no_yes_leaves_out_another_truth(kind: str, tmp_path: Path) -> None:
    """Of the pairs of `python -m benchmarks indistinguishable` two of each kind."""
    for seed in (101, 102):
        one = bench.pair(kind, seed, tmp_path)
        assert one.unlike < 1e-11
        for truth in (one.first, one.second):
            assert truth is None or not bench.is_certified_apart(truth, one.apart, tmp_path)


def readings(scenario: Scenario, moved: dict[str, Any] | None, u: Floats, t: Floats) -> Floats:
    """What the sensor reads of an input, of the declared truth or of the second one."""
    A, B, C = (np.array(getattr(scenario.plant, name), float) for name in "ABC")
    start, push = np.zeros(len(A)), np.zeros(B.shape[1])
    right, left = (
        float(np.ravel(scenario.sensor.right)[0]),
        float(np.ravel(scenario.sensor.left)[0]),
    )
    if moved is not None:
        start, push = np.array(moved["start"]), np.array(moved["input"])
        right, left = moved["right"], moved["left"]
    z = lsim((A, B, C, np.zeros((1, 1))), u[:, None] + push, t, X0=start)[1]
    return np.asarray(deadzone(np.ravel(z), right, left))


@pytest.mark.parametrize("time", ["sampled", "continuous"])
@pytest.mark.parametrize("disturbance", [{"kind": "step", "amplitude": 0.2}, None])
@pytest.mark.parametrize("integrates", [False, True])
def test_a_second_truth_that_nothing_tells_has_exactly_the_same_readings(
    time: str, disturbance: dict[str, Any] | None, integrates: bool
) -> None:
    plant = {"A": [[0, 1], [-1.0 * (not integrates), -2]], "B": [[0], [1]], "C": [[1, 0]]}
    known = assess_only_output(
        plant=plant, disturbance=disturbance, simulation={**SAMPLED, "time": time}
    )
    t = np.arange(0.0, 10.0, 0.01)
    u = 20.0 * np.cos(1.5 * t)
    if disturbance is None and not integrates:
        assert known.second is None
        return
    assert not known.centre
    assert abs(known.second["right"] - 1.0) == pytest.approx(0.25)
    assert (max(map(abs, known.second["input"])) > 0.1) == (not integrates)
    scenario = scene(plant=plant, sensor={"noise": 0.01})
    one, other = readings(scenario, None, u, t), readings(scenario, known.second, u, t)
    assert np.abs(one).max() > 2.0
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


def test_a_second_truth_within_the_noise_lies_at_the_end_of_the_interval() -> None:
    """A cosine that swings once over the run may be a constant of its rms: d_r +- .42, no less."""
    known = assess_only_output(
        disturbance={"kind": "sine", "amplitude": 0.3, "frequency": 0.05, "phase": 1.57}
    )
    assert known.centre
    assert known.second["right"] - 1.0 == pytest.approx(HALF_95 * known.std["right"], rel=0.01)
    assert known.second["right"] - 1.0 == pytest.approx(HALF_95 * 0.3 / np.sqrt(2), rel=0.01)
    assert known.second["left"] - 1.0 == pytest.approx(1.0 - known.second["right"], rel=0.01)
    assert known.second["input"][0] == pytest.approx(known.second["right"] - 1.0, rel=0.01)
    (words,) = describe_indistinguishable([known.second])
    assert words == (
        "d_r 1.415, d_l 0.5849, a constant 0.415 more at the input and x(0) larger by [0.415, 0]"
    )


def test_no_width_of_a_second_truth_is_negative() -> None:
    known = assess_only_output(
        sensor={"right": 0.1, "left": 0.05, "noise": 0.01},
        disturbance={"kind": "sine", "amplitude": 2.0, "frequency": 0.05},
    )
    assert min(known.second["right"], known.second["left"]) == pytest.approx(0.0, abs=1e-12)
    assert not known.centre
    assert "practically not: noise and disturbances leave" in known.reasons[-1]


def test_an_edge_that_is_never_reached_may_lie_anywhere() -> None:
    offset = {"kind": "sine", "amplitude": 2.0, "frequency": 0.2, "offset": 2.0}
    known = assess_only_output(reference=offset, sensor={"left": 2.5, "noise": 0.01})
    assert (known.right, known.left) == (True, False)
    assert known.second["left"] != 2.5
    assert known.second["right"] == pytest.approx(1.0, abs=1e-6)
    assert known.second["input"] == [0.0]


def test_a_tone_hides_most_of_the_width_at_the_frequency_of_the_reference() -> None:
    """A random signal of its rms, of which little is at that frequency, hides less."""
    tone = {"kind": "sine", "amplitude": 0.3}
    locked = assess_only_output(disturbance={**tone, "frequency": 1.0}).std["width"]
    apart = assess_only_output(disturbance={**tone, "frequency": 0.7}).std["width"]
    noisy = {"kind": "random", "rms": 0.3 / np.sqrt(2), "correlation_time": 0.25}
    assert (
        assess_only_output().std["width"]
        < apart
        < assess_only_output(disturbance=noisy).std["width"]
        < locked
    )


def test_of_a_nonlinear_plant_a_disturbance_counts_as_a_constant_of_its_rms() -> None:
    bent = {"f": ["v", "-x - 0.01 * x**3 - 2 * v + u"], "h": ["x"], "states": ["x", "v"]}
    changes: dict[str, Any] = tables_of("""
        reference = { kind = "sine", amplitude = 2.0, frequency = 0.2 }
        observer = { method = "extended", right = [0.0, 2.0], left = [0.0, 2.0] }
        controller = { method = "state_feedback", poles = [-5.0, -6.0] }
        """) | {"plant": {**bent, "inputs": ["u"]}, "simulation": {**SAMPLED, "duration": 8.0}}
    alone, pushed = assess_only_output(**changes), assess_only_output(**changes, disturbance=SLOW)
    assert alone.second is None
    assert pushed.std["right"] > 5 * alone.std["right"]
    constants, rms = unknown_constants(Sine(amplitude=[0.3, 0.0], frequency=1.0), 2, 10.0)
    assert constants.tolist() == [[1.0], [0.0]]
    assert rms == pytest.approx([0.3 / np.sqrt(2)], rel=1e-3)
    _, rms = unknown_constants(Random(rms=0.3, correlation_time=0.05), 1, 10.0)
    assert rms == pytest.approx([0.03], rel=1e-9)
    _, rms = unknown_constants(Sine(amplitude=0.3, frequency=1.0, offset=0.1), 1, 10.0)
    assert rms.tolist() == [np.inf]


def test_the_correlation_time_is_that_of_the_process() -> None:
    rng, w = np.random.default_rng(1), np.zeros(200_000)
    for k in range(1, w.size):
        w[k] = np.exp(-0.02) * w[k - 1] + rng.normal()
    assert correlation_time(w, 0.01) == pytest.approx(0.5, rel=0.1)
