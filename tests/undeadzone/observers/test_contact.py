"""First passages, and the filter of contacts of arms behind gears."""

from __future__ import annotations

import importlib
import subprocess
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest

import once
import undeadzone as uz
from documents import EXAMPLES
from requirements import import_package
from scenes import tables_of
from undeadzone.cli import group
from undeadzone.interfaces import Reading
from undeadzone.numerics.first_passage import arrival_shares, chance_beyond, condition_on_edge
from undeadzone.numerics.gaussian import Gaussian, mix_gaussians, truncate_to_range
from undeadzone.observers.contact import (
    JUMP,
    OPEN,
    Jumps,
    accumulate_jumps,
    largest_of_groups,
    variance_of_starts,
)
from undeadzone.observers.contact_filter.drive import (
    PASSED,
    apply_gear_impulses,
    build_drive,
    mean_posture,
    mix_posteriors,
)
from undeadzone.observers.contact_filter.modes import (
    LOST,
    Layout,
    Mode,
    Posterior,
    _move_mode,
    condition_on_impact,
    correct_modes,
    predict_modes,
    replace_diverged,
)
from undeadzone.plants.robots.build import build_two_link
from undeadzone.plants.robots.geared import Gears, build_geared_arm
from undeadzone.results import mjcf
from undeadzone.results.run import final_width_rows
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone_export import exporting

SERVO = """
sensor = { right = 0.0, left = 0.0, noise = 0.0005 }
observer = { method = "contact", half = [0.0, 0.06], payload = [0.0, 0.5] }
controller = { method = "computed_torque", bandwidth = 15.0, crossing = 40.0 }
simulation = { time = "sampled", duration = 4.5, step = 0.001, substeps = 4 }

[plant]
x0 = [-1.5708, 0.0]
parameters = { m = 0.35, l = 0.25, c = 0.125, I = 0.0018, payload = 0.2, f1 = 0.02, b1 = 0.01 }

[plant.arm]
kind = "one_link"
torque_max = 3.0
gears = { half = 0.03, inertia = 0.012, friction = 0.08, viscous = 0.05 }

[model.parameters]
payload = 0.0

[reference]
kind = "quintic"
points = [[-1.57], [-1.07], [-2.07], [-1.07], [-2.07], [-1.07], [-1.57]]
times = [0.0, 0.7, 1.7, 2.7, 3.7, 4.7, 5.4]
"""

HINGES = """
<mujoco>
  <compiler angle="radian" autolimits="false"/>
  <option gravity="0 0 0" timestep="1e-4"/>
  <include file="gears.xml"/>
  <worldbody>
    <body>
      <inertial pos="0.125 0 0" mass="0.35" diaginertia="1e-4 0.0018 0.0018"/>
      <joint name="q1" class="q1_motor" axis="0 0 1"/>
      <joint name="q1_gap" class="q1_gap" axis="0 0 1"/>
    </body>
  </worldbody>
</mujoco>
"""


def servo(**changes: Any) -> uz.Scenario:
    """A hanging servo behind gears whose gap, payload and friction are not told."""
    tables = tomllib.loads(SERVO)
    for name, entries in changes.items():
        tables[name] = tables[name] | entries
    return convert(tables)


@pytest.fixture(scope="module")
def run() -> uz.Run:
    return uz.simulate(servo())


def test_mujoco_has_the_gap_that_a_run_found(run: uz.Run, tmp_path: Path) -> None:
    """The link is pushed to both ends by less than what the motor's friction holds."""
    mujoco: Any = import_package("mujoco")
    (tmp_path / "servo.toml").write_text(SERVO.replace("duration = 4.5", "duration = 0.2"))
    words = ["run", str(tmp_path / "servo.toml"), "--out", str(tmp_path), "--json"]
    group.main(words, standalone_mode=False)
    assert "armature" in (tmp_path / "gears.xml").read_text()
    [joint] = mjcf.joints_from_run(run)
    [path] = mjcf.write_gears([joint], tmp_path)
    model = mujoco.MjModel.from_xml_string(HINGES, {path.name: path.read_bytes()})
    assert model.dof_armature[0] == pytest.approx(0.012)
    assert model.dof_damping[0] == pytest.approx(0.05)
    assert model.dof_frictionloss[0] == pytest.approx(run.parameters["friction1"]["estimate"])
    ends, data = [], mujoco.MjData(model)
    for push in (0.05, -0.05):
        data.qfrc_applied[1] = push
        mujoco.mj_step(model, data, 6_000)
        ends.append(data.qpos[1])
    assert abs(data.qpos[0]) < 5e-3
    assert ends == pytest.approx([joint.ahead, -joint.behind], abs=2e-4)
    assert joint.ahead == pytest.approx(0.03, abs=0.003)


def test_what_found_no_gap_says_none_to_mujoco() -> None:
    """An observer that is told the state believes the model, which may have no gap."""
    tables = tomllib.loads(SERVO) | {"observer": {"method": "full_state"}}
    tables["simulation"] |= {"duration": 0.05}
    assert mjcf.joints_from_run(uz.simulate(convert(tables))) == []


# --- First passage


def passages(samples: int, speed: float, spread: float) -> tuple[Any, Any, Any]:
    """(shares that arrive in each sample by Monte Carlo, by `arriving`, by cuts; last spread)."""
    rng = np.random.default_rng(1)
    place = rng.normal(-1.0, spread, 200_000)
    h, slack = ca.DM([[1.0]]), 1e-8
    true, by_shares, cut = [], [], []
    whole, truncated = (
        Gaussian(ca.SX(-1.0), ca.SX(spread**2)),
        Gaussian(ca.SX(-1.0), ca.SX(spread**2)),
    )
    waiting = place <= 0
    for _ in range(samples):
        before = chance_beyond(whole, h, whole.mean, slack)
        place, whole = place + speed, Gaussian(whole.mean + speed, whole.cov)
        true.append(np.mean(place[waiting] > 0))
        waiting &= place <= 0
        by_shares.append(
            float(
                ca.evalf(arrival_shares([before], [chance_beyond(whole, h, whole.mean, slack)])[0])
            )
        )
        truncated = Gaussian(truncated.mean + speed, truncated.cov)
        cut.append(float(ca.evalf(chance_beyond(truncated, h, truncated.mean, slack))))
        shift, lost, _ = truncate_to_range(truncated.mean, truncated.cov, -1e3, 0.0)
        truncated = Gaussian(
            truncated.mean + truncated.cov * shift, truncated.cov - lost * truncated.cov**2
        )
    return np.array(true), np.array(by_shares), np.array(cut)


def test_shares_of_first_passage_are_those_of_monte_carlo_and_cuts_are_not() -> None:
    """A belief that is cut in every sample narrows without news: its shares run away."""
    true, by_shares, cut = passages(60, 0.03, 0.4)
    near = 4 * np.sqrt(true / 200_000 / np.maximum(np.cumprod(1 - true), 1e-3)) + 1e-4
    assert (np.abs(by_shares - true) < near).all()
    assert np.abs(cut[-10:] / true[-10:] - 1).min() > 0.1


def test_both_edges_share_what_has_not_arrived() -> None:
    shares = [float(ca.evalf(ca.SX(each))) for each in arrival_shares([0.2, 0.4], [0.3, 0.4])]
    assert shares == pytest.approx([0.25, 0.0])
    shares = [float(ca.evalf(ca.SX(each))) for each in arrival_shares([0.9, 0.1], [0.9, 0.1])]
    assert sum(shares) == pytest.approx(1.0)  # nothing is left between them


def test_at_an_edge_a_position_tells_where_it_is() -> None:
    """Of x = [position; edge], both unknown, arrival makes them one."""
    belief = Gaussian(ca.SX([1.0, 2.0]), ca.SX(ca.diag([4.0, 1.0])))
    h = ca.DM([[1.0, -1.0]])
    mean, cov = (
        np.asarray(ca.evalf(part)) for part in condition_on_edge(belief, h, h @ belief.mean, 1e-12)
    )
    assert mean.ravel() == pytest.approx([1.8, 1.8])
    assert cov == pytest.approx(np.full((2, 2), 0.8))


def test_a_mixture_has_the_moments_of_its_parts() -> None:
    parts = [Gaussian(ca.SX([0.0]), ca.SX([[1.0]])), Gaussian(ca.SX([2.0]), ca.SX([[3.0]]))]
    mean, cov = (float(ca.evalf(part)) for part in mix_gaussians([0.25, 0.75], parts))
    assert (mean, cov) == pytest.approx((1.5, 0.25 + 2.25 + 0.25 * 0.75 * 4))


# --- The filter


def test_gap_payload_and_friction_are_found_on_the_way(run: uz.Run) -> None:
    """None of them is told; each lies in its 95 % interval twice over."""
    half, std = float(run.d_hat[-1].ravel()[0]), float(run.d_std[-1].ravel()[0])
    assert abs(half / 0.03 - 1) < 0.1
    assert abs(half - 0.03) < 4 * std
    theta, theta_std = run.theta_hat[-1], run.theta_std[-1]
    assert (np.abs(theta - [0.2, 0.08, 0.02]) < 4 * theta_std).all()
    link = np.abs(run.z - run.z_hat)[-2000:]
    assert np.sqrt(np.mean(link**2)) < 0.003 < 0.03
    assert run.consistent[-1].all()


@pytest.mark.parametrize(
    ("gears", "unknown"),
    [
        ({"stiffness": 200.0}, {"winding": [0.0, 0.01]}),
        ({"asymmetry": 0.04}, {"asymmetry": [-0.1, 0.1]}),
        ({"drag": 0.1}, {"drag": [0.0, 0.3]}),
        ({"inertia": 0.024}, {"inertia": [0.01, 0.03]}),
        ({}, {"wear": [0.0, 0.01]}),
    ],
)
def test_further_numbers_of_the_gears_are_found_with_the_gap(gears: Any, unknown: Any) -> None:
    """The model has others, which do not count; each lies in its interval twice over."""
    tables = tomllib.loads(SERVO)
    plant = {"arm": tables["plant"]["arm"] | {"gears": tables["plant"]["arm"]["gears"] | gears}}
    [name] = unknown
    model = {"parameters": {"payload": 0.0} | {f"{each}1": 0.012 for each in unknown if gears}}
    observer = {"unknown": unknown, "starts": 1}
    run = uz.simulate(servo(plant=plant, model=model, observer=observer))
    found = run.parameters[f"{name}1"]
    assert abs(found["estimate"] - found["true"]) < 4 * found["std"]
    assert found["std"] < np.ptp(unknown[name]) / np.sqrt(12) / 2
    half, std = float(run.d_hat[-1].ravel()[0]), float(run.d_std[-1].ravel()[0])
    assert abs(half - 0.03) < min(4 * std, 0.003)
    told = "lost motion of q1" in str(run) and "N m: gap 0.0" in str(run)
    assert told == (name == "winding")
    assert ("gap of q1 grows by" in str(run)) == (not gears)


def test_a_half_gap_wears_by_its_rate() -> None:
    """No plant has it; the filter's half gap grows by its unknown rate."""
    scenario = servo(observer={"unknown": {"wear": [0.0, 0.001]}})
    observer = resolve_scenario(scenario).observer
    (setup,) = observer.step.args
    drive, x = setup.drives[0], ca.SX.zeros(setup.layout.entry_count)
    x[setup.layout.slice_of("wear")] = 7e-4
    rate = drive.rate(ca.SX(setup.gears.values), x, 0.0, (0,))[0]
    assert float(ca.evalf(rate)[setup.layout.slice_of("half")]) == 7e-4
    assert observer.traits.uncertain[-1] == "wear1"
    with pytest.raises(uz.InputError, match=r"observer\.unknown\.oil: cannot be estimated\. There"):
        resolve_scenario(servo(observer={"unknown": {"oil": [0.0, 1.0]}}))
    with pytest.raises(
        uz.InputError, match=r"observer\.unknown\.drag: a range needs 0 <= lo <= hi"
    ):
        resolve_scenario(servo(observer={"unknown": {"drag": [-1.0, 1.0]}}))


def test_a_contact_modelled_far_too_slow_is_found_firm() -> None:
    """Wind-up that is not there would put the link elsewhere: 1.7 mrad where firmness is known."""
    slow = {"parameters": {"payload": 0.0, "contact1": 60.0}}
    slow_run = uz.simulate(servo(model=slow, observer={"centre": 0.0}))
    half, std = float(slow_run.d_hat[-1].ravel()[0]), float(slow_run.d_std[-1].ravel()[0])
    assert abs(half / 0.03 - 1) < 0.05
    assert abs(half - 0.03) < 2 * std
    assert np.sqrt(np.mean((slow_run.z - slow_run.z_hat)[-2000:] ** 2)) < 0.0016


def test_engines_agree() -> None:
    short = servo(simulation={"duration": 0.3}, observer={"starts": 1})
    one, other = (uz.simulate(short, engine=engine) for engine in ("interpret", "lanes"))
    assert np.allclose(one.z_hat, other.z_hat, rtol=0, atol=1e-9)
    assert np.allclose(one.d_hat, other.d_hat, rtol=0, atol=1e-9)


def test_before_a_first_reading_nothing_is_foretold() -> None:
    """A run whose first reading is missing begins with the next one."""
    scenario = servo(simulation={"duration": 0.05}, sensor={"dropout": 0.5})
    run = uz.simulate(scenario)
    assert np.isfinite(run.z_hat).all()
    assert np.abs(run.z_hat - run.z)[-1] < 0.06


# --- Joint by joint


def test_one_joint_alone_is_the_coupled_filter() -> None:
    """Where its payload is told, which bends its dynamics; gravity is linear within a sample."""
    short, options = {"duration": 0.2}, {"payload": [0.2, 0.2]}
    coupled = uz.simulate(servo(simulation=short, observer=options))
    alone = uz.simulate(servo(simulation=short, observer=options | {"joints": "separate"}))
    assert np.allclose(alone.z_hat, coupled.z_hat, rtol=0, atol=1e-6)
    assert np.allclose(alone.d_std, coupled.d_std, rtol=1e-4)


def test_two_links_are_found_joint_by_joint() -> None:
    """Gaps lie in their intervals, which are no wider than 5 mrad after 3 s of swings."""
    example = tomllib.loads((EXAMPLES / "two_link_gears.toml").read_text())
    del example["compare"]
    example["observer"]["joints"] = "separate"
    example["simulation"]["duration"] = 3.0
    run = uz.simulate(convert(example))
    half, std = run.d_hat[-1].reshape(2, 2)[:, 0], run.d_std[-1].reshape(2, 2)[:, 0]
    assert (np.abs(half - [0.05, 0.06]) < 3 * std).all()
    assert (std < 0.005).all()
    assert np.abs(run.z - run.z_hat)[-300:].max() < 0.004
    assert abs(run.theta_hat[-1, 0] - 0.5) < 4 * run.theta_std[-1, 0]
    assert run.consistent[-1].all()


def test_joint_by_joint_gaps_are_less_sure_by_their_coupling() -> None:
    """Their variance is the filter's times half the coupling, or 1.3, at most the range's."""
    example = tomllib.loads((EXAMPLES / "two_link_gears.toml").read_text())
    del example["compare"]
    example["observer"] |= {"joints": "separate", "starts": 1, "compliance": 1e-6}
    problem = resolve_scenario(convert(example))
    observer, stds = problem.observer, []
    first = observer.init(observer.params)
    assert first.coupling.tolist() == [1.0, 1.0]
    surer = tuple(
        tuple(one._replace(covs=tuple(np.asarray(cov) / 16 for cov in one.covs)) for one in modes)
        for modes in first.modes
    )
    reading = Reading(ca.SX(problem.x0[:2]), ca.SX.zeros(2))
    for coupling in ([1.0, 2.6], [8.0 * 1.3, 2.0], [1e3, 1e3]):
        now = first._replace(modes=surer, coupling=np.array(coupling))
        after, estimate = observer.step(observer.params, now, ca.SX.zeros(2), reading)
        stds.append(np.asarray(ca.evalf(estimate.width_std)).ravel())
        assert (np.asarray(ca.evalf(after.coupling)).ravel() >= coupling).all()
    range_std = (
        2 * np.ptp(np.broadcast_to(example["observer"]["half"], (2, 2)), axis=1) / np.sqrt(12)
    )
    assert (stds[0] < range_std / 3).all()
    assert stds[1] == pytest.approx(stds[0] * [2.0, 1.0], rel=1e-3)
    assert stds[2] == pytest.approx(range_std, rel=1e-3)


def test_what_a_motor_tells_of_its_gears_moves_the_free_links_of_others() -> None:
    """As the arm answers to an impulse at that joint; a link in contact is left to its readings."""
    gears = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))
    mean = ca.DM([0.3, 0.8, 0.3, 0.8, *[0.0] * 17])
    belief = Gaussian(ca.SX(11, 1), ca.SX.eye(11))
    posterior = Posterior((), (belief,) * 3, belief, belief.mean, 0.0, 1.0)
    arm = mean_posture(Layout(2), gears, gears.values, mean, ca.DM.zeros(2))
    news, impulse = ca.SX(21, 1), 0.2
    news[5] = -impulse / 0.03  # the second motor, slower than was foretold
    first, second = apply_gear_impulses([(0,), (1,)], [posterior, posterior], news, arm)
    right, free, left = (float(one.mean[3]) for one in first.beliefs)
    answer = np.asarray(ca.evalf(build_drive(gears, 1e-3, 1).mobility(gears.values, mean)))
    assert free == pytest.approx(PASSED * impulse * answer[2, 1])
    assert right == left == 0.0
    assert all(float(one.mean[3]) == 0.0 for one in second.beliefs)


def test_three_filters_find_a_gap_that_one_of_them_had_locked_on() -> None:
    """A servo that MuJoCo moves, from the table of `python -m benchmarks contact`."""
    import_package("mujoco")
    gears = importlib.import_module("benchmarks.gears.contact")
    row = next(row for row in gears.rows() if row.label == "servo, horizontal")
    seed = 14079
    arm = row.draw(np.random.default_rng(seed))
    centred = gears.changed(row.scenario, observer={"centre": 0.0})
    three = gears.outcome(gears.bench(centred), arm, seed)
    assert abs(three.score[0]) < 3
    assert three.half[0] == pytest.approx(1.0, abs=0.25)


def test_filters_count_by_their_shares_and_one_that_overflows_is_renewed() -> None:
    rng, entries = np.random.default_rng(0), Layout(1).entry_count
    beliefs = [Gaussian(ca.SX(rng.normal(size=entries)), ca.SX.eye(entries)) for _ in range(2)]
    posteriors = []
    for belief, e in zip(beliefs, (1.0, 3.0), strict=True):
        posteriors.append(
            Posterior((0.2, 0.3, 0.5), (belief,) * 3, belief, belief.mean, e, 2.0, 0.0)
        )
    both = mix_posteriors(posteriors, (ca.SX([0.5, 0.5]), ca.SX([0.25, 0.75])))
    first, second = (np.asarray(ca.evalf(belief.mean)).ravel() for belief in beliefs)
    mean, off = 0.25 * first + 0.75 * second, first - second
    assert np.asarray(ca.evalf(both.whole.mean)).ravel() == pytest.approx(mean)
    cov = np.eye(entries) + 0.25 * 0.75 * np.outer(off, off)
    assert np.asarray(ca.evalf(both.whole.cov)) == pytest.approx(cov)
    assert [float(one) for one in both.chances] == pytest.approx(
        [0.05, 0.075, 0.125, 0.15, 0.225, 0.375]
    )
    assert float(both.e) == pytest.approx(2.0)
    assert float(both.std) == pytest.approx(np.sqrt(4 + 1))
    runaway = Gaussian(ca.SX(np.full(entries, np.nan)), beliefs[0].cov)
    lost = posteriors[0]._replace(
        beliefs=(runaway,) * 3, whole=runaway, news=runaway.mean, log=LOST
    )
    renewed = replace_diverged([posteriors[1], lost])
    for one in renewed:
        assert (np.asarray(ca.evalf(one.whole.mean)).ravel() == second).all()
        assert (np.asarray(ca.evalf(one.beliefs[2].mean)).ravel() == second).all()


def test_a_joint_has_up_to_three_filters() -> None:
    assert len(resolve_scenario(servo()).observer.params.start[0]) == 3
    one = resolve_scenario(servo(observer={"starts": 1})).observer
    assert len(one.params.start[0]) == 1
    with pytest.raises(uz.InputError, match=r"observer\.starts: expected 1 to 3, found 4"):
        resolve_scenario(servo(observer={"starts": 4}))


@pytest.mark.parametrize(("speed", "share"), [(0.0, 0.0), (2.0, 1.0)])
def test_joint_by_joint_a_resting_link_gives_no_information_on_a_gap(
    speed: float, share: float
) -> None:
    """A link that comes upon a flank, 10 mrad later than predicted; the motor has a speed."""
    gears = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))
    of, mean = Layout(2).slice_of, ca.DM.zeros(Layout(2).entry_count)
    place = of("half").start
    mean[of("half")], mean[of("motor_speed").start], mean[of("link").start] = 0.05, speed, -0.06
    belief = Gaussian(ca.SX(mean), 1e-4 * ca.SX.eye(Layout(2).entry_count))

    def gap_shift(apart: bool) -> float:
        q = SimpleNamespace(model=gears.values, slack=1e-8, impact=0.3)
        drive = build_drive(gears, 1e-3, 1, apart)
        return float(condition_on_impact(drive, q, 0, -1, belief).mean[place]) - 0.05

    assert abs(gap_shift(False)) > 1e-3
    assert gap_shift(True) == pytest.approx(share * gap_shift(False), abs=1e-9)


def test_without_a_reading_no_gap_is_learnt() -> None:
    """Links come and go, and the mean of half a gap over the modes stays."""
    observer = resolve_scenario(servo()).observer
    (setup,), q, half = observer.step.args, observer.params, Layout(1).slice_of("half")
    before = correct_modes(setup.drives[0], q.modes, q.start[0][0], ca.DM([0.0]))
    after = predict_modes(setup.drives[0], q.modes, before, ca.DM([1.0]))
    mean = sum(mode.chance * mode.belief.mean[half] for mode in after)
    assert float(after[1].chance) > 0.4
    assert float(mean) == pytest.approx(float(before.whole.mean[half]), rel=1e-9)


@pytest.mark.parametrize(("spread", "part"), [(0.0, 1.0), (0.5, 0.75), (1.0, 0.0), (2.0, 0.0)])
def test_a_half_gap_drifts_up_to_a_share_of_its_range(spread: float, part: float) -> None:
    """From a deviation so many times the largest one; what is more uncertain is left so."""
    gears = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))
    drive = build_drive(gears, 1e-3, 1)
    entries, half = drive.layout.entry_count, drive.layout.slice_of("half").start
    half_range, Q = 0.06, np.full(entries, 1e-9)
    variance = (spread * OPEN * half_range) ** 2
    cov = ca.SX.zeros(entries, entries)
    cov[half, half] = variance
    q = SimpleNamespace(
        model=gears.values,
        Q=Q,
        rest=np.zeros(2),
        least=np.zeros(2),
        most=np.full(entries, (OPEN * half_range) ** 2),
    )
    belief = Gaussian(ca.SX(ca.DM.zeros(entries)), cov)
    after = _move_mode(drive, q, (0, 0), Mode(ca.SX(1.0), belief), ca.DM.zeros(2)).belief.cov
    assert float(after[half, half]) == pytest.approx(variance + part * 1e-9, rel=1e-9, abs=1e-16)


def six_joints(**observer: Any) -> uz.Scenario:
    """A UR5 that stays where it is, behind gears."""
    start = [0.2, -1.2, 2.05, -1.4, -0.9, 0.1, *[0.0] * 6]
    arm = {"kind": "urdf", "path": str(EXAMPLES / "ur5.urdf"), "tip": "tool0"}
    gears = {"half": 0.02, "inertia": [1.5, 1.5, 0.6, 0.2, 0.2, 0.02], "friction": 0.1}
    return convert(
        tables_of("""
            sensor = { right = 0.0, left = 0.0, noise = 0.0005 }
            controller = { method = "computed_torque", bandwidth = 10.0 }
            simulation = { time = "sampled", step = 0.001, duration = 0.1, substeps = 2 }
            """)
        | {
            "plant": {"arm": {**arm, "gears": gears}, "x0": start},
            "reference": {
                "kind": "quintic",
                "points": [start[:6], [x + 0.1 for x in start[:6]]],
                "times": [0.0, 1.0],
            },
            "observer": {"method": "contact", "half": [0.0, 0.06], **observer},
        }
    )


def test_six_joints_are_filtered_joint_by_joint() -> None:
    """Readings follow the motors; a link is known by its claim at first, and held there."""
    import_package("adam")
    run = uz.simulate(six_joints(joints="separate", payload=[0.0, 1.0], starts=1))
    assert (np.abs(run.z - run.z_hat)[-1] < 0.06).all()
    assert (np.abs(run.d_hat[-1] - 0.02) < 4 * run.d_std[-1]).all()
    assert abs(run.theta_hat[-1, 0]) < 4 * run.theta_std[-1, 0]


def test_six_joints_at_once_are_refused_with_the_way_out() -> None:
    import_package("adam")
    with pytest.raises(uz.InputError, match=r'observer\.joints: 6 joints have 729.*"separate"'):
        uz.simulate(six_joints())


def test_without_gears_it_is_refused() -> None:
    tables = tomllib.loads(SERVO)
    del tables["plant"]["arm"]["gears"], tables["model"]
    tables["plant"]["x0"] = [-1.57, 0.0]
    with pytest.raises(uz.InputError, match=r"plant\.arm\.gears"):
        uz.simulate(convert(tables))


def test_exported_C_has_every_bit_and_fits_a_microcontroller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its self-test compares the bits with the reference's; step and flash are estimates."""
    monkeypatch.setattr(exporting, "STEPS", 200)  # of the comparison with double
    messages: list[str] = []
    three = servo(simulation={"duration": 0.01})
    report = exporting.export(three, out=tmp_path / "three", notify=messages.append).report
    assert messages[0].endswith(
        " to write, compile and compare; --method 'contact starts=1' takes less"
    )
    assert "Cortex-M4F (STM32F4)" in report["leaner"]["contact starts=1"]
    one = servo(simulation={"duration": 0.2}, observer={"starts": 1})
    done = uz.export(one, out=tmp_path / "fw")
    board = next(one for one in done.report["boards"] if "M4F" in one["board"])
    assert board["fits"]
    sources = [path.name for path in (tmp_path / "fw").glob("*.c")]
    options = ["-O0", "-std=c99", "-ffp-contract=off", "-fno-math-errno"]
    selftest = once.program(["selftest", *options, *sources], tmp_path / "fw")
    assert subprocess.run([selftest], capture_output=True).returncode == 0


def test_starts_that_found_other_gaps_widen_the_displayed_deviation() -> None:
    """By a tenth of their odds; a start that was wrong by far counts no more."""
    half, posteriors = Layout(1).slice_of("half").start, []
    for gap, std in ((0.02, 0.001), (0.03, 0.002)):
        mean, cov = ca.SX.zeros(11, 1), ca.SX.eye(11)
        mean[half], cov[half, half] = gap, std**2
        posteriors.append(Posterior((), (), Gaussian(mean, cov), mean, 0.0, 1.0))
    estimate = ca.SX.zeros(11, 1)
    estimate[half] = 0.02
    for log, share in ((0.0, 0.5), (-10.0, 1 / (1 + np.e)), (-60.0, 0.0025)):
        found = variance_of_starts(Layout(1), [(0,)], [posteriors], [ca.SX([0.0, log])], estimate)
        expected = (1 - share) * 0.001**2 + share * (0.002**2 + 0.01**2)
        assert float(found) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_gap_that_jumps_is_less_sure_by_its_jump(share: float) -> None:
    """A window may move it by 4 deviations of what it learnt and of its walk, not by more."""
    before, after, walk, window = 4e-6, 1e-6, 1e-8, 5
    lost = before - after + window * walk
    gap = 0.01 + share * JUMP * lost**0.5
    now = Jumps(*map(ca.DM, (0.0, 0.01, before, 0.0)))
    for k in range(2 * window):
        assert float(now.excess) == 0 or k >= window
        now = accumulate_jumps(now, ca.DM(gap), ca.DM(after), walk, window)
    expected = (share * JUMP) ** 2 * lost - lost if share > 1 else 0.0
    assert float(now.excess) == pytest.approx(expected)
    assert float(now.value) == pytest.approx(gap)
    assert float(now.variance) == after
    assert float(now.age) == 0


def test_a_jump_counts_for_each_gap_of_its_filter() -> None:
    """The third gap of an xArm was 5.8 deviations off when that of its first joint had jumped."""
    found = largest_of_groups(((0, 2), (1,)), ca.DM([4e-6, 1e-6, 0.0]))
    assert np.asarray(ca.evalf(found)).ravel() == pytest.approx([4e-6, 1e-6, 4e-6])


def test_a_filter_that_is_right_hardly_jumps() -> None:
    """Kalman's estimates of a constant from noise: 6 of 100,000 windows by chance."""
    rng, jumped = np.random.default_rng(4), 0
    for truth in rng.normal(0.0, 1.0, 40):
        value, variance = ca.DM(0.0), ca.DM(1.0)
        now = Jumps(ca.DM(0.0), value, variance, ca.DM(0.0))
        for reading in truth + 3 * rng.standard_normal(100):
            gain = variance / (variance + 9)
            value, variance = value + gain * (reading - value), variance * (1 - gain)
            now = accumulate_jumps(now, value, variance, 0.0, 10.0)
        jumped += float(now.excess) > 0
    assert jumped <= 1  # of 400 windows


def test_stiff_ends_are_those_of_the_model(tmp_path: Path) -> None:
    joint = mjcf.Joint("q", "gap 0.1 rad", 0.04, 0.06, 0.01, 0.0, 0.0, contact=(200.0, 0.5))
    soft = joint._replace(name="r", contact=None)
    [path] = mjcf.write_gears([joint, soft], tmp_path)
    found = [one.find("joint") for one in ElementTree.parse(path).findall(".//default[@class]")]
    ends = [one.get("solreflimit") for one in found if one is not None and one.get("limited")]
    assert ends[1] is None
    assert [float(word) for word in str(ends[0]).split()] == pytest.approx([-4e4, -200.0])


def test_options_become_ranges_and_deviations_of_a_uniform_law() -> None:
    """Half gaps of 0.01 to 0.05 about a centre of 0.003 +- 0.002: edges within three deviations."""
    tables = tomllib.loads(SERVO)
    tables["plant"]["arm"]["gears"]["centre"] = 0.003
    tables["observer"] |= {"half": [0.01, 0.05], "centre": 0.002}
    observer = resolve_scenario(convert(tables)).observer
    expected = [[0.007, 0.059], [0.001, 0.053]]
    np.testing.assert_allclose(observer.traits.ranges, expected, rtol=1e-12)
    start, layout = observer.params.start[0][0], Layout(1)
    assert layout.slice_of("payload").stop == layout.entry_count  # so its variance comes last
    np.testing.assert_allclose([cov[-1] for cov in start.covs], 0.5**2 / 12, rtol=1e-12)


def test_a_gap_is_reported_with_its_deviation(run: uz.Run) -> None:
    [[gap, _]] = final_width_rows(run)
    assert run.width_std is not None
    assert gap.std == run.width_std[-1, 0] > 0
    assert gap.value == pytest.approx(float(run.d_hat[-1].sum()))
