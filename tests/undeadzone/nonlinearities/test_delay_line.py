"""A plant whose input acts late: in a loop, along a log, in what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import undeadzone as uz
from undeadzone.scenario.reader import parse

LATE = 7
LINEAR = "A = [[0.0, 1.0], [-4.0, -0.8]]\nB = [0.0, 4.0]\nC = [1.0, 0.0]\n"
PENDULUM = (
    'f = ["speed", "-4 * sin(angle) - 0.8 * speed + 4 * u"]\nh = ["angle"]\n'
    'states = ["angle", "speed"]\n'
)
KALMAN = 'method = "kalman"\nright = [0.1, 0.5]\nleft = [0.1, 0.5]'
ZONE = "right = 0.3\nleft = 0.2\n"
FEEDBACK = 'method = "state_feedback"'
ACTUATOR = (
    '[actuator]\nright = 0.05\nleft = 0.1\nlimit = [-1.5, 1.5]\n[compensator]\nmethod = "inverse"\n'
)


def late(
    samples: int = LATE,
    assumed: int | None = None,
    *,
    plant: str = LINEAR,
    sensor: str = ZONE,
    observer: str = KALMAN,
    controller: str = FEEDBACK,
    more: str = "",
    time: str = "sampled",
) -> uz.Scenario:
    """A loop that steps to 1, whose input acts some samples late."""
    model = "" if assumed is None else f"[model]\ndelay = {assumed}\n"
    return parse(
        f"[plant]\n{plant}delay = {samples}\n[sensor]\n{sensor}\n"
        '[reference]\nkind = "step"\namplitude = 1.0\n'
        f"[observer]\n{observer}\n[controller]\n{controller}\n{model}{more}\n"
        f'[simulation]\nduration = 6.0\ntime = "{time}"\nstep = 0.02\n'
    )


LOOPS: dict[str, dict[str, Any]] = {
    "feedback": {},
    "servo": {"controller": 'method = "lqg"\nintegral = 1.0'},
    "gain": {"controller": 'method = "lqg"'},
    "pid": {"controller": 'method = "pid"\nk_p = 1.0\nk_i = 1.0'},
    "actuator": {"more": ACTUATOR},
    "pendulum": {
        "plant": PENDULUM,
        "observer": 'method = "full_state"',
        "controller": 'method = "lqr"\nQ = 10.0',
    },
    "play": {
        "sensor": f'kind = "play"\n{ZONE}',
        "observer": 'method = "oracle"\nL = [[0.5], [0.5]]',
        "more": "",
    },
}


@pytest.mark.parametrize("loop", LOOPS)
def test_the_loop_is_the_one_without_a_delay_some_samples_later(loop: str) -> None:
    prompt, shifted = (uz.simulate(late(n, **LOOPS[loop])) for n in (0, LATE))
    assert np.abs(prompt.z[-1] - 1.0) < 0.2
    assert np.abs(shifted.z[:LATE]).max() == 0.0
    assert shifted.z[LATE:] == pytest.approx(prompt.z[:-LATE], abs=1e-12)
    assert shifted.u == pytest.approx(prompt.u, abs=1e-9)


def test_a_wrong_known_delay_increases_the_error() -> None:
    right = uz.simulate(late())
    for assumed in (LATE - 1, LATE + 1):
        wrong = uz.simulate(late(LATE, assumed))
        assert np.abs(wrong.z - right.z).max() > 0.01
        assert np.abs(wrong.z - wrong.z_hat).max() > 2 * np.abs(right.z - right.z_hat).max() + 0.01


def test_a_constant_disturbance_is_countered_over_the_delay() -> None:
    more = '[disturbance]\nkind = "step"\namplitude = 0.3\n'
    observer = 'method = "censored"\nright = [0.29, 0.31]\nleft = [0.19, 0.21]\n'
    observer += "disturbance = 0.3\ncorrelation_time = 100.0"
    run = uz.simulate(late(observer=observer, more=more))
    assert run.z[-1] == pytest.approx(1.0, abs=0.01)


def test_a_log_is_followed_as_one_whose_inputs_were_recorded_when_they_acted() -> None:
    run = uz.simulate(late())
    own = uz.estimate(late(), y=run.y, u=run.u)
    assert own.z_hat == pytest.approx(run.z_hat, abs=1e-12)
    acted = np.vstack([np.zeros((LATE, 1)), run.u[:-LATE]])
    prompt = uz.estimate(late(0), y=run.y, u=acted)
    for name in ("x_hat", "d_hat", "z_smooth", "x_smooth_std"):
        assert np.array_equal(getattr(own, name), getattr(prompt, name))
    assert own.consistent == prompt.consistent


def test_certified_gains_are_certified_whatever_the_delay() -> None:
    """The error of an observer that knows what is under way does not hold the input."""
    observer = 'method = "certified"\n'
    prompt, shifted = (uz.check(late(n, observer=observer)) for n in (0, LATE))
    assert shifted.certified
    assert shifted.margin == prompt.margin
    assert shifted.rate == pytest.approx(prompt.rate)
