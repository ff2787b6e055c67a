"""Output feedback with an approximator: the order and the input gain of the plant are known.

The rest is W'phi(x^).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices, companion_form
from undeadzone.linalg.poles import observer_gain
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, list_numbers, require_positive
from undeadzone_arena.approximators import Basis
from undeadzone_arena.gain_defaults import rate_or_default


class FeedbackOptions(Options, frozen=True, kw_only=True):
    """Options of all output feedbacks with an approximator.

    Attributes:
        reach: |z|, |z'|, ... up to which the functions hold, one per derivative below the relative
            degree.
        speed: all poles of its observer [1/s] (default 40 times the fastest pole).
        bandwidth: all poles of the error [1/s] (default 10 times the fastest pole).
        gain: gain of the weights [1/s^2] (default 50 times the fastest pole squared).
        leak: leak of the weights [1/s] (default a hundredth of the fastest pole).
    """

    reach: Array
    speed: float | None = None
    bandwidth: float | None = None
    gain: float | None = None
    leak: float | None = None


class FeedbackParams(NamedTuple):
    """Numbers of the controller.

    Attributes:
        basis: numbers of the basis.
        chain, input: r integrators (r x r, r), per step when sampled.
        L: gain of their observer (r), per step when sampled.
        L_top: last entry of that gain in continuous time [1/s].
        reference: r and its derivatives from x_ref (r x n).
        top: the derivative above them (n).
        b: input gain.
        feedback, slide: weights of the error (r).
        gain, leak: of the weights, per step when sampled.
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


class FeedbackState(NamedTuple):
    """Estimates of z and its derivatives (r), and the weights (N)."""

    x: Any
    W: Any


class FeedbackRates(NamedTuple):
    """Poles of observer and error [1/s], gain [1/s^2] and leak [1/s] of the weights."""

    speed: float
    bandwidth: float
    gain: float
    leak: float


def build_learned_feedback(
    model: System, options: FeedbackOptions, basis_on: Callable[[Floats], Basis]
) -> Controller:
    """Build the controller for z^(r) = f + b u, r the relative degree, f unknown, b known.

    x^' = chain x^ + input (b u + W'phi(x^)) + L e, e = z - x^_1, z the inverted reading. E = x^
    less r and its derivatives. b u = r^(r) - W'phi - L_r e - feedback E, W' = gain phi s - leak W,
    s = slide E = (d/dt + bandwidth)^(r-1) E_1.

    Args:
        model: the model, continuous or sampled.
        options: the controller's.
        basis_on: basis_on(reach (r)) is the basis.

    Raises:
        InputError, ShapeError, StructureError: for a model or options that cannot be.
    """
    if model.m != 1 or model.p != 1 or model.nonlinear:
        nonlinear = ", nonlinear" if model.nonlinear else ""
        raise InputError(
            "controller.method: this method is for a linear model of one input and one output, "
            f"found {model.m} and {model.p}{nonlinear}"
        )
    flow = model.continuous
    rows = derivative_rows(flow)
    r = len(rows) - 1
    rates = _rates_or_defaults(model, options)
    derivatives = f"|z| and its derivatives up to order {r - 1}"
    basis = basis_on(require_positive("controller.reach", options.reach, r, derivatives))
    params = _feedback_params(flow, model.Ts, rows, rates, basis.params)

    def init(p: FeedbackParams) -> FeedbackState:
        """Return the state at t = 0."""
        return FeedbackState(np.zeros(r), np.zeros(basis.size))

    return Controller(params, init, partial(feedback_step, basis, model.keep))


def derivative_rows(linear: Matrices) -> Floats:
    """Return the rows from x to the one output and its derivatives (r + 1 x n).

    r is the order of the lowest derivative that the input moves.

    Raises StructureError if the rest is not stable by itself.
    """
    A, B, C = linear
    n = A.shape[0]
    rows = [C]
    while len(rows) < n and _is_input_free(rows[-1], B):
        rows.append(rows[-1] @ A)
    seen = np.vstack(rows)
    highest = rows[-1] @ A
    b = (rows[-1] @ B).item()
    if n > len(rows):
        hidden = np.linalg.svd(seen)[2][len(rows) :].T
        zeros = np.linalg.eigvals(hidden.T @ (A - B @ highest / b) @ hidden)
        if zeros.real.max() >= 0:
            raise StructureError(
                f"controller.method: the plant has zeros {list_numbers(zeros)}, and what an output "
                "feedback without a model cannot see must be stable"
            )
    return np.vstack([seen, highest])


def _is_input_free(row: Floats, B: Floats) -> bool:
    """Return whether the input leaves a derivative of the output unchanged, up to rounding."""
    scale = float(np.linalg.norm(row) * np.linalg.norm(B))
    return abs((row @ B).item()) <= 1e-9 * scale


def _rates_or_defaults(model: System, options: FeedbackOptions) -> FeedbackRates:
    """Return the given rates, or defaults in fastest poles of the plant. Raises InputError."""
    return FeedbackRates(
        speed=rate_or_default(model, "controller.speed", options.speed, 40.0),
        bandwidth=rate_or_default(model, "controller.bandwidth", options.bandwidth, 10.0),
        gain=rate_or_default(model, "controller.gain", options.gain, 50.0 * fastest_pole(model)),
        leak=rate_or_default(model, "controller.leak", options.leak, 0.01),
    )


def _feedback_params(
    flow: Matrices, Ts: float | None, rows: Floats, rates: FeedbackRates, basis: Any
) -> FeedbackParams:
    """Return the controller's numbers (rows: of `derivative_rows`)."""
    r = len(rows) - 1
    chain = companion_form(np.zeros(r))
    poles = np.full(r, -rates.speed)
    L = observer_gain(chain, poles, None)[:, 0]
    b = (rows[r - 1] @ flow.B).item()
    per_step, moving, injected = 1.0, chain, L
    if Ts is not None:
        per_step, moving = Ts, zoh(chain, Ts)
        injected = observer_gain(moving, poles, Ts)[:, 0]
    return FeedbackParams(
        basis=basis,
        chain=moving.A,
        input=moving.B[:, 0],
        L=injected,
        L_top=L[-1],
        reference=rows[:r],
        top=rows[r],
        b=np.float64(b),
        feedback=error_weights(r, rates.bandwidth),
        slide=np.append(error_weights(r - 1, rates.bandwidth), 1.0),
        gain=np.float64(rates.gain * per_step),
        leak=np.float64(rates.leak * per_step),
    )


def error_weights(order: int, bandwidth: float) -> Floats:
    """Return the coefficients of (s + bandwidth)^order, lowest first, without the highest."""
    return np.atleast_1d(np.poly(np.full(order, -bandwidth)))[:0:-1]


def feedback_step(
    basis: Basis,
    keep: float,
    p: FeedbackParams,
    s: FeedbackState,
    estimate: Estimate,
    target: Target,
) -> tuple[FeedbackState, Any]:
    """Return the state's derivative, or its next value when sampled, and u.

    The factor `keep` is 1 when sampled, else 0.
    """
    e = estimate.z_inverse - s.x[0]
    phi = basis.phi(p.basis, s.x)
    error = s.x - p.reference @ target.x_ref
    # f + b u, what z^(r) is to be
    pseudo_control = p.top.T @ target.x_ref + p.b * target.u_ff - p.L_top * e - p.feedback.T @ error
    u = (pseudo_control - ca.dot(s.W, phi)) / p.b
    learnt = keep * s.W + p.gain * phi * (p.slide.T @ error) - p.leak * s.W
    return FeedbackState(p.chain @ s.x + p.input * pseudo_control + p.L * e, learnt), u
