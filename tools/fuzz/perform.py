"""A case run: streams, folder and descriptors are its own, and its process, if it asks for one."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from tests.commands import undeadzone
from tests.traps import COMMAND

from tools.fuzz.apart import tell_apart
from tools.fuzz.case import Case, End
from undeadzone.errors import UndeadzoneError
from undeadzone.util.text import escape_controls

LONGEST: Final = 120  # [s] of the clock that a process of its own may take


def perform(case: Case) -> End:
    """Run a case in an empty folder."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        folder = Path(name)
        for file, content in case.files.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(content)
        if case.made is not None:
            case.made(folder)
        with _native() as written, contextlib.chdir(folder / case.inside):
            end = _ended(case, folder)
        left = "" if case.judged is None else case.judged(folder, end)
        return end._replace(native=written.getvalue(), left=left)


def _ended(case: Case, folder: Path) -> End:
    """The end of a case."""
    if case.command is None:
        return _called(case, folder)
    return {"": _commanded, "forked": _forked, "started": _started}[case.apart](case)


def _started(case: Case) -> End:
    """The end of a command that a shell starts."""
    done = subprocess.run(
        [*COMMAND, *(case.command or ())],
        input=case.stdin,
        capture_output=True,
        timeout=LONGEST,
        env=os.environ | case.settings,
    )
    return _without_remarks(End(done.returncode, done.stdout.decode(), done.stderr.decode()))


def _forked(case: Case) -> End:
    """The end of a command in a process that begins as this one is; what it gives up is its own."""

    def ends() -> Iterator[End]:
        """Yield the end, unless it takes too long."""
        signal.alarm(LONGEST)
        yield _commanded(case)

    told, code = tell_apart(ends())
    if not told:
        return End(code, "", "it died, or took too long")
    return _without_remarks(End(*told[0]))


def _without_remarks(end: End) -> End:
    """An end without the lines that say what a system lacks."""
    lines = end.err.splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith("untrusted: ")]
    return end._replace(err="".join(kept))


def _called(case: Case, folder: Path) -> End:
    """The end of a call."""
    assert case.call is not None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            case.call(folder)
        return End(0, "", "")
    except UndeadzoneError as error:
        return End(2, "", f"undeadzone: {escape_controls(str(error))}\n")
    except Exception:
        return End(70, "", traceback.format_exc())


def _commanded(case: Case) -> End:
    """The end of a command."""
    return End(*undeadzone(*(case.command or ()), stdin=case.stdin))


@contextlib.contextmanager
def _native() -> Iterator[io.StringIO]:
    """What is written to the descriptors of stdout and stderr meanwhile."""
    written = io.StringIO()
    kept = [os.dup(1), os.dup(2)]
    with tempfile.TemporaryFile() as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
        try:
            yield written
        finally:
            for number, before in zip((1, 2), kept, strict=True):
                os.dup2(before, number)
                os.close(before)
            file.seek(0)
            written.write(file.read().decode("utf-8", "replace"))
