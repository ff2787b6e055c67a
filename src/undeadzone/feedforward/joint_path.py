"""From a path of an arm's tip to the path of its joints (inverse kinematics).

The joints meet the equations that put the tip on its target.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, TrackingError
from undeadzone.feedforward.targets import flat_targets
from undeadzone.plants.robots.arm import Arm, Chain
from undeadzone.plants.system import System
from undeadzone.signals.exosystem import Exosystem, build_exosystem, piecewise_exosystem
from undeadzone.signals.paths import Quintic, Swing
from undeadzone.util.arrays import Floats, list_numbers, require_matrix, require_series

JUMP = 0.3  # [rad] from the position predicted by the speed: another solution
SHORT = 1e-6  # of the arm's reach: a tip farther than this from its goal does not get there
OTHER_START = "move the path, or let the arm start from another configuration (plant.x0)"
REACHED = 1e-9  # of the arm's reach: largest residual of a position that counts as found
SINGULAR = 1e-4  # least over greatest singular value of the Jacobian
NEWTON = 3  # steps from one position to the next, and from the interpolated one to the exact
LOOKS = 50  # positions on the way to the path; instants at which an unreachable path is looked at


def joint_path(
    arm: Arm,
    params: Floats,
    task: Exosystem,
    duration: float,
    step: float,
    start: Floats,
) -> Exosystem:
    """Return the joints' path q, with two derivatives, that moves an arm's tip along a path.

    It holds for 0 <= t <= duration + step. An arm in space with six joints or more keeps the
    orientation that its tip has at the start. Joints beyond those needed keep their part in the
    null space of the Jacobian at `start` (extended Jacobian: Baillieul 1985).

    Args:
        arm: the arm.
        params: its parameters.
        task: the path of its tip [m].
        duration: duration of the path [s].
        step: between the instants at which the path is checked [s].
        start: joint angles near which it begins, which choose among elbow up and down (N) [rad].

    Raises:
        TrackingError: the tip cannot get there, or a joint meets a singular configuration or its
            limits.
    """
    from scipy.interpolate import CubicHermiteSpline

    equations = equations_of(arm, params, start)
    t = np.arange(int(np.ceil(duration / step)) + 2) * step
    q, v = _interpolate_nodes(equations, task, t, start)
    require_range(arm.chain, t, q, v)
    nearby = CubicHermiteSpline(t, q, v)

    def derivatives(at: Floats) -> Floats:
        if at.size == 0:
            return np.empty((0, 3, arm.joint_count))
        if at.max() > t[-1]:
            raise TrackingError(
                f"reference: the joints' path is known up to t = {t[-1]:g} s, not at {at.max():g} s"
            )
        return _refine_path(equations, task, at, nearby(at))

    path = piecewise_exosystem(derivatives, arm.joint_count)._replace(corners=task.corners)
    period = task.period if _closes(path, task.period, t[-1]) else None
    return path._replace(period=period)


def after_swing(path: Exosystem, swing: Swing) -> Exosystem:
    """Return a path of joints that begins after they have swung through points and back.

    Args:
        path: the path, which begins at rest.
        swing: motion that the joints make first.

    Raises:
        InputError: or a subclass, for points and times that cannot be.
    """
    key = "reference.swing"
    begin = path.output_at(np.zeros(1))
    joints = begin.shape[1]
    if path.output_at(np.zeros(1), 1).any():
        raise InputError(f"{key}: the path that follows must begin at rest. Set reference.ramp")
    points = require_matrix(f"{key}.points", swing.points, None, joints, "a row per point")
    times = require_series(f"{key}.times", swing.times)
    through = Quintic(
        points=np.vstack([begin, points, begin]),
        times=np.concatenate([[0.0], times, [swing.until]]),
    )
    first = build_exosystem(key, through, joints)

    def derivatives(t: Floats) -> Floats:
        later = np.maximum(t - swing.until, 0.0)
        orders = range(3)
        swung = np.stack([first.output_at(t, order) for order in orders], axis=1)
        following = np.stack([path.output_at(later, order) for order in orders], axis=1)
        return np.where((t < swing.until)[:, None, None], swung, following)

    corners = np.concatenate([first.corners, path.corners + swing.until])
    return piecewise_exosystem(derivatives, joints)._replace(corners=np.unique(corners))


def _interpolate_nodes(
    equations: Equations, task: Exosystem, t: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Return positions and speeds (N x joints) at times t [s].

    Raises TrackingError if the tip cannot reach the path, if the arm is singular, or if its joints
    jump.
    """
    goals = equations.goals(task.output_at(t))
    q = follow_path(equations, goals, start)
    values, J = evaluate_at_inputs(equations.constraint, q)
    missed = ~(np.abs(values[:, :, 0] - goals).max(axis=1) < REACHED)
    stops = np.flatnonzero(missed | singular(np.nan_to_num(J)))
    if stops.size:
        stop = stops[0]
        before = q[max(stop - 1, 0)]
        raise _blocking_reason(equations, task, t[stop:], before, bool(missed[stop]))
    v = solve_jacobians(J, equations.goals(task.output_at(t, 1)))
    step = t[1] - t[0]
    expected = step / 2 * (v[:-1] + v[1:])
    jumps = np.flatnonzero(np.abs(np.diff(q, axis=0) - expected).max(axis=1) > JUMP)
    if jumps.size:
        jump = jumps[0]
        raise _blocking_reason(equations, task, t[jump:], q[jump], False)
    return q, v


def _refine_path(equations: Equations, task: Exosystem, t: Floats, nearby: Floats) -> Floats:
    """Return positions, speeds and accelerations of the joints at N times (N x 3 x joints).

    Args:
        equations: equations h(q) = goal of the arm.
        task: path of the tip [m].
        t: the times (N) [s].
        nearby: positions from which Newton's method converges (N x joints) [rad].
    """
    q = nearby
    goals = equations.goals(task.output_at(t))
    for _ in range(NEWTON):
        values, J = evaluate_at_inputs(equations.constraint, q)
        q = q - solve_jacobians(J, values[:, :, 0] - goals)
    _, J = evaluate_at_inputs(equations.constraint, q)
    # Two derivatives of h(q) = goal by time: J q' = goal', and J q'' + J' q' = goal''.
    v = solve_jacobians(J, equations.goals(task.output_at(t, 1)))
    (bias,) = evaluate_at_inputs(equations.bias_acceleration, q, v)
    a = solve_jacobians(J, equations.goals(task.output_at(t, 2)) - bias[:, :, 0])
    return np.stack([q, v, a], axis=1)


def _closes(path: Exosystem, period: float | None, end: float) -> bool:
    """Return whether the joints return to their start after a period [s], known up to `end` [s]."""
    if period is None or period > end:
        return False
    both_ends = path.output_at(np.array([0.0, period]))
    return bool(np.ptp(both_ends, axis=0).max() < 1e-6)


def require_range(chain: Chain, t: Floats, q: Floats, v: Floats) -> None:
    """Raise TrackingError if positions or speeds lie beyond the joints' limits.

    Args:
        chain: the arm's links.
        t: times (N) [s].
        q: positions (N x joints) [rad or m].
        v: speeds (N x joints) [rad/s or m/s].
    """
    places = "a position", "rad or m", OTHER_START
    _require_within(places, chain.joints, t, q, chain.limits)
    speeds = "a speed", "rad/s or m/s", "slow the path down"
    _require_within(speeds, chain.joints, t, v, np.outer(chain.speed, [-1, 1]))


def require_torque(model: System, path: Exosystem, t: Floats) -> None:
    """Raise TrackingError if a path needs more torque than the motors have.

    Args:
        model: a continuous model of an arm.
        path: the path of its flat coordinates.
        t: times (N) [s].
    """
    assert model.arm is not None
    assert model.limit is not None
    torques = "a torque", "N m or N", "slow the path down, lighten the arm, or raise the limit"
    needed = flat_targets(model, path, [0], t).u_ff
    _require_within(torques, model.arm.chain.joints, t, needed, np.outer(model.limit, [-1, 1]))


def _blocking_reason(
    equations: Equations, task: Exosystem, t: Floats, before: Floats, missed: bool
) -> TrackingError:
    """Return the error with the reason why the tip cannot follow the path.

    Args:
        equations: equations of the arm.
        task: path of its tip [m].
        t: times of the part of the path that is not followed (N) [s].
        before: last joint angles on the path (joints) [rad].
        missed: whether the equations have no solution at t[0], so that it is not singular.
    """
    looks = t[np.unique(np.linspace(0, t.size - 1, LOOKS).astype(int))]
    positions = task.output_at(looks)
    short = _shortfall(equations, positions, before)
    worst = int(short.argmax())
    if short[worst] > SHORT * equations.reach:
        return TrackingError(
            f"reference: the tip cannot get to ({list_numbers(positions[worst])}) m at "
            f"t = {looks[worst]:.4g} s, it comes no nearer than {short[worst]:.3g} m; "
            f"the path leaves the arm's reach at about t = {looks[0]:.4g} s"
        )
    if missed and equations.constraint.size1_out(0) > equations.tip.size1_out(0):
        return TrackingError(
            f"reference: the arm cannot follow beyond t = {t[0]:.4g} s, "
            f"near q = {list_numbers(before)}, "
            "while it keeps the tip's orientation, or its joints to spare, as where it starts; "
            f"{OTHER_START}"
        )
    return TrackingError(
        f"reference: the path meets a singular configuration at about t = {t[0]:.4g} s, "
        f"near q = {list_numbers(before)}, where the joints' speeds have no bound, "
        "or it is too fast for steps as long as simulation.step: move it or slow it down"
    )


def _shortfall(equations: Equations, positions: Floats, start: Floats) -> Floats:
    """Return the distance that remains between the tip and each of N positions (N) [m]."""
    short = np.zeros(len(positions))
    angles = start
    for i, position in enumerate(positions):
        goal = position / equations.reach
        angles = nearest(equations.tip, goal, angles)
        gap = equations.tip(angles)[0].full().ravel() - goal
        short[i] = equations.reach * np.linalg.norm(gap)
    return short


def _require_within(
    words: tuple[str, str, str], joints: tuple[str, ...], t: Floats, values: Floats, bounds: Floats
) -> None:
    """Raise TrackingError where values (N x joints) lie beyond the bounds (joints x 2).

    It names the joint and the first instant that are farthest off.

    words: name of the quantity that a path needs of the joints, its unit, and advice if a joint
    cannot.
    """
    what, unit, advice = words
    excess = np.round(np.maximum(values - bounds[:, 1], bounds[:, 0] - values), 6)
    node, joint = np.unravel_index(int(excess.argmax()), excess.shape)
    if excess[node, joint] > 0:
        low, high = bounds[joint]
        raise TrackingError(
            f"reference: the path needs {what} of {values[node, joint]:.4g} from {joints[joint]} "
            f"at t = {t[node]:.4g} s, which allows {low:.4g} to {high:.4g} [{unit}]; {advice}"
        )


class Equations(NamedTuple):
    """Equations h(q) = goal of an arm's inverse kinematics, as many as joints.

    h(q) is the tip's position over the arm's reach, then the residuals that the arm keeps at 0:
    of the tip's orientation, and of the null space of the Jacobian at the start.

    Attributes:
        constraint: q -> h and its Jacobian J.
        bias_acceleration: (q, v) -> J' v, the second derivative of h at constant joint speeds v.
        tip: q -> the tip's position over the reach and its Jacobian.
        reach: sum of the lengths between the joints [m].
    """

    constraint: ca.Function
    bias_acceleration: ca.Function
    tip: ca.Function
    reach: float

    def goals(self, positions: Floats) -> Floats:
        """Return the goals of h (N x joints) for positions of the tip (N x 2 or 3) [m].

        The map is linear, so it converts derivatives of positions as well.
        """
        residuals = self.constraint.size1_in(0) - positions.shape[1]
        return np.pad(positions / self.reach, ((0, 0), (0, residuals)))


def equations_of(arm: Arm, params: Floats, start: Floats) -> Equations:
    """Return the equations of an arm that sets out from `start`. Raises TrackingError."""
    q = ca.SX.sym("q", arm.joint_count)
    v = ca.SX.sym("v", arm.joint_count)
    numbers = ca.SX(params)
    tip = arm.tip(numbers, q)
    if arm.joint_count < tip.numel():
        raise TrackingError(
            f"reference.space: an arm with {arm.joint_count} joint{'s' * (arm.joint_count > 1)} "
            f"cannot move its tip along a path in {tip.numel()} coordinates. Give the joints' path "
            "(space = 'joint')"
        )
    reach = float(np.linalg.norm(np.diff(arm.points(params, start).full(), axis=0), axis=1).sum())
    constraint = tip / reach
    if tip.numel() == 3 and arm.joint_count >= 6:
        W = ca.DM(arm.turn(params, start)).T @ arm.turn(numbers, q)  # turn since the start
        # 2 tan(angle / 2) about the axis: 0 at W = I alone.
        rotation = 2 / (1 + ca.trace(W)) * ca.inv_skew(W - W.T)
        constraint = ca.vertcat(constraint, rotation)
    free = arm.joint_count - constraint.numel()  # joints to spare
    _, J = evaluate_at_inputs(_with_jacobian(q, constraint), start[None])
    if singular(J).any():
        raise TrackingError(
            f"reference: the arm is singular at the start of the path, "
            f"q = {list_numbers(start)}: "
            "its tip cannot move in every direction there. "
            "Let it start from another configuration (plant.x0)"
        )
    null_space = np.linalg.svd(J[0])[2][arm.joint_count - free :]
    constraint = ca.vertcat(constraint, null_space @ (q - start))
    bias_acceleration = ca.jtimes(ca.jtimes(constraint, q, v), q, v)
    return Equations(
        _with_jacobian(q, constraint),
        ca.Function("bias_acceleration", [q, v], [bias_acceleration], {"cse": True}),
        _with_jacobian(q, tip / reach),
        reach,
    )


def _with_jacobian(q: ca.SX, value: ca.SX) -> ca.Function:
    """Return q -> the value and its Jacobian."""
    return ca.Function("value", [q], [value, ca.densify(ca.jacobian(value, q))], {"cse": True})


def evaluate_at_inputs(function: ca.Function, *columns: Floats) -> list[Floats]:
    """Return the function's values (N x rows x columns each) at N inputs (N x size each)."""
    count = len(columns[0])
    values = function.map(count)(*[column.T for column in columns])
    if not isinstance(values, tuple):
        values = (values,)
    return [value.full().reshape(value.shape[0], count, -1).swapaxes(0, 1) for value in values]


def solve_jacobians(J: Floats, goals: Floats) -> Floats:
    """Return J^-1 goal for each of N Jacobians and goals (N x joints)."""
    return np.linalg.solve(J, goals[:, :, None])[:, :, 0]


def singular(J: Floats) -> np.ndarray:
    """Return flags of the Jacobians (N x rows x joints) that are singular (N, bool).

    A square Jacobian is also flagged if its determinant has another sign than that of the first
    one: the path has crossed a singular configuration between two samples.
    """
    values = np.linalg.svd(J, compute_uv=False)
    nearly = values[:, -1] < SINGULAR * values[:, 0]
    if J.shape[1] < J.shape[2]:
        return nearly
    return nearly | (np.linalg.det(J) * np.linalg.det(J[:1]) < 0)


def follow_path(equations: Equations, goals: Floats, start: Floats) -> Floats:
    """Return joint positions (N x joints) that meet the equations h(q) = goal.

    Newton's method finds each position from the one before.

    Args:
        equations: equations of the arm.
        goals: goals of h (N x joints).
        start: joint positions from which the first goal is searched (joints).
    """
    q = ca.SX.sym("q", start.size)
    goal = ca.SX.sym("goal", start.size)
    after = q
    for _ in range(NEWTON):
        value, J = equations.constraint(after)
        D, L, order = ca.ldl(J.T @ J + 1e-12 * ca.SX.eye(start.size))
        after = after - ca.ldl_solve(J.T @ (value - goal), D, L, order)
    follow = ca.Function("follow", [q, goal], [after], {"cse": True})
    first = _solve_first(equations, follow, goals[0], start)
    return follow.mapaccum(len(goals))(first, goals.T).full().T


def _solve_first(equations: Equations, follow: ca.Function, goal: Floats, start: Floats) -> Floats:
    """Return joint angles (joints) that meet the first goal (joints).

    Newton's method follows a straight line of goals from `start`. If that fails, least squares
    search for the nearest angles.
    """
    value = equations.constraint(start)[0].full().ravel()
    line = np.linspace(value, goal, LOOKS).T
    angles = follow.mapaccum(LOOKS)(start, line).full()[:, -1]
    residual = np.abs(equations.constraint(angles)[0].full().ravel() - goal).max()
    if residual < REACHED:
        return angles
    return nearest(equations.constraint, goal, start)


def nearest(function: ca.Function, goal: Floats, start: Floats) -> Floats:
    """Return the joint angles at which a function is nearest to a goal, in least squares.

    Args:
        function: q -> value and Jacobian.
        goal: goal of the value (k).
        start: joint angles from which the search starts (joints).
    """
    from scipy.optimize import least_squares

    def gap(q: Floats) -> Floats:
        return function(q)[0].full().ravel() - goal

    def jacobian(q: Floats) -> Floats:
        return function(q)[1].full()

    return least_squares(gap, start, jacobian, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
