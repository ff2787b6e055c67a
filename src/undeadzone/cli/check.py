"""undeadzone check SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import common, json_text, print_json, print_pairs, progress, yes_no

if TYPE_CHECKING:
    from undeadzone.scenario.schema import Scenario
    from undeadzone.synthesis.assessment import Gains

REFUSED = "not certified: "  # before the reason, where `design.check` gives it


@click.command(
    epilog="Example: undeadzone check examples/paper_5sin.toml --out verdict && open verdict/report.html"
)
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@common
def check(scenario: Path, out: Path | None, as_json: bool, no_figures: bool) -> int:
    """Judge the gains of a scenario's observer without a simulation.

    Prints whether one V proves x^ -> x for every sequence of sides (else at which frequency 1 + G fails, and the nearest
    certified gains; a nonlinear model is judged on the scenario's [region]), how fast the error dies along the reference,
    and which widths its readings can tell, how well, and what would help. Writes check.json, figures and report.html to
    DIR (default: NAME-check); with --no-figures and no --out it writes nothing. Exit code 1: not certified (observers
    without constant gains need not be), a run leaves the region, or not every width can be identified.
    """
    from undeadzone.scenario.problem import resolve_scenario
    from undeadzone.scenario.reader import read
    from undeadzone.support.files import write_text
    from undeadzone.synthesis.assessment import assess, attack
    from undeadzone.synthesis.check import summary as told

    problem = read(scenario)
    with progress("judging", None) as advance:
        of = assess(resolve_scenario(problem))
        near = None if of.gains is None else of.gains.nearest
        summary = told(of) | {"nearest": None if near is None else in_numbers(near)}
        folder = out if out is not None else None if no_figures else Path(f"{scenario.stem}-check")
        written = (
            [] if folder is None else [write_text(json_text(summary) + "\n", folder / "check.json")]
        )
        if folder is not None and not no_figures:
            from undeadzone.report.gains_page import write_gains

            tried = attack(of)
            advance(1)
            written += write_gains(of, tried, folder)
    if as_json:
        print_json(summary | {"files": [str(path) for path in written]})
    else:
        print_pairs(
            in_words(summary, problem)
            | ({"written": ", ".join(map(str, written))} if written else {})
        )
    known = (
        summary["identifiable"]
        if isinstance(summary["identifiable"], list)
        else [summary["identifiable"]]
    )
    covered = summary["certified"] is not False and summary["left_region"] is None
    return 0 if covered and all(verdict["right"] and verdict["left"] for verdict in known) else 1


def in_words(summary: dict[str, Any], problem: Scenario) -> dict[str, Any]:
    """What the judge found, for `print_pairs`."""
    shown: dict[str, Any] = {
        "scenario": summary["title"],
        "observer": f"{problem.observer.__struct_config__.tag}, {problem.simulation.time} time",
    }
    if summary["certified"] and problem.region is not None:
        shown["certified"] = (
            f"yes on the region, margin {summary['margin']:.4g}: V never rises while x, x^ and u stay in it, whatever the sides do"
        )
    elif summary["certified"]:
        frequency = (
            "for large frequencies"
            if summary["frequency"] is None
            else f"at {summary['frequency']:.4g} rad/s"
        )
        shown["certified"] = (
            f"yes, margin {summary['margin']:.4g} {frequency}: V never rises, whatever the sides do"
        )
    elif summary["certified"] is False:
        shown["certified"] = "NO: " + "; ".join(
            reason.removeprefix(REFUSED)
            for reason in summary["reasons"]
            if reason.startswith(REFUSED)
        )
    if problem.region is not None and summary["certified"] is not None:
        left = summary["left_region"]
        shown["region"] = (
            "a run of the scenario stays in it"
            if left is None
            else f"LEFT at {left:.4g} s of a run of the scenario: no claim from there"
        )
    if near := summary.get("nearest"):
        shown["nearest certified"] = (
            f"L = {plain(near['L'])}, gamma = {plain(near['gamma'])}: margin {near['margin']:.3g}, rate {near['rate']:.4g} 1/s"
        )
        shown["faster ones"] = (
            "undeadzone design finds certified gains by their rate and what they trade for it"
        )
    if bounds := summary.get("l2_gain"):
        shown["bounded"] = (
            f"L2 gain to z - z^ {bounds['disturbance']:.4g} from the input's disturbance, {bounds['noise']:.4g} from noise on y"
        )
    if summary["rate"] is not None:
        after = (
            "the error does not die"
            if summary["time_constant"] is None
            else f"time constant {summary['time_constant']:.4g} s"
        )
        shown["rate"] = f"{summary['rate']:.4g} 1/s along the reference, {after}"
    if summary["never"]:
        shown["stays"] = (
            f"{', '.join(summary['never'])}: these errors stay along this reference, whatever the gains"
        )
    known, std = (
        value if isinstance(value, list) else [value]
        for value in (summary["identifiable"], summary["std"])
    )
    for i, (verdict, deviation) in enumerate(zip(known, std, strict=True)):
        where = f" {i}" if len(known) > 1 else ""
        shown[f"identifiable{where}"] = yes_no(verdict)
        if found := [
            f"{name} {value:.2g}" for name, value in deviation.items() if value is not None
        ]:
            unit = "" if problem.units.output == "1" else f" {problem.units.output}"
            shown[f"expected std{where}"] = (
                f"{', '.join(found)}{unit} after {problem.simulation.duration:g} s at best"
            )
    reasons = [reason for reason in summary["reasons"] if not reason.startswith(REFUSED)]
    return shown | {
        name: words for name, words in (("why", reasons), ("cure", summary["cures"])) if words
    }


def in_numbers(found: Gains) -> dict[str, Any]:
    """Gains and what they are worth, for JSON."""
    return {
        "L": found.L.tolist(),
        "gamma": found.gamma.tolist(),
        "margin": found.certificate.margin,
        "rate": found.rates.rate,
    }


def plain(gains: list[Any]) -> str:
    """Gains as one would write them in a scenario, to six digits; one column as a plain list, one number as itself."""
    flat = [row[0] if isinstance(row, list) and len(row) == 1 else row for row in gains]
    words = [plain(row) if isinstance(row, list) else f"{row:.6g}" for row in flat]
    return (
        words[0] if len(words) == 1 and not isinstance(gains[0], list) else f"[{', '.join(words)}]"
    )
