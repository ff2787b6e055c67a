"""Random certified designs: stable plants of 1-8 states and 1-3 outputs with gains somewhere below the certificate's edge."""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.certificate.passivity import margin
from undeadzone.analysis.error_dynamics import dynamics
from undeadzone.linear.hold import zoh
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats


def random_matrices(rng: np.random.Generator, n: int, p: int, spread: float = 1.0) -> Matrices:
    """A stable plant: real and complex poles over `spread` decades, mixed by a random change of coordinates."""
    A, k = np.zeros((n, n)), 0
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
    """(model, L, gamma, Ts) with a margin of 2 % to 95 % of what L = 0 would have; half of them sampled, gamma per edge or full."""
    model = random_matrices(rng, n, p)
    Ts = float(10 ** rng.uniform(-4, 0)) if rng.random() < 0.5 else None
    if Ts is not None:
        model = zoh(model, Ts)
    R = rng.normal(size=(2 * p, 2 * p))
    gamma = (
        np.exp(rng.normal(size=(p, 2)))
        if rng.random() < 0.7
        else R @ R.T / (2 * p) + 0.1 * np.eye(2 * p)
    )
    if Ts is not None:
        gamma = gamma * rng.uniform(0.05, 1.5) / Ts / np.linalg.norm(gamma, 2)
    L = rng.normal(size=(n, p))
    free = margin(dynamics(model, 0 * L, gamma, Ts), np.ones(p))[0]
    loss = (
        margin(dynamics(model, 0 * L, np.zeros(p), Ts), np.ones(p))[0]
        - margin(dynamics(model, L, np.zeros(p), Ts), np.ones(p))[0]
    )
    return model, L * free * rng.uniform(0.05, 0.98) / max(loss, 1e-3), gamma, Ts
