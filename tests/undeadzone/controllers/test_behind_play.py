"""What is behind a play follows the reference; what happens where its reading is fed back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_engines import gap_of_engines, parts

import undeadzone as uz
from scenes import scene, tables_of
from undeadzone.interfaces import Estimate
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.run_ensemble import replay_deviation, run_ensemble

TS = 5e-3
GAPS = {"right": 0.06, "left": 0.04}
MOTOR = tables_of("""
A = [[0.0, 1.0], [0.0, -10.0]]
B = [[0.0], [100.0]]
C = [[1.0, 0.0]]
""")
KALMAN = {"method": "kalman", "right": [0.0, 0.2], "disturbance": 0.05}
KNOWN = {"method": "oracle", "L": [20.0, 100.0]}
NAIVE = {"method": "luenberger", "poles": [-40.0, -44.0]}
FEEDBACK = {"method": "state_feedback", "poles": [-20.0, -21.0]}


def motor(behind_play: float | None = 60.0, **changes: Any) -> Scenario:
    """A motor that drives through gears, with an encoder behind them."""
    tables: dict[str, Any] = {
        "plant": MOTOR | {"x0": [0.2, 0.0]},
        "sensor": {"kind": "play", "quantum": 0.0031} | GAPS,
        "observer": KALMAN,
        "reference": {"kind": "sine", "amplitude": 1.0, "frequency": 0.5},
        "controller": FEEDBACK,
        "simulation": {"time": "sampled", "step": TS, "duration": 12.0},
        "disturbance": {"kind": "random", "rms": 0.05, "correlation_time": 1e-4},
    }
    if behind_play is not None:
        tables["behind_play"] = behind_play
    return scene(**tables | changes)


def behind(run: Run) -> float:
    """The rms of y / m - r, without the quantum."""
    assert run.rms_behind_play is not None
    return run.rms_behind_play


def test_what_is_behind_the_play_follows_although_the_gap_is_unknown() -> None:
    led = behind(simulate(motor()))
    assert led < behind(simulate(motor(None))) / 6
    assert led < behind(simulate(motor(None, observer=NAIVE))) / 3


def test_a_faster_crossing_is_better_and_costs_more() -> None:
    errors, peaks = [], []
    for rate in (15.0, 30.0, 60.0):
        run = simulate(motor(rate))
        errors.append(behind(run))
        peaks.append(float(np.abs(run.u[run.last]).max()))
    assert errors[0] > 1.5 * errors[1] > 2.25 * errors[2]
    assert peaks[0] < peaks[1] < peaks[2]


@pytest.mark.parametrize("controller", [FEEDBACK, {"method": "lqr", "Q": [1e3, 1.0]}], ids=str)
def test_with_known_gaps_the_rest_of_the_error_is_that_of_the_crossing(
    controller: dict[str, Any],
) -> None:
    """Exact readings, no disturbance: between the crossings y / m is r."""
    exact = {"kind": "play"} | GAPS
    start = MOTOR | {"x0": [0.0, np.pi]}
    changes = {"sensor": exact, "disturbance": None, "plant": start, "controller": controller}
    run = simulate(motor(60.0, observer=KNOWN, **changes))
    assert run.level is not None
    error = np.abs(run.level - run.r)[:, 0]
    phase = 2 * np.pi * 0.5 * run.t
    crossed = (run.t > 4.0) & (np.abs(np.cos(phase)) > 0.9)
    assert error[crossed].max() < 1e-5
    assert error.max() > 1e-3


def test_a_plant_with_a_zero_is_led_across_too() -> None:
    """Of third order; the filter is a copy of the plant, so its zero needs no inverse."""
    plant = {
        "transfer_function": {"numerator": [3.0, 60.0], "denominator": [1.0, 14.0, 58.0, 60.0]}
    }
    changes = {"plant": plant, "sensor": {"kind": "play"} | GAPS, "disturbance": None}
    controller = {"method": "state_feedback", "poles": [-10.0, -11.0, -12.0]}
    observer = {"method": "full_state"}
    run = simulate(motor(30.0, observer=observer, controller=controller, **changes))
    assert run.level is not None
    error = np.abs(run.level - run.r)[:, 0]
    crossed = (run.t > 6.0) & (np.abs(np.cos(np.pi * run.t)) > 0.9)
    assert error[crossed].max() < 2e-3
    assert error[crossed].max() < 0.05 * np.abs(run.z - run.r)[crossed].min()


def test_the_run_tells_both_errors() -> None:
    run = simulate(motor())
    summary = run.summary()
    assert summary["rms_behind_play"] == behind(run) < summary["rms_tracking"]
    assert "rms y/m - r" in repr(run)
    assert "rms_behind_play" not in simulate(motor(None, sensor=GAPS)).summary()


def test_gaps_that_drift_have_no_level() -> None:
    run = simulate(motor(sensor={"kind": "play", "drift": 0.01} | GAPS))
    assert run.level is None
    assert run.rms_behind_play is None


def test_a_reference_that_stands_still_keeps_its_side() -> None:
    """A step down to 0: what is behind comes to rest there, against the left contact."""
    changes = {"reference": {"kind": "step", "amplitude": -1.0, "time": 1.0}, "disturbance": None}
    sensor = {"kind": "play"} | GAPS
    run = simulate(motor(60.0, sensor=sensor, observer=KNOWN, plant=MOTOR, **changes))
    assert run.level is not None
    assert run.z[-1, 0] == pytest.approx(-1.04, abs=1e-3)
    assert run.level[-1, 0] == pytest.approx(-1.0, abs=1e-3)


# Engines


def test_engines_agree_to_the_last_bit() -> None:
    assert "controller.crossing.gain" in parts(motor())[-1]
    assert gap_of_engines(motor()) == 0


def test_an_ensemble_varies_the_gaps() -> None:
    vary = {
        "runs": 6,
        "sensor.right": {"uniform": [0.02, 0.1]},
        "controller.K": {"normal": [1.0, 0.02], "relative": True},
    }
    result = run_ensemble(motor(ensemble=vary))
    assert replay_deviation(result, 2) == 0
    assert result.column("rms_behind_play").max() < result.column("rms_tracking").min() / 3


def test_exported_c_passes_its_self_test(tmp_path: Path) -> None:
    done = uz.export(
        motor(), out=tmp_path / "fw", precision="double", name="o", part="observer+controller"
    )
    assert done.has_passed


# What feeding y back does


def describing_function(amplitude: float, half: float) -> complex:
    """That of a play with gaps of `half` on each side, for a sine of z."""
    phase = np.arcsin(1 - 2 * half / amplitude)
    return complex(
        (np.pi / 2 + phase + np.sin(2 * phase) / 2) / np.pi, -(np.cos(phase) ** 2) / np.pi
    )


def balance(half: float, k_p: float, k_i: float) -> tuple[float, float]:
    """(A, w) at which 1 + N(A) G(jw) = 0, G of the motor and a PI controller."""
    from scipy.optimize import fsolve

    def left(unknown: Floats) -> list[float]:
        A, w = half * (1 + np.exp(unknown[0])), np.exp(unknown[1])
        s = 1j * w
        loop = 100 / (s * (s + 10)) * (k_p + k_i / s) * describing_function(float(A), half)
        return [(1 + loop).real, (1 + loop).imag]

    found = fsolve(left, [1.0, 1.5])
    return float(half * (1 + np.exp(found[0]))), float(np.exp(found[1]))


def test_pi_on_the_reading_has_the_limit_cycle_of_the_describing_function() -> None:
    half, k_p, k_i, step = 0.05, 0.6, 3.0, 1e-3
    A, w = balance(half, k_p, k_i)
    assert (A, w) == (pytest.approx(0.171, abs=3e-3), pytest.approx(5.60, abs=0.05))
    total = 0.0

    def law(t: float, estimate: Estimate, r: Floats) -> Floats:
        nonlocal total
        error = -estimate.z_inverse
        total += step * k_i * float(error[0])
        return k_p * error + total

    run = simulate(
        motor(
            None,
            plant=MOTOR | {"x0": [0.3, 0.0]},
            sensor={"kind": "play", "right": half, "left": half},
            observer=NAIVE,
            disturbance=None,
            simulation={"time": "sampled", "step": step, "duration": 30.0},
        ),
        controller=law,
    )
    z = run.z[run.t > 20, 0]
    middle = (z.max() + z.min()) / 2
    starts = np.flatnonzero((z[:-1] < middle) & (z[1:] >= middle))
    period = np.diff(starts).mean() * step
    assert (z.max() - z.min()) / 2 == pytest.approx(A, rel=0.04)
    assert 2 * np.pi / period == pytest.approx(w, rel=0.02)
