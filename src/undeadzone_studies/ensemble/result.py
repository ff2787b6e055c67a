"""Result of an ensemble: the columns of varied entries and of metrics, and their statistics."""

from __future__ import annotations

import dataclasses
import os
from functools import reduce
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError
from undeadzone.results.run import LAST
from undeadzone.util import shown
from undeadzone.util.arrays import Floats, to_json_value
from undeadzone.util.shown import Block
from undeadzone_studies.ensemble import saved
from undeadzone_studies.ensemble.metrics import Bands, width_error
from undeadzone_studies.ensemble.saved import Info, unit_of_column
from undeadzone_studies.ensemble.words import describe_ensemble
from undeadzone_studies.statistics import sensitivity
from undeadzone_studies.statistics.intervals import LEVEL, Interval, describe, proportion
from undeadzone_studies.statistics.sensitivity import Sensitivity

JUDGED: Final = 2**16  # runs from which sensitivities are found
MAIN: Final = "rms_tracking"  # the metric by which runs are ranked
WIDTHS: Final = "d_error"  # the largest |d^ - d| of a run, at the end
LISTED_RUNS: Final = 10  # worst runs, and runs that diverged, in a summary


def _influence_of_entry(one: Sensitivity) -> float:
    """Return the share of the variance (of the ranks' variance if larger) that comes from the
    entry.
    """
    return max(one.spearman.value**2, (one.total_order or one.first_order).value)


@dataclasses.dataclass(frozen=True, eq=False)
class Ensemble:
    """Many runs of a scenario as columns by name, one number a run. Columns may be maps of
    files.

    Attributes:
        varied: the values of the varied entries
        metrics: what came of each run, with `diverged`, 0 or 1
        info: metadata besides the columns
        bands: quantiles over time of the recorded runs (None if none were recorded)
    """

    varied: dict[str, Floats]
    metrics: dict[str, Floats]
    info: Info
    bands: Bands | None = None

    @property
    def drawn(self) -> tuple[str, str, str]:
        """Return module and functions that draw the ensemble for `uz.plot`."""
        return "undeadzone_studies.report.ensemble_figures", "first_of_ensemble", "distribution"

    @property
    def diverged(self) -> npt.NDArray[np.bool_]:
        """Return a mask of the diverged runs, which all statistics except their share leave out."""
        return self.metrics["diverged"] != 0

    @property
    def independent(self) -> slice:
        """Return the runs independent of each other: all, or blocks A and B of Saltelli's
        design.
        """
        blocks = len(self.varied) + 2 if self.info.sampling == "saltelli" else 2
        return slice(2 * self.info.runs // blocks)

    @property
    def quantities(self) -> list[str]:
        """Return the names of the quantities that have a distribution.

        These are the metrics, the errors d^ - d of the widths as `d_right_error[0]`, and the
        largest of their sizes, `d_error`.
        """
        return [
            *(name for name in self.metrics if name != "diverged"),
            *self.width_error_names,
            WIDTHS,
        ]

    @property
    def width_error_names(self) -> list[str]:
        """Return the names of the errors of the widths."""
        widths = [name for name in self.metrics if name.startswith(("d_right[", "d_left["))]
        return [name.replace("[", "_error[") for name in widths]

    def column(self, name: str) -> Floats:
        """Return a column by name (runs).

        Args:
            name: a varied entry, a metric, or one of `quantities`

        Returns:
            One number for each run, those that diverged included.

        Raises:
            InputError: there is no such column.
        """
        if name == WIDTHS:
            return reduce(
                np.maximum, (np.abs(self.column(each)) for each in self.width_error_names)
            )
        if name in self.metrics:
            return self.metrics[name]
        if name in self.varied:
            return self.varied[name]
        if name not in self.width_error_names:
            known = ", ".join([*self.varied, *self.quantities])
            raise InputError(f"{name}: is not a column of this ensemble. There are {known}")
        return width_error(name, self.metrics, self.info.widths, self.varied, self.info.geared)

    def sample(self, name: str) -> Floats:
        """Return the values of a quantity for the statistics: independent runs that did
        not diverge.

        Args:
            name: as of `column`

        Returns:
            Its numbers in these runs. The settling time of a run that did not settle is infinite.

        Raises:
            InputError: there is no such column, or no such run.
        """
        values = self.column(name)[self.independent]
        if name == "settling_time":
            values = np.where(self.settled[self.independent], values, np.inf)
        return values[~self.diverged[self.independent]]

    @property
    def settled(self) -> npt.NDArray[np.bool_]:
        """Return a mask of the settled runs.

        They did not diverge and kept |z - r| within the tolerance for the last 2 s (at the end of a
        shorter run).
        """
        settled_for = LAST if self.info.duration > LAST else self.info.step
        until = self.info.duration - settled_for
        return ~self.diverged & (self.metrics["settling_time"] <= until)

    def unit(self, name: str) -> str:
        """Return the unit of a column.

        Args:
            name: as of `column`

        Returns:
            The unit, 1 also if it is unknown.
        """
        return unit_of_column(name, self.info.units)

    def worst(self, metric: str = MAIN, count: int = LISTED_RUNS) -> list[int]:
        """Return the numbers of the worst runs, worst first.

        Args:
            metric: by which runs are ranked, as of `column`
            count: how many

        Returns:
            Those that diverged, then those in which the metric is largest in size.

        Raises:
            InputError: there is no such column, or no such run.
        """
        size = np.where(self.diverged, np.inf, np.abs(self.column(metric)))
        bar = 0.0  # the least size among the worst
        if count < size.size:
            bar = np.partition(size, -count)[-count]
        runs = np.flatnonzero(size >= bar)
        worst_first = np.lexsort((runs, -size[runs]))
        return runs[worst_first][:count].tolist()

    def typical(self, metric: str = MAIN) -> int | None:
        """Return the number of the run with the median metric.

        Args:
            metric: as of `column`

        Returns:
            The run, or None if all diverged, or the median is infinite.

        Raises:
            InputError: there is no such column, or no such run.
        """
        sample = self.sample(metric)
        if not sample.size:
            return None
        middle = np.partition(sample, sample.size // 2)[sample.size // 2]
        if not np.isfinite(middle):
            return None
        return int(np.flatnonzero(~self.diverged & (self.column(metric) == middle))[0])

    def sensitivities(self, metric: str = MAIN) -> dict[str, Sensitivity]:
        """Return the sensitivities of a metric to each varied entry.

        Args:
            metric: as of `column`

        Returns:
            Sensitivities by entry, the most influential first, none for too few runs.

        Raises:
            InputError: there is no such column, or no such run.
        """
        if not self.varied:
            return {}
        values = np.where(self.diverged, np.nan, self.column(metric))
        finite = np.flatnonzero(np.isfinite(values[self.independent]))[:JUDGED]
        entries = np.column_stack([column[finite] for column in self.varied.values()])
        by_entry = sensitivity.sensitivities_of_runs(entries, values[finite])
        if self.info.sampling == "saltelli":
            blocks = values.reshape(len(self.varied) + 2, -1)[:, :JUDGED]
            by_entry = [
                one._replace(first_order=index.first, floor=None, total_order=index.total)
                for one, index in zip(by_entry, sensitivity.saltelli_indices(blocks), strict=False)
            ]
        pairs = zip(self.varied, by_entry, strict=False)
        return dict(sorted(pairs, key=lambda pair: -_influence_of_entry(pair[1])))

    def row(self, run: int) -> dict[str, Any]:
        """Return one run as a table.

        Args:
            run: its number, from 0

        Returns:
            `run`, `diverged`, the values `varied` and the `metrics`, by name.

        Raises:
            InputError: there is no such column, or no such run.
        """
        if not 0 <= run < self.info.runs:
            raise InputError(f"run {run}: expected 0 to {self.info.runs - 1}")
        return {
            "run": run,
            "diverged": bool(self.diverged[run]),
            "varied": {name: float(column[run]) for name, column in self.varied.items()},
            "metrics": {name: float(column[run]) for name, column in self.metrics.items()},
        }

    def summary(self) -> dict[str, Any]:
        """Return all statistics, ready for JSON.

        Returns:
            Shares, distributions, sensitivities and worst runs (null if the runs give no bound).
        """
        diverged = self.diverged[self.independent]
        settled = self.settled[self.independent]
        info = msgspec.structs.asdict(self.info)
        del info["scenario"], info["units"]
        lost = np.flatnonzero(self.diverged)[:LISTED_RUNS].tolist()
        names = [] if diverged.all() else self.quantities
        summary = {
            **info,
            "confidence": LEVEL,
            "diverged": _share_of_runs(diverged)._asdict() | {"runs": lost},
            "settled": _share_of_runs(settled),
            "metrics": {name: describe(self.sample(name)) for name in names},
            "sensitivities": self.sensitivities(),
            "typical": self.typical(),
            "worst": list(map(self.row, self.worst())),
        }
        return to_json_value(summary)

    def blocks(self, summary: dict[str, Any] | None = None) -> list[Block]:
        """Return the tables that `undeadzone ensemble` prints (summary: its own, if already
        computed).
        """
        numbers = self.summary() if summary is None else summary
        return describe_ensemble(self.info, numbers, int(self.diverged.sum()))

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html

    plot = shown.plot
    """Draw it."""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a file with a row for each run.

        Args:
            path: `.npz`, or `.parquet` with pyarrow

        Returns:
            The path.

        Raises:
            FileError: if it cannot be written
            InputError: for another suffix, or where pyarrow is missing
        """
        return saved.save_ensemble_file(path, self.varied, self.metrics, self.info, self.bands)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Ensemble:
        """Read a saved ensemble.

        Args:
            path: of the file

        Returns:
            The ensemble. The columns of an `.npz` stay on disk and are read as they are used.

        Raises:
            FileError: if it cannot be read or is not an ensemble
            InputError: where pyarrow is missing
        """
        return cls(*saved.read_ensemble(path))


def _share_of_runs(runs: npt.NDArray[np.bool_]) -> Interval:
    """Return the share of runs that have a property, with its interval."""
    return proportion(int(runs.sum()), runs.size)
