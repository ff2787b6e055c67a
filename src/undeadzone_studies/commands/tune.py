"""undeadzone tune SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import undeadzone as uz
from undeadzone.cli.common import (
    build_origin,
    flag_option,
    force_option,
    shell_command,
    value_option,
)
from undeadzone.cli.output import (
    Output,
    add_scenario_options,
    discard_partial,
    files_line,
    next_line,
    partial_file,
)
from undeadzone.errors import InputError
from undeadzone.util.progress import terminal_progress as progress

STATISTICS = click.Choice(["mean", "median", "p95", "worst"])


@click.command(
    epilog="Example: undeadzone tune examples/tune.toml --out tuned "
    "&& undeadzone run tuned/tuned.toml"
)
@value_option(
    "--over",
    "ADDRESS=LOW:HIGH[:log]",
    "Tune this number too, or within these bounds. May be repeated.",
    multiple=True,
)
@value_option("--metric", "NAME", "Metric to make small (default: [tune] metric, rms_tracking).")
@value_option(
    "--statistic", None, "Statistic over runs (default: [tune] statistic, mean).", type=STATISTICS
)
@flag_option("--certified", "Keep the observer's gains certified.", default=None)
@value_option("--runs", "N", "Runs of each candidate (default: [tune] runs, 64).", type=int)
@value_option("--budget", "N", "Candidates tried in all (default: [tune] budget, 200).", type=int)
@value_option("--seed", "N", "Seed of the runs and the search (default: [tune] seed).", type=int)
@flag_option("--resume", "Continue a search that was stopped, from DIR/tuned.toml.partial.")
@force_option
@add_scenario_options
def tune(
    scenario: Path,
    over: tuple[str, ...],
    resume: bool,
    output: Output,
    force: bool,
    confine: Path | None,
    **changes: Any,
) -> bool:
    """Find the numbers of observer and controller that make a metric small over many runs.

    The table [tune] of the scenario names the numbers and their bounds. The runs vary as the table
    [ensemble] describes:

    \b
        [tune]
        metric = "rms_tracking"     # of a run
        statistic = "p95"           # of the runs: mean, median, p95, worst
        certified = true            # keep the observer's gains certified
        "observer.gamma" = { between = [0.1, 100.0], log = true }
        "observer.L" = { between = [0.01, 100.0], log = true }

    Prints the numbers found and their metric on held-out runs. Writes tuned.toml, the scenario with
    these numbers, and figures and report.html to DIR (default: NAME-tune). With --no-figures and
    no --out it writes nothing. Results of candidates are kept in DIR: after Ctrl-C, kill or a crash
    --resume goes on.

    Exit code 1: the numbers are not better on the held-out runs, or have no certificate although
    certified = true.
    """
    from undeadzone.util.own_files import require_own_file

    tuned = uz.read(scenario, confine)
    folder = output.choose_folder(f"{scenario.stem}-tune")
    if folder is not None:
        require_own_file(folder / "tuned.toml", force)
    task = _tuning_task(tuned, over, changes)
    keep = partial_file(folder, "tuned.toml", resume)
    with progress("tuning", task.budget, "candidates", of=tuned.observer) as advance:
        result = uz.tune(tuned, task, progress=advance, keep=keep, resume=resume)
    written = [] if folder is None else [result.save(folder / "tuned.toml")]
    discard_partial(keep)
    if folder is not None and output.figures:
        from undeadzone_studies.report.tune_page import write_tuned

        written += write_tuned(result, folder, build_origin(scenario, result.seed))
    last = files_line(written)
    if written:
        last |= next_line(shell_command("undeadzone", "run", written[0]))
    output.print_result(result.summary, result.blocks, written, last)
    return result.improved and result.certified


def _tuning_task(scenario: uz.Scenario, over: tuple[str, ...], changes: dict[str, Any]) -> uz.Tune:
    """Return the [tune] table of a scenario, updated by the options. Raises InputError."""
    import msgspec

    table = scenario.tune or uz.Tune()
    options = {name: value for name, value in changes.items() if value is not None}
    entries = table.entries | dict(map(_parse_bounds, over))
    return msgspec.structs.replace(table, entries=entries, **options)


def _parse_bounds(text: str) -> tuple[str, Any]:
    """Return an address and its bounds, from ADDRESS=LOW:HIGH[:log]. Raises InputError."""
    address, _, bounds = text.partition("=")
    low, _, rest = bounds.partition(":")
    high, _, scale = rest.partition(":")
    try:
        if scale not in ("", "log"):
            raise ValueError
        return address.strip(), uz.Range(between=(float(low), float(high)), log=scale == "log")
    except ValueError:
        raise InputError(
            "--over: expected ADDRESS=LOW:HIGH or ADDRESS=LOW:HIGH:log, such as "
            f"observer.gamma=0.1:100:log, found {text!r}"
        ) from None
