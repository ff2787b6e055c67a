"""Leaderboard of a contest as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from undeadzone.results.sheet import format_number
from undeadzone.util.shown import Block
from undeadzone.util.text import count_noun
from undeadzone_arena.contest.leaderboard import Row, select_contestants

FEW: Final = 3  # methods whose refusal is printed in full
HEAD: Final = (
    "",
    "method",
    "median regret",
    "behind the best",
    "worst regret",
    "worst where",
    "diverged",
    "n/a",
    "rms z - r",
    "coverage",
)


def leaderboard_blocks(
    rows: Sequence[Row], scenarios: int, seeds: int, reasons: Mapping[str, str]
) -> list[Block]:
    """Return a leaderboard as blocks of text and a table.

    Args:
        rows: the leaderboard.
        scenarios: how many it rests on.
        seeds: runs of each method on each scenario.
        reasons: why a method does not apply, by its name.
    """
    places = {row.method: f"{place}" for place, row in enumerate(select_contestants(rows), 1)}
    refused = [row.method for row in rows if row.not_applicable == 1]
    table: list[tuple[str, ...]] = [HEAD]
    for row in rows:
        if row.method not in refused:
            table.append(_text_cells(places.get(row.method, "-"), row))
    blocks: list[Block] = [table]
    if len(refused) <= FEW:
        blocks += [f"not applicable: {name}: {reasons[name]}" for name in refused]
    else:
        blocks.append(f"not applicable (--json has the reasons): {', '.join(refused)}")
    on = f"{count_noun(scenarios, 'scenario')}, {count_noun(seeds, 'run')} each"
    blocks.append(f"{on}; - : line to compare with, 95 % intervals in []")
    return blocks


def _text_cells(place: str, row: Row) -> tuple[str, ...]:
    """Return a row of the leaderboard as text."""
    return (
        place,
        row.method,
        regret_text(row.median_regret, row.median_interval),
        regret_text(row.behind, row.behind_interval),
        regret_text(row.worst_regret, row.worst_interval),
        row.worst_scenario,
        _percent_text(row.diverged),
        _percent_text(row.not_applicable),
        format_number(row.tracking, ".3g", ""),
        format_number(row.coverage, ".2f", ""),
    )


def regret_text(value: float, interval: tuple[float, float]) -> str:
    """Return a regret and its interval as text."""
    return f"{value:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]"


def _percent_text(value: float) -> str:
    """Return a share in percent, empty for 0."""
    return f"{100 * value:.0f} %" if value else ""
