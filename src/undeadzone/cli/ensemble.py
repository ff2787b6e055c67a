"""undeadzone ensemble SCENARIO.toml"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    common,
    confined,
    print_json,
    print_pairs,
    print_table,
    progress,
    say,
    writable,
)

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
    help="Compute on N processes of this computer; the bits are the same.",
)
@click.option(
    "--cluster",
    default=None,
    metavar="ADDRESS",
    help="Compute on the Dask cluster whose scheduler is there, such as tcp://10.0.0.1:8786 "
    "(needs the extra dask; docs/security.md says what is trusted).",
)
@click.option(
    "--parquet",
    is_flag=True,
    help="Write runs.parquet instead of runs.npz (needs the extra parquet).",
)
@confined
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
    confine: Path | None,
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
    from undeadzone.ensemble.run_ensemble import run_ensemble
    from undeadzone.scenario.reader import read

    varied = _sized(read(scenario, confine), runs)
    total = varied.ensemble.runs if varied.ensemble else None
    folder = writable(out if out is not None else Path(f"{scenario.stem}-ensemble"))
    path = folder / ("runs.parquet" if parquet else "runs.npz")
    with progress("running", total, "runs") as advance:
        result = run_ensemble(
            varied, path, resume=resume, workers=workers, cluster=cluster, progress=advance
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


def _sized(scenario: Scenario, runs: int | None) -> Scenario:
    """The scenario with that many runs. Raises InputError."""
    import msgspec

    from undeadzone.errors import InputError

    if runs is None or scenario.ensemble is None:
        return scenario
    if runs < 1:
        raise InputError(f"--runs: expected 1 or more, found {runs}")
    ensemble = msgspec.structs.replace(scenario.ensemble, runs=runs)
    return msgspec.structs.replace(scenario, ensemble=ensemble)


def _print(result: Ensemble, summary: dict[str, Any], folder: Path, written: list[Path]) -> None:
    """Print what an ensemble came to."""
    info = result.info
    sampling = info.sampling.replace("_", " ")
    say(
        f"{info.title}: {info.runs:,} run{'s' * (info.runs > 1)} of {info.duration:g} s, "
        f"{sampling} sampling, seed {info.seed}"
    )
    say()
    print_pairs(_shares(result, summary))
    if summary["metrics"]:
        say()
        print_table(_quantiles(result, summary["metrics"]))
    if summary["sensitivities"]:
        say()
        entries = list(summary["sensitivities"].items())[:SHOWN]
        heads = ("what decides rms z - r", "rank correlation", "share of the variance")
        print_table([heads, *(_decides(name, entry) for name, entry in entries)])
    say()
    worst = [row["run"] for row in summary["worst"]][:SHOWN]
    print_pairs(
        {
            "worst runs": ", ".join(map(str, worst)),
            "see one": f"undeadzone run {shlex.quote(str(written[0]))} --replay {worst[0]}",
            "written": f"{folder}: {', '.join(path.name for path in written)}",
        }
    )


def _shares(result: Ensemble, summary: dict[str, Any]) -> dict[str, str]:
    """The shares of runs that settle and that diverge."""
    from undeadzone.simulation.run import LAST

    info, diverged = result.info, summary["diverged"]
    lasts = f"for the last {LAST:g} s" if info.duration > LAST else "at the end"
    which = ""
    if diverged["runs"]:
        runs = _listed(diverged["runs"], int(result.diverged.sum()))
        which = f": {runs}; left out of what follows"
    return {
        "settled": (
            f"{_share(summary['settled'])}: |z - r| within {100 * info.tolerance:g} % of the "
            f"largest |r| {lasts}"
        ),
        "diverged": f"{_share(diverged)}{which}",
    }


def _quantiles(result: Ensemble, metrics: dict[str, Any]) -> list[tuple[str, ...]]:
    """The table of quantiles of each metric."""
    from undeadzone.report.style import label

    rows: list[tuple[str, ...]] = [
        ("95 % intervals in ()", "median", "95 % of runs below", "99 % of runs below")
    ]
    for key, name in METRICS.items():
        if key in metrics:
            quantiles = [_interval(metrics[key][column]) for column in ("median", "p95", "p99")]
            rows.append((label(name, result.unit(key)), *quantiles))
    return rows


def _listed(runs: list[int], total: int) -> str:
    """The first runs of a list."""
    names = ", ".join(map(str, runs[:SHOWN]))
    return f"run{'s' * (total > 1)} {names}{', ...' * (total > SHOWN)}"


def _share(share: dict[str, Any]) -> str:
    """A share and its interval in percent; one end of which is left out at 0 % and at 100 %."""
    value, low, high = (f"{100 * share[key]:.3g} %" for key in ("value", "low", "high"))
    if share["value"] <= 0:
        return _within(value, None, high if share["value"] < 1 else None)
    return _within(value, low, high if share["value"] < 1 else None)


def _interval(metric: dict[str, Any]) -> str:
    """A metric and its interval; a settling time without a bound is one that is never over."""
    low, high = _number(metric["low"]), _number(metric["high"])
    if metric["value"] is not None:
        return _within(f"{metric['value']:.4g}", low, high)
    return "never settles" if low is None else f"never settles (or after {low})"


def _number(value: float | None) -> str | None:
    """A number to four digits; None where there is none."""
    return None if value is None else f"{value:.4g}"


def _decides(name: str, entry: dict[str, Any]) -> tuple[str, str, str]:
    """What an entry decides: its rank correlation, and its share of the variance."""
    share = entry["total_order"] or entry["first_order"]
    chance = entry["floor"] is not None and share["value"] < entry["floor"]
    rank = _in_hundredths(entry["spearman"])
    return name, rank, "may be chance" if chance else _in_hundredths(share)


def _in_hundredths(value: dict[str, float]) -> str:
    """A value and its interval, with two decimals."""
    return _within(*(f"{value[key]:z.2f}" for key in ("value", "low", "high")))


def _within(value: str, low: str | None, high: str | None) -> str:
    """A value and its interval, an end of which may be unknown."""
    if low is None and high is None:
        return value
    if high is None:
        return f"{value} ({low} or more)"
    if low is None:
        return f"{value} ({high} or less)"
    return value if value == low == high else f"{value} ({low} to {high})"
