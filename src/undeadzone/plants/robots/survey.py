"""Survey of an arm in a URDF file: its joints, its reach, and its holding torques."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.plants.robots import urdf
from undeadzone.plants.robots.arm import Arm, build_arm, evaluate_rows
from undeadzone.plants.robots.urdf_elements import MOVABLE, Joint, Robot, read_urdf
from undeadzone.util.arrays import Array, Floats, require_vector

POSTURES = 4096  # random ones, from the best of which the reach is climbed
CLIMBS = 8
NEAR = 0.1  # of the range between two limits: a joint that stands closer to one stands at it


class Survey(NamedTuple):
    """Arm of N joints in one posture.

    Attributes:
        body: the arm.
        robot: the whole tree of the file.
        base, tip: links in which the arm begins and ends.
        joints: the moving joints, from base to tip (N).
        fixed: names of joints that could move and are fixed at 0.
        masses: mass between each joint and the next one (N) [kg].
        q: the posture (N) [rad or m].
        place: position of the tip in that posture (3) [m].
        holding: torques or forces that hold the arm in that posture (N) [N m or N].
        reach: greatest distance of the tip from the first joint's place at q = 0, within the limits
            [m] (None if a sliding joint has no limits).
    """

    body: Arm
    robot: Robot
    base: str
    tip: str
    joints: list[Joint]
    fixed: list[str]
    masses: Floats
    q: Floats
    place: Floats
    holding: Floats
    reach: float | None


def survey_urdf(
    path: str | os.PathLike[str],
    joints: Sequence[str] | None = None,
    tip: str | None = None,
    at: Array | None = None,
) -> Survey:
    """Survey an arm in a URDF file: return its joints, masses, reach and holding torques.

    Args:
        path: the file.
        joints: names of the joints that move (N), as in `plant.arm.joints`.
        tip: the link in which the arm ends, as in `plant.arm.tip`.
        at: the posture (N) [rad or m] (default 0, or the middle if 0 is near a limit or beyond it).

    Raises:
        FileError: the file, or its contents.
        InputError: joints, tip, at, or adam-robotics is missing.
    """
    body = build_arm(urdf.load_urdf_chain(path, joints, tip))
    robot = read_urdf(Path(path))
    moving, tip = urdf.select_joints(robot, joints, tip)
    limits = body.chain.limits
    q = (
        _default_posture(limits)
        if at is None
        else require_vector("at", at, body.joint_count, "one per moving joint")
    )
    _require_within_limits(moving, q)
    movable = [joint.name for joint in robot.joints if joint.kind in MOVABLE]
    return Survey(
        body=body,
        robot=robot,
        base=moving[0].parent,
        tip=tip,
        joints=moving,
        fixed=[name for name in movable if name not in body.chain.joints],
        masses=body.values[: body.joint_count],
        q=q,
        place=body.points(body.values, q).full()[-1],
        # At rest, M q'' + h(q, q') = tau leaves tau = h(q, 0): gravity alone.
        holding=body.bias(body.values, q, np.zeros(body.joint_count)).full().ravel(),
        reach=_compute_reach(body, moving),
    )


def _default_posture(limits: Floats) -> Floats:
    """Return 0, or the middle between two limits if 0 is near a limit or beyond it (N) [rad or
    m].
    """
    q = np.zeros(len(limits))
    for i, (low, high) in enumerate(limits):
        room = NEAR * (high - low)
        if np.isfinite(room) and not low + room <= 0 <= high - room:
            q[i] = (low + high) / 2
        elif not low < 0 < high:
            q[i] = low + 1 if np.isfinite(low) else high - 1
    return q


def _require_within_limits(moving: list[Joint], q: Floats) -> None:
    """Raise InputError if a posture lies beyond the limits."""
    for i, (joint, value) in enumerate(zip(moving, q, strict=True)):
        low, high = joint.limits
        if not low <= value <= high:
            raise InputError(
                f"at[{i}]: {joint.name} moves from {low:g} to {high:g}, found {value:g}"
            )


def _compute_reach(body: Arm, moving: list[Joint]) -> float | None:
    """Return the greatest distance of the tip from the first joint: climbed from the best
    postures.
    """
    from scipy.optimize import minimize

    low, high = body.chain.limits.T.copy()
    for i, joint in enumerate(moving):
        if joint.kind != "prismatic":
            low[i] = max(low[i], -np.pi)
            high[i] = min(high[i], np.pi)
            if low[i] >= high[i]:  # limits beyond half a turn to one side
                low[i], high[i] = joint.limits
    if not np.isfinite([low, high]).all():
        return None
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, body.joint_count))
    points = evaluate_rows(body.points, body.values, postures)
    origin = body.points(body.values, np.zeros(body.joint_count))[1, :]  # a sliding joint leaves it
    distances = np.linalg.norm(points[:, -1] - origin.full(), axis=1)
    best = postures[np.argsort(distances)[-CLIMBS:]]
    q = ca.SX.sym("q", body.joint_count)
    squared = -ca.sumsqr(body.points(ca.SX(body.values), q)[-1, :] - origin)
    slope = ca.Function("slope", [q], [squared, ca.gradient(squared, q)])

    def negative_reach(at: Floats) -> tuple[float, Floats]:
        """Return the value and its gradient at a posture."""
        found, gradient = slope(at)
        return float(found), gradient.full().ravel()

    bounds = list(zip(low, high, strict=True))
    tops = [minimize(negative_reach, start, jac=True, bounds=bounds).fun for start in best]
    return float(np.sqrt(max(0.0, -min(tops))))
