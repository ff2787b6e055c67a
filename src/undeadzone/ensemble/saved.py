"""An ensemble in a file: its columns, and in the header what it knows besides."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec

from undeadzone.ensemble.bands import Bands
from undeadzone.ensemble.blocks import table_file
from undeadzone.ensemble.info import Info
from undeadzone.errors import FileError
from undeadzone.support.arrays import Floats


class Contents(NamedTuple):
    """What a file holds: the fields of `result.Ensemble`.

    Attributes:
        varied: the values of the varied entries
        metrics: what came of each run
        info: what is known besides the columns
        bands: of the recorded runs, if there are any
    """

    varied: dict[str, Floats]
    metrics: dict[str, Floats]
    info: Info
    bands: Bands | None


class _Header(msgspec.Struct, frozen=True):
    """What a file says of its columns.

    Attributes:
        info: of the ensemble
        varied: the columns that are varied entries
    """

    info: Info
    varied: list[str]


def write(contents: Contents, path: Path) -> Path:
    """Write a file, a row for each run. Raises FileError, InputError."""
    header = _Header(contents.info, list(contents.varied))
    columns = {**contents.varied, **contents.metrics}
    attached = {}
    if contents.bands is not None:
        attached = {"t": contents.bands.t, **contents.bands.quantiles}
    text = msgspec.json.encode(header).decode()
    return table_file.save(table_file.Table(text, columns, attached), path)


def read(path: Path) -> Contents:
    """Read a file. Raises FileError, InputError."""
    table = table_file.load(path)
    try:
        header = msgspec.json.decode(table.header, type=_Header)
        varied = {name: table.columns[name] for name in header.varied}
    except (KeyError, msgspec.DecodeError) as error:
        raise FileError(f"{path}: not an ensemble saved by undeadzone ({error})") from None
    metrics = {name: column for name, column in table.columns.items() if name not in varied}
    return Contents(varied, metrics, header.info, _attached_bands(table.attached))


def _attached_bands(attached: Mapping[str, Floats]) -> Bands | None:
    """The bands among the other arrays of a file, if it has some."""
    if "t" not in attached:
        return None
    t = attached["t"]
    quantiles = {}
    for name, values in attached.items():
        if name != "t":
            quantiles[name] = values.reshape(t.size, -1)
    return Bands(t, quantiles)
