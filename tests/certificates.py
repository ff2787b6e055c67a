"""Two facts about V that docs/certificate.md proves, as code that only tests ask."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis import error_dynamics
from undeadzone.analysis.dissipation import (
    LEAST,
    NO_PROOF,
    DefinitenessCheck,
    Inequality,
    check_inequality,
    deepest_solution,
)
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, require_matrix, require_vector
from undeadzone_design.certificate.driven import original_storage


class Sector(NamedTuple):
    """Whether V falls for every nonlinearity in the sector.

    Attributes:
        certified: whether it is proved.
        V: the storage.
        check: of its own inequality.
    """

    certified: bool
    V: error_dynamics.Storage
    check: DefinitenessCheck


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
    H, low, high = (
        require_matrix("H", H, k, n),
        require_vector("low", low, k),
        require_vector("high", high, k),
    )
    if (low > high).any():
        raise InputError(f"low: must not exceed high, found {low.tolist()} and {high.tolist()}")
    errors = errors._replace(A=tuple(A + G * (low + high) / 2 @ H for A in errors.A))
    scaling = error_dynamics.balance_dynamics(errors)
    scaled = scaling.scale_dynamics(errors)
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
        return scaled.extend_inequality(errors.groups @ q[:groups], E, terms)

    def normalised(P: Floats, q: Floats) -> list[Floats]:
        return [q - LEAST, groups + k - q.sum(keepdims=True)]

    solution = deepest_solution(family, np.ones(groups + k), normalised)
    if solution is None:
        return Sector(False, error_dynamics.identity_storage(errors), NO_PROOF)
    proof = check_inequality(family(solution.q), solution.P)
    return Sector(proof.proved, original_storage(errors, scaling, solution), proof)


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
