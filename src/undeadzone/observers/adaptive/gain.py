"""Observer gain L: given, or the default gains.

The default gains are certified for every stable model, and large enough for readings to matter.
Other models have a fast gain.
Page docs/observer.md derives the two numbers.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from undeadzone.analysis.certificate.passivity import (
    certify,
    instability_reason,
    passive_gain,
)
from undeadzone.analysis.error_dynamics import build_error_dynamics
from undeadzone.linalg.matrices import Matrices, delta_form, scale_states, state_response_sizes
from undeadzone.linalg.riccati import fast_gain
from undeadzone.plants.system import System, holds_no_width, mean_pole
from undeadzone.util.arrays import Array, Floats, require_array, require_matrix

STRENGTH: Final = 1.0  # C (-A)^-1 L: how far a lasting error moves z^, in that error
ADAPTATION: Final = 3.0  # gamma, in mean poles of the plant
LARGEST: Final = 0.5  # of gamma, per sample
WEAKER: Final = 0.5  # factor on L until it is certified in sampled time
TRIES: Final = 20  # such factors


def innovation_gain(L: Array | None, model: System, key: str = "observer.L") -> Floats:
    """Return the gain L of the innovation (n x p) [1/s], given or the default.

    Args:
        L: gains, a plain list for one output (None: `default_gain` of the model).
        model: the model, for its shape.
        key: what an error calls L.

    Raises:
        ShapeError: for another shape.
    """
    n = model.n
    p = model.p
    if L is None:
        return default_gain(model)
    gain = require_array(key, L)
    if gain.ndim == 1 and p == 1:
        gain = gain[:, None]
    return require_matrix(key, gain, n, p, "states x outputs")


def default_gain(model: System) -> Floats:
    """Return L (n x p) [1/s] along P^-1 C', or for a model that is not stable that of mirrored
    poles.

    A lasting error moves z^ by `STRENGTH` times itself. In continuous time every multiple is
    certified. Sampled, the gain is weakened until it is. No common V exists for integrators,
    undamped and unstable poles (docs/certificate.md). Each pole slower than half the mean pole is
    then mirrored at that rate: the least gain of its speed (Anderson and Moore 1971).

    Args:
        model: the model, continuous or sampled.

    Raises:
        StructureError: if the outputs hardly show some state.
    """
    linear = model.linear
    Ts = model.Ts
    gamma = np.full(model.p, default_adaptation(model))
    if instability_reason(build_error_dynamics(linear, linear.C.T, gamma, Ts)):
        return fast_gain(linear, mean_pole(model), Ts) / model.per_step
    A = delta_form(linear, Ts).A
    unit = 1 / state_response_sizes(A.T, linear.C.T)
    balanced = Matrices(scale_states(linear.A, unit), linear.B / unit[:, None], linear.C * unit)
    L = unit[:, None] * passive_gain(balanced, Ts)
    at_rest = np.diag(linear.C @ np.linalg.solve(-A, L))
    L = L * STRENGTH / np.exp(np.log(at_rest).mean())
    for _ in range(TRIES):
        if certify(linear, L, gamma, Ts).certified:
            break
        L = WEAKER * L
    return L


def default_adaptation(model: System) -> float:
    """Return the adaptation gain gamma for the plant's mean pole [1/s].

    It is 0 for an odd number of unstable poles without an integrator. On a branch the errors have
    the polynomial s det(s - A + L C) + gamma det(s - A), at s = 0 gamma det(-A) < 0: a pole on the
    right for every L and gamma > 0.
    """
    if holds_no_width(model.continuous.A):
        return 0.0
    rate = ADAPTATION * mean_pole(model)
    return rate if model.Ts is None else min(rate, LARGEST / model.Ts)
