"""Shell lines that a page shows, or a command prints, run by a shell in a folder of their own."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from commands import COMMAND, undeadzone
from documents import ROOT
from undeadzone import errors

# A command inside a line that is printed, up to the words on what it does.
PRINTED = re.compile(
    r"(?:undeadzone|make) .*?(?=, |; | says | shows | writes | builds | of what |  # fits |$)", re.M
)


class Walk:
    """A folder with the examples of a checkout and the command.

    Args:
        folder: the folder.

    Attributes:
        printed: output of each line that ran, in order.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.printed = folder, dict[str, str]()
        (folder / "examples").symlink_to(ROOT / "examples")
        (folder / "bin").mkdir()
        for name, words in (("undeadzone", COMMAND), ("python", [sys.executable])):
            command = folder / "bin" / name
            command.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
            command.chmod(0o755)

    def run(self, line: str, highest: int = 0) -> str:
        """Run a line as it stands and return its output. Its exit code is at most `highest`.

        A command of the package alone runs in this process, unless it restricts its process.
        """
        if re.match(r"undeadzone (?!.*--untrusted)[^|<>&;#$]*$", line):
            return self._keep(line, undeadzone(*shlex.split(line)[1:], cwd=self.folder), highest)
        here = {"PATH": f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"}
        here["PYTHONPATH"] = str(Path(errors.__file__).parents[1])
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=self.folder, env=os.environ | here, capture_output=True, text=True,
        )  # fmt: skip
        return self._keep(line, done, highest)

    def _keep(self, line: str, done: Any, highest: int) -> str:
        assert done.returncode <= highest, f"{line}\n{done.stdout}{done.stderr}"
        self.printed[line] = done.stdout
        return str(done.stdout)


def commands_in(text: str) -> list[str]:
    """The commands that a text has, each once."""
    return [*dict.fromkeys(line.removeprefix("or ") for line in PRINTED.findall(text))]
