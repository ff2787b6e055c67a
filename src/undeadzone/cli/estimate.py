"""undeadzone estimate SCENARIO.toml LOG.csv"""

from __future__ import annotations

from pathlib import Path

import click

import undeadzone as uz
from undeadzone.cli.common import (
    READ,
    build_origin,
    columns_option,
    flag_option,
    force_option,
    shell_command,
    strict_option,
    value_option,
)
from undeadzone.cli.output import (
    Output,
    add_scenario_options,
    csv_option,
    decide_table,
    files_line,
    next_line,
    require_own_table,
)
from undeadzone.errors import InputError
from undeadzone.util.files import read_text
from undeadzone.util.progress import terminal_progress as progress


@click.command(epilog="Example: undeadzone estimate mine.toml log.csv --columns y=angle,u=voltage")
@columns_option
@strict_option
@value_option(
    "--delay",
    "N",
    "Samples by which the inputs act later than the log has them; -1: earlier.",
    type=int,
    default=0,
)
@flag_option("--causal", "The filter alone: no smoothing with the whole log.")
@csv_option
@force_option
@add_scenario_options
@click.argument("log", type=READ, metavar="LOG")
def estimate(
    scenario: Path,
    log: Path,
    columns: str | None,
    strict: bool,
    delay: int,
    causal: bool,
    as_csv: bool,
    force: bool,
    confine: Path | None,
    output: Output,
) -> bool:
    """Run the observer of a scenario along a log, and test it against the log.

    A log is a CSV file of any dialect with a header (t, y, u with units in brackets), .npz, .mat or
    .jsonl. Times must fit simulation.step. The scenario needs no [reference], no
    [controller], no widths.

    Prints the widths, the missing samples, and whether the innovations are consistent with the
    observer's assumptions. Writes estimate.npz, estimate.csv (up to 10 MB), figure.svg and
    report.html to DIR (default: LOG-estimate). `kalman`, `censored`, `extended` and `auto` are
    smoothed with the whole log as well.

    Exit code 1: the log is not consistent with the assumptions. Exchanged columns, signs, units and
    delays are then tried, and a variant that fits is shown.
    """
    from undeadzone.report.log_page import write_estimation
    from undeadzone.results.run import describe_last_noise
    from undeadzone.scenario.reader import read_for_logs

    if log.suffix == ".toml":
        right = shell_command("undeadzone", "estimate", log, scenario)
        raise InputError(f"the log and the scenario are exchanged: {right}")
    folder = output.choose_folder(f"{log.stem}-estimate", as_csv)
    require_own_table(folder, "estimate.csv", force)
    watched = read_for_logs(scenario, confine)
    with progress("estimating", None, of=watched.observer) as advance:
        result = uz.estimate(
            watched,
            log,
            columns=columns,
            strict=strict,
            smoothing=not causal,
            delay=delay,
            progress=advance,
        )
    cure = None
    if result.info.consistent is False or describe_last_noise(result):
        from undeadzone.simulation.log_diagnosis import what_would_fit

        with progress("trying what would fit", None, of=watched.observer):
            cure = what_would_fit(watched, result)
    written: list[Path] = []
    tables, left_out = decide_table(as_csv, result.table_size, "estimate.csv")
    if folder is not None:
        written = write_estimation(result, folder, output.figures, tables, build_origin(scenario))
    files = files_line(written) | left_out if written else {}
    remedy = {} if cure is None else {"would fit": cure}
    last = remedy | files | ({} if cure else _advise_after_estimate(scenario, log, columns, result))
    output.print_result(
        lambda: result.summary() | {"would_fit": cure}, result.blocks, written, last
    )
    return result.info.consistent is not False


def _advise_after_estimate(
    scenario: Path, log: Path, columns: str | None, result: uz.Estimation
) -> dict[str, str]:
    """Return the next command after a log: export if the model fits, else `identify`.

    A scenario of `identify` has none: its answer would be the same.
    """
    if result.info.consistent is False:
        if "Written by undeadzone identify" in read_text(scenario):
            return {}
        again = shell_command("undeadzone", "identify", log, columns=columns)
        return next_line(f"{again} finds a plant and a zone that fit")
    return next_line(shell_command("undeadzone", "export", scenario))
