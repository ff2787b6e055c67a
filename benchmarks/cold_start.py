"""Cold starts of the command line, as multiples of `python -c "import numpy"`."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

SCENARIO = Path(__file__).parents[1] / "examples" / "paper_5sin.toml"
CLI = [sys.executable, "-c", "from undeadzone.cli import main; main()"]
COMMANDS = {
    'python -c "import numpy"': [sys.executable, "-c", "import numpy"],
    "undeadzone --help": [*CLI, "--help"],
    "undeadzone run paper_5sin.toml --no-figures --json": [*CLI, "run", str(SCENARIO), "--no-figures", "--json"],
}


def table(rounds: int = 11) -> str:
    """Medians over interleaved rounds."""
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(rounds):
        for name, command in COMMANDS.items():
            began = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            times[name].append(time.perf_counter() - began)
    medians = {name: statistics.median(values) for name, values in times.items()}
    unit = next(iter(medians.values()))
    rows = [f"| `{name}` | {value / unit:.2f} |" for name, value in medians.items()]
    return "\n".join(["## Cold start\n", "| command | times importing numpy |", "|---|---|", *rows, ""])
