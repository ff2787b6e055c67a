"""An observer along a log that was recorded: `estimate`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from undeadzone.errors import FileError, InputError
from undeadzone.logs.names import Layout, parse_columns
from undeadzone.logs.samples import Faults, LogReader, Placed, placed, samples_of_text
from undeadzone.logs.whole import BINARY, samples_of, samples_of_arrays
from undeadzone.results.estimation import Estimation
from undeadzone.results.signals import LOG, Signals, of_estimate
from undeadzone.scenario.reader import read_for_logs
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.follower import Follower, require_units
from undeadzone.simulation.smoother import smooth
from undeadzone.support.arrays import Array
from undeadzone.support.files import LARGEST_RUN
from undeadzone.support.progress import in_notebook

LARGEST_LOG: Final = 20_000_000  # samples; beyond this the memory of most machines


def estimate(
    scenario: Scenario | str | os.PathLike[str],
    frame_or_path: Any = None,
    *,
    t: Array | None = None,
    u: Array | None = None,
    y: Array | None = None,
    columns: str | None = None,
    strict: bool = False,
    smoothing: bool = True,
    progress: Callable[[int], None] | None = None,
) -> Estimation:
    """Let an observer follow a log.

    Args:
        scenario: a scenario, or the path of its file, which needs no [reference], no [controller]
            and no widths of the sensor. Its plant (or model), sensor, observer and step are used,
            in sampled time.
        frame_or_path: the log: a CSV file (any dialect), .npz, .mat, or a pandas DataFrame with
            columns t, y, u; or give arrays.
        t: times (N) [s]; None: one step apart.
        u: inputs (N) or (N x m).
        y: readings (N) or (N x p), NaN where one is missing.
        columns: which column is which where names do not say it: `y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error; else its sample is missing.
        smoothing: whether `kalman`, `censored`, `extended` and `auto` are smoothed too, with the
            whole log.
        progress: called with the number of samples just done; None: a bar in a notebook.

    Returns:
        The estimates along the log, the final widths, and whether the record is consistent.

    Raises:
        FileError: the log cannot be read, its columns cannot be told, or its step is another one.
        InputError: or a subclass, for what is wrong with the scenario or the arrays.
    """
    if not isinstance(scenario, Scenario):
        scenario = read_for_logs(scenario)
    follower = Follower(scenario)
    chosen = parse_columns(columns)
    if frame_or_path is None:
        if y is None or u is None:
            raise InputError("estimate: expected a file, a DataFrame, or arrays y and u")
        step, model = scenario.simulation.step, follower.model
        samples = samples_of_arrays(t, y, u, model.p, model.m, step)
        log = _Log("arrays", placed(samples, t is not None, step, "arrays"))
    elif t is not None or y is not None or u is not None:
        raise InputError("estimate: expected a log or arrays, found both")
    else:
        log = _read(scenario, follower, frame_or_path, chosen, strict)
    regular = log.placed.samples
    if regular.t.size > LARGEST_LOG:
        raise FileError(
            f"{log.source}: more than {LARGEST_LOG} samples; give it to undeadzone watch, or split "
            "it"
        )
    with in_notebook(progress, "estimating", None) as advance:
        estimated, sides, B = follower.follow(regular, advance)
        given = {name: value for name, value in of_estimate(estimated).items() if name in LOG.names}
        signals = {"t": regular.t, "y": regular.y, "u": regular.u, "side": sides} | given
        if B.size:
            signals["B"] = B
        if smoothing and follower.observer.smoothing is not None and regular.t.size:
            parts = follower.model, follower.observer, follower.zone
            signals |= smooth(*parts, regular.y, regular.u, advance)
    info = follower.info(log.source, log.layout, log.placed, log.faults)
    return Estimation(info, Signals(LOG, signals))


class _Log(NamedTuple):
    """A log as it was read.

    Attributes:
        source: what it is called in messages.
        placed: its samples, one step apart.
        layout: its columns; None: it has none.
        faults: the lines that cannot be read; None: it has no lines.
    """

    source: str
    placed: Placed
    layout: Layout | None = None
    faults: Faults | None = None


def _read(
    scenario: Scenario, follower: Follower, log: Any, chosen: Mapping[str, str], strict: bool
) -> _Log:
    """A log from a file or a DataFrame."""
    is_path = isinstance(log, str | os.PathLike)
    if not is_path and not (hasattr(log, "columns") and hasattr(log, "index")):
        raise InputError(f"estimate: expected a path or a DataFrame, found {type(log).__name__}")
    source = str(log) if is_path else "DataFrame"
    p, m = follower.model.p, follower.model.m
    layout: Layout | None
    faults: Faults | None = None
    if is_path and Path(log).suffix.lower() not in BINARY:
        reader = LogReader(source, p, m, chosen, strict)
        samples = samples_of_text(reader, Path(log), LARGEST_RUN, LARGEST_LOG)
        layout, faults = reader.layout, reader.faults
    else:
        samples, layout = samples_of(Path(log) if is_path else log, p, m, chosen, source)
    if layout is not None:
        require_units(layout, scenario.units, source)
    timed = layout is not None and layout.timed
    on_steps = placed(samples, timed, scenario.simulation.step, source)
    return _Log(source, on_steps, layout, faults)
