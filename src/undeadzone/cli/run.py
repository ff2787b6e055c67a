"""undeadzone run SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import click

import undeadzone as uz
from undeadzone.cli.common import (
    build_origin,
    force_option,
    shell_command,
    value_option,
)
from undeadzone.cli.output import (
    Output,
    add_scenario_options,
    csv_option,
    decide_table,
    export_command,
    files_line,
    next_line,
    require_own_table,
)
from undeadzone.errors import InputError
from undeadzone.util.installed import load_registered
from undeadzone.util.progress import terminal_progress as progress
from undeadzone.util.text import HALF_95, append_unit

WIDE: Final = 0.2  # half of an interval, in widths: above it the remedy is printed
# The assumptions that narrow intervals most, the usual one first.
NARROWING: Final = ("disturbance", "bias", "centre")
ENSEMBLES = "undeadzone.ensembles"  # entry points of the package that runs ensembles
OF_ENSEMBLE = (".npz", ".parquet")  # files that hold runs, no scenario


@click.command(
    epilog="Example: undeadzone init mine.toml && undeadzone run mine.toml --out results"
)
@value_option(
    "--replay",
    "NUMBER",
    "Show a run of an ensemble, whose file stands for SCENARIO.toml.",
    type=int,
)
@csv_option
@force_option
@add_scenario_options
def run(
    scenario: Path,
    replay: int | None,
    as_csv: bool,
    force: bool,
    output: Output,
    confine: Path | None,
) -> bool:
    """Simulate a scenario: a plant behind its dead zone, an observer, a controller.

    Prints the errors over the last 2 s, the final widths with intervals, their identifiability, and
    whether a certificate holds. Writes run.npz, run.csv (up to 10 MB), figure.svg and report.html
    to DIR (default: NAME-results), and gears.xml for MuJoCo if the plant has gears. With
    --no-figures and without --out and --csv it writes nothing.

    Exit code 1: it diverged, half the step changes it by more than 1 %, or its widths cannot be
    identified.

    undeadzone run DIR/runs.npz --replay NUMBER repeats a run of an ensemble with its own numbers
    and noise (default folder: run-NUMBER-results), and reports whether every bit agrees.
    """
    rival: uz.Run | None = None
    deviation: float | None = None
    follow: dict[str, str] = {}
    name = scenario.stem if replay is None else f"run-{replay}"
    folder = output.choose_folder(f"{name}-results", as_csv)
    require_own_table(folder, "run.csv", force)
    if replay is None:
        loaded_scenario = _read_scenario(scenario, confine)
        result, rival = _simulate_and_compare(loaded_scenario)
        follow = _advise_after_run(scenario, loaded_scenario, result)
    else:
        with progress("replaying", None):
            result, deviation = load_registered(ENSEMBLES, "replay_saved")(
                scenario, replay, confine
            )
    given = build_origin(scenario if replay is None else None, result.info.seed)
    again = given if given.scenario else given._replace(scenario=result.info.scenario)
    tables, left_out = decide_table(as_csv, result.table_size, "run.csv")
    written: list[Path] = []
    if folder is not None:
        from undeadzone.report.run_page import write_run

        written += write_run(result, folder, output.figures, rival, tables, again)
        if result.info.sensor == "gears":
            from undeadzone.results import mjcf

            written += mjcf.write_gears(mjcf.joints_from_run(result), folder)
    files = files_line(written) | (left_out if folder is not None else {})
    output.print_result(
        lambda: _outcome_to_json(result, rival, replay, deviation),
        result.blocks,
        written,
        _describe_rival(rival) | _describe_replay(deviation) | files | follow,
    )
    return _is_successful(result)


def _is_successful(run: uz.Run) -> bool:
    """Return whether a run succeeded: exit code 0."""
    known = run.fully_identifiable or not run.adapts
    return run.divergence_time is None and not run.inexact and known


def _advise_after_run(path: Path, scenario: uz.Scenario, run: uz.Run) -> dict[str, str]:
    """Return the next commands after a run, first the remedy for wide intervals."""
    import numpy as np

    check = f"{shell_command('undeadzone', 'check', path)} shows which widths can be known"
    if not _is_successful(run):
        return next_line(check)
    if run.d_std is None or (HALF_95 * run.d_std[-1] <= WIDE * np.abs(run.d_hat[-1])).all():
        return next_line(check, *export_command(path, scenario))
    observer = scenario.observer
    open_assumptions = [
        name for name in NARROWING if getattr(observer, name, "no such assumption") is None
    ]
    narrower = f"narrower intervals: declare observer.{', '.join(open_assumptions)} if known"
    return next_line(*[narrower] * bool(open_assumptions), check)


def _read_scenario(path: Path, confine: Path | None) -> uz.Scenario:
    """Return the scenario that is to run. Raises InputError.

    Args:
        path: of the scenario.
        confine: a folder outside of which the scenario may name no file (None: any).
    """
    if path.suffix in OF_ENSEMBLE:
        raise InputError(
            f"{path}: not a scenario. To see one of the runs of an ensemble add --replay and its "
            "number"
        )
    return uz.read(path, confine)


def _simulate_and_compare(scenario: uz.Scenario) -> tuple[uz.Run, uz.Run | None]:
    """Return the run of a scenario, and the run of the observer under comparison, or None."""
    from undeadzone.simulation.feedback import measure_feedback
    from undeadzone.simulation.simulate import beside

    with progress("simulating", _count_simulated_steps(scenario), of=scenario.observer) as advance:
        if scenario.ensemble is not None:
            load_registered(ENSEMBLES, "require_bound")(scenario)
        result = measure_feedback(scenario, advance)
        return (result, None) if scenario.compare is None else beside(scenario, result, advance)


def _count_simulated_steps(scenario: uz.Scenario) -> int:
    """Return the number of simulated steps over all observers and repetitions."""
    from undeadzone.simulation.simulate import count_progress_steps

    observers = 1 if scenario.compare is None else 2
    return observers * count_progress_steps(scenario) + count_progress_steps(
        scenario, check_step=False
    )


def _outcome_to_json(
    result: uz.Run, rival: uz.Run | None, replay: int | None, deviation: float | None
) -> dict[str, Any]:
    """Return the numbers of a run for JSON."""
    summary = result.summary()
    if rival is not None:
        summary["compare"] = rival.summary()
    if replay is not None:
        summary["replayed"] = {"run": replay, "deviation": deviation}
    return summary


def _describe_replay(deviation: float | None) -> dict[str, str]:
    """Return the deviation of a run from the run in its ensemble, as text."""
    if deviation is None:
        return {}
    if deviation == 0:
        return {"replayed": "as in the ensemble, to the last bit"}
    return {"replayed": f"off by {deviation:.1g} of the ensemble: another processor or version"}


def _describe_rival(rival: uz.Run | None) -> dict[str, str]:
    """Return the errors of the run under comparison, as text."""
    if rival is None:
        return {}
    if rival.divergence_time is not None:
        return {"compared": f"{rival.observer_name} diverges at {rival.divergence_time:g} s"}
    tip = "" if rival.rms_tip is None else f", tip {rival.rms_tip:.4g} m"
    rms = append_unit(f"{rival.rms_tracking:.4g}", rival.info.units.output)
    return {"compared": f"{rival.observer_name}: rms z - r {rms}{tip}"}
