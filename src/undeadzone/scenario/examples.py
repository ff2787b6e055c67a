"""The examples that come with the package: scenarios, the files that they name, and others."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import undeadzone
from undeadzone.errors import InputError
from undeadzone.support.files import read_text

OTHERS: Final = {
    "samples.csv": "A log for undeadzone watch and estimate, of asymmetric_noise",
    "your_plant.py": "Ten lines of Python for your own plant",
}


def titles() -> dict[str, str]:
    """What each example shows, by its name: that of a scenario, or of another file."""
    scenarios = sorted(_folder().glob("*.toml"))
    return {path.stem: str(_tables(path)["title"]) for path in scenarios} | OTHERS


def files_of(name: str) -> list[Path]:
    """The file of an example, and then those that it names.

    Args:
        name: of the example; `.toml` may be left out.

    Raises:
        InputError: there is no such example.
    """
    known = titles()
    name = name.removesuffix(".toml")
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        advice = f"did you mean {near[0]!r}? " if near else ""
        raise InputError(f"example: there is no {name!r}; {advice}--list shows all")
    if name in OTHERS:
        return [_folder() / name]
    path = _folder() / f"{name}.toml"
    named = [_folder() / word for word in _words(_tables(path))]
    return [path, *[file for file in named if file.is_file()]]


def _folder() -> Path:
    """Where the examples are: beside the package's files in a wheel, else in the checkout."""
    package = Path(undeadzone.__file__).parent
    packed = package / "examples"
    return packed if packed.is_dir() else package.parents[1] / "examples"


def _tables(path: Path) -> dict[str, Any]:
    """The tables of a scenario."""
    return tomllib.loads(read_text(path))


def _words(tables: dict[str, Any]) -> Iterator[str]:
    """All texts in tables, which may be names of files."""
    for value in tables.values():
        if isinstance(value, dict):
            yield from _words(value)
        elif isinstance(value, str):
            yield value
