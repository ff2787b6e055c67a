"""Paths and inverse kinematics: derivatives, smoothness, the tip where it should be.

And the messages about a path that cannot be followed.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path as File
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from test_exosystem import slopes_agree, state_obeys
from tests.scenes import linear

from requirements import import_package
from undeadzone.errors import InputError, TrackingError
from undeadzone.feedforward import joint_path as kinematics
from undeadzone.feedforward.joint_path import (
    equations_of,
    evaluate_at_inputs,
    nearest,
    singular,
    solve_jacobians,
)
from undeadzone.feedforward.targets import linear_targets
from undeadzone.linalg.matrices import Matrices
from undeadzone.plants.robots import build
from undeadzone.plants.robots.arm import Arm, Chain, build_arm
from undeadzone.plants.robots.build import build_flat_joints
from undeadzone.plants.system import System
from undeadzone.signals import paths
from undeadzone.signals.exosystem import Exosystem, Signal, build_exosystem
from undeadzone.signals.paths import Circle, FigureEight, Path, Quintic
from undeadzone.util.arrays import Floats, decode_array

T = np.linspace(-0.9, 9.9, 541) + 0.003
VIA = Quintic(points=[[0.0, 1.0], [1.0, -1.0], [0.5, 2.0], [0.0, 1.0]], times=[0.0, 1.0, 3.0, 4.0])
CIRCLE = Circle(centre=[0.4, 0.1], radius=0.15, period=4.0, phase=0.3)
EIGHT = FigureEight(centre=[0.35, 0.2], width=0.3, height=0.2, period=5.0)
TWO_LINK = build_arm(build.build_two_link())
ELBOWS = [[0.3, 0.8], [0.8, -0.8]]
UR5 = File(__file__).parents[3] / "examples" / "ur5.urdf"


def changed(path: Any, **changes: Any) -> Any:
    return msgspec.structs.replace(path, **changes)


def tip_path(path: Path, channels: int = 2) -> Exosystem:
    return build_exosystem("reference", changed(path, space="task"), channels, task=True)


def spatial(joints: int, **bounds: Floats) -> Arm:
    """An arm that only moves: joints about z and y in turn, a link after each of them."""
    about_z = [i in (0, 3, 5) for i in range(joints)]
    axes = [np.eye(3)[1 + z] for z in about_z]
    lengths = [0.3, 0.5, 0.4, 0.1, 0.3, 0.2, 0.2]

    def frames(q: Any) -> list[tuple[Any, Any]]:
        poses = [(ca.DM.eye(3), ca.DM.zeros(3, 1))]
        for i in range(joints):
            turn, point = poses[-1]
            a, K = axes[i], np.cross(np.eye(3), axes[i] * -1.0)
            turn = turn @ (
                ca.DM.eye(3) * ca.cos(q[i])
                + ca.sin(q[i]) * ca.DM(K)
                + (1 - ca.cos(q[i])) * ca.DM(np.outer(a, a))
            )
            poses.append((turn, point + turn @ ca.DM([0.05, 0.0, lengths[i]])))
        return poses

    def points(p: Any, q: Any) -> Any:
        return ca.horzcat(*[point for _, point in frames(q)]).T

    free = np.full(joints, np.inf)
    chain = Chain(
        joints=tuple(f"j{i}" for i in range(joints)),
        parameters={},
        mass=lambda p, q: ca.SX.eye(joints),
        bias=lambda p, q, v: 0 * v,
        points=points,
        turn=lambda p, q: frames(q)[-1][0],
        gravity=lambda p: ca.DM([0.0, 0.0, -9.81]),
        plane=(0, 1, 2),
        limits=np.outer(free, [-1, 1]),
        torque=free,
        speed=free,
        friction=np.zeros((2, joints)),
    )
    return build_arm(chain._replace(**bounds))


def tips(given: Arm, q: Floats) -> Floats:
    return given.tip.map(len(q))(given.values, q.T).full().T


def turns(given: Arm, q: Floats) -> Floats:
    return given.turn.map(len(q))(given.values, q.T).full().reshape(3, len(q), 3).swapaxes(0, 1)


def joints(
    given: Arm, path: Exosystem, start: Any, duration: float = 8.0, step: float = 2e-3
) -> Exosystem:
    return kinematics.joint_path(given, given.values, path, duration, step, np.array(start))


PATHS = [
    VIA,
    changed(VIA, repeat=True),
    CIRCLE,
    changed(CIRCLE, ramp=0.0),
    EIGHT,
    changed(EIGHT, ramp=2.0),
    changed(CIRCLE, centre=[1.0, 2.0, 3.0], normal=[1.0, 2.0, -0.5]),
    changed(EIGHT, centre=0.5, normal=[0.0, -1.0, 0.0]),
]


def size(path: Path) -> int:
    return 3 if np.size(getattr(path, "normal", None)) == 3 else 2


def corners_of(path: Exosystem) -> Floats:
    """The corners of a path in the periods that are looked at."""
    return np.add.outer(np.arange(-1, 5) * (path.period or 0.0), path.corners).ravel()


@pytest.mark.parametrize("path", PATHS)
def test_derivatives_are_those_of_the_values(path: Path) -> None:
    found = tip_path(path, size(path))
    slopes_agree(found, T, 4, corners_of(found))


@pytest.mark.parametrize(("path", "smooth"), [(VIA, 2), (CIRCLE, 3), (EIGHT, 3)])
def test_smoothness_at_corners(path: Path, smooth: int) -> None:
    found, h = tip_path(path), 1e-9
    for order in range(smooth + 1):
        jump = found.output_at(found.corners + h, order) - found.output_at(found.corners - h, order)
        assert np.abs(jump).max() < 1e-6 * (1 + np.abs(found.output_at(T, order)).max())
    inner = found.corners[1:-1] if isinstance(path, Quintic) else np.empty(0)
    assert found.output_at(inner + h, 4) == pytest.approx(found.output_at(inner - h, 4), rel=1e-5)


@pytest.mark.parametrize("path", PATHS)
def test_state_obeys_its_exosystem_once_the_ramp_is_over(path: Path) -> None:
    found = tip_path(path, size(path))
    begin = 0 if isinstance(path, Quintic) else 2.0
    state_obeys(found, T[(begin < T) & (T < 3.9)], 0.004, found.corners)


def test_quintic_goes_through_its_points_from_rest_to_rest() -> None:
    found = build_exosystem("reference", VIA, 2)
    times = np.asarray(VIA.times)
    assert found.output_at(times) == pytest.approx(np.asarray(VIA.points), abs=1e-12)
    for order in (1, 2):
        assert np.abs(found.output_at(times[[0, -1]], order)).max() < 1e-12
    assert found.output_at(np.array([-5.0, 20.0])) == pytest.approx(np.asarray(VIA.points)[[0, -1]])
    again = build_exosystem("reference", changed(VIA, repeat=True), 2)
    assert again.period == 4.0
    assert again.output_at(np.array([8.7, -0.5])) == pytest.approx(
        found.output_at(np.array([0.7, 3.5])), abs=1e-12
    )
    one = build_exosystem("reference", Quintic(points=[1.0, 3.0], times=[0.5, 2.5]), 1)
    share = (T.clip(0.5, 2.5) - 0.5) / 2
    assert one.output_at(T).ravel() == pytest.approx(
        1 + 2 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    )
    uneven = build_exosystem("reference", Quintic(points=[0.0, 2.0, 0.0], times=[0.0, 2.0, 5.0]), 1)
    assert uneven.output_at(np.linspace(0, 5, 1001)).max() == pytest.approx(2.16, abs=5e-3)


def test_quintic_has_the_least_jerk() -> None:
    """Every variation that keeps points and rest is orthogonal to it in jerk."""
    found, times = build_exosystem("reference", VIA, 2), np.asarray(VIA.times)
    roots = np.polynomial.Polynomial.fromroots(np.concatenate([times, times[[0, 0, -1, -1]]]))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    t = np.concatenate([a + (b - a) * (nodes + 1) / 2 for a, b in pairwise(times)])
    weights = np.concatenate([weights * (b - a) / 2 for a, b in pairwise(times)])
    for factor in ([1.0], [0.3, 1.0], [-2.0, 0.5, 1.0]):
        variation = (roots * np.polynomial.Polynomial(factor)).deriv(3)(t)
        products = found.output_at(t, 3) * variation[:, None]
        assert np.abs(weights @ products).max() < 1e-12 * (weights @ np.abs(products)).max()


def test_turning_paths_in_closed_form() -> None:
    t = T[T > 0]
    angle = 2 * np.pi * t / 4.0 + 0.3
    expected = np.array([0.4, 0.1]) + 0.15 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert tip_path(changed(CIRCLE, ramp=0.0)).output_at(t) == pytest.approx(expected)
    assert tip_path(CIRCLE).output_at(t[t > 1.0] + 0.5) == pytest.approx(
        expected[t > 1.0]
    )  # the ramp costs half of itself
    angle = 2 * np.pi * t / 5.0
    expected = np.array([0.35, 0.2]) + np.stack(
        [0.15 * np.sin(angle), 0.1 * np.sin(2 * angle)], axis=1
    )
    assert tip_path(changed(EIGHT, ramp=0.0)).output_at(t) == pytest.approx(expected)
    at_rest = tip_path(CIRCLE)
    assert at_rest.output_at(np.array([-1.0, 0.0])) == pytest.approx(
        np.array([[0.4 + 0.15 * np.cos(0.3), 0.1 + 0.15 * np.sin(0.3)]] * 2)
    )
    assert (np.abs(at_rest.output_at(np.array([-1.0, 0.0]), 1)).max(), at_rest.period) == (0, None)


@pytest.mark.parametrize(
    ("normal", "start"),
    [
        ([0, 0, 1], [1, 0, 0]),
        ([0, 0, -2], [1, 0, 0]),
        ([1, 0, 0], [0, 1, 0]),
        ([0, 3, 0], [-1, 0, 0]),
        ([1, 0, 1], [0, 1, 0]),
    ],
)
def test_circle_about_a_normal(normal: list[float], start: list[float]) -> None:
    path = tip_path(Circle(centre=[1.0, 2.0, 3.0], radius=0.5, period=1.0, normal=normal), 3)
    r, v = path.output_at(T) - [1.0, 2.0, 3.0], path.output_at(T, 1)
    assert path.output_at(np.zeros(1))[0] == pytest.approx(
        np.array([1.0, 2.0, 3.0]) + 0.5 * np.array(start)
    )
    assert np.linalg.norm(r, axis=1) == pytest.approx(np.full(T.size, 0.5))
    unit = np.array(normal) / np.linalg.norm(normal)
    assert np.cross(r, v) == pytest.approx(
        0.5 * np.linalg.norm(v, axis=1)[:, None] * unit, abs=1e-12
    )


def test_joint_space_paths_steer_ordinary_plants() -> None:
    chains = linear(
        np.kron(np.eye(2), [[0.0, 1.0], [0.0, 0.0]]),
        np.kron(np.eye(2), [[0.0], [1.0]]),
        np.kron(np.eye(2), [[1.0, 0.0]]),
    )
    path = build_exosystem("reference", changed(CIRCLE, space="joint"), 2)
    found = linear_targets(chains, path, [0, 1], T)
    assert found.u_ff == pytest.approx(path.output_at(T, 2), abs=1e-9)
    assert found.x_ref[:, 1::2] == pytest.approx(path.output_at(T, 1), abs=1e-9)
    zeros = linear(
        np.kron(np.eye(2), [[0.0, 1.0], [-1.0, -2.0]]),
        np.kron(np.eye(2), [[0.0], [1.0]]),
        np.kron(np.eye(2), [[2.0, 1.0]]),
    )
    steady = T[T > 1.0]
    found, slope = (linear_targets(zeros, path, [0, 1], steady, order) for order in (0, 1))
    A, B, C = zeros.linear
    assert found.x_ref @ C.T == pytest.approx(path.output_at(steady))
    assert slope.x_ref == pytest.approx(found.x_ref @ A.T + found.u_ff @ B.T, abs=1e-9)


def test_task_space_needs_an_arm() -> None:
    with pytest.raises(InputError, match=r"reference.space: task.*plant.arm.*Use space = 'joint'"):
        build_exosystem("reference", CIRCLE, 2)
    words = {
        "kind": "figure_eight",
        "centre": [0, 0],
        "width": 1,
        "height": 0.5,
        "period": 2,
        "space": "joint",
    }
    read = msgspec.convert(words, Signal, dec_hook=decode_array)
    assert build_exosystem("reference", read, 2).output_at(np.array([1.5]))[0] == pytest.approx(
        [0.5 * np.sin(1.25 * np.pi), 0.25 * np.sin(2.5 * np.pi)]
    )


@pytest.mark.parametrize("start", ELBOWS)
@pytest.mark.parametrize(
    "path",
    [CIRCLE, EIGHT, Quintic(points=[[0.5, 0.0], [0.3, 0.4], [0.1, 0.5]], times=[0.0, 2.0, 5.0])],
)
def test_two_link_follows_with_either_elbow(path: Path, start: list[float]) -> None:
    task = tip_path(path)
    found = joints(TWO_LINK, task, start)
    t = np.random.default_rng(3).uniform(0, 8, 400)  # in no order
    q = found.output_at(t)
    assert tips(TWO_LINK, q) == pytest.approx(task.output_at(t), abs=1e-12)
    assert (np.sign(q[:, 1]) == np.sign(start[1])).all()
    assert found.output_at(np.empty(0), 2).shape == (0, 2)
    slopes_agree(found, t, 2, corners_of(found))


def test_start_on_the_other_side_of_the_base() -> None:
    """The straight line to the path crosses the hole that the arm cannot reach."""
    found = joints(TWO_LINK, tip_path(CIRCLE), [np.pi + 0.3, 1.3])
    assert tips(TWO_LINK, found.output_at(T[T > 0][:300])) == pytest.approx(
        tip_path(CIRCLE).output_at(T[T > 0][:300]), abs=1e-12
    )


def test_joint_path_against_the_textbook() -> None:
    found, task, l1, l2 = joints(TWO_LINK, tip_path(CIRCLE), ELBOWS[0]), tip_path(CIRCLE), 0.4, 0.3
    t = T[(T > 0) & (T < 8)]
    x, y = task.output_at(t).T
    q2 = np.arccos((x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2))
    q1 = np.arctan2(y, x) - np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))
    assert found.output_at(t) == pytest.approx(np.stack([q1, q2], axis=1), abs=1e-12)


def test_a_coarse_grid_gives_the_same_path() -> None:
    t = T[(T > 0) & (T < 8)]
    coarse = joints(TWO_LINK, tip_path(EIGHT), ELBOWS[0], step=0.05)
    fine = joints(TWO_LINK, tip_path(EIGHT), ELBOWS[0], step=1e-3)
    for order in range(3):
        assert coarse.output_at(t, order) == pytest.approx(fine.output_at(t, order), abs=1e-11)


@pytest.mark.parametrize(
    "path",
    [changed(EIGHT, period=2.5), Circle(centre=[0.0, 0.0], radius=0.5, period=1.005, ramp=0.0)],
)
def test_a_grid_too_coarse_for_the_path(path: Path) -> None:
    """From one step to the next the elbow would flip, or a turn about the base go the short way."""
    with pytest.raises(
        TrackingError,
        match=r"singular configuration .*, or it is too fast for steps as long as "
        r"simulation.step: move it or slow",
    ):
        joints(TWO_LINK, tip_path(path), ELBOWS[0], step=1.0)


def test_period_of_a_joint_path() -> None:
    assert joints(TWO_LINK, tip_path(changed(CIRCLE, ramp=0.0)), ELBOWS[0]).period == 4.0
    around = joints(
        TWO_LINK, tip_path(Circle(centre=[0.0, 0.0], radius=0.5, period=4.0, ramp=0.0)), ELBOWS[0]
    )
    assert (
        around.period is None
    )  # after a turn about its base the arm is where it was, its first joint a turn further
    assert around.output_at(np.array([4.0])) - around.output_at(np.zeros(1)) == pytest.approx(
        np.array([[2 * np.pi, 0.0]])
    )
    with pytest.raises(TrackingError, match=r"known up to t = 8\.\d+ s, not at 9 s"):
        around.output_at(np.array([1.0, 9.0]))


@pytest.mark.parametrize("count", [3, 4, 5, 6, 7])
def test_spatial_arms(count: int) -> None:
    given, start = spatial(count), np.array([0.2, 0.5, 0.9, 0.3, -0.8, 0.7, 0.4])[:count]
    centre = given.tip(given.values, start).full().ravel()
    task = tip_path(Circle(centre=centre, radius=0.06, period=4.0, normal=[1.0, 1.0, 0.5]), 3)
    found = joints(given, task, start, step=1e-2)
    t = np.random.default_rng(1).uniform(0, 8, 300)
    q = found.output_at(t)
    assert tips(given, q) == pytest.approx(task.output_at(t), abs=1e-12)
    slopes_agree(found, t, 2, corners_of(found))
    turned = np.abs(turns(given, q) - turns(given, start[None])).max()
    assert turned < 1e-12 if count >= 6 else turned > 1e-3


def ur5() -> tuple[Arm, Floats]:
    import_package("adam")
    from undeadzone.plants.robots import urdf

    return build_arm(urdf.load_urdf_chain(UR5)), np.array([0.0, -1.2, 1.6, -1.9, -1.57, 0.0])


def test_ur5_follows_without_turning() -> None:
    given, start = ur5()
    centre = given.tip(given.values, start).full().ravel()
    for path in (
        Circle(centre=centre, radius=0.1, period=4.0, normal=[1.0, 0.0, 1.0]),
        FigureEight(centre=centre, width=0.3, height=0.2, period=5.0, normal=[1.0, 0.0, 0.0]),
    ):
        task = tip_path(path, 3)
        found = joints(given, task, start, step=1e-2)
        t = np.random.default_rng(5).uniform(0, 8, 300)
        q = found.output_at(t)
        assert tips(given, q) == pytest.approx(task.output_at(t), abs=1e-12)
        assert turns(given, q) == pytest.approx(
            np.broadcast_to(turns(given, start[None]), (300, 3, 3)), abs=1e-12
        )
        slopes_agree(found, t, 2, corners_of(found))
        kinematics.require_torque(driven(given, given.chain.torque), found, t)
        with pytest.raises(TrackingError, match=r"needs a torque of .* from shoulder_lift_joint"):
            kinematics.require_torque(driven(given, given.chain.torque / 10), found, t)


def driven(given: Arm, limit: Floats) -> System:
    """An arm as a plant whose motors have so much torque."""
    linear = Matrices(
        np.zeros((2 * given.joint_count,) * 2),
        np.zeros((2 * given.joint_count, given.joint_count)),
        np.eye(given.joint_count, 2 * given.joint_count),
    )
    return System(
        given.values,
        lambda p, x, u: x,
        lambda p, x: x[: given.joint_count],
        linear,
        nonlinear=True,
        arm=given,
        flat=build_flat_joints(given),
        limit=limit,
    )


def number(pattern: str, error: pytest.ExceptionInfo[TrackingError]) -> list[float]:
    import re

    found = re.search(pattern.replace("#", r"(-?[\d.]+(?:e-?\d+)?)"), str(error.value))
    assert found, str(error.value)
    return [float(group) for group in found.groups()]


@pytest.mark.parametrize("start", ELBOWS)
@pytest.mark.parametrize(
    ("centre", "beyond"),
    [
        ([0.6, 0.1], np.hypot(0.6, 0.1) + 0.15 - 0.7),
        ([1.5, 0.0], 0.95),
        ([0.1, 0.0], 0.1 - (0.15 - 0.1)),
    ],
)
def test_unreachable_points_are_reported_with_their_distance(
    centre: list[float], beyond: float, start: list[float]
) -> None:
    """The two-link arm reaches from 0.1 m to 0.7 m from its base."""
    with pytest.raises(TrackingError, match=r"^reference: the tip cannot get to") as error:
        joints(TWO_LINK, tip_path(changed(CIRCLE, centre=centre)), start)
    x, y, t, distance, leaves = number(
        r"\(#, #\) m at t = # s, it comes no nearer than # m; .* at about t = # s", error
    )
    assert distance == pytest.approx(beyond, rel=0.05)  # among the instants looked at
    assert distance == pytest.approx(max(np.hypot(x, y) - 0.7, 0.1 - np.hypot(x, y)), abs=1e-3)
    path = tip_path(changed(CIRCLE, centre=centre))
    assert path.output_at(np.array([t]))[0] == pytest.approx([x, y], abs=2e-3)
    inside = np.hypot(*path.output_at(np.linspace(0, max(leaves - 3e-3, 0), 100)).T)
    assert leaves == 0 or ((inside >= 0.1) & (inside <= 0.7)).all()


def test_singular_configurations() -> None:
    with pytest.raises(
        TrackingError, match=r"singular at the start of the path, q = 0.3, 0: .*plant.x0"
    ):
        joints(TWO_LINK, tip_path(CIRCLE), [0.3, 0.0])
    touch = Quintic(points=[[0.3, 0.0], [0.7, 0.0], [0.3, 0.2]], times=[0.0, 2.0, 4.0])
    with pytest.raises(TrackingError, match=r"singular configuration at about t = (1.9|2)"):
        joints(
            TWO_LINK,
            tip_path(changed(touch, points=[[0.3, 0.0], [0.7, 0.0], [0.3, 0.0]])),
            ELBOWS[0],
        )
    given, start = spatial(6), np.array([0.2, 0.5, 0.9, 0.3, -0.8, 0.7])
    away = given.tip(given.values, start).full().ravel() * [-1, -1, 1]
    with pytest.raises(
        TrackingError,
        match=r"cannot follow beyond .* keeps the tip's orientation|singular configuration",
    ):
        joints(
            given,
            tip_path(
                Quintic(
                    points=[given.tip(given.values, start).full().ravel(), away], times=[0.0, 5.0]
                ),
                3,
            ),
            start,
            step=1e-2,
        )


def test_limits_of_the_joints() -> None:
    free = joints(TWO_LINK, tip_path(CIRCLE), ELBOWS[0])
    q, v = (free.output_at(np.arange(4002) * 2e-3, order) for order in (0, 1))
    for chain, words in [
        (
            TWO_LINK.chain._replace(limits=np.array([[-9.0, 9.0], [-2.0, 2.0]])),
            rf"position of {q[:, 1].max():.4g} from q2 at t = # s, which allows -2 to 2 \[rad",
        ),
        (
            TWO_LINK.chain._replace(speed=np.array([0.1, np.inf])),
            rf"speed of -?{np.abs(v[:, 0]).max():.4g} from q1 at t = # s, "
            r"which allows -0.1 to 0.1 \[rad/s",
        ),
    ]:
        with pytest.raises(TrackingError, match=r"^reference: the path needs a") as error:
            joints(build_arm(chain), tip_path(CIRCLE), ELBOWS[0])
        (t,) = number(words, error)
        extreme = q[:, 1] if "position" in words else np.abs(v[:, 0])
        assert extreme[round(t / 2e-3)] == pytest.approx(extreme.max(), abs=1e-5)
    joints(
        build_arm(
            TWO_LINK.chain._replace(
                limits=np.array([[-1.0, 1.4], [-0.2, 2.5]]), speed=np.abs(v).max(axis=0) + 0.01
            )
        ),
        tip_path(CIRCLE),
        ELBOWS[0],
    )


def test_torque_limits() -> None:
    path = joints(TWO_LINK, tip_path(CIRCLE), ELBOWS[0])
    t = np.arange(4001) * 2e-3
    q, v, a = (path.output_at(t, order) for order in range(3))
    torques = np.stack(
        [
            (
                TWO_LINK.mass(TWO_LINK.values, *now[:1]) @ now[2]
                + TWO_LINK.bias(TWO_LINK.values, *now[:2])
            )
            .full()
            .ravel()
            for now in zip(q, v, a, strict=True)
        ]
    )
    most = np.abs(torques).max(axis=0)
    kinematics.require_torque(driven(TWO_LINK, most * 1.001), path, t)
    with pytest.raises(TrackingError, match=r"^reference: the path needs a torque") as error:
        kinematics.require_torque(driven(TWO_LINK, np.array([np.inf, most[1] / 2])), path, t)
    value, when, bound = number(
        r"torque of # from q2 at t = # s, which allows -[\d.]+ to # \[N m", error
    )
    assert (abs(value), bound) == (
        pytest.approx(most[1], rel=1e-3),
        pytest.approx(most[1] / 2, rel=1e-3),
    )
    assert torques[np.abs(t - when).argmin(), 1] == pytest.approx(value, rel=1e-3)


def test_too_few_joints() -> None:
    with pytest.raises(
        TrackingError,
        match=r"reference.space: an arm with 1 joint cannot .* 2 coordinates. "
        r"Give the joints' path",
    ):
        joints(build_arm(build.build_one_link()), tip_path(CIRCLE), [0.3])


@pytest.mark.parametrize("harmonics", [[1], [1, 2]])
def test_the_closure_holds_on_waves_that_turn_evenly(harmonics: list[int]) -> None:
    w, t = 1.7, np.linspace(0.0, 3.0, 20)
    angle = [w * t, np.full_like(t, w), *[np.zeros_like(t)] * (paths.ORDER - 1)]
    waves = paths._wave_derivatives(np.array(harmonics), [part[:, None] for part in angle])
    next_derivative = (1j * w * np.array(harmonics)) ** (paths.ORDER + 1) * waves[:, 0]
    closure = paths._harmonic_closure(np.array(harmonics), w)
    assert np.einsum("i,nik->nk", closure, waves) == pytest.approx(next_derivative, rel=1e-12)


def test_mapped_functions_are_those_of_each_row() -> None:
    q = ca.SX.sym("q", 2)
    function = ca.Function("f", [q], [ca.sin(q), ca.diag(q)])
    rows = np.random.default_rng(0).normal(size=(5, 2))
    sines, diagonals = evaluate_at_inputs(function, rows)
    assert sines[:, :, 0] == pytest.approx(np.sin(rows))
    assert diagonals == pytest.approx(np.array([np.diag(row) for row in rows]))
    (one,) = evaluate_at_inputs(ca.Function("g", [q], [ca.sin(q)]), rows)
    assert one == pytest.approx(sines)


def test_solved_and_singular_jacobians() -> None:
    J = np.array([np.eye(2), np.diag([1.0, 1e-5]), np.diag([1.0, -2.0])])
    assert singular(J).tolist() == [False, True, True]
    goals = np.array([[1.0, 2.0], [3.0, 4e-5], [5.0, 6.0]])
    assert solve_jacobians(J, goals) == pytest.approx(
        np.array([[1.0, 2.0], [3.0, 4.0], [5.0, -3.0]])
    )


def test_the_equations_of_an_arm_hold_where_it_starts() -> None:
    """Three equations place the tip in space; the joint to spare keeps its part at 0."""
    body, start = spatial(4), np.array([0.3, 0.4, -0.6, 0.2])
    equations = equations_of(body, body.values, start)
    place, J = (part.full() for part in equations.constraint(start))
    tip = body.tip(body.values, start).full().ravel()
    assert place.ravel() == pytest.approx([*tip / equations.reach, 0.0])
    assert equations.goals(tip[None]) == pytest.approx(place.T)
    assert abs(np.linalg.det(J)) > 1e-3
    angles = nearest(equations.constraint, place.ravel(), start + 0.05)
    assert angles == pytest.approx(start, abs=1e-9)
