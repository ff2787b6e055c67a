"""undeadzone run SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    common,
    confined,
    csv_option,
    folder_for,
    named_files,
    origin,
    prepare_figures,
    print_blocks,
    print_json,
    wanted_table,
    writable,
)
from undeadzone.cli.untrusted import untrusted
from undeadzone.support.progress import on_terminal as progress

if TYPE_CHECKING:
    from undeadzone.report.html import Origin
    from undeadzone.results.run import Run
    from undeadzone.scenario.schema import Scenario

OF_ENSEMBLE = (".npz", ".parquet")  # files that hold runs, no scenario


@click.command(
    epilog="Example: undeadzone init mine.toml && undeadzone run mine.toml --out results"
)
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--replay",
    type=int,
    default=None,
    metavar="NUMBER",
    help="Show a run of an ensemble, whose file stands for SCENARIO.toml.",
)
@click.option(
    "--animation",
    type=click.Path(path_type=Path),
    default=None,
    metavar="FILE",
    help="Write an arm's motion as .gif (or .mp4, with ffmpeg) too.",
)
@csv_option
@untrusted
@confined
@common
def run(
    scenario: Path,
    replay: int | None,
    animation: Path | None,
    as_csv: bool,
    out: Path | None,
    as_json: bool,
    no_figures: bool,
    confine: Path | None,
) -> int:
    """Simulate a scenario: a plant behind its dead zone, an observer, a controller.

    Prints the errors over the last 2 s, the final widths, what can be known of them, and whether a
    certificate holds. Writes run.npz, run.csv (if it has at most 10 MB), figure.svg and report.html
    to DIR (default: NAME-results); with --no-figures and no --out it writes nothing. Exit code 1:
    it diverged, half the step changes it by more than 1 %, or its widths cannot be identified.

    undeadzone run DIR/runs.npz --replay NUMBER shows a run of an ensemble in the same way (default
    folder: run-NUMBER-results), computed again with its own numbers and noise, and says whether it
    met them to the last bit.
    """
    if animation is not None:
        prepare_figures()
        from undeadzone.report.animation import require_movie

        require_movie(animation)
        writable(animation.parent)
    rival: Run | None = None
    deviation: float | None = None
    name = scenario.stem if replay is None else f"run-{replay}"
    folder = folder_for(out, no_figures, f"{name}-results")
    if replay is None:
        result, rival = _simulated(scenario, animation is not None, confine)
    else:
        result, deviation = _replayed(scenario, replay, confine)
    given = origin(scenario if replay is None else None, result.info.seed)
    again = given if given.scenario else given._replace(scenario=result.info.scenario)
    tables, left_out = wanted_table(as_csv, result.table_size, "run.csv")
    written = _written(result, rival, folder, animation, not no_figures, tables, again)
    if as_json:
        summary = result.summary()
        if rival is not None:
            summary["compare"] = rival.summary()
        if replay is not None:
            summary["replayed"] = {"run": replay, "deviation": deviation}
        print_json(summary, written)
    else:
        left_out = left_out if folder is not None else {}
        _print(result, deviation, rival, named_files(written) | left_out)
    known = result.fully_identifiable or not result.adapts
    sound = result.diverged_at is None and not result.inexact
    return 0 if sound and known else 1


def _simulated(path: Path, animated: bool, confine: Path | None) -> tuple[Run, Run | None]:
    """The run of a scenario, and that of the observer that it is to be compared with.

    Args:
        path: of the scenario.
        animated: whether a film is wanted, which only an arm's run gives.
        confine: a folder outside of which the scenario may name no file; None: any.
    """
    from undeadzone.errors import InputError
    from undeadzone.scenario.reader import read
    from undeadzone.simulation.listening import heard
    from undeadzone.simulation.simulate import beside

    if path.suffix in OF_ENSEMBLE:
        raise InputError(
            f"{path}: not a scenario; to see one of the runs of an ensemble add --replay and its "
            "number"
        )
    scenario = read(path, confine)
    if scenario.ensemble is not None:
        from undeadzone.ensemble.binding import require_bound

        require_bound(scenario)
    if animated and scenario.plant.arm is None:
        raise InputError("animation: this plant is no arm; leave the option out")
    with progress("simulating", _steps(scenario)) as advance:
        result = heard(scenario, advance)
        return (result, None) if scenario.compare is None else beside(scenario, result, advance)


def _steps(scenario: Scenario) -> int:
    """How many steps are simulated: of each observer, of its twin of half the step, of `heard`."""
    from undeadzone.simulation.simulate import steps

    observers = 1 if scenario.compare is None else 2
    return observers * steps(scenario) + steps(scenario, check_step=False)


def _replayed(path: Path, number: int, confine: Path | None) -> tuple[Run, float]:
    """A run of an ensemble, and how far it lies from what it was there.

    Args:
        path: of the ensemble.
        number: of the run.
        confine: a folder outside of which the ensemble's scenario may name no file; None: any.
    """
    from undeadzone.ensemble.result import Ensemble
    from undeadzone.ensemble.run_ensemble import deviation, replay_run

    ensemble = Ensemble.load(path)
    if confine is not None:
        from undeadzone.scenario.reader import confined as kept_inside
        from undeadzone.scenario.reader import parse

        kept_inside(parse(ensemble.info.scenario), confine)
    return replay_run(ensemble, number), deviation(ensemble, number)


def _written(
    result: Run,
    rival: Run | None,
    folder: Path | None,
    animation: Path | None,
    figures: bool,
    tables: bool,
    again: Origin,
) -> list[Path]:
    """The files of a run, once they are written."""
    written = []
    if folder is not None:
        from undeadzone.report.run_page import write_run

        written += write_run(result, folder, figures, rival, tables, again)
    if animation is not None:
        from undeadzone.report.animation import frames, movie

        with progress("drawing", frames(result), "frames") as advance:
            written.append(movie(result, rival, animation, advance))
    return written


def _print(result: Run, deviation: float | None, rival: Run | None, files: dict[str, Any]) -> None:
    """Print what a run came to; files: the lines on what was written."""
    last = {}
    if rival is not None:
        last["compared"] = _compared(rival)
    if deviation == 0:
        last["replayed"] = "as in the ensemble, to the last bit"
    elif deviation is not None:
        last["replayed"] = f"off by {deviation:.1g} of the ensemble: another processor or version"
    print_blocks(result.blocks(), last | files)


def _compared(rival: Run) -> str:
    """What a rival's run came to."""
    from undeadzone.support.text import with_unit

    if rival.diverged_at is not None:
        return f"{rival.name} diverges at {rival.diverged_at:g} s"
    tip = "" if rival.rms_tip is None else f", tip {rival.rms_tip:.4g} m"
    rms = with_unit(f"{rival.rms_tracking:.4g}", rival.info.units.output)
    return f"{rival.name}: rms z - r {rms}{tip}"
