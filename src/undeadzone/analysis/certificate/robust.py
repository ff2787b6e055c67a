"""The certificate under disturbance, noise, leakage, an uncertain plant and known nonlinearities; proofs in docs/certificate.md.

Every function takes error dynamics (`errordynamics.dynamics`, or `closed_loop` with a controller) and returns a value
with its storage V and the check of its own LMI by eigenvalues. Sampled, the plant itself must be given in sampled form,
and what enters x~' (E, G) in delta form like A: the matrix of one step divided by Ts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.dissipation import LEAST, Check, Found, Inequality, check, optimise
from undeadzone.analysis.error_dynamics import (
    Dynamics,
    Scaling,
    Storage,
    adaptation,
    balance,
    delta,
    growth,
)
from undeadzone.errors import InputError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats, matrix, vector

FLOOR = 1e-6  # smallest squared gain and weight that is minimised to, in scaled quantities
UNPROVED = Check(False, np.inf, -np.inf, 0.0)


class Gain(NamedTuple):
    """int |z|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2 for every side sequence; inf where nothing is proved."""

    disturbance: float
    noise: float
    V: Storage
    check: Check


class Ultimate(NamedTuple):
    """|z| <= bound as t -> inf, and the level of V and its rate of approach [1/s] behind it; inf where nothing is proved."""

    bound: float
    level: float
    rate: float
    V: Storage
    check: Check


class Sector(NamedTuple):
    """Whether V falls for every nonlinearity in the sector."""

    certified: bool
    V: Storage
    check: Check


def l2_gain(
    given: Dynamics,
    E: Floats | None = None,
    noise: Floats | None = None,
    output: Floats | None = None,
) -> Gain:
    """The paper's BIBO claim as numbers: the least sum of squared gains from w and v to z = output x~.

    E (n x q): x~' = ... + E w. noise (p): the reading of an active output i is off by noise_i v_i. output (rows x n): C
    by default. With E or noise left out the other gain is as small as it can be.
    """
    scaling = balance(given)
    scaled = scaling.dynamics(given)
    channels, z = _channels(given, scaling, E, noise, output)
    groups = given.groups.shape[1]
    sizes = np.array([max(np.linalg.norm(np.vstack(channel)), 1e-300) for channel in channels])
    size = max(float(np.linalg.norm(z)), 1e-300)
    unit = [
        Channel(*(part / s for part in channel)) for channel, s in zip(channels, sizes, strict=True)
    ]

    def family(q: Floats) -> Inequality:
        return _driven(scaled, q[:groups], q[groups:], unit, z / size)

    found = _prove(family, np.r_[np.zeros(groups), np.square(sizes / sizes.max(initial=1e-300))])
    if found is None:
        return Gain(np.inf, np.inf, _nothing(given), UNPROVED)
    V = Storage(
        size**2 * scaling.storage(found.P),
        size**2 * scaling.weights(given.groups @ found.q[:groups]),
        given.gamma,
    )
    gains = iter(np.sqrt(found.q[groups:]) * sizes * size)
    disturbance, noisy = (0.0 if signal is None else float(next(gains)) for signal in (E, noise))
    return Gain(disturbance, noisy, V, check(family(found.q), found.P))


def certified_radius(given: Dynamics, E: Floats, F: Floats) -> float:
    """The largest r such that V falls for x~' = (A + E Delta F) x~ - L e with any Delta(t), |Delta| < r; 0 if not certified.

    By the same token the largest Lipschitz constant of phi in a known plant A x + B u + E phi(F x), and in `closed_loop`
    with its model alone, E twice and F = [F_A - F_B K, F_B K], the largest |Delta| of a plant A + E Delta F_A,
    B + E Delta F_B. Small gain: 1 / the least disturbance gain from E to F x~ is the exact edge of the LMI.
    """
    gain = l2_gain(given, E, output=F)
    return 1 / gain.disturbance if gain.disturbance > 0 else np.inf


def sector(given: Dynamics, G: Floats, H: Floats, low: Floats, high: Floats) -> Sector:
    """Whether one V falls for x' = A x + B u + G phi(H x), phi known, each phi_i with slopes in [low_i, high_i] (k numbers).

    phi(H x) - phi(H x^) = (centre + w) H x~ componentwise with |w| <= radius; a multiplier for each component, so that it
    is sharper than `certified_radius` with the largest |slope|, and A alone need not be stable. Raises InputError, ShapeError.
    """
    n, k = np.shape(G)
    H, low, high = matrix("H", H, k, n), vector("low", low, k), vector("high", high, k)
    if (low > high).any():
        raise InputError(f"low: must not exceed high, found {low.tolist()} and {high.tolist()}")
    given = given._replace(A=tuple(A + G * (low + high) / 2 @ H for A in given.A))
    scaling = balance(given)
    scaled = scaling.dynamics(given)
    E, h = scaling.time * G / scaling.state[:, None], (high - low)[:, None] / 2 * H * scaling.state
    ratio = np.sqrt(np.linalg.norm(h, axis=1) / np.maximum(np.linalg.norm(E, axis=0), 1e-300))
    ratio[ratio == 0] = 1.0
    E, h = E * ratio, h / ratio[:, None]
    groups = given.groups.shape[1]

    def family(q: Floats) -> Inequality:
        T = q[groups:]
        return scaled.extended(
            given.groups @ q[:groups], E, [(0, 0, h.T * T @ h), (2, 2, -np.diag(T))]
        )

    found = _deepest(
        family, np.ones(groups + k), lambda P, q: [q - LEAST, groups + k - q.sum(keepdims=True)]
    )
    if found is None:
        return Sector(False, _nothing(given), UNPROVED)
    proof = check(family(found.q), found.P)
    return Sector(
        proof.proved,
        Storage(
            scaling.storage(found.P), scaling.weights(given.groups @ found.q[:groups]), given.gamma
        ),
        proof,
    )


def ultimate_bound(
    given: Dynamics,
    widths: Floats,
    E: Floats | None = None,
    noise: Floats | None = None,
    sigma: float = 0.0,
    output: Floats | None = None,
) -> Ultimate:
    """Where |z|, z = output x~ (C by default), ends for |w| <= 1, |v| <= 1 (put their sizes into E and noise).

    widths (2p, or one number): what |d - d^| cannot exceed, by projection onto [0, d_M]. With leakage
    d^' = ... - sigma Gamma (d^ - d0), so that the leak's rate is sigma gamma, it is what |d - d0| cannot exceed; Gamma
    must be diagonal then.
    """
    p, groups = given.L.shape[1], given.groups.shape[1]
    widths = vector("widths", widths, 2 * p, "[right, left] of each output")
    V = Storage(np.eye(given.L.shape[0]), np.ones(p), given.gamma)
    if sigma > 0:
        given = _leaking(given, sigma)
    scaling = balance(given)
    scaled = scaling.dynamics(given)
    channels, z = _channels(given, scaling, E, noise, output)

    def confine(P: Floats, q: Floats) -> list[Floats]:
        return [np.block([[P, z.T], [z, np.eye(len(z))]])]

    # The most that d~'R d~ can be, and the rate at which leakage feeds V, per unit weight of each group (in scaled units).
    widths_scaled = widths / np.repeat(scaling.output, 2)
    most = np.outer(widths_scaled, widths_scaled) * np.abs(V.R) / scaling.time
    held = most.sum(axis=1).reshape(p, 2).sum(axis=1) @ given.groups
    fed = sigma * np.square(widths_scaled).reshape(p, 2).sum(axis=1) @ given.groups
    fastest = min(-growth(A, scaled.Ts) for A in scaled.A)
    if scaled.Ts is not None:
        fastest = min(fastest, 0.5 / scaled.Ts)
    if sigma > 0:
        fastest = min(fastest, scaling.time * sigma * float(np.diag(V.gamma).min()) / 2)

    def at(rate: float) -> tuple[Found | None, Callable[[Floats], Inequality], float, float]:
        def family(q: Floats) -> Inequality:
            return _driven(
                scaled, q[:groups], q[groups:], channels, np.zeros((0, z.shape[1])), rate
            )

        cost = np.r_[
            fed / (2 * rate) if sigma > 0 else held, np.full(len(channels), 1 / (2 * rate))
        ]
        found = _prove(family, cost, confine)
        if found is None:
            return None, family, np.inf, np.inf
        level = float(cost @ found.q)
        spread = float(np.linalg.eigvalsh(z @ np.linalg.solve(found.P, z.T))[-1])
        return found, family, level, float(np.sqrt(level * spread))

    rate = _best(lambda rate: at(rate)[-1], fastest)
    found, family, level, bound = at(rate)
    if found is None:
        return Ultimate(np.inf, np.inf, 0.0, _nothing(given), UNPROVED)
    V = Storage(scaling.storage(found.P), scaling.weights(given.groups @ found.q[:groups]), V.gamma)
    return Ultimate(
        bound, level * scaling.time, rate / scaling.time, V, check(family(found.q), found.P)
    )


def closed_loop(
    model: Matrices,
    plants: Sequence[Matrices],
    L: Floats,
    K: Floats,
    gamma: Floats,
    Ts: float | None = None,
) -> Dynamics:
    """Error dynamics of (x - x_ref, x~) under u = u_ff - K (x^ - x_ref), one vertex per plant; x~ is x - x^ of the model.

    `passivity.certify_dynamics` of it proves convergence for every plant between the vertices, also a varying one, when
    x_ref = 0; a reference drives both errors by (A_k - A) x_ref + (B_k - B) u_ff, a disturbance for `l2_gain` and
    `ultimate_bound`. Sampled, model and plants are sampled ones: what lies between sampled vertices is covered.
    """
    A, B, C = delta(model, Ts), model.B if Ts is None else model.B / Ts, model.C
    n, p = A.shape[0], C.shape[0]
    vertices = []
    for plant in plants:
        A_k, B_k = delta(plant, Ts), plant.B if Ts is None else plant.B / Ts
        dA, dB = A_k - A, B_k - B
        vertices.append(np.block([[A_k - B_k @ K, B_k @ K], [dA - dB @ K, A + dB @ K]]))
    L = matrix("L", L, n, p, "states x outputs")
    return Dynamics(
        tuple(vertices),
        np.hstack([np.zeros((p, n)), C]),
        np.vstack([np.zeros((n, p)), L]),
        adaptation(gamma, p),
        Ts,
    )


def project(d_hat: Floats, V: Storage, limit: Floats) -> Floats:
    """The widths in [0, limit] (2p) nearest to d^ (2p) in the metric R of V, in which projection never raises V."""
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(V.R).T
    return np.asarray(lsq_linear(root, root @ d_hat, (0.0, limit), tol=1e-14).x)


class Channel(NamedTuple):
    """An outside signal: x~' = ... + state w (n x k), e = ... + reading w (p x k)."""

    state: Floats
    reading: Floats


def _channels(
    given: Dynamics, scaling: Scaling, E: Floats | None, noise: Floats | None, output: Floats | None
) -> tuple[list[Channel], Floats]:
    """Disturbance and noise where given, and the rows z, in scaled quantities."""
    n, p = given.L.shape
    found = []
    if E is not None:
        E = matrix("E", E, n, None, "one row per state")
        found.append(Channel(scaling.time * E / scaling.state[:, None], np.zeros((p, E.shape[1]))))
    if noise is not None:
        found.append(
            Channel(
                np.zeros((n, p)),
                np.diag(vector("noise", noise, p, "one per output") / scaling.output),
            )
        )
    z = given.C if output is None else matrix("output", output, None, n, "one column per state")
    return found, z * scaling.state


def _driven(
    given: Dynamics,
    weights: Floats,
    mu: Floats,
    channels: list[Channel],
    z: Floats,
    decay: float = 0.0,
) -> Inequality:
    """V' + 2 decay x~'P x~ + |z x~|^2 - sum of mu |w|^2 over the channels < 0 in (x~, e, w)."""
    W = given.groups @ weights
    counts = [channel.state.shape[1] for channel in channels]
    state = np.hstack([np.zeros((given.L.shape[0], 0)), *(channel.state for channel in channels)])
    reading = np.hstack([np.zeros((W.size, 0)), *(channel.reading for channel in channels)])
    terms = [(0, 0, z.T @ z), (1, 2, W[:, None] * reading), (2, 2, -np.diag(np.repeat(mu, counts)))]
    return given.extended(W, state, terms, decay)


def _nothing(given: Dynamics) -> Storage:
    return Storage(np.eye(given.L.shape[0]), np.ones(given.L.shape[1]), given.gamma)


def _leaking(given: Dynamics, sigma: float) -> Dynamics:
    """Leakage seen by the LMI: sampled, Gamma grows to Gamma / (1 - Ts sigma Gamma)."""
    gamma = np.diag(given.gamma)
    if (given.gamma - np.diag(gamma)).any() or not (gamma > 0).all():
        raise InputError("sigma: leakage is covered for a diagonal positive Gamma only")
    if given.Ts is None:
        return given
    if given.Ts * sigma * gamma.max() >= 1:
        raise InputError(
            f"sigma: Ts sigma gamma must be below 1, found {given.Ts * sigma * gamma.max():g}"
        )
    return given._replace(gamma=np.diag(gamma / (1 - given.Ts * sigma * gamma)))


def _deepest(
    family: Callable[[Floats], Inequality],
    start: Floats,
    extra: Callable[[Floats, Floats], list[Floats]],
) -> Found | None:
    return optimise(
        family,
        np.zeros(start.size),
        start,
        extra,
        True,
        lambda found: check(family(found.q), found.P).proved,
        4,
    )


def _prove(
    family: Callable[[Floats], Inequality],
    cost: Floats,
    confine: Callable[[Floats, Floats], list[Floats]] = lambda P, q: [],
) -> Found | None:
    """P, q >= 0 of least cost'q, drawn so little towards the deep inside that the LMI checks; None if it cannot."""

    def bounds(P: Floats, q: Floats) -> list[Floats]:
        return [q - FLOOR, 1e6 - q, *confine(P, q)]

    best = optimise(family, cost, np.ones(cost.size), bounds)
    if best is None:
        return None
    limit = 2 * float(cost @ best.q)
    deep = _deepest(family, best.q, lambda P, q: [*bounds(P, q), np.array([limit - cost @ q])])
    if deep is None:
        return None
    for share in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0):
        found = Found(
            *(share * inner + (1 - share) * outer for inner, outer in zip(deep, best, strict=True))
        )
        if (found.q > 0).all() and check(family(found.q), found.P).proved:
            return found
    return None


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
