"""The command line called in this process, or in a copy of it; a start costs half a second.

`test_hostile_folder.py` and `test_wheel.py` start commands as a shell does.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, NamedTuple, NoReturn, TextIO

from undeadzone.cli import group, untrusted
from undeadzone.cli.ending import run_to_exit_code

COMMAND = [sys.executable, "-c", "from undeadzone.cli import main; main()"]


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
        code = run_to_exit_code(lambda: group.main(words, "undeadzone", standalone_mode=False))
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


def forked(
    *arguments: object, cwd: Path | None = None, stdin: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[bytes]:
    """Run a command in a copy of this process, which ends with it and has streams of its own.

    So a command may give away rights, as `--untrusted` does, and read a pipe, as `watch` does.

    Args:
        arguments: its words.
        cwd: folder that it runs in; default: this one.
        stdin: what it reads.
        environment: variables that it sees besides.
    """
    words = [str(argument) for argument in arguments]
    for thread in threading.enumerate():
        if thread.name == "compile":  # a copy of it would hold locks for ever
            thread.join()
    reading, writing = os.pipe()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: none of ours is left
            pid = os.fork()
        if not pid:
            os.close(writing)
            _copy(words, (reading, out.fileno(), err.fileno()), cwd, environment)
        os.close(reading)
        with contextlib.suppress(BrokenPipeError), open(writing, "wb") as given:
            given.write(stdin)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        outputs = [_whole(stream) for stream in (out, err)]
    return subprocess.CompletedProcess(words, code, *outputs)


def _addresses() -> int:
    """Bytes of addresses of this process: a copy has them at once, a command of a user has not."""
    statm = Path("/proc/self/statm")
    pages = int(statm.read_text().split()[0]) if statm.exists() else 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _copy(
    words: list[str], streams: tuple[int, int, int], folder: Path | None, more: dict[str, str]
) -> NoReturn:
    """What the copy of the process does: the command, on streams given by their numbers."""
    code = 70
    try:
        signal.alarm(120)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
        sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = os.fdopen(2, "w", 1, encoding="utf-8", closefd=False)
        untrusted.MEMORY += _addresses()
        sys.argv = ["undeadzone", *words]
        os.environ.update(more)
        os.chdir(folder or Path.cwd())
        code = run_to_exit_code(lambda: group.main(words, "undeadzone", standalone_mode=False))
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _whole(stream: IO[bytes]) -> bytes:
    """All that was written into a file."""
    stream.seek(0)
    return stream.read()
