"""A case run in this process: streams, folder and descriptors are its own."""

from __future__ import annotations

import functools
import io
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fuzz.case import Case, End
from undeadzone.cli import group
from undeadzone.cli.ending import ended
from undeadzone.errors import UndeadzoneError
from undeadzone.support.text import printable


def perform(case: Case) -> End:
    """Run a case in an empty folder."""
    with tempfile.TemporaryDirectory() as name, _inside(Path(name)) as folder:
        for file, content in case.files.items():
            (folder / file).write_bytes(content)
        with _native() as written:
            end = _called(case, folder) if case.command is None else _commanded(case)
        return end._replace(native=written.getvalue())


def _called(case: Case, folder: Path) -> End:
    """The end of a call."""
    assert case.call is not None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            case.call(folder)
        return End(0, "", "")
    except UndeadzoneError as error:
        return End(2, "", f"undeadzone: {printable(str(error))}\n")
    except Exception:
        return End(70, "", traceback.format_exc())


def _commanded(case: Case) -> End:
    """The end of a command."""
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.TextIOWrapper(io.BytesIO(), "utf-8")
    before = sys.stdin, sys.stdout, sys.stderr
    sys.stdin, sys.stdout, sys.stderr = io.TextIOWrapper(io.BytesIO(case.stdin)), out, err
    try:
        code = ended(
            functools.partial(
                group.main, list(case.command or ()), "undeadzone", standalone_mode=False
            )
        )
        texts = []
        for stream in (out, err):
            stream.flush()
            texts.append(stream.buffer.getvalue().decode("utf-8", "replace"))
    finally:
        sys.stdin, sys.stdout, sys.stderr = before
    return End(code, *texts)


@contextmanager
def _inside(folder: Path) -> Iterator[Path]:
    """The folder as the current one."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield folder
    finally:
        os.chdir(before)


@contextmanager
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
