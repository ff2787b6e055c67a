"""Run the benchmarks named on the command line and print their tables.

Without names all are run, and their tables are written to benchmarks/RESULTS.md.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys
from pathlib import Path

NAMES = (
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
    "identify_known",
    "identify_speed",
    "damaged_logs",
    "firmware",
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
)
HEAD = (
    "# Results\n\nWritten by `make bench`. "
    "Times are ratios within one run; machines differ, ratios less so.\n"
)


def main() -> None:
    # idle threads of one program must not spin beside the next one's
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    names = sys.argv[1:] or NAMES
    parts = [HEAD, f"Python {platform.python_version()}, {platform.machine()}.\n"]
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        parts.append(importlib.import_module(f"benchmarks.{name}").table())
    text = "\n".join(parts)
    if not sys.argv[1:]:
        Path(__file__).with_name("RESULTS.md").write_text(text, encoding="utf-8")
    print(text)


main()
