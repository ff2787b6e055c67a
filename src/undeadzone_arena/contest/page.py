"""Page of the arena: ranking, failures, costs and rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from undeadzone.report.html import (
    MOST,
    Html,
    Origin,
    build_page,
    build_paragraph,
    build_section,
    build_table,
    encode_pictures,
    fold_numbers,
    fold_section,
    pick_pictures,
    write_page,
)
from undeadzone.util.files import read_table
from undeadzone.util.text import count_noun
from undeadzone_arena.contest.contest import Contest
from undeadzone_arena.contest.figures import (
    plot_costs,
    plot_leaderboard,
    plot_ranking,
    plot_regret_map,
    plot_traces,
)
from undeadzone_arena.contest.leaderboard import CAP, NAIVE, ZERO, compute_regrets
from undeadzone_arena.contest.metric import TAIL
from undeadzone_arena.contest.traces import Trace
from undeadzone_arena.contest.words import regret_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RULES: Final = (
    "A run counts by J, the rms of z − r of the tracked outputs over its last "
    f"{100 * TAIL:.0f} %: z is the true output, which no method sees. Its regret is "
    f"(J − J_{ZERO}) / ((d_r + d_l) / 2) on the same scenario and seed: {ZERO} knows the state, "
    f"the plant and the disturbance. A run that diverged counts {CAP:g}; beyond {CAP / 2:g} the "
    f"regret of others rises ever more slowly towards that. Where a method is not applicable the "
    f"naive observer ({NAIVE}) is left, and its regret counts.",
    "Ranked is the median over scenarios of the mean over seeds. Its interval resamples scenarios "
    "and seeds, that of the worst resamples seeds alone.",
    "A method has the believed model, the sensor but for its widths, and all that the scenario "
    "declares: ranges of the widths and rough assumptions, never the truth. The lines full_state "
    "and oracle have the true state and the true widths, informed the plant and the disturbance "
    "too.",
    "Numbers were tuned on other scenarios, with the same budget for all.",
)
SHORT: Final = (1, 2, 4, 5)  # columns of the leaderboard that a page begins with
_WORDS: Final = read_table(__file__)


def write_arena(
    contest: Contest, runs: Sequence[Trace], folder: Path, origin: Origin | None
) -> list[Path]:
    """Write the figures as SVG and report.html to a folder. Raises FileError.

    Args:
        contest: contest to show
        runs: of some methods, as `traces.trace_runs` gives them
        folder: folder of the files (created if needed)
        origin: data to compute the same again (None: unknown)

    Returns:
        The paths of the files.
    """
    drawn = arena_figures(contest, runs)
    return write_page(drawn, folder, lambda images: arena_page(contest, images, origin))


def arena_figures(contest: Contest, runs: Sequence[Trace]) -> dict[str, Figure]:
    """Build the figures by name. `runs` are those that `traces.trace_runs` returns."""
    drawn = {
        "leaderboard": plot_first_figure(contest),
        "scenarios": plot_regret_map(
            contest.rows, compute_regrets(contest.results), list(contest.scenarios)
        ),
    }
    if runs:
        drawn["trajectories"] = plot_traces(runs)
    drawn["cost"] = plot_costs(contest.rows)
    return drawn


def plot_first_figure(contest: Contest) -> Figure:
    """Plot median and worst regret of every method."""
    return plot_ranking(contest.rows, contest_size_text(contest))


def panel(axes: Axes, contest: Contest) -> None:
    """Plot median and worst regret of every method on given axes."""
    plot_leaderboard(axes, contest.rows)


def arena_page(contest: Contest, images: Mapping[str, bytes], origin: Origin | None = None) -> str:
    """Return the HTML of the page. `images` are SVGs by the names of `arena_figures`."""
    pictures = encode_pictures(images, _WORDS["captions"])
    blocks: Any = contest.blocks()
    (head, *rows), *notes = blocks
    ranked = [[row[k] for k in SHORT] for row in rows if row[0].isdigit()]
    numbers = {row.method: msgspec.structs.asdict(row) for row in contest.rows}
    every = fold_section("All methods", build_table(head, rows), *map(build_paragraph, notes))
    leaders = [
        build_table([head[k] for k in SHORT], ranked[:MOST]),
        *pick_pictures(pictures, "leaderboard"),
        every,
        fold_numbers(numbers),
        build_paragraph(_WORDS["note"], "note"),
    ]
    rules = [*map(build_paragraph, RULES), _refusal_table(contest), _knob_table(contest)]
    return build_page(
        "The arena",
        _leader_text(contest),
        build_section("Leaderboard", *leaders),
        build_section(
            "Scenario by scenario", *pick_pictures(pictures, "scenarios"), _scenario_table(contest)
        ),
        build_section("One run of it", *pick_pictures(pictures, "trajectories")),
        build_section("What it costs", *pick_pictures(pictures, "cost")),
        build_section("Rules", *rules),
        origin=origin,
    )


def contest_size_text(contest: Contest) -> str:
    """Return the numbers of methods, scenarios and runs as text."""
    parts = [
        count_noun(len(contest.rows), "method"),
        count_noun(len(contest.scenarios), "scenario"),
        count_noun(len(contest.seeds), "run"),
    ]
    return ", ".join(parts) + " each"


def _leader_text(contest: Contest) -> Html:
    """Describe the leader, its margin, and the method of least worst regret."""
    if not contest.contestants:
        return build_paragraph("Lines to compare with only.")
    first, *rest = contest.contestants
    regret = regret_text(first.median_regret, first.median_interval)
    text = f"{contest_size_text(contest)}. Least median regret: {first.method}, {regret}"
    text += f"; its worst is {first.worst_regret:.3f}, on {first.worst_scenario}."
    if rest:
        second = rest[0]
        behind = f"{regret_text(second.behind, second.behind_interval)} behind in the median"
        steady = min(contest.contestants, key=lambda row: row.worst_regret)
        text += f" Next: {second.method}, {second.median_regret:.3f}"
        text += f"; on the same scenario it is {behind}."
        text += f" Least worst regret: {steady.method}, {steady.worst_regret:.3f}."
    return build_paragraph(text)


def _scenario_table(contest: Contest) -> Html:
    """Return a table of the scenarios: widths, noise and step."""
    rows = []
    for name, scenario in contest.scenarios.items():
        sensor = scenario.sensor
        widths = (str(sensor.right), str(sensor.left))
        step = f"{scenario.simulation.step:g} s"
        rows.append((name, scenario.title, *widths, str(sensor.noise), step))
    return fold_section("The scenarios", build_table(("", "", "d_r", "d_l", "noise", "step"), rows))


def _refusal_table(contest: Contest) -> Html:
    """Return a table of the scenarios that refuse a method, with each reason once."""
    refused = [result for result in contest.results if result.worth is None]
    reasons = [(result.method, result.scenario, result.reason) for result in refused]
    rows = list(dict.fromkeys(reasons))
    title = f"Not applicable: {len(rows)} of {len(contest.rows) * len(contest.scenarios)}"
    return fold_section(title, build_table(("method", "scenario", "why"), rows))


def _knob_table(contest: Contest) -> Html:
    """Return a table of the tuned numbers of every method that has knobs."""
    rows = []
    for row in contest.rows:
        knobs = contest.numbers.get(row.method, {})
        if knobs:
            words = [f"{address} {value:.4g}" for address, value in knobs.items()]
            rows.append((row.method, ", ".join(words)))
    return fold_section("Tuned numbers", build_table(("method", "knobs"), rows))
