"""`python -m tools.fuzz [NAME ...] --seconds 60 --seed 1`; `--case 123` shows one input again."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import tempfile
import time
from collections import Counter
from typing import Final

from tools.fuzz.case import Case, Maker, stream
from tools.fuzz.isolated import Result, results
from tools.fuzz.judge import complaint
from tools.fuzz.perform import perform

NAMES: Final = (
    "formulas",
    "designs",
    "journals",
    "options",
    "scenarios",
    "commands",
    "streams",
    "splits",
    "identify_logs",
    "arms",
    "folders",
    "engines",
    "number_formats",
    "pipes",
    "entry_points",
    "arguments",
    "exports",
)
SHOWN: Final = 5  # cases of one complaint that are named


def maker(name: str) -> Maker:
    """The `case` of a fuzzer."""
    make: Maker = importlib.import_module(f"tools.fuzz.{name}").case
    return make


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--seconds", type=float, default=600.0, help="in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--case", type=int, help="show this case alone")
    words = parser.parse_args()
    names = words.names or NAMES
    if words.case is not None:
        return shown(maker(names[0])(stream(names[0], words.seed, words.case)))
    broke = 0
    with tempfile.TemporaryDirectory() as kernels:
        os.environ["UNDEADZONE_CACHE"] = f"{kernels}/kernels"  # the user's own is not filled
        for name in names:
            until = time.monotonic() + words.seconds / len(names)
            broke += told(name, list(results(name, maker(name), words.seed, words.first, until)))
    return 1 if broke else 0


def told(name: str, every: list[Result]) -> int:
    """Print what became of the cases of a fuzzer; how many broke."""
    wrong: dict[str, list[Result]] = {}
    for result in every:
        if result.complaint:
            where = result.words.strip().splitlines()[-1:] or [""]
            wrong.setdefault(f"{result.complaint}: {where[0][:160]}", []).append(result)
    codes = Counter(result.code for result in every)
    slowest = max((result.seconds for result in every), default=0.0)
    ends = ", ".join(f"{count} x {code}" for code, count in sorted(codes.items()))
    count = sum(map(len, wrong.values()))
    print(f"{name}: {len(every)} tried ({ends}), {count} broke, slowest {slowest:.1f} s")
    for words, cases in sorted(wrong.items(), key=lambda item: -len(item[1])):
        numbers = ", ".join(f"{result.index} ({result.kind})" for result in cases[:SHOWN])
        print(f"  {len(cases)} x {words}\n      cases {numbers}")
    sys.stdout.flush()
    return count


def shown(case: Case) -> int:
    """Print a case, run it, print its end."""
    print(case.kind, case.command)
    for name, content in case.files.items():
        print(f"--- {name}\n{content.decode('utf-8', 'backslashreplace')}")
    if case.stdin:
        print(f"--- stdin\n{case.stdin.decode('utf-8', 'backslashreplace')}")
    end = perform(case)
    print(f"--- {end.code}\n{end.out}\n--- stderr\n{end.err}\n--- native\n{end.native}")
    wrong = complaint(case, end)
    print(f"--- {wrong or 'sound'}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
