"""Options of a plant, in one of several forms.

Arms as a scenario names them: `plant.arm`.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices, companion_form
from undeadzone.plants.robots.geared import Gears
from undeadzone.util.arrays import Array, require_matrix, require_number, require_series
from undeadzone.util.toml import Kind, OptionTable

ALONE = ("kind",)  # leading keys of the forms around which no loop is closed


class Rigid(OptionTable, frozen=True, kw_only=True):
    """Options of every rigid arm of N joints. Its numbers stand in `plant.parameters`.

    Attributes:
        measured: the joints' position q less `reference`, or their velocity.
        reference: position at which a sensor reads 0, one number or one per joint (N) [rad or m].
        torque_max: largest torque, one number or one per joint (N) [N m] (default: of a URDF file
            its efforts, else no limit).
        limits: [lo, hi], or one per joint (N x 2) [rad or m], which a path must keep (default: of a
            URDF file its limits, else none).
        stops: stiffness [N m/rad] and damping [N m s/rad] of mechanical stops at the limits
            (default: there are none).
        rest: speed below which Coulomb friction f v / sqrt(v^2 + rest^2) fades [rad/s].
        gears: with a gap, between motors and links (default: there are none).
    """

    measured: Literal["position", "velocity"] = "position"
    reference: Array = 0.0
    torque_max: Array | None = None
    limits: Array | None = None
    stops: tuple[float, float] | None = None
    rest: float = 0.05
    gears: Gears | None = None


class OneLink(Rigid, frozen=True, kw_only=True, tag_field="kind", tag="one_link"):
    """One link in a plane, with q from the x axis, gravity along -y (g = 0: a horizontal table)."""


class TwoLink(Rigid, frozen=True, kw_only=True, tag_field="kind", tag="two_link"):
    """Two links in a plane, gravity along -y (g = 0: a horizontal table).

    q1 is measured from the x axis, q2 from the first link.
    """


class URDF(Rigid, frozen=True, kw_only=True, tag_field="kind", tag="urdf"):
    """Serial arm of N joints from a URDF file. It needs the extra `robots`.

    Attributes:
        path: the file, relative to the scenario's.
        joints: names of those that move (N), default: all from the base to `tip` (the others stay
            at 0).
        tip: the link in which the arm ends (default: the last one).
        gravity: acceleration of gravity in base coordinates (3) [m/s^2].
    """

    path: str
    joints: list[str] | None = None
    tip: str | None = None
    gravity: Array = (0.0, 0.0, -9.81)


class ElasticJoint(Kind, frozen=True, kw_only=True, tag="elastic_joint"):
    """Motor that moves a link through a spring, with a sensor on the motor or the link (Spong
    1987).

    References:
        M. W. Spong (1987), doi:10.1115/1.3143860

    Attributes:
        measured: the part whose angle, less `reference`, is the output.
        reference: angle at which the sensor reads 0 [rad].
        torque_max: largest torque of the motor [N m] (default: no limit).
        rest: speed below which Coulomb friction f v / sqrt(v^2 + rest^2) fades [rad/s].
    """

    measured: Literal["motor", "link"] = "motor"
    reference: float = 0.0
    torque_max: float | None = None
    rest: float = 0.05


ArmOptions = OneLink | TwoLink | URDF | ElasticJoint


# --- A plant


class SecondOrder(OptionTable, frozen=True, kw_only=True):
    """Linear plant x'' + 2 zeta omega_n x' + omega_n^2 x = gain u, (37) with its square
    restored.

    Attributes:
        zeta: damping ratio [1].
        omega_n: natural frequency [rad/s].
        gain: gain of the input [1/s^2] (omega_n^2 makes a DC gain of 1).
    """

    zeta: float
    omega_n: float
    gain: float = 1.0


class TransferFunction(OptionTable, frozen=True, kw_only=True):
    """Strictly proper transfer function, numerator / denominator.

    Attributes:
        numerator: coefficients of the numerator, from the highest power of s down.
        denominator: coefficients of the denominator, from the highest power of s down.
    """

    numerator: Array
    denominator: Array


class Plant(OptionTable, frozen=True, kw_only=True):
    """Plant in exactly one form.

    The forms are (A, B, C), second_order, companion, integrators, transfer_function, (f, h), and
    arm. A plant has n states, m inputs, p outputs.

    Example:
        >>> plant = uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0])
        >>> plant.C
        [1, 0]
        >>> plant.to_control().poles().real
        array([-1., -1.])

    See Also:
        from_control, from_scipy, TransferFunction, Model

    Attributes:
        A: x' = A x + B u (n x n).
        B: gain of the input (n x m).
        C: z = C x (p x n).
        second_order: x'' + 2 zeta omega_n x' + omega_n^2 x = gain u.
        companion: [a_0, ..., a_(n-1)] of the last row -a of (15), with C = e_1 (n).
        integrators: n, the length of the chain (15) of integrators, 1 to 50.
        transfer_function: numerator / denominator.
        kind: "signal", a sensor without a known input: z is a random walk, or the integral of one,
            at a rate that the readings choose (docs/signal.md). Filters of logs alone take it.
        f: x' = f(x, u), n formulas in the names of `states`, `inputs` and `parameters`. In Python
            they may be a callable f(x, u) on CasADi vectors.
        h: z = h(x), p formulas, or in Python a callable h(x).
        states: names of the states in f and h (n).
        inputs: names of the inputs in f (m) (default: u alone).
        arm: a robot arm (docs/robots.md).
        parameters: numbers by name, in f and h or of the arm.
        x_eq: state at which a nonlinear plant is linearised for gains (n) (default: 0, of an arm at
            rest in its position of x0).
        u_eq: input at which a nonlinear plant is linearised for gains (m) (default: 0, of an arm
            the torques that hold it at x_eq).
        x0: initial state (n), or one number for every entry (default: 0).
        delay: samples by which the input acts late, of sampled time only.
    """

    A: Array | None = None
    B: Array | None = None
    C: Array | None = None
    second_order: SecondOrder | None = None
    companion: Array | None = None
    integrators: int | None = None
    kind: Literal["signal"] | None = None
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

    def to_control(self) -> Any:
        """Return a linear plant as `control.StateSpace`, as `uz.to_control` does."""
        return to_control(self)


# --- Matrices of a linear plant


def to_control(plant: Plant) -> Any:
    """Return the plant as `control.StateSpace` (extra `control`).

    Args:
        plant: a linear plant in any form.

    Returns:
        The state-space object, with D = 0.

    Raises:
        InputError: the plant is nonlinear, or its numbers are wrong.
    """
    import control

    A, B, C = linear_matrices(plant)
    return control.ss(A, B, C, np.zeros((C.shape[0], B.shape[1])))


def linear_matrices(plant: Plant, key: str = "plant") -> Matrices:
    """Return the matrices of a linear plant in any form.

    Args:
        plant: the plant in words.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if plant.second_order is not None:
        return _second_order_matrices(f"{key}.second_order", plant.second_order)
    if plant.companion is not None:
        return companion_form(require_series(f"{key}.companion", plant.companion))
    if plant.integrators is not None:
        if not 1 <= plant.integrators <= 50:
            raise InputError(f"{key}.integrators: expected 1 to 50, found {plant.integrators}")
        return companion_form(np.zeros(plant.integrators))
    if plant.kind is not None:
        A, _, C = companion_form(np.zeros(2))
        return Matrices(A, np.zeros((2, 0)), C)
    if plant.transfer_function is not None:
        return _transfer_function_matrices(f"{key}.transfer_function", plant.transfer_function)
    if plant.f is not None or plant.arm is not None:
        raise InputError(f"{key}: is nonlinear. Matrices A, B, C exist for a linear plant only")
    return _require_given_matrices(plant, key)


def _require_given_matrices(plant: Plant, key: str) -> Matrices:
    """Return the matrices A, B, C that a plant specifies itself."""
    for name in "ABC":
        if getattr(plant, name) is None:
            raise InputError(
                f"{key}.{name}: missing. A linear plant needs A (n x n), B (n x m) and C (p x n)"
            )
    A = require_matrix(f"{key}.A", plant.A)
    n = A.shape[0]
    A = require_matrix(f"{key}.A", plant.A, n, n, "A must be square")
    B = require_matrix(
        f"{key}.B", _reshape_single(plant.B, (n, 1)), n, None, f"as many rows as A, {n}"
    )
    C = require_matrix(
        f"{key}.C", _reshape_single(plant.C, (1, n)), None, n, f"as many columns as A, {n}"
    )
    return Matrices(A, B, C)


def _reshape_single(value: Any, shape: tuple[int, int]) -> Any:
    """Return B for a single input, or C for a single output, from a plain list of n numbers, else
    unchanged.
    """
    return np.reshape(value, shape) if np.shape(value) == (max(shape),) else value


def _second_order_matrices(key: str, options: SecondOrder) -> Matrices:
    """Return the matrices of (37) in companion form."""
    zeta = require_number(f"{key}.zeta", options.zeta)
    gain = require_number(f"{key}.gain", options.gain)
    omega = require_number(f"{key}.omega_n", options.omega_n, above=0.0)
    unit = companion_form([omega * omega, 2 * zeta * omega])
    return unit._replace(B=gain * unit.B)


def _transfer_function_matrices(key: str, options: TransferFunction) -> Matrices:
    """Return the matrices of a transfer function in companion form."""
    num = np.trim_zeros(require_series(f"{key}.numerator", options.numerator), "f")
    den = np.trim_zeros(require_series(f"{key}.denominator", options.denominator), "f")
    if den.size < 2 or num.size == 0:
        raise InputError(f"{key}: needs a non-zero numerator and a denominator of order 1 or more")
    if num.size >= den.size:
        orders = f"numerator order {num.size - 1} < denominator order {den.size - 1}"
        raise InputError(f"{key}: must be strictly proper ({orders})")
    with np.errstate(over="ignore"):
        return companion_form((den / den[0])[:0:-1], (num / den[0])[::-1])
