"""Common form of all plants, `System`: pure functions on CasADi expressions and their numbers."""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices, balance_states, change_state_units, feedback_loops
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.numerics.runge_kutta import rk4_change
from undeadzone.plants.robots.arm import Arm
from undeadzone.plants.robots.geared import Geared
from undeadzone.util.arrays import LARGEST, Floats


class Flat(NamedTuple):
    """Flat coordinates of a plant.

    With their derivatives up to `order` they determine state and input (flatness: Fliess and others
    1995).

    Attributes:
        order: order of the highest derivative.
        solve: (params, derivatives (coordinates x order + 1)) -> (x, u), in continuous time.
    """

    order: int
    solve: Callable[[Any, Any], tuple[Any, Any]]


class System(NamedTuple):
    """Dynamics as pure functions on CasADi expressions, and their numbers.

    Attributes:
        params: the numbers: `Matrices` of a linear plant, a vector of a nonlinear one.
        move: (params, x, u) -> the derivative of x, or its next value when Ts is set (n).
        output: (params, x) -> z (p).
        linear: the matrices, or those of the linearisation at (x_eq, u_eq) for a nonlinear plant.
        nonlinear: whether the plant is nonlinear.
        Ts: sample time [s] (None in continuous time).
        flow: the matrices in continuous time of a sampled plant.
        arm: links and joints of a robot (x = `[q; q']` of a rigid one).
        gears: between motors and links of an arm (None: there are none).
        seen: (params, x) -> input of the sensor in the place of z (p), as encoders at the motors of
            links z (None: z itself).
        flat: the state and input of a robot along a path of its joints.
        limit: largest |u| of a robot (m) [N m or N], infinite without a limit.
        names: names of the parameters of a nonlinear plant, in the order of params.
        rate: `move` before the plant was sampled.
        change: (params, x, u) -> next value less x (n) of a sampled plant, without the rounding
            that their difference would have.
        actuator: knowledge about the actuator ahead of it, whose widths an observer may estimate
            (None: there is none).
        delay: samples by which an input acts late. The functions above take the input that acts.
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
    change: Callable[[Any, Any, Any], Any] | None = None
    actuator: Belief | None = None
    delay: int = 0
    gears: Geared | None = None
    seen: Callable[[Any, Any], Any] | None = None

    @property
    def continuous(self) -> Matrices:
        """Return the matrices in continuous time, also for a sampled plant."""
        return self.linear if self.flow is None else self.flow

    @property
    def per_step(self) -> float:
        """Return the factor from a rate x' to the method's output: the sample time [s], or
        1 in continuous time.
        """
        return 1.0 if self.Ts is None else self.Ts

    @property
    def keep(self) -> float:
        """Return 1 if a method returns the next value of its state, 0 if it returns its
        rate.
        """
        return 0.0 if self.Ts is None else 1.0

    def filtering(self, time: Any) -> Any:
        """Return the rate of a filter of this time constant [s]: 1 / time, or its share
        per sample.
        """
        return 1.0 / time if self.Ts is None else -np.expm1(-self.Ts / time)

    @property
    def n(self) -> int:
        """Return the number of states."""
        return self.linear.A.shape[0]

    @property
    def m(self) -> int:
        """Return the number of inputs."""
        return self.linear.B.shape[1]

    @property
    def p(self) -> int:
        """Return the number of outputs."""
        return self.linear.C.shape[0]

    def read(self, params: Any, x: Any) -> Any:
        """Return the input of the sensor (p): z, or `seen` in its place."""
        return self.output(params, x) if self.seen is None else self.seen(params, x)

    def joints(self, params: Any, x: Any) -> tuple[Any, Any]:
        """Return (parameters of `arm`, positions of its joints (N)) in parameters and a
        state.
        """
        assert self.arm is not None
        N = self.arm.joint_count
        if self.gears is None:
            return params, x[:N]
        return self.gears.link_params(params), x[N : 2 * N]

    def move_with_correction(self, params: Any, x: Any, u: Any, push: Any) -> Any:
        """Return `move` plus the effect of a correction (n). For a sampled plant this is one
        increment of x.
        """
        if self.change is None:
            return self.move(params, x, u) + push
        return x + (self.change(params, x, u) + push)


def linearise_plant(
    key: str, params: Floats, move: Any, output: Any, x_eq: Floats, u_eq: Floats
) -> System:
    """Return a continuous nonlinear plant with its linearisation.

    Args:
        key: name of the plant in messages.
        params: the plant's numbers.
        move: (params, x, u) -> the derivative of x (n).
        output: (params, x) -> z (p).
        x_eq: the state at which to linearise (n).
        u_eq: the input at which to linearise (m).

    Raises:
        ShapeError: not one derivative per state.
        InputError: a derivative is not finite there.
    """
    x = ca.SX.sym("x", x_eq.size)
    u = ca.SX.sym("u", u_eq.size)
    dx = move(ca.SX(params), x, u)
    z = output(ca.SX(params), x)
    if dx.shape != x.shape:
        shape = f"{dx.shape[0]} x {dx.shape[1]}"
        raise ShapeError(
            f"{key}.f: expected {x.shape[0]} derivatives (one per state), found {shape}"
        )
    jacobians = ca.Function(
        "jacobians", [x, u], [ca.jacobian(dx, x), ca.jacobian(dx, u), ca.jacobian(z, x)]
    )
    linear = Matrices(*(np.asarray(value.full()) for value in jacobians(x_eq, u_eq)))
    if not all((np.abs(value) < LARGEST**2).all() for value in linear):
        raise InputError(
            f"{key}: f or h cannot be linearised at x_eq, u_eq (a derivative there is not finite)"
        )
    return System(params, move, output, linear, nonlinear=True)


def sample_plant(plant: System, Ts: float, substeps: int = 10) -> System:
    """Return the plant sampled every Ts [s] with u held, as x plus its change in a sample.

    An exact zero-order hold if the plant is linear, else RK4 with `substeps` steps.
    """
    linear = zoh(plant.linear, Ts)

    def change_of_hold(params: Matrices, x: Any, u: Any) -> Any:
        """Return the change of x in a sample of a linear plant (n)."""
        return (params.A - np.eye(plant.n)) @ x + params.B @ u

    def change_of_steps(params: Any, x: Any, u: Any) -> Any:
        """Return the change of x in a sample by Runge-Kutta steps (n)."""
        total = 0.0
        for _ in range(substeps):
            now = x + total
            total += rk4_change(lambda state, _: plant.move(params, state, u), now, Ts / substeps)
        return total

    change = change_of_steps if plant.nonlinear else change_of_hold

    def move(params: Any, x: Any, u: Any) -> Any:
        """Return x+ (n)."""
        return x + change(params, x, u)

    return plant._replace(
        params=plant.params if plant.nonlinear else linear,
        move=move,
        linear=linear,
        Ts=Ts,
        flow=plant.linear,
        rate=plant.move if plant.nonlinear else None,
        change=change,
    )


class ScaledMatrices(NamedTuple):
    """Numbers of a linear plant whose states have units of their own.

    Attributes:
        A, B, C: its matrices in the plant's units.
        units: of the states (n).
    """

    A: Any
    B: Any
    C: Any
    units: Any


def scale_states(system: System, units: Floats) -> System:
    """Return a sampled system with states in these units (n): x = units x_counted.

    Of a linear plant the units are numbers like others, so that one graph serves plants whose units
    differ.
    """
    if system.nonlinear and (units == 1).all():
        return system
    move = system.move
    output = system.output
    change = system.change
    rate = system.rate
    assert change is not None

    params = system.params
    if not system.nonlinear:
        params = ScaledMatrices(params.A, params.B, params.C, units)

    def select_units(params: Any) -> Any:
        """Return the units in the params (n)."""
        return units if system.nonlinear else params.units

    def counted(function: Callable[[Any, Any, Any], Any]) -> Callable[[Any, Any, Any], Any]:
        """Return a function of a scaled state."""
        return lambda params, x, u: (
            function(params, select_units(params) * x, u) / select_units(params)
        )

    return system._replace(
        params=params,
        move=counted(move),
        output=lambda params, x: output(params, select_units(params) * x),
        change=counted(change),
        rate=None if rate is None else counted(rate),
        linear=_scale_matrices(system.linear, units),
        flow=_scale_matrices(system.continuous, units),
    )


def _scale_matrices(linear: Matrices, units: Floats) -> Matrices:
    """Return the matrices for states in these units (n)."""
    A, B, C = linear
    return Matrices(change_state_units(A, units), B / units[:, None], C * units)


def hold_integral(model: System) -> Floats:
    """Return the integral of e^(A t) over one step (n x n) [s]: the effect of a constant w in
    x' = f(x, u) + w.

    w is held over a step: the integral of e^(A t).
    """
    assert model.Ts is not None
    return zoh(model.continuous._replace(B=np.eye(model.n)), model.Ts).B


# --- How fast a plant moves


QUARTER = (
    50.0  # samples in a quarter period of a chain of integrators, which has no time of its own
)
UNSTABLE = 2.0  # poles of the loop around an unstable pole, at least, in that pole
STILL = 1e-6  # of |A|, balanced: a pole this close to 0 is an integrator's


def holds_no_width(A: Floats) -> bool:
    """Return whether x' = A x has an odd number of unstable poles and no integrator."""
    poles = _find_moving_poles(A)
    return len(poles) == len(A) and bool((poles.real > 0).sum() % 2)


def _find_moving_poles(A: Floats) -> np.ndarray:
    """Return the poles of x' = A x that are not those of integrators."""
    poles = np.linalg.eigvals(A)
    loops = feedback_loops(A)
    size = np.linalg.norm(change_state_units(loops, balance_states(loops)), 2)
    return np.asarray(poles[np.abs(poles) > STILL * size])


def moving_poles(model: System) -> Floats:
    """Return |pole| of the plant in continuous time [1/s], those of integrators left out.

    One rate of 1 for a chain of integrators.
    """
    moving = np.abs(_find_moving_poles(model.continuous.A))
    return moving if moving.size else np.ones(1)


def fastest_pole(model: System) -> float:
    """Return the largest of `moving_poles` [1/s]."""
    return float(moving_poles(model).max())


def mean_pole(model: System) -> float:
    """Return the geometric mean of `moving_poles` [1/s]."""
    return float(np.exp(np.log(moving_poles(model)).mean()))


def time_scale(flow: Matrices, Ts: float | None = None) -> float:
    """Return a quarter period pi / (2 |pole|) [s], geometric mean over the poles that are not
    integrators.

    If all are, `QUARTER` samples: who samples so fast expects changes as fast. Of an unstable pole
    `UNSTABLE` times its size counts: the loop around it must be as fast.

    Args:
        flow: the matrices in continuous time.
        Ts: sample time [s] (None in continuous time, in which a chain of integrators gets 1 s).
    """
    poles = _find_moving_poles(flow.A)
    if not poles.size:
        return 1.0 if Ts is None else QUARTER * Ts
    unstable = poles.real > STILL * np.abs(poles)
    moving = np.abs(poles) * np.where(unstable, UNSTABLE, 1.0)
    return float(np.pi / 2 * np.exp(-np.log(moving).mean()))


def arrival_time(flow: Matrices, Ts: float | None = None) -> float:
    """Return a quarter period, and 1 / |pole| for each further pole that an input passes to an
    output [s].

    The poles count per output. Until then an input has moved z by about the same share of its final
    effect for any order. flow, Ts: as for `time_scale`. Integrators are not a delay.
    """
    further = max(_find_moving_poles(flow.A).size / flow.C.shape[0] - 1.0, 0.0)
    return time_scale(flow, Ts) * (1 + 2 / np.pi * further)


def plant_pace(flow: Matrices, Ts: float | None = None) -> float:
    """Return the speed of the plant [1/s]: |pole| of equal poles, else at least their mean.

    It is the largest of the k-th roots of the mean products of k poles, which rounding hardly
    changes where poles are nearly equal. That of `time_scale` for a chain of integrators, 1 in
    continuous time. flow, Ts: as there.
    """
    poles = _find_moving_poles(flow.A)
    if not poles.size:
        return 1.0 if Ts is None else float(np.pi / 2) / time_scale(flow, Ts)
    sums = np.abs(np.poly(poles))
    means = [(sums[k] / comb(poles.size, k)) ** (1 / k) for k in range(1, sums.size)]
    return float(max(means))


def state_units(flow: Matrices, Ts: float | None = None) -> Floats:
    """Return the amount of each state that appears as a z of 1, in powers of the plant's
    `plant_pace` (n) [x / z].

    State i of unit s shows in the k-th derivative of z as C A^k, which counts in units of pace^k.
    In these units a plant does not depend on its unit of time or on the units of its states.

    Args:
        flow: the matrices in continuous time.
        Ts: sample time [s] (None in continuous time).
    """
    rate = plant_pace(flow, Ts)
    output_rows = flow.C
    seen = np.abs(flow.C).max(axis=0)
    for _ in range(1, flow.A.shape[0]):
        output_rows = output_rows @ flow.A / rate
        seen = np.maximum(seen, np.abs(output_rows).max(axis=0))
    some = seen[seen > 0]
    least = some.min() if some.size else 1.0
    return np.asarray(1 / np.where(seen > 0, seen, least))
