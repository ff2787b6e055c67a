"""Plants: x' = f(x, u), z = h(x); linear ones (14), (15), (37)-(39) and known nonlinear ones share one shape, `System`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone import expression
from undeadzone.arrays import LARGEST, Array, Floats, matrix, scalar, series, vector
from undeadzone.errors import InputError, ShapeError
from undeadzone.integrate import rk4
from undeadzone.robots.arm import Arm
from undeadzone.robots.options import ArmOptions


class Matrices(NamedTuple):
    """A (n x n), B (n x m), C (p x n) of x' = A x + B u (or x+ = ... when sampled), z = C x."""

    A: Floats
    B: Floats
    C: Floats


class Flat(NamedTuple):
    """Coordinates that, with their derivatives up to `order`, say what state and input are (flatness: Fliess and others 1995).

    solve(params, derivatives (coordinates x order + 1)): (x, u) in continuous time.
    """

    order: int
    solve: Callable[[Any, Any], tuple[Any, Any]]


class System(NamedTuple):
    """Dynamics as pure functions on CasADi expressions, and their numbers.

    move(params, x, u): the derivative of x, or its next value when Ts [s] is set; output(params, x): z.
    linear: the matrices, or those of the linearisation at (x_eq, u_eq) for a nonlinear plant; flow: those in continuous
    time of a sampled plant. Of robots: arm: links and joints, of rigid ones x = [q; q'];
    flat: the state and input along a path of the joints; limit: largest |u| (m), infinite where there is none.
    names: of the parameters of a nonlinear plant, in the order of params; rate: what `move` was before it was sampled.
    """

    params: Any
    move: Callable[[Any, Any, Any], Any]
    output: Callable[[Any, Any], Any]
    linear: Matrices
    nonlinear: bool
    Ts: float | None = None
    flow: Matrices | None = None
    arm: Arm | None = None
    flat: Flat | None = None
    limit: Floats | None = None
    names: tuple[str, ...] = ()
    rate: Callable[[Any, Any, Any], Any] | None = None

    @property
    def n(self) -> int:
        """Number of states."""
        return self.linear.A.shape[0]

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.linear.B.shape[1]

    @property
    def p(self) -> int:
        """Number of outputs."""
        return self.linear.C.shape[0]


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


# Each form by its leading key, and the keys that belong to it.
_FORMS = {
    "A": ("B", "C"),
    "second_order": (),
    "companion": (),
    "integrators": (),
    "transfer_function": (),
    "f": ("h", "states", "inputs", "parameters", "x_eq", "u_eq"),
    "arm": ("parameters", "x_eq", "u_eq"),
}


def companion(a: Any, b: Any = (1.0,)) -> Matrices:
    """Companion form (15) with last row -a: A (n x n), B = e_n, C = [b_0, b_1, ...] of the numerator, lowest first."""
    a, b = np.atleast_1d(a), np.atleast_1d(b)
    n = a.size
    A = np.eye(n, k=1)
    A[-1] = -a
    return Matrices(A, np.eye(n)[:, -1:], np.pad(b, (0, n - b.size))[None, :])


def _transfer_function(key: str, given: TransferFunction) -> Matrices:
    num, den = (np.trim_zeros(series(f"{key}.{name}", getattr(given, name)), "f") for name in ("numerator", "denominator"))
    if den.size < 2 or num.size == 0:
        raise InputError(f"{key}: needs a non-zero numerator and a denominator of order 1 or more")
    if num.size >= den.size:
        raise InputError(f"{key}: must be strictly proper (numerator order {num.size - 1} < denominator order {den.size - 1})")
    with np.errstate(over="ignore"):
        return companion((den / den[0])[:0:-1], (num / den[0])[::-1])


def matrices(plant: Plant, key: str = "plant") -> Matrices:
    """The matrices of a linear plant given in any form. Raises InputError, ShapeError."""
    if plant.second_order is not None:
        zeta, gain = (scalar(f"{key}.second_order.{name}", getattr(plant.second_order, name)) for name in ("zeta", "gain"))
        omega = scalar(f"{key}.second_order.omega_n", plant.second_order.omega_n, above=0.0)
        found = companion([omega * omega, 2 * zeta * omega])
        return found._replace(B=gain * found.B)
    if plant.companion is not None:
        return companion(series(f"{key}.companion", plant.companion))
    if plant.integrators is not None:
        if not 1 <= plant.integrators <= 50:
            raise InputError(f"{key}.integrators: expected 1 to 50, found {plant.integrators}")
        return companion(np.zeros(plant.integrators))
    if plant.transfer_function is not None:
        return _transfer_function(f"{key}.transfer_function", plant.transfer_function)
    if plant.f is not None or plant.arm is not None:
        raise InputError(f"{key}: is nonlinear; matrices A, B, C exist for a linear plant only")
    for name in "ABC":
        if getattr(plant, name) is None:
            raise InputError(f"{key}.{name}: missing; a linear plant needs A (n x n), B (n x m) and C (p x n)")
    A = matrix(f"{key}.A", plant.A)
    n = A.shape[0]
    A = matrix(f"{key}.A", plant.A, n, n, "A must be square")
    return Matrices(
        A,
        matrix(f"{key}.B", plant.B, n, None, f"as many rows as A, {n}"),
        matrix(f"{key}.C", plant.C, None, n, f"as many columns as A, {n}"),
    )


def system(plant: Plant, key: str = "plant") -> System:
    """The continuous-time `System` of a plant. Raises InputError, ShapeError that name the key."""
    given = [form for form in _FORMS if getattr(plant, form) is not None]
    if len(given) != 1:
        found = f"found {' and '.join(given)}" if given else "found none"
        raise InputError(f"{key}: give exactly one form ({', '.join(_FORMS)}), {found}")
    known = {given[0], *_FORMS[given[0]], "x0"}
    present = [name for name in Plant.__struct_fields__ if not (getattr(plant, name) is None or (name == "parameters" and not plant.parameters))]
    if unused := [name for name in present if name not in known]:
        raise InputError(f"{key}.{unused[0]}: has no meaning for a plant given by {given[0]}; remove one of them")
    if plant.f is not None:
        return _nonlinear(plant, key)
    if plant.arm is not None:
        from undeadzone.robots.plants import robot

        return robot(plant, plant.arm, key)
    linear = matrices(plant, key)
    if not all(np.abs(part).max() < LARGEST**2 for part in linear):
        raise InputError(f"{key}.{given[0]}: its numbers are too far apart to compute with")
    return System(linear, _linear_move, _linear_output, linear, nonlinear=False)


def initial_state(plant: Plant, n: int, key: str = "plant") -> Floats:
    """x(0), zeros if not given. Raises ShapeError."""
    return np.zeros(n) if plant.x0 is None else vector(f"{key}.x0", plant.x0, n, "one per state")


def _linear_move(params: Matrices, x: Any, u: Any) -> Any:
    return params.A @ x + params.B @ u


def _linear_output(params: Matrices, x: Any) -> Any:
    return params.C @ x


def _nonlinear(plant: Plant, key: str) -> System:
    names = list(plant.parameters)
    if callable(plant.f) != callable(plant.h):
        raise InputError(f"{key}: f and h must both be formulas or both be callables")
    if callable(plant.f):
        if plant.states is not None:
            n = len(plant.states)
        elif plant.x0 is not None:
            n = np.size(plant.x0)
        else:
            raise InputError(f"{key}: a plant given by callables needs x0 or states, to know its order")
        m = len(plant.inputs) if plant.inputs is not None else 1

        def move(params: Any, x: Any, u: Any) -> Any:
            return ca.SX(plant.f(x, u))

        def output(params: Any, x: Any) -> Any:
            return ca.SX(plant.h(x))
    else:
        states, inputs = plant.states, plant.inputs or ["u"]
        if not (isinstance(plant.f, list) and isinstance(plant.h, list) and states):
            raise InputError(f"{key}: formulas need lists f and h and the names in states (and inputs)")
        if len(plant.f) != len(states):
            raise ShapeError(f"{key}.f: expected {len(states)} formulas (one per state), found {len(plant.f)}")
        if len({*states, *inputs, *names}) < len(states) + len(inputs) + len(names):
            raise InputError(f"{key}: a name is used twice among states, inputs and parameters")
        if not all(isinstance(text, str) for text in [*plant.f, *plant.h]) or not plant.h:
            raise InputError(f"{key}: every entry of f and h must be a formula in quotes, and h must not be empty")
        n, m = len(states), len(inputs)

        def scope(params: Any, x: Any) -> dict[str, Any]:
            return dict(zip([*states, *names], [*ca.vertsplit(x), *ca.vertsplit(params)], strict=True))

        def move(params: Any, x: Any, u: Any) -> Any:
            bound = scope(params, x) | dict(zip(inputs, ca.vertsplit(u), strict=True))
            return ca.vertcat(*(expression.evaluate(f"{key}.f[{i}]", text, bound) for i, text in enumerate(plant.f)))

        def output(params: Any, x: Any) -> Any:
            bound = scope(params, x)
            return ca.vertcat(*(expression.evaluate(f"{key}.h[{i}]", text, bound) for i, text in enumerate(plant.h)))

    params = np.array([scalar(f"{key}.parameters.{name}", plant.parameters[name]) for name in names])
    x_eq = np.zeros(n) if plant.x_eq is None else vector(f"{key}.x_eq", plant.x_eq, n, "one per state")
    u_eq = np.zeros(m) if plant.u_eq is None else vector(f"{key}.u_eq", plant.u_eq, m, "one per input")
    linear = linearise(key, move, output, params, x_eq, u_eq)
    return System(params, move, output, linear, nonlinear=True, names=tuple(names))


def linearise(key: str, move: Any, output: Any, params: Floats, x_eq: Floats, u_eq: Floats) -> Matrices:
    """The linearisation of a continuous plant. Raises ShapeError, InputError."""
    x, u = ca.SX.sym("x", x_eq.size), ca.SX.sym("u", u_eq.size)
    dx, z = move(ca.SX(params), x, u), output(ca.SX(params), x)
    if dx.shape != x.shape:
        raise ShapeError(f"{key}.f: expected {x.shape[0]} derivatives (one per state), found {dx.shape[0]} x {dx.shape[1]}")
    jacobians = ca.Function("jacobians", [x, u], [ca.jacobian(dx, x), ca.jacobian(dx, u), ca.jacobian(z, x)])
    found = Matrices(*(np.asarray(value.full()) for value in jacobians(x_eq, u_eq)))
    if not all((np.abs(value) < LARGEST**2).all() for value in found):
        raise InputError(f"{key}: f or h cannot be linearised at x_eq, u_eq (a derivative there is not finite)")
    return found


def sampled(plant: System, Ts: float, substeps: int = 10) -> System:
    """The plant seen every Ts [s] with u held: exact zero-order hold if linear, else RK4 with `substeps`."""
    linear = zoh(plant.linear, Ts)
    if not plant.nonlinear:
        return plant._replace(params=linear, linear=linear, Ts=Ts, flow=plant.linear)

    def move(params: Any, x: Any, u: Any) -> Any:
        for _ in range(substeps):
            x = rk4(lambda state, _: plant.move(params, state, u), x, Ts / substeps)
        return x

    return plant._replace(move=move, linear=linear, Ts=Ts, flow=plant.linear, rate=plant.move)


def zoh(linear: Matrices, Ts: float) -> Matrices:
    """Exact zero-order hold: Ad = e^{A Ts}, Bd = int_0^Ts e^{A t} dt B, C unchanged."""
    from scipy.linalg import expm

    n, m = linear.B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = linear.A, linear.B
    both = expm(block * Ts)
    return Matrices(both[:n, :n], both[:n, n:], linear.C)


def held(model: System) -> Floats:
    """What a sampled model adds to x+ per unit of w in x' = f(x, u) + w, w held over a step (n x n): the integral of e^(A t)."""
    assert model.flow is not None
    assert model.Ts is not None
    return zoh(model.flow._replace(B=np.eye(model.n)), model.Ts).B


def sampled_noise(A: Floats, W: Floats, Ts: float) -> tuple[Floats, Floats]:
    """(e^{A Ts}, the covariance that white noise of density W (n x n) per second adds to x' = A x + w over Ts [s]), van Loan (1978)."""
    from scipy.linalg import expm

    n = A.shape[0]
    both = expm(np.block([[-A, W], [np.zeros((n, n)), A.T]]) * Ts)
    Ad = both[n:, n:].T
    return Ad, Ad @ both[:n, n:]
