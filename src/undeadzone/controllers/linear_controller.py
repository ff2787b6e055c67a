"""User-defined linear controller on the estimated output: state space or transfer function."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.controllers.parts import require_square, select_tracked_output
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.matrices import spectral_radius
from undeadzone.plants.interop import to_state_space
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_array, require_matrix, require_number

SAME_STEP = 1e-9  # relative difference of two sample times that are the same


class LinearController(Options, frozen=True, tag="linear"):
    """Linear controller x_c' = A x_c + B e, u = C x_c + D e with e = r - z^.

    Any tool may design it.

    z^ is the observer's estimate of the hidden output. Give A, B, C, D, or numerator and
    denominator (one output and one input), or in Python the object itself:
    `LinearController(control.ss(...))`, `LinearController(control.tf(...))`, and those of scipy.
    A continuous controller in a sampled loop is discretised by Tustin's rule.

    Example:
        >>> uz.LinearController(numerator=[2.0, 1.0], denominator=[1.0, 0.0]).numerator
        [2.0, 1.0]

    See Also:
        PID, StateFeedback

    Attributes:
        A: (k x k) [1/s] (in Python also a system of scipy or python-control, for all of them).
        B: (k x p).
        C: (m x k).
        D: (m x p) (default 0).
        numerator, denominator: of the transfer function from e to u, highest power first.
        Ts: sample time of a controller in discrete time [s] (default: continuous time).
        feedforward: whether u_ff, which makes the model follow r exactly, is added.
    """

    A: Array | None = None
    B: Array | None = None
    C: Array | None = None
    D: Array | None = None
    numerator: Array | None = None
    denominator: Array | None = None
    Ts: float | None = None
    feedforward: bool = False

    def __post_init__(self) -> None:
        """Convert a system of a third-party package to matrices. Raises InputError."""
        if hasattr(self.A, "to_ss") or hasattr(self.A, "dt"):
            _unpack_system(self, self.A)

    def build(self, model: System) -> Controller:
        """Return the controller for a model with as many inputs as outputs.

        Raises InputError, ShapeError.
        """
        require_square("linear", model)
        numbers = self._read_matrices(model)
        params = self._to_model_time(model, numbers)

        def init(p: Params) -> State:
            """Return the state at t = 0: zeros."""
            return State(np.zeros(params.A.shape[0]))

        def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
            """Return the state's derivative, or its next value if sampled, and u (m)."""
            e = target.r - select_tracked_output("linear", estimate, target)
            u = p.C @ s.x + p.D @ e
            if self.feedforward:
                u = u + target.u_ff
            return State(p.A @ s.x + p.B @ e), u

        return Controller(params, init, step, rate=_largest_pole(numbers.A, self.Ts))

    def _read_matrices(self, model: System) -> Params:
        """Return A, B, C, D as given. Raises InputError, ShapeError."""
        by_matrices = [name for name in "ABCD" if getattr(self, name) is not None]
        by_function = self.numerator is not None or self.denominator is not None
        if by_function and by_matrices:
            raise InputError(
                "controller: 'linear' needs A, B, C, D or numerator and denominator, not both, "
                f"found {', '.join(by_matrices)} and a transfer function"
            )
        if by_function:
            return self._realise_transfer_function()
        m = model.m
        p = model.p
        D: Floats = np.zeros((m, p))
        if self.D is not None:
            D = require_matrix("controller.D", self.D, m, p, "inputs x outputs")
        if self.A is None and self.B is None and self.C is None:
            if self.D is None:
                raise InputError(
                    "controller: 'linear' needs A, B, C and D, or numerator and denominator, or D "
                    "alone"
                )
            return _static_gain(D)
        absent = [name for name in "ABC" if getattr(self, name) is None]
        if absent:
            raise InputError(f"controller.{absent[0]}: 'linear' needs A, B and C together")
        A = require_matrix("controller.A", self.A)
        k = A.shape[0]
        A = require_matrix("controller.A", A, k, k, "square")
        B = require_matrix("controller.B", self.B, k, p, "controller's states x outputs")
        C = require_matrix("controller.C", self.C, m, k, "inputs x controller's states")
        return Params(A, B, C, D)

    def _realise_transfer_function(self) -> Params:
        """Return a realisation of the transfer function. Raises InputError."""
        from scipy.signal import tf2ss

        if self.numerator is None or self.denominator is None:
            absent = "numerator" if self.numerator is None else "denominator"
            raise InputError(f"controller.{absent}: 'linear' needs numerator and denominator")
        numerator = np.trim_zeros(
            np.atleast_1d(require_array("controller.numerator", self.numerator)), "f"
        )
        denominator = np.atleast_1d(require_array("controller.denominator", self.denominator))
        denominator = np.trim_zeros(denominator, "f")
        if numerator.ndim != 1 or denominator.ndim != 1:
            raise InputError("controller.numerator: expected one list of coefficients")
        if denominator.size == 0 or numerator.size > denominator.size:
            raise InputError(
                "controller.denominator: must be of the numerator's order or above, which is "
                f"{max(numerator.size - 1, 0)}, found order {denominator.size - 1}. Add a filter"
            )
        if numerator.size == 0:
            numerator = np.zeros(1)
        if denominator.size == 1:
            return _static_gain(np.array([[numerator[0] / denominator[0]]]))
        return Params(*(np.asarray(part, float) for part in tf2ss(numerator, denominator)))

    def _to_model_time(self, model: System, numbers: Params) -> Params:
        """Return the matrices in the time of the model. Raises InputError, ShapeError."""
        if numbers.D.shape != (model.m, model.p):
            raise InputError(
                "controller.numerator: a transfer function is for a plant of one input and one "
                f"output, the plant has {model.m} and {model.p}. Use A, B, C, D"
            )
        if self.Ts is None:
            return numbers if model.Ts is None else _discretise_tustin(numbers, model.Ts)
        Ts = require_number("controller.Ts", self.Ts, above=0.0)
        if model.Ts is None:
            raise InputError(
                "controller.Ts: a controller in discrete time needs simulation.time = "
                f'"sampled" and simulation.step = {Ts:g}'
            )
        if abs(Ts - model.Ts) > SAME_STEP * model.Ts:
            raise InputError(
                f"controller.Ts: must be simulation.step, {model.Ts:g} s, found {Ts:g} s"
            )
        return numbers


class Params(NamedTuple):
    """Parameters of the controller.

    Attributes:
        A: (k x k) [1/s], per step when sampled.
        B: (k x p).
        C: (m x k).
        D: (m x p).
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats


class State(NamedTuple):
    """State of the controller (k)."""

    x: Any


def _static_gain(D: Floats) -> Params:
    """Return the matrices of a gain without states (m x p)."""
    m, p = D.shape
    return Params(np.zeros((0, 0)), np.zeros((0, p)), np.zeros((m, 0)), D)


def _unpack_system(options: LinearController, system: Any) -> None:
    """Replace a system in the options by its matrices. Raises InputError."""
    space = to_state_space(system, "controller", "LinearController")
    for name in "ABCD":
        numbers = np.atleast_2d(np.asarray(getattr(space, name), float))
        msgspec.structs.force_setattr(options, name, numbers if numbers.size else None)
    dt = getattr(system, "dt", None)
    if dt is True:
        raise InputError("controller: the system is in discrete time without a sample time. Set it")
    if dt:
        msgspec.structs.force_setattr(options, "Ts", float(dt))


def _discretise_tustin(numbers: Params, Ts: float) -> Params:
    """Return a continuous controller discretised by s = 2/Ts (z - 1)/(z + 1).

    This is the bilinear rule.

    Raises InputError if it has a pole at 2/Ts.
    """
    A, B, C, D = numbers
    identity = np.eye(A.shape[0])
    implicit = identity - Ts / 2 * A
    if A.size and np.linalg.cond(implicit) > 1 / np.finfo(float).eps:
        raise InputError(
            f"controller.A: has a pole at 2 / simulation.step = {2 / Ts:g} 1/s. Use a smaller step"
        )
    forward = np.linalg.solve(implicit, identity + Ts / 2 * A)
    driven = np.linalg.solve(implicit, Ts * B)
    seen = (C @ np.linalg.inv(implicit)) if A.size else C
    return Params(forward, driven, seen, D + seen @ (Ts / 2 * B))


def _largest_pole(A: Floats, Ts: float | None) -> float | None:
    """Return the largest abs(pole) of a continuous controller [1/s], or None without poles."""
    if Ts is not None or A.size == 0:
        return None
    return spectral_radius(A) or None
