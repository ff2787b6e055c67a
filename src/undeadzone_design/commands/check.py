"""undeadzone check SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path

import click

import undeadzone as uz
from undeadzone.cli.common import (
    WRITTEN,
    add_schema,
    build_origin,
    shell_command,
    to_json_text,
    value_option,
)
from undeadzone.cli.output import (
    Output,
    add_scenario_options,
    export_command,
    files_line,
    next_line,
)
from undeadzone.util.files import write_text
from undeadzone.util.progress import terminal_progress as progress


@click.command(
    epilog="Example: undeadzone check examples/paper_5sin.toml --out verdict, then look at "
    "verdict/report.html"
)
@value_option(
    "--proof",
    "FILE",
    "Write a proof in exact fractions about a certified observer, sampled with its C in double, "
    "for python -m undeadzone_proof FILE.",
    type=WRITTEN,
)
@add_scenario_options
def check(scenario: Path, output: Output, confine: Path | None, proof: Path | None) -> bool:
    """Assess the scenario's gains, and the strength of the feedback from readings to z^.

    Prints whether one V proves x^ -> x for every sequence of sides, the decay rate of the error
    along the reference, and the widths that the readings identify, with the best possible standard
    deviation and an advice. Without a proof it prints the frequency at which 1 + G fails and the
    nearest certified gains. A nonlinear model is certified on the scenario's [region].

    Writes check.json, figures and report.html to DIR (default: NAME-check). With --no-figures and
    no --out it writes nothing.

    Exit code 1: not certified (observers without constant gains need not be), a run leaves the
    region, or a width cannot be identified.
    """
    folder = output.choose_folder(f"{scenario.stem}-check")
    written = []
    judged = uz.read(scenario, confine)
    with progress("judging", None, of=judged.observer) as advance:
        result = uz.check(judged)
        proved = {} if proof is None else {"proved": uz.prove(judged, proof)}
        written += [proof] if proof is not None else []
        if folder is not None:
            text = to_json_text(add_schema(result.summary()))
            written.append(write_text(text + "\n", folder / "check.json"))
        if folder is not None and output.figures:
            from undeadzone_design.report.gains_page import write_gains
            from undeadzone_design.synthesis.assessment import attack_gains

            attempts = attack_gains(result.assessment)
            again = build_origin(scenario, judged.simulation.seed)
            advance(1)
            written += write_gains(result, attempts, folder, origin=again)
    last = (
        proved
        | files_line(written)
        | _advise_after_check(scenario, judged, result.summary()["certified"])
    )
    output.print_result(result.summary, result.blocks, written, last)
    return result.affirmed


def _advise_after_check(
    path: Path, scenario: uz.Scenario, certified: bool | None
) -> dict[str, str]:
    """Return the next commands after a verdict. Without constant gains `certified` has no value."""
    if certified is False:
        return next_line(
            f"{shell_command('undeadzone', 'design', path)} searches gains that have a proof"
        )
    varies = scenario.ensemble is not None
    ensemble = [f"{shell_command('undeadzone', 'ensemble', path)} varies what may vary"] * varies
    return next_line(*ensemble, *export_command(path, scenario))
