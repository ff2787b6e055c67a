"""undeadzone ensemble SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import undeadzone as uz
from undeadzone.cli.common import (
    build_origin,
    flag_option,
    require_writable,
    shell_command,
    value_option,
)
from undeadzone.cli.output import Output, add_scenario_options, prepare_figures, report_fresh_start
from undeadzone.util.progress import terminal_progress as progress


@click.command(epilog="Example: undeadzone ensemble examples/ensemble.toml --out study")
@value_option(
    "--runs", "N", "Number of runs (default: [ensemble] runs, 10000).", type=click.IntRange(1)
)
@flag_option("--resume", "Compute what an interrupted command left in DIR. The bits are the same.")
@value_option(
    "--workers", "N", "Compute on N processes of this computer. The bits are the same.", type=int
)
@value_option(
    "--cluster",
    "ADDRESS",
    "Compute on the Dask cluster whose scheduler is there, such as tcp://10.0.0.1:8786 "
    "(needs the extra dask, see docs/security.md).",
)
@flag_option("--parquet", "Write runs.parquet instead of runs.npz (needs the extra parquet).")
@add_scenario_options
def ensemble(
    scenario: Path,
    runs: int | None,
    parquet: bool,
    output: Output,
    confine: Path | None,
    **options: Any,
) -> bool:
    """Run a scenario many times: shares that settle, errors, and the parameters that decide.

    The table [ensemble] of the scenario names the parameters that vary. Every run has its own
    noise:

    \b
        [ensemble]
        "sensor.right" = { uniform = [0.3, 2.0] }
        "plant.A[1,1]" = { normal = [1.0, 0.1], relative = true }

    Prints the shares that settle and that diverge, quantiles with 95 % intervals, the influence of
    each parameter, and the worst runs. undeadzone run DIR/runs.npz --replay NUMBER shows one in
    full. Writes runs.npz, figures and report.html to DIR (default: NAME-ensemble), and with
    --no-figures runs.npz alone. Exit code 1: a run diverged.

    Every block of runs is kept on disk as it is done: after Ctrl-C, kill or a crash --resume
    computes the rest. docs/ensemble.md explains the numbers, docs/scenario.md lists the parameters
    that can vary.
    """
    varied = _replace_run_count(uz.read(scenario, confine), runs)
    total = varied.ensemble.runs if varied.ensemble else None
    folder = require_writable(output.out or Path(f"{scenario.stem}-ensemble"))
    path = folder / ("runs.parquet" if parquet else "runs.npz")
    if options["resume"] and not path.exists():
        report_fresh_start(Path(f"{path}.partial"))
    with progress("running", total, "runs", of=varied.observer) as advance:
        result = uz.run_ensemble(varied, path, progress=advance, **options)
    summary = result.summary()
    written = [path]
    if output.figures:
        prepare_figures()
        from undeadzone_studies.report.ensemble_page import write_ensemble

        written += write_ensemble(result, summary, folder, build_origin(scenario, result.info.seed))
    last = _final_lines(summary, folder, written)
    output.print_result(lambda: summary, lambda: result.blocks(summary), written, last)
    return not summary["diverged"]["value"]


def _replace_run_count(scenario: uz.Scenario, runs: int | None) -> uz.Scenario:
    """Return the scenario with the given number of runs. Raises InputError."""
    import msgspec

    if runs is None or scenario.ensemble is None:
        return scenario
    ensemble = msgspec.structs.replace(scenario.ensemble, runs=runs)
    return msgspec.structs.replace(scenario, ensemble=ensemble)


def _final_lines(summary: dict[str, Any], folder: Path, written: list[Path]) -> dict[str, str]:
    """Return the lines on the worst runs, the command to show a run, and the files."""
    from undeadzone_studies.ensemble.words import LISTED

    worst = [row["run"] for row in summary["worst"]][:LISTED]
    return {
        "worst runs": ", ".join(map(str, worst)),
        "see one": shell_command("undeadzone", "run", written[0], "--replay", worst[0]),
        "written": f"{folder}: {', '.join(path.name for path in written)}",
    }
