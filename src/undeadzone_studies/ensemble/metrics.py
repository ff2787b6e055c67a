"""Metrics of runs: sums and extremes that the loop accumulates, and bands of some signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.results.scales import LIMIT, Scales, largest_scaled_signals
from undeadzone.scenario.address import matching
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.loop import Exogenous, Loop, Outputs, Params
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

LEVELS: Final = (0.01, 0.05, 0.5, 0.95, 0.99)
EDGES: Final = ("right", "left")


class Tally(NamedTuple):
    """Sums and extremes that a run has accumulated so far. The tail is the last 2 s.

    Attributes:
        tracking: sum of |z - r|^2 over the tail
        estimation: sum of |z - z^|^2 over the tail
        peak: the largest |z - r|
        settled: the last time at which |z - r| was beyond the tolerance [s]
        silent: number of samples without a reading, of all outputs
        effort: sum of |u|^2
        right, left: the latest d_r^, d_l^ (p each)
        tip: of an arm, the sum over the tail of squared distances of its tip from its path [m^2]
            (empty for other plants)
        behind: of a play, the sum over the tail of |y / m - r|^2, y without noise (else empty)
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
    behind: Any


class LoopWithMetrics(NamedTuple):
    """Loop that also accumulates a `Tally`.

    Attributes:
        step: the loop's step with three longer arguments: the state, then the tally, the exogenous
            inputs, then time [s] and 1 in the tail, and the params, then the tolerance [z] for
            scale 1
        rare: the parts of the step that a change of side needs, as in `engine.lanes.build`
        tally: zeros, in its shape
    """

    step: ca.Function
    rare: tuple[ca.Function, ...]
    tally: Tally


def add_metrics(loop: Loop, problem: Problem) -> LoopWithMetrics:
    """Return the loop of a problem with its metrics."""
    step, rare = (loop.step, ()) if loop.parts is None else loop.parts
    zero = _empty_tally(problem.plant, problem.sensor.kind)
    size = tree.count_numbers(zero)
    s = ca.SX.sym("s", step.size1_in(0) + size)
    w = ca.SX.sym("w", step.size1_in(1) + 2)
    p = ca.SX.sym("p", step.size1_in(2) + 1)
    t = w[-2]
    tail = w[-1]
    tolerance = p[-1]
    arguments = (s[:-size], w[:-2], p[:-1])
    following, out, *flag = step(*arguments)
    outputs: Outputs = tree.unpack_column(loop.outputs, out)
    instant: Exogenous = tree.unpack_column(loop.instant, w[: tree.count_numbers(loop.instant)])
    params: Params = tree.unpack_column(loop.params, arguments[2])
    scale = params.scale.reference
    error = outputs.z[problem.tracked] - scale * instant.target.r
    before: Tally = tree.unpack_column(zero, s[-size:])
    tally = _add_sample(before, outputs, error, t, tail, tolerance * ca.fabs(scale))
    if problem.plant.arm is not None:
        astray = _tip_error(problem.plant, problem.model, params, outputs, instant)
        tally = tally._replace(tip=tally.tip + tail * ca.sumsqr(astray))
    if problem.sensor.kind == "play":
        level = tree.unpack_column(loop.state, following).sensor[problem.tracked]
        missed = level - scale * instant.target.r
        tally = tally._replace(behind=tally.behind + tail * ca.sumsqr(missed))
    results = [ca.vertcat(following, tree.stack_leaves(tally)), out, *flag]
    parts = tuple(ca.Function("rare", [s, w, p], part(*arguments)) for part in rare)
    return LoopWithMetrics(ca.Function("measured", [s, w, p], results, {"cse": True}), parts, zero)


def _empty_tally(plant: System, sensor: str) -> Tally:
    """Return the tally of a run that has not begun."""
    tip = int(plant.arm is not None)
    behind = int(sensor == "play")
    return Tally(*map(np.zeros, (*[1] * 6, plant.p, plant.p, tip, behind)))


def _tip_error(
    plant: System, model: System, params: Params, out: Outputs, instant: Exogenous
) -> Any:
    """Return the tip of an arm less the model's tip on the path [m]."""
    assert plant.arm is not None
    x_ref = params.scale.reference * instant.target.x_ref
    reached = plant.arm.tip(*plant.joints(params.plant, out.x))
    return reached - plant.arm.tip(*model.joints(model.params, x_ref))


def _add_sample(
    tally: Tally, out: Outputs, error: ca.SX, t: ca.SX, tail: ca.SX, tolerance: ca.SX
) -> Tally:
    """Return the tally with another sample, except for the tip and the error behind a
    backlash.
    """
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


def metric_names(plant: System, sensor: str) -> tuple[str, ...]:
    """Return the names of the metrics of a plant behind a sensor of that kind."""
    right = [f"d_right[{i}]" for i in range(plant.p)]
    left = [f"d_left[{i}]" for i in range(plant.p)]
    tip = [] if plant.arm is None else ["rms_tip"]
    behind = ["rms_behind_play"] if sensor == "play" else []
    sums = "rms_tracking", "rms_estimation", "peak_tracking", "settling_time"
    return (*sums, "silent_fraction", "rms_input", *right, *left, *tip, *behind, "diverged")


def metric_rows(
    tally: Tally, states: Floats, scales: Scales, samples: int, tail: int, tracked: int
) -> Floats:
    """Return the metrics (runs x columns) of finished runs.

    Args:
        tally: what each run accumulated (runs x 1 or x p each)
        states: the final states of the loop, those of the plant first (runs x S)
        scales: of the plant, 1e12 times which a signal has diverged
        samples: number of samples of a run
        tail: number of samples in the tail
        tracked: number of outputs that follow a reference
    """
    p = tally.right.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):
        metrics = (
            np.sqrt(tally.tracking / (tail * tracked)),
            np.sqrt(tally.estimation / (tail * p)),
            tally.peak,
            tally.settled,
            tally.silent / (samples * p),
            np.sqrt(tally.effort / samples),
        )
        outputs = [tally.peak, metrics[1], tally.right, tally.left]
        worst = largest_scaled_signals(
            scales, [states[:, : scales.states.size]], outputs, metrics[-1]
        )
        bounded = np.isfinite(states).all(axis=1) & (worst < LIMIT)
    tip = np.sqrt(tally.tip / tail)
    behind = np.sqrt(tally.behind / (tail * tracked))
    return np.hstack([*metrics, tally.right, tally.left, tip, behind, ~bounded[:, None]])


class Bands(NamedTuple):
    """Quantiles of the recorded runs over time, by name (i: the output).

    Attributes:
        t: instants (N) [s]
        quantiles: N x len(LEVELS) each: of |z - r| as `tracking[i]`, of the errors d^ - d of the
            widths as `d_right[i]` and `d_left[i]`
    """

    t: Floats
    quantiles: dict[str, Floats]


def error_bands(
    t: Floats, z: Floats, r: Floats, d_hat: Floats, widths: Floats, tracked: Sequence[int]
) -> Bands:
    """Return the bands of recorded runs.

    A signal that is not a number any more counts as infinitely far off, so that a band is one of
    all runs.

    Args:
        t: instants (N) [s]
        z: outputs (lanes x N x p)
        r: references (lanes x N x k)
        d_hat: estimated widths (lanes x N x 2p), right and left of each output in turn
        widths: true widths (lanes x 2p) in the same order
        tracked: the outputs that follow the k references
    """
    errors = {}
    for k, i in enumerate(tracked):
        errors[f"tracking[{i}]"] = np.abs(z[:, :, i] - r[:, :, k])
    for j in range(d_hat.shape[2]):
        name = f"d_{EDGES[j % 2]}[{j // 2}]"
        errors[name] = d_hat[:, :, j] - widths[:, None, j]
    return Bands(t, {name: _quantiles_over_time(error) for name, error in errors.items()})


def true_width(
    name: str, widths: Sequence[float], varied: Mapping[str, Floats], geared: bool
) -> Floats:
    """Return the true width of a breakpoint in each run: a number, or a column (runs) if it
    varies.

    Args:
        name: the edge, such as `right[0]`
        widths: [right, left] of each output in the scenario, one after the other
        varied: columns by the names of `varied.UncertainNumber`, in whatever words they name the
            edge
        geared: whether the widths are gaps of gears, whose half gaps and centres are drawn
    """
    edge, _, index = name.rstrip("]").partition("[")
    right, left = widths[2 * int(index) : 2 * int(index) + 2]
    sign, nominal = (1, right) if edge == "right" else (-1, left)
    if not geared:
        return _value_of_runs(f"sensor.{name}", nominal, varied)
    joint = int(index) + 1
    half = (right + left) / 2
    centre = (right - left) / 2
    wider = _value_of_runs(f"plant.parameters.half{joint}", half, varied) - half
    moved = _value_of_runs(f"plant.parameters.centre{joint}", centre, varied) - centre
    return nominal + wider + sign * moved


def width_error(
    name: str,
    metrics: Mapping[str, Floats],
    widths: Sequence[float],
    varied: Mapping[str, Floats],
    geared: bool,
) -> Floats:
    """Return the final error d^ - d of a width in each run.

    Args:
        name: of the error, such as `d_right_error[0]`
        metrics: columns by name
        widths, varied, geared: as of `true_width`
    """
    metric = name.replace("_error[", "[")
    return metrics[metric] - true_width(metric.removeprefix("d_"), widths, varied, geared)


def interleave_widths(sensor: Zone) -> list[float]:
    """Return [right, left] of each output, output by output (2 p) [y]."""
    return list(np.stack([sensor.right, sensor.left], axis=1).ravel().tolist())


def _value_of_runs(name: str, nominal: float, varied: Mapping[str, Floats]) -> Floats:
    """Return a number of the scenario in each run: a constant, or a column (runs) if it
    varies.
    """
    for words, column in varied.items():
        address = words.removesuffix(" (relative)")
        if any(matching(part, [name]) for part in address.split(" + ")):
            relative = address != words
            return column * nominal if relative else column
    return np.asarray(nominal)


def _quantiles_over_time(values: Floats) -> Floats:
    """Return the quantiles at each instant (N x levels) of values (lanes x N).

    Each is the value of a run: nothing is interpolated between a number and infinity.
    """
    bounded = np.where(np.isnan(values), np.inf, values)
    return np.quantile(bounded, LEVELS, axis=0, method="inverted_cdf").T
