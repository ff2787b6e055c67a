"""Command `undeadzone arena [SCENARIO.toml ...]`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from undeadzone.cli.common import (
    READ,
    WRITTEN_FOLDER,
    add_guards,
    build_origin,
    flag_option,
    force_option,
    print_blocks,
    print_json,
    print_line,
    require_writable,
    value_option,
)
from undeadzone.cli.output import (
    discard_partial,
    files_line,
    json_option,
    prepare_figures,
    report_fresh_start,
)
from undeadzone.util.progress import terminal_progress as progress

if TYPE_CHECKING:
    from undeadzone.scenario.schema import Scenario
    from undeadzone_arena.contest.contest import Contest
    from undeadzone_arena.contest.tuned_file import Tuned

FOLDER = Path("arena-results")


@click.command(
    epilog="Example: undeadzone arena mine.toml --methods censored,adaptive_inverse,ekf --html"
)
@click.argument("scenarios", type=READ, metavar="[SCENARIO.toml ...]", nargs=-1)
@value_option(
    "--methods", "A,B,...", "Only these (default: all), and the lines that make a regret."
)
@value_option(
    "--seeds",
    "N",
    "Runs of each method on each scenario.",
    type=click.IntRange(1),
    default=3,
    show_default=True,
)
@value_option(
    "--set",
    None,
    "Set of scenarios of the arena, if you give none (default: dead_zones).",
    "chosen",
    type=click.Choice(("dead_zones", "plays", "both_ends")),
)
@flag_option("--html", "Write results.json, figures and report.html to DIR.")
@value_option(
    "--out",
    "DIR",
    f"Folder for the files written, implies --html (default: {FOLDER}).",
    type=WRITTEN_FOLDER,
)
@json_option
@flag_option(
    "--tune",
    "Find the methods' numbers on the tuning scenarios instead, and write DIR/tuned.toml.",
    "tuning",
)
@value_option(
    "--budget",
    "N",
    "With --tune: candidates of each method.",
    type=click.IntRange(2),
    default=60,
    show_default=True,
)
@value_option("--tuned", "FILE", "A tuned.toml to use in the place of the built-in one.", type=READ)
@value_option(
    "--processes",
    "N",
    "Number of processes (default: one per processor).",
    type=click.IntRange(1),
)
@flag_option(
    "--resume",
    "Continue an interrupted command from DIR/results.json.partial or tuned.toml.partial.",
)
@force_option
@add_guards
def arena(
    scenarios: tuple[Path, ...],
    methods: str | None,
    seeds: int,
    chosen: str | None,
    html: bool,
    out: Path | None,
    as_json: bool,
    tuning: bool,
    budget: int,
    tuned: Path | None,
    processes: int | None,
    resume: bool,
    force: bool,
    confine: Path | None,
) -> None:
    """Compare methods: each replaces the scenario's observer, with the same prior information.

    Without scenarios it uses those that the arena holds out. Methods are ranked by their regret on
    the hidden z - r: 0 knows state, plant and disturbance, 1 is wrong by half the zone. The table
    shows the median over the scenarios, and the worst, with 95 % intervals. The number of runs and
    their approximate time are printed on stderr first. Finished runs are kept in DIR: after Ctrl-C,
    kill or a crash --resume goes on. See docs/arena.md.
    """
    from undeadzone.util.own_files import require_own_file
    from undeadzone_arena.contest.contest import run_contest
    from undeadzone_arena.contest.entry import read_knob_numbers
    from undeadzone_arena.contest.leaderboard import FRAME
    from undeadzone_arena.contest.scenario_sets import SETS, scenarios_from_files
    from undeadzone_arena.contest.scenario_sets import arena_scenarios as built_in
    from undeadzone_arena.contest.trials import resolve_names

    if chosen and scenarios:
        raise click.UsageError("--set names scenarios of the arena. Leave your own out, or --set")
    _require_used_options(tuning)
    tuned_on, held_out = SETS[chosen or "dead_zones"]
    asked = None if methods is None else _parse_method_names(methods)
    own = scenarios_from_files(scenarios, confine)
    grounds = own or built_in(tuned_on if tuning else held_out)
    names = resolve_names(asked, grounds)
    folder = out or FOLDER
    writes = tuning or html or out is not None
    if tuning:
        require_own_file(require_writable(folder) / "tuned.toml", force)
        if resume:
            report_fresh_start(folder / "tuned.toml.partial")
        _run_tuning(names, grounds, budget, processes, folder, as_json, resume)
        return
    keep = folder / "results.json.partial" if _can_store_results(folder, writes) else None
    if resume and keep is not None:
        report_fresh_start(keep)
    every = list(dict.fromkeys([*FRAME, *names]))
    try:
        _announce(every, grounds, seeds, "seed", processes)
        with progress("arena", len(grounds) * seeds * len(every), "runs") as advance:
            rest = tuple(range(seeds)), read_knob_numbers(tuned), processes, advance, keep, resume
            contest = run_contest(names, grounds, *rest)
        if writes:
            prepare_figures()
        written = _write_results(contest, folder, bool(own)) if writes else []
        discard_partial(keep)
    finally:
        with suppress(OSError):  # it holds something
            folder.rmdir()
    if as_json:
        print_json(contest.summary(), written)
    else:
        print_blocks(contest.blocks(), files_line(written))


def _require_used_options(tuning: bool) -> None:
    """Raise UsageError for an option that would have no effect."""
    context = click.get_current_context()
    unused = ("seeds", "tuned", "html") if tuning else ("budget",)
    for name in unused:
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise click.UsageError(
                f"--{name} has no effect {'with' if tuning else 'without'} --tune. Leave it out"
            )


def _can_store_results(folder: Path, writes: bool) -> bool:
    """Return whether results can be stored in a folder meanwhile.

    Raises:
        FileError: it cannot, though something is to be written there anyway.
    """
    from undeadzone.errors import FileError

    try:
        require_writable(folder)
    except FileError as error:
        if writes:
            raise
        print_line(f"arena: nothing is kept meanwhile: {error}", err=True)
        return False
    return True


def _parse_method_names(methods: str) -> list[str]:
    """Parse a list of names separated by commas.

    Raises BadParameter if it is empty.
    """
    named = list(filter(None, map(str.strip, methods.split(","))))
    if not named:
        raise click.BadParameter(
            f"expected names with commas between them, found {methods!r}", param_hint="'--methods'"
        )
    return named


def _announce(names: list[str], grounds: dict[str, Scenario], runs: int, *more: Any) -> None:
    """Print the size of the work (more: name of a run, processes)."""
    from undeadzone_arena.contest.effort import effort_text

    print_line(f"arena: {effort_text(names, grounds, runs, *more)}", err=True)


def _run_tuning(
    names: list[str],
    grounds: dict[str, Scenario],
    budget: int,
    processes: int | None,
    folder: Path,
    as_json: bool,
    resume: bool,
) -> None:
    """Tune methods, write and print their numbers."""
    from undeadzone_arena.contest.methods import method_registry
    from undeadzone_arena.contest.tune import tune_methods
    from undeadzone_arena.contest.tuned_file import save_tuned

    adjustable = [name for name in names if method_registry()[name].knobs]
    _announce(adjustable, grounds, budget, "candidate", processes)
    partial = folder / "tuned.toml.partial"
    with progress("tuning", len(names), "methods") as advance:
        tuned = tune_methods(
            names,
            grounds,
            budget,
            processes=processes,
            progress=advance,
            keep=partial,
            resume=resume,
        )
    path = save_tuned(tuned, folder / "tuned.toml")
    partial.unlink(missing_ok=True)
    if as_json:
        import msgspec

        print_json(msgspec.to_builtins(tuned), [path])
    else:
        _print_tuned(tuned, path)


def _write_results(contest: Contest, folder: Path, own: bool) -> list[Path]:
    """Write results, figures and page.

    For a user's own scenarios, also write each with its best method.
    """
    from undeadzone.errors import InputError
    from undeadzone.util import toml
    from undeadzone.util.files import write_text
    from undeadzone_arena.contest.page import write_arena
    from undeadzone_arena.contest.traces import trace_runs

    written = contest.save(folder / "results.json")
    written += write_arena(contest, trace_runs(contest), folder, build_origin(None))
    if own and contest.contestants:
        best = contest.contestants[0].method
        for title in contest.scenarios:
            try:
                text = toml.to_toml(contest.scenario(best, title))
            except InputError:
                continue
            written.append(write_text(text, folder / f"{title}-{best}.toml"))
    return written


def _print_tuned(tuned: Tuned, path: Path) -> None:
    """Print the numbers that tuning found."""
    rows = [("method", "mean regret", "candidates", "knobs")]
    for name, found in tuned.methods.items():
        regret = f"{found.before:.3f} -> {found.regret:.3f}"
        knobs = [f"{address} {value:.3g}" for address, value in found.knobs.items()]
        rows.append((name, regret, str(found.candidates), ", ".join(knobs)))
    print_blocks([rows], files_line([path]))
