"""Output of a command's result: files, and a JSON object or text."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import reduce, wraps
from pathlib import Path
from typing import Any, NamedTuple

import click

import undeadzone as uz
from undeadzone.cli.common import (
    READ,
    WRITTEN_FOLDER,
    add_guards,
    flag_option,
    print_blocks,
    print_json,
    print_line,
    require_writable,
    shell_command,
    value_option,
)
from undeadzone.errors import InputError
from undeadzone.util.installed import import_scipy
from undeadzone.util.own_files import require_own_file
from undeadzone.util.shown import Block

LARGE = 1e7  # [bytes] of a table of signals that is written unasked

csv_option = flag_option(
    "--csv", f"Write the table of signals even if it is larger than {LARGE / 1e6:g} MB.", "as_csv"
)
json_option = flag_option(
    "--json", "Print one JSON object on stdout and nothing else there.", "as_json"
)
OUTPUTS = (
    flag_option("--no-figures", "Compute without drawing."),
    json_option,
    value_option(
        "--out", "DIR", "Folder for the files written (made if missing).", type=WRITTEN_FOLDER
    ),
)


class Output(NamedTuple):
    """Output of a command's result.

    Attributes:
        out: folder that --out names (None: the command's own).
        as_json: whether one JSON object is printed.
        figures: whether figures and a page are drawn.
    """

    out: Path | None
    as_json: bool
    figures: bool

    def choose_folder(self, default: str, tables: bool = False) -> Path | None:
        """Return the folder for the files written, or None if the command writes no files.

        Called before the computation, so that a folder in which nothing can be written is noticed
        then. Libraries are imported here, before the process is restricted.

        Args:
            default: name of the folder without --out.
            tables: whether signals are wanted, figures or not.

        Raises:
            FileError: nothing can be written there.
        """
        import_scipy()
        if self.out is None and not (self.figures or tables):
            return None
        folder = require_writable(self.out or Path(default))
        if self.figures:
            prepare_figures()
        return folder

    def print_result(
        self,
        numbers: Callable[[], Mapping[str, Any]],
        blocks: Callable[[], Sequence[Block]],
        written: Sequence[Path],
        last: Mapping[str, Any] | None = None,
    ) -> None:
        """Print a result as a JSON object, or as text.

        Args:
            numbers: gives the object.
            blocks: gives the words.
            written: the files.
            last: lines at the end of the words (None: those that name the files).
        """
        if self.as_json:
            print_json(numbers(), written)
        else:
            print_blocks(blocks(), files_line(written) if last is None else last)


def add_output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --out, --json and --no-figures, passed to the command as an `Output`."""

    @wraps(command)
    def run_with_output(out: Path | None, as_json: bool, no_figures: bool, **options: Any) -> Any:
        """Run the command with its `Output`."""
        return command(output=Output(out, as_json, not no_figures), **options)

    return reduce(lambda decorated, option: option(decorated), OUTPUTS, run_with_output)


def add_scenario_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add SCENARIO.toml, --untrusted, --confine, and the options of `add_output_options`."""
    argument = click.argument("scenario", type=READ, metavar="SCENARIO.toml")
    return argument(add_guards(add_output_options(command)))


def decide_table(as_csv: bool, size: float, name: str) -> tuple[bool, dict[str, str]]:
    """Return whether a table of signals is written, and if not, the line that reports it.

    Args:
        as_csv: whether --csv is given.
        size: of the table [bytes].
        name: of its file.
    """
    if as_csv or size <= LARGE:
        return True, {}
    return False, {"left out": f"{name}, about {size / 1e6:.0f} MB: --csv writes it"}


def require_own_table(folder: Path | None, name: str, force: bool) -> None:
    """Raise FileError for a table of signals that is not as undeadzone wrote it.

    Args:
        folder: of the table (None: none is written).
        name: of the table.
        force: whether it may be replaced all the same.
    """
    from undeadzone.results.files import is_own_table

    if folder is not None:
        require_own_file(folder / name, force, is_own_table)


def discard_partial(keep: Path | None) -> None:
    """Delete the file that contained a search, if there is one."""
    if keep is not None:
        keep.unlink(missing_ok=True)


def partial_file(folder: Path | None, name: str, resume: bool) -> Path | None:
    """Return the file that contains a search until it is done, or None without a folder.

    Args:
        folder: of the written files (None: it writes nothing).
        name: of the file that it writes at its end.
        resume: whether --resume is given.

    Raises:
        click.UsageError: there is nothing to resume.
    """
    if folder is not None:
        whole = folder / name
        partial = folder / f"{name}.partial"
        if resume and whole.exists() and not partial.exists():
            raise click.UsageError(f"{whole}: is finished. Leave --resume out to replace it")
        if resume:
            report_fresh_start(partial)
        return partial
    if resume:
        raise click.UsageError("--resume needs the folder that was written to. Name it with --out")
    return None


def report_fresh_start(partial: Path) -> None:
    """Report on stderr that --resume has no saved results in a folder.

    Args:
        partial: the file that it would have kept.
    """
    if not partial.exists():
        print_line(f"--resume: there is no {partial}. Begins anew", err=True)


def prepare_figures() -> None:
    """Set the style of figures, equal in every folder. Call it before the first figure."""
    from undeadzone.report.style import import_default_matplotlib

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a cache of fonts that is not kept
    import_default_matplotlib()


def next_line(*words: str) -> dict[str, str]:
    """Return the line with the next commands and their purposes, for `print_blocks`."""
    return {"next": "; ".join(words)} if words else {}


def export_command(path: Path, scenario: uz.Scenario) -> list[str]:
    """Return the command that exports a scenario, with the least changes that it needs.

    Empty if no such change is known, and for `full_state`.
    """
    if scenario.observer.__struct_config__.tag == "full_state":
        return []
    command = shell_command("undeadzone", "export", path)
    if scenario.simulation.time == "sampled":
        return [command]
    changes = _changes_for_export(scenario)
    return [f"{command} takes it with {changes}"] if changes else []


def _changes_for_export(scenario: uz.Scenario) -> str:
    """Return the least changes with which a continuous scenario can be sampled, or "".

    Some methods exist in continuous time alone: `certified` and `state_feedback` take their place.
    """
    import msgspec

    from undeadzone.registry import CONTROLLERS, OBSERVERS
    from undeadzone.scenario.problem import resolve_scenario

    sampled = msgspec.structs.replace(scenario.simulation, time="sampled")
    observer = OBSERVERS.decode_options({"method": "certified"})
    controller = CONTROLLERS.decode_options({"method": "state_feedback"})
    others: list[dict[str, Any]] = [
        {},
        {"observer": observer},
        {"controller": controller},
        {"observer": observer, "controller": controller},
    ]
    for other in others:
        try:
            resolve_scenario(msgspec.structs.replace(scenario, simulation=sampled, **other))
        except InputError:
            continue
        named = [
            f'{part}.method = "{options.__struct_config__.tag}"' for part, options in other.items()
        ]
        return ", ".join([*named, 'simulation.time = "sampled"'])
    return ""


def files_line(written: Sequence[Path]) -> dict[str, Any]:
    """Return the line that names the written files, for `print_blocks`, empty without files."""
    return {"written": ", ".join(map(str, written))} if written else {}
