"""Planar arms and the elastic joint against MuJoCo, Lagrange's equations, energy, each other."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from requirements import import_package
from scenes import seeds
from undeadzone.errors import InputError, ShapeError
from undeadzone.plants.build import system
from undeadzone.plants.options import ElasticJoint, Plant, TwoLink
from undeadzone.plants.robots import build
from undeadzone.plants.robots.arm import Arm, build_arm, forward_dynamics, inverse_dynamics
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats

CHAINS = {"one_link": build.build_one_link(), "two_link": build.build_two_link()}
ARMS = {name: build_arm(chain) for name, chain in CHAINS.items()}
kinds = pytest.mark.parametrize("kind", ARMS)


def params(body: Arm | System, **changes: float) -> Floats:
    """The column of an arm's parameters, some of them changed."""
    values = body.values if isinstance(body, Arm) else body.params
    return np.array(list((dict(zip(body.names, values, strict=True)) | changes).values()))


def drawn(body: Arm, seed: int) -> tuple[np.random.Generator, Floats, Floats, Floats]:
    """Random parameters, payload and friction among them, and a random state."""
    rng = np.random.default_rng(seed)
    return (
        rng,
        rng.uniform(0.1, 2.0, len(body.names)),
        rng.uniform(-np.pi, np.pi, body.joint_count),
        rng.normal(size=body.joint_count) * 5,
    )


def column(value: Any) -> Floats:
    return np.asarray(ca.DM(value)).ravel()


def move(plant: System, numbers: Floats, x: Any, u: Any) -> Floats:
    return column(plant.move(ca.DM(numbers), ca.DM(x), ca.DM(u)))


def elastic(measured: str = "motor", x_eq: Any = None, **parameters: float) -> System:
    return system(Plant(arm=ElasticJoint(measured=measured), parameters=parameters, x_eq=x_eq))  # type: ignore[arg-type]


def energy(body: Arm, numbers: Floats, q: Floats, v: Floats) -> float:
    """Kinetic and potential energy of the links and payload.

    From the paths of their centres of mass in the complex plane.
    """
    p = dict(zip(body.names, numbers, strict=True))
    tags = [""] if body.joint_count == 1 else ["1", "2"]
    links = [{name: p[name + tag] for name in "mlcI"} for tag in tags]
    joint, speed, total = 0j, 0j, 0.0
    for link, angle, rate in zip(links, np.cumsum(q), np.cumsum(v), strict=True):
        along = np.exp(1j * angle)
        centre, swing = joint + link["c"] * along, speed + 1j * rate * link["c"] * along
        total += (
            0.5 * link["m"] * abs(swing) ** 2
            + 0.5 * link["I"] * rate**2
            + link["m"] * p["g"] * centre.imag
        )
        joint, speed = joint + link["l"] * along, speed + 1j * rate * link["l"] * along
    return total + 0.5 * p["payload"] * abs(speed) ** 2 + p["payload"] * p["g"] * joint.imag


def elastic_energy(plant: System, numbers: Floats, x: Floats) -> float:
    p = dict(zip(plant.names, numbers, strict=True))
    link = build_arm(build.build_one_link())
    of_link = energy(
        link,
        params(link, **{name: p[name] for name in ("m", "l", "c", "I", "g", "payload")}),
        x[1:2],
        x[3:],
    )
    return of_link + 0.5 * p["J"] * x[2] ** 2 + 0.5 * p["k"] * (x[0] - x[1]) ** 2


def moved(rate: ca.Function, x0: Floats, duration: float = 10.0) -> Floats:
    """The states (times x n) of a free motion."""
    found = solve_ivp(
        lambda t, x: rate(x).full().ravel(),
        (0, duration),
        x0,
        method="DOP853",
        rtol=1e-10,
        atol=1e-11,
    )
    return found.y.T


ELASTIC = elastic()

MJCF = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 {g} 0"/>
  <worldbody>
    <body>
      <joint axis="0 0 1" damping="{b1}" armature="0"/>
      <inertial pos="{c1} 0 0" mass="{m1}" diaginertia="{I1} {I1} {I1}"/>
      <body pos="{l1} 0 0">
        <joint axis="0 0 1" damping="{b2}" armature="0"/>
        <inertial pos="{c2} 0 0" mass="{m2}" diaginertia="{I2} {I2} {I2}"/>
        <body pos="{l2} 0 0">{payload}</body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
POINT = '<inertial pos="0 0 0" mass="{}" diaginertia="1e-14 1e-14 1e-14"/>'
ELASTIC_MJCF = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 {g} 0"/>
  <worldbody>
    <body>
      <joint name="motor" axis="0 0 1" damping="{b1}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{J} {J} {J}"/>
    </body>
    <body>
      <joint name="link" axis="0 0 1" damping="{b2}"/>
      <inertial pos="{c} 0 0" mass="{m}" diaginertia="{I} {I} {I}"/>
      <body pos="{l} 0 0">{payload}</body>
    </body>
  </worldbody>
  <tendon>
    <fixed stiffness="{k}" springlength="0 0">
      <joint joint="motor" coef="1"/>
      <joint joint="link" coef="-1"/>
    </fixed>
  </tendon>
</mujoco>
"""


def mujoco_arm(text: str, numbers: dict[str, float]) -> Any:
    """MuJoCo's model and data of an arm whose payload is a point mass at the tip."""
    mujoco = import_package("mujoco")
    point = POINT.format(numbers["payload"]) if numbers["payload"] else ""
    model = mujoco.MjModel.from_xml_string(
        text.format(**numbers | {"g": -numbers["g"], "payload": point})
    )
    return mujoco, model, mujoco.MjData(model)


def mujoco_accelerations(
    text: str, numbers: dict[str, float], q: Floats, v: Floats, u: Floats
) -> Floats:
    mujoco, model, data = mujoco_arm(text, numbers)
    found = np.empty_like(q)
    for i in range(len(q)):
        data.qpos, data.qvel, data.qfrc_applied = q[i], v[i], u[i]
        mujoco.mj_forward(model, data)
        found[i] = data.qacc
    return found


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"payload": 1.5},
        {"payload": 0.7, "b1": 0.3, "b2": 0.1, "m2": 4.0, "c2": 0.1, "I1": 0.3, "g": 0.0},
    ],
)
def test_two_links_accelerate_as_in_mujoco(changes: dict[str, float]) -> None:
    body = ARMS["two_link"]
    numbers = params(body, **changes)
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (1000, 2))
    v = rng.normal(size=(1000, 2)) * 5
    u = rng.normal(size=(1000, 2)) * 20
    expected = mujoco_accelerations(MJCF, dict(zip(body.names, numbers, strict=True)), q, v, u)
    found = np.array(
        [column(forward_dynamics(body, numbers, q[i], v[i], u[i])) for i in range(1000)]
    )
    assert (
        np.linalg.norm(found - expected, axis=1) <= 1e-9 * np.linalg.norm(expected, axis=1)
    ).all()


def test_two_links_stand_where_mujoco_says() -> None:
    body = ARMS["two_link"]
    mujoco, model, data = mujoco_arm(MJCF, dict(zip(body.names, body.values, strict=True)))
    data.qpos = q = np.array([0.7, -1.9])
    mujoco.mj_kinematics(model, data)
    assert body.points(body.values, q).full() == pytest.approx(data.xpos[1:])
    assert body.turn(body.values, q).full() == pytest.approx(data.xmat[3].reshape(3, 3))
    assert column(body.tip(body.values, q)) == pytest.approx(data.xpos[3, :2])


@kinds
@given(seed=seeds)
def test_inverse_dynamics_inverts_forward_dynamics(kind: str, seed: int) -> None:
    body = ARMS[kind]
    rng, numbers, q, v = drawn(body, seed)
    u = rng.normal(size=body.joint_count) * 20
    assert column(
        inverse_dynamics(body, numbers, q, v, forward_dynamics(body, numbers, q, v, u))
    ) == pytest.approx(u, rel=1e-8, abs=1e-8)


@kinds
@given(seed=seeds)
def test_mass_is_symmetric_and_positive_and_the_energy_that_of_the_links(
    kind: str, seed: int
) -> None:
    body = ARMS[kind]
    _, numbers, q, v = drawn(body, seed)
    M = body.mass(numbers, q).full()
    assert np.abs(M - M.T).max() <= 1e-14 * np.abs(M).max()
    assert np.linalg.eigvalsh(M).min() > 0
    assert 0.5 * v @ M @ v == pytest.approx(
        energy(body, numbers, q, v) - energy(body, numbers, q, 0 * v), rel=1e-9
    )


@kinds
@given(seed=seeds)
def test_bias_is_lagranges(kind: str, seed: int) -> None:
    """h - gravity = (dM/dt) v - 1/2 d(v'Mv)/dq, and gravity = dV/dq.

    Hence v'(dM/dt)v / 2 = v'(h - gravity): the arm is passive.
    """
    body = ARMS[kind]
    _, numbers, q, v = drawn(body, seed)
    x, w = ca.SX.sym("q", body.joint_count), ca.SX.sym("v", body.joint_count)
    M = body.mass(numbers, x)
    change = ca.reshape(ca.jtimes(ca.vec(M), x, w), M.shape)
    at = ca.Function("at", [x, w], [change, change @ w - ca.gradient(0.5 * ca.dot(w, M @ w), x)])
    Mdot, coriolis = (np.asarray(part.full()) for part in at(q, v))
    gravity = column(body.bias(numbers, q, 0 * v))
    swing = column(body.bias(numbers, q, v)) - gravity
    assert swing == pytest.approx(coriolis.ravel(), rel=1e-9, abs=1e-9)
    assert 0.5 * v @ Mdot @ v == pytest.approx(v @ swing, rel=1e-8, abs=1e-8)
    step = 1e-5 * np.eye(body.joint_count)
    slope = [
        (energy(body, numbers, q + h, 0 * v) - energy(body, numbers, q - h, 0 * v)) / 2e-5
        for h in step
    ]
    assert gravity == pytest.approx(np.array(slope), abs=1e-7)


@kinds
def test_energy_stays_without_friction_and_torque(kind: str) -> None:
    body = ARMS[kind]
    N, numbers = body.joint_count, params(body, payload=0.4)
    x = ca.SX.sym("x", 2 * N)
    path = moved(
        ca.Function(
            "rate", [x], [ca.vertcat(x[N:], forward_dynamics(body, numbers, x[:N], x[N:], 0))]
        ),
        np.array([0.3, 1.1, -0.5, 2.0])[-2 * N :],
    )
    found = np.array([energy(body, numbers, state[:N], state[N:]) for state in path])
    kinetic = found - [energy(body, numbers, state[:N], 0 * state[N:]) for state in path]
    assert np.ptp(kinetic) > 1.0
    assert np.abs(found - found[0]).max() < 1e-6 * kinetic.max()


@given(seeds)
def test_on_a_horizontal_table_the_first_joint_is_cyclic(seed: int) -> None:
    body = ARMS["two_link"]
    rng, numbers, q, v = drawn(body, seed)
    numbers[body.names.index("g")] = 0.0
    turned = q + np.array([rng.normal(), 0.0])
    for value in (
        body.mass(numbers, q) - body.mass(numbers, turned),
        body.bias(numbers, q, v) - body.bias(numbers, turned, v),
    ):
        assert column(value) == pytest.approx(0, abs=1e-12)
    assert column(body.bias(numbers, q, 0 * v)) == pytest.approx(0)


def test_default_inertias_are_those_of_uniform_rods() -> None:
    for chain in CHAINS.values():
        p = chain.parameters
        for tag in [""] if len(chain.joints) == 1 else ["1", "2"]:
            assert p["c" + tag] == pytest.approx(p["l" + tag] / 2)
            assert p["I" + tag] == pytest.approx(p["m" + tag] * p["l" + tag] ** 2 / 12)


@given(seeds)
def test_two_links_with_a_straight_locked_elbow_are_one_link(seed: int) -> None:
    """An elbow that is straight and stays so: joint 1 moves one link with all the mass."""
    two, one = ARMS["two_link"], ARMS["one_link"]
    _, numbers, q, v = drawn(two, seed)
    p = dict(zip(two.names, numbers, strict=True))
    m, far = p["m1"] + p["m2"], p["l1"] + p["c2"]
    c = (p["m1"] * p["c1"] + p["m2"] * far) / m
    inertia = p["I1"] + p["I2"] + p["m1"] * p["c1"] ** 2 + p["m2"] * far**2 - m * c**2
    same = {name: p[name] for name in ("g", "payload", "b1", "f1")}
    rigid = params(one, m=m, l=p["l1"] + p["l2"], c=c, I=inertia, **same)
    found = column(inverse_dynamics(two, numbers, [q[0], 0], [v[0], 0], [3.0, 0]))[0]
    assert found == pytest.approx(
        column(inverse_dynamics(one, rigid, q[0], v[0], 3.0))[0], rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize("payload", [0.0, 0.8])
def test_the_elastic_joint_accelerates_as_in_mujoco(payload: float) -> None:
    plant = elastic(payload=payload, b1=0.2, b2=0.1)
    rng = np.random.default_rng(2)
    x, u = rng.normal(size=(1000, 4)) * [1, 1, 5, 5], rng.normal(size=(1000, 1)) * 10
    numbers = dict(zip(plant.names, plant.params, strict=True))
    expected = mujoco_accelerations(
        ELASTIC_MJCF, numbers, x[:, :2], x[:, 2:], np.pad(u, ((0, 0), (0, 1)))
    )
    found = np.array([move(plant, plant.params, x[i], u[i])[2:] for i in range(1000)])
    assert (
        np.linalg.norm(found - expected, axis=1) <= 1e-9 * np.linalg.norm(expected, axis=1)
    ).all()


@given(seeds)
def test_the_elastic_joints_power_goes_into_energy_and_friction(seed: int) -> None:
    plant = ELASTIC
    rng = np.random.default_rng(seed)
    numbers = rng.uniform(0.1, 2.0, len(plant.names))
    x = rng.normal(size=4) * 3
    u = rng.normal(size=1) * 5
    p = dict(zip(plant.names, numbers, strict=True))
    drag = sum(
        p["b" + i] * v**2 + p["f" + i] * v**2 / np.sqrt(v**2 + 0.05**2)
        for i, v in zip("12", x[2:], strict=True)
    )
    dx = move(plant, numbers, x, u) * 1e-6
    change = (
        elastic_energy(plant, numbers, x + dx) - elastic_energy(plant, numbers, x - dx)
    ) / 2e-6
    assert change == pytest.approx(u[0] * x[2] - drag, rel=1e-5, abs=1e-5)


def test_the_elastic_joints_energy_stays_without_friction_and_torque() -> None:
    plant = elastic(payload=0.3, k=10.0)
    x = ca.SX.sym("x", 4)
    path = moved(
        ca.Function("rate", [x], [plant.move(ca.DM(plant.params), x, 0)]),
        np.array([0.4, 0.2, 0.0, 3.0]),
    )
    found = np.array([elastic_energy(plant, plant.params, state) for state in path])
    kinetic = 0.5 * 0.05 * path[:, 2] ** 2  # the motor's
    assert kinetic.max() > 0.1
    assert np.abs(found - found[0]).max() < 1e-6 * kinetic.max()


@given(seeds)
def test_flat_state_and_torque_satisfy_the_equations_along_a_path(seed: int) -> None:
    plant = ELASTIC
    rng = np.random.default_rng(seed)
    numbers, t, now = rng.uniform(0.1, 2.0, len(plant.names)), ca.SX.sym("t"), rng.uniform(0, 10)
    path = sum(a * ca.sin(w * t + phase) for a, w, phase in rng.uniform(0.2, 2.0, (3, 3)))
    derivatives = [path]
    assert plant.flat is not None
    for _ in range(plant.flat.order):
        derivatives.append(ca.jacobian(derivatives[-1], t))
    x, u = plant.flat.solve(ca.DM(numbers), ca.horzcat(*derivatives))
    at = ca.Function("at", [t], [x, ca.jacobian(x, t), plant.move(ca.DM(numbers), x, u)])
    state, rate, moves = (column(part) for part in at(now))
    assert moves == pytest.approx(rate, rel=1e-8, abs=1e-8 * max(1.0, np.abs(rate).max()))
    assert state[1] == pytest.approx(column(ca.Function("path", [t], [path])(now))[0])


def test_the_stiff_limit_is_the_rigid_arm_with_the_motors_inertia() -> None:
    rigid = build_arm(build.build_one_link())
    path = [0.4, -1.2, 2.0, -3.0, 5.0]
    q, v, a = path[:3]
    friction = {"b1": 0.2, "b2": 0.1, "f1": 0.3, "f2": 0.4}
    same = params(rigid, payload=0.5, I=rigid.values[rigid.names.index("I")] + 0.05, b1=0.3, f1=0.7)
    gaps = []
    for k in (1e3, 1e4, 1e5):
        plant = elastic(payload=0.5, k=k, **friction)
        assert plant.flat is not None
        x, u = plant.flat.solve(plant.params, np.array([path]))
        gaps.append(
            [column(x)[0] - q, column(u)[0] - column(inverse_dynamics(rigid, same, q, v, a))[0]]
        )
    ratios = np.array(gaps)[:-1] / np.array(gaps)[1:]
    assert ratios == pytest.approx(10, rel=0.02)


@pytest.mark.parametrize(("measured", "row"), [("motor", 0), ("link", 1)])
@pytest.mark.parametrize("angle", [-np.pi / 2, 0.0, 0.9])
def test_linearisation_has_the_poles_of_the_closed_form(
    measured: str, row: int, angle: float
) -> None:
    x0 = [0.0, angle, 0.0, 0.0]
    numbers = {"b1": 0.3, "b2": 0.2, "f1": 0.1, "f2": 0.05, "payload": 0.6}
    plant = system(Plant(arm=ElasticJoint(measured=measured), parameters=numbers, x0=x0))  # type: ignore[arg-type]
    p = dict(zip(plant.names, plant.params, strict=True))
    inertia = p["I"] + p["m"] * p["c"] ** 2 + 0.6 * p["l"] ** 2
    weight = (p["m"] * p["c"] + 0.6 * p["l"]) * p["g"]
    motor = [p["J"], 0.3 + 0.1 / 0.05, p["k"]]
    link = [inertia, 0.2 + 0.05 / 0.05, p["k"] - weight * np.sin(angle)]
    polynomial = np.polysub(np.polymul(motor, link), [p["k"] ** 2])
    assert np.poly(plant.linear.A) == pytest.approx(polynomial / polynomial[0], rel=1e-9, abs=1e-8)
    assert plant.linear.C.tolist() == [np.eye(4)[row].tolist()]
    for s in (1j, 10j, 3 + 2j):
        numerator = np.polyval(link, s) if measured == "motor" else p["k"]
        gain = plant.linear.C @ np.linalg.solve(s * np.eye(4) - plant.linear.A, plant.linear.B)
        assert gain[0, 0] == pytest.approx(numerator / np.polyval(polynomial, s))


@pytest.mark.parametrize(("motor", "frequency"), [(0.05, 6.2), (1e9, 3.6)], ids=["free", "held"])
def test_the_spring_swings_as_the_page_says(motor: float, frequency: float) -> None:
    poles = np.linalg.eigvals(elastic(g=0.0, J=motor).linear.A)
    assert np.abs(poles.imag).max() / (2 * np.pi) == pytest.approx(frequency, abs=0.05)


@given(st.floats(-3, 3))
def test_gravity_hold_is_an_equilibrium(angle: float) -> None:
    numbers = params(ELASTIC, payload=0.4, f1=0.2)
    assert ELASTIC.flat is not None
    x, u = ELASTIC.flat.solve(numbers, angle * np.eye(1, 5))
    assert move(ELASTIC, numbers, x, u) == pytest.approx(0, abs=1e-10)
    assert column(u)[0] == pytest.approx((1.2 * 0.25 + 0.4 * 0.5) * 9.81 * np.cos(angle))
    x, _ = ELASTIC.flat.solve(ELASTIC.params, angle * np.eye(1, 5))
    assert column(x)[0] - angle == pytest.approx(0.059 * np.cos(angle), abs=2e-4)


def test_the_elastic_joint_draws_motor_and_link() -> None:
    plant = ELASTIC
    assert plant.arm is not None
    hands = [plant.arm.points(plant.params, [0.3, angle]).full() for angle in (0.3, 0.7)]
    assert hands == [
        pytest.approx(np.array([[0, 0, 0], [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0]]))
        for angle in (0.3, 0.7)
    ]


def test_what_else_is_refused() -> None:
    with pytest.raises(InputError, match=r"plant\.parameters: .*mass matrix is singular"):
        system(Plant(arm=TwoLink(), parameters={"I1": 1e-30, "I2": 1e-30, "c1": 0.0, "c2": 0.0}))
    with pytest.raises(InputError, match=r"plant\.parameters\.stiffness: unknown"):
        elastic(stiffness=3.0)
    with pytest.raises(InputError, match=r"plant\.parameters\.b2: must not be negative"):
        elastic(b2=-3.0)
    with pytest.raises(ShapeError, match=r"plant\.x_eq: expected 4 numbers"):
        elastic(x_eq=[0.0, 1.0])
    with pytest.raises(InputError, match=r"plant\.arm\.torque_max: must be greater than 0"):
        system(Plant(arm=ElasticJoint(torque_max=0.0)))
    with pytest.raises(InputError, match=r"plant\.arm\.rest"):
        system(Plant(arm=ElasticJoint(rest=0.0)))


def test_changed_parameters_are_those_of_the_chain_alone() -> None:
    assert build.change_parameters({"m": 1.0, "l": 2.0}, {"l": 3.0, "b1": 4.0}) == {
        "m": 1.0,
        "l": 3.0,
    }
