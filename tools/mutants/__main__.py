"""Mutants: see the package's docstring."""

from __future__ import annotations

import argparse
import ast
import json
import random
import re
import sys
import time
from pathlib import Path
from typing import Any, Final

from tools.mutants import covering, trial
from tools.mutants.changes import Place, files, mutant, places

ROOT: Final = Path(__file__).parents[2]
SOURCE: Final = ROOT / "src"
FOLDER: Final = ROOT / ".pytest_cache" / "mutants"
CHEAP: Final = 3.0  # [s] of tests that are run first, and usually suffice
OF_TEXT: Final = ("docs", "rules", "emulator")  # folders of tests that run none of the source
ALL: Final = 15.0  # [s] of tests that are run of what these do not notice
FAIL_ALWAYS: Final[set[str]] = set()  # tests that fail without a mutant, too
PASS: Final[set[str]] = set()  # tests that were seen to pass without one


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.mutants", description=__doc__)
    parser.add_argument("act", choices=["map", "run", "again", "survivors"])
    parser.add_argument(
        "options", nargs="*", help="with map: for pytest; with again: FILE:LINE; default: all"
    )
    parser.add_argument("--count", type=int, default=300, help="mutants in all")
    parser.add_argument("--rooms", nargs="+", default=packages(), help="folders or files of src")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--seconds", type=float, default=1e9, help="then stop; with again: for each"
    )
    parser.add_argument("--folder", type=Path, default=FOLDER)
    words = parser.parse_args()
    journal = words.folder / "journal"
    if words.act == "map":
        covering.noted(ROOT, words.folder, words.options or quick_tests())
    elif words.act == "run":
        until = time.monotonic() + words.seconds
        run(words.folder, tuple(words.rooms), words.count, words.seed, until)
    elif words.act == "again":
        again(journal, words.options, words.seconds)
    told(journal)
    return 0


def packages() -> list[str]:
    """The folders of all packages."""
    return sorted(path.name for path in SOURCE.glob("undeadzone*") if path.is_dir())


def quick_tests() -> list[str]:
    """Words of pytest: all tests that take less than a second."""
    folders = (path for path in (ROOT / "tests").iterdir() if list(path.rglob("test_*.py")))
    return [
        "-m",
        "not slow and not long",
        *sorted(str(path) for path in folders if path.name not in OF_TEXT),
    ]


def run(folder: Path, rooms: tuple[str, ...], count: int, seed: int, until: float) -> None:
    """Try mutants until there are so many, or the time is over; those of quick rooms first."""
    cover = covering.read(SOURCE, folder)
    every: list[Place] = []
    for file in files(SOURCE, rooms):
        every += places(SOURCE, file)
    random.Random(seed).shuffle(every)
    journal = folder / "journal"
    done = {(row["file"], row["number"]) for row in rows(journal)}
    trial.preload(ROOT, {test.partition("::")[0] for test in cover.costs})
    costs: dict[str, float] = {}  # of the tests of each room
    for test, cost in cover.costs.items():
        room = room_of(test.removeprefix("tests/"))
        costs[room] = costs.get(room, 0.0) + cost
    drawn = sorted(every[:count], key=lambda place: costs.get(room_of(place.file), 0.0))
    for place in drawn:  # quick rooms first
        if time.monotonic() > until:
            return
        if (place.file, place.number) not in done:
            row = place._asdict() | tried(place, cover)
            with open(journal, "a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


def tried(place: Place, cover: covering.Covering) -> dict[str, Any]:
    """What became of a mutant.

    A test that notices it counts where it passes without it: one that fails always is left out.
    """
    near = {name: rank for rank, name in enumerate(tests_of_room(place.file))}

    def order(test: str) -> tuple[int, float]:
        return near.get(test.partition("::")[0], len(near)), cover.costs[test]

    tests = sorted(cover.tests(place.file, place.line), key=order)
    tree = mutant(SOURCE, place)
    plain = ast.parse((SOURCE / place.file).read_text(encoding="utf-8"))
    for seconds in (CHEAP, ALL):
        chosen = affordable([test for test in tests if test not in FAIL_ALWAYS], cover, seconds)
        while chosen:
            noticed, how = trial.noticed(place.file, tree, chosen, seconds)
            if noticed and how in chosen and how not in PASS:
                fails = trial.noticed(place.file, plain, [how], cover.costs[how])[0]
                (FAIL_ALWAYS if fails else PASS).add(how)
            if not noticed or how not in FAIL_ALWAYS:
                break
            chosen = [test for test in chosen if test not in FAIL_ALWAYS]
        else:
            noticed, how = False, ""
        if noticed:
            break
    how = how or ("" if tests else "no test that is mapped runs this line")
    return {"noticed": noticed, "how": how, "tests": len(tests)}


def again(journal: Path, chosen: list[str], seconds: float) -> None:
    """Try what survived as a program that starts anew, on all tests of its room.

    Args:
        journal: of the mutants, which is written anew.
        chosen: places as FILE:LINE (empty: all that survived).
        seconds: for each.
    """
    every = rows(journal)
    for row in every:
        if row["noticed"] or (chosen and f"{row['file']}:{row['line']}" not in chosen):
            continue
        place = Place(*(row[name] for name in Place._fields))
        tree, tests = mutant(SOURCE, place), tests_of_room(place.file)
        row["noticed"], row["how"] = trial.noticed_afresh(ROOT, place.file, tree, tests, seconds)
        lines = "".join(json.dumps(row) + "\n" for row in every)
        journal.write_text(lines, encoding="utf-8")
        print(f"{place.file}:{place.line}  {place.what}  {row['how']}", flush=True)


def tests_of_room(file: str) -> list[str]:
    """The files of tests of a file's room: that of its name first, then those that name it."""
    module = Path(file)
    folder = ROOT / "tests" / Path(*module.parts[: 2 if module.parts[0] == "undeadzone" else 1])
    names = re.compile(rf"\b{module.stem}\b")

    def rank(path: Path) -> tuple[bool, bool]:
        return path.stem != f"test_{module.stem}", not names.search(path.read_text("utf-8"))

    found = sorted(folder.parent.rglob("test_*.py") if folder.suffix else folder.rglob("test_*.py"))
    return [str(path.relative_to(ROOT)) for path in sorted(found, key=rank)]


def affordable(tests: list[str], cover: covering.Covering, seconds: float) -> list[str]:
    """The first tests, one of each name first, within so many seconds; at least one."""
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


def room_of(file: str) -> str:
    """The room of a file of the tool, or another package as a whole."""
    first, second = file.split("/")[:2]
    return second if first == "undeadzone" and not second.endswith(".py") else first


def told(journal: Path) -> None:
    """Print the share that was noticed, by room, and what survived."""
    every = rows(journal)
    by_room: dict[str, list[bool]] = {}
    for row in every:
        by_room.setdefault(room_of(row["file"]), []).append(row["noticed"])
    for room, noticed in sorted(by_room.items()):
        print(f"{room}: {sum(noticed)} of {len(noticed)} noticed")
    print(f"all: {sum(row['noticed'] for row in every)} of {len(every)} noticed")
    for row in every:
        if not row["noticed"]:
            print(f"  {row['file']}:{row['line']}  {row['what']}  {row['how']}")


if __name__ == "__main__":
    sys.exit(main())
