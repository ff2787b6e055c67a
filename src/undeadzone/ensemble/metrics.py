"""What is kept of a run without keeping its signals: sums and extremes that the loop itself accumulates."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.plants.robots.arm import Arm
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.loop import Exogenous, Loop, Outputs, Params
from undeadzone.simulation.run import LIMIT
from undeadzone.support import tree
from undeadzone.support.arrays import Floats


class Tally(NamedTuple):
    """Sums of (z - r)^2 and (z - z^)^2 over the tail, the largest |z - r|, the last time at which it was too large [s], silent samples, sum of u^2.

    right, left: the latest d_r^, d_l^ (p each). tip: of an arm, the sum of squared distances of its tip from its path over the tail.
    """

    tracking: Any
    estimation: Any
    peak: Any
    settled: Any
    silent: Any
    effort: Any
    right: Any
    left: Any
    tip: Any


class Measured(NamedTuple):
    """A loop that also keeps a `Tally`, behind its own state; rare: as in `engine.lanes.build`.

    step(state and tally, exogenous inputs, time [s] and 1 in the tail, params and tolerance [z] for scale 1).
    """

    step: ca.Function
    rare: tuple[ca.Function, ...]
    tally: Tally


def measured(loop: Loop, problem: Problem) -> Measured:
    """The loop of a problem with its metrics."""
    step, rare = (loop.step, ()) if loop.parts is None else loop.parts
    one, each = np.zeros(1), np.zeros(problem.plant.p)
    zero = Tally(
        one, one, one, one, one, one, each, each, np.zeros(0 if problem.plant.arm is None else 1)
    )
    kept = tree.size(zero)
    s, w, p = (
        ca.SX.sym(name, step.size1_in(i) + more)
        for i, (name, more) in enumerate((("s", kept), ("w", 2), ("p", 1)))
    )
    given = (s[:-kept], w[:-2], p[:-1])
    following, out, *flag = step(*given)
    outputs: Outputs = tree.unpack(loop.outputs, out)
    instant: Exogenous = tree.unpack(loop.instant, w[: tree.size(loop.instant)])
    params: Params = tree.unpack(loop.params, given[2])
    error = outputs.z[problem.tracked] - params.scale.reference * instant.target.r
    tally = _add(
        tree.unpack(zero, s[-kept:]),
        outputs,
        error,
        w[-2],
        w[-1],
        p[-1] * ca.fabs(params.scale.reference),
    )
    if problem.plant.arm is not None:
        tally = tally._replace(
            tip=tally.tip
            + w[-1] * ca.sumsqr(_astray(problem.plant.arm, problem.model, params, outputs, instant))
        )
    results = [ca.vertcat(following, tree.stack(tally)), out, *flag]
    parts = tuple(ca.Function("rare", [s, w, p], part(*given)) for part in rare)
    return Measured(ca.Function("measured", [s, w, p], results, {"cse": True}), parts, zero)


def _astray(body: Arm, model: System, params: Params, out: Outputs, instant: Exogenous) -> Any:
    """An arm's tip less where the model's would be on the path."""
    x_ref = params.scale.reference * instant.target.x_ref
    return body.tip(params.plant, out.x[: body.size]) - body.tip(model.params, x_ref[: body.size])


def _add(
    tally: Tally, out: Outputs, error: ca.SX, t: ca.SX, tail: ca.SX, tolerance: ca.SX
) -> Tally:
    """The tally with one sample more, but for the tip."""
    worst = ca.norm_inf(error)
    return tally._replace(
        tracking=tally.tracking + tail * ca.sumsqr(error),
        estimation=tally.estimation + tail * ca.sumsqr(out.z - out.estimate.z),
        peak=ca.fmax(worst, tally.peak),
        settled=ca.if_else(worst > tolerance, t, tally.settled),
        silent=tally.silent + ca.sum1(out.side == 0),
        effort=tally.effort + ca.sumsqr(out.u),
        right=out.estimate.right,
        left=out.estimate.left,
    )


def columns(plant: System) -> tuple[str, ...]:
    """The names of the metrics of a plant."""
    widths = (f"d_{edge}[{i}]" for edge in ("right", "left") for i in range(plant.p))
    tip = () if plant.arm is None else ("rms_tip",)
    return (
        "rms_tracking",
        "rms_estimation",
        "peak_tracking",
        "settling_time",
        "silent_fraction",
        "rms_input",
        *widths,
        *tip,
        "diverged",
    )


def rows(tally: Tally, states: Floats, samples: int, tail: int, tracked: int) -> Floats:
    """The metrics (runs x columns) from tallies (runs x 1 or x p each) and final states (runs x S)."""
    p = tally.right.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):
        diverged = ~((np.abs(states) < LIMIT).all(axis=1) & (tally.peak[:, 0] < LIMIT))
        found = (
            np.sqrt(tally.tracking / (tail * tracked)),
            np.sqrt(tally.estimation / (tail * p)),
            tally.peak,
            tally.settled,
            tally.silent / (samples * p),
            np.sqrt(tally.effort / samples),
        )
    return np.hstack(
        [*found, tally.right, tally.left, np.sqrt(tally.tip / tail), diverged[:, None]]
    )
