"""undeadzone ensemble SCENARIO.toml"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import common, print_json, print_pairs, print_table, progress

if TYPE_CHECKING:
    from undeadzone.ensemble.result import Ensemble
    from undeadzone.scenario.schema import Scenario

METRICS = {
    "rms_tracking": "rms z - r, last 2 s",
    "rms_estimation": "rms z - z^, last 2 s",
    "rms_tip": "rms distance of the tip from its path, last 2 s",
    "d_error": "largest |d^ - d|, at the end",
    "settling_time": "settling time",
    "peak_tracking": "peak |z - r|",
    "rms_input": "rms u",
    "silent_fraction": "share of silent samples",
}
SHOWN = 5  # worst runs, and entries that decide


@click.command(epilog="Example: undeadzone ensemble examples/ensemble.toml --out study")
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--runs",
    type=int,
    default=None,
    metavar="N",
    help="How many (default: [ensemble] runs, 10000).",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Compute what an interrupted command left to do in DIR; the bits are the same.",
)
@click.option(
    "--workers",
    type=int,
    default=None,
    metavar="N",
    help="Compute on N local processes (needs the extra dask); the bits are the same.",
)
@click.option(
    "--cluster",
    default=None,
    metavar="ADDRESS",
    help="Compute on the Dask cluster whose scheduler is there, such as tcp://10.0.0.1:8786.",
)
@click.option(
    "--parquet",
    is_flag=True,
    help="Write runs.parquet instead of runs.npz (needs the extra parquet).",
)
@common
def ensemble(
    scenario: Path,
    runs: int | None,
    resume: bool,
    workers: int | None,
    cluster: str | None,
    parquet: bool,
    out: Path | None,
    as_json: bool,
    no_figures: bool,
) -> int:
    """Run a scenario many times: how often does it settle, how large do the errors get, what decides?

    A table of the scenario says what varies; besides, every run has noise of its own:

    \b
        [ensemble]
        "sensor.right" = { uniform = [0.3, 2.0] }
        "plant.A[1,1]" = { normal = [1.0, 0.1], relative = true }

    Prints the shares that settle and that diverge, quantiles with 95 % intervals, what each entry decides, and the worst
    runs: undeadzone run DIR/runs.npz --replay NUMBER shows one in full. Writes runs.npz, figures and report.html to DIR
    (default: NAME-ensemble); with --no-figures runs.npz alone. Exit code 1: some run diverged.

    Every block of runs is kept on disk as it is done: after Ctrl-C, kill or a crash --resume computes the rest.
    docs/ensemble.md says what the numbers mean, docs/scenario.md what can vary.
    """
    from undeadzone.ensemble.run_ensemble import run_ensemble
    from undeadzone.scenario.reader import read

    problem = _sized(read(scenario), runs)
    folder = out if out is not None else Path(f"{scenario.stem}-ensemble")
    path = folder / ("runs.parquet" if parquet else "runs.npz")
    with progress(
        "running", problem.ensemble.runs if problem.ensemble else None, "runs"
    ) as advance:
        result = run_ensemble(
            problem, path, resume=resume, workers=workers, cluster=cluster, progress=advance
        )
    summary = result.summary()
    written = [path]
    if not no_figures:
        from undeadzone.report.ensemble_page import write_ensemble

        written += write_ensemble(result, summary, folder)
    if as_json:
        print_json(summary | {"files": [str(name) for name in written]})
    else:
        _print(result, summary, folder, written)
    return 1 if summary["diverged"]["value"] else 0


def _sized(problem: Scenario, runs: int | None) -> Scenario:
    """The scenario with that many runs."""
    import msgspec

    from undeadzone.errors import InputError

    if runs is None or problem.ensemble is None:
        return problem
    if runs < 1:
        raise InputError(f"--runs: expected 1 or more, found {runs}")
    return msgspec.structs.replace(
        problem, ensemble=msgspec.structs.replace(problem.ensemble, runs=runs)
    )


def _print(result: Ensemble, summary: dict[str, Any], folder: Path, written: list[Path]) -> None:
    from undeadzone.report.style import label
    from undeadzone.simulation.run import LAST

    info, path = result.info, written[0]
    click.echo(
        f"{info.title}: {info.runs:,} run{'s' * (info.runs > 1)} of {info.duration:g} s, {info.sampling.replace('_', ' ')} sampling, seed {info.seed}\n"
    )
    lasts = f"for the last {LAST:g} s" if info.duration > LAST else "at the end"
    lost = summary["diverged"]
    which = (
        f": {_listed(lost['runs'], int(result.diverged.sum()))}; left out of what follows"
        if lost["runs"]
        else ""
    )
    shares = {
        "settled": f"{_share(summary['settled'])}: |z - r| within {100 * info.tolerance:g} % of the largest |r| {lasts}",
        "diverged": f"{_share(lost)}{which}",
    }
    print_pairs(shares)
    if summary["metrics"]:
        found = (
            (label(name, result.unit(key)), summary["metrics"][key])
            for key, name in METRICS.items()
            if key in summary["metrics"]
        )
        rows = [
            (name, *(_interval(metric[column]) for column in ("median", "p95", "p99")))
            for name, metric in found
        ]
        click.echo()
        print_table(
            [("95 % intervals in ()", "median", "95 % of runs below", "99 % of runs below"), *rows]
        )
    if summary["sensitivities"]:
        click.echo()
        print_table(
            [
                ("what decides rms z - r", "rank correlation", "share of the variance"),
                *map(_decides, list(summary["sensitivities"].items())[:SHOWN]),
            ]
        )
    click.echo()
    worst = [row["run"] for row in summary["worst"]][:SHOWN]
    print_pairs(
        {
            "worst runs": ", ".join(map(str, worst)),
            "see one": f"undeadzone run {shlex.quote(str(path))} --replay {worst[0]}",
            "written": f"{folder}: {', '.join(name.name for name in written)}",
        }
    )


def _listed(runs: list[int], total: int) -> str:
    return f"run{'s' * (total > 1)} {', '.join(map(str, runs[:SHOWN]))}{', ...' * (total > SHOWN)}"


def _share(found: dict[str, Any]) -> str:
    value, low, high = (f"{100 * found[key]:.3g} %" for key in ("value", "low", "high"))
    return _within(value, low if found["value"] > 0 else None, high if found["value"] < 1 else None)


def _interval(found: dict[str, Any]) -> str:
    """A settling time without a bound is one that is never over."""
    value, low, high = (
        None if found[key] is None else f"{found[key]:.4g}" for key in ("value", "low", "high")
    )
    if value is None:
        return "never settles" if low is None else f"never settles (or after {low})"
    return _within(value, low, high)


def _decides(entry: tuple[str, dict[str, Any]]) -> tuple[str, str, str]:
    name, found = entry
    share = found["total_order"] or found["first_order"]
    chance = found["floor"] is not None and share["value"] < found["floor"]
    rank, part = (
        _within(*(f"{one[key]:z.2f}" for key in ("value", "low", "high")))
        for one in (found["spearman"], share)
    )
    return name, rank, "may be chance" if chance else part


def _within(value: str, low: str | None, high: str | None) -> str:
    """A value and its interval, an end of which may be unknown."""
    if high is None or low is None:
        return (
            value
            if high == low
            else f"{value} ({low} or more)"
            if high is None
            else f"{value} ({high} or less)"
        )
    return value if value == low == high else f"{value} ({low} to {high})"
