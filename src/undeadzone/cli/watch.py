"""undeadzone watch SCENARIO.toml < samples.csv"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import click

from undeadzone.cli.common import confined, json_line
from undeadzone.errors import FileError

if TYPE_CHECKING:
    from undeadzone.interfaces import Estimate
    from undeadzone.simulation.online import Online


LONGEST = 100_000  # characters of a line
LARGEST = 100_000_000  # characters of a line that is skipped
DAMAGED = ("error", "missing")


@click.command(epilog="Example: undeadzone watch mine.toml < samples.csv > estimates.csv")
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object per sample instead of CSV."
)
@click.option(
    "--damaged",
    type=click.Choice(DAMAGED),
    default=DAMAGED[0],
    show_default=True,
    help="What a line that is no sample is: the end, or a sample that is missing.",
)
@confined
def watch(scenario: Path, as_json: bool, damaged: str, confine: Path | None) -> int:
    """Read samples from stdin, write one estimate per sample to stdout, each line flushed at once.

    A sample is a CSV line: the readings, then the inputs that act until the next sample; a time in
    front is allowed and passed through, and so is a header line. Samples are simulation.step apart.
    An empty or NaN reading counts as missing: the estimate is predicted, not corrected. The
    observer and [model] (or [plant]) of the scenario are used.
    """
    from undeadzone.scenario.problem import modelled_plant
    from undeadzone.scenario.reader import read
    from undeadzone.simulation.online import Online

    watched = read(scenario, confine)
    step = watched.simulation.step
    online = Online(
        watched.observer,
        modelled_plant(watched),
        watched.sensor,
        step,
        watched.simulation.substeps,
    )
    p, m = online.model.p, online.model.m
    count, lost = 0, 0
    time = -step
    for number, line in enumerate(_lines(), 1):
        if not line.strip() or (count == 0 and _is_header(line)):
            continue
        try:
            sample = _sample(line, p, m)
        except ValueError as error:
            if damaged == "error":
                raise FileError(f"stdin, line {number}: {error}") from None
            sample = Sample(None, [math.nan] * p, [math.nan] * m)
            lost += 1
        time = time + step if sample.time is None else sample.time
        columns = _columns(online, online.update(sample.readings, sample.inputs))
        if count == 0 and not as_json:
            click.echo(",".join(_header(columns)))
        click.echo(_json(time, columns) if as_json else _csv(time, columns))
        sys.stdout.flush()
        count += 1
    if count == 0:
        raise FileError("stdin: no samples; give lines of readings and inputs")
    words = f", of which {lost} damaged lines" if lost else ""
    click.echo(f"{online.samples} samples, {online.missing} missing{words}", err=True)
    return 0


class Sample(NamedTuple):
    """A line of the stream.

    Attributes:
        time: [s]; None: a step after the one before.
        readings, inputs: NaN where one is missing.
    """

    time: float | None
    readings: list[float]
    inputs: list[float]


def _lines() -> Iterator[str]:
    """The lines of stdin; of one too long its beginning, which is no sample. Raises FileError."""
    if sys.stdin is None:
        raise FileError("stdin: it is closed; give lines of readings and inputs")
    stream = sys.stdin.buffer
    while line := stream.readline(LONGEST + 1):
        yield line.decode("utf-8", "replace")
        if len(line) > LONGEST and not line.endswith(b"\n"):
            _skip_line(stream)


def _skip_line(stream: BinaryIO) -> None:
    """Skip the rest of a line. Raises FileError for one without end."""
    for _ in range(LARGEST // LONGEST):
        rest = stream.readline(LONGEST)
        if not rest or rest.endswith(b"\n"):
            return
    raise FileError(f"stdin: not CSV text (a line of more than {LARGEST:,} characters)")


def _sample(line: str, p: int, m: int) -> Sample:
    """The sample in a line of p readings, m inputs. Raises ValueError that says what is wrong."""
    if len(line) > LONGEST:
        raise ValueError(f"not CSV text (more than {LONGEST:,} characters)")
    cells = _cells(line)
    if len(cells) not in (p + m, p + m + 1):
        raise ValueError(
            f"expected {p + m} values ({p} readings, {m} inputs) or a time and these, "
            f"found {len(cells)}"
        )
    values = [_value(cell) for cell in cells]
    time = values[0] if len(cells) > p + m else None
    return Sample(time, values[-(p + m) : -m], values[-m:])


def _cells(line: str) -> list[str]:
    """The cells of a line. Raises ValueError."""
    try:
        return next(csv.reader([line]), [])
    except csv.Error as error:
        raise ValueError(f"not CSV text ({error})") from None


def _value(cell: str) -> float:
    """The number in a cell; NaN in an empty one. Raises ValueError that quotes anything else."""
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"expected a number or nothing, found {cell!r:.40}") from None


def _is_header(line: str) -> bool:
    """Whether a line holds words alone."""
    try:
        return not any(map(_is_number, _cells(line)))
    except ValueError:
        return False


def _is_number(cell: str) -> bool:
    """Whether a cell holds a number or nothing, and is no word of a header."""
    try:
        _value(cell)
    except ValueError:
        return False
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
    return json_line({"t": time} | parts)
