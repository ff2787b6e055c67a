"""undeadzone check SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    common,
    confined,
    folder_for,
    json_text,
    named_files,
    print_json,
    print_pairs,
    progress,
)

if TYPE_CHECKING:
    from undeadzone.synthesis.assessment import Gains


@click.command(
    epilog="Example: undeadzone check examples/paper_5sin.toml --out verdict "
    "&& open verdict/report.html"
)
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@confined
@common
def check(
    scenario: Path, out: Path | None, as_json: bool, no_figures: bool, confine: Path | None
) -> int:
    """Assess the scenario's gains, and how strongly its readings move z^.

    Prints whether one V proves x^ -> x for every sequence of sides (else at which frequency 1 + G
    fails, and the nearest certified gains; a nonlinear model is certified on the scenario's
    [region]), how fast the error dies along the reference, and which widths its readings can tell,
    how well, and what would help. Writes check.json, figures and report.html to DIR (default:
    NAME-check); with --no-figures and no --out it writes nothing. Exit code 1: not certified
    (observers without constant gains need not be), a run leaves the region, or not every width can
    be identified.
    """
    from undeadzone.scenario.problem import resolve_scenario
    from undeadzone.scenario.reader import read
    from undeadzone.support.files import write_text
    from undeadzone.synthesis.assessment import assess, attack
    from undeadzone.synthesis.check import affirmed
    from undeadzone.synthesis.check import summary as summary_of
    from undeadzone.synthesis.words import in_words

    checked = read(scenario, confine)
    folder = folder_for(out, no_figures, f"{scenario.stem}-check")
    written = []
    with progress("judging", None) as advance:
        assessment = assess(resolve_scenario(checked), listen=True)
        near = None if assessment.gains is None else assessment.gains.nearest
        summary = summary_of(assessment)
        summary["nearest"] = None if near is None else _in_numbers(near)
        if folder is not None:
            written.append(write_text(json_text(summary) + "\n", folder / "check.json"))
        if folder is not None and not no_figures:
            from undeadzone.report.gains_page import write_gains

            attempts = attack(assessment)
            advance(1)
            written += write_gains(assessment, attempts, folder)
    if as_json:
        print_json(summary | {"files": [str(path) for path in written]})
    else:
        print_pairs(in_words(summary, checked) | named_files(written))
    return 0 if affirmed(summary) else 1


def _in_numbers(gains: Gains) -> dict[str, Any]:
    """Gains and what they are worth, for JSON."""
    return {
        "L": gains.L.tolist(),
        "gamma": gains.gamma.tolist(),
        "margin": gains.certificate.margin,
        "rate": gains.rates.rate,
    }
