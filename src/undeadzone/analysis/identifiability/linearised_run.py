"""Linearisation of a plant along a run: transitions and outputs of `[x; beta; theta]` at its
samples.

beta is a constant input bias, theta uncertain parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.analysis.convergence.floquet import matrix_exponentials
from undeadzone.compile import interpret
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats, Integers

TOLERANCE = 1e-9, 1e-4  # share of information that counts as none, with exact steps and others
WORK = 5e7  # products and sums spent on exact derivatives; more, and samples are thinned


class LinearisedRun(NamedTuple):
    """Run linearised at K of its samples, s = n + b + t.

    Attributes:
        steps: transition from each of the samples to the next (K x s x s).
        outputs: of `[x; beta; theta]` (K x p x s).
        samples: their numbers (K).
        tolerance: share of a direction's information, all else known, that the steps' errors may
            feign.
    """

    steps: Floats
    outputs: Floats
    samples: Integers
    tolerance: float


def linearise_run(
    model: System, x: Floats, u: Floats, step: float, bias: Floats, uncertain: Sequence[str]
) -> LinearisedRun:
    """Linearise the plant along a run.

    A sampled plant's is exact at every sample, unless that costs too much. In continuous time, and
    for large sampled plants, steps span 2 samples, or as many as the work allows, by a fourth-order
    Magnus expansion (Iserles, Norsett 1999). Over such a step, a sampled plant gets the mean of its
    inputs.

    Args:
        model: the plant (n states, m inputs, p outputs).
        x: states (N x n).
        u: inputs (N x m).
        step: time between two samples [s].
        bias: directions (m x b) of unknown constant inputs.
        uncertain: names of unknown parameters (t).
    """
    motion = model.move if model.rate is None else model.rate
    rates = _build_derivatives(model, motion, bias, uncertain)
    work = rates.n_instructions() * len(x)
    if model.Ts is not None and (model.rate is None or 8 * work <= WORK):
        exact = _build_derivatives(model, model.move, bias, uncertain)
        steps, outputs = _derivatives_along(exact, model, x, u, uncertain)
        return _assemble_run(steps, outputs, np.arange(len(x)), TOLERANCE[0])
    stride = 2 * max(1, int(np.ceil(1.5 * work / WORK)))
    first = np.arange(0, len(x), stride)
    last = np.minimum(first + stride, len(x) - 1)
    # Rates at the start, the middle and the end of each step.
    places = first, (first + last) // 2, last
    inputs = [u[at] for at in places]
    if model.Ts is not None:
        inputs = [np.add.reduceat(u, first) / np.diff(first, append=len(x))[:, None]] * 3
    of_rates = []
    of_outputs = []
    for at, w in zip(places, inputs, strict=True):
        A, C = _derivatives_along(rates, model, x[at], w, uncertain)
        of_rates.append(np.pad(A, [(0, 0), (0, A.shape[2] - A.shape[1]), (0, 0)]))
        of_outputs.append(C)
    h = step * (last - first)[:, None, None]
    A0, A1, A2 = of_rates
    steps = matrix_exponentials(_magnus_exponent(A0, A1, A2, h))
    return _assemble_run(steps[:, : model.n], of_outputs[0], first, TOLERANCE[1])


def _magnus_exponent(A0: Floats, A1: Floats, A2: Floats, h: Floats) -> Floats:
    """Return the exponent of a step of length h [s] with rates A0, A1, A2 at start, middle and
    end.
    """
    return h / 6 * (A0 + 4 * A1 + A2) - h**2 / 12 * (A0 @ A2 - A2 @ A0)


def _build_derivatives(
    model: System, move: Any, bias: Floats, uncertain: Sequence[str]
) -> ca.Function:
    """Build the derivatives of move and output by `[x; beta; theta]` as a function.

    Its arguments are `[x; u]` and theta.

    They are a step without a state.
    """
    x = ca.SX.sym("x", model.n)
    u = ca.SX.sym("u", model.m)
    theta = ca.SX.sym("theta", len(uncertain))
    params = model.params
    if model.nonlinear:
        params = ca.SX(params)
        for k, name in enumerate(uncertain):
            params[model.names.index(name)] = theta[k]
    moved = move(params, x, u)
    output = ca.SX(model.output(params, x))
    by = ca.vertcat(x, theta)
    A = ca.jacobian(moved, by)
    C = ca.jacobian(output, by)
    n = model.n
    b = bias.shape[1]
    A = ca.horzcat(A[:, :n], ca.jacobian(moved, u) @ bias, A[:, n:])
    C = ca.horzcat(C[:, :n], ca.SX(model.p, b), C[:, n:])
    both = ca.densify(ca.vec(ca.vertcat(A, C)))
    return interpret.build_stateless_step([ca.vertcat(x, u), theta], ca.cse(both))


def _derivatives_along(
    function: ca.Function, model: System, x: Floats, u: Floats, uncertain: Sequence[str]
) -> tuple[Floats, Floats]:
    """Return the derivatives of move and of the output at each x and u (rows)."""
    theta = np.array([model.params[model.names.index(name)] for name in uncertain])
    values = interpret.map_rows(function, np.hstack([x, u]), theta)
    both = values.reshape(len(x), -1, model.n + model.p).transpose(0, 2, 1)
    return both[:, : model.n], both[:, model.n :]


def _assemble_run(
    steps: Floats, outputs: Floats, samples: Integers, tolerance: float
) -> LinearisedRun:
    """Return the run up to the first derivative that is not finite. The constants stay
    constant.
    """
    good = np.isfinite(steps).all(axis=(1, 2)) & np.isfinite(outputs).all(axis=(1, 2))
    end = good.size if good.all() else int(good.argmin())
    n, s = steps.shape[1:]
    constants = np.broadcast_to(np.eye(s)[n:], (end, s - n, s))
    whole = np.concatenate([steps[:end], constants], axis=1)
    return LinearisedRun(whole, outputs[:end], samples[:end], tolerance)


def symmetric(model: System, change: Floats) -> bool:
    """Return whether the motion is invariant under a constant change of the state.

    Args:
        model: the plant.
        change: of the state (n).
    """
    sampled_only = model.Ts is not None and model.rate is None
    still = np.eye(model.n) if sampled_only else 0.0
    motion = model.move if model.rate is None else model.rate
    function = _build_derivatives(model, motion, np.zeros((model.m, 0)), ())
    points = np.random.default_rng(0).normal(size=(8, model.n + model.m))
    x, u = np.split(points, [model.n], axis=1)
    A = _derivatives_along(function, model, x, u, ())[0] - still
    return bool((np.abs(A @ change) <= 1e-9 * np.abs(A).max() * np.abs(change).max()).all())
