"""Arms whose motors move their links through gears with a gap: physics, runs, refusals."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from benchmarks.gears.contact_urdf_arms import Outcome, line

import undeadzone as uz
from commands import undeadzone
from requirements import import_package
from scenes import tables_of
from undeadzone.analysis.identifiability.linear import WidthIdentifiability
from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate
from undeadzone.numerics.runge_kutta import rk4_change
from undeadzone.plants.robots.arm import build_arm
from undeadzone.plants.robots.build import build_one_link, build_two_link
from undeadzone.plants.robots.geared import Geared, Gears, build_geared_arm, largest_couplings
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.simulation.collect import WIDENED, withdraw_vague_gaps, withhold_gaps
from undeadzone.util.arrays import Floats

GEARS: dict[str, Any] = {"half": [0.05, 0.06], "inertia": [0.08, 0.03]}
FRICTION = {"friction": [0.3, 0.1], "viscous": [0.4, 0.2]}
EIGHT = {
    "kind": "figure_eight",
    "centre": [0.2351, -0.4853],
    "width": 0.3,
    "height": 0.2,
    "period": 4.0,
}
SWING = {"points": [[-0.9, 0.6], [-2.2, -0.9], [-0.9, 0.6]], "times": [0.7, 1.6, 2.5], "until": 3.0}
MJCF = """
<mujoco>
  <compiler angle="radian" autolimits="false"/>
  <option timestep="{dt}" gravity="0 -9.81 0" integrator="implicitfast" tolerance="1e-10"/>
  <worldbody>
    <body>
      <inertial pos=".2 0 0" mass="3" diaginertia="1e-4 .04 .04"/>
      <joint axis="0 0 1" armature=".08" damping=".4"/>
      <joint axis="0 0 1" limited="true" range="-.05 .05" solreflimit="-160000 -560"/>
      <body pos=".4 0 0">
        <inertial pos=".15 0 0" mass="2" diaginertia="1e-4 .015 .015"/>
        <joint axis="0 0 1" armature=".03" damping=".2"/>
        <joint axis="0 0 1" limited="true" range="-.06 .06" solreflimit="-160000 -560"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def geared(**changes: Any) -> Geared:
    return build_geared_arm(build_two_link(), Gears(**GEARS, viscous=[0.4, 0.2]), changes=changes)


def stepper(plant: Geared, h: float) -> ca.Function:
    """x+ of x, u after a Runge-Kutta step."""
    n = 4 * plant.joint_count
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", plant.joint_count)
    change = rk4_change(lambda x, _: plant.motion(plant.values, x, u)[0], x, h)
    return ca.Function("step", [x, u], [x + change], {"cse": True})


def along(plant: Geared, x0: Floats, u: Floats, h: float) -> Floats:
    """States along inputs (N x n), the start first."""
    following = stepper(plant, h).mapaccum(len(u))(x0, u.T)
    return np.vstack([x0, np.asarray(following).T])


def scenario(**changes: Any) -> uz.Scenario:
    """The two-link arm with gears on its figure of eight, its state known."""
    tables: dict[str, Any] = tables_of("""
        sensor = { right = 0.0, left = 0.0, noise = 0.001 }
        observer = { method = "full_state" }
        controller = { method = "computed_torque", bandwidth = 14.0 }
        simulation = { time = "sampled", duration = 5.0, step = 0.001, substeps = 4 }
        """) | {
        "plant": {
            "arm": {"kind": "two_link", "torque_max": [60.0, 25.0], "gears": GEARS | FRICTION},
            "x0": [-1.7, 1.4, 0.0, 0.0],
            "parameters": {"payload": 0.5},
        },
        "reference": EIGHT,
    }
    return convert(tables | changes)


@pytest.fixture(scope="module")
def known() -> uz.Run:
    return uz.simulate(scenario())


# --- Physics


def test_in_the_gap_motors_and_links_move_as_in_mujoco() -> None:
    mujoco = import_package("mujoco")
    plant, rng = geared(), np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(MJCF.format(dt=1e-4))
    data = mujoco.MjData(model)
    move = stepper(plant, 1e-6)
    for _ in range(20):
        motor, v, u = rng.uniform(-3, 3, 2), rng.normal(size=4), rng.normal(size=2) * 10
        gap = rng.uniform(-0.8, 0.8, 2) * [0.05, 0.06]
        data.qpos[0::2], data.qpos[1::2] = motor, gap
        data.qvel[0::2], data.qvel[1::2] = v[:2], v[2:] - v[:2]
        data.qfrc_applied[0::2] = u
        mujoco.mj_forward(model, data)
        motors, links = data.qacc[0::2], data.qacc[0::2] + data.qacc[1::2]
        x = np.concatenate([motor, motor + gap, v])
        found = (np.asarray(move(x, u)).ravel() - x)[4:] / 1e-6
        np.testing.assert_allclose(found, [*motors, *links], rtol=1e-3, atol=1e-3)


def test_across_the_gap_links_move_as_in_mujoco() -> None:
    """Through the same contact frequency and damping, in an engine with contacts of its own."""
    mujoco = import_package("mujoco")
    h, N = 1e-4, 8000
    t = np.arange(N) * h
    u = np.stack([6 * np.sin(9 * t), 1.5 * np.sin(13 * t)], axis=1)
    model = mujoco.MjModel.from_xml_string(MJCF.format(dt=h))
    data = mujoco.MjData(model)
    x0 = np.array([-np.pi / 2, 0.0, -np.pi / 2 + 0.02, 0.01, 0, 0, 0, 0])
    data.qpos[0::2], data.qpos[1::2] = x0[:2], x0[2:4] - x0[:2]
    links = np.empty((N, 2))
    for k in range(N):
        data.qfrc_applied[0::2] = u[k]
        mujoco.mj_step(model, data)
        links[k] = data.qpos[0::2] + data.qpos[1::2]
    x = along(geared(), x0, u, h)[1:]
    crossings = np.abs(np.diff(np.sign(x[:, :2] - x[:, 2:4]), axis=0)).sum(axis=0) / 2
    assert (crossings >= 2).all()
    assert np.abs(x[:, 2:4] - links).max() < 0.05 * np.ptp(links, axis=0).min()


def test_without_gap_and_with_stiff_contact_it_is_the_rigid_arm() -> None:
    """One link whose inertia has grown by the motor's."""
    h, u = 1e-4, 3 * np.sin(np.arange(6000) * 1e-3)[:, None]
    stiff = build_geared_arm(build_one_link(), Gears(half=0.0, inertia=0.05, contact=2000.0))
    x = along(stiff, np.zeros(4), u, h)
    body = build_arm(
        build_one_link()._replace(parameters=build_one_link().parameters | {"I": 0.025 + 0.05})
    )
    y, s = ca.SX.sym("y", 2), ca.SX.sym("s")
    values = body.values
    a = (s - body.bias(values, y[0], y[1])) / body.mass(values, y[0])
    rate = ca.Function("rate", [y, s], [ca.vertcat(y[1], a)])
    change = rk4_change(lambda y, _: rate(y, s), y, h)
    rigid = ca.Function("rigid", [y, s], [y + change]).mapaccum(len(u))(np.zeros(2), u.T)
    assert np.abs(x[1:, 1] - np.asarray(rigid)[0]).max() < 1e-4


@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_energy_does_not_grow_without_friction_and_torque(damping: float) -> None:
    plant = build_geared_arm(build_one_link(), Gears(half=0.04, inertia=0.05, damping=damping))
    x = along(plant, np.array([0.3, 0.3, 0.0, 0.0]), np.zeros((40_000, 1)), 5e-5)
    numbers = dict(zip(plant.names, plant.values, strict=True))
    K = plant.stiffness[0] * numbers["contact1"] ** 2
    xi = x[:, 0] - x[:, 1]
    pressed = np.maximum(np.abs(xi) - 0.04, 0.0)
    inertia = numbers["I"] + numbers["m"] * numbers["c"] ** 2
    energy = 0.5 * (0.05 * x[:, 2] ** 2 + inertia * x[:, 3] ** 2 + K * pressed**2)
    energy += numbers["m"] * numbers["g"] * numbers["c"] * np.sin(x[:, 1])
    swing = np.ptp(energy - 0.5 * K * pressed**2)
    assert (pressed > 0).any()
    assert (pressed == 0).any()
    if damping:
        assert np.diff(energy).max() < 1e-4 * np.ptp(energy)
        assert energy[-1] < energy[0]
    else:
        assert np.ptp(energy) < 1e-3 * swing


def test_a_locked_flank_is_the_true_law_while_it_touches() -> None:
    plant, rng = geared(centre1=0.01), np.random.default_rng(1)
    for _ in range(20):
        x = rng.normal(size=8)
        xi = x[:2] - x[2:4] + [0.01, 0.0]
        flank = np.sign(xi) * (np.abs(xi) > [0.05, 0.06])
        np.testing.assert_allclose(
            np.asarray(plant.gear_torque(plant.values, x, flank)).ravel(),
            np.asarray(plant.gear_torque(plant.values, x)).ravel(),
            rtol=1e-12,
        )
    free = np.asarray(plant.gear_torque(plant.values, rng.normal(size=8), np.zeros(2)))
    assert not free.any()


# --- Runs


def test_motors_led_across_their_gaps_keep_the_tip_on_its_path(known: uz.Run) -> None:
    ignoring = scenario(model={"parameters": {"payload": 0.5, "half1": 0.0, "half2": 0.0}})
    assert known.rms_tip is not None
    assert known.rms_tip < 1.5e-3
    blind = uz.simulate(ignoring)
    assert blind.rms_tip is not None
    assert blind.rms_tip > 0.02
    np.testing.assert_allclose(known.widths, [[0.05, 0.05], [0.06, 0.06]])
    assert known.info.sensor == "gears"
    q, theta = known.z, known.y
    assert np.abs(q - theta).max() > 0.05  # encoders at motors do not see the links
    assert np.abs(q - theta).max() < 0.08


def test_a_link_that_needs_no_torque_is_brought_back_to_its_path() -> None:
    """It floats in its gap, 20 mrad off: no torque is planned that would choose a flank for it."""
    gears = {"half": 0.03, "inertia": 0.012}
    tables: dict[str, Any] = tables_of("""
        reference = { kind = "quintic", points = [[0.0], [0.0]], times = [0.0, 1.5] }
        simulation = { time = "sampled", duration = 1.5, step = 0.001, substeps = 4 }
        """) | {
        "plant": {
            "arm": {"kind": "one_link", "torque_max": 3.0, "gears": gears},
            "x0": [0.02, 0.0],
            "parameters": {"m": 0.35, "l": 0.25, "c": 0.125, "I": 0.0018, "g": 0.0, "b1": 0.01},
        }
    }
    run = uz.simulate(scenario(**tables))
    assert run.z[0, 0] == pytest.approx(0.02, abs=1e-3)
    assert np.abs(run.z[-300:]).max() < 0.006


def test_readme_path_holds_the_second_joint_on_one_flank(known: uz.Run) -> None:
    first, second = known.info.identifiable
    assert first["width"]
    assert not second["width"]
    (reason,) = second["reasons"]
    assert reason.startswith("held on one flank: its gap cannot be known. Swing it through ")
    place = float(reason.partition("through ")[2].split()[0])
    mean = known.x[:, 2].mean()
    assert np.cos(mean + place) == pytest.approx(0.0, abs=0.02)  # where the link hangs


def shaken(friction: float, measured: str, noise: float, turns: int) -> uz.Scenario:
    """A light link that nothing presses but its inertia, to and fro."""
    gears = {"half": 0.03, "inertia": 0.012, "friction": friction, "measured": measured}
    weightless = {"m": 0.35, "l": 0.25, "c": 0.125, "I": 0.0018, "g": 0.0}
    times = np.linspace(0.0, 1.6 * turns, 2 * turns + 1).tolist()
    return scenario(
        plant={
            "arm": {"kind": "one_link", "torque_max": 3.0, "gears": gears},
            "x0": [0.0, 0.0],
            "parameters": weightless,
        },
        reference={"kind": "quintic", "points": [[0.0], *[[0.5], [0.0]] * turns], "times": times},
        sensor={"right": 0.0, "left": 0.0, "noise": noise},
        simulation={"time": "sampled", "duration": times[-1], "step": 1e-3, "substeps": 4},
    )


def test_many_hidden_strikes_narrow_a_gap() -> None:
    """The filter's own belief of it is withheld."""
    observer = {"method": "contact", "half": [0.0, 0.05], "starts": 1}
    run = uz.simulate(shaken(1.5, "motor", 3e-4, 6).replace("observer", observer))
    (verdict,) = run.info.identifiable
    assert verdict["crossings"] == 0
    assert verdict["narrowed"]
    numbers = run.summary()
    assert numbers["gap_low"] < 0.06 < numbers["gap_high"]
    assert numbers["gap_high"] - numbers["gap_low"] < 0.08


@pytest.mark.parametrize(
    ("friction", "measured", "noise", "known"),
    [
        (0.05, "motor", 1e-4, True),
        (0.05, "motor", 4e-3, False),
        (1.0, "motor", 1e-4, False),
        (1.0, "link", 1e-4, True),
    ],
)
def test_a_strike_that_noise_and_unknown_torque_hide_shows_no_gap(
    friction: float, measured: str, noise: float, known: bool
) -> None:
    run = uz.simulate(shaken(friction, measured, noise, 1))
    (verdict,) = run.info.identifiable
    assert verdict["width"] == known
    if not known:
        (reason,) = verdict["reasons"]
        assert "a strike changes the speed of its motor by" in reason
        assert "noise and unknown torque hide" in reason
    else:
        assert verdict["crossings"] > 0


def test_after_a_swing_both_gaps_can_be_known() -> None:
    swung = uz.simulate(scenario(reference=EIGHT | {"swing": SWING}))
    assert swung.fully_identifiable
    assert swung.rms_tip is not None
    assert swung.rms_tip < 2e-3
    np.testing.assert_allclose(swung.tip_r[3000], [0.2351, -0.4853], atol=1e-6)


def test_both_encoders_read_links_then_motors() -> None:
    both = scenario(
        plant={"arm": {"kind": "one_link", "gears": {"half": 0.03, "inertia": 0.05}}},
        reference={"kind": "sine", "amplitude": 0.5, "frequency": 0.5, "offset": -1.57},
        simulation={"time": "sampled", "duration": 1.0, "step": 1e-3, "substeps": 4},
    ).replace("plant.arm.gears.measured", "both")
    run = uz.simulate(both)
    assert run.outputs == ["q1", "motor of q1"]
    np.testing.assert_allclose(run.z, run.x[:, [1, 0]])
    assert run.info.tracked == [0]
    np.testing.assert_allclose(run.widths, [[0.03, 0.03], [0.0, 0.0]])


def test_what_an_ensemble_draws_is_the_true_width(tmp_path: Path) -> None:
    several = scenario(
        ensemble={"runs": 4, "plant.parameters.half1": {"uniform": [0.02, 0.08]}},
        simulation={"time": "sampled", "duration": 0.05, "step": 1e-3, "substeps": 4},
    )
    found = uz.run_ensemble(several)
    drawn = found.column("plant.parameters.half1")
    np.testing.assert_allclose(found.column("d_right_error[0]"), 0.05 - drawn, atol=1e-12)


def test_a_file_runs_and_its_numbers_are_json(tmp_path: Path) -> None:
    short = scenario().replace("simulation.duration", 1.0)
    short.save(tmp_path / "gears.toml")
    done = undeadzone("run", tmp_path / "gears.toml", "--json", "--out", tmp_path / "out")
    numbers = json.loads(done.stdout)
    assert numbers["d_right"] == [0.05, 0.06]
    assert len(numbers["identifiable"]) == 2
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "held on one flank" in page


# --- Joints about nearly one axis

COAXIAL = tables_of("""
sensor = { right = 0.0, left = 0.0, noise = 0.001 }
reference.kind = "quintic"
reference.points = [[0.0, 0.0], [0.3, 0.3], [-0.3, -0.3], [0.0, 0.0]]
reference.times = [0.0, 1.0, 3.0, 4.0]
reference.repeat = true
observer = { method = "contact", joints = "separate", half = [0.0, 0.03] }
simulation = { time = "sampled", duration = 1.5, step = 0.001, substeps = 9 }
""") | {
    "plant": {
        "arm": {
            "kind": "two_link",
            "gears": {"half": 0.01, "inertia": [1.455, 1.418], "friction": 1.74},
        },
        "x0": [0.0] * 4,
        "parameters": {
            **{"m1": 1.0, "m2": 1.0, "l1": 1e-4, "c1": 1e-4, "c2": 1e-4, "g": 0.0},
            **{"I1": 0.037, "I2": 1.4176},
        },
    }
}


def test_joints_about_one_axis_are_coupled_by_what_lies_between_them() -> None:
    """A body of 0.037 kg m^2 between two links: m_ii times the inverse's entry, by hand."""
    arm = resolve_scenario(scenario(**COAXIAL)).plant
    assert arm.gears is not None
    links, still = arm.gears.link_params(arm.params), np.zeros((1, 2))
    first, second = largest_couplings(arm.gears.arm, links, still, [(0,), (1,)])
    assert (first.partner, second.partner) == (1, 0)
    assert first.ratio == pytest.approx(second.ratio)
    assert first.ratio == pytest.approx((0.037 + 1.4176) / 0.037, rel=1e-3)
    (both, _) = largest_couplings(arm.gears.arm, links, still, [(0, 1)])
    assert both.ratio == 1.0


def test_coupled_joints_share_a_filter_unless_they_are_separated() -> None:
    """Of a two-link arm whose joints hardly know of each other each has its own."""
    observer = COAXIAL["observer"]
    assert isinstance(observer, dict)
    apart = scenario(**COAXIAL | {"observer": {**observer, "groups": []}})
    usual = scenario(observer=observer)
    groups = [
        resolve_scenario(each).observer.traits.groups for each in (scenario(**COAXIAL), apart)
    ]
    assert groups == [((0, 1),), ((0,), (1,))]
    assert resolve_scenario(usual).observer.traits.groups == ((0,), (1,))


def test_joint_by_joint_a_coupled_gap_is_as_it_was_declared() -> None:
    """The filter stays finite, its belief is narrow and false, and none of it is shown."""
    observer = COAXIAL["observer"]
    assert isinstance(observer, dict)
    run = uz.simulate(scenario(**COAXIAL | {"observer": {**observer, "groups": [], "starts": 1}}))
    assert run.width_std is not None
    assert run.x_std is not None
    assert np.isfinite(run.x_hat).all()
    for verdict in run.info.identifiable:
        assert not verdict["width"]
        (reason,) = verdict["reasons"]
        assert "(coupling 39.3): joint by joint its gap cannot be known" in reason
    low, high = (np.array(run.summary()[name]) for name in ("gap_low", "gap_high"))
    np.testing.assert_allclose(low, 0.0)
    np.testing.assert_allclose(high, 0.06)
    assert str(run).count("[0, 0.06] as declared") == 2
    assert np.ptp(run.width_std, axis=0).max() == 0.0
    assert (run.x_std[:, 2:4] >= 0.03 / np.sqrt(3)).all()


def test_springs_hold_a_link_and_share_the_twist_of_its_gears() -> None:
    """At rest the motor's torque holds gravity and spring, with k and K in series."""
    numbers = {"pull": 0.2, "spring": 3.0, "hardening": 4.0, "spring_at": 0.1, "drag": 0.5}
    firm = {"half": 0.02, "inertia": 0.05, "friction": 0.3}
    bent = Gears(**firm, **numbers, stiffness=700.0, asymmetry=0.1)
    gears = build_geared_arm(build_one_link(), bent)
    q, turned = 0.6, 0.5
    theta = float(gears.motors_at_rest(gears.values, ca.DM(q)))
    x = ca.DM([theta, q, 0.0, 0.0])
    weight = float(gears.arm.bias(gears.link_params(gears.values), q, 0.0))
    load = weight + 0.2 + 3.0 * turned + 4.0 * turned**3
    rate, tau = gears.motion(gears.values, x, load)
    assert np.asarray(rate).ravel() == pytest.approx(0.0, abs=1e-9)
    assert float(tau) == pytest.approx(load)
    rigid = build_geared_arm(build_one_link(), Gears(**firm))
    [K] = rigid.contact_stiffness(rigid.values)[0]
    assert theta - q == pytest.approx(0.02 + load * (1 / 700 + 1 / K))
    crossing = gears.motion(gears.values, ca.DM([q, q, 0.7, 0.2]), 0.0)[1]
    assert float(crossing) == pytest.approx(0.5 * 0.5)
    for speed, rubbing in ((100.0, 0.4), (-100.0, -0.2)):
        assert gears.motor_friction_torque(gears.values, speed) == pytest.approx(rubbing, abs=1e-6)


# --- Refusals


def test_online_refuses_what_does_not_know_gears() -> None:
    with pytest.raises(InputError, match="takes motors for links"):
        uz.Online(uz.Kalman(right=0.1), scenario().plant, scenario().sensor, 1e-3)


def test_a_row_of_the_robots_bench_counts_known_gaps_alone() -> None:
    """A field that was renamed left the bench without a single row after 40 minutes."""
    yes, no = np.array([True, False]), np.array([False, True])
    off = np.array([7.0, 0.2])
    runs = [
        Outcome(False, yes, yes & no, yes, yes, np.array([0.5, 9.0]), yes, 1.5, 0.8),
        Outcome(False, yes & no, no, yes | no, no, off, ~yes, 3.0, math.nan),
        Outcome(True, ~yes, no, no, no, 2 * off, no, 99.0, 99.0),
    ]
    cells = [cell.strip() for cell in line("leg", runs).strip("| ").split("|")]
    assert cells[:4] == ["leg", "3 (1)", "1, 1, 0, 1, 1 of 4", "0"]
    assert cells[4:6] == ["0.5; 0", "1.00, 1.00, 0.50"]
    assert cells[6:] == ["2.2 (3.0)", "0.8 (0.8)"]


@pytest.mark.parametrize(
    ("std", "known", "found"),
    [(0.0034, True, 0.02), (0.0035, False, 0.02), (0.0035, False, 0.029), (0.015, False, 0.02)],
)
def test_a_gap_that_strikes_left_uncertain_is_narrowed(
    std: float, known: bool, found: float
) -> None:
    """Half of it is declared as [0, 0.03]: a deviation of the whole gap of 0.0173.

    A belief at the end of that range contradicts it.
    """
    traits = SimpleNamespace(halves=np.array([[0.0, 0.03], [0.0, 0.0]]))
    problem: Any = SimpleNamespace(
        plant=SimpleNamespace(gears=SimpleNamespace(joint_count=1)),
        observer=SimpleNamespace(traits=traits),
    )
    half = np.array([[0.015, 0.0], [found, 0.0]])
    deviation = np.array([[0.0173, 0.0], [std, 0.0]])
    signals = {"right": half, "left": half, "right_std": deviation, "left_std": deviation}
    signals |= {"width_std": deviation, "x_std": np.zeros((2, 4))}
    estimate = Estimate(*[deviation] * 6)._replace(**signals)
    yes = WidthIdentifiability(True, True, True, True, (), crossings=4)
    gap, encoder = withdraw_vague_gaps(problem, [yes, yes], estimate)
    assert gap.width == known
    assert known or f"uncertain by {std:.2g}, of 0.017 as it was declared" in gap.reasons[0]
    assert gap.narrowed == ((std, found) == (0.0035, 0.02))
    shown = withhold_gaps(problem, [gap, encoder], estimate)
    wide = WIDENED * std if gap.narrowed else 0.0173
    assert shown.width_std[-1, 0] == pytest.approx(std if known else wide)
    assert shown.right[-1, 0] == (found if known or gap.narrowed else 0.015)
    assert (shown.x_std[-1, 1] > 0) == (not known)
    assert gap.crossings == 4
    assert encoder == gap
