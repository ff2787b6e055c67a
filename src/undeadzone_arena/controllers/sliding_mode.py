"""Sliding-mode controller: it drives the tracking error onto a plane of decaying errors.

It does so for any bounded input disturbance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError, StepError, StructureError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.matrices import Matrices, scale_states, state_response_sizes
from undeadzone.linalg.poles import state_gain
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_nonnegative,
    require_positive,
)
from undeadzone_arena.approximators import clip_to_box
from undeadzone_arena.gain_defaults import rate_or_default

USUAL = 10.0  # rate of the surface and on it, in fastest poles of the plant


class SlidingMode(Options, frozen=True, kw_only=True, tag="sliding_mode"):
    """Sliding mode: Slotine and Li (1991), and if sampled the reaching law of Gao, Wang, Homaifa
    (1995).

    u = u_ff - G (f(x^, u_ff) - f(x_ref, u_ff)) - rate s - gain sat(s / boundary), s = G (x^ -
    x_ref), G B = I. It needs as many independent columns of B as inputs. A nonlinear plant needs a
    constant B.

    References:
        W. Gao, Y. Wang, A. Homaifa (1995), doi:10.1109/41.370376

    Attributes:
        gain: what exceeds the input disturbances to suppress, one or one per input [u].
        poles: poles of the error on s = 0 (n - m of them) [1/s] (default about ten times the
            fastest pole of the plant).
        rate: rate at which s decays [1/s] (default ten times the fastest pole of the plant).
        boundary: layer in which the law is linear, one or one per input [u s] (default gain / (2
            rate)).
    """

    gain: Array
    poles: Array | None = None
    rate: float | None = None
    boundary: Array | None = None

    def build(self, model: System) -> Controller:
        """Build the controller for a model, continuous or sampled."""
        m = model.m
        Ts = model.Ts
        rate = rate_or_default(model, "controller.rate", self.rate, USUAL)
        poles = poles_about(model, USUAL * fastest_pole(model), self.poles)
        gain, boundary = self._gain_and_boundary(m, rate)
        if Ts is not None and (gain * Ts > boundary).any():
            raise StepError(
                f"simulation.step: {Ts:g} s is too coarse: gain / boundary = "
                f"{(gain / boundary).max():.4g} 1/s inside the layer must be below 1 / step. "
                "Use a wider controller.boundary or a shorter step"
            )
        keep = -rate if Ts is None else np.exp(-rate * Ts)
        params = SlidingModeParams(
            model.params, sliding_surface(model, poles), np.float64(keep), gain, boundary
        )

        def step(
            p: SlidingModeParams, s: Any, estimate: Estimate, target: Target
        ) -> tuple[Any, Any]:
            """Return the unchanged state and u (m)."""
            apart, distance = surface_errors(model, p, estimate, target)
            pull = p.gain * clip_to_box(model.per_step * distance / p.boundary)
            return s, target.u_ff - p.G @ apart + p.keep * distance - pull

        return Controller(params, lambda p: None, step)

    def _gain_and_boundary(self, m: int, rate: float) -> tuple[Floats, Floats]:
        """Return gain and boundary (m each). Raises InputError, ShapeError."""
        gain = require_nonnegative("controller.gain", self.gain, m, "one per input")
        if not gain.all():
            raise InputError(
                "controller.gain: must be positive, found 0. Without it the law is a state feedback"
            )
        width = gain / (2 * rate) if self.boundary is None else self.boundary
        boundary = require_positive("controller.boundary", width, m, "one per input")
        return gain, boundary


class SlidingModeParams(NamedTuple):
    """Numbers of the controller.

    Attributes:
        model: numbers of the model.
        G: from the error to s (m x n), G B = 1.
        keep: -rate, or the factor of s per step.
        gain: gain of the switching term (m).
        boundary: its layer (m).
    """

    model: Any
    G: Floats
    keep: Any
    gain: Floats
    boundary: Floats


def poles_about(model: System, rate: float, poles: Array | None) -> Array:
    """Return the poles of the error on the surface as given, or n - m of them about -rate [1/s]."""
    spread = np.linspace(0.8, 1.2, max(model.n - model.m, 0))
    return -rate * spread if poles is None else poles


def sliding_surface(model: System, poles: Array) -> Floats:
    """Return G (m x n) with G B = 1 such that the error on G e = 0 has given poles.

    Args:
        model: the model, continuous or sampled.
        poles: poles of the error (n - m) [1/s].

    Raises:
        InputError, StructureError: for poles that cannot be, or inputs that are not independent.
    """
    A, B, _ = model.linear
    n, m = B.shape
    size = state_response_sizes(A if model.Ts is None else (A - np.eye(n)) / model.Ts, B)
    A = scale_states(A, size)
    B = B / size[:, None]
    rank = np.linalg.matrix_rank(B)
    if rank < m:
        raise StructureError(
            "controller.method: 'sliding_mode' needs inputs that move independent states, "
            f"B has rank {rank}, not {m}"
        )
    Q = np.linalg.qr(B, mode="complete")[0]
    # directions that inputs move, and the others
    moved = Q[:, :m]
    free = Q[:, m:]
    M: Floats = np.zeros((m, 0))
    if n > m or np.size(poles):
        reduced = Matrices(free.T @ A @ free, free.T @ A @ moved, np.zeros((0, n - m)))
        M = state_gain(reduced, poles, model.Ts)
    G = moved.T + M @ free.T
    return np.asarray(np.linalg.solve(G @ B, G / size))


def surface_errors(model: System, p: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
    """Return the motion of the error under u_ff, as of `move` (n), and s (m).

    Args:
        model: the model.
        p: numbers of the controller, `model` and `G` among them.
        estimate: of the state.
        target: state and input of the reference.
    """
    moved = model.move(p.model, estimate.x, target.u_ff)
    apart = moved - model.move(p.model, target.x_ref, target.u_ff)
    return apart, p.G @ (estimate.x - target.x_ref)
