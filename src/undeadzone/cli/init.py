"""undeadzone init [FILE]

The examples that come with the package: scenarios, the files that they name, and others.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import click

import undeadzone
from undeadzone.cli.common import (
    WRITTEN,
    flag_option,
    force_option,
    print_blocks,
    print_json,
    print_line,
    shell_command,
    value_option,
)
from undeadzone.cli.output import Output, add_output_options
from undeadzone.errors import InputError
from undeadzone.util.files import read_text, write_text
from undeadzone.util.text import suggest_name

OTHERS: Final = {
    "samples.csv": "A log for undeadzone watch and estimate, of asymmetric_noise",
    "your_plant.py": "Ten lines of Python for your own plant",
}


@click.command(epilog="Example: undeadzone init mine.toml && undeadzone run mine.toml")
@click.argument("file", type=WRITTEN, default=None, metavar="[FILE]")
@value_option(
    "--example", "NAME", "Write an example, with the files that it names, in place of the template."
)
@flag_option("--full", "Write the template with all its remarks and alternatives, 80 lines.")
@flag_option("--list", "List the examples and write nothing.", "as_list")
@force_option
@add_output_options
def init(
    file: Path | None,
    example: str | None,
    full: bool,
    as_list: bool,
    force: bool,
    output: Output,
) -> None:
    """Write a scenario of 25 lines to FILE (default: scenario.toml), ready to run and to change.

    With --full it lists all other keys as comments. With --example two_link write that example
    (default FILE: two_link.toml). --list shows all examples.
    """
    from undeadzone.util.own_files import require_own_file

    if as_list:
        _print_examples(output.as_json)
        return
    texts = _texts_to_write(file, example, full, output.out or Path())
    for path in texts:
        require_own_file(path, force)
    for path, text in texts.items():  # they are for the user to edit: without a mark
        write_text(text, path)
    if output.as_json:
        print_json({}, list(texts))
    else:
        first = next(iter(texts))
        print_line(f"wrote {', '.join(map(str, texts))}{_advise_after_init(first)}")


def _print_examples(as_json: bool) -> None:
    """Print names and titles of the examples."""
    found = example_titles()
    if as_json:
        print_json({"examples": found})
    else:
        print_blocks([[("example", "shows"), *found.items()]])
        print_line("write one: undeadzone init --example two_link")


def _texts_to_write(
    file: Path | None, example: str | None, full: bool, folder: Path
) -> dict[Path, str]:
    """Return the texts to be written, by path: the scenario first, then the files that it
    names.
    """
    if example is not None and full:
        raise InputError("--full: an example is whole as it is. Leave one of the two options out")
    if example is None:
        from importlib.resources import files

        template = files("undeadzone").joinpath("template.toml").read_text(encoding="utf-8")
        return {
            folder / (file or "scenario.toml"): template if full else _shorten_template(template)
        }

    first, *named = example_files(example)
    target = folder / (file or first.name)
    texts = {target: first.read_text(encoding="utf-8")}
    for path in named:
        texts[target.parent / path.name] = path.read_text(encoding="utf-8")
    return texts


def _shorten_template(template: str) -> str:
    """Return a template without its remarks and alternatives, except those at its top."""
    head, _, _ = template.partition("\n\n")[0].partition("title")
    lines = [line for line in template.split("\n") if not line.startswith("#")]
    text = re.sub(r"\n{3,}", "\n\n", "\n".join(lines))
    return f"{head}# More keys and alternatives: undeadzone init --full, docs/keys.md.\n{text}"


def _advise_after_init(path: Path) -> str:
    """Return the next command after a file was written."""
    starts = {".toml": ("undeadzone", "run"), ".py": ("python",)}
    start = starts.get(path.suffix)
    return f"; next: {shell_command(*start, path)}" if start else ""


def example_titles() -> dict[str, str]:
    """Return the title of each example by its name: of a scenario, or of a further file."""
    scenarios = sorted(_examples_folder().glob("*.toml"))
    return {path.stem: str(_load_tables(path)["title"]) for path in scenarios} | OTHERS


def example_files(name: str) -> list[Path]:
    """Return the file of an example, and then the files that it names.

    Args:
        name: of the example (`.toml` may be left out).

    Raises:
        InputError: there is no such example.
    """
    known = example_titles()
    name = name.removesuffix(".toml")
    if name not in known:
        advice = suggest_name(name, known, "There are")
        raise InputError(f"example: there is no {name!r}. {advice} --list shows their titles")
    if name in OTHERS:
        return [_examples_folder() / name]
    path = _examples_folder() / f"{name}.toml"
    named = [_examples_folder() / word for word in _iterate_texts(_load_tables(path))]
    return [path, *[file for file in named if file.is_file()]]


def _examples_folder() -> Path:
    """Return the folder of the examples: beside the package in a wheel, else in the checkout."""
    package = Path(undeadzone.__file__).parent
    packed = package / "examples"
    return packed if packed.is_dir() else package.parents[1] / "examples"


def _load_tables(path: Path) -> dict[str, Any]:
    """Return the tables of a scenario."""
    from undeadzone.util.toml import require_short_keys

    return tomllib.loads(require_short_keys(read_text(path)))


def _iterate_texts(tables: dict[str, Any]) -> Iterator[str]:
    """Yield all texts in tables, which may be names of files."""
    for value in tables.values():
        if isinstance(value, dict):
            yield from _iterate_texts(value)
        elif isinstance(value, str):
            yield value
