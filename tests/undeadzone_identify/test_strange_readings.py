"""Readings within the input's own sample, of a switch, of a sensor slower one way, of two gains."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.identify.logs.strangers import ALL, STEP, compared, lags, noisy, walk
from click.testing import CliRunner

import undeadzone as uz
from further import further
from requirements import needs
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.chain import ChainModel

FEEDTHROUGH = "zone with a share passed on"


def log_of(kind: str, seed: int) -> tuple[Floats, Floats]:
    """Return the input and readings of a stranger."""
    log = ALL[kind].make(np.random.default_rng(seed))
    return log.u, log.y


def write_log(u: Floats, y: Floats) -> None:
    """Write log.csv into the folder."""
    table = np.column_stack([STEP * np.arange(u.size), u, y])
    np.savetxt("log.csv", table, delimiter=",", header="t,u,y", comments="")


def test_an_input_that_acts_in_its_own_sample_is_taken_one_sample_earlier(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The widths hold, and the command that is printed estimates along the same log."""
    monkeypatch.chdir(tmp_path)
    write_log(*log_of(FEEDTHROUGH, 8000))
    run = CliRunner()
    told = run.invoke(group, ["identify", "log.csv", "--no-figures", "--out", "o"])
    words = " ".join(told.output.split())
    assert "it is taken one sample earlier (--delay -1)" in words
    assert "closed loop" not in words
    advised = re.search(r"undeadzone (estimate o/log.toml log.csv --delay -1)", words)
    assert advised is not None
    estimated = run.invoke(group, [*advised[1].split(), "--no-figures", "--out", "e"])
    assert estimated.exit_code == 0, estimated.output
    assert "consistent yes" in " ".join(estimated.output.split())
    wrong = run.invoke(group, ["estimate", "o/log.toml", "log.csv", "--no-figures", "--out", "f"])
    assert "the log has them late: delay = -1" in " ".join(wrong.output.split())


@pytest.mark.long("test_an_input_that_acts_in_its_own_sample_is_taken_one_sample_earlier")
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # `check` overflows by the fast pole
@needs("compiler", "gcc")
def test_a_log_of_an_input_of_its_own_row_ends_in_firmware(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(*log_of(FEEDTHROUGH, 8000))
    words = ["identify", "log.csv", "--no-figures", "--out", "o", "--chain", "fw"]
    told = CliRunner().invoke(group, words)
    assert told.exit_code == 0, told.output
    assert "every bit agrees" in told.output
    assert "consistent yes" in " ".join(told.output.split())
    assert Path("fw/firmware/log.c").exists()


@pytest.mark.long("test_an_input_that_acts_in_its_own_sample_is_taken_one_sample_earlier")
def test_an_input_taken_earlier_gives_the_same_answer_as_a_shifted_log() -> None:
    u, y = log_of(FEEDTHROUGH, 8001)
    found = uz.identify(t=STEP, u=u, y=y)
    shifted = uz.identify(t=STEP, u=u[1:], y=y[:-1])
    assert found.verdict == shifted.verdict == "dead_zone"
    assert (found.recorded_delay, shifted.recorded_delay) == (-1, 0)
    assert found.width is not None
    assert shifted.width is not None
    assert found.width.low < 0.85 < found.width.high
    assert found.width.value == pytest.approx(shifted.width.value, abs=1e-3)
    system = found.to_control()
    assert system.D.item() > 0.1  # what passes at once


def test_a_controller_that_answers_at_once_is_no_feedthrough() -> None:
    """The innovations of its output have a negative correlation with the noise of the readings."""
    rng, size, z = np.random.default_rng(3), 1200, 0.0
    r, u, y = walk(rng, size, 30.0), np.empty(size), np.empty(size)
    for k in range(size):
        y[k] = z + 0.05 * rng.standard_normal()
        u[k] = 2.0 * (r[k] - y[k])
        z += 0.1 * (u[k] - z)
    found = uz.identify(t=STEP, u=u, y=y)
    assert found.recorded_delay == 0
    assert any("closed loop" in one for one in found.answer.remarks)


@pytest.mark.parametrize("noise", [0.02, *further(0.0)])
def test_readings_of_a_switch_have_no_name(noise: float) -> None:
    rng = np.random.default_rng(4)
    u = walk(rng)
    found = uz.identify(t=STEP, u=u, y=noisy(rng, compared(lags(u)), noise))
    assert found.verdict == "unclear"
    assert "two levels alone, as those of a switch" in found.answer.reasons[0]


def test_a_sensor_slower_one_way_has_no_name() -> None:
    """It was a curve of the input, since it shifts the mean."""
    found = uz.identify(
        t=STEP, **dict(zip("uy", log_of("sensor slower upwards", 8000), strict=True))
    )
    assert found.verdict == "unclear"
    assert "how fast the output changes" in found.answer.reasons[0]


@pytest.mark.long("test_the_slope_inside_a_zone_grows_with_the_roundness_of_its_edges")
def test_a_curve_that_passes_most_of_what_lies_inside_is_no_zone() -> None:
    """Two gains of a range were a zone with edges of five times its half width, at odds of 1."""
    found = uz.identify(t=STEP, **dict(zip("uy", log_of("range that switches", 8001), strict=True)))
    assert found.verdict in ("undecided", "unclear", "other")


@pytest.mark.parametrize(("rounding", "slope"), [(0.01, 0.0), (0.45 / np.log(3), 0.5), (50.0, 1.0)])
def test_the_slope_inside_a_zone_grows_with_the_roundness_of_its_edges(
    rounding: float, slope: float
) -> None:
    """Edges at 0.45 of softplus: 2 / (1 + e^(d / rounding))."""
    model: ChainModel = object.__new__(ChainModel)
    for name, value in (("shaped", True), ("shape", slice(0, 2)), ("edges", slice(2, 4))):
        object.__setattr__(model, name, value)
    assert model.slope_inside(np.array([1.0, rounding, 0.45, 0.45])) == pytest.approx(
        slope, abs=0.01
    )


def test_the_delay_of_a_recording_shifts_the_inputs_of_an_estimate(tmp_path: Path) -> None:
    scenario = tmp_path / "plant.toml"
    scenario.write_text(
        "[plant]\nA = [[-1.0]]\nB = [[1.0]]\nC = [[1.0]]\n[sensor]\nright = 0.1\nnoise = 0.01\n"
        '[observer]\nmethod = "censored"\nright = [0.0, 1.0]\n'
        '[simulation]\ntime = "sampled"\nstep = 0.01\n'
    )
    u, y = walk(np.random.default_rng(5), 200), np.zeros(200)
    given = {"t": STEP * np.arange(199), "y": y[1:]}
    late = uz.estimate(scenario, u=np.append(u[1:-1], u[-2]), delay=1, **given)
    np.testing.assert_array_equal(late.u[1:, 0], u[1:-1])


@pytest.mark.parametrize("delay", ["-2", "1001", "1.5", "soon"])
def test_delays_that_no_recording_has_are_refused(delay: str) -> None:
    with pytest.raises(InputError, match=f"expected auto or -1 to 1000 samples, found '{delay}'"):
        uz.identify(t=STEP, u=np.arange(50.0), y=np.arange(50.0), delay=delay)


def test_a_log_of_a_single_step_says_what_to_record() -> None:
    """No part of it tests a fit to the others; after three more steps a line is one."""
    rng, k = np.random.default_rng(1), np.arange(400)
    reasons, words = [], []
    for u in (
        1.0 * (k >= 50),
        np.select([k < 50, k < 130, k < 220, k < 310], [0, 1, 0.3, -0.8], 0.4),
    ):
        found = uz.identify(t=STEP, u=u, y=noisy(rng, lags(u) * u.std(), 0.01))
        reasons.append(found.answer.reasons[0])
        words.append(found.verdict)
    assert words == ["unclear", "none"]
    assert "Record several steps up and down" in reasons[0]
    assert "changes" not in reasons[0]


def test_a_play_without_dynamics_is_measured() -> None:
    """A joystick's hysteresis was friction at 0.98, and withheld later."""
    u, y = log_of("no dynamics, play", 8500)
    found = uz.identify(t=STEP, u=u, y=y)
    assert found.verdict == "play"
    (numbers,) = found.account.effects.values()
    assert numbers["gap"].low < 0.7 < numbers["gap"].high


def test_the_overlap_of_a_cylinders_valve_is_not_mistaken_for_friction() -> None:
    """It rests as friction does, but brakes nothing: its odds were 1."""
    u, y = log_of("cylinder", 8500)
    found = uz.identify(t=STEP, u=u, y=y, integrators=1)
    assert found.verdict == "undecided"
    assert "a dead zone of the input, as of a valve that overlaps" in found.answer.reasons[0]


@pytest.mark.long("test_a_sensor_slower_one_way_has_no_name")
def test_much_noise_is_not_taken_for_readings_that_hardly_move() -> None:
    u, y = log_of("zone, much noise", 8501)
    found = uz.identify(t=STEP, u=u, y=y)
    assert not any("hardly move" in one for one in found.answer.reasons)


def test_readings_beyond_the_limits_that_fit_best_are_no_saturation() -> None:
    """A pendulum that went over its top hangs about two angles, and was a saturation at 1.00."""
    u, y = log_of("pendulum", 7030)
    found = uz.identify(t=STEP, u=u, y=y)
    assert found.verdict == "unclear"
    assert "readings exceed the fitted limits of the saturation" in found.answer.reasons[0]
