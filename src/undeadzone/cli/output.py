"""What a command does with its result: it writes files, and prints one JSON object or words."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import reduce, wraps
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import click

import undeadzone as uz
from undeadzone.cli.common import (
    PATH,
    add_guards,
    cmd,
    flag,
    option,
    print_blocks,
    print_json,
    say,
    writable,
)
from undeadzone.util.shown import Block

LARGE = 1e7  # [bytes] of a table of signals that is written unasked

csv_option = flag(
    "--csv", f"Write the table of signals too where it is larger than {LARGE / 1e6:g} MB.", "as_csv"
)
OUTPUTS = (
    flag("--no-figures", "Compute only; draw nothing."),
    flag("--json", "Print one JSON object on stdout and nothing else there.", "as_json"),
    option("--out", "DIR", "Folder for the files written (made if missing).", type=PATH),
)


class Output(NamedTuple):
    """What a command does with its result.

    Attributes:
        out: folder that --out names; None: the command's own.
        as_json: whether one JSON object is printed.
        figures: whether figures and a page are drawn.
    """

    out: Path | None
    as_json: bool
    figures: bool

    def folder(self, default: str, tables: bool = False) -> Path | None:
        """Return the folder for the files written; None: nothing is written.

        Called before the computation, so that a folder in which nothing can be written is noticed
        then; here libraries are imported as a process of our own may import them.

        Args:
            default: name of the folder without --out.
            tables: whether signals are asked for, figures or not.

        Raises:
            FileError: nothing can be written there.
        """
        _import_scipy()
        if self.out is None and not (self.figures or tables):
            return None
        folder = writable(self.out or Path(default))
        if self.figures:
            prepare_figures()
        return folder

    def show(
        self,
        numbers: Callable[[], Mapping[str, Any]],
        blocks: Callable[[], Sequence[Block]],
        written: Sequence[Path],
        last: Mapping[str, Any] | None = None,
    ) -> None:
        """Print a result as one JSON object, or in words.

        Args:
            numbers: gives the object.
            blocks: gives the words.
            written: the files.
            last: lines at the end of the words; None: those that name the files.
        """
        if self.as_json:
            print_json(numbers(), written)
        else:
            print_blocks(blocks(), line_of_files(written) if last is None else last)


def common(command: Callable[..., int]) -> Callable[..., int]:
    """Add --out, --json and --no-figures, which the command gets as one `Output`."""

    @wraps(command)
    def given(out: Path | None, as_json: bool, no_figures: bool, **options: Any) -> int:
        return command(output=Output(out, as_json, not no_figures), **options)

    return reduce(lambda made, option: option(made), OUTPUTS, given)


def on_scenario(command: Callable[..., int]) -> Callable[..., int]:
    """Add SCENARIO.toml, --untrusted and --confine, and what `common` adds."""
    argument = click.argument("scenario", type=PATH, metavar="SCENARIO.toml")
    return argument(add_guards(common(command)))


def decide_table(as_csv: bool, size: float, name: str) -> tuple[bool, dict[str, str]]:
    """Return whether a table of signals is written, and else the line that says so.

    Args:
        as_csv: whether --csv is given.
        size: of the table [bytes].
        name: of its file.
    """
    if as_csv or size <= LARGE:
        return True, {}
    return False, {"left out": f"{name}, about {size / 1e6:.0f} MB: --csv writes it"}


def partial_file(folder: Path | None, name: str, resume: bool) -> Path | None:
    """Where a search is kept until it is done; None: nowhere.

    Args:
        folder: of what it writes; None: it writes nothing.
        name: of the file that it writes at its end.
        resume: whether --resume is given.

    Raises:
        click.UsageError: there is nothing to resume.
    """
    if folder is not None:
        whole, partial = folder / name, folder / f"{name}.partial"
        if resume and whole.exists() and not partial.exists():
            raise click.UsageError(f"{whole}: is finished; leave --resume out to replace it")
        if resume:
            tell_anew(partial)
        return partial
    if resume:
        raise click.UsageError("--resume needs the folder that was written to; name it with --out")
    return None


def tell_anew(partial: Path) -> None:
    """Say on stderr that --resume finds nothing in a folder that a stopped command has kept.

    Args:
        partial: the file that it would have kept.
    """
    if not partial.exists():
        say(f"--resume: there is no {partial}; begins anew", err=True)


def _import_scipy() -> None:
    """Import SciPy without the parts of NumPy that only its tests use.

    SciPy's array layer takes over every name of NumPy, which imports f2py, testing, random and
    others for that: more than half of the time of its import.
    """
    import numpy as np

    space: Any = vars(np)
    public, listed = space["__all__"], space["__dir__"]
    space |= {"__all__": [name for name in public if name in space], "__dir__": lambda: [*space]}
    try:
        import_module("scipy.linalg")
    finally:
        space |= {"__all__": public, "__dir__": listed}


def prepare_figures() -> None:
    """Let figures look the same in every folder; called before the first is drawn."""
    from undeadzone.report.style import own_settings

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a cache of fonts that is not kept
    own_settings()


def to_type(*words: str) -> dict[str, str]:
    """Return the line that says what to type next, for `print_blocks`; each command with its
    purpose.
    """
    return {"next": "; ".join(words)} if words else {}


def export_of(path: Path, scenario: uz.Scenario) -> list[str]:
    """Return the command that exports a scenario, and what it asks for first; none of a told
    observer.
    """
    if scenario.observer.__struct_config__.tag == "full_state":
        return []
    first = ' takes it with simulation.time = "sampled"' * (scenario.simulation.time != "sampled")
    return [cmd("undeadzone", "export", path) + first]


def line_of_files(written: Sequence[Path]) -> dict[str, Any]:
    """Return the line that names the files written, for `print_blocks`; nothing where there are
    none.
    """
    return {"written": ", ".join(map(str, written))} if written else {}
