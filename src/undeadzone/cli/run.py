"""undeadzone run SCENARIO.toml"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import common, print_json, print_pairs, progress, yes_no

if TYPE_CHECKING:
    from undeadzone.simulation.run import Run

TIP = "The tip against its path, its distance from it, and the torques."
PHASE = "Position and velocity of each joint, truth and estimate, over its dead zone."


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
@common
def run(
    scenario: Path,
    replay: int | None,
    animation: Path | None,
    out: Path | None,
    as_json: bool,
    no_figures: bool,
) -> int:
    """Simulate a scenario: its plant behind its dead zone, watched by its observer, driven by its controller.

    Prints the errors over the last 2 s, the final widths, what can be known of them, and whether a certificate
    holds. Writes run.npz, run.csv, figure.png and report.html to DIR (default: NAME-results);
    with --no-figures and no --out it writes nothing. Exit code 1: it diverged, or its widths cannot be identified.

    undeadzone run DIR/runs.npz --replay NUMBER shows a run of an ensemble in the same way (default folder:
    run-NUMBER-results), computed again with its own numbers and noise, and says whether it met them to the last bit.
    """
    if animation is not None:
        from undeadzone.report.animation import require_movie

        require_movie(animation)
    (result, rival), apart = (
        (_simulated(scenario, animation is not None), None)
        if replay is None
        else _replayed(scenario, replay)
    )
    name = scenario.stem if replay is None else f"run-{replay}"
    folder = out if out is not None else None if no_figures else Path(f"{name}-results")
    written = write(result, folder, not no_figures, rival) if folder is not None else []
    if animation is not None:
        written.append(_animated(result, rival, animation))
    summary = result.summary() | ({} if rival is None else {"compare": rival.summary()})
    if as_json:
        again = {} if replay is None else {"replayed": {"run": replay, "deviation": apart}}
        print_json(summary | again | {"files": [str(path) for path in written]})
    else:
        _print(result, written, apart, rival)
    return (
        0 if result.diverged_at is None and (result.fully_identifiable or not result.adapts) else 1
    )


def _simulated(path: Path, animated: bool) -> tuple[Run, Run | None]:
    """The run of a scenario, and of the same with the observer that it is to be compared with; animated: only an arm's."""
    import dataclasses

    import msgspec

    from undeadzone.errors import InputError
    from undeadzone.scenario.reader import read
    from undeadzone.simulation.simulate import simulate

    if path.suffix in (".npz", ".parquet"):
        raise InputError(
            f"{path}: not a scenario; to see one of the runs of an ensemble add --replay and its number"
        )
    scenario = read(path)
    if scenario.ensemble is not None:
        from undeadzone.ensemble.binding import require_bound

        require_bound(scenario)
    if animated and scenario.plant.arm is None:
        raise InputError("animation: this plant is no arm; leave the option out")
    both = (
        [scenario]
        if scenario.compare is None
        else [scenario, msgspec.structs.replace(scenario, observer=scenario.compare)]
    )
    each = 3 if scenario.simulation.time == "continuous" else 1
    with progress(
        "simulating",
        round(
            len(both) * each * scenario.simulation.duration / max(scenario.simulation.step, 1e-12)
        ),
    ) as advance:
        runs = [simulate(one, progress=advance) for one in both]
    if scenario.compare is None:
        return runs[0], None
    names = _told_apart(scenario.observer, scenario.compare)
    first, second = (
        dataclasses.replace(run, info=msgspec.structs.replace(run.info, label=name))
        for run, name in zip(runs, names, strict=True)
    )
    return first, second


def _told_apart(first: Any, second: Any) -> tuple[str, str]:
    """Names of two observers: their methods, and, where these are the same, one option that differs, a switch before all others."""
    from undeadzone.support.toml import tables

    one, other = tables(first), tables(second)
    differing = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    telling = (
        "method"
        if "method" in differing
        else min(
            differing,
            key=lambda name: True not in (one.get(name), other.get(name)),
            default="method",
        )
    )
    return _told(one, telling), _told(other, telling)


def _told(options: dict[str, Any], name: str) -> str:
    """A method and one of its options in words."""
    value = options.get(name)
    if name == "method" or value in (None, False, {}):
        return str(options["method"])
    return f"{options['method']}, {name}" + (
        ""
        if value is True
        else f" {', '.join(value)}"
        if isinstance(value, dict)
        else f" = {value}"
    )


def _replayed(path: Path, number: int) -> tuple[tuple[Run, None], float]:
    """A run of an ensemble, and how far it lies from what it was there."""
    from undeadzone.ensemble.result import Ensemble
    from undeadzone.ensemble.run_ensemble import deviation, replay_run

    ensemble = Ensemble.load(path)
    return (replay_run(ensemble, number), None), deviation(ensemble, number)


def _animated(result: Run, rival: Run | None, path: Path) -> Path:
    from undeadzone.report.animation import frames, movie

    with progress("drawing", frames(result), "frames") as advance:
        return movie(result, rival, path, advance)


def write(result: Run, folder: Path, figures: bool, rival: Run | None = None) -> list[Path]:
    """The files of a run: signals always, figure and page where wanted, with a rival's run beside it if there is one."""
    written = [result.save(folder / "run.npz"), result.save(folder / "run.csv")]
    if figures:
        from undeadzone.report.figures import overview
        from undeadzone.report.html import run_page
        from undeadzone.report.style import write as write_figure
        from undeadzone.support.files import write_text

        figure = overview(result)
        written.append(write_figure(figure, folder / "figure.png"))
        first: list[Any] = []
        if result.poses is not None:
            from undeadzone.report.animation import animated
            from undeadzone.report.arm_figures import phase, tip
            from undeadzone.report.html import picture
            from undeadzone.report.style import png

            drawn = {"tip": tip(result, rival), "phase": phase(result)}
            written += [
                write_figure(panel, folder / f"{name}.png") for name, panel in drawn.items()
            ]
            first = [
                animated(result, rival),
                picture(png(drawn["tip"]), TIP),
                picture(png(drawn["phase"]), PHASE),
            ]
        written.append(write_text(run_page(result, [figure], rival, first), folder / "report.html"))
    return written


def _print(result: Run, written: list[Path], apart: float | None, rival: Run | None) -> None:
    summary = result.summary()
    unit = result.info.units.output
    shown: dict[str, Any] = {
        "scenario": summary["title"],
        "observer": f"{summary['method']}, {summary['time']} time, step {summary['step']:g} s",
        "rms z - r": f"{result.rms_tracking:.4g} {unit} (last 2 s)",
        "rms z - z^": f"{result.rms_estimation:.4g} {unit} (last 2 s)",
        **(
            {}
            if result.rms_tip is None
            else {"rms tip": f"{result.rms_tip:.4g} m from its path (last 2 s)"}
        ),
        "d_right": _widths(result, 0),
        "d_left": _widths(result, 1),
        **{
            name: f"{found['estimate']:.4g} ± {found['std']:.2g} (true {found['true']:g})"
            for name, found in result.parameters.items()
        },
        "silent": f"{100 * result.silent_fraction:.1f} % of the time",
    }
    if summary["certified"] is not None:
        rise = summary["largest_rise_of_V"]
        holds = "holds for an exact model without noise or disturbance"
        if rise is not None:
            holds += f"; along this run V rose by at most {rise:.1g} of its peak"
        shown["certificate"] = (
            holds
            if summary["certified"]
            else "none found for these gains; undeadzone check says why"
        )
    if summary["integration_error"] is not None:
        shown["integration"] = f"error {summary['integration_error']:.2g} (against half the step)"
    for output, verdict in zip(result.outputs, result.info.identifiable, strict=True):
        where = (
            f" of {'' if result.info.joints else 'output '}{output}"
            if len(result.info.identifiable) > 1
            else ""
        )
        shown[f"identifiable{where}"] = "; ".join([yes_no(verdict), *verdict["reasons"]])
    if rival is not None:
        shown["compared"] = _compared(rival)
    if result.diverged_at is not None:
        shown["DIVERGED"] = f"at {result.diverged_at:g} s"
    if apart is not None:
        shown["replayed"] = (
            "as in the ensemble, to the last bit"
            if apart == 0
            else f"off by {apart:.1g} of the ensemble: another processor or version"
        )
    if written:
        shown["written"] = ", ".join(map(str, written))
    print_pairs(shown)


def _compared(rival: Run) -> str:
    """What a rival's run came to."""
    if rival.diverged_at is not None:
        return f"{rival.name} diverges at {rival.diverged_at:g} s"
    tip = "" if rival.rms_tip is None else f", tip {rival.rms_tip:.4g} m"
    return f"{rival.name}: rms z - r {rival.rms_tracking:.4g} {rival.info.units.output}{tip}"


def _widths(result: Run, edge: int) -> str:
    """The final estimates of one edge (0 right, 1 left) of each output, their standard deviations where known, the truth."""
    std = (
        ""
        if result.d_std is None
        else f" ± {', '.join(f'{value:.2g}' for value in result.d_std[-1, edge::2])}"
    )
    return f"{_listed(result.widths[:, edge])}{std} (true {_listed(result.info.widths[edge::2])})"


def _listed(widths: Iterable[float]) -> str:
    return ", ".join(f"{width:.6g}" for width in widths)
