"""undeadzone check SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path

import click

import undeadzone as uz
from undeadzone.cli.common import cmd, json_text, origin, with_schema
from undeadzone.cli.output import Output, export_of, line_of_files, on_scenario, to_type
from undeadzone.util.files import write_text
from undeadzone.util.progress import on_terminal as progress


@click.command(
    epilog="Example: undeadzone check examples/paper_5sin.toml --out verdict, then look at "
    "verdict/report.html"
)
@on_scenario
def check(scenario: Path, output: Output, confine: Path | None) -> int:
    """Assess the scenario's gains, and how strongly its readings move z^.

    Prints whether one V proves x^ -> x for every sequence of sides (else at which frequency 1 + G
    fails, and the nearest certified gains; a nonlinear model is certified on the scenario's
    [region]), how fast the error dies along the reference, and which widths its readings can tell,
    how well, and what would help. Writes check.json, figures and report.html to DIR (default:
    NAME-check); with --no-figures and no --out it writes nothing. Exit code 1: not certified
    (observers without constant gains need not be), a run leaves the region, or not every width can
    be identified.
    """
    folder = output.folder(f"{scenario.stem}-check")
    written = []
    judged = uz.read(scenario, confine)
    with progress("judging", None, of=judged.observer) as advance:
        result = uz.check(judged)
        if folder is not None:
            text = json_text(with_schema(result.summary()))
            written.append(write_text(text + "\n", folder / "check.json"))
        if folder is not None and output.figures:
            from undeadzone.report.gains_page import write_gains
            from undeadzone.synthesis.assessment import attack

            attempts = attack(result.assessment)
            again = origin(scenario, judged.simulation.seed)
            advance(1)
            written += write_gains(result.assessment, attempts, folder, origin=again)
    last = line_of_files(written) | _next(scenario, judged, result.summary()["certified"])
    output.show(result.summary, result.blocks, written, last)
    return 0 if result.affirmed else 1


def _next(path: Path, scenario: uz.Scenario, certified: bool | None) -> dict[str, str]:
    """What to type after a verdict; certified: None of an observer without constant gains."""
    if certified is False:
        return to_type(f"{cmd('undeadzone', 'design', path)} searches gains that have a proof")
    varies = scenario.ensemble is not None
    ensemble = [f"{cmd('undeadzone', 'ensemble', path)} varies what may vary"] * varies
    return to_type(*ensemble, *export_of(path, scenario))
