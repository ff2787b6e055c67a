"""Output feedback that knows of the plant only its order and its input gain, and learns the rest with W'phi(x^)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linear.hold import zoh
from undeadzone.linear.matrices import Matrices, companion
from undeadzone.linear.poles import observer_gain
from undeadzone.numerics.approximators import Basis
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole, in_poles
from undeadzone.support.arrays import Array, Floats, listed, positive


class Params(NamedTuple):
    """Numbers of the controller.

    chain, input: of the r integrators (per step when sampled); L: gain of their observer (r), per step when sampled; L_top: its last
    entry [1/s]; reference (r x n), top (n): r and its derivatives from x_ref, b: input gain; feedback (r), slide (r): of
    the error; gain, leak: of the weights, per step when sampled.
    """

    basis: Any
    chain: Floats
    input: Floats
    L: Floats
    L_top: Any
    reference: Floats
    top: Floats
    b: Any
    feedback: Floats
    slide: Floats
    gain: Any
    leak: Any


class State(NamedTuple):
    """Estimates of z and its derivatives (r), the weights (N)."""

    x: Any
    W: Any


def relative_degree(linear: Matrices) -> int:
    """r, the first derivative of the one output that the input moves. Raises StructureError if the rest is not stable by itself."""
    A, B, C = linear
    n = A.shape[0]
    rows = [C]
    while len(rows) < n and abs((rows[-1] @ B).item()) <= 1e-9 * float(
        np.linalg.norm(rows[-1]) * np.linalg.norm(B)
    ):
        rows.append(rows[-1] @ A)
    seen = np.vstack(rows)
    b = (rows[-1] @ B).item()
    if n > len(rows):
        hidden = np.linalg.svd(seen)[2][len(rows) :].T
        zeros = np.linalg.eigvals(hidden.T @ (A - B @ rows[-1] @ A / b) @ hidden)
        if zeros.real.max() >= 0:
            raise StructureError(
                f"controller.method: the plant has zeros {listed(zeros)}, and what an output feedback without a model cannot see must be stable"
            )
    return len(rows)


def approximating(
    model: System, reach: Array, basis_on: Callable[[Floats], Basis],
    speed: float | None, bandwidth: float | None, gain: float | None, leak: float | None,
) -> Controller:  # fmt: skip
    """The controller for z^(r) = f + b u, r the relative degree, f unknown, b known.

    x^' = chain x^ + input (b u + W'phi(x^)) + L e, e = z - x^_1, z the inverted reading; E = x^ less r and its derivatives;
    b u = r^(r) - W'phi - L_r e - feedback E, W' = gain phi s - leak W, s = slide E = (d/dt + bandwidth)^(r-1) E_1.
    speed, bandwidth [1/s]: all poles of the observer, of the error, if not given 40 and 10 times the fastest pole of the
    plant, likewise gain and leak. basis_on(reach (r)): the basis.
    Raises InputError, ShapeError, StructureError.
    """
    if model.m != 1 or model.p != 1 or model.nonlinear:
        raise InputError(
            f"controller.method: this method is for a linear model of one input and one output, found {model.m} and {model.p}{model.nonlinear * ', nonlinear'}"
        )
    flow = model.linear if model.flow is None else model.flow
    r = relative_degree(flow)
    speed, bandwidth = (
        in_poles(model, "controller.speed", speed, 40.0),
        in_poles(model, "controller.bandwidth", bandwidth, 10.0),
    )
    gain, leak = (
        in_poles(model, "controller.gain", gain, 50.0 * fastest_pole(model)),
        in_poles(model, "controller.leak", leak, 0.01),
    )
    basis = basis_on(
        positive("controller.reach", reach, r, f"|z| and its derivatives up to order {r - 1}")
    )
    chain = companion(np.zeros(r))
    L = observer_gain(chain, np.full(r, -speed), None)[:, 0]
    rows = np.vstack([flow.C @ np.linalg.matrix_power(flow.A, k) for k in range(r + 1)])
    b = (rows[r - 1] @ flow.B).item()
    per_step, keep, moving, injected = (1.0, 0.0, chain, L)
    if model.Ts is not None:
        per_step, keep, moving = model.Ts, 1.0, zoh(chain, model.Ts)
        injected = observer_gain(moving, np.full(r, -speed), model.Ts)[:, 0]
    feedback, slide = (
        np.atleast_1d(np.poly(np.full(order, -bandwidth)))[:0:-1] for order in (r, r - 1)
    )
    params = Params(
        basis.params, moving.A, moving.B[:, 0], injected, L[-1], rows[:r], rows[r], np.float64(b), feedback,
        np.append(slide, 1.0), np.float64(gain * per_step), np.float64(leak * per_step),
    )  # fmt: skip

    def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
        e = estimate.z_inverse - s.x[0]
        phi = basis.phi(p.basis, s.x)
        error = s.x - p.reference @ target.x_ref
        wanted = (
            p.top.T @ target.x_ref + p.b * target.u_ff - p.L_top * e - p.feedback.T @ error
        )  # f + b u
        u = (wanted - ca.dot(s.W, phi)) / p.b
        learnt = keep * s.W + p.gain * phi * (p.slide.T @ error) - p.leak * s.W
        return State(p.chain @ s.x + p.input * wanted + p.L * e, learnt), u

    return Controller(params, lambda p: State(np.zeros(r), np.zeros(basis.size)), step)
