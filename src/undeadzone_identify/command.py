"""Command `undeadzone identify LOG.csv ...`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    READ,
    WRITTEN,
    SubjectCommand,
    add_untrusted,
    build_origin,
    columns_option,
    flag_option,
    force_option,
    help_all,
    name_file_in_errors,
    require_writable,
    shell_command,
    strict_option,
    value_option,
)
from undeadzone.cli.output import (
    Output,
    add_output_options,
    discard_partial,
    files_line,
    partial_file,
)
from undeadzone.errors import InputError
from undeadzone.util.files import read_table, write_text
from undeadzone.util.progress import terminal_progress as progress

if TYPE_CHECKING:
    from undeadzone_identify.chain import FirmwareChain
    from undeadzone_identify.results.at_rest import IdentifiedAtRest
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.results.lost_motion import IdentifiedMotion
    from undeadzone_identify.results.next_log import NextLog
    from undeadzone_identify.results.result import Identified, IdentifiedOutputs

    Answers = Identified | IdentifiedOutputs | IdentifiedMotion | IdentifiedAtRest | IdentifiedLoop


KINDS = click.Choice(["auto", "deadzone", "jump", "play", "backlash"])
NOISES = click.Choice(["auto", "before", "after"])
PLACES = click.Choice(["auto", "sensor", "actuator", "plant"])


@click.command(
    cls=SubjectCommand,
    subjects=read_table(__file__)["subjects"],
    epilog="Example: undeadzone identify log.csv && undeadzone run log.toml",
)
@click.argument("logs", nargs=-1, required=True, type=READ, metavar="LOG [LOG ...]")
@columns_option
@value_option("--kind", None, "Nonlinearity at the output, or auto.", type=KINDS, default="auto")
@value_option(
    "--order", "N|LOW-HIGH", "Poles of the plant, or a range to choose from.", default="1-4"
)
@value_option("--right", "WIDTH", "d_r: known (0.5), within bounds (0.2,1) or inf (no such edge).")
@value_option("--left", "WIDTH", "d_l: known (0.5), within bounds (0.2,1) or inf (no such edge).")
@value_option("--zero", "READING", "Reading of the sensor inside its zone.", default=0.0)
@value_option("--integrators", None, "Poles at 0: 1 for a motor's position.", default=0)
@value_option("--offset", "RMS|free", "RMS of an offset of the output, or free.", default="0")
@value_option("--held-out", None, "Share of the log, at its end, for validation.", default=0.3)
@value_option("--noise", None, "Noise before or after the zone.", type=NOISES, default="auto")
@value_option(
    "--place",
    None,
    "Place of the zone: sensor, actuator, plant (friction).",
    type=PLACES,
    default="auto",
)
@value_option(
    "--delay",
    "N",
    "Samples by which the input acts later than the log has it; -1: earlier.",
    default="auto",
)
@value_option("--threshold", "|y|", "Largest |y| that counts as inside the zone.", type=float)
@value_option("--resample", "STEP", "Step [s] to put the samples on.", type=float)
@strict_option
@value_option(
    "--chain", "DIR", "Go on to firmware in DIR: check, estimate, export, replay.", type=WRITTEN
)
@value_option("--next", "FILE", "CSV of the input to record next.", "further", type=WRITTEN)
@flag_option("--resume", "Continue an interrupted command from DIR/identify.json.partial.")
@help_all
@force_option
@add_untrusted
@name_file_in_errors
@add_output_options
def identify(
    logs: tuple[Path, ...],
    output: Output,
    resume: bool,
    chain: Path | None,
    further: Path | None,
    force: bool,
    **options: Any,
) -> bool:
    """Find plant and dead zone from a log of a real plant.

    A log is a CSV file of any dialect (t, u, y with units in brackets), .npz, .mat or .jsonl.
    Several logs are records of one plant.

    Prints whether the sensor has a dead zone, the width of each side with its 95 % interval, the
    plant, and the fit on held-out data. Backlash, friction or a dead zone of the actuator is named
    and measured instead. Writes NAME.toml, a scenario for run, check, design and watch, and
    identify.json, figures and report.html to DIR (default: NAME-identify). With --no-figures and no
    --out it writes the scenario alone. Fits are kept in DIR: after Ctrl-C, kill or a crash --resume
    goes on.

    With --chain the scenario is checked, runs along the log, is exported to C, and the C runs along
    the log. It prints the distances of the reading and of the C's z^ from z.

    The answer has a grade: named, measured, indicated (a number with its doubts), or bounded (the
    largest effect that could hide). A table of commands and readings needs no times.

    Exit code 1: the answer lacks number and bound, or the firmware is refused.
    """
    from undeadzone.logs.names import require_table
    from undeadzone.util.own_files import require_own_file
    from undeadzone_identify.chain import compensating_lines
    from undeadzone_identify.fitting.motor import write_motor
    from undeadzone_identify.pipeline import identify as identified
    from undeadzone_identify.results.at_rest import IdentifiedAtRest
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.results.lost_motion import IdentifiedMotion
    from undeadzone_identify.results.result import WRITTEN, Identified

    first = logs[0]
    if chain is not None and len(logs) > 1:
        raise click.UsageError("--chain follows one log")
    folder = output.choose_folder(f"{first.stem}-identify")
    path = require_writable(output.out or Path()) / f"{first.stem}.toml"
    if chain is not None:
        require_writable(chain)
    require_table(str(first))
    for target in filter(None, (path, further)):
        require_own_file(target, force)
    keep = partial_file(folder, "identify.json", resume)
    with progress("identifying", None) as advance:
        names = list(map(str, logs))
        answer = identified(names, progress=advance, keep=keep, resume=resume, **options)
        motion = (
            answer
            if isinstance(answer, IdentifiedMotion | IdentifiedAtRest | IdentifiedLoop)
            else None
        )
        written: list[Path] = [] if folder is None else [answer.save(folder / "identify.json")]
        reason = None
        if motion is None and answer.verdict in (*WRITTEN, "dead_zone", "jump"):
            scenario, reason = _write_scenario_file(answer, path, force)
            written = scenario + written
        best, why = (None, {}) if further is None else _propose_next_input(answer)
        if further is not None and best is not None:
            written.append(write_text(best.input_table, further))
        if folder is not None and output.figures:
            written += _write_pages(answer, folder, first.name, best)
    discard_partial(keep)
    why |= {} if reason is None else {"no scenario": reason.removeprefix("scenario: ")}
    is_written = path in written
    driven = is_written and "[reference]" in path.read_text(encoding="utf-8")
    late = getattr(answer, "recorded_delay", 0)
    numbers = answer.numbers()
    if isinstance(answer, Identified):
        options["columns"] = options["columns"] or answer.answer.case.grid.guessed
    if any("resampled to" in one for one in numbers.get("remarks", ())):
        options |= {"resample": True}  # no command reads the log at another step
    follow = {"next": _next_commands(path, logs, options, driven, late)} if is_written else {}
    if folder is not None and not is_written and isinstance(answer, Identified):
        motor = folder / "motor.toml"
        free = write_motor(answer.answer.case.grid, motor, force)
        if free is not None:
            words = shell_command(
                "undeadzone", "fit", motor, *logs, columns=options["columns"], free=free
            )
            follow = {"next": f"{words}; if the encoder is the motor's: its gap, inertia, friction"}
            written.append(motor)
    lines = compensating_lines(numbers, first.name) if answer.account.is_certain else {}
    if folder is not None and lines:
        few = shell_command("undeadzone", "export", folder / "identify.json", "--to", "snippet")
        why |= {"few lines": f"{few} writes these in C, Python and Structured Text"}
    is_done = answer.account.says_something
    chain_numbers = {}
    if chain is not None:
        scenario_file = path if is_written else None
        firmware = _build_firmware(answer, numbers, scenario_file, first, chain, options, late)
        written = written + firmware.files
        is_done = firmware.passed
        why = why | firmware.words
        chain_numbers = {"chain": firmware.numbers} if firmware.numbers else {}
        if is_written:
            makes = shell_command("make", "-C", chain / "firmware")
            follow = {"next": f"{makes} builds the self-test"}
    shown = [{"in C": lines["snippet.h"].splitlines()}] if lines else []
    output.print_result(
        lambda: numbers | chain_numbers,
        lambda: [*answer.blocks(), *shown],
        written,
        why | files_line(written) | follow,
    )
    return is_done


def _build_firmware(
    answer: Answers,
    numbers: dict[str, Any],
    scenario: Path | None,
    log: Path,
    folder: Path,
    options: dict[str, Any],
    late: int,
) -> FirmwareChain:
    """Build tested firmware from the scenario, or a few lines that compensate a backlash.

    The lines need a gap of certain width, but no plant. If neither can be built, the result holds
    the reason.

    Args:
        answer: the identified log.
        numbers: those of the answer, as in identify.json.
        scenario: its scenario file (None: none was written).
        log: file of the log, along which the firmware is run.
        folder: of the firmware.
        options: of the command.
        late: samples by which the recording delays the inputs.
    """
    from undeadzone_identify.chain import (
        FirmwareChain,
        command_of_log,
        find_compensation,
        run_firmware_chain,
        run_snippet_chain,
    )
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.results.lost_motion import IdentifiedMotion
    from undeadzone_identify.results.result import Identified

    with progress("going on to firmware", None):
        if scenario is not None:
            reading_options = options["columns"], options["strict"]
            return run_firmware_chain(scenario, log, folder, *reading_options, late)
        lost_motion = find_compensation(numbers, log.name)
        if (
            lost_motion is None
            or lost_motion.kind != "backlash"
            or not isinstance(answer, IdentifiedMotion | Identified | IdentifiedLoop)
        ):
            reason = "impossible: it takes a scenario or a certain gap"
            return FirmwareChain({"firmware": reason}, {}, [], False)
        return run_snippet_chain(lost_motion, command_of_log(answer), folder)


def _next_commands(
    scenario: Path, logs: tuple[Path, ...], options: dict[str, Any], driven: bool, late: int = 0
) -> str:
    """Return the commands to type next, with the scenario that was written, as text.

    Args:
        scenario: file that was written.
        logs: that were read.
        options: of the command.
        driven: whether the plant has as many inputs as outputs. Else no controller can follow a
            reference, and `watch` takes the place of `run` and `export`.
        late: samples by which the recording delays the inputs.
    """
    words = shell_command("undeadzone", "run", scenario)
    if not driven:
        words = f"{shell_command('undeadzone', 'watch', scenario)} of readings from now on"
    if len(logs) == 1 and options["resample"] is None:
        given = {"columns": options["columns"], "delay": late}
        words = f"{shell_command('undeadzone', 'estimate', scenario, *logs, **given)}, {words}"
    return f"{words}, or {shell_command('undeadzone', 'export', scenario)}" if driven else words


def _propose_next_input(answer: Answers) -> tuple[NextLog | None, dict[str, str]]:
    """Return the input to record next and its description, or None and the reason."""
    from undeadzone_identify.results.result import Identified

    if not isinstance(answer, Identified):
        return None, {"no next log": "it takes the plant of one output, named by --columns"}
    try:
        best = answer.next_log()
    except InputError as error:
        return None, {"no next log": str(error).removeprefix("next: ")}
    return best, {"record next": best.description}


def _write_scenario_file(answer: Answers, path: Path, force: bool) -> tuple[list[Path], str | None]:
    """Write the scenario; return its path, or no path and the reason."""
    from undeadzone.util.own_files import write_own_file

    try:
        return [write_own_file(answer.scenario(path.stem), path, force)], None
    except InputError as error:
        return [], str(error)


def _write_pages(answer: Answers, folder: Path, source: str, best: NextLog | None) -> list[Path]:
    """Write a page with figures for each output to a folder; return the paths."""
    from undeadzone.results.mjcf import write_gears
    from undeadzone_identify.page import write_identified
    from undeadzone_identify.results.result import Identified, IdentifiedOutputs
    from undeadzone_identify.results.words import servo_joints

    written = []
    if isinstance(answer, Identified):
        written = write_gears(servo_joints(answer.answer), folder)
    if not isinstance(answer, IdentifiedOutputs):
        return written + write_identified(answer, folder, source, build_origin(None), best)
    for k, (name, one) in enumerate(zip(answer.names, answer.outputs, strict=True)):
        written += write_identified(
            one, folder / f"output-{k}", f"{source}, {name}", build_origin(None)
        )
    return written
