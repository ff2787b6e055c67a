"""An observer along a log that was recorded: `estimate`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from undeadzone.errors import FileError, InputError
from undeadzone.interfaces import Estimate
from undeadzone.logs.names import Layout, parse_columns
from undeadzone.logs.samples import Faults, LogReader, Regular, placed, samples_of_text
from undeadzone.logs.whole import BINARY, samples_of, samples_of_arrays
from undeadzone.results.estimation import Estimation
from undeadzone.results.info import LogInfo
from undeadzone.results.signals import LOG, Signals, of_estimate
from undeadzone.scenario.reader import read_for_logs
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.follower import Follower, require_units
from undeadzone.simulation.smoother import smooth
from undeadzone.support.arrays import Array, Floats
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
        regular, known = _of_arrays(scenario, follower, t, y, u)
    elif t is not None or y is not None or u is not None:
        raise InputError("estimate: expected a log or arrays, found both")
    else:
        regular, known = _of_log(scenario, follower, frame_or_path, chosen, strict)
    with in_notebook(progress, "estimating", None) as advance:
        estimated, sides, B = follower.follow(regular, advance)
        smoothed = _smoothed(follower, regular, advance) if smoothing else {}
    return _collected(regular, estimated, sides, B, known(), smoothed)


Known = Callable[[], LogInfo]  # what a log comes to, once it was followed


def _of_arrays(
    scenario: Scenario, follower: Follower, t: Any, y: Any, u: Any
) -> tuple[Regular, Known]:
    """Samples from arrays, one step apart."""
    step, model = scenario.simulation.step, follower.model
    samples = samples_of_arrays(t, y, u, model.p, model.m, step)
    on_steps = placed(samples, t is not None, step, "arrays")
    return _limited(on_steps.samples, "arrays"), lambda: follower.info("arrays", None, on_steps)


def _of_log(
    scenario: Scenario, follower: Follower, log: Any, chosen: Mapping[str, str], strict: bool
) -> tuple[Regular, Known]:
    """Samples from a file or a DataFrame, one step apart."""
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
    return _limited(on_steps.samples, source), lambda: follower.info(
        source, layout, on_steps, faults
    )


def _limited(regular: Regular, source: str) -> Regular:
    """The samples, if there are some and not too many. Raises FileError."""
    if regular.t.size > LARGEST_LOG:
        raise FileError(
            f"{source}: more than {LARGEST_LOG} samples; give it to undeadzone watch, or split it"
        )
    return regular


def _smoothed(
    follower: Follower, regular: Regular, progress: Callable[[int], None] | None
) -> dict[str, Floats]:
    """The smoothed signals by name; none where the method has no smoother."""
    observer = follower.observer
    if observer.smoothing is None or not regular.t.size:
        return {}
    return smooth(follower.model, observer, follower.zone, regular.y, regular.u, progress)


def _collected(
    regular: Regular,
    estimated: Estimate,
    sides: Floats,
    B: Floats,
    info: LogInfo,
    smoothed: dict[str, Floats],
) -> Estimation:
    """The result, without the signals that the observer does not estimate."""
    given = {name: value for name, value in of_estimate(estimated).items() if name in LOG.names}
    own = {"t": regular.t, "y": regular.y, "u": regular.u, "side": sides}
    B_known = {"B": B} if B.size else {}
    return Estimation(info, Signals(LOG, own | B_known | given | smoothed))
