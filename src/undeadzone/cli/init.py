"""undeadzone init [FILE]"""

from __future__ import annotations

from pathlib import Path

import click

from undeadzone.cli.common import common, print_json, say
from undeadzone.errors import FileError


@click.command(epilog="Example: undeadzone init mine.toml && undeadzone run mine.toml")
@click.argument(
    "file", type=click.Path(path_type=Path), default=Path("scenario.toml"), metavar="[FILE]"
)
@click.option("--force", is_flag=True, help="Replace the file if it exists.")
@common
def init(file: Path, force: bool, out: Path | None, as_json: bool, no_figures: bool) -> int:
    """Write a commented scenario to FILE (default: scenario.toml), ready to run and to change."""
    from importlib.resources import files

    from undeadzone.support.files import write_text

    path = file if out is None else out / file
    if path.exists() and not force:
        raise FileError(f"{path}: exists already; choose another name or add --force")
    write_text(files("undeadzone").joinpath("template.toml").read_text(encoding="utf-8"), path)
    if as_json:
        print_json({}, [path])
    else:
        say(f"wrote {path}; next: undeadzone run {path}")
    return 0
