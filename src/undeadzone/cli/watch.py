"""undeadzone watch SCENARIO.toml < samples.csv"""

from __future__ import annotations

import json
import math
import select
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import undeadzone as uz
from undeadzone.cli.common import (
    READ,
    READ_AND_WRITTEN,
    SCHEMA,
    add_guards,
    add_schema,
    columns_option,
    flag_option,
    print_blocks,
    print_line,
    require_writable,
    strict_option,
    value_option,
)
from undeadzone.cli.ending import defer_signals
from undeadzone.cli.output import next_line
from undeadzone.errors import FileError, Terminated
from undeadzone.util.files import lock_file
from undeadzone.util.progress import terminal_progress as progress

if TYPE_CHECKING:
    from undeadzone.results.info import LogInfo
    from undeadzone.simulation.follower import Follower, LiveLog
    from undeadzone.util.arrays import Floats

BLOCK = 1 << 16  # bytes that are read at once, if as many have come
TIME = click.FloatRange(min=0, min_open=True, max=threading.TIMEOUT_MAX)  # [s]


def _check_seconds(
    ctx: click.Context, param: click.Parameter, seconds: float | None
) -> float | None:
    """Return a time that can be waited for [s]. Raises BadParameter."""
    if seconds is not None and math.isnan(seconds):
        raise click.BadParameter("nan is not a time [s]", ctx, param)
    return seconds


@click.command(
    epilog="Example: undeadzone watch mine.toml < samples.csv > estimates.csv; on Windows: "
    "type samples.csv | undeadzone watch mine.toml > estimates.csv"
)
@click.argument("scenario", type=READ, metavar="SCENARIO.toml")
@flag_option("--json", "Print one JSON object per sample instead of CSV.", "as_json")
@columns_option
@strict_option
@value_option(
    "--state", "FILE", "Save the observer state there, continue from it.", type=READ_AND_WRITTEN
)
@value_option(
    "--every",
    "SECONDS",
    "Time between saves of the state.",
    type=TIME,
    default=10.0,
    callback=_check_seconds,
)
@value_option(
    "--false-alarm",
    "SECONDS",
    "Time between two false alarms; without it a month.",
    type=TIME,
    callback=_check_seconds,
)
@value_option(
    "--heartbeat",
    "SECONDS",
    "Time between progress lines on stderr.",
    type=TIME,
    callback=_check_seconds,
)
@add_guards
def watch(
    scenario: Path,
    as_json: bool,
    columns: str | None,
    strict: bool,
    state: Path | None,
    every: float,
    false_alarm: float | None,
    heartbeat: float | None,
    confine: Path | None,
) -> bool:
    """Read samples from stdin, write one estimate per sample to stdout, flushed as they come.

    A sample is a CSV line. A header names the columns: t, y, u (or y[0], y[1], ...), with units in
    brackets. Other columns are ignored, and run.csv of `undeadzone run` is such a log. Without a
    header, --columns t=1,y=2,u=3 names them. u acts until the next sample.

    Times must fit simulation.step. Gaps, empty and NaN readings and unreadable lines are missing
    samples: predicted, not corrected, and counted. A line whose time does not fit its neighbours is
    missing as well. If the time jumps for good, the observer starts again. --strict ends at the
    first such line. The observer and [model] (or [plant]) of the scenario are used. It needs no
    [reference], no [controller], no widths.

    Ends with a table on stderr, after Ctrl-C too: widths, missing samples, and whether the readings
    are consistent with the observer's assumptions. With --json it is one JSON object in one line.
    Exit code 1: the readings are not consistent.
    """
    from undeadzone.logs.names import parse_columns
    from undeadzone.scenario.reader import read_for_logs
    from undeadzone.simulation.consistency import FALSE_ALARMS
    from undeadzone.simulation.follower import Follower, LiveLog

    if state is not None:
        require_writable(state.parent)
    watched = read_for_logs(scenario, confine)
    with progress("watching", None, of=watched.observer):
        follower = Follower(watched, True, false_alarm or FALSE_ALARMS)
    log = LiveLog("stdin", watched, follower, parse_columns(columns), strict)
    if sys.stdin is None:
        raise FileError("stdin: it is closed. Give lines of readings and inputs")
    store = SavedWatch(state, every, follower, log)
    try:
        with store.lock, _print_heartbeat(heartbeat, follower, log):
            _estimate_stream(log, follower, store, as_json)
    except (KeyboardInterrupt, Terminated):  # a live log ends this way
        if follower.samples:
            _print_log_summary(log.info(follower), as_json)
        raise
    info = log.info(follower)
    _print_log_summary(info, as_json)
    return info.consistent is not False


class SavedWatch:
    """State of the watch, saved in a file. Read at the start if the file exists.

    A lock beside it refuses a second watch.

    Args:
        path: of the file (None: nothing is saved).
        every: time between two savings [s].
        follower, log: objects whose state is saved.

    Attributes:
        lock: open file, closed by whoever ends the watch.
    """

    def __init__(self, path: Path | None, every: float, follower: Follower, log: LiveLog) -> None:
        self._path = path
        self._every = every
        self._parts = {"follower": follower, "clock": log.clock, "reader": log.reader}
        self._digest = follower.digest
        self._saved = time.monotonic()
        self._failures = 0
        if path is None:
            self.lock: AbstractContextManager[object] = nullcontext()
            return
        from undeadzone.simulation import saved_state

        with lock_file(path.with_name(f".{path.name}.lock"), "a+") as self.lock:
            if path.exists():
                saved_state.load(path, self._parts, self._digest)
                follower.go_on()

    def save_state(self, when_due: bool = False) -> None:
        """Replace the file.

        Args:
            when_due: only if this time has passed. A save that fails (a full disk) is then reported
                on stderr, counted, and tried again after as much time.

        Raises:
            FileError: it cannot be written.
        """
        if self._path is None or (when_due and time.monotonic() - self._saved < self._every):
            return
        from undeadzone.simulation import saved_state

        self._saved = time.monotonic()
        try:
            saved_state.save(self._path, self._parts, self._digest)
        except FileError as error:
            if not when_due:
                raise
            self._failures += 1
            print_line(
                f"undeadzone: {error}: not saved, {self._failures} times by now. "
                f"Tried again in {self._every:g} s",
                err=True,
            )


@contextmanager
def _print_heartbeat(seconds: float | None, follower: Follower, log: LiveLog) -> Iterator[None]:
    """Provide a block in which a thread reports the progress of the watch on stderr at
    intervals.
    """
    ended = threading.Event()

    def beat() -> None:
        """Print the progress at intervals until the block ends."""
        seen = follower.samples
        idle = 0.0
        while not ended.wait(seconds):
            idle = idle + (seconds or 0.0) if follower.samples == seen else 0.0
            seen = follower.samples
            faults = sum(log.clock.faults.by_kind.values())
            print_line(
                f"alive: {seen} samples, {faults} faults, {idle:g} s without a sample", err=True
            )

    beats = threading.Thread(target=beat, daemon=True)
    if seconds is not None:
        beats.start()
    try:
        yield
    finally:
        ended.set()
        if seconds is not None:
            beats.join()


def _estimate_stream(log: LiveLog, follower: Follower, store: SavedWatch, as_json: bool) -> None:
    """Print an estimate for every sample on stdin until it ends."""
    stdin: Any = sys.stdin.buffer
    text = _to_json_lines if as_json else _to_csv_lines
    last = False
    header = not as_json
    lines: list[bytes] = []
    try:
        while not last:
            store.save_state(when_due=True)
            _wait_for_input(stdin)
            try:
                with defer_signals():  # what came in is followed before one ends the watch
                    data = stdin.read1(BLOCK)
                    last = not data
                    for begins, samples in log.pieces(data, last):
                        if begins:
                            follower.restart()
                        before = follower.alarm.count
                        estimate, sides, _ = follower.follow(samples)
                        if follower.alarm.count > before:
                            print_line(f"alarm: readings do not fit, t = {samples.t[-1]}", err=True)
                        if header:
                            lines.append(_csv_header(estimate, sides))
                            header = False
                        lines.append(text(samples.t, estimate, sides))
            finally:
                while lines:
                    click.echo(lines.pop(0), nl=False)
        store.save_state()
    except (KeyboardInterrupt, Terminated):
        store.save_state()
        raise


def _wait_for_input(stdin: Any) -> None:
    """Wait until something can be read, if the system can wait. A signal ends this at once."""
    with suppress(OSError, ValueError):  # without a descriptor, or not a socket on Windows
        select.select([stdin], [], [])


def _print_log_summary(info: LogInfo, as_json: bool) -> None:
    """Print the summary of the log on stderr."""
    from undeadzone.results.estimation import blocks_from_log
    from undeadzone.util.arrays import to_json_value

    if as_json:
        print_line(json.dumps(to_json_value(add_schema(info.summary())), allow_nan=False), err=True)
    else:
        words = "undeadzone estimate, with the scenario and the log in a file, tries what would fit"
        print_blocks(
            blocks_from_log(info), next_line(words) if info.consistent is False else {}, err=True
        )


def _estimate_columns(estimate: uz.Estimate, sides: Floats) -> dict[str, Floats]:
    """Return the parts of estimates, and the measured branches, by the names of their columns."""
    from undeadzone.interfaces import COLUMNS

    return dict(zip(COLUMNS, estimate, strict=True)) | {"side": sides}


def _csv_header(estimate: uz.Estimate, sides: Floats) -> bytes:
    """Return the names of the columns of a CSV file: t, x_hat[0], ..."""
    names = "t"
    for name, part in _estimate_columns(estimate, sides).items():
        names += "".join(f",{name}[{i}]" for i in range(part.shape[1]))
    return f"{names}\n".encode()


def _to_csv_lines(t: Floats, estimate: uz.Estimate, sides: Floats) -> bytes:
    """Return lines of a CSV file, with all digits."""
    import msgspec
    import numpy as np

    table = np.hstack([t[:, None], *_estimate_columns(estimate, sides).values()])
    rows = msgspec.json.encode(table.tolist())[2:-2]  # the quickest exact way to write numbers
    if not np.isfinite(table).all():
        rows = rows.replace(b"null", b"nan")
    return rows.replace(b"],[", b"\n") + b"\n"


def _to_json_lines(t: Floats, estimate: uz.Estimate, sides: Floats) -> bytes:
    """Return lines of JSON. Quantities that the observer does not estimate are left out."""
    import msgspec

    parts = {
        name: part for name, part in _estimate_columns(estimate, sides).items() if part.shape[1]
    }
    lists = [part.tolist() for part in parts.values()]
    names = ("schema", "t", *parts)
    rows = zip(len(t) * [SCHEMA], t.tolist(), *lists, strict=True)
    return msgspec.json.Encoder().encode_lines(dict(zip(names, row, strict=True)) for row in rows)
