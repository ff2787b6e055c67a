"""What the commands share: their common options, the progress bar, printing of numbers."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])
PATIENCE = 2.0  # [s] before a progress bar appears


def common(command: Command) -> Command:
    """Add --out, --json and --no-figures."""
    for option in (
        click.option("--no-figures", is_flag=True, help="Compute only; draw nothing."),
        click.option(
            "--json",
            "as_json",
            is_flag=True,
            help="Print one JSON object on stdout and nothing else there.",
        ),
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            default=None,
            metavar="DIR",
            help="Folder for the files written (made if missing).",
        ),
    ):
        command = option(command)
    return command


def print_json(value: Any) -> None:
    """One JSON object on stdout."""
    click.echo(json_text(value))


def json_text(value: Any) -> str:
    """A value as JSON; numbers that are not finite become null."""
    from undeadzone.support.arrays import finite

    return json.dumps(finite(value), indent=2, allow_nan=False)


def print_pairs(pairs: dict[str, Any]) -> None:
    """Aligned `name  value` lines; a list takes a line for each of its entries."""
    width = max(map(len, pairs))
    for name, value in pairs.items():
        for k, entry in enumerate(value if isinstance(value, list) else [value]):
            click.echo(
                f"{'' if k else name:<{width}}  {f'{entry:.6g}' if isinstance(entry, float) else entry}"
            )


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Aligned columns, the first row their heads."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo(
            "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        )


def yes_no(verdict: Mapping[str, bool]) -> str:
    """What can be known of one output: right yes, left NO, ..."""
    return ", ".join(
        f"{name} {'yes' if verdict[name] else 'NO'}"
        for name in ("right", "left", "width", "centre")
    )


@contextmanager
def progress(
    what: str, total: int | None, unit: str | None = None
) -> Iterator[Callable[[int], None]]:
    """A function to call with the steps just done; a bar on stderr once 2 s have passed, if stderr is a terminal.

    unit: what is counted; with it the bar shows how many per second.
    """
    if not sys.stderr.isatty():
        yield lambda done: None
        return
    began, bar, task, waiting, seen = time.monotonic(), None, None, 0, 0

    def advance(done: int) -> None:
        nonlocal bar, task, waiting, seen
        waiting += done
        seen += done
        if bar is None and time.monotonic() - began > PATIENCE:
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
            bar = Progress(*columns, console=Console(stderr=True), transient=True)
            bar.start()
            task = bar.add_task(what, total=total, rate="")
        if bar is not None and task is not None:
            rate = f"{seen / (time.monotonic() - began):,.0f} {unit}/s" if unit else ""
            bar.update(task, advance=waiting, rate=rate)
            waiting = 0

    try:
        yield advance
    finally:
        if bar is not None:
            bar.stop()
