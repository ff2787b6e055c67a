"""What strangers leave in a folder, and how a shell starts a command there."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from undeadzone.errors import FileError

COMMAND = [
    sys.executable,
    "-P",
    "-c",
    "import sys; sys.argv[0] = 'undeadzone'; from undeadzone.cli import main; main()",
]
SHORT = """title = "short"
plant = { A = [[-1.0]], B = [[1.0]], C = [[1.0]] }
sensor = { right = 0.4, left = 0.3 }
reference = { kind = "sine", amplitude = 2.0, frequency = 1.0 }
observer = { method = "kalman", right = [0.1, 1.0] }
controller = { method = "state_feedback", poles = [-6.0] }
simulation = { duration = 0.2, step = 1e-2, time = "sampled" }
"""
TRAP = 'open("RAN", "w").close()\n'
TRAPS = ("pickle", "socket", "struct", "random", "numpy", "undeadzone_arena", "sitecustomize")


def refuse_link(path: Path, link: str, write: Callable[[Path], object]) -> None:
    """Check that nothing is written where a link of a stranger stands.

    Args:
        path: of the file that is to be written.
        link: method of a path that makes the link.
        write: writes it.
    """
    outside = path.with_name("outside")
    if link == "hardlink_to":
        outside.write_bytes(b"")
    getattr(path, link)(outside)
    with pytest.raises(FileError, match=rf"{path.name}: cannot write: it is .* Delete it, or"):
        write(path)
    assert not outside.exists() or outside.read_bytes() == b""
