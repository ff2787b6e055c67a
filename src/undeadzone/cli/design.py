"""undeadzone design SCENARIO.toml"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.check import in_words, plain
from undeadzone.cli.common import common, print_json, print_pairs, progress

if TYPE_CHECKING:
    from undeadzone.analysis.certificate.design_file import Design
    from undeadzone.scenario.schema import Scenario


def powers(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    """The three numbers of D,M,N."""
    if value is None:
        return None
    try:
        found = tuple(map(float, value.split(",")))
    except ValueError:
        found = ()
    if len(found) != 3 or not all(0 <= power < float("inf") for power in found):
        raise click.BadParameter(
            f"expected three numbers, none negative, with commas between them, as in 1,0,0.5; found {value!r}",
            context,
            parameter,
        )
    return found


@click.command(
    epilog="Example: undeadzone design examples/paper_5sin.toml --out mine && open mine/report.html"
)
@click.argument("scenario", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@click.option(
    "--maximise",
    type=click.Choice(["knee", "rate"]),
    default=None,
    help="The knee of the front of rate, disturbance and noise (default), or the rate alone.",
)
@click.option(
    "--weights",
    callback=powers,
    metavar="D,M,N",
    default=None,
    help="Instead: maximise rate / (disturbance^D mismatch^M noise^N).",
)
@click.option(
    "--margin",
    type=float,
    default=0.01,
    show_default=True,
    help="Least margin of the certificate, between 0 and 1.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Of the search: the same seed gives the same gains.",
)
@common
def design(
    scenario: Path,
    maximise: str | None,
    weights: tuple[float, ...] | None,
    margin: float,
    seed: int,
    out: Path | None,
    as_json: bool,
    no_figures: bool,
) -> int:
    """Find gains L, gamma for a scenario's plant, sensor and reference, with a proof.

    Prints the gains, the proof, the rate, what they trade against your present ones, and what can be known. Writes
    design.toml, figures and report.html to DIR (default: NAME-design); with --no-figures and no --out it writes nothing.
    A scenario uses the file by

    \b
        [observer]
        method = "certified"
        design = "NAME-design/design.toml"

    and the proof is checked again whenever it is read. Exit code 1: no gains can be certified for this plant.
    """
    from undeadzone.scenario.reader import read
    from undeadzone.synthesis.check import check as judge
    from undeadzone.synthesis.design import design as search
    from undeadzone.synthesis.design import rounds
    from undeadzone.synthesis.gain_search import Weights

    if maximise is not None and weights is not None:
        raise click.UsageError(
            "give --maximise or --weights, not both", click.get_current_context()
        )
    problem = read(scenario)
    if reason := impossible(problem):
        if as_json:
            print_json(
                {"title": problem.title, "certified": False, "reasons": [reason], "files": []}
            )
        else:
            print_pairs(
                {
                    "scenario": problem.title,
                    "certified": "NO gains can be",
                    "why": reason,
                    "next": f"undeadzone check {scenario} says what can be known",
                }
            )
        return 1
    wanted: Any = (maximise or "knee") if weights is None else Weights(*weights)
    with progress("designing", rounds(wanted)) as advance:
        found = search(problem, wanted, margin=margin, seed=seed, progress=advance)
    folder = out if out is not None else None if no_figures else Path(f"{scenario.stem}-design")
    designed = with_gains(problem, found)
    summary = judge(designed)
    written = [] if folder is None else write(found, designed, folder, not no_figures)
    if as_json:
        print_json(_numbers(found) | summary | {"files": [str(path) for path in written]})
    else:
        print_pairs(
            _words(found, summary, designed)
            | ({"written": ", ".join(map(str, written))} if written else {})
        )
    return 0


def impossible(scenario: Scenario) -> str:
    """Why no gains can be certified for a linear model, or an empty string. Raises InputError and its kinds for a wrong scenario."""
    import numpy as np

    from undeadzone.analysis.certificate.passivity import certify
    from undeadzone.scenario.problem import systems

    _, flow, _ = systems(scenario)
    return (
        ""
        if flow.nonlinear
        else certify(flow.linear, np.zeros((flow.n, flow.p)), np.ones(flow.p)).reason
    )


def with_gains(scenario: Scenario, found: Design) -> Scenario:
    """The scenario with the gains of a design."""
    import msgspec

    from undeadzone.observers import Certified

    kept = scenario.observer if isinstance(scenario.observer, Certified) else Certified()
    return msgspec.structs.replace(
        scenario, observer=msgspec.structs.replace(kept, L=found.L, gamma=found.gamma, design=None)
    )


def write(found: Design, scenario: Scenario, folder: Path, figures: bool) -> list[Path]:
    """The files of a design and of the scenario that has its gains: design.toml always, figures and page where wanted."""
    written = [found.save(folder / "design.toml")]
    if figures:
        from undeadzone.report.gains_page import write_gains
        from undeadzone.scenario.problem import resolve_scenario
        from undeadzone.synthesis.assessment import assess, attack

        of = assess(resolve_scenario(scenario))
        written += write_gains(of, attack(of, found.seed), folder, found)
    return written


def _numbers(found: Design) -> dict[str, Any]:
    """A design for JSON, its gains first."""
    import msgspec

    numbers = msgspec.to_builtins(found)
    return numbers.pop("best") | numbers


def _words(found: Design, summary: dict[str, Any], scenario: Scenario) -> dict[str, Any]:
    units = {
        "rate": " 1/s",
        "disturbance": " rms error per white disturbance",
        "mismatch": " per relative model error",
        "noise": " per rms noise",
    }
    now = {name: f"{name} {getattr(found.best, name):.4g}{unit}" for name, unit in units.items()}
    if found.present is not None:
        now = {
            name: f"{words}; yours {getattr(found.present, name):.4g}"
            for name, words in now.items()
        }
    rest = in_words(summary, scenario)
    return {
        "scenario": rest.pop("scenario"),
        "chosen": f"{found.chosen}, seed {found.seed}",
        "L": plain(found.best.L),
        "gamma": plain(found.best.gamma),
        **{name: rest.pop(name) for name in ("certified", "rate")},
        "proof P": [plain(row) for row in found.P],
        "proof W": plain(found.W),
        "trade": list(now.values()),
        **({"remark": found.remarks} if found.remarks else {}),
        **{name: value for name, value in rest.items() if name != "observer"},
    }
