"""How fast a plant is: its poles, their largest, a quarter of its period."""

from __future__ import annotations

import numpy as np

from undeadzone.linear.matrices import Matrices
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, scalar


def moving_poles(model: System) -> Floats:
    """|pole| of the plant in continuous time [1/s], those of integrators left out; 1 for a chain of integrators."""
    A = (model.linear if model.flow is None else model.flow).A
    rates = np.abs(np.linalg.eigvals(A))
    moving = rates[rates > 1e-6 * np.linalg.norm(A, 2)]
    return moving if moving.size else np.ones(1)


def fastest_pole(model: System) -> float:
    """The largest of `moving_poles` [1/s]."""
    return float(moving_poles(model).max())


def in_poles(model: System, key: str, given: float | None, default: float) -> float:
    """A rate [1/s] as given, or `default` times the fastest pole of the plant. Raises InputError."""
    return default * fastest_pole(model) if given is None else scalar(key, given, above=0.0)


def time_scale(flow: Matrices) -> float:
    """A quarter period pi / (2 |pole|) [s], geometric mean over the poles that are not integrators; 1 s if all are."""
    rates = np.abs(np.linalg.eigvals(flow.A))
    moving = rates[rates > 1e-6 * np.linalg.norm(flow.A, 2)]
    return float(np.pi / 2 * np.exp(-np.log(moving).mean())) if moving.size else 1.0
