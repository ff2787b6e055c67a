"""CPU time of starts of the command line, as multiples of `python -c "import numpy"`.

Kernels and bytecode are on disk already, as they are from the second start on.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import undeadzone
from benchmarks.markdown import head, row
from benchmarks.timing import medians

EXAMPLES = Path(__file__).parents[2] / "examples"
TEMPLATE = Path(undeadzone.__file__).parent / "template.toml"
RUN = ("run", str(EXAMPLES / "paper_5sin.toml"), "--no-figures", "--json")
ENSEMBLE = ("ensemble", str(EXAMPLES / "ensemble.toml"), "--runs", "64", "--no-figures")
CLI = (sys.executable, "-c", "from undeadzone.cli import main; main()")
COMMANDS = {
    'python -c "import numpy"': [sys.executable, "-c", "import numpy"],
    "undeadzone --help": [*CLI, "--help"],
    "undeadzone run paper_5sin.toml --no-figures --json": [*CLI, *RUN],
    "undeadzone run template.toml": [*CLI, "run", str(TEMPLATE)],
    "undeadzone ensemble ensemble.toml --runs 64 --no-figures": [*CLI, *ENSEMBLE],
}


def table(rounds: int = 11) -> str:
    """Medians over interleaved rounds, after one that is not counted."""
    with tempfile.TemporaryDirectory() as folder:
        programs = {name: partial(start, command, folder) for name, command in COMMANDS.items()}
        seconds = medians(programs, rounds, 1, spent)
    unit = next(iter(seconds.values()))
    rows = [row(f"`{name}`", f"{s / unit:.2f}", f"{s:.2f}") for name, s in seconds.items()]
    columns = head("command", "times importing numpy", "CPU s")
    return "\n".join(["## Cold start\n", *columns, *rows, ""])


def start(command: list[str], folder: str) -> None:
    """Run a command in a folder, which holds the cache, too."""
    environment = os.environ | {"UNDEADZONE_CACHE": folder}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    subprocess.run(command, check=True, capture_output=True, cwd=folder, env=environment)


def spent() -> float:
    """CPU time of the programs that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
