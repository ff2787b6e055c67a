"""Super-twisting observer of any order: exact in finite time if the reading is the output.

They would be, were the reading the output.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import StructureError
from undeadzone.interfaces import Observer
from undeadzone.linalg.structure import output_chains
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.adaptive.output_error import (
    build_output_error_observer,
    read_adapted_widths,
)
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_positive
from undeadzone_arena.gain_defaults import injection_gain

# Gains of the recursive differentiator, from the last derivative up.
LEVANT = (1.1, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 12.0)


class SuperTwisting(Options, frozen=True, kw_only=True, tag="super_twisting"):
    """Davila, Fridman and Levant (2005) for second order, Levant (1998, 2003) for higher orders.

    The latter is the exact differentiator with the model in it. In coordinates z_i, z_i', ...
    (r for output i) the k-th is corrected by lambda_k lipschitz^(k/r) |e|^((r-k)/r) sgn e: 1.5 and
    1.1 for r = 2.

    References:
        J. Davila, L. Fridman, A. Levant (2005), doi:10.1109/TAC.2005.858636
        A. Levant (1998), doi:10.1016/S0005-1098(97)00209-4
        J. A. Moreno, M. Osorio (2012), doi:10.1109/TAC.2012.2186179

    Attributes:
        lipschitz: a bound that exceeds the effect of a disturbance on the r-th derivative, one or
            one per output [z/s^r] (default 5 times the fastest pole, to the power r, fit for z of
            order 1).
        L: gain of a linear correction beside it (Moreno and Osorio 2012) (n x p) [1/s], which an
            unstable plant needs (default none).
        poles: poles of A - L C (n) [1/s], in place of L.
        speed: speed of A - L C [1/s], in place of L.
        gamma: adaptation gain of the widths, one or one per output [1/s] (0 with widths0 = 0 takes
            the reading for the output).
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M per side, one or one per output [z]. The widths stay within [0, width_max]
            (default none).
    """

    lipschitz: Array | None = None
    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    gamma: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        widths = read_adapted_widths(self.gamma, self.widths0, self.width_max, model, sensor)
        L = self._linear_gain(model)
        flow = model.continuous
        chains = output_chains(flow.A, flow.C)
        orders = list(map(len, chains.rows))
        if max(orders) > len(LEVANT):
            raise StructureError(
                f"observer.method: 'super_twisting' has gains for up to {len(LEVANT)} derivatives "
                f"of one output, this plant needs {max(orders)}"
            )
        bound = self._lipschitz_bound(model, orders)
        scales = []
        for r, size in zip(orders, bound, strict=True):
            scales.append(differentiator_gains(r) * size ** (np.arange(1, r + 1) / r))
        order = np.concatenate(chains.rows)
        law = TwistingLaw(
            np.linalg.inv(chains.O)[:, order] * model.per_step, np.concatenate(scales)
        )
        return build_output_error_observer(
            model, sensor, L, widths, law, partial(fractional_powers, orders)
        )

    def _linear_gain(self, model: System) -> Floats:
        """Return L (n x p) of the linear correction, per step when sampled, 0 by default."""
        if self.L is self.poles is self.speed is None:
            return np.zeros((model.n, model.p))
        return injection_gain(model, self.L, self.poles, self.speed, 1.0)

    def _lipschitz_bound(self, model: System, orders: list[int]) -> Floats:
        """Return `lipschitz` as given, or its default (p) [z/s^r].

        Raises InputError, ShapeError.
        """
        default = (5 * fastest_pole(model)) ** np.array(orders, float)
        chosen = default if self.lipschitz is None else self.lipschitz
        return require_positive("observer.lipschitz", chosen, model.p, "one per output")


class TwistingLaw(NamedTuple):
    """Numbers of the correction.

    Attributes:
        inverse: from the derivatives of the outputs to x (n x n), per step when sampled.
        scale: scales of their corrections (n).
    """

    inverse: Floats
    scale: Floats


def fractional_powers(orders: list[int], law: TwistingLaw, e: Any) -> Any:
    """Return the correction of x^' (n): |e|^((r-k)/r) sgn e in the k-th of r coordinates."""
    powers = []
    for i, r in enumerate(orders):
        for k in range(1, r + 1):
            powers.append(ca.sign(e[i]) * ca.fabs(e[i]) ** ((r - k) / r))
    return law.inverse @ (law.scale * ca.vertcat(*powers))


def differentiator_gains(r: int) -> Floats:
    """Return lambda_1 ... lambda_r (r) [1] of the non-recursive differentiator."""
    gains = [LEVANT[r - 1]]
    for k in range(1, r):
        gains.append(LEVANT[r - 1 - k] * gains[-1] ** ((r - 1 - k) / (r - k)))
    return np.array(gains)
