"""The result of an ensemble: what varied and what came of it, a column each, the statistics of these, and how to keep them."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from undeadzone.ensemble.bands import Bands, true_width
from undeadzone.ensemble.blocks import table_file as storage
from undeadzone.errors import FileError, InputError
from undeadzone.scenario.schema import Units
from undeadzone.simulation.run import LAST
from undeadzone.statistics.intervals import LEVEL, Interval, describe, proportion
from undeadzone.statistics.sensitivity import Correlation, given, saltelli
from undeadzone.support.arrays import Floats, finite

MAIN: Final = "rms_tracking"  # the metric by which runs are ranked
WIDTHS: Final = "d_error"  # the largest |d^ - d| of a run, at the end
JUDGED: Final = 2**16  # runs from which sensitivities are found
_OUTPUT: Final = (
    "rms_",
    "peak_",
    "d_",
    "sensor.right",
    "sensor.left",
    "sensor.noise",
    "reference.amplitude",
)  # in the unit of the output
SHOWN: Final = 10  # worst runs, and runs that diverged, in a summary


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """What an ensemble knows besides its columns; scenario: the TOML text that, with a run's number, replays it.

    duration, step [s]; sampling, seed: how values were drawn; tolerance: of |z - r|, for settling, as a share of the largest |r|;
    widths: the nominal [right, left] of each output; recorded: the first runs, those behind the bands; numbers: a digest of
    what all runs share.
    """

    title: str
    method: str
    time: str
    step: float
    duration: float
    seed: int
    sampling: str
    runs: int
    tolerance: float
    tracked: list[int]
    widths: list[float]
    scenario: str
    version: str
    recorded: int = 0
    numbers: str = ""
    units: Units = Units()


class Sensitivity(NamedTuple):
    """What a metric owes to one entry; first_order: Sobol index, of the design if it is Saltelli's, else of the runs as they are.

    floor: first_order that chance alone reaches once in twenty (None under Saltelli's design); total_order: under it only.
    """

    spearman: Correlation
    partial: Correlation
    first_order: Interval
    floor: float | None
    total_order: Interval | None

    @property
    def influence(self) -> float:
        """The share of the variance, or of that of the ranks if larger, that comes from this entry."""
        return max(self.spearman.value**2, (self.total_order or self.first_order).value)


@dataclasses.dataclass(frozen=True, eq=False)
class Ensemble:
    """Columns by name, one number a run: varied (the entries' values) and metrics (with `diverged`, 0 or 1); they may be maps of files."""

    varied: dict[str, Floats]
    metrics: dict[str, Floats]
    info: Info
    bands: Bands | None = None

    @property
    def diverged(self) -> npt.NDArray[np.bool_]:
        """Which runs diverged; no statistic but their share takes them in."""
        return self.metrics["diverged"] != 0

    @property
    def independent(self) -> slice:
        """The runs that are independent of each other: all, or blocks A and B of Saltelli's design."""
        blocks = len(self.varied) + 2 if self.info.sampling == "saltelli" else 2
        return slice(2 * self.info.runs // blocks)

    @property
    def quantities(self) -> list[str]:
        """What has a distribution: the metrics, the errors of the widths as `d_right_error[0]`, d^ - d, and the largest of their sizes, `d_error`."""
        return [*(name for name in self.metrics if name != "diverged"), *self.errors, WIDTHS]

    @property
    def errors(self) -> list[str]:
        """The errors of the widths, by name."""
        return [
            name.replace("[", "_error[")
            for name in self.metrics
            if name.startswith(("d_right[", "d_left["))
        ]

    def column(self, name: str) -> Floats:
        """A varied entry, metric or error of widths by name (runs). Raises InputError."""
        if name == WIDTHS:
            return functools.reduce(
                np.maximum, (np.abs(self.column(error)) for error in self.errors)
            )
        known = {**self.varied, **self.metrics}
        if name in known:
            return known[name]
        edge, _, index = name.partition("_error[")
        if f"{edge}[{index}" not in self.metrics:
            raise InputError(
                f"{name}: is not a column of this ensemble; there are {', '.join([*self.varied, *self.quantities])}"
            )
        nominal = self.info.widths[2 * int(index.rstrip("]")) + (edge == "d_left")]
        return self.metrics[f"{edge}[{index}"] - true_width(
            f"{edge.removeprefix('d_')}[{index}", nominal, self.varied
        )

    def sample(self, name: str) -> Floats:
        """What the statistics of a quantity take in: independent runs that did not diverge; a run that did not settle takes for ever."""
        values = self.column(name)[self.independent]
        if name == "settling_time":
            values = np.where(self.settled[self.independent], values, np.inf)
        return values[~self.diverged[self.independent]]

    @property
    def settled(self) -> npt.NDArray[np.bool_]:
        """Which runs did not diverge and kept |z - r| within the tolerance for the last 2 s (at the end of a shorter run)."""
        until = self.info.duration - (LAST if self.info.duration > LAST else self.info.step)
        return ~self.diverged & (self.metrics["settling_time"] <= until)

    def unit(self, name: str) -> str:
        """The unit of a column; 1 also where it is not known."""
        units, stem = self.info.units, name.partition("[")[0]
        if name.endswith("(relative)"):
            return "1"
        return {"settling_time": "s", "rms_input": units.input, "rms_tip": "m"}.get(
            stem, units.output if stem.startswith(_OUTPUT) else "1"
        )

    def worst(self, metric: str = MAIN, count: int = SHOWN) -> list[int]:
        """The numbers of the worst runs, worst first: those that diverged, then the largest in size. Raises InputError."""
        size = np.where(self.diverged, np.inf, np.abs(self.column(metric)))
        bar = np.partition(size, -count)[-count] if count < size.size else 0.0
        found = np.flatnonzero(size >= bar)
        return [int(run) for run in found[np.lexsort((found, -size[found]))][:count]]

    def typical(self, metric: str = MAIN) -> int | None:
        """The number of the run whose metric is the median; None if all diverged. Raises InputError."""
        sample = self.sample(metric)
        if not sample.size:
            return None
        middle = np.partition(sample, sample.size // 2)[sample.size // 2]
        return (
            int(np.flatnonzero(~self.diverged & (self.column(metric) == middle))[0])
            if np.isfinite(middle)
            else None
        )

    def sensitivities(self, metric: str = MAIN) -> dict[str, Sensitivity]:
        """By varied entry, the most influential first; none for too few runs. Raises InputError."""
        if not self.varied:
            return {}
        values = np.where(self.diverged, np.nan, self.column(metric))
        kept = np.flatnonzero(np.isfinite(values[self.independent]))[:JUDGED]
        found = given(
            np.column_stack([column[kept] for column in self.varied.values()]), values[kept]
        )
        if self.info.sampling == "saltelli":
            designed = saltelli(values.reshape(len(self.varied) + 2, -1)[:, :JUDGED])
            judged = [
                Sensitivity(g.spearman, g.partial, d.first, None, d.total)
                for g, d in zip(found, designed, strict=False)
            ]
        else:
            judged = [Sensitivity(*g, None) for g in found]
        pairs = zip(self.varied, judged, strict=False)
        return dict(sorted(pairs, key=lambda pair: -pair[1].influence))

    def row(self, run: int) -> dict[str, Any]:
        """One run: its number, its values, what came of it. Raises InputError."""
        if not 0 <= run < self.info.runs:
            raise InputError(f"run {run}: expected 0 to {self.info.runs - 1}")
        values = {
            kind: {name: float(column[run]) for name, column in getattr(self, kind).items()}
            for kind in ("varied", "metrics")
        }
        return {"run": run, "diverged": bool(self.diverged[run])} | values

    def summary(self) -> dict[str, Any]:
        """Everything found, ready for JSON: shares, distributions, sensitivities, worst runs; null where the runs give no bound."""
        diverged, settled = (
            getattr(self, name)[self.independent] for name in ("diverged", "settled")
        )
        found = {
            **{
                name: value
                for name, value in msgspec.structs.asdict(self.info).items()
                if name not in ("scenario", "units")
            },
            "confidence": LEVEL,
            "diverged": proportion(int(diverged.sum()), diverged.size)._asdict()
            | {"runs": np.flatnonzero(self.diverged)[:SHOWN].tolist()},
            "settled": proportion(int(settled.sum()), settled.size)._asdict(),
            "metrics": {
                name: _plain(describe(self.sample(name)))
                for name in self.quantities
                if not diverged.all()
            },
            "sensitivities": {
                name: _plain(value._asdict()) for name, value in self.sensitivities().items()
            },
            "typical": self.typical(),
            "worst": [self.row(run) for run in self.worst()],
        }
        return finite(found)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write `.npz`, or `.parquet` with pyarrow (a row for each run). Raises FileError, InputError."""
        header = msgspec.json.encode({"info": self.info, "varied": list(self.varied)}).decode()
        attached = {"t": self.bands.t, **self.bands.quantiles} if self.bands is not None else {}
        return storage.save(
            storage.Table(header, {**self.varied, **self.metrics}, attached), Path(path)
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Ensemble:
        """Read a saved ensemble; the columns of an `.npz` stay on disk and are read as they are used. Raises FileError, InputError."""
        table = storage.load(Path(path))
        try:
            header = msgspec.json.decode(table.header, type=_Header)
            varied = {name: table.columns[name] for name in header.varied}
        except (KeyError, msgspec.DecodeError) as error:
            raise FileError(f"{path}: not an ensemble saved by undeadzone ({error})") from None
        t = table.attached.get("t")
        bands = (
            None
            if t is None
            else Bands(
                t,
                {
                    name: values.reshape(t.size, -1)
                    for name, values in table.attached.items()
                    if name != "t"
                },
            )
        )
        return cls(
            varied,
            {name: column for name, column in table.columns.items() if name not in varied},
            header.info,
            bands,
        )


class _Header(msgspec.Struct, frozen=True):
    info: Info
    varied: list[str]


def _plain(found: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: value._asdict() if hasattr(value, "_asdict") else value
        for name, value in found.items()
    }
