"""What estimating dead zones of random widths does for the tip of an arm, and how near the estimated widths come."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

import undeadzone as uz
from undeadzone.analysis.identifiability.linear import MARGIN
from undeadzone.ensemble.bands import true_width
from undeadzone.ensemble.batch import Batch, prepare
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario
from undeadzone.statistics.intervals import Interval, proportion, quantile
from undeadzone.support.arrays import Floats

EXAMPLES = Path(__file__).parents[1] / "examples"
RUNS = 100
WITHIN, THIRD = 0.05, 1 / 3  # of a width; of the uncompensated error


class Accuracy(NamedTuple):
    """Of each run: rms error of the tip over the last 2 s [m], compensated and not; widths (runs x joints x [right, left]).

    reached: whether the path of a joint goes beyond its edges.
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
    scenario = msgspec.structs.replace(
        scenario, ensemble=msgspec.structs.replace(scenario.ensemble or uz.Vary(), runs=RUNS)
    )
    if blind and scenario.compare is None:
        return None
    return prepare(
        msgspec.structs.replace(scenario, observer=scenario.compare) if blind else scenario
    )


def measured(name: str) -> Accuracy:
    """The runs of an example beside its [compare], with the same widths, noise and initial states."""
    ours, other = fleet(name), fleet(name, blind=True)
    assert ours is not None
    found, blind = _columns(ours), None if other is None else _columns(other)
    varied, sensor = {words: found[words] for words in ours.binding.names}, ours.problem.sensor
    edges = [
        [
            (f"{edge}[{i}]", nominal[i])
            for edge, nominal in (("right", sensor.right), ("left", sensor.left))
        ]
        for i in range(ours.problem.plant.p)
    ]
    runs = ours.layout.runs
    estimate = np.array([[found[f"d_{words}"] for words, _ in pair] for pair in edges])
    truth = np.array(
        [
            [np.broadcast_to(true_width(words, nominal, varied), runs) for words, nominal in pair]
            for pair in edges
        ]
    )
    path = ours.problem.reference.value(
        np.arange(len(ours.exogenous)) * ours.problem.scenario.simulation.step
    )
    reached = np.stack([path.max(axis=0), -path.min(axis=0)], axis=1)[..., None] > (
        1 + MARGIN
    ) * np.where(truth > 0, truth, np.inf)
    return Accuracy(
        _tip(found),
        None if blind is None else _tip(blind),
        *(part.transpose(2, 0, 1) for part in (estimate, truth, reached)),
    )


def _columns(given: Batch) -> dict[str, Floats]:
    runs = given.layout.runs
    return dict(
        zip(
            given.layout.columns,
            given.rows(np.arange(runs), given.binding.draw(0, runs, runs)).T,
            strict=True,
        )
    )


def _tip(found: dict[str, Floats]) -> Floats:
    return np.where(found["diverged"] != 0, np.inf, found["rms_tip"])


def tips(name: str, found: Accuracy) -> str:
    """The row of an arm."""
    scenario = read(EXAMPLES / f"{name}.toml")
    cells = [name, method(scenario), _median(1e3 * found.tip, "{:.3g}")]
    if found.blind is None:
        return _row(*cells, "no [compare]", "", "")
    ratio = found.tip / found.blind
    return _row(
        *cells,
        _median(1e3 * found.blind, "{:.3g}"),
        _median(ratio, "{:.3g}"),
        _share(ratio <= THIRD),
    )


def widths(name: str, found: Accuracy) -> list[str]:
    """A row for each joint: relative errors of what the readings determine."""
    info = uz.simulate(read(EXAMPLES / f"{name}.toml")).info
    lines = []
    for i, verdict in enumerate(info.identifiable):
        (right, left), (d_right, d_left), (far, near) = (
            found.estimate[:, i].T,
            found.truth[:, i].T,
            found.reached[:, i].T,
        )
        parts = {
            "width": (right + left, d_right + d_left, far & near),
            "right": (right, d_right, far),
            "left": (left, d_left, near),
        }
        cells = [
            _relative(*part) if verdict[key] else "not identifiable" for key, part in parts.items()
        ]
        lines.append(_row(name, str(i + 1), *cells, "yes" if verdict["centre"] else "no"))
    return lines


def _relative(estimate: Floats, truth: Floats, reached: npt.NDArray[np.bool_]) -> str:
    """Of the runs in which the path reaches the edges."""
    if not reached.any():
        return "never reached" if truth.any() else "no dead zone"
    error = np.abs(estimate[reached] / truth[reached] - 1)
    few = "" if reached.all() else f" of {error.size}"
    return f"{_median(100 * error, '{:.2g}')}; {_share(error <= WITHIN)}{few}"


def method(scenario: Scenario) -> str:
    return str(type(scenario.observer).__struct_config__.tag)


def _median(values: Floats, form: str) -> str:
    return _interval(quantile(np.sort(values), 0.5), form)


def _share(held: Any) -> str:
    return (
        _interval(
            Interval(*(100 * value for value in proportion(int(held.sum()), held.size))), "{:.3g}"
        )
        + " %"
    )


def _interval(found: Interval, form: str) -> str:
    value, low, high = map(form.format, found)
    return f"{value} ({low} to {high})"


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def lines(names: tuple[str, ...]) -> list[str]:
    """The tables of these examples."""
    found = {name: measured(name) for name in names}
    return [
        f"\n{RUNS} arms with random widths, asymmetric, each joint its own: medians over runs and shares of runs with 95 % intervals.\n",
        "| arm | observer | rms error of the tip, last 2 s [mm] | uncompensated [mm] | their ratio | at most a third |\n|---|---|---|---|---|---|",
        *(tips(name, one) for name, one in found.items()),
        "\nRelative errors [%] of estimated widths at the end, and share within 5 %, of runs whose path passes the edges by 5 %.\n",
        "| arm | joint | d_r + d_l | d_r | d_l | centre identifiable |\n|---|---|---|---|---|---|",
        *(line for name, one in found.items() for line in widths(name, one)),
    ]
