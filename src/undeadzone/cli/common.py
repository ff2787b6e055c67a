"""What the commands share: their common options, the progress bar, printing of numbers."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from undeadzone.support.shown import Block, aligned, columns
from undeadzone.support.shown import text as text_of
from undeadzone.support.text import printable

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

Command = TypeVar("Command", bound=Callable[..., Any])
PATIENCE = 2.0  # [s] before a progress bar appears
SETTING_UP = "setting up"  # what it says before the first step


def common(command: Command) -> Command:
    """Add --out, --json and --no-figures."""
    no_figures = click.option("--no-figures", is_flag=True, help="Compute only; draw nothing.")
    as_json = click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print one JSON object on stdout and nothing else there.",
    )
    out = click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=None,
        metavar="DIR",
        help="Folder for the files written (made if missing).",
    )
    return out(as_json(no_figures(command)))


def confined(command: Command) -> Command:
    """Add --confine."""
    option = click.option(
        "--confine",
        type=click.Path(path_type=Path),
        default=None,
        metavar="DIR",
        help="Refuse files that the scenario names outside of DIR, as a service should.",
    )
    return option(command)


def folder_for(out: Path | None, no_figures: bool, default: str) -> Path | None:
    """The folder for the files written; None: nothing is written.

    Called before the computation, so that a folder in which nothing can be written is noticed then.

    Args:
        out: what --out says.
        no_figures: whether --no-figures is given.
        default: name of the folder without --out.

    Raises:
        FileError: nothing can be written there.
    """
    if out is None and no_figures:
        return None
    return writable(Path(default) if out is None else out)


def writable(folder: Path) -> Path:
    """The folder. Raises FileError where nothing can be written."""
    from undeadzone.support.files import require_folder

    require_folder(folder)
    return folder


def named_files(written: Sequence[Path]) -> dict[str, Any]:
    """The line that names the files written, for `print_pairs`; nothing where there are none."""
    return {"written": ", ".join(map(str, written))} if written else {}


def print_json(value: Any) -> None:
    """One JSON object on stdout."""
    click.echo(json_text(value))


def say(text: str = "", err: bool = False) -> None:
    """One line on stdout, or stderr, whatever characters a scenario put into it."""
    click.echo(printable(text), err=err)


def json_text(value: Any) -> str:
    """A value as JSON; numbers that are not finite become null."""
    from undeadzone.support.arrays import finite

    return json.dumps(finite(value), indent=2, allow_nan=False)


def json_line(value: Any) -> str:
    """A value as JSON in one line; numbers that are not finite become null."""
    from undeadzone.support.arrays import finite

    return json.dumps(finite(value), allow_nan=False)


def print_pairs(pairs: dict[str, Any], err: bool = False) -> None:
    """Aligned `name  value` lines; a list takes a line for each of its entries.

    Args:
        pairs: the values by name.
        err: whether they go to stderr.
    """
    for line in aligned(pairs):
        say(line, err)


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Aligned columns, the first row their heads."""
    for line in columns(rows):
        say(line)


def print_blocks(blocks: Sequence[Block]) -> None:
    """Blocks of a result, an empty line between them."""
    click.echo(text_of(blocks))


@contextmanager
def progress(
    what: str, total: int | None, unit: str | None = None
) -> Iterator[Callable[[int], None]]:
    """A function to call with the steps just done.

    A bar appears on stderr once 2 s have passed, if stderr is a terminal. Until the first step it
    says that something is set up.

    Args:
        what: words in front of the bar.
        total: steps in all; None: unknown.
        unit: what is counted; with it the bar shows how many per second.
    """
    if not sys.stderr.isatty():
        yield lambda done: None
        return
    bar = _Bar(what, total, unit)
    try:
        yield bar.advance
    finally:
        bar.stop()


class _Bar:
    """A progress bar that appears once PATIENCE has passed, even if no step is done by then."""

    def __init__(self, what: str, total: int | None, unit: str | None) -> None:
        self._what, self._total, self._unit = what, total, unit
        self._began = time.monotonic()
        self._seen = 0  # steps done
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._stopped = False
        self._lock = threading.Lock()  # steps are told from several threads, the bar starts in one
        self._timer = threading.Timer(PATIENCE, self._start)
        self._timer.daemon = True
        self._timer.start()

    def advance(self, done: int) -> None:
        """Show that so many steps more are done."""
        with self._lock:
            self._seen += done
            self._show()

    def stop(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        with self._lock:
            if self._bar is not None:
                self._bar.stop()
            self._stopped = True

    def _start(self) -> None:
        """Draw the bar."""
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        with self._lock:
            if self._stopped:
                return
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task(SETTING_UP, total=self._total, rate="")
            self._show()
            self._bar.start()

    def _show(self) -> None:
        """Bring the bar up to date, if there is one; the lock is held."""
        if self._bar is None or self._task is None or not self._seen:
            return
        elapsed = time.monotonic() - self._began
        rate = f"{self._seen / elapsed:,.0f} {self._unit}/s" if self._unit else ""
        self._bar.update(self._task, description=self._what, completed=self._seen, rate=rate)
