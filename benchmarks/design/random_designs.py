"""Random certified designs: stable plants with gains somewhere below the certificate's edge."""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.certificate.weights import margin_of_weights
from undeadzone.analysis.error_dynamics import build_error_dynamics
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.util.arrays import Floats


def random_matrices(rng: np.random.Generator, n: int, p: int, spread: float = 1.0) -> Matrices:
    """A stable plant (n states, p outputs).

    Real and complex poles over `spread` decades, mixed by a random change of coordinates.
    """
    A = np.zeros((n, n))
    k = 0  # states that have their poles
    while k < n:
        rate, zeta = 10 ** rng.uniform(-spread / 2, spread / 2), rng.uniform(0.02, 1.0)
        if k + 1 < n and rng.random() < 0.5:
            turn = np.sqrt(1 - zeta**2)
            A[k : k + 2, k : k + 2] = rate * np.array([[-zeta, turn], [-turn, -zeta]])
            k += 2
        else:
            A[k, k] = -rate
            k += 1
    T = rng.normal(size=(n, n))
    return Matrices(T @ A @ np.linalg.inv(T), rng.normal(size=(n, 1)), rng.normal(size=(p, n)))


def random_design(
    rng: np.random.Generator, n: int, p: int
) -> tuple[Matrices, Floats, Floats, float | None]:
    """(model, L, gamma, Ts) with a margin of 2 % to 95 % of what L = 0 would have.

    Half of them are sampled; gamma is per edge or full.
    """
    model = random_matrices(rng, n, p)
    Ts = float(10 ** rng.uniform(-4, 0)) if rng.random() < 0.5 else None
    if Ts is not None:
        model = zoh(model, Ts)
    R = rng.normal(size=(2 * p, 2 * p))
    if rng.random() < 0.7:
        gamma = np.exp(rng.normal(size=(p, 2)))
    else:
        gamma = R @ R.T / (2 * p) + 0.1 * np.eye(2 * p)
    if Ts is not None:
        gamma = gamma * rng.uniform(0.05, 1.5) / Ts / np.linalg.norm(gamma, 2)
    L = rng.normal(size=(n, p))

    def margin_of(L: Floats, gamma: Floats) -> float:
        return margin_of_weights(build_error_dynamics(model, L, gamma, Ts), np.ones(p))[0]

    free = margin_of(0 * L, gamma)
    loss = margin_of(0 * L, np.zeros(p)) - margin_of(L, np.zeros(p))
    return model, L * free * rng.uniform(0.05, 0.98) / max(loss, 1e-3), gamma, Ts
