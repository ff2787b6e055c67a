"""A plant in a user's words: one of several forms."""

from __future__ import annotations

from typing import Any

import msgspec

from undeadzone.plants.robots.options import ArmOptions
from undeadzone.support.arrays import Array


class SecondOrder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """x'' + 2 zeta omega_n x' + omega_n^2 x = gain u, (37) with its square restored; gain = omega_n^2 is unity DC."""

    zeta: float
    omega_n: float
    gain: float = 1.0


class TransferFunction(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """numerator / denominator, coefficients from the highest power down."""

    numerator: Array
    denominator: Array


class Plant(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A plant in exactly one form: A, B, C; second_order; companion; integrators; transfer_function; f, h; or arm.

    A (n x n), B (n x m), C (p x n); companion: [a_0, ..., a_{n-1}] of the last row -a of (15) with C = e_1;
    integrators: n, the chain (15) itself. f, h: formulas (or Python callables f(x, u), h(x) on CasADi vectors) in
    the names of `states`, `inputs` and `parameters`; x_eq, u_eq: where a nonlinear plant is linearised for gains.
    arm: a robot arm, whose numbers `parameters` changes by name (docs/robots.md). x0: initial state (default 0).
    """

    A: Array | None = None
    B: Array | None = None
    C: Array | None = None
    second_order: SecondOrder | None = None
    companion: Array | None = None
    integrators: int | None = None
    transfer_function: TransferFunction | None = None
    f: Any = None
    h: Any = None
    states: list[str] | None = None
    inputs: list[str] | None = None
    arm: ArmOptions | None = None
    parameters: dict[str, float] = {}
    x_eq: Array | None = None
    u_eq: Array | None = None
    x0: Array | None = None
