"""Filter of a signal without an input: joystick, scale and flow meter, against what they read."""

from __future__ import annotations

import numpy as np
import pytest

import undeadzone as uz

SIGNAL = uz.Plant(kind="signal")
NOISE = 0.0045


def joystick(seed: int, samples: int = 4000) -> np.ndarray:
    """Return the travel of a stick that rests, moves within 1 to 10 samples, and rests again."""
    rng = np.random.default_rng(seed)
    at = [0.0]
    while len(at) < samples:
        goal = 0.0 if rng.random() < 0.4 else rng.uniform(-1, 1)
        at += [*np.linspace(at[-1], goal, rng.integers(2, 11))[1:], *[goal] * rng.integers(5, 60)]
    return np.array(at[:samples])


def read(z: np.ndarray, seed: int, width: float = 0.12) -> np.ndarray:
    noisy = z + NOISE * np.random.default_rng(seed + 1000).standard_normal(z.size)
    return np.sign(noisy) * np.maximum(np.abs(noisy) - width, 0.0)


def estimate(y: np.ndarray, **sensor: float) -> uz.Estimate:
    zone = uz.Sensor(**({"right": 0.12, "left": 0.12, "noise_before": NOISE} | sensor))
    online = uz.Online(uz.Auto(right=[0.115, 0.125]), SIGNAL, zone, step=0.05)
    return online.update_many(y[:, None], np.zeros((y.size, 0)))[0]


@pytest.mark.parametrize("declared", [NOISE, NOISE / 3, 0.0])
def test_a_stick_is_followed_better_than_by_adding_the_edge(declared: float) -> None:
    z = joystick(1)
    y = read(z, 1)
    found = estimate(y, noise_before=declared)
    outside = y != 0
    error = (found.z[:, 0] - z)[outside]
    added = (y + 0.12 * np.sign(y) - z)[outside]
    assert np.sqrt(np.mean(error**2)) < 0.75 * np.sqrt(np.mean(added**2))
    assert np.abs(error).max() < np.abs(added).max()
    held = (found.low[:, 0] <= z) & (z <= found.high[:, 0])
    assert held.mean() > 0.95
    assert (found.z[~outside] == 0).all()
    assert found.noise[-1, 0] == pytest.approx(NOISE, rel=0.15)


def test_a_missing_reading_is_foretold_and_a_stuck_one_is_no_quality() -> None:
    z = np.sin(0.02 * np.arange(600))
    y = read(z, 3)
    y[60:70] = np.nan  # beyond the edge
    y[400:440] = y[400]
    found = estimate(y)
    assert np.abs(found.z[60:70, 0] - z[60:70]).max() < 0.04
    assert (found.quality[60:70] == 0).all()
    assert (found.consistent[425:440] == 0).all()
    assert (found.consistent[445:] == 1).all()
    assert found.consistent[:400].all()


def test_a_wrong_reading_is_refused_where_some_are_declared() -> None:
    z = joystick(4)
    z[:] = 0.5
    y = read(z, 4)
    y[100::100] += 0.4
    zone = uz.Sensor(right=0.12, left=0.12, noise_before=NOISE)
    online = uz.Online(uz.Auto(right=[0.115, 0.125], glitches=0.01), SIGNAL, zone, step=0.05)
    found = online.update_many(y[:, None], np.zeros((y.size, 0)))[0]
    assert np.abs(found.z[5:, 0] - 0.5).max() < 0.1
    assert found.refused[-1, 0] == len(y[100::100])


@pytest.mark.parametrize("method", [uz.Kalman(right=[0.0, 1.0]), uz.Certified(L=[1, 1], gamma=1.0)])
def test_other_observers_are_refused(method: object) -> None:
    with pytest.raises(uz.InputError, match=r"observer\.method: a signal has no input"):
        uz.Online(method, SIGNAL, uz.Sensor(right=0.12, left=0.12), step=0.05)
