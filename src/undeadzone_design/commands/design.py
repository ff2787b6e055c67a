"""undeadzone design SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import undeadzone as uz
from undeadzone.cli.common import build_origin, force_option, shell_command, value_option
from undeadzone.cli.output import Output, add_scenario_options, files_line
from undeadzone.util.progress import terminal_progress as progress


def parse_weights(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    """Return the three numbers of D,M,N."""
    if value is None:
        return None
    try:
        numbers = tuple(map(float, value.split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(0 <= power < float("inf") for power in numbers):
        raise click.BadParameter(
            "expected three numbers, none negative, with commas between them, as in 1,0,0.5, "
            f"found {value!r}",
            context,
            parameter,
        )
    return numbers


AIMS = click.Choice(["knee", "rate"])
COUNT = click.IntRange(min=0)


@click.command(
    epilog="Example: undeadzone design examples/paper_5sin.toml --out mine, then look at "
    "mine/report.html"
)
@value_option("--maximise", None, "The knee of the front (default), or the rate alone.", type=AIMS)
@value_option(
    "--weights",
    "D,M,N",
    "Maximise instead rate / (disturbance^D mismatch^M noise^N).",
    callback=parse_weights,
)
@value_option("--margin", None, "Least margin of the certificate, between 0 and 1.", default=0.01)
@value_option(
    "--seed", None, "Seed of the search. The same seed gives the same gains.", default=0, type=COUNT
)
@force_option
@add_scenario_options
def design(
    scenario: Path,
    maximise: str | None,
    weights: tuple[float, ...] | None,
    margin: float,
    seed: int,
    output: Output,
    force: bool,
    confine: Path | None,
) -> bool:
    """Find gains L, gamma for a scenario's plant, sensor and reference, with a proof.

    Prints the gains, the proof, the rate, the differences from your present gains, and the
    identifiability of the widths. Writes design.toml, figures and report.html to DIR (default:
    NAME-design). With --no-figures and no --out it writes nothing. A scenario uses the file by

    \b
        [observer]
        method = "certified"
        design = "NAME-design/design.toml"

    and the proof is checked again whenever the file is read. Exit code 1: no gains can be certified
    for this plant.
    """
    from undeadzone.scenario.problem import systems
    from undeadzone.util.own_files import require_own_file
    from undeadzone_design.synthesis.assessment import attack_gains
    from undeadzone_design.synthesis.check import describe_design_and_check, list_design_numbers
    from undeadzone_design.synthesis.design import (
        apply_design,
        count_design_rounds,
        why_not_certifiable,
    )

    if maximise is not None and weights is not None:
        raise click.UsageError(
            "give --maximise or --weights, not both", click.get_current_context()
        )
    planned = uz.read(scenario, confine)
    folder = output.choose_folder(f"{scenario.stem}-design")
    if folder is not None:
        require_own_file(folder / "design.toml", force)
    _, flow, _ = systems(planned)
    reason = why_not_certifiable(flow)
    if reason:
        output.print_result(
            lambda: {"title": planned.title, "certified": False, "reasons": [reason]},
            lambda: [_describe_impossible(planned, scenario, reason)],
            written=[],
        )
        return False
    aim: Any = (maximise or "knee") if weights is None else uz.Weights(*weights)
    with progress("designing", count_design_rounds(aim)) as advance:
        result = uz.design(planned, aim, margin=margin, seed=seed, progress=advance)
        judged = uz.check(apply_design(planned, result))
    written = [] if folder is None else [result.save(folder / "design.toml")]
    if folder is not None and output.figures:
        from undeadzone_design.report.gains_page import write_gains

        attempts = attack_gains(judged.assessment, seed)
        written += write_gains(judged, attempts, folder, result, build_origin(scenario, seed))
    output.print_result(
        lambda: list_design_numbers(result, judged),
        lambda: describe_design_and_check(result, judged),
        written,
        files_line(written) | _advise_after_design(folder),
    )
    return True


def _advise_after_design(folder: Path | None) -> dict[str, str]:
    """Return the advice on use of the written gains in a scenario, empty without a file."""
    if folder is None:
        return {}
    return {
        "next": f'[observer] method = "certified" and design = "{folder / "design.toml"}" in the '
        "scenario, then undeadzone run"
    }


def _describe_impossible(scenario: uz.Scenario, path: Path, reason: str) -> dict[str, str]:
    """Return the reason that no gains can be certified, as text by name."""
    return {
        "scenario": scenario.title,
        "certified": "NO gains can be",
        "why": reason,
        "next": f"{shell_command('undeadzone', 'check', path)} shows which widths can be known",
    }
