"""High-gain observer: differentiates the outputs as fast as noise allows."""

from __future__ import annotations

import math

import numpy as np

from undeadzone.errors import StepError
from undeadzone.interfaces import Observer
from undeadzone.linalg.matrices import spectral_radius
from undeadzone.linalg.structure import output_chains
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.adaptive.output_error import (
    build_output_error_observer,
    read_adapted_widths,
)
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_number


class HighGain(Options, frozen=True, kw_only=True, tag="high_gain"):
    """High-gain observer of Khalil and Praly (2014) in coordinates z_i, z_i', z_i'', ...

    The k-th derivative is corrected by binom(r, k) / epsilon^k e. The r derivatives of an output
    are those that make the coordinates complete. For a nonlinear plant they are those of its
    linearisation, which is exact if the states are outputs and their derivatives.

    References:
        H. K. Khalil, L. Praly (2014), doi:10.1002/rnc.3051

    Attributes:
        epsilon: all poles tend to -1 / epsilon [s] (default a tenth of the time of the plant's
            fastest pole, but at least four samples).
        gamma: adaptation gain of the widths, one or one per output [1/s] (0 with widths0 = 0 takes
            the reading for the output).
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M per side, one or one per output [z]. The widths stay within [0, width_max]
            (default none).
    """

    epsilon: float | None = None
    gamma: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model, continuous or sampled.

        Raises StepError for a coarse step.
        """
        widths = read_adapted_widths(self.gamma, self.widths0, self.width_max, model, sensor)
        epsilon = self._resolve_epsilon(model)
        L = high_gain_matrix(model, epsilon)
        if model.Ts is not None:
            L = L * model.Ts
            fastest = spectral_radius(model.linear.A - L @ model.linear.C)
            if fastest >= 1:
                raise StepError(
                    f"simulation.step: {model.Ts:g} s is too coarse for observer.epsilon = "
                    f"{epsilon:g} s (spectral radius {fastest:.4g}). "
                    "Use a larger epsilon or a shorter step"
                )
        return build_output_error_observer(model, sensor, L, widths)

    def _resolve_epsilon(self, model: System) -> float:
        """Return epsilon as given, or its default [s]. Raises InputError."""
        if self.epsilon is not None:
            return require_number("observer.epsilon", self.epsilon, above=0.0)
        least = 0.0 if model.Ts is None else 4 * model.Ts
        return max(0.1 / fastest_pole(model), least)


def high_gain_matrix(model: System, epsilon: float) -> Floats:
    """Return the gain L (n x p) [1/s] in continuous time (epsilon: as in `HighGain` [s])."""
    flow = model.continuous
    chains = output_chains(flow.A, flow.C)
    gains = np.zeros((model.n, model.p))
    for i, rows in enumerate(chains.rows):
        r = len(rows)
        gains[rows, i] = [math.comb(r, k) / epsilon**k for k in range(1, r + 1)]
    return np.linalg.solve(chains.O, gains)
