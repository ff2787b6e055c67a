"""Identification beyond one linear plant: integrators, delays, jumps, offsets, several outputs."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from benchmarks.identify.logs.random_plants import dead_zone, motor
from click.testing import CliRunner
from scipy.signal import lfilter

import undeadzone as uz
from records import identify_log, identify_second_order, second_order, steps
from undeadzone.cli import group
from undeadzone.errors import InputError
from undeadzone.linalg.hold import zoh
from undeadzone_identify.logs.prepare import jump_edge_below
from undeadzone_identify.models.plant import PlantSimulator, RecordData, delay_inputs
from undeadzone_identify.models.zone import WidthLimits, ZoneObjective
from undeadzone_identify.results.to_continuous import to_continuous_plant
from undeadzone_identify.selection.adequacy import SEEN

DENOMINATOR = [1.0, -1.6, 0.68]
STEP = 0.05


def driven(seed: int = 1, size: int = 900, late: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """u, and z with noise of 0.03, `late` samples late."""
    rng = np.random.default_rng(seed)
    u = steps(rng, size)
    z = lfilter(np.r_[np.zeros(late + 1), 0.05, 0.03], DENOMINATOR, u)
    return u, z + 0.03 * rng.standard_normal(size)


def small_data(integrators: int = 0) -> RecordData:
    rng = np.random.default_rng(3)
    u = steps(rng, 200)
    y = dead_zone(0.5 * rng.standard_normal(200).cumsum() / 4, 0.2, 0.3)
    side = np.sign(y).astype(int)
    starts = np.array([0, 90])
    return RecordData(u[:, None], y, np.ones(200, bool), starts, side, True, np.ones(1), 1.0)


# --- integrators


@pytest.mark.parametrize("integrators", [1, 2])
def test_an_integrating_plant_is_its_difference_equation(integrators: int) -> None:
    data = small_data()
    simulator = PlantSimulator(data, 3, integrators)
    layout = simulator.layout
    theta = np.zeros(layout.parameter_count)
    theta[layout.denominator] = [-0.5, 0.06][: layout.denominator.stop]
    theta[layout.numerators] = [0.1, 0.2, -0.05]
    theta[layout.x0.start] = 0.7
    z = simulator.simulate_z(theta)[:90]
    whole = np.convolve(np.append(1.0, theta[layout.denominator]), np.poly(np.ones(integrators)))
    direct = lfilter(np.r_[0.0, 0.1, 0.2, -0.05], whole, data.u[:90, 0])
    direct += lfilter([0.7], whole, np.eye(90, 1)[:, 0])
    assert z == pytest.approx(direct)
    assert np.sum(np.abs(simulator.plant_poles(theta) - 1) < 1e-12) == integrators


def test_scores_of_tied_widths_are_differences() -> None:
    simulator = PlantSimulator(small_data(), 2, 1)
    objective = ZoneObjective(simulator, "ahead", WidthLimits(tied=True))
    layout = objective.layout
    theta = np.zeros(layout.parameter_count)
    theta[layout.denominator], theta[layout.numerators] = -0.6, [0.05, 0.03]
    theta[layout.right : layout.right + 2] = 0.3
    theta[layout.right + 2] = -1.0
    score = objective.total_score(theta)
    for index in objective.free:
        ahead, back = theta.copy(), theta.copy()
        for moved, step in ((ahead, 1e-6), (back, -1e-6)):
            moved[index] += step
            moved[layout.right + 1] = moved[layout.right]
        slope = (
            objective.total_log_likelihood(ahead) - objective.total_log_likelihood(back)
        ) / 2e-6
        assert score[index] == pytest.approx(slope, rel=2e-5, abs=2e-5)


def test_the_width_of_an_integrating_plant() -> None:
    log = motor(np.random.default_rng(4))
    answer = identify_log(log, integrators=1, order=2, delay=0)
    width = log.right + log.left
    assert answer.verdict == "dead_zone"
    assert answer.width.low <= width <= answer.width.high
    assert answer.width.half_width < 0.25 * width
    assert answer.right.value == pytest.approx(0.5 * answer.width.value)
    assert answer.centre is None
    assert np.sum(np.abs(answer.plant["poles"]) < 1e-9) == 1
    with pytest.raises(InputError, match="expected 0, 1 or 2"):
        identify_log(log, integrators=3)


def test_a_mode_that_rings_for_half_of_the_record_is_found() -> None:
    rng = np.random.default_rng(8)
    pole = 0.9975 * np.exp(0.35j)
    u = rng.standard_normal(800)
    z = lfilter([0.0, 0.1, 0.05], np.poly([pole, pole.conj()]).real, u)
    z /= z.std()
    y = z + 0.02 * rng.standard_normal(z.size)
    y = dead_zone(y, 0.6, 0.3)
    answer = uz.identify(t=1.0, u=u, y=y, order=2, delay=0)
    assert answer.verdict == "dead_zone"
    assert answer.right.low <= 0.6 <= answer.right.high
    assert answer.left.low <= 0.3 <= answer.left.high
    assert answer.right.half_width < 0.03


def test_a_pole_that_no_plant_in_continuous_time_has_is_one_pole() -> None:
    rng = np.random.default_rng(9)
    u = np.repeat(rng.standard_normal(80), 5)
    z = lfilter([0.0, 1.0], [1.0, 0.6], u) + 0.02 * rng.standard_normal(u.size)
    y = dead_zone(z, 0.2, 0.1)
    answer = uz.identify(t=0.1, u=u, y=y, order=1)
    poles = answer.summary()["plant"]
    assert "+-" not in poles
    assert f"{np.log(0.6) / 0.1:.1f}"[:4] in poles
    assert "alternates from sample to sample" in poles


def test_an_integrator_in_continuous_time_is_exact() -> None:
    layout = PlantSimulator(small_data(), 2, 1).layout
    a, b = np.array([-0.8]), np.array([0.02, 0.015])
    plant = to_continuous_plant(a, b, layout, 0.1)
    assert np.min(np.abs(np.linalg.eigvals(plant.A))) == 0.0
    A, B, _ = zoh(plant, 0.1)
    u = np.random.default_rng(0).standard_normal(50)
    x, z = np.zeros(2), []
    for value in u:
        z.append(plant.C[0] @ x)
        x = A @ x + B[:, 0] * value
    whole = np.convolve([1.0, -0.8], [1.0, -1.0])
    assert np.array(z) == pytest.approx(lfilter(np.r_[0.0, b], whole, u), abs=1e-9)


# --- delays


def test_a_delay_moves_the_input_within_each_record() -> None:
    data = small_data()
    late = delay_inputs(data, 3)
    assert np.array_equal(late.u[3:90], data.u[:87])
    assert np.array_equal(late.u[90:94, 0], np.repeat(data.u[90], 4))
    assert np.array_equal(delay_inputs(late, -3).u[3:80], data.u[3:80])


def test_a_late_input_is_found_and_its_scenario_says_it() -> None:
    u, z = driven(late=3, seed=0)
    answer = uz.identify(t=STEP, u=u, y=dead_zone(z, 0.5, 0.3), order=2)
    assert answer.answer.found.delay == 3
    assert answer.right.low <= 0.5 <= answer.right.high
    written = tomllib.loads(answer.scenario())
    assert written["plant"]["delay"] == 3


# --- jump sensors


def test_the_interval_of_a_jump_holds_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    covered, off = [], []
    for _ in range(2000):
        edge = jump_edge_below(np.sort(0.7 + rng.random(60)))
        covered.append(edge.low <= 0.7 <= edge.high)
        off.append(edge.value - 0.7)
    assert 0.935 <= np.mean(covered) <= 0.965
    assert abs(np.mean(off)) < 0.05 * np.std(off) + 1e-3


def test_a_jump_sensor_is_named_and_measured(tmp_path: Path) -> None:
    u, z = driven(size=700)
    y = np.where((z > 0.5) | (z < -0.3), z, 0.0)
    answer = identify_second_order(u, y)
    assert answer.verdict == "jump"
    assert not answer.zone
    for edge, truth in ((answer.right, 0.5), (answer.left, 0.3)):
        assert edge.low <= truth <= edge.high
        assert edge.high - edge.low < 0.03
    assert 'kind = "jump"' in answer.scenario()
    with pytest.raises(InputError, match="no exact zeros"):
        uz.identify(t=STEP, u=u, y=y + 0.01 * np.sin(np.arange(700.0)), kind="jump")


# --- what the model lacks


def test_an_offset_behind_the_zone_is_named() -> None:
    u, z = driven()
    noise = 0.03 * np.random.default_rng(0).standard_normal(u.size)
    y = 0.1 + dead_zone(z, 0.5, 0.3) + noise
    answer = identify_second_order(u, y)
    assert answer.verdict == "other"
    assert "constant offset behind the zone" in answer.answer.reasons[0]
    cured = uz.identify(t=STEP, u=u, y=y, order=2, zero=0.1, place="sensor", delay=0)
    assert cured.right.low <= 0.5 <= cured.right.high
    exact = uz.identify(t=STEP, u=u, y=1.25 + dead_zone(z, 0.5, 0.3), order=2)
    assert exact.verdict == "dead_zone"
    assert exact.right.value == pytest.approx(0.5, abs=0.01)
    assert exact.answer.case.options.zero == 1.25


def test_the_level_of_a_silent_sensor_is_followed_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scenario and the commands that are printed count from it; lines about 0 are none."""
    monkeypatch.chdir(tmp_path)
    u, z = driven()
    table = np.column_stack([STEP * np.arange(u.size), u, 1.25 + dead_zone(z, 0.5, 0.3)])
    np.savetxt("log.csv", table, delimiter=",", header="t,u,y", comments="")
    run = CliRunner()
    words = ["identify", "log.csv", "--order", "2", "--delay", "0", "--no-figures", "--out", "o"]
    found = run.invoke(group, words)
    assert found.exit_code == 0, found.output
    assert "the reading 1.25 comes back exactly" in " ".join(found.output.split())
    assert "return y + 0." in found.output
    assert "about 1.25: " in found.output
    point = tomllib.loads(Path("o/log.toml").read_text())["operating_point"]
    assert point["output"] == [1.25]
    advised = re.search(r"undeadzone (estimate [^,]+)", found.output)
    assert advised is not None
    estimated = run.invoke(group, [*advised[1].split(), "--no-figures", "--out", "e"])
    assert estimated.exit_code == 0, estimated.output
    assert "consistent yes" in " ".join(estimated.output.split())
    done = run.invoke(group, ["export", "o/identify.json", "--to", "snippet"])
    assert done.exit_code == 0
    body = Path("snippet/snippet.h").read_text().partition("*/")[2].split()
    assert body == found.output[found.output.index("static float") :].split()[: len(body)]


def test_a_spring_that_stiffens_is_no_zone() -> None:
    rng = np.random.default_rng(2)
    u = steps(rng, 800, 8)
    z, v, h = np.zeros(800), 0.0, 0.05
    for k in range(799):
        x = z[k]
        for _ in range(10):
            v += h / 10 * (4 * (3 * u[k] - x - 0.1 * x**3) - 0.8 * v)
            x += h / 10 * v
        z[k + 1] = x
    z = z / z.std() + 0.02 * rng.standard_normal(800)
    answer = uz.identify(t=h, u=u, y=dead_zone(z, 0.5, 0.3), order=2, delay=0)
    assert answer.verdict == "unclear"
    assert re.search(r"explains 3\d % of the held-out", answer.answer.reasons[0])
    # Both explain 17 % of the residual; which of them explains more, the processor decides.
    assert answer.answer.reasons[1:] in ([], [SEEN["output"]], [SEEN["behind"]])


def test_an_edge_that_is_hardly_passed_has_its_profile() -> None:
    rng = np.random.default_rng(1)
    u = steps(rng, 1200)
    z = second_order(u)
    z /= z.std()
    right = float(np.sort(z)[-15])
    y = dead_zone(z + 0.03 * rng.standard_normal(1200), right, 0.3)
    answer = identify_second_order(u, y)
    assert answer.answer.excitation.visits[0] == 2
    assert answer.right.low <= right <= answer.right.high
    assert answer.width.half_width >= answer.right.half_width


# --- several outputs


def test_two_outputs_two_inputs_one_scenario(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    size = 900
    u = np.column_stack([steps(rng, size), steps(rng, size, 17)])
    first = lfilter([0, 0.05, 0.03], DENOMINATOR, u[:, 0] + 0.4 * u[:, 1])
    second = lfilter([0, 0.1], [1, -0.9], u[:, 1])
    y = np.column_stack(
        [
            dead_zone(first + 0.03 * rng.standard_normal(size), 0.5, 0.3),
            dead_zone(second + 0.02 * rng.standard_normal(size), 0.2, 0.4),
        ]
    )
    table = np.column_stack([STEP * np.arange(size), u, y])
    path = tmp_path / "log.csv"
    header = "t,u[0],u[1],y[0],y[1]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    given = ["--order", "1-2", "--delay", "0", "--place", "sensor", "--kind", "deadzone"]
    options = [*given, "--no-figures", "--json", "--out", str(tmp_path)]
    done = CliRunner().invoke(group, ["identify", str(path), *options], standalone_mode=False)
    assert done.return_value == 0
    numbers = json.loads(done.stdout)
    widths = {"y[0]": (0.5, 0.3), "y[1]": (0.2, 0.4)}
    assert numbers["verdict"] == "dead_zone"
    for name, truths in widths.items():
        for side, truth in zip(("right", "left"), truths, strict=True):
            value, low, high = numbers["outputs"][name][side]
            assert low <= truth <= high
            assert abs(value - truth) < 0.03
    result = uz.estimate(tmp_path / "log.toml", path)
    assert result.consistent
    assert result.d_hat.shape == (size, 4)
