"""Truths that no model holds: what is seen is said, and nothing is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benchmarks.strangers_logs import KINDS
from scipy.signal import lfilter

import undeadzone as uz
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats

STEP = 0.01


def walk(rng: np.random.Generator, size: int = 1200, hold: float = 8.0) -> Floats:
    """Coloured noise of rms 1."""
    u = lfilter([1.0], [1.0, -np.exp(-1 / hold)], rng.standard_normal(size))
    return np.asarray(u / u.std())


def two_lags(u: Floats, samples: float = 12.0) -> Floats:
    """A plant of two equal time constants, its output of rms 1."""
    keep = np.exp(-1 / samples)
    for _ in range(2):
        u = lfilter([0.0, 1 - keep], [1.0, -keep], u)
    return np.asarray(u / u.std())


def asked(u: Floats, y: Floats, **more: object) -> uz.Identified:
    answer = uz.identify(t=STEP, u=u, y=y, **more)
    assert isinstance(answer, uz.Identified)
    return answer


def of_kind(kind: str, seed: int) -> uz.Identified:
    log = KINDS[kind].make(np.random.default_rng(seed))
    return asked(log.u, log.y, **log.options)


@pytest.mark.parametrize("samples", [5, 50, 500])
def test_a_linear_motor_has_no_gap(samples: int) -> None:
    """Of 500 samples the log holds four time constants: then nothing is named."""
    answer = of_kind(f"motor of {samples}", 3 if samples == 500 else 1)
    assert answer.verdict == ("unclear" if samples == 500 else "none")
    assert answer.width is None
    if samples == 500:
        assert "ecord for longer" in answer.answer.reasons[0]
        assert not answer.numbers()["odds"]


def test_a_joint_that_rubs_is_named_with_its_friction() -> None:
    """The servo's predictor excludes a gap: its fit is that of friction, in the input's unit."""
    answer = of_kind("joint, friction .3", 1)
    assert answer.verdict == "friction"
    value, low, high = answer.numbers()["friction"]
    assert low < 0.3 < high
    assert value == pytest.approx(0.3, rel=0.03)
    assert "friction" in answer.summary()
    assert "crossings" not in answer.summary()
    assert answer.numbers()["held_out"]["fit"] > 0.99


def test_another_curve_of_the_input_has_no_name_and_no_odds(tmp_path: Path) -> None:
    """A soft limit of the input: nothing known holds it; the command says what it saw."""
    rng = np.random.default_rng(1)
    u = walk(rng)
    y = two_lags(np.tanh(2 * u)) + 0.02 * rng.standard_normal(u.size)
    log = tmp_path / "log.csv"
    rows = np.column_stack([STEP * np.arange(u.size), u, y])
    np.savetxt(log, rows, delimiter=",", header="t,u,y", comments="")
    words = ["identify", str(log), "--json", "--no-figures", "--out", str(tmp_path)]
    assert group.main(words, standalone_mode=False) == 1
    saved = json.loads((tmp_path / "identify.json").read_text())
    assert saved["verdict"] == "unclear"
    assert saved["odds"] == {}
    assert saved["width"] is None
    assert "depends on the size of the input" in saved["reasons"][0]
    assert "record steps" in saved["reasons"][1]
    assert not (tmp_path / "log.toml").exists()


def test_a_dead_zone_leaves_nothing() -> None:
    rng = np.random.default_rng(2)
    u = walk(rng)
    z = two_lags(u)
    y = np.maximum(z - 0.5, 0) + np.minimum(z + 0.35, 0) + 0.02 * rng.standard_normal(u.size)
    answer = asked(u, y)
    assert answer.verdict == "dead_zone"
    assert answer.width is not None
    assert answer.width.low < 0.85 < answer.width.high


# --- Everyday truths


@pytest.mark.parametrize("kind", ["fan", "exponential valve", "cubic input", "root of the input"])
def test_a_curve_of_the_input_is_no_zone(kind: str) -> None:
    """It has neither widths nor a scenario whose inverse would add at each reversal."""
    answer = of_kind(kind, 1)
    assert answer.verdict == "input_curve"
    assert answer.width is None
    assert not answer.zone
    assert "smooth curve" in answer.answer.reasons[0]
    with pytest.raises(InputError, match="no inverse"):
        answer.scenario()


@pytest.mark.parametrize(("kind", "gap"), [("play ahead, 12", 0.5), ("play ahead, 2", 0.9)])
def test_play_ahead_of_the_plant_has_its_gap(kind: str, gap: float) -> None:
    answer = of_kind(kind, 1)
    assert answer.verdict == "input_play"
    assert answer.width is not None
    assert answer.width.low < gap < answer.width.high
    assert answer.width.value == pytest.approx(gap, rel=0.03)
    assert "c width" in answer.summary()
    assert len(answer.answer.poles) == answer.order


def test_a_filter_behind_the_zone_is_no_friction() -> None:
    answer = of_kind("zone, mean of 4", 1)
    assert answer.verdict == "filtered_zone"
    assert answer.zone
    assert "filter off" in answer.answer.reasons[0]
    with pytest.raises(InputError, match="filter"):
        answer.scenario()


def test_a_mean_of_readings_is_no_zone() -> None:
    assert of_kind("mean of 5", 1).verdict == "none"
