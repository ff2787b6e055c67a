"""Budgets of syntax nodes: one for each room of `undeadzone`, one for each package beside it.

`nodes.toml` holds them. `tests/test_budget.py` compares them with the code.

    python tests/rules/node_budget.py                     print nodes and budgets
    python tests/rules/node_budget.py --lower             lower the budgets to today's nodes
    python tests/rules/node_budget.py --rename ends=nonlinearities
                                                          give a room's budget to its new name
"""

from __future__ import annotations

import argparse
import functools
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from source_measures import read_sources

TABLE = Path(__file__).with_name("nodes.toml")
TOOL, TOP, TOTAL = "undeadzone", "(root)", "(total)"
GOAL = 300_000  # nodes of all packages
SLACK = 0.15  # share of a budget that may be unused
HEAD = """\
# Syntax nodes that a room of undeadzone, or a package beside it, may have. Budgets only fall;
# docstrings, comments, imports and annotations are free.
# `python tests/rules/node_budget.py --lower` writes this file. Empty lines between the rows let git
# merge branches that lower different rows. "(total)" is the limit of all packages together.
"""


def name_room(path: str) -> str:
    """Return the room of a file: a folder of undeadzone, its top, or another package."""
    package, *folders = PurePosixPath(path).parts[:-1]
    if package != TOOL:
        return package
    return folders[0] if folders else TOP


@functools.cache
def measure_rooms() -> Counter[str]:
    """Count the syntax nodes of each room."""
    nodes = Counter[str]()
    for source in read_sources():
        nodes[name_room(source.path)] += source.size
    return nodes


def read_budget() -> dict[str, int]:
    """Read the budget of each room and the limit of all."""
    return tomllib.loads(TABLE.read_text(encoding="utf-8"))


def write_budget(budget: dict[str, int]) -> None:
    """Write `nodes.toml`, the total first, the rooms in alphabetical order."""
    rows = [f'"{room}" = {nodes}\n' for room, nodes in sorted(budget.items())]
    rows.sort(key=lambda row: not row.startswith(f'"{TOTAL}"'))
    TABLE.write_text("\n".join([HEAD, *rows]), encoding="utf-8")


def round_to_tens(nodes: int) -> int:
    """Round a number of nodes up to the next 10."""
    return -(-nodes // 10) * 10


def rename_rooms(
    budget: dict[str, int], nodes: dict[str, int], renames: Iterable[tuple[str, str]]
) -> dict[str, int]:
    """Give the budgets of removed rooms to their new names.

    Args:
        budget: budget of each room.
        nodes: syntax nodes of each room today.
        renames: pairs of an old and a new name. A room that was split has several pairs, and its
            parts together get no more than its budget.

    Raises:
        ValueError: An old room still exists or has no budget, or a new room does not exist.
    """
    moved = dict(budget)
    targets: dict[str, list[str]] = {}
    for old, new in renames:
        if old in nodes or old not in budget:
            raise ValueError(f"{old}: the room still exists, or never had a budget")
        if new not in nodes:
            raise ValueError(f"{new}: there is no such room")
        targets.setdefault(old, []).append(new)
    for old, news in targets.items():
        spare = moved.pop(old)
        for new in news[:-1]:
            part = min(spare, round_to_tens(nodes[new]))
            moved[new] = moved.get(new, 0) + part
            spare -= part
        moved[news[-1]] = moved.get(news[-1], 0) + spare
    return moved


def lower_budget(budget: dict[str, int], nodes: dict[str, int]) -> dict[str, int]:
    """Return the budgets lowered to the nodes of today; rooms that are gone leave the table.

    Raises:
        ValueError: A room has no budget.
    """
    missing = sorted(nodes.keys() - budget.keys())
    if missing:
        raise ValueError(
            f"{', '.join(missing)}: a new room needs a budget. Use --rename OLD={missing[0]}"
        )
    lowered = {room: min(budget[room], round_to_tens(count)) for room, count in nodes.items()}
    lowered[TOTAL] = min(budget[TOTAL], round_to_tens(sum(nodes.values())))
    return lowered


def compare_budget(budget: dict[str, int], nodes: dict[str, int]) -> tuple[list[str], list[str]]:
    """Compare rooms and their total with the budgets.

    Returns:
        A line for each room above its budget, and for each one more than `SLACK` below it.
    """
    above, loose = [], []
    for room, count in {**nodes, TOTAL: sum(nodes.values())}.items():
        allowed = budget.get(room, 0)
        line = f"{room}: {count} nodes, budget {allowed}"
        if count > allowed:
            above.append(line)
        elif round_to_tens(count) < (1 - SLACK) * allowed:
            loose.append(line)
    return above, loose


def main() -> int:
    """Print, lower or rename budgets."""
    parser = argparse.ArgumentParser(description="Budgets of syntax nodes.")
    parser.add_argument("--lower", action="store_true", help="Lower the budgets to the code.")
    parser.add_argument("--rename", action="append", default=[], metavar="OLD=NEW",
                        help="Give the budget of a removed room to a new one.")  # fmt: skip
    options = parser.parse_args()
    budget, nodes = read_budget(), measure_rooms()
    try:
        if options.rename:
            pairs = [pair.partition("=") for pair in options.rename]
            budget = rename_rooms(budget, nodes, [(old, new) for old, _, new in pairs])
        if options.lower:
            budget = lower_budget(budget, nodes)
    except ValueError as error:
        parser.error(str(error))
    if options.lower or options.rename:
        write_budget(budget)
    for room, count in sorted(nodes.items()):
        sys.stdout.write(f"{room:22}{count:8} of {budget.get(room, 0):8}\n")
    total = sum(nodes.values())
    sys.stdout.write(f"{TOTAL:22}{total:8} of {budget[TOTAL]:8}, goal {GOAL}\n")
    above, _ = compare_budget(budget, nodes)
    return int(bool(above))


if __name__ == "__main__":
    sys.exit(main())
