"""What estimating dead zones of random widths does for the tip of an arm, and how exact it is."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

import undeadzone as uz
from benchmarks.markdown import head, row
from undeadzone.analysis.identifiability.linear import MARGIN
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.batch import Batch, prepare_batch
from undeadzone_studies.ensemble.metrics import EDGES, interleave_widths, true_width
from undeadzone_studies.statistics.intervals import Interval, proportion, quantile_interval

EXAMPLES = Path(__file__).parents[2] / "examples"
RUNS = 100
WITHIN = 0.05  # of a width
THIRD = 1 / 3  # of the uncompensated error
TIPS = (
    "arm",
    "observer",
    "rms error of the tip, last 2 s [mm]",
    "uncompensated [mm]",
    "their ratio",
    "at most a third",
)
WIDTHS = ("arm", "joint", "d_r + d_l", "d_r", "d_l", "centre identifiable")
NOTES = (
    "arms with random widths, asymmetric, each joint its own: medians over runs and shares of runs "
    "with 95 % intervals.",
    "Relative errors [%] of estimated widths at the end, and share within 5 %, of runs whose path "
    "passes the edges by 5 %.",
)


class Accuracy(NamedTuple):
    """What came of each run.

    Attributes:
        tip: rms error of the tip over the last 2 s (runs) [m]
        blind: the same without compensation
        estimate, truth: widths (runs x joints x [right, left])
        reached: whether the path of a joint goes beyond its edges (runs x joints x [right, left])
    """

    tip: Floats
    blind: Floats | None
    estimate: Floats
    truth: Floats
    reached: npt.NDArray[np.bool_]


@functools.cache
def fleet(name: str, blind: bool = False) -> Batch | None:
    """The runs of an example, or of what it is compared with, None without that."""
    scenario = read(EXAMPLES / f"{name}.toml")
    ensemble = msgspec.structs.replace(scenario.ensemble or uz.Vary(), runs=RUNS)
    scenario = msgspec.structs.replace(scenario, ensemble=ensemble)
    if not blind:
        return prepare_batch(scenario)
    if scenario.compare is None:
        return None
    return prepare_batch(msgspec.structs.replace(scenario, observer=scenario.compare))


def measured(name: str) -> Accuracy:
    """The runs of an example beside its [compare], with the same widths, noise, initial states."""
    ours, other = fleet(name), fleet(name, blind=True)
    assert ours is not None
    columns = _columns(ours)
    estimate, truth = _widths(ours, columns)
    r = ours.problem.reference.output_at(
        np.arange(len(ours.exogenous)) * ours.problem.scenario.simulation.step
    )
    reach = np.stack([r.max(axis=0), -r.min(axis=0)], axis=1)[None]  # of each joint to each side
    edges = (1 + MARGIN) * np.where(truth > 0, truth, np.inf)
    return Accuracy(
        tip=_tip(columns),
        blind=None if other is None else _tip(_columns(other)),
        estimate=estimate,
        truth=truth,
        reached=reach > edges,
    )


def _widths(fleet: Batch, columns: dict[str, Floats]) -> tuple[Floats, Floats]:
    """Estimated and true widths (runs x joints x [right, left])."""
    sensor, runs = fleet.problem.sensor, fleet.layout.runs
    varied = {name: columns[name] for name in fleet.binding.names_of_columns}
    shape = (runs, fleet.problem.plant.p, 2)
    estimate, truth = np.empty(shape), np.empty(shape)
    for i in range(fleet.problem.plant.p):
        for k, edge in enumerate(EDGES):
            name = f"{edge}[{i}]"
            estimate[:, i, k] = columns[f"d_{name}"]
            truth[:, i, k] = true_width(
                name, interleave_widths(sensor), varied, sensor.kind == "gears"
            )
    return estimate, truth


def _columns(fleet: Batch) -> dict[str, Floats]:
    """All runs simulated: a column for each entry and metric."""
    runs = fleet.layout.runs
    table = fleet.rows_of_runs(np.arange(runs), fleet.binding.draw_columns(0, runs, runs))
    return dict(zip(fleet.layout.columns, table.T, strict=True))


def _tip(columns: dict[str, Floats]) -> Floats:
    """The rms error of the tip, infinite where a run diverged."""
    return np.where(columns["diverged"] != 0, np.inf, columns["rms_tip"])


def tips(name: str, accuracy: Accuracy) -> str:
    """The row of an arm."""
    scenario = read(EXAMPLES / f"{name}.toml")
    cells = [name, method(scenario), _median(1e3 * accuracy.tip, "{:.3g}")]
    if accuracy.blind is None:
        return row(*cells, "no [compare]", "", "")
    ratio = accuracy.tip / accuracy.blind
    blind = _median(1e3 * accuracy.blind, "{:.3g}")
    return row(*cells, blind, _median(ratio, "{:.3g}"), _share(ratio <= THIRD))


def widths(name: str, accuracy: Accuracy) -> list[str]:
    """A row for each joint: relative errors of what the readings determine."""
    info = uz.simulate(read(EXAMPLES / f"{name}.toml")).info
    rows = []
    for i, verdict in enumerate(info.identifiable):
        right, left = accuracy.estimate[:, i].T
        d_right, d_left = accuracy.truth[:, i].T
        far, near = accuracy.reached[:, i].T
        parts = {
            "width": (right + left, d_right + d_left, far & near),
            "right": (right, d_right, far),
            "left": (left, d_left, near),
        }
        cells = []
        for key, part in parts.items():
            cells.append(_relative(*part) if verdict[key] else "not identifiable")
        rows.append(row(name, str(i + 1), *cells, "yes" if verdict["centre"] else "no"))
    return rows


def _relative(estimate: Floats, truth: Floats, reached: npt.NDArray[np.bool_]) -> str:
    """Of the runs in which the path reaches the edges."""
    if not reached.any():
        return "never reached" if truth.any() else "no dead zone"
    error = np.abs(estimate[reached] / truth[reached] - 1)
    few = "" if reached.all() else f" of {error.size}"
    return f"{_median(100 * error, '{:.2g}')}; {_share(error <= WITHIN)}{few}"


def method(scenario: Scenario) -> str:
    """The name of a scenario's observer."""
    return str(type(scenario.observer).__struct_config__.tag)


def _median(values: Floats, form: str) -> str:
    """The median with its interval."""
    return _interval(quantile_interval(np.sort(values), 0.5), form)


def _share(covered: Any) -> str:
    """The share of runs in which something held, with its interval [%]."""
    percent = [100 * value for value in proportion(int(covered.sum()), covered.size)]
    return f"{_interval(Interval(*percent), '{:.3g}')} %"


def _interval(interval: Interval, form: str) -> str:
    """A value with its interval in words."""
    value, low, high = map(form.format, interval)
    return f"{value} ({low} to {high})"


def lines(names: tuple[str, ...]) -> list[str]:
    """The tables of these examples."""
    accuracies = {name: measured(name) for name in names}
    written = [f"\n{RUNS} {NOTES[0]}\n", *head(*TIPS)]
    for name, accuracy in accuracies.items():
        written.append(tips(name, accuracy))
    written += [f"\n{NOTES[1]}\n", *head(*WIDTHS)]
    for name, accuracy in accuracies.items():
        written += widths(name, accuracy)
    return written
