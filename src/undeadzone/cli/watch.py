"""undeadzone watch SCENARIO.toml < samples.csv"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.errors import FileError

if TYPE_CHECKING:
    from undeadzone.interfaces import Estimate
    from undeadzone.simulation.online import Online


@click.command(epilog="Example: undeadzone watch mine.toml < samples.csv > estimates.csv")
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object per sample instead of CSV."
)
def watch(scenario: Path, as_json: bool) -> int:
    """Read samples from stdin, write one estimate per sample to stdout, each line flushed at once.

    A sample is a CSV line: the readings, then the inputs that act until the next sample; a time in
    front is allowed and passed through, and so is a header line. Samples are simulation.step apart.
    An empty or NaN reading counts as missing: the estimate is predicted, not corrected. The
    observer and [model] (or [plant]) of the scenario are used.
    """
    from undeadzone.scenario.problem import modelled_plant
    from undeadzone.scenario.reader import read
    from undeadzone.simulation.online import Online

    watched = read(scenario)
    step = watched.simulation.step
    online = Online(
        watched.observer,
        modelled_plant(watched),
        watched.sensor,
        step,
        watched.simulation.substeps,
    )
    p, m = online.model.p, online.model.m
    count = 0
    for number, row in enumerate(_rows(), 1):
        if not row or (count == 0 and not any(_is_number(cell) for cell in row)):
            continue
        if len(row) not in (p + m, p + m + 1):
            raise FileError(
                f"stdin, line {number}: expected {p + m} values ({p} readings, {m} inputs) or a "
                f"time and these, found {len(row)}"
            )
        values = [_value(cell, number) for cell in row]
        columns = _columns(online, online.update(values[-(p + m) : -m], values[-m:]))
        if count == 0 and not as_json:
            click.echo(",".join(_header(columns)))
        time = values[0] if len(row) > p + m else count * step
        click.echo(_json(time, columns) if as_json else _csv(time, columns))
        sys.stdout.flush()
        count += 1
    if count == 0:
        raise FileError("stdin: no samples; give lines of readings and inputs")
    click.echo(f"{online.samples} samples, {online.missing} missing", err=True)
    return 0


def _rows() -> Iterator[list[str]]:
    """The lines of stdin, in cells. Raises FileError."""
    try:
        yield from csv.reader(sys.stdin)
    except (csv.Error, UnicodeDecodeError) as error:
        raise FileError(f"stdin: not CSV text ({error})") from None


def _value(cell: str, number: int) -> float:
    """The number in a cell; NaN in an empty one. Raises FileError that names the line."""
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise FileError(
            f"stdin, line {number}: expected a number or nothing, found {cell!r:.40}"
        ) from None


def _is_number(cell: str) -> bool:
    """Whether a cell holds a number or nothing, and is no word of a header."""
    try:
        float(cell)
    except ValueError:
        return not cell.strip()
    return True


def _columns(online: Online, estimate: Estimate) -> dict[str, Any]:
    """The parts of an estimate, and the measured side, by the names of their columns."""
    from undeadzone.interfaces import COLUMNS

    return dict(zip(COLUMNS, estimate, strict=True)) | {"side": online.side}


def _header(columns: dict[str, Any]) -> list[str]:
    """The names of the columns of a CSV file: t, x_hat[0], ..."""
    names = ["t"]
    for name, part in columns.items():
        names += [f"{name}[{i}]" for i in range(part.size)]
    return names


def _csv(time: float, columns: dict[str, Any]) -> str:
    """A line of a CSV file, with all digits."""
    values = [time]
    for part in columns.values():
        values += part.tolist()
    return ",".join(repr(float(value)) for value in values)


def _json(time: float, columns: dict[str, Any]) -> str:
    """A line of JSON; what the observer does not estimate is left out."""
    parts = {name: part.tolist() for name, part in columns.items() if part.size}
    return json.dumps({"t": time} | parts)
