"""undeadzone watch SCENARIO.toml < samples.csv"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    SCHEMA,
    columns_option,
    confined,
    exit_code,
    print_blocks,
    strict_option,
)
from undeadzone.cli.untrusted import untrusted
from undeadzone.errors import FileError, Terminated

if TYPE_CHECKING:
    from undeadzone.interfaces import Estimate
    from undeadzone.simulation.follower import Follower, TextLog
    from undeadzone.support.arrays import Floats

BLOCK = 1 << 20  # bytes that are read at once, if as many have come


@click.command(
    epilog="Example: undeadzone watch mine.toml < samples.csv > estimates.csv; on Windows: "
    "type samples.csv | undeadzone watch mine.toml > estimates.csv"
)
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object per sample instead of CSV."
)
@columns_option
@strict_option
@untrusted
@confined
def watch(
    scenario: Path, as_json: bool, columns: str | None, strict: bool, confine: Path | None
) -> int:
    """Read samples from stdin, write one estimate per sample to stdout, flushed as they come.

    A sample is a CSV line. A header says which column is which: t, y, u (or y[0], y[1], ...), with
    units in brackets; other columns are ignored, and run.csv of `undeadzone run` is such a log.
    Without a header name the columns: --columns t=1,y=2,u=3. u acts until the next sample.
    Times must fit simulation.step; gaps in them, empty and NaN readings and lines that cannot be
    read are missing samples: predicted, not corrected, and counted. The observer and [model] (or
    [plant]) of the scenario are used; it needs no [reference], no [controller], no widths.

    Ends with a table on stderr, after Ctrl-C too: widths, what was missing, and whether the
    readings are what the observer claims. Exit code 1: they are not.
    """
    from undeadzone.logs.names import parse_columns
    from undeadzone.results.estimation import in_words
    from undeadzone.scenario.reader import read_for_logs
    from undeadzone.simulation.follower import Follower, TextLog

    watched = read_for_logs(scenario, confine)
    follower = Follower(watched, live=True)
    log = TextLog("stdin", watched, follower, parse_columns(columns), strict)
    if sys.stdin is None:
        raise FileError("stdin: it is closed; give lines of readings and inputs")
    try:
        _follow(log, follower, as_json)
    except (KeyboardInterrupt, Terminated):  # a live log ends this way
        if follower.samples:
            print_blocks(in_words(log.info(follower)), err=True)
        raise
    info = log.info(follower)
    print_blocks(in_words(info), err=True)
    return exit_code(info)


def _follow(log: TextLog, follower: Follower, as_json: bool) -> None:
    """Answer every sample on stdin until it ends."""
    stdin: Any = sys.stdin.buffer
    last = False
    header = not as_json
    while not last:
        data = stdin.read1(BLOCK)
        last = not data
        samples = log.feed(data, last)
        if not samples.t.size:
            continue
        estimate, sides, _ = follower.follow(samples)
        if header:
            _write(_header(estimate, sides))
            header = False
        _write(_json(samples.t, estimate, sides) if as_json else _csv(samples.t, estimate, sides))


def _write(text: bytes) -> None:
    """Write bytes to stdout, at once."""
    click.echo(text, nl=False)


def _parts(estimate: Estimate, sides: Floats) -> dict[str, Floats]:
    """The parts of estimates, and the measured sides, by the names of their columns."""
    from undeadzone.interfaces import COLUMNS

    return dict(zip(COLUMNS, estimate, strict=True)) | {"side": sides}


def _header(estimate: Estimate, sides: Floats) -> bytes:
    """The names of the columns of a CSV file: t, x_hat[0], ..."""
    names = ["t"]
    for name, part in _parts(estimate, sides).items():
        names += [f"{name}[{i}]" for i in range(part.shape[1])]
    return ",".join(names).encode() + b"\n"


def _csv(t: Floats, estimate: Estimate, sides: Floats) -> bytes:
    """Lines of a CSV file, with all digits."""
    import msgspec
    import numpy as np

    table = np.hstack([t[:, None], *_parts(estimate, sides).values()])
    rows = msgspec.json.encode(table.tolist())[2:-2]  # the quickest exact way to write numbers
    if not np.isfinite(table).all():
        rows = rows.replace(b"null", b"nan")
    return rows.replace(b"],[", b"\n") + b"\n"


def _json(t: Floats, estimate: Estimate, sides: Floats) -> bytes:
    """Lines of JSON; what the observer does not estimate is left out."""
    import msgspec

    parts = {name: part for name, part in _parts(estimate, sides).items() if part.shape[1]}
    lists = [part.tolist() for part in parts.values()]
    names = ("schema", "t", *parts)
    rows = zip(len(t) * [SCHEMA], t.tolist(), *lists, strict=True)
    return msgspec.json.Encoder().encode_lines(dict(zip(names, row, strict=True)) for row in rows)
