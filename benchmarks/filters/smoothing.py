"""What the smoother gains over the filter, and whether its intervals hold, on random problems.

`python -m benchmarks smoothing --folder FOLDER` keeps every part in the folder and goes on where it
stopped.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.filters.coverage import ROUNDING
from benchmarks.filters.glitches import doubting, from_ranges
from benchmarks.filters.problems.assumed_worlds import KINDS, problems
from benchmarks.filters.problems.random_plants import Problems
from benchmarks.markdown import head, row
from benchmarks.results import load_or_compute
from undeadzone.interfaces import Estimate, require_graph
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.plants.options import Plant
from undeadzone.simulation.estimate import smooth
from undeadzone.simulation.online import Online, build_observer
from undeadzone.util.arrays import Floats

ORDERS = (1, 2, 3)
ASSUMPTIONS = {"told": doubting, "ranges alone": from_ranges}
EVERY = 10  # samples between those at which intervals are looked at


class Part(NamedTuple):
    """What filter and smoother make of the problems of one kind.

    Attributes:
        covered: share of the samples at which intervals of z, d_r, d_l hold, of the filter, of the
            filter at the end, of the smoother (K x 3 x 3)
        rms: of z - z^, of both, over the mean width (K x 2)
    """

    covered: Floats
    rms: Floats


def part(assumed: Callable[[Problems, int], Any], kind: str, count: int, seed: int) -> Part:
    """Problems of one kind, `count` of each order."""
    covered, rms = [], []
    for order in ORDERS:
        posed = problems(KINDS[kind], order, count, seed)
        for k in range(count):
            one = of_problem(assumed, posed, k)
            covered.append(one.covered)
            rms.append(one.rms)
    return Part(np.array(covered), np.array(rms))


def of_problem(assumed: Callable[[Problems, int], Any], posed: Problems, k: int) -> Part:
    """What both make of one problem."""
    right, left = posed.ranges[k, :, 1]
    sensor = Sensor(right=right, left=left, noise=posed.noise[k])
    parts = (assumed(posed, k), Plant(**posed.models[k]._asdict()), sensor, posed.step[k], 10)
    model, zone, observer = build_observer(*parts)
    y, u = posed.y[:, k : k + 1], posed.u[:, k : k + 1]
    causal, _ = Online(*parts).update_many(y, u)
    smoothed = smooth(model, require_graph(observer), zone, y, u)
    truth = np.column_stack([posed.z[:, k], np.tile(posed.d[k], (len(y), 1))])
    covered, last, rms = [], [], []
    for mean, std in (_of_filter(causal), _of_smoother(smoothed)):
        error = np.abs(mean - truth)
        inside = error <= 1.96 * std + ROUNDING
        covered.append(inside[::EVERY].mean(axis=0))
        last.append(1.0 * inside[-1])
        rms.append(np.sqrt(np.mean(error[:, 0] ** 2)) / posed.d[k].mean())
    return Part(np.array([covered[0], last[0], covered[1]]), np.array(rms))


def _of_filter(known: Estimate) -> tuple[Floats, Floats]:
    """Means and deviations of z, d_r, d_l (N x 3): the first state is z."""
    mean = np.hstack([known.z, known.right, known.left])
    return mean, np.hstack([known.x_std[:, :1], known.right_std, known.left_std])


def _of_smoother(known: dict[str, Floats]) -> tuple[Floats, Floats]:
    """Means and deviations of z, d_r, d_l (N x 3)."""
    mean = np.hstack([known["z_smooth"], known["d_smooth"]])
    return mean, np.hstack([known["x_smooth_std"][:, :1], known["d_smooth_std"]])


def stored_part(folder: Path | None, assumptions: str, kind: str, count: int, seed: int) -> Part:
    """`part`, from the folder if it is there already."""
    name = f"{assumptions}, {kind}, {count} of seed {seed}"
    ask = functools.partial(part, ASSUMPTIONS[assumptions], kind, count, seed)
    return Part(*load_or_compute(folder, name, ask))


def table(count: int = 3, seed: int = 0, folder: Path | None = None) -> str:
    """The table, from `count` problems of each order a row."""
    rows = []
    for assumptions in ASSUMPTIONS:
        parts = {kind: stored_part(folder, assumptions, kind, count, seed) for kind in KINDS}
        for kind, one in parts.items():
            rows.append(_row(assumptions, kind, one))
        covered, rms = zip(*parts.values(), strict=True)
        rows.append(_row(assumptions, "all", Part(np.concatenate(covered), np.concatenate(rms))))
    columns = ("z", "d_r", "d_l", "rms, times the filter's", "not worse", "rms of all together")
    lines = [
        "## The smoother beside the filter",
        "",
        f"`censored`, {count} problems of each order from {ORDERS[0]} to {ORDERS[-1]} a row. Share"
        " of the samples at which 95 % intervals hold: filter, filter at the end / smoother, which"
        " says of a width at all times nearly what the filter says at the end; median ratio of the"
        " rms of z - z^, and in how many problems the smoother's is not above the filter's by more"
        " than 1 %; the ratio of the rms over all of them. An exact smoother of an exactly linear"
        f" problem, one edge and a bias that nothing tells apart: {_shares(exact(400))}.",
        "",
        *head("world", "claims", *columns),
        *rows,
        "",
    ]
    return "\n".join(lines)


def _row(assumptions: str, kind: str, one: Part) -> str:
    """A line of the table."""
    cells = []
    for k in range(3):
        filtered, last, smoothed = one.covered[:, :, k].mean(axis=0)
        cells.append(f"{filtered:.3f}, {last:.3f} / {smoothed:.3f}")
    return row(kind, assumptions, *cells, *_shares(one.rms).split(", "))


def _shares(rms: Floats) -> str:
    """Median ratio of the smoother's rms to the filter's, where it is not worse, ratio of all."""
    ratio = rms[:, 1] / rms[:, 0]
    together = np.sqrt(np.mean(rms[:, 1] ** 2) / np.mean(rms[:, 0] ** 2))
    better = int((ratio <= 1.01).sum())
    return f"{np.median(ratio):.2f}, {better} of {ratio.size}, {together:.2f}"


def exact(count: int) -> Floats:
    """rms of z - z^ of filter and smoother (K x 2) where both are exact: [z; d; bias; p], linear.

    Args:
        count: problems K.
    """
    rng, step = np.random.default_rng(0), 0.01
    decay, fade = np.exp(-2 * step), np.exp(-step / 0.4)
    F = np.diag([decay, 1.0, 1.0, fade])
    F[0, 2:] = 1 - decay
    Q = np.zeros((4, 4))
    Q[3, 3] = 0.2**2 * (1 - fade**2)
    h, R = np.array([1.0, -1.0, 0.0, 0.0]), 0.02**2
    P = np.diag([1.0, 0.5**2, 0.2**2, 0.2**2])
    x, mean = rng.multivariate_normal(np.zeros(4), P, count), np.zeros((count, 4))
    truth, before, after = [], [], []
    for _ in range(1000):
        y = x @ h + 0.02 * rng.standard_normal(count)
        K = P @ h / (h @ P @ h + R)
        before.append((mean, P))
        mean, P = mean + np.outer(y - mean @ h, K), P - np.outer(K, h @ P)
        after.append((mean, P))
        truth.append(x[:, 0])
        x = x @ F.T
        x[:, 3] += np.sqrt(Q[3, 3]) * rng.standard_normal(count)
        mean, P = mean @ F.T, F @ P @ F.T + Q
    smoothed = [after[-1][0]]
    for k in range(len(after) - 2, -1, -1):
        gain = after[k][1] @ F.T @ np.linalg.pinv(before[k + 1][1])
        smoothed.append(after[k][0] + (smoothed[-1] - before[k + 1][0]) @ gain.T)
    errors = [
        np.array([one[:, 0] for one in known]) - np.array(truth)
        for known in ([mean for mean, _ in after], smoothed[::-1])
    ]
    return np.stack([np.sqrt(np.mean(one**2, axis=0)) for one in errors], axis=1)
