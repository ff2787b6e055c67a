"""The certificate bears disturbance, noise, uncertain plants and known nonlinearities.

Proofs are in docs/certificate.md. Every function takes error dynamics (`error_dynamics.dynamics`,
or `closed_loop` with a controller) and returns a value with its storage V and the check of its own
LMI by eigenvalues. Sampled, the plant itself must be given in sampled form, and what enters x~'
(E, G) in delta form like A: the matrix of one step divided by Ts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.analysis import error_dynamics
from undeadzone.analysis.certificate.driven import (
    Channel,
    channels,
    deepest,
    driven,
    original_storage,
    output_rows,
    prove,
)
from undeadzone.analysis.dissipation import LEAST, NOTHING, Check, Inequality, check
from undeadzone.errors import InputError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats, matrix, vector


class Gain(NamedTuple):
    """int |z|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2 for every side sequence.

    Attributes:
        disturbance: gain from w to z; inf where nothing is proved.
        noise: gain from v to z; inf where nothing is proved.
        V: the storage.
        check: of its own inequality.
    """

    disturbance: float
    noise: float
    V: error_dynamics.Storage
    check: Check


class Sector(NamedTuple):
    """Whether V falls for every nonlinearity in the sector.

    Attributes:
        certified: whether it is proved.
        V: the storage.
        check: of its own inequality.
    """

    certified: bool
    V: error_dynamics.Storage
    check: Check


def l2_gain(
    errors: error_dynamics.Dynamics,
    E: Floats | None = None,
    noise: Floats | None = None,
    output: Floats | None = None,
) -> Gain:
    """The paper's BIBO claim as numbers: the least sum of squared gains from w and v to z.

    With E or noise left out the other gain is as small as it can be.

    Args:
        errors: the error dynamics.
        E: x~' = ... + E w (n x q).
        noise: the reading of an active output i is off by noise_i v_i (p).
        output: rows of z = output x~ (rows x n); C by default.
    """
    if max(error_dynamics.growth(A, errors.Ts) for A in errors.A) >= 0:
        return Gain(np.inf, np.inf, error_dynamics.identity_storage(errors), NOTHING)
    scaling = error_dynamics.balance(errors)
    scaled = scaling.dynamics(errors)
    signals = channels(errors, scaling, E, noise)
    z = output_rows(errors, scaling, output)
    groups = errors.groups.shape[1]
    # Signals and z in units of their own size.
    norms = [max(np.linalg.norm(np.vstack(signal)), 1e-300) for signal in signals]
    sizes = np.array(norms)
    size = max(float(np.linalg.norm(z)), 1e-300)
    unit = []
    for signal, own in zip(signals, sizes, strict=True):
        unit.append(Channel(signal.state / own, signal.reading / own))

    def family(q: Floats) -> Inequality:
        return driven(scaled, q[:groups], q[groups:], unit, z / size)

    cost = np.r_[np.zeros(groups), np.square(sizes / sizes.max(initial=1e-300))]
    solution = prove(family, cost)
    if solution is None:
        return Gain(np.inf, np.inf, error_dynamics.identity_storage(errors), NOTHING)
    V = original_storage(errors, scaling, solution)
    V = V._replace(P=size**2 * V.P, W=size**2 * V.W)
    gains = [float(gain) for gain in np.sqrt(solution.q[groups:]) * sizes * size]
    disturbance = 0.0 if E is None else gains[0]
    noisy = 0.0 if noise is None else gains[-1]
    return Gain(disturbance, noisy, V, check(family(solution.q), solution.P))


def certified_radius(errors: error_dynamics.Dynamics, E: Floats, F: Floats) -> float:
    """The largest r such that V falls for x~' = (A + E Delta F) x~ - L e with |Delta(t)| < r.

    By the same token the largest Lipschitz constant of phi in a known plant
    A x + B u + E phi(F x), and in `closed_loop` with its model alone, E twice and
    F = [F_A - F_B K, F_B K], the largest |Delta| of a plant A + E Delta F_A, B + E Delta F_B.
    Small gain: 1 / the least disturbance gain from E to F x~ is the exact edge of the LMI.

    Args:
        errors: the error dynamics.
        E: how the uncertainty enters x~' (n x q).
        F: what it acts on (r x n).

    Returns:
        The radius; 0 if not certified.
    """
    gain = l2_gain(errors, E, output=F)
    return 1 / gain.disturbance if gain.disturbance > 0 else np.inf


def sector(
    errors: error_dynamics.Dynamics, G: Floats, H: Floats, low: Floats, high: Floats
) -> Sector:
    """Whether one V falls for x' = A x + B u + G phi(H x), phi known, its slopes in a sector.

    phi(H x) - phi(H x^) = (centre + w) H x~ componentwise with |w| <= radius; a multiplier for each
    component, so that it is sharper than `certified_radius` with the largest |slope|, and A alone
    need not be stable.

    Args:
        errors: the error dynamics without phi.
        G: how phi enters x' (n x k).
        H: what phi acts on, a row per component (k x n).
        low, high: bounds on the slope of each phi_i (k numbers each).

    Raises:
        InputError: if low exceeds high.
        ShapeError: for an argument of the wrong shape.
    """
    n, k = np.shape(G)
    H, low, high = matrix("H", H, k, n), vector("low", low, k), vector("high", high, k)
    if (low > high).any():
        raise InputError(f"low: must not exceed high, found {low.tolist()} and {high.tolist()}")
    errors = errors._replace(A=tuple(A + G * (low + high) / 2 @ H for A in errors.A))
    scaling = error_dynamics.balance(errors)
    scaled = scaling.dynamics(errors)
    # E w with |w_i| <= |h_i x~| is what remains of phi; both get the same size.
    E = scaling.time * G / scaling.state[:, None]
    h = (high - low)[:, None] / 2 * H * scaling.state
    ratio = np.sqrt(np.linalg.norm(h, axis=1) / np.maximum(np.linalg.norm(E, axis=0), 1e-300))
    ratio[ratio == 0] = 1.0
    E, h = E * ratio, h / ratio[:, None]
    groups = errors.groups.shape[1]

    def family(q: Floats) -> Inequality:
        T = q[groups:]  # the multipliers of the components
        terms = [(0, 0, h.T * T @ h), (2, 2, -np.diag(T))]
        return scaled.extended(errors.groups @ q[:groups], E, terms)

    def normalised(P: Floats, q: Floats) -> list[Floats]:
        return [q - LEAST, groups + k - q.sum(keepdims=True)]

    solution = deepest(family, np.ones(groups + k), normalised)
    if solution is None:
        return Sector(False, error_dynamics.identity_storage(errors), NOTHING)
    proof = check(family(solution.q), solution.P)
    return Sector(proof.proved, original_storage(errors, scaling, solution), proof)


def closed_loop(
    model: Matrices,
    plants: Sequence[Matrices],
    L: Floats,
    K: Floats,
    gamma: Floats,
    Ts: float | None = None,
) -> error_dynamics.Dynamics:
    """Error dynamics of (x - x_ref, x~) under u = u_ff - K (x^ - x_ref), one vertex per plant.

    x~ is x - x^ of the model. `passivity.certify_dynamics` of it proves convergence for every plant
    between the vertices, also a varying one, when x_ref = 0; a reference drives both errors by
    (A_k - A) x_ref + (B_k - B) u_ff, a disturbance for `l2_gain` and `ultimate_bound`. Sampled,
    model and plants are sampled ones: what lies between sampled vertices is covered.

    Args:
        model: A, B, C of the observer.
        plants: A_k, B_k of the vertices.
        L: observer gains (n x p) [1/s].
        K: state feedback (m x n).
        gamma: adaptation gains, see `error_dynamics.adaptation` [1/s].
        Ts: sample time [s]; None in continuous time.

    Raises:
        InputError, ShapeError: for gains of the wrong kind.
    """
    A, B, C = error_dynamics.delta(model, Ts), _input_rate(model, Ts), model.C
    n, p = A.shape[0], C.shape[0]
    vertices = []
    for plant in plants:
        A_k, B_k = error_dynamics.delta(plant, Ts), _input_rate(plant, Ts)
        dA, dB = A_k - A, B_k - B
        vertices.append(np.block([[A_k - B_k @ K, B_k @ K], [dA - dB @ K, A + dB @ K]]))
    L = matrix("L", L, n, p, "states x outputs")
    of_outputs = np.hstack([np.zeros((p, n)), C])
    to_errors = np.vstack([np.zeros((n, p)), L])
    return error_dynamics.Dynamics(
        tuple(vertices), of_outputs, to_errors, error_dynamics.adaptation(gamma, p), Ts
    )


def _input_rate(linear: Matrices, Ts: float | None) -> Floats:
    """B, or B / Ts of a sampled model: how u enters x' in delta form."""
    return linear.B if Ts is None else linear.B / Ts


def project(d_hat: Floats, V: error_dynamics.Storage, limit: Floats) -> Floats:
    """The widths nearest to d^ in the metric R of V; this projection never raises V.

    Args:
        d_hat: estimated widths d^ (2p).
        V: the storage.
        limit: the widths end up in [0, limit] (2p).
    """
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(V.R).T
    return np.asarray(lsq_linear(root, root @ d_hat, (0.0, limit), tol=1e-14).x)
