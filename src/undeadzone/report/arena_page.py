"""The page of the arena: who leads and by how much, where each method fails, what it costs, and by which rules."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undeadzone.arena.contest import Contest
from undeadzone.arena.leaderboard import CAP, FRAME, REFUSED, Row, regrets
from undeadzone.arena.metric import TAIL
from undeadzone.arena.traces import Trace
from undeadzone.report.arena_figures import costs, heat, places, traces
from undeadzone.report.html import Html, folded, page, paragraph, picture, section, table
from undeadzone.report.style import write
from undeadzone.support.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_arena(contest: Contest, runs: Sequence[Trace], folder: Path) -> list[Path]:
    """Write the figures as PNG and report.html to a folder; runs: `traces.traced`. Raises FileError."""
    written = {
        name: write(figure, folder / f"{name}.png")
        for name, figure in figures(contest, runs).items()
    }
    text = arena_page(contest, {name: path.read_bytes() for name, path in written.items()})
    return [*written.values(), write_text(text, folder / "report.html")]


def figures(contest: Contest, runs: Sequence[Trace]) -> dict[str, Figure]:
    """The figures by name."""
    return {
        "leaderboard": places(contest.rows, _runs(contest)),
        "scenarios": heat(contest.rows, regrets(contest.results), list(contest.scenarios)),
        **({"trajectories": traces(runs)} if runs else {}),
        "cost": costs(contest.rows),
    }


def arena_page(contest: Contest, images: dict[str, bytes]) -> str:
    """The page; images: PNGs by the names of `figures`."""

    def shown(name: str, caption: str) -> Html:
        return picture(images[name], caption) if name in images else Html("")

    return page(
        "The arena",
        _verdict(contest),
        section(
            "Leaderboard",
            shown(
                "leaderboard",
                "Dots: median over the scenarios; squares: the worst of them; bars: 95 % intervals. Grey names are lines to compare with.",
            ),
            table(_HEAD, [_cells(row) for row in contest.rows]),
            paragraph(
                "In parentheses: 95 % intervals. Behind the best: median over scenarios of the difference on the same scenario and seed. Width, centre: median "
                "errors of d_r + d_l and d_r − d_l relative to d_r + d_l, where readings can tell. Coverage: of claimed 95 % intervals of the widths. Cost: of "
                "a step, in those of the naive observer.",
                "note",
            ),
        ),
        section(
            "Scenario by scenario", shown("scenarios", "Mean over the seeds."), _settings(contest)
        ),
        section(
            "What it looks like",
            shown(
                "trajectories",
                "The best, the worst that never diverged, the paper's as printed, the naive observer.",
            ),
        ),
        section(
            "What it costs",
            shown(
                "cost",
                "Measured on the virtual machine, or in Python where a method computes there.",
            ),
        ),
        section("Rules", *map(paragraph, _RULES), _refusals(contest), _numbers(contest)),
    )


_HEAD = (
    "method", "median regret", "", "behind the best", "", "worst regret", "", "where",
    "rms z − r", "rms z − z^", "width", "centre", "coverage", "settled", "rms u", "cost", "diverged", "n/a",
)  # fmt: skip


def _cells(row: Row) -> tuple[Any, ...]:
    def interval(ends: tuple[float, float]) -> str:
        return f"({ends[0]:.3f} to {ends[1]:.3f})"

    def rounded(value: float | None) -> float | None:
        return None if value is None else float(f"{value:.3g}")

    return (
        row.method if not row.reference else Html(f'<span class="note">{row.method}</span>'),
        rounded(row.median_regret), interval(row.median_interval), rounded(row.behind), interval(row.behind_interval),
        rounded(row.worst_regret), interval(row.worst_interval), row.worst_scenario,
        *map(rounded, (row.tracking, row.estimation, row.width, row.centre, row.coverage, row.settled, row.effort, row.cost, row.diverged, row.not_applicable)),
    )  # fmt: skip


def _runs(contest: Contest) -> str:
    numbers = {
        "method": len(contest.rows),
        "scenario": len(contest.scenarios),
        "run": len(contest.seeds),
    }
    return (
        ", ".join(f"{count} {what}{'s' * (count > 1)}" for what, count in numbers.items()) + " each"
    )


def _verdict(contest: Contest) -> Html:
    if not contest.contestants:
        return paragraph("Lines to compare with only.")
    first, *rest = contest.contestants
    text = (
        f"{_runs(contest)}. Least median regret: {first.method}, {first.median_regret:.3f} ({first.median_interval[0]:.3f} to {first.median_interval[1]:.3f}); "
        f"its worst is {first.worst_regret:.3f}, on {first.worst_scenario}."
    )
    if rest:
        text += f" Next: {rest[0].method}, {rest[0].median_regret:.3f}; on the same scenario it is {rest[0].behind:.3f} behind in the median"
        text += f" ({rest[0].behind_interval[0]:.3f} to {rest[0].behind_interval[1]:.3f})."
        steady = min(contest.contestants, key=lambda row: row.worst_regret)
        text += f" Least worst regret: {steady.method}, {steady.worst_regret:.3f}."
    return paragraph(text)


_RULES = (
    f"A run counts by J, the rms of z − r of the tracked outputs over its last {100 * TAIL:.0f} %: z is the true output, which no method sees. Its regret is "
    f"(J − J_full) / (J_naive − J_full) with the J of {FRAME[0]} and {FRAME[1]} on the same scenario and seed. It is at most {CAP:g}, which a diverged run "
    f"counts. A method that is not applicable counts {REFUSED:g} there: what is left is the naive observer.",
    "Ranked is the median over scenarios of the mean over seeds. Its interval resamples scenarios and seeds; that of the worst resamples seeds alone.",
    "A method is told the believed model, the sensor but for its widths, and what the scenario declares: ranges of the widths and rough claims, never "
    "the truth. The lines full_state and oracle are told the true state and the true widths.",
    "Numbers were tuned on other scenarios, with the same budget for all.",
)


def _settings(contest: Contest) -> Html:
    rows = []
    for title, scenario in contest.scenarios.items():
        sensor = scenario.sensor
        rows.append(
            (
                title,
                scenario.title,
                str(sensor.right),
                str(sensor.left),
                str(sensor.noise),
                f"{scenario.simulation.step:g} s",
            )
        )
    return folded("The scenarios", table(("", "", "d_r", "d_l", "noise", "step"), rows))


def _refusals(contest: Contest) -> Html:
    rows = list(
        dict.fromkeys(
            (result.method, result.scenario, result.reason)
            for result in contest.results
            if result.worth is None
        )
    )
    return folded(
        f"Not applicable: {len(rows)} of {len(contest.rows) * len(contest.scenarios)}",
        table(("method", "scenario", "why"), rows),
    )


def _numbers(contest: Contest) -> Html:
    rows = [
        (
            row.method,
            ", ".join(
                f"{address} {value:.4g}"
                for address, value in contest.numbers.get(row.method, {}).items()
            ),
        )
        for row in contest.rows
    ]
    return folded("Tuned numbers", table(("method", "knobs"), [row for row in rows if row[1]]))
