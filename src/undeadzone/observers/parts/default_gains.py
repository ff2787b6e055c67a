"""Default gains of `Certified`: certified for every stable model, and loud enough to be heard.

docs/observer.md says where the two numbers come from.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from undeadzone.analysis.certificate.passivity import certify, passive_gain
from undeadzone.analysis.error_dynamics import delta
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import sizes
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import mean_pole
from undeadzone.support.arrays import Floats

STRENGTH: Final = 1.0  # C (-A)^-1 L: how far a lasting error moves z^, in that error
ADAPTATION: Final = 3.0  # gamma, in mean poles of the plant
LARGEST: Final = 0.5  # of gamma, per sample
WEAKER: Final = 0.5  # factor on L until it is certified in sampled time
TRIES: Final = 20  # such factors


def default_gain(model: System) -> Floats:
    """L (n x p) [1/s] along P^-1 C', so strong that a lasting error moves z^ `STRENGTH` times.

    In continuous time every multiple is certified; sampled, the gain is weakened until it is.

    Args:
        model: a stable model, continuous or sampled.

    Raises:
        StructureError: if the model is not stable.
    """
    linear, Ts = model.linear, model.Ts
    A = delta(linear, Ts)
    unit = 1 / sizes(A.T, linear.C.T)
    balanced = Matrices(linear.A * unit / unit[:, None], linear.B / unit[:, None], linear.C * unit)
    L = unit[:, None] * passive_gain(balanced, Ts)
    at_rest = np.diag(linear.C @ np.linalg.solve(-A, L))
    L = L * STRENGTH / np.exp(np.log(at_rest).mean())
    gamma = np.full(model.p, default_adaptation(model))
    for _ in range(TRIES):
        if certify(linear, L, gamma, Ts).certified:
            break
        L = WEAKER * L
    return np.asarray(L)


def default_adaptation(model: System) -> float:
    """gamma [1/s] for the plant's own speed."""
    wanted = ADAPTATION * mean_pole(model)
    return wanted if model.Ts is None else min(wanted, LARGEST / model.Ts)
