"""Looks at rest, reversals and torque: numbers ahead of dynamics, none without evidence."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from benchmarks.identify.logs.strangers import dragged
from scipy.signal import lfilter

import undeadzone as uz
from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.log import Options, read_log
from undeadzone_identify.looks.map import map_at_rest
from undeadzone_identify.looks.pushes import friction_level
from undeadzone_identify.looks.rests import free_play_between_rests
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.selection.lost_motion import LostMotionAnswer, find_lost_motion

SEEDS = 20
FEW = 17  # of 20 intervals hold at least: below it lies 1.6 % of fair ones of 95 %
Log = tuple[Floats, Floats, Floats]


# --- What rests


def flipping_load(seed: int, play: float = 17.0, flips: float = 0.06) -> Log:
    """A servo holds three goals while a load pulls it to either side of its play, in counts."""
    rng = np.random.default_rng(seed)
    goals = np.resize(np.repeat([-100.0, 0.0, 100.0, 0.0], [14, 55, 14, 55]), 400)
    at, side, y = 0.0, 1.0, np.empty(goals.size)
    for k, goal in enumerate(goals):
        side = -side if rng.random() < flips else side
        at += np.clip(0.8 * (goal + side * play / 2 - at), -25, 25)
        y[k] = round(at + 0.4 * rng.standard_normal())
    return 0.1 * np.arange(goals.size), goals, y


def test_a_load_that_flips_shows_the_free_play_between_two_rests() -> None:
    held = 0
    for seed in range(SEEDS):
        found = free_play_between_rests(*flipping_load(seed))
        assert found is not None
        assert found.goal == 0
        held += found.play.low <= 17 <= found.play.high
    assert held >= FEW


def test_the_free_play_is_that_of_any_unit_and_any_origin() -> None:
    t, u, y = flipping_load(3)
    one = free_play_between_rests(t, u, y)
    other = free_play_between_rests(1e3 * t, 0.25 * u + 512, 0.25 * y + 512)
    assert one is not None
    assert other is not None
    assert list(other.play) == pytest.approx([0.25 * end for end in one.play])
    assert (other.flips, other.is_measured) == (one.flips, one.is_measured)


@pytest.mark.parametrize(("play", "flips"), [(17.0, 0.0), (1.0, 0.06), (0.0, 0.06)])
def test_a_load_that_never_flips_and_a_flicker_of_a_count_are_no_free_play(
    play: float, flips: float
) -> None:
    assert all(free_play_between_rests(*flipping_load(k, play, flips)) is None for k in range(8))


def test_rests_that_depend_on_the_side_of_arrival_are_no_free_play() -> None:
    """Friction stops an axis on either side of its goal, but never in the middle of a hold."""
    goals = np.repeat(np.tile([-100.0, 0.0, 100.0, 0.0], 8), 20)
    came = np.repeat(np.tile([-1.0, 1.0, 1.0, -1.0], 8), 20)
    y = np.round(goals - 8 * came + 0.4 * np.random.default_rng(0).standard_normal(goals.size))
    assert free_play_between_rests(np.arange(goals.size) * 0.1, goals, y) is None


# --- A valley that sweeps pass both ways


def focus_sweeps(seed: int, gap: float, sweeps: int = 4) -> tuple[Floats, Floats]:
    """Size of a star over the commanded place of a focuser, up and down in turn."""
    rng = np.random.default_rng(seed)
    up = np.linspace(-1000, 1000, 41)
    u = np.concatenate([up[:: 1 if k % 2 == 0 else -1] for k in range(sweeps)])
    size = np.hypot(2.0, 0.01 * (dragged(u, gap) - 60))
    return u, size * (1 + 0.02 * rng.standard_normal(u.size))


def gap_of(u: Floats, y: Floats) -> Interval | None:
    """Distance of the ways in the map at rest of a log without times."""
    seen = map_at_rest(None, u, y)
    return None if seen is None or seen.curve is None else seen.curve.distance


def test_the_least_reading_moves_by_the_gap_between_sweeps_up_and_down() -> None:
    held = 0
    for seed in range(SEEDS):
        gap = gap_of(*focus_sweeps(seed, 200.0))
        assert gap is not None
        assert gap.value == pytest.approx(200, abs=10)
        held += gap.low <= 200 <= gap.high
    assert held >= FEW


def test_valleys_without_a_gap_have_none_and_units_change_nothing() -> None:
    u, y = focus_sweeps(1, 200.0)
    gap, none = gap_of(u, y), gap_of(*focus_sweeps(1, 0.0))
    scaled = gap_of(-3 * u, 7 * y)
    assert gap is not None
    assert none is not None
    assert scaled is not None
    assert none.low < 0 < none.high
    assert scaled.value == pytest.approx(3 * gap.value)


# --- What pushes


def joint(seed: int, level: float, way: float = 0.0) -> tuple[Floats, Floats, Floats, Floats]:
    """Times, torque, angle and speed of a joint with inertia and weight, at irregular times."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.008, 0.012, 4000))
    rates, phases = np.array([0.9, 2.3, 4.1]), rng.uniform(0, 6, 3)
    sizes = np.array([0.8, 0.3, 0.1])
    angles = np.outer(t, rates) + phases
    q = np.sin(angles) @ sizes + way * t
    v = np.cos(angles) @ (sizes * rates) + way
    a = -np.sin(angles) @ (sizes * rates**2)
    torque = level * np.sign(v) + 0.4 * v + 0.25 * a + 1.5 * np.sin(q) + 0.3
    noise = rng.standard_normal((2, t.size))
    return t, torque + 0.1 * noise[0], q + 1e-4 * noise[1], v + 0.01 * noise[1]


@pytest.mark.parametrize("is_speed", [False, True])
def test_the_torque_of_both_ways_shows_the_friction_level(is_speed: bool) -> None:
    held = 0
    for seed in range(SEEDS):
        t, torque, q, v = joint(seed, 0.7)
        found = friction_level(t, torque, v if is_speed else q, is_speed)
        assert found is not None
        assert found.is_measured
        assert found.level.value == pytest.approx(0.7, abs=0.05)
        held += found.level.low <= 0.7 <= found.level.high
    assert held >= FEW


def test_a_friction_level_has_the_unit_of_its_torque() -> None:
    t, torque, q, _ = joint(1, 0.7)
    one = friction_level(t, torque, q, False)
    other = friction_level(1e3 * t, 50 * torque, q, False)
    assert one is not None
    assert other is not None
    assert list(other.level) == pytest.approx([50 * end for end in one.level])


@pytest.mark.parametrize(("level", "way", "sign"), [(0.0, 0.0, 1), (0.7, 4.0, 1), (0.7, 0.0, -1)])
def test_no_friction_one_way_and_a_torque_of_the_wrong_sign_give_no_level(
    level: float, way: float, sign: int
) -> None:
    for seed in range(4):
        t, torque, q, _ = joint(seed, level, way)
        assert friction_level(t, sign * torque, q, False) is None


# --- What turns


def ask(columns: dict[str, Floats], named: str | None = None) -> tuple[LostMotionAnswer, bool]:
    """Return the lost motion of a log, and whether it stands before plants are tried."""
    found, stands = find_lost_motion(read_log(pd.DataFrame(columns), named), Options())
    assert found is not None
    return found, stands


@pytest.mark.parametrize("back", [False, True])
def test_a_zone_on_a_ramp_that_hardly_turns_is_no_play(back: bool) -> None:
    u = np.arange(-254, 255.0)
    u = np.append(u, u[::-1]) if back else u
    zone = np.maximum(u - 45, 0) + np.minimum(u + 39, 0)
    y = 640 * np.tanh(zone / 60) + 4 * np.random.default_rng(1).standard_normal(u.size)
    found, stands = ask(
        {"t": 1.1 * np.arange(u.size), "motorCommand": u, "y": y}, "y=y,u=motorCommand"
    )
    assert (found.verdict, stands) == ("unclear", False)
    assert list(found.gap) == [0, 0, np.ptp(u)]
    assert any("turns round" in reason for reason in found.reasons)


def step_goals(seed: int, gap: float) -> dict[str, Floats]:
    """An axis that follows steps of its goal with a lag, behind a gap, in counts."""
    rng = np.random.default_rng(seed)
    goal = np.repeat(np.cumsum(rng.permutation(np.tile([-400, -200, 200, 400], 4))), 150)
    motor = np.empty(goal.size)
    at = 0.0
    for k, one in enumerate(goal):
        motor[k] = at = at + 0.35 * (one - at)
    y = np.floor(dragged(motor, gap) + 0.5 + 0.55 * rng.standard_normal(goal.size))
    return {"t [s]": 0.005 * np.arange(goal.size), "target [counts]": goal, "measured [counts]": y}


def test_a_lag_behind_steps_of_a_goal_is_no_play_and_has_a_bound() -> None:
    for seed in range(8):
        found, stands = ask(step_goals(seed, 0.0))
        assert (found.verdict, stands) == ("none", True)
        assert found.is_at_rest
        assert 0 < found.gap.high < 1.01


def test_the_readings_at_rest_show_the_gap_behind_a_lag() -> None:
    held = 0
    for seed in range(SEEDS):
        found, _ = ask(step_goals(seed, 12.0))
        assert found.verdict == "play"
        assert any("at rest" in reason for reason in found.reasons)
        held += found.gap.low <= 12 <= found.gap.high
    assert held >= FEW


def test_a_fit_that_leaves_more_than_it_excludes_excludes_nothing() -> None:
    for seed in range(8):
        t, u, y = flipping_load(seed)
        found, stands = ask({"t [s]": t, "target pos": u, "pos": y}, "y=pos,u=target pos")
        assert (found.verdict, stands) == ("unclear", False)


def test_play_that_alone_leaves_noise_needs_no_name_of_a_position() -> None:
    """A plunger and its volume, whose play ahead and behind is one and the same."""
    held = 0
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        u = np.interp(np.arange(800), np.arange(0, 840, 40), rng.uniform(2, 18, 21))
        y = 15 * dragged(u, 0.5) + 0.3 * rng.standard_normal(u.size)
        columns = {"time": 0.05 * np.arange(u.size), "plunger": u, "volume": y}
        found, stands = ask(columns, "y=volume,u=plunger")
        assert (found.verdict, stands) == ("play", True)
        held += found.gap.low <= 0.5 <= found.gap.high
    assert held >= FEW
    one = uz.identify(pd.DataFrame(columns), columns="y=volume,u=plunger")
    assert isinstance(one, uz.IdentifiedMotion)


@pytest.mark.parametrize("size", [150, 800])
@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_a_lag_of_a_sample_is_no_play_where_no_name_says_positions(size: int, noise: float) -> None:
    """A straight line explains nearly all of it, as of a plunger, and noise hides the lag."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = lfilter([1.0], [1.0, -0.95], rng.standard_normal(size))
        y = lfilter([0.7], [1.0, -0.3], u) + noise * rng.standard_normal(size)
        found, stands = ask({"t": 0.05 * np.arange(size), "u": u, "y": y})
        assert not (stands and found.verdict == "play")
