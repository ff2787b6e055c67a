"""The state and input that make a plant's output follow a reference exactly.

They are x_ref, u_ff with C x_ref = r.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import TrackingError
from undeadzone.linalg.matrices import Matrices, delta_form, state_response_sizes
from undeadzone.plants.system import System
from undeadzone.signals.exosystem import Exosystem
from undeadzone.util.arrays import Floats, list_numbers

SOLVED = 1e-8  # largest relative residual of the regulator equations
INVERTED = 1e-9  # largest relative gap between the reference and what Newton's method finds


class Target(NamedTuple):
    """Quantity to follow, at one instant or at N of them (N x ...).

    Attributes:
        r: values of the tracked outputs.
        x_ref: state (n).
        u_ff: input (m).
        plan: numbers that the controller computed ahead (`controllers.Plan`).
    """

    r: Floats
    x_ref: Floats
    u_ff: Floats
    plan: Floats = np.empty(0)


def along_targets(law: Callable[[Any, Any], Any], target: Target) -> Floats:
    """Return law(x_ref, u_ff) at each of N instants (N x k).

    Args:
        law: a function of CasADi expressions.
        target: what to follow, a row per instant.
    """
    x = ca.SX.sym("x", target.x_ref.shape[1])
    u = ca.SX.sym("u", target.u_ff.shape[1])
    function = ca.Function("law", [x, u], [law(x, u)], {"cse": True})
    return np.asarray(function.map(len(target.u_ff))(target.x_ref.T, target.u_ff.T).full().T)


def regulator(linear: Matrices, S: Floats, Q: Floats) -> tuple[Floats, Floats, float]:
    """Return the solution of the regulator equations A Pi + B Gamma = Pi S, C Pi = Q.

    Then x_ref = Pi w, u_ff = Gamma w. It is that of least scaled norm where inputs are more than
    tracked outputs.

    Args:
        linear: A (n x n), B (n x m) and C (q x n) of the tracked outputs only.
        S: dynamics of the exosystem (k x k).
        Q: output of the exosystem (q x k).

    Returns:
        Pi (n x k), Gamma (m x k), and the relative residual, which is not small exactly when a zero
        of the plant meets the spectrum of S.
    """
    A, B, C = linear
    n = A.shape[0]
    m = B.shape[1]
    k = S.shape[0]
    q = C.shape[0]
    identity = np.eye(k)
    dynamics = [np.kron(identity, A) - np.kron(S.T, np.eye(n)), np.kron(identity, B)]
    outputs = [np.kron(identity, C), np.zeros((q * k, m * k))]
    equations = np.block([dynamics, outputs])
    right_side = np.concatenate([np.zeros(n * k), Q.ravel(order="F")])
    state_sizes = [state_response_sizes(A, B, float(np.linalg.norm(column))) for column in S.T]
    scale = np.concatenate([*state_sizes, np.ones(m * k)])
    rows = np.abs(equations * scale).max(axis=1)
    rows[rows == 0] = 1.0
    scaled = equations * scale / rows[:, None]
    goal = right_side / rows
    solution = np.linalg.lstsq(scaled, goal, rcond=None)[0]
    gap = np.linalg.norm(scaled @ solution - goal)
    residual = float(gap / max(float(np.linalg.norm(goal)), 1e-300))
    solution = solution * scale
    Pi = solution[: n * k].reshape(n, k, order="F")
    Gamma = solution[n * k :].reshape(m, k, order="F")
    return Pi, Gamma, residual


def _blocking(linear: Matrices, S: Floats) -> complex:
    """Return the eigenvalue of S nearest to being a zero of the plant.

    There the Rosenbrock matrix has its least singular value.
    """
    A, B, C = linear
    zero = np.zeros((C.shape[0], B.shape[1]))

    def gap(s: complex) -> float:
        rosenbrock = np.block([[A - s * np.eye(A.shape[0]), B], [C, zero]])
        singular = np.linalg.svd(rosenbrock, compute_uv=False)
        wide = rosenbrock.shape[0] <= rosenbrock.shape[1]
        return float(singular[-1 if wide else 0])

    poles = np.linalg.eigvals(S)
    return complex(min(poles[poles.imag >= 0], key=gap))


def moves(S: Floats, Ts: float | None) -> Floats:
    """Return the S of w' = S w, or (e^(S Ts) - I) / Ts, its delta form (k x k) [1/s].

    Args:
        S: dynamics of the exosystem (k x k) [1/s].
        Ts: sample time [s] (None in continuous time).
    """
    if Ts is None:
        return S
    from scipy.linalg import expm

    return np.asarray((expm(S * Ts) - np.eye(S.shape[0])) / Ts)


def steady_state(model: System, exo: Exosystem, tracked: list[int]) -> tuple[Floats, Floats]:
    """Return (Pi, Gamma): x_ref = Pi w and u_ff = Gamma w of a linear model, continuous or sampled.

    Args:
        model: the plant.
        exo: the reference.
        tracked: the outputs that follow it.

    Raises:
        TrackingError: there are none.
    """
    # Sampled, the same equations less the identity, per second: well scaled for short samples too.
    S = moves(exo.S, model.Ts)
    linear = delta_form(model.linear, model.Ts)
    if len(tracked) > model.m:
        many = "s" * (model.m > 1)
        raise TrackingError(
            f"tracked: the plant has {model.m} input{many} and cannot make {len(tracked)} outputs "
            f"follow. Name at most {model.m}"
        )
    linear = linear._replace(C=linear.C[tracked])
    Pi, Gamma, residual = regulator(linear, S, exo.Q)
    if residual > SOLVED:
        s = _blocking(linear, S)
        if model.Ts is not None:
            s = np.log(1 + s * model.Ts) / model.Ts
        where = list_numbers([complex(round(s.real, 9), round(s.imag, 9))])
        raise TrackingError(
            f"reference: the plant cannot follow it: a zero of the plant at s = {where} lies on "
            f"the reference's spectrum (regulator equations, residual {residual:.1g}). "
            "Change the frequency or the tracked outputs"
        )
    return Pi, Gamma


def linear_targets(
    model: System, exo: Exosystem, tracked: list[int], t: Floats, derivative: int = 0
) -> Target:
    """Return targets, or their derivatives, for a linear model, continuous or sampled.

    Args:
        model: the plant.
        exo: the reference.
        tracked: the outputs that follow it.
        t: times (N) [s].
        derivative: order of the derivative.

    Raises:
        TrackingError: the plant cannot follow the reference.
    """
    Pi, Gamma = steady_state(model, exo, tracked)
    w = exo.state(t) @ np.linalg.matrix_power(exo.S, derivative).T
    return Target(w @ exo.Q.T, w @ Pi.T, w @ Gamma.T)


class _Derivative(NamedTuple):
    """A tracked output, or a derivative of it along the dynamics, as an expression of x and u.

    Attributes:
        value: the expression.
        channel: position among the tracked outputs.
        order: order of the derivative.
    """

    value: ca.SX
    channel: int
    order: int


def invert_targets(
    model: System, exo: Exosystem, tracked: list[int], t: Floats, x_eq: Floats
) -> Target:
    """Return targets for a nonlinear model without zero dynamics.

    r and its derivatives are inverted for x and u by Newton's method, each instant from the
    solution of the one before.

    Args:
        model: the plant, with one input per tracked output and relative degrees that add up to n.
        exo: the reference.
        tracked: the outputs that follow it.
        t: times (N) [s].
        x_eq: state from which the first search starts (n).

    Raises:
        TrackingError: the model is of another kind, or Newton's method finds no state and input.
    """
    x = ca.SX.sym("x", model.n)
    u = ca.SX.sym("u", model.m)
    derivatives = _derivatives(model, tracked, x, u)
    highest = max(derivative.order for derivative in derivatives)
    r = [exo.output_at(t, order) for order in range(highest + 1)]
    goals = np.stack([r[each.order][:, each.channel] for each in derivatives], axis=1)
    unknown = ca.vertcat(x, u)
    goal = ca.SX.sym("goal", goals.shape[1])
    values = ca.vertcat(*[derivative.value for derivative in derivatives])
    gap = (values - goal) / (1 + np.abs(goals).max(axis=0))
    solve = ca.rootfinder(
        "invert",
        "newton",
        {"x": unknown, "p": goal, "g": gap},
        {"error_on_fail": False, "abstol": 1e-12, "max_iter": 25},
    )
    start = np.concatenate([x_eq, np.zeros(model.m)])
    solutions = solve.mapaccum(t.size)(start, goals.T)  # each starts from the one before
    gap_of = ca.Function("gap", [unknown, goal], [gap]).map(t.size)
    gaps = np.abs(gap_of(solutions, goals.T).full()).max(axis=0)
    failed = np.flatnonzero(~(gaps < INVERTED))
    if failed.size:
        when = round(float(t[failed[0]]), 6)
        raise TrackingError(
            f"reference: the nonlinear plant cannot follow it at t = {when:g} s "
            "(Newton's method finds no state and input)"
        )
    rows = solutions.full().T
    return Target(exo.output_at(t), rows[:, : model.n], rows[:, model.n :])


def _derivatives(model: System, tracked: list[int], x: ca.SX, u: ca.SX) -> list[_Derivative]:
    """Return derivatives of the tracked outputs, one per state and input, that determine x and u.

    Each output is differentiated until the input shows: those without it first, then those with it.
    Raises TrackingError.
    """
    if len(tracked) != model.m:
        many = "s" * (model.m != 1)
        raise TrackingError(
            f"tracked: a nonlinear plant with {model.m} input{many} needs {model.m} tracked "
            f"output{many}, found {len(tracked)}"
        )
    params = ca.SX(model.params)
    dx = model.move(params, x, u)
    without_input = []
    with_input = []
    for channel, index in enumerate(tracked):
        value = model.output(params, x)[index]
        order = 0
        while not ca.depends_on(value, u) and order <= model.n:
            without_input.append(_Derivative(value, channel, order))
            value = ca.jtimes(value, x, dx)
            order = order + 1
        with_input.append(_Derivative(value, channel, order))
    if len(without_input) != model.n:
        degrees = [derivative.order for derivative in with_input]
        raise TrackingError(
            f"reference: the nonlinear plant has zero dynamics (relative degrees {degrees} "
            f"add up to {len(without_input)}, not to n = {model.n}). "
            "Its feedforward cannot be computed by inversion"
        )
    return without_input + with_input


def flat_targets(model: System, exo: Exosystem, tracked: list[int], t: Floats) -> Target:
    """Return targets for a continuous model with `flat` coordinates.

    Args:
        model: the plant.
        exo: the path of its flat coordinates.
        tracked: the outputs in r.
        t: times (N) [s].
    """
    assert model.flat is not None
    rows = [exo.Q @ np.linalg.matrix_power(exo.S, order) for order in range(model.flat.order + 1)]
    path = ca.SX.sym("path", exo.Q.shape[0], len(rows))
    params = ca.SX(model.params)
    x, u = model.flat.solve(params, path)
    solve = ca.Function("flat", [path], [model.output(params, x)[tracked], x, u], {"cse": True})
    paths = np.tensordot(exo.state(t), np.stack(rows, axis=2), (1, 1))
    targets = solve.map(t.size)(np.hstack(list(paths)))
    return Target(*(part.full().T for part in targets))
