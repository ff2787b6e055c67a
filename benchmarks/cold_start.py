"""Starts of the command line, as multiples of `python -c "import numpy"`.

The kernels of the ensemble are on disk already.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.markdown import head, row
from benchmarks.timing import medians

EXAMPLES = Path(__file__).parents[1] / "examples"
RUN = ("run", str(EXAMPLES / "paper_5sin.toml"), "--no-figures", "--json")
ENSEMBLE = ("ensemble", str(EXAMPLES / "ensemble.toml"), "--runs", "64", "--no-figures")
CLI = (sys.executable, "-c", "from undeadzone.cli import main; main()")
COMMANDS = {
    'python -c "import numpy"': [sys.executable, "-c", "import numpy"],
    "undeadzone --help": [*CLI, "--help"],
    "undeadzone run paper_5sin.toml --no-figures --json": [*CLI, *RUN],
    "undeadzone ensemble ensemble.toml --runs 64 --no-figures": [*CLI, *ENSEMBLE],
}


def table(rounds: int = 11) -> str:
    """Medians over interleaved rounds, after one that is not counted."""
    with tempfile.TemporaryDirectory() as folder:
        programs = {name: partial(start, command, folder) for name, command in COMMANDS.items()}
        seconds = medians(programs, rounds, uncounted=1)
    unit = next(iter(seconds.values()))
    rows = [row(f"`{name}`", f"{s / unit:.2f}", f"{s:.2f}") for name, s in seconds.items()]
    columns = head("command", "times importing numpy", "seconds")
    return "\n".join(["## Cold start\n", *columns, *rows, ""])


def start(command: list[str], folder: str) -> None:
    """Run a command in a folder, which holds the cache, too."""
    environment = os.environ | {"UNDEADZONE_CACHE": folder}
    subprocess.run(command, check=True, capture_output=True, cwd=folder, env=environment)
