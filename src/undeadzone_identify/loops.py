"""Command `undeadzone loops FOLDER_OR_TABLE`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import READ, build_origin, flag_option, to_json_text, value_option
from undeadzone.cli.output import (
    Output,
    add_output_options,
    discard_partial,
    files_line,
    partial_file,
)
from undeadzone.errors import InputError
from undeadzone.util.progress import terminal_progress as progress

if TYPE_CHECKING:
    from undeadzone_identify.logs.loops import Record

HEAD = ("loop", "cause", "odds", "S of OP", "J of OP", "cost", "travel a day", "what to do")


@click.command(epilog="Example: undeadzone loops plant --out ranked")
@click.argument("source", type=READ, metavar="PLANT")
@value_option("--workers", "N", "Judge N loops at once.", type=click.IntRange(1), default=1)
@flag_option("--resume", "Go on from what an interrupted command left in DIR.")
@add_output_options
def loops(source: Path, workers: int, resume: bool, output: Output) -> bool:
    """Rank the control loops of a plant by the cost of their swing, with the cause of each.

    PLANT is a folder, with a CSV file for each record, named by the valve and a date, as in
    FIC101_0612.csv, or a table of columns or tags such as FIC101.PV, FIC101.OP, FIC101.SP (MV, SV,
    CV, OUT.CV as well), a column each or a line a value.

    Prints a line a loop: cause, odds, S and J with 95 % intervals, rms of PV - SP, travel of the
    stem, what to do. The valve's S stands there whether it is named or not. Writes loops.json, a
    page a loop and report.html to DIR (default: NAME-loops). Each answer is kept in DIR: after
    Ctrl-C, kill or a crash --resume goes on.

    Exit code 1: a loop was refused.
    """
    from undeadzone.util.answers import open_answers
    from undeadzone.util.files import write_text
    from undeadzone.util.installed import use_one_blas_thread
    from undeadzone_identify.logs.loops import find_loops
    from undeadzone_studies.ensemble.local_workers import iterate_results

    folder = output.choose_folder(f"{source.stem}-loops")
    keep = partial_file(folder, "loops.json", resume)
    found = find_loops(source)
    pages = folder if output.figures else None
    asked = [(tag, records, pages) for tag, records in found.items()]
    with use_one_blas_thread(), progress("judging", len(asked), "loops") as advance:

        def answer_missing(missing: list[int]) -> Iterator[tuple[int, Any]]:
            """Yield number and row of each loop that has no answer yet."""
            pending = {k: asked[k] for k in missing}
            one_by_one = ((k, judge_loop(*pending[k])) for k in missing)
            for result in (
                one_by_one if workers == 1 else iterate_results(workers, judge_loop, pending)
            ):
                advance(1)
                yield result

        with open_answers(keep, lambda: {"source": str(source)}, "loops", resume) as answers:
            rows = answers.compute_missing([*found], answer_missing)
    rows.sort(key=lambda one: -(one["cost"] or 0.0))
    written = []
    if folder is not None:
        written.append(write_loops(rows, folder, source.name))
        numbers = to_json_text({"loops": rows}) + "\n"
        written.append(write_text(numbers, folder / "loops.json"))
    discard_partial(keep)
    table = [HEAD, *map(cells_of_row, rows)]
    output.print_result(lambda: {"loops": rows}, lambda: [table], written, files_line(written))
    return all(row["verdict"] != "refused" for row in rows)


def judge_loop(tag: str, records: list[Record], folder: Path | None) -> dict[str, Any]:
    """Return the line of a loop, and write its page.

    Args:
        tag: name of the loop.
        records: of it.
        folder: of the pages; None: none is written.
    """
    from undeadzone_identify.logs.loops import read_record
    from undeadzone_identify.page import write_identified
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.selection.loop import find_loop_cause, is_loop

    row: dict[str, Any] = {"loop": tag, "cost": 0.0, "page": None}
    try:
        logs = list(map(read_record, records))
        if not all(map(is_loop, logs)):
            raise InputError(f"{logs[0].source}: its columns are no OP and PV by their names")
        answer = IdentifiedLoop(tuple(logs), find_loop_cause(logs))
    except InputError as error:
        return row | {"verdict": "refused", "found": str(error)}
    numbers = answer.numbers()
    row |= {key: numbers[key] for key in ("verdict", "found", "odds", "records")} | numbers["loop"]
    cure = answer.found.remarks[-1:] if answer.found.is_thinned else ()
    row["unit"] = numbers["units"]["input"]
    row["do"] = [*cure, *answer.account.remedies, *answer.account.doubts][:1]
    if folder is not None:
        page = re.sub(r"[^\w.-]+", "_", tag)
        write_identified(answer, folder / page, tag, build_origin(None))
        row["page"] = f"{page}/report.html"
    return row


def cells_of_row(row: dict[str, Any]) -> list[str]:
    """Return the cells of a loop's line, in the order of HEAD."""
    from undeadzone_identify.models.estimates import Interval
    from undeadzone_identify.results.formats import describe_interval, unit_suffix
    from undeadzone_identify.results.loop import cost_in_words, read_number

    if row["verdict"] == "refused":
        return [row["loop"], "refused", *["-"] * 5, row["found"]]
    word, share = next(iter(row["odds"].items()))
    unit = unit_suffix(row["unit"])
    sizes = [describe_interval(Interval(*row[key]), unit) for key in ("S", "J")]
    cost = cost_in_words(read_number(row["error"]), row["cost"], row["about"])
    odds = f"{word} {100 * share:.0f} %"
    rest = [cost, read_number(row["travel"]), *(row["do"] or ["-"])]
    return [row["loop"], row["verdict"], odds, *sizes, *rest]


def write_loops(rows: list[dict[str, Any]], folder: Path, source: str) -> Path:
    """Write the page of all loops with a link to the page of each; return its path.

    Args:
        rows: of the loops, in their order.
        folder: where to.
        source: name of the folder or table.
    """
    from html import escape

    from undeadzone.report import html
    from undeadzone.util.files import write_text

    lines = []
    for row in rows:
        first, *rest = cells_of_row(row)
        name = html.escape_html(first)
        link = f'<a href="{escape(row["page"])}">{name}</a>' if row["page"] else name
        lines.append([html.Html(link), *rest])
    about = "S and J of a valve that is not named are those that it has if it sticks."
    text = html.build_page(
        f"Loops: {source}",
        html.build_section("By cost", html.build_table(HEAD, lines), html.build_paragraph(about)),
        origin=build_origin(None),
    )
    return write_text(text, folder / "report.html")
