"""undeadzone paper"""

from __future__ import annotations

from pathlib import Path

import click

from undeadzone.cli.common import common, print_json, progress


@click.command(epilog="Example: undeadzone paper --out results && open results/report.html")
@common
def paper(out: Path | None, as_json: bool, no_figures: bool) -> int:
    """Run the paper's example as printed and repaired, and check every claim.

    Prints the table of claims with what was measured for each. Writes paper.json, figures 3-8 and report.html to
    DIR (default: paper-results); with --no-figures and no --out it writes nothing.
    """
    from undeadzone.paper import audit, write

    with progress("auditing the paper", None) as advance:
        found = audit(progress=advance)
        folder = out if out is not None else None if no_figures else Path("paper-results")
        written = (
            write(found, folder, figures=not no_figures, progress=advance)
            if folder is not None
            else []
        )
    if as_json:
        print_json(found.summary())
        return 0
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console()
    summary = found.summary()
    table = Table(title="The paper's claims", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("claim", "measured", "as printed", "repaired", "limit", "verdict"):
        table.add_column(
            column, justify="right" if column in ("as printed", "repaired", "limit") else "left"
        )
    for claim in summary["claims"]:
        numbers = (_shown(claim[key]) for key in ("printed", "repaired", "limit"))
        colour = {"holds": "green", "holds after repair": "yellow"}.get(claim["verdict"], "red")
        table.add_row(
            claim["claim"], claim["quantity"], *numbers, f"[{colour}]{claim['verdict']}[/]"
        )
    console.print(table)
    printed, repaired = summary["printed"], summary["repaired"]
    console.print(
        f"As printed: max |z| = {printed['max_abs_z']:.4g} over the last 4 s, max |y| = {printed['max_abs_y']:g}: the sensor never speaks."
    )
    console.print(
        f"Repaired: rms z - r = {repaired['rms_tracking']:.3g} over the last 2 s, "
        f"d_r^ = {repaired['d_right']:.6g}, d_l^ = {repaired['d_left']:.6g} (true 1, 1)."
    )
    for path in written:
        console.print(f"wrote {path}", highlight=False)
    return 0


def _shown(value: float | None) -> str:
    return "diverges" if value is None else f"{value:.3g}"
