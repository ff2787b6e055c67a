"""Certificates under disturbance, noise, uncertain plants and known nonlinearities.

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
from undeadzone.analysis.dissipation import (
    NO_PROOF,
    DefinitenessCheck,
    Inequality,
    check_inequality,
)
from undeadzone.linalg.matrices import Matrices, delta_form
from undeadzone.util.arrays import Floats, require_matrix
from undeadzone_design.certificate.driven import (
    Channel,
    build_channels,
    dissipation_inequality,
    original_storage,
    output_rows,
    prove_inequality,
)


class Gain(NamedTuple):
    """Bound int |z|^2 <= V(0) + disturbance^2 int |w|^2 + noise^2 int |v|^2 on any branches.

    Attributes:
        disturbance: gain from w to z (inf if nothing is proved).
        noise: gain from v to z (inf if nothing is proved).
        V: the storage.
        check: of its own inequality.
    """

    disturbance: float
    noise: float
    V: error_dynamics.Storage
    check: DefinitenessCheck


def l2_gain(
    errors: error_dynamics.Dynamics,
    E: Floats | None = None,
    noise: Floats | None = None,
    output: Floats | None = None,
) -> Gain:
    """Return the gains from w and v to z with the least sum of squares: the paper's BIBO
    statement.

    With E or noise left out the other gain is as small as it can be.

    Args:
        errors: the error dynamics.
        E: x~' = ... + E w (n x q).
        noise: the reading of an active output i is off by noise_i v_i (p).
        output: rows of z = output x~ (rows x n) (C by default).
    """
    if max(error_dynamics.largest_growth_rate(A, errors.Ts) for A in errors.A) >= 0:
        return Gain(np.inf, np.inf, error_dynamics.identity_storage(errors), NO_PROOF)
    scaling = error_dynamics.balance_dynamics(errors)
    scaled = scaling.scale_dynamics(errors)
    signals = build_channels(errors, scaling, E, noise)
    z = output_rows(errors, scaling, output)
    groups = errors.groups.shape[1]
    # Signals and z in units of their own size.
    norms = [max(np.linalg.norm(np.vstack(signal)), 1e-300) for signal in signals]
    sizes = np.array(norms)
    size = max(float(np.linalg.norm(z)), 1e-300)
    pairs = zip(signals, sizes, strict=True)
    unit = [Channel(signal.state / own, signal.reading / own) for signal, own in pairs]

    def family(q: Floats) -> Inequality:
        """Return the inequality for multipliers q."""
        return dissipation_inequality(scaled, q[:groups], q[groups:], unit, z / size)

    cost = np.r_[np.zeros(groups), np.square(sizes / sizes.max(initial=1e-300))]
    solution = prove_inequality(family, cost)
    if solution is None:
        return Gain(np.inf, np.inf, error_dynamics.identity_storage(errors), NO_PROOF)
    V = original_storage(errors, scaling, solution)
    V = V._replace(P=size**2 * V.P, W=size**2 * V.W)
    gains = (np.sqrt(solution.q[groups:]) * sizes * size).tolist()
    disturbance = 0.0 if E is None else gains[0]
    noisy = 0.0 if noise is None else gains[-1]
    return Gain(disturbance, noisy, V, check_inequality(family(solution.q), solution.P))


def certified_radius(errors: error_dynamics.Dynamics, E: Floats, F: Floats) -> float:
    """Return the largest r such that V falls for x~' = (A + E Delta F) x~ - L e, |Delta(t)| <
    r.

    By the same token the largest Lipschitz constant of phi in a known plant
    A x + B u + E phi(F x), and in `closed_loop` with its model alone, E twice and
    F = [F_A - F_B K, F_B K], the largest |Delta| of a plant A + E Delta F_A, B + E Delta F_B.
    Small gain: 1 / the least disturbance gain from E to F x~ is the exact edge of the LMI.

    Args:
        errors: the error dynamics.
        E: how the uncertainty enters x~' (n x q).
        F: map to its input (r x n).

    Returns:
        The radius, or 0 if not certified.
    """
    gain = l2_gain(errors, E, output=F)
    return 1 / gain.disturbance if gain.disturbance > 0 else np.inf


def closed_loop(
    model: Matrices,
    plants: Sequence[Matrices],
    L: Floats,
    K: Floats,
    gamma: Floats,
    Ts: float | None = None,
) -> error_dynamics.Dynamics:
    """Return the error dynamics of (x - x_ref, x~), u = u_ff - K (x^ - x_ref), a vertex per
    plant.

    x~ is x - x^ of the model. `passivity.certify_dynamics` of it proves convergence for every plant
    between the vertices, also a varying one, when x_ref = 0. A reference drives both errors by (A_k
    - A) x_ref + (B_k - B) u_ff, a disturbance for `l2_gain` and `ultimate_bound`. Sampled, model
    and plants are sampled ones: all between sampled vertices are covered.

    Args:
        model: A, B, C of the observer.
        plants: A_k, B_k of the vertices.
        L: observer gains (n x p) [1/s].
        K: state feedback (m x n).
        gamma: adaptation gains, see `error_dynamics.adaptation` [1/s].
        Ts: sample time [s] (None in continuous time).

    Raises:
        InputError, ShapeError: for gains of the wrong kind.
    """
    A, B, C = delta_form(model, Ts)
    n = A.shape[0]
    p = C.shape[0]
    vertices = []
    for plant in plants:
        A_k, B_k, _ = delta_form(plant, Ts)
        dA = A_k - A
        dB = B_k - B
        vertices.append(np.block([[A_k - B_k @ K, B_k @ K], [dA - dB @ K, A + dB @ K]]))
    L = require_matrix("L", L, n, p, "states x outputs")
    of_outputs = np.hstack([np.zeros((p, n)), C])
    to_errors = np.vstack([np.zeros((n, p)), L])
    return error_dynamics.Dynamics(
        tuple(vertices), of_outputs, to_errors, error_dynamics.adaptation_matrix(gamma, p), Ts
    )
