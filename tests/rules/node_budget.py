"""Budgets of syntax nodes: one for each room of `undeadzone`, for each other package, and for each
folder beside `src`.

`nodes.toml` holds them. A budget falls, or moves to another room: their sum never rises.
`test_budget.py` compares them with the code, and their sum with each version that git has.

    python tests/rules/node_budget.py                     print nodes and budgets
    python tests/rules/node_budget.py --lower             lower the budgets to today's nodes
    python tests/rules/node_budget.py --move cli=report:200
                                                          move 200 nodes to another room
"""

from __future__ import annotations

import argparse
import functools
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import starmap
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from source_measures import HOME, count_nodes, read_sources

TABLE = Path(__file__).with_name("nodes.toml")
TOOL, TOP = "undeadzone", "(root)"
# Rooms beside src: their folders.
FOLDERS = {
    "benchmarks": "benchmarks",
    "fuzz": "tools/fuzz",
    "mutants": "tools/mutants",
    "supply": "tools/supply",
    "tests": "tests",
}
GOAL = 300_000  # nodes of all packages
SLACK = 0.15  # share of a budget that may be unused
HEAD = """\
# Syntax nodes that a room of undeadzone, a package or folder beside it, may have; docstrings,
# comments, imports and annotations are free. `python tests/rules/node_budget.py` writes this file.
#
# Budgets only fall (--lower). A room that needs more takes it from another one (--move FROM=TO:N),
# in the same change; so does the new name of one that is gone. The rows without a title have one
# sum, [beside] has another, and neither is ever higher than in an earlier version.
# Empty lines between the rows let git merge branches that change different rows.
"""


class Budget(NamedTuple):
    """Nodes by room.

    Attributes:
        src: rooms and packages of src.
        beside: folders beside src.
    """

    src: dict[str, int]
    beside: dict[str, int]

    @property
    def sums(self) -> dict[str, int]:
        """Nodes of src, and of the folders beside it."""
        return {pool: sum(rooms.values()) for pool, rooms in self._asdict().items()}


def name_room(path: str) -> str:
    """Return the room of a file: a folder of undeadzone, its top, or another package."""
    package, *folders = PurePosixPath(path).parts[:-1]
    if package != TOOL:
        return package
    return folders[0] if folders else TOP


@functools.cache
def measure_rooms() -> Budget:
    """Count the syntax nodes of each room."""
    src = Counter[str]()
    for source in read_sources():
        src[name_room(source.path)] += source.size
    beside = {
        room: sum(count_nodes(path.read_text("utf-8")) for path in (HOME / folder).rglob("*.py"))
        for room, folder in FOLDERS.items()
    }
    return Budget(src, beside)


def parse_budget(text: str) -> Budget:
    """Read the budgets of a text; earlier ones had [new], what issues were to add to src."""
    src = tomllib.loads(text)
    beside, new = src.pop("beside"), src.pop("new", {})
    return Budget(src | new, beside)


def read_budget() -> Budget:
    """Read the budgets of `nodes.toml`."""
    return parse_budget(TABLE.read_text("utf-8"))


def write_budget(budget: Budget) -> None:
    """Write `nodes.toml`, the rooms in alphabetical order."""
    src, beside = ([f'"{room}" = {nodes}\n' for room, nodes in sorted(of.items())] for of in budget)
    TABLE.write_text("\n".join([HEAD, *src, "[beside]\n", *beside]), encoding="utf-8")


def read_history() -> list[Budget]:
    """Read the versions of `nodes.toml` that the main line of git's history has, newest first.

    Nothing is read where git, or the history, is missing, nor from before the budgets were frozen.
    """
    separator = "# version\n"
    list_commits = ["git", "rev-list", "--first-parent", "HEAD", "--", TABLE.name]
    read_files = ["git", "cat-file", f"--batch={separator.strip()}"]
    try:
        commits = run_git(list_commits).split()
        texts = run_git(read_files, "".join(f"{each}:./{TABLE.name}\n" for each in commits))
    except (OSError, subprocess.CalledProcessError):
        return []
    return [parse_budget(text) for text in texts.split(separator)[1:] if "[beside]\n" in text]


def run_git(words: Sequence[str], given: str = "") -> str:
    """Return what git prints in the folder of `nodes.toml`."""
    done = subprocess.run(
        words, input=given, cwd=TABLE.parent, capture_output=True, text=True, check=True
    )
    return done.stdout


def find_raises(history: Iterable[Budget], budget: Budget) -> list[str]:
    """Return a line for each sum of budgets that is higher than in an earlier version."""
    earlier = [version.sums for version in history]
    raised = []
    for pool, nodes in budget.sums.items():
        least = min((sums[pool] for sums in earlier), default=nodes)
        if nodes > least:
            raised.append(f"{pool}: {nodes} nodes, {least} before: lower rooms by {nodes - least}")
    return raised


def move_budget(budget: Budget, rooms: Budget, move: str) -> Budget:
    """Move nodes from a room, or from one that is gone, to a room.

    Args:
        budget: of each room.
        rooms: syntax nodes of each room today.
        move: `FROM=TO:N`.

    Raises:
        ValueError: There are no such rooms on the same side of src, or FROM has too few nodes.
    """
    source, _, rest = move.partition("=")
    target, _, number = rest.rpartition(":")
    moved = Budget(*map(dict, budget))
    table = moved.beside if source in moved.beside else moved.src
    present = rooms.beside if source in moved.beside else rooms.src
    if source not in table or target not in present:
        raise ValueError(f"{move}: expected FROM=TO:N, two rooms of src or two beside it")
    if not number.isdecimal() or not 0 < int(number) <= table[source]:
        raise ValueError(f"{move}: expected 1 to {table[source]} nodes")
    table[source] -= int(number)
    table[target] = table.get(target, 0) + int(number)
    return moved


def round_to_tens(nodes: int) -> int:
    """Round a number of nodes up to the next 10."""
    return -(-nodes // 10) * 10


def lower_budget(budget: Mapping[str, int], nodes: Mapping[str, int]) -> dict[str, int]:
    """Return the budgets lowered to the nodes of today; rooms that are gone leave the table.

    Raises:
        ValueError: A room has no budget.
    """
    missing = sorted(nodes.keys() - budget.keys())
    if missing:
        raise ValueError(
            f"{', '.join(missing)}: a new room needs a budget. Use --move FROM={missing[0]}:N"
        )
    return {room: min(budget[room], round_to_tens(count)) for room, count in nodes.items()}


def compare_budget(budget: Budget, nodes: Budget) -> tuple[list[str], list[str]]:
    """Compare rooms with their budgets.

    Returns:
        A line for each room above its budget, and for each one more than `SLACK` below it.
    """
    above, loose = [], []
    budgets = {**budget.src, **budget.beside}
    for room, count in {**nodes.src, **nodes.beside}.items():
        allowed = budgets.get(room, 0)
        line = f"{room}: {count} nodes, budget {allowed}"
        if count > allowed:
            above.append(line)
        elif round_to_tens(count) < (1 - SLACK) * allowed:
            loose.append(line)
    return above, loose


def main(words: Sequence[str] | None = None) -> int:
    """Print, lower or move budgets."""
    parser = argparse.ArgumentParser(description="Budgets of syntax nodes.")
    parser.add_argument("--lower", action="store_true", help="Lower the budgets to the code.")
    parser.add_argument("--move", action="append", default=[], metavar="FROM=TO:N",
                        help="Move nodes to a room from another.")  # fmt: skip
    options = parser.parse_args(words)
    budget, nodes = read_budget(), measure_rooms()
    try:
        for move in options.move:
            budget = move_budget(budget, nodes, move)
        if options.lower:
            budget = Budget(*starmap(lower_budget, zip(budget, nodes, strict=True)))
    except ValueError as error:
        parser.error(str(error))
    if options.lower or options.move:
        write_budget(budget)
    for table, counts in zip(budget, nodes, strict=True):
        for room in sorted({*table, *counts}):
            sys.stdout.write(f"{room:22}{counts.get(room, 0):8} of {table.get(room, 0):8}\n")
    for pool, total in nodes.sums.items():
        goal = f", goal {GOAL}" if pool == "src" else ""
        sys.stdout.write(f"{pool:22}{total:8} of {budget.sums[pool]:8}{goal}\n")
    faults = compare_budget(budget, nodes)[0] + find_raises(read_history(), budget)
    sys.stderr.writelines(f"{fault}\n" for fault in faults)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
