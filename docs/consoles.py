"""Writes the output that pages show, as it is today: of each command of a console block, and of
each block of Python that a block of text follows.

Run: python docs/consoles.py [PAGE ...], without a page for all of docs/. Commands run in a folder
with `examples` and the logs of docs/trades, as a reader has them after a download.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

DOCS: Final = Path(__file__).parent
BLOCK: Final = re.compile(r"(?<=```console\n).*?(?=```)", re.S)
PRINTED: Final = re.compile(r"```python\n(.*?)```\n\n```text\n(.*?)(?=```)", re.S)
COMMAND: Final = re.compile(r"^\$ undeadzone (.*)\n((?:(?!\$ ).*\n)*)", re.M)


def link_inputs(folder: Path) -> Path:
    """Link the examples and the logs of the trades into a folder, and return it."""
    for path in (DOCS.parent / "examples", *(DOCS / "trades").glob("*.csv")):
        (folder / path.name).symlink_to(path)
    return folder


def run_block(block: str) -> str:
    """Return a console block with the output that its commands have in one folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = link_inputs(Path(name))
        return COMMAND.sub(lambda match: run_command(match[1], folder), block)


def run_python(match: re.Match[str]) -> str:
    """Return a block of Python and the block of text with its output."""
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, "-c", match[1]]
        folder = link_inputs(Path(name))
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return f"```python\n{match[1]}```\n\n```text\n{done.stdout.rstrip()}\n"


def run_command(line: str, folder: Path) -> str:
    """Return a command as a console shows it, and its output."""
    command = [sys.executable, "-m", "undeadzone", *shlex.split(line)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"undeadzone {line}\n{done.stderr}")
    return f"$ undeadzone {line}\n{done.stdout.rstrip()}\n"


if __name__ == "__main__":
    for page in [Path(name) for name in sys.argv[1:]] or sorted(DOCS.rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        text = PRINTED.sub(run_python, BLOCK.sub(lambda match: run_block(match[0]), text))
        page.write_text(text, encoding="utf-8")
