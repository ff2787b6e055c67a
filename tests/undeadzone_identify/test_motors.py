"""Motors by torque and encoder: friction, a gap or none, and the files that people have of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from benchmarks.identify.logs.lost_motion import linear_motor
from benchmarks.identify.logs.motors import NOISE, STEP, Motor, random_motor, record, record_both
from benchmarks.identify.motors import output_error
from scipy.io import savemat

import undeadzone as uz
from further import further
from records import holds
from undeadzone.errors import InputError
from undeadzone_identify.logs.log import read_log
from undeadzone_identify.models.free_load import fit_free_load
from undeadzone_identify.models.lost_motion import Positions
from undeadzone_identify.results.account import INDICATED, NAMED
from undeadzone_identify.servo.gap import are_errors_in_bursts


def ask(motor: Motor, seed: int) -> uz.Identified:
    """Return what a motor's log says, told that its position is read."""
    u, y = record(motor, seed)
    answer = uz.identify(t=STEP, u=u, y=y, integrators=1)
    assert isinstance(answer, uz.Identified)
    return answer


@pytest.mark.parametrize("seed", [4, *further(8)])
def test_a_rigid_motor_that_rubs_is_named_behind_a_noisy_encoder(seed: int) -> None:
    """Friction of another law imitates a gap below the noise, which was named."""
    motor = random_motor(seed, with_gap=False)
    assert motor.friction
    assert not motor.ticks
    answer = ask(motor, seed)
    assert answer.verdict == "friction"
    value, low, high = answer.numbers()["friction"]
    assert low < motor.friction < high
    assert value == pytest.approx(motor.friction, rel=0.05)
    assert any("motor's side of the gears" in remark for remark in answer.answer.remarks)


def test_a_rigid_motor_without_friction_has_no_gap() -> None:
    answer = ask(random_motor(3, with_gap=False), 3)
    assert answer.verdict == "none"
    assert answer.width is None


@pytest.mark.parametrize("seed", [3, *further(2)])
def test_a_heavy_load_in_a_gap_is_not_mistaken_for_a_linear_motor(seed: int) -> None:
    """A load that nothing rubs strikes and bounces: "no backlash" had odds above 99 %."""
    motor = random_motor(seed, with_gap=True)
    assert motor.gap > 10 * NOISE
    answer = ask(motor, seed)
    assert answer.verdict == "undecided"
    assert not answer.numbers()["odds"]
    assert "comes in bursts" in answer.answer.reasons[0]


def test_bursts_are_distinguished_from_errors_of_one_size() -> None:
    size = 1500
    for seed in range(20):
        white = np.random.default_rng(seed).standard_normal(size)
        assert not are_errors_in_bursts(white)
        assert are_errors_in_bursts(white * np.where(np.arange(size) % 200 < 20, 2.0, 0.9))
    assert not are_errors_in_bursts(np.zeros(100))  # nothing is left of a log without noise


def test_output_error_finds_the_time_constant_of_a_linear_motor() -> None:
    """The rival in the benchmark is worth its place."""
    motor = random_motor(0, with_gap=False)
    assert output_error(*record(motor, 0)).samples == pytest.approx(motor.samples, rel=0.01)


# --- Both sides of the gears


@pytest.mark.parametrize("seed", [103, 104])
def test_a_load_that_floats_in_its_gap_is_measured_by_both_encoders(seed: int) -> None:
    """One rubs and one does not, one by ticks and one by noise: plants called the latter linear."""
    motor = random_motor(seed, with_gap=True)
    u, angles = record_both(motor, seed)
    columns = {"t [s]": STEP * np.arange(u.size), "torque [Nm]": u}
    columns |= {"motor [rad]": angles[:, 0], "load [rad]": angles[:, 1]}
    found = uz.identify(pd.DataFrame(columns))
    assert isinstance(found, uz.IdentifiedMotion)
    assert found.verdict == "play"
    assert holds(found.gap, motor.gap)
    assert found.gap.value == pytest.approx(motor.gap, rel=0.15)
    assert "floats in its gap" in found.answer.remarks[-1]


def shaft(motor: np.ndarray, stiffness: float) -> np.ndarray:
    """Return the angle of a load behind a shaft that bends, by stiffness over inertia [1/s^2]."""
    x, v, parts, out = 0.0, 0.0, 20, np.empty(motor.size)
    for k in range(motor.size):
        out[k] = x
        for ahead in np.linspace(motor[max(k - 1, 0)], motor[k], parts, endpoint=False):
            v += STEP / parts * (stiffness * (ahead - x) - 0.1 * math.sqrt(stiffness) * v)
            x += STEP / parts * v
    return out


@pytest.mark.parametrize("stiffness", [900.0, 6000.0])
def test_a_shaft_that_bends_has_no_flanks(stiffness: float) -> None:
    """Its load lies at either end of its way most of the time, as in a gap, and is linear."""
    rng = np.random.default_rng(1)
    _, angles = record_both(random_motor(101, with_gap=False), 101)
    noise = NOISE * rng.standard_normal((2, len(angles)))
    t, load = STEP * np.arange(len(angles)), shaft(angles[:, 0], stiffness)
    free = fit_free_load(Positions(t, angles[:, 0] + noise[0], load + noise[1]))
    assert free is None or free.rivals["none"].bic < free.rivals["play"].bic
    motor = random_motor(103, with_gap=True)
    _, angles = record_both(motor, 103)
    free = fit_free_load(Positions(t, *angles.T))
    assert free is not None
    assert free.rivals["play"].bic < free.rivals["none"].bic


def test_a_torque_and_a_position_are_a_motor_by_their_names() -> None:
    """It integrates, though nobody said so, where no plant that settles explains the log."""
    log = linear_motor(np.random.default_rng(1))
    found = uz.identify(pd.DataFrame(log.columns))
    assert isinstance(found, uz.Identified)
    assert found.verdict == "none"
    assert any("taken to integrate" in remark for remark in found.answer.remarks)


# --- Files


def test_times_in_the_first_column_of_a_matrix(tmp_path: Path) -> None:
    """As Simulink writes them; which column is what else has to be said, with brackets quoted."""
    t = 0.001 * np.arange(200)
    rows = np.column_stack([t, np.sin(t), np.cos(t)])
    savemat(tmp_path / "drive.mat", {"J": 1.0, "data": rows})
    assert 'read as --columns "t=data[0],' in read_log(tmp_path / "drive.mat").remarks[0]
    log = read_log(tmp_path / "drive.mat", "y=data[2],u=data[1]")
    assert np.array_equal(log.t, t)
    assert np.array_equal(log.y[:, 0], rows[:, 2])
    drive_log = read_log(tmp_path / "drive.mat", "t=data[0],y=data[2],u=data[1]")
    assert np.array_equal(drive_log.t, t)
    savemat(tmp_path / "ramp.mat", {"u": rows, "y": rows[:, 1]})
    assert not read_log(tmp_path / "ramp.mat").has_clock


def test_a_short_log_of_irregular_times_is_too_short() -> None:
    """The command that was named for its times, --resample, ended in this message next."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.7, 1.5, 11))
    log = pd.DataFrame({"time": t, "pulses": rng.normal(size=11), "star": rng.normal(size=11)})
    with pytest.raises(InputError, match=r"11 readings are too few\. Order 1 needs 100"):
        uz.identify(log, order=1)


def test_lost_motion_that_explains_nothing_has_no_odds() -> None:
    """A mount whose star wanders by itself."""
    rng = np.random.default_rng(1)
    size = 400
    t = np.cumsum(rng.uniform(0.7, 1.5, size))
    star = np.cumsum(rng.normal(size=size)) * 0.1
    log = pd.DataFrame({"t": t, "pulse": rng.normal(size=size), "star": star})
    found = uz.identify(log)
    assert isinstance(found, uz.IdentifiedMotion)
    assert found.verdict == "unclear"
    assert found.numbers()["odds"] == {}
    assert "odds" not in found.summary()


@pytest.mark.parametrize("one_way", [True, False])
def test_friction_has_the_level_of_the_ways_that_were_tried(one_way: bool) -> None:
    """A motor of first order that sticks: its readings are those of a zone of the sensor."""
    rng = np.random.default_rng(1)
    volts = [0.0, 2, 3, 4, 5, 6, 7, 8] if one_way else [-6.0, -4, -2, -1, -0.5, 0, 0.5, 1, 2, 4, 6]
    u, speed = np.repeat(rng.choice(volts, 25), 60), np.zeros(1500)
    for k in range(1, u.size):
        way = np.sign(speed[k - 1]) or np.sign(u[k - 1]) * (32 * abs(u[k - 1]) > 25)
        new = 0.9 * speed[k - 1] + 0.1 * (32 * u[k - 1] - 25 * way)
        speed[k] = new if way and new * way > 0 else 0.0
    y = speed + 0.3 * rng.standard_normal(u.size)
    log = pd.DataFrame({"t": 0.1 * np.arange(u.size), "volts": u, "rpm": y})
    account = uz.identify(log).account
    level = {**account.others, **account.effects}["friction"]["level"]
    assert holds(level, 25 / 32)
    assert account.unmet == (("left",) if one_way else ())
    assert account.grade == (NAMED if one_way else INDICATED)
