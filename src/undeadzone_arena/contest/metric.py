"""What a run is worth: errors of the hidden output, of the estimates, honesty, effort and cost."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from undeadzone.analysis.branch_schedule import schedule_of_record
from undeadzone.analysis.identifiability.linear import verdicts
from undeadzone.results.scales import LIMIT, plant_scales, shares
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.identifiability import (
    actuator_unknown,
    constant_inputs,
    widths_with_unknown_actuator,
)
from undeadzone.simulation.loop import Outputs
from undeadzone.util.arrays import Floats

TAIL: Final = 0.2  # share of the run, its last, over which errors are taken
SETTLED: Final = 0.1  # |z - r| within this share of the largest |r| has settled
SURE: Final = 1.959963984540054  # standard deviations of a 95 % interval


class Worth(msgspec.Struct, frozen=True, kw_only=True):
    """What one run is worth; errors are root mean squares over its last fifth.

    Attributes:
        tracking: z - r of the tracked outputs, the true z [z].
        estimation: z - z^ [z].
        width: |error| of d_r + d_l at the end, relative to the true d_r + d_l; None where the run's
            readings cannot tell or the method does not try.
        centre: |error| of (d_r - d_l)/2 at the end, relative to half of the true d_r + d_l.
        coverage: share of claimed 95 % intervals of widths that hold the truth at the end; None
            without claims.
        settling: from when on |z - r| stays within a tenth of the largest |r| [s]; None: never.
        effort: rms of u [u].
        slew: rms of the change of u per step [u].
        cost: of a step, measured [s].
        diverged: whether a signal left 1e12 times its scale or was no number.
        zone: half of the true d_r + d_l at the end, mean over the outputs [z]: what ignoring the
            zone costs, and so the unit of a regret.
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
    zone: float = 1.0


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one method on one scenario with one seed.

    Attributes:
        method: its name.
        scenario: its name.
        seed: of the run.
        worth: what the run is worth; None where the method is not applicable.
        reason: that the method gives for not being applicable.
    """

    method: str
    scenario: str
    seed: int
    worth: Worth | None
    reason: str | None = None


def worth(problem: Problem, out: Outputs, truth: Floats, cost: float) -> Worth:
    """Return the worth of a run.

    Args:
        problem: what was simulated.
        out: its signals (a row per sample).
        truth: true widths at the end (2 x p) [z].
        cost: of a step [s].
    """
    t = np.arange(len(out.z)) * problem.scenario.simulation.step
    tail = slice(int((1 - TAIL) * len(t)), None)
    r = problem.reference.value(t)
    error = out.z[:, problem.tracked] - r
    with np.errstate(invalid="ignore", over="ignore"):
        diverged = _has_diverged(problem, out)
        width, centre = (None, None) if diverged else _widths(problem, out, truth)
        return Worth(
            tracking=rms(error[tail]),
            estimation=rms((out.z - out.estimate.z)[tail]),
            width=width,
            centre=centre,
            coverage=None if diverged else _coverage(out, truth),
            settling=_settling(t, error, r, tail.start),
            effort=rms(out.u),
            slew=rms(np.diff(out.u, axis=0)),
            cost=cost,
            diverged=diverged,
            zone=float(truth.sum(axis=0).mean()) / 2 or rms(r) or 1.0,
        )


def rms(values: Floats) -> float:
    """Return root mean square of all entries."""
    return float(np.sqrt(np.mean(values**2)))


def _has_diverged(problem: Problem, out: Outputs) -> bool:
    """Return whether a signal left `LIMIT` times its scale or was no number."""
    estimate = out.estimate
    outputs = [out.z, estimate.z, estimate.right, estimate.left]
    worst = shares(plant_scales(problem), [out.x, estimate.x], outputs, out.u)
    return not bool((worst < LIMIT).all())


def _settling(t: Floats, error: Floats, r: Floats, tail: int) -> float | None:
    """From when on the error stays small [s]; None if it does not before the tail begins."""
    small = np.abs(error).max(axis=1) <= SETTLED * np.abs(r).max()
    outside = np.flatnonzero(~small)
    if not outside.size:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] < tail else None


def _widths(problem: Problem, out: Outputs, truth: Floats) -> tuple[float | None, float | None]:
    """Return the errors of width and centre at the end, relative, where they can be known."""
    estimated = np.stack([out.estimate.right, out.estimate.left], axis=1)
    if not (estimated != estimated[0]).any():
        return None, None
    sensor, linear = problem.sensor, problem.model.linear
    schedule = schedule_of_record(out.z, sensor, problem.scenario.simulation.step, problem.model.Ts)
    if actuator_unknown(problem):
        judged = widths_with_unknown_actuator(problem, out, schedule)
    else:
        bias = constant_inputs(problem, linear.B)
        judged = verdicts(linear, schedule, bias, sensor.kind == "jump")
    off, size = estimated[-1] - truth, truth.sum(axis=0)
    width = np.abs(off.sum(axis=0)) / size
    centre = np.abs(off[0] - off[1]) / size  # both halved
    width_known = np.array([verdict.width for verdict in judged])
    centre_known = np.array([verdict.centre for verdict in judged])
    return _mean(width[width_known]), _mean(centre[centre_known])


def _mean(values: Floats) -> float | None:
    """Return the mean; None of nothing."""
    return float(values.mean()) if values.size else None


def _coverage(out: Outputs, truth: Floats) -> float | None:
    """Return the share of claimed 95 % intervals of widths that hold the truth at the end (2 x
    p).
    """
    estimate = out.estimate
    if not estimate.right_std.size:
        return None
    off = np.abs(np.stack([estimate.right[-1], estimate.left[-1]]) - truth)
    std = np.stack([estimate.right_std[-1], estimate.left_std[-1]])
    return float((off <= SURE * std).mean())
