"""The command line called in this process, as a shell would call it; a start costs half a second.

`test_untrusted.py` and `test_wheel.py` start them as processes of their own.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, TextIO

from undeadzone.cli import group
from undeadzone.cli.ending import ended


class Done(NamedTuple):
    """What a command left behind, named as in `subprocess`."""

    returncode: int
    stdout: str
    stderr: str


def undeadzone(
    *arguments: object, cwd: Path | None = None, stdin: str | bytes = "", **environment: str
) -> Done:
    """Run a command.

    Args:
        arguments: its words.
        cwd: folder that it runs in; default: this one.
        stdin: what it reads.
        environment: variables that it sees besides.
    """
    words = [str(argument) for argument in arguments]
    given = stdin.encode() if isinstance(stdin, str) else stdin
    read, out, err = io.BytesIO(given), io.BytesIO(), io.BytesIO()
    streams = [io.TextIOWrapper(stream, "utf-8") for stream in (read, out, err)]
    with _as_a_shell(words, streams, cwd or Path.cwd(), environment):
        code = ended(lambda: group.main(words, standalone_mode=False))
        streams[1].flush()
        streams[2].flush()
    return Done(code, out.getvalue().decode(), err.getvalue().decode())


@contextlib.contextmanager
def _as_a_shell(
    words: list[str], streams: Sequence[TextIO], folder: Path, environment: dict[str, str]
) -> Iterator[None]:
    """Streams, words, folder and variables of a command; all is as before at the end."""
    before = sys.argv, sys.stdin, sys.stdout, sys.stderr, dict(os.environ)
    terminate = signal.getsignal(signal.SIGTERM)
    sys.argv = ["undeadzone", *words]
    sys.stdin, sys.stdout, sys.stderr = streams
    os.environ.update(environment)
    try:
        with contextlib.chdir(folder):
            yield
    finally:
        sys.argv, sys.stdin, sys.stdout, sys.stderr, variables = before
        os.environ.clear()
        os.environ.update(variables)
        with contextlib.suppress(ValueError):  # not the main thread
            signal.signal(signal.SIGTERM, terminate)
