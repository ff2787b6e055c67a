"""Arms from URDF files against Pinocchio, and what is said about files that cannot be used."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from documents import EXAMPLES
from requirements import import_package
from undeadzone.errors import FileError, InputError
from undeadzone.plants.options import URDF, Plant
from undeadzone.plants.robots.arm import Arm, build_arm, forward_dynamics
from undeadzone.plants.robots.build import build_robot_plant
from undeadzone.plants.robots.urdf import load_urdf_chain
from undeadzone.util.arrays import Floats

import_package("adam.casadi")

UR5 = EXAMPLES / "ur5.urdf"
INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>'
INERTIAL = f'<inertial><mass value="1"/>{INERTIA}</inertial>'
LIMIT = '<limit lower="-1" upper="2" effort="30" velocity="3"/>'
Pinocchio = Any


@pytest.fixture(scope="module")
def pin() -> Pinocchio:
    return import_package("pinocchio")


def joint(name: str, parent: str, child: str, kind: str = "revolute", rest: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{rest}</joint>'


def link(name: str, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}</link>'


SHOULDER = joint("shoulder", "base", "upper", rest=LIMIT)
ELBOW = joint("elbow", "upper", "lower", "continuous", '<origin xyz="0 1 0"/>')
SMALL = (
    f'<robot name="small">{link("base", "")}{link("upper")}{link("lower")}{SHOULDER}{ELBOW}</robot>'
)


def written(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def forward(body: Arm) -> ca.Function:
    """q, v, torque -> acceleration, with the arm's own parameters."""
    q, v, u = (ca.SX.sym(name, body.joint_count) for name in "qvu")
    return ca.Function("forward", [q, v, u], [forward_dynamics(body, body.values, q, v, u)])


def states(N: int, count: int, seed: int) -> Floats:
    return np.random.default_rng(seed).uniform(-3, 3, (count, 3, N))


def worst(found: Callable[..., Any], expected: Callable[..., Any], cases: Floats) -> float:
    """The largest difference of two functions over the cases, relative to the largest entry."""
    pairs = [(np.array(found(*case)).ravel(), np.array(expected(*case)).ravel()) for case in cases]
    return max(np.abs(a - b).max() / np.abs(b).max() for a, b in pairs)


def inertia_of_points(rng: np.random.Generator) -> Floats:
    """About the centre of some random point masses."""
    r = rng.normal(scale=0.1, size=(5, 3))
    r -= r.mean(axis=0)
    return 0.4 * (np.sum(r**2) * np.eye(3) - r.T @ r)


def random_arm(seed: int, kinds: list[str]) -> str:
    """A chain of joints with random mountings, axes and inertias, a tool fixed to its last link."""
    rng = np.random.default_rng(seed)

    def origin() -> str:
        return '<origin xyz="{} {} {}" rpy="{} {} {}"/>'.format(
            *rng.uniform(-0.5, 0.5, 3), *rng.uniform(-3, 3, 3)
        )

    def inertial() -> str:
        entries = " ".join(
            f'i{pair}="{value}"'
            for pair, value in zip(
                ("xx", "xy", "xz", "yy", "yz", "zz"),
                inertia_of_points(rng)[np.triu_indices(3)],
                strict=True,
            )
        )
        place = origin()
        mass = f'<mass value="{rng.uniform(0.5, 3)}"/>'
        return f"<inertial>{place}{mass}<inertia {entries}/></inertial>"

    def moving(i: int, kind: str) -> str:
        axis = '<axis xyz="{} {} {}"/>'.format(
            *(d / np.linalg.norm(d) if (d := rng.normal(size=3)) is not None else ())
        )
        return joint(
            f"j{i}",
            f"l{i}",
            f"l{i + 1}",
            kind,
            origin()
            + axis
            + '<limit lower="-3" upper="3" effort="10" velocity="2"/>' * (kind != "fixed"),
        )

    N = len(kinds)
    links = [link(f"l{i}", inertial()) for i in range(N + 1)] + [link("tool", inertial())]
    joints = [moving(i, kind) for i, kind in enumerate(kinds)] + [
        joint("hand", f"l{N}", "tool", "fixed", origin())
    ]
    return f'<robot name="random">{"".join(links + joints)}</robot>'


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return build_arm(load_urdf_chain(UR5))


def test_ur5_forward_dynamics_are_those_of_pinocchio(pin: Pinocchio, ur5: Arm) -> None:
    model = pin.buildModelFromUrdf(str(UR5))
    data = model.createData()
    assert (
        worst(forward(ur5), lambda q, v, u: pin.aba(model, data, q, v, u), states(6, 1000, 0))
        < 1e-12
    )


def same_dynamics(pin: Pinocchio, body: Arm, params: Floats, model: Any, tip: str) -> None:
    data, frame = model.createData(), model.getFrameId(tip)

    def upper(q: Floats) -> Floats:
        return np.triu(pin.crba(model, data, q))

    def placement(q: Floats) -> Any:
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[frame]

    cases = states(body.joint_count, 50, 1)
    assert worst(lambda q: np.triu(np.asarray(body.mass(params, q))), upper, cases[:, :1]) < 1e-12
    assert (
        worst(
            lambda q, v: body.bias(params, q, v),
            lambda q, v: pin.nonLinearEffects(model, data, q, v),
            cases[:, :2],
        )
        < 1e-12
    )
    assert (
        worst(lambda q: body.tip(params, q), lambda q: placement(q).translation, cases[:, :1])
        < 1e-12
    )
    assert (
        worst(lambda q: body.turn(params, q), lambda q: placement(q).rotation, cases[:, :1]) < 1e-12
    )
    for (q,) in cases[:5, :1]:
        placement(q)
        joints = np.array([place.translation for place in list(data.oMi)[1:]])
        np.testing.assert_allclose(
            np.asarray(body.points(params, q))[:-1], np.vstack([np.zeros(3), joints]), atol=1e-12
        )


def test_ur5_mass_bias_and_tip_are_those_of_pinocchio(pin: Pinocchio, ur5: Arm) -> None:
    same_dynamics(pin, ur5, ur5.values, pin.buildModelFromUrdf(str(UR5)), "tool0")


def test_payload_and_masses_are_bodies_of_pinocchio(pin: Pinocchio, ur5: Arm) -> None:
    model = pin.buildModelFromUrdf(str(UR5))
    tool = model.frames[model.getFrameId("tool0")]
    model.appendBodyToJoint(
        tool.parentJoint, pin.Inertia(3.0, np.zeros(3), np.zeros((3, 3))), tool.placement
    )
    forearm = model.inertias[3]
    model.inertias[3] = pin.Inertia(2 * forearm.mass, forearm.lever, 2 * forearm.inertia)
    params = ur5.values.copy()
    params[ur5.names.index("payload")] = 3.0
    params[ur5.names.index("m3")] *= 2
    same_dynamics(pin, ur5, params, model, "tool0")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_any_seven_joints_are_those_of_pinocchio(pin: Pinocchio, tmp_path: Path, seed: int) -> None:
    kinds = [
        "revolute",
        "prismatic",
        "revolute",
        "fixed",
        "revolute",
        "revolute",
        "prismatic",
        "revolute",
        "revolute",
        "revolute",
    ]
    path = written(tmp_path, random_arm(seed, kinds))
    moved = [f"j{i}" for i, kind in enumerate(kinds) if kind != "fixed" and i != 8]
    whole = pin.buildModelFromUrdf(str(path))
    model = pin.buildReducedModel(
        whole, [whole.getJointId(name) for name in ("j0", "j8")], pin.neutral(whole)
    )
    gravity = np.array([1.0, -2.0, 9.0])
    model.gravity.linear = gravity
    body = build_arm(load_urdf_chain(path, moved[1:], gravity=gravity))
    assert body.chain.joints == tuple(model.names)[1:]
    same_dynamics(pin, body, body.values, model, "tool")
    data = model.createData()
    assert (
        worst(forward(body), lambda q, v, u: pin.aba(model, data, q, v, u), states(7, 100, seed))
        < 1e-9
    )


def test_energy_stays_the_same(pin: Pinocchio, ur5: Arm) -> None:
    model = pin.buildModelFromUrdf(str(UR5))
    data, f = model.createData(), forward(ur5)
    x0 = np.r_[0.3, -1.0, 1.2, 0.4, -0.7, 0.2, np.zeros(6)]
    x = solve_ivp(
        lambda _, x: np.r_[x[6:], np.asarray(f(x[:6], x[6:], np.zeros(6))).ravel()],
        (0, 10),
        x0,
        "DOP853",
        rtol=1e-10,
        atol=1e-10,
    ).y.T
    kinetic = np.array([pin.computeKineticEnergy(model, data, row[:6], row[6:]) for row in x])
    energy = kinetic + [pin.computePotentialEnergy(model, data, row[:6]) for row in x]
    assert np.ptp(energy) < 1e-6 * kinetic.max()


def test_digits_of_pi_cost_nothing(tmp_path: Path, ur5: Arm) -> None:
    rounded = build_arm(
        load_urdf_chain(
            written(tmp_path, UR5.read_text().replace("1.5707963267948966", "1.57079632679"))
        )
    )
    assert forward(rounded).n_instructions() == forward(ur5).n_instructions()
    assert worst(forward(rounded), forward(ur5), states(6, 50, 2)) < 1e-9
    short = build_arm(
        load_urdf_chain(written(tmp_path, UR5.read_text().replace("1.5707963267948966", "1.5708")))
    )
    assert (
        1e-9 < worst(forward(short), forward(ur5), states(6, 50, 2)) < 1e-3
    )  # other angles are what the file says
    assert forward(short).n_instructions() == pytest.approx(
        4 / 3 * forward(ur5).n_instructions(), rel=0.05
    )


def test_what_the_file_says_of_the_joints(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    more = ELBOW.replace(
        "</joint>",
        '<limit lower="0" upper="0" effort="5" velocity="7"/>'
        '<dynamics damping="0.3" friction="0.1"/></joint>',
    )
    noise = '<gazebo><x/></gazebo><transmission name="t"/><sensor name="s"/><material name="m"/>'
    given = load_urdf_chain(written(tmp_path, SMALL.replace(ELBOW, more + noise)))
    assert given.joints == ("shoulder", "elbow")
    np.testing.assert_array_equal(given.limits, [[-1, 2], [-np.inf, np.inf]])
    np.testing.assert_array_equal(given.torque, [30, 5])
    np.testing.assert_array_equal(given.speed, [3, 7])
    np.testing.assert_array_equal(given.friction, [[0, 0.3], [0, 0.1]])
    assert np.isinf(load_urdf_chain(written(tmp_path, SMALL.replace(LIMIT, ""))).limits).all()
    assert capfd.readouterr() == ("", "")


def test_a_part_of_a_tree(tmp_path: Path) -> None:
    fingers = joint("left", "lower", "finger", "prismatic") + joint(
        "right", "lower", "thumb", "prismatic", '<mimic joint="left"/>'
    )
    path = written(
        tmp_path, SMALL.replace("</robot>", link("finger") + link("thumb") + fingers + "</robot>")
    )
    with pytest.raises(InputError, match=r"plant\.arm\.tip: the movable joints branch"):
        load_urdf_chain(path, ["shoulder", "elbow", "left", "right"])
    for names in (None, ["shoulder", "elbow"]):
        arm = load_urdf_chain(path, names)
        assert arm.joints == ("shoulder", "elbow")
        assert arm.parameters == {"m1": 1.0, "m2": 3.0, "payload": 0.0}
    assert load_urdf_chain(path, ["elbow"], tip="lower").parameters == {"m1": 3.0, "payload": 0.0}
    with pytest.raises(InputError, match="'right' mimics 'left'"):
        load_urdf_chain(path, tip="finger")
    path.write_text(path.read_text().replace("prismatic", "fixed"))
    with pytest.raises(
        InputError, match=r"plant\.arm\.tip: the arm ends in finger, thumb: name one"
    ):
        load_urdf_chain(path, names)


@pytest.mark.parametrize(
    ("joints", "tip", "expected"),
    [
        (
            ["shoulder", "elbo"],
            None,
            r"plant\.arm\.joints\[1\]: no joint 'elbo'. Did you mean 'elbow'",
        ),
        (
            ["shoulder", "x"],
            None,
            r"plant\.arm\.joints\[1\]: no joint 'x'. The file has shoulder, elbow",
        ),
        (
            ["elbow", "shoulder"],
            None,
            r"plant\.arm\.joints: must name each joint once, from base to tip: shoulder, elbow",
        ),
        (["elbow", "elbow"], None, r"plant\.arm\.joints: must name each joint once"),
        (
            ["shoulder", "elbow"],
            "upper",
            r"plant\.arm\.joints\[1\]: 'elbow' is not between the base and the tip 'upper'",
        ),
        (None, "hand", r"plant\.arm\.tip: no link 'hand'. The file has base, upper, lower"),
        (None, "base", r"no joint moves between the base and 'base'"),
        ([], None, "no joint moves between"),
    ],
)
def test_joints_and_tips_that_do_not_fit(
    tmp_path: Path, joints: list[str] | None, tip: str | None, expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        load_urdf_chain(written(tmp_path, SMALL), joints, tip)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("</robot>", "", "not XML"),
        ("robot", "mujoco", "not a URDF: its first element is not <robot>"),
        (
            "<robot",
            '<robot xmlns:xacro="http://ros.org/xacro"><xacro:property name="a"/></robot><!--',
            "not XML",
        ),
        (
            "</robot>",
            '<xacro:x xmlns:xacro="http://ros.org/xacro"/></robot>',
            "xacro macros: expand them first",
        ),
        ('type="continuous"', 'type="floating"', "joint elbow: type must be .* found 'floating'"),
        ('type="continuous"', 'type="planar"', "found 'planar'"),
        ('type="continuous"', 'type="ball"', "found 'ball'"),
        ('<link name="lower">', "<link>", "a <link> has no name"),
        ('link name="lower"', 'link name="upper"', "two links have the same name"),
        ('joint name="elbow"', 'joint name="shoulder"', "two joints have the same name"),
        (
            '<child link="lower"/>',
            '<child link="lover"/>',
            "joint elbow: no link 'lover'. Did you mean 'lower'",
        ),
        ('<child link="lower"/>', "", "joint elbow: needs <parent"),
        ('<child link="lower"/>', '<child link="upper"/>', "link upper has two parents"),
        (
            '<parent link="base"/>',
            '<parent link="lower"/>',
            "link upper is not connected to the base base",
        ),
        (ELBOW, "", "expected one base link, found base, lower"),
        (
            '<origin xyz="0 1 0"/>',
            '<origin xyz="0 1"/>',
            r"joint elbow: <origin xyz='0 1'>: expected 3 finite numbers",
        ),
        ('<origin xyz="0 1 0"/>', '<origin xyz="0 1 nan"/>', "expected 3 finite numbers"),
        ('<origin xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "joint elbow: its axis is zero"),
        ('upper="2"', 'upper="-2"', "limit lower = -1 must be less than upper = -2"),
        ('effort="30"', 'effort="0"', "limit effort and velocity must be positive"),
        ('<origin xyz="0 1 0"/>', '<dynamics damping="-1"/>', "must not be negative, found -1"),
        ('mass value="1"', 'mass value="-1"', "link upper: mass must not be negative, found -1"),
        (
            'mass value="1"',
            'mass value="one"',
            "link upper: <mass value='one'>: expected 1 finite number",
        ),
        ('izz="0.02"', 'izz="-0.02"', "inertia must be positive definite"),
        ('izz="0.02"', 'izz="0.0401"', "no body has the principal moments 0.02, 0.02, 0.0401"),
        (
            link("upper"),
            link("upper", ""),
            "link upper moves but has no mass. Give it an <inertial>, or leave shoulder out",
        ),
    ],
)
def test_files_that_do_not_describe_an_arm(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in SMALL
    with pytest.raises(FileError, match=rf"plant\.arm\.path: .*arm\.urdf: .*{expected}"):
        load_urdf_chain(written(tmp_path, SMALL.replace(old, new)))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path in (tmp_path / "none.urdf", tmp_path):
        with pytest.raises(FileError, match=r"plant\.arm\.path: .*: cannot read: "):
            load_urdf_chain(path)
    binary = tmp_path / "arm.urdf"
    binary.write_bytes(b"\x00\xff\xfe")
    with pytest.raises(FileError, match="not XML"):
        load_urdf_chain(binary)


def test_a_joint_that_moves_points_about_themselves(tmp_path: Path) -> None:
    point = INERTIAL.replace("0.02", "0")
    path = written(tmp_path, SMALL.replace(link("lower"), link("lower", point)))
    with pytest.raises(InputError, match="mass matrix is singular"):
        build_robot_plant(Plant(arm=URDF(path=str(path))), URDF(path=str(path)), "plant")


def test_gravity_has_three_numbers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"plant\.arm\.gravity"):
        load_urdf_chain(written(tmp_path, SMALL), gravity=[0.0, 9.81])


def test_adam_is_imported_when_it_is_used_and_named_when_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (
        "import sys, undeadzone.plants.robots.urdf; "
        "sys.exit('adam' in sys.modules or 'urdf_parser_py' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    monkeypatch.setitem(sys.modules, "adam.casadi.casadi_like", None)
    with pytest.raises(InputError, match=r"pip install 'undeadzone\[robots\]'"):
        load_urdf_chain(written(tmp_path, SMALL))
