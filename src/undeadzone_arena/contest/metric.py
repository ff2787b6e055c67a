"""Metrics of a run: errors of hidden output and estimates, coverage, effort and cost."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from undeadzone.analysis.branch_schedule import schedule_of_record
from undeadzone.analysis.identifiability.linear import width_identifiability
from undeadzone.results.scales import LIMIT, largest_scaled_signals, plant_scales
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


class RunMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """Metrics of one run. Errors are root mean squares over its last fifth.

    Attributes:
        tracking: z - r of the tracked outputs, the true z [z].
        estimation: z - z^ [z].
        width: |error| of d_r + d_l at the end, relative to the true d_r + d_l (None if the run's
            readings do not determine it or the method does not estimate it).
        centre: |error| of (d_r - d_l)/2 at the end, relative to half of the true d_r + d_l.
        coverage: share of the method's 95 % intervals of widths that contain the truth at the end
            (None without intervals).
        settling: time from which |z - r| stays within a tenth of the largest |r| [s] (None: never).
        effort: rms of u [u].
        slew: rms of the change of u per step [u].
        cost: of a step, measured [s].
        diverged: whether a signal left 1e12 times its scale or was not a number.
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
    """Result of a method on a scenario with a seed.

    Attributes:
        method: its name.
        scenario: its name.
        seed: of the run.
        worth: score of the run (None if the method is not applicable).
        reason: that the method gives for not being applicable.
    """

    method: str
    scenario: str
    seed: int
    worth: RunMetrics | None
    reason: str | None = None


def measure_run(problem: Problem, out: Outputs, truth: Floats, cost: float) -> RunMetrics:
    """Compute the metrics of a run.

    Args:
        problem: the simulated problem.
        out: its signals (a row per sample).
        truth: true widths at the end (2 x p) [z].
        cost: of a step [s].
    """
    t = np.arange(len(out.z)) * problem.scenario.simulation.step
    tail = slice(int((1 - TAIL) * len(t)), None)
    r = problem.reference.output_at(t)
    error = out.z[:, problem.tracked] - r
    with np.errstate(invalid="ignore", over="ignore"):
        diverged = _has_diverged(problem, out)
        width, centre = (None, None) if diverged else _relative_width_errors(problem, out, truth)
        return RunMetrics(
            tracking=rms_of_entries(error[tail]),
            estimation=rms_of_entries((out.z - out.estimate.z)[tail]),
            width=width,
            centre=centre,
            coverage=None if diverged else _width_coverage(out, truth),
            settling=_settling_time(t, error, r, tail.start),
            effort=rms_of_entries(out.u),
            slew=rms_of_entries(np.diff(out.u, axis=0)),
            cost=cost,
            diverged=diverged,
            zone=float(truth.sum(axis=0).mean()) / 2 or rms_of_entries(r) or 1.0,
        )


def rms_of_entries(values: Floats) -> float:
    """Return the root mean square of all entries."""
    return float(np.sqrt(np.mean(values**2)))


def _has_diverged(problem: Problem, out: Outputs) -> bool:
    """Return whether a signal left `LIMIT` times its scale or was not a number."""
    estimate = out.estimate
    outputs = [out.z, estimate.z, estimate.right, estimate.left]
    worst = largest_scaled_signals(plant_scales(problem), [out.x, estimate.x], outputs, out.u)
    return not bool((worst < LIMIT).all())


def _settling_time(t: Floats, error: Floats, r: Floats, tail: int) -> float | None:
    """Return the time from which the error stays small [s], or None if after the tail's start."""
    small = np.abs(error).max(axis=1) <= SETTLED * np.abs(r).max()
    outside = np.flatnonzero(~small)
    if not outside.size:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] < tail else None


def _relative_width_errors(
    problem: Problem, out: Outputs, truth: Floats
) -> tuple[float | None, float | None]:
    """Return the final errors of d_r + d_l and of d_r - d_l, relative, None if unidentifiable."""
    estimated = np.stack([out.estimate.right, out.estimate.left], axis=1)
    if not (estimated != estimated[0]).any():
        return None, None
    sensor = problem.sensor
    linear = problem.model.linear
    schedule = schedule_of_record(out.z, sensor, problem.scenario.simulation.step, problem.model.Ts)
    if actuator_unknown(problem):
        judged = widths_with_unknown_actuator(problem, out, schedule)
    else:
        bias = constant_inputs(problem)
        judged = width_identifiability(linear, schedule, bias, sensor.kind == "jump")
    off = estimated[-1] - truth
    size = truth.sum(axis=0)
    width = np.abs(off.sum(axis=0)) / size
    centre = np.abs(off[0] - off[1]) / size  # both halved
    width_known = np.array([verdict.width for verdict in judged])
    centre_known = np.array([verdict.centre for verdict in judged])
    return _mean_or_none(width[width_known]), _mean_or_none(centre[centre_known])


def _mean_or_none(values: Floats) -> float | None:
    """Return the mean, or None for no values."""
    return float(values.mean()) if values.size else None


def _width_coverage(out: Outputs, truth: Floats) -> float | None:
    """Return the share of 95 % intervals of widths that contain the truth at the end (2 x p)."""
    estimate = out.estimate
    if not estimate.right_std.size:
        return None
    off = np.abs(np.stack([estimate.right[-1], estimate.left[-1]]) - truth)
    std = np.stack([estimate.right_std[-1], estimate.left_std[-1]])
    return float((off <= SURE * std).mean())
