"""The super-twisting observer and its higher-order kin: exact in finite time, were the reading the output."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.interfaces import Observer
from undeadzone.linear.structure import output_chains
from undeadzone.observers.parts.gain import injection
from undeadzone.observers.parts.output_error import adapted, output_error
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, Floats, vector

LEVANT = (
    1.1,
    1.5,
    2.0,
    3.0,
    5.0,
    7.0,
    10.0,
    12.0,
)  # gains of the recursive differentiator, from the last derivative up


class SuperTwisting(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="super_twisting",
):
    """Davila, Fridman and Levant (2005) for second order; for higher orders Levant's exact differentiator (1998, 2003) with the model in it.

    In coordinates z_i, z_i', ... (r for output i) the k-th is corrected by lambda_k lipschitz^(k/r) |e|^((r-k)/r) sgn e:
    1.5 and 1.1 for r = 2. lipschitz [z/s^r], one or one per output: must exceed what a disturbance does to the r-th
    derivative (default: 5 times the fastest pole, to the power r, fit for z of order 1). L, poles [1/s] or speed [1/s]: a
    linear correction beside it (Moreno and Osorio 2012), which an unstable plant needs; default none. gamma [1/s]: adapts the
    widths from widths0 (p x 2) [z] within [0, width_max]; 0 with widths0 = 0 takes the reading for the output.
    """

    lipschitz: Array | None = None
    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    gamma: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StructureError."""
        widths = adapted(self.gamma, self.widths0, self.width_max, model, sensor)
        linear = any(given is not None for given in (self.L, self.poles, self.speed))
        L = (
            injection(model, self.L, self.poles, self.speed, 1.0)
            if linear
            else np.zeros((model.n, model.p))
        )
        flow = model.linear if model.flow is None else model.flow
        chains = output_chains(flow.A, flow.C)
        orders = [len(rows) for rows in chains.rows]
        if max(orders) > len(LEVANT):
            raise StructureError(
                f"observer.method: 'super_twisting' has gains for up to {len(LEVANT)} derivatives of one output, this plant needs {max(orders)}"
            )
        default = (5 * fastest_pole(model)) ** np.array(orders, float)
        bound = vector(
            "observer.lipschitz",
            default if self.lipschitz is None else self.lipschitz,
            model.p,
            "one per output",
        )
        if (bound <= 0).any():
            raise InputError(f"observer.lipschitz: must be positive, found {bound.min():g}")
        per_step = 1.0 if model.Ts is None else model.Ts
        scale = np.concatenate(
            [
                _gains(r) * size ** (np.arange(1, r + 1) / r)
                for r, size in zip(orders, bound, strict=True)
            ]
        )
        order = np.concatenate(chains.rows)

        def inject(law: Law, e: Any) -> Any:
            powers = [
                ca.sign(e[i]) * ca.fabs(e[i]) ** ((r - k) / r)
                for i, r in enumerate(orders)
                for k in range(1, r + 1)
            ]
            return law.inverse @ (law.scale * ca.vertcat(*powers))

        return output_error(
            model,
            sensor,
            L,
            widths,
            Law(np.linalg.inv(chains.O)[:, order] * per_step, scale),
            inject,
        )


class Law(NamedTuple):
    """inverse (n x n): from the derivatives of the outputs to x, per step when sampled; scale (n): of their corrections."""

    inverse: Floats
    scale: Floats


def _gains(r: int) -> Floats:
    """lambda_1 ... lambda_r of the non-recursive differentiator of r coordinates."""
    found = [LEVANT[r - 1]]
    for k in range(1, r):
        found.append(LEVANT[r - 1 - k] * found[-1] ** ((r - 1 - k) / (r - k)))
    return np.array(found)
