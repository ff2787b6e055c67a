"""undeadzone tune SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import undeadzone as uz
from undeadzone.cli.common import cmd, flag, force_option, option, origin
from undeadzone.cli.output import Output, line_of_files, on_scenario, partial_file, to_type
from undeadzone.errors import InputError
from undeadzone.util.progress import on_terminal as progress

STATISTICS = click.Choice(["mean", "median", "p95", "worst"])


@click.command(
    epilog="Example: undeadzone tune examples/tune.toml --out tuned "
    "&& undeadzone run tuned/tuned.toml"
)
@option(
    "--over",
    "ADDRESS=LOW:HIGH[:log]",
    "Tune this number too, or within these bounds; may be given several times.",
    multiple=True,
)
@option("--metric", "NAME", "What is made small (default: [tune] metric, rms_tracking).")
@option("--statistic", None, "Of the runs (default: [tune] statistic, mean).", type=STATISTICS)
@flag("--certified", "Keep the observer's gains certified.", default=None)
@option("--runs", "N", "Runs of each candidate (default: [tune] runs, 64).", type=int)
@option("--budget", "N", "Candidates tried in all (default: [tune] budget, 200).", type=int)
@option("--seed", "N", "Of the runs and the search (default: [tune] seed).", type=int)
@flag("--resume", "Continue a search that was stopped, from DIR/tuned.toml.partial.")
@force_option
@on_scenario
def tune(
    scenario: Path,
    over: tuple[str, ...],
    resume: bool,
    output: Output,
    force: bool,
    confine: Path | None,
    **changes: Any,
) -> int:
    """Find the numbers of observer and controller that make a metric small over many runs.

    A table of the scenario says which, within which bounds; their runs vary as its [ensemble] says:

    \b
        [tune]
        metric = "rms_tracking"     # of a run
        statistic = "p95"           # of the runs: mean, median, p95, worst
        certified = true            # keep the observer's gains certified
        "observer.gamma" = { between = [0.1, 100.0], log = true }
        "observer.L" = { between = [0.01, 100.0], log = true }

    Prints the numbers found and what they are worth on held-out runs, others than those tuned on.
    Writes tuned.toml, the scenario with these numbers, and figures and report.html to DIR (default:
    NAME-tune);
    with --no-figures and no --out it writes nothing. What candidates cost is kept in DIR meanwhile:
    after Ctrl-C, kill or a crash --resume goes on. Exit code 1: no better on the held-out runs,
    or not certified though this was asked for.
    """
    from undeadzone.util.own_files import require_own

    tuned = uz.read(scenario, confine)
    folder = output.folder(f"{scenario.stem}-tune")
    if folder is not None:
        require_own(folder / "tuned.toml", force)
    wanted = _tuning_task(tuned, over, changes)
    keep = partial_file(folder, "tuned.toml", resume)
    with progress("tuning", wanted.budget, "candidates", of=tuned.observer) as advance:
        result = uz.tune(tuned, wanted, progress=advance, keep=keep, resume=resume)
    written = [] if folder is None else [result.save(folder / "tuned.toml")]
    if keep is not None:
        keep.unlink(missing_ok=True)
    if folder is not None and output.figures:
        from undeadzone.report.tune_page import write_tuned

        written += write_tuned(result, folder, origin(scenario, result.seed))
    last = line_of_files(written)
    if written:
        last |= to_type(cmd("undeadzone", "run", written[0]))
    output.show(result.summary, result.blocks, written, last)
    return 0 if result.improved and result.certified else 1


def _tuning_task(scenario: uz.Scenario, over: tuple[str, ...], changes: dict[str, Any]) -> uz.Tune:
    """Return the [tune] of a scenario with what the options say. Raises InputError."""
    import msgspec

    table = scenario.tune or uz.Tune()
    options = {name: value for name, value in changes.items() if value is not None}
    entries = table.entries | dict(map(_bounds, over))
    return msgspec.structs.replace(table, entries=entries, **options)


def _bounds(text: str) -> tuple[str, Any]:
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
