"""A plant in a user's words: one of several forms."""

from __future__ import annotations

from typing import Any

import msgspec

from undeadzone.plants.robots.options import ArmOptions
from undeadzone.support.arrays import Array


class SecondOrder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """x'' + 2 zeta omega_n x' + omega_n^2 x = gain u, (37) with its square restored.

    Attributes:
        zeta: damping ratio [1].
        omega_n: natural frequency [rad/s].
        gain: gain of the input [1/s^2]; omega_n^2 makes a DC gain of 1.
    """

    zeta: float
    omega_n: float
    gain: float = 1.0


class TransferFunction(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A strictly proper transfer function, numerator / denominator.

    Attributes:
        numerator: coefficients of the numerator, from the highest power of s down.
        denominator: coefficients of the denominator, from the highest power of s down.
    """

    numerator: Array
    denominator: Array


class Plant(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A plant in exactly one form.

    The forms are: A, B, C; second_order; companion; integrators; transfer_function; f, h; or arm.
    A plant has n states, m inputs, p outputs.

    Attributes:
        A: x' = A x + B u (n x n).
        B: gain of the input (n x m).
        C: z = C x (p x n).
        second_order: x'' + 2 zeta omega_n x' + omega_n^2 x = gain u.
        companion: [a_0, ..., a_{n-1}] of the last row -a of (15), with C = e_1 (n).
        integrators: n, the length of the chain (15) of integrators, 1 to 50.
        transfer_function: numerator / denominator.
        f: x' = f(x, u), n formulas in the names of `states`, `inputs` and `parameters`; in Python
            also a callable f(x, u) on CasADi vectors.
        h: z = h(x), p formulas, or in Python a callable h(x).
        states: names of the states in f and h (n).
        inputs: names of the inputs in f (m); default: u alone.
        arm: a robot arm (docs/robots.md).
        parameters: numbers by name, in f and h or of the arm.
        x_eq: state at which a nonlinear plant is linearised for gains (n); default: 0, of an arm at
            rest in its position of x0.
        u_eq: input at which a nonlinear plant is linearised for gains (m); default: 0, of an arm
            what holds it at x_eq.
        x0: initial state (n); default: 0.
        delay: samples by which the input acts late, of sampled time only.
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
    delay: int = 0
