"""A play ahead of a dead zone: what turns back crosses the gap first, and the zone comes after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.loops import play_and_zone as bench
from benchmarks.loops.plants.random_loops import Loops, run_loops
from benchmarks.loops.play import WORLDS
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_alternatives import STEP, driven, through
from test_engines import gap_of_engines
from test_play import CENSORED, KALMAN, late, slow

import undeadzone as uz
from further import further
from records import identify_second_order
from scenes import tables_of
from undeadzone.analysis.branch_schedule import plan_schedule, schedule_of_record
from undeadzone.analysis.identifiability.two_elements import (
    ReadingConditions,
    _single_contact_reason,
    append_gaps,
    gap_and_width_information,
)
from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers.filtering import constant_states
from undeadzone.report.run_page import run_page
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.prior_knowledge import build_setting
from undeadzone_studies.ensemble.run_ensemble import replay_deviation, run_ensemble

BOTH = {"kind": "deadzone", "right": 1.0, "left": 0.7, "play": [0.5, 0.3]}
RANGES = {"play": [[0.0, 1.0], [0.0, 1.0]]}
WIDTHS = st.one_of(st.just(0.0), st.floats(1e-6, 1.5))
NAIVE = {"method": "luenberger", "L": [1.0, 1.0]}
READINGS: dict[str, dict[str, float]] = {
    "exact": {},
    "noise": {"noise": 0.02},
    "encoder": {"quantum": 0.05},
}


def both(sensor: dict[str, Any], observer: dict[str, Any], **changes: Any) -> Scenario:
    """The paper's plant behind gears and a dead zone, followed slowly."""
    return slow(BOTH | sensor, observer, **changes)


def follow(run: Run, scenario: Scenario) -> uz.Estimation:
    """What the observer of a scenario makes of the readings of a run."""
    return uz.estimate(scenario, t=run.t, y=run.y, u=run.u)


# The element


def by_hand(z: Floats, sensor: dict[str, Any]) -> Floats:
    """What a noise-free sensor reads, one sample after the other."""
    c_r, c_l = sensor["play"]
    slope, quantum = sensor.get("slope", 1.0), sensor.get("quantum", 0.0)
    low, high = sensor.get("range", [-np.inf, np.inf])
    level, readings = sensor.get("start", 0.0) / slope, []
    for now in z:
        if now - level > c_r:
            level = now - c_r
        elif level - now > c_l:
            level = now + c_l
        if level > sensor["right"]:
            y = slope * (level - sensor["right"])
        elif level < -sensor["left"]:
            y = slope * (level + sensor["left"])
        else:
            y = 0.0
        if quantum:
            y = quantum * np.floor(y / quantum + 0.5)
        readings.append(min(max(y, low), high))
    return np.array(readings)


@pytest.mark.parametrize(
    "changes",
    [{}, {"slope": 2.0, "start": 3.0}, {"quantum": 0.15}, {"range": [-2.0, 3.0]}],
    ids=str,
)
def test_the_run_reads_what_the_element_says(changes: dict[str, Any]) -> None:
    run = simulate(both(changes, NAIVE))
    expected = by_hand(run.z[:, 0], BOTH | changes)
    np.testing.assert_allclose(run.y[:, 0], expected, atol=1e-12)
    inside = np.abs(run.side[:, 0]) < 2
    np.testing.assert_array_equal(run.side[inside, 0], np.sign(expected[inside]))


@settings(max_examples=20)
@given(c=st.tuples(WIDTHS, WIDTHS), d=st.tuples(WIDTHS, WIDTHS))
@example(c=(0.0, 0.0), d=(0.0, 0.0))
def test_what_is_read_bounds_z(c: tuple[float, float], d: tuple[float, float]) -> None:
    """Silence within gap and zone; a reading within the gap about itself."""
    sensor = {"right": d[0], "left": d[1], "play": list(c)}
    run = simulate(both(sensor, NAIVE, simulation={"duration": 6.0}))
    z, y = run.z[:, 0], run.y[:, 0]
    above, below = np.where(y >= 0, d[0], -d[1]), np.where(y > 0, d[0], -d[1])
    assert (z <= y + above + c[0] + 1e-12).all()
    assert (z >= y + below - c[1] - 1e-12).all()


@pytest.mark.parametrize("observer", [KALMAN, CENSORED], ids=str)
def test_without_a_gap_it_is_the_dead_zone_to_the_bit(observer: dict[str, Any]) -> None:
    noisy = {"noise": 0.02}
    none = simulate(both(noisy | {"play": [0.0, 0.0]}, observer))
    plain = simulate(slow({"kind": "deadzone", "right": 1.0, "left": 0.7} | noisy, observer))
    for name in ("z", "y", "side", "z_hat", "d_hat", "d_std"):
        np.testing.assert_array_equal(getattr(none, name), getattr(plain, name))


def test_a_gap_that_goes_to_0_leaves_the_dead_zone() -> None:
    tiny = simulate(both({"play": [1e-13, 1e-13]}, NAIVE))
    plain = simulate(slow({"kind": "deadzone", "right": 1.0, "left": 0.7}, NAIVE))
    np.testing.assert_allclose(tiny.y, plain.y, atol=1e-12)


def test_without_a_zone_it_is_the_play() -> None:
    """To the bit what is read; what the filter makes of it, where it is not near 0."""
    gaps = {"right": 0.5, "left": 0.3}
    narrow = {"method": "kalman", "right": [0.0, 1e-9], "disturbance": 0.8, "noise": 0.01}
    run = simulate(both({"right": 0.0, "left": 0.0}, narrow, model=RANGES))
    ranges = narrow | {"right": [0.0, 1.0]}
    alone = simulate(slow({"kind": "play"} | gaps, NAIVE))
    naive = simulate(both({"right": 0.0, "left": 0.0}, NAIVE))
    np.testing.assert_array_equal(naive.y, alone.y)
    of_play = follow(run, slow({"kind": "play"} | gaps, ranges))
    assert run.c_hat is not None
    np.testing.assert_allclose(run.c_hat[-1], of_play.d_hat[-1], atol=5e-3)


# What is refused


def test_the_page_and_the_arena_refuse_it(tmp_path: Path) -> None:
    scenario = both({}, KALMAN, disturbance=None)
    with pytest.raises(InputError, match="one band, a dead zone's or a play's, not both"):
        uz.export(scenario, out=tmp_path / "p.html", to="page")
    with pytest.raises(InputError, match="Compare two observers"):
        build_setting(scenario)


# What the filters make of it


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("observer", [KALMAN, CENSORED], ids=["kalman", "censored"])
def test_gap_and_zone_are_found(reading: str, observer: dict[str, Any]) -> None:
    """Both widths, and the sum of both centres; neither centre alone."""
    run = simulate(both(READINGS[reading], observer, model=RANGES))
    assert run.c_hat is not None
    assert run.c_std is not None
    (c_r, c_l), (d_r, d_l) = run.c_hat[-1], run.d_hat[-1]
    assert c_r + c_l == pytest.approx(0.8, abs=0.02)
    assert d_r + d_l == pytest.approx(1.7, abs=0.02)
    assert c_r - c_l + d_r - d_l == pytest.approx(0.5, abs=0.15)
    assert late(run, run.z - run.z_hat) < 0.04
    assert (run.c_std[-1] > 0.1).all()


@pytest.mark.parametrize("reading", READINGS)
def test_widths_are_estimated_behind_known_gaps(reading: str) -> None:
    run = simulate(both(READINGS[reading], KALMAN))
    assert run.d_std is not None
    assert (run.d_std[-1] < 0.05).all()
    np.testing.assert_allclose(run.d_hat[-1], [1.0, 0.7], atol=0.05)
    assert run.c_hat is None


def test_exact_readings_determine_all_identifiable_combinations() -> None:
    exact = KALMAN | {"disturbance": 0.0, "noise": 1e-6}
    run = simulate(both({}, exact, model=RANGES, disturbance=None))
    assert run.c_hat is not None
    (c_r, c_l), (d_r, d_l) = run.c_hat[-1], run.d_hat[-1]
    assert c_r + c_l == pytest.approx(0.8, abs=1e-4)
    assert d_r + d_l == pytest.approx(1.7, abs=1e-4)
    assert c_r - c_l + d_r - d_l == pytest.approx(0.5, abs=1e-4)


def test_a_wrong_model_leaves_the_error() -> None:
    right = simulate(both({"noise": 0.02}, KALMAN, model=RANGES))
    zone = simulate(both({"noise": 0.02}, KALMAN, model={"play": [0.0, 0.0]}))
    assert late(zone, zone.z - zone.z_hat) > 10 * late(right, right.z - right.z_hat)


def test_a_wrong_sign_puts_the_gap_into_the_widths(monkeypatch: pytest.MonkeyPatch) -> None:
    right = simulate(both({"noise": 0.02}, KALMAN))
    sign = constant_states.offset

    def wrong(side: Any, *gaps: Any) -> Any:
        return -sign(side, *gaps)

    monkeypatch.setattr(constant_states, "offset", wrong)
    turned = follow(right, both({"noise": 0.02}, KALMAN))
    assert turned.consistent is False
    assert np.abs(turned.d_hat[-1] - [1.0, 0.7]).min() > 0.5


def test_a_log_gives_what_the_run_gave() -> None:
    scenario = both({"noise": 0.02}, CENSORED, model=RANGES)
    run = simulate(scenario)
    followed = follow(run, scenario)
    for name in ("x_hat", "d_hat", "c_hat", "c_std", "gap_std", "z_inverse"):
        np.testing.assert_array_equal(getattr(followed, name), getattr(run, name))
    assert followed.consistent


def test_missing_limited_and_wrong_readings_do_no_harm() -> None:
    sensor = {"noise": 0.02, "dropout": 0.2, "range": [-3.0, 3.0]}
    scenario = both(sensor, CENSORED, model=RANGES)
    run = simulate(scenario)
    assert np.isnan(run.y).any()
    assert (np.abs(run.side) == 2).any()
    y = run.y.copy()
    y[1000] += 30.0
    hit = follow(run, scenario)
    assert hit.c_hat is not None
    assert hit.c_hat[-1].sum() == pytest.approx(0.8, abs=0.05)
    assert late(run, run.z - hit.z_hat) < 0.1


def test_each_output_has_gaps_of_its_own() -> None:
    plant = tables_of("""
        A = [[0.0, 1.0, 0.0, 0.0], [-1.0, -2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0, 0, -2, -3]]
        B = [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]
        C = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
        """)
    sensor = tables_of("""
        right = [1.0, 0.4]
        left = [0.7, 0.6]
        play = [[0.5, 0.3], [0.2, 0.7]]
        """)
    changes: dict[str, Any] = tables_of("""
        controller = { method = "state_feedback", poles = [-8.0, -8.4, -8.8, -9.2] }
        model = { play = [[[0.0, 1.0], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]] }
        reference = { kind = "sine", amplitude = [5.0, 4.0], frequency = 0.2 }
        """) | {"plant": plant}
    run = simulate(both(sensor | {"noise": 0.02}, KALMAN, **changes))
    for i, (c, d) in enumerate([([0.5, 0.3], [1.0, 0.7]), ([0.2, 0.7], [0.4, 0.6])]):
        own = {"play": c, "right": d[0], "left": d[1], "noise": 0.02}
        exact = by_hand(run.z[:, i], own)
        assert np.abs(run.y[:, i] - exact).max() < 6 * 0.02 * 1.1
    assert run.c_hat is not None
    np.testing.assert_allclose(run.c_hat[-1].reshape(2, 2).sum(axis=1), [0.8, 0.9], atol=0.05)
    assert "gap_right" not in str(run)
    assert "gap_right" in run_page(run, {})


@pytest.mark.parametrize(
    ("place", "options"), [("slow", "`censored`"), *further(("arm", "`kalman`"))]
)
def test_intervals_hold_over_random_loops(place: str, options: str) -> None:
    ran = random_loops(place, options)
    gap, zone = np.abs(ran.gap_errors.sum(axis=1)), np.abs(ran.errors.sum(axis=1))
    assert np.mean(gap <= 1.96 * ran.gap_std) > 0.85
    assert np.mean(zone <= 1.96 * ran.width_std) > 0.8
    assert np.median(gap / ran.gaps.sum(axis=1)) < 0.06
    known = random_loops(place, "both known")
    assert np.median(ran.rms / known.rms) < 1.8
    mistaken = random_loops(place, "`kalman`, taken for a dead zone")
    assert np.median(mistaken.rms / known.rms) > 3


def random_loops(place: str, options: str) -> Loops:
    """Twenty loops of a family."""
    world, entry = WORLDS[place], bench.ROWS[options]
    each = [bench.posed(world, "noise 1 %", entry, seed) for seed in range(20)]
    return run_loops(each, 0.8 * world.duration)


# What readings can tell


def brute(linear: Matrices, z: Floats, sensor: dict[str, Any], noise: float) -> Floats:
    """Information on [x(0); c_r; c_l; d_r; d_l] of all readings that move, one by one."""
    n = linear.A.shape[0]
    (c_r, c_l), power = sensor["play"], np.eye(n)
    level, total = 0.0, np.zeros((n + 4, n + 4))
    for now in z:
        before, level = level, max(min(level, now + c_l), now - c_r)
        right, left = level > sensor["right"], level < -sensor["left"]
        if (right or left) and level != before:
            values = [-1.0 * (level > before), level < before, -1.0 * right, left]
            row = np.r_[(linear.C @ power)[0], np.array(values, float)]
            total += np.outer(row, row) / noise**2
        power = linear.A @ power
    return total


def assess_both(scenario: Scenario, gaps_known: bool = False) -> tuple[Any, Floats]:
    """What `told_of_both` says along the reference, and the information of its readings."""
    problem = resolve_scenario(scenario)
    t = np.arange(problem.steps) * 0.01
    z = problem.reference.output_at(t)
    schedule = schedule_of_record(z, problem.sensor, 0.01, problem.model.Ts)
    span = len(t) * 0.01
    known = np.zeros((0, problem.model.n + 2))
    rest = (np.ones(1), None, None, known, gaps_known)
    readings = ReadingConditions(np.array([0.02]), 0.01, span, *rest)
    (one,) = gap_and_width_information(problem.model.linear, schedule, readings)
    return one, brute(problem.model.linear, z[:, 0], BOTH, 0.02)


def test_deviations_are_those_of_all_readings() -> None:
    """Of the combinations that can be told, by the pseudo-inverse of the information."""
    one, information = assess_both(both({}, KALMAN, disturbance=None))
    scale = 1 / np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    assert (values < 1e-9 * values[-1]).sum() == 1
    hidden = scale * vectors[:, 0]
    np.testing.assert_allclose(hidden[2:] / hidden[2], [1, -1, -1, 1], atol=1e-5)
    cov = np.outer(scale, scale) * ((vectors[:, 1:] / values[1:]) @ vectors[:, 1:].T)
    gap, width = (np.array(row, float) for row in ([0, 0, 1, 1, 0, 0], [0, 0, 0, 0, 1, 1]))
    assert one.gap_std == pytest.approx(np.sqrt(gap @ cov @ gap), rel=1e-3)
    assert one.zone.std["width"] == pytest.approx(np.sqrt(width @ cov @ width), rel=1e-3)
    assert one.both
    assert not one.zone.centre
    assert not one.gap["centre"]


def test_known_gaps_leave_nothing_hidden() -> None:
    one, information = assess_both(both({}, KALMAN, disturbance=None), gaps_known=True)
    cov = np.linalg.inv(information[np.ix_([0, 1, 4, 5], [0, 1, 4, 5])])
    assert one.zone.right
    assert one.zone.left
    assert one.zone.std["right"] == pytest.approx(np.sqrt(cov[2, 2]), rel=1e-3)
    assert one.zone.std["left"] == pytest.approx(np.sqrt(cov[3, 3]), rel=1e-3)


def test_an_integrator_hides_the_sum_of_the_centres_too() -> None:
    motor = tables_of("""
        A = [[0.0, 1.0], [0.0, -2.0]]
        B = [[0.0], [1.0]]
        C = [[1.0, 0.0]]
        """)
    run = simulate(both({"noise": 0.02}, KALMAN, model=RANGES, plant=motor))
    (verdict,) = run.info.identifiable
    assert verdict["width"]
    assert not verdict["right"]
    assert any("sum of both centres" in reason for reason in verdict["reasons"])


def test_a_constant_disturbance_hides_where_the_zone_lies() -> None:
    """It moves the centre. A width is a difference of both edges, and is known."""
    step = {"kind": "step", "amplitude": 0.3}
    run = simulate(both({"noise": 0.02}, KALMAN, model=RANGES, disturbance=step))
    (verdict,) = run.info.identifiable
    assert verdict["width"]
    assert not verdict["right"]


def test_one_direction_alone_does_not_tell_the_gap() -> None:
    """A slow rise through the zone: beyond the edges the output moves right alone."""
    scenario = both(
        {"noise": 0.02, "start": -5.0},
        KALMAN,
        disturbance=None,
        reference={"kind": "sine", "amplitude": 5.0, "frequency": 0.02, "phase": -np.pi / 2},
    )
    one, _ = assess_both(scenario)
    assert not one.gap["width"]
    assert one.zone.width
    assert any("moves right alone" in reason for reason in one.zone.reasons)


@pytest.mark.parametrize(
    ("amplitude", "words"),
    [(1.1, "stays below d_r + c_r, 1."), (1.2, "the right edge is hardly reached")],
)
def test_an_edge_that_is_not_reached_is_named_with_its_gap(amplitude: float, words: str) -> None:
    """The loop of a filter that learns no noise comes close to the edge, and hardly beyond it."""
    low = {"kind": "sine", "amplitude": amplitude, "frequency": 0.2}
    fixed = KALMAN | {"glitches": 0.0}
    (verdict,) = simulate(both({}, fixed, model=RANGES, reference=low)).info.identifiable
    assert not verdict["right"]
    assert any(words in reason for reason in verdict["reasons"])
    assert not any("told are" in reason for reason in verdict["reasons"])


def test_check_and_run_say_the_same_in_words() -> None:
    scenario = both({"noise": 0.02}, KALMAN, model=RANGES)
    verdict, run = uz.check(scenario), simulate(scenario)
    for text in (str(verdict), str(run)):
        assert "right NO, left NO, width yes, centre NO" in text
        assert "cannot be separated from one of the zone" in text
    assert "model.play = [c_r, c_l]" in str(verdict)
    assert verdict.states == (True, True)  # what mixes the centres moves no state
    known = uz.check(both({"noise": 0.02}, KALMAN))
    assert known.affirmed


def test_known_gaps_that_exclude_the_truth_are_reported() -> None:
    scenario = both({"noise": 0.02}, KALMAN, model={"play": [0.6, 0.3]})
    for known in (simulate(scenario).info.identifiable[0]["reasons"], uz.check(scenario).reasons):
        assert any("a false assumption: model.play" in reason for reason in known)
    assert not uz.check(scenario).affirmed


def test_no_verdict_where_none_was_derived() -> None:
    actuator = {"right": 1.0, "left": 0.5}
    model = RANGES | {"actuator": {"right": [0.0, 2.0], "left": [0.0, 2.0]}}
    run = simulate(both({"noise": 0.02}, KALMAN, model=model, actuator=actuator))
    (verdict,) = run.info.identifiable
    assert not verdict["width"]
    assert "no verdict was derived" in verdict["reasons"][0]
    assert run.c_hat is not None
    assert run.c_hat[-1].sum() == pytest.approx(0.8, abs=0.03)
    assert late(run, run.z - run.z_hat) < 0.1


def test_a_plan_sees_the_zone_behind_the_gap() -> None:
    problem = resolve_scenario(both({}, KALMAN))
    schedule = plan_schedule(problem.model, problem.reference, [0], problem.sensor, 20.0)
    t = np.arange(500) * 0.01
    twice = by_hand(np.tile(5 * np.sin(2 * np.pi * 0.2 * t), 2), BOTH)[500:]
    moves = np.diff(twice, prepend=twice[-1])
    beyond = schedule.spans @ (schedule.sides == 1)
    assert beyond[0] == pytest.approx(((twice > 0) & (moves != 0)).sum(), abs=2)


# From a log


def test_identify_writes_the_scenario_that_runs(tmp_path: Path) -> None:
    rng, u, z = driven(21)
    gaps, widths = (0.25, 0.15), (0.2, 0.3)
    y = through(z, gaps, widths) + 0.01 * rng.standard_normal(z.size)
    found = identify_second_order(u, y)
    (tmp_path / "both.toml").write_text(found.scenario())
    scenario = uz.read(tmp_path / "both.toml")
    sensor = resolve_scenario(scenario).sensor
    assert sensor.play is not None
    assert sensor.play.right + sensor.play.left == pytest.approx(0.4, abs=0.03)
    assert sensor.right + sensor.left == pytest.approx(0.5, abs=0.05)
    centre = gaps[0] - gaps[1] + widths[0] - widths[1]
    assert sensor.right - sensor.left == pytest.approx(centre, abs=0.05)
    followed = uz.estimate(scenario, t=STEP * np.arange(y.size), y=y, u=u)
    assert followed.c_hat is not None
    assert followed.c_hat[-1].sum() == pytest.approx(0.4, abs=0.03)
    late_error = (followed.z_hat[:, 0] - z)[len(z) // 2 :]
    assert np.sqrt(np.mean(late_error**2)) < 0.05 * z.std()
    run = simulate(scenario.replace("simulation.duration", 60.0))
    assert run.divergence_time is None
    assert late(run, run.z - run.z_hat) < 0.1 * run.z.std()


# What is shown, written and run elsewhere


def test_gaps_are_reported_wherever_widths_are(tmp_path: Path) -> None:
    scenario = both({"noise": 0.02}, KALMAN, model=RANGES, title="Gears")
    run = simulate(scenario)
    numbers = run.summary()
    assert run.c_hat is not None
    assert numbers["gap_right"] == run.c_hat[-1, 0]
    assert numbers["gap_left_std"] > numbers["gap_std"] > 0
    assert "gap_right + gap_left" in str(run)
    assert "gap_right" in run_page(run, {})
    again = Run.load(run.save(tmp_path / "run.csv"))
    np.testing.assert_array_equal(again.c_hat, run.c_hat)
    assert again.info.gaps == [0.5, 0.3]
    assert run.unit("gap_right[0]") == run.unit("d_right[0]")
    followed = follow(run, scenario)
    assert followed.summary()["gap_right"] == run.c_hat[-1, 0]
    assert "gap_right + gap_left" in str(followed)


def test_a_scenario_is_read_as_it_was_written(tmp_path: Path) -> None:
    scenario = both({"noise": 0.02}, KALMAN, model=RANGES).replace("sensor.play[0]", 0.6)
    again = uz.read(scenario.save(tmp_path / "s.toml"))
    assert again.sensor.play is not None
    np.testing.assert_array_equal(again.sensor.play, [0.6, 0.3])
    assert str(again) == str(scenario)


@pytest.mark.parametrize(
    ("reading", "observer"),
    [(next(iter(READINGS)), KALMAN), *((reading, CENSORED) for reading in READINGS)],
    ids=["kalman", *READINGS],
)
def test_engines_agree_to_the_last_bit(reading: str, observer: dict[str, Any]) -> None:
    short = {"duration": 2.0}
    scenario = both(READINGS[reading], observer, model=RANGES, simulation=short)
    assert gap_of_engines(scenario) <= 1e-13


def test_exported_c_passes_its_self_test(tmp_path: Path) -> None:
    scenario = both({"noise": 0.02}, KALMAN, model=RANGES, simulation={"duration": 2.0})
    done = uz.export(scenario, out=tmp_path / "fw", precision="double", name="o")
    assert done.has_passed


@pytest.mark.parametrize("model", [None, RANGES], ids=["known", "unknown"])
def test_an_ensemble_varies_the_gaps(model: Any) -> None:
    vary = {"runs": 6, "sensor.play[0]": {"uniform": [0.1, 0.9]}}
    result = run_ensemble(both({"noise": 0.02}, KALMAN, model=model, ensemble=vary))
    assert replay_deviation(result, 2) == 0
    assert np.median(result.column("rms_estimation")) < 0.05


def test_gaps_and_ranges_have_one_shape_for_any_number_of_outputs() -> None:
    three = resolve(Sensor(right=1.0, left=1.0, play=[0.5, 0.3]), 3, 0.01).play
    assert three is not None
    np.testing.assert_array_equal(three.right, [0.5] * 3)
    pair = [[0.0, 1.0], [0.0, 2.0]]
    resolved = resolve(Sensor(right=1.0, left=1.0, play=pair), 3, 0.01).play
    assert resolved is not None
    np.testing.assert_array_equal(resolved.left, [1.0] * 3)
    two = resolve(Sensor(right=1.0, left=1.0, play=pair), 2, 0.01).play  # one pair per output
    assert two is not None
    assert two.ranges is None
    np.testing.assert_array_equal(two.left, [1.0, 2.0])


@pytest.mark.parametrize(("side", "seen"), [(0, "right"), (1, "left")])
def test_a_reason_names_an_output_that_is_read_in_one_contact_alone(side: int, seen: str) -> None:
    """Beyond one of both edges suffices."""
    read = np.zeros((2, 2), bool)
    read[side, 1] = True
    (words,) = _single_contact_reason(read, 0)
    assert f"while it moves {seen} alone" in words


def test_gaps_that_are_known_have_no_error_in_any_output() -> None:
    linear = Matrices(-np.eye(2), np.eye(2), np.eye(2))
    readings = ReadingConditions(np.full(2, 0.1), 0.01, 1.0, gaps_known=True)
    sensor = resolve(Sensor(**BOTH), 2, 0.01)
    schedule = schedule_of_record(np.outer(np.sin(np.arange(99)), [2.0, 2.0]), sensor, 0.01, 0.01)
    rows = append_gaps(linear, schedule, readings)[2].prior
    assert rows is not None
    np.testing.assert_array_equal(rows / rows.max(), np.eye(2 + 4 * 2)[2:6])
