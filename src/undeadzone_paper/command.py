"""Command `undeadzone paper`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import build_origin, print_json
from undeadzone.cli.output import Output, add_output_options
from undeadzone.util.progress import terminal_progress as progress

if TYPE_CHECKING:
    from rich.table import Table

    from undeadzone_paper.claims import Claim

COLUMNS = ("claim", "measured", "as printed", "repaired", "limit", "verdict")
SUMMARY: str = (
    "As printed: max |z| = {printed[max_abs_z]:.4g} over the last 4 s, max |y| = "
    "{printed[max_abs_y]:g}: the sensor never speaks.\n"
    "Repaired: rms z - r = {repaired[rms_tracking]:.3g} over the last 2 s, "
    "d_r^ = {repaired[d_right]:.6g}, d_l^ = {repaired[d_left]:.6g} (true 1, 1)."
)
COLOURS = {"holds": "green", "holds after repair": "yellow"}  # of verdicts; of others red


@click.command(epilog="Example: undeadzone paper --out results, then look at results/report.html")
@add_output_options
def paper(output: Output) -> None:
    """Run the paper's example as printed and repaired, and check every claim.

    Prints the table of claims, each with its measured number. Writes paper.json, figures 1-8 and
    report.html to DIR (default: paper-results). With --no-figures and no --out it writes nothing.
    """
    from undeadzone_paper import audit, write

    folder = output.choose_folder("paper-results")
    written: list[Path] = []
    with progress("auditing the paper", None) as advance:
        result = audit(progress=advance)
        if folder is not None:
            written = write(
                result, folder, output.figures, progress=advance, origin=build_origin(None)
            )
    summary = result.summary()
    if output.as_json:
        print_json(summary, written)
    else:
        _print_claims(result.claims, summary, written)


def _print_claims(claims: list[Claim], summary: dict[str, Any], written: list[Path]) -> None:
    """Print the claims and their measured numbers."""
    from rich.console import Console

    from undeadzone_paper.claims import verdict_counts_text

    console = Console()
    console.print(_claims_table(claims))
    console.print(verdict_counts_text(claims), highlight=False)
    console.print(SUMMARY.format_map(summary))
    for path in written:
        console.print(f"wrote {path}", highlight=False)


def _claims_table(claims: list[Claim]) -> Table:
    """Return the table of claims."""
    from rich import box
    from rich.table import Table

    table = Table(*COLUMNS, title="The paper's claims", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in table.columns[2:5]:
        column.justify = "right"
    for claim in claims:
        text = claim.text
        numbers = map(_cell_number_text, (claim.worst_printed, claim.repaired, text.limit))
        verdict = f"[{COLOURS.get(claim.verdict, 'red')}]{claim.verdict}[/]"
        table.add_row(text.claim, text.quantity, *numbers, verdict)
    return table


def _cell_number_text(value: float | None) -> str:
    """Return a number as text, empty for None."""
    from undeadzone_paper.claims import value_text

    return "" if value is None else value_text(value)
