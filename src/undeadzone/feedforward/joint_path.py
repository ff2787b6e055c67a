"""From a path of an arm's tip to the path of its joints (inverse kinematics), and whether the joints can follow it."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import TrackingError
from undeadzone.feedforward.targets import flat_targets
from undeadzone.plants.robots.arm import Arm, Chain
from undeadzone.plants.system import System
from undeadzone.signals.exosystem import Exosystem, piecewise
from undeadzone.support.arrays import Floats, listed

REACHED = 1e-9  # of the arm's reach: largest residual of a position that counts as found
SINGULAR = 1e-4  # least over greatest singular value of the Jacobian
NEWTON = 3  # steps from one position to the next, and from the interpolated one to the exact
JUMP = 0.3  # [rad] from where the speed leads within one step: another solution
LOOKS = 50  # positions from the start to the path; instants of an unreachable path at which the shortfall is computed


class _Equations(NamedTuple):
    """place(q) = goal, as many as joints: the tip's position over the arm's reach [m], then what the arm keeps at 0.

    place: q -> its value and Jacobian; swing: (q, v) -> its second derivative at constant v; tip: q -> the tip's position over the reach and its Jacobian.
    """

    place: ca.Function
    swing: ca.Function
    tip: ca.Function
    reach: float

    def goals(self, positions: Floats) -> Floats:
        """The goals (N x joints) for positions of the tip (N x 2 or 3), or for their derivatives."""
        return np.pad(
            positions / self.reach, ((0, 0), (0, self.place.size1_in(0) - positions.shape[1]))
        )


def joint_path(
    arm: Arm,
    params: Floats,
    task: Exosystem,
    duration: float,
    step: float,
    start: Floats,
    key: str = "reference",
) -> Exosystem:
    """The joints' path q, with two derivatives, that moves the tip along `task`, for 0 <= t <= duration + step [s].

    start: joint angles near which it begins, which choose among elbow up and down. An arm in space with six joints or more keeps the orientation that its
    tip has there; joints beyond those needed keep their part in the null space of the Jacobian at `start` (extended Jacobian: Baillieul 1985).
    Every `step` [s] the path is checked: raises TrackingError where the tip cannot get, at singular configurations, beyond a joint's limit or speed.
    """
    from scipy.interpolate import CubicHermiteSpline

    equations = _equations(arm, params, start, key)
    t = np.arange(int(np.ceil(duration / step)) + 2) * step
    goals = equations.goals(task.value(t))
    q = _followed(equations, goals, start)
    found, J = _mapped(equations.place, q)
    missed = ~(np.abs(found[:, :, 0] - goals).max(axis=1) < REACHED)
    if (stops := np.flatnonzero(missed | _singular(np.nan_to_num(J)))).size:
        raise _blocked(
            equations, task, t[stops[0] :], q[max(stops[0] - 1, 0)], bool(missed[stops[0]]), key
        )
    v = _solved(J, equations.goals(task.value(t, 1)))
    if (
        jumps := np.flatnonzero(
            np.abs(np.diff(q, axis=0) - step / 2 * (v[:-1] + v[1:])).max(axis=1) > JUMP
        )
    ).size:
        raise _blocked(equations, task, t[jumps[0] :], q[jumps[0]], False, key)
    require_range(arm.chain, t, q, v, key)
    nearby = CubicHermiteSpline(t, q, v)

    def derivatives(at: Floats) -> Floats:
        if at.size == 0:
            return np.empty((0, 3, arm.size))
        if at.max() > t[-1]:
            raise TrackingError(
                f"{key}: the joints' path is known up to t = {t[-1]:g} s, not at {at.max():g} s"
            )
        q, goals = nearby(at), equations.goals(task.value(at))
        for _ in range(NEWTON):
            found, J = _mapped(equations.place, q)
            q = q - _solved(J, found[:, :, 0] - goals)
        _, J = _mapped(equations.place, q)
        v = _solved(J, equations.goals(task.value(at, 1)))
        (swing,) = _mapped(equations.swing, q, v)
        return np.stack(
            [q, v, _solved(J, equations.goals(task.value(at, 2)) - swing[:, :, 0])], axis=1
        )

    path = piecewise(derivatives, arm.size)._replace(corners=task.corners)
    closes = (
        task.period is not None
        and task.period <= t[-1]
        and np.ptp(path.value(np.array([0.0, task.period])), axis=0).max() < 1e-6
    )
    return path._replace(period=task.period if closes else None)


def require_range(chain: Chain, t: Floats, q: Floats, v: Floats, key: str = "reference") -> None:
    """Raise TrackingError where positions or speeds of the joints (N x joints) at times t [s] lie beyond what the joints allow."""
    advice = "move the path, or let the arm start from another configuration (plant.x0)"
    _require_within(
        f"{key}: the path needs a position", "rad or m", t, q, chain.limits, chain.joints, advice
    )
    _require_within(
        f"{key}: the path needs a speed",
        "rad/s or m/s",
        t,
        v,
        np.outer(chain.speed, [-1, 1]),
        chain.joints,
        "slow the path down",
    )


def require_torque(model: System, path: Exosystem, t: Floats, key: str = "reference") -> None:
    """Raise TrackingError where a path of a continuous model's flat coordinates needs more torque at times t [s] than its motors have."""
    assert model.arm is not None
    assert model.limit is not None
    needed = flat_targets(model, path, [0], t).u_ff
    advice = "slow the path down, lighten the arm, or raise the limit"
    _require_within(
        f"{key}: the path needs a torque",
        "N m or N",
        t,
        needed,
        np.outer(model.limit, [-1, 1]),
        model.arm.chain.joints,
        advice,
    )


def _equations(arm: Arm, params: Floats, start: Floats, key: str) -> _Equations:
    q, v = (ca.SX.sym(name, arm.size) for name in "qv")
    numbers = ca.SX(params)
    tip = arm.tip(numbers, q)
    if arm.size < tip.numel():
        raise TrackingError(
            f"{key}.space: an arm with {arm.size} joint{'s' * (arm.size > 1)} cannot move its tip along a path in {tip.numel()} coordinates; "
            "give the joints' path (space = 'joint')"
        )
    reach = float(np.linalg.norm(np.diff(arm.points(params, start).full(), axis=0), axis=1).sum())
    place = tip / reach
    if tip.numel() == 3 and arm.size >= 6:
        W = ca.DM(arm.turn(params, start)).T @ arm.turn(numbers, q)
        place = ca.vertcat(
            place, 2 / (1 + ca.trace(W)) * ca.inv_skew(W - W.T)
        )  # 2 tan(angle / 2) about the axis: 0 at W = I alone
    (_, J), free = _mapped(_with_jacobian(q, place), start[None]), arm.size - place.numel()
    if _singular(J).any():
        raise TrackingError(
            f"{key}: the arm is singular where the path starts from, q = {listed(start)}: its tip cannot move in every direction there; "
            "let it start from another configuration (plant.x0)"
        )
    place = ca.vertcat(place, np.linalg.svd(J[0])[2][arm.size - free :] @ (q - start))
    swing = ca.jtimes(ca.jtimes(place, q, v), q, v)
    return _Equations(
        _with_jacobian(q, place),
        ca.Function("swing", [q, v], [swing], {"cse": True}),
        _with_jacobian(q, tip / reach),
        reach,
    )


def _with_jacobian(q: ca.SX, value: ca.SX) -> ca.Function:
    return ca.Function("place", [q], [value, ca.densify(ca.jacobian(value, q))], {"cse": True})


def _mapped(function: ca.Function, *columns: Floats) -> list[Floats]:
    """The function's values (N x rows x columns each) at N inputs (N x size each)."""
    count = len(columns[0])
    values = function.map(count)(*(column.T for column in columns))
    return [
        value.full().reshape(value.shape[0], count, -1).swapaxes(0, 1)
        for value in (values if isinstance(values, tuple) else (values,))
    ]


def _solved(J: Floats, goals: Floats) -> Floats:
    return np.linalg.solve(J, goals[:, :, None])[:, :, 0]


def _singular(J: Floats) -> np.ndarray:
    """Which matrices are nearly singular, or have a determinant of another sign than the first one."""
    sizes = np.linalg.svd(J, compute_uv=False)
    near = sizes[:, -1] < SINGULAR * sizes[:, 0]
    return near if J.shape[1] < J.shape[2] else near | (np.linalg.det(J) * np.linalg.det(J[:1]) < 0)


def _followed(equations: _Equations, goals: Floats, start: Floats) -> Floats:
    """Positions (N x joints) at which the equations meet their goals, each by Newton's method from the one before; the first from `start`."""
    q, goal = ca.SX.sym("q", start.size), ca.SX.sym("goal", start.size)
    after = q
    for _ in range(NEWTON):
        found, J = equations.place(after)
        D, L, order = ca.ldl(J.T @ J + 1e-12 * ca.SX.eye(start.size))
        after = after - ca.ldl_solve(J.T @ (found - goal), D, L, order)
    follow = ca.Function("follow", [q, goal], [after], {"cse": True})
    here = equations.place(start)[0].full().ravel()
    arrived = follow.mapaccum(LOOKS)(start, np.linspace(here, goals[0], LOOKS).T).full()[
        :, -1
    ]  # in a straight line, where there is no gap
    straight = np.abs(equations.place(arrived)[0].full().ravel() - goals[0]).max() < REACHED
    first = arrived if straight else _nearest(equations.place, goals[0], start)
    return follow.mapaccum(len(goals))(first, goals.T).full().T


def _nearest(function: ca.Function, goal: Floats, start: Floats) -> Floats:
    """The joint angles, from `start` on, at which the function comes nearest to its goal (least squares)."""
    from scipy.optimize import least_squares

    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14)
    return least_squares(
        lambda q: function(q)[0].full().ravel() - goal,
        start,
        lambda q: function(q)[1].full(),
        **tight,
    ).x


def _blocked(
    equations: _Equations, task: Exosystem, t: Floats, before: Floats, missed: bool, key: str
) -> TrackingError:
    """What keeps the tip from following the path from t[0] on, after joint angles `before`."""
    looks = t[np.unique(np.linspace(0, t.size - 1, LOOKS).astype(int))]
    positions, short, angles = task.value(looks), np.zeros(looks.size), before
    for i, position in enumerate(positions):
        angles = _nearest(equations.tip, position / equations.reach, angles)
        short[i] = equations.reach * np.linalg.norm(
            equations.tip(angles)[0].full().ravel() - position / equations.reach
        )
    worst = int(short.argmax())
    if short[worst] > 1e-6 * equations.reach:
        return TrackingError(
            f"{key}: the tip cannot get to ({listed(positions[worst])}) m at t = {looks[worst]:.4g} s, it comes no nearer than {short[worst]:.3g} m; "
            f"the path leaves the arm's reach at about t = {looks[0]:.4g} s"
        )
    if missed and equations.place.size1_out(0) > equations.tip.size1_out(0):
        return TrackingError(
            f"{key}: the arm cannot follow beyond t = {t[0]:.4g} s, near q = {listed(before)}, while it keeps the tip's orientation, or its joints to spare, "
            "as where it starts; move the path, or let the arm start from another configuration (plant.x0)"
        )
    return TrackingError(
        f"{key}: the path meets a singular configuration at about t = {t[0]:.4g} s, near q = {listed(before)}, where the joints' speeds have no bound, "
        "or it is too fast for steps as long as simulation.step; move it or slow it down"
    )


def _require_within(
    does: str,
    unit: str,
    t: Floats,
    values: Floats,
    bounds: Floats,
    joints: tuple[str, ...],
    advice: str,
) -> None:
    """Raise TrackingError where values (N x joints) lie beyond the bounds (joints x 2), for the joint and the first instant that are farthest off."""
    excess = np.round(np.maximum(values - bounds[:, 1], bounds[:, 0] - values), 6)
    node, joint = np.unravel_index(int(excess.argmax()), excess.shape)
    if excess[node, joint] > 0:
        low, high = bounds[joint]
        raise TrackingError(
            f"{does} of {values[node, joint]:.4g} from {joints[joint]} at t = {t[node]:.4g} s, which allows {low:.4g} to {high:.4g} [{unit}]; {advice}"
        )
