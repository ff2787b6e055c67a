"""Error dynamics with outside signals: their inequality, and the search for its proof.

The ultimate bound is the size that the errors approach under disturbance, noise and leakage. Proofs
are in docs/certificate.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.dissipation import (
    NO_PROOF,
    DefinitenessCheck,
    Extra,
    Family,
    Inequality,
    Solution,
    check_inequality,
    deepest_solution,
    no_constraints,
    optimise_storage,
)
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    Scaling,
    Storage,
    balance_dynamics,
    identity_storage,
    largest_growth_rate,
)
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, require_matrix, require_vector

FLOOR = 1e-6  # smallest multiplier that is minimised to, in its own unit
CEILING = 1e6  # the largest
# the units of a multiplier, at least and at most
LOWEST = 1e-12
HIGHEST = 1e12
ROUNDS = 6  # of finding these units, at most
NEAR = 100.0  # factor within which a multiplier suits its unit
LARGER = 1e4  # factor on the units if nothing is feasible below the ceiling
EXCESSES = (0.01, 0.1, 1.0)  # of the least cost that being inside may cost more, relatively
SHARES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)  # of the way inside that a proof may go


class Channel(NamedTuple):
    """Outside signal w of k entries.

    Attributes:
        state: how it enters x~' = ... + state w (n x k).
        reading: how it enters e = ... + reading w (p x k).
    """

    state: Floats
    reading: Floats


def build_channels(
    errors: Dynamics, scaling: Scaling, E: Floats | None, noise: Floats | None
) -> list[Channel]:
    """Return the channels of disturbance and noise, if present, in scaled quantities.

    Args:
        errors: the error dynamics, not scaled.
        scaling: their scaling.
        E: how disturbances enter x~' (n x q).
        noise: size of the noise on each active reading (p).
    """
    n, p = errors.L.shape
    signals = []
    if E is not None:
        E = require_matrix("E", E, n, None, "one row per state")
        to_state = scaling.time * E / scaling.state[:, None]
        signals.append(Channel(to_state, np.zeros((p, E.shape[1]))))
    if noise is not None:
        to_reading = np.diag(require_vector("noise", noise, p, "one per output") / scaling.output)
        signals.append(Channel(np.zeros((n, p)), to_reading))
    return signals


def output_rows(errors: Dynamics, scaling: Scaling, output: Floats | None) -> Floats:
    """Return the rows of z = output x~ (C by default) for scaled states (rows x n)."""
    n = errors.L.shape[0]
    z = (
        errors.C
        if output is None
        else require_matrix("output", output, None, n, "one column per state")
    )
    return z * scaling.state


def dissipation_inequality(
    errors: Dynamics,
    weights: Floats,
    mu: Floats,
    signals: list[Channel],
    z: Floats,
    decay: float = 0.0,
) -> Inequality:
    """Return V' + 2 decay x~'P x~ + |z x~|^2 - sum mu |w|^2 < 0 as an inequality in (x~, e,
    w).

    Args:
        errors: the error dynamics.
        weights: one per group of outputs, see `Dynamics.groups`.
        mu: multipliers, one per channel.
        signals: the channels of w.
        z: rows of the output that counts (rows x n).
        decay: rate [1/s].
    """
    W = errors.groups @ weights
    counts = [channel.state.shape[1] for channel in signals]
    none = np.zeros((errors.L.shape[0], 0))
    state = np.hstack([none, *(channel.state for channel in signals)])
    reading = np.hstack([np.zeros((W.size, 0)), *(channel.reading for channel in signals)])
    terms = [(0, 0, z.T @ z), (1, 2, W[:, None] * reading), (2, 2, -np.diag(np.repeat(mu, counts)))]
    return errors.extend_inequality(W, state, terms, decay)


def original_storage(errors: Dynamics, scaling: Scaling, solution: Solution) -> Storage:
    """Return V in original quantities from a scaled solution with q = [weight per group, ...]."""
    weights = errors.groups @ solution.q[: errors.groups.shape[1]]
    return Storage(
        scaling.unscale_storage(solution.P), scaling.unscale_weights(weights), errors.gamma
    )


class _Search(NamedTuple):
    """Search for P, q >= 0 of least cost'q under an inequality and a further constraint.

    Attributes:
        family: q -> the inequality, affine in q.
        cost: weights of the multipliers.
        confine: P, q -> a further matrix that must be positive semidefinite.
    """

    family: Family
    cost: Floats
    confine: Extra

    def minimise_cost(self, unit: Floats, passes: int) -> Solution | None:
        """Return P, q of least cost'q according to the solver, or None.

        `unit` scales the multipliers.
        """

        def bounds(P: Floats, q: Floats) -> list[Floats]:
            """Return the constraints on P and q besides the inequality."""
            return [q - FLOOR, CEILING - q, *self.confine(P, q * unit)]

        cost = self.cost * unit / max(float(self.cost @ unit), 1e-300)
        start = np.ones(unit.size)
        best = optimise_storage(lambda q: self.family(q * unit), cost, start, bounds, passes=passes)
        return None if best is None else Solution(best.P, best.q * unit)

    def move_inside(self, best: Solution, excess: float) -> Solution | None:
        """Return P, q that pass the check and cost little more than the best, or None.

        excess: relative extra cost that the deepest point may have.
        """
        unit = np.clip(best.q, LOWEST, HIGHEST)
        limit = (1 + excess) * float(self.cost @ unit)

        def bounds(P: Floats, q: Floats) -> list[Floats]:
            """Return the constraints on P and q, with the limit on the cost."""
            left = np.array([1 - self.cost @ (q * unit) / limit])
            return [q - FLOOR, CEILING - q, *self.confine(P, q * unit), left]

        inside = deepest_solution(lambda q: self.family(q * unit), np.ones(unit.size), bounds)
        if inside is None:
            return None
        for share in SHARES:
            P = share * inside.P + (1 - share) * best.P
            q = share * inside.q * unit + (1 - share) * best.q
            if (q > 0).all() and check_inequality(self.family(q), P).proved:
                return Solution(P, q)
        return None

    def reduce_cost(self, best: Solution, solution: Solution, low: float, high: float) -> Solution:
        """Return a solution that passes the check at nearly the least cost, by bisection.

        If the inequality is hardly feasible, the solver's least cost lies below the true one.

        Args:
            best: the solver's optimum, perhaps not provable.
            solution: that passes the check.
            low, high: costs over the solver's least cost (>= 1): low failed the check, high is that
                of the solution. The bisection is geometric, until their ratio is 1 + EXCESSES[0].
        """
        while high > (1 + EXCESSES[0]) * low:
            middle = float(np.sqrt(low * high))
            found = self.move_inside(best, middle - 1)
            if found is None:
                low = middle
            else:
                solution = found
                high = middle
        return solution


def prove_inequality(
    family: Family, cost: Floats, confine: Extra = no_constraints
) -> Solution | None:
    """Return P, q >= 0 of least cost'q, moved inside just enough that the LMI passes the
    check.

    Args:
        family: q -> the inequality, affine in q.
        cost: weights of the multipliers.
        confine: P, q -> a further matrix that must be positive semidefinite.

    Returns:
        The solution, checked, or None if there is none.
    """
    search = _Search(family, cost, confine)
    unit = np.ones(cost.size)
    for _ in range(ROUNDS):
        rough = search.minimise_cost(unit, passes=1)
        if rough is None:
            unit = unit * LARGER
            continue
        change = rough.q / unit
        unit = np.clip(rough.q, LOWEST, HIGHEST)
        if change.min() > 1 / NEAR and change.max() < NEAR:
            break
    best = search.minimise_cost(unit, passes=2)
    if best is None:
        return None
    failed = 0.0
    for excess in EXCESSES:
        solution = search.move_inside(best, excess)
        if solution is not None:
            return search.reduce_cost(best, solution, 1 + failed, 1 + excess)
        failed = excess
    return None


class Ultimate(NamedTuple):
    """Ultimate bound: |z| <= bound as t -> inf, or inf if nothing is proved.

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
    check: DefinitenessCheck


def ultimate_bound(
    errors: Dynamics,
    widths: Floats,
    E: Floats | None = None,
    noise: Floats | None = None,
    sigma: float = 0.0,
    output: Floats | None = None,
) -> Ultimate:
    """Return the bound that |z|, z = output x~, approaches for |w| <= 1, |v| <= 1.

    Args:
        errors: the error dynamics (Gamma diagonal if there is leakage).
        widths: what |d - d^| cannot exceed (2p, [right, left] of each output, or one number), by
            projection onto [0, d_M]. With leakage what |d - d0| cannot exceed.
        E: x~' = ... + E w (n x q), with the size of the disturbance.
        noise: sizes of the noise: the reading of active output i is off by noise_i v_i (p).
        sigma: leakage d^' = ... - sigma Gamma (d^ - d0), so that its rate is sigma gamma.
        output: rows of z (rows x n) (C by default).

    Raises:
        InputError: for leakage with Gamma that is not diagonal or too fast for Ts.
        ShapeError: for an argument of the wrong shape.
    """
    p = errors.L.shape[1]
    gamma = errors.gamma
    widths = require_vector("widths", widths, 2 * p, "[right, left] of each output")
    nothing = Ultimate(np.inf, np.inf, 0.0, identity_storage(errors), NO_PROOF)
    if not 0 <= sigma < np.inf:
        raise InputError(f"sigma: expected a number that is not negative, found {sigma:g}")
    if max(largest_growth_rate(A, errors.Ts) for A in errors.A) >= 0:
        return nothing
    if sigma > 0:
        errors = add_leakage(errors, sigma)
    scaling = balance_dynamics(errors)
    scaled = scaling.scale_dynamics(errors)
    signals = build_channels(errors, scaling, E, noise)
    z = output_rows(errors, scaling, output)
    scaled_widths = widths / np.repeat(scaling.output, 2)
    # The most that d~'R d~ can be, per unit weight of each group.
    R = Storage(np.eye(errors.L.shape[0]), np.ones(p), gamma).R
    most = np.outer(scaled_widths, scaled_widths) * np.abs(R) / scaling.time
    largest_width_term = most.sum(axis=1).reshape(p, 2).sum(axis=1) @ errors.groups
    # The rate at which leakage feeds V, per unit weight of each group.
    fed = sigma * np.square(scaled_widths).reshape(p, 2).sum(axis=1) @ errors.groups
    fastest = _fastest_rate(scaled)
    if sigma > 0:
        fastest = min(fastest, scaling.time * sigma * float(np.diag(gamma).min()) / 2)

    def level_at_rate(rate: float) -> _Level:
        """Return the least level of V at a rate."""
        of_widths = fed / (2 * rate) if sigma > 0 else largest_width_term
        return _least_level(scaled, signals, z, of_widths, rate)

    rate = _best_rate(lambda rate: level_at_rate(rate).bound, fastest)
    best = level_at_rate(rate)
    if best.solution is None:
        return nothing
    V = original_storage(errors, scaling, best.solution)._replace(gamma=gamma)
    proof = check_inequality(best.family(best.solution.q), best.solution.P)
    return Ultimate(best.bound, best.level * scaling.time, rate / scaling.time, V, proof)


class _Level(NamedTuple):
    """Least level of V at a given rate and the resulting bound on |z|, in scaled quantities.

    Attributes:
        solution: P, q = [weight per group, multiplier per channel] (None if there is none).
        family: q -> the inequality.
        level: of V.
        bound: of |z|.
    """

    solution: Solution | None
    family: Family
    level: float
    bound: float


def _least_level(
    scaled: Dynamics, signals: list[Channel], z: Floats, of_widths: Floats, rate: float
) -> _Level:
    """Return the least level of V that is approached at this rate.

    of_widths: the amount that the widths add to the level, per unit weight of each group.
    """
    groups = scaled.groups.shape[1]
    nothing = np.zeros((0, z.shape[1]))

    def family(q: Floats) -> Inequality:
        """Return the inequality for multipliers q."""
        return dissipation_inequality(scaled, q[:groups], q[groups:], signals, nothing, rate)

    def confine(P: Floats, q: Floats) -> list[Floats]:
        """Return the constraint that bounds |z| by V."""
        return [np.block([[P, z.T], [z, np.eye(len(z))]])]

    cost = np.r_[of_widths, np.full(len(signals), 1 / (2 * rate))]
    solution = prove_inequality(family, cost, confine)
    if solution is None:
        return _Level(None, family, np.inf, np.inf)
    level = float(cost @ solution.q)
    spread = float(np.linalg.eigvalsh(z @ np.linalg.solve(solution.P, z.T))[-1])
    return _Level(solution, family, level, float(np.sqrt(level * spread)))


def _fastest_rate(errors: Dynamics) -> float:
    """Return the rate that no V with these vertices can exceed [1/s]."""
    fastest = min(-largest_growth_rate(A, errors.Ts) for A in errors.A)
    return fastest if errors.Ts is None else min(fastest, 0.5 / errors.Ts)


def add_leakage(errors: Dynamics, sigma: float) -> Dynamics:
    """Return the error dynamics with leakage: sampled, Gamma becomes Gamma / (1 - Ts sigma
    Gamma).

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


def _best_rate(cost: Callable[[float], float], limit: float) -> float:
    """Return the rate in (0, limit] of least cost: the best of a geometric grid, refined."""
    from scipy.optimize import minimize_scalar

    grid = limit * np.geomspace(0.02, 0.98, 8)
    values = list(map(cost, grid))
    k = int(np.argmin(values))
    if not np.isfinite(values[k]):
        return float(grid[k])
    span = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    refined = minimize_scalar(cost, bounds=span, method="bounded", options={"maxiter": 8})
    return float(refined.x if refined.fun < values[k] else grid[k])
