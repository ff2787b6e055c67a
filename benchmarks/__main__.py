"""Run the benchmarks named on the command line and print their tables.

With --write their tables replace those of the same title in benchmarks/RESULTS.md, where each has
the commit of the code that made it. Without names all are run and written, one after the other.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

from benchmarks.markdown import parted
from benchmarks.names import commit

NAMES = (
    "cases",
    "cold_start",
    "live_step",
    "long_watch",
    "accuracy",
    "engines",
    "kernels",
    "filters",
    "first_compile",
    "noise",
    "speed",
    "precision",
    "exact",
    "coverage",
    "glitches",
    "honesty",
    "claims",
    "shape",
    "told_apart",
    "ranges",
    "smoothing",
    "closed_loops",
    "colours",
    "arm_coverage",
    "arm_operations",
    "certificates",
    "two_truths",
    "arms",
    "identify",
    "names",
    "strangers",
    "time_constants",
    "plain_fits",
    "lost_motion",
    "motors",
    "reports",
    "valves",
    "identify_known",
    "identify_speed",
    "damaged_logs",
    "firmware",
    "small_code",
    "worst_day",
    "arena_effort",
    "play",
    "play_and_zone",
    "behind_play",
    "both_ends",
    "which",
    "loops",
    "loops_told",
    "servo",
    "gears",
    "gears_anchors",
    "gears_worlds",
    "paper_recomputed",
    "long_tests",
)
HEAD = """# Results

Written by `make bench`, or table by table by `python -m benchmarks --write NAME`. Times are ratios
within one run; machines differ, ratios less so.
"""


def command(name: str) -> str:
    """What makes a table, with the variables that it heeds."""
    heeded = sorted(word for word in os.environ if word.startswith(name.upper().split("_")[0]))
    return " ".join(
        [*(f"{word}={os.environ[word]}" for word in heeded), "python -m benchmarks", name]
    )


def main() -> None:
    # idle threads of one program must not spin beside the next one's
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    names = [word for word in sys.argv[1:] if word != "--write"]
    writes = len(names) < len(sys.argv[1:]) or not names
    results = Path(__file__).with_name("RESULTS.md")
    for name in names or NAMES:
        print(f"{name} ...", file=sys.stderr, flush=True)
        origin = f"At commit {commit()} (`{command(name)}`).\n"
        table = importlib.import_module(f"benchmarks.{name}").table()
        tables = {title: f"{text.strip()}\n\n{origin}" for title, text in parted(table).items()}
        print("\n".join(tables.values()), flush=True)
        if writes:
            stored = parted(results.read_text(encoding="utf-8"))
            every = [f"{text.strip()}\n" for text in (stored | tables).values()]
            results.write_text("\n".join([HEAD, *every]), encoding="utf-8")


main()
