"""The state and input that make a plant's output follow a reference exactly: x_ref, u_ff with C x_ref = r."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import TrackingError
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import sizes
from undeadzone.plants.system import System
from undeadzone.signals.exosystem import Exosystem
from undeadzone.support.arrays import Floats, listed


class Target(NamedTuple):
    """What to follow at one instant: r (tracked outputs), x_ref (n), u_ff (m); plan: what the controller computed ahead for it (`controllers.Plan`)."""

    r: Floats
    x_ref: Floats
    u_ff: Floats
    plan: Floats = np.empty(0)


def regulator(linear: Matrices, S: Floats, Q: Floats) -> tuple[Floats, Floats, float]:
    """(Pi, Gamma, residual) of the regulator equations A Pi + B Gamma = Pi S, C Pi = Q; x_ref = Pi w, u_ff = Gamma w.

    C here holds the tracked outputs only. Least scaled norm where inputs are more than tracked outputs. The residual
    is relative; it is not small exactly when a zero of the plant meets the spectrum of S.
    """
    A, B, C = linear
    n, m, k, q = A.shape[0], B.shape[1], S.shape[0], C.shape[0]
    identity = np.eye(k)
    equations = np.block(
        [
            [np.kron(identity, A) - np.kron(S.T, np.eye(n)), np.kron(identity, B)],
            [np.kron(identity, C), np.zeros((q * k, m * k))],
        ]
    )
    wanted = np.concatenate([np.zeros(n * k), Q.ravel(order="F")])
    scale = np.concatenate(
        [*(sizes(A, B, float(np.linalg.norm(column))) for column in S.T), np.ones(m * k)]
    )
    rows = np.abs(equations * scale).max(axis=1)
    rows[rows == 0] = 1.0
    scaled, goal = equations * scale / rows[:, None], wanted / rows
    solution = np.linalg.lstsq(scaled, goal, rcond=None)[0]
    residual = float(
        np.linalg.norm(scaled @ solution - goal) / max(float(np.linalg.norm(goal)), 1e-300)
    )
    solution = solution * scale
    return (
        solution[: n * k].reshape(n, k, order="F"),
        solution[n * k :].reshape(m, k, order="F"),
        residual,
    )


def _blocking(linear: Matrices, S: Floats) -> complex:
    """The eigenvalue of S nearest to being a zero of the plant (least singular value of the Rosenbrock matrix)."""
    A, B, C = linear
    zero = np.zeros((C.shape[0], B.shape[1]))

    def gap(s: complex) -> float:
        rosenbrock = np.block([[A - s * np.eye(A.shape[0]), B], [C, zero]])
        return float(
            np.linalg.svd(rosenbrock, compute_uv=False)[
                -1 if rosenbrock.shape[0] <= rosenbrock.shape[1] else 0
            ]
        )

    poles = np.linalg.eigvals(S)
    return complex(min(poles[poles.imag >= 0], key=gap))


def steady_state(model: System, exo: Exosystem, tracked: list[int]) -> tuple[Floats, Floats]:
    """(Pi, Gamma): x_ref = Pi w and u_ff = Gamma w of a linear model, continuous or sampled. Raises TrackingError where none exists."""
    A, B, C = model.linear
    S, linear = exo.S, Matrices(A, B, C[tracked])
    if model.Ts is not None:
        from scipy.linalg import expm

        # The same equations less the identity, per second: well scaled for short samples too.
        S = (expm(S * model.Ts) - np.eye(S.shape[0])) / model.Ts
        linear = Matrices((A - np.eye(model.n)) / model.Ts, B / model.Ts, C[tracked])
    if len(tracked) > model.m:
        raise TrackingError(
            f"tracked: the plant has {model.m} input{'s' * (model.m > 1)} and cannot make {len(tracked)} outputs follow; name at most {model.m}"
        )
    Pi, Gamma, residual = regulator(linear, S, exo.Q)
    if residual > 1e-8:
        s = _blocking(linear, S)
        if model.Ts is not None:
            s = np.log(1 + s * model.Ts) / model.Ts
        where = listed([complex(round(s.real, 9), round(s.imag, 9))])
        raise TrackingError(
            f"reference: the plant cannot follow it: a zero of the plant at s = {where} lies on the reference's spectrum "
            f"(regulator equations, residual {residual:.1g}); change the frequency or the tracked outputs"
        )
    return Pi, Gamma


def linear_targets(
    model: System, exo: Exosystem, tracked: list[int], t: Floats, derivative: int = 0
) -> Target:
    """Targets, or their derivatives of the given order, at times t [s] for a linear model, continuous or sampled.

    Raises TrackingError where none exists.
    """
    Pi, Gamma = steady_state(model, exo, tracked)
    w = exo.state(t) @ np.linalg.matrix_power(exo.S, derivative).T
    return Target(w @ exo.Q.T, w @ Pi.T, w @ Gamma.T)


def inverted_targets(
    model: System, exo: Exosystem, tracked: list[int], t: Floats, x_eq: Floats
) -> Target:
    """Targets for a nonlinear model without zero dynamics: r and its derivatives inverted for x and u by Newton.

    Needs one input per tracked output and relative degrees that add up to n. Raises TrackingError otherwise.
    """
    if len(tracked) != model.m:
        many = "s" * (model.m != 1)
        raise TrackingError(
            f"tracked: a nonlinear plant with {model.m} input{many} needs {model.m} tracked output{many}, found {len(tracked)}"
        )
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    params = ca.SX(model.params)
    dx = model.move(params, x, u)
    values, orders, tops = [], [], []
    for index in tracked:
        value, order = model.output(params, x)[index], 0
        while not ca.depends_on(value, u) and order <= model.n:
            values.append(value)
            orders.append(order)
            value, order = ca.jtimes(value, x, dx), order + 1
        tops.append((value, order))
    if len(values) != model.n:
        raise TrackingError(
            f"reference: the nonlinear plant has zero dynamics (relative degrees {[order for _, order in tops]} add up to "
            f"{len(values)}, not to n = {model.n}); its feedforward cannot be computed by inversion"
        )
    channel = np.repeat(np.arange(len(tracked)), [order for _, order in tops])
    derivatives = [exo.value(t, order) for order in range(max(order for _, order in tops) + 1)]
    goals = np.stack(
        [derivatives[order][:, c] for c, order in zip(channel, orders, strict=True)]
        + [derivatives[order][:, c] for c, (_, order) in enumerate(tops)],
        axis=1,
    )
    unknown, goal = ca.vertcat(x, u), ca.SX.sym("goal", goals.shape[1])
    gap = (ca.vertcat(*values, *(value for value, _ in tops)) - goal) / (
        1 + np.abs(goals).max(axis=0)
    )
    solve = ca.rootfinder(
        "invert",
        "newton",
        {"x": unknown, "p": goal, "g": gap},
        {"error_on_fail": False, "abstol": 1e-12, "max_iter": 25},
    )
    # Each instant starts from the solution of the one before.
    found = solve.mapaccum(t.size)(np.concatenate([x_eq, np.zeros(model.m)]), goals.T)
    gaps = np.abs(
        ca.Function("gap", [unknown, goal], [gap]).map(t.size)(found, goals.T).full()
    ).max(axis=0)
    if (failed := np.flatnonzero(~(gaps < 1e-9))).size:
        when = round(float(t[failed[0]]), 6)
        raise TrackingError(
            f"reference: the nonlinear plant cannot follow it at t = {when:g} s (Newton's method finds no state and input)"
        )
    solution = found.full().T
    return Target(exo.value(t), solution[:, : model.n], solution[:, model.n :])


def flat_targets(model: System, exo: Exosystem, tracked: list[int], t: Floats) -> Target:
    """Targets at times t [s] for a continuous model with `flat` coordinates, whose path is exo; r: the tracked outputs on it."""
    assert model.flat is not None
    rows = [exo.Q @ np.linalg.matrix_power(exo.S, order) for order in range(model.flat.order + 1)]
    path = ca.SX.sym("path", exo.Q.shape[0], len(rows))
    params = ca.SX(model.params)
    x, u = model.flat.solve(params, path)
    solve = ca.Function("flat", [path], [model.output(params, x)[tracked], x, u], {"cse": True})
    paths = np.tensordot(exo.state(t), np.stack(rows, axis=2), (1, 1))
    return Target(*(part.full().T for part in solve.map(t.size)(np.hstack(list(paths)))))
