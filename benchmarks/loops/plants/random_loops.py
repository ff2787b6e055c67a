"""Many closed loops of one structure at once: one graph, with numbers of their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from undeadzone.compile import lanes
from undeadzone.interfaces import Estimate
from undeadzone.nonlinearities.play import levels
from undeadzone.observers import Censored
from undeadzone.plants.options import Plant
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.simulate import prepare
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_studies.statistics.intervals import quantile_interval


class Loops(NamedTuple):
    """Random loops of one observer.

    Attributes:
        rms: of z - r, late (K).
        hidden: rms of z - z^, late (K).
        errors: of the widths in the end (K x 2).
        stds: claimed deviations of the same (K x 2), or without columns.
        width_std: that of their sum (K), or empty.
        width: true sum of the widths (K).
        behind: rms of y / m - r without noise, late (K); of a sensor without play that of z - r.
        peak: largest |u|, late (K).
        actuator: errors of the actuator's widths in the end (K x 2), or without columns.
        actuator_stds: claimed deviations of the same.
        gaps: true gaps of a play ahead of a dead zone (K x 2), or without columns.
        gap_errors: errors of its gaps in the end (K x 2), or without columns.
        gap_std: claimed deviation of their sum (K), or empty.
    """

    rms: Floats
    hidden: Floats
    errors: Floats
    stds: Floats
    width_std: Floats
    width: Floats
    behind: Floats
    peak: Floats
    actuator: Floats
    actuator_stds: Floats
    gaps: Floats
    gap_errors: Floats
    gap_std: Floats

    def actuator_covered(self) -> str:
        """The share of the actuator's widths that claimed intervals hold; nothing if none are."""
        if not self.actuator_stds.size:
            return ""
        return f"{np.mean(np.abs(self.actuator) <= 1.96 * self.actuator_stds):.2f}"

    def covered(self) -> str:
        """The share of the widths that claimed 95 % intervals hold; nothing if none is claimed."""
        if not self.stds.size:
            return ""
        return f"{np.mean(np.abs(self.errors) <= 1.96 * self.stds):.2f}"


def ratio_cells(rms: Floats, best: Floats, digits: int = 2) -> list[str]:
    """Median of an rms, that of its ratio to the best one with a 95 % interval, 90 % quantile."""
    ratio = np.sort(np.nan_to_num(rms / best, nan=np.inf))
    middle = quantile_interval(ratio, 0.5)
    interval = f"{middle.value:.2f} [{middle.low:.2f}, {middle.high:.2f}]"
    return [f"{np.median(rms):.3g}", interval, f"{np.quantile(ratio, 0.9):.{digits}f}"]


def white_censored(step: float, **options: Any) -> Censored:
    """`Censored` told that a white disturbance is all that it does not know of the plant."""
    told = {"bias": 0.0, "calibrated": 0.0, "tolerance": 0.0, "drift": 0.0, "levels": 1}
    return Censored(correlation_time=step, **told | options)


def random_plant(rng: np.random.Generator) -> Plant:
    """A stable plant of second order."""
    a0, a1, b = rng.uniform(0.5, 4.0), rng.uniform(0.8, 4.0), rng.uniform(0.5, 2.0)
    return Plant(A=[[0.0, 1.0], [-a0, -a1]], B=[[0.0], [b]], C=[[1.0, 0.0]])


def run_loops(each: Sequence[Problem], late: float) -> Loops:
    """Run loops of one structure, one lane each.

    Args:
        each: the loops.
        late: from when on they are judged [s].
    """
    prepared = [prepare(problem) for problem in each]
    loop, step = prepared[0][0], each[0].scenario.simulation.step
    states = np.stack([state for _, state, _ in prepared])
    numbers = np.stack([tree.pack_tree(one.params) for one, _, _ in prepared])
    own = np.stack([exogenous for _, _, exogenous in prepared], axis=2)
    kernel = lanes.build_kernel(
        loop.step, exogenous=range(own.shape[1]), params=range(numbers.shape[1])
    )
    shared = np.zeros(own.shape[:2])
    out, _ = lanes.run_lanes(kernel, states, shared, numbers[0], own, numbers, threads=1)
    places = tree.leaf_slices(loop.outputs)
    estimate = places.estimate
    t = np.arange(len(shared)) * step
    r = np.stack([problem.reference.output_at(t)[:, 0] for problem in each])
    judged = slice(round(late / step), None)
    z, u = out[:, judged, places.z][..., 0], out[:, judged, places.u]
    behind = np.stack([_behind(*pair) for pair in zip(each, out[..., places.z], strict=True)])
    widths = np.concatenate([out[:, -1, estimate.right], out[:, -1, estimate.left]], 1)
    stds = np.concatenate([out[:, -1, estimate.right_std], out[:, -1, estimate.left_std]], 1)
    true = np.stack([[problem.sensor.right[0], problem.sensor.left[0]] for problem in each])
    b_stds = [out[:, -1, estimate.actuator_right_std], out[:, -1, estimate.actuator_left_std]]
    b = [out[:, -1, estimate.actuator_right], out[:, -1, estimate.actuator_left]]
    drives = [problem.actuator for problem in each]
    b_true = np.array([[*drive.right, *drive.left] for drive in drives if drive is not None])
    wrong = np.concatenate(b, 1) - b_true if len(b_true) else np.zeros((len(each), 0))
    gaps, gap_errors = _gaps(each, out[:, -1], estimate)
    return Loops(
        rms=_rms(z - r[:, judged]),
        hidden=_rms(z - out[:, judged, estimate.z][..., 0]),
        errors=widths - true,
        stds=stds,
        width_std=out[:, -1, estimate.width_std].ravel(),
        width=true.sum(axis=1),
        behind=_rms((behind - r)[:, judged]),
        peak=np.abs(u).max(axis=(1, 2)),
        actuator=wrong,
        actuator_stds=np.concatenate(b_stds, 1),
        gaps=gaps,
        gap_errors=gap_errors,
        gap_std=out[:, -1, estimate.gap_std].ravel(),
    )


def _gaps(each: Sequence[Problem], last: Floats, places: Estimate) -> tuple[Floats, Floats]:
    """The true gaps ahead of dead zones, and the errors of those that were estimated (K x 2)."""
    plays = [problem.sensor.play for problem in each]
    true = np.array([[play.right[0], play.left[0]] for play in plays if play is not None])
    true = true.reshape(-1, 2)
    found = np.concatenate([last[:, places.gap_right], last[:, places.gap_left]], 1)
    errors = found - true if found.shape == true.shape else np.zeros((len(each), 0))
    return true, errors


def _behind(problem: Problem, z: Floats) -> Floats:
    """What is behind the play of a loop along outputs (N x 1), z itself without one (N)."""
    sensor = problem.sensor
    if sensor.kind != "play":
        return z[:, 0]
    return levels(z, sensor.right, sensor.left, sensor.start)[:, 0]


def _rms(error: Floats) -> Floats:
    """The root of the mean square along each row (K)."""
    return np.asarray(np.sqrt(np.mean(error**2, axis=1)))
