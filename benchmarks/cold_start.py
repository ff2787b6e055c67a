"""Starts of the command line, as multiples of `python -c "import numpy"`; the kernels of the ensemble are on disk already."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"
CLI = [sys.executable, "-c", "from undeadzone.cli import main; main()"]
COMMANDS = {
    'python -c "import numpy"': [sys.executable, "-c", "import numpy"],
    "undeadzone --help": [*CLI, "--help"],
    "undeadzone run paper_5sin.toml --no-figures --json": [
        *CLI,
        "run",
        str(EXAMPLES / "paper_5sin.toml"),
        "--no-figures",
        "--json",
    ],
    "undeadzone ensemble ensemble.toml --runs 64 --no-figures": [
        *CLI,
        "ensemble",
        str(EXAMPLES / "ensemble.toml"),
        "--runs",
        "64",
        "--no-figures",
    ],
}


def table(rounds: int = 11) -> str:
    """Medians over interleaved rounds, after one that is not counted."""
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds + 1):
            for name, command in COMMANDS.items():
                began = time.perf_counter()
                subprocess.run(
                    command,
                    check=True,
                    capture_output=True,
                    cwd=folder,
                    env=os.environ | {"UNDEADZONE_CACHE": folder},
                )
                times[name].append(time.perf_counter() - began)
    medians = {name: statistics.median(values[1:]) for name, values in times.items()}
    unit = next(iter(medians.values()))
    rows = [f"| `{name}` | {value / unit:.2f} | {value:.2f} |" for name, value in medians.items()]
    return "\n".join(
        [
            "## Cold start\n",
            "| command | times importing numpy | seconds |",
            "|---|---|---|",
            *rows,
            "",
        ]
    )
