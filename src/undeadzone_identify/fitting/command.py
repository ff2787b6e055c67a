"""undeadzone fit SCENARIO.toml LOG ..."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

import undeadzone as uz
from undeadzone.cli.common import (
    READ,
    build_origin,
    columns_option,
    flag_option,
    force_option,
    shell_command,
    strict_option,
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
from undeadzone.util.progress import terminal_progress as progress


@click.command(
    epilog="Example: undeadzone fit pendulum.toml log.csv --free plant.mass,sensor.right=0..0.5"
)
@value_option("--free", "ADDRESS[=LO..HI],...", "Numbers to fit, with their ranges.", required=True)
@value_option(
    "--x0",
    None,
    "Whether x(0) is fitted too, or known from the scenario.",
    type=click.Choice(["free", "known"]),
    default="free",
)
@value_option("--seed", "N", "Seed of the starts of the search.", type=int, default=1)
@value_option(
    "--arm", "ARM.toml", "Write the gears found for a joint of this arm to DIR/ARM.toml.", type=READ
)
@value_option("--joint", "NAME", "Joint of --arm.")
@columns_option
@strict_option
@flag_option("--resume", "Continue a search that was stopped, from DIR/fitted.toml.partial.")
@force_option
@add_scenario_options
@click.argument("logs", nargs=-1, required=True, type=READ, metavar="LOG ...")
def fit(
    scenario: Path,
    logs: tuple[Path, ...],
    free: str,
    x0: Literal["free", "known"],
    seed: int,
    arm: Path | None,
    joint: str | None,
    columns: str | None,
    strict: bool,
    resume: bool,
    force: bool,
    confine: Path | None,
    output: Output,
) -> bool:
    """Estimate numbers of a scenario from logs of a real plant.

    A number is named by its address: plant.mass of formulas, plant.A[1,0], sensor.right,
    actuator.left, sensor.noise, disturbance.rms, plant.arm.gears.half[0], plant.delay=0..5. Without
    an index an address stands for all entries. [plant], [sensor], [actuator] and [disturbance]
    describe what made the log, [observer] is not used.

    Prints each number with its 95 % interval, and whether the log contradicts the scenario. Silent
    readings count: z is inside the zone. Writes fitted.toml, the scenario with these numbers, and a
    figure and report.html to DIR (default: NAME-fit). With --arm it writes an arm's scenario too,
    in which these gears are a joint's, for run. With --no-figures and no --out it writes nothing.
    Stages of the search are kept in DIR: after Ctrl-C, kill or a crash --resume goes on.

    Exit code 1: the log contradicts the scenario, or determines no number.
    """
    from undeadzone.scenario.reader import read_for_logs
    from undeadzone.util.own_files import require_own_file
    from undeadzone_identify.fitting.joint import GEARS, read_place, write_arm

    folder = output.choose_folder(f"{scenario.stem}-fit")
    if (arm is None) is not (joint is None):
        raise click.UsageError("--arm and --joint name a joint of an arm together")
    place = None if arm is None else read_place(arm, joint or "")
    if place is not None and folder is None:
        raise click.UsageError("--arm writes a file to DIR: give --out DIR")
    if folder is not None:
        require_own_file(folder / "fitted.toml", force)
    fitted = read_for_logs(scenario, confine)
    keep = partial_file(folder, "fitted.toml", resume)
    with progress("fitting", None) as advance:
        result = uz.fit(
            fitted,
            list(logs),
            free,
            columns=columns,
            strict=strict,
            x0=x0,
            seed=seed,
            keep=keep,
            resume=resume,
            progress=advance,
        )
    written = [] if folder is None else [result.save(folder / "fitted.toml")]
    discard_partial(keep)
    if folder is not None and output.figures:
        from undeadzone_identify.fitting.page import write_fit

        written += write_fit(result, folder, build_origin(scenario, seed))
    steps = []
    if place is not None and folder is not None:
        written.append(write_arm(result, place, folder, force))
        steps.append(shell_command("undeadzone", "run", written[-1]))
    elif written:
        steps.append(shell_command("undeadzone", "estimate", written[0], logs[0], columns=columns))
        if any(each.name.startswith(GEARS) for each in result.numbers):
            steps.append("with --arm ARM.toml --joint NAME these gears become a joint's")
    last = files_line(written) | next_line(*steps)
    output.print_result(result.summary, result.blocks, written, last)
    return result.consistent and any(each.shown for each in result.numbers)
