"""undeadzone init [FILE]"""

from __future__ import annotations

from pathlib import Path

import click

from undeadzone.cli.common import common, print_blocks, print_json, say
from undeadzone.errors import FileError


@click.command(epilog="Example: undeadzone init mine.toml && undeadzone run mine.toml")
@click.argument("file", type=click.Path(path_type=Path), default=None, metavar="[FILE]")
@click.option(
    "--example",
    default=None,
    metavar="NAME",
    help="Write an example, with the files that it names, in place of the template.",
)
@click.option("--list", "as_list", is_flag=True, help="List the examples and write nothing.")
@click.option("--force", is_flag=True, help="Replace files that exist.")
@common
def init(
    file: Path | None,
    example: str | None,
    as_list: bool,
    force: bool,
    out: Path | None,
    as_json: bool,
    no_figures: bool,
) -> int:
    """Write a commented scenario to FILE (default: scenario.toml), ready to run and to change.

    With --example two_link write that example (default FILE: two_link.toml); --list shows all.
    """
    if as_list:
        return _listed(as_json)
    texts = _texts(file, example, out or Path())
    for path in texts:
        if path.exists() and not force:
            raise FileError(f"{path}: exists already; choose another name or add --force")
    from undeadzone.support.files import write_text

    for path, text in texts.items():
        write_text(text, path)
    if as_json:
        print_json({}, list(texts))
    else:
        first = next(iter(texts))
        say(f"wrote {', '.join(map(str, texts))}{_next(first)}")
    return 0


def _listed(as_json: bool) -> int:
    """Print names and titles of the examples."""
    from undeadzone.scenario.examples import titles

    found = titles()
    if as_json:
        print_json({"examples": found})
    else:
        print_blocks([[("example", "shows"), *found.items()]])
        say("write one: undeadzone init --example two_link")
    return 0


def _texts(file: Path | None, example: str | None, folder: Path) -> dict[Path, str]:
    """What is to be written, by path: the scenario first, then the files that it names."""
    if example is None:
        from importlib.resources import files

        template = files("undeadzone").joinpath("template.toml").read_text(encoding="utf-8")
        return {folder / (file or "scenario.toml"): template}
    from undeadzone.scenario.examples import files_of

    first, *named = files_of(example)
    target = folder / (file or first.name)
    texts = {target: first.read_text(encoding="utf-8")}
    for path in named:
        texts[target.parent / path.name] = path.read_text(encoding="utf-8")
    return texts


def _next(path: Path) -> str:
    """What to type after a file was written."""
    starts = {".toml": "undeadzone run", ".py": "python"}
    start = starts.get(path.suffix)
    return f"; next: {start} {path}" if start else ""
