"""The equations that the joints of an arm must meet so that its tip is where it should be."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import TrackingError
from undeadzone.plants.robots.arm import Arm
from undeadzone.support.arrays import Floats, listed

REACHED = 1e-9  # of the arm's reach: largest residual of a position that counts as found
SINGULAR = 1e-4  # least over greatest singular value of the Jacobian
NEWTON = 3  # steps from one position to the next, and from the interpolated one to the exact
LOOKS = 50  # positions on the way to the path; instants at which an unreachable path is looked at


class Equations(NamedTuple):
    """place(q) = goal, as many equations as joints.

    They are the tip's position over the arm's reach, then what the arm keeps at 0.

    Attributes:
        place: q -> its value and Jacobian.
        swing: (q, v) -> its second derivative at constant v.
        tip: q -> the tip's position over the reach and its Jacobian.
        reach: sum of the lengths between the joints [m].
    """

    place: ca.Function
    swing: ca.Function
    tip: ca.Function
    reach: float

    def goals(self, positions: Floats) -> Floats:
        """The goals (N x joints) for positions of the tip (N x 2 or 3), or their derivatives."""
        kept = self.place.size1_in(0) - positions.shape[1]
        return np.pad(positions / self.reach, ((0, 0), (0, kept)))


def equations_of(arm: Arm, params: Floats, start: Floats, key: str) -> Equations:
    """The equations of an arm that sets out from `start`. Raises TrackingError."""
    q, v = ca.SX.sym("q", arm.size), ca.SX.sym("v", arm.size)
    numbers = ca.SX(params)
    tip = arm.tip(numbers, q)
    if arm.size < tip.numel():
        raise TrackingError(
            f"{key}.space: an arm with {arm.size} joint{'s' * (arm.size > 1)} cannot move its tip "
            f"along a path in {tip.numel()} coordinates; give the joints' path (space = 'joint')"
        )
    reach = float(np.linalg.norm(np.diff(arm.points(params, start).full(), axis=0), axis=1).sum())
    place = tip / reach
    if tip.numel() == 3 and arm.size >= 6:
        W = ca.DM(arm.turn(params, start)).T @ arm.turn(numbers, q)  # turn since the start
        # 2 tan(angle / 2) about the axis: 0 at W = I alone.
        turned = 2 / (1 + ca.trace(W)) * ca.inv_skew(W - W.T)
        place = ca.vertcat(place, turned)
    free = arm.size - place.numel()  # joints to spare
    _, J = mapped(_with_jacobian(q, place), start[None])
    if singular(J).any():
        raise TrackingError(
            f"{key}: the arm is singular where the path starts from, q = {listed(start)}: "
            "its tip cannot move in every direction there; "
            "let it start from another configuration (plant.x0)"
        )
    null_space = np.linalg.svd(J[0])[2][arm.size - free :]
    place = ca.vertcat(place, null_space @ (q - start))
    swing = ca.jtimes(ca.jtimes(place, q, v), q, v)
    return Equations(
        _with_jacobian(q, place),
        ca.Function("swing", [q, v], [swing], {"cse": True}),
        _with_jacobian(q, tip / reach),
        reach,
    )


def _with_jacobian(q: ca.SX, value: ca.SX) -> ca.Function:
    """q -> the value and its Jacobian."""
    return ca.Function("place", [q], [value, ca.densify(ca.jacobian(value, q))], {"cse": True})


def mapped(function: ca.Function, *columns: Floats) -> list[Floats]:
    """The function's values (N x rows x columns each) at N inputs (N x size each)."""
    count = len(columns[0])
    values = function.map(count)(*[column.T for column in columns])
    if not isinstance(values, tuple):
        values = (values,)
    return [value.full().reshape(value.shape[0], count, -1).swapaxes(0, 1) for value in values]


def solved(J: Floats, goals: Floats) -> Floats:
    """J^-1 goal for each of N Jacobians and goals (N x joints)."""
    return np.linalg.solve(J, goals[:, :, None])[:, :, 0]


def singular(J: Floats) -> np.ndarray:
    """Which of N matrices are nearly singular, or turn over.

    Then the determinant has another sign than that of the first one.
    """
    sizes = np.linalg.svd(J, compute_uv=False)
    near = sizes[:, -1] < SINGULAR * sizes[:, 0]
    if J.shape[1] < J.shape[2]:
        return near
    return near | (np.linalg.det(J) * np.linalg.det(J[:1]) < 0)


def followed(equations: Equations, goals: Floats, start: Floats) -> Floats:
    """Positions (N x joints) at which the equations meet their goals, the first from `start`.

    Each is reached by Newton's method from the one before.
    """
    q, goal = ca.SX.sym("q", start.size), ca.SX.sym("goal", start.size)
    after = q
    for _ in range(NEWTON):
        place, J = equations.place(after)
        D, L, order = ca.ldl(J.T @ J + 1e-12 * ca.SX.eye(start.size))
        after = after - ca.ldl_solve(J.T @ (place - goal), D, L, order)
    follow = ca.Function("follow", [q, goal], [after], {"cse": True})
    first = _first(equations, follow, goals[0], start)
    return follow.mapaccum(len(goals))(first, goals.T).full().T


def _first(equations: Equations, follow: ca.Function, goal: Floats, start: Floats) -> Floats:
    """Joint angles that meet the first goal, by a line from `start` if that leads there."""
    here = equations.place(start)[0].full().ravel()
    line = np.linspace(here, goal, LOOKS).T
    arrived = follow.mapaccum(LOOKS)(start, line).full()[:, -1]
    miss = np.abs(equations.place(arrived)[0].full().ravel() - goal).max()
    if miss < REACHED:
        return arrived
    return nearest(equations.place, goal, start)


def nearest(function: ca.Function, goal: Floats, start: Floats) -> Floats:
    """The joint angles, from `start` on, at which a function comes nearest to its goal.

    function: q -> value and Jacobian; nearest in the sense of least squares.
    """
    from scipy.optimize import least_squares

    def gap(q: Floats) -> Floats:
        return function(q)[0].full().ravel() - goal

    def jacobian(q: Floats) -> Floats:
        return function(q)[1].full()

    return least_squares(gap, start, jacobian, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
