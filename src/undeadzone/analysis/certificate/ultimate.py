"""The ultimate bound says where the errors end under disturbance, noise and leakage.

Proofs are in docs/certificate.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.driven import (
    Channel,
    channels,
    driven,
    original_storage,
    output_rows,
    prove,
)
from undeadzone.analysis.dissipation import NOTHING, Check, Family, Inequality, Solution, check
from undeadzone.analysis.error_dynamics import Dynamics, Storage, balance, growth, identity_storage
from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats, vector


class Ultimate(NamedTuple):
    """|z| <= bound as t -> inf; inf where nothing is proved.

    Attributes:
        bound: of |z|.
        level: of V, which V cannot stay above.
        rate: at which V approaches it [1/s].
        V: the storage.
        check: of its own inequality.
    """

    bound: float
    level: float
    rate: float
    V: Storage
    check: Check


def ultimate_bound(
    errors: Dynamics,
    widths: Floats,
    E: Floats | None = None,
    noise: Floats | None = None,
    sigma: float = 0.0,
    output: Floats | None = None,
) -> Ultimate:
    """Where |z|, z = output x~, ends for |w| <= 1, |v| <= 1.

    Args:
        errors: the error dynamics; Gamma diagonal if there is leakage.
        widths: what |d - d^| cannot exceed (2p, [right, left] of each output, or one number), by
            projection onto [0, d_M]. With leakage what |d - d0| cannot exceed.
        E: x~' = ... + E w (n x q), with the size of the disturbance.
        noise: sizes of the noise: the reading of active output i is off by noise_i v_i (p).
        sigma: leakage d^' = ... - sigma Gamma (d^ - d0), so that its rate is sigma gamma.
        output: rows of z (rows x n); C by default.

    Raises:
        InputError: for leakage with Gamma that is not diagonal or too fast for Ts.
        ShapeError: for an argument of the wrong shape.
    """
    p = errors.L.shape[1]
    gamma = errors.gamma
    widths = vector("widths", widths, 2 * p, "[right, left] of each output")
    nothing = Ultimate(np.inf, np.inf, 0.0, identity_storage(errors), NOTHING)
    if not 0 <= sigma < np.inf:
        raise InputError(f"sigma: expected a number that is not negative, found {sigma:g}")
    if max(growth(A, errors.Ts) for A in errors.A) >= 0:
        return nothing
    if sigma > 0:
        errors = leaking(errors, sigma)
    scaling = balance(errors)
    scaled = scaling.dynamics(errors)
    signals = channels(errors, scaling, E, noise)
    z = output_rows(errors, scaling, output)
    scaled_widths = widths / np.repeat(scaling.output, 2)
    # The most that d~'R d~ can be, per unit weight of each group.
    R = Storage(np.eye(errors.L.shape[0]), np.ones(p), gamma).R
    most = np.outer(scaled_widths, scaled_widths) * np.abs(R) / scaling.time
    held = most.sum(axis=1).reshape(p, 2).sum(axis=1) @ errors.groups
    # The rate at which leakage feeds V, per unit weight of each group.
    fed = sigma * np.square(scaled_widths).reshape(p, 2).sum(axis=1) @ errors.groups
    fastest = _fastest(scaled)
    if sigma > 0:
        fastest = min(fastest, scaling.time * sigma * float(np.diag(gamma).min()) / 2)

    def at(rate: float) -> _Level:
        of_widths = fed / (2 * rate) if sigma > 0 else held
        return _level(scaled, signals, z, of_widths, rate)

    rate = _best(lambda rate: at(rate).bound, fastest)
    best = at(rate)
    if best.solution is None:
        return nothing
    V = original_storage(errors, scaling, best.solution)._replace(gamma=gamma)
    proof = check(best.family(best.solution.q), best.solution.P)
    return Ultimate(best.bound, best.level * scaling.time, rate / scaling.time, V, proof)


class _Level(NamedTuple):
    """The least level of V at one rate, and the bound on |z| that it gives; in scaled quantities.

    Attributes:
        solution: P, q = [weight per group, multiplier per channel]; None if there is none.
        family: q -> the inequality.
        level: of V.
        bound: of |z|.
    """

    solution: Solution | None
    family: Family
    level: float
    bound: float


def _level(
    scaled: Dynamics, signals: list[Channel], z: Floats, of_widths: Floats, rate: float
) -> _Level:
    """The least level of V that is approached at this rate.

    of_widths: what the widths add to the level, per unit weight of each group.
    """
    groups = scaled.groups.shape[1]
    nothing = np.zeros((0, z.shape[1]))

    def family(q: Floats) -> Inequality:
        return driven(scaled, q[:groups], q[groups:], signals, nothing, rate)

    def confine(P: Floats, q: Floats) -> list[Floats]:
        return [np.block([[P, z.T], [z, np.eye(len(z))]])]

    cost = np.r_[of_widths, np.full(len(signals), 1 / (2 * rate))]
    solution = prove(family, cost, confine)
    if solution is None:
        return _Level(None, family, np.inf, np.inf)
    level = float(cost @ solution.q)
    spread = float(np.linalg.eigvalsh(z @ np.linalg.solve(solution.P, z.T))[-1])
    return _Level(solution, family, level, float(np.sqrt(level * spread)))


def _fastest(errors: Dynamics) -> float:
    """The rate [1/s] that no V with these vertices can exceed."""
    fastest = min(-growth(A, errors.Ts) for A in errors.A)
    return fastest if errors.Ts is None else min(fastest, 0.5 / errors.Ts)


def leaking(errors: Dynamics, sigma: float) -> Dynamics:
    """Error dynamics as the LMI sees leakage: sampled, Gamma grows to Gamma / (1 - Ts sigma Gamma).

    Raises:
        InputError: if Gamma is not diagonal and positive, or Ts sigma gamma not below 1.
    """
    gamma = np.diag(errors.gamma)
    if (errors.gamma - np.diag(gamma)).any() or not (gamma > 0).all():
        raise InputError("sigma: leakage is covered for a diagonal positive Gamma only")
    if errors.Ts is None:
        return errors
    most = errors.Ts * sigma * gamma.max()
    if most >= 1:
        raise InputError(f"sigma: Ts sigma gamma must be below 1, found {most:g}")
    return errors._replace(gamma=np.diag(gamma / (1 - errors.Ts * sigma * gamma)))


def _best(cost: Callable[[float], float], limit: float) -> float:
    """The rate in (0, limit] of least cost: the best of a geometric grid, refined."""
    from scipy.optimize import minimize_scalar

    grid = limit * np.geomspace(0.02, 0.98, 8)
    values = [cost(rate) for rate in grid]
    k = int(np.argmin(values))
    if not np.isfinite(values[k]):
        return float(grid[k])
    span = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    refined = minimize_scalar(cost, bounds=span, method="bounded", options={"maxiter": 8})
    return float(refined.x if refined.fun < values[k] else grid[k])
