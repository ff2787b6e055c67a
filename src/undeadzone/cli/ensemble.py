"""undeadzone ensemble SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import undeadzone as uz
from undeadzone.cli.common import cmd, flag, option, origin, writable
from undeadzone.cli.output import Output, on_scenario, prepare_figures, tell_anew
from undeadzone.util.progress import on_terminal as progress


@click.command(epilog="Example: undeadzone ensemble examples/ensemble.toml --out study")
@option("--runs", "N", "How many (default: [ensemble] runs, 10000).", type=click.IntRange(1))
@flag("--resume", "Compute what an interrupted command left to do in DIR; the bits are the same.")
@option(
    "--workers", "N", "Compute on N processes of this computer; the bits are the same.", type=int
)
@option(
    "--cluster",
    "ADDRESS",
    "Compute on the Dask cluster whose scheduler is there, such as tcp://10.0.0.1:8786 "
    "(needs the extra dask; docs/security.md says what is trusted).",
)
@flag("--parquet", "Write runs.parquet instead of runs.npz (needs the extra parquet).")
@on_scenario
def ensemble(
    scenario: Path,
    runs: int | None,
    parquet: bool,
    output: Output,
    confine: Path | None,
    **options: Any,
) -> int:
    """Run a scenario many times: how often does it settle, how large are the errors, what decides?

    A table of the scenario says what varies; besides, every run has noise of its own:

    \b
        [ensemble]
        "sensor.right" = { uniform = [0.3, 2.0] }
        "plant.A[1,1]" = { normal = [1.0, 0.1], relative = true }

    Prints the shares that settle and that diverge, quantiles with 95 % intervals, what each entry
    decides, and the worst runs: undeadzone run DIR/runs.npz --replay NUMBER shows one in full.
    Writes runs.npz, figures and report.html to DIR (default: NAME-ensemble); with --no-figures
    runs.npz alone. Exit code 1: some run diverged.

    Every block of runs is kept on disk as it is done: after Ctrl-C, kill or a crash --resume
    computes the rest. docs/ensemble.md says what the numbers mean, docs/scenario.md what can vary.
    """
    varied = _with_number_of_runs(uz.read(scenario, confine), runs)
    total = varied.ensemble.runs if varied.ensemble else None
    folder = writable(output.out or Path(f"{scenario.stem}-ensemble"))
    path = folder / ("runs.parquet" if parquet else "runs.npz")
    if options["resume"] and not path.exists():
        tell_anew(Path(f"{path}.partial"))
    with progress("running", total, "runs", of=varied.observer) as advance:
        result = uz.run_ensemble(varied, path, progress=advance, **options)
    summary = result.summary()
    written = [path]
    if output.figures:
        prepare_figures()
        from undeadzone.report.ensemble_page import write_ensemble

        written += write_ensemble(result, summary, folder, origin(scenario, result.info.seed))
    last = _last(summary, folder, written)
    output.show(lambda: summary, lambda: result.blocks(summary), written, last)
    return 1 if summary["diverged"]["value"] else 0


def _with_number_of_runs(scenario: uz.Scenario, runs: int | None) -> uz.Scenario:
    """Return the scenario with that many runs. Raises InputError."""
    import msgspec

    if runs is None or scenario.ensemble is None:
        return scenario
    ensemble = msgspec.structs.replace(scenario.ensemble, runs=runs)
    return msgspec.structs.replace(scenario, ensemble=ensemble)


def _last(summary: dict[str, Any], folder: Path, written: list[Path]) -> dict[str, str]:
    """Which runs are worst, how one is seen, and the files."""
    from undeadzone.ensemble.words import SHOWN

    worst = [row["run"] for row in summary["worst"]][:SHOWN]
    return {
        "worst runs": ", ".join(map(str, worst)),
        "see one": cmd("undeadzone", "run", written[0], "--replay", worst[0]),
        "written": f"{folder}: {', '.join(path.name for path in written)}",
    }
