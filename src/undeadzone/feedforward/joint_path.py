"""From a path of an arm's tip to the path of its joints (inverse kinematics)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.errors import TrackingError
from undeadzone.feedforward.targets import flat_targets
from undeadzone.feedforward.tip_equations import (
    LOOKS,
    NEWTON,
    REACHED,
    Equations,
    equations_of,
    followed,
    mapped,
    nearest,
    singular,
    solved,
)
from undeadzone.plants.robots.arm import Arm, Chain
from undeadzone.plants.system import System
from undeadzone.signals.exosystem import Exosystem, piecewise
from undeadzone.support.arrays import Floats, listed

JUMP = 0.3  # [rad] from where the speed leads within one step: another solution
SHORT = 1e-6  # of the arm's reach: a tip farther than this from its goal does not get there
OTHER_START = "move the path, or let the arm start from another configuration (plant.x0)"


def joint_path(
    arm: Arm,
    params: Floats,
    task: Exosystem,
    duration: float,
    step: float,
    start: Floats,
    key: str = "reference",
) -> Exosystem:
    """The joints' path q, with two derivatives, that moves an arm's tip along a path.

    It holds for 0 <= t <= duration + step. An arm in space with six joints or more keeps the
    orientation that its tip has at the start; joints beyond those needed keep their part in the
    null space of the Jacobian at `start` (extended Jacobian: Baillieul 1985).

    Args:
        arm: the arm.
        params: its parameters.
        task: the path of its tip [m].
        duration: duration of the path [s].
        step: between the instants at which the path is checked [s].
        start: joint angles near which it begins, which choose among elbow up and down (N) [rad].
        key: name of the path in messages.

    Raises:
        TrackingError: the tip cannot get there, or a joint meets a singular configuration or its
            limits.
    """
    from scipy.interpolate import CubicHermiteSpline

    equations = equations_of(arm, params, start, key)
    t = np.arange(int(np.ceil(duration / step)) + 2) * step
    q, v = _checked_nodes(equations, task, t, start, key)
    require_range(arm.chain, t, q, v, key)
    nearby = CubicHermiteSpline(t, q, v)

    def derivatives(at: Floats) -> Floats:
        if at.size == 0:
            return np.empty((0, 3, arm.size))
        if at.max() > t[-1]:
            raise TrackingError(
                f"{key}: the joints' path is known up to t = {t[-1]:g} s, not at {at.max():g} s"
            )
        return _refined(equations, task, at, nearby(at))

    path = piecewise(derivatives, arm.size)._replace(corners=task.corners)
    period = task.period if _closes(path, task.period, t[-1]) else None
    return path._replace(period=period)


def _checked_nodes(
    equations: Equations, task: Exosystem, t: Floats, start: Floats, key: str
) -> tuple[Floats, Floats]:
    """Positions and speeds (N x joints) at times t [s].

    Raises TrackingError where the tip cannot get, and where the arm is singular or its joints jump.
    """
    goals = equations.goals(task.value(t))
    q = followed(equations, goals, start)
    places, J = mapped(equations.place, q)
    missed = ~(np.abs(places[:, :, 0] - goals).max(axis=1) < REACHED)
    stops = np.flatnonzero(missed | singular(np.nan_to_num(J)))
    if stops.size:
        stop = stops[0]
        before = q[max(stop - 1, 0)]
        raise _blocked(equations, task, t[stop:], before, bool(missed[stop]), key)
    v = solved(J, equations.goals(task.value(t, 1)))
    step = t[1] - t[0]
    expected = step / 2 * (v[:-1] + v[1:])
    jumps = np.flatnonzero(np.abs(np.diff(q, axis=0) - expected).max(axis=1) > JUMP)
    if jumps.size:
        jump = jumps[0]
        raise _blocked(equations, task, t[jump:], q[jump], False, key)
    return q, v


def _refined(equations: Equations, task: Exosystem, t: Floats, nearby: Floats) -> Floats:
    """Exact positions, speeds and accelerations (N x 3 x joints) at times t [s].

    By Newton's method from positions nearby (N x joints).
    """
    q, goals = nearby, equations.goals(task.value(t))
    for _ in range(NEWTON):
        places, J = mapped(equations.place, q)
        q = q - solved(J, places[:, :, 0] - goals)
    _, J = mapped(equations.place, q)
    v = solved(J, equations.goals(task.value(t, 1)))
    (swing,) = mapped(equations.swing, q, v)
    a = solved(J, equations.goals(task.value(t, 2)) - swing[:, :, 0])
    return np.stack([q, v, a], axis=1)


def _closes(path: Exosystem, period: float | None, end: float) -> bool:
    """Whether the joints are back where they began after a period [s], known up to `end` [s]."""
    if period is None or period > end:
        return False
    both_ends = path.value(np.array([0.0, period]))
    return bool(np.ptp(both_ends, axis=0).max() < 1e-6)


def require_range(chain: Chain, t: Floats, q: Floats, v: Floats, key: str = "reference") -> None:
    """Raise TrackingError where positions or speeds lie beyond what the joints allow.

    Args:
        chain: the arm's links.
        t: times (N) [s].
        q: positions (N x joints) [rad or m].
        v: speeds (N x joints) [rad/s or m/s].
        key: name of the path in messages.
    """
    positions = _Needed(f"{key}: the path needs a position", "rad or m", chain.joints, OTHER_START)
    _require_within(positions, t, q, chain.limits)
    speeds = _Needed(
        f"{key}: the path needs a speed", "rad/s or m/s", chain.joints, "slow the path down"
    )
    _require_within(speeds, t, v, np.outer(chain.speed, [-1, 1]))


def require_torque(model: System, path: Exosystem, t: Floats, key: str = "reference") -> None:
    """Raise TrackingError where a path needs more torque than the motors have.

    Args:
        model: a continuous model of an arm.
        path: the path of its flat coordinates.
        t: times (N) [s].
        key: name of the path in messages.
    """
    assert model.arm is not None
    assert model.limit is not None
    torques = _Needed(
        f"{key}: the path needs a torque",
        "N m or N",
        model.arm.chain.joints,
        "slow the path down, lighten the arm, or raise the limit",
    )
    needed = flat_targets(model, path, [0], t).u_ff
    _require_within(torques, t, needed, np.outer(model.limit, [-1, 1]))


def _blocked(
    equations: Equations, task: Exosystem, t: Floats, before: Floats, missed: bool, key: str
) -> TrackingError:
    """Why the tip cannot follow the path.

    Args:
        equations: the equations of the arm.
        task: the path of its tip.
        t: the times of the path from there on (N) [s].
        before: the last joint angles (joints) [rad].
        missed: whether the equations are not met there.
        key: name of the path in messages.
    """
    looks = t[np.unique(np.linspace(0, t.size - 1, LOOKS).astype(int))]
    positions = task.value(looks)
    short = _shortfall(equations, positions, before)
    worst = int(short.argmax())
    if short[worst] > SHORT * equations.reach:
        return TrackingError(
            f"{key}: the tip cannot get to ({listed(positions[worst])}) m at "
            f"t = {looks[worst]:.4g} s, it comes no nearer than {short[worst]:.3g} m; "
            f"the path leaves the arm's reach at about t = {looks[0]:.4g} s"
        )
    if missed and equations.place.size1_out(0) > equations.tip.size1_out(0):
        return TrackingError(
            f"{key}: the arm cannot follow beyond t = {t[0]:.4g} s, near q = {listed(before)}, "
            "while it keeps the tip's orientation, or its joints to spare, as where it starts; "
            f"{OTHER_START}"
        )
    return TrackingError(
        f"{key}: the path meets a singular configuration at about t = {t[0]:.4g} s, "
        f"near q = {listed(before)}, where the joints' speeds have no bound, "
        "or it is too fast for steps as long as simulation.step; move it or slow it down"
    )


def _shortfall(equations: Equations, positions: Floats, start: Floats) -> Floats:
    """How far the tip stays from each of N positions, whatever the joints do (N) [m]."""
    short, angles = np.zeros(len(positions)), start
    for i, position in enumerate(positions):
        goal = position / equations.reach
        angles = nearest(equations.tip, goal, angles)
        gap = equations.tip(angles)[0].full().ravel() - goal
        short[i] = equations.reach * np.linalg.norm(gap)
    return short


class _Needed(NamedTuple):
    """What a path needs of the joints, in words.

    Attributes:
        what: "reference: the path needs a speed".
        unit: its unit.
        joints: names of the joints.
        advice: advice where a joint cannot.
    """

    what: str
    unit: str
    joints: tuple[str, ...]
    advice: str


def _require_within(needed: _Needed, t: Floats, values: Floats, bounds: Floats) -> None:
    """Raise TrackingError where values (N x joints) lie beyond the bounds (joints x 2).

    It names the joint and the first instant that are farthest off.
    """
    excess = np.round(np.maximum(values - bounds[:, 1], bounds[:, 0] - values), 6)
    node, joint = np.unravel_index(int(excess.argmax()), excess.shape)
    if excess[node, joint] > 0:
        low, high = bounds[joint]
        raise TrackingError(
            f"{needed.what} of {values[node, joint]:.4g} from {needed.joints[joint]} "
            f"at t = {t[node]:.4g} s, which allows {low:.4g} to {high:.4g} [{needed.unit}]; "
            f"{needed.advice}"
        )
