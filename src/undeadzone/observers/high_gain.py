"""The high-gain observer: the outputs are differentiated as fast as noise allows."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from undeadzone.errors import StepError
from undeadzone.interfaces import Observer
from undeadzone.linear.structure import output_chains
from undeadzone.observers.parts.output_error import adapted, output_error
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, Floats, scalar


class HighGain(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="high_gain",
):
    """Khalil and Praly (2014): in coordinates z_i, z_i', z_i'', ... the k-th derivative is corrected by binom(r, k) / epsilon^k e.

    epsilon [s]: all poles tend to -1 / epsilon (default: a tenth of the time of the plant's fastest pole, but at least four
    samples). The r derivatives of an output are those that make the coordinates complete; for a nonlinear plant they are those of its linearisation,
    which is exact if the states are outputs and their derivatives. gamma [1/s]: adapts the widths from widths0 (p x 2) [z]
    within [0, width_max]; 0 with widths0 = 0 takes the reading for the output.
    """

    epsilon: float | None = None
    gamma: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StepError, StructureError."""
        widths = adapted(self.gamma, self.widths0, self.width_max, model, sensor)
        if self.epsilon is None:
            epsilon = max(0.1 / fastest_pole(model), 0.0 if model.Ts is None else 4 * model.Ts)
        else:
            epsilon = scalar("observer.epsilon", self.epsilon, above=0.0)
        L = high_gain(model, epsilon)
        if model.Ts is not None:
            L = L * model.Ts
            fastest = np.abs(np.linalg.eigvals(model.linear.A - L @ model.linear.C)).max()
            if fastest >= 1:
                raise StepError(
                    f"simulation.step: {model.Ts:g} s is too coarse for observer.epsilon = {epsilon:g} s (spectral radius {fastest:.4g}); "
                    "use a larger epsilon or a shorter step"
                )
        return output_error(model, sensor, L, widths)


def high_gain(model: System, epsilon: float) -> Floats:
    """L (n x p) [1/s] in continuous time."""
    flow = model.linear if model.flow is None else model.flow
    chains = output_chains(flow.A, flow.C)
    gains = np.zeros((model.n, model.p))
    for i, rows in enumerate(chains.rows):
        gains[rows, i] = [math.comb(len(rows), k) / epsilon**k for k in range(1, len(rows) + 1)]
    return np.linalg.solve(chains.O, gains)
