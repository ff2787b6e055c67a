"""Play (backlash) at the sensor: what turns back must first cross the gap."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from benchmarks.loops import play
from benchmarks.loops.plants.random_loops import run_loops
from hypothesis import given, settings
from hypothesis import strategies as st
from test_engines import gap_of_engines

import undeadzone as uz
from scenes import scene, tables_of
from undeadzone.analysis.branch_schedule import plan_schedule
from undeadzone.errors import InputError
from undeadzone.nonlinearities.play import apply_backlash, contacts, levels
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers.adaptive import branch_observer
from undeadzone.observers.filtering import motion_detection
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Sine, build_exosystem
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.log import Options
from undeadzone_studies.ensemble.run_ensemble import replay_deviation, run_ensemble

TS = 0.01
SLOW = {"kind": "sine", "amplitude": 5.0, "frequency": 0.2}
KALMAN = {"method": "kalman", "right": [0.0, 2.0], "disturbance": 0.8}
CENSORED = {
    "method": "censored",
    "right": [0.0, 2.0],
    "disturbance": 0.8,
    "correlation_time": TS,
    "bias": 0.0,
    "tolerance": 0.0,
    "levels": 1,
}
CERTIFIED = {"method": "certified", "L": [1.0, 1.5], "gamma": 10.0, "widths0": 1.0}
READINGS: dict[str, dict[str, float]] = {
    "exact": {},
    "noise": {"noise": 0.05},
    "encoder": {"quantum": 0.15},
}


def slow(sensor: dict[str, Any], observer: dict[str, Any], **changes: Any) -> Scenario:
    """The paper's plant behind gears, followed slowly."""
    tables: dict[str, Any] = tables_of("""
        controller = { method = "state_feedback", poles = [-8.0, -8.4] }
        disturbance = { kind = "random", rms = 0.8, correlation_time = 0.0001 }
        """) | {
        "sensor": {"kind": "play", "right": 1.0, "left": 0.7} | sensor,
        "observer": observer,
        "reference": SLOW,
        "simulation": {"time": "sampled", "step": TS, "duration": 20.0},
    }
    simulation = tables["simulation"] | changes.pop("simulation", {})
    return scene(**tables | changes | {"simulation": simulation})


def late(run: Run, error: Floats) -> float:
    """The rms over the last quarter."""
    return float(np.sqrt(np.mean(error[3 * len(run.t) // 4 :] ** 2)))


def gap_error(run: Run) -> float:
    """The error of c_r + c_l in the end [z]."""
    return float(run.d_hat[-1].sum() - sum(run.info.widths))


# The element


@given(
    z=st.lists(st.floats(-5, 5), min_size=1, max_size=30),
    right=st.floats(0.0, 2.0),
    left=st.floats(0.0, 2.0),
)
def test_the_level_stays_within_the_gap_and_moves_in_contact_alone(
    z: list[float], right: float, left: float
) -> None:
    level = 0.0
    for now in z:
        before, level = level, float(apply_backlash(np, now, level, right, left))
        assert -left - 1e-12 <= now - level <= right + 1e-12
        if level > before:
            assert level == now - right
        if level < before:
            assert level == now + left


@given(
    z=st.lists(st.floats(-5.0, 5.0) | st.just(math.nan), max_size=40),
    right=st.floats(0.0, 3.0),
    left=st.floats(0.0, 3.0),
    level=st.floats(-5.0, 5.0),
)
def test_the_levels_of_a_record_are_those_of_its_samples_one_after_another(
    z: list[float], right: float, left: float, level: float
) -> None:
    column = np.array(z).reshape(-1, 1)
    along = levels(column, np.array([right]), np.array([left]), np.array([level]))
    for now, found in zip(z, along[:, 0], strict=True):
        level = float(apply_backlash(np, now, level, right, left))
        assert found == level


def test_the_contacts_of_a_sine_are_those_of_its_motion_but_for_the_gap() -> None:
    t = np.linspace(0, 3 * np.pi, 3001)
    sides = contacts(5 * np.sin(t)[:, None], np.array([1.0]), np.array([0.5]), np.zeros(1))[:, 0]
    turned = np.arccos(1 - 1.5 / 5)  # phase after a turn at which the gap of 1.5 is crossed
    down = (t > np.pi / 2) & (t < 3 * np.pi / 2)
    assert (sides[(t > np.pi / 2 + turned + 0.01) & down] == -1).all()
    assert (sides[(t > np.pi / 2) & (t < np.pi / 2 + turned - 0.01)] == 0).all()


def test_the_run_reads_what_the_element_says() -> None:
    run = simulate(slow({"slope": 2.0, "start": 3.0}, {"method": "luenberger", "L": [1.0, 1.0]}))
    level = 1.5
    for z, y, side in zip(run.z[:, 0], run.y[:, 0], run.side[:, 0], strict=True):
        before, level = level, apply_backlash(np, z, level, 1.0, 0.7)
        assert y == pytest.approx(2 * level, abs=1e-12)
        assert side == np.sign(level - before)


def test_backlash_is_another_name_of_play() -> None:
    named = Sensor(right=1.0, left=0.7, kind="backlash")
    assert named == Sensor(right=1.0, left=0.7, kind="play")
    read = slow({"kind": "backlash"}, KALMAN)
    assert read.sensor.kind == "play"
    assert Options(kind="backlash") == Options(kind="play")


# What is refused


@pytest.mark.parametrize("key", ["start", "window"])
def test_keys_of_a_play_are_refused_of_a_dead_zone(key: str) -> None:
    with pytest.raises(InputError, match=f"sensor.{key}: only a play"):
        resolve(Sensor(right=1.0, left=1.0, **{key: 0.5}), 1, TS)


# Which side


@pytest.mark.parametrize("window", [8, 20, 100])
def test_the_fading_line_has_the_variance_of_a_straight_one(window: int) -> None:
    """The stationary variance of its slope under unit noise, by the Lyapunov equation."""
    fade = motion_detection.line_fading(window)
    g, h = 1 - fade**2, (1 - fade) ** 2
    F = np.array([[1 - g, 1 - g], [-h, 1 - h]])
    drive = np.array([g, h])
    cov = np.linalg.solve(np.eye(4) - np.kron(F, F), np.outer(drive, drive).ravel())
    straight = 12 / (window * (window**2 - 1))
    assert cov.reshape(2, 2)[1, 1] == pytest.approx(straight, rel=0.5 / window + 0.03)


@pytest.mark.parametrize("window", [4, 10, 25])
def test_a_young_line_asks_for_as_many_deviations_as_an_old_one(window: int) -> None:
    """Of the slope through any number of readings since the beginning, in exact deviations."""
    fade, sigmas = motion_detection.line_fading(window), 5.0
    sensor = resolve(Sensor(kind="play", right=1.0, left=1.0, noise=1.0), 1, 0.01, 1.0)
    q = motion_detection.Motion(
        slope=np.ones(1),
        quantum=np.zeros(1),
        threshold=np.array([sigmas * window * math.sqrt(12 / window**3)]),
        window=float(window),
        gains=np.array([1 - fade**2, (1 - fade) ** 2]),
        friction=np.empty(0),
    )
    size, none = 3 * window, ca.DM.zeros(1)
    slopes = np.zeros((size, size))  # of unit noise in one reading each
    for place in range(size):
        s = motion_detection.State(None, none, none, none, ca.DM.ones(1), none)
        for k in range(size):
            line = motion_detection.update_line(sensor, q, s, ca.DM(float(k == place)), 1.0)
            s = motion_detection.State(None, *line, ca.DM.ones(1), none)
            slopes[k, place] = float(s.slope)
            assert float(s.known) == min(k + 1, window)
    for k, std in enumerate(np.linalg.norm(slopes, axis=1)):
        s = motion_detection.State(None, none, none, ca.DM(min(k + 1, window)), ca.DM.ones(1), none)
        for share, moves in ((0.88, 0.0), (1.08, 1.0)):
            young = s._replace(slope=ca.DM(share * sigmas * max(std, 1e-9)))
            assert float(motion_detection.branch_by_line(q, young, none, 0)[0]) == (
                moves if k else 0.0
            )


@pytest.mark.parametrize("reading", READINGS)
def test_a_detected_side_is_the_true_one(reading: str) -> None:
    run = simulate(slow(READINGS[reading], KALMAN))
    followed = uz.estimate(slow(READINGS[reading], KALMAN), t=run.t, y=run.y, u=run.u)
    sides = followed.side[200:, 0] * run.side[200:, 0]
    assert (sides > 0).sum() > 60
    assert (sides < 0).sum() == 0


def test_a_log_gives_what_the_run_gave() -> None:
    run = simulate(slow(READINGS["noise"], CENSORED))
    followed = uz.estimate(slow(READINGS["noise"], CENSORED), t=run.t, y=run.y, u=run.u)
    np.testing.assert_array_equal(followed.x_hat, run.x_hat)
    np.testing.assert_array_equal(followed.d_hat, run.d_hat)


# What observers make of it


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize(
    ("observer", "most"), [(KALMAN, 0.02), (CENSORED, 0.02), (CERTIFIED, 0.05)], ids=str
)
def test_the_gap_is_found(reading: str, observer: dict[str, Any], most: float) -> None:
    errors, hidden = [], []
    for seed in range(3):
        run = simulate(slow(READINGS[reading], observer, simulation={"seed": seed}))
        errors.append(abs(gap_error(run)) / 1.7)
        hidden.append(late(run, run.z - run.z_hat))
    assert np.median(errors) < most
    assert max(hidden) < 0.15


def test_a_wrong_model_is_as_bad_as_none() -> None:
    """A play that is taken for a dead zone leaves the gap's error, and the observer is wrong."""
    right = simulate(slow({"noise": 0.01}, KALMAN))
    estimated = uz.estimate(
        slow({"noise": 0.01, "kind": "deadzone"}, KALMAN), t=right.t, y=right.y, u=right.u
    )
    wrong = estimated.z_hat[:, 0] - right.z[:, 0]
    assert late(right, wrong) > 10 * late(right, right.z[:, 0] - right.z_hat[:, 0])


def test_readings_of_one_hold_are_not_counted_as_independent() -> None:
    """A motor whose hold levels are noisy: with each of them used at every reading, .73 of 60.

    The bound is three standard errors below .95 of 24.
    """
    world, reading = play.WORLDS["motor"], "noise 1 %"
    each = [play.posed(world, reading, play.censored, False, seed) for seed in range(24)]
    ran = run_loops(each, 0.8 * world.duration)
    error = ran.errors.sum(axis=1)
    assert np.mean(np.abs(error) <= 1.96 * ran.width_std) > 0.82
    assert abs(np.median(error / ran.width)) < 0.06


def test_silent_readings_are_not_counted_as_independent() -> None:
    """Grazing motion under a known white disturbance: used at every sample, .70 of 40.

    The bounds are three standard errors below .95 of 24.
    """
    world, each = play.WORLDS["slow"], []
    for seed in range(24):
        posed = play.posed(world, "noise 1 %", play.censored, False, seed).scenario
        sensor = msgspec.structs.replace(posed.sensor, kind="deadzone")
        widest = max(sensor.right, sensor.left)
        amplitude = np.random.default_rng([seed, 7]).uniform(0.4, 1.6) * widest
        reference = Sine(amplitude=amplitude, frequency=0.2)
        grazing = msgspec.structs.replace(posed, sensor=sensor, reference=reference)
        each.append(resolve_scenario(grazing))
    ran = run_loops(each, 0.8 * world.duration)
    assert np.mean(np.abs(ran.errors.sum(axis=1)) <= 1.96 * ran.width_std) > 0.82
    assert np.mean(np.abs(ran.errors) <= 1.96 * ran.stds) > 0.82


def test_one_glitch_costs_little() -> None:
    scenario = slow({"noise": 0.01}, CENSORED)
    run = simulate(scenario)
    y = run.y.copy()
    y[900] += 30.0
    hit = uz.estimate(scenario, t=run.t, y=y, u=run.u)
    clean, dirty = (late(run, run.z - z) for z in (run.z_hat, hit.z_hat))
    assert hit.info.glitches == 1
    assert dirty < 1.2 * clean + 1e-3


def test_missing_readings_show_no_side() -> None:
    run = simulate(slow({"noise": 0.01, "dropout": 0.3}, CENSORED))
    assert np.isnan(run.y).any()
    assert np.isfinite(run.d_hat).all()
    assert abs(gap_error(run)) < 0.1


def test_missing_readings_cost_little() -> None:
    """The line goes on without them; a new line after each cost 1.5 to 2 times here."""
    hidden = []
    for dropout in (0.0, 0.3):
        each = []
        for seed in range(8):
            posed = play.posed(play.WORLDS["arm"], "noise 1 %", play.kalman, False, seed).scenario
            sensor = msgspec.structs.replace(posed.sensor, dropout=dropout)
            each.append(resolve_scenario(msgspec.structs.replace(posed, sensor=sensor)))
        hidden.append(np.median(run_loops(each, 0.8 * play.WORLDS["arm"].duration).hidden))
    assert hidden[1] < 1.3 * hidden[0]


def test_readings_at_a_limit_count_as_missing() -> None:
    run = simulate(slow({"noise": 0.01, "range": [-3.0, 3.0]}, CENSORED))
    assert (np.abs(run.side) >= 2).any()
    assert abs(gap_error(run)) < 0.1


# The certificate


@settings(max_examples=8)
@given(
    right=st.floats(0.1, 2.0), left=st.floats(0.1, 2.0), x0=st.floats(-3, 3), start=st.floats(-3, 3)
)
def test_v_never_rises(right: float, left: float, x0: float, start: float) -> None:
    assert rise(right, left, x0, start) <= 1e-9


def rise(right: float, left: float, x0: float, start: float) -> float:
    """The largest rise of V in a step, relative to V at first; readings exact, held ones heard."""
    plant = tables_of("""
        A = [[0.0, 1.0], [-1.0, -2.0]]
        B = [[0.0], [1.0]]
        C = [[1.0, 0.0]]
        """)
    sensor = {"right": right, "left": left, "start": start}
    observer = CERTIFIED | {"silence": True}
    simulation = {"duration": 6.0}
    changes = {"plant": plant | {"x0": [x0, 0.0]}, "disturbance": None, "simulation": simulation}
    V = simulate(slow(sensor, observer, **changes)).V
    assert V is not None
    return float(np.diff(V).max() / V[0])


def test_v_rises_if_a_hold_corrects_with_the_wrong_sign(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right_one = branch_observer.zone_violation

    def wrong(*arguments: Any) -> Any:
        over, under = right_one(*arguments)
        return -under, -over

    monkeypatch.setattr(branch_observer, "zone_violation", wrong)
    assert rise(0.4, 0.4, 3.0, -3.0) > 1e-4


def test_the_certificate_is_that_of_the_dead_zone() -> None:
    of_play = uz.check(slow({}, CERTIFIED))
    of_zone = uz.check(slow({"kind": "deadzone"}, CERTIFIED))
    assert of_play.margin == of_zone.margin


# What readings can tell


def test_an_integrator_hides_the_centre_of_its_play_but_not_the_width() -> None:
    motor = tables_of("""
        A = [[0.0, 1.0], [0.0, -2.0]]
        B = [[0.0], [1.0]]
        C = [[1.0, 0.0]]
        """)
    run = simulate(slow({"noise": 0.01}, KALMAN, plant=motor))
    (verdict,) = run.info.identifiable
    assert verdict["width"]
    assert not verdict["centre"]
    (known,) = simulate(slow({"noise": 0.01}, KALMAN)).info.identifiable
    assert known["width"]
    assert known["centre"]


def test_a_plan_knows_the_gap_of_the_pass_before() -> None:
    problem = resolve_scenario(slow({}, CERTIFIED))
    reference = build_exosystem("reference", problem.scenario.reference, 1)
    schedule = plan_schedule(problem.model, reference, [0], problem.sensor, 20.0)
    assert schedule.periodic
    moving = schedule.spans @ (schedule.sides != 0) / schedule.spans.sum()
    gap = 2 * np.arccos(1 - 1.7 / 5) / (2 * np.pi)  # share of a period in which y holds
    assert moving[0] == pytest.approx(1 - gap, abs=0.01)


# Engines


@pytest.mark.parametrize("reading", READINGS)
def test_engines_agree_to_the_last_bit(reading: str) -> None:
    scenario = slow(READINGS[reading], CERTIFIED, simulation={"duration": 2.0})
    assert gap_of_engines(scenario) == 0


def test_exported_c_passes_its_self_test(tmp_path: Path) -> None:
    scenario = slow(READINGS["noise"], KALMAN, simulation={"duration": 2.0})
    done = uz.export(scenario, out=tmp_path / "fw", precision="double", name="o")
    assert done.has_passed


def test_the_page_draws_a_play(tmp_path: Path) -> None:
    uz.export(slow({}, CERTIFIED, disturbance=None), out=tmp_path / "p.html", to="page")
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert "blind at every turn" in text
    assert "holds still" in text


def test_the_oracle_of_an_ensemble_knows_the_gap_of_each_run() -> None:
    vary = {"runs": 6, "sensor.right": {"uniform": [0.3, 1.5]}}
    oracle = {"method": "oracle", "L": [1.0, 1.5]}
    result = run_ensemble(slow({"noise": 0.01}, oracle, ensemble=vary))
    assert result.column("rms_estimation").max() < 0.1


def test_an_ensemble_varies_the_gaps() -> None:
    vary = {"runs": 6, "sensor.right": {"uniform": [0.3, 1.5]}}
    result = run_ensemble(slow({"noise": 0.01}, CERTIFIED, ensemble=vary))
    assert replay_deviation(result, 2) == 0
    assert np.median(np.abs(result.column("d_right_error[0]"))) < 0.2
