"""What a run is worth: errors of the hidden output, of the estimates, honesty, effort and cost."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from undeadzone.analysis.identifiability.linear import unknown_bias, verdicts
from undeadzone.analysis.side_schedule import recorded
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.run import LIMIT
from undeadzone.support.arrays import Floats

TAIL: Final = 0.2  # share of the run, its last, over which errors are taken
SETTLED: Final = 0.1  # |z - r| within this share of the largest |r| has settled
SURE: Final = 1.959963984540054  # standard deviations of a 95 % interval


class Worth(msgspec.Struct, frozen=True, kw_only=True):
    """Of one run; errors are root mean squares over its last fifth.

    tracking: z - r of the tracked outputs, the true z [z]; estimation: z - z^ [z]; width, centre: |error| of d_r + d_l, of
    d_r - d_l at the end, relative to the true d_r + d_l, None where the run's readings cannot tell or the method does not
    try; coverage: share of claimed 95 % intervals of widths that hold the truth at the end, None without claims; settling [s]: from
    when on |z - r| stays within a tenth of the largest |r|, None if never; effort, slew: rms of u and of its change
    per step [u]; cost [s]: of a step, measured; diverged: a signal left +-1e12 or was no number.
    """

    tracking: float
    estimation: float
    width: float | None
    centre: float | None
    coverage: float | None
    settling: float | None
    effort: float
    slew: float
    cost: float
    diverged: bool


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """Of one method on one scenario with one seed; worth: None where the method is not applicable, for the reason that it gives."""

    method: str
    scenario: str
    seed: int
    worth: Worth | None
    reason: str | None = None


def worth(problem: Problem, out: Outputs, truth: Floats, cost: float) -> Worth:
    """The worth of a run: its signals, and its true widths at the end (2 x p)."""
    t = np.arange(len(out.z)) * problem.scenario.simulation.step
    tail = slice(int((1 - TAIL) * len(t)), None)
    r = problem.reference.value(t)
    error = out.z[:, problem.tracked] - r
    with np.errstate(invalid="ignore", over="ignore"):
        diverged = not bool(
            (
                np.abs(
                    np.hstack([out.x, out.estimate.x, out.estimate.right, out.estimate.left, out.u])
                )
                < LIMIT
            ).all()
        )
        outside = np.flatnonzero(~(np.abs(error).max(axis=1) <= SETTLED * np.abs(r).max()))
        width, centre = (None, None) if diverged else _widths(problem, out, truth)
        return Worth(
            tracking=rms(error[tail]),
            estimation=rms((out.z - out.estimate.z)[tail]),
            width=width,
            centre=centre,
            coverage=None if diverged else _coverage(out, truth),
            settling=0.0
            if not outside.size
            else float(t[outside[-1] + 1])
            if outside[-1] < tail.start
            else None,
            effort=rms(out.u),
            slew=rms(np.diff(out.u, axis=0)),
            cost=cost,
            diverged=diverged,
        )


def rms(values: Floats) -> float:
    """Root mean square of all entries."""
    return float(np.sqrt(np.mean(values**2)))


def _widths(problem: Problem, out: Outputs, truth: Floats) -> tuple[float | None, float | None]:
    estimated = np.stack([out.estimate.right, out.estimate.left], axis=1)
    if not (estimated != estimated[0]).any():
        return None, None
    sensor, linear = problem.sensor, problem.model.linear
    schedule = recorded(out.z, sensor, problem.scenario.simulation.step, problem.model.Ts)
    told = verdicts(
        linear,
        schedule,
        unknown_bias(problem.scenario.disturbance, linear.B),
        sensor.kind == "jump",
    )
    off, size = estimated[-1] - truth, truth.sum(axis=0)
    errors = {"width": np.abs(off.sum(axis=0)) / size, "centre": np.abs(off[0] - off[1]) / size}

    def mean(name: str) -> float | None:
        known = np.array([getattr(verdict, name) for verdict in told])
        return float(errors[name][known].mean()) if known.any() else None

    return mean("width"), mean("centre")


def _coverage(out: Outputs, truth: Floats) -> float | None:
    if not out.estimate.right_std.size:
        return None
    off = np.abs(np.stack([out.estimate.right[-1], out.estimate.left[-1]]) - truth)
    return float(
        (off <= SURE * np.stack([out.estimate.right_std[-1], out.estimate.left_std[-1]])).mean()
    )
