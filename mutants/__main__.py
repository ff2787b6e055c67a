"""Mutants: see the package's docstring."""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from pathlib import Path
from typing import Any, Final

from mutants import covering, trial
from mutants.changes import Place, files, mutant, places

ROOT: Final = Path(__file__).parents[1]
PACKAGE: Final = ROOT / "src" / "undeadzone"
FOLDER: Final = ROOT / ".pytest_cache" / "mutants"
# What a step of the closed loop is made of.
LOOP: Final = ("simulation/close.py", "results/scales.py")
ROOMS: Final = (
    "numerics",
    "linalg",
    "analysis",
    "observers/filtering",
    "observers/adaptive",
    "observers/contact_filter",
    *LOOP,
)
CHEAP: Final = 3.0  # [s] of tests that are run first, and usually suffice
ALL: Final = 30.0  # [s] of tests that are run of what these do not notice


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("act", choices=["map", "run", "survivors"])
    parser.add_argument("tests", nargs="*", help="with map: files of tests; default: all")
    parser.add_argument("--count", type=int, default=300, help="mutants in all")
    parser.add_argument("--rooms", nargs="+", default=ROOMS, help="of the mathematics")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9, help="then stop")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    words = parser.parse_args()
    if words.act == "map":
        covering.noted(ROOT, words.folder, words.tests)
    elif words.act == "run":
        until = time.monotonic() + words.seconds
        run(words.folder, tuple(words.rooms), words.count, words.seed, until)
    told(words.folder / "journal")
    return 0


def run(folder: Path, rooms: tuple[str, ...], count: int, seed: int, until: float) -> None:
    """Try mutants until there are so many, or the time is over."""
    cover = covering.read(PACKAGE, folder)
    every: list[Place] = []
    for file in files(PACKAGE, rooms):
        every += places(PACKAGE, file)
    random.Random(seed).shuffle(every)
    journal = folder / "journal"
    done = {(row["file"], row["number"]) for row in rows(journal)}
    trial.preload(ROOT, {test.partition("::")[0] for test in cover.costs})
    for place in every[:count]:
        if time.monotonic() > until:
            return
        if (place.file, place.number) not in done:
            row = place._asdict() | tried(place, cover)
            with open(journal, "a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


def tried(place: Place, cover: covering.Covering) -> dict[str, Any]:
    """What became of a mutant."""
    tests = cover.lines.get(place.file, {}).get(place.line, [])
    tests = sorted(tests, key=lambda test: cover.costs[test])
    if not tests:
        return {"noticed": False, "how": "no test runs this line", "tests": 0}
    tree = mutant(PACKAGE, place)
    first = affordable(tests, cover, CHEAP)
    noticed, how = trial.noticed(PACKAGE, place.file, tree, first, CHEAP)
    rest = affordable(tests, cover, ALL)[len(first) :]
    if not noticed and rest:
        noticed, how = trial.noticed(PACKAGE, place.file, tree, rest, ALL)
    return {"noticed": noticed, "how": how, "tests": len(tests)}


def affordable(tests: list[str], cover: covering.Covering, seconds: float) -> list[str]:
    """The cheapest tests, one of each name first, within so many seconds; at least one."""
    seen: set[str] = set()
    first, others = [], []
    for test in tests:
        name = test.partition("[")[0]
        (others if name in seen else first).append(test)
        seen.add(name)
    chosen, spent = [], 0.0
    for test in [*first, *others]:
        spent += cover.costs[test]
        if chosen and spent > seconds:
            break
        chosen.append(test)
    return chosen


def rows(journal: Path) -> list[dict[str, Any]]:
    """The mutants tried so far."""
    if not journal.exists():
        return []
    return [json.loads(line) for line in journal.read_text(encoding="utf-8").splitlines()]


def told(journal: Path) -> None:
    """Print the share that was noticed, by room, and what survived."""
    every = rows(journal)
    by_room: dict[str, list[bool]] = {}
    for row in every:
        room = next(room for room in ROOMS if row["file"].startswith(room))
        by_room.setdefault(room, []).append(row["noticed"])
    for room, noticed in by_room.items():
        print(f"{room}: {sum(noticed)} of {len(noticed)} noticed")
    print(f"all: {sum(row['noticed'] for row in every)} of {len(every)} noticed")
    for row in every:
        if not row["noticed"]:
            print(f"  {row['file']}:{row['line']}  {row['what']}  {row['how']}")


if __name__ == "__main__":
    sys.exit(main())
