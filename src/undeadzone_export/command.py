"""Command `undeadzone export SCENARIO.toml`."""

from __future__ import annotations

import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    READ,
    WRITTEN,
    add_guards,
    flag_option,
    force_option,
    print_blocks,
    print_json,
    print_line,
    shell_command,
    value_option,
)
from undeadzone.util.files import open_scratch
from undeadzone.util.progress import terminal_progress as progress
from undeadzone.util.text import count_noun

if TYPE_CHECKING:
    from undeadzone.util.shown import Block


@click.command(epilog="Example: undeadzone export mine.toml --to c --out firmware --check")
@click.argument("scenario", type=READ, metavar="SCENARIO.toml")
@value_option(
    "--to", "WHAT", "c (default), arduino, fmu2, fmu3, python, st, page or snippet.", default="c"
)
@value_option(
    "--out",
    "DIR",
    "Folder for the files (default: firmware, and none with --check alone). For a page, the file "
    "(default: live.html).",
    type=WRITTEN,
)
@value_option(
    "--precision", "P", "single (default of c, arduino and st) or double (default of the others)."
)
@value_option("--part", "PART", "observer (default) or observer+controller.", default="observer")
@value_option(
    "--tunable",
    "NAME",
    "Number that stays a parameter, such as observer.gamma. May be repeated.",
    multiple=True,
)
@value_option("--name", "NAME", "Prefix of every symbol.")
@value_option(
    "--method",
    "NAME",
    "Another observer for this export, such as kalman or certified. Keys of [observer] that it "
    "does not have are dropped. 'contact starts=1' sets a key as well.",
)
@flag_option(
    "--check",
    "Build the self-test with this computer's compiler, run it, print the accuracy table.",
)
@force_option
@flag_option("--json", "Print the report as one JSON object.", "as_json")
@add_guards
def export(
    scenario: Path,
    to: str,
    out: Path | None,
    precision: str | None,
    part: str,
    tunable: tuple[str, ...],
    name: str | None,
    method: str | None,
    check: bool,
    force: bool,
    as_json: bool,
    confine: Path | None,
) -> bool:
    """Write a scenario's observer, and on request its controller, as code for another machine.

    The targets are C99 for firmware, Structured Text (st) for a PLC, an FMU for Simulink, Modelica
    and others, and a Python module. A folder of C holds the code, a self-test with reference
    vectors as bits, build files, README and manifest. Single precision is run beside double along
    the scenario's own run.

    `--to page` writes one HTML file in which the whole loop runs in a browser, with sliders.
    `--to snippet` writes a few lines of C, Python and Structured Text that compensate a dead zone
    or a gap. It takes identify.json as well, and its default folder is snippet.

    Files of an earlier export in the folder are replaced, other files stay. An edited file, or a
    folder without an export, is refused without --force. Without --precision the code is in double
    where float is not accurate enough. Exit code 1: the self-test or the accuracy fails, and
    nothing is written.
    """
    if to == "snippet":
        if check or tunable or precision or method or part != "observer":
            raise click.UsageError("--to snippet takes --out, --name, --force and --json only")
        _export_snippet(scenario, out or Path("snippet"), name, force, as_json, confine)
        return True
    from undeadzone.scenario.reader import read
    from undeadzone_export.boards import BoardFit, board_table
    from undeadzone_export.exporting import export as run

    problem = read(scenario, confine)
    usual = "live.html" if to == "page" else "firmware"
    with open_scratch() as scratch:
        destination = out or (None if check else Path(usual))
        folder = destination or scratch / "firmware"
        with progress("exporting", None, of=problem.observer):
            notify = partial(print_line, err=True)
            result = run(
                problem, to, folder, precision, part, tunable, name, check, force, notify, method
            )
    files = [str(path) for path in result.files if destination]
    if as_json:
        print_json(result.report | {"written": files})
    else:
        words = _page_lines if to == "page" else _report_lines
        pairs = words(result.report, files)
        pairs["dropped"] = [
            f"{key}: the other method has no key of this meaning"
            for key in result.report["dropped"]
        ]
        blocks: list[Block] = [pairs]
        if "boards" in result.report:
            blocks.append(board_table([BoardFit(**row) for row in result.report["boards"]]))
        if check and result.report["accuracy"] is not None:
            blocks.append(_accuracy_table(result.report["accuracy"]))
        print_blocks(blocks)
    return result.has_passed


def _export_snippet(
    source: Path, out: Path, name: str | None, force: bool, as_json: bool, confine: Path | None
) -> None:
    """Write the lines that compensate, and print the report and the shortest of them."""
    from undeadzone_export.snippet import write_snippet

    report = write_snippet(source, out, name, force, confine)
    if as_json:
        print_json(report)
        return
    sides = [report["width"]] if report["kind"] == "backlash" else [report["right"], report["left"]]
    widths = [f"{value:.6g} [{low:.6g}, {high:.6g}] {report['unit']}" for value, low, high in sides]
    print_blocks([{report["kind"]: widths, "written": report["written"]}])


def _report_lines(report: dict[str, Any], files: list[str]) -> dict[str, Any]:
    """Return the printed form of a report, by title."""
    from undeadzone_export.targets import operations_text

    sizes = report["sizes"]
    again = shell_command("undeadzone", *sys.argv[1:])
    builds = [
        shell_command("make", "-C", Path(name).parent)
        for name in files
        if name.endswith("Makefile")
    ]
    texts = [report["structured_text"]] if "structured_text" in report else []
    return {
        "name": f"{report['name']} ({report['part']}, {report['precision']})",
        "hash": report["hash"],
        "sizes": f"state {sizes['state']}, in {sizes['in']}, out {sizes['out']} bytes",
        "operations": operations_text(report) or "none",
        "text": [
            f"{count_noun(size['blocks'], 'block')}, {count_noun(size['lines'], 'line')}"
            for size in texts
        ],
        "self-test": report.get("self_test", []),
        "proof": report["proof"] or [],
        "double": report["float_refusals"][:1],
        "REFUSED": report["refusals"],
        "leaner": [
            f"{again} --method {shlex.quote(method)}  # fits {', '.join(boards)}"
            for method, boards in report.get("leaner", {}).items()
        ],
        "written": files or "nothing" + "; --out DIR keeps the files" * (not report["refusals"]),
        "next": [f"{build} builds the self-test. README.md has the rest" for build in builds],
    }


def _page_lines(report: dict[str, Any], files: list[str]) -> dict[str, Any]:
    """Return the printed form of a page's report, by title."""
    from undeadzone_export.targets import operations_text

    sizes = report["sizes"]
    return {
        "page": f"{report['title']}: {report['steps']:,} steps at each move of a slider",
        "hash": report["hash"],
        "sizes": f"page {sizes['page']:,}, of which code {sizes['wasm']:,} bytes",
        "operations": operations_text(report),
        "sliders": ", ".join(report["sliders"]),
        "written": files,
    }


def _accuracy_table(accuracy: dict[str, Any]) -> list[list[str]]:
    """Return the accuracy as rows of text."""
    rows = [["float against double", "largest error", "largest value"]]
    for name, numbers in accuracy["float_against_double"].items():
        rows.append([name, f"{numbers['error']:.2g}", f"{numbers['size']:.3g}"])
    if accuracy["machine"] is not None:
        rows.append(["code against graph, double", f"{accuracy['machine']:.2g}", "relative"])
    for real, key in (("double", ""), ("float", "_in_float")):
        eigenvalue = accuracy[f"smallest_correlation_eigenvalue{key}"]
        if eigenvalue is not None:
            rows.append(["smallest correlation eigenvalue", f"{eigenvalue:.2g}", f"in {real}"])
    return rows
