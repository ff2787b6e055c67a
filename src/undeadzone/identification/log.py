"""A log as it was recorded: times, inputs and readings, checked for usual mistakes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.errors import FileError
from undeadzone.logs.names import Layout
from undeadzone.logs.samples import Samples
from undeadzone.support.arrays import LARGEST, Floats

Flags = npt.NDArray[np.bool_]


class Log(NamedTuple):
    """A record of one plant.

    Attributes:
        t: times (N) [s], increasing.
        u: inputs (N x m).
        y: readings (N x p); NaN where one is missing.
        inputs, outputs: names of the inputs (m) and of the readings (p)
        input_unit: unit of the inputs, "1" where none is named, or several differ.
        output_units: units of the readings (p), "1" where none is named.
        source: where the log came from, for messages.
        lines: the line of each sample in its file (N), for messages; empty where there is none.
        counted: whether the times count samples, so that no rate in seconds is known.
        remarks: what was left out, for the user.
    """

    t: Floats
    u: Floats
    y: Floats
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_unit: str
    output_units: tuple[str, ...]
    source: str
    lines: Any
    counted: bool
    remarks: tuple[str, ...] = ()

    def of_output(self, k: int) -> Log:
        """The log with one of its outputs alone."""
        return self._replace(
            y=self.y[:, k : k + 1],
            outputs=self.outputs[k : k + 1],
            output_units=self.output_units[k : k + 1],
        )


def checked_log(samples: Samples, layout: Layout, source: str) -> Log:
    """A log from samples, fit for identification.

    Args:
        samples: times, readings, inputs.
        layout: where they came from, with units.
        source: the log, for messages.

    Returns:
        The log; times that count samples have 1 s between two of them.

    Raises:
        FileError: times that do not increase, a missing input, readings that are all missing.
    """
    t, lines = samples.t, samples.lines
    outputs, inputs = tuple(layout.reading_names), tuple(layout.input_names)
    y = np.where(np.isfinite(samples.y), samples.y, np.nan)
    _check_times(t, source, lines)
    _check_inputs(samples.u, inputs, source, lines)
    for name, column in zip(outputs, y.T, strict=True):
        if np.isnan(column).all():
            raise FileError(f"{source}: {name} holds no reading: every one is missing")
        if np.nanmax(np.abs(column)) > LARGEST:
            raise FileError(f"{source}: {name} holds numbers beyond {LARGEST:g}")
    units = {unit or "1" for unit in layout.input_units}
    return Log(
        t,
        samples.u,
        y,
        inputs,
        outputs,
        units.pop() if len(units) == 1 else "1",
        tuple(unit or "1" for unit in layout.reading_units),
        source,
        lines,
        layout.seconds is None,
    )


def where(source: str, lines: Any, index: int) -> str:
    """The place of a sample, for messages: its line where the file has one."""
    if len(lines):
        return f"{source}, line {int(lines[index])}"
    return f"{source}, sample {index}"


def _check_times(t: Floats, source: str, lines: Any) -> None:
    """Every time is a number and later than the one before. Raises FileError."""
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise FileError(f"{where(source, lines, bad[0])}: the time is missing or not finite")
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        index = int(back[0]) + 1
        raise FileError(
            f"{where(source, lines, index)}: time does not increase: {t[index]:.9g} s after"
            f" {t[index - 1]:.9g} s; sort the lines, or give logs of several runs as several files"
        )


def _check_inputs(u: Floats, inputs: Sequence[str], source: str, lines: Any) -> None:
    """Every input is a number of sensible size. Raises FileError."""
    bad = np.argwhere(~np.isfinite(u) | (np.abs(u) > LARGEST))
    if bad.size:
        row, column = bad[0]
        raise FileError(
            f"{where(source, lines, int(row))}: input {inputs[column]!r} is missing or not a"
            " usable number; an input must be known at every sample"
        )
