"""undeadzone watch SCENARIO.toml < samples.csv"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from undeadzone.errors import FileError

if TYPE_CHECKING:
    from undeadzone.simulation.online import OnlineEstimate

NAMES = (
    "x_hat", "z_hat", "d_right", "d_left", "z_inverse", "innovation",
    "x_std", "d_right_std", "d_left_std", "width_std", "innovation_std", "w_hat", "theta_hat", "theta_std", "side",
)  # fmt: skip


@click.command(epilog="Example: undeadzone watch mine.toml < samples.csv > estimates.csv")
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object per sample instead of CSV."
)
def watch(scenario: Path, as_json: bool) -> int:
    """Read samples from stdin, write one estimate per sample to stdout, each line flushed at once.

    A sample is a CSV line: the readings, then the inputs that act until the next sample; a time in front is allowed
    and passed through, and so is a header line. Samples are simulation.step apart. An empty or NaN reading counts as
    missing: the estimate is predicted, not corrected. The observer and [model] (or [plant]) of the scenario are used.
    """
    from undeadzone.scenario.problem import believed_plant
    from undeadzone.scenario.reader import read
    from undeadzone.simulation.online import Online

    problem = read(scenario)
    online = Online(
        problem.observer,
        believed_plant(problem),
        problem.sensor,
        problem.simulation.step,
        problem.simulation.substeps,
    )
    p, m = online.model.p, online.model.m
    count = 0
    for number, row in enumerate(_rows(), 1):
        if not row or (count == 0 and not any(_is_number(cell) for cell in row)):
            continue
        if len(row) not in (p + m, p + m + 1):
            raise FileError(
                f"stdin, line {number}: expected {p + m} values ({p} readings, {m} inputs) or a time and these, found {len(row)}"
            )
        values = [_value(cell, number) for cell in row]
        live = online.update(values[-(p + m) : -m], values[-m:])
        if count == 0 and not as_json:
            click.echo(",".join(_header(live)))
        time = values[0] if len(row) > p + m else count * problem.simulation.step
        click.echo(
            _json(time, live) if as_json else ",".join(repr(float(v)) for v in (time, *_flat(live)))
        )
        sys.stdout.flush()
        count += 1
    if count == 0:
        raise FileError("stdin: no samples; give lines of readings and inputs")
    click.echo(f"{online.samples} samples, {online.missing} missing", err=True)
    return 0


def _rows() -> Iterator[list[str]]:
    try:
        yield from csv.reader(sys.stdin)
    except (csv.Error, UnicodeDecodeError) as error:
        raise FileError(f"stdin: not CSV text ({error})") from None


def _value(cell: str, number: int) -> float:
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise FileError(
            f"stdin, line {number}: expected a number or nothing, found {cell!r:.40}"
        ) from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not cell.strip()
    return True


def _header(live: OnlineEstimate) -> list[str]:
    return [
        "t",
        *(f"{name}[{i}]" for name, part in zip(NAMES, live, strict=True) for i in range(part.size)),
    ]


def _flat(live: OnlineEstimate) -> list[float]:
    return [float(value) for part in live for value in part]


def _json(time: float, live: OnlineEstimate) -> str:
    return json.dumps(
        {"t": time}
        | {name: part.tolist() for name, part in zip(NAMES, live, strict=True) if part.size}
    )
