"""`undeadzone arm`: what a URDF file says of an arm, and a scenario to start from."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import undeadzone as uz
from commands import undeadzone
from documents import EXAMPLES
from requirements import import_package
from undeadzone.plants.robots.geared import fastest_contact
from undeadzone.plants.robots.survey import survey_urdf
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import parse
from undeadzone.scenario.urdf_start import starting_scenario

import_package("adam")

UR5 = EXAMPLES / "ur5.urdf"
LINK = """<link name="{name}"><inertial><origin xyz="0 0 -0.2"/><mass value="{mass}"/>
  <inertia ixx="0.03" iyy="0.03" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="0 0 {down}"/><axis xyz="{axis}"/>{rest}</joint>"""
LIMIT = '<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>'


def joint(
    name: str, parent: str, child: str, down: float = -0.4, kind: str = "revolute", **limit: float
) -> str:
    """A joint about y, or along x where it slides."""
    wide = {"low": -3.0, "high": 3.0, "effort": 60.0, "velocity": 5.0}
    axis = "1 0 0" if kind == "prismatic" else "0 1 0"
    rest = "" if kind == "fixed" else LIMIT.format(**wide | limit)
    return JOINT.format(
        name=name, kind=kind, parent=parent, child=child, down=down, axis=axis, rest=rest
    )


def written(folder: Path, *parts: str, links: str = "upper lower") -> Path:
    """A URDF file: base, links of 2 kg, a tip without mass."""
    bodies = [LINK.format(name=name, mass=2.0) for name in links.split()]
    ends = '<link name="base"/>\n<link name="tip"/>'
    path = folder / "two.urdf"
    path.write_text("\n".join(['<robot name="two">', ends, *bodies, *parts, "</robot>"]))
    return path


def two(folder: Path, **limit: float) -> Path:
    """Two links that hang: 0.4 m and 0.3 m."""
    return written(
        folder,
        joint("shoulder", "base", "upper", 0.0, **limit),
        joint("elbow", "upper", "lower"),
        joint("hand", "lower", "tip", -0.3, "fixed"),
    )


def test_an_arm_that_is_known_by_hand(tmp_path: Path) -> None:
    found = survey_urdf(two(tmp_path), at=[np.pi / 2, 0.0])
    assert (found.base, found.tip, found.fixed) == ("base", "tip", [])
    np.testing.assert_allclose(np.abs(found.place), [0.7, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.reach, 0.7, rtol=1e-9)
    np.testing.assert_allclose(found.masses, 2.0)
    lever = 9.81 * np.array([2 * 0.2 + 2 * 0.6, 2 * 0.2])
    np.testing.assert_allclose(np.abs(found.holding), lever, rtol=1e-9)


def test_limits_shorten_the_reach_and_move_the_posture(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        joint("shoulder", "base", "upper", 0.0),
        joint("elbow", "upper", "lower", low=1.0, high=2.0),
        joint("hand", "lower", "tip", -0.3, "fixed"),
    )
    found = survey_urdf(file)
    np.testing.assert_allclose(found.q, [0.0, 1.5])
    expected = np.sqrt(0.4**2 + 0.3**2 + 2 * 0.4 * 0.3 * np.cos(1.0))
    np.testing.assert_allclose(found.reach, expected, rtol=1e-7)


def test_a_sliding_joint_without_limits_has_no_reach(tmp_path: Path) -> None:
    file = two(tmp_path)
    slide = joint("elbow", "upper", "lower", kind="prismatic")
    text = file.read_text().replace(joint("elbow", "upper", "lower"), slide)
    file.write_text(text)
    assert survey_urdf(file).reach == pytest.approx(np.hypot(0.7, 3.0))
    bare = slide.replace(LIMIT.format(low=-3.0, high=3.0, effort=60.0, velocity=5.0), "")
    file.write_text(text.replace(slide, bare))
    assert survey_urdf(file).reach is None
    done = undeadzone("arm", file)
    assert done.returncode == 0, done.stderr
    assert "no limit: a sliding joint has none" in done.stdout
    (row,) = [line for line in done.stdout.split("\n") if "slides" in line]
    assert row.split().count("none") == 4


def test_the_command_shows_what_the_file_says() -> None:
    done = undeadzone("arm", UR5)
    assert done.returncode == 0, done.stderr
    assert "6 joints move, from base_link to tool0" in done.stdout
    assert "(0.8173, 0.1915, -0.005491) m" in done.stdout
    assert "friction (plant.parameters b1, f1, ...)" in done.stdout
    numbers = json.loads(undeadzone("arm", UR5, "--json", "--at", "0,-1.57,0,0,0,0").stdout)
    assert numbers["at"] == [0, -1.57, 0, 0, 0, 0]
    assert [each["effort"] for each in numbers["joints"]] == [150, 150, 150, 28, 28, 28]
    assert 0.9 < numbers["reach"] < 1.0
    fewer = json.loads(undeadzone("arm", UR5, "--json", "--joints", "elbow_joint").stdout)
    assert len(fewer["joints"]) == 1
    assert len(fewer["fixed"]) == 5


def test_a_started_scenario_runs_and_beats_blindness(tmp_path: Path) -> None:
    done = undeadzone("arm", two(tmp_path), "--out", "mine", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "next: undeadzone run mine/two.toml" in done.stdout
    again = undeadzone("arm", "two.urdf", "--out", "mine", cwd=tmp_path)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    own, blind = uz.compare(uz.read(tmp_path / "mine" / "two.toml"))
    assert own.fully_identifiable
    assert own.divergence_time is None
    assert own.rms_tip is not None
    assert blind.rms_tip is not None
    assert own.rms_tip < blind.rms_tip / 3


def test_a_started_scenario_of_one_joint_is_consistent() -> None:
    """With one level of its default disturbance the filter erred by .0056 rad and blamed a lag."""
    text = starting_scenario(survey_urdf(UR5, joints=["elbow_joint"], at=[1.57]), str(UR5))
    run = uz.simulate(parse(text))
    assert "NOT as told" not in str(run)
    assert run.rms_estimation < 0.002


def test_a_started_scenario_of_a_light_arm_is_consistent(tmp_path: Path) -> None:
    """Three levels of the default disturbance erred by .008 rad and blamed the sensor's slope."""
    hand = joint("hand", "upper", "tip", -0.4, "fixed")
    file = written(tmp_path, joint("shoulder", "base", "upper", 0.0), hand, links="upper")
    file.write_text(file.read_text().replace("0 0 -0.2", "0.29 0 0").replace("0.03", "0.07"))
    text = starting_scenario(survey_urdf(file), str(file))
    run = uz.simulate(parse(text))
    assert "NOT as told" not in str(run)
    assert run.rms_estimation < 0.002


@pytest.mark.parametrize("gears", [[], ["--gears"]])
def test_a_joint_at_its_limit_starts_no_scenario(tmp_path: Path, gears: list[str]) -> None:
    """It was written with a range of no width, which `run` refused."""
    done = undeadzone("arm", two(tmp_path), "--at", "0,3", *gears, "--out", tmp_path)
    assert done.returncode == 2
    assert "at: elbow stands at its limit 3 and cannot swing" in done.stderr
    assert not (tmp_path / "two.toml").exists()


def test_the_reach_of_an_arm_on_a_slide_counts_the_slide(tmp_path: Path) -> None:
    """It was counted from where the slide stands."""
    rail = joint("shoulder", "base", "upper", 0.0, kind="prismatic", low=0.0, high=0.5)
    hand = joint("hand", "lower", "tip", -0.3, "fixed")
    file = written(tmp_path, rail, joint("elbow", "upper", "lower"), hand)
    assert survey_urdf(file).reach == pytest.approx(max_reach(0.5))


def max_reach(slide: float) -> float:
    """Of two links of .4 m and .3 m, the second of which turns, on a slide across the first [m]."""
    turns = np.linspace(-3.0, 3.0, 600_001)
    return float(np.hypot(slide + 0.3 * np.sin(turns), 0.4 + 0.3 * np.cos(turns)).max())


def test_with_gears_a_started_scenario_follows_its_path(tmp_path: Path) -> None:
    done = undeadzone("arm", two(tmp_path), "--at", "0.3,-0.5", "--gears", "--out", tmp_path)
    assert "two.toml" in done.stdout
    scenario = uz.read(tmp_path / "two.toml").replace("simulation.duration", 2.0)
    assert scenario.units.state == ["rad"] * 4 + ["rad/s"] * 4
    assert isinstance(scenario.observer, uz.observers.Contact)
    run = uz.simulate(scenario.replace("observer", {"method": "full_state"}))
    assert run.info.sensor == "gears"
    assert run.rms_tip is not None
    assert run.rms_tip < 2e-3


def test_friction_stops_a_guessed_motor_in_a_second_or_more(tmp_path: Path) -> None:
    """The last link of a UR5 is lighter than any such motor, that of the shoulder heavier."""
    assert undeadzone("arm", UR5, "--gears", "--out", tmp_path).returncode == 0
    arm = uz.read(tmp_path / "ur5.toml").plant.arm
    assert isinstance(arm, uz.plants.URDF)
    assert arm.gears is not None
    speeds = np.array([joint.velocity for joint in survey_urdf(UR5).joints])
    coasting = np.asarray(arm.gears.inertia) * speeds / np.asarray(arm.gears.friction)
    assert (coasting > 0.999).all()
    assert coasting[0] > 1.5
    assert coasting[-1] == pytest.approx(1.0, rel=1e-3)


def test_a_large_arm_with_gears_starts_with_a_filter_that_runs() -> None:
    scenario = parse(starting_scenario(survey_urdf(UR5), str(UR5), gears=True))
    assert isinstance(scenario.observer, uz.observers.Contact)
    assert scenario.observer.joints == "separate"
    run = uz.simulate(scenario.replace("simulation.duration", 0.05))
    assert run.d_std is not None
    assert np.isfinite(run.z_hat).all()
    assert "gap [rad]" in str(run)


def alternatives(text: str) -> list[str]:
    """The text with each of the keys that stand in remarks, one by one, and with those of a table.

    A remark's key replaces the one of its table that is there.
    """
    model = text.replace("# [model.parameters] ", "[model.parameters]", 1)
    texts = [model.replace("# payload = 0.0", "payload = 0.0", 1)]
    for line in re.findall(r"^# \w+ = .*$", text, flags=re.M):
        if not line.startswith("# payload = 0.0"):
            texts.append(text.replace(line, line.removeprefix("# "), 1))
    return texts


@pytest.mark.parametrize("gears", [True, False])
@pytest.mark.parametrize("file", ["two", "ur5"])
def test_every_alternative_that_stands_in_a_remark_runs(
    tmp_path: Path, gears: bool, file: str
) -> None:
    path = UR5 if file == "ur5" else two(tmp_path)
    texts = alternatives(starting_scenario(survey_urdf(path), str(path), gears=gears))
    assert len(texts) == (5 if gears else 3)
    for text in texts:
        problem = resolve_scenario(parse(text))
        assert problem.plant.n == (4 if gears else 2) * len(survey_urdf(path).joints)
    if gears and file == "two":
        for text in texts[-2:]:  # those of the filter
            run = uz.simulate(parse(text).replace("simulation.duration", 0.05))
            assert np.isfinite(run.z_hat).all()


def test_the_step_of_an_arm_with_gears_follows_from_its_fastest_contact() -> None:
    """Two axes that coincide at first have a light body between them."""
    found = survey_urdf(UR5)
    scenario = parse(starting_scenario(found, str(UR5), gears=True))
    problem = resolve_scenario(scenario)
    gears = problem.plant.gears
    assert gears is not None
    fastest = fastest_contact(gears, gears.values, found.q[None])
    poles = np.abs(np.linalg.eigvals(problem.plant.continuous.A)).max()
    assert fastest == pytest.approx(poles, rel=0.02)
    assert fastest * scenario.simulation.step <= 2.0 * scenario.simulation.substeps


def test_an_upright_lift_is_drawn(tmp_path: Path) -> None:
    """Seen from above it is a point, and the page's grid had no spacing."""
    rail = joint("shoulder", "base", "upper", 0.0, kind="prismatic").replace("1 0 0", "0 0 1")
    hand = joint("hand", "upper", "tip", 0.0, "fixed")
    text = starting_scenario(survey_urdf(written(tmp_path, rail, hand, links="upper")), "two.urdf")
    (tmp_path / "lift.toml").write_text(text.replace("duration = 8.0", "duration = 1.0"))
    done = undeadzone("run", "lift.toml", "--out", "seen", cwd=tmp_path)
    assert "report.html" in done.stdout, done.stderr


def test_weak_motors_are_named(tmp_path: Path) -> None:
    file = two(tmp_path, effort=10.0)
    done = undeadzone("arm", file, "--at", "1.57,0")
    assert done.returncode == 1
    assert "NO: the motors of shoulder cannot hold the arm there" in done.stdout
    assert undeadzone("arm", file).returncode == 0  # it hangs


def test_a_gripper_stays_at_0_and_two_arms_are_refused(tmp_path: Path) -> None:
    gripper = written(
        tmp_path,
        joint("shoulder", "base", "upper", 0.0),
        joint("mount", "upper", "palm", kind="fixed"),
        joint("left_finger", "palm", "left", kind="prismatic", low=0.0, high=0.04),
        joint("right_finger", "palm", "right", kind="prismatic", low=0.0, high=0.04),
        joint("hand", "palm", "tip", -0.3, "fixed"),
        links="upper palm left right",
    )
    done = undeadzone("arm", gripper)
    assert "from base to palm" in done.stdout
    assert "left_finger, right_finger. Each link behind" in done.stdout
    done = undeadzone("arm", gripper, "--tip", "left", "--gears")
    words = shlex.split(done.stdout.split("undeadzone ")[-1])
    assert undeadzone(*words, cwd=tmp_path).returncode == 0
    assert 'tip = "left"\n\n[plant]' in (tmp_path / "two.toml").read_text()
    found = survey_urdf(gripper)
    assert found.fixed == ["left_finger", "right_finger"]
    assert found.masses.tolist() == [8.0]
    text = gripper.read_text().replace('name="shoulder" type="revolute"', 'name="s" type="fixed"')
    gripper.write_text(text)
    done = undeadzone("arm", gripper)
    assert done.returncode == 2
    assert "the movable joints branch at" in done.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--at", "1,two"], "at: expected numbers with commas between"),
        (["--at", "1"], "at: "),
        (["--at", "0,9"], "at[1]: elbow moves from -3 to 3, found 9"),
        (["--at", "nan,0"], "at"),
        (["--tip", "tap"], "Did you mean 'tip'?"),
        (["--joints", "elbow,shoulder"], "from base to tip: shoulder, elbow"),
    ],
)
def test_wrong_options_are_explained(tmp_path: Path, words: list[str], expected: str) -> None:
    done = undeadzone("arm", two(tmp_path), *words)
    assert done.returncode == 2
    assert expected in done.stderr
    assert len(done.stderr.strip().split("\n")) == 1
